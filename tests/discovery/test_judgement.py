"""Worth of a finding: intervals, the share of the gap that is closed, shares of it, the ranking."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from soil_env.discovery import judgement
from soil_env.discovery.calibrate import Problem
from soil_env.discovery.judgement import closed_interval
from soil_env.discovery.search import Finding, Hypothesis
from soil_env.identification.table.data import folds
from soil_env.identification.table.priors import Unknown
from tests.discovery.files import with_data
from tests.discovery.tables import NOISE, table


def linear(unknown, u, *parts):
    """(finding, evidence) of one unknown, fitted at u: (probability, mean, variance) of each
    hypothesis.
    """
    fit = SimpleNamespace(unknowns=(unknown,), u=np.array([u]))
    own = [
        SimpleNamespace(mean=np.array([m]), covariance=np.array([[v]]), fit=fit)
        for _, m, v in parts
    ]
    hypotheses = tuple(
        Hypothesis((), False, w, 0.0, e) for (w, _, _), e in zip(parts, own, strict=True)
    )
    return Finding(hypotheses, {}, {}), own[0]


def test_intervals_are_those_of_a_linear_problem():
    """One unknown with prior sd 2 seen once with noise 1: posterior variance 1/(1/4 + 1), 0.2 of
    the prior's.
    """
    unknown = Unknown("x", 5.0, 2.0, -math.inf, math.inf, False)
    result = judgement.intervals(*linear(unknown, 0.5, (1.0, 0.5, 0.2)))
    assert result["x"].value == pytest.approx(6.0)
    assert result["x"].high - result["x"].value == pytest.approx(1.959964 * math.sqrt(0.8))
    logarithmic = Unknown("x", 0.0, 2.0, -math.inf, math.inf, True)
    result = judgement.intervals(*linear(logarithmic, 0.5, (1.0, 0.5, 0.2)))
    assert result["x"].high / result["x"].value == pytest.approx(
        result["x"].value / result["x"].low
    )


def test_intervals_are_over_all_hypotheses():
    unknown = Unknown("x", 0.0, 1.0, -math.inf, math.inf, False)
    result = judgement.intervals(*linear(unknown, 0.0, (0.5, 0.0, 0.01), (0.5, 1.0, 0.01)))
    assert result["x"].value == pytest.approx(0.5)
    assert result["x"].high == pytest.approx(0.5 + 1.959964 * math.sqrt(0.26))


@given(st.floats(-50, 50), st.floats(1e-6, 10), st.floats(0.1, 5))
@settings(max_examples=50, deadline=None)
def test_intervals_stay_within_the_bounds(u, variance, sd):
    unknown = Unknown("x", 0.0, sd, -1.0, 1.0, False)
    at = unknown.at(min(max(unknown.value(u), -1.0), 1.0))
    result = judgement.intervals(*linear(unknown, at, (1.0, at, variance)))["x"]
    assert -1.0 - 1e-9 <= result.low <= result.value <= result.high <= 1.0 + 1e-9


def test_closed_weighs_what_is_above_the_noise(planted):
    """1 where the gap falls to the noise, less where another channel grows, None without a gap."""
    gap = {"sinkage": judgement.Gap(0.0012, 0.0006, 0.0006), "torque": judgement.Gap(0.1, 0.1, 0.1)}
    assert judgement.closed(planted.problem, gap) == pytest.approx(1.0)
    gap["torque"] = judgement.Gap(0.1, 0.2, 0.1)
    assert judgement.closed(planted.problem, gap) == pytest.approx(0.0)
    assert judgement.closed(planted.problem, {"sinkage": judgement.Gap(0.5, 0.5, 0.6)}) is None


def test_shares_of_two_effects_sum_to_what_both_close(problem):
    rng = np.random.default_rng(5)
    before = predictions(problem, 4.0, rng)
    held = {
        (): before,
        ("a",): predictions(problem, 3.0, rng),
        ("b",): predictions(problem, 2.0, rng),
        ("a", "b"): predictions(problem, 1.2, rng),
    }
    shares = judgement.shares(problem, held)
    both = judgement.closed(problem, judgement.gaps(problem, before, held["a", "b"]))
    assert sum(shares.values()) == pytest.approx(both) and shares["b"] > shares["a"] > 0.0
    alone = judgement.shares(problem, {(): before, ("b",): held["b",]})
    assert alone["b"] == judgement.closed(problem, judgement.gaps(problem, before, held["b",]))


@pytest.fixture(scope="module")
def problem():
    """A table of the base model without noise: 36 rows of six slips, three loads and two speeds."""
    return Problem(table(speeds=(0.03, 0.1)), NOISE.copy(), np.ones((36, 3), dtype=bool))


def predictions(problem, size, rng):
    """Held-out predictions [N, 3] with normal errors of `size` standard deviations of the noise."""
    return problem.data.y + size * NOISE * rng.normal(size=problem.data.y.shape)


def test_it_holds_the_share_and_is_the_same_for_the_same_seed(problem):
    """The interval of the share of the gap that is closed, `closed_interval`."""
    rng = np.random.default_rng(1)
    before = predictions(problem, 3.0, rng)
    after = predictions(problem, 1.5, rng)
    share = judgement.closed(problem, judgement.gaps(problem, before, after))
    low, high = closed_interval(problem, before, after, np.random.default_rng(0))
    assert low < share < high <= 1.0 and 0.02 < high - low < 0.6
    assert closed_interval(problem, before, after, np.random.default_rng(0)) == (low, high)


def test_noise_of_single_rows_is_no_gap(problem):
    """Errors as large as the noise of each row, which differs by ten between rows."""
    rng = np.random.default_rng(3)
    relative = 10.0 ** rng.uniform(-0.5, 0.5, problem.data.y.shape)
    own = with_data(problem, relative_sd=relative)
    as_noise = own.data.y + relative * NOISE * rng.normal(size=relative.shape)
    for gap in judgement.gaps(own, as_noise, as_noise).values():
        assert gap.over_noise[0] == pytest.approx(1.0, abs=0.25)


def test_one_bad_group_widens_it(problem):
    """The interval is wider where an error sits in one slip alone than where the same error is
    spread over all slips.
    """
    rng = np.random.default_rng(2)
    before = predictions(problem, 3.0, rng)
    after = predictions(problem, 1.0, rng)
    spread = after + 1.5 * NOISE * np.sign(rng.normal(size=after.shape))
    only = after.copy()
    group = folds(problem.data)[0] == 0
    only[group] += 1.5 * NOISE * np.sqrt(group.size / group.sum())
    wide, narrow = (
        np.ptp(closed_interval(problem, before, a, np.random.default_rng(0)))
        for a in (only, spread)
    )
    assert wide > 1.5 * narrow
