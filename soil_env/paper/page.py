"""docs/paper.md from the recomputed results: tables and figures; the text is in templates/paper.md."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from soil_env._io.document import Table, render, wrapped
from soil_env._io.files import replace_file, save_figure
from soil_env.identification import Estimate
from soil_env.paper import figures
from soil_env.paper.curves import Traverse
from soil_env.paper.points import CONVERGED_SET, MOTOR, PRINTED_PULL, PRINTED_SET, triple
from soil_env.paper.results import Results

COMMAND = "python -m soil_env.paper --out docs"
CAPTIONS = {
    "fig2": "Fig. 2: DP (12) against slip, Simpson (18) and exact",
    "fig3": "Fig. 3: DP (12), m = 2, against cohesion, at 22.11 % slip and an entry angle of 37 deg",
    "fig4": "Fig. 4: DP (12), m = 2, against phi and K",
    "table4": "Table 4 as a map",
    "fig6_7": "Figs. 6 and 7: predicted from true and identified parameters",
    "fig8_9": "Figs. 8 and 9: torque required, drawbar pull",
}


def write(results: Results, folder: Path) -> None:
    """Write `folder`/paper.md and the figures in `folder`/paper."""
    r = results
    (folder / "paper").mkdir(parents=True, exist_ok=True)
    for name, draw, content in (
        ("fig2", figures.pull_against_slip, r.curves),
        ("fig3", figures.pull_against_cohesion, r.curves),
        ("fig4", figures.pull_against_phi_and_K, r.curves),
        ("table4", figures.guess_map, r.map),
        ("fig6_7", figures.force_curves, r.forces),
        ("fig8_9", figures.traversability, r.traverses),
    ):
        figure = Figure(figsize=(6.4, 4.2), layout="constrained")
        draw(figure, content)
        save_figure(figure, folder / "paper" / f"{name}.png", dpi=110, metadata={"Software": None})
    replace_file(folder / "paper.md", markdown(r))


def markdown(results: Results) -> str:
    """The page as Markdown."""
    r = results
    other = np.unique(np.round(r.map.elsewhere, 6), axis=0)

    def off(name: str) -> tuple[float, float]:
        """Least and largest error [%] of the torque of a parameter set."""
        errors = 100.0 * np.abs(r.forces.torque[name] / next(iter(r.forces.torque.values())) - 1.0)
        return errors.min(), errors.max()

    text = render(
        "soil_env.paper:paper.md",
        r=r,
        command=COMMAND + (f" --seed {r.seed}" if r.seed else ""),
        captions=CAPTIONS,
        shares=_shares,
        off=off,
        closest=min(n.miss for cases in r.nearest.values() for n in cases.values()),
        nearest_stop=min(s.miss for s in r.stops.values()),
        largest_noise=max(n.together.max() for n in r.noise_needed.values()),
        second_root=f" (phi, K, S) = ({', '.join(_set(other[0]))})" if len(other) else "",
        forces=_forces(r),
        traverses=_traverses(r),
        **_pulls(r),
        **_identification(r),
    )
    return wrapped(text)


def _pulls(r: Results) -> dict[str, Table]:
    """The checked drawbar pull, Figs. 2-4 and Table 1."""
    changes = [
        (name, f"{value:g} {unit}".strip(), f"{changed:.5g} {unit}".strip(), f"{100 * (changed / value - 1):+.2f} %")
        for name, (value, changed, unit) in r.changes.items()
    ]
    rules = [(rule, f"{pull:.2f}", f"{100 * (pull / r.rules['exact'] - 1):+.2f} %") for rule, pull in r.rules.items()]
    changed = [(name, *(f"{v:+.2f} %" for v in values)) for name, values in r.sensitivity.items()]
    return {
        "known": _known(r),
        "changes": Table(("changed alone", "ours", "gives 1047.22 N", "change"), changes),
        "rules": Table(("rule at 22.11 % slip", "DP (12) [N]", "from exact (12)"), rules),
        "sensitivity": Table(("parameter", "m = 2, -5 %", "m = 2, +5 %", "exact, -5 %", "exact, +5 %"), changed),
    }


def _identification(r: Results) -> dict[str, Table]:
    """Tables 3, 4 and 5."""
    points = [
        (f"{name}{k + 1}", f"{100 * i:.2f} %", f"{z:.5f}", f"{pull:.2f}")
        for name, p in r.points.items()
        for k, (i, z, pull) in enumerate(zip(*p, strict=True))
    ]
    stops = [
        (name, ", ".join(_set(s.found)), f"{100 * s.miss:.1f} %",
         f"{s.guess[0]:.0f} deg, {s.guess[1]:.4f} m, {s.guess[2]:.3g}", s.iteration, f"{100 * s.next_step:.0f} %",
         f"{s.within_5_percent} of {s.runs}")
        for name, s in r.stops.items()
    ]  # fmt: skip
    needed = [
        (name, ", ".join(f"{v:+.1f} %" for v in n.pull_alone), ", ".join(f"{v:.1f} %" for v in n.together))
        for name, n in r.noise_needed.items()
    ]
    reached = [(f"{s:.2g}", r.map.plain[:, :, k], r.map.ours[:, :, k]) for k, s in enumerate(r.map.S)]
    guesses = [
        (s, *(f"{100 * np.mean(o == 'root'):.1f} %" for o in outcomes))
        for s, *outcomes in (*reached, ("all", r.map.plain, r.map.ours))
    ]
    noise = [
        (name, *(f"{a:+.1f} +- {s:.1f} ({q:.1f})" for a, s, q in zip(n.mean, n.spread, n.median_size, strict=True)),
         f"{n.converged:.1f} %")
        for name, n in r.noise.items()
    ]  # fmt: skip
    nearest_iterate = ("stopped early", "nearest iterate", "off", "guess", "iteration", "next step", "within 5 %")
    return {
        "points": Table(("synthetic point", "slip", "z0 [m]", "DP [N]"), points),
        "solutions": _solutions(r),
        "nearest": _nearest(r),
        "stops": Table(nearest_iterate, stops),
        "noise_needed": Table(("noise needed", "on DP alone, per point", "on DP, z0 and i at once, per point"), needed),
        "guesses": Table(("guess of S", "plain Newton-Raphson at the root", "ours at the root"), guesses),
        "noise": Table(("points, noise on DP, z0 and i", "phi [%]", "K [%]", "S [%]", "converged"), noise),
    }


def _set(x) -> tuple[str, str, str]:
    """(phi, K, S) as text."""
    return f"{x[0]:.2f}", f"{x[1]:.4f}", f"{x[2]:,.0f}"


def _shares(outcomes) -> str:
    names, counts = np.unique(outcomes, return_counts=True)
    return ", ".join(f"{100 * c / outcomes.size:.1f} % {n}" for n, c in zip(names, counts, strict=True))


def _known(r: Results) -> Table:
    """The drawbar pulls beside those that are printed, or that the design notes give by quadrature."""
    notes = "design notes, by quadrature"
    rows = []
    for name, equation, value, origin, found, why in (
        ("DP", "(12), m = 2", PRINTED_PULL, "print", r.rules["m = 2"], "possibly rounded inputs, next table"),
        ("DP", "(12), exact", 1095, notes, r.rules["exact"], "same to the digits given"),
        ("DP", "(11), exact", 1318, notes, r.rules["exact, (11)"], "same"),
        ("DP of the set printed in Table 3", "(12), m = 2", PRINTED_PULL, "print", r.printed_pull,
         "that set is not a root: Table 3"),
    ):  # fmt: skip
        difference = f"{found - value:+.2f} ({100.0 * (found / value - 1.0):+.2f} %)"
        rows.append((name, equation, value, origin, f"{found:.2f}", difference, why))
    return Table(("quantity", "equation", "reference", "from", "ours", "difference", "why"), rows)


def _solutions(r: Results) -> Table:
    """Table 3: the sets solved for beside the printed one."""

    def differences(found: np.ndarray) -> str:
        return ", ".join(f"{100 * v:+.1f} %" for v in found / PRINTED_SET - 1.0)

    def solve(e: Estimate) -> str:
        return f"{e.status.name.lower()}, {e.iterations} iterations, condition {e.condition:.0f}"

    rows = [
        ("paper: printed", *_set(PRINTED_SET), "", ""),
        ("design notes: converged solve of the paper's points", *_set(CONVERGED_SET), "", ""),
    ]
    for name, estimate in r.solutions.items():
        found = triple(estimate.soil)
        rows.append((f"ours: points {name}", *_set(found), differences(found), solve(estimate)))
        if estimate.other is not None:
            other = triple(estimate.other)
            rows.append((f"points {name}, a second exact root", *_set(other), differences(other), ""))
    return Table(("", "phi [deg]", "K [m]", "S", "from the printed set (phi, K, S)", "solve"), rows)


def _nearest(r: Results) -> Table:
    """Assumptions changed alone, on both triples."""
    header = ["changed alone"]
    for name in r.nearest:
        header += [f"{name}: nearest at", f"{name}: phi, K, S", f"{name}: off"]
    rows = []
    for label in next(iter(r.nearest.values())):
        row = [label]
        for cases in r.nearest.values():
            n = cases[label]
            row += [n.value, ", ".join(_set(n.found)), f"{100 * n.miss:.1f} %"]
        rows.append(row)
    return Table(header, rows)


def _forces(r: Results) -> Table:
    """Figs. 6 and 7 at four slips."""
    f = r.forces
    picks = [int(np.argmin(np.abs(f.slip - s))) for s in (0.1, 0.2, 0.4, 0.6)]
    rows = []
    for what, curves in (("DP (12) [N]", f.pull), ("T (3) [N m]", f.torque)):
        true = next(iter(curves.values()))
        for name, values in curves.items():
            rms = np.sqrt(np.mean((values - true) ** 2))
            rows.append((what, name, *(f"{values[k]:.0f}" for k in picks), f"{rms:.0f}"))
    return Table(("", "parameters", *(f"slip {f.slip[k]:.2f}" for k in picks), "rms from true"), rows)


def _traverses(r: Results) -> Table:
    """Figs. 8 and 9: torque required and drawbar pull by soil."""
    rows = []
    for name, pair in r.traverses.items():
        for t, digging in zip(pair, ("no", "yes"), strict=True):
            within = t.slip[t.torque <= MOTOR]
            reach = f"{within[-1]:.2f}" if within.size else "-"
            paper = "" if t.pull_paper is None else limits(t.pull_paper)
            rows.append((name, digging, limits(t.torque), reach, limits(t.pull), paper, verdict(t)))
    header = ("soil", "slip-sinkage", "T (3) [N m]", "T <= 3 kN m up to slip", "DP (11) [N]", "DP (12) [N]",
              "passes, by (11)")  # fmt: skip
    return Table(header, rows)


def verdict(t: Traverse) -> str:
    """Whether the wheel passes this soil, and if not, why."""
    if not np.isfinite(t.torque).any():
        return "no: buried at every slip"
    if not (t.torque <= MOTOR).any():
        return "no: torque"
    return "yes" if t.best.drawbar_pull > 0.0 else "no: DP < 0"


def limits(values: np.ndarray) -> str:
    """Least and largest value; a dash where there is none."""
    return f"{np.nanmin(values):.0f} to {np.nanmax(values):.0f}" if np.isfinite(values).any() else "-"
