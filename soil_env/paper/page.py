"""paper.md of `soil-env paper`: tables and figures of the recomputed paper; the text is in
templates/paper.md.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from soil_env._io.document import Table, render
from soil_env._io.files import picture_of, write_own

from . import compare
from .compare import (
    LABELS,
    MODELS,
    NAMES,
    POINT,
    SLIPS,
    WIDE_SLIP,
    P,
    Results,
    Row,
    as_shown,
    on_the_curve,
    percent_above,
    prediction,
    pull_misfits,
    pulls,
    rules,
    sets,
)

READINGS = "equations as printed", "with Wong & Reece's peak"  # of the paper, as `MODELS`


def write(results: Results, folder: Path, command: str) -> None:
    """Write `folder`/paper.md and the figures in `folder`/paper; `command` as in `markdown`."""
    files: dict[str, bytes | str] = {}
    for name, (width, draw) in FIGURES.items():
        figure = Figure(figsize=(width, 4.2), layout="constrained")
        draw(figure)
        files[f"paper/{name}.png"] = picture_of(figure, dpi=110, metadata={"Software": None})
    write_own(folder, {**files, "paper.md": markdown(results, command)})


def markdown(results: Results, command: str) -> str:
    """paper.md as text; `command` is the command line that it names as its origin."""
    rows = results.rows
    names = ("point", "table1", "table3", "fig3", "fig4")
    own, printed, _ = sets(1).values()  # (soil, equations) of Table 2 and of Table 3 as printed
    # [%] by which the torques of the printed parameters are too low.
    low = -percent_above(prediction(*printed)[:, 1], prediction(*own)[:, 1])
    # Points of Figs. 3 and 4 but for the last of Fig. 3, whose drawbar pull is a misprint.
    fits = [*rows["fig3"][:-1], *rows["fig4"]]
    misses = np.abs([np.subtract(row.ours, row.printed) for row in fits])

    return render(
        "soil_env.paper:paper.md",
        **{f"{name}_table": _comparison(rows[name]) for name in names},
        table4_table=_ranges(results),
        corners=_corners(results),
        rules=_rules(),
        noise=_noise(results),
        # Numbers of Table 1 that agree to the last digit.
        agree=sum(as_shown(r.ours[1], r.form) == r.printed for r in rows["table1"]),
        r=results,
        p=P,
        c=compare,
        command=command,
        low=(low.min(), low.max()),
        off={rule.name: rule.differences for rule in rules()},
        miss=misses.max(axis=0),
        rms=pull_misfits(),
        misprint=rows["fig3"][-1].ours[1] - POINT.if_measured_drawbar_pull,
        reach=[100.0 * found.mean() for found in results.box.reached],
    )


def _comparison(rows: Sequence[Row]) -> Table:
    """Table of printed numbers, the recomputed ones by each reading of the paper, and their
    differences; these are taken from the rounded numbers.
    """
    header = ["", "printed", *(text for name in READINGS for text in (name, "difference"))]
    lines = []
    for row in rows:
        form = row.form
        line = [row.name, format(row.printed, form)]
        for value in row.ours:
            difference = as_shown(value, form) - row.printed
            line += [format(value, form), format(difference, "+" + form)]
        lines.append(line)
    return Table(header, lines)


def _limits(row: Row) -> list[str]:
    """The recomputed limits of a row of Table 4 as text, one for each reading; "< x (end of the
    scan)" or "> x (...)" where the scan of `compare.table_4` met no limit.
    """
    return [
        f"{side} {value:{row.form}} (end of the scan)" if side else format(value, row.form)
        for value, side in zip(row.ours, row.beyond, strict=True)
    ]


#: Methods of Table 4: plain Newton-Raphson and with backtracking, by each reading.
METHODS = [f"{name}: {how}" for name in READINGS for how in ("plain", "with backtracking")]


def _ranges(r: Results) -> Table:
    """Table 4: least and largest starting guess of phi [deg], K [m] and S [N/m^(n+2)] from which
    the search reaches the root (`compare.table_4`), printed and by each of `METHODS`.
    """
    rows = []
    for plain, other in zip(r.rows["table4"], r.rows["table4_backtracking"], strict=True):
        ours = [text for pair in zip(_limits(plain), _limits(other), strict=True) for text in pair]
        rows.append((plain.name, format(plain.printed, plain.form), *ours))
    return Table(("", "printed", *METHODS), rows)


def _corners(r: Results) -> Table:
    """Table of the corners of the ranges of Table 4: does the search from each reach the root?"""
    rows = [
        (f"{phi:.0f}", f"{K:.3f}", f"{S:.2g}", *("converges" if ok else "lost" for ok in found))
        for (phi, K, S), *found in zip(r.corners.guesses, *r.corners.reached, strict=True)
    ]
    total = (f"{found.sum()} of {found.size}" for found in r.corners.reached)
    return Table(("phi [deg]", "K [m]", "S", *METHODS), [*rows, ("all", "", "", *total)])


def _rules() -> Table:
    """Table of Fig. 2: drawbar pull and difference by each rule of integration."""
    rows = [
        (r.name, *(f"{v:.2f}" for v in r.pulls), *(f"{v:+.2f}" for v in r.differences))
        for r in rules()
    ]
    return Table(
        (
            "resistance, integration",
            *(f"{name}: DP [N]" for name in READINGS),
            *(f"{name}: from (12), exact [%]" for name in READINGS),
        ),
        rows,
    )


def _noise(r: Results) -> Table:
    """Table 5: errors [%] of phi, K and S under noise, printed and drawn, and the share of draws
    whose error is below the printed one.
    """
    rows = []
    for k, name in enumerate(NAMES):
        row = [LABELS[name], f"{P.table5[name][1]:.2f}"]
        for n in r.noise:
            low, median, high = n.quantiles[:, k]
            row += [f"{median:.1f} [{low:.1f}, {high:.1f}]", f"{100 * n.below[k]:.0f} %"]
        rows.append(row)
    columns = (
        text for name in READINGS for text in (f"{name}: median [5 %, 95 %]", "below the printed")
    )
    return Table(("error with noise [%]", "printed", *columns), rows)


def _axes(figure: Figure, x: str, y: str, position: int = 111) -> Axes:
    """Axes with a grid and the labels `x` and `y`, at a `position` of matplotlib."""
    axes = figure.add_subplot(position)
    axes.set(xlabel=x, ylabel=y)
    axes.grid(alpha=0.3)
    return axes


def _by_slip(figure: Figure) -> None:
    """Draw Fig. 2: drawbar pull against slip by Simpson's rule and exactly, and the differences."""
    slip = np.linspace(0.01, WIDE_SLIP[1], 80)
    pull = _axes(figure, "slip [-]", "drawbar pull [N]", 121)
    error = _axes(figure, "slip [-]", "from (12), exact [N]", 122)
    for k, reading in enumerate(READINGS):
        exact = pulls(compare.EXACT[k], slip)
        for colour, rule in enumerate(rules()):
            y = pulls(rule.equations[k], slip)
            label = f"{rule.name}, {reading}"
            # (11) is far from (12): its difference would hide the others.
            shown = ((pull, y), (error, y - exact))[: 1 + rule.equations[k].compaction]
            for axes, values in shown:
                axes.plot(slip, values, ("--", "-")[k], color=f"C{colour}", label=label)
    target = POINT.drawbar_pull
    pull.plot([POINT.slip], [target], "r^", label="printed")
    error.plot([POINT.slip], [target - compare.pull(compare.EXACT[1])], "r^")
    pull.legend(fontsize=6)


