"""Search for the missing effects: the probability of every hypothesis about what the base model
lacks.

A hypothesis is a set of no, one or two effects of the catalogue, with or without an anonymous
contribution that no listed effect explains. Its probability is its prior (below) times the tempered
evidence of its model, in which the law of the base model and of each effect may be wrong
(`evidence`). The verdict, the names and their alternatives follow from these probabilities alone
(`Finding`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from .calibrate import Problem
from .evidence import (
    Detectable,
    Evidence,
    anonymous,
    detectable,
    in_place_of_effects,
    log_sum,
    promised,
    settle,
)
from .instrument import (
    INSTRUMENT,
    LISTED,
    Choice,
    Choices,
    Names,
    effect_names,
    odds_factors,
    ruled_out,
    titles,
)
from .unnamed import UNNAMED

#: Prior odds that a listed effect of the soil or the drive is missing, and that the instrument has
#: a listed error, each independent of the others: none is there with 32 %. An error is less
#: probable where the setup states that the rig is known better than usual (`odds_factors`). No
#: single name has odds of its own.
ODDS = 0.06  # of the soil or the drive
RIG_ODDS = 0.04  # of the instrument
#: Prior odds of an anonymous contribution: the catalogue holds what the literature has found to
#: matter.
UNLISTED_ODDS = 0.05
#: Prior odds of each anonymous law of few numbers (`unnamed`), half of those of a listed effect.
UNNAMED_ODDS = 0.03
#: Odds, for each effect of a set, that an unlisted law that moves the same channels under the same
#: conditions is missing instead (`evidence.in_place_of_effects`).
ALIKE = 0.17
#: Log evidences are divided by this. The form errors have assumed shapes and lengths, which no soil
#: keeps to, so that evidence is less certain than it says (generalised Bayes: Grunwald & van Ommen
#: 2017, Bayesian Anal. 12:1069-1103). Chosen on the development seed 136101 of
#: `benchmarks.discovery`; between 1 and 2.5 hardly a share of its answers moves.
TEMPERATURE = 1.75
NAMED = 0.5  # probability from which an answer is given, such as a name
#: Probability, also if the laws err by the largest of `LAW_ERRORS`, from which a name is sure; from
#: `NAMED` it is likely.
SURE = 0.8
#: Relative errors of the base law, for which probabilities are given beside those over all sizes.
LAW_ERRORS = (0.03, 0.1)
REPORTED = 0.05  # least probability of an alternative
_LEAST_SUM = 1e-300  # least sum of probabilities, since it divides: all may be 0
_FIRST = 8  # number of best single effects, beside which a second one is sought
_PAIRS = 10  # number of pairs that are fitted after the screen
_FORMS = 3  # number of best pairs that are fitted with all forms of each of the two effects
_FREE = 3  # number of best sets that are tried with an anonymous contribution too


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A set of effects, with or without an anonymous contribution, and its probability."""

    names: Names  # listed effects
    free: bool  # with an anonymous contribution or law
    probability: float
    score: float  # log evidence less that of the base model, without priors
    evidence: Evidence  # in the most probable of the forms
    #: Listed effects that it is said to resemble: those that it stands in for, or for an anonymous
    #: law the one that explains most by itself.
    like: Names = ()
    if_laws_err: tuple[float, ...] = ()  # its probability if the laws err by each of `LAW_ERRORS`

    @property
    def law(self) -> str:
        """Name of its anonymous law of few numbers (`unnamed`), "" if it has none."""
        return next((name for name in self.evidence.names if name in UNNAMED), "")


class Rank(NamedTuple):
    """One effect among the candidates."""

    name: str
    #: Log evidence of the best hypothesis with it, less that of the best without a listed effect.
    score: float
    probability: float
    if_laws_err: tuple[float, ...]  # probability if the laws err by each of `LAW_ERRORS`


