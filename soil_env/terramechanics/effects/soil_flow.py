"""Soil that flows along the rim, which a braked wheel shows most."""

from soil_env._compiled.flags import compiled
from soil_env.parameters.soil import MOST_FLOW, MOST_PEAK
from soil_env.terramechanics.ground import with_flow

from .entry import Effect, EffectParameter as P, Form


@compiled
def flowing(soil, fx):
    """`soil` that flows by its own constants and those of the effect: the sums of `rim_flow` and of
    `braked_peak`, at most `MOST_FLOW` and `MOST_PEAK`.
    """
    flow = min(soil.rim_flow + fx.soil_flow_rim_flow, MOST_FLOW)
    peak = min(soil.braked_peak + fx.soil_flow_braked_peak, MOST_PEAK)
    return with_flow(soil, flow, peak)


EFFECT = Effect(
    "soil_flow",
    "soil that flows along the rim",
    (
        P("rim_flow", "a", 0.0, MOST_FLOW, 0.1, "soil carried along the rim"),
        P("braked_peak", "q", 0.0, MOST_PEAK, 0.25, "forward shift of the braked stress peak"),
    ),
    (
        Form(
            "carried",
            ("rim_flow", "braked_peak"),
            "kappa = {rim_flow} tan(phi) (1 - i)^3; "
            "thetam = [1/2 + {braked_peak} s/(1 + s)] theta1",
            "after Wong & Reece (1967), J. Terramechanics 4(2):7-25, part II; own form",
        ),
    ),
    symbols={
        "i": "slip, below 0 where the wheel is braked",
        "kappa": "speed of the soil along the rim over the travel speed, below its bound",
        "s": "share of its travel that a braked wheel slides, -i below 0",
    },
    explained=(
        "Soil in front of the wheel moves along with its rim, and a braked wheel is pressed most "
        "further ahead."
    ),
)