def _along(figure: Figure, label: str, name: str, position: int = 111) -> Axes:
    """Draw drawbar pull against the parameter `name` by both readings, and the printed points.
    Return the axes, whose x is labelled `label`.
    """
    axes = _axes(figure, label, "drawbar pull (12) [N]", position)
    points = on_the_curve(name)
    values = np.array([value for _, value, _ in points])
    margin = 0.3 * np.ptp(values)
    wide = np.linspace(values.min() - margin, values.max() + margin, 60)
    for e, style, reading in zip(MODELS, ("C0--", "C1-"), READINGS, strict=True):
        axes.plot(wide, [compare.pull(e, **{name: v}) for v in wide], style, label=reading)
    for mark, (where, value, row) in zip("v^>s", points, strict=False):
        axes.plot([value], [row.printed], f"k{mark}", label=f"printed, {where}")
    return axes


def _by_cohesion(figure: Figure) -> None:
    """Draw Fig. 3: drawbar pull against cohesion."""
    _along(figure, "cohesion c [Pa]", "cohesion").legend(fontsize=8)


def _by_phi_and_K(figure: Figure) -> None:
    """Draw Fig. 4: drawbar pull against phi and against K."""
    for k, name in enumerate(NAMES[:2]):
        axes = _along(figure, LABELS[name], name, 121 + k)
    axes.legend(fontsize=8)


def _torques(figure: Figure) -> None:
    """Draw Fig. 8: torque required and available against slip, the criterion of traversability."""
    axes = _axes(figure, "slip [-]", "torque required (3) [N m]")
    for k, style in enumerate(("--", "-")):
        for colour, (name, (soil, e)) in enumerate(sets(k).items()):
            label = f"{name}, {READINGS[k]}"
            axes.plot(SLIPS, compare.torque(soil, e), style, color=f"C{colour}", label=label)
    axes.axhline(P.available_torque, color="k", linestyle=":", label="available, printed")
    axes.set_ylim(0.0)
    axes.legend(fontsize=8)


#: Width [in] of each figure, and the function that draws it.
FIGURES = {
    "fig2": (11.0, _by_slip),
    "fig3": (6.4, _by_cohesion),
    "fig4": (11.0, _by_phi_and_K),
    "fig8": (6.4, _torques),
}
