"""The picture: size, what is seen of wheel, rut, stress and end, history, windows, and the physics of the arrows."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest

from soil_env.driving.wheels import Simulation
from soil_env.parameters import load_scenario
from soil_env.rendering import canvas, side_view as rendering
from soil_env.rendering.side_view import Renderer, stresses_under
from soil_env.simulation.world.terrain import cell_at

SCALE = rendering.SCENE[2] / rendering._VIEW  # units of the design per wheel radius


def start(seed=1, changes=None, mode="rgb_array", variant="identified", **options):
    """(simulation, renderer) after a reset."""
    scenario = load_scenario("mixed", changes or {})
    simulation = Simulation(1, scenario, variant)
    simulation.seed(0, np.random.default_rng(seed))
    simulation.restart(0)
    renderer = Renderer(scenario, mode, **options)
    renderer.record(simulation, 0)
    return simulation, renderer


def drive(simulation, renderer, steps, command=0.4):
    """Drive on, recording every step."""
    for _ in range(steps):
        simulation.step(0, command)
        renderer.record(simulation, 0)


def near(picture, colour, tolerance=12):
    """Mask [height, width] of the pixels that have a colour."""
    return (np.abs(picture.astype(int) - colour) <= tolerance).all(axis=-1)


def scene(picture):
    """The side view within a picture of the design's size."""
    x, y, w, h = rendering.SCENE
    return picture[y : y + h, x : x + w]


def hub(simulation):
    """Place (column, row) of the hub in `scene`."""
    w, r = simulation.wheel(0), simulation.numbers.world.wheel.radius
    up = SCALE * (1.0 - w["sinkage"] / r)
    x = rendering._WHEEL_AT[0] * rendering.SCENE[2] - up * math.sin(w["grade"])
    return x, rendering._WHEEL_AT[1] * rendering.SCENE[3] - up * math.cos(w["grade"])


def integral(values, x):
    """Trapezoidal rule."""
    return float(np.sum(0.5 * (values[1:] + values[:-1]) * np.diff(x)))


def ring(picture, simulation):
    """Share of the wheel's rim, by angle, that is drawn in the colour of the rim."""
    x, y = hub(simulation)
    a = np.linspace(0.0, 2.0 * math.pi, 180, endpoint=False)
    radius = 0.97 * SCALE
    rows, columns = np.rint(y + radius * np.sin(a)).astype(int), np.rint(x + radius * np.cos(a)).astype(int)
    return near(scene(picture)[rows, columns], canvas.RIM, 40).mean()


def test_wheel_is_drawn_where_it_is_and_nowhere_else():
    simulation, renderer = start()
    for _ in range(4):
        picture = renderer.draw(simulation, 0)
        assert ring(picture, simulation) > 0.8  # arrow heads lie on the rest
        simulation.worlds.state["sinkage"][0] += 0.03  # m: the ring must have moved with it
        assert ring(picture, simulation) < 0.4
        simulation.worlds.state["sinkage"][0] -= 0.03
        drive(simulation, renderer, 25)


def test_rut_lowers_the_ground_behind_the_wheel():
    simulation, renderer = start()
    drive(simulation, renderer, 60)
    with_rut = scene(renderer.draw(simulation, 0))
    rut = simulation.worlds.courses.rut
    depth = rut[0, cell_at(simulation.worlds.courses, simulation.worlds.state[0]["x"]) - 4]
    rut[:] = 0.0
    without = scene(renderer.draw(simulation, 0))
    column = int(hub(simulation)[0] - 1.5 * SCALE)
    sky = [near(p[:, column], canvas.SKY, 6).sum() for p in (with_rut, without)]
    expected = float(depth) / simulation.numbers.world.wheel.radius * SCALE
    assert expected > 8.0
    assert sky[0] - sky[1] == pytest.approx(expected, abs=0.25 * expected + 3.0)
    ahead = int(hub(simulation)[0] + 1.5 * SCALE)
    assert np.array_equal(with_rut[:, ahead:], without[:, ahead:])


