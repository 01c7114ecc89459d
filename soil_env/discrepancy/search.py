"""Search for the missing effects: every candidate is refitted jointly with the soil and judged on held-out conditions.

The steps, for the conclusion `Finding`:

1. The base model. If neither the test of what it leaves (`lack_of_fit`) nor any candidate shows more than chance would,
   after accounting for all that were tried, nothing is missing.
2. One effect. Each candidate is refitted in each of its forms. Those that leave no significant misfit, and gain nothing
   significant from a second effect, can be the answer; the one with the best held-out likelihood is named, and every
   other that these data cannot tell from it is its alternative.
3. Two effects, where no single one is enough; the same for pairs, all of them screened.
4. If no pair is enough: unlisted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from soil_env.discrepancy.calibrate import Choice, Fit, Problem
from soil_env.discrepancy.data import folds
from soil_env.discrepancy.misfit import lack_of_fit, log_bound, probability
from soil_env.terramechanics.catalogue import CATALOGUE

CHANCE = 0.004  # probability of a false alarm over everything that is tried
LEAST_FIT = (3e-3, 0.02)  # p value of the lack of fit below which one effect, two effects, are not enough: where
# -e p ln p (Sellke et al. 2001) meets prior odds of 20, of 5, that what is missing is in the catalogue
SECOND = 1e-4  # the same for a second effect beside one that is enough: B(p) of it against prior odds of 20 is again 20
RULED_OUT = 4.6  # [nats] of held-out likelihood by which a candidate must be behind to be ruled out
LOOKS = 20  # independent tests that the candidates amount to
IMPLAUSIBLE = 4.0  # [widened prior sd] of a soil that no candidate may need
LEADING = 10.0  # [nats] by which a pair must lead to be named with a fit down to LEAST_FIT of one effect, and by which
# what is named may not be behind a model that does not fit
_PAIRS = 8  # pairs refitted after the screen


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model with its judgement."""

    fit: Fit
    score: float  # held-out log-likelihood minus that of the base model
    misfit: float  # p value of the lack of fit

    @property
    def worth(self) -> float:
        """Held-out log-likelihood less what the lack of fit speaks against it at most."""
        return self.score - log_bound(self.misfit)

    @property
    def names(self) -> tuple[str, ...]:
        """Its effects."""
        return tuple(c.effect for c in self.fit.choices)


# --- judgement of one fit ---------------------------------------------------------------------------------------------


def groups(problem: Problem) -> tuple[np.ndarray, int]:
    """([F, M] which of the values in use each held-out group has, number of ways to cut the table into groups)."""
    ways, rows = folds(problem.data), np.nonzero(problem.used)[0]
    return np.stack([group[rows] for way in ways for group in way]), len(ways)


