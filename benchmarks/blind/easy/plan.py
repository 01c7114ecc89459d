"""Soil, wheel and test plan of a blind case, and what is asked of one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.blind.easy.forms import FORMS
from benchmarks.blind.easy.limits import Bench
from benchmarks.blind.easy.unlisted import UNLISTED
from benchmarks.blind.world import Ground, Rows, Wheel, predict

KINDS = ("none", "one", "two", "unlisted")
DESIGNS = ("rich", "poor")
NOISES = ("given", "repeats", "absent")
PRIOR_ERRORS = ("normal", "2sd", "none")
SCALES = ("detection", "naming")
MULTIPLES = (2.0, 8.0)
PRIOR_SD = {  # standard deviation of a prior from its value
    "friction_angle_deg": lambda value: 1.5,
    "cohesion": lambda value: max(0.2 * value, 30.0),
    "shear_modulus": lambda value: 0.2 * value,
    "sinkage_coefficient": lambda value: 0.12 * value,
    "sinkage_exponent": lambda value: 0.025,
}

# friction angle [deg], cohesion [Pa], K [m], n [-], mean pressure W/(b r) [Pa]: ranges
SOILS = {
    "dry sand": ((28, 38), (50, 500), (0.008, 0.025), (0.7, 1.1), (2500, 6000)),
    "lunar simulant": ((32, 40), (150, 1200), (0.01, 0.03), (0.8, 1.3), (2500, 6000)),
    "sandy loam": ((25, 33), (1000, 3500), (0.01, 0.04), (0.5, 0.9), (4000, 10000)),
    "clayey loam": ((22, 28), (2500, 5000), (0.005, 0.03), (0.5, 0.8), (7000, 14000)),
}


@dataclass(frozen=True)
class Options:
    """What a case is to be like."""

    kind: str = "one"
    design: str = "rich"
    names: tuple[str, ...] = ()  # effects, else drawn
    forms: tuple[str, ...] = ()  # only these forms, else all
    noise: str = "given"
    prior_error: str = "normal"
    outliers: bool = False
    multiple: tuple[float, float] = MULTIPLES  # of the limit, drawn log-uniformly; high may be inf: up to the cap
    scale: str = "detection"  # limit against the model without it; "naming": against the best other listed effect too

    def __post_init__(self):
        for value, known in (
            (self.kind, KINDS),
            (self.design, DESIGNS),
            (self.noise, NOISES),
            (self.prior_error, PRIOR_ERRORS),
            (self.scale, SCALES),
        ):
            if value not in known:
                raise ValueError(f"{value!r}: expected one of {', '.join(known)}")
        low, high = self.multiple
        if not 0.0 < low <= high:
            raise ValueError(f"multiple {low:g} {high:g}: expected 0 < low <= high")
        known = [f.effect for f in (UNLISTED if self.kind == "unlisted" else FORMS)]
        for name in self.names:
            if name not in known:
                raise ValueError(f"effect {name!r}: expected one of {', '.join(dict.fromkeys(known))}")


def draw_bench(rng, want: Options) -> tuple[Bench, list[str], str]:
    """Wheel, soil and plan whose base sinkage is 0.03 to 0.35 r everywhere."""
    while True:
        soil = list(SOILS)[rng.integers(len(SOILS))]
        phi, c, k, n, pressure = (float(rng.uniform(*span)) for span in SOILS[soil])
        radius = float(np.round(np.exp(rng.uniform(np.log(0.08), np.log(0.35))), 3))
        width = float(np.round(np.clip(radius * rng.uniform(0.5, 1.1), 0.06, 0.25), 3))
        wheel = Wheel(radius, width)
        mean_load = pressure * radius * width
        rows, runs = _plan(rng, want, mean_load)
        ground = Ground(phi, c, k, 1.0, n, float(np.round(rng.uniform(1300, 1800))))
        ground = replace(ground, sinkage_coefficient=stiffness_for(wheel, ground, mean_load, rng.uniform(0.07, 0.2)))
        z = predict(ground, wheel, rows).sinkage / radius
        if np.all(np.isfinite(z)) and z.min() >= 0.03 and z.max() <= 0.35:
            break
    level = np.exp(rng.uniform(np.log(0.6), np.log(1.6), 2))
    noise = (
        float(radius * np.exp(rng.uniform(np.log(0.004), np.log(0.012)))),
        float(0.01 * mean_load * level[0]),
        float(0.01 * mean_load * radius * level[1]),
    )
    sd = {name: rule(getattr(ground, name)) for name, rule in PRIOR_SD.items()}
    grade = float(np.round(np.exp(rng.uniform(np.log(0.5), np.log(12.0))), 1))
    return Bench(wheel, ground, rows, grade, noise, sd), runs, soil


def stiffness_for(wheel: Wheel, ground: Ground, load: float, depth: float) -> float:
    """S [N/m^(n+2)] that lets the wheel sink `depth` radii at the load and slip 0.3."""
    one = np.ones(1)
    rows = Rows(0.3 * one, load * one, one, one, 0.0 * one, one)
    s = load / (wheel.width * wheel.radius * (depth * wheel.radius) ** ground.sinkage_exponent)
    for _ in range(30):
        z = predict(replace(ground, sinkage_coefficient=s), wheel, rows).sinkage[0] / wheel.radius
        if not np.isfinite(z):
            s *= 3.0
            continue
        s *= (z / depth) ** (ground.sinkage_exponent + 0.5)
        if abs(z / depth - 1.0) < 1e-3:
            break
    return float(s)


def _plan(rng, want: Options, mean_load: float) -> tuple[Rows, list[str]]:
    """Conditions and run labels; grades as a pattern in [-1, 1].

    Rich: 3 loads x 3 speeds x 3 passes x 6 slips, a run being one load, speed and pass; the grade follows a Latin
    square of load and speed. For noise from repeats: 9 runs in a Graeco-Latin square, each 3 times at the same slips.
    Poor: one load, speed and pass, 6 to 9 slips, 3 times.
    """
    spread = rng.uniform(2.0, 3.0)
    loads = np.round(mean_load * spread ** np.array([-0.5, 0.0, 0.5]), 1)
    slowest, range_ = np.exp(rng.uniform(np.log(0.01), np.log(0.1))), rng.uniform(5.0, 10.0)
    speeds = np.round(slowest * range_ ** np.array([0.0, 0.5, 1.0]), 4)
    pattern = np.array(((-1.0, 0.0, 1.0), (0.0, 0.5, 1.0))[rng.integers(2)])
    top = rng.uniform(0.5, 0.65)
    if want.design == "poor":
        slips, speed = np.linspace(0.05, top, int(rng.integers(6, 10))), speeds[rng.integers(3)]
        blocks = [(loads[1], speed, 1, 0.0, repeat) for repeat in range(3)]
    else:
        slips = np.linspace(0.05, top, 6)
        order = [(i, j) for i in range(3) for j in range(3)]
        rng.shuffle(order)
        blocks = []
        for i, j in order:
            grade = pattern[(i + j) % 3]
            if want.noise == "repeats":
                blocks += [(loads[i], speeds[j], 1 + (i + 2 * j) % 3, grade, repeat) for repeat in range(3)]
            else:
                blocks += [(loads[i], speeds[j], p, grade, 0) for p in (1, 2, 3)]
    repeated = want.design == "poor" or want.noise == "repeats"
    rows, runs, clock, own = [], [], 0.0, slips
    for number, (load, speed, pass_, grade, repeat) in enumerate(blocks, start=1):
        clock += rng.uniform(600, 1800) if pass_ == 1 or repeated else rng.uniform(60, 180)  # preparing the soil
        if repeat == 0:
            own = np.round(slips + rng.uniform(-0.015, 0.015, slips.size), 4)
        for slip in own:
            clock += rng.uniform(30, 90)
            rows.append((slip, load, speed, pass_, grade, np.round(clock)))
            runs.append(f"run{number:02d}")
    return Rows(*np.array(rows).T), runs