@pytest.mark.parametrize("command", [0.4, -0.3, 0.9])
def test_stresses_sum_to_the_forces_of_the_simulation(command):
    simulation, renderer = start()
    drive(simulation, renderer, 12, command)
    w, world = simulation.wheel(0), simulation.numbers.world.wheel
    angle, normal, shear = stresses_under(simulation, 0)
    r, area = world.radius, world.radius * world.width
    side = math.copysign(1.0, w["speed"])
    load = area * integral(normal * np.cos(angle) + side * shear * np.sin(angle), angle)
    pull = area * integral(shear * np.cos(angle) - side * normal * np.sin(angle), angle)
    torque = r * area * integral(shear, angle)
    weight = w["mass"] * world.gravity * math.cos(w["grade"])
    assert load == pytest.approx(weight, rel=0.02)
    assert torque == pytest.approx(w["torque"], abs=0.03 * weight * r)
    assert pull == pytest.approx(w["drawbar_pull"], abs=0.03 * weight)


def test_history_starts_anew_with_the_episode():
    simulation, renderer = start()
    drive(simulation, renderer, 50)
    assert len(renderer._history) == 51
    renderer.draw(simulation, 0)
    simulation.restart(0)
    renderer.record(simulation, 0)
    assert len(renderer._history) == 1 and renderer._angles == 0.0
    fresh = Renderer(simulation.scenario, "rgb_array")
    fresh.record(simulation, 0)
    assert np.array_equal(renderer.draw(simulation, 0), fresh.draw(simulation, 0))
    renderer.clear()
    assert not renderer._history
    renderer.draw(simulation, 0)


@pytest.mark.parametrize("variant", ["identified", "blind"])
def test_where_nothing_is_identified_no_estimate_is_drawn(variant):
    """Another prior then leaves the picture as it is."""
    pictures = []
    for prior in (30.0, 40.0):
        belief = {"soils": {}, "friction_angle_deg": prior, "shear_modulus": 4e-4 * prior}
        simulation, renderer = start(changes={"belief": belief}, variant=variant)
        drive(simulation, renderer, 20)
        pictures.append(renderer.draw(simulation, 0))
    assert np.array_equal(*pictures) == (variant == "blind")


def test_off_screen_pictures_need_no_display():
    code = (
        "import sys, numpy as np\n"
        "import soil_env.rendering.side_view\n"
        "assert 'pygame' not in sys.modules\n"
        "from tests.rendering.test_side_view import start\n"
        "simulation, renderer = start()\n"
        "assert renderer.draw(simulation, 0).any()\n"
        "import pygame\n"
        "assert not pygame.display.get_init()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=_without_display())
    assert done.returncode == 0, done.stderr


def _without_display():
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    root = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    return env | {"SDL_VIDEODRIVER": "nonexistent", "PYTHONPATH": root}


@pytest.fixture
def dummy_display(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    import pygame

    pygame.display.quit()
    yield pygame
    pygame.display.quit()


FAST = {"control": {"period": 0.01, "substep": 0.01}}


def test_windows_live_and_close_one_by_one(dummy_display):
    pygame = dummy_display
    (sim_a, a), (sim_b, b) = start(mode="human", changes=FAST), start(mode="human", changes=FAST)
    off_screen = Renderer(sim_a.scenario, "rgb_array")
    for _ in range(3):
        drive(sim_a, a, 1)
        drive(sim_b, b, 1)
        assert a.draw(sim_a, 0) is None and b.draw(sim_b, 0) is None
    shown = pygame.surfarray.array3d(a._window.get_surface()).transpose(1, 0, 2)
    off_screen._history, off_screen._angles = a._history, a._angles
    assert np.array_equal(shown, off_screen.draw(sim_a, 0))

    pygame.event.post(pygame.event.Event(pygame.WINDOWCLOSE, window=a._window))
    assert b.draw(sim_b, 0) is None  # b takes the event meant for a
    assert a._id not in Renderer._windows and b._id in Renderer._windows
    for _ in range(2):
        drive(sim_a, a, 1)
        assert a.draw(sim_a, 0) is None and b.draw(sim_b, 0) is None
    for renderer in (a, a, b, b, off_screen, off_screen):
        renderer.close()
    assert not Renderer._windows
