"""The sections of the page of `paper`: what its tables say and its text explains. Nothing is computed here.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from matplotlib.figure import Figure

from soil_env.paper import figures as draw
from soil_env.paper.points import CONVERGED_SET, LOAD, MOTOR, PRINTED_PULL, PRINTED_SET

UNKNOWN = "not available to us"
PRINT, NOTES = "print", "design notes, by quadrature"  # where a value beside ours comes from


@dataclass(frozen=True)
class Table:
    """A table of text."""

    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]


@dataclass(frozen=True)
class Picture:
    """A figure, drawn only when it is saved."""

    name: str
    caption: str
    draw: Callable[[Figure], None]


@dataclass(frozen=True)
class Section:
    """A heading with text, tables and figures, in this order."""

    title: str
    text: list[str] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def _set(x) -> tuple[str, str, str]:
    """(phi, K, S) as text."""
    return f"{x[0]:.2f}", f"{x[1]:.4f}", f"{x[2]:,.0f}"


def _beside(name: str, equation: str, value: float, origin: str, found: float, why: str) -> tuple[str, ...]:
    difference = f"{found - value:+.2f} ({100.0 * (found / value - 1.0):+.2f} %)"
    return (
        name,
        equation,
        f"{value:.2f}" if origin == PRINT else f"{value:.0f}",
        origin,
        f"{found:.2f}",
        difference,
        why,
    )


def _known(results) -> Section:
    rules = results.rules
    rows = [
        _beside("DP", "(12), m = 2", PRINTED_PULL, PRINT, rules["m = 2"], "possibly rounded inputs, next table"),
        _beside("DP", "(12), exact", 1095.0, NOTES, rules["exact"], "same to the digits given"),
        _beside("DP", "(11), exact", 1318.0, NOTES, rules["exact, (11)"], "same"),
        _beside("DP of the set printed in Table 3", "(12), m = 2", PRINTED_PULL, PRINT, results.printed_pull,
                "that set is not a root: Table 3"),
    ]  # fmt: skip
    changes = [
        (name, f"{value:g} {unit}".strip(), f"{changed:.5g} {unit}".strip(), f"{100 * (changed / value - 1):+.2f} %")
        for name, (value, changed, unit) in results.changes.items()
    ]
    return Section(
        "Drawbar pull at 22.11 % slip, entry angle 37 deg (Table 2's sand)",
        tables=[
            Table(("quantity", "equation", "reference", "from", "ours", "difference", "why"), rows),
            Table(("changed alone", "ours", "gives 1047.22 N", "change"), changes),
        ],
        notes=[
            "Composite Simpson with m = 2 in each zone (18) leaves 0.29 % to the printed 1047.22 N. Any one of phi, n "
            "or the entry angle, changed within the rounding of the value we have (33.3 deg, 0.47, 37 deg), would "
            "remove it; no integration with more subintervals comes near. (12) is not (11): it is exact only without "
            "the rear branch (8). The design notes give 1050.25 N for m = 2; our S was solved back from it (Table 2 "
            "below), so that the test of the equations is in the two values by quadrature.",
        ],
    )


def _table_2(results) -> Section:
    rows = [
        ("r, b", "0.6274 m, 0.1524 m", "Wong & Reece (1967), 24.7 in and 6 in, by way of pyTerramechanics"),
        ("W", "8923 N", "Wong & Reece (1967), 2006 lb, same way"),
        ("c", "690 Pa", "Wong & Reece (1967), 0.1 psi; DP hardly depends on it"),
        ("phi", "33.3 deg", "Wong & Reece (1967); reproduces the checked DP"),
        ("K", "0.0381 m", "Wong & Reece (1967), 1.5 in; reproduces the checked DP"),
        ("n", "0.47", "Wong & Reece (1967); reproduces the checked DP"),
        ("S", "583,792", "solved back from DP = 1050.25 N; 584,230 by exact conversion of 20 psi, 2.5 psi/in"),
        ("k_c, k_phi", "20/35 and 15/35 of S", "Wong & Reece (1967); only their sum can be checked"),
        ("th2", "0", "Wong & Reece (1967); reproduces the checked DP"),
    ]
    load = results.point_load["exact"]
    return Section(
        "Table 2: compact sand and wheel",
        [f"The table as printed: {UNKNOWN}. These are the values used here and where each comes from."],
        [Table(("quantity", "value", "provenance"), rows)],
        notes=[
            f"The working point is not quite in balance under this W: by (1), integrated exactly, the sand carries "
            f"{load:.0f} N at 37 deg and 22.11 % slip, {100.0 * (load / LOAD - 1.0):+.1f} % from {LOAD:.0f} N "
            f"({results.point_load['m = 2']:.0f} N by m = 2); at that slip it carries W at "
            f"{results.balance_deg:.2f} deg. Tables 3 and 5 take the sinkages of the load of the 37 deg point, Figs. 6 "
            "to 9 those of W.",
        ],
    )


def _curves(results) -> Section:
    c = results.curves
    rows = [(rule, f"{pull:.2f}", f"{100 * (pull / results.rules['exact'] - 1):+.2f} %", UNKNOWN)
            for rule, pull in results.rules.items()]  # fmt: skip
    return Section(
        "Figs. 2, 3 and 4: drawbar pull against slip, cohesion, phi and K",
        ["At the sinkage of the 37 deg point. The published curves are " + UNKNOWN + ". Exact is Gauss-Legendre after "
         "a substitution that removes the root at both ends of the arc; it agrees with quadrature to 1e-5."],
        [Table(("rule at 22.11 % slip", "DP (12) [N]", "from exact (12)", "published"), rows)],
        [
            Picture("fig2", "Fig. 2: DP (12) against slip, Simpson (18) and exact", lambda f: draw.fig2(f, c)),
            Picture("fig3", "Fig. 3: DP (12), m = 2, against cohesion, at 22.11 % slip and an entry angle of 37 deg",
                    lambda f: draw.fig3(f, c)),
            Picture("fig4", "Fig. 4: DP (12), m = 2, against phi and K", lambda f: draw.fig4(f, c)),
        ],
        ["Fig. 5 is not here: what it shows is " + UNKNOWN + "."],
    )  # fmt: skip


def _table_1(results) -> Section:
    rows = [(name, *(f"{v:+.2f} %" for v in values), UNKNOWN) for name, values in results.sensitivity.items()]
    return Section(
        "Table 1: change of DP (12) for -5 % and +5 % of each parameter",
        tables=[Table(("parameter", "m = 2, -5 %", "m = 2, +5 %", "exact, -5 %", "exact, +5 %", "published"), rows)],
        notes=["The design notes say that m = 2 gives the printed Table 1 to every digit but that of c, and m = 50 "
               "does not. That cannot be checked here: the digits are " + UNKNOWN + "."],
    )  # fmt: skip


def _table_3(results) -> Section:
    solved = [("paper: printed", *_set(PRINTED_SET), "", ""),
              ("design notes: converged solve of the paper's points", *_set(CONVERGED_SET), "", "")]  # fmt: skip
    for name, estimate in results.solutions.items():
        s = estimate.soil
        found = np.array([s.friction_angle_deg, s.shear_modulus, s.sinkage_coefficient])
        difference = ", ".join(f"{100 * v:+.1f} %" for v in found / PRINTED_SET - 1.0)
        solved.append((f"ours: points {name}", *_set(found), difference, f"{estimate.status.name.lower()}, "
                       f"{estimate.iterations} iterations, condition {estimate.condition:.0f}"))  # fmt: skip
        if estimate.other is not None:
            s = estimate.other
            other = np.array([s.friction_angle_deg, s.shear_modulus, s.sinkage_coefficient])
            difference = ", ".join(f"{100 * v:+.1f} %" for v in other / PRINTED_SET - 1.0)
            solved.append((f"points {name}, a second exact root", *_set(other), difference, ""))
    given = [(f"{name}{k + 1}", f"{100 * i:.2f} %", f"{z:.5f}", f"{d:.2f}")
             for name, p in results.points.items() for k, (i, z, d) in enumerate(zip(*p, strict=True))]  # fmt: skip
    return Section(
        "Table 3: phi, K and S from three points, c = 3000 Pa",
        [
            f"The paper's three measured points are {UNKNOWN}. Two synthetic triples, labelled A and B, stand in for "
            "them, both with the 22.11 %, 37 deg point and the sinkages at which (1) carries the load of that point. "
            "A: DP (12), m = 2, of Table 2's sand with its own c = 690 Pa. B: DP of the set (31.97, 0.0317, 498358) "
            "with c = 3000 Pa, which by the design notes is the root of the paper's own points, so that B has it too.",
            "Solved by Newton-Raphson with n = 0.47, m = 2, (12).",
        ],
        [
            Table(("synthetic point", "slip", "z0 [m]", "DP [N]"), given),
            Table(("", "phi [deg]", "K [m]", "S", "from the printed set (phi, K, S)", "solve"), solved),
        ],
        notes=[
            "Three drawbar pulls at sinkages so alike do not fix the soil: each triple has a second exact root, loose "
            "in phi, stiff and quick to mobilise its shear. The solve has the status AMBIGUOUS and names it; which "
            "root is met depends on the guess. Points at several loads, or the load or torque as a further channel, "
            "decide (docs/identification.md).",
            f"At the 37 deg point the converged set gives {results.points['B'].pull[1]:.1f} N, as it should if that "
            f"point (1047.22 N) is among the paper's three, and the printed set {results.printed_pull:.1f} N: it is "
            "not a root of the printed equations. From the points of the sand itself (A) the wrong cohesion costs "
            "little: phi 2 % low, K and S right. The lower K and S of that converged set therefore come from the "
            "measured points, not from c.",
        ],
    )


def _explanations(results) -> Section:
    names = list(results.points)
    rows = []
    for label in results.nearest[names[0]]:
        row = [label]
        for name in names:
            n = results.nearest[name][label]
            row += [n.value, ", ".join(_set(n.found)), f"{100 * n.miss:.1f} %"]
        rows.append(tuple(row))
    header = ("changed alone", *(f"{name}: {what}" for name in names for what in ("nearest at", "phi, K, S", "off")))
    stops = [
        (name, ", ".join(_set(s.found)), f"{100 * s.miss:.1f} %",
         f"{s.guess[0]:.0f} deg, {s.guess[1]:.4f} m, {s.guess[2]:.3g}", str(s.iteration), f"{100 * s.next_step:.0f} %",
         f"{s.within_5_percent} of {s.runs}")
        for name, s in results.stops.items()
    ]  # fmt: skip
    noise = [
        (name, ", ".join(f"{v:+.1f} %" for v in n.pull_alone), ", ".join(f"{v:.1f} %" for v in n.together))
        for name, n in results.noise_needed.items()
    ]
    closest = min(n.miss for cases in results.nearest.values() for n in cases.values())
    steps = " or ".join(f"{100 * s.next_step:.0f} %" for s in results.stops.values())
    worst = max(n.together.max() for n in results.noise_needed.values())
    return Section(
        "Table 3: what could explain the printed set",
        ["Tried on both triples: one assumption changed at a time, over a range, and solved to convergence ('off' is "
         "the largest relative distance in phi, K, S from the printed set); stopping an unsafeguarded Newton-Raphson "
         "early, from a grid of guesses over the box of Table 4; and errors of measurement (to first order) that make "
         "the printed set an exact root."],
        [
            Table(header, rows),
            Table(("stopped early", "nearest iterate", "off", "guess", "iteration", "next step", "within 5 %"), stops),
            Table(("noise needed", "on DP alone, per point", "on DP, z0 and i at once, per point"), noise),
        ],
        notes=[
            "No other cohesion (0 to 12 kPa), no z0 convention, no other n, no rule of integration and not (11) gives "
            f"the printed set: none comes within {100 * closest:.0f} %. "
            f"An iteration stopped while its next step is still {steps} passes by at "
            f"{100 * min(s.miss for s in results.stops.values()):.1f} %, from fewer than 1 % of the guesses: possible, "
            "but no sign that it happened. Noise does it easily: the equations are so badly conditioned that errors "
            f"of at most {worst:.0f} % on DP, z0 and i together turn one set into the other, and the paper itself puts "
            "5 % of white noise on them (Table 5). Noisy or differently rounded points, or an early stop, remain; "
            "without the points we cannot decide.",
        ],
    )  # fmt: skip


def _shares(outcomes) -> str:
    names, counts = np.unique(outcomes, return_counts=True)
    return ", ".join(f"{100 * c / outcomes.size:.1f} % {n}" for n, c in zip(names, counts, strict=True))


def _table_4(results) -> Section:
    m = results.map
    rows = [(f"{s:.2g}", *(f"{100 * np.mean(o[:, :, k] == 'root'):.1f} %" for o in (m.plain, m.ours)))
            for k, s in enumerate(m.S)]  # fmt: skip
    rows.append(("all", *(f"{100 * np.mean(o == 'root'):.1f} %" for o in (m.plain, m.ours))))
    other = np.unique(np.round(m.elsewhere, 6), axis=0)
    second = f" (phi, K, S) = ({', '.join(_set(other[0]))})" if len(other) else ""
    return Section(
        "Table 4: initial guesses that converge",
        [
            "The paper prints the box phi 5-89 deg, K 0.015-0.089 m, S 7e4-3.1e12. Its examples inside the box are "
            f"{UNKNOWN}. Here the whole box is scanned, {' x '.join(map(str, m.plain.shape))} guesses (S in equal "
            "ratios), on points A, for the unsafeguarded Newton-Raphson in (phi, K, S) and for ours.",
        ],
        [Table(("guess of S", "plain Newton-Raphson at the root", "ours at the root"), rows)],
        [Picture("table4", "Table 4 as a map", lambda f: draw.guess_map(f, m))],
        [
            f"Points A, plain: {_shares(m.plain)} ('lost': K <= 0 or a singular Jacobian); ours: {_shares(m.ours)}. "
            f"Points B, plain: {_shares(results.map_b.plain)}; ours: {_shares(results.map_b.ours)}. "
            "The printed box is thus no region of convergence of the plain iteration on these points.",
            f"Where ours ends elsewhere it has found another exact root of the same three equations{second}: three "
            "drawbar pulls do not determine the soil uniquely within these bounds; a further point or the load does.",
            "Why S may start at 3.1e12: (2) and (12) are affine in S, so the first Newton step moves phi and K by an "
            "amount proportional to 1/S, hardly at all, and sets S to a value that hardly depends on its guess. A "
            "guess of S that is too small throws phi and K far away instead.",
        ],
    )


def _table_5(results) -> Section:
    rows = []
    for name, n in results.noise.items():
        errors = [f"{a:+.1f} +- {s:.1f} ({q:.1f})" for a, s, q in zip(n.mean, n.spread, n.median_size, strict=True)]
        rows.append((name, *errors, f"{n.converged:.1f} %", UNKNOWN))
    return Section(
        "Table 5: 5 % white noise",
        [
            f"Gaussian, standard deviation 5 % of each value, {results.draws} draws a row, seed {results.seed}; Table "
            "2's sand, c known. Error in % of the true value: mean +- standard deviation over the draws that converged "
            "(in brackets the median of its size). Three points by Newton-Raphson, more by generalized Newton-Raphson "
            "(20)-(24).",
        ],
        [Table(("points, noise on DP, z0 and i", "phi [%]", "K [%]", "S [%]", "converged", "published"), rows)],
        notes=[
            "With such a spread a single draw, as in one printed table, can show almost any error. More points at one "
            "load shrink the spread but not the mean: their sinkage hardly varies, and plain least squares, which "
            "takes slip and sinkage for exact, is biased along the direction that the points leave open. What helps "
            "is sinkage that varies: the same number of points at 0.5, 1 and 1.5 times the load. Errors in variables "
            "are treated in docs/identification.md.",
        ],
    )


def _prediction(results) -> Section:
    p = results.prediction
    true = next(iter(p.pull))
    picks = [int(np.argmin(np.abs(p.slip - s))) for s in (0.1, 0.2, 0.4, 0.6)]
    rows = []
    for what, curves, unit in (("DP (12)", p.pull, "N"), ("T (3)", p.torque, "N m")):
        for name, values in curves.items():
            rms = np.sqrt(np.mean((values - curves[true]) ** 2))
            rows.append((f"{what} [{unit}]", name, *(f"{values[k]:.0f}" for k in picks), f"{rms:.0f}", UNKNOWN))

    def off(name):
        low = 100.0 * np.abs(p.torque[name] / p.torque[true] - 1.0)
        return low.min(), low.max()

    header = ("", "parameters", *(f"slip {p.slip[k]:.2f}" for k in picks), "rms from true", "published")
    return Section(
        "Figs. 6 and 7: drawbar pull and torque from identified parameters",
        ["W = 8923 N, sinkage by (1) of the true sand, m = 2. Identified sets are used with c = 3000 Pa."],
        [Table(header, rows)],
        [Picture("fig6_7", "Figs. 6 and 7: predicted from true and identified parameters", lambda f: draw.pair(f, p))],
        [f"A wrong c alone (points A) leaves both within {off('identified, points A')[1]:.1f} %. The converged set of "
         "Table 3 is {:.0f} to {:.0f} % low in torque and the printed set {:.0f} to {:.0f} %: a set that fits drawbar "
         "pulls need not give the torque, on which traversability depends.".format(*off("Table 3, converged"),
                                                                                  *off("Table 3, printed"))],
    )  # fmt: skip


def _verdict(ground) -> str:
    if not np.isfinite(ground.torque).any():
        return "no: buried at every slip"
    if not (ground.torque <= MOTOR).any():
        return "no: torque"
    return "yes" if ground.best.drawbar_pull > 0.0 else "no: DP < 0"


def _limits(values) -> str:
    return f"{np.nanmin(values):.0f} to {np.nanmax(values):.0f}" if np.isfinite(values).any() else "-"


def _traversability(results) -> Section:
    rows = []
    for name, pair in results.ground.items():
        for ground, digging in zip(pair, ("no", "yes"), strict=True):
            within = ground.slip[ground.torque <= MOTOR]
            reach = f"{within[-1]:.2f}" if within.size else "-"
            paper = "" if ground.pull_paper is None else _limits(ground.pull_paper)
            rows.append((name, digging, _limits(ground.torque), reach, _limits(ground.pull), paper,
                         _verdict(ground), UNKNOWN))  # fmt: skip
    header = ("soil", "slip-sinkage", "T (3) [N m]", "T <= 3 kN m up to slip", "DP (11) [N]", "DP (12) [N]",
              "passes, by (11)", "published")  # fmt: skip
    return Section(
        "Figs. 8 and 9: traversability at 3 kN m",
        [f"W = 8923 N, wheel of 0.6274 m. Which soils the paper used is {UNKNOWN}; these are Wong's rows of the same "
         "names (configs/soils.yaml). A soil passes if at some slip the torque required stays within 3 kN m (the "
         "paper's criterion) and DP is positive. The paper has no slip-sinkage; the second row of each soil has it."],
        [Table(header, rows)],
        [Picture("fig8_9", "Figs. 8 and 9: torque required, drawbar pull", lambda f: draw.ground(f, results.ground))],
        ["By torque alone (the paper's criterion) sandy loam, dry sand and clayey soil pass; sand exceeds 3 kN m only "
         "when it digs in. By drawbar pull clayey soil does not pull itself, and this snow cannot carry a wheel so "
         "narrow and heavy at all: it sinks beyond 1.5 radii before (1) balances. By (12) dry sand has no positive DP: "
         "what the simplified resistance decides."],
    )  # fmt: skip


def _not_recomputed(results) -> Section:
    return Section(
        "What is known of print and is no result of ours",
        tables=[Table(("printed", "here"), [
            ("identification takes 0.15 s", "a time is not reproducible to the digit: see docs/identification.md"),
            ("3 kN m motor", "taken as given"),
            ("5 % white noise on DP, z0, i", "taken as the standard deviation"),
            ("tau/K in the exponent of (10)", "read as r/K, the only reading with a right unit"),
            ("tau1 missing in (18)", "read with it"),
        ])],
    )  # fmt: skip


def sections(results) -> list[Section]:
    """The page."""
    parts = (_known, _table_2, _curves, _table_1, _table_3, _explanations, _table_4, _table_5, _prediction,
             _traversability, _not_recomputed)  # fmt: skip
    return [part(results) for part in parts]
