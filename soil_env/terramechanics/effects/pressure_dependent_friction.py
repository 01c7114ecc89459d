"""Pressure-dependent friction: a strength envelope that is curved."""

from soil_env._compiled.elementary import power
from soil_env._compiled.flags import compiled
from soil_env.terramechanics.ground import with_strength

from .entry import Bench, Effect, EffectParameter as P, Form

LEAST_PRESSURE = 1e-3  # [of the reference] below which soil changes no more; own choice


@compiled
def pressure_factor(pressure, reference, exponent):
    """(pressure/reference)^exponent, both in Pa; the ratio counts as at least `LEAST_PRESSURE`."""
    return power(max(pressure / reference, LEAST_PRESSURE), exponent)


@compiled
def rubbed_under_pressure(soil, passage, fx):
    """`soil` with tan(phi) times the `pressure_factor` of the pressure of a `Passage`."""
    factor = pressure_factor(
        passage.pressure,
        fx.pressure_dependent_friction_reference_pressure,
        fx.pressure_dependent_friction_exponent,
    )
    return with_strength(soil, factor * soil.tan_phi, soil.cohesion, soil.shear_modulus)


def middle_pressure(bench: Bench) -> dict[str, float]:
    """The pressure [Pa] of the table's median load as reference pressure, which is not fitted."""
    return {"reference_pressure": bench.pressure}


#: Reference pressure, also of `pressure_dependent_modulus`. It is not fitted: in a fit it is the
#: `middle_pressure` of the table.
REFERENCE = P("reference_pressure", "p0", 1.0, 1e7, 0.0, "reference pressure", "Pa", 1e4)
EFFECT = Effect(
    "pressure_dependent_friction",
    "friction that changes with pressure",
    (
        P("exponent", "m", -1.0, 1.0, 0.12, "power of the pressure"),
        REFERENCE,
    ),
    (
        Form(
            "power",
            ("exponent",),
            "tan(phi_p) = tan(phi) (p/{reference_pressure})^{exponent}; p = W/(b r)",
            "Baker (2004), Can. Geotech. J. 41:367-382, strength as a power of the stress",
        ),
    ),
    varies="load",
    symbols={"phi_p": "friction angle at the pressure p", "p": "mean pressure, of the load"},
    neutral=middle_pressure,
    explained="Soil that is pressed harder has a smaller (or larger) angle of friction.",
)
