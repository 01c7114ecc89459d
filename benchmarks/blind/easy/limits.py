"""How large an effect must be to be seen: the detection limit of a hidden effect in a given table.

The *gap* of an effect at strength s is the smallest noise-weighted sum of squares, priors counted as measurements, to
which the base world can be refitted (phi, c, K, S, n) to the noise-free table with the effect. It is the noncentrality
of the likelihood ratio against the base model. The detection limit is the strength at which the gap reaches the
noncentrality that gives a chi-square test at the 1 % level a power of 95 % (17.8 for one parameter, 20.7 for two).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.optimize import brentq, least_squares
from scipy.stats import chi2, ncx2

from benchmarks.blind.easy.forms import FORMS
from benchmarks.blind.effect import Context, Hidden
from benchmarks.blind.world import Ground, Outcome, Rows, Wheel, predict, with_soil

SOIL = ("friction_angle_deg", "cohesion", "shear_modulus", "sinkage_coefficient", "sinkage_exponent")
LEVEL, POWER = 0.01, 0.95
SOFTEST = np.array([5.0, 1.0, 5e-4, 1e2, 0.1])  # lower bounds of `SOIL` in a refit


@cache
def noncentrality(freedom: int) -> float:
    """Noncentrality at which a chi-square test of `freedom` degrees at `LEVEL` has the power `POWER`."""
    threshold = chi2.isf(LEVEL, freedom)
    return float(brentq(lambda nc: ncx2.sf(threshold, freedom, nc) - POWER, 1e-3, 500.0))


@dataclass(frozen=True, eq=False)
class Bench:
    """A table's conditions and what is known about them: all that a detection limit depends on."""

    wheel: Wheel
    ground: Ground  # the truth
    rows: Rows  # grades as a pattern in [-1, 1] times `grade`
    grade: float  # [deg]
    noise: tuple[float, float, float]  # 1-sigma of sinkage [m], drawbar pull [N], torque [N m]
    prior_sd: dict[str, float]  # of `SOIL`

    @property
    def context(self) -> Context:
        return Context(self.wheel, self.ground, self.conditions())

    def conditions(self, effects: Sequence[Hidden] = ()) -> Rows:
        """Rows with the grades in degrees, set by the strength of a grade effect if there is one."""
        scale = next((e.strength for e in effects if e.form.scales_grade), self.grade)
        return replace(self.rows, grade_deg=self.rows.grade_deg * scale)

    def truth(self, effects: Sequence[Hidden] = ()) -> np.ndarray:
        """Noise-free table [3, N]; NaN where the wheel finds no balance."""
        return self.predict(self.ground, self.conditions(effects), effects).stack()

    def predict(self, ground: Ground, rows: Rows, effects: Sequence[Hidden] = ()) -> Outcome:
        """Steady state of the wheel with the effects, applied in the order of their forms."""
        return predict(ground, self.wheel, rows, sorted(effects, key=lambda e: e.form.order))

    def weighted(self, table: np.ndarray) -> np.ndarray:
        """Table in units of the noise, flat."""
        return (table / np.array(self.noise)[:, None]).ravel()


def _tables(bench: Bench, effects: Sequence[Hidden], x: np.ndarray) -> np.ndarray:
    """Weighted tables [B, 3 N] for soils x [B, 5], in units of the prior's sd from the truth."""
    true = np.array([getattr(bench.ground, name) for name in SOIL])
    sd = np.array([bench.prior_sd[name] for name in SOIL])
    ground = with_soil(bench.ground, np.maximum(true + sd * x, SOFTEST), len(bench.rows))
    rows = bench.conditions(effects).tiled(len(x))
    out = bench.predict(ground, rows, effects).stack().reshape(3, len(x), -1)
    return np.moveaxis(out / np.array(bench.noise)[:, None, None], 1, 0).reshape(len(x), -1)


def _scaled(free: Sequence[Hidden], u: np.ndarray) -> list[Hidden]:
    return [e.at(e.strength * max(1.0 + du, 0.0)) for e, du in zip(free, u, strict=True)]


