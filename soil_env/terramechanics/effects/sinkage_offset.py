"""Offset of the measured sinkage."""

from .entry import SINKAGE, Bench, Effect, EffectParameter as P, Form, Priors


def _priors(bench: Bench) -> Priors:
    """Prior of the offset: a standard deviation of 0.3 of the table's median sinkage, bounds of -+
    half the wheel radius; own choice.
    """
    return {"offset": (0.3 * bench.sinkage, -0.5 * bench.radius, 0.5 * bench.radius)}


EFFECT = Effect(
    "sinkage_offset",
    "offset of the measured sinkage",
    (P("offset", "d", -0.3, 0.3, 0.0, "offset of the sensor", unit="m"),),
    (Form("offset", ("offset",), "z_measured = z + {offset}", "zero of the sinkage sensor"),),
    moves=(SINKAGE,),
    beside="elapsed",  # zeros of sensors drift
    symbols={"z_measured": "measured sinkage"},
    sensed=("offset",),
    priors=_priors,
    explained="The zero of the sinkage sensor is off.",
)
