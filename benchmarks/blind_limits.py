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

from benchmarks.blind_effect import Context, Hidden
from benchmarks.blind_forms import FORMS
from benchmarks.blind_world import Ground, Rows, Wheel, predict, with_soil

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
        return predict(self.ground, self.wheel, self.conditions(effects), effects).stack()

    def weighted(self, table: np.ndarray) -> np.ndarray:
        """Table in units of the noise, flat."""
        return (table / np.array(self.noise)[:, None]).ravel()


def _prediction(bench: Bench, effects, free, x: np.ndarray):
    """Weighted prediction and its Jacobian by x in one batch of soils, and one prediction for each free strength.

    x[:5] is the soil in units of the prior's sd from the truth, x[5:] the relative change of the strengths of `free`.
    """
    true = np.array([getattr(bench.ground, name) for name in SOIL])
    sd = np.array([bench.prior_sd[name] for name in SOIL])
    step = 0.02

    def scaled(u):
        return [*effects, *(e.at(e.strength * max(1.0 + du, 0.0)) for e, du in zip(free, u, strict=True))]

    def run(values, u):
        soils = np.maximum(true + sd * values, SOFTEST)
        now = scaled(u)
        rows = bench.conditions(now).tiled(len(soils))
        ground = with_soil(bench.ground, soils, len(bench.rows))
        out = predict(ground, bench.wheel, rows, now).stack().reshape(3, len(soils), -1)
        return np.moveaxis(out / np.array(bench.noise)[:, None, None], 1, 0).reshape(len(soils), -1)

    flat = run(np.concatenate([x[None, :5], x[:5] + step * np.eye(5)]), x[5:])
    more = [run(x[None, :5], x[5:] + step * row)[0] for row in np.eye(len(free))]
    return flat[0], (np.array([*flat[1:], *more]) - flat[0]).T / step


def gap(bench: Bench, table: np.ndarray, free: Sequence[Hidden] = (), rounds: int = 20) -> float:
    """Smallest weighted sum of squares, priors included, of a refit to a noise-free table [3, N].

    Refitted are the soil and the strengths of the effects in `free`. Infinite where the table is not finite.
    """
    target = bench.weighted(table)
    if not np.all(np.isfinite(target)):
        return np.inf
    penalty = np.eye(5 + len(free))[:5]
    memo: dict[bytes, tuple] = {}

    def both(x):
        key = x.tobytes()
        if key not in memo:
            memo.clear()
            memo[key] = _prediction(bench, (), free, x)
        return memo[key]

    def residual(x):
        r = np.concatenate([both(x)[0] - target, penalty @ x])
        return np.where(np.isfinite(r), r, 1e3)

    def jacobian(x):
        j = np.concatenate([both(x)[1], penalty])
        return np.where(np.isfinite(j), j, 0.0)

    start = np.zeros(5 + len(free))
    fit = least_squares(residual, start, jacobian, ftol=1e-3, xtol=1e-4, max_nfev=rounds)
    return float(2.0 * fit.cost)


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


def imitation_gap(bench: Bench, effects: Sequence[Hidden], rng: np.random.Generator) -> dict:
    """What is left of hidden effects when other listed ones are fitted: linearised gaps, with the names that do best.

    The soil and one listed form, then two, are fitted to the noise-free table, linearised at the true soil without
    effects. {"none": gap, "one": (gap, names), "two": (gap, names), "each": {name: gap}}; the effects themselves are
    left out.
    """
    own = {e.form.effect for e in effects}
    grade = next((e.strength for e in effects if e.form.scales_grade), bench.grade)
    bench = replace(bench, grade=grade)
    target = bench.weighted(bench.truth(effects))
    flat, jac = _prediction(bench, (), (), np.zeros(5))
    q, _ = np.linalg.qr(np.concatenate([jac, np.eye(5)]))

    def left(vector):
        vector = np.concatenate([vector - flat, np.zeros(5)])
        return vector - q @ (q.T @ vector)

    residual = left(target)
    columns, names = [], []
    for form in FORMS:
        if form.effect in own:
            continue
        small = grade if form.scales_grade else max(0.02 * form.cap(bench.context), form.floor)
        moved = bench.weighted(bench.truth([Hidden(form, small, form.side(rng, bench.context))]))
        if np.all(np.isfinite(moved)) and np.linalg.norm(column := left(moved)) > 1e-6:
            columns.append(column / np.linalg.norm(column))
            names.append(form.effect)
    none = float(residual @ residual)
    each: dict[str, float] = {}
    for c, n in zip(columns, names, strict=True):
        each[n] = min(each.get(n, np.inf), none - float(c @ residual) ** 2)
    one = min((value, (n,)) for n, value in each.items())
    two = min(
        (none - _explained(np.stack([a, b], 1), residual), (names[j], names[i]))
        for i, a in enumerate(columns)
        for j, b in enumerate(columns[:i])
        if names[i] != names[j]
    )
    return {"none": none, "one": one, "two": two, "each": each}


def _explained(columns: np.ndarray, residual: np.ndarray) -> float:
    q, _ = np.linalg.qr(columns)
    return float(np.sum((q.T @ residual) ** 2))
