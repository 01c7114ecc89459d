"""Readings of a recording, whatever its format, on one time axis."""

import math
from pathlib import Path

import numpy as np

from soil_env._io.loading import ParameterError, unknown_key
from soil_env.logs import bags, tables
from soil_env.logs.align import Aligned, Channel, align
from soil_env.logs.bags import Message, Notes, NotHere, Progress, number, parse
from soil_env.logs.doubts import doubts, time_doubts
from soil_env.logs.mapping import UNITS, LogMap, TimeColumn, factor
from soil_env.online import largest_readings

_DELAY = 1.0  # [s] between the clocks of header and recording, beyond which the report says so
_SLOW = 0.3  # share of interpolated steps beyond which the report says so


def read_recording(
    path: str | Path, log_map: LogMap, progress: Progress = lambda done, size: None
) -> Aligned:
    """The readings of a bag (a folder, .mcap, .db3), a CSV or a Parquet file, as `log_map`
    describes it.

    `progress` is called with the bytes read so far and those in all. Raises `ParameterError` for a
    recording of another format, a topic, field or column that it does not have, and one without a
    single reading of the wheel speed.
    """
    path = Path(path)
    stamps = log_map.time if _check_kind(path, log_map) else None
    notes = Notes()
    reader = _Reader(log_map)
    if stamps is not None:
        reader.read_table(path, stamps, notes, progress)
    else:
        reader.read_bag(path, notes, progress)
    found = align(reader.channels, reader.constants, log_map.period, log_map.max_gap)
    if len(found) == 0:
        raise ParameterError(
            f"{path}: {log_map.channels['wheel_speed'].place}: not one reading of wheel_speed"
        )
    found.notes.extend(notes.lines + _remarks(found, log_map, reader.limits))
    found.doubts.extend(
        time_doubts(reader.interval, reader.length, log_map) + doubts(found, log_map)
    )
    return found


def _check_kind(path: Path, log_map: LogMap) -> bool:
    """True for a table, False for a bag; `ParameterError` for neither, or where the map is for the
    other kind.
    """
    if not path.exists():
        raise ParameterError(
            f"{path}: is not there: expected a bag, an .mcap, .db3, .csv or .parquet file"
        )
    table = path.suffix.lower() in tables.SUFFIXES and path.is_file()
    if not (table or path.is_dir() or path.suffix in bags.SUFFIXES):
        raise ParameterError(
            f"{path}: expected a ROS 2 bag (a folder), an .mcap, .db3, .csv or .parquet file"
        )
    if path.is_file() and path.stat().st_size == 0:
        raise ParameterError(f"{path}: is empty (0 bytes)")
    for name, source in log_map.channels.items():
        if (source.topic and table) or (source.column and not table):
            expected = "column" if table else "topic and field"
            raise ParameterError(
                f"channels.{name}: has a {source.place}: expected {expected} for {path.name}"
            )
    if table and log_map.time is None:
        raise ParameterError(f"time: expected {{column: ..., unit: s}} for the table {path.name}")
    return table


class _Clock:
    """Time stamps of a table or of a topic; those that go back by more than `gap` [ns] are left
    out.

    Readings that are a little late, as of a recorder with several threads, still belong where their
    time says.
    """

    def __init__(self, source: str, gap: int) -> None:
        self._source = source
        self._gap = gap
        self._back = 0
        self._left_out = 0
        self._first = ""
        self.begin()

    def begin(self) -> None:
        """Begin another file, whose times may lie before those of the last."""
        self._latest = -(2**63)

    def accept(self, time: int, place: str) -> bool:
        """True if a reading of this time [ns] counts; `place`: its row or message."""
        if time >= self._latest:
            self._latest = time
            return True
        self._first = (
            self._first or f"{place} ({time * 1e-9:.3f} s after {self._latest * 1e-9:.3f} s)"
        )
        late = self._latest - time > self._gap
        self._back = self._back + 1
        self._left_out = self._left_out + late
        return not late

    def note(self, notes: Notes) -> None:
        """Add a note where time went back."""
        if self._back:
            notes.add(
                f"{self._source}: time goes back {self._back} times, first in {self._first}: "
                f"{self._left_out} of them, more than {self._gap * 1e-9:g} s (max_gap) late, left "
                "out"
            )


