"""Memory of terrain classes: posteriors of patches combined, and calibration after a course."""

import math

import numpy as np
import pytest

from soil_env.driving.wheels import Simulation
from soil_env.identification.online import class_memory as memory
from soil_env.identification.online.identifier import forget, identifier_numbers, new_identifiers
from soil_env.parameters import SoilState, load_scenario
from soil_env.terramechanics.traversability import best_working_point

SCENARIO = load_scenario("two_lines")
NUMBERS = memory.memory_numbers(SCENARIO)
PRIOR, WIDE = NUMBERS.prior, NUMBERS.precision**-0.5
ESTIMATE, SD = PRIOR + 0.4 * WIDE, WIDE * np.array([0.3, 0.4, 0.3, 0.7, 0.5, 0.2])


class Memory:
    """The memory of one wheel, of three classes."""

    def __init__(self):
        self.kept, self.ids = memory.new_memory(1, 3), new_identifiers(1)
        forget(self.ids, 0, identifier_numbers(SCENARIO))
        memory.forget_classes(self.kept, 0, NUMBERS)

    def remember(self, c, patch, estimate, sd):
        """Remember an estimate [6] with sd [6] of a class and a patch; the best drawbar pull is the last of them."""
        sd = sd / np.array([1.0] * 5 + [memory.WIDER])
        self.ids.estimate[0], self.ids.sd[0] = estimate[:5], sd[:5]
        self.ids.best_pull[0] = estimate[5], sd[5]
        memory.remember(self.kept, 0, c, patch, self.ids, NUMBERS)

    def of(self, c):
        """(estimate [6], sd [6]) of a class."""
        return self.kept.estimate[0, c].copy(), self.kept.sd[0, c].copy()


@pytest.fixture
def one():
    return Memory()


def combined(posteriors):
    """Posteriors (mean, sd) of one number each that all hold the prior, which counts once."""
    J, h = WIDE**-2.0, WIDE**-2.0 * PRIOR
    for mean, sd in posteriors:
        J, h = J + sd**-2.0 - WIDE**-2.0, h + sd**-2.0 * mean - WIDE**-2.0 * PRIOR
    return h / J, J**-0.5


def test_precisions_of_patches_add_up_and_the_prior_counts_once(one):
    told = [(ESTIMATE, SD), (ESTIMATE - 0.3 * SD, 0.8 * SD), (ESTIMATE + 0.1 * SD, 1.2 * SD)]
    for patch, (estimate, sd) in enumerate(told):
        one.remember(0, patch, PRIOR, 0.9 * SD)  # an earlier one on the same patch
        one.remember(0, patch, estimate, sd)
        one.remember(2, 10 + patch, ESTIMATE, SD)  # another class between
    for c, told_of_it in ((0, told), (2, [(ESTIMATE, SD)] * 3)):
        np.testing.assert_allclose(one.of(c), combined(told_of_it), rtol=1e-9)
        assert one.kept.patches[0, c] == 3
    assert np.all(one.of(2)[1] > SD / math.sqrt(3.0))  # the prior is no reading of each patch


def test_patches_that_differ_by_more_than_they_allow_are_less_sure(one):
    one.remember(0, 0, ESTIMATE, SD)
    one.remember(0, 1, ESTIMATE + 3.0 * math.sqrt(2.0) * SD, SD)
    mean, sd = combined([(ESTIMATE, SD), (ESTIMATE + 3.0 * math.sqrt(2.0) * SD, SD)])
    np.testing.assert_allclose(one.of(0), (mean, 3.0 * sd), rtol=1e-9)


def test_who_knows_no_more_than_the_prior_adds_nothing(one):
    one.remember(0, 0, ESTIMATE, SD)
    one.remember(0, 1, PRIOR - 5.0 * WIDE, 1.2 * WIDE)
    np.testing.assert_allclose(one.of(0), (ESTIMATE, SD), rtol=1e-9)


def test_a_new_course_begins_with_the_prior(one):
    one.remember(0, 0, ESTIMATE, SD)
    memory.forget_classes(one.kept, 0, NUMBERS)
    np.testing.assert_allclose(one.of(0), (PRIOR, WIDE), rtol=1e-12)
    one.remember(0, 0, ESTIMATE, SD)
    np.testing.assert_allclose(one.of(0), (ESTIMATE, SD), rtol=1e-9)


def test_what_was_learnt_of_a_class_is_near_its_soil():
    """After a course, best drawbar pulls of the classes met: a quarter of their scatter off, and about as stated."""
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
    found, sds, true = [], [], []
    for k in range(wheels):
        for c in np.flatnonzero(kept.patches[k]):
            load = sim.worlds.state["mass"][k] * scenario.gravity
            wheel, soil = scenario.wheel, SoilState(*lines.library[k, c])
            best = best_working_point(load, soil, wheel.radius, wheel.width, wheel.stall_torque)
            true.append(best.drawbar_pull / load)
            found.append(kept.estimate[k, c, memory.PULL])
            sds.append(kept.sd[k, c, memory.PULL])
    error, sds = np.array(found) - true, np.array(sds)
    assert len(error) > 150 and np.std(true) > 0.08
    assert abs(error.mean()) < 0.03 and error.std() < 0.25 * np.std(true)
    without = np.array(true) - PRIOR[memory.PULL]
    assert np.sqrt(np.mean(error**2)) < 0.5 * np.sqrt(np.mean(without**2))
    scaled = np.abs(error) / sds
    assert 0.45 < np.mean(scaled < 1.0) < 0.85 and np.mean(scaled < 3.0) > 0.94
