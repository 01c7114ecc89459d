"""Location of disagreements between a table and a fitted model: channel, region of the conditions,
size, p value.

Every box of one or two conditions (intervals of levels of one, half-lines of two) is looked at in
every channel. What the fit's own parameters would absorb is projected out, so under the null the
statistic of a box is standard normal

    t = v'e / sqrt(v'P v),    e = P n,    P = I - A (A'A)^-1 A',    n ~ N(0, I),

v being 1 in the box, e the whitened residuals, n their noise and A the Jacobian of the fit. All
have the priors as further rows. The p value is that of the largest |t| over all boxes and channels;
its null distribution is simulated through P.
"""

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import stdtr

from soil_env.identification.table.data import CHANNELS

from .calibrate import Fit, Problem, Sizes
from .evidence import Evidence

SIGNIFICANT = 0.01  # p value above which a disagreement is not reported
LAW = 0.1  # relative error of the laws that `structure` allows
EFFECT = 0.12  # relative error of an effect's form that `structure` allows
MOST = 4  # disagreements reported
LEAST_VALUES = 3  # of a channel in a box
_DRAWS = 400  # draws of the noise, for the distribution of the largest |t|
#: Quantile of the simulated maxima at which the number of independent looks is read off.
_TAIL = 0.95
#: Least |t| of the mean residual of a box without the projection, which a reader of a report sees.
_SHOWS = 2.0
_OPEN = 0.02  # share of a box's variance that the parameters must leave for it to be looked at


@dataclass(frozen=True)
class Disagreement:
    """One box in which a channel leaves the model."""

    channel: str
    #: condition -> (low, high) in its unit; what is not named is not limited.
    region: dict[str, tuple[float, float]]
    size: float  # [m, N or N m] mean of measured - model in the box
    size_sd: float  # the same in standard deviations of the noise of one value
    p_value: float  # of as large a |t| in any box and channel


Limits = dict[str, tuple[int, int]]  # condition -> (first, last) level


def boxes(problem: Problem) -> tuple[tuple[Limits, ...], np.ndarray]:
    """(limits of each of R boxes, [R, N] bool, True for the rows inside).

    The boxes are the whole table, intervals of levels of one condition, and for each pair of
    conditions products of two half-lines. Boxes with fewer than `LEAST_VALUES` rows are left out,
    and so is a box of the same rows as one before it in this order.
    """
    varied = problem.data.varied
    rows = problem.data.rows.slip.size
    limits: list[Limits] = [{}]
    for name, c in varied.items():
        ends = combinations(range(c.levels + 1), 2)
        limits += [{name: (a, b - 1)} for a, b in ends if b - a < c.levels]
    for (one, c), (two, d) in combinations(varied.items(), 2):
        limits += [{one: p, two: q} for p in _half_lines(c.levels) for q in _half_lines(d.levels)]
    found: dict[bytes, Limits] = {}
    for box in limits:
        inside = np.ones(rows, bool)
        for name, (a, b) in box.items():
            inside &= (varied[name].level >= a) & (varied[name].level <= b)
        if inside.sum() >= LEAST_VALUES:
            found.setdefault(inside.tobytes(), box)
    return tuple(found.values()), np.frombuffer(b"".join(found), bool).reshape(len(found), rows)


def _half_lines(levels: int) -> list[tuple[int, int]]:
    """(first, last) level of every interval that begins at the first level or ends at the last; not
    that of all levels.
    """
    return [(0, k) for k in range(levels - 1)] + [(k, levels - 1) for k in range(1, levels)]


