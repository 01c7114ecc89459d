"""Shear softening: strength with a peak and a residual."""

from soil_env._compiled.flags import compiled
from soil_env.terramechanics.contact import ShearLaw

from .entry import Bench, Effect, EffectParameter as P, Form, Priors

#: Eq. (10) as a `ShearLaw`.
JANOSI = ShearLaw(1.0, 0.0, 0.0, 1.0, 0.0)


@compiled
def mobilisation(fx):
    """`ShearLaw` with a peak and a residual strength; that of Janosi & Hanamoto, Eq. (10), where
    the effect is off.

    (1 - x)(1 + s x) with x = exp(-j/K), j being the shear displacement, falls from its peak to the
    residual share 4 s/(1 + s)^2 for s > 1 (family of Wong 1983). It is divided by its peak, so that
    phi and c stay those of the peak. A sharpness s below 1 has no peak and counts as 0.
    `shear_softening_drop` lets the strength decay to the residual 1 - d over the length L beyond an
    onset (Oida 1979). With both the residual is the product of the two, and the peak is never
    passed.
    """
    s = fx.shear_softening_sharpness
    drop = fx.shear_softening_drop
    if s < 1.0:
        s = 0.0  # no peak: off
    peak = (1.0 + s) * (1.0 + s) / (4.0 * s) if s > 1.0 else 1.0
    return ShearLaw(
        (1.0 - drop) / peak,
        s / peak,
        drop / peak,
        fx.shear_softening_length,
        fx.shear_softening_onset,
    )


@compiled
def shear_length_ratio(fx):
    """Length that takes the place of K in the shear law, over K.

    With `shear_softening_slope_kept` it is 4 s/(1 + s), so that the law rises at first as Eq. (10)
    does with K. Without it, and for a sharpness s below 1, where the law has no peak, it is 1.
    """
    s = fx.shear_softening_sharpness
    # at 1 too, where the law is 1 - x^2: with 2 K it is Eq. (10)
    if s >= 1.0 and fx.shear_softening_slope_kept > 0.0:
        return 4.0 * s / (1.0 + s)
    return 1.0


def _priors(bench: Bench) -> Priors:
    """(standard deviation, low, high) of the priors of sharpness and onset [m], about their neutral
    values; own choice. The prior of the onset scales with the wheel radius.
    """
    return {
        "sharpness": (4.0, 1.0, 30.0),  # below 1 the law has no peak
        "onset": (0.15 * bench.radius, 0.0, 2.0 * bench.radius),
    }


_WONG = "Wong & Preston-Thomas (1983), J. Terramechanics 19:225-234"
_HUMP = "tau = tau_max 4 {sharpness} (1 - x) (1 + {sharpness} x)/(1 + {sharpness})^2; "
EFFECT = Effect(
    "shear_softening",
    "peak and residual strength",
    (
        P("sharpness", "s", 0.0, 30.0, 4.0, "off below 1; the residual share is 4 s/(1 + s)^2"),
        P(
            "slope_kept",
            "",
            0.0,
            1.0,
            1.0,
            "1: K is that of the first slope, k = 4 s/(1 + s); 0: k = 1",
        ),
        P("drop", "d", 0.0, 0.9, 0.3, "share of the strength that is lost"),
        P(
            "length",
            "L",
            2e-3,
            1.0,
            0.7,
            "displacement over which it is lost",
            unit="m",
            neutral=0.05,
            centre=0.05,
        ),
        P("onset", "j0", 0.0, 0.5, 0.0, "displacement from which it is lost", unit="m"),
    ),
    (
        Form("hump", ("sharpness",), _HUMP + "x = exp(-j/K)", _WONG),
        Form(
            "hump_of_first_slope",
            ("sharpness",),
            _HUMP + "x = exp(-j/(k K)); k = 4 {sharpness}/(1 + {sharpness})",
            _WONG,
            (("slope_kept", 1.0),),
        ),
        Form(
            "decaying",
            ("drop", "length", "onset"),
            "tau = tau_max (1 - exp(-j/K)) [1 - {drop} + {drop} exp(-(j - {onset})/{length})], "
            "the bracket 1 up to j = {onset}",
            "Oida (1979); Wong (2010), Terramechanics and Off-Road Vehicle Engineering",
        ),
    ),
    symbols={"j": "shear displacement", "tau": "shear stress", "tau_max": "c + sigma tan(phi)"},
    priors=_priors,
    neutral=lambda bench: {"length": 0.3 * bench.radius},
    explained=(
        "The strength of the soil rises to a peak and falls to a residual as it is sheared further."
    ),
)
