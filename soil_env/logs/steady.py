"""Steady stretches of a log as points of a measurement table (`measurement.table`).

A stretch is steady where the means of its two halves agree in slip, speed, pull, torque and pitch, and where sinkage
has come to what the slip makes of it. Sinkage follows dz/dt = A (z_end - z), A = (|V| + recovery |r w - V|)/l
(`effects.excavation_rate`): from a change dz between the halves, a time T/2 apart, there is dz/(1 - exp(-A T/2)) to go.

Each point belongs to a ground, the stretch between two borders to another soil as the filter found them (`replay`). The
filter finds a border some centimetres late, so that points within `belief.border` of one are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from soil_env.logs.align import Aligned
from soil_env.logs.mapping import LogMap
from soil_env.measurement.table import MEASURED
from soil_env.online import slips
from soil_env.slip import travel_speeds
from soil_env.terramechanics.effects import excavation_rate

_COLUMNS = ("slip", "load", "speed", "grade_deg", "run", "time", *MEASURED)
_LEAST_SD = 1e-9
_LEAST_SPREAD = 0.01  # of slip, for a table

Point = dict[str, float | str]  # columns of a measurement table, ground and start [s]; NaN = not measured


@dataclass(frozen=True, eq=False)
class Steady:
    """Steady points and the noise of their means."""

    rows: list[Point] = field(default_factory=list)
    noise: dict[str, float] = field(default_factory=dict)  # 1-sigma of a row's value, by column

    @property
    def reason(self) -> str:
        """Reason for which the points are no measurement table; empty where they are one."""
        if not self.rows:
            return "no stretch of the log is steady enough (windows in map.yaml) and has sinkage, pull or torque"
        slip = [float(row["slip"]) for row in self.rows]
        if max(slip) - min(slip) < _LEAST_SPREAD:
            many = "1 steady point" if len(slip) == 1 else f"{len(slip)} steady points of one slip"
            return f"{many}: a measurement table has at least two slips"
        return ""

    def table(self) -> str:
        """The measurement table as CSV; columns that no row has are left out."""
        names = [n for n in _COLUMNS if any(r[n] == r[n] for r in self.rows)]
        cells = [[cell(r[n], ".9g") for n in names] for r in self.rows]
        return "\n".join(",".join(line) for line in (names, *cells)) + "\n"

    def on(self, ground: int) -> Steady:
        """The points of one ground."""
        return Steady([row for row in self.rows if row["ground"] == ground], self.noise)


def cell(value: float | str, form: str) -> str:
    """Text of a value; empty for NaN."""
    return value if isinstance(value, str) else "" if value != value else format(value, form)


def steady_windows(log: Aligned, log_map: LogMap, ground: np.ndarray | None = None) -> Steady:
    """The steady stretches of a log, none overlapping another, each as long as `log_map.windows.duration`.

    `ground` [N] is that of `Replay`, one more from each border on; left out, all is one ground.
    """
    columns, where = _columns(log, log_map), log.travelled(log_map.wheel.radius)
    ground = np.ones(len(log), np.int64) if ground is None else ground
    runs, n = _drives(log, columns["rim"], log_map), round(log_map.windows.duration / log.period)
    borders = where[1:][np.diff(ground) != 0]
    between = np.all(np.abs(where[:, None] - borders) > log_map.belief.border, axis=1)
    rows, residuals, at = [], {name: [] for name in (*MEASURED, "slip", "load")}, 0
    while at + n <= len(log):
        here, last = slice(at, at + n), at + n - 1
        part = {name: values[here] for name, values in columns.items()}
        one_drive = runs[at] >= 0 and runs[at] == runs[last] and between[here].all() and ground[at] == ground[last]
        if not (one_drive and is_steady(part, log.period, log_map)):
            at += max(1, n // 4)
            continue
        row = _row(part, float(log.time[at]), log.period)
        if any(row[name] == row[name] for name in MEASURED) and row["load"] > 0.0:
            rows.append(row | {"run": f"ground{ground[at]}.drive{runs[at]}", "ground": int(ground[at])})
            for name, scatter in residuals.items():
                scatter.append(_scatter(part[name]))
        at += n
    noise = {}
    for name, scatter in residuals.items():
        pooled = math.sqrt(float(np.nanmean(np.square(scatter)))) if np.isfinite(scatter).any() else 0.0
        if pooled > _LEAST_SD and (name != "load" or "load" in log.readings):
            noise[name] = pooled / math.sqrt(n)
    return Steady(rows, noise)


def _columns(log: Aligned, log_map: LogMap) -> dict[str, np.ndarray]:
    """Quantities [N] of steady points; the weight for the load, and the like, where a channel is not measured."""
    rim, pitch, mass = log.get("wheel_speed") * log_map.wheel.radius, log.get("pitch"), log_map.wheel.body_mass
    slip = np.where(np.isnan(log.get("slip")), slips(rim, log.get("speed")), np.clip(log.get("slip"), -1.0, 1.0))
    motor = log.get("motor_torque")
    if "motor_torque" in log.readings and len(log) > 1 and log_map.wheel.inertia is not None:
        motor = motor - log_map.wheel.inertia * np.gradient(log.get("wheel_speed"), log.time)

    def first(name: str, other: np.ndarray) -> np.ndarray:
        return np.where(np.isnan(log.get(name)), other, log.get(name))

    return {
        "slip": slip,
        "speed": first("speed", travel_speeds(rim, slip)),
        "rim": rim,
        "load": first("load", log_map.weight * np.cos(np.nan_to_num(pitch))),
        "pitch": pitch,
        "sinkage": log.get("sinkage"),
        "drawbar_pull": first("drawbar_pull", log.get("acceleration") * mass),
        "torque": first("torque", motor),
    }


def _drives(log: Aligned, rim: np.ndarray, log_map: LogMap) -> np.ndarray:
    """Number [N] of the drive of each step, between halts and gaps; -1 where the wheel stands."""
    driving = np.abs(rim) > log_map.windows.wheel_speed * log_map.wheel.radius
    gap = np.diff(log.time, prepend=log.time[:1]) > 1.5 * log.period
    begins = driving & (gap | ~np.concatenate(([False], driving[:-1])))
    return np.where(driving, np.cumsum(begins) - 1, -1)


def is_steady(part: dict[str, np.ndarray], period: float, log_map: LogMap) -> bool:
    """True if the columns [n] of a stretch are steady within the limits of `log_map.windows`."""
    w, radius, weight = log_map.windows, log_map.wheel.radius, log_map.weight
    n = part["slip"].size
    if np.isnan(part["slip"]).any() or np.isnan(part["speed"]).any() or np.mean(part["speed"]) < 0.0:
        return False
    rim = float(np.mean(np.abs(part["rim"])))
    speeds = float(np.mean(np.abs(part["speed"]))), float(np.mean(np.abs(part["rim"] - part["speed"])))
    rate, _ = excavation_rate(*speeds, 0.0, log_map.belief.dig_recovery, log_map.relaxation * radius)
    come = -math.expm1(-rate * (n / 2) * period)
    limits = {
        "slip": w.slip_change,
        "speed": w.speed_change * rim,
        "rim": w.speed_change * rim,
        "pitch": w.pitch_change,
        "load": w.pull_change * weight,
        "drawbar_pull": w.pull_change * weight,
        "torque": w.torque_change * weight * radius,
        "sinkage": w.sinkage_left * radius * come,
    }
    return all(_change(part[name]) <= limit for name, limit in limits.items())


def _change(values: np.ndarray) -> float:
    """Difference of the means of the two halves; 0 where nothing is measured."""
    first, second = values[: values.size // 2], values[values.size // 2 :]
    if np.isnan(first).all() or np.isnan(second).all():
        return 0.0
    return abs(float(np.nanmean(second) - np.nanmean(first)))


def _scatter(values: np.ndarray) -> float:
    """Standard deviation about a straight line; NaN where a value is missing."""
    if np.isnan(values).any():
        return math.nan
    x = np.linspace(-1.0, 1.0, values.size)
    residual = values - values.mean() - x * (x @ values) / (x @ x)
    return math.sqrt(float(residual @ residual) / (values.size - 2))


def _row(part: dict[str, np.ndarray], start: float, period: float) -> Point:
    """The means of a stretch that begins at `start` [s]; NaN where half of the values are missing."""
    mean = {n: float(np.nanmean(v)) if np.isfinite(v).mean() > 0.5 else math.nan for n, v in part.items()}
    time = start + 0.5 * (part["slip"].size - 1) * period
    row: Point = {name: mean[name] for name in ("slip", "load", "speed", *MEASURED)}
    return row | {"grade_deg": math.degrees(mean["pitch"]), "time": time, "start": start}
