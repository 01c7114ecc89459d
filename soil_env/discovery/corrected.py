"""Models that are simulated: `WheelSoilModel` of a fit, and of the prediction with all effects.

The latter has the laws of the world and a table of the remainder, with the standard deviations of a
run. The table has what these laws do not: the smooth remainder of each channel, soil that goes
with the load, and what may be an error of the rig. Errors of the rig that are named, and the
tilt of the setup, are in neither.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from soil_env._compiled.cache import kept
from soil_env.identification.table.data import CHANNELS, WHEEL
from soil_env.identification.table.form_error import Conditions
from soil_env.identification.table.priors import Values, soil_of
from soil_env.parameters import SoilState
from soil_env.slip import slips_of_radius
from soil_env.terramechanics.effects import CATALOGUE
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.residual import (
    COLUMNS,
    GROUPS,
    LARGEST,
    MOST_SD,
    ResidualTable,
    WorkingPoint,
    dimensionless_groups,
)
from soil_env.terramechanics.steady import Rim
from soil_env.terramechanics.validity import ranges_of

from .calibrate import Problem, sinkage_guess
from .instrument import INSTRUMENT, LISTED, Choice
from .prediction import Prediction, independent
from .predictive import DEEPEST

#: Slip by which the table goes beyond the measured ones; it begins at 0 where no row is braked.
BEYOND_SLIP = 0.1
MOST_SLIP = 0.95  # [-] of either sign, where the table ends even if a row is beyond; own choice
BEYOND_LOAD = 2.0  # factor by which the table goes beyond the measured loads
STEPS = {"slip": 0.08, "load": 0.2}  # correlation lengths between two nodes of the table
LEAST_STEP = {"slip": 0.012, "load": 0.15}  # between two nodes: of slip, and of ln W
COARSER = 1.2  # factor of the steps of slip and load until there are few enough nodes
MOST = 2000  # nodes of the table, less than `terramechanics.residual.MOST_NODES`
FEW = 4  # nodes of a condition other than slip and load, at most
SENSED = ("slip_bias", "sinkage_offset")  # effects of a world that only sensors feel
LITTLE = 0.05  # [noise] change below which an effect is left to the table


def model_of(problem: Problem, choices: Sequence[Choice], values: Values) -> WheelSoilModel:
    """The `WheelSoilModel` of parameters `values` by name: the soil, and the effects of the
    catalogue among `choices`.

    Errors of the rig and laws without a name are left out, since the world has none. The model
    knows the range of slip, load and other conditions of the table.
    """
    data = problem.data
    setup = data.setup
    soil = soil_of(setup, {**problem.known, **values, "density": problem.density})
    effects: dict[str, dict[str, float]] = {}
    for choice in choices:
        if choice.effect in CATALOGUE:
            effects.setdefault(choice.effect, {}).update(parameters(problem, choice, values))
    # A `WheelSoilModel` takes the load as normal to the ground; with a share of 1 it is vertical.
    if setup.load == "vertical":
        grade = effects.get("grade", {})
        effects["grade"] = grade | {"share": 1.0 + grade.get("share", 0.0)}
    wheel = data.wheel
    if data.lugs_unknown and "grousers" not in effects:
        wheel = replace(wheel, grouser_height=0.0)  # a height was assumed only to try grousers
    soil = replace(soil, source="calibrated by soil_env.discovery")
    return WheelSoilModel(
        wheel, soil, effects, gravity=setup.gravity, validity=ranges_of(data.rows)
    )


def parameters(problem: Problem, choice: Choice, values: Values) -> dict[str, float]:
    """Parameters of an effect by name ("gain", not "slip_sinkage_gain"), cut to their bounds.

    They are those that its form frees, those that the form sets, and the references, which the
    table sets.
    """
    numbers = {**problem.effects((choice,), values)._asdict(), **values}
    out = {}
    for p in LISTED[choice.effect].parameters:
        full = f"{choice.effect}_{p.name}"
        if full in choice.free or full in choice.fixed or p.name.startswith("reference_"):
            out[p.name] = min(max(float(numbers[full]), p.low), p.high)
    return out


def corrected(found: Prediction, named: Sequence[str] = ()) -> WheelSoilModel:
    """The model of a prediction that can be simulated: its soil, its effects, and the rest as a
    table.

    In the rest are errors of the rig, effects that only sensors feel (`SENSED`), and effects that
    together change no value by `LITTLE`. Exceptions: a `SENSED` effect that is `named` stays an
    effect, and so does `soil_flow`, which braked wheels would show. A named error of the rig and
    the tilt of the setup are in neither, since the world is no rig. The steps of the table grow by
    `COARSER` until it has at most `MOST` nodes.
    """
    problem = found.problem
    left = [name for name in (*INSTRUMENT, *SENSED) if name not in {*named} & {*SENSED}]
    choices = tuple(c for c in found.law.choices if c.effect not in left)
    output = problem.predict(found.values, choices, sinkage_guess(found.output))
    # `output` stays that of all effects: those that are left out change little even together.
    for name in dict.fromkeys(c.effect for c in choices if c.effect != "soil_flow"):
        fewer = tuple(c for c in choices if c.effect != name)
        there = problem.predict(found.values, fewer, sinkage_guess(output))
        if np.max(np.abs(there - output) / problem.noise) < LITTLE:
            choices = fewer
    model = model_of(problem, choices, found.values)
    coarse = 1.0
    while math.prod(x.size for x in _nodes(found, coarse).values()) > MOST:
        coarse *= COARSER
    without = [*(name for name in named if name in INSTRUMENT), "tilt_deg"]
    return replace(model, remainder=_remainder(found, model, _nodes(found, coarse), without))


def _remainder(
    found: Prediction,
    model: WheelSoilModel,
    nodes: Conditions,
    without: Sequence[str],
) -> ResidualTable:
    """The table of a prediction less `model`, at all combinations of the `nodes` of each condition.

    Its values are sinkage over radius, pull over load, torque over load times radius, cut to
    ±`LARGEST`; 0 where the model has no value. Beside them are the standard deviations of the
    prediction, cut to `MOST_SD`. Its axes are the nodes as dimensionless groups
    (`residual.GROUPS`).

    Conditions without nodes are at their medians, and the ground is then level. Slip always has
    nodes, which are true slips. `without`: errors of the rig that the prediction leaves out.
    """
    grid = np.stack(np.meshgrid(*nodes.values(), indexing="ij"), axis=-1).reshape(-1, len(nodes))
    count = len(grid)
    at = _medians(found.problem, ("load", "speed", "pass"), count)
    at |= dict(zip(nodes, grid.T, strict=True))
    bias = {"offset": 0.0, "radius_error": 0.0} | model.effects.get("slip_bias", {})
    # Model and prediction take the slip as the rig measures it: from true to measured slips, as by
    # `slip_bias.measured_slip`.
    scale = np.full(count, 1.0 / (1.0 - bias["radius_error"]))
    at["slip"] = np.clip(slips_of_radius(at["slip"] - bias["offset"], scale), -1.0, 1.0)
    # The nodes go beyond the range of the model, which may have no law of grades.
    with warnings.catch_warnings(action="ignore"):
        law = np.stack(model.predict(at)[:3], axis=1)
    radius = model.wheel.radius
    size = np.stack([np.full(count, radius), at["load"], at["load"] * radius], axis=1)
    mean, sd = found.at(at, without)
    left = np.clip(np.nan_to_num(mean - law) / size, -LARGEST, LARGEST)
    columns = np.concatenate([left, np.minimum(sd / size, MOST_SD)], axis=1)
    # Values in four digits, deviations in two; + 0.0 makes -0 a 0.
    text = [
        " ".join(f"{x + 0.0:.{4 if k < len(CHANNELS) else 2}g}" for x in column)
        for k, column in enumerate(columns.T)
    ]
    axes = {name.removesuffix("_deg"): tuple(_groups(model, name, x)) for name, x in nodes.items()}
    return ResidualTable(axes, dict(zip(COLUMNS, text, strict=True)))


def _medians(problem: Problem, names: Sequence[str], count: int) -> dict[str, np.ndarray]:
    """Median in the table of each of the conditions `names`, as arrays of `count` equal values."""
    conditions = problem.data.conditions
    return {name: np.full(count, np.median(conditions[name])) for name in names}


class Guess(NamedTuple):
    """Corner of the remainder's table at which a prediction is least sure (`least_sure`)."""

    conditions: dict[str, float]  # by the columns of a table
    mean: np.ndarray  # [3] predicted sinkage [m], pull [N], torque [N m]
    sd: np.ndarray  # [3]
    #: sd over the largest sd at the conditions of the table, mean of the channels in use.
    times: float


