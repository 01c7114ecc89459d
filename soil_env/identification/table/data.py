"""A measurement table made ready for the fits: its conditions as factors with levels, groups to
hold out.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.measurement.setup import Setup
from soil_env.measurement.table import MEASURED, Table
from soil_env.terramechanics.model import ModelWheel, Rows, rows_of
from soil_env.terramechanics.validity import columns_of

from .form_error import LOGARITHMIC

CHANNELS = MEASURED  # sinkage, drawbar_pull, torque
UNKNOWN_HEIGHT = 0.08  # [radii] lug height where the setup gives none
LEAST_PRESSURE = 100.0  # [Pa] load over radius times width, below which its unit is wrong
MOST_PRESSURE = 1e7  # [Pa] load over radius times width, above which its unit is wrong
#: Pull over load, or torque over load times radius, beyond which the unit is wrong.
MOST_FORCE = 5.0
LOAD_SPAN = 0.05  # range of the loads over their mean, from which sinkage is compared with load
SURELY_DRIVEN = 0.05  # slip above which a wheel needs a positive torque
TERMS = ("speed", "pass", "grade_deg")  # conditions that the base law does not know
#: Share of a condition's sd that the other conditions do not explain, below which it follows from
#: them.
OWN = 0.1
WHEEL = ("wheel_radius", "wheel_width", "grouser_height")
#: Difference below which two values of a condition are one level; relative where it is compared by
#: its ratio.
_SAME = {
    "slip": 0.005,
    "grade_deg": 0.1,
    "grouser_height": 1e-4,
    "wheel_radius": 0.005,
    "wheel_width": 0.005,
}
_SAME_RATIO = 0.02  # relative difference, likewise, of conditions that `_SAME` does not name
_SAME_SHARE = 0.02  # of the range of a condition: a smaller step parts no levels either
_CHAIN = 6.0  # [least step between levels] width of a level beyond which it is a continuum
# Own choices. A condition with more levels than both of these is a continuum:
_MOST_LEVELS = 12
_ROWS_OF_LEVEL = 4  # rows of the table over its levels
# It is cut into as many bins as both of these allow, but into two at least:
_MOST_BINS = 8
_ROWS_OF_BIN = 6


@dataclass(frozen=True, eq=False)
class Factor:
    """A condition of the table; `LOGARITHMIC` ones are scaled in the logarithm."""

    value: np.ndarray  # [N] in the unit of its column
    level: np.ndarray  # [N] int, number of the row's level as of `_factor`: 0 for the lowest values
    scaled: np.ndarray  # [N] value scaled to [-1, 1]; 0 where the condition does not vary

    @property
    def levels(self) -> int:
        """Number of distinct levels."""
        return int(self.level.max()) + 1


@dataclass(frozen=True, eq=False)
class Data:
    """The table as the fits take it; arrays [N] or [N, 3] with the channels in the order of
    `CHANNELS`.
    """

    table: Table
    setup: Setup
    wheel: ModelWheel  # of the setup, with the lugs of the rows where it says nothing of them
    rows: Rows  # [N] with slip by the rim; the speed 0 where the table has none
    y: np.ndarray  # [N, 3] measured values [m, N, N m]; nan where not measured
    varied: dict[str, Factor]  # conditions that vary by themselves; slip first
    cell: np.ndarray  # [N] int, combination of levels; rows of one cell are repeats
    relative_sd: np.ndarray  # [N, 3] noise of a value over that of its channel

    @property
    def measured(self) -> np.ndarray:
        """[N, 3] True where a value was measured."""
        known: np.ndarray = np.isfinite(self.y)
        return known

    @property
    def lugs_unknown(self) -> bool:
        """True where neither setup nor rows give a height of lugs, so that one is assumed."""
        bare = np.isnan(self.table.grouser_height)
        return self.setup.wheel.grouser_height is None and bool(np.all(bare))

    @property
    def conditions(self) -> dict[str, np.ndarray]:
        """Conditions [N] by the columns of a table; a speed of 0 is not known."""
        return conditions_of(self.rows)

    @property
    def group(self) -> np.ndarray:
        """[N] number from 0 of the combination of the levels of all conditions but slip; 0 in all
        rows where nothing else varies.
        """
        others = [c.level for name, c in self.varied.items() if name != "slip"]
        return combinations_of(others or [np.zeros_like(self.cell)])

    @property
    def groups(self) -> list[np.ndarray]:
        """Indices [n] of the rows of each `group`."""
        label = self.group
        return [np.flatnonzero(label == k) for k in range(label.max() + 1)]

    @property
    def beds(self) -> np.ndarray:
        """[N] number of the bed of soil of each row, from 0.

        A row on fresh soil is on the bed of its `run`, a later pass on that of the last fresh row
        above it. Without any above it, it is on the bed of the first row of the table.
        """
        fresh = np.where(self.rows.conditions[:, 1] <= 1.0, np.arange(len(self.table)), 0)
        return np.unique(self.table.run[np.maximum.accumulate(fresh)], return_inverse=True)[1]

    @property
    def elapsed(self) -> dict[str, np.ndarray]:
        """{"elapsed": time [N] since the earliest row, over the span of the times}; empty where a
        time is missing or all are the same.
        """
        time = self.table.time
        known = np.all(np.isfinite(time)) and np.ptp(time) > 0.0
        return {"elapsed": (time - time.min()) / np.ptp(time)} if known else {}


def combinations_of(levels: Sequence[np.ndarray]) -> np.ndarray:
    """[N] number from 0 of the combination of levels in each row; `levels`: those of each condition
    [N].
    """
    return np.unique(np.stack(levels), axis=1, return_inverse=True)[1].ravel()


def conditions_of(rows: Rows) -> dict[str, np.ndarray]:
    """Conditions [N] of rows by the columns of a table, in their units."""
    return columns_of(rows) | dict(zip(WHEEL, rows.wheels.T, strict=True))


def prepare(table: Table, setup: Setup) -> Data:
    """`Data` of a table and its setup.

    Where the setup gives no height of lugs, that of its wheel is the median of the rows, in radii,
    and without any `UNKNOWN_HEIGHT`. A speed that no row gives is 0. Of the conditions that vary,
    those that follow from others before them are no factors.

    Raises `ParameterError` for one slip only, for speeds in some rows only, and for heights in some
    rows only where the setup gives none. Impossible units are refused too (`_refuse_units`).
    """
    # Columns that all rows must have or none, and what the message allows beside all.
    otherwise = {"speed": " or in none"}
    stated = setup.wheel
    height = stated.grouser_height
    if height is None:
        otherwise = {"grouser_height": ", or wheel.grouser_height in the setup"} | otherwise
        # over the radius, since rows may have wheels of other sizes
        median = float(np.median(table.grouser_height / table.radius(stated)))
        height = stated.radius * (UNKNOWN_HEIGHT if math.isnan(median) else median)
    wheel = ModelWheel(stated.radius, stated.width, height)
    rows = rows_of(table, wheel)._replace(slip=table.rim_slip(setup).copy())
    for name, allowed in otherwise.items():
        empty = np.isnan(getattr(table, name))
        if np.any(empty) and not np.all(empty):
            raise ParameterError(
                f"{table.source}: row {table.row[empty][0]}, {name} is empty: expected it in every "
                f"row{allowed}"
            )
    y = table.values
    _refuse_units(table, setup, rows, y)
    varied: dict[str, Factor] = {}
    for name, value in conditions_of(rows).items():
        found = _factor(name, value)
        same = name in WHEEL and any(_one_to_one(found, varied[w]) for w in WHEEL if w in varied)
        # Of sizes that change together one stands for the wheel. A speed that follows from the
        # slip, as at one rim speed, is no condition of its own. A grade set by a Latin square of
        # load and speed is one: no sum of functions of these two gives it.
        if found.levels > 1 and not same and not (name in TERMS and _follows(found, varied)):
            varied[name] = found
    if "slip" not in varied:
        raise ParameterError(f"{table.source}: slip: expected at least two different slips")
    cell = combinations_of([c.level for c in varied.values()])
    return Data(table, setup, wheel, rows, y, varied, cell, table.relative_sd(setup))


def _one_to_one(a: Factor, b: Factor) -> bool:
    """True if the levels of two factors divide the rows into the same groups."""
    return bool(combinations_of([a.level, b.level]).max() + 1 == a.levels == b.levels)


def _follows(factor: Factor, others: Mapping[str, Factor]) -> bool:
    """True if a factor follows from the others: they leave less than `OWN` of its sd unexplained.

    The fit is a sum of functions of one other factor each, with a free value at every level.
    """
    value = factor.scaled
    levels = (np.eye(o.levels)[o.level] for o in others.values())
    functions = np.hstack([np.ones((value.size, 1)), *levels])
    own = value - functions @ np.linalg.lstsq(functions, value, rcond=1e-9)[0]
    return bool(np.std(own) < OWN * np.std(value))


def _refuse_units(table: Table, setup: Setup, rows: Rows, y: np.ndarray) -> None:
    """`ParameterError` where a whole column has a unit or a sign that cannot be right.

    Load and forces are judged by their medians; `y` [N, 3] as in `Data`. Sinkages below 0
    throughout are refused unless they rise with the load, as sinkages with a wrong zero do. Torque
    is refused if negative in all of three or more driven rows, a normal load if the pull is 0 in
    all of two or more rows on grades.
    """

    def refuse(wrong: bool, text: str) -> None:
        """Raise `ParameterError` with the `text` if it is `wrong`."""
        if wrong:
            raise ParameterError(f"{table.source}: {text}")

    load = rows.load
    radius = rows.wheels[:, 0]
    pressure = np.median(load / (radius * rows.wheels[:, 1]))
    shown = (
        f"load is {np.median(load):.3g} N in the middle of the rows, {pressure:.3g} Pa on radius "
        "times width"
    )
    refuse(pressure < LEAST_PRESSURE, f"{shown}: expected newtons (if it is kN, multiply by 1000)")
    refuse(pressure > MOST_PRESSURE, f"{shown}: expected newtons")
    small = "newton millimetres or centimetres, divide by 1000 or 100"
    for column, name, unit, times, over, otherwise in (
        (1, "drawbar_pull", "newtons", "the load", load, "millinewtons, divide by 1000"),
        (2, "torque", "newton metres", "load times radius", load * radius, small),
    ):
        ratio = np.abs(y[:, column]) / over
        ratio = ratio[np.isfinite(ratio)]
        middle = np.median(ratio) if ratio.size else 0.0
        refuse(
            middle > MOST_FORCE,
            f"{name} is {middle:.3g} times {times} in the middle of the rows, where {times} is "
            f"{np.median(over):.3g}: expected {unit} (if it is {otherwise}; "
            "if load is in kilograms, multiply that by 9.81)",
        )
    z = y[:, 0]
    known = np.isfinite(z)
    if np.any(known) and np.all(z[known] < 0.0):
        slope = (
            np.polyfit(load[known], z[known], 1)[0]
            if np.ptp(load[known]) > LOAD_SPAN * load.mean()
            else 0.0
        )
        refuse(
            slope <= 0.0,
            "sinkage is negative in every row: expected metres below the surface, positive "
            "downward",
        )
    pull = y[(rows.conditions[:, 2] != 0.0) & np.isfinite(y[:, 1]), 1]
    refuse(
        setup.load == "normal" and pull.size > 1 and not np.any(pull),
        "drawbar_pull = 0 on every grade, as of a wheel that climbs by itself: expected load: "
        "vertical in the setup",
    )
    driven = y[(rows.slip > SURELY_DRIVEN) & np.isfinite(y[:, 2]), 2]
    refuse(
        driven.size > 2 and bool(np.all(driven < 0.0)),
        f"torque is negative in every row with slip > {SURELY_DRIVEN:g}: expected the driving "
        "torque, positive where it drives",
    )


def _factor(name: str, value: np.ndarray) -> Factor:
    """`Factor` of the condition `name` with these values [N]; `LOGARITHMIC` ones are compared by
    their ratio.

    A step between sorted values that is larger than a gap parts two levels. The gap is
    `_SAME_SHARE` of the range, but at least the difference that does not count (`_SAME`). Slip,
    load, speed and grade are a continuum if they have too many levels, or one that is wider than
    `_CHAIN` gaps. Bins of equal count are the levels of a continuum.
    """
    same = _SAME.get(name, _SAME_RATIO)
    x = value
    if name in LOGARITHMIC:
        # A speed of 0, which is not known, counts as the least that is.
        x = np.log(np.maximum(value, np.min(value, where=value > 0.0, initial=value.max() or 1.0)))
        same = math.log(1.0 + same)
    span = np.ptp(x)
    gap = max(_SAME_SHARE * span, same)
    order = np.argsort(x, kind="stable")
    rising = x[order]
    steps = np.diff(rising) > gap
    level = np.empty(x.size, int)
    level[order] = np.concatenate([[0], np.cumsum(steps)])
    widest = max(map(np.ptp, np.split(rising, np.flatnonzero(steps) + 1)))
    many = level.max() > max(_MOST_LEVELS, x.size // _ROWS_OF_LEVEL)
    if name in ("slip", "load", "speed", "grade_deg") and (many or widest > _CHAIN * gap):
        bins = max(2, min(_MOST_BINS, x.size // _ROWS_OF_BIN))
        first = np.searchsorted(rising, rising)  # equal values stay together
        # Numbers of bins without a gap: a value that many rows have may fill more than one.
        level[order] = np.unique(first * bins // x.size, return_inverse=True)[1]
    scaled = (x - 0.5 * (x.min() + x.max())) / (0.5 * span) if span > gap else np.zeros_like(x)
    return Factor(value, level, scaled)


def folds(data: Data) -> list[np.ndarray]:
    """Cross-validation folds: one or two ways to cut the table into groups, which are held out one
    at a time; for each way the number [N] from 0 of the group of each row.

    The groups of the first way are the levels of slip. Those of the second are the combinations of
    the other conditions, where there are more than two.
    """
    slip = data.varied["slip"].level
    others = data.group
    return [slip, others] if others.max() > 1 else [slip]
