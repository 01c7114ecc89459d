"""Statistics of a finding: intervals, the gap on held-out data and shares of it.

All follow from models linearised about given fits; nothing is fitted here.
"""

import math
from typing import NamedTuple

import numpy as np

from soil_env.identification.table.data import CHANNELS, folds
from soil_env.identification.table.form_error import mixed
from soil_env.identification.table.priors import Unknown

from .calibrate import Fit, Problem
from .evidence import Evidence
from .instrument import Names
from .search import Finding

SD_OF_95 = 1.959964  # [sd] half of a 95 % interval
_CLOSED_DRAWS = 2000  # of the groups, for the interval of `closed`
_LEAST_GAP = 0.5  # share of these draws that have a gap to close, below which no interval is given


class Interval(NamedTuple):
    """Value with its 95 % interval; low = high = value where it was given or set, or where a bound
    leaves no width.
    """

    value: float
    low: float
    high: float


class Remainder(NamedTuple):
    """What the named effects leave of an error, without the noise."""

    rms: float  # [unit of the channel]
    share: float | None  # mean square over that before; None if nothing was left before


class Gap(NamedTuple):
    """Root mean square of measured - predicted on held-out data [unit of the channel]."""

    before: float  # of the base model
    after: float  # with the named effects
    noise_floor: float  # standard deviation of the noise

    @property
    def over_noise(self) -> tuple[float, float]:
        """Error before and after over the noise."""
        return self.before / self.noise_floor, self.after / self.noise_floor

    @property
    def remainder(self) -> Remainder:
        """What is left once the variance of the noise is taken off each mean square, to 0 at
        least.
        """
        before, after = (max(x**2 - self.noise_floor**2, 0.0) for x in (self.before, self.after))
        return Remainder(math.sqrt(after), after / before if before > 0.0 else None)


def intervals(finding: Finding, own: Evidence) -> dict[str, Interval]:
    """Value and 95 % interval of every unknown, in its unit, by a normal distribution of what is
    fitted, its mean or that of its logarithm.

    Those of the soil have mean and variance of the mixture of all hypotheses and sizes of form
    errors, each with its probability. Those of the effects are of `own`, the model of the named
    effects, averaged over the sizes. No end is beyond a bound.
    """
    p = len(finding.best().evidence.fit.unknowns)  # of the soil, which come first in all models
    share = np.array([h.probability for h in finding.hypotheses])
    mean = np.stack([h.evidence.mean[:p] for h in finding.hypotheses])
    within = np.stack([h.evidence.covariance[:p, :p] for h in finding.hypotheses])
    soil, covariance = mixed(share, mean, within)
    mean = np.concatenate([soil, own.mean[p:]])
    sd = np.sqrt(np.concatenate([np.diag(covariance), np.diag(own.covariance)[p:]]))
    return {k.name: _interval(k, u, s) for k, u, s in zip(own.fit.unknowns, mean, sd, strict=True)}


def _interval(unknown: Unknown, u: float, sd: float) -> Interval:
    """Value and 95 % interval of an unknown in its unit, within its bounds, where the whitened one
    is normal with mean u and standard deviation `sd`.
    """
    return Interval(
        *(
            float(unknown.value(np.clip(x, *unknown.bounds)))
            for x in (u, u - SD_OF_95 * sd, u + SD_OF_95 * sd)
        )
    )


def held_out_predictions(problem: Problem, fit: Fit) -> np.ndarray:
    """[N, 3] prediction of each value by the model fitted without the group that holds the value;
    NaN where it is not in use.

    Form errors weigh the values and do not enter the prediction, which is that of the laws. Refits
    are linearised about the fit to all. The table is cut into groups in one or two ways (`folds`),
    of which the mean is taken.
    """
    a, e = fit.linearised()
    ways = folds(problem.data)
    used = problem.used
    rows = np.nonzero(used)[0]
    jacobian = a[: fit.residual.size]
    normal = a.T @ a
    residual = e[: fit.residual.size]
    laws = fit.free_unknowns.sum()  # the columns after these are form errors
    error = np.zeros(residual.size)  # [noise] measured less predicted
    for out in (way[rows] == k for way in ways for k in range(way.max() + 1)):
        j = jacobian[out]
        r = residual[out]
        # Solution of the normal equations without the values that are held out.
        moved = np.linalg.solve(normal - j.T @ j, a.T @ e - j.T @ r)
        # The linear problem is over the noise times the scatter.
        error[out] += fit.sizes.scatter * (r - j[:, :laws] @ moved[:laws]) / len(ways)
    predicted = np.full(used.shape, math.nan)
    predicted[used] = problem.data.y[used] - error * problem.sd[used]
    return predicted


