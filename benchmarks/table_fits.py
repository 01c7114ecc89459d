"""Accuracy of fits to tables: convergence, efficiency, identifiability, coverage of intervals.

    python benchmarks/table_fits.py                    the full study, minutes; writes docs/table_fits.*
    python benchmarks/table_fits.py --smoke --out X    every part in seconds, numbers without meaning
    python benchmarks/table_fits.py --parts coverage   this part anew, the others as docs/table_fits.json has them

Every number of docs/table_fits.md comes from this command; the page says with what options and seed.
"""

from __future__ import annotations

import argparse
import math
import platform
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import soil_env  # noqa: F401  first: from here on Ctrl-C ends the imports in one line

# isort: split
import numpy as np

from benchmarks import table_fits_coverage, table_fits_page
from benchmarks.common import study_parser
from soil_env._io.commands import command_line, leave, whole_number
from soil_env._io.files import check_outputs, make_folder, write_json
from soil_env._io.loading import ParameterError, read_json
from soil_env.identification import Reading, Status, generalized_newton_raphson, predict
from soil_env.identification.point import Points, weigh
from soil_env.parameters import Soil, SoilState, soils
from soil_env.terramechanics.model import steady_state

PAPER = Reading(cohesion=3000.0, exponent=0.47, radius=0.6274, width=0.1524)  # the wheel and sand of the source paper
ROVER = Reading(cohesion=170.0, exponent=1.0, radius=0.15, width=0.15)
ROVER_SD = (1.47, 1.47, 0.22)  # [N], [N], [N m]: 1 % of weight and of weight times radius, as the env's sensors
SLIP_SD, SINKAGE_SD = 0.01, 0.001
IDENTIFIABLE = 100.0  # condition number of the whitened Jacobian by (phi, ln K, ln S) up to which a problem counts


def unknowns(soil: Soil, width: float = 1.0) -> np.ndarray:
    """(phi [rad], ln K, ln S) of a soil under a wheel of this width [m]."""
    return np.array([math.radians(soil.friction_angle_deg), *np.log([soil.shear_modulus, soil.lumped(width)])])


def predictions(x, slip, sinkage, reading):
    """Drawbar pull, load, torque [M, 3] and their Jacobian by x and cohesion [M, 3, 4]."""
    values, jacobians = np.empty((len(slip), 3)), np.empty((len(slip), 3, 4))
    for k, (i, z) in enumerate(zip(slip, sinkage, strict=True)):
        predict(x, i, z, 1.0, reading, values[k], jacobians[k])
    return values, jacobians


def steady_sinkage(x, slip, load, reading) -> np.ndarray:
    """Sinkage [m] at each slip under each load: the points a rig would measure."""
    soil = SoilState(math.tan(x[0]), reading.cohesion, math.exp(x[1]), math.exp(x[2]), reading.exponent, 0.0, 0.5)
    return np.array([steady_state(i, w, soil, reading.radius, reading.width).sinkage for i, w in zip(slip, load)])  # noqa: B905


# --- 1: convergence ---------------------------------------------------------------------------------------------------


