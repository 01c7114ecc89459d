"""Multipass: soil in the track of earlier passes."""

from numba import njit

from soil_env._compiled.elementary import exp, power
from soil_env._compiled.flags import EXACT
from soil_env.terramechanics.effects.entry import (
    PULL,
    SINKAGE,
    TORQUE,
    Effect,
    EffectParameter as P,
    Form,
)
from soil_env.terramechanics.ground import stiffened, with_strength


@njit(**EXACT)
def depends_on_passes(fx):
    """True if earlier passes change the soil."""
    if fx is None:
        return False
    else:
        bearing = (
            fx.multipass_gain != 0.0
            or fx.multipass_per_pass != 0.0
            or fx.multipass_slip_gain != 0.0
        )
        strength = (
            fx.multipass_stiffening != 0.0
            or fx.multipass_strength != 0.0
            or fx.multipass_cohesion != 0.0
        )
        return bearing or strength or fx.multipass_hardening != 0.0


@njit(**EXACT)
def pass_factor(passes, slip, fx):
    """Sinkage coefficient in the track of earlier passes over that of fresh soil, earlier passes at
    the same slip.

    N^a [1 + g (1 - exp(-(N - 1)/d)) + s (1 - exp(-|i|/k1)) + p (N - 1)].
    """
    if passes <= 1.0:
        return 1.0
    more = passes - 1.0
    gain = fx.multipass_gain * (1.0 - exp(-more / fx.multipass_passes))
    gain += fx.multipass_per_pass * more
    gain += fx.multipass_slip_gain * (1.0 - exp(-abs(slip) / fx.multipass_slip_scale))
    return power(passes, fx.multipass_hardening) * max(1.0 + gain, 0.05)


@njit(**EXACT)
def passed_over(soil, passage, fx):
    """Soil in the track: bearing by `pass_factor`, strength and K by powers of the pass number."""
    if not depends_on_passes(fx):
        return soil
    passes = max(passage.passes, 1.0)
    stronger = with_strength(
        soil,
        soil.tan_phi * power(passes, fx.multipass_strength),
        soil.cohesion * power(passes, fx.multipass_cohesion),
        soil.shear_modulus * power(passes, -fx.multipass_stiffening),
        soil.rim_flow,
    )
    return stiffened(stronger, pass_factor(passes, passage.slip, fx))


_SENATORE = "Senatore & Sandu (2011), J. Terramechanics 48:265-276"
_STIFFER = "K_N = K N^(-{stiffening}); "
_STRONGER = "tan(phi_N) = tan(phi) N^{strength}"
_MORE_COHESIVE = "c_N = c N^{cohesion}"
EFFECT = Effect(
    "multipass",
    "multipass",
    (SINKAGE, PULL, TORQUE),
    (
        P("hardening", "a", "", 0.0, -1.0, 3.0, 0.4, "power of the pass number"),
        P("gain", "g", "", 0.0, -0.8, 8.0, 0.8, "saturating gain"),
        P("passes", "d", "", 1.0, 0.3, 10.0, 0.5, "passes to saturation", centre=1.0),
        P("slip_gain", "s", "", 0.0, -0.8, 8.0, 0.5, "gain after passes at much slip"),
        P(
            "slip_scale",
            "k1",
            "",
            0.2,
            0.02,
            2.0,
            0.5,
            "slip of those passes that brings most of it",
            centre=0.2,
        ),
        P("per_pass", "p", "", 0.0, -0.4, 2.0, 0.2, "gain with each pass"),
        P("stiffening", "k", "", 0.0, -1.0, 1.5, 0.15, "on the shear deformation modulus"),
        P("strength", "f", "", 0.0, -0.5, 0.5, 0.05, "on the friction"),
        P("cohesion", "h", "", 0.0, -1.0, 2.0, 0.2, "on the cohesion"),
    ),
    (
        Form(
            "power",
            ("hardening", "stiffening", "strength"),
            "S_N = S N^{hardening}; " + _STIFFER + _STRONGER,
            "Wong (2010), Terramechanics and Off-Road Vehicle Engineering",
        ),
        Form(
            "saturating",
            ("gain", "passes", "stiffening", "strength", "cohesion"),
            "S_N = S [1 + {gain} (1 - exp(-(N - 1)/{passes}))]; "
            + _STIFFER
            + _STRONGER
            + "; "
            + _MORE_COHESIVE,
            _SENATORE,
        ),
        Form(
            "slip_history",
            ("slip_gain", "slip_scale", "per_pass", "stiffening", "cohesion"),
            "S_N = S [1 + {slip_gain} (1 - exp(-i/{slip_scale})) + {per_pass} (N - 1)]; "
            + _STIFFER
            + _MORE_COHESIVE,
            _SENATORE,
        ),
    ),
    varies="pass",
    symbols={
        "N": "pass number, 1 = fresh soil; the laws hold from N = 2",
        "S_N": "sinkage coefficient on pass N",
        "K_N": "shear deformation modulus on pass N",
        "c_N": "cohesion on pass N",
        "phi_N": "friction angle on pass N",
    },
)
