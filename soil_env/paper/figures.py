"""Figures of the recomputed paper, each drawn onto a given matplotlib figure.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from soil_env.paper.curves import ForceCurves, PullCurves, Traverse
from soil_env.paper.points import FIXED_COHESION, MOTOR, PRINTED_PULL, SAND, SLIP, GuessMap


def _axes(figure: Figure, x: str, y: str, position=111):
    """New axes with a light grid."""
    axes = figure.add_subplot(position)
    axes.set(xlabel=x, ylabel=y)
    axes.grid(alpha=0.3)
    return axes


def pull_against_slip(figure: Figure, c: PullCurves) -> None:
    """DP (12) against slip, by Simpson (18) and exactly."""
    axes = _axes(figure, "slip [-]", "drawbar pull (12) [N]")
    for name, values in c.by_rule.items():
        axes.plot(c.slip, values, "k--" if name == "exact" else "-", label=name, linewidth=1.5)
    axes.plot([SLIP], [PRINTED_PULL], "k^", label="printed, 1047.22 N")
    axes.legend()


def pull_against_cohesion(figure: Figure, c: PullCurves) -> None:
    """DP (12) against cohesion."""
    axes = _axes(figure, "cohesion [kPa]", "drawbar pull (12) [N]")
    axes.plot(c.cohesion / 1e3, c.by_cohesion, label="slip 22.11 %, entry angle 37 deg, m = 2")
    for name, value, mark in (("Table 2", SAND.cohesion, "k^"), ("held in Table 3", FIXED_COHESION, "ks")):
        label = f"c = {value:.0f} Pa, {name}"
        axes.plot([value / 1e3], [np.interp(value, c.cohesion, c.by_cohesion)], mark, label=label)
    axes.legend()


def pull_against_phi_and_K(figure: Figure, c: PullCurves) -> None:
    """DP (12) against phi and K; the star is Table 2's sand."""
    axes = _axes(figure, "friction angle phi [deg]", "shear deformation modulus K [m]")
    filled = axes.contourf(c.phi_deg, c.K, c.by_phi_K.T, 20, cmap="viridis")
    lines = axes.contour(c.phi_deg, c.K, c.by_phi_K.T, levels=[0.0, PRINTED_PULL], colors="white")
    axes.clabel(lines, fmt="%.0f N")
    axes.plot([SAND.friction_angle_deg], [SAND.shear_modulus], "w*", markersize=11)
    figure.colorbar(filled, ax=axes, label="drawbar pull (12) [N]")


def guess_map(figure: Figure, m: GuessMap) -> None:
    """Share of the guesses of the box of Table 4 that reach the root (star)."""
    figure.set_size_inches(11.0, 4.2)
    for k, (title, outcomes) in enumerate((("plain Newton-Raphson", m.plain), ("ours", m.ours))):
        axes = _axes(figure, "guess of phi [deg]", "guess of K [m]", 131 + k)
        share = 100.0 * np.mean(outcomes == "root", axis=2)
        image = axes.pcolormesh(m.phi_deg, m.K, share.T, vmin=0.0, vmax=100.0, cmap="viridis", shading="nearest")
        axes.plot(m.root[0], m.root[1], "r*", markersize=11)
        axes.set_title(title, fontsize=10)
        axes.grid(False)
    figure.colorbar(image, ax=figure.axes, label="guesses of S that reach the root [%]", location="bottom", shrink=0.8)
    axes = _axes(figure, "guess of S", "guesses of phi, K that reach the root [%]", 133)
    for name, outcomes, colour in (("plain", m.plain, "C0"), ("ours", m.ours, "C1")):
        axes.semilogx(m.S, 100.0 * np.mean(outcomes == "root", axis=(0, 1)), "o-", label=name, color=colour)
    axes.axvline(m.root[2], color="r", linestyle=":", label="root")
    axes.set_ylim(0.0, 103.0)
    axes.legend()


def force_curves(figure: Figure, p: ForceCurves) -> None:
    """DP (12) and torque (3) of each parameter set."""
    figure.set_size_inches(11.0, 4.2)
    for k, (label, curves) in enumerate((("drawbar pull (12) [N]", p.pull), ("torque (3) [N m]", p.torque))):
        axes = _axes(figure, "slip [-]", label, 121 + k)
        for (name, values), style in zip(curves.items(), ("k-", "C1--", "C2-", "C3-"), strict=True):
            axes.plot(p.slip, values, style, label=name)
    axes.legend()


def traversability(figure: Figure, soils: dict[str, tuple[Traverse, Traverse]]) -> None:
    """Torque required (3) and DP of each soil."""
    figure.set_size_inches(11.0, 4.2)
    torque = _axes(figure, "slip [-]", "torque required (3) [N m]", 121)
    pull = _axes(figure, "slip [-]", "drawbar pull (11), dotted (12) [N]", 122)
    for k, (name, pair) in enumerate(soils.items()):
        for g, style in zip(pair, ("-", "--"), strict=True):
            label = name if style == "-" else None
            if style == "-" and not np.isfinite(g.torque).any():
                label = f"{name}: buried"
            torque.plot(g.slip, g.torque, style, color=f"C{k}", label=label)
            pull.plot(g.slip, g.pull, style, color=f"C{k}", label=label)
            if g.pull_paper is not None:
                pull.plot(g.slip, g.pull_paper, ":", color=f"C{k}")
    torque.axhline(MOTOR, color="k", linestyle=":", label="motor, 3 kN m")
    pull.axhline(0.0, color="k", linewidth=0.8)
    torque.set_ylim(0.0, 3300.0)
    torque.legend(title="dashed: with slip-sinkage", fontsize=8, loc="lower right")
    for style, label in (("-", "(11)"), ("--", "(11), with slip-sinkage"), (":", "(12)")):
        pull.plot([], [], f"k{style}", label=label)
    pull.legend(title="colours as on the left", fontsize=8, loc="lower left")
