"""The ground as identified: can the wheel pass it? (source paper, Section 6)"""

import math

import numpy as np

from soil_env._compiled.cache import kept
from soil_env.identification.published import Traversability
from soil_env.parameters import NO_LAYER, SoilState
from soil_env.terramechanics.contact import ARC_NODES
from soil_env.terramechanics.steady import LEVEL, Rim
from soil_env.terramechanics.traversability import best_point_at

from .memory import (
    BEST_PULL,
    PUBLISHED_COHESION,
    PUBLISHED_GAIN,
    PUBLISHED_LN_K,
    PUBLISHED_LN_S,
    PUBLISHED_PHI,
)
from .points import LIFTED

# Largest numbers of a soil that an estimate may stand for, the upper bounds of `Soil`.
STIFFEST = 1e13  # [N/m^(n+2)] sinkage coefficient
MOST_DIGGING = 20.0  # [-] gain of slip-sinkage
# Columns of what is assessed.
BEST_SLIP, MARGIN, MARGIN_SD, REQUIRED, AVAILABLE, PASSABLE = range(len(Traversability._fields))


@kept
def _assess(rows, estimate, sd, seen, setting, nodes, out):
    """Compiled part of `assess_ground`, with its arguments and a scratch `nodes` [1] `ARC_NODES`.

    The margin is by the estimated best pull, slip and torque by the steady state on the estimated
    soil. Cohesion below 0 counts as 0, S is at most `STIFFEST`, the gain at most `MOST_DIGGING`.
    """
    numbers = setting[0]
    # a smooth, rigid rim without limit of grip
    wheel = Rim(numbers.radius, numbers.width, 0.0, 0.0, 0.0, 0.0, 0.0)
    for k in rows:
        x = estimate[k]
        soil = SoilState(
            math.tan(x[PUBLISHED_PHI]),
            max(x[PUBLISHED_COHESION], 0.0),
            math.exp(x[PUBLISHED_LN_K]),
            min(math.exp(x[PUBLISHED_LN_S]), STIFFEST),
            numbers.exponent,
            min(numbers.dig_gain * math.exp(x[PUBLISHED_GAIN]), MOST_DIGGING),
            numbers.dig_recovery,
            numbers.rim_flow,
            numbers.braked_peak,
            numbers.shear_growth,
            numbers.shear_length,
            *NO_LAYER,
        )
        load = max(seen[k, 0], LIFTED) * numbers.weight
        best = best_point_at(nodes[0], load, soil, wheel, LEVEL, None, numbers.stall_torque)
        # at some slip the soil carries the load and the motor has the torque
        turns = best.drawbar_pull > -math.inf
        margin = max(x[BEST_PULL] - math.tan(seen[k, 1]), -1.0) if turns else -1.0
        out[k, BEST_SLIP] = best.slip
        out[k, MARGIN] = margin
        out[k, MARGIN_SD] = sd[k, BEST_PULL]
        out[k, REQUIRED] = best.torque
        out[k, AVAILABLE] = numbers.stall_torque
        out[k, PASSABLE] = 1.0 if margin > 0.0 else 0.0


def assess_ground(
    rows: np.ndarray,
    estimate: np.ndarray,
    sd: np.ndarray,
    seen: np.ndarray,
    setting: np.ndarray,
    out: np.ndarray,
) -> None:
    """Write the traversability of the ground under the wheels `rows` [n] into `out` [wheels, 6].

    `estimate` and `sd` [wheels, 6]; `seen` [wheels, 2], load [of weight], at least `LIFTED`, and
    pitch [rad]; `setting` is `SETTING` [1]. Columns of `out` are those of `Traversability`: best
    slip, drawbar margin and its sd [of load], torques required and available [N m], 1 if passable.

    The margin is best pull less tan(pitch), at least -1. Where the motor has too little torque, or
    the soil does not carry the load, at every slip, the margin is -1 and the torque required 0.
    """
    estimate = np.ascontiguousarray(estimate)
    sd = np.ascontiguousarray(sd)
    _assess(rows, estimate, sd, seen, setting, np.zeros(1, ARC_NODES), out)
