"""What the identifier remembers of terrain classes."""

import math

import numpy as np
import pytest

from soil_env.identification import class_memory as memory
from soil_env.parameters import SoilState, load_scenario
from soil_env.simulation.worlds import Simulation
from soil_env.terramechanics.traversability import best_working_point

SCENARIO = load_scenario("two_lines")
PRIOR, WIDE = np.array([0.5, -4.4, 14.0, 500.0, 0.0]), np.array([0.1, 0.7, 0.6, 400.0, 0.7])
ESTIMATE, SD = np.array([0.6, -4.0, 13.5, 300.0, 0.2]), np.array([0.02, 0.2, 0.1, 300.0, 0.3])


@pytest.fixture
def one():
    kept = memory.new_memory(1, 3)
    memory.forget_classes(kept, 0, PRIOR, WIDE, memory.memory_numbers(SCENARIO))
    return kept


def test_a_class_not_met_is_the_prior(one):
    assert not one.met.any()
    np.testing.assert_array_equal(one.estimate[0], np.tile(PRIOR, (3, 1)))
    np.testing.assert_array_equal(one.sd[0], np.tile(WIDE, (3, 1)))


def test_a_later_estimate_on_the_same_patch_replaces_the_earlier(one):
    memory.remember(one, 0, 1, 4, 2.0 * ESTIMATE, SD)
    memory.remember(one, 0, 1, 4, ESTIMATE, 0.5 * SD)
    np.testing.assert_allclose(one.estimate[0, 1], ESTIMATE)
    np.testing.assert_allclose(one.sd[0, 1], 0.5 * SD)
    assert list(one.met[0]) == [False, True, False]
    np.testing.assert_array_equal(one.estimate[0, 2], PRIOR)


def test_estimates_of_patches_are_weighted_by_precision(one):
    """Mean and standard deviation of independent Gaussian measurements of one number."""
    for patch, (e, s) in enumerate([(ESTIMATE, SD), (1.1 * ESTIMATE, 2.0 * SD), (0.9 * ESTIMATE, SD)]):
        memory.remember(one, 0, 0, patch, e, s)
        memory.remember(one, 0, 2, 10 + patch, PRIOR, WIDE)  # another class between
    weights = np.array([1.0, 0.25, 1.0])
    expected = (weights @ np.array([1.0, 1.1, 0.9])) / weights.sum() * ESTIMATE
    np.testing.assert_allclose(one.estimate[0, 0], expected, atol=1e-12)
    np.testing.assert_allclose(one.sd[0, 0], SD / math.sqrt(weights.sum()))


def best_pull(estimate, load):
    """Best steady drawbar pull over the load of an estimate."""
    wheel, belief = SCENARIO.wheel, SCENARIO.belief
    soil = SoilState(
        math.tan(estimate[0]), estimate[3], math.exp(estimate[1]), math.exp(estimate[2]), belief.sinkage_exponent,
        belief.dig_gain * math.exp(estimate[4]), belief.dig_recovery,
    )  # fmt: skip
    return best_working_point(load, soil, wheel.radius, wheel.width, wheel.stall_torque).drawbar_pull / load


def test_capacity_is_the_mean_of_the_patches_of_a_class(one):
    """Of each patch that of the last estimate on it; a patch without an estimate changes nothing."""
    numbers = memory.memory_numbers(SCENARIO)
    prior = one.capacity[0, 0]
    assert prior == pytest.approx(best_pull(PRIOR, SCENARIO.weight), rel=1e-9)
    memory.judge_class(one, 0, 1, 5, 160.0, numbers)
    np.testing.assert_array_equal(one.capacity[0], prior)  # not met
    other = ESTIMATE + np.array([0.05, 0.3, -0.2, 100.0, 0.1])
    for patch, found, expected in (
        (5, other, best_pull(other, 160.0)),
        (5, ESTIMATE, best_pull(ESTIMATE, 160.0)),
        (8, other, 0.5 * (best_pull(ESTIMATE, 160.0) + best_pull(other, 160.0))),
        (9, ESTIMATE, (2.0 * best_pull(ESTIMATE, 160.0) + best_pull(other, 160.0)) / 3.0),
    ):
        memory.remember(one, 0, 1, patch, found, SD)
        memory.judge_class(one, 0, 1, patch, 160.0, numbers)
        assert one.capacity[0, 1] == pytest.approx(expected, rel=1e-9)
    memory.judge_class(one, 0, 2, 10, 160.0, numbers)
    assert one.capacity[0, 0] == one.capacity[0, 2] == prior


def test_the_end_of_a_patch_is_reached_once(one):
    memory.remember(one, 0, 1, 4, ESTIMATE, SD)
    found = [memory.leaves(one, 0, patch, clear) for patch, clear in ((4, True), (3, False), (4, False), (4, False))]
    assert found == [False, False, True, False]


def test_what_was_learnt_of_a_class_is_near_its_soil():
    """After a course, best drawbar pulls of the classes met: a quarter of their scatter off at most."""
    wheels = 60
    scenario = load_scenario("two_lines", {"control": {"action": "wheel_speed"}, "camera": {"label_error": 0.0},
                                           "course": {"dead_ends": 0.0}})  # fmt: skip
    sim = Simulation(wheels, scenario, "identified", threads=1)
    for k in range(wheels):
        sim.seed(k, np.random.default_rng([11, k]))
    sim.restart_where(np.ones(wheels, dtype=bool))
    what, command = np.zeros(wheels, dtype=np.int8), np.zeros(wheels)
    for _ in range(600):
        halted = sim.worlds.state["halt_left"] > 0.0
        command = np.where(halted, 0.0, np.minimum(command + 0.01, 0.55))
        sim.step_all(command, what)
        what[sim.worlds.cause != 0] = 2
    kept, lines = sim.worlds.memory, sim.worlds.courses.lines
    found, true = [], []
    for k in range(wheels):
        for c in np.flatnonzero(kept.met[k]):
            load = sim.worlds.state["mass"][k] * scenario.gravity
            wheel, soil = scenario.wheel, SoilState(*lines.library[k, c])
            true.append(
                best_working_point(load, soil, wheel.radius, wheel.width, wheel.stall_torque).drawbar_pull / load
            )
            found.append(kept.capacity[k, c])
    error = np.array(found) - true
    assert len(error) > 150 and np.std(true) > 0.08
    assert abs(error.mean()) < 0.03 and error.std() < 0.25 * np.std(true)
