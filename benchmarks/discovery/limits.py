"""Size of an effect in units of its detection limit, with the errors of the base law in the covariance.

The change of a table by an effect, d, is judged against V = noise^2 + (law error)^2 C + J P J' + D D'. C is the
covariance of the table by law errors (`laws.covariance`), J the tangent space of the soil, P the covariance of its
priors. D is the change by a base law of another form, a direction of which nothing is known. d' V^-1 d is the
noncentrality of the likelihood ratio of a method that knows the form of the effect and the size of all of these. The
*size* is its root over that of the noncentrality at which a test at the 1 % level has a power of 95 %
(`noncentrality`): 1 is the detection limit. Sizes grow with the strength, in proportion where the effect is
small. What an effect adds is computed without the law errors, whose change by the effect is of second order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from benchmarks.discovery.forms import Hidden
from benchmarks.discovery.laws import covariance
from benchmarks.discovery.listed import LISTED
from benchmarks.discovery.plan import SOIL, Bench
from benchmarks.discovery.world import Wheel, predict, with_soil

LEVEL, POWER = 0.01, 0.95
FREE = 10.0  # standard deviation of the strength of another effect that is refitted, over its strength


@cache
def noncentrality(freedom: int) -> float:
    """Noncentrality at which a chi-square test of `freedom` degrees at `LEVEL` has the power `POWER`."""
    threshold = chi2.isf(LEVEL, freedom)
    return float(brentq(lambda nc: ncx2.sf(threshold, freedom, nc) - POWER, 1e-3, 500.0))


def soil_tangent(bench: Bench) -> np.ndarray:
    """Change of the paper's table [3N, 5] by each soil parameter, for one sd of its prior."""
    true = np.array([getattr(bench.ground, name) for name in SOIL])
    step = 0.05 * np.array([bench.prior_sd[name] for name in SOIL])
    soils = np.concatenate([true + np.diag(step), true - np.diag(step)])
    count = len(bench.rows)
    wheel = Wheel(*(np.tile(np.broadcast_to(x, count), 10) for x in (bench.wheel.radius, bench.wheel.width)))
    out = predict(with_soil(bench.ground, soils, count), wheel, bench.conditions().tiled(10)).stack()
    out = out.reshape(3, 2, 5, count)
    return ((out[:, 0] - out[:, 1]) / 0.1).transpose(0, 2, 1).reshape(3 * count, 5)


class Measure:
    """Sizes of contributions to one table, in units of the detection limit.

    Raises `ValueError` where the base world finds no balance.
    """

    def __init__(self, bench: Bench):
        self.whole = bench
        self.bench = replace(bench, error=None)
        self.kept = bench.measured.ravel()
        noise = np.repeat(np.array(bench.noise), len(bench.rows))
        total = np.diag(noise**2)
        tangent = soil_tangent(bench)
        total += tangent @ tangent.T
        size = bench.error.size if bench.error is not None else 0.0
        if size > 0.0:
            contact = bench.contact(exact=True)
            entry = np.arccos(1.0 - bench.exact[:1].T / contact.radius)
            total += size**2 * covariance(contact, entry, bench.pressure, bench.load)
        if bench.law is not None:
            other = (self.bench.base - bench.exact).ravel()
            total += np.outer(other, other)
        total = total[np.ix_(self.kept, self.kept)]
        if not np.all(np.isfinite(total)):
            raise ValueError("no balance of the base world")
        self.factor = cholesky(total, lower=True)

    def white(self, change: np.ndarray) -> np.ndarray:
        """Change of the table [3, N] in units in which all errors are independent and 1."""
        return solve_triangular(self.factor, change.ravel()[self.kept], lower=True, check_finite=False)

    def contribution(self, effect: Hidden, others: Sequence[Hidden] = ()) -> np.ndarray:
        """Change of the table by an effect beside the others, whitened; NaN where the wheel finds no balance."""
        return self.white(
            self.bench.truth([*others, effect]) - (self.bench.truth(others) if others else self.bench.base)
        )

    def size(self, effect: Hidden, others: Sequence[Hidden] = ()) -> float:
        """Size of an effect, the strengths of `others` refitted; infinite where the wheel finds no balance."""
        vector, free = self.contribution(effect, others), [self.contribution(e) for e in others]
        if not all(np.all(np.isfinite(v)) for v in (vector, *free)):
            return np.inf
        return float(np.sqrt(max(without(vector, free) @ vector, 0.0) / noncentrality(effect.form.freedom)))

    def strength(
        self, effect: Hidden, wanted: float, others: Sequence[Hidden] = (), rounds: int = 8
    ) -> tuple[float, float]:
        """(strength of a wanted size, or the largest sensible one where that is less; its size)."""
        sign, cap = np.sign(effect.strength) or 1.0, effect.form.cap(self.bench.context)
        s, best = 0.15 * cap, (0.0, 0.0)
        low, high = 0.0, cap
        for _ in range(rounds):
            size = self.size(effect.at(sign * s), others)
            if np.isfinite(size):
                best = (s, size)
                if abs(np.log(max(size, 1e-9) / wanted)) < 0.03 or (size < wanted and s >= cap):
                    break
            low, high = (s, high) if size < wanted else (low, min(high, s))
            guess = s * wanted / max(size, 1e-3 * wanted)
            s = min(guess, cap) if low < min(guess, cap) < high or (guess >= cap == high) else 0.5 * (low + high)
        return sign * best[0], best[1]

    def left(self, vector: np.ndarray, free: Sequence[np.ndarray], freedom: int) -> dict[str, float]:
        """Size that the best listed form of each mechanism leaves of a contribution, the strengths fitted."""
        out = {}
        projected = without(vector, free)
        for name, strength_cap, signed, change in self.listed:
            beside = without(change, free)
            amount = np.clip(
                (beside @ vector) / max(beside @ change, 1e-12), -strength_cap if signed else 0.0, strength_cap
            )
            square = vector @ projected - 2.0 * amount * (beside @ vector) + amount**2 * (beside @ change)
            value = float(np.sqrt(max(square, 0.0) / noncentrality(freedom)))
            out[name] = min(out.get(name, np.inf), value)
        return out

    @cached_property
    def listed(self) -> list[tuple[str, float, bool, np.ndarray]]:
        """(mechanism, largest multiple, negative ones count too, whitened change) of each listed form."""
        rng, context, found = np.random.default_rng(0), self.bench.context, []
        for form in LISTED:
            cap = form.cap(context)
            some = self.bench.grade if form.scales_grade else max(0.3 * cap, form.floor)
            change = self.contribution(Hidden(form, some, form.side(rng, context)))
            if np.all(np.isfinite(change)) and some > 0.0:
                found.append((form.effect, cap / some, -1 in form.signs, change))
        return found


def without(vector: np.ndarray, free: Sequence[np.ndarray]) -> np.ndarray:
    """(1 + FREE^2 sum f f')^-1 vector: what is left of it where the amounts of `free` are unknown."""
    if not len(free):
        return vector
    f = FREE * np.stack(free, axis=1)
    return vector - f @ cho_solve(cho_factor(np.eye(f.shape[1]) + f.T @ f), f.T @ vector)
