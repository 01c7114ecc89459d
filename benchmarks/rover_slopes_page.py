"""docs/rover_measured.md and docs/rover_slopes.svg from the result of benchmarks/rover_slopes.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.common import ROOT, machine_text, renew_page
from benchmarks.rover_rigs import half
from soil_env._io.document import Table
from soil_env._io.files import save_figure

PAGE = ROOT / "docs" / "rover_measured.md"
PARTS = ("mgru3", "mgru3 fit", "ex1", "ex1 fit", "made")
_UNITS = {
    "friction_angle_deg": ("phi", "deg", 1.0, 1), "cohesion": ("c", "Pa", 1.0, 0),
    "sinkage_exponent": ("n", "", 1.0, 2), "shear_modulus": ("K", "mm", 1e3, 1),
    "pressure": ("pressure at 10 mm", "kPa", 1e-3, 0), "dig_gain": ("gain of digging", "", 1.0, 2),
}  # fmt: skip
_COLOURS = ("#d55e00", "#0072b2", "#009e73")
_MARKS = ("o", "s", "^")


def write(results: dict[str, Any], folder: Path) -> None:
    """Write rover_measured.md and rover_slopes.svg into `folder`."""
    figure(results["rovers"], folder / "rover_slopes.svg")
    made, parts = results["made"], {}
    for name, found in results["rovers"].items():
        parts[name] = "\n\n".join((_over_slope(found).markdown(), _of_band(found).markdown()))
        fits = [_of_fits(found).markdown(), *(_drive_table(found, one).markdown() for one in found["fits"])]
        parts[f"{name} fit"] = "\n\n".join([_fitted(found), *fits, *_alternatives(found), _pulls(found)])
    starts = " and ".join(f"{count} ({name.upper()})" for name, count in made["draws"].items())
    parts["made"] = (
        f"Bands of {made['soils']} drawn soils a rover, seed {made['seed']}; fits from {starts} others, seed 1; "
        f"{machine_text(made['machine'], 'numpy', 'numba')}."
    )
    renew_page(PAGE, parts, folder / PAGE.name)


def _percent(value: float, digits: int = 1) -> str:
    return f"{100.0 * value:.{digits}f}"


def _degrees(value: float | None) -> str:
    return "none" if value is None else f"{value:.1f}"


# --- the band of drawn soils ------------------------------------------------------------------------------------------


def _main_sets(found: dict) -> list[str]:
    """The sets of points but for the parts that one is split into."""
    return [name for name in found["points"] if ", " not in name]


def _over_slope(found: dict) -> Table:
    """Slip at the measured slopes, theirs and ours."""
    rows, slopes, b = [], found["slopes"], found["band"]
    sets = _main_sets(found)
    for name in sets[:1] if "m/s" in sets[0] else sets:  # of a law, at one speed
        points = found["points"][name]
        for slope, slip in zip(points["slope"], points["slip"], strict=True):
            ours = [float(np.interp(slope, slopes, b[key])) for key in ("low", "median", "high")]
            inside = "yes" if ours[0] <= slip <= ours[2] else "no"
            rows.append((name, f"{slope:.1f}", _percent(slip), _percent(ours[1]), f"{_percent(ours[0])} to "
                         f"{_percent(ours[2])}", inside))  # fmt: skip
    head = ("set", "slope [deg]", "theirs [%]", "ours, median [%]", "ours, 5 to 95 %", "within")
    return Table(head, rows)


def _of_band(found: dict) -> Table:
    """How far the drawn soils are from each set, and where slip passes 50 %."""
    rows, half = [], found["band"]["half"]
    ours = "{} ({} to {})".format(*(_degrees(half[i]) for i in (1, 0, 2)))
    for name in _main_sets(found):
        of, theirs = found["band"]["measured"][name], found["points"][name]["half"]
        best, middle, worst = of["rms"]
        rows.append((name, f"{of['inside']} of {of['points']}", f"{_percent(best)}, {_percent(middle)}, "
                     f"{_percent(worst)}", _percent(of["rms_of_median"]), _degrees(theirs), ours))  # fmt: skip
    head = (
        "set", "points within 5 to 95 %", "rms of slip: best, median, worst soil", "rms of the median curve",
        "50 % slip at [deg], theirs", "ours: median (5 to 95 %)",
    )  # fmt: skip
    return Table(head, rows)


# --- fits -------------------------------------------------------------------------------------------------------------


def _fitted(found: dict) -> str:
    """What was fitted, as a list."""
    lines = []
    for name, fit in found["fits"].items():
        values = [
            f"{label} = {fit['soil'][key] * scale:.{digits}f} {unit}".strip()
            for key, (label, unit, scale, digits) in _UNITS.items()
        ]
        speeds, steady = fit["by_speed"], np.array(fit["driven"]["steady"], dtype=bool)
        apart = np.ptp(np.array(list(speeds.values()))[:, steady], axis=0)
        halves = ", ".join(_degrees(half(found["slopes"], slip)) for slip in fit["variants"])
        lines.append(
            f"- fitted to {name}: {', '.join(values)}. It slips 50 % at {_degrees(fit['half'])} deg, on the variants "
            f"of the rover at {halves} deg; with wheels at {' to '.join((min(speeds), max(speeds)))} m/s slip where it "
            f"drives steadily is the same to {_percent(np.median(apart))} points (median; at most "
            f"{_percent(apart.max())})."
        )
    return "\n".join(lines)


def _of_fits(found: dict) -> Table:
    """Errors of the fits on what they were fitted to and on what they were not."""
    rows = []
    for name, fit in found["fits"].items():
        for other, of in fit["measured"].items():
            points = found["points"][other]
            errors = ", ".join(f"{100 * (a - b):+.0f}" for a, b in zip(of["slip"], points["slip"], strict=True))
            what = "fitted" if other == name else "not seen" if not _overlap(name, other) else "partly fitted"
            between = found["between"].get(f"{name} for {other}")
            own = "" if between is None else _percent(between)
            rows.append((name, other, what, _percent(of["rms"]), _percent(of["rms_early"]), own, errors))
    head = (
        "fitted to", "judged on", "", "rms of slip", "the same, over the first 2 m of the rims",
        "one campaign itself for the other", "ours less theirs, by slope",
    )  # fmt: skip
    return Table(head, rows)


def _alternatives(found: dict) -> list[str]:
    """Other contact laws, each with the best of its own soils."""
    if not found["alternatives"]:
        return []
    first, sets = next(iter(found["fits"])), _main_sets(found)
    rows = [(label, *(_percent(one["rms"][name]) for name in sets)) for label, one in found["alternatives"].items()]
    head = ("contact", *(f"rms of slip, {name}" for name in sets))
    return [Table(head, rows, f"The best of the drawn soils for {first}, not refined.").markdown()]


def _pulls(found: dict) -> str:
    """Pull over load at a few slips: what the points ask for, and what one wheel gives on the fitted soils."""
    columns = {f"theirs, {name}": found["points"][name]["pull"] for name in _main_sets(found)}
    columns |= {f"ours, fitted to {name}": fit["pull"] for name, fit in found["fits"].items()}
    rows = [
        (_percent(slip, 0), *("" if values[i] is None else f"{values[i]:.2f}" for values in columns.values()))
        for i, slip in enumerate(found["pull_slips"])
    ]
    caption = "Theirs: tan of the slope at which a slip was measured, between the points; ours: one wheel, fresh soil."
    return Table(("slip [%]", *columns), rows, caption).markdown()


def _overlap(name: str, other: str) -> bool:
    """Whether a set is the whole that another is a part of."""
    return name.startswith(f"{other},")


def _drive_table(found: dict, name: str) -> Table:
    """What the rover does on the fitted soil."""
    fit, rows = found["fits"][name], []
    d = fit["driven"]
    for i, slope in enumerate(found["slopes"]):
        front, rear = d["load"][i]
        sunk = [1e3 * (a + b) for a, b in zip(d["sinkage"][i], d["rut"][i], strict=True)]
        rows.append(
            (
                f"{slope:g}", *(_percent(s) for s in d["axle_slip"][i]), _percent(d["slip"][i]),
                _percent(d["early"][i]), _percent(fit["one_wheel"][i]), _percent(fit["two_wheels"][i]),
                f"{front:.0f}, {rear:.0f}", f"{sunk[0]:.1f}, {sunk[1]:.1f}", "yes" if d["steady"][i] else "no",
            )
        )  # fmt: skip
    head = (
        "slope [deg]", "slip, front [%]", "rear [%]", "mean [%]", "over the first 2 m of the rims [%]", "one wheel [%]",
        "two wheels, fresh soil [%]", "load, front, rear [N]", "below the surface, front, rear [mm]", "steady",
    )  # fmt: skip
    return Table(head, rows, f"On the soil fitted to {name}.")


# --- the figure -------------------------------------------------------------------------------------------------------


def figure(rovers: dict[str, dict], path: Path) -> None:
    """Slip over the slope, loads and sinkages of each rover."""
    plt.rcParams |= {"svg.hashsalt": "rover_slopes", "svg.fonttype": "none"}
    fig, axes = plt.subplots(2, len(rovers), figsize=(11, 7.5), height_ratios=(2, 1), squeeze=False)
    for (top, bottom), (name, found) in zip(axes.T, rovers.items(), strict=True):
        _slips(top, name, found)
        _loads(bottom, found)
    for axis in axes.flat:
        axis.spines[["top", "right"]].set_visible(False)
    fig.tight_layout()
    save_figure(fig, path, metadata={"Date": None})
    plt.close(fig)


def _slips(axis, name: str, found: dict) -> None:
    b, slopes = found["band"], np.array(found["slopes"])
    for slip in b["slips"]:
        axis.plot(slopes, slip, color="#bbbbbb", linewidth=0.4, zorder=1)
    axis.fill_between(slopes, b["low"], b["high"], color="#56b4e9", alpha=0.3, label="ours, 5 to 95 % of drawn soils")
    axis.plot(slopes, b["median"], color="#56b4e9", label="ours, median")
    for colour, mark, one in zip(_COLOURS, _MARKS, _main_sets(found), strict=False):
        points = found["points"][one]
        line = "-" if "m/s" in one else "none"
        axis.plot(
            points["slope"], points["slip"], color=colour, marker=mark, linestyle=line, markersize=5, zorder=5,
            label=f"theirs, {one}",
        )  # fmt: skip
    first, fit = next(iter(found["fits"].items()))
    axis.plot(slopes, fit["driven"]["slip"], "k-", label=f"ours, fitted to {first}")
    axis.plot(slopes, fit["one_wheel"], "k:", label="the same soil, one wheel")
    axis.set(xlabel="slope [deg]", ylabel="slip [-]", ylim=(-0.08, 1.02), title=name.upper())
    axis.legend(fontsize=7.5, frameon=False, loc="upper left")


def _loads(axis, found: dict) -> None:
    fit = next(iter(found["fits"].values()))
    d, slopes = fit["driven"], found["slopes"]
    load, sunk = np.array(d["load"]), 1e3 * (np.array(d["sinkage"]) + np.array(d["rut"]))
    right = axis.twinx()
    for i, (label, colour) in enumerate((("front", "#0072b2"), ("rear", "#d55e00"))):
        axis.plot(slopes, load[:, i], color=colour, label=f"load, {label}")
        right.plot(slopes, sunk[:, i], color=colour, linestyle="--", label=f"sinkage, {label}")
    axis.set(xlabel="slope [deg]", ylabel="load on a wheel [N]")
    right.set(ylabel="below the surface [mm]")
    right.spines["top"].set_visible(False)
    lines = [*axis.get_lines(), *right.get_lines()]
    axis.legend(lines, [line.get_label() for line in lines], fontsize=7.5, frameon=False, loc="upper left")
