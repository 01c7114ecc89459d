"""Steady windows of a log as points of measurement tables, one table a ground, with a setup
beside each.

A window is steady where the means of its two halves agree, and those of its middle half and the
rest, in slip, both speeds, load, pull, torque and pitch.
Sinkage must have come to the value that belongs to the slip. It follows dz/dt = A (z_end - z), A =
(|V| + recovery |r w - V|)/l (`effects.excavation_rate`). After a change dz between the halves, a
time T/2 apart, dz/(1 - exp(-A T/2)) is left to go.

A fit to points of several soils is that of none, so each ground between two borders (`replay`) has
a table of its own. The filter finds a border some centimetres late: points within `belief.border`
of one are left out. `steady.csv` has all points, with the ground in the column `run`.

The priors in a setup are those of the belief, not the online estimate, which was made of the same
readings. The gain of slip-sinkage, which a setup takes as known or not at all, is the online one of
that ground.
"""

import math
import re
import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.signal import detrend

from soil_env._io.loading import plural
from soil_env.identification.online.prior import depth_of
from soil_env.measurement.setup import setup_of
from soil_env.measurement.table import MEASURED
from soil_env.online import Estimate
from soil_env.parameters import FLOW_LAW
from soil_env.terramechanics.effects.slip_sinkage import excavation_rate

from .align import Aligned
from .mapping import UNKNOWN_INERTIA, LogMap
from .replay import DIFFERS, Replay

FILES = re.compile(r"(steady|setup|ground\d+)\.(csv|yaml)")  # those that `files` may write
_COLUMNS = ("slip", "load", "speed", "grade_deg", "run", "time", *MEASURED)
_LEAST_SD = 1e-9  # in the unit of a channel: a smaller scatter is rounding
_LEAST_SPREAD = 0.01  # [-] of the slips of a table; own choice, below it they count as one slip
_STARTS = 4  # places at which a window is tried within its own length
GAP = 1.5  # [periods] between steps, from which they are of two drives; neighbours have 1
# Most change of a mean from the first half of a steady window to the second; own choices.
_SLIP_CHANGE = 0.03  # [-]
_SPEED_CHANGE = 0.05  # [of the rim speed] of travel and rim speed
_PITCH_CHANGE = 0.02  # [rad]
_FORCE_CHANGE = 0.04  # [of weight], of the torque [of weight x radius]
#: [of the radius] that the sinkage may have left to go, by the law of slip-sinkage.
_SINKAGE_LEFT = 0.05
_MOST_GAIN = 20.0  # [-] largest `dig_gain` that `Soil` takes

#: Columns of a measurement table, ground and start [s]: numbers, NaN = not measured, but for `run`.
Point = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Steady:
    """Steady points, one for each steady window, and the noise of their means."""

    rows: list[Point] = field(default_factory=list)
    noise: dict[str, float] = field(default_factory=dict)  # 1-sigma of a row's value, by column

    @property
    def reason(self) -> str:
        """Why the points cannot serve as a measurement table; "" where they can."""
        if not self.rows:
            return (
                "no window of the log is steady enough (windows in map.yaml), away from borders, "
                "and has a load above 0 with sinkage, pull or torque"
            )
        slip = [row["slip"] for row in self.rows]
        if max(slip) - min(slip) < _LEAST_SPREAD:
            many = plural(len(slip), "steady point") + " of one slip" * (len(slip) > 1)
            return f"{many}: a measurement table has at least two slips"
        return ""

    def table(self) -> str:
        """The measurement table as CSV; columns that no row has are left out."""
        names = [n for n in _COLUMNS if any(r[n] == r[n] for r in self.rows)]
        cells = [[cell(r[n], ".9g") for n in names] for r in self.rows]
        return "\n".join(",".join(line) for line in (names, *cells)) + "\n"


def cell(value: float | str, form: str) -> str:
    """Text of a value: text as it is, a number in the format `form`, "" for NaN."""
    return value if isinstance(value, str) else "" if value != value else format(value, form)