@dataclass(frozen=True, eq=False)
class Finding:
    """The hypotheses, the most probable first, and what follows from them."""

    hypotheses: tuple[Hypothesis, ...]
    untestable: dict[str, str]  # reason by name of the listed effects that were not tried
    detectable: dict[str, Detectable]  # by name of the effects of soil and drive that were tried
    #: Sets of effects that held-out rows or a pattern speak against.
    refuted: tuple[Names, ...] = ()

    def without(self, names: Names, alone: bool = False) -> Finding:
        """The finding once these effects, together, are refuted; the probabilities of what is left
        sum to 1. They are equal if all that is not refuted had the probability 0.

        All sets with these effects are left out. With `alone`, only the set of exactly these
        effects is refuted: sets with more may explain what it leaves. It stays as a hypothesis with
        the probability 0, since others are compared with it. Without names that is only the base
        model without an anonymous contribution.
        """

        def refuted(h: Hypothesis) -> bool:
            """True if a hypothesis is refuted with the names."""
            if alone:
                return {*h.names} == {*names} and bool(names or not h.free)
            return {*names} <= {*h.names}

        left = [h for h in self.hypotheses if alone or not refuted(h)]
        share = np.array(
            [np.multiply((h.probability, *h.if_laws_err), not refuted(h)) for h in left]
        )
        total = share.sum(axis=0)
        equal = np.array([[float(not refuted(h))] for h in left])
        if not equal.any():  # nothing else is left
            equal += 1.0
        share = np.where(total > 0.0, share / np.maximum(total, _LEAST_SUM), equal / equal.sum())
        kept = [
            replace(h, probability=p, if_laws_err=tuple(others))
            for h, (p, *others) in zip(left, share.tolist(), strict=True)
        ]
        kept.sort(key=lambda h: -h.probability)
        return replace(self, hypotheses=tuple(kept), refuted=(*self.refuted, names))

    def in_form(self, evidence: Evidence) -> Finding:
        """The finding with the stated effects in the forms of `evidence`, which becomes that of the
        hypothesis `stated`; its probability and score stay.
        """
        stated = self.stated
        kept = (replace(h, evidence=evidence) if h is stated else h for h in self.hypotheses)
        return replace(self, hypotheses=tuple(kept))

    def share(self, *names: str) -> float:
        """Probability that these effects are missing, alone or with others."""
        return sum(h.probability for h in self.hypotheses if {*names} <= {*h.names})

    def if_laws_err(self, *names: str) -> tuple[float, ...]:
        """`share` if the laws err, for each of `LAW_ERRORS`."""
        with_all = [h.if_laws_err for h in self.hypotheses if {*names} <= {*h.names}]
        return tuple(map(sum, zip(*with_all, strict=True)))

    def is_sure(self, name: str) -> bool:
        """True if an effect is sure to be missing: with `SURE`, also if the laws err by the largest
        of `LAW_ERRORS`. Otherwise a name is only likely.
        """
        return min(self.share(name), self.if_laws_err(name)[-1]) >= SURE

    @property
    def none(self) -> float:
        """Probability of the base model alone: nothing is missing beyond an ordinary form error."""
        return self.best().probability

    @property
    def unlisted(self) -> float:
        """Probability that something is missing and nothing that is listed: an anonymous
        contribution or law by itself.
        """
        return sum(h.probability for h in self.hypotheses if not h.names and h.free)

    @property
    def remainder(self) -> float:
        """Probability that something is missing that no listed effect explains, with or without a
        listed one.
        """
        return sum(h.probability for h in self.hypotheses if h.free)

    @property
    def by_effects(self) -> dict[Names, float]:
        """Probability of each set of effects, with an anonymous contribution or without; the empty
        set is the base model alone.

        Something unlisted without a listed effect is left out, since it predicts nothing.
        """
        share: dict[Names, float] = {}
        for h in self.hypotheses:
            if h.names or not h.free:
                share[h.names] = share.get(h.names, 0.0) + h.probability
        return share

    @property
    def more(self) -> float:
        """Probability that the stated effects are missing and more: a further effect, or what no
        listed effect explains.
        """
        return self.share(*self.names) - self.best(*self.names).probability

    @cached_property
    def names(self) -> Names:
        """Effects that are stated to be missing.

        They are taken in the order of their probabilities. One is stated if it and those stated
        before it are missing together with a probability of `NAMED`, also if the laws err by the
        largest of `LAW_ERRORS`.
        """
        named: Names = ()
        for name in sorted(self.tried, key=lambda n: -self.share(n)):
            all_of = (*named, name)
            if self.share(*all_of) >= NAMED and self.if_laws_err(*all_of)[-1] >= NAMED:
                named = all_of
        return named

    @cached_property
    def candidates(self) -> Names:
        """Effects that are not stated and have at least `REPORTED`, the most probable first.

        The probability is that the effect is missing, or that a missing anonymous law resembles it,
        whichever is larger.
        """
        near = {
            n: max(self.share(n), sum(h.probability for h in self.hypotheses if n in h.like))
            for n in self.tried
            if n not in self.names
        }
        return _reported(near)

    @cached_property
    def tried(self) -> Names:
        """Every effect that was tried, by name, but for those that `without` has left in no
        hypothesis.
        """
        return tuple(dict.fromkeys(n for h in self.hypotheses for n in h.names))

    @cached_property
    def ranking(self) -> tuple[Rank, ...]:
        """Every effect that was tried, the stated ones first, then the most probable."""
        without = max(h.score for h in self.hypotheses if not h.names)
        out = [
            Rank(
                n,
                max(h.score for h in self.hypotheses if n in h.names) - without,
                self.share(n),
                self.if_laws_err(n),
            )
            for n in self.tried
        ]
        return tuple(
            sorted(out, key=lambda r: (r.name not in self.names, -r.probability, -r.score))
        )

    @property
    def verdict(self) -> str:
        """named, partly, ambiguous, unlisted, none or undetermined, by what has `NAMED` or more.

        It is "partly" instead of "named" if a further effect or an anonymous contribution has as
        much. It is "undetermined" instead of "none" if the table is `blind`.
        """
        if self.names:
            return "partly" if max(self.remainder, self.more) >= NAMED else "named"
        if self.unlisted >= NAMED:
            return "unlisted"
        return "ambiguous" if self.none < NAMED else "undetermined" if self.blind else "none"

    @property
    def blind(self) -> bool:
        """True if a missing listed effect would more probably have been overlooked than seen.

        Then the mean power is at most `NAMED`, or no effect could be seen at all.
        """
        return sum(d.power for d in self.detectable.values()) <= NAMED * len(self.detectable)

    def alternatives(self, name: str) -> Names:
        """Rivals of the stated effect `name`, the most probable first.

        They are effects that are not stated, each of which is missing while `name` is not with a
        probability of `REPORTED` or more.
        """
        return _reported(
            {n: self.share(n) - self.share(n, name) for n in self.tried if n not in self.names}
        )

    @property
    def stated(self) -> Hypothesis:
        """The most probable hypothesis with exactly the stated effects, with an anonymous
        contribution or without.
        """
        return self.best(*self.names, free=None)

    @property
    def scatter(self) -> float:
        """Scatter of the values about the model over their noise: root mean square over the
        hypotheses by their probabilities.
        """
        return math.sqrt(
            sum(h.probability * h.evidence.typical("scatter") ** 2 for h in self.hypotheses)
        )

    def best(self, *names: str, free: bool | None = False) -> Hypothesis:
        """The most probable hypothesis with exactly these listed effects, and with an anonymous
        contribution if `free` (None: with or without).

        Hypotheses of an anonymous law that resembles an effect (`Hypothesis.like`) do not count.
        """
        of_names = (h for h in self.hypotheses if {*h.names} == {*names} and not h.like)
        return next(h for h in of_names if free in (None, h.free))


