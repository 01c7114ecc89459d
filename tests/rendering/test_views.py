"""Pictures of a wheel and of a rover: wheels, stresses and ruts where they are, history, windows,
video.
"""

import math
import os
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from scipy.integrate import trapezoid

from soil_env.parameters import load_rover, load_scenario, rover_names
from soil_env.rendering import canvas
from soil_env.rendering.ground import draw_ground, profile_of
from soil_env.rendering.side_view import AT, SCENE, hubs_of, shown_wheels, width_of
from soil_env.rendering.view import CourseView
from soil_env.rendering.wheels import stresses_under
from soil_env.simulation.world.terrain import CELL, CELLS_BEHIND
from tests.conftest import ROOT
from tests.programs import python
from tests.simulation.wheels import started

VEHICLES = pytest.mark.parametrize("rover", [None, *rover_names()], ids=["wheel", *rover_names()])


def start(rover=None, changes=None, mode="rgb_array", variant="identified"):
    """(simulation, view) after a reset of the wheel of `mixed`, or of a rover."""
    if rover is None:
        scenario = load_scenario("mixed", changes or {})
    else:
        scenario = load_rover(rover, {"control": {"action": "wheel_speed"}} | (changes or {}))
    simulation = started(scenario, variant, [1])
    view = CourseView(scenario, mode)
    view.record(simulation)
    return simulation, view


def drive(simulation, view, steps, command=0.4):
    """Drive on, recording every step."""
    for _ in range(steps):
        simulation.step(0, command)
        view.record(simulation)


def near(picture, colour, tolerance=12):
    """Mask [height, width] of the pixels that have a colour [3], each channel to `tolerance` of
    255.
    """
    return (np.abs(picture.astype(int) - colour) <= tolerance).all(axis=-1)


def ground(simulation):
    """`Profile` of the course, from 1 m before its start to 60 m past it."""
    border = simulation.scenario.course.border
    return profile_of(simulation.worlds.courses, border, 1.0, 60.0)


def hubs(simulation):
    """Places [axles, 2] (column, row) of the hubs in a picture, and its pixels per metre."""
    left, top, width, height = SCENE
    scale = width / width_of(simulation)
    wheels = shown_wheels(simulation)
    profile = ground(simulation)
    middle = 0.5 * (wheels[0]["x"] + wheels[-1]["x"])
    up = hubs_of(simulation, wheels, profile) - profile.at(middle)
    return np.array([left + AT[0] * width, top + AT[1] * height]) + up * scale * (1.0, -1.0), scale


def ring(picture, x, y, radius):
    """Share of a wheel's rim, by angle, that has the colour of the rim at one of two radii in it;
    centre and radius in pixels.
    """
    angle = np.linspace(0.0, 2.0 * math.pi, 120, endpoint=False)
    radii = radius * np.array([[0.94], [0.97]])
    rows = np.rint(y + radii * np.sin(angle)).astype(int)
    columns = np.rint(x + radii * np.cos(angle)).astype(int)
    return near(picture[rows, columns], canvas.RIM, 40).any(axis=0).mean()


@VEHICLES
def test_wheels_are_drawn_where_they_are_and_bear_what_they_bear(rover):
    simulation, view = start(rover)
    drive(simulation, view, 40)
    picture = view.draw(simulation)
    places, scale = hubs(simulation)
    radius = simulation.scenario.wheel.radius * scale
    for x, y in places:
        assert ring(picture, x, y, radius) > 0.6  # arrow heads and beams lie on the rest
        assert ring(picture, x, y - 0.3 * radius, radius) < 0.4
        below = picture[int(y) : int(y + 1.9 * radius), int(x - radius) : int(x + 1.6 * radius)]
        assert near(below, canvas.LIGHT_BLUE).sum() > 15  # of the stresses


@pytest.mark.parametrize("command", [0.5, 0.9, -0.3])
@VEHICLES
def test_stresses_sum_to_the_forces_on_every_wheel(rover, command):
    """Load, pull and torque of the state of a wheel that drives, by the trapezoidal rule; the load
    is what the suspension gives.
    """
    # no halts
    simulation, view = start(rover, {"course": {"halt_interval": [1e3, 1e3]}})
    drive(simulation, view, 15, command)
    wheel = simulation.scenario.wheel
    r = wheel.radius
    area = wheel.radius * wheel.width
    for w in shown_wheels(simulation):
        angle, normal, shear = stresses_under(w, r, wheel.width)
        side = math.copysign(1.0, w["speed"])
        up = normal * np.cos(angle) + side * shear * np.sin(angle)
        along = shear * np.cos(angle) - side * normal * np.sin(angle)
        load, pull, torque = area * trapezoid([up, along, r * shear], angle)
        assert load == pytest.approx(w["load"], rel=0.02)
        assert torque == pytest.approx(w["torque"], abs=0.03 * w["load"] * r)
        assert pull == pytest.approx(w["drawbar_pull"], abs=0.03 * w["load"])


