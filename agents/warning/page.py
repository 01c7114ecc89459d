"""Tables and figure of what `agents.warning` has found, drawn from the content of warning.json alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from soil_env._io.document import Table, renewed
from soil_env._io.files import replace_file, save_figure

from .study import FOREIGN, SCENARIOS

FIGURE = "warning.png"
_HORIZONS = ("3 s", "5 s")
_WORTH = ("AUC", "warned [%]", "lead [s], median", "mean", "lead [m], median", "false [% of time]", "false [% of courses]")


def text(m: dict, factor: float = 1.0, digits: int = 2) -> str:
    """A figure with its 95 % interval, a dash where it is not defined."""
    if m["value"] is None:
        return "-"
    value, low, high = (None if m[k] is None else f"{factor * m[k] + 0.0:.{digits}f}" for k in ("value", "low", "high"))
    return f"{value} [{low}, {high}]"


def _worth(m: dict) -> list[str]:
    return [
        text(m["auc"], 1.0, 3), text(m["warned"], 100.0, 1), text(m["time"], 1.0, 1), text(m["mean_time"], 1.0, 1),
        text(m["way"]), text(m["false"], 100.0, 1), text(m["false_courses"], 100.0, 0),
    ]  # fmt: skip


def _named(name: str) -> str:
    return f"`{name}`"


def tables(found: dict) -> dict[str, str]:
    """{marker in the page: Markdown}."""
    cells = [
        [_named(c["scenario"]), _named(c["driver"]), c["immobilised"]["value"], *_worth(c)] for c in found["cells"]
    ]
    own = [[_named(c["scenario"]), _named(c["driver"]), *_worth(c)] for c in found["own"]]
    rivals = [
        [name, text(m["auc"], 1.0, 3), text(m["auc_after"], 1.0, 3), text(m["warned"], 100.0, 1),
         text(m["time"], 1.0, 1), text(m["mean_time"], 1.0, 1), text(m["strict"], 1.0, 1), text(m["declared"], 1.0, 1),
         text(m["false"], 100.0, 1), text(m["false_courses"], 100.0, 0), text(m["early"], 100.0, 1)]
        for name, m in found["rivals"].items()
    ]  # fmt: skip
    kept = [
        [_named(key), *(cell for m in (both["with"], both["without"])
                        for cell in (text(m["auc"], 1.0, 3), text(m["warned"], 100.0, 1), text(m["mean_time"], 1.0, 1)))]
        for key, both in found["kept_from"].items()
    ]  # fmt: skip
    limits = [
        [name, *(f"{text(by[f]['auc'], 1.0, 3)}; {text(by[f]['time'], 1.0, 1)}" for f in by)]
        for name, by in found["limits"].items()
    ]
    calibrated = [
        [name, *(cell for h in _HORIZONS
                 for c in (by[h],) for cell in (f"{100 * c['mean']:.1f}", f"{100 * c['observed']:.1f}",
                                                f"{100 * c['error']:.1f}", f"{c['skill']:.2f}"))]
        for name, by in found["calibration"].items()
    ]  # fmt: skip
    heads = [f"{what}, {h}" for h in _HORIZONS for what in ("mean [%]", "observed [%]", "error [points]", "skill")]
    drivers = list(next(iter(found["limits"].values())))
    return {
        "cells": Table(["scenario", "driver", "immobilised", *_WORTH], cells).markdown(),
        "own": Table(["scenario", "driver", *_WORTH], own).markdown(),
        "rivals": Table(
            ["score", "AUC", "AUC, with the time after the stop", "warned [%]", "lead [s], median", "mean",
             "before the last 0.1 m", "before the end", "false [% of time]", "false [% of courses]", "early [% of time]"],
            rivals).markdown(),
        "kept": Table(
            ["kept from", "AUC, all seen", "warned [%]", "mean lead [s]", "AUC, not seen", "warned [%]", "mean lead [s]"],
            kept).markdown(),
        "limits": Table(["network that knows", *map(_named, drivers)], limits).markdown(),
        "calibration": Table(["courses", *heads], calibrated).markdown(),
        "facts": facts(found),
    }  # fmt: skip


def facts(found: dict) -> str:
    """What the text of the page says in numbers."""
    sizes, leak = found["sizes"], found["leakage"]
    return (
        f"- Training: {found['courses_of_training']:,} courses of set {found['sets']['training']} "
        f"({', '.join(map(_named, found['scenarios']))}; {len(found['families'])} families of drivers), "
        f"{found['rows_of_training']:,} control periods of them, {sizes['epochs']} epochs. Threshold of the alarm: "
        f"{found['alarm']:.3f}, set on {sizes['tuning']} courses of set {found['sets']['tuning']} with each driver. Tests: "
        f"{sizes['test']} courses of set {found['sets']['test']} with each.\n"
        f"- Area under the ROC curve on {', '.join(f'{name}: {text(m, 1.0, 3)}' for name, m in leak.items())} (`mixed`).\n"
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
    names = ("cells", "own", "rivals", "kept", "limits", "calibration", "facts")
    renewed(page.read_text(encoding="utf-8"), dict.fromkeys(names, ""), page)


def write(found: dict, out: Path, page: Path | None) -> None:
    """Write the figure into `out`, and the tables between the markers of `page`."""
    save_figure(figure(found), out / FIGURE, dpi=110)
    if page is not None:
        replace_file(page, renewed(page.read_text(encoding="utf-8"), tables(found), page))


