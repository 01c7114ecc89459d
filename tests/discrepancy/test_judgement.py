"""What a finding is worth: intervals, the share of the gap that is closed, probabilities, redraws of the noise."""

import copy
import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from soil_env.discrepancy import judgement
from soil_env.discrepancy.calibrate import Problem, Unknown
from soil_env.discrepancy.data import folds
from soil_env.discrepancy.judgement import closed_interval
from soil_env.discrepancy.search import Named, held_out
from tests.discrepancy.files import PLANTED, world
from tests.discrepancy.tables import NOISE, table

# --- intervals and the gap --------------------------------------------------------------------------------------------


def linear(slope, unknown):
    """A fit of one unknown with this whitened slope: its covariance by hand."""
    return SimpleNamespace(unknowns=(unknown,), covariance=lambda: np.array([[1.0 / (1.0 + slope * slope)]]))


def test_intervals_are_those_of_a_linear_problem():
    """One unknown with prior sd 2 seen once with noise 1: the posterior variance is 1/(1/4 + 1)."""
    unknown = Unknown("x", 5.0, 2.0, -math.inf, math.inf, False)
    told = judgement.intervals(linear(2.0, unknown), {"x": 6.0})
    assert told["x"].value == pytest.approx(6.0)
    assert told["x"].high - told["x"].value == pytest.approx(1.959964 * math.sqrt(0.8))
    logarithmic = Unknown("x", 0.0, 2.0, -math.inf, math.inf, True)
    told = judgement.intervals(linear(2.0, logarithmic), {"x": 3.0})
    assert told["x"].high / told["x"].value == pytest.approx(told["x"].value / told["x"].low)


@given(st.floats(-50, 50), st.floats(1e-3, 10), st.floats(0.1, 5))
@settings(max_examples=50, deadline=None)
def test_intervals_stay_within_the_bounds(u, slope, sd):
    unknown = Unknown("x", 0.0, sd, -1.0, 1.0, False)
    value = min(max(unknown.value(u), -1.0), 1.0)
    told = judgement.intervals(linear(slope, unknown), {"x": value})["x"]
    assert -1.0 - 1e-9 <= told.low <= told.value <= told.high <= 1.0 + 1e-9


def test_intervals_hold_the_planted_soil(planted):
    """Five 95 % intervals with the truth: at least four, the chance of fewer being 2 %."""
    truth = world(PLANTED).soil
    inside = [p.low <= getattr(truth, name) <= p.high for name, p in planted.soil.items() if name != "density"]
    assert sum(inside) >= 4
    assert planted.soil["density"].low == planted.soil["density"].high == 1600.0


def test_closed_weighs_what_is_above_the_noise(planted):
    gap = {"sinkage": judgement.Gap(0.0012, 0.0006, 0.0006), "torque": judgement.Gap(0.1, 0.1, 0.1)}
    assert judgement.closed(planted.problem, gap) == pytest.approx(1.0)
    gap["torque"] = judgement.Gap(0.1, 0.2, 0.1)
    assert judgement.closed(planted.problem, gap) == pytest.approx(0.0)
    assert judgement.closed(planted.problem, {"sinkage": judgement.Gap(0.5, 0.5, 0.6)}) is None


def test_the_named_effect_heads_the_ranking_whatever_its_score(planted):
    last = planted.ranking[-1].name
    finding = dataclasses.replace(planted.finding, named=(Named(last, ()),))
    ranks, other = judgement.ranking(planted.problem, finding)
    assert ranks[0].name == last and ranks[1].name == "slip_sinkage"
    assert sum(r.probability for r in ranks) + sum(other.values()) == pytest.approx(1.0, abs=1e-6)


def test_the_bootstrap_judges_the_data_themselves_as_the_search_did(planted):
    """Refitted to the residuals of the table, a model gains what its fit had left to gain, and moves no further."""
    for c in planted.finding.singles:
        a, e = c.fit.linearised()
        gain = (a.T @ e) @ np.linalg.solve(a.T @ a, a.T @ e)  # of the objective, to its optimum
        score, evidence = judgement._refitted(planted.problem, c.fit, c.fit.residual[:, None])
        assert evidence[0] - c.fit.evidence == pytest.approx(0.5 * gain, rel=1e-3, abs=1e-6), c.names
        assert abs(score[0] - held_out(planted.problem, c.fit)) < 4.0 * np.sqrt(gain) + 1e-3, c.names


