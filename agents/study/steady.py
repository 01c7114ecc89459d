"""The table of a log: its steady points, as the instrument reads them, and the setup with what is known of the bed."""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from soil_env._io.loading import ParameterError
from soil_env.discrepancy.instrument import LEAST_OFFSET
from soil_env.measurement.setup import Calibration, Prior
from soil_env.parameters import Scenario, soils
from soil_env.terramechanics.model import ModelWheel

from ..evaluate.tables import save_csv

if TYPE_CHECKING:
    from .commissioning import Commissioning, Log

CHANNELS = ("sinkage", "drawbar_pull", "torque")
COLUMNS = ("slip", "load", "speed", "run", "time", *CHANNELS)
LEAST_REPEATS = 6  # differences of repeats that the noise is computed from
LEFT = 0.1  # of an error of the instrument that was checked and corrected


@dataclass(frozen=True)
class Steady:
    """One steady point: means of the readings."""

    run: int
    stretch: int
    time: float  # [s] of its end
    mean: dict[str, float]


def steady_points(log: Log, scenario: Scenario, plan: Commissioning) -> list[Steady]:
    """One point a stretch of a drive: the longest row of consecutive windows that are all steady.

    Windows lie end to end, the first beginning after the run-in of the stretch. A window is steady where mean
    acceleration, drift of sinkage and of slip, and scatter of slip are within the limits of the plan, widened by twice
    what the noise of the sensors alone makes of them. Points of less than half the planned time are left out, so that
    all have nearly the same noise.
    """
    size = max(4, round(plan.window / scenario.control.period))
    least = 0.5 * (plan.hold / plan.window)
    out, key = [], log.run * 1000 + log.stretch
    for k in np.unique(key):
        rows = np.flatnonzero((key == k) & log.ran_in)
        windows = [rows[i : i + size] for i in range(0, rows.size - size + 1, size)]
        good = [steady(log, w, scenario, plan) for w in windows]
        steady_ones = itertools.groupby(range(len(windows)), key=lambda w: good[w])
        best = max((list(group) for is_good, group in steady_ones if is_good), key=len, default=[])
        if best and len(best) >= least:
            inside = np.concatenate([windows[w] for w in best])
            last, mean = inside[-1], {n: float(x[inside].mean()) for n, x in log.readings.items()}
            out.append(Steady(int(log.run[last]), int(log.stretch[last]), float(log.time[last]), mean))
    return out


def steady(log: Log, rows: np.ndarray, scenario: Scenario, plan: Commissioning) -> bool:
    """True if the readings in `rows` are those of a steady drive."""
    period, noise, n = scenario.control.period, scenario.noise, rows.size
    t = period * (np.arange(n) - 0.5 * (n - 1))
    slope = {name: float(t @ log.readings[name][rows]) / float(t @ t) for name in ("speed", "sinkage", "slip")}
    by_noise = 2.0 / math.sqrt(float(t @ t))
    speed = float(log.readings["speed"][rows].mean())
    if speed <= 0.0:
        return False
    spread = float(log.readings["slip"][rows].std(ddof=1))
    return (
        abs(slope["speed"]) <= plan.acceleration + by_noise * noise.speed
        and abs(slope["sinkage"]) <= plan.sinkage_drift * speed + by_noise * noise.sinkage
        and abs(slope["slip"]) <= plan.slip_drift * speed + by_noise * noise.slip
        and spread <= math.hypot(plan.slip_spread, noise.slip * (1.0 + 2.0 / math.sqrt(2.0 * n)))
    )


def misread(points: list[Steady], scenario: Scenario, seed: int, checked: tuple[str, ...]) -> list[Steady]:
    """The points as a rig reads them: its errors are drawn from the calibration of a setup that says nothing of it.

    Level, gains and zeros of the sensors of pull and torque, and the rolling radius that slip is computed with. Of the
    checked ones `LEFT` is left.
    """
    sd, rng = Calibration(), np.random.default_rng([seed, 9])
    zero = LEAST_OFFSET * float(np.median([p.mean["load"] for p in points]))
    spread = {"tilt": math.radians(sd.tilt_deg), "force_gain": sd.force_gain, "force_offset": zero,
              "torque_gain": sd.torque_gain, "torque_offset": zero * scenario.wheel.radius,
              "wheel_radius": sd.wheel_radius}  # fmt: skip
    e = {n: (LEFT if n in checked else 1.0) * x * rng.standard_normal() for n, x in spread.items()}

    def read(m: dict[str, float]) -> dict[str, float]:
        pull = (m["drawbar_pull"] - m["load"] * math.sin(e["tilt"])) * (1.0 + e["force_gain"]) + e["force_offset"]
        torque = m["torque"] * (1.0 + e["torque_gain"]) + e["torque_offset"]
        slip = 1.0 - (1.0 - m["slip"]) * (1.0 + e["wheel_radius"])
        return m | {"slip": slip, "drawbar_pull": pull, "torque": torque}

    return [dataclasses.replace(p, mean=read(p.mean)) for p in points]


