"""Memory of terrain classes: posteriors of patches combined, and calibration after a course."""

import math

import numpy as np
import pytest

from soil_env.identification.online import class_memory
from soil_env.identification.online.memory import BEST_PULL, MEMORY
from soil_env.identification.online.prior import setting_of
from soil_env.parameters import SoilState, load_scenario
from soil_env.terramechanics.traversability import best_working_point
from tests.identification.observing import started

SCENARIO = load_scenario("two_lines")
SETTING = setting_of(SCENARIO)
PRIOR = SETTING["prior"][0]
WIDE = SETTING["prior_sd"][0]
ESTIMATE = PRIOR + 0.4 * WIDE
SD = WIDE * np.array([0.3, 0.4, 0.3, 0.7, 0.5, 0.2])


@pytest.fixture
def kept():
    """The memory of one wheel."""
    kept = np.zeros(1, class_memory.CLASSES)
    class_memory.forget_classes(kept[0], SETTING[0])
    return kept


def remember(kept, c, patch, estimate, sd):
    """Remember an estimate [6] with sd [6] of class c on a patch, the best drawbar pull last.

    The sd of the pull is handed over by `WIDER` smaller, since `remember_class` makes it larger.
    """
    memory = np.zeros(1, MEMORY)
    memory["estimate"] = estimate
    memory["sd"] = sd
    memory["sd"][0, BEST_PULL] /= class_memory.WIDER
    class_memory.remember_class(kept[0], c, patch, memory[0], SETTING[0])


def combined(posteriors):
    """Posteriors (mean, sd) of one number each that all hold the prior, which counts once."""
    J = WIDE**-2.0
    h = WIDE**-2.0 * PRIOR
    for mean, sd in posteriors:
        J = J + sd**-2.0 - WIDE**-2.0
        h = h + sd**-2.0 * mean - WIDE**-2.0 * PRIOR
    return h / J, J**-0.5


def check(kept, c, mean, sd):
    """Assert that class c is known with this mean [6] and sd [6]."""
    known = kept["of"][0, c]
    np.testing.assert_allclose((known["estimate"], known["sd"]), (mean, sd), rtol=1e-9)


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
    assert kept["of"]["patches"][0, :3].tolist() == [4, 0, 3]
    class_memory.forget_classes(kept[0], SETTING[0])  # a new course
    check(kept, 0, PRIOR, WIDE)
    remember(kept, 0, 0, ESTIMATE, SD)
    check(kept, 0, ESTIMATE, SD)


def test_patches_that_differ_by_more_than_they_allow_are_less_sure(kept):
    """A chi-squared of 9 between two estimates makes the sd of their mean three times as large."""
    posteriors = [(ESTIMATE, SD), (ESTIMATE + 3.0 * math.sqrt(2.0) * SD, SD)]
    for patch, posterior in enumerate(posteriors):
        remember(kept, 0, patch, *posterior)
    mean, sd = combined(posteriors)
    check(kept, 0, mean, 3.0 * sd)


def test_an_estimate_near_a_border_is_not_of_one_soil():
    """Behind half a border and some way in which it is found, and before half of the next."""
    length = SCENARIO.belief.border
    behind = (0.5 + class_memory.FOUND) * length
    for since, left, clear in (
        (1.01 * behind, 0.51 * length, True),
        (0.99 * behind, 0.51 * length, False),
        (1.01 * behind, 0.49 * length, False),
    ):
        assert class_memory.clear_of_borders(since, left, SETTING[0]) == clear


@pytest.fixture(scope="module")
def learnt():
    """(true, found, standard deviation) [classes met] of best drawbar pulls after a course."""
    wheels = 60
    scenario = load_scenario(
        "two_lines",
        {
            "control": {"action": "wheel_speed"},
            "camera": {"label_error": 0.0},
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
    for k, c in np.argwhere(kept["patches"]):
        load = sim.worlds.state["mass"][k] * scenario.gravity
        soil = SoilState(*library[k, c])
        best = best_working_point(load, soil, wheel.radius, wheel.width, wheel.stall_torque)
        known = kept[k, c]
        rows.append(
            (best.drawbar_pull / load, known["estimate"][BEST_PULL], known["sd"][BEST_PULL])
        )
    return np.transpose(rows)


def test_what_was_learnt_of_a_class_is_about_as_sure_as_stated(learnt):
    true, found, sds = learnt
    error = found - true
    without = PRIOR[BEST_PULL] - true
    assert len(error) > 150 and np.std(true) > 0.08
    assert abs(error.mean()) < 0.03 and error.std() < 0.55 * np.std(true)
    assert np.sqrt(np.mean(error**2)) < 0.55 * np.sqrt(np.mean(without**2))
    scaled = np.abs(error) / sds
    assert 0.45 < np.mean(scaled < 1.0) < 0.85 and np.mean(scaled < 3.0) > 0.94


@pytest.mark.xfail(strict=True, reason="half of it: the slopes of today ask for little slip")
def test_what_was_learnt_of_a_class_is_near_its_soil(learnt):
    """A quarter of the scatter of the classes off."""
    true, found, _ = learnt
    error = found - true
    without = PRIOR[BEST_PULL] - true
    assert error.std() < 0.25 * np.std(true)
    assert np.sqrt(np.mean(error**2)) < 0.5 * np.sqrt(np.mean(without**2))
