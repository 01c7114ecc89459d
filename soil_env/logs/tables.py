"""Rows of CSV and Parquet files with time stamps, one by one."""

import csv
import math
from collections import Counter
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

from soil_env._io.loading import ParameterError, unknown_key
from soil_env.logs.bags import Notes, Progress
from soil_env.logs.mapping import TIMES

SUFFIXES = (".csv", ".parquet", ".pq")
_LATEST = 2**62  # [ns] from 1970, the year 2116

#: Number of the row, time stamp (int: [ns]), cells as text.
_Cells = tuple[int, str | int, list[str]]


class Row(NamedTuple):
    """A row of a table."""

    number: int  # in the file
    time: int  # [ns]
    values: list[float]  # of the columns; NaN = empty


def rows(
    path: Path, stamps: str, unit: str, columns: dict[str, str], notes: Notes, progress: Progress
) -> Iterator[Row]:
    """Rows of a table: time stamps in the column `stamps` of `unit`, and `columns`, each with its
    readings.
    """
    nans = Counter[str]()

    def converted(convert: Callable, text: str, number: int, column: str, expected: str):
        try:
            return convert(text)
        except (ArithmeticError, ValueError):
            said = f"{path}: row {number}, {column} = {text!r}: expected {expected} in every row"
            raise ParameterError(said) from None

    read = _csv if path.suffix.lower() == ".csv" else _parquet
    for number, time, texts in read(path, stamps, columns, notes, progress):
        if isinstance(time, str):
            time = converted(
                lambda text: _nanoseconds(text, unit), time, number, stamps, f"a time in {unit}"
            )
        values = [
            converted(_number, t, number, c, "a number")
            for c, t in zip(columns, texts, strict=True)
        ]
        nans.update(
            c for c, t, x in zip(columns, texts, values, strict=True) if x != x and t.strip()
        )
        yield Row(number, time, values)
    for column, count in nans.items():
        notes.add(f"column {column}: {count} cell{'s' * (count > 1)} nan: taken as empty")


def _number(text: str) -> float:
    return float(text) if text.strip() else math.nan


def _nanoseconds(text: str, unit: str) -> int:
    """Time stamp [ns] from 1970; an ISO 8601 text without a zone is taken as UTC."""
    if unit == "iso":
        at = datetime.fromisoformat(text)
        delta = (at if at.tzinfo else at.replace(tzinfo=UTC)) - datetime(1970, 1, 1, tzinfo=UTC)
        stamp = (delta.days * 86400 + delta.seconds) * 1_000_000_000 + delta.microseconds * 1000
    else:
        # A float has too few digits for a time of today.
        stamp = int(Decimal(text.strip()) * round(TIMES[unit] * 1e9))
    if abs(stamp) > _LATEST:
        raise ValueError(text)
    return stamp


def _check_columns(path: Path, header: list[str], stamps: str, columns: dict[str, str]) -> None:
    for name, what in {stamps: "time", **columns}.items():
        if name not in header:
            raise ParameterError(
                str(unknown_key(name, header, f"{path}: {what}")).replace(
                    "unknown key", "no column"
                )
            )


def _csv(
    path: Path, stamps: str, columns: dict[str, str], notes: Notes, progress: Progress
) -> Iterator[_Cells]:
    """Rows of a CSV file; one that is cut off in its last row gives the others."""
    size = path.stat().st_size
    short = ""
    count = 0
    try:
        with path.open("rb") as raw:
            reader = csv.reader((line.decode("utf-8") for line in raw), strict=True)
            lines = (
                cells
                for cells in reader
                if any(map(str.strip, cells)) and not cells[0].startswith("#")
            )
            header = [cell.strip().lstrip("\ufeff") for cell in next(lines, [])]
            if not header:
                raise ParameterError(
                    f"{path}: has no line: expected a header with column names, and rows below it"
                )
            # The file ends there.
            in_header = raw.tell() == size and not path.read_bytes().endswith(b"\n")
            if in_header and stamps in header and not set(columns) <= set(header):
                raise ParameterError(
                    f"{path}: is cut off in its header, after column {header[-1]!r}: nothing to "
                    "read"
                )
            _check_columns(path, header, stamps, columns)
            at = header.index(stamps)
            places = [header.index(c) for c in columns]
            for cells in lines:
                if short:
                    raise ParameterError(f"{path}: {short}")
                # Allowed in the last row, where a recording was cut off.
                if len(cells) != len(header):
                    short = (
                        f"row {reader.line_num} has {len(cells)} cells: expected {len(header)}, as "
                        "the header"
                    )
                    continue
                count += 1
                yield reader.line_num, cells[at], [cells[p] for p in places]
                if count % 4096 == 0:
                    progress(raw.tell(), size)
    except UnicodeDecodeError as error:
        raise ParameterError(
            f"{path}: not UTF-8 text (byte {error.start} of a line): expected a CSV file"
        ) from None
    except csv.Error as error:
        raise ParameterError(f"{path}: not a CSV file ({error})") from None
    if not count:
        raise ParameterError(
            f"{path}: no whole row below the header{': it is cut off' if short else ''}"
        )
    if short:
        notes.add(f"{path.name} is cut off in its last row: that row is left out")
    progress(size, size)


def _parquet(
    path: Path, stamps: str, columns: dict[str, str], notes: Notes, progress: Progress
) -> Iterator[_Cells]:
    """Rows of a Parquet file as text; stamps of a column of type timestamp in nanoseconds."""
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
            _check_columns(path, file.schema_arrow.names, stamps, columns)
            for batch in file.iter_batches(4096, columns=[stamps, *columns]):
                times = batch.column(stamps)
                if is_stamp := pyarrow.types.is_timestamp(times.type):
                    times = times.cast(pyarrow.timestamp("ns")).cast(pyarrow.int64())
                cells = (
                    ["" if x is None else str(x) for x in batch.column(c).to_pylist()]
                    for c in columns
                )
                for time, *texts in zip(times.to_pylist(), *cells, strict=True):
                    number += 1
                    stamp = "" if time is None else time if is_stamp else str(time)
                    yield number, stamp, texts
                progress(number, file.metadata.num_rows)
    except (OSError, pyarrow.ArrowException) as error:
        said = str(error).splitlines()[0]
        raise ParameterError(
            f"{path}: cannot be read as Parquet, whose index is at its end ({said})"
        ) from None
    if number == 0:
        raise ParameterError(f"{path}: has no rows")
