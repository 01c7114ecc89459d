"""Plots of a report, as SVG; the same report gives the same bytes."""

import io
import re

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from soil_env._io.document import plot_text
from soil_env.discovery.calibrate import Law
from soil_env.discovery.prediction import at_conditions
from soil_env.discovery.result import Report
from soil_env.identification.table.data import CHANNELS
from soil_env.terramechanics.effects.text import plain

from .sentences import CONDITIONS, TITLES, UNITS

BEFORE = "#c2571a"
AFTER = "#1f6f8b"
MEASURED = "#222222"
MANY = 1200  # points of a plot above which they are drawn as an image
CURVES = 4  # groups of rows whose curves over slip are drawn
FEWEST_SLIPS = 3  # least number of slips in such a group, or all slips of the table if it has less
POINTS = 60  # of a curve
WIDTH = 3.5  # [in] of a plot
HEIGHT = 2.1  # [in] of a row of plots over slip
BELOW = 1.0  # [in] height of the axis labels and the legend below these rows
CAPTIONS = {
    "predicted": "Held-out predictions against the measured values; grey: twice the noise.",
    "slip": (
        "Measured values and models over slip, in a few groups of rows that differ in slip alone, "
        "from where the base model does best (top) to where it does worst. A red cross was left "
        "out as an outlier."
    ),
}
_STYLE = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#888888",
    "axes.linewidth": 0.7,
    "svg.hashsalt": "soil_env",
}


def pictures(report: Report) -> dict[str, bytes]:
    """SVG by name of the plots "predicted" and "slip" (`CAPTIONS`)."""
    with matplotlib.rc_context(_STYLE):
        return {"predicted": _saved(_predicted(report)), "slip": _saved(_slip(report))}


def _saved(figure: Figure) -> bytes:
    """The figure as SVG without document type and metadata, such as the date."""
    # Drawn once: `savefig` draws a figure with a layout twice.
    stream = io.BytesIO()
    FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None})
    text = stream.getvalue().decode("utf-8")
    return re.sub(r"<!DOCTYPE.*?>|<metadata>.*?</metadata>", "", text, flags=re.S).encode("utf-8")


def _columns(report: Report, height: float, rows: int = 1, **options) -> tuple[Figure, np.ndarray]:
    """(figure, axes [rows, channels]) with a column for each measured channel; `height` of the
    figure in inches. A single column makes it as wide as two, for the legend. `options`: of
    `Figure.subplots`.
    """
    figure = Figure(figsize=(WIDTH * max(len(report.channels), 2), height), layout="constrained")
    return figure, figure.subplots(rows, len(report.channels), squeeze=False, **options)


