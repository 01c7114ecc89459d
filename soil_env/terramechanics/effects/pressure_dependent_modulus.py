"""Pressure-dependent modulus: a shear deformation modulus K that goes with the contact length, and
so with the load.
"""

from soil_env._compiled.elementary import power
from soil_env._compiled.flags import compiled
from soil_env.terramechanics.ground import with_growing_modulus

from .entry import Bench, Effect, EffectParameter as P, Form


@compiled
def stretched_under_load(soil, fx):
    """`soil` with K times (l/l0)^g, with the contact length l that `contact.grown_modulus` knows.

    g is added to `shear_growth`, and K taken from the length l0 to `shear_length`.
    """
    growth = fx.pressure_dependent_modulus_growth
    factor = power(soil.shear_length / fx.pressure_dependent_modulus_reference_length, growth)
    return with_growing_modulus(soil, factor * soil.shear_modulus, soil.shear_growth + growth)


def _neutral(bench: Bench) -> dict[str, float]:
    """A contact length of the table as reference length, which is not fitted."""
    return {"reference_length": (2.0 * bench.radius * bench.sinkage) ** 0.5}


EFFECT = Effect(
    "pressure_dependent_modulus",
    "shear modulus that changes with pressure",
    (
        P("growth", "g", -1.0, 3.0, 0.7, "power of the contact length"),
        P("reference_length", "l0", 1e-4, 10.0, 0.0, "reference length", "m", 0.1),
    ),
    (
        Form(
            "contact_length",
            ("growth",),
            "K_l = K (r theta1/{reference_length})^{growth}",
            "own assumption, fitted on rigs: the law of the simulated world",
        ),
    ),
    varies="load",
    symbols={"K_l": "shear deformation modulus at the contact length"},
    neutral=_neutral,
    explained="Soil under a larger or heavier contact needs more way until its strength is there.",
)
