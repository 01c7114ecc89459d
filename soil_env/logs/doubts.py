"""Implausible readings: another unit, sign, field or mass than the map says.

Each reading is compared with what the map says of the wheel, or with another reading of the same
quantity. Rim speed is compared with travel speed and slip, a force with the weight, torque with
weight times radius, and pitch with the gravity in accelerometer or pull. Where the load is
doubtful, so is the mass: other forces are not compared then. Most values are medians or other
quantiles over the steps that drive. A doubt is one line: what, where, what was expected.
"""

import math

import numpy as np

from soil_env.online import slips
from soil_env.parameters.sensors import SENSORS, sizes_of

from .align import Aligned
from .mapping import CONVERTED, GEARED, TIMES, UNITS, LogMap, TimeColumn, si_factor, si_unit

_STANDS = 0.13  # [rad/s] wheel speed, or travel speed over radius, below which a wheel stands
_LEAST = 10  # steps that drive, below which nothing is compared
# Own choices for the median difference between the slip measured and that of the two speeds.
_SLIP_OFF = 0.3  # [-] a doubt beyond
_SLIP_TURNED = 0.05  # [-] from which another sign of the slip is tried
_FITS_BETTER = 2.0  # times that the difference falls where another sign counts as the reason
_HILL = 0.02  # [of gravity] rms over the steps, below which the sign of a pitch cannot be seen
_AGAINST = -0.5  # slope of the gravity felt by that of the pitch, below which its sign is wrong
_ALIKE = 0.5  # size of the correlation of both, from which that counts
_INTERVAL = (5e-4, 5.0)  # [s] between rows; a doubt beyond
_USUAL = (2e-3, 2.0)  # [s] between rows, usual
_SHORT = 10.0  # [s] length of a short table


# Range of rim speed over travel speed into which another unit has to bring it; own choice.
_HELD = 0.7  # [-] least: of a wheel that holds back downhill
_SPUN = 2.0  # [-] greatest: at a slip of one half
_FREE_SHARE = 0.1  # of the steps: those with the least slip
_LEAST_DIVISOR = 1e-9  # in place of the 0 of a sensor that reads nothing
_TINIEST = 1e-300  # [m2/s4] keeps a correlation with a constant 0 finite
# Plausible ratios, least and most; wide, so that hardly a wheel on soil is outside.
#: Rim speed over travel speed: slips of -0.35 to 0.83; more where the wheel is stuck for long.
_RIM = (0.65, 6.0)
_FREEST = (0.4, 3.2)  # the same at the quantile `_FREE_SHARE`, where the wheel slips least
#: (Reading, its SI unit, size of the wheel that it is divided by or a unit, `Sensor.usual`) of the
#: readings that `_sizes` compares, the load before the other forces.
_SIZED = sorted(
    ((s.name, s.unit, s.observed[0], s.usual) for s in SENSORS if s.usual is not None),
    key=lambda sized: ("weight" in sized[2], sized[0] != "load"),
)


def time_doubts(interval: float, length: float, stamps: TimeColumn) -> list[str]:
    """Doubt on the unit of the column of time, in a list; empty without one.

    `interval` [s] is the median between rows, `length` [s] that of the table. Doubtful is an
    interval beyond `_INTERVAL`, and below the usual one in a table shorter than `_SHORT`. One of 0
    is left to `Stamps.settle`, which notes repeated stamps.
    """
    brief = interval < _USUAL[0] and length < _SHORT
    if interval == 0.0 or not (interval < _INTERVAL[0] or interval > _INTERVAL[1] or brief):
        return []
    now = stamps.unit
    usual = [
        u
        for u, f in TIMES.items()
        if u not in ("iso", now) and _USUAL[0] <= interval * f / TIMES[now] <= _USUAL[1]
    ]
    likely = " or ".join(usual) or "another"
    return [
        f"time (column {stamps.column}): rows are {interval:.3g} s apart, {length:.3g} s in all, "
        f"expected {_USUAL[0]:g} to {_USUAL[1]:g} s apart. Perhaps unit {likely} in place of {now}."
    ]


def doubts(log: Aligned, log_map: LogMap) -> list[str]:
    """Doubts on the readings of a log: a line for each that looks like another unit, sign, field or
    wheel than the map says.
    """
    return _Doubts(log, log_map).lines


