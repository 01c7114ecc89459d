"""Implausible readings: another unit, sign, field or mass than the map says.

Each reading is compared with what the map says of the wheel, or with another reading of the same
quantity. Rim speed is compared with travel speed and slip, a force with the weight, torque with
weight times radius, and pitch with the gravity in accelerometer or pull. Where the load is
doubtful, so is the mass: other forces are not compared then. All values are medians over the steps
that drive. A doubt is one line: what, where, what was expected.
"""

import math

import numpy as np

from soil_env.online import slips
from soil_env.parameters.sensors import SENSORS, sizes_of

from .align import Aligned
from .mapping import GEARED, TIMES, UNITS, LogMap, is_converted, si_factor, si_unit

_STANDS = 0.13  # [rad/s] wheel speed, or travel speed over radius, below which a wheel stands
_LEAST = 10  # steps that drive, below which nothing is compared
#: Differences between the slip measured and that of the speeds: least of another sign, most.
_SLIPS = (0.05, 0.3)
_HILL = 0.02  # [of gravity] rms over the steps, below which the sign of a pitch cannot be seen
_AGAINST = -0.5  # slope of the gravity felt by that of the pitch, below which its sign is wrong
_ALIKE = 0.5  # size of the correlation of both, from which that counts
_INTERVAL = (5e-4, 5.0)  # [s] between rows; a doubt beyond
_USUAL = (2e-3, 2.0)  # [s] between rows, usual
_SHORT = 10.0  # [s] length of a short table


_HELD = 0.7  # of the travel speed: the rim of a wheel that holds back downhill
# Plausible ratios, least and most; wide, so that hardly a wheel on soil is outside.
#: Rim speed over travel speed: slips of -0.35 to 0.83; more where the wheel is stuck for long.
_RIM = (0.65, 6.0)
_FREEST = (0.4, 3.2)  # the same in the tenth of the steps with the least slip
#: Sensors whose readings are compared with sizes of the wheel, the load before the other forces.
_SIZED = sorted(
    ((s.name, s.unit, s.observed[0], s.usual) for s in SENSORS if s.usual is not None),
    key=lambda sized: ("weight" in sized[2], sized[0] != "load"),
)


def time_doubts(interval: float, length: float, log_map: LogMap) -> list[str]:
    """A doubt where rows of a table are `interval` [s] apart and take `length` [s] in all; NaN: not
    known.
    """
    brief = interval < _USUAL[0] and length < _SHORT
    if (
        log_map.time is None
        or interval == 0.0
        or not (interval < _INTERVAL[0] or interval > _INTERVAL[1] or brief)
    ):
        return []
    now = log_map.time.unit
    usual = [
        u
        for u, f in TIMES.items()
        if u not in ("iso", now) and _USUAL[0] <= interval * f / TIMES[now] <= _USUAL[1]
    ]
    likely = " or ".join(usual) or "another"
    return [
        f"time (column {log_map.time.column}): rows are {interval:.3g} s apart, {length:.3g} s in "
        f"all, expected {_USUAL[0]:g} to {_USUAL[1]:g} s apart. Perhaps unit {likely} in place of "
        f"{now}."
    ]


def doubts(log: Aligned, log_map: LogMap) -> list[str]:
    """A line for each reading that looks like another unit, sign or field."""
    return _Doubts(log, log_map).lines


