"""Drives of wheels over the same courses against plain loops, and the metrics of a course."""

import numpy as np
import pytest

from agents.controllers import make_controller
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


@pytest.mark.parametrize("name", ["full_throttle", "fixed_slip", "best_slip_identified", "best_slip_true"])
def test_runs_equal_a_loop_over_one_wheel(scenario, name):
    controller = make_controller(name, scenario, **({"slip": 0.45, "start": 0.15} if name == "fixed_slip" else {}))
    got, pulled = run_courses(controller, scenario, SEED, 6, detailed=True), 0
    for course in range(6):
        sim = Simulation(1, scenario, controller.variant, threads=1)
        sim.seed(0, course_rng(SEED, course))
        sim.restart(0)
        w, rows, returns, state = sim.worlds, [], 0.0, None
        while w.cause[0] == Cause.RUNNING.value:
            action, state = controller.predict(w.observation.copy(), state, np.array([state is None]))
            sim.step(0, float(action[0, 0]))
            returns += float(w.terms[0].sum())
            s = w.state[0]
            rows.append([s[k] for k in ("motor_work", "sinkage", "x", "slip", "halt_left", "drawbar_pull", "travel")])
        work, sinkage, x, slip, halt, pull, travel = np.array(rows).T
        assert got.cause[course] == w.cause[0]
        one = {field: getattr(got, field)[course] for field in FIELDS} | {n: got.metric(n)[course] for n in got.names}
        under_way, pulls = halt == 0.0, (halt == 0.0) & (pull > 0.0) & (work > 0.0)
        expected = {
            "time": 0.1 * len(rows), "distance": max(x.max(), 0.0), "energy": np.maximum(work, 0.0).sum(),
            "return": returns, "sinkage": 1000.0 * sinkage.mean(), "slip": slip[under_way].mean(),
        }  # fmt: skip
        expected["speed"] = expected["distance"] / expected["time"]
        expected["energy_per_metre"] = expected["energy"] / max(expected["distance"], 0.1)
        for metric, series in (("slip", slip), ("sinkage", 1000.0 * sinkage)):
            expected |= {f"{metric}_p{q}": np.quantile(series[under_way], q / 100) for q in (50, 95)}
        assert {key: one[key] for key in expected} == pytest.approx(expected, rel=1e-9)
        efficiency = one["tractive_efficiency"]  # NaN where the wheel rolls downhill all the way
        if pulls.any():
            assert efficiency == pytest.approx(np.maximum(pull * travel, 0.0)[pulls].sum() / work[pulls].sum())
            assert 0.0 < efficiency < 1.0
        assert np.isfinite(efficiency) == pulls.any()
        pulled += pulls.any()
    assert pulled > 2


def test_return_is_compared_without_the_information_that_an_agent_was_paid_for(scenario):
    paid = load_scenario(scenario, {"reward": {"information": 50.0}})
    plain, got = (run_courses(make_controller("fixed_slip", s), s, SEED, 4) for s in (scenario, paid))
    np.testing.assert_array_equal(got.returns, plain.returns)


def test_a_detailed_drive_is_the_same_drive(scenario):
    controller = make_controller("full_throttle", scenario)
    plain, detailed = (run_courses(controller, scenario, SEED, 10, detailed=flag) for flag in (False, True))
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(plain, field), getattr(detailed, field), err_msg=field)
    assert plain.names == list(METRICS) and set(detailed.names) < set(MEANINGS)


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
