"""The tables and figures of the source paper, recomputed: `python -m soil_env.paper [--out DIR] [--seed N]`.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251. Figures and Table 1 are computed here,
Tables 3 to 5 in `paper_points`; `paper_page` words and draws them. With `--out DIR` the page is written to DIR/paper.md
and its figures to DIR/paper/*.png.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from soil_env._io.commands import INTERRUPTED, drop_output
from soil_env._io.signals import terminable
from soil_env.identification import Reading
from soil_env.paper import page as paper_page
from soil_env.paper.points import (
    CONVERGED_SET,
    DRAWS,
    ENTRY_DEG,
    EXACT,
    HELD,
    LOAD,
    MOTOR,
    PRINTED_PULL,
    PRINTED_SET,
    READING,
    SAND,
    SLIP,
    B,
    Map,
    R,
    balance_sinkage,
    channels,
    early_stop,
    identified,
    nearest_by_assumption,
    needed_noise,
    sand_pull,
    sand_unknowns,
    sinkage_at,
    synthetic_points,
    table_4,
    table_5,
    triple,
    unknowns,
)
from soil_env.parameters import Soil, soils
from soil_env.terramechanics.contact import entry_angle
from soil_env.terramechanics.model import steady_state
from soil_env.terramechanics.traversability import Best, best_working_point

#: Soils of Figs. 8 and 9: the name in the paper and the preset that stands for it.
FIELD = {"sandy loam": "sandy_loam_15", "dry sand": "dry_sand", "snow": "snow", "clayey soil": "clayey_soil_38"}


# --- the known numbers, Figs. 2-4, Table 1 ----------------------------------------------------------------------------


def pull_rules() -> dict[str, float]:
    """DP [N] at the checked point by every rule of integration."""
    rules = {f"m = {m}": sand_pull(simpson=m) for m in (1, 2, 5, 10)}
    return rules | {"exact": sand_pull(**EXACT), "exact, (11)": sand_pull(**EXACT, paper_resistance=False)}


def point_loads() -> dict[str, float]:
    """W [N] by Eq. (1) of Table 2's sand at the checked point, exactly and by m = 2."""
    z, x = sinkage_at(ENTRY_DEG), sand_unknowns()
    return {
        "exact": float(channels(x, SLIP, z, READING._replace(**EXACT))[0, 1]),
        "m = 2": float(channels(x, SLIP, z)[0, 1]),
    }


def single_changes() -> dict[str, tuple[float, float, str]]:
    """Change of one input alone that turns our DP for m = 2 into the printed 1047.22 N: (value, changed, unit)."""

    def root(pull, low, high):
        return float(brentq(lambda v: pull(v) - PRINTED_PULL, low, high))

    def pull_at(slip, entry_deg):
        return float(channels(sand_unknowns(), slip, sinkage_at(entry_deg))[0, 0])

    found = {}
    for name, key, unit in (("phi", "friction_angle_deg", "deg"), ("K", "shear_modulus", "m"),
                            ("n", "sinkage_exponent", ""), ("c", "cohesion", "Pa")):  # fmt: skip
        value = getattr(SAND, key)
        changed = root(lambda v, key=key: sand_pull(replace(SAND, **{key: v})), 0.85 * value, 1.05 * value)
        found[name] = value, changed, unit
    found["slip"] = SLIP, root(lambda v: pull_at(v, ENTRY_DEG), 0.2, 0.23), ""
    found["entry angle"] = ENTRY_DEG, root(lambda v: pull_at(SLIP, v), 36.0, 38.0), "deg"
    return found


def split_sand() -> Soil:
    """Table 2's sand with S split into k_c and k_phi as Wong & Reece's 20 psi and 2.5 psi/in x 6 in: 20 to 15."""
    s = SAND.lumped(B)
    return replace(SAND, sinkage_coefficient=None, k_c=20.0 / 35.0 * s * B, k_phi=15.0 / 35.0 * s)


def table_1() -> dict[str, np.ndarray]:
    """Change of DP [%] for each parameter -5 %, +5 %: [m = 2 -, m = 2 +, exact -, exact +]."""
    base, rows = split_sand(), {}
    fields = {"c": "cohesion", "phi": "friction_angle_deg", "K": "shear_modulus", "k_c": "k_c", "k_phi": "k_phi",
              "n": "sinkage_exponent"}  # fmt: skip
    for name, key in fields.items():
        rows[name] = np.array([
            100.0 * (sand_pull(replace(base, **{key: share * getattr(base, key)}), **rule) / sand_pull(**rule) - 1.0)
            for rule in ({}, EXACT) for share in (0.95, 1.05)
        ])  # fmt: skip
    return rows


