"""Blind cases for the discrepancy workflow: a random soil, wheel and test plan, hidden effects, noise and priors.

`draw_case` draws one, `write_case` writes what the workflow may read (data.csv, setup.yaml) and, in another folder, the
truth. The column `load` is the vertical load (weight) on the wheel, on a grade too; `sinkage` is below the surface in
front of the wheel; `drawbar_pull` is the net forward force on the axle, where a grade effect is hidden less the weight
component; where none is hidden the rig has already taken it off. Commands:

    python -m benchmarks.blind_cases --seed 0 --count 20 --kind one --design rich --out DIR
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from benchmarks.blind_effect import Form, Hidden
from benchmarks.blind_forms import EFFECTS, FORMS, forms_of
from benchmarks.blind_limits import SOIL, Bench, detection_limit, gap, imitation_gap, noncentrality
from benchmarks.blind_unlisted import UNLISTED
from benchmarks.blind_world import Ground, Rows, Wheel, predict

KINDS = ("none", "one", "two", "unlisted")
DESIGNS = ("rich", "poor")
NOISES = ("given", "repeats", "absent")
PRIOR_ERRORS = ("normal", "2sd", "none")
CHANNELS = ("sinkage", "drawbar_pull", "torque")
MULTIPLES = (2.0, 8.0)
ATTEMPTS = 60


# friction angle [deg], cohesion [Pa], K [m], n [-], mean pressure W/(b r) [Pa]: ranges
SOILS = {
    "dry sand": ((28, 38), (50, 500), (0.008, 0.025), (0.7, 1.1), (2500, 6000)),
    "lunar simulant": ((32, 40), (150, 1200), (0.01, 0.03), (0.8, 1.3), (2500, 6000)),
    "sandy loam": ((25, 33), (1000, 3500), (0.01, 0.04), (0.5, 0.9), (4000, 10000)),
    "clayey loam": ((22, 28), (2500, 5000), (0.005, 0.03), (0.5, 0.8), (7000, 14000)),
}


@dataclass(frozen=True, eq=False)
class Case:
    """One blind case; `setup` and the columns are what the workflow may see, `truth` is not."""

    columns: dict[str, list]  # of data.csv
    setup: dict  # setup.yaml
    truth: dict  # truth.json
    clean: np.ndarray  # noise-free table [3, N]
    bench: Bench
    effects: tuple[Hidden, ...]


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
    multiple: tuple[float, float] = MULTIPLES  # of the detection limit, drawn log-uniformly

    def __post_init__(self):
        for value, known in (
            (self.kind, KINDS),
            (self.design, DESIGNS),
            (self.noise, NOISES),
            (self.prior_error, PRIOR_ERRORS),
        ):
            if value not in known:
                raise ValueError(f"{value!r}: expected one of {', '.join(known)}")
        known = [f.effect for f in (UNLISTED if self.kind == "unlisted" else FORMS)]
        for name in self.names:
            if name not in known:
                raise ValueError(f"effect {name!r}: expected one of {', '.join(dict.fromkeys(known))}")


def draw_case(rng: np.random.Generator, kind: str = "one", design: str = "rich", **options) -> Case:
    """One case; keywords as in `Options`. Raises `RuntimeError` if no detectable one is found for the effects named."""
    want = Options(kind, design, **options)
    for attempt in range(ATTEMPTS):
        if attempt % 6 == 0:  # then other effects, if they are not given: not every one can be seen in every design
            forms = _draw_forms(rng, want)
        bench, runs, soil = _draw_bench(rng, want)
        found = _draw_effects(rng, bench, forms, want)
        if found is not None:
            return _measure(rng, bench, runs, soil, *found, want)
    raise RuntimeError(f"no detectable case of {', '.join(f.name for f in forms)} in {ATTEMPTS} attempts")


# --- the effects ------------------------------------------------------------------------------------------------------


def _draw_forms(rng, want: Options) -> list[Form]:
    if want.kind == "none":
        return []

    def one_of(forms):
        forms = [f for f in forms if not want.forms or f.name in want.forms] or forms
        return forms[rng.integers(len(forms))]

    count = 2 if want.kind == "two" else 1
    pool = [f.effect for f in UNLISTED] if want.kind == "unlisted" else EFFECTS
    names = list(want.names)
    while len(names) < count:
        name = pool[rng.integers(len(pool))]
        if name not in names:
            names.append(name)
    return [one_of([f for f in UNLISTED if f.effect == n] if want.kind == "unlisted" else forms_of(n)) for n in names]


def _draw_effects(rng, bench: Bench, forms: list[Form], want: Options):
    """(effects, limits, imitation), or None if one is not detectable or the wheel does not get through."""
    context = bench.context
    hidden = [Hidden(f, float(f.signs[rng.integers(len(f.signs))]), f.side(rng, context)) for f in forms]
    limits: list[float] = []
    for k, effect in enumerate(hidden):
        limit = detection_limit(bench, effect, hidden[:k])
        if limit is None:
            return None
        strength = _strength(rng, bench, effect.form, limit, want)
        if strength is None:
            return None
        hidden[k] = effect.at(np.sign(effect.strength) * strength)
        limits.append(limit)
    if len(hidden) == 2:
        limit = detection_limit(bench, hidden[0], hidden[1:])
        if limit is None or (strength := max(abs(hidden[0].strength), want.multiple[0] * limit)) > hidden[0].form.cap(
            context
        ):
            return None
        limits[0], hidden[0] = limit, hidden[0].at(np.sign(hidden[0].strength) * strength)
    table = bench.truth(hidden)
    if not np.all(np.isfinite(table)) or np.max(table[0]) > 0.7 * bench.wheel.radius:
        return None
    if len(hidden) == 2 and want.multiple[0] >= 2.0:
        for k, effect in enumerate(hidden):
            if gap(bench, table, [hidden[1 - k]]) < 4.0 * 0.9 * noncentrality(effect.form.freedom):
                return None
    imitation = imitation_gap(bench, hidden, rng) if hidden else {}
    if want.kind == "unlisted" and want.multiple[0] >= 2.0 and imitation["two"][0] < 4.0 * noncentrality(2):
        return None
    return tuple(hidden), tuple(limits), imitation


def _strength(rng, bench: Bench, form: Form, limit: float, want: Options) -> float | None:
    """Strength drawn log-uniformly between multiples of the limit, or None if the least is beyond the cap."""
    cap = form.cap(bench.context)
    low, high = (m * limit for m in want.multiple)
    if form.scales_grade and want.multiple == MULTIPLES:
        high = cap  # the weight component is never small on a real slope
    low, high = max(low, form.floor), min(max(high, form.floor), cap)
    return None if low > cap else float(np.exp(rng.uniform(np.log(low), np.log(max(high, low)))))


# --- soil, wheel, test plan -------------------------------------------------------------------------------------------


def _draw_bench(rng, want: Options) -> tuple[Bench, list[str], str]:
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
        ground = replace(ground, sinkage_coefficient=_stiffness(wheel, ground, mean_load, rng.uniform(0.07, 0.2)))
        z = predict(ground, wheel, rows).sinkage / radius
        if np.all(np.isfinite(z)) and z.min() >= 0.03 and z.max() <= 0.35:
            break
    level = np.exp(rng.uniform(np.log(0.6), np.log(1.6), 2))
    noise = (
        float(radius * np.exp(rng.uniform(np.log(0.004), np.log(0.012)))),
        float(0.01 * mean_load * level[0]),
        float(0.01 * mean_load * radius * level[1]),
    )
    sd = {
        "friction_angle_deg": 1.5,
        "cohesion": max(0.2 * ground.cohesion, 30.0),
        "shear_modulus": 0.2 * ground.shear_modulus,
        "sinkage_coefficient": 0.12 * ground.sinkage_coefficient,
        "sinkage_exponent": 0.025,
    }
    grade = float(np.round(np.exp(rng.uniform(np.log(0.5), np.log(12.0))), 1))
    return Bench(wheel, ground, rows, grade, noise, sd), runs, soil


def _stiffness(wheel: Wheel, ground: Ground, load: float, depth: float) -> float:
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


# --- measuring and writing --------------------------------------------------------------------------------------------


def _measure(rng, bench: Bench, runs, soil: str, effects, limits, imitation, want: Options) -> Case:
    clean = bench.truth(effects)
    if not np.all(np.isfinite(clean)):
        raise RuntimeError("the hidden world has no steady state in some row")
    noise = np.array(bench.noise)[:, None]
    measured = clean + noise * rng.standard_normal(clean.shape)
    wrong = np.zeros(clean.shape, bool)
    if want.outliers:
        wrong = rng.random(clean.shape) < 0.02
        gross = rng.uniform(5.0, 15.0, clean.shape) * rng.choice((-1.0, 1.0), clean.shape)
        measured = np.where(wrong, clean + noise * gross, measured)
    conditions = bench.conditions(effects)
    columns = {
        "run": runs,
        "time": conditions.time.tolist(),
        "slip": conditions.slip.tolist(),
        "load": conditions.load.tolist(),
        "speed": conditions.speed.tolist(),
        "pass": [int(p) for p in conditions.passes],
    }
    if want.design == "rich":
        columns["grade_deg"] = [float(np.round(g, 4)) for g in conditions.grade_deg]
    columns |= {name: [float(f"{v:.6g}") for v in row] for name, row in zip(CHANNELS, measured, strict=True)}
    setup = {
        "wheel": {"radius": bench.wheel.radius, "width": bench.wheel.width},
        "soil": _priors(rng, bench, want.prior_error) | {"density": bench.ground.density},
    }
    if want.noise == "given":
        setup["noise"] = {name: float(f"{s:.3g}") for name, s in zip(CHANNELS, bench.noise, strict=True)}
    truth = {
        "kind": want.kind,
        "design": want.design,
        "noise": want.noise,
        "prior_error": want.prior_error,
        "outliers": int(wrong.sum()),
        "soil_type": soil,
        "soil": asdict(bench.ground),
        "noise_levels": dict(zip(CHANNELS, bench.noise, strict=True)),
        "effects": [
            {
                "name": e.form.effect,
                "form": e.form.name,
                "strength": e.strength,
                "unit": e.form.strength,
                "side": e.side,
                "limit": limit,
                "multiple": abs(e.strength) / limit,
                "cap": e.form.cap(bench.context),
                "channels": list(e.form.channels),
                "source": e.form.source,
            }
            for e, limit in zip(effects, limits, strict=True)
        ],
        "imitation": imitation,
    }
    return Case(columns, setup, truth, clean, bench, effects)


def _priors(rng, bench: Bench, error: str) -> dict:
    """Prior of each soil parameter, its value off the truth by its sd times N(0, 1), or by 2 sd either way."""
    out = {}
    for name in SOIL:
        true, sd = getattr(bench.ground, name), bench.prior_sd[name]
        value = -1.0
        while value <= 0.02 * true:
            off = {"normal": rng.standard_normal(), "2sd": rng.choice((-2.0, 2.0)), "none": 0.0}[error]
            value = true + sd * off
        out[name] = {"value": float(f"{value:.6g}"), "sd": float(f"{sd:.3g}")}
    return out


def write_case(case: Case, folder: Path, truth_file: Path) -> None:
    """data.csv and setup.yaml in `folder`, the truth in another place."""
    folder.mkdir(parents=True, exist_ok=True)
    truth_file.parent.mkdir(parents=True, exist_ok=True)
    with (folder / "data.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(case.columns)
        writer.writerows(zip(*case.columns.values(), strict=True))
    (folder / "setup.yaml").write_text(yaml.safe_dump(case.setup, sort_keys=False), encoding="utf-8")
    truth_file.write_text(json.dumps(case.truth, indent=1), encoding="utf-8")


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind_cases", description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--kind", choices=KINDS, default="one")
    parser.add_argument("--design", choices=DESIGNS, default="rich")
    parser.add_argument("--noise", choices=NOISES, default="given")
    parser.add_argument("--prior-error", choices=PRIOR_ERRORS, default="normal")
    parser.add_argument("--outliers", action="store_true", help="2 %% of the cells off by 5 to 15 sigma")
    parser.add_argument("--effect", action="append", default=[], help="effect to hide (twice for two), else drawn")
    parser.add_argument("--multiple", type=float, nargs=2, default=MULTIPLES, metavar=("LOW", "HIGH"))
    parser.add_argument("--out", type=Path, required=True)
    a = parser.parse_args(arguments)
    for number in range(a.count):
        rng = np.random.default_rng([a.seed, number])
        try:
            case = draw_case(
                rng,
                a.kind,
                a.design,
                names=tuple(a.effect),
                noise=a.noise,
                prior_error=a.prior_error,
                outliers=a.outliers,
                multiple=tuple(a.multiple),
            )
        except (ValueError, RuntimeError) as error:
            print(f"blind_cases: {error}", file=sys.stderr)
            return 2
        write_case(case, a.out / "cases" / f"{number:04d}", a.out / "truth" / f"{number:04d}.json")
        names = ", ".join(f"{e['name']} ({e['form']}, {e['multiple']:.1f}x)" for e in case.truth["effects"])
        print(f"{number:04d} {a.kind} {a.design}: {names or 'no effect'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
