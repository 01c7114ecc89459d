"""Figures of an evaluation, drawn from the content of evaluation.json alone."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .records import METRICS, RATES
from .tables import draw_intervals

_PANELS = ("immobilised", "finished", "speed", "energy_per_metre", "tractive_efficiency", "return")
_CAUSES = {"entrapped": "#d55e00", "stalled": "#e69f00", "bogged": "#7b3f00", "time_limit": "#999999",
           "finished": "#009e73"}  # fmt: skip
_LINES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999999")


def metrics(result: dict) -> Figure:
    """Six metrics of all controllers as points with their 95 % intervals."""
    names = list(result["controllers"])[::-1]
    figure = Figure(figsize=(2.3 * len(_PANELS), 0.4 * len(names) + 1.2), layout="constrained")
    for k, metric in enumerate(_PANELS):
        axis = figure.add_subplot(1, len(_PANELS), k + 1)
        rate = metric in RATES
        draw_intervals(axis, [result["controllers"][n]["metrics"][metric] for n in names], 100.0 if rate else 1.0)
        axis.set_yticks(range(len(names)), names if k == 0 else [""] * len(names))
        axis.set_xlabel(f"{metric.replace('_', ' ')} [{'%' if rate else METRICS[metric][0]}]")
    return figure


def causes(result: dict) -> Figure:
    """How the courses ended, stacked to 100 %."""
    names = list(result["controllers"])[::-1]
    figure = Figure(figsize=(9, 0.4 * len(names) + 1.3), layout="constrained")
    axis = figure.add_subplot()
    left = np.zeros(len(names))
    for cause, colour in _CAUSES.items():
        share = np.array([100.0 * result["controllers"][n]["metrics"][cause]["value"] for n in names])
        axis.barh(range(len(names)), share, left=left, color=colour, label=cause.replace("_", " "), height=0.7)
        left += share
    axis.set_yticks(range(len(names)), names)
    axis.set_xlabel("courses [%]")
    axis.set_xlim(0, 100)
    axis.legend(ncols=len(_CAUSES), loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False, fontsize=8)
    return figure


def profiles(result: dict) -> Figure:
    """Performance profiles: share of runs above a score, with 95 % bands."""
    scores = list(next(iter(result["controllers"].values()))["profile"])
    figure = Figure(figsize=(6 * len(scores), 4), layout="constrained")
    for k, score in enumerate(scores):
        axis = figure.add_subplot(1, len(scores), k + 1)
        draw_profiles(axis, {name: entry["profile"][score] for name, entry in result["controllers"].items()})
        axis.set_xlabel(f"{score} [{METRICS[score][0]}]")
        axis.set_ylabel("share of runs above")
    axis.legend(fontsize=8)
    return figure


def draw_profiles(axis: Axes, profiles: dict[str, dict]) -> None:
    """Performance profiles {controller: {"threshold", "share", "low", "high"}} with their bands."""
    for i, (name, p) in enumerate(profiles.items()):
        line = {"color": _LINES[i % len(_LINES)], "ls": "-" if i < len(_LINES) else "--"}
        axis.plot(p["threshold"], p["share"], lw=1.4, label=name, **line)
        axis.fill_between(p["threshold"], p["low"], p["high"], color=line["color"], alpha=0.15, lw=0)
    axis.set_ylim(0, 1)
    axis.grid(alpha=0.3)


def improvement(result: dict) -> Figure:
    """Probability that the row's controller has the higher return on a course than the column's."""
    names = list(result["controllers"])
    n = len(names)
    figure = Figure(figsize=(0.95 * n + 2.5, 0.6 * n + 2), layout="constrained")
    axis = figure.add_subplot()
    grid = np.full((n, n), np.nan)
    for i, a in enumerate(names):
        for j, b in enumerate(names):
            if a != b:
                m = result["improvement"][a][b]
                grid[i, j] = m["value"]
                text = f"{m['value']:.2f}\n[{m['low']:.2f}, {m['high']:.2f}]"
                axis.text(j, i, text, ha="center", va="center", fontsize=7)
    axis.imshow(grid, cmap="RdBu", vmin=0.0, vmax=1.0, alpha=0.6, aspect="auto")
    axis.set_xticks(range(n), names, rotation=30, ha="right", fontsize=8)
    axis.set_yticks(range(n), names, fontsize=8)
    axis.set_title("P(row better than column)", fontsize=10)
    return figure


#: File -> (caption, drawing).
FIGURES = {
    "metrics.png": ("Means over courses and training seeds; bars: 95 % intervals.", metrics),
    "causes.png": ("How the courses ended. Entrapped, stalled and bogged are immobilised.", causes),
    "profiles.png": ("Performance profiles: share of runs (training seed x course) above a score.", profiles),
    "improvement.png": (
        "Probability that the row's controller has the higher return on a random course, ties half; 95 % intervals.",
        improvement,
    ),
}


def png(figure: Figure) -> bytes:
    """The figure as a PNG, the same bytes for the same figure."""
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110, metadata={"Software": None})
    return out.getvalue()