class Curves(NamedTuple):
    """Drawbar pulls [N] of Figs. 2, 3 and 4 at an entry angle of 37 deg."""

    slip: np.ndarray
    by_rule: dict[str, np.ndarray]  # Fig. 2
    cohesion: np.ndarray
    by_cohesion: np.ndarray  # Fig. 3
    phi_deg: np.ndarray
    K: np.ndarray
    by_phi_K: np.ndarray  # Fig. 4 [phi, K]


def curves() -> Curves:
    """Figs. 2-4."""
    z, x = sinkage_at(ENTRY_DEG), sand_unknowns()
    slip, cohesion = np.linspace(0.01, 0.6, 60), np.linspace(0.0, 10e3, 41)
    phi, K = np.linspace(20.0, 45.0, 51), np.linspace(0.015, 0.089, 51)
    rules = {f"Simpson m = {m}": m for m in (1, 2, 5, 10)} | {"exact": 0}
    by_rule = {name: channels(x, slip, z, READING._replace(simpson=m))[:, 0] for name, m in rules.items()}
    by_cohesion = np.array([sand_pull(replace(SAND, cohesion=c)) for c in cohesion])
    grid = unknowns(phi[:, None], K[None, :], SAND.lumped(B)).reshape(-1, 3)
    by_phi_K = channels(grid, SLIP, z)[:, 0].reshape(phi.size, K.size)
    return Curves(slip, by_rule, cohesion, by_cohesion, phi, K, by_phi_K)


# --- Figs. 6-9 --------------------------------------------------------------------------------------------------------


class Prediction(NamedTuple):
    """Figs. 6 and 7: [slip] drawbar pull [N] and torque [N m] of each parameter set at the true sinkage."""

    slip: np.ndarray
    pull: dict[str, np.ndarray]
    torque: dict[str, np.ndarray]


def prediction(solution) -> Prediction:
    """Predict at W = 8923 N from the true sand, the set identified from points A, and the two sets of Table 3."""
    slip = np.linspace(0.02, 0.8, 40)
    sinkage = balance_sinkage(slip, LOAD)
    sets = {"true (Table 2)": (sand_unknowns(), READING), "identified, points A": (unknowns(*solution), HELD),
            "Table 3, converged": (unknowns(*CONVERGED_SET), HELD),
            "Table 3, printed": (unknowns(*PRINTED_SET), HELD)}  # fmt: skip
    found = {name: channels(x, slip, sinkage, reading) for name, (x, reading) in sets.items()}
    return Prediction(slip, {k: v[:, 0] for k, v in found.items()}, {k: v[:, 2] for k, v in found.items()})


class Ground(NamedTuple):
    """Figs. 8 and 9 for one soil, [slip] each, NaN where the soil does not carry the wheel."""

    slip: np.ndarray
    sinkage: np.ndarray
    torque: np.ndarray
    pull: np.ndarray  # Eq. (11)
    pull_paper: np.ndarray | None  # Eq. (12); for the balance without slip-sinkage only
    best: Best  # working point of the highest pull within the motor's torque, Eq. (11)


def traverse(name: str, digging: bool) -> Ground:
    """Torque required and drawbar pull against slip at W = 8923 N, with or without slip-sinkage."""
    soil, slip = soils()[name], np.linspace(0.01, 0.95, 48)
    state = soil.state(B) if digging else soil.state(B)._replace(dig_gain=0.0)
    steady = np.array([steady_state(i, LOAD, state, R, B) for i in slip])
    sinkage, pull, torque = np.where(steady[:, 3] > 0.0, steady[:, :3].T, np.nan)
    paper = None
    if not digging:
        reading = Reading(soil.cohesion, soil.sinkage_exponent, R, B, paper_resistance=True)
        carried = np.isfinite(sinkage)
        paper = np.full(slip.size, np.nan)
        paper[carried] = channels(sand_unknowns(soil), slip, np.nan_to_num(sinkage, nan=0.1), reading)[carried, 0]
    return Ground(slip, sinkage, torque, pull, paper, best_working_point(LOAD, state, R, B, MOTOR))


