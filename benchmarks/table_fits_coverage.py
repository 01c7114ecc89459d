"""Coverage of the 95 % intervals of `python -m soil_env.identification`: a part of benchmarks/table_fits.py.

Tables are drawn from one soil (friction angle 31 deg, K 0.018 m, S 9e5, n 0.9, cohesion 1500 Pa) under a wheel of
0.15 m by 0.12 m: steady points by Eqs. (1)-(3), with Gaussian noise of 0.3 mm, 0.7 N and 0.1 N m. Cohesion and n are
known.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env.identification import Reading, predict
from soil_env.identification.table import identify_table
from soil_env.measurement.table import NOISE, NoiseLevels, Prior, Setup, SetupWheel, SoilPriors, Table
from soil_env.parameters import SoilState
from soil_env.terramechanics.model import steady_state

WHEEL = SetupWheel(0.15, 0.12)
PHI_DEG, COHESION, K, S, EXPONENT = 31.0, 1500.0, 0.018, 9e5, 0.9
TRUTH = {"friction_angle_deg": PHI_DEG, "shear_modulus": K, "sinkage_coefficient": S}
SD = {"sinkage": 3e-4, "drawbar_pull": 0.7, "torque": 0.1}


class Case(NamedTuple):
    """A row of the table: how many slips from 0.05 to 0.7, which loads [N], what is measured and given."""

    slips: int
    loads: tuple[float, ...]
    torque: bool
    noise_given: bool
    slip_sd: float = 0.0  # true noise of the slip
    slip_given: bool = False

    @property
    def label(self) -> tuple[str, ...]:
        """Cells that say what the case is."""
        noise = ("given" if self.noise_given else "estimated") if not self.slip_sd else (
            f"given; slip +- {self.slip_sd:g} " + ("given" if self.slip_given else "not given")
        )  # fmt: skip
        return str(self.slips), str(len(self.loads)), "DP, T" if self.torque else "DP", noise


ONE, THREE = (120.0,), (60.0, 120.0, 240.0)
CASES = (
    Case(8, THREE, True, True),
    Case(8, THREE, True, False),
    Case(6, ONE, True, True),
    Case(8, ONE, True, False),
    Case(6, ONE, True, False),
    Case(4, ONE, True, False),
    Case(6, ONE, False, False),
    Case(4, ONE, False, False),
    Case(8, THREE, True, True, 0.02, False),
    Case(8, THREE, True, True, 0.02, True),
)


def clean(case: Case) -> np.ndarray:
    """Rows [N, 5] of slip, load, sinkage, drawbar pull and torque without noise."""
    soil = SoilState(math.tan(math.radians(PHI_DEG)), COHESION, K, S, EXPONENT, 0.0, 0.5)
    x = np.array([math.radians(PHI_DEG), math.log(K), math.log(S)])
    reading = Reading(COHESION, EXPONENT, WHEEL.radius, WHEEL.width)
    rows, out, rates = [], np.empty(3), np.empty((3, 4))
    for load in case.loads:
        for slip in np.linspace(0.05, 0.7, case.slips):
            z = steady_state(slip, load, soil, WHEEL.radius, WHEEL.width).sinkage
            predict(x, slip, z, 1.0, reading, out, rates)
            rows.append((slip, load, z, out[0], out[2]))
    return np.array(rows)


def table_of(case: Case, rows: np.ndarray, rng: np.random.Generator) -> Table:
    """The rows with noise, as a measurement table."""
    noisy = rows + rng.normal(size=rows.shape) * [case.slip_sd, 0.0, *SD.values()]
    none = np.full(len(rows), np.nan)
    absent = ("speed", "grade_deg", "time", "wheel_radius", "wheel_width", "grouser_height", *NOISE)
    return Table(
        "drawn", frozenset(("slip", "load", *SD)), np.arange(2, len(rows) + 2),
        slip=np.clip(noisy[:, 0], -1.0, 1.0), load=noisy[:, 1], sinkage=noisy[:, 2], drawbar_pull=noisy[:, 3],
        torque=noisy[:, 4] if case.torque else none, passes=np.ones(len(rows), dtype=int),
        run=np.full(len(rows), ""), **dict.fromkeys(absent, none),
    )  # fmt: skip


def coverage(case: Case, draws: int, rng: np.random.Generator) -> tuple[dict[str, float], float]:
    """Share of the draws whose interval holds the truth, by parameter, and share that did not settle."""
    levels = dict(SD) if case.noise_given else {}
    if case.slip_given:
        levels["slip"] = case.slip_sd
    known = {"cohesion": Prior(COHESION, 0.0), "sinkage_exponent": Prior(EXPONENT, 0.0)}
    setup, rows = Setup(WHEEL, SoilPriors(**known), NoiseLevels(**levels)), clean(case)
    hits, unsettled = dict.fromkeys(TRUTH, 0), 0
    for _ in range(draws):
        estimate = identify_table(table_of(case, rows, rng), setup)
        unsettled += not estimate.converged
        for name, truth in TRUTH.items():
            p = estimate.parameters[name]
            hits[name] += p.low <= truth <= p.high
    return {name: count / draws for name, count in hits.items()}, unsettled / draws


def study(seed: int, draws: int) -> dict:
    """All cases: shares of the draws by parameter, and of those that did not settle."""
    rows = []
    for k, case in enumerate(CASES):
        shares, unsettled = coverage(case, draws, np.random.default_rng([seed, k]))
        rows.append({"case": case.label, "shares": shares, "unsettled": unsettled})
    return {"draws": draws, "rows": rows}
