"""paper.md of `soil-env paper`: tables and figures of the recomputed paper; the text is in
templates/paper.md.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from soil_env._io.document import Table, render
from soil_env._io.files import picture_of, write_own
from soil_env.paper import compare
from soil_env.paper.compare import MEASURED, NAMES, P, Results, Row

FIGURES = ("fig6_7", "fig9")
READINGS = "equations as printed", "with Wong & Reece's peak"


def write(results: Results, folder: Path, command: str) -> None:
    """Write `folder`/paper.md and the figures in `folder`/paper."""
    files: dict[str, bytes | str] = {}
    for name, draw in zip(FIGURES, (_predictions, _torques), strict=True):
        figure = Figure(figsize=(6.4 if draw is _torques else 11.0, 4.2), layout="constrained")
        draw(figure, results)
        files[f"paper/{name}.png"] = picture_of(figure, dpi=110, metadata={"Software": None})
    write_own(folder, {**files, "paper.md": markdown(results, command)})


def markdown(results: Results, command: str) -> str:
    """The page as Markdown."""
    tables = {f"{name}_table": _beside(rows) for name, rows in results.rows.items()}
    own, printed, _ = compare.sets(1).values()
    low = 100.0 * (1.0 - compare.prediction(*printed)[:, 1] / compare.prediction(*own)[:, 1])
    tables |= {"rules": _rules(), "noise": _noise(results), "rms": _rms()}
    tables["torques"] = _torque_table(results)

    def agree(table: str, reading: int = 1) -> int:
        """Count the printed numbers of a table that agree to the last digit."""
        return sum(
            compare.as_shown(row.ours[reading], row.form) == row.printed
            for row in results.rows[table]
        )

    values = {
        "agree": agree,
        "r": results,
        "p": P,
        "c": compare,
        "command": command,
        "low": (low.min(), low.max()),
    }
    return render("soil_env.paper:paper.md", **values, **tables)


def _beside(rows: Sequence[Row]) -> Table:
    """A printed number, ours by each reading, and the differences; none where our scan ends before
    a limit.
    """
    header = ["", "printed", *(text for name in READINGS for text in (name, "difference"))]
    lines = []
    for name, printed, ours, form, beyond in rows:
        line = [name, format(printed, form)]
        for value, side in zip(ours, beyond, strict=True):
            if side:
                line += [f"{side} {value:{form}} (end of the scan)", "-"]
            else:
                line += [
                    format(value, form),
                    format(compare.as_shown(value, form) - printed, "+" + form),
                ]
        lines.append(line)
    return Table(header, lines)


def _rules() -> Table:
    return Table(
        ("resistance, integration", *(f"{name}: DP [N]" for name in READINGS)),
        [(name, *(f"{v:.2f}" for v in values)) for name, *values in compare.rules()],
    )


def _noise(r: Results) -> Table:
    rows = []
    for k, name in enumerate(NAMES):
        row = [compare.LABELS[name], f"{P.table5[name][1]:.2f}"]
        for n in r.noise:
            low, median, high = n.quantiles[:, k]
            row += [f"{median:.1f} [{low:.1f}, {high:.1f}]", f"{100 * n.below[k]:.0f} %"]
        rows.append(row)
    columns = (
        text for name in READINGS for text in (f"{name}: median [5 %, 95 %]", "below the printed")
    )
    return Table(("error with noise [%]", "printed", *columns), rows)


def _rms() -> Table:
    """The printed rms errors of Figs. 6 and 7, and ours where three points allow one."""
    header = (
        "rms error",
        "printed, over the curve",
        *(f"{name}, at the three points" for name in READINGS),
    )
    rows = []
    for what, values in (
        ("drawbar pull [N]", P.fig6_rms_drawbar_pull),
        ("torque [N m]", P.fig7_rms_torque),
    ):
        for points, printed in values.items():
            row = [f"{what}, set from {points.replace('_', ' ')}", f"{printed:.2f}"]
            known = values is P.fig6_rms_drawbar_pull and points == "three_points"
            rows.append(row + [f"{own:.2f}" if known else "-" for own in compare.pull_misfits()])
    return Table(header, rows)


def _torque_table(r: Results) -> Table:
    rows = []
    for name, found in r.torques.items():
        below = P.fig9_below.get(name)
        about = P.fig9_about.get(name)
        row = [name.replace("_", " "), f"about {about:.0f}" if below is None else f"< {below:.0f}"]
        for T in found:
            carried = np.isfinite(T).any()
            row.append(
                f"{np.nanmin(T):.0f} to {np.nanmax(T):.0f}" if carried else "buried at every slip"
            )
            row.append(f"{np.nanmax(T) - (about or below):+.0f}" if carried else "-")
        rows.append(row)
    difference = "highest less printed"
    return Table(
        ("soil", "printed T [N m]", "ours, balanced", difference, "ours, at 37 deg", difference),
        rows,
    )


def _axes(figure: Figure, x: str, y: str, position=111):
    axes = figure.add_subplot(position)
    axes.set(xlabel=x, ylabel=y)
    axes.grid(alpha=0.3)
    return axes


def _predictions(figure: Figure, r: Results) -> None:
    """Figs.

    6 and 7: drawbar pull and torque against slip, at sinkages interpolated between the measured
    ones.
    """
    slip = np.linspace(MEASURED.slip[0], MEASURED.slip[-1], 60)
    sinkage = np.interp(slip, MEASURED.slip, MEASURED.sinkage)
    pull = _axes(figure, "slip [-]", "drawbar pull (12) [N]", 121)
    torque = _axes(figure, "slip [-]", "torque (3) [N m]", 122)
    for k, style in enumerate(("--", "-")):
        for colour, (name, (soil, e)) in enumerate(compare.sets(k).items()):
            y = compare.forces(soil, slip, sinkage, e)
            for axes, column in ((pull, 0), (torque, 2)):
                axes.plot(
                    slip, y[:, column], style, color=f"C{colour}", label=f"{name}, {READINGS[k]}"
                )
    pull.plot(MEASURED.slip, MEASURED.pull, "ko", label="measured")
    pull.legend(fontsize=7)


def _torques(figure: Figure, r: Results) -> None:
    """Fig. 9: torque required."""
    axes = _axes(figure, "slip [-]", "torque required (3) [N m]")
    for k, (name, (T, _)) in enumerate(r.torques.items()):
        label = name.replace("_", " ") + ("" if np.isfinite(T).any() else ": buried")
        axes.plot(compare.SLIPS, T, color=f"C{k}", label=label)
    axes.axhline(P.available_torque, color="k", linestyle=":", label="available")
    axes.axhline(
        P.fig9_about["clayey_soil"],
        color=f"C{len(r.torques) - 1}",
        linestyle="--",
        label="printed, clayey",
    )
    axes.set_ylim(0.0)
    axes.legend()
