"""Messages of ROS 2 bags and MCAP files, one by one, without ROS, and the numbers in them.

MCAP is read by the library `mcap`, a bag in SQLite by Python's own module. Messages in CDR are
decoded by `rosbags`. Their definitions are those of the map, of the recording, or of the current
ROS 2. Files are read from front to end with no more than a chunk in memory. An MCAP file that was
cut off gives all that is whole, and a message that cannot be decoded is an error of its own.
"""

import dataclasses
import itertools
import json
import math
import re
import sqlite3
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, suppress
from functools import partial
from numbers import Real
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

from soil_env._io.loading import ParameterError, nearest, plural, read_yaml

from .notes import Notes

SUFFIXES = (".mcap", ".db3")
#: Commands that unpack a file, by its suffix.
_UNPACK = {".zst": "zstd -d", ".zstd": "zstd -d", ".lz4": "lz4 -d", ".gz": "gzip -d"}
_MOST_CHUNK = 2**28  # [bytes] unpacked, of a chunk; recorders make them of a few megabytes
_MOST_MESSAGE = 2**26  # [bytes] unpacked, of a message of which a number is read
#: Most instructions of SQLite for a file: (for any file, more for each of its bytes). A plain bag
#: takes less than one a byte; own choice.
_MOST_WORK = (10_000_000, 10)
_WORK_STEP = 100_000  # instructions between two counts
_LEAST_TEXT = 10_000  # [bytes] of a text or blob that SQLite may make of a file however small
_MOST_TEXT = 1_000_000_000  # [bytes] the same of a file however large: the limit of SQLite itself
_BETWEEN_REPORTS = 64  # rows of a .db3 file, between two reports of progress
_STEP = r"[A-Za-z_]\w*(\[[^\[\]]+\])*"  # of a path into a message
_PATH = re.compile(rf"{_STEP}(\.{_STEP})*")
_LISTS_OF_NAMES = ("name", "joint_names", "names")
_ZSTD = b"\x28\xb5\x2f\xfd"  # first bytes of what zstd compressed (RFC 8878)
_LEAST_NORM = 1e-6  # [-] squared, of a quaternion; one that nobody has set is all zeros
_DEEPEST = 6  # levels of fields within fields whose paths an error names
_MOST_NAMED = 24  # paths that an error names


class Message(NamedTuple):
    """A message of a bag, still in its bytes."""

    topic: str
    time: int  # [ns] of its recording
    kind: str  # sensor_msgs/msg/JointState
    #: Its content; `ParameterError` for a type that nothing defines, and any other exception for
    #: bytes that are no such message.
    decode: Callable[[], Any]


def bag_files(path: Path) -> list[Path]:
    """Files of a bag: in the order of recording, as metadata.yaml lists them, by name in this
    folder; without that by name, which need not be the order of recording.

    A recording that was killed has no metadata.yaml, and one that cannot be read counts as none.
    Files that it lists may be missing; one that was compressed may be there unpacked.
    `ParameterError` for a folder without files of a bag, and for compressed ones. Of a path to a
    file the list is that file, unchecked.
    """
    if path.is_file():
        return [path]
    inside = sorted(path.iterdir())
    found = []
    if (path / "metadata.yaml").is_file():
        with suppress(ParameterError):
            about = read_yaml(path / "metadata.yaml").get("rosbag2_bagfile_information")
            named = about.get("relative_file_paths") if isinstance(about, dict) else None
            if isinstance(named, list):
                listed = [path / name for name in dict.fromkeys(Path(str(n)).name for n in named)]
                found = [_unpacked_file(file) for file in listed]
    found = found or [file for file in inside if file.suffix in SUFFIXES]
    for file in found or [file for file in inside if Path(file.stem).suffix in SUFFIXES]:
        check_packed(file)
    if not found:
        raise ParameterError(f"{path}: no .mcap or .db3 file in this folder: expected a ROS 2 bag")
    return found


def _unpacked_file(file: Path) -> Path:
    """What was unpacked of a compressed `file`, where it lies beside it; else `file` itself."""
    inner = file.with_suffix("")
    return inner if file.suffix in _UNPACK and inner.is_file() else file


def check_packed(file: Path) -> None:
    """Raise `ParameterError` for a file that is compressed as a whole, by its suffix.

    Chunks and messages within a file may be compressed.
    """
    if file.suffix in _UNPACK:
        raise ParameterError(
            f"{file}: is compressed as a whole: expected {file.stem}; unpack it with "
            f"{_UNPACK[file.suffix]}"
        )


