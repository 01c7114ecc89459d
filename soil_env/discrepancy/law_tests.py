"""Design of tests for a law without a name.

Such a law is a guess at a form. Two kinds of test bear on it: the run in which it adds most, made again, says whether
there is anything to explain; runs in which one of its conditions goes beyond the table, all else kept, say whether the
law goes on or stays at its value at the end of the table.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from soil_env.discrepancy.calibrate import Problem
from soil_env.discrepancy.data import CHANNELS
from soil_env.discrepancy.experiment import DEEPEST, LEAST, MOST, NextTest
from soil_env.discrepancy.fits import Fit
from soil_env.discrepancy.symbolic import ResidualFit
from soil_env.terramechanics.model import Prediction, WheelSoilModel

LAW, BASE, GOES_ON, STAYS = "the law", "the base model", "the law goes on", "it stays as at the end of the table"
#: The condition of a table that moves a group of the law.
_CONDITION = {"slip": "slip", "grip": "slip", "sinkage": "load", "load": "load", "speed": "speed", "pass": "pass",
              "grade": "grade_deg"}  # fmt: skip


def law_tests(problem: Problem, base: Fit, law: ResidualFit, model: WheelSoilModel) -> tuple[NextTest, ...]:
    """At most `MOST` tests, the repetition first, then those beyond the table, the most telling first."""
    off = (problem.data.y - base.output) / problem.noise if not law.terms else law.offset / problem.noise
    off = np.where(problem.used, np.nan_to_num(off), 0.0)
    cells = problem.data.cell
    mean = np.array([off[cells == k].mean(axis=0) for k in range(int(cells.max()) + 1)])
    cell, channel = np.unravel_index(int(np.argmax(np.abs(mean))), mean.shape)
    row = int(np.flatnonzero(cells == cell)[0])
    point = _conditions(problem, row)
    size = float(abs(mean[cell, channel]))
    pair = (LAW, BASE) if law.terms else ("a missing effect", "a slip of the rig")
    first = NextTest(point, CHANNELS[channel], pair, size, "repeat")
    return (first, *_beyond(problem, law, model, point)[: MOST - 1])


def _beyond(problem: Problem, law: ResidualFit, model: WheelSoilModel, point: dict[str, float]) -> list[NextTest]:
    """Tests with one condition of the law beyond the table, `point` for the rest."""
    out, spread = [], law.covariance() if law.terms else np.zeros((0, 0))
    asked = dict.fromkeys(_CONDITION[g] for t in law.terms for g in t.powers)
    for name in asked:
        if name != "slip" and name not in point:
            continue
        best = None
        for value in _steps(problem, name):
            there = point | {name: value}
            found = _difference(problem, law, model, there, name, spread)
            if found is not None and (best is None or found[0] > best[1]):
                best = (there, *found)
        if best is not None and best[1] >= LEAST:
            there, sigma, channel = best
            out.append(NextTest(there, CHANNELS[channel], (GOES_ON, STAYS), sigma, "extend", name))
    return sorted(out, key=lambda t: -t.expected_sigma)


def _difference(
    problem: Problem, law: ResidualFit, model: WheelSoilModel, there: dict[str, float], name: str, spread: np.ndarray
) -> tuple[float, int] | None:
    """(difference of the law going on and staying, over noise and uncertainty; channel); None where not feasible."""
    groups = [g for g, c in _CONDITION.items() if c == name]
    free = tuple(
        dataclasses.replace(t, ranges={g: r for g, r in t.ranges.items() if g not in groups}) for t in law.terms
    )
    quiet = dataclasses.replace(model, validity={})
    stays = quiet.predict(there)
    on = dataclasses.replace(quiet, residual=free).predict(there)
    if not on.supported or not -0.1 < on.sinkage[0] / model.wheel.radius < DEEPEST:
        return None

    def value(predicted: Prediction, j: int) -> float:
        return float(getattr(predicted, CHANNELS[j])[0])

    best = (0.0, 0)
    for j, channel in enumerate(CHANNELS):
        if not problem.used[:, j].any():
            continue
        slopes = np.zeros(len(free))
        for k, (a, b) in enumerate(zip(free, law.terms, strict=True)):
            if a.channel == channel and a.coefficient != 0.0:
                one = [value(dataclasses.replace(quiet, residual=(t,)).predict(there), j) for t in (a, b)]
                slopes[k] = (one[0] - one[1]) / a.coefficient
        off = abs(value(on, j) - value(stays, j))
        sd = math.sqrt(problem.noise[j] ** 2 + float(slopes @ spread @ slopes))
        best = max(best, (off / sd, j))
    return best


def _steps(problem: Problem, name: str) -> list[float]:
    """Values of a condition beyond the table."""
    x = problem.data.conditions[name]
    low, high = float(x.min()), float(x.max())
    if name == "slip":
        return [s for s in (high + 0.1, high + 0.2, low - 0.1) if 0.0 <= s <= 0.8]
    if name == "pass":
        return [high + 1.0, high + 2.0]
    if name == "grade_deg":
        return [low - 5.0, high + 5.0]
    return [float(f"{f * x0:.2g}") for f, x0 in ((1.5, high), (2.0, high), (0.5, low)) if x0 > 0.0]


def _conditions(problem: Problem, row: int) -> dict[str, float]:
    """The conditions of a row, as the columns of a table."""
    varied = problem.data.varied
    point = {name: float(column[row]) for name, column in problem.data.conditions.items()}
    known = {"slip", "load", *varied} | ({"speed"} if point["speed"] > 0.0 else set())
    return {name: value for name, value in point.items() if name in known}
