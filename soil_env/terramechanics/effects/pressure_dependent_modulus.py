"""Pressure-dependent modulus: a shear deformation modulus K that changes with the load."""

from soil_env._compiled.flags import compiled
from soil_env.terramechanics.ground import with_strength

from .entry import Effect, EffectParameter as P, Form
from .pressure_dependent_friction import REFERENCE, middle_pressure, pressure_factor


@compiled
def stretched_under_pressure(soil, passage, fx):
    """`soil` with K times the `pressure_factor` of the pressure of a `Passage`."""
    factor = pressure_factor(
        passage.pressure,
        fx.pressure_dependent_modulus_reference_pressure,
        fx.pressure_dependent_modulus_exponent,
    )
    return with_strength(soil, soil.tan_phi, soil.cohesion, factor * soil.shear_modulus)


EFFECT = Effect(
    "pressure_dependent_modulus",
    "shear modulus that changes with pressure",
    (
        P("exponent", "m", -3.0, 3.0, 0.6, "power of the pressure"),
        REFERENCE,
    ),
    (
        Form(
            "power",
            ("exponent",),
            "K_p = K (p/{reference_pressure})^{exponent}; p = W/(b r)",
            "own assumption, fitted on rigs",
        ),
    ),
    varies="load",
    symbols={
        "K_p": "shear deformation modulus at the pressure p",
        "p": "mean pressure, of the load",
    },
    neutral=middle_pressure,
    explained="Soil under a heavier wheel needs more way until its strength is there.",
)