def least_sure(found: Prediction) -> Guess | None:
    """The corner of the remainder's table where the standard deviation is largest, relative to the
    largest at the measured conditions, in the mean of the channels in use.

    Conditions that are no axis of the table are at their medians and not named. None where the
    wheel sinks deeper than `predictive.DEEPEST` radii in every corner.
    """
    problem = found.problem
    nodes = _nodes(found, 1.0)
    corners = np.array(list(product(*((x[0], x[-1]) for x in nodes.values()))))
    at = dict(zip(nodes, corners.T, strict=True))
    there = found.at(_medians(problem, ("load", "speed", "pass", "grade_deg"), len(corners)) | at)
    known = found.at(problem.data.conditions).sd.max(axis=0)
    times = np.mean((there.sd / known)[:, problem.seen], axis=1)
    wheel = problem.data.wheel
    times[there.mean[:, 0] > DEEPEST * wheel.radius] = 0.0
    k = np.argmax(times)
    if times[k] == 0.0:
        return None
    sizes = dict(zip(WHEEL, (wheel.radius, wheel.width, wheel.grouser_height), strict=True))
    point = {n: float(x[k]) for n, x in at.items()}
    # The wheel is that of the setup, and so is told where rows have others.
    point |= {n: x for n, x in sizes.items() if np.any(problem.data.conditions[n] != x)}
    return Guess(point, there.mean[k], there.sd[k], float(times[k]))


