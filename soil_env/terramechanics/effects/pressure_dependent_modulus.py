"""Pressure-dependent modulus: a shear deformation modulus K that changes with the load."""

from soil_env._compiled.elementary import power
from soil_env._compiled.flags import compiled
from soil_env.terramechanics.ground import with_growing_modulus

from .entry import Bench, Effect, EffectParameter as P, Form
from .penetration_rate import rate_factor


@compiled
def stretched_under_pressure(soil, passage, fx):
    """`soil` with K times a power of the pressure p, and times (l/l0)^g of the contact length l.

    `contact.grown_modulus` knows l: g is added to `shear_growth`, and K taken from the length l0 to
    `shear_length`.
    """
    growth = fx.pressure_dependent_modulus_growth
    reference = fx.pressure_dependent_modulus_reference_pressure
    factor = rate_factor(
        passage.pressure, reference, fx.pressure_dependent_modulus_exponent, 0.0
    ) * power(soil.shear_length / fx.pressure_dependent_modulus_reference_length, growth)
    return with_growing_modulus(soil, factor * soil.shear_modulus, soil.shear_growth + growth)


def _neutral(bench: Bench) -> dict[str, float]:
    """The middle pressure and a contact length of the table as references, which are not fitted."""
    return {
        "reference_pressure": bench.pressure,
        "reference_length": (2.0 * bench.radius * bench.sinkage) ** 0.5,
    }


EFFECT = Effect(
    "pressure_dependent_modulus",
    "shear modulus that changes with pressure",
    (
        P("exponent", "m", -3.0, 3.0, 0.6, "power of the pressure"),
        P("growth", "g", -1.0, 3.0, 0.7, "power of the contact length"),
        P("reference_pressure", "p0", 1.0, 1e7, 0.0, "reference pressure", "Pa", 1e4),
        P("reference_length", "l0", 1e-4, 10.0, 0.0, "reference length", "m", 0.1),
    ),
    (
        Form(
            "pressure",
            ("exponent",),
            "K_p = K (p/{reference_pressure})^{exponent}; p = W/(b r)",
            "own assumption, fitted on rigs",
        ),
        Form(
            "contact_length",
            ("growth",),
            "K_p = K (r theta1/{reference_length})^{growth}",
            "own assumption, fitted on rigs: the law of the simulated world",
        ),
    ),
    varies="load",
    symbols={
        "K_p": "shear deformation modulus at the pressure p",
        "p": "mean pressure, of the load",
    },
    neutral=_neutral,
    explained="Soil under a larger or heavier contact needs more way until its strength is there.",
)
