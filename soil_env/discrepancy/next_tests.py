"""Design of the next tests: conditions that discriminate best between the remaining candidates, or test a law.

Every candidate predicts a grid of feasible conditions, with its uncertainty: the covariance C = (I + J'J)^-1 of its
parameters and form errors, carried to the grid. A single extra run separates candidates a and b in a channel by

    |f_a - f_b| / sqrt(sigma^2 + g_a'C_a g_a + g_b'C_b g_b)

standard deviations (Box & Hill 1967, Technometrics 9:57-71; Atkinson & Fedorov 1975, Biometrika 62:57-70).

A law without a name is a guess at a form. The run in which it adds most, made again, shows if there is anything to
explain. Runs in which one of its conditions goes beyond the table show if the law goes on or stays as at its end.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from soil_env.discrepancy.calibrate import Fit, Problem
from soil_env.discrepancy.data import CHANNELS, LOGARITHMIC, WHEEL
from soil_env.discrepancy.evidence import Evidence
from soil_env.discrepancy.instrument import LISTED
from soil_env.discrepancy.predictive import predicted, problem_at
from soil_env.discrepancy.search import Finding
from soil_env.discrepancy.symbolic import ResidualFit
from soil_env.terramechanics.model import Prediction, WheelSoilModel
from soil_env.terramechanics.residual import ResidualTerm

MOST = 4  # tests proposed
LEAST = 1.0  # [sd] below which a test separates nothing
ENOUGH = 8.0  # [sd] beyond which a test is not better
WITHIN_REACH = 0.01  # least probability of a set of effects that a test is to separate
CANDIDATES = 5
DEEPEST = 0.6  # [radii] deepest sinkage of a feasible test
SLIPS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
_GAIN_OUTSIDE = 0.3  # [sd] that a test must gain for each half span by which it lies outside the table
_HALF_SPAN = {"slip": 0.1, "load": 0.35, "speed": 0.35, "pass": 0.35, "grade_deg": 5.0, "wheel_radius": 0.2,
              "wheel_width": 0.2, "grouser_height": 0.01}  # at least; logarithmic  # fmt: skip
_SAME_WITHIN = 0.7  # distance, in half spans, below which two tests are much the same


@dataclass(frozen=True)
class NextTest:
    """One run to make: the conditions, and the two models or hypotheses that it separates."""

    conditions: dict[str, float]  # slip, load [N] and what else matters, as the columns of a table
    channel: str
    separates: tuple[str, str]
    expected_sigma: float  # difference over noise and uncertainty of the two predictions
    purpose: str = (
        "separate"  # "repeat" the run with the largest misfit, or go beyond the table in one "extend"ed condition
    )
    extended: str = ""  # that condition


class Grid(NamedTuple):
    """Conditions [G] that could be run."""

    value: dict[str, np.ndarray]  # by column
    asked: tuple[str, ...]  # columns that matter
    scaled: np.ndarray  # [G, K] in half spans of the table, from its middle


def next_tests(problem: Problem, finding: Finding) -> tuple[NextTest, ...]:
    """The tests that would best separate the most probable set of effects from the others that are within reach."""
    plain = [h for h in finding.hypotheses if not h.free]
    first = next((h for h in plain if {*h.names} == {*finding.names}), plain[0])
    rest = [h for h in plain if {*h.names} != {*first.names} and h.probability >= WITHIN_REACH]
    return separating(problem, [h.evidence for h in (first, *rest[: CANDIDATES - 1])])


def separating(problem: Problem, candidates: Sequence[Evidence]) -> tuple[NextTest, ...]:
    """A handful of different tests, the most telling first."""
    if len(candidates) < 2:
        return ()
    grid = conditions(problem, candidates)
    names = [" and ".join(c.names) or "base model" for c in candidates]
    there = problem_at(problem, grid.value)
    means, variances, feasible = zip(*(predicted(there, c) for c in candidates), strict=True)
    pairs = list(combinations(range(len(candidates)), 2))
    sigma = np.stack([np.abs(means[a] - means[b]) / np.sqrt(1.0 + variances[a] + variances[b]) for a, b in pairs])
    sigma[:, :, ~problem.used.any(axis=0)] = 0.0
    sigma[:, ~np.all(feasible, axis=0)] = 0.0
    sigma[~np.isfinite(sigma)] = 0.0
    outside = np.maximum(np.abs(grid.scaled) - 1.0, 0.0).sum(axis=1)
    rivals = np.array([1.0 if a == 0 else 0.5 for a, _ in pairs])  # the best against another first
    odd = _GAIN_OUTSIDE * outside + 0.02 * np.abs(grid.scaled).sum(axis=1)
    score = np.maximum(np.minimum(sigma, ENOUGH) - odd[None, :, None], 1e-3) * rivals[:, None, None]
    score[sigma < LEAST] = 0.0
    out: list[NextTest] = []
    while len(out) < MOST and score.any():
        p, g, j = np.unravel_index(int(np.argmax(score)), score.shape)
        pair = (names[pairs[p][0]], names[pairs[p][1]])
        point = {name: float(grid.value[name][g]) for name in grid.asked}
        out.append(NextTest(point, CHANNELS[j], pair, float(sigma[p, g, j])))
        same = np.linalg.norm(grid.scaled - grid.scaled[g], axis=1) < _SAME_WITHIN
        score[p] *= 0.5
        score[p, same] = 0.0
        score[p, :, j] *= 0.5
    return tuple(out)


# --- the grid ---------------------------------------------------------------------------------------------------------


def conditions(problem: Problem, candidates: Sequence[Evidence]) -> Grid:
    """Slips to 0.7, half to twice the loads of the table, its wheels, and speeds, passes and grades that matter.

    What no candidate knows is the middle speed, the first pass and the least grade of the table.
    """
    column, varied = problem.data.conditions, problem.data.varied
    speed, passes, grade = column["speed"], column["pass"], column["grade_deg"]
    choices = [choice for c in candidates for choice in c.fit.choices]
    known = {LISTED[c.effect].varies for c in choices}
    if any("drivetrain_friction_viscous" in c.free for c in choices):
        known.add("speed")
    timed = bool(np.all(speed > 0.0))
    if not timed:
        known.discard("speed")
    wheels = np.unique(problem.data.rows.wheels, axis=0)
    levels = {name: [float(np.median(x))] for name, x in column.items() if name not in WHEEL}
    levels["pass"] = [float(passes.min())]
    levels["grade_deg"] = [min(max(0.0, float(grade.min())), float(grade.max()))]
    levels["slip"], levels["load"] = list(SLIPS), _around(column["load"], 0.5, 2.0)
    if "speed" in known:
        levels["speed"] = _around(speed, 0.3, 3.0)
    if "pass" in known:
        levels["pass"] = sorted({1.0, 2.0, 3.0, float(passes.max())})
    if "grade_deg" in known:
        levels["grade_deg"] = [min(-10.0, float(grade.min())), 0.0, max(10.0, float(grade.max()))]
    points = np.array([(*p, *w) for p in product(*levels.values()) for w in wheels])
    names = (*levels, *WHEEL)
    asked = [n for n in names if n in varied or n in known or n in ("slip", "load") or (n == "speed" and timed)]
    scaled = []
    for k, name in enumerate(names):
        x, t = points[:, k], column[name]
        if name in LOGARITHMIC:
            x, t = np.log(np.maximum(x, 1e-9)), np.log(np.maximum(t, 1e-9))
        scaled.append((x - 0.5 * (t.min() + t.max())) / max(0.5 * np.ptp(t), _HALF_SPAN[name]))
    return Grid(dict(zip(names, points.T, strict=True)), tuple(asked), np.stack(scaled, axis=1))


def _around(x: np.ndarray, below: float, above: float) -> list[float]:
    """The ends and the middle of the values, and beyond by the two factors, in two digits where the table has none."""
    low, high = float(x.min()), float(x.max())
    middle = _round((low * high) ** 0.5) if high > 1.1 * low else low
    return sorted({_round(below * low), low, middle, high, _round(above * high)})


def _round(x: float) -> float:
    return float(f"{x:.2g}")


# --- a law without a name ---------------------------------------------------------------------------------------------

LAW, BASE, GOES_ON, STAYS = "the law", "the base model", "the law goes on", "it stays as at the end of the table"
#: The condition of a table that moves a group of the law.
_CONDITION = {"slip": "slip", "grip": "slip", "sinkage": "load", "load": "load", "speed": "speed", "pass": "pass",
              "grade": "grade_deg"}  # fmt: skip


def law_tests(problem: Problem, base: Fit, law: ResidualFit, model: WheelSoilModel) -> tuple[NextTest, ...]:
    """At most `MOST` tests, the repetition first, then those beyond the table, the most telling first."""
    off = (law.offset if law.terms else problem.data.y - base.output) / problem.noise
    off, cells = np.where(problem.used, np.nan_to_num(off), 0.0), problem.data.cell
    mean = np.array([off[cells == k].mean(axis=0) for k in range(int(cells.max()) + 1)])
    cell, channel = np.unravel_index(int(np.argmax(np.abs(mean))), mean.shape)
    row = int(np.argmax(cells == cell))
    point = {name: float(column[row]) for name, column in problem.data.conditions.items()}
    known = {"slip", "load", *problem.data.varied} | ({"speed"} if point["speed"] > 0.0 else set())
    point = {name: value for name, value in point.items() if name in known}
    pair = (LAW, BASE) if law.terms else ("a missing effect", "a slip of the rig")
    first = NextTest(point, CHANNELS[channel], pair, float(abs(mean[cell, channel])), "repeat")
    return (first, *_beyond(problem, law, model, point)[: MOST - 1])


def _beyond(problem: Problem, law: ResidualFit, model: WheelSoilModel, point: dict[str, float]) -> list[NextTest]:
    """Tests with one condition of the law beyond the table, `point` for the rest."""
    out, asked = [], dict.fromkeys(_CONDITION[g] for t in law.terms for g in t.powers)
    for name in (n for n in asked if n in point):
        tried = []
        for value in _steps(problem, name):
            there = point | {name: value}
            sigma, channel = _difference(problem, law, model, there, name)
            tried.append(NextTest(there, channel, (GOES_ON, STAYS), sigma, "extend", name))
        best = max(tried, key=lambda t: t.expected_sigma, default=None)
        if best is not None and best.expected_sigma >= LEAST:
            out.append(best)
    return sorted(out, key=lambda t: -t.expected_sigma)


def _difference(
    problem: Problem, law: ResidualFit, model: WheelSoilModel, there: dict[str, float], name: str
) -> tuple[float, str]:
    """(difference of the law going on and staying, over noise and uncertainty; channel); 0 where not feasible."""
    groups = [g for g, c in _CONDITION.items() if c == name]
    free = [dataclasses.replace(t, ranges={g: r for g, r in t.ranges.items() if g not in groups}) for t in law.terms]

    def predicted(*terms: ResidualTerm) -> Prediction:
        return dataclasses.replace(model, validity={}, residual=terms).predict(there)

    on, stays, spread = predicted(*free), predicted(*model.residual), law.covariance()
    if not on.supported or not -0.1 < on.sinkage[0] / model.wheel.radius < DEEPEST:
        return 0.0, ""
    best = (0.0, CHANNELS[0])
    for j, channel in enumerate(CHANNELS):
        if not problem.used[:, j].any():
            continue
        slopes = np.zeros(len(free))
        for k, (a, b) in enumerate(zip(free, law.terms, strict=True)):
            if a.channel == channel and a.coefficient != 0.0:
                ends = [float(getattr(predicted(t), channel)[0]) for t in (a, b)]
                slopes[k] = (ends[0] - ends[1]) / a.coefficient
        off = abs(float(getattr(on, channel)[0] - getattr(stays, channel)[0]))
        sd = math.sqrt(problem.noise[j] ** 2 + float(slopes @ spread @ slopes))
        best = max(best, (off / sd, channel), key=lambda pair: pair[0])
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
    return [_round(f * x0) for f, x0 in ((1.5, high), (2.0, high), (0.5, low)) if x0 > 0.0]
