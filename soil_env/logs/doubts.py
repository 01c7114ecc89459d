"""Readings that a wheel of this size and weight hardly gives: another unit, another sign, another field.

Each is compared with what the map says of the wheel: rim speed with travel speed, load and pull with the weight on the
wheel, torque with weight times radius and with the stall torque. Medians are compared, over the steps that drive.
"""

from __future__ import annotations

import math

import numpy as np

from soil_env.logs.align import Aligned
from soil_env.logs.mapping import UNITS, LogMap
from soil_env.online import slips

_SLOWEST = 0.02  # [m/s] rim or travel speed below which a wheel stands
_LEAST = 10  # steps that drive, below which nothing is said
#: Admissible medians: (low, high, over what). Wide: what is outside is hardly a wheel on soil.
_RIM = (0.65, 6.0)  # rim speed over travel speed: a slip of -0.35 to 0.83
_LOAD, _PULL, _TORQUE = (0.2, 5.0), (1e-3, 2.0), (5e-3, 3.0)
_STEEP, _TILTED = 0.8, 0.7  # [rad] pitch; acceleration over gravity, which an accelerometer pointing down reads
_SINKAGE = 1e-3  # of the radius, largest
_SLIPS = 0.3  # between the slip measured and that of the speeds


def doubts(log: Aligned, log_map: LogMap) -> list[str]:
    """A sentence for each reading that looks like another unit, sign or field, with where it comes from."""
    wheel, weight, read = log_map.wheel, log_map.weight, log.readings
    nan = np.full(len(log), math.nan)
    rim, speed = read["wheel_speed"] * wheel.radius, read.get("speed", nan)
    drives = (np.abs(rim) > _SLOWEST) | (np.abs(np.nan_to_num(speed)) > _SLOWEST)
    lines = _of_speeds(log, log_map, rim, speed, drives)
    twist = f"weight times radius ({weight * wheel.radius:.3g} N m)"
    scales = {
        "load": (weight, *_LOAD, f"the weight on the wheel ({weight:.3g} N)"),
        "drawbar_pull": (weight, *_PULL, f"the weight on the wheel ({weight:.3g} N)"),
        "torque": (weight * wheel.radius, *_TORQUE, twist),
        "motor_torque": (weight * wheel.radius, *_TORQUE, twist),
    }
    for name, (scale, low, high, what) in scales.items():
        values = np.abs(read.get(name, nan)[drives & ~np.isnan(read.get(name, nan))])
        # a pull, and the torque of a wheel that rolls, may be small for a while
        ratio = _middle(values if name == "load" else np.sort(values)[values.size // 2 :]) / scale
        if values.size >= _LEAST and not low <= ratio <= high:
            lines.append(_line(log_map, name, f"{ratio:.3g} times {what}", low / ratio, high / ratio))
        elif values.size >= _LEAST and "torque" in name and _middle(values) > 1.2 * wheel.stall_torque:
            lines.append(_line(log_map, name, f"{_middle(values):.3g} N m, above the stall torque", 0.0, 0.0))
    for name in ("load", "sinkage"):
        if _middle(read.get(name, nan)) < 0.0:
            lines.append(_line(log_map, name, "negative", 0.0, 0.0, "another sign or offset"))
    return lines + _of_others(log, log_map)


def _of_speeds(log: Aligned, log_map: LogMap, rim: np.ndarray, speed: np.ndarray, drives: np.ndarray) -> list[str]:
    both = drives & ~np.isnan(rim) & ~np.isnan(speed)
    moves = both & (np.abs(np.nan_to_num(speed)) > _SLOWEST)
    both = moves if moves.sum() >= _LEAST else both
    if both.sum() < _LEAST:
        return []
    lines, slip = [], log.readings.get("slip")
    over = _middle(np.abs(rim[both])) / max(_middle(np.abs(speed[both])), 1e-9)
    turned = _middle(np.sign(rim[both]) * np.sign(speed[both])) < 0.0
    if not _RIM[0] <= over <= _RIM[1]:
        said = f"a rim speed of {over:.3g} times the travel speed ({_place(log_map, 'speed')})"
        other = _units(log_map, "speed", over / 2.0, over / 0.9)
        also = f" or speed in {' or '.join(other)}?" if other else ""
        stuck = "another unit, or a wheel that hardly gets on" if over > 1.0 else ""
        lines.append(_line(log_map, "wheel_speed", said, 0.9 / over, 2.0 / over, stuck) + also)
    elif turned:
        said = f"against the travel speed ({_place(log_map, 'speed')})"
        lines.append(_line(log_map, "wheel_speed", said, 0.0, 0.0, "another sign of one of the two"))
    elif slip is not None and _middle(np.abs(slip - slips(rim, speed))[both]) > _SLIPS:
        said = f"{_middle(slip[both]):.2g} where wheel and travel speed give {_middle(slips(rim, speed)[both]):.2g}"
        lines.append(_line(log_map, "slip", said, 0.0, 0.0, "another sign, unit or definition"))
    return lines


def _of_others(log: Aligned, log_map: LogMap) -> list[str]:
    lines, read = [], log.readings
    if "sinkage" in read and 0.0 < np.nanmax(np.abs(read["sinkage"]), initial=0.0) < _SINKAGE * log_map.wheel.radius:
        deepest = float(np.nanmax(np.abs(read["sinkage"])))
        lines.append(_line(log_map, "sinkage", f"at most {deepest:.3g} m", 1e-3 / deepest, 0.1 / deepest))
    if _middle(np.abs(read.get("pitch", np.zeros(1)))) > _STEEP:
        lines.append(_line(log_map, "pitch", f"{_middle(np.abs(read['pitch'])):.2g} rad in the middle", 0.0, 0.5))
    felt = _middle(np.abs(read.get("acceleration", np.zeros(1)))) / log_map.gravity
    if felt > _TILTED:
        said = f"{felt:.3g} times gravity in the middle"
        lines.append(_line(log_map, "acceleration", said, 0.0, 0.0, "another unit, or an axis that points down"))
    return lines


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


def _line(log_map: LogMap, name: str, said: str, low: float, high: float, reason: str = "") -> str:
    """The sentence; units by which the reading would be `low` to `high` times as large are proposed."""
    units = _units(log_map, name, low, high) if high > 0.0 else []
    likely = f"unit {' or '.join(units)}?" if units else f"{reason or 'another unit or field'}?"
    return f"{_place(log_map, name)}: reads {said}: {likely}"