def write_table(points: list[Steady], path: Path) -> None:
    """Write the measurement table."""
    rows = [
        [{"run": f"{p.run}", "time": f"{p.time:.1f}"}.get(c) or f"{p.mean[c]:.6g}" for c in COLUMNS] for p in points
    ]
    save_csv(path, [COLUMNS, *rows])


def setup(scenario: Scenario, wheel: ModelWheel, plan: Commissioning, points: list[Steady]) -> dict:
    """The mapping of setup.yaml: the wheel, what is known of the bed, and the noise of a point.

    Priors: the preset with the standard deviations of the scenario's belief (K and S relative; n as the scenario
    spreads it). The digging is known, as it is to the identifier. Noise: from repeats (`repeat_noise`).
    """
    preset, belief = soils()[plan.soil], scenario.belief
    width = scenario.wheel.width

    def prior(value, sd):
        return dataclasses.asdict(Prior(float(f"{value:.6g}"), float(f"{sd:.4g}")))

    S = preset.lumped(width)
    return {
        "wheel": {"radius": wheel.radius, "width": wheel.width, "grouser_height": wheel.grouser_height},
        "soil": {
            "friction_angle_deg": prior(preset.friction_angle_deg, belief.friction_sd_deg),
            "cohesion": prior(preset.cohesion, min(belief.cohesion_sd, preset.cohesion)),
            "shear_modulus": prior(preset.shear_modulus, belief.shear_modulus_sd * preset.shear_modulus),
            "sinkage_coefficient": prior(S, belief.sinkage_coefficient_sd * S),
            "sinkage_exponent": prior(preset.sinkage_exponent, scenario.spread.exponent * preset.sinkage_exponent),
            "density": preset.density,
            "dig_gain": preset.dig_gain,
            "dig_recovery": preset.dig_recovery,
        },
        "noise": repeat_noise(plan, points),
        "checked": list(plan.decided),
    }


def repeat_noise(plan: Commissioning, points: list[Steady]) -> dict[str, float]:
    """Standard deviation of a point by channel, from the drives that repeat each other.

    What is given is the upper end of its 68 % interval: a noise that is taken for too small would show as an effect.
    Slip enters the model as if it were exact. So where two repeats differ in slip, what the channel changes with slip
    there, as the neighbouring grades show it, counts as noise of the channel: e = (y1 - y2) - dy/di (i1 - i2), which
    has twice the variance of a point.
    """
    series: dict[tuple[int, int], dict[int, list[Steady]]] = {}
    for p in points:
        condition = p.run // plan.repeats
        payload, grade = divmod(condition, len(plan.grades_deg))
        series.setdefault((payload, p.stretch), {}).setdefault(grade, []).append(p)
    squares: dict[str, list[float]] = {name: [] for name in CHANNELS}
    for grades in series.values():
        repeats = [grades[g] for g in sorted(grades)]
        slip = np.array([np.mean([p.mean["slip"] for p in same]) for same in repeats])
        if slip.size < 2 or not (np.diff(slip) > 0.0).all():
            continue
        for name in CHANNELS:
            slope = np.gradient(np.array([np.mean([p.mean[name] for p in same]) for same in repeats]), slip)
            for d, same in zip(slope, repeats, strict=True):
                left = np.array([p.mean[name] - d * p.mean["slip"] for p in same])
                if left.size > 1:
                    squares[name] += [float(left.var(ddof=1))] * (left.size - 1)
    if min(map(len, squares.values())) < LEAST_REPEATS:
        raise ParameterError(
            f"commissioning: {len(points)} steady points, too few that repeat each other; expected more grades_deg "
            "that the rover can climb, or more repeats"
        )
    upper = {name: math.sqrt(np.sum(values) / chi2.ppf(0.16, len(values))) for name, values in squares.items()}
    return {name: float(f"{value:.3g}") for name, value in upper.items()}
