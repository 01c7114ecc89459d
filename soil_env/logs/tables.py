"""Rows of CSV and Parquet files with time stamps, one by one."""

import csv
from codecs import BOM_UTF8
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from itertools import islice
from pathlib import Path
from typing import Any

from soil_env._io.loading import (
    TITLES,
    ParameterError,
    decimal,
    one_line,
    plural,
    refuse_title,
    unknown_key,
)

from .mapping import TIMES
from .notes import Faults, Notes
from .stamps import LATEST

SUFFIXES = (".csv", ".parquet", ".pq")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_EXCEL = 25569  # [days] from 1899-12-30, where Excel counts from, to 1970

_DAY = 86400 * 10**9  # [ns]
_MIDNIGHT = _DAY // 2  # [ns] by which a time of day falls back, at least, on the next day
_LATE = _DAY * 23 // 24  # [ns] by which it rises, at least, where it is late, from before midnight
_BATCH = 4096  # rows read between two reports of progress
_EXAMPLES = {
    "iso": "text as 2026-05-04T09:30:00.25 or 09:30:00.25",
    "excel": "days of Excel as 46146.39583",
}
#: Number of the row, time stamp (int: [ns]), cells as text.
_Cells = tuple[int, str | int, list[str]]


def rows(
    stamps: str, unit: str, columns: dict[str, str], notes: Notes
) -> Iterator[tuple[int, int, list[float | None]]]:
    """Yield (number in the file, time [ns], values of the `columns`) for each row of a table.

    The column `stamps` has times in `unit`. `columns`: names of the columns to read, each with its
    readings in words for an error. A value is None where a cell is empty or no number. A time of
    day that falls by `_MIDNIGHT` is one of the next day, one that rises by `_LATE` after that is a
    late one of the day before.

    Rows without a time and cells without a number are left out, and counted in notes;
    `ParameterError` where that leaves less than half.
    """
    whole = Faults(notes.path.name, "rows")
    cells = {column: Faults(f"column {column}", "cells") for column in columns}
    midnights = 0
    last = 0
    read = _csv if notes.path.suffix.lower() == ".csv" else _parquet
    for number, time, texts in read(stamps, columns, notes, whole):
        whole.count += 1
        try:
            at = _nanoseconds(time, unit)
        except (ArithmeticError, ValueError):
            whole.add(f"row {number}", f"{stamps} = {time!r}, expected {_expected(time, unit)}")
            continue
        if unit == "iso" and abs(at) < _DAY:  # a time of day
            midnights += at < last - _MIDNIGHT
            midnights -= midnights > 0 and at > last + _LATE
            last = at
            at += midnights * _DAY
        values: list[float | None] = [None] * len(texts)
        for k, (column, faults) in enumerate(cells.items()):
            faults.count += 1
            try:
                if texts[k].strip():
                    values[k] = decimal(texts[k])
            except ValueError:
                faults.add(f"row {number}", f"{column} = {texts[k]!r}, expected a number")
        yield number, at, values
    for faults in (whole, *cells.values()):
        faults.settle(notes)


def _nanoseconds(stamp: str | int, unit: str) -> int:
    """Time [ns] from 1970 of a stamp: a whole number of ns, or text in `unit`.

    An ISO 8601 text without a zone is taken as UTC, and a time of day as one of 1970-01-01.
    ValueError or ArithmeticError for a text of another kind and a time beyond `LATEST`.
    """
    if isinstance(stamp, int):
        time: Any = stamp
    elif unit == "iso":
        at = _moment(stamp.strip())
        at = at if at.tzinfo else at.replace(tzinfo=UTC)
        time = (at - _EPOCH) // timedelta(microseconds=1) * 1000
    else:
        decimal(stamp)  # only for its error: a float has too few digits for a time of today
        count = Decimal(stamp.strip()) - (_EXCEL if unit == "excel" else 0)
        time = count * round(TIMES[unit] * 1e9)
    if not abs(time) <= LATEST:
        raise ValueError(stamp)
    return int(time)


def _moment(text: str) -> datetime:
    """Date and time of an ISO 8601 text; a time of day, also as 9:30:00, is of 1970-01-01."""
    if text[1:2] == ":":  # 9:30:00
        text = f"0{text}"
    return datetime.fromisoformat(f"1970-01-01T{text}" if text[2:3] == ":" else text)


def _expected(stamp: str | int, unit: str) -> str:
    """What a time stamp of this unit looks like, for an error, and the unit that may be meant.

    ISO 8601 text under another unit gets "iso" named, any stamp refused under "iso" the units of
    numbers.
    """
    text = _EXAMPLES.get(unit, f"a time in {unit}")
    if unit == "iso":
        return f"{text}; for numbers give time: unit: s, ms, us, ns or excel"
    if isinstance(stamp, str):
        with suppress(ValueError):
            _moment(stamp.strip())
            return f"{text}; for {_EXAMPLES['iso']} give time: unit: iso"
    return text


