"""Everything that the page of the recomputed paper shows, as numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

from soil_env.identification import Estimate
from soil_env.paper import curves, points
from soil_env.paper.points import DRAWS, ENTRY_DEG, HELD, LOAD, PRINTED_SET, SLIP, R
from soil_env.terramechanics.contact import entry_angle


@dataclass(frozen=True)
class Results:
    """Results by table and figure of the paper; "A" and "B" are the synthetic triples of points."""

    seed: int
    draws: int
    rules: dict[str, float]  # rule of integration -> DP [N] at the checked point
    changes: dict[str, tuple[float, float, str]]  # input -> (value, value that gives the printed DP, unit)
    point_load: dict[str, float]  # rule -> W [N] by Eq. (1) at the checked point
    balance_deg: float  # entry angle [deg] at which Eq. (1) carries 8923 N at the slip of the checked point
    printed_pull: float  # DP [N] of the printed set of Table 3 at the checked point
    sensitivity: dict  # Table 1
    curves: curves.PullCurves  # Figs. 2-4
    points: dict[str, points.Points]
    solutions: dict[str, Estimate]  # Table 3
    nearest: dict[str, dict[str, points.Nearest]]
    noise_needed: dict[str, points.NeededNoise]
    stops: dict[str, points.Stop]
    map: points.GuessMap  # Table 4, points A
    map_b: points.GuessMap
    noise: dict[str, points.Noisy]  # Table 5
    forces: curves.ForceCurves  # Figs. 6 and 7
    traverses: dict[str, tuple[curves.Traverse, curves.Traverse]]  # Figs. 8 and 9: without and with slip-sinkage


def compute(seed: int = 0, draws: int = DRAWS, counts: tuple[int, int, int] = (40, 40, 9)) -> Results:
    """Recompute every table and figure; `counts` are the guesses of phi, K and S in Table 4."""
    given = points.synthetic_points()
    solutions = {name: points.identified(p) for name, p in given.items()}
    return Results(
        seed=seed,
        draws=draws,
        rules=curves.pull_rules(),
        changes=curves.single_changes(),
        point_load=curves.point_loads(),
        balance_deg=math.degrees(entry_angle(points.balance_sinkage(SLIP, LOAD)[0], R)),
        printed_pull=float(
            points.channels(points.unknowns(*PRINTED_SET), SLIP, points.sinkage_at(ENTRY_DEG), HELD)[0, 0]
        ),
        sensitivity=curves.table_1(),
        curves=curves.pull_curves(),
        points=given,
        solutions=solutions,
        nearest={name: points.nearest_by_assumption(p) for name, p in given.items()},
        noise_needed={name: points.needed_noise(p) for name, p in given.items()},
        stops={name: points.early_stop(p) for name, p in given.items()},
        map=points.table_4(given["A"], counts),
        map_b=points.table_4(given["B"], counts),
        noise=points.table_5(seed, draws),
        forces=curves.force_curves(points.triple(solutions["A"].soil)),
        traverses={
            name: (curves.traverse(key, False), curves.traverse(key, True)) for name, key in curves.FIELD.items()
        },
    )