def messages(wanted: set[str], notes: Notes, definitions: Mapping[str, str]) -> Iterator[Message]:
    """Yield the messages on the topics `wanted` of a bag, at `notes.path`, by file in the order of
    `bag_files`, within a file as they are stored.

    The path is the folder of the bag or one of its files; a file that is missing is noted.
    `definitions`: text of .msg files by message type. `notes` receives all topics of the bag, the
    file being read, and the progress. `ParameterError` without the libraries of the extra logs.
    """
    try:
        import mcap  # noqa: F401
        import rosbags  # noqa: F401
    except ImportError:
        raise ParameterError("bags need the extra logs: pip install 'soil_env[logs]'") from None
    files = bag_files(notes.path)
    notes.size = sum(file.stat().st_size for file in files if file.is_file())
    for file in files:
        if not file.is_file():
            notes.add(
                f"{file.name} is named in metadata.yaml and is not there. Its part of the "
                "recording is missing."
            )
            continue
        notes.file = file.name
        reader = _mcap if file.suffix == ".mcap" else _sqlite
        yield from reader(file, wanted, notes, _Decoder(definitions))
        notes.before += file.stat().st_size
        notes.report(0)


class _Decoder:
    """Decoder of messages in CDR, one for each file of a bag.

    A type is looked up in the map's definitions, then in those of the file, then in those of the
    current ROS 2. `definitions`: those of the map, by type; `ParameterError` for one that cannot be
    read.
    """

    def __init__(self, definitions: Mapping[str, str]) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._known = get_typestore(Stores.LATEST)  # types of ROS 2
        self._own = get_typestore(Stores.EMPTY)  # types of the map and of the file
        self._unread: dict[str, Exception] = {}  # why a definition cannot be read, by type
        for kind, text in definitions.items():
            self.define(kind, text)
            if kind in self._unread:
                raise ParameterError(
                    f"messages.{kind}: not the text of a .msg file ({self._unread[kind]})"
                )

    def define(self, kind: str, text: str) -> None:
        """Take the definitions in the text of a message type, but for types that have one already.

        A text that cannot be read raises nothing here; `cdr` names the type where it is needed.
        """
        from rosbags.typesys import get_types_from_msg

        try:
            new = get_types_from_msg(text, kind)
            self._own.register({k: v for k, v in new.items() if k not in self._own.types})
        # The parser and the code made of the definition have errors of their own.
        except Exception as error:
            self._unread[kind] = error

    def cdr(self, kind: str, where: str, data: bytes) -> Any:
        """Decode a message of this type, compressed or not; `where` begins the text of an error.

        `ParameterError` for a type that nothing defines.
        """
        for store in (self._own, self._known):
            if kind in store.types:
                return self._decoded(store, kind, _unpacked(data))
        lacks = "defines it in a way that cannot be read" if kind in self._unread else "lacks it"
        raise ParameterError(
            f"{where}: messages are of the type {kind}, whose definition is not known: the "
            f"recording {lacks}; give the text of its .msg file in the map, as messages: "
            f"{{{kind}: 'float64 x'}}"
        )

    def _decoded(self, store: Any, kind: str, data: bytes) -> Any:
        """Decode a message by the definitions of `store`.

        rosbags raises `KeyError` for a nested type without a definition. That of the current ROS 2
        is added then, if it has one, and the message is decoded again.
        """
        while True:
            try:
                return store.deserialize_cdr(data, kind)
            except KeyError as error:
                name = error.args[0]
                if name in store.types or name not in self._known.types:
                    raise
                store.register({name: self._known.fielddefs[name]})


def _unpacked(data: bytes) -> bytes:
    """The bytes of a message, unpacked if zstd compressed them; CDR itself begins with a zero.

    ValueError for a message that unpacks to more than `_MOST_MESSAGE` by its header; one whose
    header does not state the size may unpack to as much (`zstandard.ZstdError`).
    """
    if data[:4] != _ZSTD:
        return data
    import zstandard

    size = zstandard.get_frame_parameters(data).content_size
    if _MOST_MESSAGE < size < zstandard.CONTENTSIZE_UNKNOWN:
        raise ValueError(f"unpacks to more than {_MOST_MESSAGE} bytes")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=_MOST_MESSAGE)


