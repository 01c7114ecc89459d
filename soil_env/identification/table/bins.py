"""Dense tables: rows that a run recorded at a high rate, averaged in bins of similar conditions.

Errors of such rows are correlated from one row to the next, so that there are fewer independent
values than rows. The mean of a bin counts as one value, and its noise is the scatter of the means.
"""

import dataclasses
import math
from collections.abc import Callable
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
#: Bins of a series, but for one of so few rows that it may be a grid of steady points. Errors that
#: go on from row to row are shared by neighbouring bins if these are short; own choice.
MOST_OF_SERIES = 40
#: Distance of a row from the one before, by the median, in a dense table that is a series.
NEAR = 0.25  # [correlation lengths] own choice
FINE = 0.04  # [correlation lengths of a form error] extent of a bin that is not cut further
JUMP = 0.25  # share of the extent of a bin, above which a gap between values is where it is cut
FEWEST = 8  # values of a bin, of which one may be an outlier
OUTLIER_AT = 8.0  # [sd] from the median of a bin, beyond which a value is an outlier
#: Rows of a bin if all were equal, over the fewest that a part of a cut may have; own
#: choice.
_PART = 4
_WIDE = 1.0  # [correlation lengths] extent from which a bin is cut whatever its parts are
# [correlation lengths] range from which a condition that scatters over a whole series does more
# than that: it alternates, and so rows are sorted by value; own choice
_MOVES = 0.5
# [correlation lengths] standard deviation in a bin of consecutive rows, above which the series goes
# to and fro too often for such bins; own choice
_TOO_WIDE = 0.45
# Correlation lengths of the coordinates in which rows are compared.
_LENGTHS = {name: LENGTHS[name] for name in LENGTHS if name != "elapsed"} | {
    "log_slip": LAW_LENGTHS[2]["log_slip"]
}
_APART = 10.0  # correlation lengths between rows whose channels or overrides differ


class Binned(NamedTuple):
    """A table in bins."""

    table: Table
    setup: Setup  # without the noise of the channels, which is that of single rows
    words: str  # on what was done; "" for a table that is taken as it is


def binned(table: Table, setup: Setup) -> Binned:
    """The table with one row a bin if it is dense, as it is otherwise.

    Dense are tables of more than `DENSE` rows, and series of more than `REPEATED` with `FEWEST`
    rows or more a bin on average. In a series a row is mostly near the one before (`NEAR`). Bins of
    one whose conditions are held or change slowly are of consecutive rows, so that none is chosen
    by the noise of its slip. Those of others are of like values. A measured value of a bin is the
    mean without outliers, and noise that is given of it is dropped. That of slip and load stays;
    for bins of consecutive rows it is divided by the root of their median size.
    """
    if len(table) <= REPEATED:
        return Binned(table, setup, "")
    x = _coordinates(table, setup)
    steps = np.max(np.abs(np.diff(x, axis=0)), axis=1, initial=0.0)
    series = np.median(steps) < NEAR
    in_order = series and not np.any(_scatters(x) & (np.ptp(x, axis=0) > _MOVES))
    if in_order:
        bins = _bins(x, MOST_OF_SERIES, _split)
        in_order = max(np.max(np.std(x[rows], axis=0), initial=0.0) for rows in bins) <= _TOO_WIDE
    if not in_order:
        recorded = series and len(table) >= FEWEST * MOST  # else single steady points
        bins = _bins(x, MOST_OF_SERIES if recorded else MOST, _cut)
    if len(table) <= DENSE and not (series and len(table) >= FEWEST * len(bins)):
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
        means, counts = zip(*(_without_outliers(v, usual) for v in values), strict=True)
        outliers += sum(counts)
        columns[channel] = np.array(means)
    columns |= dict.fromkeys(NOISE, np.full(len(bins), math.nan))
    sizes = [rows.size for rows in bins]
    root = math.sqrt(np.median(sizes)) if in_order else 1.0
    given = {n: sd / root for n in ("slip", "load") if (sd := getattr(setup.noise, n))}
    words = (
        f"The table is dense: its {len(table)} rows are taken in {len(bins)} bins of {min(sizes)} "
        f"to {max(sizes)} rows at about the same conditions. The mean of a bin counts as one "
        "value, and its noise is the scatter of the means: errors that go on from row to row "
        "count once, unless they outlast a bin. Of the noise in the setup only that of slip and "
        "load is used. A row that is named stands for the bin that begins with it, and its values "
        "are means."
    )
    if outliers:
        words += f" Values left out that are far from the others of their bin: {outliers}."
    return Binned(
        dataclasses.replace(table, **columns), setup.changed(noise=NoiseLevels(**given)), words
    )


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


def _bins(x: np.ndarray, most: int, cut: Callable[..., Any]) -> list[np.ndarray]:
    """Row numbers of each bin of the coordinates x [N, D], in the order of their first rows.

    The widest bin is cut in two (`cut`: `_split` or `_cut`) until none is wider than `FINE`, or
    there are `most`. A bin stays whole if a part would be empty, and one that is narrower than
    `_WIDE` if a part would have too few rows (`_PART`).
    """
    few = max(1, len(x) // (_PART * most))
    bins = [np.arange(len(x))]
    extents = [_extent(x)]  # 0 for a bin that stays whole
    while len(bins) < most and max(extents) > FINE:
        widest = np.argmax(extents)
        parts = cut(x, bins[widest])
        if min(map(len, parts)) < (few if extents[widest] < _WIDE else 1):
            extents[widest] = 0.0
            continue
        del bins[widest], extents[widest]
        bins += parts
        extents += [_extent(x[part]) for part in parts]
    return sorted(bins, key=lambda rows: rows[0])


def _scatters(x: np.ndarray) -> np.ndarray:
    """[D] True for coordinates x [N, D] that scatter from row to row.

    Their squared differences from row to row sum to more than those from the mean: to twice as
    much, if they are white (von Neumann 1941, Ann. Math. Stat. 12:367-395).
    """
    return np.sum(np.diff(x, axis=0) ** 2, axis=0) >= np.sum((x - np.mean(x, axis=0)) ** 2, axis=0)


def _split(x: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two parts of consecutive `rows` of x [N, D], before and after the largest change of their
    mean (binary segmentation: Scott & Knott 1974, Biometrics 30:507-512).

    The change is of the coordinate of the largest range among those that do more than scatter
    (`_scatters`). The second part is empty where all do.
    """
    here = x[rows] - np.mean(x[rows], axis=0)
    ranges = np.where(_scatters(here), 0.0, np.ptp(here, axis=0))
    before = np.arange(1.0, rows.size)
    sums = np.cumsum(here[:, np.argmax(ranges)])[:-1]
    first = 1 + np.argmax(sums**2 / (before * before[::-1])) if np.any(ranges) else rows.size
    return rows[:first], rows[first:]


def _extent(x: np.ndarray) -> float:
    """Range of the rows x [N, D] along the coordinate where it is largest."""
    return np.max(np.ptp(x, axis=0), initial=0.0)


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
    for begin in (0, value.size // 4):
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