# --- all of it --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Results:
    """Everything that the page shows."""

    seed: int
    draws: int
    rules: dict
    changes: dict
    sensitivity: dict
    curves: Curves
    points: dict  # name -> Points
    solutions: dict  # name -> Estimate
    nearest: dict  # name -> {assumption: Nearest}
    noise_needed: dict  # name -> NeededNoise
    stops: dict  # name -> Stop
    map: Map  # points A
    map_b: Map  # points B
    noise: dict
    prediction: Prediction
    ground: dict  # soil -> (without digging, with digging)
    printed_pull: float  # DP [N] of the printed set of Table 3 at the checked point
    point_load: dict  # rule -> W [N] by Eq. (1) at the checked point
    balance_deg: float  # entry angle [deg] at which Eq. (1) carries 8923 N at its slip


def compute(seed: int = 0, draws: int = DRAWS, counts=(40, 40, 9)) -> Results:
    """Recompute every table and figure."""
    points = synthetic_points()
    solutions = {name: identified(p) for name, p in points.items()}
    return Results(
        seed=seed, draws=draws, rules=pull_rules(), changes=single_changes(), sensitivity=table_1(), curves=curves(),
        points=points, solutions=solutions,
        nearest={name: nearest_by_assumption(p) for name, p in points.items()},
        noise_needed={name: needed_noise(p) for name, p in points.items()},
        stops={name: early_stop(p) for name, p in points.items()},
        map=table_4(points["A"], counts),
        map_b=table_4(points["B"], counts), noise=table_5(seed, draws),
        prediction=prediction(triple(solutions["A"])),
        ground={name: (traverse(key, False), traverse(key, True)) for name, key in FIELD.items()},
        printed_pull=float(channels(unknowns(*PRINTED_SET), SLIP, sinkage_at(ENTRY_DEG), HELD)[0, 0]),
        point_load=point_loads(), balance_deg=math.degrees(entry_angle(balance_sinkage(SLIP, LOAD)[0], R)),
    )  # fmt: skip


_HELP = """The tables and figures of the source paper, recomputed, beside those printed values that are known.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251. Prints the drawbar pull of the checked
point by every rule of integration, Tables 1 and 3 to 5 and Figs. 2 to 4 and 6 to 9. Four printed results are known and
compared, one drawbar pull and the three parameters of Table 3, with the difference and why; of all others the page says
that the printed digits are not available. Every force comes from the compiled functions that the simulated world uses.
Takes about a minute."""
_EPILOG = """files:
  DIR/paper.md       the page, with everything that is printed
  DIR/paper/*.png    its figures

exit status:
  0 done; 2 bad input or a folder that cannot be written, said in one line; 130 interrupted

examples:
  python -m soil_env.paper
  python -m soil_env.paper --out docs"""


def _parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="python -m soil_env.paper",
        description=_HELP,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    p.add_argument(
        "--out", type=_folder, metavar="DIR", help="write the page and its figures there (default: print only)"
    )
    p.add_argument("--seed", type=_seed, metavar="N", default=0, help="of the noise in Table 5, >= 0 (default 0)")
    return p


def _folder(text: str) -> Path:
    if not text:
        raise argparse.ArgumentTypeError("is empty: expected a folder")
    return Path(text)


def _seed(text: str) -> int:
    if not text.strip().isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r}: expected a whole number >= 0")
    return int(text)


@terminable
def main(arguments: list[str] | None = None) -> int:
    """Command line; exit status."""
    options = _parser().parse_args(arguments)
    try:
        if options.out is not None:
            paper_page.prepare(options.out)
        results = compute(options.seed)
        if options.out is not None:
            paper_page.write(results, options.out)
    except OSError as error:
        print(f"soil_env.paper: --out {options.out}: cannot write there ({error.strerror})", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nsoil_env.paper: interrupted", file=sys.stderr)
        return INTERRUPTED
    try:
        paper_page.show(results)
        if options.out is not None:
            print(f"written: {options.out / 'paper.md'}, figures in {options.out / 'paper'}")
        sys.stdout.flush()
    except OSError as error:
        drop_output()
        where = "" if options.out is None else f"; it is in {options.out}"
        print(f"soil_env.paper: the page cannot be printed ({error.strerror}){where}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nsoil_env.paper: interrupted", file=sys.stderr)
        return INTERRUPTED
    return 0
