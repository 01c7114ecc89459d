"""A plain bank of models weighed by BIC: every effect in every form, and pairs with the best one, by least squares.

P(set) in proportion to exp(-BIC/2) (Schwarz 1978; Raftery 1995, equal priors), the best form for each effect. No error
of the laws: that is what it is a baseline for.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.blind.entrants import Answer
from benchmarks.blind.entrants.bank import Bank, Fitted

LEAST = 0.05  # probability from which a mechanism is an alternative


def answer(data: Path, setup: Path) -> Answer:
    """What the bank says of a table."""
    return best_of(Bank(data, setup), lambda fitted: fitted.bic)


def best_of(bank: Bank, criterion: Callable[[Fitted], float]) -> Answer:
    """The answer by a criterion: base model, every effect in its best form, and pairs of these with the best effect."""
    base = bank.fit()
    singles: dict[str, tuple[float, Fitted]] = {}
    for chosen in bank.candidates:
        fitted = bank.fit([chosen])
        told = criterion(fitted)
        if chosen.effect not in singles or told < singles[chosen.effect][0]:
            singles[chosen.effect] = told, fitted
    _, best = min(singles.values(), key=lambda pair: pair[0])
    pairs = [bank.fit([*best.chosen, *f.chosen]) for _, f in singles.values() if f is not best]
    return weighed([(criterion(base), base), *singles.values(), *((criterion(f), f) for f in pairs)])


def weighed(told: list[tuple[float, Fitted]]) -> Answer:
    """The answer that BIC weights give: names above one half; where none is, the first with those of 5 % and more."""
    bic, fits = np.array([value for value, _ in told]), [f for _, f in told]
    weight = np.exp(-0.5 * (bic - bic.min()))
    weight /= weight.sum()
    chance: dict[str, float] = {}
    for f, w in zip(fits, weight, strict=True):
        for c in f.chosen:
            chance[c.effect] = min(chance.get(c.effect, 0.0) + float(w), 1.0)
    order = sorted(chance, key=lambda name: -chance[name])
    named = [name for name in order if chance[name] > 0.5]
    others = [name for name in order if LEAST <= chance[name] <= 0.5]
    if named:
        return Answer("named", tuple(named), tuple(others), chance)
    if weight[0] > 0.5:
        return Answer("none", (), (), chance)
    return Answer("ambiguous", (order[0],), tuple(others[1:]), chance)