def predictive(member: np.ndarray, top: np.ndarray, normal: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Log-likelihood of groups of values, `member` [F, M], each predicted from the others, of a linear model.

    With the residuals r [M] or [M, B] of the fit to all, J the rows of the Jacobian `top` [M, p] that are held out and
    N = A'A of the whole problem: the predictive covariance of what is held out is
    S = (I - J N^-1 J')^-1 = I + J (N - J'J)^-1 J', and its error S r.
    """
    whole, total = np.linalg.slogdet(normal)[1], 0.0
    for out in member:
        j, held = top[out], r[out]
        rest, pull = normal - j.T @ j, j.T @ held
        quadratic = np.sum(held**2, axis=0) + np.sum(pull * np.linalg.solve(rest, pull), axis=0)
        total = total - 0.5 * quadratic - 0.5 * (whole - np.linalg.slogdet(rest)[1])
    return total


def held_out(problem: Problem, fit: Fit) -> float:
    """Log-likelihood of what is held out, group by group, averaged over the ways to cut the table.

    Refits are linearised about the fit of all rows, and exact as far as the model is linear there; the predictive
    covariance includes that of the parameters.
    """
    (a, _), (member, ways) = fit.linearised(), groups(problem)
    return float(predictive(member, a[: fit.residual.size], a.T @ a, fit.residual)) / ways


def held_out_predictions(problem: Problem, fit: Fit) -> np.ndarray:
    """Predictions [N, 3] of each value from the groups without it, the mean over the ways; NaN where not in use."""
    (a, _), (member, ways) = fit.linearised(), groups(problem)
    top, normal, r = a[: fit.residual.size], a.T @ a, fit.residual
    error = np.zeros(r.size)
    for out in member:
        j = top[out]
        error[out] += (r[out] + j @ np.linalg.solve(normal - j.T @ j, j.T @ r[out])) / ways
    predicted = np.full(problem.used.shape, math.nan)
    sd = np.broadcast_to(problem.noise * problem.data.relative_sd, predicted.shape)
    predicted[problem.used] = problem.data.y[problem.used] - error * sd[problem.used]
    return predicted


# --- the search -------------------------------------------------------------------------------------------------------


def candidates(problem: Problem) -> tuple[list[str], dict[str, str]]:
    """(names to try, reason by name of those that this table cannot show)."""
    names, reasons = [], {}
    data = problem.data
    words = {"pass": "every row is of the same pass", "speed": "no speed variation", "grade_deg": "no grade variation"}
    for effect in CATALOGUE.values():
        measured = [k for k in effect.moves if problem.used[:, ("sinkage", "drawbar_pull", "torque").index(k)].any()]
        if not measured:
            reasons[effect.name] = f"{' and '.join(effect.moves)} not measured"
        elif (
            effect.name == "grousers" and data.setup.wheel.grouser_height == 0.0 and not np.any(data.rows.wheels[:, 2])
        ):
            reasons[effect.name] = "the wheel has no grousers (grouser_height 0)"
        elif effect.varies is not None and effect.varies not in data.varied and effect.name != "shear_rate":
            reasons[effect.name] = words[effect.varies]
        elif effect.name == "shear_rate" and not np.all(data.rows.conditions[:, 0] > 0.0):
            reasons[effect.name] = "speed not given"
        else:
            names.append(effect.name)
    return names, reasons


def fit_effect(problem: Problem, name: str, others: tuple[Choice, ...] = (), slack: bool = True) -> Fit:
    """Best fit of an effect over its forms, with `others` already in the model."""
    return max(
        (problem.fit((*others, Choice(name, k)), slack=slack) for k in forms(problem, name)), key=lambda f: f.evidence
    )


def forms(problem: Problem, name: str) -> list[int]:
    """Forms of an effect that this table can be fitted with."""
    speed = bool(np.all(problem.data.rows.conditions[:, 0] > 0.0))
    return [k for k, f in enumerate(CATALOGUE[name].forms) if speed or f.name != "coulomb_and_viscous"]


def judge(problem: Problem, fit: Fit, base_score: float = 0.0) -> Candidate:
    """`Candidate` of a fit."""
    return Candidate(fit, held_out(problem, fit) - base_score, lack_of_fit(problem, fit))


def strengths(choices: Iterable[Choice]) -> int:
    """Number of unknowns of effects."""
    return sum(len(c.free) for c in choices)


def first_gain(problem: Problem, fit: Fit, name: str) -> tuple[float, float]:
    """(gain, p value) that a further effect promises to first order, the best of its forms."""
    a, e = fit.linearised()
    q, _ = np.linalg.qr(a)
    e = e - q @ (q.T @ e)
    values, best = fit.parameters(), (0.0, 1.0)
    base = problem.whiten(fit.output)
    guess = problem.sinkage_guess(fit)
    for k in forms(problem, name):
        choice = Choice(name, k)
        own = [u for u in problem.unknowns((choice,)) if u.name in choice.free]
        columns, one_sided = [], []
        for moved in own:
            if moved.log:
                continue
            trial = {u.name: u.value(0.0) for u in own} | {moved.name: moved.value(0.05)}
            there = problem.predict(values | trial, (*fit.choices, choice), guess.copy())
            columns.append((problem.whiten(there) - base) / 0.05)
            one_sided.append(moved.low >= moved.mean)
        c = np.concatenate([np.stack(columns, axis=1), np.zeros((e.size - base.size, len(columns)))])
        c = c - q @ (q.T @ c)
        gain = _gain(c, e, np.array(one_sided))
        p = probability(gain, len(columns), problem.freedom)
        if p < best[1]:
            best = (gain, p)
    return best


def _gain(c: np.ndarray, e: np.ndarray, one_sided: np.ndarray) -> float:
    """Fall of |e|^2 by strengths of the columns c with a unit prior; those that may not be negative stay at 0."""
    while c.shape[1]:
        solved = np.linalg.solve(c.T @ c + np.eye(c.shape[1]), c.T @ e)
        wrong = one_sided & (solved < 0.0)
        if not wrong.any():
            return float(e @ c @ solved)
        c, one_sided = c[:, ~wrong], one_sided[~wrong]
    return 0.0


# --- the conclusion ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Named:
    """One named effect."""

    name: str
    alternatives: tuple[str, ...]  # that these data cannot tell from it


@dataclass(frozen=True, eq=False)
class Finding:
    """What the search concludes."""

    verdict: str  # named, none, ambiguous, unlisted
    named: tuple[Named, ...]
    base: Candidate
    best: Candidate  # the model to go on with: the named effects, or the base model
    singles: tuple[Candidate, ...]  # best first
    pairs: tuple[Candidate, ...]
    untestable: dict[str, str]
    chance: float  # p value that all disagreement is noise


def search(problem: Problem, say: Callable[[str], None] = lambda text: None) -> Finding:
    """Find the missing effects; `say` is told what is being done."""
    say("base model")
    fit = problem.fit()
    base_score = held_out(problem, fit)
    base = Candidate(fit, 0.0, lack_of_fit(problem, fit))
    names, untestable = candidates(problem)
    singles = []
    for name in names:
        say(f"with {CATALOGUE[name].title}")
        singles.append(judge(problem, fit_effect(problem, name), base_score))
    singles.sort(key=lambda c: -c.score)
    chance = min(_family(_p_gain(problem, base, c)) for c in singles)
    chance = min(chance, base.misfit)

    def conclude(verdict, named, best, pairs=()):
        return Finding(verdict, tuple(named), base, best, tuple(singles), tuple(pairs), untestable, chance)

    def conclude_one(enough, pairs=()):
        first, near = undecided(enough, [c for c in singles if possible(problem, base, c)])
        named = Named(first.names[0], tuple(c.names[0] for c in near))
        return conclude("ambiguous" if near else "named", [named], first, pairs)

    def conclude_without(pairs=()):
        """No listed effect is enough: unlisted, or none where the base model itself has no lack of fit."""
        if base.misfit > CHANCE:
            return conclude("none", (), base, pairs)
        return conclude("unlisted", (), max((*pairs[:1], singles[0]), key=lambda c: c.score), pairs)

    if chance > CHANCE:
        return conclude("none", (), base)
    # one effect
    enough = not_behind([c for c in singles if acceptable(problem, base, c)], singles, problem, base)
    if enough:
        first = enough[0]
        say("looking for a second effect")
        if second(problem, first, names, base_score) is None:
            return conclude_one(enough)
    # two effects, where the table has more than twice as many values as such a model has unknowns
    if problem.used.sum() <= 2 * (len(problem.soil) + 4):
        return conclude_one(enough) if enough else conclude_without()
    pairs = two_effects(problem, singles, names, base_score, say)
    needed = [c for c in pairs if both_needed(problem, c, singles)]
    enough_pairs = not_behind([c for c in needed if acceptable(problem, base, c)], needed, problem, base)
    if enough and (not enough_pairs or enough_pairs[0].score < enough[0].score + RULED_OUT):
        return conclude_one(enough, pairs)
    if not enough_pairs and pairs:
        ahead = pairs[0].score - (pairs[1].score if len(pairs) > 1 else 0.0)
        leads = ahead > LEADING and acceptable(problem, base, pairs[0], LEAST_FIT[0])
        enough_pairs = pairs[:1] if leads and both_needed(problem, pairs[0], singles) else []
    if not enough_pairs:
        return conclude_without(pairs)
    first, near = undecided(enough_pairs, [c for c in needed if possible(problem, base, c)])
    named = [Named(name, _instead(name, first, near)) for name in first.names]
    return conclude("ambiguous" if near else "named", named, first, pairs)


def not_behind(enough: list[Candidate], others: list[Candidate], problem: Problem, base: Candidate) -> list[Candidate]:
    """`enough`, best first; nothing where another, which does not fit, is ahead of all by `LEADING`."""
    enough = sorted(enough, key=lambda c: -c.score)
    ahead = max((c.worth for c in others if possible(problem, base, c)), default=0.0)
    return enough if enough and max(c.worth for c in enough) > ahead - LEADING else []


def undecided(enough: list[Candidate], others: list[Candidate]) -> tuple[Candidate, list[Candidate]]:
    """(first, others) of the candidates that cannot be ruled out, the most probable first.

    The first is one that fits; another is ruled out by the held-out likelihood and its lack of fit together.
    """
    least = max(c.score for c in enough) - RULED_OUT
    first = max((c for c in enough if c.score > least), key=lambda c: c.score + c.fit.evidence)
    least = max(c.worth for c in enough) - RULED_OUT
    near = [c for c in others if c.worth > least and c is not first]
    return first, sorted(near, key=lambda c: -(c.worth + c.fit.evidence))


def _instead(name: str, best: Candidate, near: list[Candidate]) -> tuple[str, ...]:
    """Effects that stand in the place of `name` in pairs as good as the best."""
    other = next(n for n in best.names if n != name)
    out = []
    for c in near:
        rest = [n for n in c.names if n != other]
        if len(rest) == 1 and rest[0] != name:
            out.append(rest[0])
        elif name not in c.names and other not in c.names:
            out += rest
    return tuple(dict.fromkeys(out))


def _family(p: float) -> float:
    return 1.0 - (1.0 - p) ** LOOKS


def _p_gain(problem: Problem, base: Candidate, c: Candidate) -> float:
    gain = base.fit.objective - c.fit.objective
    return probability(gain, strengths(c.fit.choices), problem.freedom)


def possible(problem: Problem, base: Candidate, c: Candidate) -> bool:
    """Whether a model is significant, better on what is held out, and has a soil that can be."""
    priors = problem.data.setup.soil
    for unknown, x, without in zip(problem.soil, c.fit.u, base.fit.u, strict=False):
        if getattr(priors, unknown.name, None) and abs(x) > max(IMPLAUSIBLE, abs(without) + 1.0):
            return False
    return c.score > RULED_OUT and _family(_p_gain(problem, base, c)) < 5.0 * CHANCE


def acceptable(problem: Problem, base: Candidate, c: Candidate, least: float | None = None) -> bool:
    """Whether a model is enough: possible, and without lack of fit."""
    return possible(problem, base, c) and c.misfit > (LEAST_FIT[len(c.names) - 1] if least is None else least)


def second(problem: Problem, first: Candidate, names: list[str], base_score: float) -> Candidate | None:
    """The model with a second effect, where that is significant beyond the form error of the first."""
    gains = sorted(
        ((first_gain(problem, first.fit, n), n) for n in names if n not in first.names), key=lambda g: g[0][1]
    )
    best = None
    for (_, p), name in gains[:3]:
        if _family(p) > 0.05:
            continue
        fit = fit_effect(problem, name, first.fit.choices)
        p = probability(first.fit.objective - fit.objective, strengths(fit.choices[-1:]), problem.freedom)
        c = judge(problem, fit, base_score)
        if _family(p) < SECOND and c.score > first.score + RULED_OUT and (best is None or c.score > best.score):
            best = c
    return best


def both_needed(problem: Problem, pair: Candidate, singles: list[Candidate]) -> bool:
    """Whether each effect of a pair is significant beside the other."""
    for c in singles:
        if c.names[0] in pair.names:
            rest = [k for k in pair.fit.choices if k.effect != c.names[0]]
            p = probability(c.fit.objective - pair.fit.objective, strengths(rest), problem.freedom)
            if _family(p) > CHANCE or pair.score < c.score + 0.5 * RULED_OUT:
                return False
    return True


def two_effects(problem: Problem, singles, names, base_score, say) -> list[Candidate]:
    """Pairs, best first: all screened to first order from either side, the most promising refitted in their forms."""
    say("screening pairs")
    promise = {}
    plain = {c.names[0]: problem.fit(c.fit.choices, start=c.fit.parameters(), slack=False) for c in singles}
    for a, b in combinations(plain, 2):
        left = min(plain[x].objective - first_gain(problem, plain[x], y)[0] for x, y in ((a, b), (b, a)))
        promise[a, b] = left
    out = []
    for a, b in sorted(promise, key=promise.get)[:_PAIRS]:
        say(f"with {CATALOGUE[a].title} and {CATALOGUE[b].title}")
        out.append(judge(problem, fit_pair(problem, plain[a].choices[0], plain[b].choices[0]), base_score))
    return sorted(out, key=lambda c: -c.score)


def fit_pair(problem: Problem, a: Choice, b: Choice) -> Fit:
    """Fit of two effects, each in the form that is best beside the other."""
    second = max((problem.fit((a, Choice(b.effect, k)), slack=False) for k in forms(problem, b.effect)),
                 key=lambda f: f.evidence).choices[1]  # fmt: skip
    first = max((problem.fit((Choice(a.effect, k), second), slack=False) for k in forms(problem, a.effect)),
                key=lambda f: f.evidence)  # fmt: skip
    return problem.fit(first.choices, start=first.parameters())
