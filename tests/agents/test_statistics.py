"""Statistics over training seeds and courses, against scipy and against the plain definitions."""

import numpy as np
import pytest
from hypothesis import given, strategies as hs
from hypothesis.extra.numpy import arrays
from scipy import stats

from agents.evaluate import statistics as st

SCORES = arrays(
    float, hs.tuples(hs.integers(1, 5), hs.integers(1, 12)), elements=hs.integers(-3, 3).map(lambda x: x / 2)
)


def repeated(scores, members, courses):
    """The scores of one draw, written out: every member and course as often as it was drawn."""
    rows = np.repeat(np.arange(len(scores)), members.astype(int))
    columns = np.repeat(np.arange(scores.shape[1]), courses.astype(int))
    return scores[np.ix_(rows, columns)]


def drawn(scores, resamples=103, seed=3, name="a"):
    draws = st.draws(seed, scores.shape[1], resamples)
    return draws.members(name, len(scores)), draws.courses


@given(SCORES)
def test_iqm_is_scipy_s_trimmed_mean(scores):
    assert st.iqm(scores) == pytest.approx(stats.trim_mean(scores, 0.25, axis=None), abs=1e-12)


@given(SCORES)
def test_draws_of_the_iqm_are_those_of_the_scores_written_out(scores):
    members, courses = drawn(scores)
    got = st.iqm_samples(scores, members, courses)
    for k in range(len(courses)):
        expected = stats.trim_mean(repeated(scores, members[k], courses[k]), 0.25, axis=None)
        assert got[k] == pytest.approx(expected, abs=1e-12)


@given(SCORES)
def test_draws_of_the_mean_are_those_of_the_scores_written_out(scores):
    members, courses = drawn(scores)
    scores = np.where(scores > 1.0, np.nan, scores)  # not defined on some courses
    got = st.mean_samples(scores, members, courses)
    for k in range(len(courses)):
        values = repeated(scores, members[k], courses[k])
        values = values[np.isfinite(values)]
        if values.size:
            assert got[k] == pytest.approx(values.mean(), abs=1e-12)
        else:
            assert np.isnan(got[k])


@given(SCORES, hs.integers(1, 4), hs.randoms(use_true_random=False))
def test_probability_of_improvement_is_the_mann_whitney_statistic(a, members, random):
    b = np.array([[random.choice((-1.0, 0.0, 0.5, 2.0)) for _ in range(a.shape[1])] for _ in range(members)])
    u = [stats.mannwhitneyu(x, y, method="asymptotic").statistic for x, y in zip(a.T, b.T, strict=True)]
    got = st.probability_of_improvement(a, b)
    assert got == pytest.approx(np.mean(u) / (len(a) * len(b)), abs=1e-12)
    assert got + st.probability_of_improvement(b, a) == pytest.approx(1.0)


@given(SCORES)
def test_draws_of_the_improvement_are_those_of_the_scores_written_out(a):
    b = a[::-1, ::-1] + 0.25
    (members_a, courses), (members_b, _) = drawn(a), drawn(b, name="b")
    got = st.improvement_samples(a, b, members_a, members_b, courses)
    for k in range(len(courses)):
        x, y = repeated(a, members_a[k], courses[k]), repeated(b, members_b[k], courses[k])
        assert got[k] == pytest.approx(st.probability_of_improvement(x, y), abs=1e-12)


def test_draws_are_reproducible_and_whole():
    a, b, other = st.draws(5, 40, 100), st.draws(5, 40, 100), st.draws(6, 40, 100)
    np.testing.assert_array_equal(a.courses, b.courses)
    assert (a.courses != other.courses).any()
    np.testing.assert_array_equal(a.courses.sum(axis=1), 40)
    members = a.members("ppo", 5)
    np.testing.assert_array_equal(members, b.members("ppo", 5))
    np.testing.assert_array_equal(members.sum(axis=1), 5)
    assert (members != a.members("sac", 5)).any()
    np.testing.assert_array_equal(a.members("one", 1), 1.0)


def test_the_interval_holds_the_middle_95_percent():
    low, high = st.interval(50.0, np.arange(101.0))
    assert (low, high) == pytest.approx((2.5, 97.5))
    assert st.interval(200.0, np.arange(101.0))[1] == 200.0
    assert st.interval(1.0, np.array([np.nan])) == (1.0, 1.0)


def test_two_way_draws_cover_the_luck_of_training():
    """10 training seeds, each better or worse on all courses alike; the truth is the mean over seeds and courses."""
    rng, covered, trials = np.random.default_rng(2), 0, 120
    for t in range(trials):
        scores = rng.normal(0.0, 1.0, (10, 1)) + rng.normal(0.0, 1.0, (1, 30)) + rng.normal(0.0, 0.5, (10, 30))
        members, courses = drawn(scores, resamples=200, seed=t)
        low, high = st.interval(st.mean(scores), st.mean_samples(scores, members, courses))
        covered += low <= 0.0 <= high
    assert covered / trials > 0.85


@pytest.mark.parametrize("n", [1, 5, 20, 1000])
def test_wilson_agrees_with_scipy(n):
    for k in sorted({0, 1, n // 3, n - 1, n}):
        expected = stats.binomtest(k, n).proportion_ci(0.95, method="wilson")
        assert st.wilson(k, n) == pytest.approx((expected.low, expected.high), abs=1e-9)