def convergence(rng: np.random.Generator, draws: int) -> dict:
    """Noise-free recovery from guesses anywhere in the box of the paper's Table 4, by number of points and channels."""
    low, high = np.array([5.0, 0.015, 7e4]), np.array([89.0, 0.089, 3.1e12])
    out = {}
    for name, points, all_channels in (
        ("drawbar pull, 3 points", 3, False),
        ("drawbar pull, 6 points", 6, False),
        ("drawbar pull, load and torque, 6 points", 6, True),
    ):
        tally = {"identifiable": 0, "drawn": 0, "ambiguous": 0, "recovered": 0, "flagged": 0, "silently_wrong": 0}
        while tally["identifiable"] < draws:
            tally["drawn"] += 1
            # stiffer soil than S = 1e7 does not let the wheel sink
            x = rng.uniform(
                [math.radians(10.0), *np.log(low[1:])], [math.radians(50.0), math.log(high[1]), math.log(1e7)]
            )
            slip, load = rng.uniform(0.03, 0.8, points), 8923.0 * rng.uniform(0.6, 1.4, points)
            sinkage = np.minimum(steady_sinkage(x, slip, load, PAPER), 0.9 * PAPER.radius)
            y, jacobian = predictions(x, slip, sinkage, PAPER)
            sd = (90.0, 90.0, 56.0)  # 1 % of the load, for the weights and the condition number
            white = (jacobian[:, :, :3] / np.array(sd)[None, :, None])[:, : 3 if all_channels else 1].reshape(-1, 3)
            singular = np.linalg.svd(white, compute_uv=False)
            if singular[0] > IDENTIFIABLE * singular[-1]:
                continue
            g = rng.uniform(0.0, 1.0, 3)
            phi, K = low[:2] + g[:2] * (high - low)[:2]
            guess = Soil(
                phi, PAPER.cohesion, K, PAPER.exponent, sinkage_coefficient=low[2] * (high[2] / low[2]) ** g[2]
            )
            channels = y.T if all_channels else (y[:, 0], None, None)
            e = generalized_newton_raphson(slip, sinkage, *channels, reading=PAPER, guess=guess, sd=sd)
            if e.status == Status.AMBIGUOUS and _both_exact(e, slip, sinkage, y[:, 0]):
                tally["ambiguous"] += 1
                continue
            tally["identifiable"] += 1
            right = e.status == Status.CONVERGED and np.max(np.abs(unknowns(e.soil) - x)) < 1e-4
            tally["recovered"] += bool(right)
            tally["flagged"] += e.status != Status.CONVERGED
            tally["silently_wrong"] += e.status == Status.CONVERGED and not right
        out[name] = tally
    return out


def _both_exact(e, slip, sinkage, pull) -> bool:
    """Whether the two soils of an ambiguous estimate differ and both give the drawbar pulls, to 1e-6 of their size."""
    found, other = unknowns(e.soil), unknowns(e.other)
    misfits = [predictions(z, slip, sinkage, PAPER)[0][:, 0] - pull for z in (found, other)]
    return np.max(np.abs(found - other)) > 1e-3 and np.max(np.abs(misfits)) < 1e-6 * np.max(np.abs(pull))


# --- 2: efficiency ----------------------------------------------------------------------------------------------------


def whitened(x, slip, sinkage, reading, sd, slip_sd, sinkage_sd, channels=(True, True, True)):
    """Jacobian by (phi, ln K, ln S, c) of all measured values, whitened [3M, 4]."""
    jacobians = predictions(x, slip, sinkage, reading)[1]
    return (whitening(x, slip, sinkage, reading, sd, slip_sd, sinkage_sd, channels) @ jacobians).reshape(-1, 4)


def whitening(x, slip, sinkage, reading, sd, slip_sd, sinkage_sd, channels):
    """Matrices [M, 3, 3] that whiten the errors of the three channels of each point."""
    points, variances = Points(len(slip)), np.where(channels, np.square(sd), np.inf)
    points["slip"], points["sinkage"], points["dig_ratio"] = slip, sinkage, 1.0
    matrices = np.zeros((len(slip), 3, 3))
    for p in range(len(slip)):
        weigh(points, p, x, variances, slip_sd, sinkage_sd, reading)
        matrices[p][np.tril_indices(3)] = [points[name][p] for name in ("w00", "w10", "w11", "w20", "w21", "w22")]
    return matrices


