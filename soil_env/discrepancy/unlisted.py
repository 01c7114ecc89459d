"""The law of something unlisted as a formula with a legend, and the tests that tell most about it.

A law without a name is a guess at a form. Two kinds of test bear on it: the run in which it adds most, made again, says
whether there is anything to explain; runs in which one of its conditions goes beyond the table, all else kept, say
whether it goes on as the law does or stays as it was at the end of the table.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from soil_env.discrepancy.calibrate import Fit, Problem
from soil_env.discrepancy.data import CHANNELS
from soil_env.discrepancy.equations import Term, plain
from soil_env.discrepancy.experiment import DEEPEST, LEAST, MOST, NextTest
from soil_env.discrepancy.locate import TITLES, UNITS, figure
from soil_env.discrepancy.symbolic import ResidualFit
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.residual import ResidualTerm

LEFT = MappingProxyType({"sinkage": "(z - z_0)/r", "drawbar_pull": "(DP - DP_0)/W", "torque": "(T - T_0)/(W r)"})
SYMBOL = MappingProxyType({
    "slip": "i", "grip": "(1 - i)", "sinkage": "Z", "load": "L", "speed": "Fr", "pass": "N", "grade": "sin(b)",
})  # fmt: skip
GROUP = MappingProxyType({
    "slip": Term("i", "slip"),
    "grip": Term("1 - i", "travel over rim speed"),
    "sinkage": Term("Z", "z_0/r, sinkage over radius"),
    "load": Term("L", "W/(S b r^(n+1)), load over bearing strength"),
    "speed": Term("Fr", "V/sqrt(g r), Froude number"),
    "pass": Term("N", "pass number"),
    "grade": Term("sin(b)", "sine of the grade"),
})  # fmt: skip
VALUES = MappingProxyType({"sinkage": "z", "drawbar_pull": "DP", "torque": "T"})
LAW, BASE, GOES_ON, STAYS = "the law", "the base model", "the law goes on", "it stays as at the end of the table"
#: What a group is about, and the condition of a table that moves it.
CONDITION = MappingProxyType({"slip": "slip", "grip": "slip", "sinkage": "sinkage", "load": "load", "speed": "speed",
                              "pass": "pass number", "grade": "grade"})  # fmt: skip
_CONDITION = CONDITION | {"sinkage": "load", "pass": "pass", "grade": "grade_deg"}
_SURE = 1.959964  # [sd] of a 95 % interval


class Coefficient(NamedTuple):
    """A coefficient of the law with its 95 % interval, soil refitted to it."""

    value: float
    low: float
    high: float


def covariance(law: ResidualFit) -> np.ndarray:
    """[T, T] of the coefficients (Laplace; the soil moves with them)."""
    fit, count = law.fit, len(law.terms)
    whole = np.linalg.inv(np.eye(fit.jacobian.shape[1]) + fit.jacobian.T @ fit.jacobian)[-count:, -count:]
    with np.errstate(divide="ignore", invalid="ignore"):
        width = np.array([t.coefficient for t in law.terms]) / fit.slack[-count:]  # prior sd of each
    width = np.where(np.isfinite(width), width, 0.0)
    return whole * np.outer(width, width)


def coefficients(law: ResidualFit) -> list[Coefficient]:
    """The coefficients of the terms, in their order."""
    sd = np.sqrt(np.diag(covariance(law))) if law.terms else ()
    return [Coefficient(t.coefficient, *sorted((t.coefficient - _SURE * s, t.coefficient + _SURE * s)))
            for t, s in zip(law.terms, sd, strict=True)]  # fmt: skip


def formulas(terms: tuple[ResidualTerm, ...], digits: int = 3) -> dict[str, str]:
    """{channel: equation} of the law."""
    out: dict[str, str] = {}
    for term in terms:
        size = f"{plain(abs(term.coefficient), digits)}{product(term.powers)}"
        minus = term.coefficient < 0.0
        if term.channel in out:
            out[term.channel] += f" {'-' if minus else '+'} {size}"
        else:
            out[term.channel] = f"{LEFT[term.channel]} = {'-' if minus else ''}{size}"
    return out


def product(powers: Mapping[str, float]) -> str:
    """The groups of a term with their powers, each behind a space."""
    parts = ""
    for group, p in powers.items():
        power = "" if p == 1.0 else f"^{p:g}" if p > 0.0 else f"^({p:g})"
        parts += f" {SYMBOL[group]}{power}"
    return parts


def legend(terms: tuple[ResidualTerm, ...]) -> list[tuple[str, str, tuple[float, float] | None]]:
    """(symbol, meaning, range in the table) of what the formulas name; no range for what is no group."""
    out: list[tuple[str, str, tuple[float, float] | None]] = []
    for channel in dict.fromkeys(t.channel for t in terms):
        symbol = VALUES[channel]
        out.append((f"{symbol}, {symbol}_0", f"{TITLES[channel]} with and without the law", None))
    for term in terms:
        for group in term.powers:
            low, high = term.ranges.get(group, (math.nan, math.nan))
            row = (*GROUP[group], (float(low), float(high)) if math.isfinite(low) else None)
            if row[0] not in [r[0] for r in out]:
                out.append(row)
    return out


def added(model: WheelSoilModel, problem: Problem) -> dict[str, tuple[float, float]]:
    """{channel: least and most that the law adds in the table}."""
    plain = dataclasses.replace(model, residual=())
    law = np.stack(model.predict(problem.data.table)[:3], axis=1) - np.stack(plain.predict(problem.data.table)[:3], 1)
    out = {}
    for channel in dict.fromkeys(t.channel for t in model.residual):
        values = law[problem.used[:, CHANNELS.index(channel)], CHANNELS.index(channel)]
        out[channel] = (float(values.min()), float(values.max()))
    return out


# --- tests ------------------------------------------------------------------------------------------------------------


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
    words = f"{_place(point)}, three times again: {'the law adds' if law.terms else 'the model misses'} most here"
    first = NextTest(point, CHANNELS[channel], pair, size, f"{words}, {_amount(problem, size, channel)}")
    return (first, *_beyond(problem, law, model, point)[: MOST - 1])


def _beyond(problem: Problem, law: ResidualFit, model: WheelSoilModel, point: dict[str, float]) -> list[NextTest]:
    """Tests with one condition of the law beyond the table, `point` for the rest."""
    out, spread = [], covariance(law) if law.terms else None
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
            words = (
                f"{_place(there)}, {name.replace('_deg', '')} alone beyond the table: {GOES_ON}, or {STAYS}, expected "
                f"to differ by {sigma:.1f} sd in {TITLES[CHANNELS[channel]]}"
            )
            out.append(NextTest(there, CHANNELS[channel], (GOES_ON, STAYS), sigma, words))
    return sorted(out, key=lambda t: -t.expected_sigma)


def _difference(problem, law, model, there, name, spread) -> tuple[float, int] | None:
    """(difference of the law going on and staying, over noise and uncertainty; channel); None where not feasible."""
    groups = [g for g, c in _CONDITION.items() if c == name]
    free = tuple(
        dataclasses.replace(t, ranges={g: r for g, r in t.ranges.items() if g not in groups}) for t in law.terms
    )
    quiet = dataclasses.replace(model, validity={})
    stays = quiet.predict(there)
    on = dataclasses.replace(quiet, residual=free).predict(there)
    if not on.floating or not -0.1 < on.sinkage[0] / model.wheel.radius < DEEPEST:
        return None
    best = (0.0, 0)
    for j, channel in enumerate(CHANNELS):
        if not problem.used[:, j].any():
            continue
        slopes = np.zeros(len(free))
        for k, (a, b) in enumerate(zip(free, law.terms, strict=True)):
            if a.channel == channel and a.coefficient != 0.0:
                one = [dataclasses.replace(quiet, residual=(t,)).predict(there)[j][0] for t in (a, b)]
                slopes[k] = (one[0] - one[1]) / a.coefficient
        off = abs(float(on[j][0] - stays[j][0]))
        sd = math.sqrt(problem.noise[j] ** 2 + float(slopes @ spread @ slopes))
        best = max(best, (off / sd, j))
    return best


def _steps(problem: Problem, name: str) -> list[float]:
    """Values of a condition beyond the table."""
    x = {"slip": problem.data.rows.slip, "load": problem.data.rows.load, "speed": problem.data.rows.conditions[:, 0],
         "pass": problem.data.rows.conditions[:, 1],
         "grade_deg": np.degrees(np.arcsin(problem.data.rows.conditions[:, 2]))}[name]  # fmt: skip
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
    rows = problem.data.rows
    speed, passes, sine = rows.conditions[row]
    out = {"slip": float(rows.slip[row]), "load": float(rows.load[row])}
    if speed > 0.0:
        out["speed"] = float(speed)
    for name, value in (("pass", float(passes)), ("grade_deg", round(float(np.degrees(np.arcsin(sine))), 6))):
        if name in problem.data.varied:
            out[name] = value
    return out


def _place(point: Mapping[str, float]) -> str:
    """The conditions in words."""
    parts = [f"load {point['load']:.4g} N"] if "load" in point else []
    parts += [f"{point['speed']:.3g} m/s"] if "speed" in point else []
    parts += [f"pass {point['pass']:g}"] if point.get("pass", 1.0) != 1.0 else []
    parts += [f"a grade of {point['grade_deg']:.3g} deg"] if point.get("grade_deg", 0.0) != 0.0 else []
    at = parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
    return f"slip {point['slip']:.2g} at {at}"


def _amount(problem: Problem, size: float, channel: int) -> str:
    unit, scale = UNITS[CHANNELS[channel]]
    value = figure(scale * size * problem.noise[channel])
    return f"{value} {unit} of {TITLES[CHANNELS[channel]]} ({size:.1f} sd)"
