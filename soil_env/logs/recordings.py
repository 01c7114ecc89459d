"""Readings of a recording, whatever its format, on one time axis."""

from array import array
from pathlib import Path
from typing import Any

import numpy as np

from soil_env._io.loading import ParameterError, plural, unknown_key
from soil_env.online import largest_readings

from . import bags, tables
from .align import Aligned, Channel, align
from .bags import Message, NotHere, number, parse
from .doubts import doubts, time_doubts
from .mapping import LogMap, Source, TimeColumn, factor, si_unit
from .notes import Faults, Notes, Progress
from .stamps import LATEST, Stamps

MOST_READINGS = 50_000_000  # of all channels: 800 MB
_DELAY = 1.0  # [s] mean, between stamps of headers and of the recording; a note says so beyond
_SLOW = 0.3  # share of interpolated steps beyond which the report says so
_FIRST_ROWS = 4096  # of a table: their median interval stands for all; own choice


def read_recording(
    path: str | Path, log_map: LogMap, progress: Progress = lambda done, size: None
) -> Aligned:
    """The readings of a bag (a folder, .mcap, .db3), a CSV or a Parquet file, as `log_map`
    describes it, with notes and doubts.

    `progress` is called with the bytes (of Parquet: rows) read so far and those in all. Raises
    `ParameterError` for a recording of another format, a topic, field or column that it does not
    have, and one without a single reading of the wheel speed.
    """
    path = Path(path)
    stamps = _stamp_column(path, log_map)
    reader = _Reader(log_map, Notes(path, progress))
    if stamps is not None:
        reader.read_table(stamps)
    else:
        reader.read_bag()
    turning = reader.channels["wheel_speed"]
    if not turning.times:
        raise ParameterError(f"{path}: {turning.place}: not one reading of wheel_speed")
    found = align(reader.channels, reader.constants, log_map.period, log_map.max_gap)
    found.notes.extend(reader.notes.lines + _remarks(found, log_map, reader.limits))
    found.doubts.extend(reader.doubts + doubts(found, log_map))
    return found


def _stamp_column(path: Path, log_map: LogMap) -> TimeColumn | None:
    """The column of time stamps of a table, None for a bag, by the name of the path.

    `ParameterError` for neither, for a missing or empty file, and for a map whose channels or time
    are those of the other kind.
    """
    if not path.exists():
        raise ParameterError(
            f"{path}: is not there: expected a bag, an .mcap, .db3, .csv or .parquet file"
        )
    table = path.suffix.lower() in tables.SUFFIXES and path.is_file()
    if not (table or path.is_dir() or path.suffix in bags.SUFFIXES):
        bags.check_packed(path)
        old = "; rosbags-convert makes one of a bag of ROS 1" * (path.suffix == ".bag")
        raise ParameterError(
            f"{path}: expected a ROS 2 bag (a folder), an .mcap, .db3, .csv or .parquet file{old}"
        )
    if path.is_file() and path.stat().st_size == 0:
        raise ParameterError(f"{path}: is empty (0 bytes)")
    for name, source in log_map.channels.items():
        if (source.topic and table) or (source.column and not table):
            expected = f"a column of the table {path.name}" if table else "topic and field of a bag"
            raise ParameterError(f"channels.{name}: is a {source.place}: expected {expected}")
    if table and log_map.time is None:
        raise ParameterError(f"time: expected {{column: ..., unit: s}} for the table {path.name}")
    return log_map.time if table else None


