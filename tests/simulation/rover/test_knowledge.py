"""What a rover knows of the soil under its wheels, on courses."""

import numpy as np
import pytest

from benchmarks.rover_identification import SwingingSlip, errors, record, scenario_of
from soil_env.driving.rover_estimator import rover_estimator_numbers
from soil_env.driving.rovers import RoverSimulation
from soil_env.driving.wheels import STEP
from soil_env.simulation.rover.task import rover_task_numbers
from soil_env.vehicle import load_rover

FRICTION_AND_COHESION = [0, 3]


@pytest.fixture(scope="module")
def told():
    """Six courses of a rover on three axles that is told which soils may come."""
    scenario = scenario_of("mars_rover", "as configured")
    return scenario, record(scenario, 6, 20, SwingingSlip(scenario))[0]


@pytest.mark.xfail(strict=True, reason="pooling spreads a border found late: phi worse than by the wheel's own filter")
def test_the_rear_wheel_knows_the_soil_better_than_by_itself(told):
    scenario, log = told
    rows = {(r["place"], r["axle"]): r for r in errors(log, scenario, 0)}
    rear = rows["leaves the border", "rear"]
    pooled, alone, prior = (np.array(rear[kind]["value"]) for kind in ("pooled", "alone", "prior"))
    assert rear["courses"] >= 3 and pooled[0] < 0.8 * alone[0] and np.all(pooled[:2] < 0.5 * prior[:2])


def test_the_rear_wheel_knows_the_soil_as_it_leaves_the_border(told):
    scenario, log = told
    rows = {(r["place"], r["axle"]): r for r in errors(log, scenario, 0)}
    rear = rows["leaves the border", "rear"]
    pooled, alone, prior = (np.array(rear[kind]["value"]) for kind in ("pooled", "alone", "prior"))
    assert rear["courses"] >= 3 and np.all(pooled[:2] < 0.7 * prior[:2]) and pooled[1] < alone[1]


def test_two_wheelbases_behind_a_border(told):
    scenario, log = told
    rows = {(r["place"], r["axle"]): r for r in errors(log, scenario, 0)}
    assert all(rows["2", axle]["pooled"]["value"][0] < 1.5 for axle in ("front", "middle", "rear"))


def test_pooled_is_surer_than_alone(told):
    _, log = told
    settled = log["driven"] & (log["soil"][..., 4] > 1.0) & (log["soil"][..., 3] > 0)
    ratio = log["pooled_sd"][settled][:, FRICTION_AND_COHESION] / log["alone_sd"][settled][:, FRICTION_AND_COHESION]
    assert np.all(np.median(ratio, axis=0) < 0.8)


def test_one_rover_and_many_know_the_same():
    scenario = scenario_of("mars_rover", "plain prior")

    def known(rovers, j):
        simulation = RoverSimulation(rovers, scenario, "identified", 2)
        for i in range(rovers):
            simulation.seed(i, np.random.default_rng(i if rovers > 1 else j))
        simulation.restart_where(np.ones(rovers, dtype=bool))
        drive = SwingingSlip(scenario)
        for _ in range(300):
            commands = drive(np.full(rovers, 0.3))
            simulation.step_all(commands, np.full(rovers, STEP))
        w, rows = simulation.worlds, simulation.wheels[j if rovers > 1 else 0]
        return w.known.estimate[rows].copy(), w.known.sd[rows].copy(), w.observation[j if rovers > 1 else 0].copy()

    for one, many in zip(known(1, 9), known(11, 9), strict=True):
        assert np.array_equal(one, many)


@pytest.mark.parametrize(("action", "read"), [("torque", True), ("wheel_speed", False), ("rim_acceleration", False)])
def test_the_torque_of_a_speed_loop_is_no_reading_of_the_soil(action, read):
    scenario = load_rover("mars_rover", {"control": {"action": action}})
    task = rover_task_numbers(scenario, "identified")
    noise = rover_estimator_numbers(scenario, task).identifier.filter.noise[8]
    assert (noise < scenario.weight * scenario.wheel.radius) == read