def _mcap_records(file: Path, notes: Notes) -> Iterator[Any]:
    """Yield the records of an MCAP file up to its index, those within chunks one by one.

    A damaged chunk is left out with a note. A file that was cut off ends, with a note, where it is
    no longer whole. `ParameterError` for a file that is no MCAP.
    """
    from mcap.exceptions import EndOfFile, InvalidMagic
    from mcap.records import Chunk, DataEnd, Footer, Message as Record
    from mcap.stream_reader import StreamReader, breakup_chunk

    size = file.stat().st_size
    last = None  # [ns] recording of the last message
    record = None
    with file.open("rb") as stream:
        records = StreamReader(stream, emit_chunks=True, record_size_limit=max(size, 1)).records
        while not isinstance(record, (DataEnd, Footer)):
            try:
                record = next(records)
            except InvalidMagic:
                raise ParameterError(
                    f"{file}: not an MCAP file (its first bytes are others)"
                ) from None
            except StopIteration:
                return
            # Besides errors of its own the library lets those of struct and of text through.
            except Exception as error:
                why = "" if isinstance(error, EndOfFile) else f" ({error})"
                at = "before its first message"
                if last is not None:
                    at = f"after the message recorded at {last * 1e-9:.3f} s"
                place = stream.tell()
                end = "at its end" if place >= size else f"at byte {place} of {size}"
                notes.add(
                    f"{file.name} is cut off or damaged {end}{why}, {at}. What comes before was "
                    "read."
                )
                return
            inside = [record]
            try:
                if isinstance(record, Chunk):
                    if record.uncompressed_size > _MOST_CHUNK:
                        raise ValueError(f"it unpacks to more than {_MOST_CHUNK} bytes")
                    inside = breakup_chunk(record, validate_crc=True)
            # checksum, decompression: each library has errors of its own
            except Exception as error:
                notes.add(
                    f"{file.name}: the chunk before byte {stream.tell()} is damaged and left out "
                    f"({error})."
                )
                continue
            for r in inside:
                last = r.log_time if isinstance(r, Record) else last
                yield r
            notes.report(stream.tell())


def _mcap(file: Path, wanted: set[str], notes: Notes, decoder: _Decoder) -> Iterator[Message]:
    """Yield the messages of an MCAP file on the topics `wanted`; all its topics go into `notes`."""
    from mcap.records import Channel, Message as Record, Schema

    schemas = {}  # by id
    channels = {}  # (topic, message type, function that decodes a message) by id, of those wanted
    for r in _mcap_records(file, notes):
        if isinstance(r, Schema):
            schemas[r.id] = r
        elif isinstance(r, Channel):
            schema = schemas.get(r.schema_id)
            kind = schema.name if schema else r.message_encoding
            notes.topics.setdefault(r.topic, kind)
            if r.topic in wanted:
                decode = _decoding(decoder, f"{file}: topic {r.topic}", r, schema)
                channels[r.id] = (r.topic, kind, decode)
        elif isinstance(r, Record) and r.channel_id in channels:
            topic, kind, decode = channels[r.channel_id]
            yield Message(topic, r.log_time, kind, partial(decode, r.data))


def _decoding(decoder: _Decoder, where: str, channel, schema) -> Callable[[bytes], Any]:
    """Return the function that decodes the bytes of a message of an MCAP channel.

    `channel` and `schema` are records of the library `mcap`, `schema` None where there is none.
    Objects of JSON become `SimpleNamespace`, so that fields are attributes as in CDR. A definition
    in the schema is handed to the decoder. `ParameterError` for another encoding.
    """
    if channel.message_encoding == "json":
        return partial(json.loads, object_hook=lambda d: SimpleNamespace(**d))
    kind = schema.encoding if schema else "none"
    if channel.message_encoding != "cdr" or kind not in ("ros2msg", ""):
        raise ParameterError(
            f"{where}: encoding {channel.message_encoding} with schema {kind}: expected cdr with "
            "schema ros2msg, or json"
        )
    if schema.data:
        decoder.define(schema.name, schema.data.decode("utf-8", "replace"))
    return partial(decoder.cdr, schema.name, where)


