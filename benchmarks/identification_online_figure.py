"""The figure of `identification_online.py`: error against distance since the last border, and calibration."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.identification_contenders import PARAMETERS
from soil_env._io.files import save_figure

_COLOURS = {"ours": "#0072b2", "library": "#1f3a8a", "window": "#e69f00", "newton_raphson": "#d55e00",
            "linear": "#999999", "ekf_joint": "#8c6d1f", "ukf": "#009e73", "ukf_joint": "#56b4e9", "batch": "#cc79a7",
            "batch_joint": "#000000"}  # fmt: skip
_LABELS = {
    "ours": "filter bank", "library": "filter bank, told the library", "window": "moving window",
    "newton_raphson": "Newton-Raphson, 3 points", "linear": "linear least squares (c, phi)",
    "ekf_joint": "extended Kalman filter, 5 unknowns", "ukf": "unscented Kalman filter, 3 unknowns",
    "ukf_joint": "unscented Kalman filter, 5 unknowns", "batch": "scipy on the window, 3 unknowns",
    "batch_joint": "scipy on the window, 5 unknowns",
}  # fmt: skip
_AXES = {"phi_deg": "friction angle [deg]", "ln_K": "ln K [-]", "ln_S": "ln S [-]"}


def figure(result: dict, path: Path | str) -> None:
    """Error against distance since the last border, coverage of the reported intervals, and time a reading."""
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(2, 3, figsize=(13, 8.0))
    names = sorted(result["contenders"], key=lambda n: n == "ours")  # on top
    for axis, parameter in zip(axes[0], PARAMETERS, strict=True):
        _errors(axis, result, names, parameter)
    known = {}
    for axis in axes[0, :2]:
        known |= dict(zip(*axis.get_legend_handles_labels()[::-1], strict=True))
    fig.legend(known.values(), known.keys(), loc="lower center", ncol=4, fontsize=9, frameon=False)
    for axis, level in zip(axes[1, :2], ("68", "95"), strict=True):
        _coverage(axis, result, names, level)
    _times(axes[1, 2], result, names)
    for axis in axes.flat:
        axis.spines[["top", "right"]].set_visible(False)
    fig.suptitle(
        f"Online identifiers on {result['courses']} courses of scenario {result['scenario']!r}; "
        "bars and bands: 95 % intervals over courses"
    )
    fig.tight_layout(rect=(0, 0.1, 1, 1))
    save_figure(fig, path, dpi=120)
    plt.close(fig)


def _errors(axis, result: dict, names: list[str], parameter: str) -> None:
    """RMS error of one parameter against the distance since the last border."""
    edges = np.array(result["bins_m"])
    middle = 0.5 * (edges[1:] + edges[:-1])
    top, bottom = 0.0, result["prior_rms"][parameter]
    for name in names:
        curve = result["contenders"][name]["curve"][parameter]
        if curve is None:
            continue
        value, low, high = (np.array(curve[key], dtype=float) for key in ("value", "low", "high"))
        style = "--" if name.startswith("batch") else "-"
        axis.plot(middle, value, style, marker="o", ms=3, color=_COLOURS[name], label=_LABELS[name])
        axis.fill_between(middle, low, high, color=_COLOURS[name], alpha=0.15, lw=0)
        top, bottom = max(top, np.nanmax(value)), min(bottom, np.nanmin(value))
    axis.axhline(result["prior_rms"][parameter], color="k", ls=":", lw=1, label="prior alone")
    axis.set_yscale("log")
    ticks = [t for t in (0.1, 0.2, 0.3, 0.5, 1, 2, 3, 5, 10, 20, 30, 50) if 0.7 * bottom < t < 1.5 * top]
    axis.set_yticks(ticks, [f"{t:g}" for t in ticks])
    axis.minorticks_off()
    axis.set_ylim(0.7 * bottom, 1.5 * top)
    axis.set_xlabel("distance since the last border [m]")
    axis.set_ylabel(f"RMS error of {_AXES[parameter]}")
    axis.grid(alpha=0.3)


def _coverage(axis, result: dict, names: list[str], level: str) -> None:
    """Share of the valid estimates whose interval of this level holds the truth."""
    for i, name in enumerate(names):
        for j, c in enumerate(result["contenders"][name]["coverage"][level][p] for p in PARAMETERS):
            if c is None or c["value"] is None:
                continue
            x = j + (i - 0.5 * (len(names) - 1)) * 0.8 / len(names)
            axis.bar(x, 100.0 * c["value"], 0.7 / len(names), color=_COLOURS[name])
            if c["low"] is not None:  # None where draws of courses have no valid estimate
                axis.plot([x, x], [100.0 * c["low"], 100.0 * c["high"]], color="k", lw=1)
    axis.axhline(float(level), color="k", ls=":", lw=1)
    axis.set_xticks(range(3), ["phi", "ln K", "ln S"])
    axis.set_ylim(0, 100)
    axis.set_ylabel(f"truth within {level} % interval [% of valid]")


def _times(axis, result: dict, names: list[str]) -> None:
    """Time a reading of each contender."""
    times = result["time"]["us_per_reading"]
    for i, name in enumerate(names):
        axis.barh(i, times[name], color=_COLOURS[name])
        share = result["contenders"][name]["valid_share"]["value"]
        words = f" {_LABELS[name]}: {times[name]:.1f} us, valid {100.0 * share:.0f} %"
        axis.text(times[name], i, words, va="center", fontsize=7)
    axis.set_yticks([])
    axis.set_xscale("log")
    axis.set_xlim(0.5 * min(times[n] for n in names), 1e5 * max(times[n] for n in names))
    axis.set_xlabel("time a reading [us] (soil_env's three compiled)")
