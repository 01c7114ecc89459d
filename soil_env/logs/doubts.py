"""Readings that a wheel of this size and weight hardly gives: another unit, another sign, another field, another mass.

Each is compared with what the map says of the wheel, or with another reading that tells the same: rim speed with travel
speed and slip, load and pull with the weight, torque with weight times radius and the stall torque, pull with mass
times acceleration, pitch with what accelerometer or pull feel of gravity. What is compared are medians over the steps
that drive. A doubt is one line: what, where, what was expected.
"""

from __future__ import annotations

import math

import numpy as np

from soil_env.logs.align import Aligned
from soil_env.logs.mapping import TIMES, UNITS, LogMap
from soil_env.online import slips

_STANDS = 0.13  # [rad/s] wheel speed, or travel speed over radius, below which a wheel stands
_LEAST = 10  # steps that drive, below which nothing is said
#: Admissible medians: (low, high, over what). Wide: what is outside is hardly a wheel on soil.
_RIM = (0.65, 6.0)  # rim speed over travel speed: a slip of -0.35 to 0.83; more where the wheel is stuck for long
_FREEST = (0.4, 3.2)  # the same where the wheel slips least, in the lowest tenth of the steps
_LOAD, _PULL, _TORQUE = (0.2, 5.0), (1e-3, 2.0), (5e-3, 3.0)
_MASS = (0.2, 5.0)  # drawbar pull over mass times acceleration
_SCALE = (0.5, 2.0)  # travel speed over that of wheel speed and measured slip
_STEEP, _TILTED = 0.8, 0.7  # [rad] pitch; acceleration over gravity, which an accelerometer pointing down reads
_SINKAGE = (1e-3, 0.7)  # of the radius, largest
_SLIPS = (0.05, 0.3)  # between the slip measured and that of the speeds: least of another sign, most
_HILL = 0.02  # of gravity, rms over the steps, below which the sign of a pitch is not seen
_AGAINST, _ALIKE = -0.5, 0.5  # slope of the gravity felt by that of the pitch; size of their correlation
_INTERVAL, _USUAL, _SHORT = (5e-4, 5.0), (2e-3, 2.0), 10.0  # [s] between rows; the usual; length of a short table


def time_doubts(interval: float, length: float, log_map: LogMap) -> list[str]:
    """A doubt where the rows of a table are `interval` [s] apart and all of them take `length` [s]; NaN: not known."""
    brief = interval < _USUAL[0] and length < _SHORT
    if log_map.time is None or interval == 0.0 or not (interval < _INTERVAL[0] or interval > _INTERVAL[1] or brief):
        return []
    now = log_map.time.unit
    usual = [u for u, f in TIMES.items() if u != "iso" and _USUAL[0] <= interval * f / TIMES[now] <= _USUAL[1]]
    likely = " or ".join(u for u in usual if u != now) or "another"
    return [
        f"time: column {log_map.time.column}: rows are {interval:.3g} s apart, {length:.3g} s in all: expected "
        f"{_USUAL[0]:g} to {_USUAL[1]:g} s apart: unit {likely}, not {now}?"
    ]


def doubts(log: Aligned, log_map: LogMap) -> list[str]:
    """A line for each reading that looks like another unit, sign or field, with where it comes from."""
    wheel, read = log_map.wheel, log.readings
    rim, speed = read["wheel_speed"] * wheel.radius, read.get("speed", np.full(len(log), math.nan))
    slowest = _STANDS * wheel.radius
    drives = (np.abs(rim) > slowest) | (np.abs(np.nan_to_num(speed)) > slowest)
    of_acceleration = _of_acceleration(log, log_map)
    of_speeds = _of_speeds(log, log_map, rim, speed, drives)
    lines = of_speeds + of_acceleration
    lines += _of_forces(log, log_map, drives, sound=not of_acceleration)
    for name in ("load", "sinkage"):
        if _middle(read.get(name, np.zeros(1))) < 0.0:
            lines.append(_line(log_map, name, "negative", "positive", "another sign or offset"))
    for name in ("torque", "motor_torque"):
        if not of_speeds and _middle(np.sign(rim[drives]) * read.get(name, np.zeros(len(log)))[drives]) < 0.0:
            lines.append(_line(log_map, name, "against the wheel speed", "with it", "another sign"))
    return lines + _of_stuck_sensors(log, log_map, drives) + _of_sinkage(log, log_map) + _of_pitch(log, log_map, speed)