class _Reader:
    """Reader of a recording into `channels`, by `read_table` or `read_bag`; one for each recording.

    While it reads, a channel holds numbers as they are in the recording, with the indices of their
    stamps. At the end these become readings in SI units and times. `ParameterError` for a constant
    beyond the largest plausible reading.
    """

    def __init__(self, log_map: LogMap, notes: Notes) -> None:
        self.map = log_map
        self.notes = notes
        self.constants: dict[str, float] = {}  # readings in SI units, by channel
        self.sources: dict[str, Source] = {}  # of the channels that are read
        self.channels = {n: Channel(s.place) for n, s in log_map.channels.items()}
        #: Largest plausible reading in SI units, by channel; larger ones are left out.
        self.limits = largest_readings(log_map.wheel, log_map.gravity)._asdict()
        self.doubts: list[str] = []  # on the unit of the time stamps
        #: `max_gap` and `restart_gap` [ns].
        self._gaps = round(log_map.max_gap * 1e9), round(log_map.restart_gap * 1e9)
        self._left = MOST_READINGS  # that may still come
        for name, source in log_map.channels.items():
            if source.constant is None:
                self.sources[name] = source
                continue
            value = source.constant * factor(name, source) + source.offset
            most = self.limits[name]
            if not abs(value) <= most:
                raise ParameterError(
                    f"channels.{name}: constant {value:g} in SI units: expected at most {most:g}"
                )
            self.constants[name] = value

    def _add(self, name: str, index: int, value: float) -> None:
        """Keep a reading of channel `name` in the unit of its source; `index`: of its stamp.

        `ParameterError` for more than `MOST_READINGS` of all channels.
        """
        self._left -= 1
        if self._left < 0:
            raise ParameterError(
                f"{self.notes.path}: has more than {MOST_READINGS} readings of the channels of the "
                "map: expected fewer; read it in parts"
            )
        channel = self.channels[name]
        channel.times.append(index)  # a time only after `_finish`
        channel.values.append(value)

    def _finish(self, name: str, times: np.ndarray, kept: np.ndarray) -> None:
        """Turn the readings of a channel into SI units, and the indices of their stamps into times
        [ns].

        `times` [ns] and `kept` [N] are those of the stamps; readings of a stamp that is not kept
        are dropped. NaN and infinite readings are counted as `empty`, those beyond `limits` as
        `unusable`, and both left out. A note says where readings of one time differ.
        """
        channel = self.channels[name]
        index = np.frombuffer(channel.times, np.int64)
        value = np.frombuffer(channel.values)[kept[index]]
        index = index[kept[index]]
        source = self.sources[name]
        with np.errstate(over="ignore", invalid="ignore"):
            si = value * factor(name, source) + source.offset
        known = np.isfinite(value)
        plausible = np.abs(si) <= self.limits[name]
        channel.readings = value.size
        channel.empty = int(np.sum(~known))
        channel.unusable = int(np.sum(known & ~plausible))
        stamps = times[index]
        length = np.ptp(stamps) * 1e-9 if stamps.size else 0.0  # [s]
        if length > 0.0:
            channel.per_second = (stamps.size - 1) / length
        stamps = stamps[plausible]
        si = si[plausible]
        channel.times = array("q", stamps.tobytes())
        channel.values = array("d", si.tobytes())
        off = _spread(stamps, si)
        if off.size:
            self.notes.add(
                f"{channel.place}: readings of {name} differ at {off.size} time stamps that are "
                f"there more than once, by up to {np.max(off):.3g} {si_unit(name)} (in "
                f"the middle {np.median(off):.3g}): their mean is taken."
            )

    def read_table(self, stamps: TimeColumn) -> None:
        """Read a CSV or Parquet file with a column of time stamps into `channels`; set `doubts`.

        Successive rows of one time that fill different columns count as one row.
        """
        columns: dict[str, list[str]] = {}
        for name, source in self.sources.items():
            columns.setdefault(source.column, []).append(name)
        labels = {column: ", ".join(names) for column, names in columns.items()}
        order = Stamps(f"column {stamps.column}", "row")
        filled: set[str] = set()  # columns with a value at the last stamp
        for row, time, values in tables.rows(stamps.column, stamps.unit, labels, self.notes):
            here = {c for c, value in zip(columns, values, strict=True) if value is not None}
            # A table may have a row for each sensor: rows of one time and other columns are one.
            if len(order) and time == order.times[-1] and filled.isdisjoint(here):
                filled |= here
            else:
                order.add(time, row)
                filled = here
            for names, value in zip(columns.values(), values, strict=True):
                if value is not None:
                    for name in names:
                        self._add(name, len(order) - 1, value)
        times = np.frombuffer(order.times, np.int64)
        kept = order.settle(times, *self._gaps, self.notes)
        sound = times[kept]
        if sound.size > 1:
            interval = np.median(np.abs(np.diff(sound[:_FIRST_ROWS]))) * 1e-9
            self.doubts = time_doubts(interval, (sound[-1] - sound[0]) * 1e-9, stamps)
        for name in self.sources:
            self._finish(name, times, kept)

    def read_bag(self) -> None:
        """Read a bag: the topics of the map.

        A topic has the clock of its headers if the map asks for it and any message has a stamp,
        else that of the recording.
        """
        notes = self.notes
        topics = {s.topic: _Topic(s.topic) for s in self.sources.values()}
        for name, source in self.sources.items():
            topics[source.topic].fields[name] = _Field(name, source)
        file = ""
        for message in bags.messages(set(topics), notes, self.map.messages):
            topic = topics[message.topic]
            if notes.file != file:
                file = notes.file
                for other in topics.values():
                    other.stamps.begin()
            content, stamp = topic.decoded(message)
            if stamp is None:
                continue
            ordinal = topic.faults.count  # of the message in its topic, from 1
            for name, field in topic.fields.items():
                value = field.number(content, message.kind, ordinal)
                if value is not None:
                    self._add(name, len(topic.stamps), value)
            topic.stamps.add(stamp, ordinal, message.time)
        self._check_found(topics)
        delays = {}  # [s] mean of the recording behind the stamps, by topic
        for of, topic in topics.items():
            by_header = self.map.clock == "header" and any(topic.stamps.times)
            times, kept = topic.sound_times(by_header, self._gaps, notes)
            for name in topic.fields:
                self._finish(name, times, kept)
            recorded = np.frombuffer(topic.stamps.recorded, np.int64)
            if kept.any():
                delays[of] = np.mean((recorded - times)[kept]) * 1e-9
        _note_delays(notes, delays)

    def _check_found(self, topics: dict[str, "_Topic"]) -> None:
        """Raise `ParameterError` for a topic that the recording lacks, a field that no message has,
        and either of which less than half can be read; note other faults.
        """
        notes = self.notes
        path = notes.path
        if not notes.topics:
            said = f" ({'; '.join(notes.lines)})" if notes.lines else ""
            raise ParameterError(f"{path}: has no topics: not one message is whole{said}")
        for name, source in self.sources.items():
            if source.topic not in notes.topics:
                where = f"{path}: channels.{name}.topic"
                unknown = unknown_key(source.topic, notes.topics, where, "unknown topic")
                cut = " (of what is whole)" if notes.lines else ""
                raise ParameterError(f"{unknown}{cut}")
        for topic in topics.values():
            topic.faults.settle(notes)
            for name, field in topic.fields.items():
                field.faults.settle(notes)
                if field.lacking and not self.channels[name].values:
                    raise ParameterError(f"{path}: {field.lacking}, in all messages")


