"""Dense tables: rows that a run recorded at a high rate, averaged in bins of similar conditions.

Errors of such rows are correlated from one row to the next, so that there are fewer independent
values than rows. The mean of a bin counts as one value, and its noise is the scatter of the means.
"""

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import median_abs_deviation

from soil_env.measurement.setup import NoiseLevels, Setup
from soil_env.measurement.table import MEASURED, NOISE, Table

from .form_error import LAW_LENGTHS, LENGTHS, coordinate
from .noise import SD_OF_MEDIAN

DENSE = 240  # rows above which every table is binned
#: Rows above which a series is binned if its bins have `FEWEST` or more rows on average.
REPEATED = 100
MOST = 120  # bins
#: Bins of a series, a dense table in which a row is mostly within `NEAR` of the one before. Errors
#: that go on from row to row are shared by neighbouring bins if these are short; own choice.
MOST_OF_SERIES = 40
NEAR = 0.25  # [correlation lengths] own choice
FINE = 0.04  # [correlation lengths of a form error] extent of a bin that is not cut further
JUMP = 0.25  # share of the extent of a bin, above which a gap between values is where it is cut
FEWEST = 8  # values of a bin, of which one may be an outlier
OUTLIER_AT = 8.0  # [sd] from the median of a bin, beyond which a value is an outlier
#: Rows of a bin if all were equal, over the fewest that a part of a cut may have; own
#: choice.
_PART = 4
_WIDE = 1.0  # [correlation lengths] extent from which a bin is cut whatever its parts are
# A condition is held while consecutive rows only scatter about it (`_held`); own choices.
_STRETCHED = 0.8  # share of the rows of a bin that the next row of the table follows, at least
_ALTERNATING = 0.1  # share of these that the cut parts from the next row, at least
_SCATTER = 0.25  # range over that of the whole table along the coordinate, at most, or `NEAR`
_BREAK = 8  # rows of other bins between two stretches at the same conditions, at least
# Correlation lengths of the coordinates in which rows are compared.
_LENGTHS = {name: LENGTHS[name] for name in LENGTHS if name != "elapsed"} | {
    "log_slip": LAW_LENGTHS[2]["log_slip"]
}
_APART = 10.0  # correlation lengths between rows whose channels or overrides differ


class Binned(NamedTuple):
    """A table in bins."""

    table: Table
    setup: Setup  # without the noise of single rows
    words: str  # on what was done; "" for a table that is taken as it is


def binned(table: Table, setup: Setup) -> Binned:
    """The table with one row a bin if it is dense, as it is otherwise.

    Dense are tables of more than `DENSE` rows, and series of more than `REPEATED` with `FEWEST`
    rows or more a bin on average. In a series a row is mostly near the one before (`NEAR`). A
    measured value of a bin is the mean without outliers. Noise of the rows and of the setup, that
    of slip and load too, is dropped: it is that of single rows.
    """
    if len(table) <= REPEATED:
        return Binned(table, setup, "")
    x = _coordinates(table, setup)
    series = np.median(np.max(np.abs(np.diff(x, axis=0)), axis=1)) < NEAR
    few = len(table) <= DENSE
    bins = _bins(x, MOST_OF_SERIES if series and not few else MOST)
    if few and not (series and len(table) >= FEWEST * len(bins)):
        return Binned(table, setup, "")
    columns: dict[str, Any] = {
        name: np.stack([_merged(column[rows]) for rows in bins])
        for name, column in vars(table).items()
        if isinstance(column, np.ndarray)
    }
    outliers = 0
    for channel in MEASURED:
        values = [getattr(table, channel)[rows] for rows in bins]
        # A channel that was not measured in a bin has no spread there.
        spreads = [s for s in map(median_abs_deviation, values) if math.isfinite(s)]
        usual = np.median(spreads) if spreads else 0.0
        cleaned = [_without_outliers(v, usual) for v in values]
        outliers += sum(count for _, count in cleaned)
        columns[channel] = np.array([value for value, _ in cleaned])
    columns |= dict.fromkeys(NOISE, np.full(len(bins), math.nan))
    sizes = [rows.size for rows in bins]
    words = (
        f"The table is dense: its {len(table)} rows are taken in {len(bins)} bins of {min(sizes)} "
        f"to {max(sizes)} rows at about the same conditions. The mean of a bin counts as one "
        "value, and its noise is the scatter of the means, not what the setup says of single "
        "rows: errors that go on from row to row count once, unless they outlast a bin. A row that "
        "is named stands for the bin that begins with it, and its values are means."
    )
    if outliers:
        words += f" Values left out that are far from the others of their bin: {outliers}."
    return Binned(dataclasses.replace(table, **columns), setup.changed(noise=NoiseLevels()), words)


