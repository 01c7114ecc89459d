"""Calibration of the online identifier on the default task."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.drives import QUANTITIES, Shadow, prior_of, record
from soil_env.parameters import load_scenario
from soil_env.parameters.sensors import calibrated
from soil_env_agents.controllers import make_controller

SEED = 5
COURSES = 160


@pytest.fixture(scope="module")
def errors():
    """Errors, their sd and errors of the prior [N, 6] of `QUANTITIES`, halts left out, by sensors
    with zeros and gains.
    """
    scenario = load_scenario("two_lines")
    controller = make_controller("best_slip_identified", scenario)
    driven = replace(scenario, noise=calibrated(scenario.noise))
    log = record(controller, driven, COURSES, SEED, {"wheel": Shadow(scenario, COURSES)})
    here = log["driven"]
    true = log["truth"][here]
    return log["wheel estimate"][here] - true, log["wheel sd"][here], prior_of(scenario) - true


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_intervals_hold_on_the_default_task(errors, quantity):
    """On courses that were not used to set any threshold, 68 % intervals hold 60 to 80 % of the
    time, and the error is smaller than that of the prior's mean.
    """
    error, sd, without = (values[:, QUANTITIES.index(quantity)] for values in errors)
    assert len(error) > 10_000
    scaled = np.abs(error / sd)
    assert 0.60 < np.mean(scaled < 1.0) < 0.80
    assert np.mean(scaled > 3.0) < 0.02
    assert np.mean(error**2) < np.mean(without**2)