@pytest.mark.parametrize("rover", [None, "field_rover"])
def test_ruts_lower_the_ground_behind_the_wheels(rover):
    """The sky behind the last wheel is higher by their depth in pixels; ahead of the wheels ruts
    change nothing.
    """
    simulation, view = start(rover, {"course": {"grade_deg": [-1.0, 0.0]}})
    drive(simulation, view, 60)
    with_rut = view.draw(simulation)
    worlds = simulation.worlds
    places, scale = hubs(simulation)
    last = shown_wheels(simulation)[-1]
    # Behind the rear wheel of a rover: its own rut in that of the front wheel.
    left = ["depth"] if rover is None else ["depth", "floor"]
    cells = worlds.courses["cells"][0] if rover is None else worlds.ruts[0, -1]
    profile = ground(simulation)
    (hub,) = hubs_of(simulation, [last], profile)
    deep = simulation.scenario.wheel.radius - last["sinkage"] - last["rut"]
    assert math.dist(hub, profile.at(last["x"])) == pytest.approx(deep, rel=1e-9)
    behind = math.floor(last["x"] / CELL) + CELLS_BEHIND - 4
    depth = scale * sum(float(cells[name][behind]) for name in left)
    for name in left:
        (worlds.courses["cells"] if rover is None else worlds.ruts)[name] = 0.0
    without = view.draw(simulation)
    radius = simulation.scenario.wheel.radius * scale
    column = int(places[-1, 0] - 1.5 * radius)
    more, less = (near(p[:, column], canvas.SKY, 6).sum() for p in (with_rut, without))
    assert depth > 3.0 and more - less == pytest.approx(depth, abs=4.0)
    # Below the key of the stresses.
    ahead = np.s_[200:, int(places[0, 0] + 1.7 * radius) : SCENE[2]]
    assert np.array_equal(with_rut[ahead], without[ahead])


@pytest.mark.parametrize("variant", ["identified", "blind"])
def test_where_nothing_is_identified_no_estimate_is_drawn(variant):
    """Another prior friction angle leaves the picture of `blind` as it is, not that of
    `identified`.
    """
    pictures = []
    for prior in (30.0, 40.0):
        belief = {"soils": {}, "friction_angle_deg": prior, "shear_modulus": 4e-4 * prior}
        simulation, renderer = start(changes={"belief": belief}, variant=variant)
        drive(simulation, renderer, 20)
        pictures.append(renderer.draw(simulation))
    assert np.array_equal(*pictures) == (variant == "blind")


def test_off_screen_pictures_need_no_display():
    code = (
        "import sys, numpy as np\n"
        "import soil_env.rendering.view\n"
        "assert 'pygame' not in sys.modules\n"
        "from tests.rendering.test_views import start\n"
        "simulation, renderer = start()\n"
        "assert renderer.draw(simulation).any()\n"
        "import pygame\n"
        "assert not pygame.display.get_init()\n"
    )
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    env |= {"SDL_VIDEODRIVER": "nonexistent", "PYTHONPATH": str(ROOT)}
    python("-c", code, env=env)


def test_no_dash_joins_two_ruts():
    x = np.linspace(0.0, 10.0, 101)
    level = np.stack((x, np.zeros(x.size)), axis=1)
    rutted = ((x > 0.95) & (x < 1.45)) | ((x > 7.95) & (x < 8.35))
    surface = level - np.where(rutted, 0.1, 0.0)[:, None] * (0.0, 1.0)
    dashes = []
    drawn = SimpleNamespace(soil=lambda *_: None, lines=lambda points, *_: dashes.append(points))
    scene = SimpleNamespace(box=(0, 0, 10, 10), at=lambda points: points)
    profile = SimpleNamespace(at=lambda _: level, friction_between=lambda _: None)
    draw_ground(drawn, scene, x, profile, surface, 0.01, (20.0, 40.0))
    assert [np.ptp(dash[:, 0]) for dash in dashes] == pytest.approx([0.2, 0.2])


def test_a_window_shows_the_picture(monkeypatch):
    """Pixel by pixel that of "rgb_array"; two windows are open at once and close one by one."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    import pygame

    pygame.display.quit()
    # A window waits until the period is over.
    fast = {"control": {"period": 0.01, "substep": 0.01}}
    simulation, a = start(mode="human", changes=fast)
    _, b = start(mode="human", changes=fast)
    off_screen = CourseView(simulation.scenario, "rgb_array")
    for _ in range(3):
        drive(simulation, a, 1)
        assert a.draw(simulation) is None and b.draw(simulation) is None
    shown = pygame.surfarray.array3d(a._window.get_surface()).transpose(1, 0, 2)
    off_screen._history = a._history
    off_screen._angles = a._angles
    assert np.array_equal(shown, off_screen.draw(simulation))
    a.close()
    assert b.draw(simulation) is None
    for view in (a, b, b, off_screen):
        view.close()
    pygame.display.quit()


@pytest.mark.parametrize("name", ["SoilWheel-v0", "SoilRover-v0"])
def test_drawing_changes_neither_the_episode_nor_an_earlier_picture(name):
    both = [
        gymnasium.make(name, render_mode=mode, action="wheel_speed") for mode in ("rgb_array", None)
    ]
    drawn, plain = both
    for env in both:
        env.reset(seed=5)
    first = drawn.render()
    kept = first.copy()
    np.testing.assert_array_equal(drawn.render(), first)
    action = np.full(drawn.action_space.shape, 0.5, np.float32)
    for k in range(30):
        (seen, *told), (own, *expected) = (env.step(action) for env in both)
        np.testing.assert_array_equal(seen, own)
        assert told == expected
        if k % 10 == 0:
            drawn.render()
    np.testing.assert_array_equal(first, kept)
    assert not np.array_equal(drawn.render(), first)
    drawn.reset(seed=5)
    np.testing.assert_array_equal(drawn.render(), first)  # the history begins anew


@pytest.mark.parametrize("name", ["SoilWheel-v0", "SoilRover-v0"])
def test_a_video_is_recorded(name, tmp_path):
    pytest.importorskip("moviepy")
    env = gymnasium.make(name, render_mode="rgb_array", control={"time_limit": 1.0})
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path / "video"), lambda _: True)
    env.reset(seed=0)
    over = False
    while not over:
        over = env.step(np.full(env.action_space.shape, 0.5, np.float32))[2]
    env.close()
    assert (tmp_path / "video" / "rl-video-episode-0.mp4").stat().st_size > 2000
