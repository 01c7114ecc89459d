"""Plots of docs/discrepancy.md: success against effect size, what is named instead of what, the gap."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

from benchmarks.blind.easy.forms import EFFECTS  # noqa: E402
from benchmarks.blind.easy.judge import gap_of  # noqa: E402
from soil_env._io.files import save_figure

CURVES = (
    ("right", "right name first", "#1b7837", "o"),
    ("included", "right or among the alternatives", "#7fbf7b", "s"),
    ("none", "says that nothing is missing", "#888888", "D"),
    ("wrong", "a wrong name without doubt", "#b2182b", "^"),
)


def curve(bins: dict[str, list[dict]], path: Path) -> None:
    """Shares with intervals over the effect size, and over how well the effect can be told from its best rival."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.2), sharey=True)
    labels = {
        "size": "effect size [detection limits]",
        "told": "distance from the best rival [detection limits], effects at 2 to 8",
    }
    for axis, (key, label) in zip(axes, labels.items(), strict=True):
        for k, (what, words, colour, marker) in enumerate(CURVES):
            x = np.array([b["middle"] for b in bins[key]]) * 1.02 ** (k - 1.5)
            value, low, high = (np.array([b[what][n] for b in bins[key]]) for n in ("value", "low", "high"))
            errors = np.abs([value - low, high - value])
            axis.errorbar(x, value, errors, color=colour, marker=marker, ms=5, lw=1.5, elinewidth=0.8, label=words)
        if key == "told" and bins[key]:
            x, ideal = zip(*((b["middle"], b["ideal"]) for b in bins[key]), strict=True)
            axis.plot(x, ideal, color="#333333", ls=":", label="best possible against the best rival")
        _logarithmic(axis, (0.1, 0.25, 0.5, 1, 2, 4, 8, 16))
        axis.set_xlabel(label)
        axis.grid(alpha=0.3)
        axis.axvline(1.0, color="#888888", lw=1)
        axis.set_ylim(-0.03, 1.03)
    axes[0].set_ylabel("share of cases")
    figure.legend(*axes[1].get_legend_handles_labels(), loc="lower center", ncols=3, fontsize=8)
    figure.subplots_adjust(bottom=0.3)
    _save(figure, path)


def confusion(cases: list[dict], path: Path) -> None:
    """Counts: hidden effect against what is named."""
    rows, columns = list(EFFECTS), [*EFFECTS, "two effects", "none", "unlisted", "error"]
    counts = np.zeros((len(rows), len(columns)), int)
    for r in cases:
        names = [e["name"] for e in r["named"]]
        said = names[0] if len(names) == 1 else "two effects" if names else r["verdict"]
        counts[rows.index(r["truth"][0]["name"]), columns.index(said)] += 1
    if not counts[:, -1].any():
        columns, counts = columns[:-1], counts[:, :-1]
    figure, axis = plt.subplots(figsize=(9.5, 7))
    axis.imshow(counts / np.maximum(counts.sum(axis=1, keepdims=True), 1), cmap="Greens", vmin=0, vmax=1.3)
    for i, j in zip(*np.nonzero(counts), strict=True):
        axis.text(j, i, counts[i, j], ha="center", va="center", color="black" if i == j else "#b2182b")
    axis.set_xticks(range(len(columns)), [c.replace("_", " ") for c in columns], rotation=60, ha="right")
    axis.set_yticks(range(len(rows)), [r.replace("_", " ") for r in rows])
    axis.set_xlabel("named first")
    axis.set_ylabel("hidden")
    _save(figure, path)


def gap(cases: list[dict], path: Path) -> None:
    """Held-out RMSE over the noise before and after, of the cases with a named effect."""
    pairs = [(gap_of(r, "before"), gap_of(r, "after")) for r in cases if r["verdict"] == "named"]
    pairs = np.array([p for p in pairs if None not in p]).reshape(-1, 2)
    figure, axis = plt.subplots(figsize=(6, 4.2))
    if pairs.size:
        edges = np.geomspace(min(0.7, pairs.min()), pairs.max() * 1.01, 40)
        axis.hist(pairs[:, 0], edges, color="#b2182b", alpha=0.6, label="base model")
        axis.hist(pairs[:, 1], edges, color="#1b7837", alpha=0.6, label="with the named effect")
        axis.legend()
    axis.axvline(1.0, color="#888888", lw=1)
    _logarithmic(axis, (1, 1.5, 2, 3, 5, 10, 20, 50))
    axis.set_xlabel("held-out RMSE / noise")
    axis.set_ylabel("cases")
    axis.grid(alpha=0.3)
    _save(figure, path)


def _logarithmic(axis, ticks: tuple[float, ...]) -> None:
    """Logarithmic abscissa with plain numbers at those ticks that are in view."""
    axis.set_xscale("log")
    low, high = axis.get_xlim()
    shown = [t for t in ticks if low <= t <= high]
    axis.set_xticks(shown, [f"{t:g}" for t in shown])
    axis.minorticks_off()
    axis.set_xlim(low, high)


def _save(figure, path: Path) -> None:
    save_figure(figure, path, dpi=110, bbox_inches="tight")
    plt.close(figure)