class _Doubts:
    """Comparisons of the readings of one log, all made on construction; `lines` are the doubts.

    Signs of torques are compared only if `_speeds` finds no doubt, that of the pitch only if
    `_sizes` finds none.
    """

    def __init__(self, log: Aligned, log_map: LogMap) -> None:
        self.log = log
        self.map = log_map
        self.lines: list[str] = []
        self.rim = log.readings["wheel_speed"] * log_map.wheel.radius  # [N] m/s
        self.speed = log.get("speed")  # [N] m/s
        self.slowest = _STANDS * log_map.wheel.radius  # [m/s] below which rim or body stands
        # [N] True for the steps that drive.
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
        """Reading and, in brackets, where it is from, for a line."""
        return f"{name} ({self.map.channels[name].place})"

    def _doubt(self, name: str, said: str, expected: str, reason: str) -> None:
        """Add the line of a doubt on the reading `name`: what it reads (`said`), what was
        `expected`, and what may be the `reason`.
        """
        self.lines.append(
            f"{self._place(name)} reads {said}, expected {expected}. Perhaps {reason}."
        )

    def _units(self, name: str, low: float, high: float) -> list[str]:
        """Units in which the reading would be `low` to `high` times as large.

        An empty list for a reading that takes more than a factor, as a current does.
        """
        unit = self.map.channels[name].unit
        if unit in CONVERTED:
            return []
        now = si_factor(name, unit)
        return [
            u
            for u, f in UNITS[name].items()
            if f != now and low <= f / now <= high and u not in CONVERTED
        ]

    def _speeds(self) -> bool:
        """Compare rim speed, travel speed and slip: add the first doubt found, and return True if
        both speeds are sound.

        Compared are first the sizes of the two speeds (`_wrong_ratio`), then their directions, then
        the slip with that of the speeds. Nothing is doubtful where fewer than `_LEAST` steps drive
        with both speeds. A speed of 0 throughout is not sound, and is doubted later
        (`_stuck_sensors`).
        """
        rim = self.rim
        speed = self.speed
        both = self.drives & ~np.isnan(rim + speed)
        moves = both & (np.abs(speed) > self.slowest)
        # if they are enough, steps in which the wheel travels: a stuck one shows no ratio
        both = moves if moves.sum() >= _LEAST else both
        if both.sum() < _LEAST:
            return True
        for name in ("wheel_speed", "speed"):
            if self._is_stuck(name) and not np.any(self._driven(self.log.get(name))):
                return False  # a speed of 0 throughout is left to `_stuck_sensors`
        wrong = self._wrong_ratio(both, moves)
        if wrong is not None:
            ratio, (low, high) = wrong
            divisor = max(ratio, _LEAST_DIVISOR)
            # Least and greatest factor on a reading that bring the ratio between _HELD and _SPUN.
            factors = {
                "wheel_speed": (_HELD / divisor, _SPUN / divisor),
                "speed": (ratio / _SPUN, ratio / _HELD),
            }
            units = [
                f"{name} in {u}" for name, of in factors.items() for u in self._units(name, *of)
            ]
            reason = (
                " or ".join(units)
                or f"another unit or gear{', or a wheel that hardly gets on' * (ratio > 1.0)}"
            )
            said = f"a rim speed of {ratio:.3g} times the travel speed of {self._place('speed')}"
            self._doubt("wheel_speed", said, f"{low:g} to {high:g}", reason)
            return False
        if _median(np.sign(rim * speed)[both]) < 0.0:
            said = f"against the travel speed of {self._place('speed')}"
            self._doubt("wheel_speed", said, "the same direction", "another sign of one of the two")
            return False
        of_speeds = slips(rim, speed)[both]
        # Median by which the slip is off, as it reads and with the opposite sign.
        slip = self.log.get("slip")[both]
        away, opposite = (_median(np.abs(slip - sign * of_speeds)) for sign in (1.0, -1.0))
        if away > _SLIP_OFF or away > max(_SLIP_TURNED, _FITS_BETTER * opposite):
            expected = f"{_median(of_speeds):.2g} by the two speeds"
            self._doubt(
                "slip", f"{_median(slip):.2g}", expected, "another sign, unit or definition"
            )
            return False
        return True

    def _wrong_ratio(
        self, both: np.ndarray, moves: np.ndarray
    ) -> tuple[float, tuple[float, float]] | None:
        """(Rim speed over travel speed [-], the limits that it is beyond), None if it is plausible.

        The ratio of the medians in the steps `both` [N] has to be in `_RIM`. That at the least slip
        has to be in `_FREEST`; it is known if the rim turns in `_LEAST` of the steps `moves` [N].
        Where it is known a ratio above `_RIM` is plausible: the wheel may be stuck in other steps.
        """
        rim = np.abs(self.rim)
        speed = np.abs(self.speed)
        ratio = _median(rim[both]) / max(_median(speed[both]), _LEAST_DIVISOR)
        turns = moves & (rim > self.slowest)
        known = turns.sum() >= _LEAST
        if ratio < _RIM[0] or (ratio > _RIM[1] and not known):
            return ratio, _RIM
        freest = np.quantile(rim[turns] / speed[turns], _FREE_SHARE) if known else 1.0
        return None if _FREEST[0] <= freest <= _FREEST[1] else (freest, _FREEST)

    def _sizes(self) -> bool:
        """Compare readings with sizes of the wheel; True if nothing is doubtful.

        The quantile of a reading's size that `usual` of its `Sensor` names is taken over the size
        of the wheel, or over its unit. A doubtful load is the last comparison, since the weight may
        be wrong, too. A sinkage of 0 throughout is left to `_stuck_sensors`.
        """
        gravity = self.map.gravity
        sizes = sizes_of(self.map.wheel, gravity)
        before = len(self.lines)
        for name, unit, of, (quantile, low, high) in _SIZED:
            values = self._driven(np.abs(self.log.get(name)))
            if values.size < _LEAST:
                continue
            size = np.quantile(values, quantile)
            ratio = size / sizes.get(of, 1.0)
            if low <= ratio <= high or (ratio == 0.0 and name == "sinkage"):
                continue
            geared = name in GEARED and self.map.channels[name].gear == 1.0
            reason = f"another unit{', gear' * geared} or field"
            if ratio == 0.0:
                reason = "a dead sensor"
            elif units := self._units(name, low / ratio, high / ratio):
                reason = f"unit {' or '.join(units)}"
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
        """Doubt the sign of a pitch whose gravity along the course another sensor feels reversed.

        An accelerometer reads dv/dt + g sin(pitch), and so does the pull over the mass on the
        wheel, which is taken without one. An unknown dv/dt counts as 0. Reversed means a slope of
        the regression of at most `_AGAINST` and a correlation of at most minus `_ALIKE`. A course
        below `_HILL` and one of fewer than `_LEAST` steps tell nothing.
        """
        log = self.log
        gravity = self.map.gravity
        if len(log) < _LEAST:
            return
        name = "acceleration" if "acceleration" in log.readings else "drawbar_pull"
        felt = log.get(name) / (1.0 if name == "acceleration" else self.map.wheel.body_mass)
        felt -= np.nan_to_num(np.gradient(self.speed, log.time))
        expected = gravity * np.sin(log.get("pitch"))
        known = ~np.isnan(expected + felt)
        x = expected[known]  # [m/s2] gravity along the course, by the pitch
        y = felt[known]  # [m/s2] the same, by the other sensor
        if x.size < _LEAST or math.sqrt((x @ x) / x.size) < _HILL * gravity:
            return
        slope = (x @ y) / (x @ x)
        alike = (x @ y) / math.sqrt(max((x @ x) * (y @ y), _TINIEST))
        if slope <= _AGAINST and alike <= -_ALIKE:
            said = f"{slope:.2g} times the slope that {self._place(name)} feels"
            self._doubt("pitch", said, "the same slope", "another sign of one of the two")

    def _is_stuck(self, name: str) -> bool:
        """True if a reading that is no constant of the map has one value in all steps that drive,
        `_LEAST` or more.
        """
        values = self._driven(self.log.get(name))
        one = values.size >= _LEAST and np.ptp(values) == 0.0
        return bool(one and self.map.channels[name].constant is None)

    def _stuck_sensors(self) -> None:
        """Doubt speeds, sinkage, pull and torques with one value in all steps that drive.

        The other readings are left out.
        """
        for name in ("wheel_speed", "speed", "sinkage", "drawbar_pull", "torque", "motor_torque"):
            if self._is_stuck(name):
                values = self._driven(self.log.get(name))
                said = f"{values[0]:.3g} {si_unit(name)} in all {values.size} steps that drive"
                self._doubt(name, said, "the noise of a sensor", "a stuck sensor, or a command")


def _median(values: np.ndarray) -> float:
    """Median of the known `values` [N]; 0, which raises no doubt, where all are NaN."""
    known = values[~np.isnan(values)]
    return float(np.median(known)) if known.size else 0.0
