"""The plots of a report, as SVG; the same report gives the same bytes."""

from __future__ import annotations

import io
import math
import re

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from soil_env.discrepancy.data import CHANNELS, WHEEL
from soil_env.discrepancy.report.words import TITLES, UNITS, fixed, title
from soil_env.discrepancy.result import Report
from soil_env.terramechanics.effects import CATALOGUE

BEFORE, AFTER, MEASURED = "#c2571a", "#1f6f8b", "#222222"
LIGHT = "#7fb2c2"
MANY = 1200  # points of a plot above which they are drawn as an image
CURVES = 4  # groups of rows whose curves over slip are drawn
CAPTIONS = {
    "predicted": "Held-out predictions against the measured values; grey: twice the noise.",
    "slip": "Measured values and models over slip, in a few groups of rows that differ in slip alone, from where "
    "the base model does best (top) to where it does worst. A red cross was left out as an outlier.",
    "residual": "Held-out residuals over slip in standard deviations of the noise; grey: twice the noise.",
    "ranking": "Probability of each effect, and that nothing listed is missing. Dark: stated; light: alternatives.",
    "shares": "The gap: mean square of the held-out error above the noise that the base model leaves, as what each "
    "stated effect, or the law, closes and what remains.",
}
_STYLE = {"font.size": 9, "axes.titlesize": 10, "axes.spines.top": False, "axes.spines.right": False,
          "axes.edgecolor": "#888888", "axes.linewidth": 0.7, "svg.hashsalt": "soil_env"}  # fmt: skip


def pictures(report: Report, form: str = "svg") -> dict[str, bytes]:
    """{name: picture} of "shares", "predicted", "slip", "residual" and "ranking"; `form` is "svg" or "png"."""
    with matplotlib.rc_context(_STYLE):
        drawn = {"shares": _shares, "predicted": _predicted, "slip": _slip, "residual": _residual, "ranking": _ranking}
        return {name: _saved(draw(report), form) for name, draw in drawn.items()}


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _saved(figure: Figure, form: str) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format=form, dpi=130, metadata={"Date": None} if form == "svg" else None)
    if form != "svg":
        return stream.getvalue()
    text = stream.getvalue().decode("utf-8")
    return re.sub(r"<!DOCTYPE.*?>|<metadata>.*?</metadata>", "", text, flags=re.S).encode("utf-8")


def _columns(report: Report, height: float, rows: int = 1, **options) -> tuple[Figure, np.ndarray]:
    """(figure, axes [rows, channels])."""
    figure = _figure(3.5 * max(len(report.channels), 2), height)
    return figure, figure.subplots(rows, len(report.channels), squeeze=False, **options)


