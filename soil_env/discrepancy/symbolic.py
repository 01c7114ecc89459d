"""Symbolic regression of a misfit that no listed effect explains, in dimensionless groups.

The law is a sum of at most `TERMS` products of powers of the groups of `residual.py`, in any
channel. Terms are chosen one after the other, each fitted jointly with the fit's own parameters (to
first order, so that the soil may move): a term must lower the objective by more than its price,
that of a parameter under BIC and of the choice among all laws as simple; of those that do, the one
is taken that gains most by the mean of that and of the likelihood of held-out conditions. Then law
and soil are refitted in turn. The form errors of the fit stay in the covariance, so that a law is
sought only for what is more than that.

What the law does to held-out values is found by choosing it anew without each group
(`held_out_predictions`).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np

from soil_env.discrepancy.calibrate import Fit, Problem
from soil_env.discrepancy.judgement import SURE, groups
from soil_env.identification.table.data import CHANNELS, folds
from soil_env.terramechanics.model import add_residual, table_groups
from soil_env.terramechanics.residual import (
    GROUPS,
    ResidualTerm,
    residual_law,
)

TERMS = 3  # of a law at most
POWERS = (1.0, 2.0, 0.5, -1.0, -0.5, 3.0)  # of a group in a product
POWERS_OF_THREE = (1.0, 2.0, 0.5)  # where three groups are multiplied
LEAST_SPREAD = 0.05  # relative spread of a group below which it does not vary
WIDTH = 0.5  # prior sd of a term's rms over that of the channel
_SWAPS = 3  # rounds in which each term may be exchanged
FURTHER_GROUP = 4.0  # added to the price of a term for each group after the first
ODD_POWER = 0.5  # added for each power other than 1
_ROUNDS = 5  # of law and soil in turn
HELD_OUT = 4  # groups of a way, at most, without which a law is chosen anew
_HELD_OUT = 24  # terms whose held-out likelihood is looked at
_CLOSE = 0.02  # [noise sd] largest change of the law at which the turns end


class Coefficient(NamedTuple):
    """A coefficient of the law with its 95 % interval, the soil refitted with it."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class ResidualFit:
    """A fit with a residual law; no terms where none is worth its price."""

    terms: tuple[ResidualTerm, ...]
    fit: Fit  # soil and effects refitted with the law in the model
    offset: np.ndarray  # [N, 3] what the law adds, as `Problem.offset` takes it
    gain: float  # fall of the objective beyond the price of the terms
    column: np.ndarray  # [M, T] whitened effect of one prior sd of each coefficient
    width: np.ndarray  # [T] that prior sd

    def without(self, fit: Fit) -> ResidualFit:
        """No law: the fit alone."""
        return ResidualFit(
            (), fit, np.zeros_like(self.offset), 0.0, self.column[:, :0], self.width[:0]
        )

    def covariance(self) -> np.ndarray:
        """[T, T] of the coefficients (Laplace; soil and form errors move with them)."""
        a, _ = with_terms(*self.fit.linearised(), self.column)
        count = len(self.terms)
        return np.linalg.inv(a.T @ a)[a.shape[1] - count :, a.shape[1] - count :] * np.outer(
            self.width, self.width
        )

    def coefficients(self) -> list[Coefficient]:
        """The coefficients of the terms, in their order."""
        sd = np.sqrt(np.diag(self.covariance())) if self.terms else ()
        return [
            Coefficient(
                t.coefficient, *sorted((t.coefficient - SURE * s, t.coefficient + SURE * s))
            )
            for t, s in zip(self.terms, sd, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class Library:
    """Products of powers [C, 7] of the groups in the channels [C]."""

    channel: np.ndarray  # [C]
    powers: np.ndarray  # [C, 7]
    column: np.ndarray  # [M, C] whitened effect of one prior sd of the coefficient
    width: np.ndarray  # [C] that prior sd
    price: np.ndarray  # [C] of choosing it

    def pick(self, keep: Any) -> Library:
        """The library with the selected products only."""
        return Library(
            self.channel[keep],
            self.powers[keep],
            self.column[:, keep],
            self.width[keep],
            self.price[keep],
        )


def symbolic(problem: Problem, fit: Fit, turns: int = 2) -> ResidualFit:
    """The simplest law for what `fit` leaves; choice of law and refit of the soil alternate `turns`
    times at most.
    """
    best = ResidualFit(
        (), fit, np.zeros_like(problem.data.y), 0.0, np.zeros((fit.residual.size, 0)), np.zeros(0)
    )
    at = fit
    offset = best.offset
    for _ in range(turns):  # the second choice starts where the first has moved the soil
        chosen = choose(problem, at, offset, library(problem, at, offset))
        if not chosen.channel.size or np.array_equal(
            chosen.powers, residual_law(best.terms).powers
        ):
            break
        now = refit(problem, fit, at, offset, chosen)
        if now.gain <= best.gain:
            break
        best = now
        at = now.fit
        offset = now.offset
    return best


def held_out_predictions(problem: Problem, fit: Fit, say: Callable[[str], None]) -> np.ndarray:
    """[N, 3] predictions of each value by a law that is chosen and fitted without its group; NaN
    where not in use.

    Soil, effects, terms and coefficients all come from the other groups, of which at most
    `HELD_OUT` are made of the groups of a way. Mean over the ways to cut the table.
    """
    total = np.zeros_like(problem.data.y)
    ways = [_bundled(way) for way in folds(problem.data)]
    for k, way in enumerate(ways):
        for n, group in enumerate(way):
            say(f"a law without group {n + 1} of {len(way)}, way {k + 1} of {len(ways)}")
            rest = problem.without(group)
            start = rest.fit(
                fit.choices, fit.parameters(), fit.sizes, rest.restricted(fit, problem.used)
            )
            total[group] += symbolic(rest, start, turns=1).fit.output[group] / len(ways)
    return np.where(problem.used, total, math.nan)


def _bundled(way: list[np.ndarray]) -> list[np.ndarray]:
    """At most `HELD_OUT` groups, of every so many of the given ones together."""
    count = min(HELD_OUT, len(way))
    return [np.any(way[k::count], axis=0) for k in range(count)]


def groups_of(problem: Problem, fit: Fit, offset: np.ndarray) -> np.ndarray:
    """[N, 7] values of `GROUPS`; the sinkage is that of the model without the law, whose values are
    `offset`.
    """
    rows = problem.data.rows
    soil = problem.state(fit.parameters())
    sinkage = fit.output[:, 0] - offset[:, 0]
    return table_groups(rows, sinkage, soil, problem.data.setup.gravity)


def products(groups: np.ndarray) -> np.ndarray:
    """[C, 7] powers of all products of up to three groups that vary and have the powers."""
    spread = np.ptp(groups, axis=0) > LEAST_SPREAD * np.max(np.abs(groups), axis=0)
    low = groups.min(axis=0)
    out = [np.zeros(len(GROUPS))]
    for count in (1, 2, 3):
        allowed = POWERS if count < 3 else POWERS_OF_THREE
        for chosen in combinations(np.flatnonzero(spread), count):
            for powers in product(allowed, repeat=count):
                if all(
                    (p > 0.0 or low[g] > 0.0) and (p % 1.0 == 0.0 or low[g] >= 0.0)
                    for g, p in zip(chosen, powers, strict=True)
                ):
                    out.append(np.zeros(len(GROUPS)))
                    out[-1][list(chosen)] = powers
    return np.array(out)


def library(problem: Problem, fit: Fit, offset: np.ndarray) -> Library:
    """Every product in every measured channel, with its price."""
    groups = groups_of(problem, fit, offset)
    powers = products(groups)
    count = np.sum(powers != 0.0, axis=1)
    measured = [j for j in range(3) if problem.used[:, j].any()]
    # as simple: no more groups, in any channel
    price = 2.0 * np.log(len(measured) * np.array([np.sum(count <= k) for k in count]))
    price += FURTHER_GROUP * np.maximum(count - 1, 0) + ODD_POWER * np.sum(
        (powers != 0.0) & (powers != 1.0), axis=1
    )
    return at_groups(
        problem,
        groups,
        np.repeat(measured, count.size),
        np.tile(powers, (len(measured), 1)),
        np.tile(price, len(measured)),
    )


def at_groups(
    problem: Problem, groups: np.ndarray, channel: np.ndarray, powers: np.ndarray, price: Any
) -> Library:
    """The products of the given powers at `groups` [N, 7]."""
    rows = problem.data.rows
    value = np.ones((groups.shape[0], powers.shape[0]))
    for g in range(len(GROUPS)):
        x = groups[:, g]
        for p in np.unique(powers[:, g]):
            if p != 0.0:
                x_p = np.where(
                    x > 0.0,
                    np.abs(np.where(x > 0.0, x, 1.0)) ** p,
                    x**p if p in (1.0, 2.0, 3.0) else 0.0,
                )
                value[:, powers[:, g] == p] *= x_p[:, None]
    radius = rows.wheels[:, 0]
    sd = problem.noise * problem.data.relative_sd
    scale = np.stack([radius, rows.load, rows.load * radius], axis=1) / sd
    row, of = np.nonzero(problem.used)
    column = np.where(of[:, None] == channel, value[row] * scale[row, of][:, None], 0.0)
    size = [np.linalg.norm((problem.data.y / sd)[problem.used[:, j], j]) for j in range(3)]
    width = WIDTH * np.array(size)[channel] / np.maximum(np.linalg.norm(column, axis=0), 1e-300)
    return Library(channel, powers, column * width, width, price)


def choose(problem: Problem, fit: Fit, offset: np.ndarray, found: Library) -> Library:
    """The terms worth their price, added one after the other; after each, all are reconsidered
    beside the others.
    """
    picked: list[int] = []
    for _ in range(TERMS):
        k = _next(problem, fit, offset, found, picked)
        if k is None:
            break
        picked.append(k)
        for _ in range(_SWAPS if len(picked) > 1 else 0):
            before = list(picked)
            for old in before:
                rest = [x for x in picked if x != old]
                new = _next(problem, fit, offset, found, rest)
                picked = rest if new is None else [new if x == old else x for x in picked]
            if picked == before:
                break
    return found.pick(sorted(picked, key=lambda k: found.channel[k]))


def _next(
    problem: Problem, fit: Fit, offset: np.ndarray, found: Library, picked: list[int]
) -> int | None:
    """The best further term, None where none is worth its price."""
    plain = without_offset(problem, fit, offset)
    a, e = with_terms(*plain, found.column[:, picked])
    q = np.linalg.qr(a)[0]
    m = found.column.shape[0]
    whole = np.einsum("mc,mc->c", found.column, found.column)
    # Of what the parameters do not absorb.
    length = whole - np.sum((q[:m].T @ found.column) ** 2, axis=0)
    along = found.column.T @ (e - q @ (q.T @ e))[:m]
    fall = along**2 / (length + 1.0)
    worth = _likelihood(problem, fall) - math.log(m) - found.price
    worth[picked] = -math.inf
    worth[length < 1e-6 * whole] = -math.inf
    best = np.argsort(-worth)[:_HELD_OUT]
    best = best[worth[best] > 0.0]
    if not best.size:
        return None
    member, ways = groups(problem)
    base = held_out(member, a, e)
    gain = [
        2.0 / ways * (held_out(member, *with_terms(*plain, found.column[:, [*picked, k]])) - base)
        - found.price[k]
        for k in best
    ]
    # Held-out values alone do not mind an implausible soil.
    gain = 0.5 * (np.array(gain) + worth[best])
    k = int(np.argmax(gain))
    return int(best[k]) if gain[k] > 0.0 else None


def _likelihood(problem: Problem, fall: np.ndarray) -> np.ndarray:
    """Fall of the objective as a log-likelihood ratio, the noise being known to some degrees of
    freedom only.
    """
    f = problem.freedom
    return fall if math.isinf(f) else f * np.log1p(fall / f)


def without_offset(problem: Problem, fit: Fit, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(A, e) of the linearised fit without its offset."""
    a, e = fit.linearised()
    return a, e + np.concatenate([problem.whiten(offset), np.zeros(e.size - fit.residual.size)])


def with_terms(a: np.ndarray, e: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(A, e) with terms [M, T] added as unknowns with a unit prior."""
    extra = column.shape[1]
    side = np.concatenate([column, np.zeros((a.shape[0] - column.shape[0], extra)), np.eye(extra)])
    return np.concatenate(
        [np.concatenate([a, np.zeros((extra, a.shape[1]))]), side], axis=1
    ), np.concatenate([e, np.zeros(extra)])


def held_out(member: np.ndarray, a: np.ndarray, e: np.ndarray) -> float:
    """Log-likelihood of groups of values, `member` [F, M], each predicted from the others by the
    linear model A x = e.

    With the residuals r [M] of the fit to all, J the rows of A that are held out and N = A'A: the
    predictive covariance of what is held out is S = (I - J N^-1 J')^-1 = I + J (N - J'J)^-1 J', and
    its error S r.
    """
    normal = a.T @ a
    m = member.shape[1]
    top = a[:m]
    r = (e - a @ np.linalg.solve(normal, a.T @ e))[:m]
    whole = np.linalg.slogdet(normal)[1]
    total = 0.0
    for out in member:
        j = top[out]
        held = r[out]
        rest = normal - j.T @ j
        pull = j.T @ held
        total -= 0.5 * (held @ held + pull @ np.linalg.solve(rest, pull))
        total -= 0.5 * (whole - np.linalg.slogdet(rest)[1])
    return total


def refit(problem: Problem, base: Fit, at: Fit, offset: np.ndarray, chosen: Library) -> ResidualFit:
    """Law and soil fitted in turn, starting from the fit `at` with its `offset`."""
    shifted = copy.copy(problem)
    for _ in range(_ROUNDS):
        here = at_groups(
            problem, groups_of(problem, at, offset), chosen.channel, chosen.powers, chosen.price
        )
        a, e = with_terms(*without_offset(problem, at, offset), here.column)
        solved = np.linalg.lstsq(a, e, rcond=None)[0][a.shape[1] - chosen.price.size :]
        terms = _terms(problem, at, offset, here, solved * here.width)
        shifted.offset = law_offset(problem, at, offset, terms)
        moved = problem.whiten(shifted.offset - offset)
        at = shifted.fit(base.choices, at.parameters(), base.sizes, at)
        offset = shifted.offset
        if np.max(np.abs(moved)) < _CLOSE:
            break
    price = float(np.sum(chosen.price)) + math.log(at.residual.size) * len(terms)
    left = [
        _left(*base.linearised()),
        _left(*with_terms(*without_offset(problem, at, offset), here.column)),
    ]
    gain = float(_likelihood(problem, np.array(left[0] - left[1]))) - price
    return ResidualFit(terms, at, offset, gain, here.column, here.width)


def _left(a: np.ndarray, e: np.ndarray) -> float:
    """Least |e - A x|^2."""
    return float(np.sum((e - a @ np.linalg.lstsq(a, e, rcond=None)[0]) ** 2))


def _terms(
    problem: Problem, fit: Fit, offset: np.ndarray, here: Library, coefficient: np.ndarray
) -> tuple[ResidualTerm, ...]:
    groups = groups_of(problem, fit, offset)[problem.used.any(axis=1)]
    out = []
    for j, powers, c in zip(here.channel, here.powers, coefficient, strict=True):
        used = np.flatnonzero(powers)
        ranges = {GROUPS[g]: (float(groups[:, g].min()), float(groups[:, g].max())) for g in used}
        out.append(
            ResidualTerm(CHANNELS[j], float(c), {GROUPS[g]: float(powers[g]) for g in used}, ranges)
        )
    return tuple(out)


def law_offset(
    problem: Problem, fit: Fit, offset: np.ndarray, terms: tuple[ResidualTerm, ...]
) -> np.ndarray:
    """[N, 3] what the terms add to the model of `fit`, which has `offset` in it."""
    rows = problem.data.rows
    plain = fit.output - offset
    out = plain.copy()
    gravity = problem.data.setup.gravity
    add_residual(residual_law(terms), rows, problem.state(fit.parameters()), gravity, out)
    added: np.ndarray = out - plain
    return added
