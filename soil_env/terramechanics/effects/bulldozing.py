"""Bulldozing: soil pushed ahead of the wheel."""

import math

from soil_env._compiled.flags import compiled

from .entry import PULL, Effect, EffectParameter as P, Form


@compiled
def passive_coefficient(tan_phi):
    """Rankine's coefficient of passive earth pressure, tan^2(45 deg + phi/2) = (1/cos phi + tan
    phi)^2, in the form that needs no difference.
    """
    root = math.sqrt(1.0 + tan_phi * tan_phi) + tan_phi
    return root * root


@compiled
def bulldozing_resistance(sinkage, soil, wheel, fx):
    """Resistance [N] of the soil pushed ahead of the wheel to the depth of its sinkage [m], which
    counts as at least 0.

    The sum of two laws, each times its factor, 0 if off: Rankine's, and that of Hegedus (1960),
    which Ishigami et al. (2007) take for the side of a wheel. Both are written out as `Form`s
    below. Of `wheel` width [m] and unit weight of the soil [N/m3] are read.
    """
    kp = passive_coefficient(soil.tan_phi)
    cot = math.sqrt(kp)  # cot X = tan(X + phi) = tan(45 deg + phi/2)
    z = max(sinkage, 0.0)
    pushed = 0.5 * wheel.unit_weight * z * z
    rankine = pushed * kp + 2.0 * soil.cohesion * z * cot
    hegedus = 2.0 * cot * (soil.cohesion * z + pushed * (cot + kp * soil.tan_phi))
    return wheel.width * (fx.bulldozing_rankine * rankine + fx.bulldozing_hegedus * hegedus)


EFFECT = Effect(
    "bulldozing",
    "bulldozing",
    (
        P("rankine", "f", 0.0, 6.0, 1.0, "factor on Rankine's passive pressure"),
        P("hegedus", "f", 0.0, 6.0, 1.0, "factor on the resistance of Hegedus"),
    ),
    (
        Form(
            "rankine",
            ("rankine",),
            "DP = DP_0 - {rankine} b [1/2 gamma z^2 Kp + 2 c z sqrt(Kp)]",
            "Bekker (1969), Introduction to Terrain-Vehicle Systems",
        ),
        Form(
            "hegedus",
            ("hegedus",),
            "DP = DP_0 - {hegedus} b D1 [c z + D2 gamma z^2/2]; D1 = cot(X) + tan(X + phi); "
            "D2 = cot(X) + cot(X)^2 tan(phi)",
            "Hegedus (1960); beside a wheel: Ishigami et al. (2007), J. Field Robotics 24:233-250",
        ),
    ),
    moves=(PULL,),
    symbols={"X": "45 deg - phi/2"},
    explained="The wheel pushes a heap of soil ahead of itself, which takes drawbar pull.",
)