class _Reader:
    """Numbers of a recording, in SI units and by channel."""

    def __init__(self, log_map: LogMap) -> None:
        self.map = log_map
        given = log_map.channels
        self.constants = {
            n: s.constant * factor(n, s) + s.offset
            for n, s in given.items()
            if s.constant is not None
        }
        self.sources = {n: s for n, s in given.items() if s.constant is None}
        self.channels = {n: Channel(s.place) for n, s in given.items()}
        # Larger readings are left out.
        self.limits = largest_readings(log_map.wheel, log_map.gravity)._asdict()
        self._scale = {n: (factor(n, s), s.offset) for n, s in self.sources.items()}
        self._gap = round(log_map.max_gap * 1e9)
        self.interval = math.nan  # [s] median between the first rows of a table
        self.length = 0.0  # [s] from the first to the last row
        for name, value in self.constants.items():
            most = self.limits[name]
            if not abs(value) <= most:
                raise ParameterError(
                    f"channels.{name}: constant {value:g} in SI units: expected at most {most:g}"
                )

    def _add(self, name: str, time: int, value: float) -> None:
        """Count a reading in the unit of its source, and keep it if it is plausible."""
        scale, offset = self._scale[name]
        channel = self.channels[name]
        value = scale * value + offset
        channel.readings += 1
        if abs(value) <= self.limits[name]:
            channel.times.append(time)
            channel.values.append(value)
        else:
            channel.unusable += 1

    def read_table(self, path: Path, stamps: TimeColumn, notes: Notes, progress: Progress) -> None:
        """Read a CSV or Parquet file with a column of time stamps."""
        columns: dict[str, list[str]] = {}
        for name, source in self.sources.items():
            columns.setdefault(source.column, []).append(name)
        labels = {column: ", ".join(names) for column, names in columns.items()}
        clock = _Clock(path.name, self._gap)
        times: list[int] = []
        for row in tables.rows(path, stamps.column, stamps.unit, labels, notes, progress):
            if len(times) < 4096:
                times.append(row.time)
            self.length = (row.time - times[0]) * 1e-9
            if clock.accept(row.time, f"row {row.number}"):
                for names, value in zip(columns.values(), row.values, strict=True):
                    if value == value:
                        for name in names:
                            self._add(name, row.time, value)
        if len(times) > 1:
            self.interval = float(np.median(np.abs(np.diff(times)))) * 1e-9
        clock.note(notes)

    def read_bag(self, path: Path, notes: Notes, progress: Progress) -> None:
        """Read a bag."""
        by_topic: dict[str, list[str]] = {}
        for name, source in self.sources.items():
            by_topic.setdefault(source.topic, []).append(name)
        paths = {
            name: parse(source.field, f"channels.{name}.field")
            for name, source in self.sources.items()
        }
        lacking: dict[str, NotHere] = {}
        delays: dict[str, list[float]] = {topic: [] for topic in by_topic}
        clocks = {t: _Clock(f"topic {t}", self._gap) for t in by_topic}
        file = ""
        for message in bags.messages(path, set(by_topic), notes, progress):
            time = self._time(message, delays[message.topic])
            if notes.file != file:
                file = notes.file
                for clock in clocks.values():
                    clock.begin()
            if not clocks[message.topic].accept(
                time, f"the message recorded at {message.time * 1e-9:.3f} s"
            ):
                continue
            for name in by_topic[message.topic]:
                source = self.sources[name]
                where = (
                    f"channels.{name}: topic {message.topic} ({message.kind}), field {source.field}"
                )
                try:
                    self._add(
                        name,
                        time,
                        number(message.content, paths[name], where, source.unit == "quaternion"),
                    )
                except NotHere as error:
                    lacking.setdefault(name, error)
        self._check_found(path, notes, lacking)
        for clock in clocks.values():
            clock.note(notes)
        _note_delays(
            notes, {topic: float(np.mean(d)) for topic, d in delays.items() if d}, set(delays)
        )

    def _time(self, message: Message, delays: list[float]) -> int:
        """[ns] in the clock of the map; of a message without a stamp, the time of its recording."""
        stamp = getattr(getattr(message.content, "header", None), "stamp", None)
        own = (
            0
            if stamp is None
            else stamp.sec * 1_000_000_000 + getattr(stamp, "nanosec", getattr(stamp, "nsec", 0))
        )
        if own and self.map.clock == "header":
            delays.append((message.time - own) * 1e-9)
            return own
        return message.time

    def _check_found(self, path: Path, notes: Notes, lacking: dict[str, NotHere]) -> None:
        """Raise `ParameterError` for a topic that is not in the recording and a field that no
        message has.
        """
        if not notes.topics:
            said = f" ({'; '.join(notes.lines)})" if notes.lines else ""
            raise ParameterError(f"{path}: has no topics: not one message is whole{said}")
        for name, source in self.sources.items():
            if source.topic not in notes.topics:
                where = f"{path}: channels.{name}.topic"
                cut = " (of what is whole)" if notes.lines else ""
                raise ParameterError(
                    str(unknown_key(source.topic, notes.topics, where)).replace("key", "topic")
                    + cut
                )
            if name in lacking and self.channels[name].readings == 0:
                raise ParameterError(f"{path}: {lacking[name]}, in all messages")


def _note_delays(notes: Notes, mean: dict[str, float], topics: set[str]) -> None:
    """Add a note where the stamps of some topics are far off the clock of the recording, which
    others have.
    """
    late = [topic for topic, delay in mean.items() if abs(delay) > _DELAY]
    if late and len(mean) < len(topics):
        topic = max(late, key=lambda t: abs(mean[t]))
        notes.add(
            f"The stamps of {topic} are {mean[topic]:.3g} s off the clock of the recording, on "
            f"which {', '.join(sorted(topics - set(mean)))} is for want of stamps: these readings "
            "do not belong together in time. Try clock: log"
        )


def _remarks(found: Aligned, log_map: LogMap, limits: dict[str, float]) -> list[str]:
    """Notes on channels without readings, with implausible or slow ones, and on gaps."""
    lines = []
    for name, c in found.channels.items():
        place = f"{name}: {c.place}"
        if c.readings == 0 and log_map.channels[name].constant is None:
            lines.append(f"{place}: not one reading")
        if c.unusable:
            doubtful = ": another unit or field?" if 2 * c.unusable > c.readings else ""
            expected = f"expected at most {limits[name]:g} {next(iter(UNITS[name]))}"
            lines.append(
                f"{place}: {c.unusable} of {c.readings} readings out of range ({expected}), left "
                f"out{doubtful}"
            )
        if c.interpolated > _SLOW:
            lines.append(
                f"{place}: comes less often than every {found.period:g} s: {c.interpolated:.0%} of "
                "its values are interpolated and count as readings; a longer period would be more "
                "honest"
            )
    jumps = np.flatnonzero(np.diff(found.time) > log_map.max_gap)
    if jumps.size:
        lines.append(f"{jumps.size} gaps of more than {log_map.max_gap:g} s without any reading")
    return lines