def _coordinates(table: Table, setup: Setup) -> np.ndarray:
    """Coordinates [N, D] of the rows in correlation lengths of a form error: the conditions that
    vary, and what only some rows have.

    Rows that lack a condition or a channel lie `_APART` from those that have it, so that the first
    cuts part the two.
    """
    conditions = table.conditions() | {
        "wheel_radius": table.radius(setup.wheel),
        "wheel_width": table.width(setup.wheel),
        "grouser_height": table.height(setup.wheel),
    }
    columns = []
    for name, length in _LENGTHS.items():
        value = coordinate(name, conditions) / length
        columns += [np.nan_to_num(value), _APART * np.isnan(value)]
    columns += [*(_APART * np.isnan(table.values).T)]
    x = np.stack(columns, axis=1)
    return x[:, np.ptp(x, axis=0) > 0.0]


def _bins(x: np.ndarray, most: int) -> list[np.ndarray]:
    """Row numbers of each bin of the coordinates x [N, D], in the order of their first rows.

    The widest bin is cut in two (`_cut`) until none is wider than `FINE`, or there are `most`. A
    bin that is narrower than `_WIDE` also stays whole if a part of it would have too few rows
    (`_PART`). A narrow bin that is `_held` is not cut by its values: parts that alternate from row
    to row would share the errors that go on from row to row. It is cut in time instead (`_times`)
    if its condition is held more than once.
    """
    few = max(1, len(x) // (_PART * most))
    bins = [np.arange(len(x))]
    extents = [_extent(x)]  # 0 for a bin that stays whole
    while len(bins) < most and max(extents) > FINE:
        widest = np.argmax(extents)
        parts = _cut(x, bins[widest])
        if extents[widest] < _WIDE:
            if _held(x, bins[widest], parts[0]):
                parts = _times(bins[widest])
            if min(map(len, parts)) < few:
                extents[widest] = 0.0
                continue
        del bins[widest], extents[widest]
        bins += parts
        extents += [_extent(x[part]) for part in parts]
    return sorted(bins, key=lambda rows: rows[0])


def _held(x: np.ndarray, rows: np.ndarray, part: np.ndarray) -> bool:
    """True if the `rows` of x [N, D] are stretches of the table that scatter about one condition:
    they are narrow, and consecutive rows are now in the `part` of a cut, now in the other.
    """
    ranges = np.ptp(x[rows], axis=0)
    widest = np.argmax(ranges)
    follows = np.diff(rows) == 1
    changes = np.diff(np.isin(rows, part))
    return bool(
        ranges[widest] < max(NEAR, _SCATTER * np.ptp(x[:, widest]))
        and np.mean(follows) > _STRETCHED
        and np.mean(changes[follows]) > _ALTERNATING
    )


def _times(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two parts of the `rows` of a bin, before and after its longest break: a stretch of the table
    that is in other bins. The second part is empty if no break has `_BREAK` rows or more.
    """
    gaps = np.diff(rows)
    longest = np.argmax(gaps)
    end = longest + 1 if gaps[longest] > _BREAK else rows.size
    return rows[:end], rows[end:]


def _extent(x: np.ndarray) -> float:
    """Range of the rows x [N, D] along the coordinate where it is largest."""
    return np.max(np.ptp(x, axis=0))


def _cut(x: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two parts of the `rows` of x [N, D], cut along the coordinate where their range is largest.

    The cut is at the widest gap if that is more than `JUMP` of the range, else at the widest one of
    the middle half by the same rule. Else it is at the median, or at the change of value that is
    nearest to it.
    """
    here = x[rows]
    value = here[:, np.argmax(np.ptp(here, axis=0))]
    order = np.argsort(value, kind="stable")
    gaps = np.diff(value[order])
    first = value.size // 2  # number of rows in the first part
    quarter = value.size // 4
    for begin in (0, quarter):
        inner = gaps[begin : gaps.size - begin]
        widest = np.argmax(inner)
        if inner[widest] > JUMP * np.sum(inner):
            first = begin + widest + 1
            break
    if gaps[first - 1] == 0.0:  # equal values stay together
        changes = np.flatnonzero(gaps)
        first = changes[np.argmin(np.abs(changes - first))] + 1
    return np.sort(rows[order[:first]]), np.sort(rows[order[first:]])


def _merged(values: np.ndarray) -> Any:
    """One value for those of a bin: the mean of floats (nan if one is), the first of others (line,
    pass, run).
    """
    return np.mean(values) if values.dtype.kind == "f" else values[0]


def _without_outliers(values: np.ndarray, usual: float) -> tuple[float, int]:
    """(mean without outliers, number of outliers) of the values of a bin.

    Outliers are beyond `OUTLIER_AT` sd from the median. The sd is that of a normal distribution
    whose median distance from the median is that of the bin or, if this is larger, `usual`: the
    median over all bins. Fewer than `FEWEST` values have no outliers. If one is nan, the mean is,
    without outliers.
    """
    if values.size < FEWEST:
        return np.mean(values), 0
    reach = OUTLIER_AT * SD_OF_MEDIAN * max(median_abs_deviation(values), usual)
    kept = ~(np.abs(values - np.median(values)) > reach)
    return np.mean(values[kept]), values.size - kept.sum()
