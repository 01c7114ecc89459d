"""What is published of an estimate, in plain numbers: for infos and for readers that identify
nothing themselves.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from soil_env.parameters import FLOW_LAW, Belief, Soil

#: [s] of driving within which an immobilisation is foreseen, own choice: the network of
#: `online.immobilisation` was trained for them.
HORIZONS = (3.0, 5.0)
#: Keys of an info: probability of an immobilisation within each of the `HORIZONS`.
FORESEEN = tuple(f"immobilised_within_{horizon:g}_s" for horizon in HORIZONS)


class Traversability(NamedTuple):
    """Drawbar margin of the ground as identified (source paper, Section 6)."""

    best_slip: float  # [-] of the highest steady drawbar pull
    drawbar_margin: float  # [of load] best drawbar pull less the tangent of the grade; at least -1
    drawbar_margin_sd: float  # [of load] of the best drawbar pull
    torque_required: float  # [N m] at the best slip; 0 where the wheel can drive at none
    torque_available: float  # [N m] stall torque of the motor
    passable: bool  # the margin is above 0


def published(x: Any, sd: Any, dig_gain: float, of: Any = math) -> dict[str, Any]:
    """Published numbers by name of an estimate x [6] with its `sd` [6]. Where x and `sd` are
    [6, ...], each number is an array [...].

    `of`: the module whose `degrees` and `exp` are taken, `numpy` for arrays.

    x is phi [rad], ln K, ln S, c [Pa], ln of the gain of slip-sinkage over the nominal `dig_gain`,
    best pull [of load]. Published are SI units and angles in degrees. The sd of a logarithm is the
    relative one of its number.
    """
    return {
        "friction_angle_deg": of.degrees(x[0]),
        "shear_modulus": of.exp(x[1]),
        "sinkage_coefficient": of.exp(x[2]),
        "cohesion": x[3],
        "dig_gain": dig_gain * of.exp(x[4]),
        "friction_angle_sd_deg": of.degrees(sd[0]),
        "shear_modulus_relative_sd": sd[1],
        "sinkage_coefficient_relative_sd": sd[2],
        "cohesion_sd": sd[3],
        "dig_gain_relative_sd": sd[4],
        "best_pull": x[5],
        "best_pull_sd": sd[5],
    }


def soil_of_numbers(numbers: Mapping[str, float], belief: Belief, gravity: float) -> Soil:
    """The soil of `published` numbers at a gravity [m/s2], each cut to its bounds; other names are
    ignored. Exponent, recovery of digging and `FLOW_LAW` are the belief's.
    """
    known = ("sinkage_exponent", "dig_recovery", *FLOW_LAW)
    fixed = {name: getattr(belief, name) for name in known}
    return Soil.within({**numbers, **fixed, "gravity_measured": gravity})
