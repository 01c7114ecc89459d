"""Figures of a run: the comparison of controllers, and one course in detail."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from soil_env._io.files import replace_file, save_figure
from soil_env.parameters import Scenario
from soil_env.simulation.task import Cause
from soil_env.simulation.world.terrain import ground_at
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.steady import sinkage_coefficient_at

from .evaluate import drive
from .evaluate.comparing import ORACLE, limit_rows
from .evaluate.tables import draw_metrics, png

_PANELS = ("immobilised", "time_limit", "finished", "speed", "energy_per_metre", "slip", "return")


def comparison_figure(result: dict, path: Path) -> None:
    """Draw the metrics of all controllers as points with their 95 % intervals."""
    title = f"{result['courses']} held-out courses of {result['scenario']!r}; bars: 95 % intervals"
    figure = draw_metrics({title: result["controllers"] | limit_rows(result)}, _PANELS, _colour)
    replace_file(path, png(figure))


def _colour(name: str) -> str:
    if name.startswith("ppo"):
        return "#d55e00"
    return "#777777" if name.endswith("true") or name.startswith(ORACLE) else "#0072b2"


def trace(
    controller, scenario: Scenario, seed: int, course: int, model: WheelSoilModel | None = None
) -> tuple[dict[str, np.ndarray], str]:
    """One course driven by `controller`: arrays over time, and the cause of its end."""
    rows = []
    for w, _ in drive(controller, scenario, seed, course, 1, threads=1, model=model, warnings=True):
        s = {name: float(w.state[name][0]) for name in ("x", "slip", "sinkage", "bearing_sinkage")}
        soil, grade, _ = ground_at(w.courses, 0, s["x"], 0, scenario.course.border)
        same = sinkage_coefficient_at(soil, scenario.belief.sinkage_exponent, s["bearing_sinkage"])
        rows.append(
            (s["x"], s["slip"], 1000.0 * s["sinkage"], math.degrees(grade), math.degrees(math.atan(soil.tan_phi)),
             1000.0 * soil.shear_modulus, same, *w.ids.estimate[0, :3], *w.ids.sd[0, :3])
        )  # fmt: skip
    names = ("x", "slip", "sinkage", "grade", "phi", "K", "S", "e_phi", "e_K", "e_S", "sd_phi", "sd_K", "sd_S")
    columns = {name: np.array(column) for name, column in zip(names, np.array(rows).T, strict=True)}
    columns["t"] = scenario.control.period * np.arange(1, len(rows) + 1)
    return columns, Cause(w.cause[0]).name


def course_figure(
    scenario: Scenario, seed: int, course: int, controllers: dict, path: Path, model: WheelSoilModel | None = None
) -> None:
    """One course, a column a controller: grade, slip, sinkage, and phi, K, S as identified against the truth."""
    figure, axes = plt.subplots(6, len(controllers), figsize=(6.5 * len(controllers), 12), sharex="col", squeeze=False)
    for a, (name, controller) in zip(axes.T, controllers.items(), strict=True):
        d, cause = trace(controller, scenario, seed, course, model)
        a[0].set_title(f"{name}: {cause.lower().replace('_', ' ')} after {d['t'][-1]:.0f} s, {d['x'].max():.1f} m")
        for axis, key, label in zip(
            a, ("grade", "slip", "sinkage"), ("grade [deg]", "slip [-]", "sinkage [mm]"), strict=False
        ):
            axis.plot(d["t"], d[key], color="#333333", lw=1)
            axis.set_ylabel(label)
        phi, sd = np.degrees(d["e_phi"]), np.degrees(d["sd_phi"])
        _estimate(a[3], d["t"], d["phi"], phi, (phi - sd, phi + sd), "friction angle [deg]")
        for axis, key, scale, label in ((a[4], "K", 1000.0, "K [mm]"), (a[5], "S", 1.0, "S [N/m$^{n+2}$]")):
            value, factor = scale * np.exp(d[f"e_{key}"]), np.exp(d[f"sd_{key}"])
            _estimate(axis, d["t"], d[key], value, (value / factor, value * factor), label)
            axis.set_yscale("log")
        a[5].set_xlabel("time [s]")
        a[3].legend(loc="upper right", fontsize=8)
        for axis in a:
            axis.grid(alpha=0.3)
    figure.suptitle(f"Held-out course {course} of scenario {scenario.name!r}")
    figure.tight_layout()
    save_figure(figure, path, dpi=110)
    plt.close(figure)


def _estimate(axis, t, truth, value, bounds, label) -> None:
    axis.fill_between(t, *bounds, color="#0072b2", alpha=0.2, lw=0)
    axis.plot(t, value, color="#0072b2", lw=1, label="identified, 1 sd")
    axis.plot(t, truth, color="#d55e00", lw=1, label="true")
    axis.set_ylabel(label)
