"""Rows of CSV and Parquet files with time stamps, one by one."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

from soil_env._io.loading import ParameterError, unknown_key
from soil_env.logs.bags import Notes
from soil_env.logs.mapping import TIMES

SUFFIXES = (".csv", ".parquet", ".pq")
_LATEST = 2**62  # [ns] from 1970, the year 2116


class Row(NamedTuple):
    """A row of a table."""

    number: int  # in the file
    time: int  # [ns]
    values: list[float]  # of the columns; NaN = empty


class _Cells(NamedTuple):
    """A row as text."""

    number: int
    time: str | int  # int: [ns]
    values: list[str]


def rows(
    path: Path, stamps: str, unit: str, columns: dict[str, str], notes: Notes, progress: Callable[[int, int], None]
) -> Iterator[Row]:
    """Rows of a table: time stamps in the column `stamps` of `unit`, and `columns`, each with its readings."""
    csv_file, nans = path.suffix.lower() == ".csv", Counter[str]()
    cells = _csv(path, stamps, columns, notes, progress) if csv_file else _parquet(path, stamps, columns, progress)
    for number, time, texts in cells:
        at = time
        if isinstance(time, str):
            at = _converted(_nanoseconds, time, path, number, stamps, f"a time in {unit}", unit)
        values = [_converted(_number, t, path, number, c, "a number") for c, t in zip(columns, texts, strict=True)]
        nans.update(c for c, t, x in zip(columns, texts, values, strict=True) if x != x and t.strip())
        yield Row(number, at, values)
    for column, count in nans.items():
        notes.add(f"column {column}: {count} cell{'s' * (count > 1)} nan: taken as empty")


def _converted(convert, text: str, path: Path, number: int, column: str, expected: str, *more):
    try:
        return convert(text, *more)
    except (ArithmeticError, ValueError):
        raise ParameterError(f"{path}: row {number}, {column} = {text!r}: expected {expected} in every row") from None


def _number(text: str) -> float:
    return float(text) if text.strip() else math.nan


def _nanoseconds(text: str, unit: str) -> int:
    """Time stamp [ns] from 1970; an ISO 8601 text without a zone is taken as UTC."""
    if unit == "iso":
        at = datetime.fromisoformat(text)
        delta = (at if at.tzinfo else at.replace(tzinfo=UTC)) - datetime(1970, 1, 1, tzinfo=UTC)
        stamp = (delta.days * 86400 + delta.seconds) * 1_000_000_000 + delta.microseconds * 1000
    else:
        stamp = int(Decimal(text.strip()) * round(TIMES[unit] * 1e9))  # a float has too few digits for a time of today
    if abs(stamp) > _LATEST:
        raise ValueError(text)
    return stamp


def _check_columns(path: Path, header: list[str], stamps: str, columns: dict[str, str]) -> None:
    for name, what in {stamps: "time", **columns}.items():
        if name not in header:
            raise ParameterError(str(unknown_key(name, header, f"{path}: {what}")).replace("unknown key", "no column"))


def _csv(path, stamps, columns, notes, progress) -> Iterator[_Cells]:
    """Rows of a CSV file; one that is cut off in its last row gives the others."""
    size = path.stat().st_size
    try:
        with path.open("rb") as raw:
            reader = csv.reader((line.decode("utf-8") for line in raw), strict=True)
            lines = (cells for cells in reader if any(map(str.strip, cells)) and not cells[0].startswith("#"))
            header = [cell.strip().lstrip("\ufeff") for cell in next(lines, [])]
            if not header:
                raise ParameterError(f"{path}: has no line: expected a header with column names, and rows below it")
            if stamps in header and not set(columns) <= set(header) and raw.tell() == size and not _ends_a_line(path):
                raise ParameterError(f"{path}: is cut off in its header, after column {header[-1]!r}: nothing to read")
            _check_columns(path, header, stamps, columns)
            at, places, short, count = header.index(stamps), [header.index(c) for c in columns], "", 0
            for cells in lines:
                if short:
                    raise ParameterError(short)
                if len(cells) != len(header):  # allowed in the last row, where a recording was cut off
                    short = (
                        f"{path}: row {reader.line_num} has {len(cells)} cells: expected {len(header)}, as the header"
                    )
                    continue
                count += 1
                yield _Cells(reader.line_num, cells[at], [cells[p] for p in places])
                if count % 4096 == 0:
                    progress(raw.tell(), size)
            if not count:
                raise ParameterError(f"{path}: no whole row below the header{': it is cut off' if short else ''}")
            if short:
                notes.add(f"{path.name} is cut off in its last row: that row is left out")
    except UnicodeDecodeError as error:
        raise ParameterError(f"{path}: not UTF-8 text (byte {error.start} of a line): expected a CSV file") from None
    except csv.Error as error:
        raise ParameterError(f"{path}: not a CSV file ({error})") from None
    progress(size, size)


def _ends_a_line(path: Path) -> bool:
    return path.read_bytes().endswith(b"\n")


def _parquet(path, stamps, columns, progress) -> Iterator[_Cells]:
    """Rows of a Parquet file as text; stamps of a column of type timestamp in nanoseconds."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ParameterError(f"{path}: Parquet needs the extra logs: pip install 'soil_env[logs]'") from None
    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            _check_columns(path, file.schema_arrow.names, stamps, columns)
            done, size = 0, path.stat().st_size
            for batch in file.iter_batches(4096, columns=[stamps, *columns]):
                times = batch.column(stamps)
                if pyarrow.types.is_timestamp(times.type):
                    times = times.cast(pyarrow.timestamp("ns")).cast(pyarrow.int64())
                    times = [_text(x) if x is None else x for x in times.to_pylist()]
                else:
                    times = [_text(x) for x in times.to_pylist()]
                texts = [[_text(x) for x in batch.column(c).to_pylist()] for c in columns]
                for time, *values in zip(times, *texts, strict=True):
                    done += 1
                    yield _Cells(done, time, values)
                progress(int(size * done / max(file.metadata.num_rows, 1)), size)
            if done == 0:
                raise ParameterError(f"{path}: has no rows")
    except (OSError, pyarrow.ArrowException) as error:
        said = str(error).splitlines()[0]
        raise ParameterError(f"{path}: cannot be read as Parquet, whose index is at its end ({said})") from None


def _text(value: object) -> str:
    return "" if value is None else str(value)
