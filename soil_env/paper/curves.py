"""Drawbar pulls, sensitivities and curves of the source paper: Table 1, Figs. 2 to 4 and 6 to 9.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from soil_env.identification import Reading
from soil_env.paper.points import (
    CONVERGED_SET,
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
    R,
    balance_sinkage,
    channels,
    sand_pull,
    sand_unknowns,
    sinkage_at,
    unknowns,
)
from soil_env.parameters import Soil, soils
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


class PullCurves(NamedTuple):
    """Drawbar pulls [N] of Figs. 2, 3 and 4 at an entry angle of 37 deg."""

    slip: np.ndarray
    by_rule: dict[str, np.ndarray]  # Fig. 2
    cohesion: np.ndarray
    by_cohesion: np.ndarray  # Fig. 3
    phi_deg: np.ndarray
    K: np.ndarray
    by_phi_K: np.ndarray  # Fig. 4 [phi, K]


def pull_curves() -> PullCurves:
    """Figs. 2-4."""
    z, x = sinkage_at(ENTRY_DEG), sand_unknowns()
    slip, cohesion = np.linspace(0.01, 0.6, 60), np.linspace(0.0, 10e3, 41)
    phi, K = np.linspace(20.0, 45.0, 51), np.linspace(0.015, 0.089, 51)
    rules = {f"Simpson m = {m}": m for m in (1, 2, 5, 10)} | {"exact": 0}
    by_rule = {name: channels(x, slip, z, READING._replace(simpson=m))[:, 0] for name, m in rules.items()}
    by_cohesion = np.array([sand_pull(replace(SAND, cohesion=c)) for c in cohesion])
    grid = unknowns(phi[:, None], K[None, :], SAND.lumped(B)).reshape(-1, 3)
    by_phi_K = channels(grid, SLIP, z)[:, 0].reshape(phi.size, K.size)
    return PullCurves(slip, by_rule, cohesion, by_cohesion, phi, K, by_phi_K)


# --- Figs. 6-9 --------------------------------------------------------------------------------------------------------


class ForceCurves(NamedTuple):
    """Figs. 6 and 7: [slip] drawbar pull [N] and torque [N m] of each parameter set at the true sinkage."""

    slip: np.ndarray
    pull: dict[str, np.ndarray]
    torque: dict[str, np.ndarray]


def force_curves(solution) -> ForceCurves:
    """Predict at W = 8923 N from the true sand, the set identified from points A, and the two sets of Table 3."""
    slip = np.linspace(0.02, 0.8, 40)
    sinkage = balance_sinkage(slip, LOAD)
    sets = {"true (Table 2)": (sand_unknowns(), READING), "identified, points A": (unknowns(*solution), HELD),
            "Table 3, converged": (unknowns(*CONVERGED_SET), HELD),
            "Table 3, printed": (unknowns(*PRINTED_SET), HELD)}  # fmt: skip
    found = {name: channels(x, slip, sinkage, reading) for name, (x, reading) in sets.items()}
    return ForceCurves(slip, {k: v[:, 0] for k, v in found.items()}, {k: v[:, 2] for k, v in found.items()})


class Traverse(NamedTuple):
    """Figs. 8 and 9 for one soil, [slip] each, NaN where the soil does not carry the wheel."""

    slip: np.ndarray
    sinkage: np.ndarray
    torque: np.ndarray
    pull: np.ndarray  # Eq. (11)
    pull_paper: np.ndarray | None  # Eq. (12); for the balance without slip-sinkage only
    best: Best  # working point of the highest pull within the motor's torque, Eq. (11)


def traverse(name: str, digging: bool) -> Traverse:
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
    return Traverse(slip, sinkage, torque, pull, paper, best_working_point(LOAD, state, R, B, MOTOR))