def _reported(share: dict[str, float]) -> Names:
    """Names with `REPORTED` or more, the most probable first."""
    return tuple(sorted((n for n in share if share[n] >= REPORTED), key=lambda n: -share[n]))


def candidates(problem: Problem) -> tuple[list[str], dict[str, str]]:
    """(names of the listed effects to try, reason by name of the others).

    An effect is not tried where none of its channels is measured or where the setup rules it out.
    Nor is it where the rig hides it, or where its condition does not vary by itself and the effect
    cannot show without that (`Effect.shows_without`).
    """
    names = []
    reasons = {}
    data = problem.data
    by_setup = ruled_out(data.setup)
    for name, effect in LISTED.items():
        if {*effect.moves}.isdisjoint(problem.channels):
            reasons[name] = f"{' and '.join(effect.moves)} not measured"
        elif reason := by_setup.get(name) or effect.hidden(problem.bench):
            reasons[name] = reason
        elif effect.varies and effect.varies not in data.varied and not effect.shows_without:
            reasons[name] = f"no {effect.varies.removesuffix('_deg')} variation of its own"
        else:
            names.append(name)
    return names, reasons


def forms(problem: Problem, name: str) -> list[Choice]:
    """Forms of an effect that can be fitted to this table: if a row has no speed, those that need
    none.
    """
    speed = problem.bench.speed > 0.0
    return [Choice(name, k) for k, f in enumerate(LISTED[name].forms) if speed or not f.needs_speed]


