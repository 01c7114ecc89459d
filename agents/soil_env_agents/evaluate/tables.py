"""Metrics with their 95 % intervals as cells, tables and points in a figure."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from soil_env._io.document import Table, plot_text
from soil_env._io.files import picture_of

from .driving import MEANINGS, RATES


class Column(NamedTuple):
    """A metric in a table of controllers."""

    metric: str
    heading: str
    factor: float = 1.0  # from the unit of the metric to that of the heading
    digits: int = 2  # behind the point
    bounds: bool = True  # the value with its interval, else alone


#: Columns of the printed table of wheels, and of rovers.
COLUMNS = (
    Column("immobilised", "immobilised [%]", 100.0, 1),
    Column("finished", "finished [%]", 100.0, 1),
    Column("time_limit", "late", 100.0, 1, bounds=False),
    Column("time", "time", digits=0, bounds=False),
    Column("energy_per_metre", "J/m", digits=0, bounds=False),
    Column("slip", "slip", bounds=False),
    Column("return", "return", bounds=False),
)
OF_ROVERS = (
    *(c for c in COLUMNS if c.metric not in ("time_limit", "slip")),
    Column("fighting", "fighting", bounds=False),
    Column("wheel_force", "force", digits=1, bounds=False),
)


def cell(
    m: Mapping, factor: float = 1.0, digits: int = 2, sign: bool = False, bounds: bool = True
) -> str:
    """'12.3 [10.0, 14.1]' of {"value", "low", "high"}, or a dash where the value is None.

    All three are multiplied by `factor` and have `digits` behind the point, a + with `sign`.
    Without `bounds` it is the value alone.
    """
    if m["value"] is None:
        return "-"
    value, low, high = (
        f"{factor * m[key]:{'+' if sign else ''}.{digits}f}" for key in ("value", "low", "high")
    )
    return f"{value} [{low}, {high}]" if bounds else value


def points(m: Mapping) -> str:
    """A difference of rates, {"value", "low", "high"} as shares, as text in percentage points with
    its sign.
    """
    return cell(m, 100.0, 1, sign=True)


def difference(metric: str, m: Mapping) -> str:
    """A difference {"value", "low", "high"} of a metric as text with its sign, in percentage points
    where the metric is a rate.
    """
    return points(m) if metric in RATES else cell(m, sign=True)


def metric_table(entries: Mapping[str, Mapping], columns: Sequence[Column], caption: str) -> Table:
    """A table of the metrics of `columns`, with a row for each controller.

    `entries`: {controller: {metric: {"value", "low", "high"}}}.
    """
    rows = [
        [name, *(cell(metrics[c.metric], c.factor, c.digits, bounds=c.bounds) for c in columns)]
        for name, metrics in entries.items()
    ]
    return Table(["controller", *(c.heading for c in columns)], rows, caption)


def bracketed(unit: str) -> str:
    """' [m]' for a heading; nothing where the unit is '-', of a number without one."""
    return "" if unit == "-" else f" [{unit}]"


def heading(metric: str) -> str:
    """Name of a metric with its unit; that of a rate is %."""
    unit = "%" if metric in RATES else MEANINGS[metric][0]
    return f"{metric.replace('_', ' ')}{bracketed(unit)}"


def legend(columns: Iterable[Column]) -> str:
    """One line with the meaning of the columns."""
    entries = []
    for c in columns:
        unit, meaning = MEANINGS[c.metric]
        unit = "%" if c.factor == 100.0 else unit
        entries.append(f"{c.heading}: {meaning}" + ("" if unit in c.heading else bracketed(unit)))
    return f"Columns: {'; '.join(entries)}"


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """A table as CSV; the first row is its heading."""
    text = io.StringIO(newline="")
    csv.writer(text).writerows(rows)
    return text.getvalue()


def draw_metrics(rows: Mapping[str, Mapping[str, Mapping]], metrics: Sequence[str]) -> bytes:
    """PNG of {group: {controller: {metric: {"value", "low", "high"}}}}: a row of panels for each
    group, a column for each metric, rates in %.

    A panel has a point with its interval for each controller, the first on top. Metrics that are
    not defined have none.
    """
    most = max(map(len, rows.values()))
    figure = Figure(
        figsize=(2.4 * len(metrics), len(rows) * (0.35 * most + 1.0) + 0.4), layout="constrained"
    )
    axes = figure.subplots(len(rows), len(metrics), squeeze=False, sharey="row")
    for line, (group, entries) in zip(axes, rows.items(), strict=True):
        names = list(entries)[::-1]
        for axis, metric in zip(line, metrics, strict=True):
            factor = 100.0 if metric in RATES else 1.0
            for y, name in enumerate(names):
                if (m := entries[name][metric])["value"] is not None:
                    value, low, high = (factor * m[key] for key in ("value", "low", "high"))
                    bars = [[value - low], [high - value]]
                    axis.errorbar(value, y, xerr=bars, fmt="o", ms=4, color="#0072b2", capsize=2)
            axis.set_ylim(-0.6, len(names) - 0.4)
            axis.xaxis.set_major_locator(MaxNLocator(3))
            axis.grid(alpha=0.3)
            axis.set_xlabel(heading(metric))
        line[0].set_yticks(range(len(names)), [plot_text(name) for name in names])
        line[0].set_title(plot_text(group), loc="left", fontsize=9)
    # The same bytes for the same figure.
    return picture_of(figure, dpi=110, metadata={"Software": None})
