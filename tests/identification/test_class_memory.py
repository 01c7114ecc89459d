"""Memory of terrain classes: posteriors of patches combined, and calibration after a course."""

import math

import numpy as np
import pytest

from soil_env.identification.online import class_memory as memory
from soil_env.identification.online.identifier import new_identifiers
from soil_env.identification.online.lanes.steady import best_working_point
from soil_env.parameters import SoilState, load_scenario
from tests.identification.observing import started

SCENARIO = load_scenario("two_lines")
NUMBERS = memory.memory_numbers(SCENARIO)
PRIOR = NUMBERS.prior
WIDE = NUMBERS.precision**-0.5
ESTIMATE = PRIOR + 0.4 * WIDE
SD = WIDE * np.array([0.3, 0.4, 0.3, 0.7, 0.5, 0.2])


@pytest.fixture
def kept():
    """The memory of one wheel, of three classes."""
    kept = memory.new_memory(1, 3)
    memory.forget_classes(kept, 0, NUMBERS)
    return kept


def remember(kept, c, patch, estimate, sd):
    """Remember an estimate [6] with sd [6] of a class and a patch; the best drawbar pull is the
    last of them.
    """
    ids = new_identifiers(1)
    sd = sd / np.array([1.0] * 5 + [memory.WIDER])
    ids.estimate[0] = estimate[:5]
    ids.sd[0] = sd[:5]
    ids.best_pull[0] = (estimate[5], sd[5])
    memory.remember(kept, 0, c, patch, ids, NUMBERS)


def combined(posteriors):
    """Posteriors (mean, sd) of one number each that all hold the prior, which counts once."""
    J = WIDE**-2.0
    h = WIDE**-2.0 * PRIOR
    for mean, sd in posteriors:
        J = J + sd**-2.0 - WIDE**-2.0
        h = h + sd**-2.0 * mean - WIDE**-2.0 * PRIOR
    return h / J, J**-0.5


def check(kept, c, mean, sd):
    np.testing.assert_allclose((kept.estimate[0, c], kept.sd[0, c]), (mean, sd), rtol=1e-9)


def test_precisions_of_patches_add_up_and_the_prior_counts_once(kept):
    """The last estimate on each patch counts; one no better than the prior adds nothing."""
    posteriors = [(ESTIMATE, SD), (ESTIMATE - 0.3 * SD, 0.8 * SD), (ESTIMATE + 0.1 * SD, 1.2 * SD)]
    for patch, posterior in enumerate(posteriors):
        remember(kept, 0, patch, PRIOR, 0.9 * SD)  # an earlier one on the same patch
        remember(kept, 0, patch, *posterior)
        remember(kept, 2, 10 + patch, ESTIMATE, SD)  # another class between
    check(kept, 0, *combined(posteriors))
    check(kept, 2, *combined([(ESTIMATE, SD)] * 3))
    remember(kept, 0, 3, PRIOR - 5.0 * WIDE, 1.2 * WIDE)
    check(kept, 0, *combined(posteriors))
    assert kept.patches.tolist() == [[4, 0, 3]]
    memory.forget_classes(kept, 0, NUMBERS)  # a new course
    check(kept, 0, PRIOR, WIDE)
    remember(kept, 0, 0, ESTIMATE, SD)
    check(kept, 0, ESTIMATE, SD)


def test_patches_that_differ_by_more_than_they_allow_are_less_sure(kept):
    posteriors = [(ESTIMATE, SD), (ESTIMATE + 3.0 * math.sqrt(2.0) * SD, SD)]
    for patch, posterior in enumerate(posteriors):
        remember(kept, 0, patch, *posterior)
    mean, sd = combined(posteriors)
    check(kept, 0, mean, 3.0 * sd)


def test_what_was_learnt_of_a_class_is_near_its_soil():
    """After a course, best drawbar pulls of the classes met: a quarter of their scatter off, and
    about as stated.
    """
    wheels = 60
    scenario = load_scenario(
        "two_lines",
        {
            "control": {"action": "wheel_speed"},
            "camera": {"label_error": 0.0},
            "course": {"dead_ends": 0.0},
        },
    )
    sim = started(scenario, *([11, k] for k in range(wheels)))
    what = np.zeros(wheels, dtype=np.int8)
    command = np.zeros(wheels)
    for _ in range(600):
        halted = sim.worlds.state["halt_left"] > 0.0
        command = np.where(halted, 0.0, np.minimum(command + 0.01, 0.55))
        sim.step_all(command, what)
        what[sim.worlds.cause != 0] = 2
    kept = sim.worlds.memory
    library = sim.worlds.courses["library"]
    wheel = scenario.wheel
    rows = []
    for k in range(wheels):
        for c in np.flatnonzero(kept.patches[k]):
            load = sim.worlds.state["mass"][k] * scenario.gravity
            soil = SoilState(*library[k, c])
            best = best_working_point(load, soil, wheel.radius, wheel.width, wheel.stall_torque)
            rows.append(
                (
                    best.drawbar_pull / load,
                    kept.estimate[k, c, memory.PULL],
                    kept.sd[k, c, memory.PULL],
                )
            )
    true, found, sds = np.transpose(rows)
    error = found - true
    without = PRIOR[memory.PULL] - true
    assert len(error) > 150 and np.std(true) > 0.08
    assert abs(error.mean()) < 0.03 and error.std() < 0.25 * np.std(true)
    assert np.sqrt(np.mean(error**2)) < 0.5 * np.sqrt(np.mean(without**2))
    scaled = np.abs(error) / sds
    assert 0.45 < np.mean(scaled < 1.0) < 0.85 and np.mean(scaled < 3.0) > 0.94
