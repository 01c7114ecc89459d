"""Statistics over training seeds and courses, against scipy and against the plain definitions."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as hs
from hypothesis.extra.numpy import arrays
from scipy import stats

from soil_env_agents.evaluate import statistics as st

SCORES = arrays(
    float,
    hs.tuples(hs.integers(1, 5), hs.integers(1, 12)),
    elements=hs.integers(-3, 3).map(lambda x: x / 2),
)


def drawn(scores, resamples=103, seed=3, name="a"):
    """How often each member and each course of `scores` [members, courses] is drawn: ([resamples,
    members], [resamples, courses]).
    """
    draws = st.draws(seed, scores.shape[1], resamples)
    return draws.members(name, len(scores)), draws.courses


@given(SCORES, hs.integers(1, 4), hs.randoms(use_true_random=False))
def test_probability_of_improvement_is_the_mann_whitney_statistic(a, members, random):
    count = members * a.shape[1]
    b = np.reshape(random.choices((-1.0, 0.0, 0.5, 2.0), k=count), (members, -1))
    u = stats.mannwhitneyu(a, b, method="asymptotic").statistic  # of each course
    got = st.probability_of_improvement(a, b)
    assert got == pytest.approx(np.mean(u) / (len(a) * len(b)), abs=1e-12)
    assert got + st.probability_of_improvement(b, a) == pytest.approx(1.0)


@settings(deadline=None)
@given(SCORES)
def test_statistics_of_draws_are_those_of_the_scores_written_out(a):
    """With every member and every course repeated as often as it was drawn."""
    b = a[::-1, ::-1] + 0.25
    holes = np.where(a > 1.0, np.nan, a)  # not defined on some courses
    members, courses = drawn(a)
    others, _ = drawn(b, name="b")
    iqms = st.iqm_samples(a, members, courses)
    means = st.mean_samples(holes, members, courses)
    improvements = st.improvement_samples(a, b, members, others, courses)
    for k in range(0, len(courses), 6):  # the last among them
        columns = np.repeat(np.arange(a.shape[1]), courses[k].astype(int))
        own, other = (np.repeat(np.arange(len(m)), m.astype(int)) for m in (members[k], others[k]))
        x = a[np.ix_(own, columns)]
        y = b[np.ix_(other, columns)]
        mean = st.mean(holes[np.ix_(own, columns)])
        improvement = st.probability_of_improvement(x, y)
        assert iqms[k] == pytest.approx(stats.trim_mean(x, 0.25, axis=None), abs=1e-12)
        assert means[k] == pytest.approx(mean, abs=1e-12, nan_ok=True)
        assert improvements[k] == pytest.approx(improvement, abs=1e-12)


def test_draws_are_whole_and_those_of_the_members_are_of_their_name():
    draws = st.draws(5, 40, 100)
    np.testing.assert_array_equal(draws.courses.sum(axis=1), 40)
    members = draws.members("ppo", 5)
    np.testing.assert_array_equal(members.sum(axis=1), 5)
    assert (members != draws.members("sac", 5)).any()
    assert (draws.courses != st.draws(6, 40, 100).courses).any()


def test_the_interval_holds_the_middle_95_percent():
    low, high = st.interval(50.0, np.arange(101.0))
    assert (low, high) == pytest.approx((2.5, 97.5))
    assert st.interval(200.0, np.arange(101.0))[1] == 200.0
    assert st.interval(1.0, np.array([np.nan])) == (1.0, 1.0)


def test_two_way_draws_cover_the_luck_of_training():
    """10 training seeds, each better or worse on all courses alike; the true mean over seeds and
    courses is 0.
    """
    rng = np.random.default_rng(2)
    covered = 0
    trials = 120
    for t in range(trials):
        scores = rng.normal(size=(10, 1)) + rng.normal(size=30) + rng.normal(0.0, 0.5, (10, 30))
        members, courses = drawn(scores, resamples=200, seed=t)
        low, high = st.interval(st.mean(scores), st.mean_samples(scores, members, courses))
        covered += low <= 0.0 <= high
    assert covered / trials > 0.85


@pytest.mark.parametrize("alone", [0.0, 0.01, 0.05, 0.2])
def test_the_difference_of_rates_is_covered_where_hardly_a_course_differs(alone):
    """`alone`: share of the courses on which `a` succeeds and `b` does not, and that of the
    opposite; on the others both have 0.8. The true difference is 0.
    """
    rng = np.random.default_rng(3)
    covered = 0
    trials = 200
    for t in range(trials):
        u, both = rng.random((2, 1, 60))
        a, b = (np.where(u < 2.0 * alone, own, both < 0.8) * 1.0 for own in (u < alone, u >= alone))
        samples = [st.mean_samples(x, *drawn(x, 200, t, name)) for x, name in ((a, "a"), (b, "b"))]
        got = st.difference_bounds(a, b, samples[0] - samples[1])
        assert got["low"] < got["value"] < got["high"]
        covered += got["low"] <= 0.0 <= got["high"]
    assert covered / trials > 0.92


def test_a_difference_of_rates_is_at_most_one():
    got = st.difference_bounds(np.ones((1, 5)), np.zeros((1, 5)), np.ones(200))
    assert (got["value"], got["high"]) == (1.0, 1.0) and 0.0 < got["low"] < 1.0


@pytest.mark.parametrize("n", [1, 5, 20, 1000])
def test_wilson_agrees_with_scipy(n):
    for k in sorted({0, 1, n // 3, n - 1, n}):
        low, high = st.wilson(k, n)
        expected = stats.binomtest(k, n).proportion_ci(0.95, method="wilson")
        assert (low, high) == pytest.approx(tuple(expected), abs=1e-9)
        assert low <= k / n <= high  # rounding may not put the value outside
