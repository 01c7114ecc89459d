"""Drives of wheels over the same courses against plain loops, and the metrics of a course."""

import json

import numpy as np
import pytest

from agents.controllers import CONTROLLERS, make_controller
from agents.evaluate import Runs, course_rng, run_courses
from agents.evaluate.driving import MEANINGS, METRICS
from soil_env.driving.wheels import Simulation
from soil_env.parameters import load_scenario
from soil_env.simulation.task import Cause
from tests.agents import drivers

SEED = 12345
FIELDS = [f for f in Runs.__dataclass_fields__ if f != "more"]
SHORT = {"control": {"time_limit": 25.0, "action": "torque"}}


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("mixed", SHORT)


@pytest.fixture(scope="module")
def runs(scenario):
    """Every controller on the same 12 courses."""
    return {name: run_courses(make_controller(name, scenario), scenario, SEED, 12) for name in CONTROLLERS}


# --- pairing ----------------------------------------------------------------------------------------------------------


def test_results_depend_neither_on_batch_nor_on_the_first(scenario):
    for name in ("fixed_slip", "best_slip_identified"):
        controller = make_controller(name, scenario)
        whole = run_courses(controller, scenario, SEED, 8)
        for other, part in (
            (run_courses(controller, scenario, SEED, 8, batch=3), slice(0, 8)),
            (run_courses(controller, scenario, SEED, 3, first=3), slice(3, 6)),
        ):
            for field in FIELDS:
                np.testing.assert_array_equal(getattr(whole, field)[part], getattr(other, field), err_msg=field)


# --- metrics against a plain loop -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["full_throttle", "constant_speed", "best_slip_identified", "best_slip_true"])
def test_runs_equal_a_loop_over_one_wheel(scenario, runs, name):
    controller = make_controller(name, scenario)
    for course in (0, 4, 11):
        sim = Simulation(1, scenario, controller.variant, threads=1)
        sim.seed(0, course_rng(SEED, course))
        sim.restart(0)
        w = sim.worlds
        energy = returns = sinkage = slip = 0.0
        steps = driving = 0
        furthest, state, fresh = 0.0, None, np.array([True])
        while w.cause[0] == Cause.RUNNING.value:
            action, state = controller.predict(w.observation.copy(), state, fresh)
            fresh = np.array([False])
            sim.step(0, float(action[0, 0]))
            s = w.state[0]
            steps += 1
            energy += max(float(s["motor_work"]), 0.0)
            returns += float(w.terms[0].sum())
            sinkage += float(s["sinkage"])
            furthest = max(furthest, float(s["x"]))
            if s["halt_left"] == 0.0:
                driving += 1
                slip += float(s["slip"])
        got = runs[name]
        assert got.cause[course] == w.cause[0]
        assert got.time[course] == pytest.approx(0.1 * steps)
        assert got.distance[course] == pytest.approx(furthest, rel=1e-12)
        assert got.energy[course] == pytest.approx(energy, rel=1e-9)
        assert got.returns[course] == pytest.approx(returns, rel=1e-9)
        assert got.sinkage[course] == pytest.approx(sinkage / steps, rel=1e-9)
        assert got.slip[course] == pytest.approx(slip / max(driving, 1), rel=1e-9)


def test_return_is_compared_without_the_information_that_an_agent_was_paid_for(scenario, runs):
    paid = load_scenario(scenario, {"reward": {"information": 50.0}})
    controller = make_controller("fixed_slip", paid)
    got = run_courses(controller, paid, SEED, 4)
    np.testing.assert_array_equal(got.returns, runs["fixed_slip"].returns[:4])


def test_units_of_the_derived_metrics():
    got = Runs(
        cause=np.array([1, 5]), distance=np.array([10.0, 0.02]), time=np.array([20.0, 90.0]),
        energy=np.array([500.0, 3.0]), slip=np.array([0.2, 0.1]), sinkage=np.array([0.03, 0.01]),
        returns=np.array([9.0, 0.0]),
    )  # fmt: skip
    assert got.metric("speed").tolist() == pytest.approx([0.5, 0.02 / 90.0])
    assert got.metric("energy_per_metre").tolist() == pytest.approx([50.0, 30.0])  # at least 0.1 m
    assert got.metric("sinkage").tolist() == pytest.approx([30.0, 10.0])
    assert got.metric("finished").tolist() == [1.0, 0.0] and got.metric("time_limit").tolist() == [0.0, 1.0]
    with pytest.raises(KeyError):
        got.metric("speeed")


# --- detailed drives --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def detailed(scenario):
    return run_courses(make_controller("full_throttle", scenario), scenario, SEED, 10, detailed=True)


def test_a_detailed_drive_is_the_same_drive(scenario, runs, detailed):
    for field in FIELDS:
        np.testing.assert_array_equal(
            getattr(runs["full_throttle"], field)[:10], getattr(detailed, field), err_msg=field
        )
    assert runs["full_throttle"].names == list(METRICS) and set(detailed.names) < set(MEANINGS)


def test_detailed_metrics_equal_a_loop_over_one_wheel(scenario):
    controller = make_controller("fixed_slip", scenario, slip=0.45, start=0.15)
    got, pulled = run_courses(controller, scenario, SEED, 6, detailed=True), 0
    for course in range(6):
        sim = Simulation(1, scenario, "blind", threads=1)
        sim.seed(0, course_rng(SEED, course))
        sim.restart(0)
        w, slips, depths, drawbar, motor, state = sim.worlds, [], [], 0.0, 0.0, None
        while w.cause[0] == Cause.RUNNING.value:
            action, state = controller.predict(w.observation.copy(), state)
            sim.step(0, float(action[0, 0]))
            s = w.state[0]
            if s["halt_left"] == 0.0:
                slips.append(float(s["slip"]))
                depths.append(1000.0 * float(s["sinkage"]))
                if s["drawbar_pull"] > 0.0 and s["motor_work"] > 0.0:
                    drawbar += max(float(s["drawbar_pull"] * s["travel"]), 0.0)
                    motor += float(s["motor_work"])
        one = {name: got.metric(name)[course] for name in got.names}
        for name, series in (("slip", slips), ("sinkage", depths)):
            assert one[f"{name}_p50"] == pytest.approx(np.median(series))
            assert one[f"{name}_p95"] == pytest.approx(np.quantile(series, 0.95))
        if motor == 0.0:  # downhill all the way
            assert np.isnan(one["tractive_efficiency"])
            continue
        assert one["tractive_efficiency"] == pytest.approx(drawbar / motor)
        assert 0.0 < one["tractive_efficiency"] < 1.0
        pulled += 1
    assert pulled > 2


def test_columns_go_through_json_and_back(detailed):
    text = json.dumps(detailed.columns(), allow_nan=False)
    back = Runs.from_columns(json.loads(text))
    assert back.columns() == detailed.columns() and back.cause.dtype == detailed.cause.dtype
    columns = json.loads(text)
    columns["slip"].pop()
    with pytest.raises(ValueError, match="slip: 9 values, expected 10"):
        Runs.from_columns(columns)


def test_nan_for_a_course_that_has_ended_is_allowed(scenario):
    class Careless(drivers.Half):
        def __init__(self, careless):
            self.careless = careless

        def predict(self, obs, state=None, episode_start=None, deterministic=True):
            action = np.ones((len(obs), 1))
            if state is not None:  # the readings of a wheel that drives are noisy: they never repeat
                action[(obs == state).all(axis=1)] = np.nan if self.careless else 1.0
            return action, obs.copy()

    a, b = (run_courses(Careless(flag), scenario, SEED, 6) for flag in (True, False))
    assert a.columns() == b.columns()