def _nodes(found: Prediction, coarse: float) -> dict[str, np.ndarray]:
    """Nodes of the remainder's table by condition that varies, in units of a measurement table.

    Slip and load go beyond the measured range, in steps `coarse` times the usual; those of the load
    are of its logarithm. Slip has a node at 0 if others lie on both sides of it, begins at 0 where
    no row is braked, and is within ±`MOST_SLIP`. Other conditions have at most `FEW` of their
    measured values, evenly picked.
    """
    problem = found.problem
    out = {}
    for name in independent(problem):
        if name in WHEEL:  # a table has no axis for the wheel
            continue
        x = problem.data.conditions[name]
        low = x.min()
        high = x.max()
        if name in STEPS:
            step = coarse * max(STEPS[name] * found.learnt.lengths[name], LEAST_STEP[name])
        if name == "slip":
            start = max(low - BEYOND_SLIP, -MOST_SLIP) if low < 0.0 else 0.0
            end = min(high + BEYOND_SLIP, MOST_SLIP)
            ends = [start, *([0.0] if start < 0.0 < end else []), end]
            parts = [np.linspace(a, b, math.ceil((b - a) / step) + 1) for a, b in pairwise(ends)]
            out[name] = np.unique(np.concatenate(parts))
        elif name == "load":
            low /= BEYOND_LOAD
            high *= BEYOND_LOAD
            out[name] = np.geomspace(low, high, math.ceil(math.log(high / low) / step) + 1)
        else:
            values = np.unique(np.round(x, 6))
            some = np.linspace(0, values.size - 1, min(values.size, FEW)).round().astype(int)
            out[name] = values[some]
    return out


@kept
def groups_at(point: WorkingPoint, soil: SoilState, rim: Rim, gravity: float) -> tuple[float, ...]:
    """`dimensionless_groups` in the order of `GROUPS`, compiled for a call from Python.

    `gravity` in m/s2.
    """
    found: tuple[float, ...] = dimensionless_groups(point, soil, rim, gravity)
    return found


def _groups(model: WheelSoilModel, name: str, values: np.ndarray) -> list[float]:
    """Values of the dimensionless group (`residual.GROUPS`) that belongs to a condition.

    `name`: the condition, `values` of it in units of a measurement table.
    """
    assert model.soil is not None
    wheel = model.wheel
    rim = Rim(wheel.radius, wheel.width, 0.0, 0.0)
    group = name.removesuffix("_deg")
    field = {"pass": "passes", "grade": "sin_grade"}.get(group, group)
    if group == "grade":
        values = np.sin(np.radians(values))
    out = []
    for x in values.tolist():
        # Of the fields only that one counts for its group; the others have any value.
        point = WorkingPoint(
            slip=0.0, sinkage=0.0, load=1.0, speed=0.0, passes=1.0, sin_grade=0.0
        )._replace(**{field: x})
        soil = model.soil.under(wheel.radius, wheel.width, point.load, model.gravity)
        out.append(float(groups_at(point, soil, rim, model.gravity)[GROUPS.index(group)]))
    return out
