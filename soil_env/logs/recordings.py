"""A recording, whatever its format, to readings on one time axis."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from soil_env._io.loading import ParameterError, unknown_key
from soil_env.logs import bags, tables
from soil_env.logs.align import Aligned, Bins, ChannelCount, aligned
from soil_env.logs.bags import Message, Notes, Progress
from soil_env.logs.doubts import doubts, time_doubts
from soil_env.logs.fields import NotHere, number, parse
from soil_env.logs.mapping import UNITS, LogMap, Source, factor
from soil_env.online import largest_readings

_DELAY = 1.0  # [s] between the clocks of header and recording, beyond which it is told
_SLOW = 0.3  # share of interpolated steps beyond which it is told


def read_recording(path: str | Path, log_map: LogMap, progress: Progress = lambda done, size: None) -> Aligned:
    """The readings of a bag (a folder, .mcap, .db3), a CSV or a Parquet file, as `log_map` describes it.

    `progress` is called with the bytes read so far and those in all. Raises `ParameterError` for a recording of another
    format, a topic, field or column that it does not have, and one without a single reading of the wheel speed.
    """
    path = Path(path)
    if not path.exists():
        raise ParameterError(f"{path}: is not there: expected a bag, an .mcap, .db3, .csv or .parquet file")
    table = path.suffix.lower() in tables.SUFFIXES and path.is_file()
    if not (table or path.is_dir() or path.suffix in bags.SUFFIXES):
        raise ParameterError(f"{path}: expected a ROS 2 bag (a folder), an .mcap, .db3, .csv or .parquet file")
    if path.is_file() and path.stat().st_size == 0:
        raise ParameterError(f"{path}: is empty (0 bytes)")
    _check_kind(path, log_map, table)
    notes, reader = Notes(), _Reader(log_map)
    (reader.table if table else reader.bag)(path, notes, progress)
    found = aligned(reader.bins, reader.counts, reader.constants, log_map.period, log_map.max_gap)
    if len(found) == 0:
        raise ParameterError(f"{path}: {log_map.channels.wheel_speed.place}: not one reading of wheel_speed")
    found.notes.extend(notes.lines + _remarks(found, log_map))
    found.doubts.extend(time_doubts(reader.interval, reader.length, log_map) + doubts(found, log_map))
    return found


def largest(log_map: LogMap) -> dict[str, float]:
    """Sizes [SI] by the name of the reading, beyond which one is left out as that of no such wheel."""
    return largest_readings(log_map.wheel.wheel(), log_map.gravity)._asdict()


def _check_kind(path: Path, log_map: LogMap, table: bool) -> None:
    """Refuse a map of topics for a table and one of columns for a bag."""
    for name, source in log_map.channels.given().items():
        if (source.topic and table) or (source.column and not table):
            expected = "column" if table else "topic and field"
            raise ParameterError(f"channels.{name}: has a {source.place}: expected {expected} for {path.name}")
    if table and log_map.time is None:
        raise ParameterError(f"time: expected {{column: ..., unit: s}} for the table {path.name}")


class _Clock:
    """Watches the time stamps of a table, or of a topic: those that go back by more than `gap` [ns] are left out.

    Readings that are a little late, as of a recorder with several threads, still belong where their time says.
    """

    def __init__(self, topic: str, gap: int) -> None:
        self._topic, self._gap, self._latest = topic, gap, -(2**63)
        self._back = self._left_out = 0
        self._first = ""

    def begin(self) -> None:
        """Another file, whose times may lie before those of the last."""
        self._latest = -(2**63)

    def kept(self, time: int, place: int) -> bool:
        """Whether a reading of this time is taken; `place` is its row, or when its message was recorded [ns]."""
        if time >= self._latest:
            self._latest = time
            return True
        if not self._back:
            where = f"the message recorded at {place * 1e-9:.3f} s" if self._topic else f"row {place}"
            self._first = f"{where} ({time * 1e-9:.3f} s after {self._latest * 1e-9:.3f} s)"
        late = self._latest - time > self._gap
        self._back += 1
        self._left_out += late
        return not late

    def kept_rows(self, times: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Whether each row [N] of a table, which stand in these rows of the file, is taken."""
        if times.size and times[0] >= self._latest and np.all(np.diff(times) >= 0):
            self._latest = int(times[-1])
            return np.ones(times.size, bool)
        return np.array([self.kept(t, r) for t, r in zip(times.tolist(), rows.tolist(), strict=True)], bool)

    def lines(self) -> list[str]:
        """What is to be told: nothing where time never went back."""
        if not self._back:
            return []
        each = "message" if self._topic else "row"
        often = f"in {self._back} {each}s, first in" if self._back > 1 else "in"
        out = f"{self._left_out} of them, more than {self._gap * 1e-9:g} s (max_gap) late, left out"
        rest = out if self._left_out else "taken in the order of time"
        return [f"{f'topic {self._topic}: ' if self._topic else ''}time goes back {often} {self._first}: {rest}"]


