"""Bias of the measured slip."""

from soil_env._compiled.flags import compiled
from soil_env.slip import slip_of_radius

from .entry import Effect, EffectParameter as P, Form


@compiled
def true_slip(measured, fx):
    """Slip of the wheel at a `measured` slip m that is off by an offset d, or was computed with a
    wrong rolling radius; cut to [-1, 1].

    i = m + d, or i = m + e (1 - m) of a driven wheel: V/(r w) is 1 - e times as large as measured.
    """
    if fx is None:
        return measured
    else:
        slip = slip_of_radius(measured, 1.0 - fx.slip_bias_radius_error) + fx.slip_bias_offset
        return min(max(slip, -1.0), 1.0)


@compiled
def measured_slip(slip, fx):
    """Inverse of `true_slip`, not cut: what a sensor shows at a true `slip`.

    `fx`: `Effects`, `SensorErrors` of `simulation.world.sensors`, or None, which leaves the slip as
    it is.
    """
    if fx is None:
        return slip
    else:
        return slip_of_radius(slip - fx.slip_bias_offset, 1.0 / (1.0 - fx.slip_bias_radius_error))


_WONG = "Wong (2010), Terramechanics and Off-Road Vehicle Engineering"
EFFECT = Effect(
    "slip_bias",
    "bias of the measured slip",
    (
        P("offset", "d", -0.3, 0.3, 0.03, "offset of the slip"),
        P("radius_error", "e", -0.3, 0.3, 0.03, "relative error of the rolling radius"),
    ),
    (
        Form("offset", ("offset",), "i = i_measured + {offset}", _WONG),
        Form(
            "rolling_radius",
            ("radius_error",),
            "i = i_measured + {radius_error} (1 - i_measured)",
            _WONG,
        ),
    ),
    beside="speed",  # the zero of a speed sensor counts the more, the slower the wheel
    any_form=True,
    symbols={"i_measured": "measured slip"},
    sensed=("offset", "radius_error"),
    explained=(
        "The recorded slip is off, by its zero or by the rolling radius that it was computed with."
    ),
)
