"""The soil that an estimate of the identifier stands for."""

import math

from soil_env.identification.online.lanes.compiling import FastCall, compiled_inline, compiled_root
from soil_env.identification.online.lanes.steady import best_working_point
from soil_env.parameters import SoilState

STIFFEST = 1e13  # largest sinkage coefficient that an estimate may stand for, whatever its exponent
MOST_DIGGING = 20.0  # largest gain of digging that an estimate may stand for
LEAST_LOAD = 0.05  # share of the weight below which a measured load counts as this share


@compiled_inline
def soil_of_estimate(x, dig_gain, exponent, dig_recovery):
    """`SoilState` of the estimate x [5] of (phi [rad], ln K, ln S, cohesion, ln(gain of digging /
    `dig_gain`)).

    Exponent and recovery of digging are those of the belief.
    """
    return SoilState(
        math.tan(x[0]),
        x[3],
        math.exp(x[1]),
        min(math.exp(x[2]), STIFFEST),
        exponent,
        min(dig_gain * math.exp(x[4]), MOST_DIGGING),
        dig_recovery,
    )


@compiled_root(nogil=True)
def assess_ground(rows, estimate, pull, seen, numbers, out):
    """Write the traversability of the ground as identified under the wheels `rows` [n] into `out`
    [wheels, 6].

    `estimate` [wheels, 5]; `pull` [wheels, 2], the best drawbar pull and its sd [of load]; `seen`
    [wheels, 2], load [of weight] and pitch [rad]; `numbers` are `FilterNumbers`. Columns of `out`:
    best slip, drawbar margin and its sd [of load], torques required and available [N m], 1 if the
    ground is passable (source paper, Section 6).
    """
    for k in rows:
        x = estimate[k]
        phi = math.radians(math.degrees(x[0]))  # to the bit as published, in degrees
        soil = soil_of_estimate(
            (phi, x[1], x[2], x[3], x[4]), numbers.dig_gain, numbers.exponent, numbers.dig_recovery
        )
        load = max(seen[k, 0], LEAST_LOAD) * numbers.weight
        best = best_working_point(load, soil, numbers.radius, numbers.width, numbers.stall_torque)
        turns = best.drawbar_pull > -math.inf  # at some slip the motor has the torque
        margin = max(pull[k, 0] - math.tan(seen[k, 1]), -1.0) if turns else -1.0
        out[k, 0] = best.slip
        out[k, 1] = margin
        out[k, 2] = pull[k, 1]
        out[k, 3] = best.torque
        out[k, 4] = numbers.stall_torque
        out[k, 5] = 1.0 if margin > 0.0 else 0.0


def ground_assessment() -> FastCall:
    """`assess_ground` for many calls with arguments of the same types."""
    return FastCall(assess_ground)