def _spread(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Largest less smallest of the `values` [N] of one time, for each time at which they differ.

    `times` [N] may repeat and need not rise.
    """
    order = np.argsort(times, kind="stable")
    first = np.unique(times[order], return_index=True)[1]
    grouped = values[order]
    found = np.maximum.reduceat(grouped, first) - np.minimum.reduceat(grouped, first)
    return found[found > 0.0]


class _Topic:
    """A topic while its messages come: its fields that are read, stamps, and counts of faults."""

    def __init__(self, name: str) -> None:
        self.fields: dict[str, _Field] = {}  # by channel
        self.stamps = Stamps(f"topic {name}", "message")
        self.faults = Faults(f"topic {name}", "messages")

    def decoded(self, message: Message) -> tuple[Any, int | None]:
        """Decode a message: (content, header stamp [ns], 0 without a header).

        (None, None), counted as a fault, where it cannot be decoded or a time is beyond `LATEST`.
        `ParameterError` for a type that nothing defines.
        """
        self.faults.count += 1
        try:
            if not abs(message.time) <= LATEST:
                raise ValueError(f"recorded at {message.time} ns")
            content = message.decode()
            return content, _stamp(content)
        except ParameterError:
            raise
        # Any error: damaged bytes make a decoder fail in ways of its own.
        except Exception as error:
            self.faults.add(f"message {self.faults.count}", error or type(error).__name__)
            return None, None

    def sound_times(
        self, by_header: bool, gaps: tuple[int, int], notes: Notes
    ) -> tuple[np.ndarray, np.ndarray]:
        """(Stamps [N] in ns, of headers if `by_header`, else of the recording; True [N] for those
        that count).

        `gaps` are `max_gap` and `restart_gap` [ns] for `Stamps.settle`. Zeros in headers are noted;
        `ParameterError` where they are more than half.
        """
        stamps = self.stamps
        times = np.frombuffer(stamps.times if by_header else stamps.recorded, np.int64)
        if by_header:
            zeros = Faults(f"{stamps.source}, header.stamp", "stamps", times.size)
            for k in np.flatnonzero(times == 0).tolist():
                zeros.add(f"message {stamps.numbers[k]}", "zero or missing; try clock: log")
            zeros.settle(notes)
        return times, stamps.settle(times, *gaps, notes)


class _Field:
    """Field of a channel in the messages of its topic, with counts of faults. `ParameterError` for
    a `Source.field` that is no path (`parse`).
    """

    def __init__(self, name: str, source: Source) -> None:
        self._name = name
        self._source = source
        self._steps = parse(source.field, f"channels.{name}.field")
        self.faults = Faults(f"{name}: {source.place}", "messages")
        self.lacking = ""  # what the first message without it lacks

    def number(self, content: Any, kind: str, ordinal: int) -> float | None:
        """Number in the `content` of a message of type `kind`, `ordinal`-th of its topic, or None.

        None where the message lacks the value, which `lacking` keeps, and where the value is no
        number, which counts as a fault. `ParameterError` for a field that no message of the type
        can have.
        """
        source = self._source
        where = f"channels.{self._name}: topic {source.topic} ({kind}), field {source.field}"
        self.faults.count += 1
        try:
            return number(content, self._steps, source.unit == "quaternion")
        except ParameterError as error:
            raise ParameterError(f"{where}: {error}") from None
        except NotHere as error:
            self.lacking = self.lacking or f"{where}: {error}"
        # A message of JSON that is built in another way, a number too large for a float, or a field
        # with the name of a method.
        except (ArithmeticError, AttributeError, TypeError, ValueError) as error:
            self.faults.add(f"message {ordinal}", error)
        return None


def _stamp(content: Any) -> int:
    """Stamp [ns] in the header of a message, 0 where it has none; ValueError for one that is no
    time or beyond `LATEST`.
    """
    stamp = getattr(getattr(content, "header", None), "stamp", None)
    seconds = getattr(stamp, "sec", None)
    if seconds is None:
        return 0
    rest = getattr(stamp, "nanosec", getattr(stamp, "nsec", 0)) or 0
    if not (isinstance(seconds, (int, float)) and isinstance(rest, (int, float))):
        raise ValueError(f"header.stamp is no time ({seconds!r} s)")
    time = round(seconds * 1_000_000_000) + round(rest)
    if not abs(time) <= LATEST:
        raise ValueError(f"header.stamp is beyond the year 2116 ({seconds!r:.20} s)")
    return time


def _note_delays(notes: Notes, mean: dict[str, float]) -> None:
    """Add a note if the clocks of two topics differ by more than `_DELAY`, so that their readings
    do not belong together.

    `mean`: mean time [s] of the recording behind the stamps by topic, 0 of one without stamps.
    """
    if mean and max(mean.values()) - min(mean.values()) > _DELAY:
        middle = np.median([*mean.values()])
        topic = max(mean, key=lambda t: (abs(mean[t] - middle), abs(mean[t])))
        others = ", ".join(f"{t} {mean[t]:.3g} s" for t in sorted(mean) if t != topic)
        notes.add(
            f"The time stamps of {topic} are {mean[topic]:.3g} s behind the clock of the "
            f"recording, those of the others: {others}. So the readings do not belong together in "
            "time. Set clock: log in the map, unless the recorder received a topic that late."
        )


def _remarks(found: Aligned, log_map: LogMap, limits: dict[str, float]) -> list[str]:
    """Notes on gaps, and on channels that are slow, have no readings, or have some that are
    implausible, NaN or all outside the time of the wheel speed.

    `limits`: largest plausible reading by channel, in SI units. A channel is slow where more than
    `_SLOW` of its steps are interpolated. A gap is longer than `max_gap` and than 1.5 periods.
    """
    lines = []
    for name, c in found.channels.items():
        place = f"{name} ({c.place})"
        if c.readings == 0 and log_map.channels[name].constant is None:
            lines.append(f"{place} has not one reading.")
        elif c.times and c.missing == 1.0:
            count = plural(len(c.times), "reading")
            lines.append(
                f"{place} has {count}, all before the first or after the last reading of "
                "wheel_speed."
            )
        if c.empty:
            lines.append(
                f"{place}: infinite or NaN in {c.empty} of {c.readings} readings, as of a range "
                "finder without an echo. These count as missing."
            )
        if c.unusable:
            doubtful = " Check its unit and field in the map." * (2 * c.unusable > c.readings)
            lines.append(
                f"{place}: beyond {limits[name]:g} {si_unit(name)}".rstrip()
                + f", which this wheel cannot reach, in {c.unusable} of {c.readings} readings. "
                f"These are left out.{doubtful}"
            )
        if c.interpolated > _SLOW:
            lines.append(
                f"{place} comes less often than every {found.period:g} s. {c.interpolated:.0%} of "
                "the steps are interpolated, and they count as readings: set a longer period in "
                "the map, and windows of four or more of it."
            )
    # Neighbouring steps, which are no gap, may be further apart than `max_gap`.
    longest = max(log_map.max_gap, 1.5 * found.period)
    jumps = np.flatnonzero(np.diff(found.time) > longest)
    if jumps.size:
        lines.append(
            f"The recording has {plural(jumps.size, 'gap')} of more than {longest:g} s "
            "without any reading."
        )
    return lines
