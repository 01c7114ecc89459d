"""Measurement tables: one row is one steady point of a wheel in a test rig or on a rover.

`read_table` reads a table in CSV. `soil_env.measurement.setup` reads the YAML file beside it.
Everything is in SI units. Impossible values are refused with one line that names the file, the row,
the column, the value and what was expected (`ParameterError`). Rows are lines of the file, those of
comments too.
"""

import csv
import dataclasses
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from soil_env._io.loading import TITLES, ParameterError, decimal, plural, refuse_title
from soil_env.parameters import LARGEST_WHEEL
from soil_env.slip import slips_of_radius

from .names import meant
from .setup import MOST_SINKAGE_NOISE, REQUIRED, Setup, SetupWheel

Channel = Literal["sinkage", "drawbar_pull", "torque"]
MEASURED: tuple[Channel, ...] = ("sinkage", "drawbar_pull", "torque")
NOISE = tuple(f"{name}_sd" for name in MEASURED)  # 1-sigma of the value in the same row
UNITS = {
    "slip": "",
    "load": "N",
    "speed": "m/s",
    "pass": "",
    "grade_deg": "deg",
    "run": "",
    "time": "s",
    "wheel_radius": "m",
    "wheel_width": "m",
    "grouser_height": "m",
    "sinkage": "m",
    "drawbar_pull": "N",
    "torque": "N m",
    "sinkage_sd": "m",
    "drawbar_pull_sd": "N",
    "torque_sd": "N m",
}
COLUMNS = tuple(UNITS)

DEEPEST = 1.0  # [m] a larger sinkage is taken for millimetres
STEEPEST = 60.0  # [deg]
FASTEST = 40.0  # [m/s] a larger speed is taken for mm/s
LIGHTEST = 1e-3  # [N] of a load
STRONGEST = 1e6  # [N], [N m] of a load, and of a pull or torque either way
MOST_BYTES = 50_000_000  # of a file: half a million steady points
MOST_PASSES = 10**6  # pass numbers are whole and small
TALLEST = 1.0  # [m] of a grouser
#: Largest |slip| beyond 1 that may be (r w - V)/V, and the largest that may be percent.
MOST_SLIP_OVER_TRAVEL = 2.0
MOST_PERCENT = 100.0
STEEPEST_IN_RADIANS = 40.0  # [deg] grades that look like radians are all below it
FEWEST_DIGITS = 3  # of a grade behind the point, that looks like radians
MOST_DIGITS = 6  # of longer ones that are compared, as single precision has them
EXACTEST = 1e-9  # least standard deviation, in the unit of its column
COARSEST = 1e6  # largest one