def _check_columns(path: Path, header: list[str], stamps: str, columns: dict[str, str]) -> None:
    """Raise `ParameterError` for a column of time or readings that `header` lacks or has twice."""
    for name, what in {stamps: "time", **columns}.items():
        if name not in header:
            unknown = unknown_key(name, header, f"{path}: {what}", "no column")
            hint = "; expected commas between columns" if ";" in "".join(header) else ""
            raise ParameterError(f"{unknown}{hint}")
        if header.count(name) > 1:
            places = ", ".join(str(k) for k, other in enumerate(header, 1) if other == name)
            raise ParameterError(
                f"{path}: {what}: the name {name!r} is that of columns {places}: expected one "
                "column of this name"
            )


def _csv(stamps: str, columns: dict[str, str], notes: Notes, faults: Faults) -> Iterator[_Cells]:
    """Yield the rows of a CSV file; empty ones and those that begin with # are passed over.

    A row with more or fewer cells than the header is left out and counted in `faults`. The last row
    may be cut off, which is only noted. `ParameterError` for no CSV, no header and no whole row.
    """
    path = notes.path
    notes.size = path.stat().st_size
    count = 0  # of whole rows
    short = False  # too few cells in the last row
    try:
        with path.open("rb") as raw:
            raw.seek(len(BOM_UTF8) if raw.read(3) == BOM_UTF8 else 0)
            # The header has to be UTF-8; below it a damaged byte spoils no more than its cell. A
            # list, since the lines are decoded one by one after this is set.
            errors = ["strict"]
            reader = csv.reader((line.decode("utf-8", errors[0]) for line in raw), strict=True)
            lines = (
                cells
                for cells in reader
                if any(map(str.strip, cells)) and not cells[0].startswith("#")
            )
            header = [cell.strip() for cell in next(lines, [])]
            if not header:
                raise ParameterError(
                    f"{path}: has no line: expected a header with column names, and rows below it"
                )
            # True if the file ends without a line break, and the header is its last line.
            ends_there = raw.tell() == notes.size and not path.read_bytes().endswith(b"\n")
            if ends_there and stamps in header and not set(columns) <= set(header):
                raise ParameterError(
                    f"{path}: is cut off in its header, after column {header[-1]!r}: nothing to "
                    "read"
                )
            if stamps not in header:
                refuse_title(path, [header, *islice(lines, TITLES)], (stamps, *columns))
            _check_columns(path, header, stamps, columns)
            errors[0] = "replace"
            stamp_column = header.index(stamps)
            places = [header.index(c) for c in columns]
            for cells in lines:
                short = len(cells) < len(header)
                if len(cells) != len(header):
                    faults.count += 1
                    faults.add(
                        f"row {reader.line_num}",
                        f"has {plural(len(cells), 'cell')}, expected {len(header)} as in the "
                        "header",
                    )
                    continue
                count += 1
                yield reader.line_num, cells[stamp_column], [cells[p] for p in places]
                if count % _BATCH == 0:
                    notes.report(raw.tell())
    except UnicodeDecodeError as error:
        raise ParameterError(
            f"{path}: not UTF-8 text (byte {error.start} of a line): expected a CSV file"
        ) from None
    except csv.Error as error:
        raise ParameterError(f"{path}: not a CSV file ({error})") from None
    if short:  # a recording was cut off in its last row: no fault
        faults.count -= 1
        faults.wrong -= 1
        notes.add(f"{path.name} is cut off in its last row, which is left out.")
    if not count and not faults.wrong:
        raise ParameterError(
            f"{path}: no whole row below the header{': it is cut off' if short else ''}"
        )
    notes.report(notes.size)


def _parquet(
    stamps: str, columns: dict[str, str], notes: Notes, faults: Faults
) -> Iterator[_Cells]:
    """Yield the rows of a Parquet file, cells as text.

    A stamp is a whole number of ns where its column has a type of timestamps, else text too. Each
    row is whole, so nothing is counted in `faults`. `ParameterError` for a file that cannot be read
    or has no rows.
    """
    path = notes.path
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ParameterError(
            f"{path}: Parquet needs the extra logs: pip install 'soil_env[logs]'"
        ) from None
    number = 0
    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            notes.size = file.metadata.num_rows
            _check_columns(path, file.schema_arrow.names, stamps, columns)
            for batch in file.iter_batches(_BATCH, columns=[stamps, *columns]):
                times = batch.column(stamps)
                tick = 0  # [ns] of the column's unit
                if pyarrow.types.is_timestamp(times.type):
                    tick = round(TIMES[times.type.unit] * 1e9)
                    times = times.cast(pyarrow.int64())
                cells = (
                    ["" if x is None else str(x) for x in batch.column(c).to_pylist()]
                    for c in columns
                )
                for time, *texts in zip(times.to_pylist(), *cells, strict=True):
                    number += 1
                    stamp = "" if time is None else time * tick if tick else str(time)
                    yield number, stamp, texts
                notes.report(number)
    except ParameterError:
        raise
    # Damaged pages also end in errors of Python's own: text, sizes, memory.
    except (OSError, pyarrow.ArrowException, ValueError, ArithmeticError, MemoryError) as error:
        raise ParameterError(
            f"{path}: cannot be read as Parquet, whose index is at its end ({one_line(error)})"
        ) from None
    if number == 0:
        raise ParameterError(f"{path}: has no rows")