def test_the_bootstrap_takes_its_noise_from_the_generator(planted):
    """With noise five times as large the name is found less often, and equally often for the same seed."""
    problem = copy.copy(planted.problem)
    problem.noise = 5.0 * problem.noise
    weak = [dataclasses.replace(c, fit=_weaker(c.fit)) for c in planted.finding.singles]
    finding = dataclasses.replace(planted.finding, singles=tuple(weak), best=weak[0])
    seeds = (1, 1, 2, 3)
    told = [judgement.bootstrap(problem, finding, 101, np.random.default_rng(k), lambda text: None) for k in seeds]
    assert told[0] == told[1] and len({t.share for t in told}) > 1
    assert 0.2 < told[0].share < 1.0 and told[0].share + sum(told[0].instead.values()) == pytest.approx(1.0)


def _weaker(fit):
    return dataclasses.replace(fit, jacobian=fit.jacobian / 5.0, residual=fit.residual / 5.0)


@pytest.fixture(scope="module")
def problem():
    return Problem(table(speeds=(0.03, 0.1)), NOISE.copy(), np.ones((36, 3), dtype=bool))


def predictions(problem, size, rng):
    """Held-out predictions whose errors have so many noise sd."""
    return problem.data.y + size * NOISE * rng.normal(size=problem.data.y.shape)


def test_it_holds_the_share_and_is_the_same_for_the_same_seed(problem):
    rng = np.random.default_rng(1)
    before, after = predictions(problem, 3.0, rng), predictions(problem, 1.5, rng)
    share = judgement.closed(problem, judgement.gaps(problem, before, after))
    low, high = closed_interval(problem, before, after, np.random.default_rng(0))
    assert low < share < high <= 1.0 and 0.02 < high - low < 0.6
    assert closed_interval(problem, before, after, np.random.default_rng(0)) == (low, high)


def test_one_bad_group_widens_it(problem):
    """An error that sits in one slip alone is known less well than the same error in all of them."""
    rng = np.random.default_rng(2)
    before, after = predictions(problem, 3.0, rng), predictions(problem, 1.0, rng)
    spread = after + 1.5 * NOISE * np.sign(rng.normal(size=after.shape))
    only = after.copy()
    group = folds(problem.data)[0][0]
    only[group] += 1.5 * NOISE * np.sqrt(group.size / group.sum())
    wide, narrow = (np.ptp(closed_interval(problem, before, a, np.random.default_rng(0))) for a in (only, spread))
    assert wide > 1.5 * narrow


def test_nothing_closed_and_no_gap(problem):
    rng = np.random.default_rng(3)
    before = predictions(problem, 3.0, rng)
    assert closed_interval(problem, before, before, np.random.default_rng(0)) == pytest.approx((0.0, 0.0))
    assert closed_interval(problem, problem.data.y, problem.data.y, np.random.default_rng(0)) is None


# --- probabilities ----------------------------------------------------------------------------------------------------


@given(st.floats(0.0041, 1.0), st.floats(-50, 4.5), st.floats(-50, 50), st.floats(0, 60))
@settings(max_examples=50, deadline=None)
def test_with_nothing_missing_that_is_the_most_probable(nothing, misfit, score, evidence, gain):
    """Whatever the likelihoods of the candidates are and however much the base model lacks beyond the threshold."""
    finding = nothing.finding
    assert nothing.verdict == "none" and nothing.other["none"] > 0.5 and nothing.other["unlisted"] < 0.1
    objective = finding.base.fit.objective - gain
    fits = [
        dataclasses.replace(c.fit, evidence=c.fit.evidence + evidence, objective=objective) for c in finding.singles
    ]
    singles = tuple(dataclasses.replace(c, score=score, fit=f) for c, f in zip(finding.singles, fits, strict=True))
    base = dataclasses.replace(finding.base, misfit=misfit)
    finding = dataclasses.replace(finding, base=base, singles=singles, pairs=singles)
    ranks, other = judgement.ranking(nothing.problem, finding)
    assert other["none"] > max(other["unlisted"], *(r.probability for r in ranks))
    assert sum(r.probability for r in ranks) + sum(other.values()) == pytest.approx(1.0)


def test_the_chance_counts_all_that_were_tried(nothing):
    finding = nothing.finding
    for c in finding.singles:
        assert judgement.chance_of(nothing.problem, finding.base, c) >= finding.chance - 1e-12
    assert judgement.chance_of(nothing.problem, finding.base, finding.base) == 1.0


def test_a_clear_name_has_the_prior_of_the_catalogue(planted):
    """20 to 1 that what is missing is listed: Sellke's bound says nothing against a model that fits."""
    best = dataclasses.replace(planted.finding.singles[0], misfit=0.9, score=500.0)
    finding = dataclasses.replace(planted.finding, singles=(best, *planted.finding.singles[1:]), pairs=())
    ranks, other = judgement.ranking(planted.problem, finding)
    assert ranks[0].probability == pytest.approx(20.0 / 21.0) and other["unlisted"] == pytest.approx(1.0 / 21.0)
    assert other["none"] == 0.0
