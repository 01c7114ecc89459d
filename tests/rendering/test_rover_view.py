"""The rover's picture: wheels, stresses, ruts and body where they are, the episode as it was, video, windows."""

import math

import gymnasium
import numpy as np
import pytest

from soil_env.driving.rovers import RoverSimulation
from soil_env.rendering import canvas, rover_view as rendering
from soil_env.rendering.rover_view import RoverRenderer, posture_of, rover_stresses
from soil_env.rover_env import SoilRoverEnv
from soil_env.simulation.world.terrain import cell_at
from soil_env.vehicle import load_rover, rover_names
from tests.rendering.test_side_view import dummy_display, integral, near  # noqa: F401


def started(rover, seed=1, mode="rgb_array", changes=None, variant="identified", **options):
    """(simulation, view) after a reset."""
    scenario = load_rover(rover, {"control": {"action": "wheel_speed"}, **(changes or {})})
    simulation = RoverSimulation(1, scenario, variant, 1)
    simulation.seed(0, np.random.default_rng(seed))
    simulation.restart(0)
    view = RoverRenderer(scenario, mode, **options)
    view.record(simulation, 0)
    return simulation, view


def drive(simulation, view, steps, command=0.5):
    for _ in range(steps):
        simulation.step(0, np.full(simulation.scenario.axles, command))
        view.record(simulation, 0)


def scene(picture):
    """The side view within a picture of the design's size."""
    x, y, w, h = rendering.SCENE
    return picture[y : y + h, x : x + w]


def hubs(simulation, view):
    """Places (column, row) of the hubs in `scene`, and units of the design per metre."""
    place, rows = posture_of(simulation, 0, view._profile), simulation.wheels[0]
    scale = rendering.SCENE[2] / rendering._width_of(simulation)
    x = simulation.worlds.rovers.wheels.x[rows]
    centre = np.array(view._profile.at(0.5 * (x[0] + x[-1])))
    at = (place.hubs - centre) * scale * (1.0, -1.0)
    return at + np.multiply(rendering._AT, rendering.SCENE[2:]), scale


def ring(picture, x, y, radius):
    """Share of a wheel's rim, by angle, that is drawn in the colour of the rim."""
    a = np.linspace(0.0, 2.0 * math.pi, 120, endpoint=False)
    places = [(y + share * radius * np.sin(a), x + share * radius * np.cos(a)) for share in (0.94, 0.97)]
    return np.any([near(picture[tuple(np.rint(p).astype(int))], canvas.RIM, 40) for p in places], axis=0).mean()


@pytest.mark.parametrize("rover", rover_names())
def test_wheels_are_drawn_where_they_are_and_bear_what_they_bear(rover):
    simulation, view = started(rover)
    drive(simulation, view, 40)
    picture = scene(view.draw(simulation, 0))
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100
    places, scale = hubs(simulation, view)
    r = simulation.numbers.world.wheel.radius
    for name, (x, y) in zip(view._axles, places, strict=True):
        assert ring(picture, x, y, r * scale) > 0.6  # arrow heads and beams lie on the rest
        assert ring(picture, x, y - 0.3 * r * scale, r * scale) < 0.4
        below = picture[int(y) : int(y + 1.9 * r * scale), int(x - r * scale) : int(x + 1.6 * r * scale)]
        assert near(below, canvas.LIGHT_BLUE, 12).sum() > 15
        assert near(picture[int(y) - 3 : int(y) + 4, int(x) - 5 : int(x) + 6], rendering._COLOURS[name][0], 12).any()


