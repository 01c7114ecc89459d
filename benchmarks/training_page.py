"""The figure and the tables of docs/training.md from the content of training.json."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.common import machine_text, range_text
from soil_env._io.document import Table
from soil_env._io.files import save_figure

PARTS = ("env", "policy", "update")


def machine(result: dict) -> str:
    """The machine line."""
    return f"{machine_text(result['machine'], 'torch', also=', shared with other work')}."


def _runs(result: dict, part: str) -> dict[str, list[dict]]:
    """{layout: its runs} of one part."""
    out: dict[str, list[dict]] = {}
    for run in result["runs"]:
        if run["part"] == part:
            out.setdefault(run["layout"], []).append(run)
    return out


def _each(runs: list[dict], value, digits: int) -> str:
    """A value of every seed."""
    return ", ".join(f"{value(run):.{digits}f}" for run in runs)


def _layouts(result: dict, part: str) -> str:
    """Layouts of a part of the study: all in the short budget, or the best of them in the long one."""
    head = ["layout", "s", "million steps", "us/step", "env", "policy", "update",
            "return", "finished [%]", "immobilised [%]", "out of time [%]"]  # fmt: skip
    rows = []
    for name, runs in _runs(result, part).items():
        seconds = {p: sum(run["seconds"][p] for run in runs) for p in PARTS}
        total, steps = sum(seconds.values()), sum(run["timesteps"] for run in runs)
        rows.append([
            name, f"{runs[0]['budget']:g}",
            f"{steps / len(runs) / 1e6:.1f}", f"{total / steps * 1e6:.1f}",
            *(f"{seconds[p] / total:.0%}" for p in PARTS),
            _each(runs, lambda run: run["points"][-1]["return"], 2),
            *(_each(runs, lambda run, m=m: 100.0 * run["points"][-1][m], 1)
              for m in ("finished", "immobilised", "time_limit")),
        ])  # fmt: skip
    return Table(head, rows).markdown()


def update(result: dict) -> str:
    """Cost of a step with SB3's update and with ours."""
    rows = [[name, *(range_text(c[key], 1) for key in ("step", "update"))] for name, c in result["update"].items()]
    return Table(["", "us a step in all", "of that the update"], rows).markdown()


def default_run(result: dict) -> str:
    """Wall time of one run of train.py, by part."""
    seconds = result.get("run")
    if not seconds:
        return "Not measured."
    total = sum(seconds.values())
    rows = [[part, f"{s:.0f}", f"{s / total:.0%}"] for part, s in seconds.items()]
    return Table(["part", "s", "share"], [*rows, ["all", f"{total:.0f}", "100%"]]).markdown()


def figure(result: dict, path: Path) -> None:
    """Share of courses finished, over wall time: the layouts in the short budget and the finalists in the long one."""
    figure, axes = plt.subplots(1, 2, figsize=(12, 4.6), sharey=True)
    for axis, part in zip(axes, ("layouts", "finalists"), strict=True):
        for k, (name, runs) in enumerate(_runs(result, part).items()):
            for run in runs:
                wall, finished = ([p[key] for p in run["points"]] for key in ("wall", "finished"))
                style = {"color": f"C{k % 10}", "marker": "o^sv"[k // 10 % 4], "markersize": 4}
                axis.plot(wall, 100.0 * np.array(finished), label=name if run is runs[0] else None, **style)
        axis.set_xlabel("wall time of training on one core [s]")
        axis.grid(alpha=0.3)
        axis.legend(fontsize=7, loc="lower right")
    axes[0].set_ylabel("validation courses finished [%]")
    axes[0].set_title("every layout, the same short time")
    axes[1].set_title("finalists, a curve a seed")
    figure.tight_layout()
    save_figure(figure, path, dpi=130)
    plt.close(figure)


SECTIONS = {
    "machine": machine, "update": update, "screening": partial(_layouts, part="layouts"),
    "finalists": partial(_layouts, part="finalists"), "run": default_run,
}  # fmt: skip


def sections(result: dict) -> dict[str, str]:
    """Text between the markers of docs/training.md, by marker."""
    return {name: section(result) for name, section in SECTIONS.items()}
