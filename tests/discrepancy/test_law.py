"""The formula of a law without a name, and the tests that it asks for."""

import dataclasses

import numpy as np
import pytest

from soil_env.discrepancy.calibrate import Problem
from soil_env.discrepancy.law_tests import law_tests
from soil_env.discrepancy.symbolic import ResidualFit
from soil_env.discrepancy.workflow import model_of
from soil_env.terramechanics.residual import ResidualTerm
from tests.discrepancy.tables import NOISE, table


@pytest.fixture(scope="module")
def problem():
    return Problem(table(speeds=(0.03, 0.1)), NOISE.copy(), np.ones((36, 3), dtype=bool))


TERMS = (
    ResidualTerm("sinkage", -0.21, {"slip": 2.0, "load": 0.5}, {"slip": [0.05, 0.55], "load": [0.01, 0.03]}),
    ResidualTerm("sinkage", 0.03, {"grip": -1.0}, {"grip": [0.45, 0.95]}),
    ResidualTerm("torque", 2400.0, {"speed": 1.0}, {"speed": [0.02, 0.08]}),
)


@pytest.fixture(scope="module")
def law(problem):
    """A law with known coefficients: prior sd half of each and unit information, so the sd is value / 2 / sqrt 2."""
    fit = problem.fit()
    count = len(TERMS)
    column = np.zeros((fit.residual.size, count))
    column[np.arange(count), np.arange(count)] = 1.0
    jacobian = fit.jacobian.copy()
    jacobian[:count] = 0.0
    offset = np.zeros_like(problem.data.y)
    offset[7] = [-5 * NOISE[0], 0.0, 0.0]
    width = np.array([t.coefficient for t in TERMS]) / 2.0
    return ResidualFit(TERMS, dataclasses.replace(fit, jacobian=jacobian), offset, 10.0, column, width)


def test_the_intervals_of_a_law(law):
    for term, c in zip(TERMS, law.coefficients(), strict=True):
        half = 1.959964 * abs(term.coefficient) / 2.0 / np.sqrt(2.0)
        assert (c.low, c.high) == pytest.approx((term.coefficient - half, term.coefficient + half))


def test_the_tests_of_a_law_repeat_its_largest_and_go_beyond_the_table(problem, law):
    base = problem.fit()
    quiet = tuple(dataclasses.replace(t, coefficient=c) for t, c in zip(TERMS, (-0.4, 0.01, 0.4), strict=True))
    law = dataclasses.replace(law, terms=quiet, width=np.array([t.coefficient for t in quiet]) / 2.0)
    model = model_of(problem, base, quiet)
    first, *rest = law_tests(problem, base, law, model)
    assert first.separates == ("the law", "the base model") and first.channel == "sinkage"
    assert first.conditions["slip"] == pytest.approx(problem.data.rows.slip[7])
    assert first.expected_sigma == pytest.approx(5.0) and first.purpose == "repeat"
    assert 1 <= len(rest) <= 3
    for t in rest:
        moved = [k for k, v in t.conditions.items() if v != first.conditions[k]]
        assert len(moved) == 1 and t.expected_sigma >= 1.0
        low, high = model.validity[moved[0]]
        assert not low <= t.conditions[moved[0]] <= high
        assert set(t.conditions) == set(first.conditions)


def test_without_a_law_the_test_is_the_largest_misfit(problem):
    shifted = dataclasses.replace(problem.data, y=problem.data.y + 0.0)
    shifted.y[20, 2] += 8 * NOISE[2]
    p = Problem(shifted, NOISE.copy(), problem.used)
    fit = p.fit()
    none = ResidualFit((), fit, np.zeros_like(shifted.y), 0.0, np.zeros((fit.residual.size, 0)), np.zeros(0))
    found = law_tests(p, fit, none, model_of(p, fit))
    assert len(found) == 1 and found[0].channel == "torque"
    assert found[0].conditions["slip"] == pytest.approx(shifted.rows.slip[20])
