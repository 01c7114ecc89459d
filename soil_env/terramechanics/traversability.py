"""Traversability: whether a wheel can pass a soil, by the torque required and available and by the
highest drawbar pull with its slip.

Criterion of the source paper (its Section 6): the ground is impassable where the torque that the
soil takes exceeds what the motor has. It is also impassable where no slip gives a positive drawbar
pull in excess of the grade.
"""

from typing import NamedTuple

import numpy as np

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import compiled
from soil_env.parameters import SoilState, Wheel

from .contact import ARC_NODES
from .effects import Effects
from .effects.slip_sinkage import digging, slip_sinkage_ratio
from .ground import SOIL, soil_of
from .steady import DEEPEST, LEVEL, Conditions, Point, Rim, floats, steady_at

#: [-] Slips at which the drawbar pull is compared.
SLIPS = np.array([0.05, 0.1, 0.15, 0.2, 0.26, 0.33, 0.41, 0.5, 0.6, 0.72, 0.85, 0.97])
MIDDLE = 4  # index of the slip that the search starts from
CLEARLY_LESS = 0.03  # [of load] drop of the pull from its maximum after which a search ends


class Best(NamedTuple):
    """The working point of the highest steady drawbar pull within the motor's torque."""

    slip: float  # [-]
    drawbar_pull: float  # [N]; -inf if at no slip the soil carries and the motor turns the wheel
    torque: float  # [N m]
    sinkage: float  # [m]


@compiled
def best_point_at(nodes, load, soil, wheel, conditions, fx, torque_available):
    """`Best` of the steady states at the slips of `SLIPS`: up from `MIDDLE`, then down from there.

    `nodes`, `soil`, `wheel`, `conditions` and `fx` as in `steady_at`; load [N], torque_available
    [N m]. The pull over slip has one maximum, so each scan ends where the pull has clearly fallen.
    The scan upward also ends where the torque is not available or the soil does not carry. Where
    that holds at every slip tried, slip is `SLIPS[0]`, pull -inf, torque and sinkage 0.
    """
    best = Best(SLIPS[0], -np.inf, 0.0, 0.0)
    n = soil.sinkage_exponent
    gain, recovery = digging(soil, fx)
    power = n / (n + 0.5)  # of the slip-sinkage ratio, to which sinkage is proportional
    middle = 0.0  # [m] sinkage at the slip `MIDDLE`
    for direction in (1, -1):
        i = MIDDLE if direction > 0 else MIDDLE - 1
        guess = middle
        last = SLIPS[MIDDLE]
        while 0 <= i < SLIPS.size:
            slip = SLIPS[i]
            if guess > 0.0:
                deeper = slip_sinkage_ratio(slip, gain, recovery)
                deeper /= slip_sinkage_ratio(last, gain, recovery)
                guess = min(guess * deeper**power, DEEPEST * wheel.radius)
            s = steady_at(nodes, Point(slip, load, guess), soil, wheel, conditions, fx)
            guess = s.felt if s.supported else 0.0
            last = slip
            if i == MIDDLE:
                middle = guess
            if s.torque <= torque_available and s.supported:
                if s.drawbar_pull > best.drawbar_pull:
                    best = Best(slip, s.drawbar_pull, s.torque, s.sinkage)
                elif s.drawbar_pull < best.drawbar_pull - CLEARLY_LESS * load:
                    break
            elif direction > 0:
                break
            i += direction
    return best


@kept
def _best_point(nodes, load, soil, wheel, conditions, fx, torque_available):
    """`best_point_at` for calls from Python, with `nodes` [1]."""
    return best_point_at(nodes[0], load, soil, wheel, conditions, fx, torque_available)


def best_working_point_with(
    load: float,
    soil: SoilState,
    wheel: Rim,
    conditions: Conditions,
    fx: Effects | None,
    torque_available: float,
) -> Best:
    """`Best` of a wheel with effects under a load [N], within the torque [N m] of its motor."""
    return _best_point(
        np.zeros(1, ARC_NODES),
        float(load),
        floats(soil),
        floats(wheel),
        floats(conditions),
        fx,
        float(torque_available),
    )


def best_working_point(
    load: float, soil: SoilState, r: float, b: float, torque_available: float
) -> Best:
    """`best_working_point_with` of the base model on level, fresh soil, with the digging of `soil`,
    for a wheel of radius r and width b [m].
    """
    return best_working_point_with(load, soil, Rim(r, b, 0.0, 0.0), LEVEL, None, torque_available)


@kept
def _best_points(nodes, soils, load, wheel, torque_available, slip, pull):
    """`best_points`, compiled, into `slip` and `pull` [n]."""
    for k in range(load.size):
        soil = soil_of(soils[k])
        best = best_point_at(nodes[0], load[k], soil, wheel, LEVEL, None, torque_available)
        slip[k] = best.slip
        pull[k] = best.drawbar_pull


def best_points(soils: np.ndarray, load: np.ndarray, wheel: Wheel) -> tuple[np.ndarray, np.ndarray]:
    """(slip [-], drawbar pull [N]) of `best_working_point` of many wheels, [n] each.

    `soils` [n, 13] are rows of `SoilState`, `load` [n] in N. All wheels have the sizes and the
    motor of `wheel`, whose stall torque is what is available.
    """
    slip = np.empty(len(load))
    pull = np.empty(len(load))
    rim = Rim(
        wheel.radius,
        wheel.width,
        0.0,
        0.0,
        wheel.tyre_deflection,
        wheel.tyre_compliance,
        wheel.grip,
    )
    rows = np.ascontiguousarray(soils, dtype=float).view(SOIL)
    _best_points(np.zeros(1, ARC_NODES), rows[:, 0], load, rim, wheel.stall_torque, slip, pull)
    return slip, pull