def steady_windows(log: Aligned, log_map: LogMap, ground: np.ndarray | None = None) -> Steady:
    """The steady windows of a log, none overlapping another, each as long as
    `log_map.windows.duration`.

    A window lies in one drive (`_drives`) and on one ground, further than `belief.border` from
    where the ground changes. It has a load above 0 and sinkage, pull or torque. The noise of a
    column is the scatter within all windows over the root of the steps of one. A column whose
    scatter is rounding has none, nor has a load that was not measured. `ground` [N] is that of
    `Replay`, one more from each border on; left out, all is one ground.
    """
    columns = _columns(log, log_map)
    where = log.travelled(log_map.wheel.radius)
    ground = np.ones(len(log), np.int64) if ground is None else ground
    runs = _drives(log, columns["rim"], log_map)
    n = round(log_map.windows.duration / log.period)  # steps of a window
    far_from_borders = np.ones(len(log), bool)
    for border in where[1:][np.diff(ground) != 0]:
        far_from_borders &= np.abs(where - border) > log_map.belief.border
    rows = []
    # By column, the scatter within each window.
    scatters: dict[str, list[float]] = {name: [] for name in (*MEASURED, "slip", "load")}
    first = 0
    while first + n <= len(log):
        window = slice(first, first + n)
        part = {name: values[window] for name, values in columns.items()}
        one_drive = (
            runs[first] >= 0
            and runs[first] == runs[first + n - 1]
            and far_from_borders[window].all()  # so on one ground
        )
        if not (one_drive and is_steady(part, log.period, log_map)):
            first += max(1, n // _STARTS)
            continue
        row = _row(part, float(log.time[first]), log.period)
        if any(row[name] == row[name] for name in MEASURED) and row["load"] > 0.0:
            run = f"ground{ground[first]}.drive{runs[first]}"
            rows.append(row | {"run": run, "ground": int(ground[first])})
            for name, scatter in scatters.items():
                scatter.append(_scatter(part[name]))
        first += n
    noise = {}
    for name, scatter in scatters.items():
        known = np.isfinite(scatter)
        pooled = math.sqrt(np.mean(np.square(scatter)[known])) if known.any() else 0.0
        if pooled > _LEAST_SD and (name != "load" or "load" in log.readings):
            noise[name] = pooled / math.sqrt(n)
    return Steady(rows, noise)


def _columns(log: Aligned, log_map: LogMap) -> dict[str, np.ndarray]:
    """Quantities [N] of steady points by name, in SI units; NaN where unknown.

    Where they are not measured, the load is the weight's part normal to the ground, the pull
    acceleration times mass, and the torque that of the motor. The part of a motor torque that
    turns the wheel faster is taken off where the inertia is known.
    """
    rim, speed, slip = log.motion(log_map.wheel.radius)
    motor = log.get("motor_torque")
    if len(log) > 1 and log_map.wheel.inertia != UNKNOWN_INERTIA:
        motor = motor - log_map.wheel.inertia * np.gradient(log.get("wheel_speed"), log.time)
    return {
        "slip": slip,
        "speed": speed,
        "rim": rim,
        "load": log.get("load", log_map.weight * np.cos(log.get("pitch", 0.0))),
        "pitch": log.get("pitch"),
        "sinkage": log.get("sinkage"),
        "drawbar_pull": log.get("drawbar_pull", log.get("acceleration") * log_map.wheel.body_mass),
        "torque": log.get("torque", motor),
    }


def _drives(log: Aligned, rim: np.ndarray, log_map: LogMap) -> np.ndarray:
    """Number [N] from 0 of the drive of each step; -1 where the wheel stands. `rim` [N]: rim speed
    [m/s].

    A halt, that is a wheel slower than `windows.wheel_speed`, and a step without a reading part two
    drives.
    """
    driving = np.abs(rim) > log_map.windows.wheel_speed * log_map.wheel.radius
    gap = np.diff(log.time, prepend=log.time[:1]) > GAP * log.period
    begins = driving & (gap | np.diff(driving, prepend=False))
    return np.where(driving, np.cumsum(begins) - 1, -1)


def is_steady(part: dict[str, np.ndarray], period: float, log_map: LogMap) -> bool:
    """True if the means of the two halves of a window agree, and those of its middle half and the
    rest; `part`: columns [n] of `_columns`, in steps of a `period` [s].

    False where slip or speed is missing or the wheel travels backward. The limit of the sinkage is
    the share of the way left that half a window covers, so a slow wheel has a small one.
    """
    radius = log_map.wheel.radius
    weight = log_map.weight
    travel = part["speed"]
    if np.isnan([part["slip"], travel]).any() or np.mean(travel) < 0.0:
        return False
    # [m/s] means of |r w|, |V| and the sliding |r w - V|.
    rim, speed, slid = (np.mean(np.abs(v)) for v in (part["rim"], travel, part["rim"] - travel))
    rate, _ = excavation_rate(
        speed, slid, 0.0, log_map.belief.dig_recovery, log_map.relaxation * radius
    )
    # Share of the way left that the sinkage comes in the time between the two means.
    come = -math.expm1(-rate * (part["slip"].size / 2) * period)
    limits = {  # of the change of the means from the first to the second half
        "slip": _SLIP_CHANGE,
        "speed": _SPEED_CHANGE * rim,
        "rim": _SPEED_CHANGE * rim,
        "pitch": _PITCH_CHANGE,
        "load": _FORCE_CHANGE * weight,
        "drawbar_pull": _FORCE_CHANGE * weight,
        "torque": _FORCE_CHANGE * weight * radius,
        "sinkage": _SINKAGE_LEFT * radius * come,
    }
    return all(_change(part[name]) <= limit for name, limit in limits.items())


def _change(values: np.ndarray) -> float:
    """Larger of two changes of the mean of `values` [n], NaN left out: from the first half to the
    second, and between the middle half and the rest.

    The latter is that of a rise and a fall. A change counts as 0 if one of its halves is all NaN.
    """
    change = 0.0
    for shift in (0, values.size // 4):  # rolled by a quarter: the middle half is the second one
        first, second = np.split(np.roll(values, shift), [values.size // 2])
        if not (np.isnan(first).all() or np.isnan(second).all()):
            change = max(change, abs(np.nanmean(second) - np.nanmean(first)))
    return change


def _scatter(values: np.ndarray) -> float:
    """Standard deviation of `values` [n] about a straight line in time; NaN if one is missing."""
    if np.isnan(values).any():
        return math.nan
    # Two degrees of freedom are those of the line.
    return float(np.std(detrend(values), ddof=2))


def _row(part: dict[str, np.ndarray], start: float, period: float) -> Point:
    """The means of a window that begins at `start` [s], its `grade_deg` and its middle `time` [s].

    A mean is NaN where half of its values or more are missing. `part`: columns [n] of `_columns`;
    `period` [s] of the steps.
    """
    mean = {
        n: float(np.nanmean(v)) if np.isfinite(v).mean() > 0.5 else math.nan
        for n, v in part.items()
    }
    time = start + 0.5 * (part["slip"].size - 1) * period
    return mean | {"grade_deg": math.degrees(mean["pitch"]), "time": time, "start": start}


@dataclass(frozen=True, eq=False)
class Ground:
    """The ground between two borders to other soils or gaps: its steady points and the surest
    estimate on it.
    """

    number: int
    begin: float  # [s]
    end: float
    #: Probability that its soil is not that of the ground before; NaN of the first after a gap.
    differs: float
    points: Steady
    estimate: dict[str, float] | None  # by `replay.COLUMNS`


def grounds(found: Replay, steady: Steady) -> list[Ground]:
    """The grounds of a log in the order of the drive, with the steady points of each."""
    out = []
    for number in np.unique(found.ground).tolist():
        time = found.time[found.ground == number].tolist()
        points = Steady([row for row in steady.rows if row["ground"] == number], steady.noise)
        out.append(
            Ground(
                number,
                time[0],
                time[-1],
                found.differs[number - 1],
                points,
                found.surest_on(number),
            )
        )
    return out


def tables_to_fit(grounds: list[Ground]) -> list[tuple[str, str, Ground]]:
    """(File of the table, file of the setup, ground) for each ground with points enough for a fit.

    Those of a single ground, which has all points, are steady.csv and setup.yaml.
    """
    return [
        ("steady.csv", "setup.yaml", g)
        if _driven(grounds) == 1
        else (f"ground{g.number}.csv", f"ground{g.number}.yaml", g)
        for g in grounds
        if not g.points.reason
    ]


def files(
    grounds: list[Ground], steady: Steady, log_map: LogMap, prior: Estimate
) -> dict[str, str]:
    """Texts of tables and setups by file name; none where there is no table (`steady.reason`).

    The pair steady.csv and setup.yaml has all points. Of several grounds with points, each with
    enough has a pair of its own, and setup.yaml then has no online estimate.
    """
    out = {}
    if _driven(grounds) > 1 and not steady.reason:
        out["steady.csv"] = (
            f"# points of {plural(_driven(grounds), 'ground')}, named in column run: no single "
            "soil fits them\n" + steady.table()
        )
        out["setup.yaml"] = setup_text(log_map, steady, prior, None)
    for table, setup, ground in tables_to_fit(grounds):
        out[table] = ground.points.table()
        out[setup] = setup_text(log_map, ground.points, prior, ground.estimate)
    return out


def _driven(grounds: list[Ground]) -> int:
    """Number of `grounds` that have a steady point or more."""
    return sum(bool(ground.points.rows) for ground in grounds)


def setup_text(
    log_map: LogMap, steady: Steady, prior: Estimate, estimate: dict[str, float] | None
) -> str:
    """Text of the setup file beside a table: wheel, priors of the soil, scatter as noise, errors of
    the sensors as calibration.

    `prior`: the identifier's estimate before any reading. `estimate`: the online one of this
    ground, by `replay.COLUMNS`, None for a table of several grounds. It gives the dig_gain and a
    comment; the priors are the belief's. What the map says of the soil replaces a prior.
    """
    text = (
        "# soil: the belief of the map (the prior of the online identifier), and what the map says "
        "is known\n"
    )
    if estimate is not None:
        text += (
            "# online, of the same drive: friction angle {friction_angle_deg:.1f} +- "
            "{friction_angle_sd_deg:.1f} deg, K {shear_modulus:.3g} m +- "
            "{shear_modulus_relative_sd:.0%}, S {sinkage_coefficient:.3g} +- "
            "{sinkage_coefficient_relative_sd:.0%}\n"
        ).format(**estimate)
    if "dig_gain" not in log_map.soil:
        origin = "as identified online" if estimate else "that of the belief, as if it were known"
        text += (
            f"# dig_gain: {origin}; take it and dig_recovery out to let soil-env discover look for "
            "slip-sinkage\n"
        )
    content = {
        "wheel": {"radius": log_map.wheel.radius, "width": log_map.wheel.width},
        "soil": _priors(log_map, prior, estimate) | log_map.soil,
        "noise": {n: _short(v) for n, v in steady.noise.items()},
        "calibration": {n: _short(v) for n, v in _calibration(log_map).items()},
        "gravity": log_map.gravity,
    }
    return text + yaml.safe_dump(content, sort_keys=False)


def _calibration(log_map: LogMap) -> dict[str, float]:
    """Section `calibration` of a setup: standard deviations of level, gains and zeros, as the
    online identifier believes them of the sensors that the columns are from.
    """
    noise = log_map.noise()
    weight = log_map.weight
    force = noise.drawbar_pull_gain, noise.drawbar_pull_zero * weight
    if "drawbar_pull" not in log_map.channels:  # acceleration times mass
        force = noise.acceleration_gain, noise.acceleration_zero * log_map.wheel.body_mass
    torque = noise.torque_gain, noise.torque_zero
    if "torque" not in log_map.channels:
        torque = noise.motor_torque_gain, noise.motor_torque_zero
    return {
        "tilt_deg": math.degrees(noise.pitch_zero),
        "force_gain": force[0],
        "force_offset": force[1],
        "torque_gain": torque[0],
        "torque_offset": torque[1] * weight * log_map.wheel.radius,
    }


def _priors(
    log_map: LogMap, prior: Estimate, estimate: dict[str, float] | None
) -> dict[str, object]:
    """Priors of the section `soil`, {value, sd}, or the value alone where it counts as known.

    K and S have the sd for which ln(1 + sd/value) is the relative sd of the prior. dig_gain is that
    of the estimate, else the prior's, at most `_MOST_GAIN`. The law of the soil's flow is given
    where the belief has one. S is stated at the map's exponent n, where it gives one: with the
    pressure that the belief has at the depth `depth_of`. S is left out beside k_c and k_phi of the
    map, the belief's dig_recovery beside a dig_gain of the map.
    """
    belief = log_map.belief
    K = prior.shear_modulus
    n = belief.sinkage_exponent
    wheel = {"radius": log_map.wheel.radius, "width": log_map.wheel.width}
    known = setup_of({"wheel": wheel, "soil": log_map.soil}, "soil").soil.sinkage_exponent
    stated = n if known is None else known.value
    S = prior.sinkage_coefficient * depth_of(log_map.wheel) ** (n - stated)
    gain = prior.dig_gain if estimate is None else estimate["dig_gain"]
    priors = {
        "friction_angle_deg": (prior.friction_angle_deg, prior.friction_angle_sd_deg),
        "cohesion": (prior.cohesion, prior.cohesion_sd),
        "shear_modulus": (K, K * math.expm1(prior.shear_modulus_relative_sd)),
        "sinkage_coefficient": (S, S * math.expm1(prior.sinkage_coefficient_relative_sd)),
        "sinkage_exponent": (n, belief.sinkage_exponent_sd),
        "dig_gain": (min(gain, _MOST_GAIN), 0.0),
        "dig_recovery": (belief.dig_recovery, 0.0),
    }
    if any(getattr(belief, name) for name in ("rim_flow", "braked_peak", "shear_growth")):
        priors |= {name: (getattr(belief, name), 0.0) for name in FLOW_LAW}
    if "k_c" in log_map.soil:
        del priors["sinkage_coefficient"]
    if "dig_gain" in log_map.soil and "dig_recovery" not in log_map.soil:
        del priors["dig_recovery"]
    return {
        name: {"value": _short(value), "sd": _short(sd)} if sd > 0.0 else _short(value)
        for name, (value, sd) in priors.items()
    }


def _short(value: float) -> float:
    """The value to four significant digits, as it is written into a setup."""
    return float(f"{value:.4g}")


def advice(found: Replay, grounds: list[Ground], steady: Steady) -> list[str]:
    """Sentences on the grounds, the steady points, and what may be fitted together.

    They count grounds, borders and restarts. Where there is no measurement table they say why. Else
    they count its points, and name the times [s] at which the ground changes, the grounds with too
    few points, and what the noise is.
    """
    out = [
        f"Grounds found: {len(grounds)}. The identifier saw {plural(found.borders, 'border')} and "
        f"started anew after {plural(found.restarts, 'gap')}. A border counts where the soils on "
        f"its two sides differ with a probability above {DIFFERS:g}. Soils that are alike, or "
        "driven on too briefly, count as one ground.",
    ]
    if steady.reason:
        return [*out, f"No measurement table: {steady.reason}."]
    count = f"steady.csv has {plural(len(steady.rows), 'steady point')}"
    if _driven(grounds) == 1:
        out.append(f"{count} of one ground. Its setup is setup.yaml.")
    else:
        changes = ", ".join(f"{g.begin:.1f}" for g in grounds[1:])
        out.append(
            f"{count} of {plural(_driven(grounds), 'ground')}. The ground changes at {changes} s. "
            "Fit one ground at a time."
        )
    few = ", ".join(str(g.number) for g in grounds if g.points.reason)
    if few and len(grounds) > 1:
        out.append(
            f"Too few points for a table are on ground {few}. Hold two wheel speeds or more there, "
            "each for the duration of a window."
        )
    return [
        *out,
        "The noise in the setup is the scatter within the windows. Differences between places come "
        "on top of it.",
    ]


def commands(grounds: list[Ground], folder: Path = Path()) -> list[str]:  # noqa: B008
    """Commands to run next: identify and discover, for each of `tables_to_fit` in `folder`."""
    out = []
    for table, setup, _ in tables_to_fit(grounds):
        data, given, target = (
            shlex.quote(str(folder / n)) for n in (table, setup, Path(table).stem)
        )
        out.append(f"soil-env identify {data} --setup {given}")
        out.append(f"soil-env discover {data} --setup {given} --out {target}")
    return out