def efficiency(rng: np.random.Generator, draws: int) -> list[dict]:
    """RMS error over the Cramer-Rao bound and coverage of the reported 95 % intervals, on a lunar soil."""
    x = unknowns(Soil(35.0, 170.0, 0.0178, 1.0, sinkage_coefficient=829333.0))
    guess, out = Soil(30.0, 170.0, 0.012, 1.0, sinkage_coefficient=1.15e6), []
    for noisy in (False, True):
        slip_sd, sinkage_sd = (SLIP_SD, SINKAGE_SD) if noisy else (0.0, 0.0)
        for points in (6, 12, 30):
            slip = np.linspace(0.05, 0.6, points)
            sinkage = steady_sinkage(x, slip, np.full(points, 147.0), ROVER)
            y, _ = predictions(x, slip, sinkage, ROVER)
            j = whitened(x, slip, sinkage, ROVER, ROVER_SD, slip_sd, sinkage_sd)[:, :3]
            bound = np.sqrt(np.diag(np.linalg.inv(j.T @ j)))
            noise = rng.standard_normal((draws, points, 5)) * np.array([*ROVER_SD, slip_sd, sinkage_sd])
            for method in ("weighted",) if not noisy else ("errors in variables", "plain least squares"):
                treat = method == "errors in variables"
                errors, covered = np.empty((draws, 3)), np.empty((draws, 3), dtype=bool)
                for d in range(draws):
                    e = generalized_newton_raphson(
                        np.clip(slip + noise[d, :, 3], -0.99, 1.0),
                        np.maximum(sinkage + noise[d, :, 4], 1e-3),
                        *(y + noise[d, :, :3]).T,
                        reading=ROVER,
                        guess=guess,
                        sd=ROVER_SD,
                        slip_sd=slip_sd if treat else 0.0,
                        sinkage_sd=sinkage_sd if treat else 0.0,
                        restarts=False,
                    )
                    errors[d] = unknowns(e.soil) - x
                    covered[d] = np.abs(errors[d]) < 1.959964 * np.sqrt(np.diag(e.covariance))
                out.append({
                    "noise_in_slip_and_sinkage": noisy, "points": points, "method": method,
                    "bound": [math.degrees(bound[0]), *bound[1:]],
                    "rmse_over_bound": np.sqrt(np.mean(errors**2, axis=0)) / bound,
                    "bias_over_bound": np.mean(errors, axis=0) / bound, "coverage_95": np.mean(covered, axis=0),
                })  # fmt: skip
    return out


# --- 3: identifiability -----------------------------------------------------------------------------------------------

SETS = {"phi, K, S": (), "phi, K, S, n": ("n",), "phi, K, S, c": ("c",), "phi, K, S, n, c": ("n", "c")}
DATA = {"drawbar pull": (True, False, False), "and load": (True, True, False), "and torque": (True, True, True)}