def _of_stuck_sensors(log: Aligned, log_map: LogMap, drives: np.ndarray) -> list[str]:
    """A line for each reading but the load that has one value in all steps that drive."""
    lines = []
    for name in ("wheel_speed", "speed", "sinkage", "drawbar_pull", "torque", "motor_torque"):
        values = log.readings[name][drives] if name in log.readings else np.zeros(0)
        values = values[~np.isnan(values)]
        if values.size >= _LEAST and np.ptp(values) == 0.0:
            said = f"{values[0]:.3g} in all {values.size} steps that drive"
            lines.append(
                _line(log_map, name, said, "values with the noise of a sensor", "a sensor that is stuck, or a command")
            )
    return lines


# --- speeds -----------------------------------------------------------------------------------------------------------


def _of_speeds(log: Aligned, log_map: LogMap, rim: np.ndarray, speed: np.ndarray, drives: np.ndarray) -> list[str]:
    slowest, slip = _STANDS * log_map.wheel.radius, log.readings.get("slip")
    both = drives & ~np.isnan(rim) & ~np.isnan(speed)
    moves = both & (np.abs(np.nan_to_num(speed)) > slowest)
    both = moves if moves.sum() >= _LEAST else both
    if both.sum() < _LEAST:
        return []
    over = _middle(np.abs(rim[both])) / max(_middle(np.abs(speed[both])), 1e-9)
    turns = moves & (np.abs(rim) > slowest)
    known = turns.sum() >= _LEAST
    freest = float(np.quantile(np.abs(rim[turns] / speed[turns]), 0.1)) if known else math.nan
    place = _place(log_map, "speed")
    if over < _RIM[0] or freest < _FREEST[0] or freest > _FREEST[1] or (over > _RIM[1] and not known):
        over = over if over < _RIM[0] or not known else freest
        low, high, other = 0.9 / over, 2.0 / over, _units(log_map, "speed", over / 2.0, over / 0.9)
        units = [f"wheel_speed in {u}" for u in _units(log_map, "wheel_speed", low, high)]
        units += [f"speed in {u}" for u in other]
        said = f"a rim speed of {over:.3g} times the travel speed ({place})"
        reason = " or ".join(units) or f"another unit{', or a wheel that hardly gets on' * (over > 1.0)}"
        return [_line(log_map, "wheel_speed", said, f"{_RIM[0]:g} to {_RIM[1]:g}", reason)]
    if _middle(np.sign(rim[both]) * np.sign(speed[both])) < 0.0:
        said = f"against the travel speed ({place})"
        return [_line(log_map, "wheel_speed", said, "the same direction", "another sign of one of the two")]
    if slip is None:
        return []
    sound = both & (np.abs(slip) < 0.8)
    scale = _middle(speed[sound] / (rim[sound] * (1.0 - slip[sound]))) if sound.sum() >= _LEAST else 1.0
    units = _units(log_map, "speed", 0.8 / scale, 1.25 / scale) if scale > 0.0 else []
    if not _SCALE[0] <= scale <= _SCALE[1] and units:
        said = f"{scale:.3g} times what wheel speed and slip ({_place(log_map, 'slip')}) give"
        return [_line(log_map, "speed", said, "once", f"unit {' or '.join(units)}")]
    away, opposite = (_middle(np.abs(slip - sign * slips(rim, speed))[both]) for sign in (1.0, -1.0))
    if away > _SLIPS[1] or away > max(_SLIPS[0], 2.0 * opposite):
        said, expected = f"{_middle(slip[both]):.2g}", f"{_middle(slips(rim, speed)[both]):.2g}, as of the two speeds"
        return [_line(log_map, "slip", said, expected, "another sign, unit or definition")]
    return []


