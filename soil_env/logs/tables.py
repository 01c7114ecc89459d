"""Rows of CSV and Parquet files with time stamps, block by block."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path

import numpy as np

from soil_env._io.loading import ParameterError, unknown_key
from soil_env.logs.bags import Notes
from soil_env.logs.mapping import TIMES

SUFFIXES = (".csv", ".parquet", ".pq")
_BLOCK = 4096  # rows

Block = tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]  # row of the file [N], time [N] ns, columns [N], NaN empty
_LATEST = 2**62  # [ns] from 1970, the year 2116


def blocks(
    path: Path, stamps: str, unit: str, columns: dict[str, str], notes: Notes, progress: Callable[[int, int], None]
) -> Iterator[Block]:
    """Blocks of rows: time stamps in the column `stamps` of `unit`, and `columns`, each with the reading it is for."""
    reader = _csv if path.suffix.lower() == ".csv" else _parquet
    yield from reader(path, stamps, unit, columns, notes, progress)


def _check_columns(path: Path, header: list[str], stamps: str, columns: dict[str, str]) -> None:
    for name, what in {stamps: "time", **columns}.items():
        if name not in header:
            raise ParameterError(str(unknown_key(name, header, f"{path}: {what}")).replace("unknown key", "no column"))


def _nanoseconds(number: float, unit: str) -> int:
    """A time stamp that is a number, exactly where it is whole; ValueError beyond `_LATEST`."""
    if not abs(number) * TIMES[unit] * 1e9 <= _LATEST:
        raise ValueError(number)
    if unit == "ns" or (float(number).is_integer() and unit in ("us", "ms", "s")):
        return int(number) * round(TIMES[unit] * 1e9)
    return round(float(number) * TIMES[unit] * 1e9)


def _iso(text: str) -> int:
    """Nanoseconds of an ISO 8601 text; one without a zone is taken as UTC."""
    at = datetime.fromisoformat(text)
    at = at if at.tzinfo else at.replace(tzinfo=UTC)
    delta = at - datetime(1970, 1, 1, tzinfo=UTC)
    if abs(delta.total_seconds()) > _LATEST * 1e-9:
        raise ValueError(text)
    return (delta.days * 86400 + delta.seconds) * 1_000_000_000 + delta.microseconds * 1000


def _stamp(text: str, unit: str) -> int:
    if unit == "iso":
        return _iso(text)
    try:
        at = int(Decimal(text.strip()) * round(TIMES[unit] * 1e9))  # a float has not the digits of a time of today
    except (ArithmeticError, ValueError):
        raise ValueError(text) from None
    if abs(at) > _LATEST:
        raise ValueError(text)
    return at


def _csv(path, stamps, unit, columns, notes, progress) -> Iterator[Block]:
    size = path.stat().st_size
    try:
        with path.open("rb") as raw:
            reader = csv.reader((line.decode("utf-8") for line in raw), strict=True)
            rows = (cells for cells in reader if any(map(str.strip, cells)) and not cells[0].startswith("#"))
            header = [cell.strip().lstrip("\ufeff") for cell in next(rows, [])]
            if not header:
                raise ParameterError(f"{path}: has no line: expected a header with column names, and rows below it")
            if stamps in header and not set(columns) <= set(header) and _is_one_line(path, size):
                raise ParameterError(f"{path}: is cut off in its header, after column {header[-1]!r}: nothing to read")
            _check_columns(path, header, stamps, columns)
            at, places = header.index(stamps), [header.index(c) for c in columns]
            block: list[tuple[int, int, list[float]]] = []
            late: str | None = None  # a short row, no matter if it is the last
            any_row, nans = False, Counter[str]()
            for cells in rows:
                if late is not None:
                    raise ParameterError(late)
                row = reader.line_num
                if len(cells) != len(header):
                    late = f"{path}: row {row} has {len(cells)} cells: expected {len(header)}, as the header"
                    continue
                time = _cell(cells[at], lambda t: _stamp(t, unit), path, row, stamps, f"a time in {unit} in every row")
                block.append((row, time, [_cell(cells[p], _value, path, row, header[p]) for p in places]))
                nans.update(header[p] for p, x in zip(places, block[-1][2], strict=True) if x != x and cells[p].strip())
                any_row = True
                if len(block) == _BLOCK:
                    progress(raw.tell(), size)
                    yield _block(block, columns)
                    block = []
            if not any_row:
                cut = "" if late is None else ": it is cut off"
                raise ParameterError(f"{path}: no whole row below the header{cut}")
            if late is not None:
                notes.add(f"{path.name} is cut off in its last row: that row is left out")
            _tell_nans(notes, nans)
            if block:
                yield _block(block, columns)
    except UnicodeDecodeError as error:
        raise ParameterError(f"{path}: not UTF-8 text (byte {error.start} of a line): expected a CSV file") from None
    except csv.Error as error:
        raise ParameterError(f"{path}: not a CSV file ({error})") from None
    progress(size, size)


def _is_one_line(path: Path, size: int) -> bool:
    """Whether a file ends before its first line does."""
    with path.open("rb") as raw:
        first = raw.readline()
    return len(first) == size and not first.endswith(b"\n")


def _block(block: list[tuple[int, int, list[float]]], columns: dict[str, str]) -> Block:
    rows, times, values = zip(*block, strict=True)
    matrix = np.array(values, float).reshape(len(rows), len(columns))
    return np.array(rows), np.array(times, np.int64), {c: matrix[:, k] for k, c in enumerate(columns)}


def _tell_nans(notes, nans: Counter[str]) -> None:
    for column, count in nans.items():
        notes.add(f"column {column}: {count} cell{'s' * (count > 1)} nan: taken as empty")


def _value(text: str) -> float:
    return float(text) if text.strip() else math.nan


def _cell(text: str, convert, path: Path, row: int, column: str, expected: str = "a number in every row"):
    try:
        return convert(text)
    except ValueError:
        raise ParameterError(f"{path}: row {row}, {column} = {text!r}: expected {expected}") from None


def _parquet(path, stamps, unit, columns, notes, progress) -> Iterator[Block]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ParameterError(f"{path}: Parquet needs the extra logs: pip install 'soil_env[logs]'") from None
    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            header = file.schema_arrow.names
            _check_columns(path, header, stamps, columns)
            done, size, nans = 0, path.stat().st_size, Counter[str]()
            for batch in file.iter_batches(_BLOCK, columns=[stamps, *columns]):
                rows = np.arange(done + 1, done + batch.num_rows + 1)
                times = _arrow_times(path, batch.column(stamps), unit, rows)
                values = {c: _arrow_numbers(path, batch.column(c), c) for c in columns}
                for c, x in values.items():
                    nans[c] += int(np.isnan(x).sum()) - batch.column(c).null_count
                done += batch.num_rows
                progress(int(size * done / max(file.metadata.num_rows, 1)), size)
                yield rows, times, values
            if done == 0:
                raise ParameterError(f"{path}: has no rows")
            _tell_nans(notes, +nans)
    except (OSError, pyarrow.ArrowException) as error:
        said = str(error).splitlines()[0]
        raise ParameterError(f"{path}: cannot be read as Parquet, whose index is at its end ({said})") from None


def _arrow_numbers(path: Path, column, name: str) -> np.ndarray:
    try:
        return column.cast("float64", safe=False).to_numpy(zero_copy_only=False)
    except Exception as error:  # the kinds of error differ by type of the column
        raise ParameterError(f"{path}: column {name} is {column.type}: expected numbers") from error


def _arrow_times(path: Path, column, unit: str, rows: np.ndarray) -> np.ndarray:
    if column.null_count:
        raise ParameterError(f"{path}: the column of time has {column.null_count} empty cells: expected a time in each")
    if str(column.type).startswith("timestamp"):
        return column.to_numpy(zero_copy_only=False).astype("datetime64[ns]").astype(np.int64)
    given = column.to_pylist()
    if str(column.type) in ("string", "large_string"):
        convert = _stamp
    else:
        _arrow_numbers(path, column, "time")
        convert = _nanoseconds
    cells = zip(given, rows.tolist(), strict=True)
    return np.array([_cell(t, lambda x: convert(x, unit), path, k, "time", f"a time in {unit}") for t, k in cells])
