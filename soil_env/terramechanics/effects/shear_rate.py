"""Rate of shear: strength that depends on the sliding speed."""

from soil_env._compiled.elementary import log
from soil_env._compiled.flags import compiled
from soil_env.terramechanics.ground import with_strength

from .entry import Bench, Effect, EffectParameter as P, Form
from .penetration_rate import LEAST_FACTOR, rate_factor


@compiled
def sheared_fast(soil, passage, fx):
    """`soil` with tan(phi) and cohesion times the `rate_factor` of the sliding speed v, and the
    cohesion also times 1 + d ln(1 + v/v1), which is at least `LEAST_FACTOR`.
    """
    cohesion = soil.cohesion
    if fx.shear_rate_cohesion != 0.0:
        faster = log(1.0 + passage.slide / fx.shear_rate_onset_speed)
        cohesion *= max(1.0 + fx.shear_rate_cohesion * faster, LEAST_FACTOR)
    strength = rate_factor(
        passage.slide, fx.shear_rate_reference_speed, fx.shear_rate_exponent, fx.shear_rate_slope
    )
    return with_strength(soil, soil.tan_phi * strength, cohesion * strength, soil.shear_modulus)


def _neutral(bench: Bench) -> dict[str, float]:
    """Reference speed [m/s], which is not fitted, and median of the onset speed's prior: the
    geometric mean of the table's sliding speed, `Bench.sliding`. Empty where that is not known:
    then both have the values of the catalogue.
    """
    if bench.sliding > 0.0:
        return {"reference_speed": bench.sliding, "onset_speed": bench.sliding}
    return {}


def _hidden(bench: Bench) -> str:
    """Why no sliding speed is known in every row: a row at rest, or no speeds given; "" if the
    travel speed is known in every row.
    """
    if bench.speed > 0.0:
        return ""
    return "a speed of 0" if bench.highest_speed > 0.0 else "speed not given"


EFFECT = Effect(
    "shear_rate",
    "rate of shear",
    (
        P("exponent", "m", -0.3, 0.6, 0.07, "power of the sliding speed"),
        P("slope", "a", -0.3, 0.6, 0.07, "change by a factor e of the sliding speed"),
        P("cohesion", "d", -0.2, 1.5, 0.2, "of the cohesion alone"),
        P(
            "onset_speed",
            "v1",
            1e-5,
            10.0,
            1.5,
            "below which cohesion does not change",
            unit="m/s",
            neutral=0.02,
            centre=0.02,
        ),
        P("reference_speed", "v0", 1e-5, 10.0, 0.0, "reference speed", unit="m/s", neutral=0.02),
    ),
    (
        Form(
            "power",
            ("exponent",),
            "c_v = c (v/{reference_speed})^{exponent}; "
            "tan(phi_v) = tan(phi) (v/{reference_speed})^{exponent}",
            "own assumption, a power in place of the logarithm",
        ),
        Form(
            "logarithmic",
            ("slope",),
            "c_v = c [1 + {slope} ln(v/{reference_speed})]; "
            "tan(phi_v) = tan(phi) [1 + {slope} ln(v/{reference_speed})]",
            "Mitchell & Soga (2005), Fundamentals of Soil Behavior",
        ),
        Form(
            "cohesion",
            ("cohesion", "onset_speed"),
            "c_v = c [1 + {cohesion} ln(1 + v/{onset_speed})]; tan(phi_v) = tan(phi)",
            "Stafford & Tanner (1983), Soil Tillage Res. 3:245-260",
        ),
    ),
    varies="speed",
    shows_without=True,  # the sliding speed varies with slip, too
    symbols={
        "c_v": "cohesion at the sliding speed v",
        "phi_v": "friction angle at the sliding speed v",
        "v": "sliding speed |r w - V|",
    },
    neutral=_neutral,
    hidden=_hidden,
    explained="Soil that is sheared faster is stronger (or weaker).",
)
