"""Bulldozing: soil pushed ahead of the wheel."""

from soil_env._numba.compiling import compiled_inline, compiled_part
from soil_env._numba.elementary import larger, sqrt
from soil_env._numba.lanes import alike
from soil_env.terramechanics.effects.entry import PULL, Effect, EffectParameter as P, Form


@compiled_part
def passive_coefficient(tan_phi):
    """Rankine's coefficient of passive earth pressure, tan^2(45 deg + phi/2) = (1 + sin phi)/(1 - sin phi)."""
    secant = sqrt(1.0 + tan_phi * tan_phi)
    return (secant + tan_phi) / (secant - tan_phi)


@compiled_part
def bulldozing_resistance(sinkage, soil, unit_weight, b, fx):
    """Resistance [N] of the soil pushed ahead of the wheel to the depth of its sinkage.

    By Rankine, or by Hegedus (1960) as in Ishigami et al. (2007): `Form`s below.
    """
    if fx.bulldozing_rankine == 0.0 and fx.bulldozing_hegedus == 0.0:
        return alike(0.0, sinkage)
    kp = passive_coefficient(soil.tan_phi)
    z = larger(sinkage, 0.0)
    cot = sqrt(kp)  # cot X = tan(X + phi) = tan(45 deg + phi/2)
    rankine = b * (0.5 * unit_weight * z * z * kp + 2.0 * soil.cohesion * z * cot)
    hegedus = (
        2.0 * cot * (soil.cohesion * z + 0.5 * unit_weight * z * z * (cot + kp * soil.tan_phi))
    )
    return fx.bulldozing_rankine * rankine + fx.bulldozing_hegedus * b * hegedus


@compiled_inline
def _resistance(force, at, fx):
    """Force with the `bulldozing_resistance` [N]."""
    return force + bulldozing_resistance(at.sinkage, at.soil, at.unit_weight, at.width, fx)


EFFECT = Effect(
    "bulldozing",
    "bulldozing",
    (PULL,),
    (
        P("rankine", "f", "", 0.0, 0.0, 6.0, 1.0, "factor on Rankine's passive pressure"),
        P("hegedus", "f", "", 0.0, 0.0, 6.0, 1.0, "factor on the resistance of Hegedus"),
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
            "Hegedus (1960); Ishigami et al. (2007), J. Field Robotics 24:233-250",
        ),
    ),
    symbols={"X": "45 deg - phi/2"},
    resistance=_resistance,
)