Say = Callable[[str], None]  # receives the progress, as text


class Entry(NamedTuple):
    """Hypothesis before its probability is known."""

    evidence: Evidence  # in the best of the forms that were tried
    log: float  # log evidence over the forms
    log_odds: float  # log prior odds against the base model
    names: Names = ()  # listed effects
    like: Names = ()  # listed effects that its anonymous law resembles
    free: bool = False  # with an anonymous contribution or law


@dataclass(frozen=True)
class _Sets:
    """Evidence of sets of effects in the forms that were tried."""

    problem: Problem
    found: dict[Names, dict[Choices, Evidence]] = field(default_factory=dict)

    def add(self, choices: Choices, near: Evidence | None) -> Evidence:
        """Evidence of a set in these forms, fitted if it was not before; `near`: as in `settle`."""
        choices = tuple(sorted(choices))
        in_forms = self.found.setdefault(effect_names(choices), {})
        if choices not in in_forms:
            in_forms[choices] = settle(self.problem, choices, near)
        return in_forms[choices]

    def best(self, names: Names) -> Evidence:
        """Evidence of a set of effects in the most probable of the forms that were tried."""
        return max(self.found[names].values(), key=lambda e: e.log)

    def log(self, names: Names) -> float:
        """Log evidence of a set of effects, over all combinations of their forms, which are equally
        probable before the table; combinations that were not tried have no evidence.
        """
        count = math.prod(len(forms(self.problem, n)) for n in names)
        return float(log_sum([e.log for e in self.found[names].values()])) - math.log(count)


def search(problem: Problem, say: Say = lambda text: None) -> Finding:
    """Return the `Finding` of a table; `say` receives the progress.

    The hypotheses are no effect, each effect and the best pairs. An anonymous contribution is tried
    with no effect, and with the `_FREE` best sets, or all single effects where the values scatter.
    For each set of effects there is an anonymous law that resembles it, unless one of them is named
    in any form (`Effect.any_form`). Anonymous laws of few numbers are tried by themselves.

    Probabilities are in proportion to the prior odds times the evidence to the power of
    1/`TEMPERATURE`. `Finding.detectable` is of effects of soil and drive alone.
    """
    names, untestable = candidates(problem)
    prior = partial(log_prior, of_rig=odds_factors(problem.data.setup, problem.bench))
    sets = _Sets(problem)
    say("base model")
    base = sets.add((), None)
    for name in names:
        say(f"with {LISTED[name].title}")
        for choice in forms(problem, name):
            sets.add((choice,), base)
    _pairs(problem, names, sets, say)
    order = sorted(sets.found, key=lambda s: -(sets.log(s) / TEMPERATURE + prior(s)))
    entries = [Entry(sets.best(s), sets.log(s), prior(s), s) for s in order]
    say("with something that no catalogue lists")
    free: dict[Names, Evidence] = {(): anonymous(problem, base)}
    # Under scatter the evidence without it does not say which sets matter.
    rough = free[()].sizes.scatter > 1.0
    single = [s for s in order if len(s) == 1]
    for s in single if rough else order[:_FREE]:
        if s not in free:
            say(f"with something that no catalogue lists and {titles(s)}")
            free[s] = anonymous(problem, sets.best(s))
    # An anonymous contribution is tried in the best forms, and taken to gain as much in others.
    entries += [
        Entry(
            evidence=e,
            log=sets.log(s) + e.log - sets.best(s).log,
            log_odds=prior(s) + math.log(UNLISTED_ODDS),
            names=s,
            free=True,
        )
        for s, e in free.items()
    ]
    for s in order:
        if not s or any(LISTED[n].any_form for n in s):
            continue  # an effect that is named in any form: what resembles it has its name
        alike = in_place_of_effects(problem, sets.best(s))
        log_odds = prior(s) + len(s) * math.log(ALIKE)
        entries.append(Entry(alike, alike.log, log_odds, like=s, free=True))
    say("with a law that no catalogue lists")
    entries += _unnamed(problem, base, max(single, key=sets.log, default=()))
    # A row for each entry; columns: over all sizes of the law's error, and under `LAW_ERRORS`.
    total = np.array(
        [
            [
                (e.log + x) / TEMPERATURE + e.log_odds
                for x in (0.0, *map(e.evidence.if_laws_err, LAW_ERRORS))
            ]
            for e in entries
        ]
    )
    share = np.exp(total - log_sum(total, axis=0)).tolist()
    found = [
        Hypothesis(
            names=e.names,
            free=e.free,
            probability=p,
            score=e.log - base.log,
            evidence=e.evidence,
            like=e.like,
            if_laws_err=tuple(others),
        )
        for e, (p, *others) in zip(entries, share, strict=True)
    ]
    threshold = -TEMPERATURE * math.log(ODDS)  # [nat] that raise the odds of an effect to 1
    usual = free[()] if rough else base
    seen = {
        n: detectable(problem, usual, forms(problem, n), threshold)
        for n in names
        if n not in INSTRUMENT
    }
    return Finding(tuple(sorted(found, key=lambda h: -h.probability)), untestable, seen)