def _sqlite(file: Path, wanted: set[str], notes: Notes, decoder: _Decoder) -> Iterator[Message]:
    """Yield the messages of a .db3 file on the topics `wanted`, in the order of its rows.

    That is the order of recording. All topics go into `notes`. `ParameterError` for a file that is
    cut off, damaged, or takes more work than a bag does (`_guard`).
    """
    size = file.stat().st_size
    _check_size(file, size)
    with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as base:
        try:
            _guard(base, size)
            for name in ("topics", "messages"):
                if not _is_plain(base, name):
                    raise ParameterError(
                        f"{file}: {name} is no plain table of SQLite: expected a ROS 2 bag"
                    )
            topics = {
                i: (str(name), str(kind))
                for i, name, kind in base.execute("SELECT id, name, type FROM topics")
            }
            count = base.execute("SELECT max(rowid) FROM messages").fetchone()[0] or 1
            notes.topics |= dict(topics.values())
            _define(base, decoder, {kind for name, kind in topics.values() if name in wanted})
            ids = [i for i, (name, _) in topics.items() if name in wanted]
            query = (
                "SELECT rowid, topic_id, timestamp, data FROM messages WHERE topic_id IN "
                f"({','.join('?' * len(ids))})"
            )
            read = base.execute(query + " ORDER BY rowid", ids)
            for k, (row, topic, time, data) in enumerate(read):
                name, kind = topics[topic]
                yield Message(
                    name, time, kind, partial(decoder.cdr, kind, f"{file}: topic {name}", data)
                )
                if k % _BETWEEN_REPORTS == 0:
                    notes.report(int(size * min(row / count, 1.0)))
        # The text of an error may quote bytes of the file that are no UTF-8.
        except (sqlite3.Error, UnicodeDecodeError) as error:
            raise ParameterError(
                f"{file}: cannot be read as a ROS 2 bag in SQLite ({error})"
            ) from None