def _prediction(bench: Bench, free: Sequence[Hidden], x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weighted table [3 N] and its Jacobian by x: soil as in `_tables`, then relative changes of free strengths."""
    step = 0.02
    soils = np.concatenate([x[None, :5], x[:5] + step * np.eye(5)])
    flat = _tables(bench, _scaled(free, x[5:]), soils)
    more = [_tables(bench, _scaled(free, x[5:] + step * row), x[None, :5])[0] for row in np.eye(len(free))]
    return flat[0], (np.array([*flat[1:], *more]) - flat[0]).T / step


def refit(bench: Bench, table: np.ndarray, free: Sequence[Hidden] = (), rounds: int = 20) -> tuple[float, np.ndarray]:
    """Least weighted sum of squares, priors included, of a refit to a noise-free table [3, N], and where it is.

    Refitted are the soil (in sd of the prior from the truth) and the strengths of the effects in `free` (relative
    change). The sum is infinite where the table is not finite.
    """
    size = 5 + len(free)
    target = bench.weighted(table)
    if not np.all(np.isfinite(target)):
        return np.inf, np.zeros(size)
    penalty = np.eye(size)[:5]
    memo: dict[bytes, tuple] = {}

    def both(x):
        key = x.tobytes()
        if key not in memo:
            memo.clear()
            memo[key] = _prediction(bench, free, x)
        return memo[key]

    def residual(x):
        r = np.concatenate([both(x)[0] - target, penalty @ x])
        return np.where(np.isfinite(r), r, 1e3)

    def jacobian(x):
        j = np.concatenate([both(x)[1], penalty])
        return np.where(np.isfinite(j), j, 0.0)

    fit = least_squares(residual, np.zeros(size), jacobian, ftol=1e-3, xtol=1e-4, max_nfev=rounds)
    return float(2.0 * fit.cost), fit.x


def gap(bench: Bench, table: np.ndarray, free: Sequence[Hidden] = (), rounds: int = 20) -> float:
    """Least weighted sum of squares of `refit`."""
    return refit(bench, table, free, rounds)[0]


def detection_limit(bench: Bench, hidden: Hidden, others: Sequence[Hidden] = ()) -> float | None:
    """Strength (> 0) of an effect at its detection limit, or None if that is beyond its cap.

    The sign is that of `hidden.strength`. `others` are in the truth, and their strengths are refitted beside the soil.
    """
    form, sign = hidden.form, np.sign(hidden.strength) or 1.0
    cap = form.cap(bench.context)
    wanted = noncentrality(form.freedom)
    low, high, s = 0.0, np.inf, 0.02 * cap
    for _ in range(14):
        reached = gap(bench, bench.truth([*others, hidden.at(sign * s)]), others)
        if abs(np.log(max(reached, 1e-12) / wanted)) < 0.05:
            return float(s)
        if reached < wanted:
            low = s
            if s >= cap:
                return None
        else:
            high = s
        guess = s * np.sqrt(wanted / max(reached, 1e-4)) if np.isfinite(reached) else 0.5 * s
        guess = min(guess, cap)
        if not low < guess < high:
            guess = 0.5 * (low + high) if np.isfinite(high) else min(2.0 * s, cap)
        s = guess
    return float(s) if np.isfinite(high) else None


@dataclass(frozen=True)
class Imitation:
    """What listed effects leave of a table (weighted sum of squares, linearised), and which leave least."""

    none: float  # with no effect but those known
    one: float  # with the best other effect
    one_name: str
    two: float  # with the best two others
    two_names: tuple[str, str]
    each: dict[str, float]  # with the best form of each other effect

    @property
    def worst(self) -> float:
        """The lesser of `one` and `two`."""
        return min(self.one, self.two)


def imitation(
    bench: Bench, table: np.ndarray, known: Sequence[Hidden], excluded: set[str], rng: np.random.Generator
) -> Imitation:
    """How well listed effects other than `excluded` explain a noise-free table [3, N].

    The soil, the strengths of the `known` effects, and one listed form, then two, are fitted; linearised at the refit
    with the known effects alone. Forms keep to the signs they allow and to their caps; their side parameters are drawn.
    """
    bench = replace(bench, grade=next((e.strength for e in known if e.form.scales_grade), bench.grade))
    _, x = refit(bench, table, known)
    known = _scaled(known, x[5:])
    soil = x[None, :5]
    flat, jac = _prediction(bench, known, np.concatenate([x[:5], np.zeros(len(known))]))
    q, _ = np.linalg.qr(np.concatenate([jac, np.eye(5 + len(known))[:5]]))

    def left(vector, prior):
        vector = np.concatenate([vector, prior])
        return vector - q @ (q.T @ vector)

    residual = left(bench.weighted(table) - flat, -x[:5])
    columns, names, bounds = [], [], []
    for form in FORMS:
        if form.effect in excluded or (form.scales_grade and bench.grade == 0.0):
            continue
        cap = form.cap(bench.context)
        small = bench.grade if form.scales_grade else max(0.02 * cap, form.floor)
        moved = _tables(bench, [*known, Hidden(form, small, form.side(rng, bench.context))], soil)[0]
        if np.all(np.isfinite(moved)) and np.linalg.norm(c := left(moved - flat, np.zeros(5))) > 1e-6:
            columns.append(c)
            names.append(form.effect)
            bounds.append((-cap / small if -1 in form.signs else form.floor / small, cap / small))
    none = float(residual @ residual)
    each: dict[str, float] = {}
    for c, n, b in zip(columns, names, bounds, strict=True):
        k = np.clip((c @ residual) / (c @ c), *b)
        each[n] = min(each.get(n, none), float(np.sum((residual - k * c) ** 2)))
    one, one_name = min((value, n) for n, value in each.items())
    two, two_names = one, (one_name, one_name)
    for i, a in enumerate(columns):
        for j, b in enumerate(columns[:i]):
            if names[i] != names[j] and (value := _pair(a, b, residual, bounds[i], bounds[j])) < two:
                two, two_names = value, (names[j], names[i])
    return Imitation(none, one, one_name, two, two_names, each)


def _pair(a, b, residual, bounds_a, bounds_b) -> float:
    """Sum of squares with both columns, or infinite where a coefficient is out of its bounds (one alone is best)."""
    aa, bb, ab, ar, br = a @ a, b @ b, a @ b, a @ residual, b @ residual
    determinant = aa * bb - ab * ab
    if determinant < 1e-9 * aa * bb:
        return np.inf
    k, m = (bb * ar - ab * br) / determinant, (aa * br - ab * ar) / determinant
    if not (bounds_a[0] <= k <= bounds_a[1] and bounds_b[0] <= m <= bounds_b[1]):
        return np.inf
    return float(residual @ residual - k * ar - m * br)