@pytest.mark.parametrize("rover", rover_names())
@pytest.mark.parametrize("command", [0.5, 0.9, -0.2])
def test_stresses_sum_to_the_forces_on_every_wheel(rover, command):
    """Load, pull and torque of the state, by the trapezoidal rule; the load is what the suspension gives."""
    simulation, view = started(rover)
    drive(simulation, view, 15, command)
    world, wheels = simulation.numbers.world.wheel, simulation.worlds.rovers.wheels
    r, area = world.radius, world.radius * world.width
    for axle, k in enumerate(simulation.wheels[0]):
        w = wheels[int(k)]
        angle, normal, shear = rover_stresses(simulation, 0, axle)
        side = math.copysign(1.0, w["speed"])
        load = area * integral(normal * np.cos(angle) + side * shear * np.sin(angle), angle)
        pull = area * integral(shear * np.cos(angle) - side * normal * np.sin(angle), angle)
        assert load == pytest.approx(w["load"], rel=0.02)
        assert r * area * integral(shear, angle) == pytest.approx(w["torque"], abs=0.03 * w["load"] * r)
        assert pull == pytest.approx(w["drawbar_pull"], abs=0.03 * w["load"])
    loads = wheels.load[simulation.wheels[0]]
    assert np.ptp(loads) > 0.05 * loads.mean()


def test_a_wheel_behind_is_drawn_on_the_floor_of_the_rut():
    simulation, view = started("field_rover", changes={"course": {"grade_deg": [-1.0, 0.0]}})
    drive(simulation, view, 60)
    rovers, rows, floor = simulation.worlds.rovers, simulation.wheels[0], simulation.worlds.rovers.axles.floor
    assert floor[rows[1]] > 0.01
    view.draw(simulation, 0)
    places, scale = hubs(simulation, view)
    p = posture_of(simulation, 0, view._profile)
    ground = np.array(view._profile.at(rovers.wheels.x[rows[1]]))
    depth = simulation.numbers.world.wheel.radius - math.dist(p.hubs[1], ground)
    assert depth == pytest.approx(rovers.wheels.sinkage[rows[1]] + floor[rows[1]], rel=1e-9)
    with_rut = scene(view.draw(simulation, 0))
    cells = [cell_at(simulation.worlds.courses, rovers.wheels.x[rows[1]]) + ahead for ahead in (5, -5)]
    left = [float(simulation.worlds.ruts.rut[rows[0], cells[0]])]
    left.append(float(simulation.worlds.ruts.floor[rows[1], cells[1]] + simulation.worlds.ruts.rut[rows[1], cells[1]]))
    assert left[1] > left[0] + 0.003
    simulation.worlds.ruts.floor[:] = 0.0
    simulation.worlds.ruts.rut[:] = 0.0
    without = scene(view.draw(simulation, 0))
    r = simulation.numbers.world.wheel.radius
    for behind, depth in ((-0.5 * (places[0, 0] - places[1, 0]), left[0]), (1.6 * r * scale, left[1])):
        column = int(places[1, 0] - behind)  # between the wheels the front one's rut, behind them that of both
        sky = [near(picture[:, column], canvas.SKY, 6).sum() for picture in (with_rut, without)]
        assert sky[0] - sky[1] == pytest.approx(depth * scale, abs=4.0)
    ahead = int(places[0, 0] + 1.7 * simulation.numbers.world.wheel.radius * scale)
    assert np.array_equal(with_rut[80:, ahead:], without[80:, ahead:])


@pytest.mark.parametrize("rover", rover_names())
def test_drawing_changes_neither_the_episode_nor_an_earlier_picture(rover):
    changes = {"rover": rover, "action": "wheel_speed", "course": {"length": 30.0}}
    drawn, plain = SoilRoverEnv(render_mode="rgb_array", **changes), SoilRoverEnv(**changes)
    for env in (drawn, plain):
        env.reset(seed=5)
    first = drawn.render()
    kept = first.copy()
    np.testing.assert_array_equal(drawn.render(), first)
    for k in range(30):
        a, b = (env.step(np.full(env.scenario.axles, 0.5)) for env in (drawn, plain))
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1:] == b[1:]
        if k % 10 == 0:
            drawn.render()
    np.testing.assert_array_equal(first, kept)
    assert not np.array_equal(drawn.render(), first)


def test_a_video_is_recorded(tmp_path):
    pytest.importorskip("moviepy")
    env = gymnasium.make("SoilRover-v0", render_mode="rgb_array", action="wheel_speed", control={"time_limit": 1.0})
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path / "video"), lambda _: True)
    env.reset(seed=0)
    over = False
    while not over:
        over = env.step(np.array([0.5, 0.5], np.float32))[2]
    env.close()
    assert (tmp_path / "video" / "rl-video-episode-0.mp4").stat().st_size > 2000