# --- forces, masses, gravity ------------------------------------------------------------------------------------------


def _of_forces(log: Aligned, log_map: LogMap, drives: np.ndarray, sound: bool) -> list[str]:
    """Of load, pull and torques; `sound`: whether the acceleration is not doubted itself."""
    wheel, weight, read, lines = log_map.wheel, log_map.weight, log.readings, []
    nan = np.full(len(log), math.nan)
    mass = _felt_mass(log) / wheel.body_mass if sound else math.nan
    load = _middle(np.abs(read.get("load", nan)[drives])) / weight
    if load > 0.0 and not _LOAD[0] <= load <= _LOAD[1] and 0.5 < mass / load < 2.0:
        return [
            f"wheel: body_mass = {wheel.body_mass:g} kg: load ({_place(log_map, 'load')}) reads {load:.3g} times its "
            f"weight, and so does the pull by the acceleration: expected about {load * wheel.body_mass:.3g} kg"
        ]
    of_weight = f"the weight on the wheel ({weight:.3g} N)"
    of_twist = f"weight times radius ({weight * wheel.radius:.3g} N m)"
    scales = {
        "load": (weight, *_LOAD, of_weight),
        "drawbar_pull": (weight, *_PULL, of_weight),
        "torque": (weight * wheel.radius, *_TORQUE, of_twist),
        "motor_torque": (weight * wheel.radius, *_TORQUE, of_twist),
    }
    for name, (scale, low, high, what) in scales.items():
        values = np.abs(read.get(name, nan)[drives & ~np.isnan(read.get(name, nan))])
        # a pull, and the torque of a wheel that rolls, may be small for a while
        size = _middle(values if name == "load" else np.sort(values)[values.size // 2 :])
        ratio = size / scale
        explained = load > 0.0 and not _LOAD[0] <= load <= _LOAD[1] and low <= ratio / load <= high
        if values.size < _LEAST or (name != "load" and explained):
            continue
        if name == "drawbar_pull" and not (lines or math.isnan(mass) or _MASS[0] <= mass <= _MASS[1]):
            said = f"{mass:.3g} times wheel.body_mass times the acceleration ({_place(log_map, 'acceleration')})"
            units = _units(log_map, name, _MASS[0] / mass, _MASS[1] / mass) if mass > 0.0 else []
            reason = f"unit {' or '.join(units)}" if units else "another unit or sign"
            reason += f", or wheel.body_mass {mass * wheel.body_mass:.3g} kg" if mass > 0.0 else ""
            lines.append(_line(log_map, name, said, f"{_MASS[0]:g} to {_MASS[1]:g}", reason))
        elif not low <= ratio <= high:
            units = _units(log_map, name, low / ratio, high / ratio) if ratio > 0.0 else []
            reason = f"unit {' or '.join(units)}" if units else "another unit or field"
            reason += f", or wheel.body_mass {size / log_map.gravity:.3g} kg" if name == "load" and size > 0.0 else ""
            lines.append(_line(log_map, name, f"{ratio:.3g} times {what}", f"{low:g} to {high:g}", reason))
        elif "torque" in name and size > 1.2 * wheel.stall_torque:
            expected = f"at most {wheel.stall_torque:g} N m, the stall torque"
            lines.append(_line(log_map, name, f"{size:.3g} N m", expected, "another unit or field"))
    return lines


def _felt_mass(log: Aligned) -> float:
    """Mass [kg] that drawbar pull and acceleration give; NaN where they are not measured or hardly anything is felt."""
    nan = np.full(len(log), math.nan)
    pull, felt = log.readings.get("drawbar_pull", nan), log.readings.get("acceleration", nan)
    known = ~np.isnan(pull + felt)
    square = float(felt[known] @ felt[known])
    return float(pull[known] @ felt[known]) / square if known.sum() >= _LEAST and square > 0.0 else math.nan


def _of_acceleration(log: Aligned, log_map: LogMap) -> list[str]:
    felt = _middle(np.abs(log.readings.get("acceleration", np.zeros(1)))) / log_map.gravity
    if felt <= _TILTED:
        return []
    said, reason = f"{felt:.3g} times gravity in the middle", "another unit, or an axis that points down"
    return [_line(log_map, "acceleration", said, f"at most {_TILTED:g}", reason)]


def _of_pitch(log: Aligned, log_map: LogMap, speed: np.ndarray) -> list[str]:
    """Of its size and its sign: an accelerometer along the course reads dv/dt + g sin(pitch)."""
    read, gravity = log.readings, log_map.gravity
    if "pitch" not in read:
        return []
    if _middle(np.abs(read["pitch"])) > _STEEP:
        units = _units(log_map, "pitch", 0.0, 0.5)
        reason = f"unit {' or '.join(units)}" if units else "another unit or field"
        said = f"{_middle(np.abs(read['pitch'])):.2g} rad in the middle"
        return [_line(log_map, "pitch", said, f"at most {_STEEP:g}", reason)]
    name = "acceleration" if "acceleration" in read else "drawbar_pull"
    if name not in read or len(log) < _LEAST:
        return []
    felt = read[name] / (1.0 if name == "acceleration" else log_map.wheel.body_mass)
    expected, felt = gravity * np.sin(read["pitch"]), felt - np.nan_to_num(np.gradient(speed, log.time))
    known = ~np.isnan(expected + felt)
    x, y = expected[known], felt[known]
    if x.size < _LEAST or math.sqrt(float(x @ x) / x.size) < _HILL * gravity:
        return []
    slope, alike = float(x @ y) / float(x @ x), float(x @ y) / math.sqrt(max(float(x @ x) * float(y @ y), 1e-300))
    if slope > _AGAINST or alike > -_ALIKE:
        return []
    said = f"{slope:.2g} times the gravity that {name} ({_place(log_map, name)}) feels"
    return [_line(log_map, "pitch", said, "once", "another sign of one of the two")]


def _of_sinkage(log: Aligned, log_map: LogMap) -> list[str]:
    radius = log_map.wheel.radius
    deepest = float(np.nanmax(np.abs(log.readings.get("sinkage", np.zeros(1))), initial=0.0))
    if not 0.0 < deepest < _SINKAGE[0] * radius:
        return []
    units = _units(log_map, "sinkage", *(share * radius / deepest for share in _SINKAGE))
    reason = f"unit {' or '.join(units)}" if units else "another unit or field"
    return [_line(log_map, "sinkage", f"at most {deepest:.3g} m", f"more than {_SINKAGE[0] * radius:.3g} m", reason)]


# --- words ------------------------------------------------------------------------------------------------------------


def _middle(values: np.ndarray) -> float:
    """Median without NaN; 0 of nothing."""
    known = values[~np.isnan(values)]
    return float(np.median(known)) if known.size else 0.0


def _place(log_map: LogMap, name: str) -> str:
    return f"{name}: {log_map.channels.given()[name].place}"


def _units(log_map: LogMap, name: str, low: float, high: float) -> list[str]:
    """Units in which the reading would be `low` to `high` times as large."""
    source = log_map.channels.given()[name]
    if source.unit in ("A", "quaternion"):
        return []
    now = UNITS[name][source.unit if source.unit is not None else next(iter(UNITS[name]))]
    return [u for u, f in UNITS[name].items() if u not in ("A", "quaternion") and f != now and low <= f / now <= high]


def _line(log_map: LogMap, name: str, said: str, expected: str, reason: str) -> str:
    return f"{_place(log_map, name)}: reads {said}: expected {expected}: {reason}?"
