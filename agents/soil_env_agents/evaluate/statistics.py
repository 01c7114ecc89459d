"""Statistics over training seeds and courses.

Scores of one controller are an array [members, courses]: one row a training seed (a controller that
is not trained has one row), one column a course. All controllers drive the same courses. NaN: not
defined on that course.

Intervals draw whole training seeds and whole courses with replacement, the courses once for all
controllers (the pigeonhole bootstrap, Owen 2007, Ann. Appl. Stat. 1(2) 386). They hold for another
training and other courses. With one training seed only the courses are drawn. They are computed
from weights: how often a member and a course were drawn.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

LEVEL = 0.95  # probability of every interval
_NORMAL = float(stats.norm.ppf(0.5 + LEVEL / 2))
_CHUNK = 100  # bootstrap draws whose weights are in memory at once


@dataclass(frozen=True)
class Draws:
    """Bootstrap draws: how often each course [resamples, courses] was drawn, and a seed for the
    members.
    """

    courses: np.ndarray
    seed: int

    def members(self, name: str, count: int) -> np.ndarray:
        """Counts of the draws of each of `count` members of controller `name` [resamples,
        count].
        """
        rng = np.random.default_rng([self.seed, 1, *name.encode()])
        return _counts(rng, len(self.courses), count)


def draws(seed: int, courses: int, resamples: int = 2000) -> Draws:
    """`Draws` of a study on so many `courses`; the same for the same arguments."""
    return Draws(_counts(np.random.default_rng([seed, 0]), resamples, courses), seed)


def _counts(rng, resamples, n):
    """How often each of `n` is drawn in n draws with replacement, [resamples, n]."""
    return rng.multinomial(n, np.full(n, 1.0 / n), size=resamples).astype(float)


def interval(value: float, samples: np.ndarray) -> tuple[float, float]:
    """Percentile interval (low, high) at `LEVEL` of bootstrap `samples` [resamples], NaN left out.

    It is widened to hold `value`, and is `value` alone where every sample is NaN.
    """
    samples = samples[np.isfinite(samples)]
    if not samples.size:
        return value, value
    low, high = np.quantile(samples, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
    return float(min(low, value)), float(max(high, value))


def wilson(successes: float, trials: float) -> tuple[float, float]:
    """Wilson (1927) score interval (low, high) of a proportion at `LEVEL`.

    `trials` > 0, and neither argument needs to be a whole number.
    """
    p = successes / trials
    z = _NORMAL
    centre = p + z * z / (2 * trials)
    half = z * math.sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials))
    scale = 1 + z * z / trials
    # min and max guard against rounding: at p = 0 and p = 1 the interval touches p exactly
    return max(0.0, min(p, (centre - half) / scale)), min(1.0, max(p, (centre + half) / scale))


def bounds(value: float, samples: np.ndarray) -> dict[str, float]:
    """{"value", "low", "high"} with the `interval` of bootstrap samples."""
    low, high = interval(value, samples)
    return {"value": value, "low": low, "high": high}


def rate_bounds(value: float, samples: np.ndarray, trials: float, members: int) -> dict[str, float]:
    """`bounds` of a rate: the Wilson interval; for several `members` each end is the wider one of
    Wilson's and the bootstrap's.

    `value` is the rate itself, `samples` its bootstrap draws. `trials` counts courses: several
    training seeds on one course are not independent trials.
    """
    low, high = wilson(value * trials, trials)
    if members > 1:
        by_draws = interval(value, samples)
        low = min(low, by_draws[0])
        high = max(high, by_draws[1])
    return {"value": value, "low": low, "high": high}


def difference_bounds(a: np.ndarray, b: np.ndarray, samples: np.ndarray) -> dict[str, float]:
    """`bounds` of the difference a - b of two rates on the same courses, from 0 or 1 in `a` and `b`
    [members, courses] and bootstrap `samples` of the difference.

    Each end is the wider of the bootstrap's and that of Agresti & Min (2005, Statistics in Medicine
    24:729, Wald + 2). Theirs has a width even where no course differs.
    """
    n = a.shape[1] + 2.0  # courses, two of them added by the method
    # Shares of the courses on which a and b alone succeed, with half a course added to each.
    won, lost = (
        ((x[:, None] > y[None]).mean(axis=(0, 1)).sum() + 0.5) / n for x, y in ((a, b), (b, a))
    )
    half = _NORMAL * math.sqrt((won + lost - (won - lost) ** 2) / n)
    out = bounds(mean(a) - mean(b), samples)
    return out | {
        "low": max(-1.0, min(out["low"], float(won - lost - half))),
        "high": min(1.0, max(out["high"], float(won - lost + half))),
    }


def mean(scores: np.ndarray) -> float:
    """Mean over all members and courses, NaN left out; NaN where there is nothing."""
    known = np.isfinite(scores)
    return float(scores[known].mean()) if known.any() else math.nan


def mean_samples(scores: np.ndarray, members: np.ndarray, courses: np.ndarray) -> np.ndarray:
    """`mean` of each bootstrap draw [resamples], for counts of the draws of `members` [resamples,
    members] and `courses` [resamples, courses].
    """
    known = np.isfinite(scores)
    total = ((courses @ np.where(known, scores, 0.0).T) * members).sum(axis=1)
    count = ((courses @ known.T.astype(float)) * members).sum(axis=1)
    return np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0.0)


def iqm(scores: np.ndarray) -> float:
    """Interquartile mean: the mean without the lowest and the highest quarter of all scores
    (Agarwal et al. 2021).
    """
    return float(stats.trim_mean(scores, 0.25, axis=None))


def iqm_samples(scores: np.ndarray, members: np.ndarray, courses: np.ndarray) -> np.ndarray:
    """`iqm` of each bootstrap draw [resamples], arguments as of `mean_samples`; every draw holds
    scores.size scores.
    """
    n = scores.size
    ordered = np.sort(scores, axis=None)
    cut = n // 4  # scores that are left out on either side
    out = []
    m, c = np.unravel_index(np.argsort(scores, axis=None, kind="stable"), scores.shape)
    for start in range(0, len(courses), _CHUNK):
        part = slice(start, start + _CHUNK)
        # Scores of the draw up to each of `ordered`.
        up_to = np.cumsum(members[part][:, m] * courses[part][:, c], axis=1)
        out.append(np.diff(np.clip(up_to, cut, n - cut), axis=1, prepend=cut) @ ordered)
    return np.concatenate(out) / (n - 2 * cut)


def _wins(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[members of a, members of b, courses]: 1 where a is better than b on the course, 1/2 where
    equal, else 0.
    """
    return (a[:, None] > b[None]) + 0.5 * (a[:, None] == b[None])


def probability_of_improvement(a: np.ndarray, b: np.ndarray) -> float:
    """Probability that a random member of a scores higher than a random member of b on a random
    course, ties half.

    On each course it is the Mann-Whitney statistic over the product of the numbers of members
    (Agarwal et al. 2021).
    """
    return float(_wins(a, b).mean())


def improvement_samples(a, b, members_a, members_b, courses) -> np.ndarray:
    """`probability_of_improvement` of each bootstrap draw [resamples].

    `members_a`, `members_b` and `courses` are counts of draws, as of `mean_samples`.
    """
    wins = _wins(a, b)
    n, m, k = wins.shape
    by_pair = (courses @ wins.reshape(n * m, k).T).reshape(-1, n, m)
    return np.einsum("bi,bij,bj->b", members_a, by_pair, members_b) / (n * m * k)
