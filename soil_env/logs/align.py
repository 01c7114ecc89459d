"""All readings of a recording on one time axis.

The axis has steps of one period and begins at the first reading of the wheel speed. A step gets the mean of what a
channel read within half a period of it, so that a fast channel is averaged; where a slow one read nothing, it is
interpolated between its neighbours if these are no further apart than `max_gap`, else it is missing (NaN).

Sums are kept a block of steps at a time, whatever the order in which readings come: memory grows with the length of
the recording in time, by some 200 bytes a step, and not with the number or the size of its messages.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from soil_env.slip import travel_speeds

_BLOCK = 1024  # steps


@dataclass
class ChannelCount:
    """How a channel came."""

    place: str  # topic and field, or column
    readings: int = 0
    unusable: int = 0  # infinite, NaN, or out of any range
    interpolated: float = 0.0  # share of the steps
    missing: float = 0.0  # share of the steps


@dataclass(frozen=True, eq=False)
class Aligned:
    """Readings in SI units on one time axis."""

    start: int  # [ns] of time 0, in the clock of the recording
    time: np.ndarray  # [N] s, rising in whole periods, with jumps where nothing was read
    readings: dict[str, np.ndarray]  # [N] each, by the names of `soil_env.online.Readings`; NaN = missing
    counts: dict[str, ChannelCount]
    period: float  # [s]
    notes: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)  # to be checked first: readings that hardly can be

    def __len__(self) -> int:
        return self.time.size

    def travelled(self, radius: float) -> np.ndarray:
        """Distance [N] in m from the beginning on, without what was travelled in gaps; `radius` [m] of the wheel."""
        nan = np.full(len(self), math.nan)
        rim, speed = self.readings["wheel_speed"] * radius, self.readings.get("speed", nan)
        slip = np.clip(np.nan_to_num(self.readings.get("slip", nan)), -0.9, 1.0)
        speed = np.where(np.isnan(speed), travel_speeds(rim, slip), speed)
        steps = np.minimum(np.diff(self.time, prepend=self.time[:1]), self.period)
        return np.cumsum(np.abs(np.nan_to_num(speed)) * steps)


class Bins:
    """Sums of readings by step; `names` are those of the channels."""

    def __init__(self, names: list[str], period: float) -> None:
        self._names, self._period = names, round(period * 1e9)
        self._origin: int | None = None
        self._blocks: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def _place(self, time: int) -> tuple[int, int]:
        if self._origin is None:
            self._origin = time
        return divmod((time - self._origin + self._period // 2) // self._period, _BLOCK)

    def _block(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        if number not in self._blocks:
            shape = (len(self._names), _BLOCK)
            self._blocks[number] = np.zeros(shape), np.zeros(shape, np.int32)
        return self._blocks[number]

    def add(self, channel: int, time: int, value: float) -> None:
        """Count one reading at `time` [ns]."""
        number, step = self._place(time)
        sums, counts = self._block(number)
        sums[channel, step] += value
        counts[channel, step] += 1

    def add_rows(self, times: np.ndarray, values: np.ndarray) -> None:
        """Count rows: `times` [N] ns int64, `values` [N, channels] with NaN where there is none."""
        if times.size == 0:
            return
        self._place(int(times[0]))
        steps = (times - self._origin + self._period // 2) // self._period
        numbers, within = steps // _BLOCK, steps % _BLOCK
        for number in np.unique(numbers):
            sums, counts = self._block(int(number))
            rows = numbers == number
            for channel in range(values.shape[1]):
                good = rows & np.isfinite(values[:, channel])
                np.add.at(sums[channel], within[good], values[good, channel])
                np.add.at(counts[channel], within[good], 1)

    def means(self) -> tuple[np.ndarray, np.ndarray]:
        """Steps [N] counted from the first reading, and the means [channels, N] at them, NaN where there is none."""
        numbers = sorted(self._blocks)
        if not numbers:
            return np.zeros(0, np.int64), np.zeros((len(self._names), 0))
        steps = np.concatenate([n * _BLOCK + np.arange(_BLOCK) for n in numbers])
        sums = np.concatenate([self._blocks[n][0] for n in numbers], axis=1)
        counts = np.concatenate([self._blocks[n][1] for n in numbers], axis=1)
        self._blocks.clear()
        sums[counts == 0] = math.nan
        np.divide(sums, counts, out=sums, where=counts > 0)
        return steps, sums

    @property
    def origin(self) -> int:
        """[ns] of step 0."""
        return self._origin or 0


def aligned(
    bins: Bins, counts: dict[str, ChannelCount], constants: dict[str, float], period: float, max_gap: float
) -> Aligned:
    """The time axis from the first to the last reading of the wheel speed, and the readings on it."""
    names = [name for name in counts if name not in constants]
    steps, means = bins.means()
    turning = np.flatnonzero(~np.isnan(means[names.index("wheel_speed")]))
    if turning.size == 0:
        return Aligned(0, np.zeros(0), {n: np.zeros(0) for n in counts}, counts, period)
    first, last = turning[0], turning[-1] + 1
    margin = math.ceil(max_gap / period) + 1  # neighbours to interpolate between
    low, high = max(0, first - margin), min(steps.size, last + margin)
    inner = slice(first - low, last - low)
    time = (steps[first:last] - steps[first]) * period
    readings = {}
    for k, name in enumerate(names):
        values, filled = interpolated(steps[low:high] * period, means[k, low:high], max_gap)
        readings[name] = values[inner]
        counts[name].interpolated = float(np.mean(filled[inner]))
        counts[name].missing = float(np.mean(np.isnan(values[inner])))
    for name, value in constants.items():
        readings[name] = np.full(time.size, value)
    seen = ~np.all([np.isnan(readings[n]) for n in names], axis=0)
    start = bins.origin + int(steps[first]) * round(period * 1e9)
    return Aligned(start, time[seen], {n: v[seen] for n, v in readings.items()}, counts, period)


def interpolated(time: np.ndarray, values: np.ndarray, max_gap: float) -> tuple[np.ndarray, np.ndarray]:
    """`values` [N] at `time` [N] with NaN filled linearly between neighbours at most `max_gap` apart; where so."""
    known = np.flatnonzero(~np.isnan(values))
    filled = np.zeros(values.size, bool)
    if known.size < 2:
        return values, filled
    after = np.clip(np.searchsorted(known, np.arange(values.size)), 1, known.size - 1)
    apart = time[known[after]] - time[known[after - 1]]
    inside = (np.arange(values.size) > known[0]) & (np.arange(values.size) < known[-1])
    filled = np.isnan(values) & inside & (apart <= max_gap * (1.0 + 1e-9))
    out = values.copy()
    out[filled] = np.interp(time[filled], time[known], values[known])
    return out, filled
