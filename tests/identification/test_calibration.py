"""Calibration of the online identifier on the default task."""

import numpy as np
import pytest

from agents.controllers import make_controller
from soil_env.identification.online.identifier import identifier_numbers
from soil_env.parameters import load_scenario
from tests.drives import QUANTITIES, record

SEED, COURSES = 5, 40


@pytest.fixture(scope="module")
def judged():
    """Errors, standard deviations and errors of the prior [N, 6] of `QUANTITIES`, halts left out."""
    scenario = load_scenario("two_lines")
    logs = record(make_controller("best_slip_identified", scenario), scenario, COURSES, SEED)
    driven = np.concatenate([log["halt_left"] == 0.0 for log in logs])
    truth, estimate, sd = (np.concatenate([log[name] for log in logs])[driven] for name in ("truth", "estimate", "sd"))
    numbers = identifier_numbers(scenario)
    return estimate - truth, sd, np.append(numbers.prior, numbers.prior_pull[0]) - truth


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_intervals_hold_on_the_default_task(judged, quantity):
    """On 40 courses that no threshold was set on 68 % intervals hold about so often, better than the prior."""
    error, sd, without = (values[:, QUANTITIES.index(quantity)] for values in judged)
    assert len(error) > 10_000
    scaled = np.abs(error / sd)
    assert 0.60 < np.mean(scaled < 1.0) < 0.80
    assert np.mean(scaled > 3.0) < 0.02
    assert np.mean(error**2) < np.mean(without**2)