class _Doubts:
    """Comparisons of the readings of one log."""

    def __init__(self, log: Aligned, log_map: LogMap) -> None:
        self.log = log
        self.map = log_map
        self.lines: list[str] = []
        self.rim = log.readings["wheel_speed"] * log_map.wheel.radius
        self.speed = log.get("speed")
        self.slowest = _STANDS * log_map.wheel.radius
        self.drives = (np.abs(self.rim) > self.slowest) | (np.abs(self.speed) > self.slowest)
        sound_speeds = self._speeds()
        sound_sizes = self._sizes()
        for name in ("load", "sinkage"):
            if _median(log.get(name)) < 0.0:
                self._doubt(name, "negative", "positive", "another sign or offset")
        for name in ("torque", "motor_torque"):
            if sound_speeds and _median((np.sign(self.rim) * log.get(name))[self.drives]) < 0.0:
                self._doubt(name, "against the wheel speed", "with it", "another sign")
        self._stuck_sensors()
        if sound_sizes:
            self._pitch()

    def _driven(self, values: np.ndarray) -> np.ndarray:
        """Known values [n] of the steps that drive."""
        return values[self.drives & ~np.isnan(values)]

    def _place(self, name: str) -> str:
        return f"{name} ({self.map.channels[name].place})"

    def _doubt(self, name: str, said: str, expected: str, reason: str) -> None:
        self.lines.append(
            f"{self._place(name)} reads {said}, expected {expected}. Perhaps {reason}."
        )

    def _units(self, name: str, low: float, high: float) -> list[str]:
        """Units in which the reading would be `low` to `high` times as large."""
        unit = self.map.channels[name].unit
        if is_converted(name, unit):
            return []
        now = si_factor(name, unit)
        others = {u: f for u, f in UNITS[name].items() if f != now and not is_converted(name, u)}
        return [u for u, f in others.items() if low <= f / now <= high]

    def _unit(self, name: str, low: float, high: float) -> str:
        """A unit that explains a reading which should be `low` to `high` times as large."""
        units = " or ".join(self._units(name, low, high))
        geared = name in GEARED and self.map.channels[name].gear == 1.0
        return f"unit {units}" if units else f"another unit{', gear' * geared} or field"

    def _speeds(self) -> bool:
        """Compare rim speed, travel speed and slip; True if nothing is doubtful."""
        rim = self.rim
        speed = self.speed
        both = self.drives & ~np.isnan(rim + speed)
        moves = both & (np.abs(speed) > self.slowest)
        both = moves if moves.sum() >= _LEAST else both
        if both.sum() < _LEAST:
            return True
        over = _median(np.abs(rim[both])) / max(_median(np.abs(speed[both])), 1e-9)

        turns = moves & (np.abs(rim) > self.slowest)
        known = turns.sum() >= _LEAST
        freest = float(np.quantile(np.abs(rim[turns] / speed[turns]), 0.1)) if known else 1.0
        low, high = _RIM
        free, freer = _FREEST
        if over < low or not free <= freest <= freer or (over > high and not known):
            over = over if over < low or not known else freest
            least = max(over, 1e-9)  # of a sensor that reads nothing
            limits = {
                "wheel_speed": (_HELD / least, 2.0 / least),
                "speed": (over / 2.0, over / _HELD),
            }
            units = [
                f"{name} in {u}" for name, of in limits.items() for u in self._units(name, *of)
            ]
            reason = (
                " or ".join(units)
                or f"another unit or gear{', or a wheel that hardly gets on' * (over > 1.0)}"
            )
            said = f"a rim speed of {over:.3g} times the travel speed of {self._place('speed')}"
            self._doubt("wheel_speed", said, f"{low:g} to {high:g}", reason)
            return False
        if _median(np.sign(rim * speed)[both]) < 0.0:
            said = f"against the travel speed of {self._place('speed')}"
            self._doubt("wheel_speed", said, "the same direction", "another sign of one of the two")
            return False
        of_speeds = slips(rim, speed)[both]
        slip = self.log.get("slip")[both]
        away, opposite = (_median(np.abs(slip - sign * of_speeds)) for sign in (1.0, -1.0))
        if away > _SLIPS[1] or away > max(_SLIPS[0], 2.0 * opposite):
            expected = f"{_median(of_speeds):.2g} by the two speeds"
            self._doubt(
                "slip", f"{_median(slip):.2g}", expected, "another sign, unit or definition"
            )
            return False
        return True

    def _sizes(self) -> bool:
        """Compare readings with sizes of the wheel; True if nothing is doubtful.

        Forces wait for a doubtful load.
        """
        gravity = self.map.gravity
        sizes = sizes_of(self.map.wheel, gravity)
        before = len(self.lines)
        for name, unit, of, (quantile, low, high) in _SIZED:
            values = self._driven(np.abs(self.log.get(name)))
            if values.size < _LEAST:
                continue
            size = float(np.quantile(values, quantile))
            ratio = size / sizes.get(of, 1.0)
            if low <= ratio <= high or (ratio == 0.0 and name == "sinkage"):
                continue
            reason = self._unit(name, low / ratio, high / ratio) if ratio else "a dead sensor"
            if name == "load":
                reason += f", or wheel.body_mass {size / gravity:.3g} kg"
            if name == "acceleration":
                reason += ", or an axis that points down"
            said = f"{size:.3g} {unit}"
            if of in sizes:
                said = f"{ratio:.3g} {of} ({sizes[of]:.3g} {unit})"
            self._doubt(name, said, f"{low:g} to {high:g}", reason)
            if name == "load":
                break
        return len(self.lines) == before

    def _pitch(self) -> None:
        """Compare the sign of the pitch: an accelerometer along the course reads dv/dt + g
        sin(pitch).
        """
        log = self.log
        gravity = self.map.gravity
        if len(log) < _LEAST:
            return
        name = "acceleration" if "acceleration" in log.readings else "drawbar_pull"
        felt = log.get(name) / (1.0 if name == "acceleration" else self.map.wheel.body_mass)
        felt = felt - np.nan_to_num(np.gradient(self.speed, log.time))
        expected = gravity * np.sin(log.get("pitch"))
        known = ~np.isnan(expected + felt)
        x = expected[known]
        y = felt[known]
        if x.size < _LEAST or math.sqrt(float(x @ x) / x.size) < _HILL * gravity:
            return
        slope = float(x @ y) / float(x @ x)
        alike = float(x @ y) / math.sqrt(max(float(x @ x) * float(y @ y), 1e-300))
        if slope <= _AGAINST and alike <= -_ALIKE:
            said = f"{slope:.2g} times the slope that {self._place(name)} feels"
            self._doubt("pitch", said, "the same slope", "another sign of one of the two")

    def _stuck_sensors(self) -> None:
        """Doubt each reading but the load that has one value in all steps that drive."""
        for name in ("wheel_speed", "speed", "sinkage", "drawbar_pull", "torque", "motor_torque"):
            values = self._driven(self.log.get(name))
            if values.size >= _LEAST and np.ptp(values) == 0.0:
                unit = si_unit(name)
                said = f"{values[0]:.3g} {unit} in all {values.size} steps that drive"
                reason = "a stuck sensor, or a command"
                self._doubt(name, said, "the noise of a sensor", reason)


def _median(values: np.ndarray) -> float:
    """Median without NaN; 0 of nothing."""
    known = values[~np.isnan(values)]
    return float(np.median(known)) if known.size else 0.0