def locate(problem: Problem, fit: Fit, seed: int = 0) -> tuple[Disagreement, ...]:
    """Significant disagreements, the most certain first, at most `MOST`; none where the model
    explains the table.

    After each, the box is given to the model as a further parameter, so that the next one says
    something new; in one channel the boxes do not overlap. The form errors that the model may have
    are those of the `fit`, at its sizes. `seed`: of the simulated null distribution.
    """
    limits, member = boxes(problem)
    a, e = fit.linearised()
    q = np.linalg.qr(a)[0]  # directions that the parameters absorb
    row, channel = np.nonzero(problem.used)
    inside = member[:, row] & (channel == np.arange(3)[:, None])[:, None]
    where = np.argwhere(inside.sum(axis=2) >= LEAST_VALUES)  # [pairs, 2] channel, box
    if not where.size:
        return ()
    raw = np.zeros((len(q), len(where)))  # v of the module's docstring, a column for each
    raw[: row.size] = inside[tuple(where.T)].T
    v, left = _project(raw, q)
    looks = _independent_looks(v, where[:, 0], problem.freedom, np.random.default_rng(seed))
    # A box must show in the residual without projection as well, with the same sign.
    plain = (raw[: row.size].T @ fit.residual) / np.sqrt(raw.sum(axis=0))
    out: list[Disagreement] = []
    taken: list[tuple[int, np.ndarray]] = []  # (channel, values inside [N, bool])
    allowed = left & (np.abs(plain) > _SHOWS)
    while len(out) < MOST and allowed.any():
        t = v.T @ e
        t = np.where(allowed & (t * plain > 0.0), np.abs(t), 0.0)
        k = np.argmax(t)
        p = _p_value(t[k], looks, problem.freedom)
        if p >= SIGNIFICANT:
            break
        j, box = where[k]
        out.append(_disagreement(problem, fit, CHANNELS[j], limits[box], member[box], p))
        taken.append((j, member[box] & problem.used[:, j]))
        e = e - v[:, k] * (v[:, k] @ e)
        v, left = _project(v, v[:, k : k + 1])
        apart = [not any(j == i and np.any(m & member[b]) for i, m in taken) for j, b in where]
        allowed = allowed & left & np.array(apart)
    return tuple(out)


def structure(problem: Problem, model: Evidence, seed: int = 0) -> float:
    """p value of the most certain `Disagreement` that a model leaves in a channel, over slip, load
    and the other conditions; 1 where none is significant.

    A posterior predictive check: a pattern counts that neither noise, nor laws that are off by
    `LAW`, nor effects whose form is off by `EFFECT` explain. If the most probable form error of the
    effects is larger than `EFFECT`, that is allowed. Unlike the evidence, the check needs no other
    model to compare with.
    """
    fit = model.fit
    effect = max(model.sizes.effect, EFFECT) if fit.choices else 0.0
    sizes = Sizes(LAW, effect, span=model.sizes.span, scatter=model.sizes.scatter, rig=1.0)
    left = locate(problem, problem.fit(fit.choices, fit.parameters(), sizes, fit), seed)
    return left[0].p_value if left else 1.0


def _project(v: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(columns of v [M, R] without the orthonormal directions q [M, K], scaled to the length 1;
    [R] bool, True for those that keep the share `_OPEN` of their variance).

    Columns that keep less become 0.
    """
    before = np.linalg.norm(v, axis=0)
    v = v - q @ (q.T @ v)
    length = np.linalg.norm(v, axis=0)
    left = length > math.sqrt(_OPEN) * before
    return v / np.where(left, length, math.inf), left


def _independent_looks(
    v: np.ndarray, channel: np.ndarray, freedom: float, rng: np.random.Generator
) -> float:
    """Number of independent looks, at least 1, that is equivalent to the columns of v [M, R].

    The largest |t| of so many looks has the same quantile `_TAIL` as the largest |t| over the
    columns, which is simulated under the null. `channel` [R]: that of each column. Noise that is
    known to `freedom` degrees has an error of its own in each channel.
    """
    t = np.abs(rng.standard_normal((_DRAWS, v.shape[0]), dtype=np.float32) @ v.astype(np.float32))
    if math.isfinite(freedom):
        noise = np.sqrt(rng.chisquare(freedom, (_DRAWS, 3)) / freedom)
        t /= noise.astype(np.float32)[:, channel]
    alone = _p_of_one(np.quantile(t.max(axis=1), _TAIL), freedom)
    return max(1.0, math.log(_TAIL) / math.log1p(-alone)) if alone < 1.0 else 1.0


def _p_of_one(t: float, freedom: float) -> float:
    """p value of one look: two-sided, by Student's t distribution."""
    return float(2.0 * stdtr(freedom, -t))


def _p_value(t: float, looks: float, freedom: float) -> float:
    """p value of the largest |t| of so many independent looks."""
    alone = _p_of_one(t, freedom)
    return -math.expm1(looks * math.log1p(-alone)) if alone < 1.0 else 1.0


def _disagreement(
    problem: Problem, fit: Fit, channel: str, box: Limits, member: np.ndarray, p: float
) -> Disagreement:
    """`Disagreement` in a box with the rows `member` [N, bool] and the p value p.

    Limits are values of the table; the size is the mean residual of the values in use.
    """
    j = CHANNELS.index(channel)
    varied = problem.data.varied
    inside = member & problem.used[:, j]
    size = float(np.mean((problem.data.y - fit.output)[inside, j]))
    region = {}
    for name, (a, b) in box.items():
        value = varied[name].value[(varied[name].level >= a) & (varied[name].level <= b)]
        region[name] = (float(value.min()), float(value.max()))
    return Disagreement(channel, region, size, float(size / np.mean(problem.sd[inside, j])), p)