def _unnamed(problem: Problem, base: Evidence, nearest: Names) -> list[Entry]:
    """Entries of the anonymous laws of few numbers whose condition varies and whose channels are
    measured.

    `nearest`: the listed effect that explains most, which the laws are said to resemble; with () in
    its place there are no entries.
    """
    laws = [
        law
        for law in UNNAMED.values()
        if law.varies in (None, *problem.data.varied) and {*law.moves} <= {*problem.channels}
        # A power of the speed needs it in every row.
        if law.varies != "speed" or problem.bench.speed > 0.0
    ]
    # Without `like` an entry would pass for an anonymous contribution (`Finding.best`).
    found = [settle(problem, (Choice(law.name, 0),), base) for law in laws if nearest]
    log_odds = math.log(UNNAMED_ODDS)
    return [Entry(e, e.log, log_odds, like=nearest, free=True) for e in found]


def log_prior(names: Names, of_rig: Mapping[str, float]) -> float:
    """Log prior odds of a set of effects against the base model without effects.

    `of_rig`: factor on `RIG_ODDS` of each error of the instrument, by name (`odds_factors`).
    """
    return sum(math.log(RIG_ODDS * of_rig[n] if n in INSTRUMENT else ODDS) for n in names)


def _pairs(problem: Problem, names: list[str], sets: _Sets, say: Say) -> None:
    """Add pairs of effects to `sets`.

    Every effect beside each of the `_FIRST` best single ones is screened to first order. The
    `_PAIRS` most promising pairs of forms are fitted, and the most promising forms of as many pairs
    of effects. The `_FORMS` best pairs are fitted with each of the two effects in all its forms.
    """
    say("screening pairs")
    promise: dict[Choices, float] = {}
    for name in sorted(names, key=lambda n: -sets.best((n,)).log)[:_FIRST]:
        first = sets.best((name,))
        others = [c for n in names if n != name for c in forms(problem, n)]
        for choice, log in zip(others, promised(problem, first, others), strict=True):
            pair = tuple(sorted((*first.fit.choices, choice)))
            promise[pair] = max(log, promise.get(pair, -math.inf))
    order = sorted(promise, key=lambda p: -promise[p])
    in_form: dict[Names, Choices] = {}
    for pair in order:
        in_form.setdefault(effect_names(pair), pair)
    tried = list(in_form)[:_PAIRS]
    # Many forms of one pair must not crowd out other pairs, and the first order chooses no form.
    for pair in (*order[:_PAIRS], *(in_form[s] for s in tried)):
        say(f"with {titles(effect_names(pair))}")
        sets.add(pair, max((sets.best((c.effect,)) for c in pair), key=lambda e: e.log))
    for both in sorted(tried, key=lambda s: -sets.best(s).log)[:_FORMS]:
        best = sets.best(both)
        for at, other in ((0, 1), (1, 0)):
            for choice in forms(problem, both[at]):
                sets.add((choice, best.fit.choices[other]), best)
