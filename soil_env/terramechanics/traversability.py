"""Can this wheel pass this soil? Torque required against torque available, and the slip of the best drawbar pull.

Criterion of the source paper (its Section 6): the ground is impassable where the torque that the soil takes exceeds
what the motor has. So it is where no slip gives a positive drawbar pull in excess of the grade.
"""

from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_part, compiled_root
from soil_env.terramechanics.effects import NO_EFFECTS, digging, slip_sinkage_ratio
from soil_env.terramechanics.ground import row_soil
from soil_env.terramechanics.steady import DEEPEST, LEVEL, Rim, steady_with

#: Slips at which the drawbar pull is compared.
SLIPS = np.array([0.05, 0.1, 0.15, 0.2, 0.26, 0.33, 0.41, 0.5, 0.6, 0.72, 0.85, 0.97])
_MIDDLE = 4


class Best(NamedTuple):
    """The working point of the highest steady drawbar pull within the motor's torque."""

    slip: float  # [-]
    drawbar_pull: float  # [N]; -inf if the motor can turn the wheel at no slip
    torque: float  # [N m]
    sinkage: float  # [m]


@compiled_part
def best_working_point(load, soil, r, b, torque_available):
    """`best_working_point_with` of the base model on level, fresh soil, with the digging of `soil`."""
    return best_working_point_with(
        load, soil, Rim(r, b, 0.0), LEVEL, 0.0, NO_EFFECTS, torque_available
    )


@compiled_part
def best_working_point_with(load, soil, wheel, conditions, unit_weight, fx, torque_available):
    """`Best` of `steady.steady_with` over the slips of `SLIPS`: up from the middle of them, then down from there.

    The curve has one maximum, so each scan stops once it has clearly passed it, or where more slip takes more torque
    than there is.
    """
    best = Best(SLIPS[0], -np.inf, 0.0, 0.0)
    n = soil.sinkage_exponent
    gain, recovery = digging(soil, fx)
    power = n / (n + 0.5)
    middle = 0.0
    for direction in (1, -1):
        i = _MIDDLE if direction > 0 else _MIDDLE - 1
        guess = middle
        last = SLIPS[_MIDDLE]
        while 0 <= i < SLIPS.size:
            slip = SLIPS[i]
            if (
                guess > 0.0
            ):  # at the same load the ratio of sinkages is the ratio of slip-sinkage, to a power
                deeper = slip_sinkage_ratio(slip, gain, recovery)
                deeper /= slip_sinkage_ratio(last, gain, recovery)
                guess *= deeper**power
            s = steady_with(
                slip,
                load,
                soil,
                wheel,
                conditions,
                unit_weight,
                fx,
                min(guess, DEEPEST * wheel.radius),
            )
            guess = s.sinkage if s.supported else 0.0
            last = slip
            if i == _MIDDLE:
                middle = guess
            if s.torque <= torque_available and s.supported:
                if s.drawbar_pull > best.drawbar_pull:
                    best = Best(slip, s.drawbar_pull, s.torque, s.sinkage)
                elif s.drawbar_pull < best.drawbar_pull - 0.03 * load:
                    break
            elif direction > 0:
                break
            i += direction
    return best


@compiled_root(nogil=True)
def best_points(rows, soils, load, r, b, torque, slip, pull):
    """Write slip [-] and drawbar pull [N] of the best working point of the wheels `rows` into `slip` and `pull` [n].

    `soils` [n, 7] are rows of `SoilState`, `load` [n] in N; r, b [m] and the motor's torque [N m] are of all wheels.
    """
    for k in rows:
        best = best_working_point(load[k], row_soil(soils[k]), r, b, torque)
        slip[k] = best.slip
        pull[k] = best.drawbar_pull
