"""Steady stretches of a log as points of a measurement table (`measurement.table`).

A stretch is steady where the means of its two halves agree in slip, speed, pull, torque and pitch, and where sinkage
has come to what the slip makes of it. Sinkage follows dz/dt = A (z_end - z), A = (|V| + recovery |r w - V|)/l
(`effects.excavation_rate`): from a change dz between the halves, a time T/2 apart, there is dz/(1 - exp(-A T/2)) to go.

Each point belongs to a ground, the stretch between two borders to another soil as the filter found them (`replay`). It
finds a border some centimetres behind it as a rule, so that what lies within `belief.border` of one is left out.
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


@dataclass(frozen=True, eq=False)
class Steady:
    """Steady points, a row each, and the scatter that their means are left with."""

    rows: list[dict[str, float | str]] = field(default_factory=list)  # columns of a measurement table; NaN = none
    ground: list[int] = field(default_factory=list)  # of each row, from 1 in the order of the drive
    start: list[float] = field(default_factory=list)  # [s] of each stretch
    noise: dict[str, float] = field(default_factory=dict)  # 1-sigma of a row's value, by column
    reason: str = ""  # why there is no table, if there is none

    def table(self) -> str:
        """The measurement table as CSV; columns that no row has are left out."""
        names = [n for n in _COLUMNS if any(r[n] == r[n] for r in self.rows)]
        cells = [[_text(r[n]) for n in names] for r in self.rows]
        return "\n".join(",".join(line) for line in (names, *cells)) + "\n"

    def on(self, ground: int) -> Steady:
        """The points of one ground."""
        kept = [k for k, g in enumerate(self.ground) if g == ground]
        rows, start = [self.rows[k] for k in kept], [self.start[k] for k in kept]
        return Steady(rows, [ground] * len(rows), start, self.noise, _reason(rows))


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else "" if value != value else f"{value:.9g}"


def steady_windows(log: Aligned, log_map: LogMap, ground: np.ndarray | None = None) -> Steady:
    """The steady stretches of a log, none overlapping another, each as long as `log_map.windows.duration`.

    `ground` [N] is that of `Replay`, one more from each border on; left out, all is one ground.
    """
    columns = _columns(log, log_map)
    rows, grounds, starts, residuals = [], [], [], {name: [] for name in (*MEASURED, "slip", "load")}
    n = round(log_map.windows.duration / log.period)
    runs = _runs(log, columns["rim"], log_map)
    ground = np.ones(len(log), np.int64) if ground is None else ground
    where = log.travelled(log_map.wheel.radius)
    found = where[1:][np.diff(ground) != 0]
    between = np.all(np.abs(where[:, None] - found) > log_map.belief.border, axis=1)
    at = 0
    while at + n <= len(log):
        part = {name: values[at : at + n] for name, values in columns.items()}
        of_one = between[at : at + n].all() and ground[at] == ground[at + n - 1]
        if runs[at] < 0 or runs[at] != runs[at + n - 1] or not of_one or not is_steady(part, log.period, log_map):
            at += max(1, n // 4)
            continue
        row = _row(part, float(log.time[at]), log.period, f"ground{ground[at]}.drive{runs[at]}")
        if row is not None:
            rows.append(row)
            grounds.append(int(ground[at]))
            starts.append(float(log.time[at]))
            for name, scatter in residuals.items():
                scatter.append(_scatter(part[name]))
        at += n
    noise = {}
    for name, scatter in residuals.items():
        pooled = math.sqrt(float(np.nanmean(np.square(scatter)))) if np.isfinite(scatter).any() else 0.0
        if pooled > _LEAST_SD and (name != "load" or "load" in log.readings):
            noise[name] = pooled / math.sqrt(n)
    return Steady(rows, grounds, starts, noise, _reason(rows))


def _reason(rows: list[dict[str, float | str]]) -> str:
    if not rows:
        return "no stretch of the log is steady enough (windows in map.yaml) and has sinkage, pull or torque"
    slip = [float(row["slip"]) for row in rows]
    if max(slip) - min(slip) < _LEAST_SPREAD:
        many = "1 steady point" if len(rows) == 1 else f"{len(rows)} steady points of one slip"
        return f"{many}: a measurement table has at least two slips"
    return ""


def _columns(log: Aligned, log_map: LogMap) -> dict[str, np.ndarray]:
    """What steady points are made of; where a channel is not measured what stands for it, else NaN."""
    nan = np.full(len(log), math.nan)
    get = {name: log.readings.get(name, nan) for name in (*MEASURED, "slip", "load", "pitch", "speed", "wheel_speed")}
    rim = get["wheel_speed"] * log_map.wheel.radius
    slip = np.where(np.isnan(get["slip"]), slips(rim, get["speed"]), np.clip(get["slip"], -1.0, 1.0))
    speed = np.where(np.isnan(get["speed"]), travel_speeds(rim, slip), get["speed"])
    weight = log_map.weight * np.cos(np.nan_to_num(get["pitch"]))
    pull = np.where(
        np.isnan(get["drawbar_pull"]), log.readings.get("acceleration", nan) * log_map.wheel.body_mass,
        get["drawbar_pull"],
    )  # fmt: skip
    motor = log.readings.get("motor_torque", nan)
    if "motor_torque" in log.readings and len(log) > 1 and log_map.wheel.inertia is not None:
        motor = motor - log_map.wheel.inertia * np.gradient(get["wheel_speed"], log.time)
    return {
        "slip": slip,
        "speed": speed,
        "rim": rim,
        "load": np.where(np.isnan(get["load"]), weight, get["load"]),
        "pitch": get["pitch"],
        "sinkage": get["sinkage"],
        "drawbar_pull": pull,
        "torque": np.where(np.isnan(get["torque"]), motor, get["torque"]),
    }


def _runs(log: Aligned, rim: np.ndarray, log_map: LogMap) -> np.ndarray:
    """Number [N] of the drive that each step belongs to, a drive being what is between halts and gaps; -1 = halted."""
    driving = np.abs(rim) > log_map.windows.wheel_speed * log_map.wheel.radius
    gap = np.diff(log.time, prepend=log.time[:1]) > 1.5 * log.period
    begins = driving & (gap | ~np.concatenate(([False], driving[:-1])))
    return np.where(driving, np.cumsum(begins) - 1, -1)


def is_steady(part: dict[str, np.ndarray], period: float, log_map: LogMap) -> bool:
    """Whether the columns [n] of a stretch are steady within the limits of `log_map.windows`."""
    w, radius, weight = log_map.windows, log_map.wheel.radius, log_map.weight
    n = part["slip"].size
    if np.isnan(part["slip"]).any() or np.isnan(part["speed"]).any() or np.mean(part["speed"]) < 0.0:
        return False
    rim = float(np.mean(np.abs(part["rim"])))
    sliding = np.abs(part["rim"] - part["speed"])
    speeds = float(np.mean(np.abs(part["speed"]))), float(np.mean(sliding))
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
    """Between the means of the two halves; 0 of what is not measured."""
    first, second = values[: values.size // 2], values[values.size // 2 :]
    if np.isnan(first).all() or np.isnan(second).all():
        return 0.0
    return abs(float(np.nanmean(second) - np.nanmean(first)))


def _scatter(values: np.ndarray) -> float:
    """Standard deviation about a straight line; NaN of what is not measured."""
    if np.isnan(values).any():
        return math.nan
    x = np.linspace(-1.0, 1.0, values.size)
    residual = values - values.mean() - x * (x @ values) / (x @ x)
    return math.sqrt(float(residual @ residual) / (values.size - 2))


def _row(part, start: float, period: float, run: str) -> dict[str, float | str] | None:
    """The point of a stretch; None where it has nothing that a table needs."""

    def mean(name: str) -> float:
        values = part[name]
        return float(np.nanmean(values)) if np.isfinite(values).mean() > 0.5 else math.nan

    row = {
        "slip": mean("slip"),
        "load": mean("load"),
        "speed": mean("speed"),
        "grade_deg": math.degrees(mean("pitch")),
        "run": run,
        "time": start + 0.5 * (part["slip"].size - 1) * period,
        **{name: mean(name) for name in MEASURED},
    }
    measured = any(row[name] == row[name] for name in MEASURED)
    return row if measured and row["load"] > 0.0 else None
