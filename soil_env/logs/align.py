"""Readings of a recording on one time axis.

The axis has steps of one period and begins at the first reading of the wheel speed. A step has the
mean of the readings of a channel within half a period of it. Where a slow channel has none, its
value is interpolated between neighbours that are at most `max_gap` apart; elsewhere it is missing
(NaN).
"""

import math
from array import array
from dataclasses import dataclass, field

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.measurement.table import with_default
from soil_env.online import slips
from soil_env.slip import travel_speeds

MOST_STEPS = 2_000_000  # of a time axis: 55 hours at 0.1 s, of which a replay takes an hour
_LOCKED = -0.9  # [-] least slip from which a travel speed is taken: a locked rim tells none
_ROUNDING = 1e-9  # [of `max_gap`] by which a gap may be longer: sums of periods are rounded


@dataclass
class Channel:
    """Readings of one channel at their own times, before they are put on the common axis, and what
    became of them.
    """

    place: str  # topic and field, or column
    readings: int = 0  # at time stamps that count, with the empty and the unusable ones
    #: Infinite or NaN: a range finder without an echo (REP 117), a sensor that is off.
    empty: int = 0
    unusable: int = 0  # larger than any reading of this wheel can be (`largest_readings`)
    per_second: float = math.nan  # readings, over their own duration; NaN of fewer than two
    interpolated: float = 0.0  # share of the steps
    missing: float = 0.0  # share of the steps
    #: [ns] of usable readings. While a recording is read: indices of their stamps in `Stamps`.
    times: array = field(default_factory=lambda: array("q"), repr=False)
    values: array = field(default_factory=lambda: array("d"), repr=False)


@dataclass(frozen=True, eq=False)
class Aligned:
    """Readings in SI units on one time axis."""

    start: int  # [ns] of time 0, in the clock of the recording
    time: np.ndarray  # [N] s, rising in whole periods, with jumps where nothing was read
    #: [N] each, by the names of `soil_env.online.Readings`; NaN = missing.
    readings: dict[str, np.ndarray]
    channels: dict[str, Channel]
    period: float  # [s]
    notes: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)  # implausible readings, to be checked first

    def __len__(self) -> int:
        """Number of steps."""
        return self.time.size

    def get(self, name: str, other: float | np.ndarray = math.nan) -> np.ndarray:
        """Readings [N] of a channel; `other`, a number or [N], where it is not measured."""
        return with_default(self.readings.get(name, np.full(len(self), math.nan)), other)

    def motion(self, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(Rim speed [m/s], travel speed [m/s], slip) [N] of a wheel of `radius` [m].

        Speed and slip follow from each other where one of them is missing. A measured slip is cut
        to [-1, 1], and where a speed follows from it to at least `_LOCKED`.
        """
        rim = self.get("wheel_speed") * radius
        slip = np.clip(self.get("slip", slips(rim, self.get("speed"))), -1.0, 1.0)
        return rim, self.get("speed", travel_speeds(rim, np.maximum(slip, _LOCKED))), slip

    def travelled(self, radius: float) -> np.ndarray:
        """Distance [N] in m from the beginning for a wheel of `radius` [m]; going back adds, too.

        Where the travel speed is missing the rim's is taken, and 0 where that is missing. A gap
        counts as one period, since nothing is known of the drive in it.
        """
        rim, speed, _ = self.motion(radius)
        steps = np.minimum(np.diff(self.time, prepend=self.time[:1]), self.period)
        return np.cumsum(np.abs(np.nan_to_num(with_default(speed, rim))) * steps)


def align(
    channels: dict[str, Channel], constants: dict[str, float], period: float, max_gap: float
) -> Aligned:
    """Put the readings of `channels` on one axis, from the first wheel speed to the last.

    `constants` are readings in SI units that hold at every step, by name. Steps at which no
    measured channel has a value, read or interpolated, are left out. The shares `interpolated` and
    `missing` of each measured channel are set. `period` and `max_gap` are in s. The wheel speed
    needs a reading. `ParameterError` for more than `MOST_STEPS` steps.
    """
    period_ns = round(period * 1e9)
    measured = {n: c for n, c in channels.items() if n not in constants}
    origin = int(np.frombuffer(channels["wheel_speed"].times, np.int64).min())
    # By channel: number of the step that is nearest to each reading; origin is step 0.
    steps = {
        n: (np.frombuffer(c.times, np.int64) - origin + period_ns // 2) // period_ns
        for n, c in measured.items()
    }
    # Numbers of all steps, those before the axis and after it too: their readings fill gaps.
    grid = _bridged(np.unique(np.concatenate(list(steps.values()))), round(max_gap / period))
    on_axis = (grid >= 0) & (grid <= steps["wheel_speed"].max())
    readings = {}
    between = {}  # by channel, True at the steps whose value is interpolated
    for name, channel in measured.items():
        # By reading of the channel: index in `grid` of its step.
        on_grid = np.searchsorted(grid, steps[name])
        counts = np.bincount(on_grid, minlength=grid.size)
        sums = np.bincount(on_grid, np.frombuffer(channel.values), grid.size)
        means = np.divide(sums, counts, out=np.full(grid.size, math.nan), where=counts > 0)
        values, filled = interpolated(grid * period, means, max_gap)
        readings[name] = values[on_axis]
        between[name] = filled[on_axis]
    time = grid[on_axis] * period
    seen = ~np.all([np.isnan(v) for v in readings.values()], axis=0)
    for name, channel in measured.items():
        channel.interpolated = float(np.mean(between[name][seen]))
        channel.missing = float(np.mean(np.isnan(readings[name][seen])))
    readings |= {name: np.full(time.size, value) for name, value in constants.items()}
    return Aligned(origin, time[seen], {n: v[seen] for n, v in readings.items()}, channels, period)


def _bridged(steps: np.ndarray, most: int) -> np.ndarray:
    """Rising whole numbers `steps` [N], with the numbers between neighbours filled in where these
    are at most `most` apart; wider gaps stay open.

    `ParameterError` for more than `MOST_STEPS`.
    """
    count = np.where(np.diff(steps) <= most, np.diff(steps), 1)
    if count.sum() >= MOST_STEPS:
        raise ParameterError(
            f"period: the recording has {count.sum() + 1} steps of it: expected at most "
            f"{MOST_STEPS}; take a longer one, or a part of the recording"
        )
    # 0, 1, ... from each of `steps` to the number before the next.
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.append(np.repeat(steps[:-1], count) + within, steps[-1:])


def interpolated(
    time: np.ndarray, values: np.ndarray, max_gap: float
) -> tuple[np.ndarray, np.ndarray]:
    """(`values` [N] with NaN filled linearly, True [N] where filled).

    A NaN is filled if the known values around it are at most `max_gap` apart, in the unit of `time`
    [N]. NaN before the first known value and after the last stays.
    """
    filled = np.isnan(values)
    known = np.flatnonzero(~filled)
    if not known.size:
        return values, ~filled
    near = np.diff(time[known]) <= max_gap * (1.0 + _ROUNDING)
    filled[: known[0]] = False
    filled[known[0] : known[-1]] &= np.repeat(near, np.diff(known))
    filled[known[-1] :] = False
    return np.where(filled, np.interp(time, time[known], values[known]), values), filled