_SEPARATOR = re.compile(r"sep=.\s*", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")
#: A number with commas, spaces or apostrophes among its digits.
_GROUPED = re.compile(r"[-+]?\d+(?:[,.'\u2019\s]\d+)+")

Rows = Sequence[tuple[int, list[str]]]  # line of the file and cells


def with_default(values: np.ndarray, other: np.ndarray | float) -> np.ndarray:
    """The values, an array of any shape, and the `other`, a number or an array of that shape, where
    they are NaN.
    """
    return np.where(np.isnan(values), other, values)


@dataclass(frozen=True, eq=False)
class Table:
    """Columns [N] of a measurement table, read-only as `read_table` gives them; NaN where a cell is
    empty or the column absent.

    Only `passes` and `run` have other values for "not given": 1 and "".
    """

    source: str  # the file, for messages
    row: np.ndarray  # line of the file, int
    slip: np.ndarray  # [-] in [-1, 1]
    load: np.ndarray  # [N]
    sinkage: np.ndarray  # [m]
    drawbar_pull: np.ndarray  # [N]
    torque: np.ndarray  # [N m]
    speed: np.ndarray  # [m/s] travel
    passes: np.ndarray  # column `pass`: 1 = fresh soil, int
    grade_deg: np.ndarray  # [deg] uphill positive
    run: np.ndarray  # group, text
    time: np.ndarray  # [s]
    wheel_radius: np.ndarray  # [m] overrides of the setup's wheel
    wheel_width: np.ndarray  # [m]
    grouser_height: np.ndarray  # [m]
    sinkage_sd: np.ndarray  # [m] 1-sigma of the value in the row; nan where the setup's holds
    drawbar_pull_sd: np.ndarray  # [N]
    torque_sd: np.ndarray  # [N m]

    def __len__(self) -> int:
        """Number of rows."""
        return self.slip.size

    def conditions(self) -> dict[str, np.ndarray]:
        """Conditions [N] of the rows by column, as `WheelSoilModel.predict` takes them.

        The slip is as in the column, even where that is by the lug tips (see `rim_slip`).
        """
        names = (*REQUIRED, "speed", "grade_deg", "wheel_radius", "wheel_width", "grouser_height")
        return {name: getattr(self, name) for name in names} | {"pass": self.passes}

    def only(self, rows: np.ndarray) -> "Table":
        """The table with these rows only: indices, or [N] bool."""
        return dataclasses.replace(
            self, **{k: v[rows] for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        )

    def with_values(self, used: np.ndarray) -> "Table":
        """The table with the values that are `used` alone, [N, 3] bool with a column for each of
        `MEASURED`; others count as not measured.
        """
        values = np.where(used, self.values, math.nan)
        return dataclasses.replace(self, **dict(zip(MEASURED, values.T, strict=True)))

    @property
    def values(self) -> np.ndarray:
        """[N, 3] values, with a column for each of `MEASURED`; NaN where not measured."""
        return np.stack([getattr(self, name) for name in MEASURED], axis=1)

    def radius(self, wheel: SetupWheel) -> np.ndarray:
        """Wheel radius [m] of each row: the override where there is one."""
        return with_default(self.wheel_radius, wheel.radius)

    def width(self, wheel: SetupWheel) -> np.ndarray:
        """Wheel width [m] of each row: the override where there is one."""
        return with_default(self.wheel_width, wheel.width)

    def height(self, wheel: SetupWheel) -> np.ndarray:
        """Grouser height [m] of each row: the override where there is one; nan where neither row
        nor wheel has a height.
        """
        known = math.nan if wheel.grouser_height is None else wheel.grouser_height
        return with_default(self.grouser_height, known)

    def channel_sd(self, setup: Setup, name: str) -> float | None:
        """1-sigma of a channel in its unit: the setup's, else the median of its `_sd` column; None
        where neither gives one.
        """
        own = getattr(self, f"{name}_sd")
        known = getattr(setup.noise, name)
        return known if known is not None or np.all(np.isnan(own)) else float(np.nanmedian(own))

    def sd_source(self, setup: Setup, name: str) -> str:
        """File and key, or file and column, that the `channel_sd` of `name` comes from, for
        messages; for slip and load the key of their noise in the setup.
        """
        of_setup = getattr(setup.noise, name) is not None
        return f"{setup.source}: noise.{name}" if of_setup else f"{self.source}: {name}_sd"

    def relative_sd(self, setup: Setup) -> np.ndarray:
        """1-sigma of each value over the `channel_sd` of its channel [N, 3], as `MEASURED`; 1 where
        a row gives none.
        """
        level = np.array([self.channel_sd(setup, name) or 1.0 for name in MEASURED])
        return with_default(np.stack([getattr(self, name) for name in NOISE], axis=1) / level, 1.0)

    def rim_slip(self, setup: Setup) -> np.ndarray:
        """Slip [N] by the radius of the rim; converted where the setup says that the column is by
        the radius r + h to the lug tips.

        V/(r w) is (r + h)/r times V/((r + h) w). `ParameterError` where h is not known.
        """
        if setup.slip_reference == "rim":
            return self.slip
        height = self.height(setup.wheel)
        if np.any(np.isnan(height)):
            raise ParameterError(
                f"{setup.source}: slip_reference: tip: expected wheel.grouser_height, or a column "
                "grouser_height"
            )
        return slips_of_radius(self.slip, 1.0 + height / self.radius(setup.wheel))


def read_table(
    path: str | Path, wheel: SetupWheel | None = None, ignore: Sequence[str] = ()
) -> Table:
    """The measurement table in a CSV file, without the rows that have no measured value.

    With `wheel`, sinkages and lugs are compared with its radius in rows that give none. Columns
    named in `ignore` (`ignore_columns` of a setup) are passed over, but a row is refused as a
    repeat only if it equals another in these too. Raises `ParameterError` with one line for
    everything that cannot be right.
    """
    path = Path(path)
    header, whole_rows = _csv_cells(path, ignore)
    kept = [k for k, name in enumerate(header) if name not in ignore]
    header = [header[k] for k in kept]
    rows = [(line, [cells[k] for k in kept]) for line, cells in whole_rows]
    _check_header(path, header)
    if not rows:
        raise ParameterError(
            f"{path}: no rows below the header: expected one row for each steady point"
        )
    values = [k for k, name in enumerate(header) if name in MEASURED]
    # Without any value a row says nothing; a table of such rows is refused below.
    rows = [row for row in rows if any(row[1][k] for k in values)] or rows
    columns = {
        name: _column(path, name, header, rows) for name in COLUMNS if name not in ("run", "pass")
    }
    passes = _column(path, "pass", header, rows)
    table = Table(
        source=str(path),
        row=np.array([line for line, _ in rows]),
        # What is cut here is refused by `_check_rows`.
        passes=np.clip(with_default(passes, 1.0), 0, MOST_PASSES).astype(int),
        run=np.array(_texts("run", header, rows)),
        **columns,
    )
    _check_rows(table, header, rows, wheel, passes)
    kept_lines = {line for line, _ in rows}
    _check_repeats(path, [row for row in whole_rows if row[0] in kept_lines])
    for column in vars(table).values():
        if isinstance(column, np.ndarray):
            column.flags.writeable = False
    return table


def _csv_cells(path: Path, ignore: Sequence[str]) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Header and (line of the file from 1, cells) of the rows that are not blank, every cell
    stripped. Commas in the columns `ignore` stay as they are.

    Lines that begin with # and a first line such as `sep=;` are passed over. Semicolons, tabs or
    bars in a header without commas separate the columns, and then commas may be decimal. Columns at
    the end that have neither name nor value are dropped, as spreadsheets write them.

    `ParameterError` for a file that cannot be read, is too large or empty, or is no CSV in UTF-8.
    So also for a title above the header, and for a row with more or fewer cells than the header.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ParameterError(
                f"{path}: larger than {MOST_BYTES // 10**6} MB: expected one row for each steady "
                "point; soil-env logs makes such rows of a recording"
            )
        # With or without a byte order mark.
        with path.open(encoding="utf-8-sig", newline="") as stream:
            # Lines that are passed over become blank, so that the reader counts them.
            text = ["\n" if line.lstrip().startswith("#") else line for line in stream]
            written = [k for k, line in enumerate(text) if line.strip()]
            if written and _SEPARATOR.fullmatch(text[written[0]]):  # of spreadsheets
                text[written.pop(0)] = "\n"
            first = text[written[0]] if written else ""
            refuse_title(path, [re.split(r"[,;\t|]", text[k]) for k in written[:TITLES]], REQUIRED)
            mark = next((m for m in ";\t|" if m in first and "," not in first), ",")
            reader = csv.reader(text, strict=True, delimiter=mark)
            lines = [
                (reader.line_num, cells)
                for row in reader
                if any(cells := [cell.strip() for cell in row])
            ]
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise ParameterError(
            f"{path}: not UTF-8 text: expected a CSV file in UTF-8, no Parquet or Excel file (in a "
            "spreadsheet: save as CSV UTF-8)"
        ) from None
    except csv.Error as error:
        raise ParameterError(f"{path}: not a CSV file ({error})") from None
    if not lines:
        raise ParameterError(f"{path}: empty file: expected a header line with column names")
    if mark != ",":
        numbers = {*COLUMNS} - {"run", *ignore}
        lines = [lines[0], *_with_points(path, lines[0][1], lines[1:], numbers)]
    width = max(k for _, cells in lines for k, cell in enumerate(cells) if cell) + 1
    (_, header), *rows = [(line, cells[:width]) for line, cells in lines]
    for line, cells in rows:
        if len(cells) != len(header):
            more = mark == "," and len(cells) > len(header)
            hint = " (numbers with decimal points, not commas)" if more else ""
            raise ParameterError(
                f"{path}: row {line} has {plural(len(cells), 'cell')}: expected {len(header)}, as "
                f"the header{hint}"
            )
    return header, rows


def _with_points(
    path: Path, header: list[str], lines: Rows, names: set[str]
) -> list[tuple[int, list[str]]]:
    """The lines with decimal points for decimal commas in the columns `names`; `ParameterError`
    where some of their cells have commas and others points.
    """
    numbers = {k for k, name in enumerate(header) if name in names}
    cells = [(line, cell) for line, row in lines for k, cell in enumerate(row) if k in numbers]
    commas = [(line, cell) for line, cell in cells if _DECIMAL_COMMA.fullmatch(cell)]
    points = [(line, cell) for line, cell in cells if re.fullmatch(r"[-+]?\d*\.[\d.,]*", cell)]
    if commas and points:
        line, cell = points[0]
        raise ParameterError(
            f"{path}: row {line}, {cell!r} has a point, row {commas[0][0]}, {commas[0][1]!r} a "
            "comma: expected one decimal mark, and no separators of thousands"
        )
    # what is no decimal number stays as it is in the file, for the message
    return [
        (
            line,
            [
                cell.replace(",", ".") if k in numbers and _DECIMAL_COMMA.fullmatch(cell) else cell
                for k, cell in enumerate(row)
            ],
        )
        for line, row in lines
    ]


def _check_header(path: Path, header: list[str]) -> None:
    """Refuse a header that is a row of numbers, or has an unknown, missing, empty or double name:
    `ParameterError`. Needed are `REQUIRED` and one of `MEASURED`.
    """
    if all(isinstance(_canonical(name), float) for name in header):
        raise ParameterError(
            f"{path}: the first line has numbers: expected a header line with column names, "
            "without # before it"
        )
    if "" in header:
        raise ParameterError(
            f"{path}: column {header.index('') + 1} has no name: expected one in the header"
        )
    unknown = [name for name in dict.fromkeys(header) if name not in COLUMNS]
    if unknown:
        names = ", ".join(f"{name!r}{meant(name, header, COLUMNS)}" for name in unknown)
        raise ParameterError(
            f"{path}: unknown column{'s' * (len(unknown) > 1)} {names} (known: "
            f"{', '.join(COLUMNS)}; a column to pass over: ignore_columns in the setup)"
        )
    for name in header:
        if header.count(name) > 1:
            raise ParameterError(
                f"{path}: column {name!r} appears {header.count(name)} times: expected once"
            )
    for name in REQUIRED:
        if name not in header:
            raise ParameterError(
                f"{path}: missing column {name!r}: expected {' and '.join(REQUIRED)} in every table"
            )
    if not set(MEASURED) & set(header):
        raise ParameterError(
            f"{path}: missing column: expected at least one of {', '.join(MEASURED)}"
        )


def _texts(name: str, header: list[str], rows: Rows) -> list[str]:
    """The cells [N] of one column, all "" where the column is absent."""
    return [cells[header.index(name)] if name in header else "" for _, cells in rows]


def _column(path: Path, name: str, header: list[str], rows: Rows) -> np.ndarray:
    """The numbers [N] of one column, NaN for an empty cell or an absent column; `ParameterError`
    for any other cell that is no finite number.
    """
    out = np.full(len(rows), math.nan)
    for k, text in enumerate(_texts(name, header, rows)):
        if not text:
            continue
        value = _canonical(text)
        out[k] = value if isinstance(value, float) else math.nan
        if not math.isfinite(out[k]):
            unit = f" in {UNITS[name]}" if UNITS[name] else ""
            if k == 0 and not any(isinstance(_canonical(cell), float) for cell in rows[0][1]):
                raise ParameterError(
                    f"{path}: row {rows[0][0]} has no number, {name} = {text!r}: expected values "
                    "below the header (a row of units begins with #)"
                )
            hint = (
                "with a decimal point, without separators of thousands"
                if _GROUPED.fullmatch(text)
                else "(empty = not measured)"
            )
            raise ParameterError(
                f"{path}: row {rows[k][0]}, {name} = {text!r}: expected a finite number{unit} "
                f"{hint}"
            )
    return out


def _check_rows(
    table: Table, header: list[str], rows: Rows, wheel: SetupWheel | None, passes: np.ndarray
) -> None:
    """Refuse values that cannot be right: `ParameterError`, which names the first wrong row of the
    first check that fails.

    Checked are cells of `REQUIRED` that are empty, each column for its range and for likely other
    units, and grades for radians. Then sinkages, their noise and lugs are compared with the radius,
    and `_check_whole` follows.

    `passes` [N]: the column `pass` as it was written, nan where empty. Without `wheel`, sinkage and
    lugs are compared with the radius only in rows that give a radius.
    """

    def refuse(name: str, wrong: np.ndarray, expected: str) -> None:
        """Raise `ParameterError` for the first row where the column `name` is `wrong` [N] bool."""
        if np.any(wrong):
            k = np.flatnonzero(wrong)[0]
            text = _texts(name, header, rows)[k]
            value = f"= {text}" if text else "is empty"
            raise ParameterError(
                f"{table.source}: row {rows[k][0]}, {name} {value}: expected {expected}"
            )

    for name in REQUIRED:
        refuse(name, np.isnan(getattr(table, name)), "a number in every row")
    slip = np.abs(table.slip)
    most = np.max(slip)
    hint = ""  # what the column may be instead; for an impossible slip only
    if np.max(table.slip) <= 1.0 and most <= MOST_SLIP_OVER_TRAVEL:
        hint = " (if it is (r w - V)/(r w) where the wheel is braked, divide it by 1 less itself)"
    elif most <= MOST_SLIP_OVER_TRAVEL:
        hint = " (if it is (r w - V)/V where the wheel drives, divide it by 1 + itself)"
    elif most <= MOST_PERCENT:
        hint = " (if it is percent, divide by 100)"
    refuse("slip", slip > 1.0, f"slip in [-1, 1]{hint}")
    refuse(
        "load",
        table.load < LIGHTEST,
        f"a load > 0 N, upward on the wheel, at least {LIGHTEST:g}",
    )
    refuse("load", table.load > STRONGEST, f"newtons, at most {STRONGEST:g}")
    refuse("speed", table.speed < 0.0, "a travel speed >= 0 m/s")
    refuse(
        "speed",
        table.speed > FASTEST,
        f"metres per second, at most {FASTEST:g} (if it is mm/s, divide by 1000)",
    )
    wrong = (passes % 1.0 > 0.0) | (passes < 1) | (passes > MOST_PASSES)
    refuse("pass", wrong, f"a whole number from 1 (fresh soil) to {MOST_PASSES:g}")
    grade = np.abs(table.grade_deg)
    refuse("grade_deg", grade > STEEPEST, f"degrees in [-{STEEPEST:g}, {STEEPEST:g}]")
    looks = look_like_radians(_texts("grade_deg", header, rows))
    # One grade may look so by chance; `identification.table.mistakes` only doubts it.
    if looks and np.unique(grade[grade > 0.0]).size > 1:
        refuse("grade_deg", grade > 0.0, "degrees (these look like radians: multiply by 57.3)")
    for name in ("wheel_radius", "wheel_width"):
        size = getattr(table, name)
        refuse(name, (size <= 0.0) | (size > LARGEST_WHEEL), f"metres in (0, {LARGEST_WHEEL:g}]")
    for name in NOISE:
        sd = getattr(table, name)
        refuse(
            name,
            (sd < EXACTEST) | (sd > COARSEST),
            f"a standard deviation in [{EXACTEST:g}, {COARSEST:g}] {UNITS[name]}, or an empty cell",
        )
    limits = f"[-{STRONGEST:g}, {STRONGEST:g}]"
    refuse("drawbar_pull", np.abs(table.drawbar_pull) > STRONGEST, f"newtons in {limits}")
    refuse("torque", np.abs(table.torque) > STRONGEST, f"newton metres in {limits}")
    radius = table.wheel_radius
    height = table.grouser_height
    refuse("grouser_height", (height < 0.0) | (height > TALLEST), f"metres in [0, {TALLEST:g}]")
    sinkage = np.abs(table.sinkage)
    refuse(
        "sinkage",
        sinkage > DEEPEST,
        "metres (this can only be millimetres, divide by 1000, or centimetres)",
    )
    if wheel is not None:
        radius = table.radius(wheel)
        height = table.height(wheel)
    refuse("grouser_height", table.grouser_height >= radius, "metres, less than the wheel radius")
    refuse("wheel_radius", table.wheel_radius <= height, "metres, more than the grouser height")
    coarse = table.sinkage_sd > MOST_SINKAGE_NOISE * radius
    # A single one may be meant, so that the row hardly counts.
    if 2 * coarse.sum() > np.isfinite(table.sinkage_sd).sum():
        refuse(
            "sinkage_sd",
            coarse,
            "metres, well below the wheel radius (if it is millimetres, divide by 1000)",
        )
    deep = sinkage > radius
    if np.any(deep):
        hint = "if it is millimetres, divide by 1000"
        others = sinkage[~deep & np.isfinite(sinkage)]
        # Where most sinkages are possible, a single row is wrong, not the unit of the column.
        if others.size > np.sum(deep) and np.median(others) > 0.0:
            hint = f"it is {sinkage[deep][0] / np.median(others):.2g} times the others"
        refuse("sinkage", deep, f"metres, at most the wheel radius {radius[deep][0]:g} m ({hint})")
    _check_whole(table)


def _check_whole(table: Table) -> None:
    """Raise `ParameterError` for a row without any measured value, and for a table that has one
    slip only.
    """
    nothing = np.all(np.isnan(table.values), axis=1)
    if np.any(nothing):
        raise ParameterError(
            f"{table.source}: row {table.row[nothing][0]}: nothing measured: expected one of "
            f"{', '.join(MEASURED)}"
        )
    if np.all(table.slip == table.slip[0]):
        said = "one row" if len(table) == 1 else f"slip = {table.slip[0]:g} in every row"
        raise ParameterError(f"{table.source}: {said}: expected at least two, with different slips")


def _check_repeats(path: Path, rows: Rows) -> None:
    """Raise `ParameterError` for a row that repeats an earlier one in every cell; numbers are
    compared by value.
    """
    seen: dict[tuple[str, ...], int] = {}
    for line, cells in rows:
        key = tuple(str(_canonical(c)) for c in cells)  # as text nan equals nan
        if key in seen:
            raise ParameterError(
                f"{path}: row {line} repeats row {seen[key]} in every column: expected each point "
                "once (a true repeat differs in run or time)"
            )
        seen[key] = line


def _canonical(cell: str) -> float | str:
    """A cell as a number if it is one (nan and inf too), else as its text."""
    try:
        return decimal(cell)
    except ValueError:
        return cell


def look_like_radians(cells: list[str]) -> bool:
    """True if grades look like radians; `cells` are texts, of which the empty and zero ones do not
    count.

    Read as radians, every grade is below `STEEPEST_IN_RADIANS` and is a whole degree, rounded to
    the digits of the cell: `FEWEST_DIGITS` at least, `MOST_DIGITS` of longer cells. One grade
    alone looks so by chance in six of a thousand cases with four digits.
    """
    grades = [cell for cell in cells if cell and float(cell) != 0.0]
    for grade in grades:
        x = float(grade)
        digits = min(len(grade.rpartition(".")[2]), MOST_DIGITS)
        if digits < FEWEST_DIGITS or not abs(x) < math.radians(STEEPEST_IN_RADIANS):
            return False
        whole = round(math.radians(round(math.degrees(x))), digits)
        # both have the same digits: equal but for the rounding of floats
        if abs(whole - round(x, digits)) >= 10.0**-digits * 1e-3:
            return False
    return bool(grades)
