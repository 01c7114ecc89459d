"""The next test: it separates what the table did not, can be run, and says so."""

import copy
import dataclasses

import numpy as np
import pytest

from soil_env.discrepancy.calibrate import Choice, Problem
from soil_env.discrepancy.data import CHANNELS
from soil_env.discrepancy.evidence import settle
from soil_env.discrepancy.next_tests import DEEPEST, LEAST, SLIPS, law_tests, next_tests, separating
from soil_env.discrepancy.search import Finding, Hypothesis
from soil_env.discrepancy.symbolic import ResidualFit
from soil_env.discrepancy.workflow import model_of
from soil_env.terramechanics.residual import ResidualTerm
from tests.discrepancy.tables import NOISE, WHEEL, problem, table

ONE_LOAD = {"loads": (150.0,)}


def rivals(effects, names, seed=1, **plan):
    """(problem, candidates) of a table with hidden effects."""
    p = problem(table(effects, **plan), np.random.default_rng(seed))
    base = settle(p, ())
    return p, [settle(p, (Choice(name, 0),), base) for name in names]


def model(problem, fit):
    """`WheelSoilModel` of a fit, without the warning beyond its table."""
    return dataclasses.replace(model_of(problem, fit), validity={})


@pytest.fixture(scope="module")
def case():
    """Bulldozing hidden in a table of one load, where an offset of the sinkage does as well."""
    return rivals({"bulldozing": {"rankine": 0.5}}, ("bulldozing", "sinkage_offset"), **ONE_LOAD)


def test_uncertainty_of_the_predictions_is_the_spread_of_refits(case):
    """The sd of a prediction against refits to 60 tables, priors drawn anew."""
    p, candidates = case
    t = separating(p, candidates[:2])[0]
    rng = np.random.default_rng(2)
    truth = model(p, candidates[0].fit)
    at, j = t.conditions, CHANNELS.index(t.channel)
    base = np.stack(truth.predict(p.data.table)[:3], axis=1)
    centre = {k.name: k.at(v) for k, v in zip(p.soil, candidates[0].fit.parameters().values(), strict=False)}
    errors = {c.names[0]: [] for c in candidates}
    for _ in range(60):
        q = copy.copy(p)
        q.data = dataclasses.replace(p.data, y=base + NOISE * rng.normal(size=base.shape))
        q.soil = tuple(k._replace(mean=k.mean + k.sd * (centre[k.name] + rng.normal())) for k in p.soil)
        for c in candidates:
            fitted = dataclasses.replace(c, fit=q.fit(c.fit.choices, c.fit.parameters(), c.sizes, c.fit))
            errors[c.names[0]].append(getattr(model(q, fitted.fit).predict(at), t.channel)[0] / NOISE[j])
    mean = [np.mean(e) for e in errors.values()]
    spread = np.sqrt(1.0 + sum(np.var(e) for e in errors.values()))
    assert abs(mean[0] - mean[1]) / spread == pytest.approx(t.expected_sigma, rel=0.35)


def test_every_test_can_be_run(case):
    p, candidates = case
    tests = separating(p, candidates)
    assert len({(t.channel, *t.conditions.values()) for t in tests}) == len(tests) > 1
    for t in tests:
        assert t.conditions["slip"] in SLIPS
        assert 75.0 <= t.conditions["load"] <= 300.0
        assert t.conditions["speed"] == pytest.approx(0.06)  # no candidate knows it
        assert t.conditions.keys() == {"slip", "load", "speed"}
        assert t.expected_sigma >= LEAST
        for c in candidates:
            found = model(p, c.fit).predict(t.conditions)
            assert found.supported
            assert found.sinkage[0] < DEEPEST * WHEEL.radius + 0.02


def test_who_is_left():
    p, (a, b, c) = rivals({"bulldozing": {"rankine": 0.5}}, ("bulldozing", "sinkage_offset", "grousers"), **ONE_LOAD)
    base = settle(p, ())

    def finding(*shares):
        sets = zip(shares, (a, b, c, base), strict=True)
        found = [Hypothesis(e.names, False, share, 0.0, e) for share, e in sets]
        return Finding(tuple(sorted(found, key=lambda h: -h.probability)), {}, {})

    assert next_tests(p, finding(0.6, 0.399, 0.0005, 0.0005)) == separating(p, (a, b))  # the others are out of reach
    assert next_tests(p, finding(0.2, 0.1, 0.0, 0.7)) == separating(p, (base, a, b))
    assert next_tests(p, finding(0.996, 0.002, 0.001, 0.001)) == ()
    assert separating(p, (a,)) == ()


# --- a law without a name ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def law_problem():
    return Problem(table(speeds=(0.03, 0.1)), NOISE.copy(), np.ones((36, 3), dtype=bool))


TERMS = (
    ResidualTerm("sinkage", -0.21, {"slip": 2.0, "load": 0.5}, {"slip": [0.05, 0.55], "load": [0.01, 0.03]}),
    ResidualTerm("sinkage", 0.03, {"grip": -1.0}, {"grip": [0.45, 0.95]}),
    ResidualTerm("torque", 2400.0, {"speed": 1.0}, {"speed": [0.02, 0.08]}),
)


@pytest.fixture(scope="module")
def law(law_problem):
    """A law with known coefficients: prior sd half of each and unit information, so the sd is value / 2 / sqrt 2."""
    fit = law_problem.fit()
    count = len(TERMS)
    column = np.zeros((fit.residual.size, count))
    column[np.arange(count), np.arange(count)] = 1.0
    jacobian = fit.jacobian.copy()
    jacobian[:count] = 0.0
    offset = np.zeros_like(law_problem.data.y)
    offset[7] = [-5 * NOISE[0], 0.0, 0.0]
    width = np.array([t.coefficient for t in TERMS]) / 2.0
    return ResidualFit(TERMS, dataclasses.replace(fit, jacobian=jacobian), offset, 10.0, column, width)


def test_the_tests_of_a_law_repeat_its_largest_and_go_beyond_the_table(law_problem, law):
    base = law_problem.fit()
    quiet = tuple(dataclasses.replace(t, coefficient=c) for t, c in zip(TERMS, (-0.4, 0.01, 0.4), strict=True))
    law = dataclasses.replace(law, terms=quiet, width=np.array([t.coefficient for t in quiet]) / 2.0)
    model = model_of(law_problem, base, quiet)
    first, *rest = law_tests(law_problem, base, law, model)
    assert first.separates == ("the law", "the base model") and first.channel == "sinkage"
    assert first.conditions["slip"] == pytest.approx(law_problem.data.rows.slip[7])
    assert first.expected_sigma == pytest.approx(5.0) and first.purpose == "repeat"
    assert 1 <= len(rest) <= 3
    for t in rest:
        moved = [k for k, v in t.conditions.items() if v != first.conditions[k]]
        assert len(moved) == 1 and t.expected_sigma >= 1.0
        low, high = model.validity[moved[0]]
        assert not low <= t.conditions[moved[0]] <= high
        assert set(t.conditions) == set(first.conditions)
