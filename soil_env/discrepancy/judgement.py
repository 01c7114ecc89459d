"""Statistics of a finding: intervals, the gap on held-out data, probabilities of the candidates, bootstrap of the name.

All are linearised about the fits of the search and need no further ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from soil_env.discrepancy.calibrate import Fit, Problem, Unknown
from soil_env.discrepancy.data import CHANNELS, folds
from soil_env.discrepancy.misfit import log_bound, probability
from soil_env.discrepancy.search import (
    CHANCE,
    LOOKS,
    RULED_OUT,
    Candidate,
    Finding,
    acceptable,
    groups,
    possible,
    predictive,
    strengths,
)

REFUSED = 1e-4  # p value of the lack of fit that a model which the search refuses has at most
LISTED = 20.0  # prior odds that what is missing is in the catalogue
LEAST = 1e-12  # probability that is reported as 0
_SURE = 1.959964  # [sd] of a 95 % interval
_CLOSED_DRAWS = 2000  # of the groups, for the interval of `closed`
_LEAST_GAP = 0.5  # share of those draws with a gap to close below which no interval is told


class Interval(NamedTuple):
    """A fitted value with its 95 % interval; low = high = value where it was given."""

    value: float
    low: float
    high: float


class Gap(NamedTuple):
    """Root mean square of measured - predicted on held-out data [unit of the channel]."""

    before: float
    after: float
    noise_floor: float


class Rank(NamedTuple):
    """One effect among the candidates."""

    name: str
    score: float
    probability: float


@dataclass(frozen=True)
class Bootstrap:
    """Shares of bootstrap draws: of the named effects being found again, and of what was found instead."""

    share: float
    draws: int
    instead: dict[tuple[str, ...], float]


# --- intervals --------------------------------------------------------------------------------------------------------


def intervals(fit: Fit, centre: dict[str, float]) -> dict[str, Interval]:
    """95 % intervals of every unknown about the values in `centre`: Laplace, inv(I + J'J) of the whitened unknowns.

    In the logarithm where the unknown is fitted in it; never beyond the bounds.
    """
    sd = np.sqrt(np.diag(fit.covariance()))
    return {k.name: _interval(k, k.at(centre[k.name]), float(s)) for k, s in zip(fit.unknowns, sd, strict=False)}


def _interval(unknown: Unknown, u: float, sd: float) -> Interval:
    low = max(u - _SURE * sd, (unknown.low - unknown.mean) / unknown.sd)
    high = min(u + _SURE * sd, (unknown.high - unknown.mean) / unknown.sd)
    return Interval(*(float(unknown.value(x)) for x in (u, min(low, u), max(high, u))))


# --- the gap ----------------------------------------------------------------------------------------------------------


def gaps(problem: Problem, before: np.ndarray, after: np.ndarray) -> dict[str, Gap]:
    """`Gap` by measured channel of two held-out predictions [N, 3], over the values in use."""
    out = {}
    for j, name in enumerate(CHANNELS):
        used = problem.used[:, j]
        if used.any():
            y = problem.data.y[used, j]
            rms = (float(np.sqrt(np.mean((y - p[used, j]) ** 2))) for p in (before, after))
            out[name] = Gap(*rms, float(problem.noise[j]))
    return out


def closed(problem: Problem, gap: dict[str, Gap]) -> float | None:
    """Share of the held-out mean square above the noise that is gone, over all values; None where there was none."""
    count = {name: int(problem.used[:, CHANNELS.index(name)].sum()) for name in gap}
    before, after = (
        sum(n * max((getattr(gap[name], which) / gap[name].noise_floor) ** 2 - 1.0, 0.0) for name, n in count.items())
        for which in ("before", "after")
    )
    return None if before <= 0.0 else 1.0 - after / before


def closed_interval(
    problem: Problem, before: np.ndarray, after: np.ndarray, rng: np.random.Generator
) -> tuple[float, float] | None:
    """95 % interval of `closed`, from held-out predictions [N, 3]; None where hardly any draw has a gap.

    Values of one slip share the error of that slip, and values of one combination of the other conditions share
    another: both are drawn with replacement, and a row counts as often as its slip times as often as its combination
    (pigeonhole bootstrap, Owen 2007, Ann. Appl. Stat. 1:386-411; conservative). The models are not refitted, since
    each value was predicted without its own group.
    """
    weight = np.ones((_CLOSED_DRAWS, problem.data.rows.slip.size))
    for way in folds(problem.data):
        group = np.argmax(np.stack(way), axis=0)
        weight *= rng.multinomial(len(way), np.full(len(way), 1.0 / len(way)), size=_CLOSED_DRAWS)[:, group]
    total = []
    for held in (before, after):
        square = np.where(problem.used, ((problem.data.y - held) / problem.noise) ** 2, 0.0)
        count = weight @ problem.used  # [draws, 3]
        mean = (weight @ square) / np.maximum(count, 1.0)
        total.append(np.sum(count * np.maximum(mean - 1.0, 0.0), axis=1))
    gap = total[0] > 0.0
    if np.mean(gap) < _LEAST_GAP:
        return None
    share = 1.0 - total[1][gap] / total[0][gap]
    low, high = np.quantile(share, (0.025, 0.975))
    return float(low), float(high)


# --- names ------------------------------------------------------------------------------------------------------------


def ranking(problem: Problem, finding: Finding) -> tuple[tuple[Rank, ...], dict[str, float]]:
    """(all candidates, the named ones first; probability of "none" and of "unlisted").

    Nothing missing has the prior 1/2 and the listed effects share the rest, so each has the prior odds LISTED/(1 +
    LISTED)/count against nothing, times the mean of its gain of held-out likelihood and of evidence (a second effect
    costs `RULED_OUT` nats), and at most the odds that the chance of its gain allows: B(chance)/B(`CHANCE`) with the
    bound B(p) = 1/(-e p ln p) for p < 1/e, else 1 (Sellke, Bayarri & Berger 2001, Am. Stat. 55:62-71), so that the
    search and the odds turn to an effect at the same chance. Something unlisted has 1/`LISTED` of the odds of each
    model times B(p value of its lack of fit); a model with a significant gain that the search refuses, for an
    implausible soil or, where it names nothing, for its lack of fit, has a p value of `REFUSED` at most. Where the
    search finds nothing, no effect has more than even odds, pairs do not count, and only what the base model lacks
    speaks for something unlisted.

    The probability of a name is that of all models with it. Its score is the gain of held-out log-likelihood by it
    alone, or by the best pair with it where two effects are named.
    """
    base = finding.base
    none = finding.verdict == "none"
    models = [base, *finding.singles, *(() if none else finding.pairs)]
    log_odds = np.array([_log_odds(problem, base, c, len(finding.singles)) for c in models])
    if none:
        log_odds = np.minimum(log_odds, 0.0)
    weight = np.exp(log_odds - log_odds.max())
    enough = possible if finding.named else acceptable
    fits = np.array([_listed(problem, base, c, enough(problem, base, c)) for c in models])
    lacking = weight * (1.0 - fits)
    if none:
        fits, lacking[1:] = np.minimum(fits, fits[0]), 0.0
    share = weight * fits
    total = share.sum() + lacking.sum()
    share = share / total
    other = {"none": _reported(share[0]), "unlisted": _reported(lacking.sum() / total)}
    named = [n.name for n in finding.named]
    out = []
    for c in finding.singles:
        name = c.names[0]
        score = max([p.score for p in finding.pairs if name in p.names] + [c.score]) if len(named) == 2 else c.score
        out.append(
            Rank(name, float(score), _reported(sum(s for s, m in zip(share, models, strict=True) if name in m.names)))
        )
    out.sort(key=lambda r: (named.index(r.name) if r.name in named else len(named), -r.probability, -r.score))
    return tuple(out), other


def _reported(p: float) -> float:
    return 0.0 if p < LEAST else min(float(p), 1.0)


def chance_of(problem: Problem, base: Candidate, c: Candidate) -> float:
    """Chance that noise alone would let any of the candidates gain as much as this one does."""
    p = probability(base.fit.objective - c.fit.objective, strengths(c.fit.choices), problem.freedom)
    return 1.0 if p >= 1.0 else -math.expm1(LOOKS * math.log1p(-p))


def _log_odds(problem: Problem, base: Candidate, c: Candidate, count: int) -> float:
    """Logarithm of the odds of a model against the base model."""
    if not c.names:
        return 0.0
    gain = 0.5 * (c.score + c.fit.evidence - base.fit.evidence) - RULED_OUT * (len(c.names) - 1)
    chance = chance_of(problem, base, c)
    most = log_bound(chance) - log_bound(CHANCE) if chance > CHANCE else math.inf
    return min(gain + math.log(LISTED / (1.0 + LISTED) / count), most)


def _listed(problem: Problem, base: Candidate, c: Candidate, enough: bool) -> float:
    """Probability that a model lacks nothing; `enough`: whether the search would have it."""
    p = c.misfit
    if c.names and chance_of(problem, base, c) <= CHANCE and not enough:
        p = min(p, REFUSED)
    return 1.0 / (1.0 + math.exp(log_bound(p)) / LISTED)


def bootstrap(
    problem: Problem, finding: Finding, draws: int, rng: np.random.Generator, say: Callable[[str], None]
) -> Bootstrap | None:
    """How often the same names would be found, were they true: a parametric bootstrap; None where nothing is named.

    Noise is drawn about the named model; every rival with as many effects is refitted to first order and judged as in
    the search: within `RULED_OUT` of the best held-out likelihood, then by likelihood and evidence together.
    """
    if not finding.named or draws < 1:
        return None
    rivals = [c for c in (*finding.singles, *finding.pairs) if len(c.names) == len(finding.best.names)]
    own = next((k for k, c in enumerate(rivals) if set(c.names) == set(finding.best.names)), None)
    if own is None:
        rivals, own = [finding.best, *rivals], 0
    truth = problem.whiten(finding.best.fit.slackened)
    noise = rng.standard_normal((truth.size, draws))
    score, total = np.empty((len(rivals), draws)), np.empty((len(rivals), draws))
    for k, c in enumerate(rivals):
        say(f"how sure the name is: {k + 1} of {len(rivals)} candidates refitted to {draws} draws of the noise")
        off = truth - problem.whiten(c.fit.slackened)
        score[k], evidence = _refitted(problem, c.fit, off[:, None] + noise)
        total[k] = score[k] + evidence
    near = score > score.max(axis=0) - RULED_OUT
    winner = np.argmax(np.where(near, total, -math.inf), axis=0)
    share = np.bincount(winner, minlength=len(rivals)) / draws
    order = sorted((k for k in range(len(rivals)) if k != own and share[k] > 0.0), key=lambda k: -share[k])
    return Bootstrap(float(share[own]), draws, {rivals[k].names: float(share[k]) for k in order})


def _refitted(problem: Problem, fit: Fit, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(held-out log-likelihood, log evidence) [B] of a model refitted to first order to whitened residuals e [M, B]."""
    x = np.concatenate([fit.u, fit.slack])
    a, _ = fit.linearised()
    j, normal = a[: e.shape[0]], a.T @ a
    whole = np.concatenate([e, np.repeat(-x[:, None], e.shape[1], axis=1)])
    left = whole - a @ np.linalg.solve(normal, a.T @ whole)
    evidence = fit.evidence + 0.5 * fit.objective - 0.5 * np.sum(left**2, axis=0)
    member, ways = groups(problem)
    return predictive(member, j, normal, left[: e.shape[0]]) / ways, evidence
