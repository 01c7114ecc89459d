"""How well the runs of a table are predicted by the others.

Levels of slip and load, and combinations of all conditions but the slip, are left out one after the
other. Three models that are fitted to the rest predict them: the base model, all effects with a
remainder (`prediction`), and a generic curve (`curve`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soil_env.identification.table.data import CHANNELS, combinations_of

from .calibrate import Problem
from .curve import Curve, at_curves, fit_curve
from .prediction import Prediction, at_conditions, fit_prediction, independent

LEVEL = 0.01  # range of the pass number, or of the sine of the grade, up to which it is constant
FEWEST_GROUPS = 3  # levels or combinations, from which they are left out in turn
MOST_GROUPS = 10  # of them: the 1st and the 11th are left out together; each costs a fit
FEWEST = 4  # values of a channel, from which it has a curve
FEWEST_SLIPS = 3  # slips of these: a curve has a level, a rise and a scale of the slip


class Errors(NamedTuple):
    """Root mean square of predicted less measured values of rows that were left out [unit of the
    channel], by each kind of prediction, and the noise.
    """

    base: float  # by the base model
    corrected: float  # by all effects and a remainder
    curve: float  # by a generic curve; NaN where the curve does not know the conditions
    noise: float


class LeftOut(NamedTuple):
    """Predictions of what was left out, one level of a condition after the other."""

    split: str  # "slip", "load", or "condition": a combination of all conditions but the slip
    what: tuple[str, ...]  # conditions whose levels, or combinations, are left out in turn
    errors: dict[str, Errors]  # by measured channel
    over_noise: Errors  # of all channels, over their noise


class Outlook(NamedTuple):
    """What can be predicted, and how well."""

    model: Prediction  # fitted to all rows
    left_out: tuple[LeftOut, ...]


def curves_of(problem: Problem) -> list[Curve | None] | None:
    """Generic curves (`curve`) through the values in use, one for each of the three channels.

    None where a condition varies that a curve does not know: any but slip and load. A pass or a
    grade that varies counts even if it follows from slip and load, like the grades that a wheel
    climbs by itself. A channel with fewer than `FEWEST` values or `FEWEST_SLIPS` slips has None.
    All rows have the same weight, whatever noise they state, since a curve misses a table by more
    than noise.
    """
    rows = problem.data.rows
    passes_grades = rows.conditions[:, 1:]
    if {*independent(problem)} - {"slip", "load"} or np.any(np.ptp(passes_grades, axis=0) > LEVEL):
        return None
    level = problem.data.varied["slip"].level
    return [
        fit_curve(rows.slip[use], rows.load[use], problem.data.y[use, j], problem.noise[j])
        if use.sum() >= FEWEST and np.unique(level[use]).size >= FEWEST_SLIPS
        else None
        for j, use in enumerate(problem.used.T)
    ]


def outlook(problem: Problem) -> Outlook:
    """The fit of all effects to the table, and the errors of rows that were left out in turn.

    Left out are the levels of slip, the levels of load, and the combinations of all conditions but
    slip, these only if more than the load varies. Each kind needs `FEWEST_GROUPS`; more than
    `MOST_GROUPS` are dealt out to that many groups. Effects, unknowns and remainder are fitted anew
    to the rest.
    """
    others = tuple(name for name in independent(problem) if name != "slip")
    splits: dict[str, tuple[str, ...]] = {"slip": ("slip",)}
    if "load" in others:
        splits["load"] = ("load",)
    if {*others} - {"load"}:
        splits["condition"] = others
    found = []
    for split, what in splits.items():
        groups = combinations_of([problem.data.varied[n].level for n in what]) % MOST_GROUPS
        if groups.max() + 1 >= FEWEST_GROUPS:
            found.append(_errors(problem, split, what, _left_out(problem, groups)))
    return Outlook(fit_prediction(problem), tuple(found))


def _left_out(problem: Problem, groups: np.ndarray) -> np.ndarray:
    """[3, N, 3] predictions of each row by fits to the rows of all other `groups` [N].

    Along the first axis: base model, all effects, curve; along the last: channels [m, N, N m]. NaN
    where there is no curve.
    """
    held = np.full((3, *problem.used.shape), np.nan)
    for k in range(groups.max() + 1):
        group = groups == k
        rest = problem.without(group)
        at = {name: x[group] for name, x in problem.data.conditions.items()}
        held[0, group] = fit_prediction(rest, (), with_remainder=False).mean_at(at)
        held[1, group] = fit_prediction(rest).mean_at(at)
        curves = curves_of(rest)
        if curves is not None:
            held[2, group] = at_curves(curves, at_conditions(rest, at).data.rows)
    return held


def _errors(problem: Problem, split: str, what: tuple[str, ...], held: np.ndarray) -> LeftOut:
    """`LeftOut` of predictions [3, N, 3] of values that were left out: by the base model, by all
    effects, and by the curve.
    """
    off = held - problem.data.y

    def size(values: np.ndarray, noise: float) -> Errors:
        """`Errors` of deviations [3, m] by base model, all effects and curve, beside `noise`."""
        base, full, curve = np.sqrt(np.mean(values**2, axis=1)).tolist()
        return Errors(base, full, curve, noise)

    errors: dict[str, Errors] = {
        name: size(off[:, used, j], float(problem.rms_noise[j]))
        for j, (name, used) in enumerate(zip(CHANNELS, problem.used.T, strict=True))
        if used.any()
    }
    return LeftOut(split, what, errors, size((off / problem.rms_noise)[:, problem.used], 1.0))