class _Reader:
    """Takes numbers out of the recording and puts them where they belong in time."""

    def __init__(self, log_map: LogMap) -> None:
        self.map, given = log_map, log_map.channels.given()
        self.constants = {
            n: s.constant * factor(n, s) + s.offset for n, s in given.items() if s.constant is not None
        }  # fmt: skip
        self.sources = {n: s for n, s in given.items() if s.constant is None}
        self.counts = {n: ChannelCount(s.place) for n, s in given.items()}
        self.bins = Bins(list(self.sources), log_map.period)
        self.factors = {n: factor(n, s) for n, s in self.sources.items()}
        self.limits = largest(log_map)
        self.interval = math.nan  # [s] between the first rows of a table, in the middle
        self.length = 0.0  # [s] from the first to the last row
        for name, value in self.constants.items():
            if not abs(value) <= self.limits[name]:
                raise ParameterError(
                    f"channels.{name}: constant {value:g} in SI units: expected at most {self.limits[name]:g}"
                )

    # --- tables ---

    def table(self, path: Path, notes: Notes, progress: Progress) -> None:
        """Read a CSV or Parquet file."""
        stamps = self.map.time
        columns: dict[str, str] = {}
        for name, source in self.sources.items():
            columns[source.column] = f"{columns[source.column]}, {name}" if source.column in columns else name
        clock, first = _Clock("", round(self.map.max_gap * 1e9)), None
        for lines, times, values in tables.blocks(path, stamps.column, stamps.unit, columns, notes, progress):
            taken = clock.kept_rows(times, lines)
            if first is None and times.size > 1:
                self.interval, first = float(np.median(np.abs(np.diff(times)))) * 1e-9, int(times[0])
            if first is not None:
                self.length = (int(times[-1]) - first) * 1e-9
            times, values = times[taken], {c: v[taken] for c, v in values.items()}
            rows = np.empty((times.size, len(self.sources)))
            for k, (name, source) in enumerate(self.sources.items()):
                rows[:, k] = self.factors[name] * values[source.column] + source.offset
                given = ~np.isnan(values[source.column])
                with np.errstate(invalid="ignore"):
                    bad = given & ~(np.abs(rows[:, k]) <= self.limits[name])
                rows[bad, k] = math.nan
                self.counts[name].readings += int(np.sum(given))
                self.counts[name].unusable += int(np.sum(bad))
            self.bins.add_rows(times, rows)
        notes.lines.extend(clock.lines())

    # --- bags ---

    def bag(self, path: Path, notes: Notes, progress: Progress) -> None:
        """Read a bag."""
        by_topic: dict[str, list[tuple[int, str, Source, tuple[str | int, ...]]]] = {}
        for k, (name, source) in enumerate(self.sources.items()):
            steps = parse(source.field, f"channels.{name}.field")
            by_topic.setdefault(source.topic, []).append((k, name, source, steps))
        lacking: dict[str, NotHere] = {}
        delays: dict[str, list[float]] = {topic: [0.0, 0] for topic in by_topic}
        clocks, file = {t: _Clock(t, round(self.map.max_gap * 1e9)) for t in by_topic}, ""
        for message in bags.messages(path, set(by_topic), notes, progress):
            time = self._time(message, delays[message.topic])
            if notes.file != file:
                file = notes.file
                for clock in clocks.values():
                    clock.begin()
            if not clocks[message.topic].kept(time, message.time):
                continue
            for k, name, source, steps in by_topic[message.topic]:
                where = f"channels.{name}: topic {message.topic} ({message.kind}), field {source.field}"
                try:
                    value = number(message.content, steps, where, source.unit == "quaternion")
                except NotHere as error:
                    lacking.setdefault(name, error)
                    continue
                value = self.factors[name] * value + source.offset
                self.counts[name].readings += 1
                if abs(value) <= self.limits[name]:
                    self.bins.add(k, time, value)
                else:
                    self.counts[name].unusable += 1
        self._check_found(path, notes, lacking)
        notes.lines.extend(line for clock in clocks.values() for line in clock.lines())
        self._tell_delays(notes, delays)

    def _time(self, message: Message, delay: list[float]) -> int:
        """[ns] in the clock of the map; where a message has no stamp of its own, that of its recording."""
        stamp = getattr(getattr(message.content, "header", None), "stamp", None)
        own = 0 if stamp is None else stamp.sec * 1_000_000_000 + getattr(stamp, "nanosec", getattr(stamp, "nsec", 0))
        if own and self.map.clock == "header":
            delay[0] += (message.time - own) * 1e-9
            delay[1] += 1
            return own
        return message.time

    def _check_found(self, path: Path, notes: Notes, lacking: dict[str, NotHere]) -> None:
        if not notes.topics:
            said = f" ({'; '.join(notes.lines)})" if notes.lines else ""
            raise ParameterError(f"{path}: has no topics: not one message is whole{said}")
        for name, source in self.sources.items():
            if source.topic not in notes.topics:
                where = f"{path}: channels.{name}.topic"
                cut = " (of what is whole)" if notes.lines else ""
                raise ParameterError(str(unknown_key(source.topic, notes.topics, where)).replace("key", "topic") + cut)
            if name in lacking and self.counts[name].readings == 0:
                raise ParameterError(f"{path}: {lacking[name]}, in all messages")

    def _tell_delays(self, notes: Notes, delays: dict[str, list[float]]) -> None:
        mean = {topic: total / count for topic, (total, count) in delays.items() if count}
        late = {topic: d for topic, d in mean.items() if abs(d) > _DELAY}
        if late and len(mean) < len(delays):
            topic = max(late, key=lambda t: abs(late[t]))
            without = ", ".join(sorted(set(delays) - set(mean)))
            notes.add(
                f"The stamps of {topic} are {late[topic]:.3g} s off the clock of the recording, which {without} has "
                "for want of stamps: these readings do not belong together in time. Try clock: log"
            )


def _remarks(found: Aligned, log_map: LogMap) -> list[str]:
    """What is odd about the readings."""
    lines = []
    for name, count in found.counts.items():
        if name in log_map.channels.given() and log_map.channels.given()[name].constant is not None:
            continue
        if count.readings == 0:
            lines.append(f"{name}: {count.place}: not one reading")
        if count.unusable:
            doubtful = ": another unit or field?" if 2 * count.unusable > count.readings else ""
            lines.append(
                f"{name}: {count.place}: {count.unusable} of {count.readings} readings out of range (expected at most "
                f"{largest(log_map)[name]:g} {next(iter(UNITS[name]))}), left out{doubtful}"
            )
        if count.interpolated > _SLOW:
            lines.append(
                f"{name}: {count.place}: comes less often than every {found.period:g} s: "
                f"{100 * count.interpolated:.0f} % of its values are interpolated and count as readings; "
                "a longer period would be more honest"
            )
    jumps = np.flatnonzero(np.diff(found.time) > log_map.max_gap)
    if jumps.size:
        lines.append(f"{jumps.size} gaps of more than {log_map.max_gap:g} s without any reading")
    return lines
