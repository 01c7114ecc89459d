"""What a finding is worth: intervals, the gap on held-out data, how probable each name is and how sure the named one.

All of it is linearised about the fits that the search made, so it costs no further fits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from soil_env.discrepancy.calibrate import Fit, Problem, Unknown
from soil_env.discrepancy.data import CHANNELS, folds
from soil_env.discrepancy.search import TOLD, Candidate, Finding, acceptable, held_out

REFUSED = 1e-4  # p value of the lack of fit that a model which the search refuses has at most
LISTED = 20.0  # prior odds that what is missing is in the catalogue
_SURE = 1.959964  # [sd] of a 95 % interval


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
class Sureness:
    """Shares of bootstrap draws: of the named effects being found again, and of what was found instead."""

    share: float
    draws: int
    instead: dict[tuple[str, ...], float]


# --- intervals --------------------------------------------------------------------------------------------------------


def intervals(fit: Fit, centre: dict[str, float]) -> dict[str, Interval]:
    """95 % intervals of every unknown about the values in `centre`: Laplace, inv(I + J'J) of the whitened unknowns.

    In the logarithm where the unknown is fitted in it; never beyond the bounds.
    """
    covariance = np.linalg.inv(np.eye(fit.jacobian.shape[1]) + fit.jacobian.T @ fit.jacobian)
    sd = np.sqrt(np.diag(covariance))
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


def predictions(problem: Problem, fit: Fit) -> np.ndarray:
    """Held-out predictions [N, 3], NaN where no value is in use."""
    return np.where(problem.used, held_out(problem, fit)[1], math.nan)


# --- names ------------------------------------------------------------------------------------------------------------


def ranking(problem: Problem, finding: Finding) -> tuple[tuple[Rank, ...], dict[str, float]]:
    """(all candidates, the named ones first; probability of "none" and of "unlisted").

    A model's log odds against the base model are the mean of two estimates: the gain of held-out log-likelihood and
    the gain of log evidence; a second effect costs `TOLD` of them, as in the search. What a model leaves unexplained
    speaks for something unlisted: a lack of fit of p value p has the odds of at most -e p ln p for the model (Sellke,
    Bayarri & Berger 2001, Am. Stat. 55:62-71), times `LISTED`. A model that the search refuses, for an implausible
    soil say, has a p value of `REFUSED` at most.

    The probability of a name is that of all models with it. Its score is the gain of held-out log-likelihood by it
    alone, or by the best pair with it where two effects are named.
    """
    base = finding.base
    models = [base, *finding.singles, *finding.pairs]
    log_odds = np.array([_log_odds(base, c) for c in models])
    weight = np.exp(log_odds - log_odds.max())
    fits = np.array([_listed(problem, base, c) for c in models])
    weight /= weight.sum()
    share = weight * fits
    other = {"none": float(share[0]), "unlisted": float(np.sum(weight * (1.0 - fits)))}
    named = [n.name for n in finding.named]
    out = []
    for c in finding.singles:
        name = c.names[0]
        score = max([p.score for p in finding.pairs if name in p.names] + [c.score]) if len(named) == 2 else c.score
        probability = float(sum(s for s, m in zip(share, models, strict=True) if name in m.names))
        out.append(Rank(name, float(score), min(probability, 1.0)))
    out.sort(key=lambda r: (named.index(r.name) if r.name in named else len(named), -r.probability, -r.score))
    return tuple(out), other


def _log_odds(base: Candidate, c: Candidate) -> float:
    return 0.5 * (c.score + c.fit.evidence - base.fit.evidence) - TOLD * max(len(c.names) - 1, 0)


def _listed(problem: Problem, base: Candidate, c: Candidate) -> float:
    """Probability that a model lacks nothing."""
    p = max(c.misfit, 1e-300)
    if c.names and not acceptable(problem, base, c):
        p = min(p, REFUSED)
    odds = LISTED * (-math.e * p * math.log(p) if p < 1.0 / math.e else 1.0)
    return odds / (1.0 + odds)


def sureness(
    problem: Problem, finding: Finding, draws: int, rng: np.random.Generator, say: Callable[[str], None]
) -> Sureness | None:
    """How often the same names would be found, were they true: a parametric bootstrap; None where nothing is named.

    Noise is drawn about the named model; every rival with as many effects is refitted to first order and judged as in
    the search: within `TOLD` of the best held-out likelihood, then by likelihood and evidence together.
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
    near = score > score.max(axis=0) - TOLD
    winner = np.argmax(np.where(near, total, -math.inf), axis=0)
    share = np.bincount(winner, minlength=len(rivals)) / draws
    order = sorted((k for k in range(len(rivals)) if k != own and share[k] > 0.0), key=lambda k: -share[k])
    return Sureness(float(share[own]), draws, {rivals[k].names: float(share[k]) for k in order})


def _refitted(problem: Problem, fit: Fit, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(held-out log-likelihood, log evidence) [B] of a model refitted to first order to whitened residuals e [M, B]."""
    x = np.concatenate([fit.u, fit.slack])
    a, _ = fit.linearised()
    j, normal = a[: e.shape[0]], a.T @ a
    whole = np.concatenate([e, np.repeat(-x[:, None], e.shape[1], axis=1)])
    left = whole - a @ np.linalg.solve(normal, a.T @ whole)
    evidence = fit.evidence + 0.5 * fit.objective - 0.5 * np.sum(left**2, axis=0)
    rows = np.nonzero(problem.used)[0]
    ways, total, r = folds(problem.data), np.zeros(e.shape[1]), left[: e.shape[0]]
    all_rows = np.linalg.slogdet(normal)[1]
    for group in (g for way in ways for g in way):
        out = group[rows]
        if not out.any():
            continue
        jo, ro = j[out], r[out]
        rest = normal - jo.T @ jo
        off = ro + jo @ np.linalg.solve(rest, jo.T @ ro)
        total += -0.5 * np.sum(off * ro, axis=0) - 0.5 * (all_rows - np.linalg.slogdet(rest)[1])  # as in `held_out`
    return total / len(ways), evidence
