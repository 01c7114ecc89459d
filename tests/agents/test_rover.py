"""Controllers of rovers, drives over held-out courses, their comparison, and the commands that
train and compare.
"""

import json

import numpy as np
import pytest

from soil_env.cli import main
from soil_env.parameters import load_rover
from soil_env.simulation.rover.task import rover_layout
from soil_env_agents import comparison, training
from soil_env_agents.config import TrainConfig
from soil_env_agents.controllers.rover import ROVER_CONTROLLERS, make_rover_controller
from soil_env_agents.evaluate.driving import METRICS, OF_ROVERS, run_courses
from tests.agents.test_train import TINY
from tests.refusals import refused

AXLES = ("front", "middle", "rear")
SHORT = {"course": {"length": 3.0}, "control": {"time_limit": 20.0}}


def observed(variant, **values):
    """One observation in units, of 0 but for `values`, of a rover with three axles."""
    names = [entry.name for entry in rover_layout(variant, 3)]
    assert values.keys() <= set(names)
    return np.array([values.get(name, 0.0) for name in names])


@pytest.fixture(scope="module")
def scenario():
    """The rover with three axles on short courses."""
    return load_rover("mars_rover", SHORT)


@pytest.mark.parametrize("name", ROVER_CONTROLLERS)
def test_every_controller_drives_every_rover(name):
    for rover in ("lunar_micro_rover", "mars_rover"):
        scenario = load_rover(rover, SHORT)
        runs = run_courses(make_rover_controller(name, scenario), scenario, 7, 4)
        assert np.all(runs.distance > 0.05) and np.all(runs.energy > 0.0)
        assert np.all(np.isfinite([runs.metric(m) for m in runs.names]))


def test_a_wheel_that_slips_is_slowed_down_alone(scenario):
    """The limiter asks less of the rear wheel, whose slip is over its limit, than of the others."""
    controller = make_rover_controller("slip_limiter", scenario, slip=0.3, acceleration=1.0)
    even = {f"{axle}_{name}": 0.5 for axle in AXLES for name in ("rim_speed", "rim_command")}
    slips = {"front_slip": 0.1, "middle_slip": 0.1, "rear_slip": 0.7}
    seen = observed("blind", **even, **slips)[None]
    state = None
    for step in range(5):
        action, state = controller.predict(seen, state, np.array([step == 0]))
    assert action[0, 2] < action[0, 0] == action[0, 1]


@pytest.mark.parametrize("name", ["soft_start", "velocity_sync", "torque_by_load"])
@pytest.mark.parametrize("deep", AXLES)
def test_all_wheels_creep_with_the_deepest(scenario, name, deep):
    """The ramp is one, whichever wheel is deep: their commands stay alike, and are lower."""
    controller = make_rover_controller(name, scenario, creep_sinkage=0.4, acceleration=100.0)
    loads = {f"{axle}_load": 1.0 for axle in AXLES}
    action, crept = (
        controller.predict(observed("blind", **loads, **sinkage))[0]
        for sinkage in ({}, {f"{deep}_sinkage": 0.8})
    )
    assert np.ptp(crept) == pytest.approx(0.0, abs=1e-6) and np.all(crept < action - 0.05)


def test_torques_go_by_the_loads(scenario):
    controller = make_rover_controller("torque_by_load", scenario)
    loads = {"front_load": 0.5, "middle_load": 1.0, "rear_load": 2.0}
    action, _ = controller.predict(observed("blind", **loads))
    assert action / action[0] == pytest.approx(np.array([1.0, 2.0, 4.0]))


def test_torques_are_of_a_ramp_in_their_own_time(scenario):
    """Torques act for a control period, not for the half second of the scenario's action."""
    controller = make_rover_controller("torque_by_load", scenario, acceleration=0.1)
    state = None
    for step in range(4):
        _, state = controller.predict(observed("blind")[None], state, np.array([step == 0]))
    assert state["ramp"] == pytest.approx(4 * 0.1 * scenario.control.period)


def test_velocity_is_synchronised_with_the_turning_body(scenario):
    """While the body pitches, axles far from its centre go faster; the speeds are those of a rigid
    body.
    """
    controller = make_rover_controller("velocity_sync", scenario, acceleration=10.0)
    state = None
    for step in range(41):
        before = state
        seen = observed("blind", speed=0.3, pitch=0.05 * step - 1.0)[None]
        _, state = controller.predict(seen, before, np.array([step == 0]))
    wheels = seen[:, controller._columns].reshape(3, -1)
    rims = controller.rim_speeds(seen, wheels, dict(before))
    rate = 0.05 / controller.own.period
    speed = 0.3 * controller.own.top_speed
    arms = scenario.vehicle.centre - np.array(scenario.vehicle.axles)
    going = np.hypot(speed, rate * arms)
    assert rims / rims.max() == pytest.approx(going / going.max(), rel=0.02)
    assert rims.max() / rims.min() > 1.02


def test_best_slip_reads_the_soil_under_each_wheel(scenario):
    """A soft shear modulus needs more slip: on it the limit of the slip is higher."""
    controller = make_rover_controller("best_slip_true", scenario)
    soil = {
        "friction_angle": 0.55,
        "log10_sinkage_coefficient": 6.0,
        "sinkage_exponent": 1.0,
        "dig_gain": 2.0,
        "dig_recovery": 0.5,
        "cohesion": 0.5,
        "log10_shear_modulus": -2.3,
        "load": 1.0,
    }
    known = {f"{axle}_{k}": v for axle in AXLES for k, v in soil.items()}
    seen = observed("true_soil", **known | {"rear_log10_shear_modulus": -1.5})[None]
    _, state = controller.predict(seen)
    assert state["slip"][2] > state["slip"][0] == state["slip"][1]


def test_energy_is_of_both_sides(scenario):
    """Work of the motors over distance, less slip, is that of the climb and of motion resistance of
    the whole rover.
    """
    slope = {"grade_deg": [8.0, 8.0], "first_grade_deg": [8.0, 8.0]}
    course = {"length": 6.0, "least_pull": 0.24, **slope}
    easy = load_rover("mars_rover", SHORT | {"course": course})
    runs = run_courses(make_rover_controller("soft_start", easy), easy, 5, 4)
    # [N] mass and gravity of the rover on 8 deg
    climb = 899.0 * 3.71 * np.sin(np.radians(8.0))
    work = runs.metric("energy_per_metre") * (1.0 - runs.slip)
    assert np.all(work > 1.5 * climb) and np.all(work < 3.0 * climb)


def test_train_writes_the_comparison(tmp_path):
    asked = ["--config=rover.yaml", "--name=small", f"--runs={tmp_path}", *TINY]
    assert main(["train", *asked]) == 0
    result = json.loads((tmp_path / "small" / comparison.DONE).read_text())
    assert set(result["controllers"]) == {*ROVER_CONTROLLERS, "agent_identified"}
    for metrics in result["controllers"].values():
        assert set(metrics) == {*METRICS, *OF_ROVERS}
        assert all(m["low"] <= m["value"] <= m["high"] for m in metrics.values())
    assert main(["train", "--resume", str(tmp_path / "small")]) == 0


def test_a_training_without_identification_is_refused_before_it_begins():
    """A controller that the agent is compared with reads the identified soil."""
    changes = {"belief": {"method": "none"}}
    config = TrainConfig(observation="blind", changes=changes, rover="mars_rover")
    refused(lambda: training.scenario_of(config), "best_slip_identified")
