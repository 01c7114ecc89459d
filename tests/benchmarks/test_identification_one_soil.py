"""benchmarks/identification_one_soil.py: the batch fit finds the soil of exact readings, the mixture is Bayes' rule."""

import numpy as np
import pytest

from benchmarks import identification_one_soil as one
from benchmarks.common import TORQUE
from benchmarks.identification_bound import SENSORS, bound, jacobians, posterior, record
from soil_env.identification.filter_bank import filter_numbers
from soil_env.identification.mixture_prior import plain
from soil_env.parameters import load_scenario
from soil_env.slip import travel_speeds

SCENARIO = load_scenario("mixed", TORQUE)


@pytest.fixture(scope="module")
def logs():
    return one.first_soils(record(SCENARIO, 4, 11), SCENARIO.course.border)


def exact(log):
    """The log with readings without noise."""
    J, rim = jacobians(log, SCENARIO), log["wheel_speed"] * SCENARIO.wheel.radius
    readings, pull, torque = log["readings"].copy(), J[:, 0, 9], J[:, 1, 9]
    turned = SCENARIO.wheel.inertia / SCENARIO.control.period * np.diff(log["wheel_speed"], prepend=0.0)
    load = log["mass"] * SCENARIO.gravity * np.cos(log["grade"])
    columns = (log["slip"], log["sinkage"], pull, load, torque, travel_speeds(rim, log["slip"]), rim, log["grade"],
               torque + turned, pull / log["mass"])  # fmt: skip
    readings[:] = np.column_stack(columns)
    return log | {"readings": readings}


def test_first_soils_end_before_the_border(logs):
    for log in logs:
        assert np.all(log["soil"] == log["soil"][0])
        assert (
            len(log["at"]) == one.STEPS and np.all(np.diff(log["at"]) > 0) and np.all(log["halt_left"][log["at"]] == 0)
        )


def by_its_own_law(log):
    """The log with readings without noise, and sinkages by the law as the fit has it, from one speed a period."""
    log = exact(log)
    r = one.readings_of(log, filter_numbers(SCENARIO))
    x = np.append(log["soil"][0], [log["mass"][0], log["sinkage"][0]])
    for _ in range(5):
        log = exact(log | {"sinkage": one.evaluate(x, log["slip"], log["sinkage"], r, SCENARIO).sinkage})
    return log


def test_the_maximum_of_exact_readings_is_the_soil(logs, monkeypatch):
    """Under a prior about the truth, from starts beside it: within a twentieth of the bound of noisy readings."""
    for log in logs[:3]:
        sure, prior = bound(log, SCENARIO, SENSORS["all sensors"]), plain(SCENARIO)[2]
        monkeypatch.setattr(one, "plain", lambda scenario, log=log, prior=prior: (1.0, log["soil"][0], prior))
        away = np.abs(one.all_readings(by_its_own_law(log), SCENARIO)[0][-3:] - log["truth"][log["at"][-3:]])
        assert np.all(away < 0.05 * sure[log["at"][-3:]]), away / sure[log["at"][-3:]]


def test_the_gradient_is_that_of_the_cost(logs):
    """Central differences in each unknown, with the slips held."""
    log = exact(logs[0])
    r = one.readings_of(log, filter_numbers(SCENARIO))
    x = np.append(log["soil"][0], [log["mass"][0], log["sinkage"][0]])
    scale = np.append(np.sqrt(np.diag(plain(SCENARIO)[2])), [x[6], x[7]])
    x += 0.02 * scale * np.array([1, -1, 1, 1, -1, 1, 0.1, 1])

    def fit(x):
        guess = log["sinkage"]
        for _ in range(4):
            new = one.evaluate(x, log["slip"], guess, r, SCENARIO)
            guess = new.sinkage
        return new

    here = fit(x)
    for j in range(one.UNKNOWNS):
        h = 1e-4 * scale[j] * np.eye(one.UNKNOWNS)[j]
        slope = (fit(x + h).cost - fit(x - h).cost) / (2e-4 * scale[j])
        size = np.sqrt(here.normal[j, j] * here.cost)
        assert abs(slope + 2.0 * here.gradient[j]) < 0.05 * size, j


def test_under_one_soil_the_library_is_a_gaussian_prior(logs):
    """A library of one soil that is the plain prior gives the plain posterior, and a soil far away gets no weight."""
    log, prior = logs[0], plain(SCENARIO)
    t = log["at"][-1]
    P = posterior(log, SCENARIO, SENSORS["all sensors"], prior[2])[1][t]
    alone = one.under_the_library(log, t, P, 0, [prior], prior, np.random.default_rng(0))
    np.testing.assert_allclose(alone[:3], alone[3:6])
    assert alone[6] == 1.0
    far = (1.0, prior[1] + np.array([0.0, 0.0, 8.0, 0.0, 0.0, 0.0]), prior[2])
    both = one.under_the_library(log, t, P, 0, [prior, far], prior, np.random.default_rng(0))
    assert both[6] > 0.99
    np.testing.assert_allclose(both[:3], alone[:3], rtol=0.05, atol=1e-8)


def test_study_and_table(capsys):
    assert one.main(["--smoke"]) == 0
    assert "maximum a posteriori of all readings" in capsys.readouterr().out
