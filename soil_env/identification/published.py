"""What is published of an estimate, in plain numbers: for infos and for readers that identify
nothing themselves.
"""

import math
from collections.abc import Mapping
from typing import Any

from soil_env.parameters import FLOW_LAW, Belief, Soil

#: [s] of driving within which an immobilisation is foreseen (`online.immobilisation`).
HORIZONS = (3.0, 5.0)


def published(x: Any, sd: Any, pull: Any, dig_gain: float, of: Any = math) -> dict[str, Any]:
    """Published numbers of an estimate x [5] with its sd [5] and of the best drawbar pull [2] with
    its sd.

    Of arrays [5, wheels] and [2, wheels] with `of` numpy.
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
        "best_pull": pull[0],
        "best_pull_sd": pull[1],
    }


def soil_of_numbers(numbers: Mapping[str, float], belief: Belief, gravity: float) -> Soil:
    """The soil of `published` numbers at a gravity [m/s2], each within its bounds; exponent,
    recovery of digging and `FLOW_LAW` are the belief's.
    """
    known = ("sinkage_exponent", "dig_recovery", *FLOW_LAW)
    fixed = {name: getattr(belief, name) for name in known}
    return Soil.within({**numbers, **fixed, "gravity_measured": gravity})
