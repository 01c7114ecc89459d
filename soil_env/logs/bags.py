"""Messages of ROS 2 bags and MCAP files, one by one, without ROS.

MCAP is read by the library `mcap`, a bag in SQLite by Python's own module, and messages in CDR are decoded by `rosbags`
with the definitions that the recording bears (those of the current ROS 2 where it bears none). Files are read from
front to end with no more than a chunk in memory. An MCAP file that was cut off gives all that is whole.
"""

from __future__ import annotations

import json
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

from soil_env._io.loading import ParameterError, read_yaml

SUFFIXES = (".mcap", ".db3")
_NEEDED = "bags need the extra logs: pip install 'soil_env[logs]'"

Progress = Callable[[int, int], None]  # bytes read, of how many in all


class Message(NamedTuple):
    """A decoded message."""

    topic: str
    time: int  # [ns] of its recording
    kind: str  # sensor_msgs/msg/JointState
    content: Any


class Notes:
    """Remarks of a reader beside the messages."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.topics: dict[str, str] = {}  # seen, with their type
        self.file = ""  # being read

    def add(self, line: str) -> None:
        """Add a sentence, once."""
        if line not in self.lines:
            self.lines.append(line)


def bag_files(path: Path) -> list[Path]:
    """The files of a bag in their order: of its metadata.yaml, or, where a recording ended without one, by name."""
    if path.is_file():
        return [path]
    found = sorted(p for p in path.iterdir() if p.suffix in SUFFIXES)
    if (path / "metadata.yaml").is_file():
        about = read_yaml(path / "metadata.yaml").get("rosbag2_bagfile_information")
        named = about.get("relative_file_paths") if isinstance(about, dict) else None
        found = [path / Path(str(name)).name for name in named or []] or found
    packed = [p for p in found if p.suffix not in SUFFIXES]
    if packed:
        raise ParameterError(f"{packed[0]}: expected .mcap or .db3; unpack a file that is compressed whole (zstd -d)")
    if not found:
        raise ParameterError(f"{path}: no .mcap or .db3 file in this folder: expected a ROS 2 bag")
    return found


def messages(path: Path, wanted: set[str], notes: Notes, progress: Progress) -> Iterator[Message]:
    """The messages on the topics `wanted` of a bag (a folder) or of one of its files, in the order of recording."""
    files = bag_files(path)
    sizes = [p.stat().st_size if p.is_file() else 0 for p in files]
    for k, file in enumerate(files):
        if not file.is_file():
            notes.add(f"{file.name} is named in metadata.yaml and is not there: its part of the recording is missing")
            continue

        def report(position: int, before: int = sum(sizes[:k])) -> None:
            progress(before + position, sum(sizes))

        notes.file = file.name
        reader = _mcap if file.suffix == ".mcap" else _sqlite
        yield from reader(file, wanted, notes, report)
        report(sizes[k])


# --- decoding ---------------------------------------------------------------------------------------------------------


class _Decoder:
    """Messages from bytes; one for each file."""

    def __init__(self) -> None:
        try:
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise ParameterError(_NEEDED) from None
        self._known = get_typestore(Stores.LATEST)
        self._own = get_typestore(Stores.EMPTY)

    def define(self, kind: str, text: str) -> None:
        """Take the definition of a message type that the recording bears."""
        from rosbags.typesys import get_types_from_msg

        new = {k: v for k, v in get_types_from_msg(text, kind).items() if k not in self._own.types}
        if new:
            self._own.register(new)

    def cdr(self, kind: str, data: bytes, where: str) -> Any:
        """The message of this type; `ParameterError` for a type that nothing defines."""
        for store in (self._own, self._known):
            if kind in store.types:
                return store.deserialize_cdr(_unpacked(data), kind)
        raise ParameterError(f"{where}: message type {kind} is not known, and the recording does not define it")


def _objects(data: bytes) -> Any:
    return json.loads(data, object_hook=lambda d: SimpleNamespace(**d))


# --- MCAP -------------------------------------------------------------------------------------------------------------


def _mcap_records(file: Path, notes: Notes, report: Callable[[int], None]) -> Iterator[Any]:
    """Records of an MCAP file up to its index, those in chunks one by one; damaged chunks are left out."""
    from mcap.exceptions import EndOfFile, InvalidMagic, McapError
    from mcap.records import Chunk, DataEnd, Footer, Message as Record
    from mcap.stream_reader import StreamReader, breakup_chunk

    size, last, record = file.stat().st_size, None, None
    with file.open("rb") as stream:
        records = StreamReader(stream, emit_chunks=True, record_size_limit=max(size, 1)).records
        while not isinstance(record, (DataEnd, Footer)):
            try:
                record = next(records)
            except InvalidMagic:
                raise ParameterError(f"{file}: not an MCAP file (its first bytes are others)") from None
            except (EndOfFile, McapError, struct.error, ValueError, MemoryError) as error:
                why = "" if isinstance(error, EndOfFile) else f" ({error})"
                at = f"after the message recorded at {last * 1e-9:.3f} s" if last else "before its first message"
                end = "at its end" if stream.tell() >= size else f"at byte {stream.tell()} of {size}"
                notes.add(f"{file.name} is cut off or damaged {end}{why}, {at}: what is whole was read")
                return
            try:
                inside = breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]
            except Exception as error:  # checksum, decompression: each library has errors of its own
                notes.add(f"{file.name}: the chunk before byte {stream.tell()} is damaged and left out ({error})")
                continue
            for r in inside:
                last = r.log_time if isinstance(r, Record) else last
                yield r
            report(stream.tell())


def _mcap(file: Path, wanted: set[str], notes: Notes, report: Callable[[int], None]) -> Iterator[Message]:
    """Messages of an MCAP file."""
    try:
        from mcap.records import Channel, Message as Record, Schema
    except ImportError:
        raise ParameterError(_NEEDED) from None
    decoder, schemas, channels = _Decoder(), {}, {}
    for r in _mcap_records(file, notes, report):
        if isinstance(r, Schema):
            schemas[r.id] = r
        elif isinstance(r, Channel):
            schema = schemas.get(r.schema_id)
            channels[r.id] = r, schema
            notes.topics.setdefault(r.topic, schema.name if schema else r.message_encoding)
            if r.topic in wanted:
                _prepare(decoder, file, r, schema)
        elif isinstance(r, Record) and r.channel_id in channels:
            channel, schema = channels[r.channel_id]
            if channel.topic in wanted:
                yield _message(decoder, file, channel, schema, r)


def _prepare(decoder: _Decoder, file: Path, channel, schema) -> None:
    """Take the type of a topic that is wanted; `ParameterError` for an encoding that is not read."""
    where = f"{file}: topic {channel.topic}"
    if channel.message_encoding == "json":
        return
    if channel.message_encoding != "cdr" or schema is None or schema.encoding not in ("ros2msg", ""):
        encoding = f"{channel.message_encoding} with schema {schema.encoding if schema else 'none'}"
        raise ParameterError(f"{where}: encoding {encoding}: expected cdr with schema ros2msg, or json")
    if schema.data:
        decoder.define(schema.name, schema.data.decode("utf-8", "replace"))


def _message(decoder: _Decoder, file: Path, channel, schema, record) -> Message:
    if channel.message_encoding == "json":
        return Message(channel.topic, record.log_time, schema.name if schema else "json", _objects(record.data))
    content = decoder.cdr(schema.name, record.data, f"{file}: topic {channel.topic}")
    return Message(channel.topic, record.log_time, schema.name, content)


# --- SQLite -----------------------------------------------------------------------------------------------------------


def _sqlite(file: Path, wanted: set[str], notes: Notes, report: Callable[[int], None]) -> Iterator[Message]:
    """Messages of a .db3 file in the order of its rows, which is that of recording."""
    decoder, size = _Decoder(), file.stat().st_size
    _check_size(file, size)
    with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as base:
        try:
            topics = {i: (name, kind) for i, name, kind in base.execute("SELECT id, name, type FROM topics")}
            count = base.execute("SELECT max(id) FROM messages").fetchone()[0] or 1
            notes.topics |= dict(topics.values())
            _define(base, decoder, {kind for name, kind in topics.values() if name in wanted})
            ids = [i for i, (name, _) in topics.items() if name in wanted]
            query = f"SELECT id, topic_id, timestamp, data FROM messages WHERE topic_id IN ({','.join('?' * len(ids))})"
            for number, topic, time, data in base.execute(query + " ORDER BY id", ids):
                name, kind = topics[topic]
                yield Message(name, time, kind, decoder.cdr(kind, data, f"{file}: topic {name}"))
                if number % 64 == 0:
                    report(int(size * min(number / count, 1.0)))
        except sqlite3.DatabaseError as error:
            raise ParameterError(f"{file}: cannot be read as a ROS 2 bag in SQLite ({error})") from None


def _check_size(file: Path, size: int) -> None:
    """Refuse an SQLite file that is shorter than its header says: missing parts of a page would be read as zeros."""
    with file.open("rb") as stream:
        header = stream.read(32)
    page, pages = struct.unpack(">16xH10xI", header) if len(header) == 32 else (0, 0)
    whole = (65536 if page == 1 else page) * pages
    if header.startswith(b"SQLite format 3") and size < whole:
        recover = f"sqlite3 {file.name} .recover | sqlite3 whole.db3"
        raise ParameterError(f"{file}: is cut off at byte {size} of {whole}: expected a whole file; try {recover}")


def _define(base: sqlite3.Connection, decoder: _Decoder, kinds: set[str]) -> None:
    """Take the definitions of message types where the bag has them; older ones do not."""
    query = "SELECT topic_type, encoded_message_definition FROM message_definitions WHERE encoding = 'ros2msg'"
    with suppress(sqlite3.DatabaseError):
        for kind, text in base.execute(query):
            if kind in kinds:
                decoder.define(kind, text)


def _unpacked(data: bytes) -> bytes:
    """A message, also of a bag whose messages are compressed one by one."""
    if data[:4] == b"\x28\xb5\x2f\xfd":  # zstd; CDR begins with 00
        import zstandard

        return zstandard.decompress(data)
    return data