def _predicted(report: Report) -> Figure:
    """Held-out predictions of both models against what was measured."""
    figure, axes = _columns(report, 3.6)
    for name, ax in zip(report.channels, axes[0], strict=True):
        j, (unit, scale) = CHANNELS.index(name), UNITS[name]
        y = scale * report.problem.data.y[:, j]
        image = y.size > MANY
        for held, color, label in _both(report, report.held_before, report.held_after):
            ax.plot(y, scale * held[:, j], "o", ms=3.2, color=color, alpha=0.7, label=label, mew=0, rasterized=image)
        used = y[report.problem.used[:, j]]
        ends = np.array([used.min(), used.max()])
        ax.plot(ends, ends, color=MEASURED, lw=0.8, zorder=0)
        noise = 2.0 * scale * report.problem.noise[j]
        ax.fill_between(ends, ends - noise, ends + noise, color="0.9", lw=0, zorder=-1)
        ax.set(title=TITLES[name], xlabel=f"measured [{unit}]", ylabel=f"predicted [{unit}]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def _both(report: Report, before, after):
    """What is drawn for each model; only the base model where nothing was added."""
    yield before, BEFORE, "base model" if report.corrected else "calibrated model"
    if report.corrected:
        yield after, AFTER, "corrected model"


def groups(report: Report) -> list[tuple[str, np.ndarray]]:
    """At most `CURVES` groups of rows that differ in slip alone, (what they share, rows sorted by slip).

    Of all groups with three slips or more, evenly from the one that the base model misses least to the one that it
    misses most.
    """
    data, varied = report.problem.data, report.problem.data.varied
    others = [c for name, c in varied.items() if name != "slip"]
    label = np.zeros(data.rows.slip.size, dtype=int)
    if others:
        label = np.unique(np.stack([c.level for c in others]), axis=1, return_inverse=True)[1].ravel()
    found = []
    for k in range(int(label.max()) + 1):
        rows = np.flatnonzero(label == k)
        if np.unique(varied["slip"].level[rows]).size >= min(3, varied["slip"].levels):
            off = (data.y - report.held_before)[rows] / report.problem.noise
            found.append((float(np.nanmean(off**2)) if np.isfinite(off).any() else 0.0, k, rows))
    found.sort(key=lambda f: f[:2])
    picked = [found[k] for k in sorted({round(x) for x in np.linspace(0, len(found) - 1, CURVES)})] if found else []
    out = []
    for _, _, rows in picked:
        parts = [_value(c.name, float(np.median(c.value[rows]))) for c in others]
        out.append((", ".join(parts), rows[np.argsort(data.rows.slip[rows], kind="stable")]))
    return out


def _value(name: str, x: float) -> str:
    unit = {"load": " N", "speed": " m/s", "grade_deg": " deg grade", "wheel_radius": " m radius",
            "wheel_width": " m width", "grouser_height": " m grousers"}  # fmt: skip
    return f"pass {x:.0f}" if name == "pass" else f"{round(x, 1) if name == 'grade_deg' else x:.3g}{unit[name]}"


def _slip(report: Report) -> Figure:
    """Measured against both models over slip, in a few groups of rows."""
    picked = groups(report)
    figure, axes = _columns(report, 1.0 + 2.1 * max(len(picked), 1), max(len(picked), 1), sharex=True)
    data = report.problem.data
    for axis, name in zip(axes[0], report.channels, strict=True):
        axis.set_title(f"{TITLES[name]} [{UNITS[name][0]}]")
    for axis in axes[-1]:
        axis.set_xlabel("slip")
    tilt = report.soil["tilt_deg"].value if "tilt_deg" in report.soil else 0.0  # of the rig; a model has none
    for (label, rows), line in zip(picked, axes, strict=False):
        slip = np.linspace(data.rows.slip[rows].min(), data.rows.slip[rows].max(), 60)
        middle = data.rows.wheels[rows[len(rows) // 2]]
        at = {name: float(np.median(column[rows])) for name, column in data.conditions.items()}
        at |= {
            "slip": slip,
            "load": data.rows.load[rows].mean(),
            "grade_deg": data.conditions["grade_deg"][rows].mean(),
        }
        at |= dict(zip(("wheel_radius", "wheel_width", "grouser_height"), middle, strict=True))
        if data.setup.load == "vertical":
            at["grade_deg"] += tilt
        along = np.array([0.0, at["load"] * math.sin(math.radians(tilt)) * (data.setup.load == "normal"), 0.0])
        curves = _both(report, report.base_model.predict(at), report.model.predict(at))
        lines = [(np.stack(p[:3], axis=1) - along, color, text) for p, color, text in curves]
        for name, ax in zip(report.channels, line, strict=True):
            j, scale = CHANNELS.index(name), UNITS[name][1]
            used = report.problem.used[rows, j]
            for p, color, text in lines:
                ax.plot(slip, scale * p[:, j], color=color, lw=1.4, label=text)
            ax.errorbar(data.rows.slip[rows], scale * data.y[rows, j], 2.0 * scale * report.problem.noise[j], fmt="o",
                        ms=3, lw=0.8, color=MEASURED, label="measured, 2 sd of noise")  # fmt: skip
            ax.plot(data.rows.slip[rows][~used], scale * data.y[rows, j][~used], "x", color="red", ms=6)
        if label:
            line[0].set_ylabel(label.replace(", ", "\n"), rotation=0, ha="right", va="center", fontsize=8)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    return figure


def _residual(report: Report) -> Figure:
    """Held-out residuals over slip in standard deviations of the noise, before and after."""
    both = list(_both(report, report.held_before, report.held_after))
    figure, axes = _columns(report, 0.8 + 2.0 * len(both), len(both), sharex=True, sharey="col")
    data = report.problem.data
    about = [CATALOGUE[e.name].varies for e in report.effects]
    by = next((n for n in (*about, "load", "speed", "pass", "grade_deg", *WHEEL) if n in data.varied), None)
    shade = data.varied[by].scaled if by else np.zeros(data.rows.slip.size)
    drawn = None
    for axis, name in zip(axes[0], report.channels, strict=True):
        axis.set_title(TITLES[name])
    for axis in axes[-1]:
        axis.set_xlabel("slip")
    for (held, _, label), line in zip(both, axes, strict=True):
        for name, ax in zip(report.channels, line, strict=True):
            j = CHANNELS.index(name)
            off = (data.y - held)[:, j] / report.problem.noise[j]
            ax.axhspan(-2.0, 2.0, color="0.92", zorder=-1, lw=0)
            ax.axhline(0.0, color="0.6", lw=0.7, zorder=0)
            drawn = ax.scatter(data.rows.slip, off, c=shade, cmap="viridis", s=11, lw=0, rasterized=off.size > MANY,
                               vmin=-1.2, vmax=1.2)  # fmt: skip
        line[0].set_ylabel(f"{label}\nresidual/noise")
    if by:
        value = data.varied[by].value
        bar = figure.colorbar(drawn, ax=axes, shrink=0.6, ticks=[-1.0, 1.0])
        bar.ax.set_yticklabels([_value(by, float(value[np.argmin(shade)])), _value(by, float(value[np.argmax(shade)]))])
        bar.outline.set_visible(False)
    return figure


def _ranking(report: Report) -> Figure:
    """Probability of each effect, and of nothing and something unlisted."""
    finding, named = report.finding, {e.name for e in report.effects}
    near = {a for e in report.effects for a in e.alternatives}
    bars = [(title(r.name), r.probability, AFTER if r.name in named else LIGHT if r.name in near else "0.75")
            for r in report.ranking]  # fmt: skip
    bars += [("something unlisted as well", finding.remainder - finding.unlisted, "0.75"),
             ("something unlisted alone", finding.unlisted, BEFORE), ("nothing", finding.none, "0.5")]  # fmt: skip
    figure = _figure(7.0, 0.9 + 0.24 * len(bars))
    ax = figure.subplots()
    labels, shares, colors = zip(*bars[::-1], strict=True)
    ax.barh(labels, shares, color=colors, height=0.7)
    for k, share in enumerate(shares):
        ax.text(share, k, f" {fixed(share, 3)}", va="center", fontsize=8)
    ax.set(xlabel="probability", xlim=(0.0, 1.12))
    return figure


def _shares(report: Report) -> Figure:
    """The gap of each channel in its parts, over the noise."""
    figure = _figure(7.0, 0.9 + 0.42 * len(report.channels))
    ax = figure.subplots()
    closed = [max(e.share or 0.0, 0.0) for e in report.effects]
    parts = [(title(e.name), c) for e, c in zip(report.effects, closed, strict=True)]
    if report.model.residual:
        parts.append(("a law without a name", 1.0))
    weight = sum(c for _, c in parts) or 1.0
    for k, (name, g) in enumerate(list(report.gap.items())[::-1]):
        left = min(
            report.remainder[name].rms ** 2 / g.noise_floor**2, whole := max(g.before**2 / g.noise_floor**2 - 1.0, 0.0)
        )
        at = 0.0
        for n, (label, c) in enumerate(parts):
            size = (whole - left) * c / weight
            ax.barh(
                k, size, left=at, color=(AFTER, LIGHT, "#b7cfd8")[n % 3], height=0.6, label=label if k == 0 else None
            )
            at += size
        ax.barh(k, left if parts else whole, left=at, color="0.8", height=0.6, label="remains" if k == 0 else None)
    ax.set_yticks(range(len(report.gap)), [TITLES[name] for name in list(report.gap)[::-1]])
    ax.set_xlabel("mean square above the noise, in noise variances (held out)")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return figure
