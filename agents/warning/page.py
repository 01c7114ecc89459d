"""Tables and figure of what `agents.warning` has found, drawn from the content of warning.json alone."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from soil_env._io.document import Table, renewed
from soil_env._io.files import replace_file, save_figure

from .study import FOREIGN, SCENARIOS

FIGURE = "warning.png"
_HORIZONS = ("3 s", "5 s")


class Shown(NamedTuple):
    """A figure in a table."""

    key: str
    heading: str
    factor: float = 1.0
    digits: int = 1


_AUC = Shown("auc", "AUC", digits=3)
_WARNED = Shown("warned", "warned [%]", 100.0)
_MEDIAN, _MEAN = Shown("time", "lead [s], median"), Shown("mean_time", "mean lead [s]")
_FALSE = (Shown("false", "false [% of time]", 100.0), Shown("false_courses", "false [% of courses]", 100.0, 0))
_WORTH = (_AUC, _WARNED, _MEDIAN, _MEAN, Shown("way", "lead [m], median", digits=2), *_FALSE)
_RIVALS = (
    _AUC,
    Shown("auc_after", "AUC, with the time after the stop", digits=3),
    _WARNED,
    _MEDIAN,
    _MEAN,
    Shown("strict", "before the last 0.1 m [s]"),
    Shown("declared", "before the end [s]"),
    *_FALSE,
    Shown("early", "early [% of time]", 100.0),
)
_KEPT = (_AUC, _WARNED, _MEDIAN, _MEAN)


def text(m: dict, factor: float = 1.0, digits: int = 2) -> str:
    """A figure with its 95 % interval, a dash where it is not defined."""
    if m["value"] is None:
        return "-"
    value, low, high = (f"{factor * m[k]:.{digits}f}" if m[k] is not None else "-" for k in ("value", "low", "high"))
    return f"{value} [{low}, {high}]"


def _cells(m: dict, shown: Iterable[Shown]) -> list[str]:
    return [text(m[s.key], s.factor, s.digits) for s in shown]


def _headings(shown: Iterable[Shown], prefix: str = "") -> list[str]:
    return [prefix + s.heading for s in shown]


def _named(name: str) -> str:
    return f"`{name}`"


def _calibrated(c: dict) -> list[str]:
    return [*(f"{100.0 * c[key]:.1f}" for key in ("mean", "observed", "error")), f"{c['skill']:.2f}"]


def tables(found: dict) -> dict[str, str]:
    """{marker in the page: Markdown}."""
    worth, place = _headings(_WORTH), ["scenario", "driver"]
    places = {part: [[_named(c["scenario"]), _named(c["driver"])] for c in found[part]] for part in ("cells", "own")}
    cells = [
        [*at, c["immobilised"]["value"], *_cells(c, _WORTH)]
        for at, c in zip(places["cells"], found["cells"], strict=True)
    ]
    scenarios = [[_named(s), m["immobilised"]["value"], *_cells(m, _WORTH)] for s, m in found["by_scenario"].items()]
    own = [[*at, *_cells(c, _WORTH)] for at, c in zip(places["own"], found["own"], strict=True)]
    rivals = [[name, *_cells(m, _RIVALS)] for name, m in (found["rivals"] | found["others"]).items()]
    kept = [
        [_named(key), *_cells(both["with"], _KEPT), *_cells(both["without"], _KEPT)]
        for key, both in found["kept_from"].items()
    ]
    groups = list(next(iter(found["limits"].values())))
    limits = [
        [name, *("; ".join(_cells(by[g], (_AUC, _MEDIAN))) for g in groups)] for name, by in found["limits"].items()
    ]
    calibration = [
        [name, *(cell for h in _HORIZONS for cell in _calibrated(by[h]))] for name, by in found["calibration"].items()
    ]
    heads = [f"{what}, {h}" for h in _HORIZONS for what in ("mean [%]", "observed [%]", "error [points]", "skill")]
    return {
        "cells": Table([*place, "immobilised", *worth], cells).markdown(),
        "scenarios": Table(["scenario", "immobilised", *worth], scenarios).markdown(),
        "own": Table([*place, *worth], own).markdown(),
        "rivals": Table(["score", *_headings(_RIVALS)], rivals).markdown(),
        "kept": Table(["kept from", *_headings(_KEPT, "seen: "), *_headings(_KEPT, "kept from it: ")], kept).markdown(),
        "limits": Table(["network that knows", *map(_named, groups)], limits).markdown(),
        "calibration": Table(["courses", *heads], calibration).markdown(),
        "facts": facts(found),
    }


def facts(found: dict) -> str:
    """What the text of the page says in numbers."""
    sizes, leak = found["sizes"], found["leakage"]
    return (
        f"- Training: {found['courses_of_training']:,} courses of set {found['sets']['training']} "
        f"({', '.join(map(_named, found['scenarios']))}; {len(found['families'])} families of drivers), "
        f"{found['rows_of_training']:,} control periods of them, {sizes['epochs']} epochs. Threshold of the alarm: "
        f"{found['alarm']:.3f}, set on {sizes['tuning']} courses of set {found['sets']['tuning']} with each driver. "
        f"Tests: {sizes['test']} courses of set {found['sets']['test']} with each"
        + "".join(f", {sizes['models']} on `{s}` with the agent" for s in found["models"])
        + ".\n"
        f"- AUC on {', '.join(f'{name}: {text(m, 1.0, 3)}' for name, m in leak.items())} (`mixed`).\n"
        f"- Another patch than the one it stopped on was under {100 * found['other_ground']:.0f} % of the immobilised "
        "wheels 2.9 s before."
    )


def figure(found: dict) -> Figure:
    """Reliability of both probabilities, on the scenarios of the training and on the foreign one."""
    out = Figure(figsize=(9, 4), layout="constrained")
    groups = {"all scenarios of the training": "#0072b2", FOREIGN[0]: "#d55e00", SCENARIOS[-1]: "#009e73"}
    for i, horizon in enumerate(_HORIZONS):
        axis = out.add_subplot(1, 2, i + 1)
        axis.plot([0, 1], [0, 1], color="0.7", lw=1)
        for group, colour in groups.items():
            bins = found["calibration"][group][horizon]["bins"]
            x, y, low, high = (np.array([b[k] for b in bins], dtype=float) for k in ("mean", "observed", "low", "high"))
            bars = np.maximum([y - low, high - y], 0.0)
            axis.errorbar(x, y, yerr=bars, fmt="o-", ms=3, lw=1, capsize=2, color=colour, label=group)
        axis.set(xlabel=f"probability within {horizon}", ylabel="share that stopped", xlim=(0, 1), ylim=(0, 1))
        axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    return out


def check(page: Path) -> None:
    """Before the work: ParameterError or OSError if the page could not be renewed."""
    names = ("scenarios", "cells", "own", "rivals", "kept", "limits", "calibration", "facts")
    renewed(page.read_text(encoding="utf-8"), dict.fromkeys(names, ""), page)


def write(found: dict, out: Path, page: Path | None) -> None:
    """Write the figure into `out`, and the tables between the markers of `page`."""
    save_figure(figure(found), out / FIGURE, dpi=110)
    if page is not None:
        replace_file(page, renewed(page.read_text(encoding="utf-8"), tables(found), page))
