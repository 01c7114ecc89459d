"""The ground as identified: can the wheel pass it? (source paper, Section 6)"""

import math

import numpy as np

from soil_env._compiled.cache import kept
from soil_env.parameters import SoilState
from soil_env.terramechanics.contact import ARC_NODES
from soil_env.terramechanics.steady import LEVEL, Rim
from soil_env.terramechanics.traversability import best_point_at

from .memory import BEST_PULL

STIFFEST = 1e13  # [N/m^(n+2)] largest sinkage coefficient that an estimate may stand for
MOST_DIGGING = 20.0  # [-] largest gain of slip-sinkage that an estimate may stand for
LEAST_LOAD = 0.05  # [of weight] below which a measured load counts as this


@kept
def _assess(rows, estimate, sd, seen, setting, nodes, out):
    """`assess_ground`, with an arc's scratch `nodes`."""
    numbers = setting[0]
    wheel = Rim(numbers.radius, numbers.width, 0.0, 0.0, 0.0, 0.0, 0.0)
    for k in rows:
        x = estimate[k]
        soil = SoilState(
            math.tan(x[0]),
            max(x[3], 0.0),
            math.exp(x[1]),
            min(math.exp(x[2]), STIFFEST),
            numbers.exponent,
            min(numbers.dig_gain * math.exp(x[4]), MOST_DIGGING),
            numbers.dig_recovery,
            numbers.rim_flow,
            numbers.braked_peak,
            numbers.shear_growth,
            numbers.shear_length,
            0.0,
            0.1,
        )
        load = max(seen[k, 0], LEAST_LOAD) * numbers.weight
        best = best_point_at(nodes[0], load, soil, wheel, LEVEL, None, numbers.stall_torque)
        turns = best.drawbar_pull > -math.inf  # at some slip the motor has the torque
        margin = max(x[BEST_PULL] - math.tan(seen[k, 1]), -1.0) if turns else -1.0
        out[k, 0] = best.slip
        out[k, 1] = margin
        out[k, 2] = sd[k, BEST_PULL]
        out[k, 3] = best.torque
        out[k, 4] = numbers.stall_torque
        out[k, 5] = 1.0 if margin > 0.0 else 0.0


def assess_ground(
    rows: np.ndarray,
    estimate: np.ndarray,
    sd: np.ndarray,
    seen: np.ndarray,
    setting: np.ndarray,
    out: np.ndarray,
) -> None:
    """Write the traversability of the ground under the wheels `rows` [n] into `out` [wheels, 6].

    `estimate` and `sd` [wheels, 6]; `seen` [wheels, 2], load [of weight] and pitch [rad]; `setting`
    is `SETTING` [1]. Columns of `out`: best slip, drawbar margin and its sd [of load], torques
    required and available [N m], 1 if the ground is passable.
    """
    arrays = (np.ascontiguousarray(estimate), np.ascontiguousarray(sd), seen)
    _assess(rows, *arrays, setting, np.zeros(1, ARC_NODES), out)