def _guard(base: sqlite3.Connection, size: int) -> None:
    """Let a connection only read, and bound the memory and work that a crafted file can ask for.

    Text and blobs are at most as long as the file (`size` [bytes]), or `_LEAST_TEXT` if that is
    more; instructions at most `_MOST_WORK`. SQLite ends a query beyond that with an error of its
    own.
    """
    base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(max(size, _LEAST_TEXT), _MOST_TEXT))
    # text that is no UTF-8 does not stop the query
    base.text_factory = lambda text: text.decode("utf-8", "replace")
    base.execute("PRAGMA query_only = ON")
    base.execute("PRAGMA trusted_schema = OFF")
    left = itertools.count((_MOST_WORK[0] + _MOST_WORK[1] * size) // _WORK_STEP, -1)
    base.set_progress_handler(lambda: next(left) <= 0, _WORK_STEP)


def _is_plain(base: sqlite3.Connection, name: str) -> bool:
    """True for a table with stored columns only: no view, virtual table or computed column, which
    run what their author wrote.
    """
    made = base.execute("SELECT type, sql FROM sqlite_master WHERE name = ?", (name,)).fetchone()
    if made is None or made[0] != "table" or not str(made[1]).upper().startswith("CREATE TABLE"):
        return False
    return all(hidden == 0 for *_, hidden in base.execute(f"PRAGMA table_xinfo({name})"))


def _check_size(file: Path, size: int) -> None:
    """Raise `ParameterError` for an SQLite file that is shorter than its header says.

    SQLite would read the missing part of a page as zeros. Of a file without a header nothing is
    said here.
    """
    with file.open("rb") as stream:
        header = stream.read(32)
    # At byte 16 the size of a page, of which 65536 is written as 1; at byte 28 the number of pages.
    page, pages = struct.unpack(">16xH10xI", header) if len(header) == 32 else (0, 0)
    whole = (65536 if page == 1 else page) * pages
    if header.startswith(b"SQLite format 3") and size < whole:
        raise ParameterError(
            f"{file}: is cut off at byte {size} of {whole}: expected a whole file; try sqlite3 "
            f"{file.name} .recover | sqlite3 whole.db3"
        )


def _define(base: sqlite3.Connection, decoder: _Decoder, kinds: set[str]) -> None:
    """Hand the bag's definitions of the types `kinds` to the decoder.

    Older bags have none, and a table of them that cannot be read counts as none.
    """
    query = (
        "SELECT topic_type, encoded_message_definition FROM message_definitions WHERE encoding = "
        "'ros2msg'"
    )
    with suppress(sqlite3.Error):
        for kind, text in base.execute(query) if _is_plain(base, "message_definitions") else ():
            if kind in kinds:
                decoder.define(kind, str(text))


class NotHere(LookupError):
    """Error for a value that is missing in this one message; others may have it."""


def parse(field: str, where: str) -> list[str]:
    """Steps of a path: names of attributes, and what is in brackets, with these.

    "velocity[front_left]" gives "velocity" and "[front_left]". `ParameterError`, which begins with
    `where`, for any other text.
    """
    if not _PATH.fullmatch(field):
        raise ParameterError(
            f"{where} = {field!r}: expected a path as twist.twist.linear.x or velocity[front_left]"
        )
    return re.findall(r"\[[^\[\]]+\]|\w+", field)


def number(message: Any, steps: list[str], quaternion: bool) -> float:
    """The number at a path of a message, whose `steps` are those of `parse`; for a `quaternion` the
    uphill pitch [rad] of the orientation there.

    Raises `NotHere` where only this message lacks it: a list is too short, or a name is not in it.
    For a path that messages of this type do not have it raises `ParameterError`, and another
    ValueError where the message is of JSON.
    """
    value = message
    for step in steps:
        if step.startswith("["):
            value = _item(message, value, step)
        elif _has_fields(value) and hasattr(value, step):
            value = getattr(value, step)
        else:
            raise _wrong(message, f"the message has no such field{_near(message, steps)}")
    if quaternion:
        try:
            parts = [float(getattr(value, name)) for name in "xyzw"]
        except (AttributeError, TypeError):
            raise _wrong(
                message, "expected an orientation with x, y, z and w for unit quaternion"
            ) from None
        return uphill(*parts)
    if not isinstance(value, Real):
        hint = _near(message, steps)
        if all(hasattr(value, name) for name in "xyzw"):
            hint = ": expected unit quaternion with an orientation, which is of pitch only"
        raise _wrong(message, f"is no number but {_kind(value)}{hint}")
    return float(value)


def _has_fields(value: Any) -> bool:
    """True for a message, or a part of one, with fields: in CDR a dataclass of `rosbags`."""
    return dataclasses.is_dataclass(value) or isinstance(value, SimpleNamespace)


def _wrong(message: Any, said: str) -> ValueError:
    """Return the error for a message that lacks a field that the user's `LogMap` names.

    `ParameterError` for CDR, where all messages of a type have the same fields, so that the map is
    wrong; `ValueError` for JSON, where the next message may have them.
    """
    return (ParameterError if dataclasses.is_dataclass(message) else ValueError)(said)


def _item(message: Any, values: Any, step: str) -> Any:
    """Element of the list `values` of a message, by the "[index]" or the "[name]" in `step`.

    A name has its place in the message's list of names (`_LISTS_OF_NAMES`). `NotHere` for an index
    or a name that is not there, `_wrong` where there is no list at all.
    """
    if not hasattr(values, "__len__") or isinstance(values, str):
        raise _wrong(message, f"{step} of something that is no list: {_kind(values)}")
    name = step[1:-1]
    if name.isdecimal():
        index = int(name)
    else:
        names = next(
            (list(getattr(message, key)) for key in _LISTS_OF_NAMES if hasattr(message, key)), None
        )
        if names is None:
            raise _wrong(message, "the message has no list of names: expected a number in brackets")
        if name not in names:
            known = ", ".join(map(str, names)) or "none"
            raise NotHere(f"no name {name!r}{nearest(name, names)} (names: {known})")
        index = names.index(name)
    if index >= len(values):
        raise NotHere(f"the list has {plural(len(values), 'value')}: expected more than {index}")
    return values[index]


def uphill(x: float, y: float, z: float, w: float) -> float:
    """Pitch [rad] of a body with axes x forward and z up (REP 103), uphill positive.

    x, y, z, w are a quaternion of any length; NaN for one of nearly zero length (`_LEAST_NORM`),
    which nobody has set.
    """
    norm = x * x + y * y + z * z + w * w  # squared length
    if norm < _LEAST_NORM:
        return math.nan
    # Minus: y is to the left, so a positive rotation about it is nose down.
    return -math.asin(min(max(2.0 * (w * y - z * x) / norm, -1.0), 1.0))


def _paths(value: Any, prefix: str = "", depth: int = _DEEPEST) -> list[str]:
    """Paths in a value that lead to numbers or lists, each after `prefix`, at most `depth` levels
    deep.
    """
    if isinstance(value, Real):
        return [prefix]
    if _has_fields(value):
        return [
            path
            for name, inner in vars(value).items()
            if depth and not name.startswith("_")
            for path in _paths(inner, f"{prefix}.{name}".lstrip("."), depth - 1)
        ]
    if isinstance(value, str) or not hasattr(value, "__len__"):
        return []
    return [] if len(value) and isinstance(value[0], str) else [f"{prefix}[0]"]


def _kind(value: Any) -> str:
    """What a value is that is no number, in words for an error."""
    if value is None:
        return "null"
    if isinstance(value, str):
        return f"text {value[:20]!r}"
    if hasattr(value, "__len__"):
        return f"a list of {len(value)}"
    if _has_fields(value):
        return "a part with fields"
    return type(value).__name__.removesuffix("_")  # bool_ of numpy 1


def _near(message: Any, steps: list[str]) -> str:
    """End of an error: the path in the message that is most like `steps`, and the first others."""
    asked = ".".join(s for s in steps if not s.startswith("["))
    known = _paths(message)
    more = ", ..." if len(known) > _MOST_NAMED else ""
    return f"{nearest(asked, known)} (fields: {', '.join(known[:_MOST_NAMED])}{more})"
