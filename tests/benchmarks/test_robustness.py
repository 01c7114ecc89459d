"""Robustness: drives from readings are those of the evaluation; errors have their sizes."""

import math

import numpy as np
import pytest

from benchmarks import robustness
from benchmarks.robustness import Case, misread
from soil_env.parameters import load_scenario
from soil_env.parameters.sensors import SensorReading
from soil_env_agents.controllers import make_controller
from soil_env_agents.evaluate.driving import run_courses

SCENARIO = load_scenario(robustness.GROUND)


def test_a_drive_from_readings_is_that_of_the_evaluation():
    rule = robustness.DRIVERS[1]
    controller = make_controller(rule, SCENARIO, **robustness.settings_of(rule, SCENARIO))
    runs = run_courses(controller, SCENARIO, robustness.SEED, 8)
    finished = runs.metric("finished") > 0.5
    assert 0 < finished.sum() < 8
    np.testing.assert_array_equal(robustness.driven(("as shipped", rule), 8), finished)


def test_every_error_is_three_standard_deviations():
    """Zeros of a force are of the weight; each case changes a reading if it has an error or a dead
    sensor.
    """
    weight = SCENARIO.gravity * SCENARIO.wheel.body_mass
    noise = SCENARIO.noise
    reading = SensorReading(*np.linspace(1.0, 2.0, len(SensorReading._fields)).tolist())
    pull = reading.drawbar_pull
    found = misread(reading, Case(error="drawbar_pull_zero"), -1.0, SCENARIO)
    assert found.drawbar_pull == pytest.approx(pull - 3.0 * noise.drawbar_pull_zero * weight)
    assert found._replace(drawbar_pull=pull) == reading
    found = misread(reading, Case(error="torque_gain"), 1.0, SCENARIO)
    assert found.torque == pytest.approx((1.0 + 3.0 * noise.torque_gain) * reading.torque)
    for case in robustness.cases().values():
        changed = misread(reading, case, 1.0, SCENARIO)
        assert (changed != reading) == bool(case.error or case.dead)
    assert math.isnan(misread(reading, Case(dead="load"), 1.0, SCENARIO).load)