def identifiability(points: int = 24) -> list[dict]:
    """Cramer-Rao bounds and conditioning by soil, channels and set of unknowns; three loads, slips 0.03 to 0.7.

    S is scaled to the pressure at the mean sinkage: S and n together have no other meaning.
    """
    out = []
    presets = soils()
    for soil_name in ("dry_sand", "lunar_nominal", "rubicon_sandy_loam", "clayey_soil_38", "heavy_clay_25"):
        preset = presets[soil_name]
        reading = Reading(preset.cohesion, preset.sinkage_exponent, ROVER.radius, ROVER.width)
        x = unknowns(preset, ROVER.width)
        slip = np.tile(np.linspace(0.03, 0.7, points // 3), 3)
        load = np.repeat([75.0, 150.0, 300.0], points // 3)
        sinkage = steady_sinkage(x, slip, load, reading)
        depth, h = float(np.exp(np.mean(np.log(sinkage)))), 1e-5
        for data, channels in DATA.items():
            sinkage_sd = min(SINKAGE_SD, 0.1 * depth)  # a stiff soil is measured with a finer gauge
            j = whitened(x, slip, sinkage, reading, ROVER_SD, SLIP_SD, sinkage_sd, channels)
            by_n = []
            for sign in (1.0, -1.0):  # n moved at equal pressure at `depth`
                moved = reading._replace(exponent=reading.exponent + sign * h)
                y, _ = predictions(x - [0.0, 0.0, sign * h * math.log(depth)], slip, sinkage, moved)
                by_n.append(y)
            white = whitening(x, slip, sinkage, reading, ROVER_SD, SLIP_SD, sinkage_sd, channels)
            white_n = (white @ ((by_n[0] - by_n[1]) / (2.0 * h))[:, :, None]).ravel()
            full = np.column_stack([j[:, :3], white_n, j[:, 3] * 1000.0])  # c in kPa
            for name, extra in SETS.items():
                used = [0, 1, 2, *([3] if "n" in extra else []), *([4] if "c" in extra else [])]
                a = full[:, used]
                singular = np.linalg.svd(a, compute_uv=False)
                covariance = np.linalg.pinv(a.T @ a)
                sd = dict(zip(np.array(["phi_deg", "ln_K", "ln_S", "n", "c_kPa"])[used], np.sqrt(np.diag(covariance))))  # noqa: B905
                sd["phi_deg"] = math.degrees(sd["phi_deg"])
                condition = float(singular[0] / max(singular[-1], 1e-300))
                told = sd["phi_deg"] < 5.0 and sd["ln_K"] < 0.5 and sd["ln_S"] < 0.5 and sd.get("n", 0.0) < 0.2
                told = told and sd.get("c_kPa", 0.0) < max(0.5, 0.3 * preset.cohesion / 1000.0)
                out.append({
                    "soil": soil_name, "data": data, "unknowns": name, "condition": condition, "bound": sd,
                    "identifiable": bool(told),
                })  # fmt: skip
    return out


# --- all --------------------------------------------------------------------------------------------------------------


PARTS = ("convergence", "efficiency", "identifiability", "coverage")


def study(seed: int, smoke: bool, names=PARTS) -> dict:
    """Run the named parts; their results as plain values, by name."""
    rngs, result = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2)], {}
    parts = {
        "convergence": lambda: convergence(rngs[0], 50 if smoke else 10_000),
        "efficiency": lambda: efficiency(rngs[1], 20 if smoke else 1000),
        "identifiability": identifiability,
        "coverage": lambda: table_fits_coverage.study(seed, 1 if smoke else 50),
    }
    for name in names:
        start = time.perf_counter()
        result[name] = parts[name]()
        print(f"{name}: {time.perf_counter() - start:.0f} s", flush=True)
    return result


def _made(options: argparse.Namespace) -> dict:
    """How these parts are made."""
    command = ["python benchmarks/table_fits.py", *(["--smoke"] if options.smoke else [])]
    if tuple(options.parts) != PARTS:
        command += ["--parts", *options.parts]
    machine = f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}"
    return {"command": " ".join(command), "seed": options.seed, "machine": machine}


@command_line("benchmarks.table_fits", interrupted="nothing written")
def main(arguments: list[str] | None = None) -> int:
    """Run the study and write its page."""
    p = study_parser("python benchmarks/table_fits.py", __doc__, "table_fits.json, .md and plots", Path("docs"))
    p.add_argument(
        "--seed", metavar="N", type=whole_number(), default=0, help="of everything random, >= 0 (default: 0)"
    )
    p.add_argument(
        "--parts", metavar="PART", nargs="+", choices=PARTS, default=PARTS,
        help="parts to make anew, the others are taken from OUT/table_fits.json; of " + ", ".join(PARTS),
    )  # fmt: skip
    options = p.parse_args(arguments)
    check_outputs(options.out, ("table_fits.json", "table_fits.md", "table_fits/x.png"))
    make_folder(options.out)
    file, kept = options.out / "table_fits.json", {}
    if set(options.parts) != set(PARTS):
        kept = read_json(file)
        made = kept.get("made")
        known = {p for p in kept if isinstance(made, dict) and isinstance(made.get(p), dict)}
        if missing := set(PARTS) - set(options.parts) - known:
            raise ParameterError(f"{file}: has no {', '.join(sorted(missing))}; give --parts with them, or without it")
    result = kept | study(options.seed, options.smoke, options.parts)
    result["made"] = kept.get("made", {}) | dict.fromkeys(options.parts, _made(options))
    write_json(file, result)
    try:
        table_fits_page.write(result, options.out)
    except (AttributeError, IndexError, KeyError, TypeError) as error:
        others = ", ".join(sorted(set(PARTS) - set(options.parts)))
        raise ParameterError(
            f"{file}: what it has of {others} is of another version ({type(error).__name__}: {error}); make these "
            "parts anew"
        ) from None
    print(f"Written: {options.out / 'table_fits.md'}", flush=True)
    return 0


if __name__ == "__main__":
    leave(main())
