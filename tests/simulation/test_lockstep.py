"""Wheels in lockstep: each as if it were alone, and as the scalar step has it."""

import numpy as np
import pytest

from soil_env._numba.random_streams import seed_stream
from soil_env.parameters import load_scenario
from soil_env.simulation import courses as drawing
from soil_env.simulation import dynamics, lockstep, terrain

WHEELS = 21


def worlds(mode="torque"):
    """(courses, state, streams, numbers) of wheels at rest, each on its own random course."""
    scenario = load_scenario("mixed", {"control": {"action": mode}})
    courses, numbers = terrain.new_courses(WHEELS, scenario), drawing.course_numbers(scenario)
    world, state = dynamics.world_numbers(scenario), np.zeros(WHEELS, dynamics.WHEEL_STATE)
    streams = np.array([seed_stream(np.random.default_rng(k)) for k in range(WHEELS)], dtype=np.uint64)
    for k in range(WHEELS):
        mass = drawing.draw_course(k, courses, streams, numbers)
        dynamics.settle(state, k, mass, courses, streams, world)
    return courses, state, streams, world


def together(w, wheels, commands):
    """One control period of `wheels` at once."""
    which, given = np.zeros(lockstep.MANY), np.zeros(lockstep.MANY)
    which[: len(wheels)], given[: len(wheels)] = wheels, commands[wheels]
    lockstep.advance_many(w[1], which, len(wheels), given, w[0], w[2], w[3])


@pytest.mark.parametrize("mode", ["torque", "wheel_speed"])
def test_a_wheel_does_not_notice_its_neighbours(mode):
    """Alone, among others, in any lane, from the start or in another's place: the same bits of everything."""
    alone, among, rng = worlds(mode), worlds(mode), np.random.default_rng(0)
    for _ in range(60):
        commands = rng.uniform(-0.1, 1.0, WHEELS)
        for k in range(WHEELS):
            together(alone, np.array([k]), commands)
        order = rng.permutation(WHEELS)
        for part in (order[:2], order[2:]):
            together(among, part, commands)
    assert alone[1]["x"].max() > 0.4
    np.testing.assert_array_equal(alone[1], among[1])
    np.testing.assert_array_equal(alone[2], among[2])
    for name, a, b in zip(terrain.Courses._fields, alone[0], among[0], strict=True):
        np.testing.assert_array_equal(a, b, name)


@pytest.mark.parametrize("mode", ["torque", "wheel_speed"])
def test_lockstep_is_the_scalar_step(mode):
    """But for rounding, while the order of sums and the elementary functions differ."""
    one, eight, rng = worlds(mode), worlds(mode), np.random.default_rng(1)
    for _ in range(100):
        commands = rng.uniform(-0.1, 1.0, WHEELS)
        for k in range(WHEELS):
            dynamics.advance(one[1], k, commands[k], one[0], one[2], one[3])
        together(eight, np.arange(WHEELS), commands)
    assert one[1]["x"].max() > 0.4 and one[0].rut.max() > 0.0
    for name in dynamics.WHEEL_STATE.names:
        scale = np.abs(one[1][name]).max() + 1e-3
        np.testing.assert_allclose(eight[1][name], one[1][name], rtol=0.0, atol=1e-6 * scale, err_msg=name)
    np.testing.assert_allclose(eight[0].modulus, one[0].modulus, atol=1e-5)


def test_a_wheel_that_fails_goes_on_alone():
    """A wheel in a state that no iteration gets through leaves its neighbours as they are, and ends as the scalar."""
    one, eight, free = worlds(), worlds(), worlds()
    for w in (one, eight):
        w[1]["sinkage"][3], w[1]["speed"][3], w[1]["wheel_speed"][3] = 0.15, 40.0, -400.0
        w[1]["pull_by_speed"][3] = 1e9
    commands = np.full(WHEELS, 0.4)
    for k in range(WHEELS):
        dynamics.advance(one[1], k, commands[k], one[0], one[2], one[3])
    for w in (eight, free):
        together(w, np.arange(WHEELS), commands)
    rest = np.delete(np.arange(WHEELS), 3)
    np.testing.assert_array_equal(eight[1][rest], free[1][rest])
    for name in ("x", "speed", "wheel_speed", "sinkage", "motor_work"):
        assert eight[1][name][3] == pytest.approx(one[1][name][3], rel=1e-6), name
