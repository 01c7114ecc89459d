"""Rate of penetration: bearing that depends on the travel speed."""

from soil_env._compiled.elementary import exp, log
from soil_env._compiled.flags import compiled
from soil_env.terramechanics.ground import stiffened

from .entry import Bench, Effect, EffectParameter as P, Form

LEAST_RATE = 0.02  # [of the reference speed] below which soil counts as loaded at rest; own choice
LEAST_FACTOR = 0.1  # [-] of a strength by its rate, where the logarithm would end it; own choice


@compiled
def rate_factor(speed, reference, exponent, slope):
    """Strength or bearing at `speed` over that at `reference` [m/s]: (v/v0)^m + a ln(v/v0).

    One of the power m (`exponent`) and a (`slope`) is 0 in each published form. v/v0 counts as at
    least `LEAST_RATE`; the factor is at least `LEAST_FACTOR`.
    """
    x = log(max(speed / reference, LEAST_RATE))
    return max(exp(exponent * x) + slope * x, LEAST_FACTOR)


@compiled
def loaded_fast(soil, passage, fx):
    """`soil` with S times the `rate_factor` of the travel speed."""
    factor = rate_factor(
        passage.speed,
        fx.penetration_rate_reference_speed,
        fx.penetration_rate_exponent,
        fx.penetration_rate_slope,
    )
    return stiffened(soil, factor)


def _neutral(bench: Bench) -> dict[str, float]:
    """The geometric mean of the travel speed [m/s] of the table as reference speed, which is not
    fitted. Empty where it is not known in every row: the parameter keeps its own.
    """
    return {"reference_speed": bench.speed} if bench.speed > 0.0 else {}


EFFECT = Effect(
    "penetration_rate",
    "rate of penetration",
    (
        P("exponent", "m", -0.5, 1.0, 0.12, "power of the speed"),
        P("slope", "a", -0.3, 1.0, 0.12, "change by a factor e of the speed"),
        P("reference_speed", "V0", 1e-4, 10.0, 0.0, "reference speed", unit="m/s", neutral=0.05),
    ),
    (
        Form(
            "power",
            ("exponent",),
            "S_V = S (V/{reference_speed})^{exponent}",
            "Grahn (1991), J. Terramechanics 28:339-347",
        ),
        Form(
            "logarithmic",
            ("slope",),
            "S_V = S [1 + {slope} ln(V/{reference_speed})]",
            "Wong (2010), Terramechanics and Off-Road Vehicle Engineering",
        ),
    ),
    varies="speed",
    symbols={"S_V": "sinkage coefficient at the speed V"},
    neutral=_neutral,
    explained="Soil that is loaded faster carries more (or less) before it gives way.",
)