def gaps(problem: Problem, before: np.ndarray, after: np.ndarray) -> dict[str, Gap]:
    """`Gap` by measured channel of held-out predictions `before` and `after` [N, 3], over the
    values in use.
    """
    out: dict[str, Gap] = {}
    for j, name in enumerate(CHANNELS):
        used = problem.used[:, j]
        if used.any():
            y = problem.data.y[used, j]
            old, new = (float(np.sqrt(np.mean((y - p[used, j]) ** 2))) for p in (before, after))
            out[name] = Gap(old, new, float(problem.rms_noise[j]))
    return out


def closed(problem: Problem, gap: dict[str, Gap]) -> float | None:
    """Share of the gap that is closed, by `gap` of each channel.

    The gap is the held-out mean square above the noise, summed over the channels with their numbers
    of values as weights. The share is negative where the error has grown. None where no channel had
    an error above the noise.
    """
    before, after = (
        sum(
            problem.used[:, CHANNELS.index(name)].sum() * max(g.over_noise[k] ** 2 - 1.0, 0.0)
            for name, g in gap.items()
        )
        for k in (0, 1)
    )
    return None if before <= 0.0 else 1.0 - after / before


def closed_interval(
    problem: Problem, before: np.ndarray, after: np.ndarray, rng: np.random.Generator
) -> tuple[float, float] | None:
    """95 % interval of `closed` for held-out predictions [N, 3], over the draws that have a gap;
    None where less than `_LEAST_GAP` of them have one.

    Values of one slip share the error of that slip, and values of one combination of the other
    conditions share another. Slips and combinations are drawn with replacement; a row counts as
    often as its slip times as often as its combination. This is the pigeonhole bootstrap (Owen
    2007, Ann. Appl. Stat. 1:386-411), which is conservative. The models are not refitted, since
    each value was predicted without its own group.
    """
    weight = np.ones((_CLOSED_DRAWS, problem.data.rows.slip.size))
    for group in folds(problem.data):
        count = group.max() + 1
        weight *= rng.multinomial(count, np.full(count, 1.0 / count), size=_CLOSED_DRAWS)[:, group]
    total = []  # [draws] gap before, gap after
    for held in (before, after):
        square = np.where(problem.used, ((problem.data.y - held) / problem.rms_noise) ** 2, 0.0)
        count = weight @ problem.used  # [draws, 3]
        mean = (weight @ square) / np.maximum(count, 1.0)
        total.append(np.sum(count * np.maximum(mean - 1.0, 0.0), axis=1))
    gap = total[0] > 0.0
    if np.mean(gap) < _LEAST_GAP:
        return None
    low, high = np.quantile(1.0 - total[1][gap] / total[0][gap], (0.025, 0.975))
    return float(low), float(high)


def shares(problem: Problem, held: dict[Names, np.ndarray]) -> dict[str, float | None]:
    """Share of the gap above the noise that each named effect closes; None where there is no gap.

    `held`: held-out predictions of the base model `()`, of each named effect alone and of all. Of
    two effects, each has the mean of what it closes alone and of what it adds to the other (Shapley
    value).
    """
    full = max(held, key=len)
    closes = {}
    for names, after in held.items():
        share = closed(problem, gaps(problem, held[()], after))
        if share is None:  # there is no gap, whatever is added
            return dict.fromkeys(full)
        closes[names] = share
    return {
        n: 0.5 * (closes[n,] + closes[full] - closes[tuple(m for m in full if m != n)])
        for n in full
    }