def _with_legend(figure: Figure, axes: np.ndarray, columns: int) -> Figure:
    """The figure with the legend of its first axes below, if they have one."""
    handles, labels = axes[0, 0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
    return figure


def _predicted(report: Report) -> Figure:
    """Held-out predictions of the base model, and with the named effects if there are any, over
    what was measured; a column for each channel, in the units of `UNITS`.
    """
    figure, axes = _columns(report, height=3.6)
    models = [(report.held_out_before, BEFORE, "base model")]
    if report.effects:
        models.append((report.held_out_after, AFTER, "with the named effects"))
    for name, ax in zip(report.channels, axes[0], strict=True):
        j = CHANNELS.index(name)
        unit, scale = UNITS[name]
        y = scale * report.problem.data.y[:, j]
        for held, color, label in models:
            ax.plot(
                y,
                scale * held[:, j],
                "o",
                ms=3.2,
                color=color,
                alpha=0.7,
                label=label,
                mew=0,
                rasterized=y.size > MANY,
            )
        used = y[report.problem.used[:, j]]
        ends = np.array([used.min(), used.max()])
        ax.plot(ends, ends, color=MEASURED, lw=0.8, zorder=0)
        noise = 2.0 * scale * report.problem.noise[j]
        ax.fill_between(ends, ends - noise, ends + noise, color="0.9", lw=0, zorder=-1)
        ax.set(title=TITLES[name], xlabel=f"measured [{unit}]", ylabel=f"predicted [{unit}]")
    return _with_legend(figure, axes, 2)


def groups(report: Report) -> list[tuple[str, np.ndarray]]:
    """At most `CURVES` groups of rows that differ in slip alone: (what the rows share in words,
    their indices sorted by slip).

    Of all groups with `FEWEST_SLIPS`, they are picked evenly in the order of the base model's
    held-out error over the noise, from the least to the largest. The error of a group is that of
    its values in use, 0 without any.
    """
    data = report.problem.data
    varied = data.varied
    others = {name: c.value for name, c in varied.items() if name != "slip"}
    found = []  # (mean square error over the noise, rows)
    for rows in data.groups:
        if np.unique(varied["slip"].level[rows]).size >= min(FEWEST_SLIPS, varied["slip"].levels):
            off = (data.y - report.held_out_before)[rows] / report.problem.sd[rows]
            found.append((np.nanmean(off**2) if np.isfinite(off).any() else 0.0, rows))
    found.sort(key=lambda f: f[0])
    evenly = np.linspace(0, len(found) - 1, min(CURVES, len(found))).round().astype(int)
    out = []
    for _, rows in (found[k] for k in evenly):
        parts = [_value(name, np.median(value[rows])) for name, value in others.items()]
        out.append((", ".join(parts), rows[np.argsort(data.rows.slip[rows], kind="stable")]))
    return out


def _value(name: str, x: float) -> str:
    """A condition in words with its value, of `name` as the column of a table, and its unit."""
    label, unit = CONDITIONS[name]
    return f"{label} {plain(round(x, 1) if name == 'grade_deg' else x)}{unit}"


def curves(report: Report, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(slips [P], values [P, 3] of the base model, values [P, 3] of the corrected one) [m, N, N m],
    as the rig measures them.

    They are at P = `POINTS` slips over the range of a group of rows, and at the means of its other
    conditions.
    """
    data = report.problem.data
    at = {name: np.mean(column[rows]) for name, column in data.conditions.items()}
    at["slip"] = np.linspace(data.rows.slip[rows].min(), data.rows.slip[rows].max(), POINTS)
    base = Law(at_conditions(report.problem, at), ()).output(report.base.u)
    return at["slip"], base, report.outlook.model.mean_at(at)


def _slip(report: Report) -> Figure:
    """Measured values, base model and corrected model over slip: a row for each of the `groups`, a
    column for each channel; empty axes where there is no group.
    """
    picked = groups(report)
    count = max(len(picked), 1)
    figure, axes = _columns(report, BELOW + HEIGHT * count, count, sharex=True)
    data = report.problem.data
    for axis, name in zip(axes[0], report.channels, strict=True):
        axis.set_title(f"{TITLES[name]} [{UNITS[name][0]}]")
    for axis in axes[-1]:
        axis.set_xlabel("slip")
    for (label, rows), line in zip(picked, axes, strict=False):
        slip, base, corrected = curves(report, rows)
        lines = [(base, BEFORE, "base model"), (corrected, AFTER, "corrected model")]
        measured_slip = data.rows.slip[rows]
        for name, ax in zip(report.channels, line, strict=True):
            j = CHANNELS.index(name)
            scale = UNITS[name][1]
            used = report.problem.used[rows, j]
            measured = scale * data.y[rows, j]
            for p, color, text in lines:
                ax.plot(slip, scale * p[:, j], color=color, lw=1.4, label=text)
            ax.errorbar(
                measured_slip,
                measured,
                2.0 * scale * report.problem.sd[rows, j],
                fmt="o",
                ms=3,
                lw=0.8,
                color=MEASURED,
                label="measured, 2 sd of noise",
            )
            ax.plot(measured_slip[~used], measured[~used], "x", color="red", ms=6)
        if label:
            line[0].set_ylabel(
                plot_text(label.replace(", ", "\n")),
                rotation=0,
                ha="right",
                va="center",
                fontsize=8,
            )
    return _with_legend(figure, axes, 3)
