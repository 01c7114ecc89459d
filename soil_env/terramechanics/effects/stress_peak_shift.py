"""Stress peak that moves with slip."""

from soil_env._compiled.flags import compiled

from .entry import Bench, Effect, EffectParameter as P, Form, Priors


@compiled
def peak_shift(theta1, slip, fx):
    """Shift [rad] of the stress peak towards the entry: (a + c |i|) theta1, with the entry angle
    theta1 [rad], a the `offset` and c the `slope` of the effect.
    """
    share = fx.stress_peak_shift_offset + fx.stress_peak_shift_slope * abs(slip)
    return share * theta1


LOWEST_DRIVEN = -0.02  # [-] slip above which a wheel counts as driven; own choice


def _priors(bench: Bench) -> Priors:
    """Prior of the slope, at least 0 where the wheel is driven: every published peak of a driven
    wheel moves forward with slip. With braked rows the prior of the parameter stays.
    """
    return {"slope": (0.3, 0.0, 0.9)} if bench.lowest_slip > LOWEST_DRIVEN else {}


EFFECT = Effect(
    "stress_peak_shift",
    "moving stress peak",
    (
        P("offset", "a", -0.4, 0.4, 0.1, "shift without slip"),
        P("slope", "c", -0.6, 0.9, 0.3, "shift per slip"),
    ),
    (
        Form(
            "linear",
            ("offset", "slope"),
            "thetam = (1/2 + {offset} + {slope} i) theta1",
            "Wong & Reece (1967), J. Terramechanics 4(1):81-98",
        ),
    ),
    priors=_priors,
    explained=(
        "The place under the wheel where the soil presses hardest moves forward as the slip grows."
    ),
)
