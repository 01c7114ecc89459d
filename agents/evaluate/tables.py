"""Metrics with their 95 % intervals as cells, tables and points in a figure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from soil_env._io.document import Table


class Column(NamedTuple):
    """A metric in a table of controllers."""

    metric: str
    heading: str
    factor: float = 1.0
    digits: int = 2
    bounds: bool = True  # whether the interval is shown


def cell(m: Mapping, factor: float = 1.0, digits: int = 2, sign: bool = False, bounds: bool = True) -> str:
    """'12.3 [10.0, 14.1]' of {"value", "low", "high"}, or a dash where the metric is not defined."""
    if m["value"] is None:
        return "-"
    value, low, high = (f"{factor * m[key]:{'+' if sign else ''}.{digits}f}" for key in ("value", "low", "high"))
    return f"{value} [{low}, {high}]" if bounds else value


def percent(m: Mapping) -> str:
    """A rate in percent."""
    return cell(m, 100.0, 1).replace(" [", " % [")


def points(m: Mapping) -> str:
    """A difference of rates in percentage points, with its sign."""
    return cell(m, 100.0, 1, sign=True)


def metric_table(entries: Mapping[str, Mapping], columns: Iterable[Column], caption: str = "") -> Table:
    """A row a controller, of {controller: {metric: {"value", "low", "high"}}}."""
    columns = list(columns)
    rows = [
        [name, *(cell(metrics[c.metric], c.factor, c.digits, bounds=c.bounds) for c in columns)]
        for name, metrics in entries.items()
    ]
    return Table(["controller", *(c.heading for c in columns)], rows, caption)


def legend(columns: Iterable[Column], metrics: Mapping[str, tuple[str, str]]) -> str:
    """One line that says what the columns are, of {metric: (unit, meaning)}."""
    entries = []
    for c in columns:
        unit, meaning = metrics[c.metric]
        entries.append(f"{c.heading}: {f'{unit}, ' if unit.startswith('share') else ''}{meaning}")
    return f"Columns: {'; '.join(entries)}"


def labels(controllers: Mapping[str, Mapping]) -> dict[str, str]:
    """{controller: its name with the number of training seeds, where there are several}."""
    return {n: f"{n} ({e['members']} seeds)" if e["members"] > 1 else n for n, e in controllers.items()}


def draw_intervals(
    axis: Axes,
    values: Iterable[Mapping],
    factor: float = 1.0,
    colours: Iterable[str] | str = "#0072b2",
    shift: float = 0.0,
) -> None:
    """Values with their intervals, one above the other from the bottom; those not defined are left out."""
    values = list(values)
    colours = [colours] * len(values) if isinstance(colours, str) else colours
    for y, (m, colour) in enumerate(zip(values, colours, strict=True)):
        if m["value"] is not None:
            value, low, high = (factor * m[key] for key in ("value", "low", "high"))
            bars = [[value - low], [high - value]]
            axis.errorbar(value, y + shift, xerr=bars, fmt="o", ms=4, color=colour, capsize=2)
    axis.set_ylim(-0.6, len(values) - 0.4)
    axis.xaxis.set_major_locator(MaxNLocator(3))
    axis.grid(alpha=0.3)
