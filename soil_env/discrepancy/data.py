"""A measurement table made ready for the search: conditions, noise, outliers, groups to hold out.

The reference for noise and outliers is a *smooth surface* through the data: the calibrated base model plus polynomials
of the conditions in every channel. Whatever effect is missing, it is smooth in the conditions; single values that leave
the surface are not an effect.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.measurement.table import MEASURED, Setup, Table
from soil_env.terramechanics.model import ModelWheel, Rows, rows_of

CHANNELS = MEASURED  # sinkage, drawbar_pull, torque
UNKNOWN_HEIGHT = 0.08  # [radii] lug height where the setup gives none
OUTLIER = 4.5  # [sd] distance from the smooth surface beyond which a value is left out
LEAST_PRESSURE, MOST_PRESSURE = 20.0, 1e7  # [Pa] load over radius times width, beyond which the unit is wrong
MOST_FORCE = 5.0  # pull over load, torque over load times radius, beyond which the unit is wrong
LEAST_NOISE = 1e-5  # scatter over the size of the values below which they are rounded or computed, not measured
REPEAT_SLIP = 0.02  # largest difference of slip within repeats
REPEAT_LOAD = 0.2  # largest difference of load within repeats, over their mean
_SAME = 0.02  # relative difference below which two values of a condition are one level
_SAME_SLIP = 0.005
_SAME_GRADE = 0.1  # [deg]


@dataclass(frozen=True, eq=False)
class Conditions:
    """A condition that varies in the table: its values [N], levels [N] int, and values scaled to [-1, 1]."""

    name: str
    value: np.ndarray
    level: np.ndarray
    scaled: np.ndarray

    @property
    def levels(self) -> int:
        """Number of distinct levels."""
        return int(self.level.max()) + 1


@dataclass(frozen=True, eq=False)
class Data:
    """The table as the fits take it; arrays [N] or [N, 3] with the channels in the order of `CHANNELS`."""

    table: Table
    setup: Setup
    wheel: ModelWheel
    rows: Rows
    y: np.ndarray  # [N, 3] measured, nan where not
    varied: dict[str, Conditions]  # slip first
    cell: np.ndarray  # [N] int, rows of one cell are repeats

    @property
    def measured(self) -> np.ndarray:
        """[N, 3] True where a value was measured."""
        return np.isfinite(self.y)


def prepare(table: Table, setup: Setup) -> Data:
    """`Data` of a table and its setup. Raises `ParameterError` where nothing could be learned from it."""
    height = setup.wheel.grouser_height
    wheel = ModelWheel(
        setup.wheel.radius,
        setup.wheel.width,
        UNKNOWN_HEIGHT * setup.wheel.radius if height is None else height,
    )
    rows = rows_of(table, wheel)
    if "speed" not in table.given or not np.any(np.isfinite(table.speed)):
        rows.conditions[:, 0] = 0.0
    elif np.any(np.isnan(table.speed)):
        k = int(np.flatnonzero(np.isnan(table.speed))[0])
        raise ParameterError(f"{table.source}: row {table.row[k]}, speed is empty: expected it in every row or in none")
    y = np.stack([getattr(table, name) for name in CHANNELS], axis=1)
    _refuse_units(table, rows, y)
    varied = {}
    for name, value, log in (
        ("slip", rows.slip, False),
        ("load", rows.load, True),
        ("speed", rows.conditions[:, 0], True),
        ("pass", rows.conditions[:, 1], True),
        ("grade_deg", np.degrees(np.arcsin(rows.conditions[:, 2])), False),
    ):
        found = _condition(name, value, log)
        if found.levels > 1:
            varied[name] = found
    if "slip" not in varied:
        raise ParameterError(f"{table.source}: slip: expected at least two different slips")
    labels = np.stack([c.level for c in varied.values()] + [np.unique(rows.wheels, axis=0, return_inverse=True)[1]])
    cell = np.unique(labels, axis=1, return_inverse=True)[1].ravel()
    return Data(table, setup, wheel, rows, y, varied, cell)


def _refuse_units(table: Table, rows: Rows, y: np.ndarray) -> None:
    """`ParameterError` where a whole column has a unit or a sign that cannot be right."""

    def refuse(wrong, text: str) -> None:
        if wrong:
            raise ParameterError(f"{table.source}: {text}")

    load, size = rows.load, rows.wheels[:, 0]
    pressure = float(np.median(load / (size * rows.wheels[:, 1])))
    shown = f"load is {np.median(load):.3g} N in the middle of the rows, {pressure:.3g} Pa on radius times width"
    refuse(pressure < LEAST_PRESSURE, f"{shown}: expected newtons (if it is kN, multiply by 1000)")
    refuse(pressure > MOST_PRESSURE, f"{shown}: expected newtons")
    for j, name, unit, over in ((1, "drawbar_pull", "newtons", load), (2, "torque", "newton metres", load * size)):
        ratio = np.abs(y[:, j]) / over
        ratio = ratio[np.isfinite(ratio)]
        if ratio.size and np.median(ratio) > MOST_FORCE:
            times = "the load" if j == 1 else "load times radius"
            refuse(True, f"{name} is {np.median(ratio):.3g} times {times} in the middle of the rows: expected {unit}")
    z = y[:, 0]
    if np.any(np.isfinite(z)) and np.nanmax(z) < 0.0:
        known = np.isfinite(z)
        slope = np.polyfit(load[known], z[known], 1)[0] if np.ptp(load[known]) > 0.05 * load.mean() else 0.0
        refuse(slope <= 0.0, "sinkage is negative in every row: expected metres below the surface, positive downward")
    driven = y[(rows.slip > 0.05) & np.isfinite(y[:, 2]), 2]
    refuse(
        driven.size > 2 and np.max(driven, initial=-math.inf) < 0.0,
        "torque is negative in every row with slip > 0.05: expected the driving torque, positive where it drives",
    )


def _condition(name: str, value: np.ndarray, log: bool) -> Conditions:
    """Levels by gaps: values closer than 2 % of the span (or of themselves) are one level."""
    x = np.log(np.maximum(value, 1e-9)) if log else value
    span = float(np.ptp(x))
    gap = max(0.02 * span, math.log(1.0 + _SAME) if log else (_SAME_SLIP if name == "slip" else _SAME_GRADE))
    order = np.argsort(x, kind="stable")
    steps = np.diff(x[order]) > gap
    level = np.empty(x.size, dtype=int)
    level[order] = np.concatenate([[0], np.cumsum(steps)])
    if name in ("slip", "load", "speed", "grade_deg") and level.max() > max(12, x.size // 4):
        # a continuum of values: cut it into bins of equal count
        bins = min(8, x.size // 6)
        level[order] = np.arange(x.size) * max(bins, 2) // x.size
    scaled = (x - 0.5 * (x.min() + x.max())) / (0.5 * span) if span > gap else np.zeros_like(x)
    return Conditions(name, value, level, scaled)


def smooth_basis(data: Data) -> np.ndarray:
    """[N, B] polynomials of the varied conditions: up to the third power of slip, second of the others, and products.

    Never more columns than half the cells.
    """
    s = data.varied["slip"].scaled
    columns = [np.ones_like(s), s]
    if data.varied["slip"].levels > 2:
        columns.append(s * s)
    if data.varied["slip"].levels > 4:
        columns.append(s**3)
    others = [c for name, c in data.varied.items() if name != "slip"]
    columns += [c.scaled for c in others]
    columns += [s * c.scaled for c in others]
    columns += [c.scaled**2 for c in others if c.levels > 2]
    columns += [a.scaled * b.scaled for i, a in enumerate(others) for b in others[i + 1 :]]
    cells = int(data.cell.max()) + 1
    return np.stack(columns[: max(2, cells // 2)], axis=1)


def folds(data: Data) -> list[list[np.ndarray]]:
    """Ways to cut the table into groups that are held out one at a time, each group [N] bool.

    One way holds out every slip; where other conditions vary too, a second holds out every combination of those.
    """
    slip = data.varied["slip"]
    ways = [[slip.level == k for k in range(slip.levels)]]
    others = [c.level for name, c in data.varied.items() if name != "slip"]
    if others:
        label = np.unique(np.stack(others), axis=1, return_inverse=True)[1].ravel()
        if label.max() >= 2:
            ways.append([label == k for k in range(int(label.max()) + 1)])
    return ways


def repeat_noise(data: Data, model: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(sd [3], degrees of freedom [3]) of the scatter of measured minus `model` [N, 3] within cells.

    The model takes up the small differences of slip and load that repeats have; cells with larger ones do not count.
    """
    left, total, freedom = data.y - model, np.zeros(3), np.zeros(3)
    for k in range(int(data.cell.max()) + 1):
        inside = data.cell == k
        load = data.rows.load[inside]
        if inside.sum() < 2 or np.ptp(data.rows.slip[inside]) > REPEAT_SLIP or np.ptp(load) > REPEAT_LOAD * load.mean():
            continue
        for j in range(3):
            v = left[inside, j]
            v = v[np.isfinite(v)]
            if v.size > 1:
                total[j] += np.sum((v - v.mean()) ** 2)
                freedom[j] += v.size - 1
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(total / freedom), freedom


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of the channels and the values that count."""

    sd: np.ndarray  # [3]
    freedom: np.ndarray  # [3] of the estimate; inf where the setup gives it
    origin: tuple[str, ...]  # [3] "setup", "repeats", "scatter" or "" where not measured
    used: np.ndarray  # [N, 3] bool
    outliers: int  # values that were left out


def find_noise(data: Data, model: np.ndarray) -> Noise:
    """`Noise` from the setup, else from repeats, else from the scatter about the smooth surface through the data.

    `model` [N, 3]: the calibrated base model, to which the surface adds polynomials. Values further than `OUTLIER` sd
    from the surface are left out one after the other.
    """
    given = [getattr(data.setup.noise, name) for name in CHANNELS]
    sd, freedom = repeat_noise(data, model)
    basis = smooth_basis(data)
    used, out_sd, out_freedom, origin = data.measured.copy(), np.ones(3), np.full(3, math.inf), [""] * 3
    for j, name in enumerate(CHANNELS):
        if not used[:, j].any():
            continue
        e = data.y[:, j] - model[:, j]
        if given[j] is not None:
            out_sd[j], origin[j] = given[j], "setup"
        elif freedom[j] >= 6:
            origin[j] = "repeats"
        else:
            origin[j] = "scatter"
        spare = int(used[:, j].sum()) - basis.shape[1]
        if origin[j] == "scatter" and spare < 3:
            raise ParameterError(
                f"{data.table.source}: noise of {name}: cannot be told from {int(used[:, j].sum())} values without "
                "repeats; expected noise in the setup, or repeated points"
            )
        if spare < 3:
            out_sd[j] = out_sd[j] if origin[j] == "setup" else sd[j]
            continue
        keep = used[:, j].copy()
        for _ in range(max(1, int(0.06 * keep.sum())) + 1):
            left, leverage = _surface(basis, e, keep)
            scale = out_sd[j]
            if origin[j] != "setup":
                median = float(np.median(np.abs(left[keep]) / np.sqrt(np.maximum(1.0 - leverage[keep], 0.05))))
                scale = max(1.4826 * median, 1e-12)
            far = np.abs(left) / (scale * np.sqrt(np.maximum(1.0 - leverage, 0.05)))
            far[~keep | (leverage > 0.8)] = 0.0
            worst = int(np.argmax(far))
            if far[worst] <= OUTLIER:
                break
            keep[worst] = False
        # values that a first outlier had masked come back
        left, leverage = _surface(basis, e, keep)
        if origin[j] == "setup":
            back = used[:, j] & (np.abs(left) <= OUTLIER * out_sd[j] * np.sqrt(1.0 + leverage))
            keep |= back
        used[:, j] = keep
        if origin[j] == "scatter":
            left, _ = _surface(basis, e, keep)
            out_freedom[j] = keep.sum() - basis.shape[1]
            out_sd[j] = math.sqrt(float(np.sum(left[keep] ** 2)) / out_freedom[j])
    if "repeats" in origin:
        cleaned = dataclasses.replace(data, y=np.where(used, data.y, math.nan))
        sd, freedom = repeat_noise(cleaned, model)
        for j in range(3):
            if origin[j] == "repeats":
                out_sd[j], out_freedom[j] = sd[j], freedom[j]
    for j, name in enumerate(CHANNELS):
        size = float(np.sqrt(np.mean(data.y[used[:, j], j] ** 2))) if used[:, j].any() else 0.0
        flat = used[:, j].any() and np.ptp(data.y[used[:, j], j]) == 0.0
        if origin[j] in ("repeats", "scatter") and (flat or out_sd[j] <= LEAST_NOISE * size):
            raise ParameterError(
                f"{data.table.source}: noise of {name}: the values hardly scatter, so it cannot be "
                "taken from them; expected noise in the setup"
            )
    return Noise(np.maximum(out_sd, 1e-12), out_freedom, tuple(origin), used, int(data.measured.sum() - used.sum()))


def _surface(basis, e, keep):
    """(residual [N], leverage [N]) of the least-squares surface through the kept values."""
    coefficients, *_ = np.linalg.lstsq(basis[keep], e[keep], rcond=1e-10)
    inverse = np.linalg.pinv(basis[keep].T @ basis[keep], rcond=1e-12)
    leverage = np.einsum("nb,bc,nc->n", basis, inverse, basis)
    return e - basis @ coefficients, np.where(keep, np.minimum(leverage, 1.0), leverage)
