"""Multipass: soil in the track of earlier passes, in the simulated world and as an effect."""

import math

from soil_env._compiled.elementary import exp, power
from soil_env._compiled.flags import compiled
from soil_env.terramechanics.ground import stiffened, with_strength

from .entry import Effect, EffectParameter as P, Form

#: [-] q = 1 - 1/a of the ruts of the simulated world. The rut of N passes is z_1 N^(1/a), with
#: a = 2 to 3 on loose soil or under a light load (Saarilahti 1991, second-hand): the middle.
COMPACTION = 0.6
LEAST_PART = 1e-6  # [-] of the first pass that a later one still sinks, at least
LEAST_FACTOR = 0.05  # [-] of the gains of `pass_factor` together, so that S stays > 0; own choice


@compiled
def _part_of_pass(number, compaction):
    """Depth by which pass `number` sinks below the floor of the rut, over the depth of the first
    pass: N^(1 - q) - (N - 1)^(1 - q) with q = `compaction`; at least `LEAST_PART`.
    """
    grown = power(number, 1.0 - compaction) - power(number - 1.0, 1.0 - compaction)
    return max(grown, LEAST_PART)


@compiled
def rut_stiffness(passes, exponent, compaction):
    """Sinkage coefficient of the floor of a rut over that of fresh soil, for pass N; at least 1.

    The rut of N passes of a wheel is z_1 N^(1 - q) deep, with q = `compaction`, so pass N sinks
    `_part_of_pass` of z_1 below its floor. Sinkage is proportional to S^(-2/(2n + 1)) (Bekker
    1969), with the sinkage `exponent` n. Between whole numbers of passes, as between cells
    of a rut, the factor is linear.
    """
    if passes <= 1.0 or compaction == 0.0:
        return 1.0
    whole = math.floor(passes)
    h = -(exponent + 0.5)  # S is proportional to this power of the sinkage
    low = power(_part_of_pass(whole, compaction), h)
    if whole == passes:
        return low
    high = power(_part_of_pass(whole + 1.0, compaction), h)
    return low + (passes - whole) * (high - low)


@compiled
def bearing_goes_with_passes(fx):
    """True if the effect says how earlier passes change the sinkage coefficient; False without
    effects.
    """
    if fx is None:
        return False
    else:
        power_or_rut = fx.multipass_hardening != 0.0 or fx.multipass_compaction != 0.0
        gain = fx.multipass_gain != 0.0 or fx.multipass_per_pass != 0.0
        return power_or_rut or gain or fx.multipass_slip_gain != 0.0


@compiled
def in_rut(soil, passes, fx):
    """`soil` as the rut of the simulated world changes it for a wheel whose pass over it is number
    `passes`; 1 = fresh soil.

    S is multiplied by `rut_stiffness` with `COMPACTION`. It is unchanged where the effect
    `multipass` changes S: `passed_over` applies that effect later.
    """
    factor = 1.0
    if passes > 1.0 and not bearing_goes_with_passes(fx):
        factor = rut_stiffness(passes, soil.sinkage_exponent, COMPACTION)
    return stiffened(soil, factor)


@compiled
def pass_factor(passes, slip, exponent, fx):
    """Sinkage coefficient on pass N > 1 over that of fresh soil, where all earlier passes had the
    same slip i.

    N^a [1 + g (1 - exp(-(N - 1)/d)) + s (1 - exp(-|i|/k1)) + p (N - 1)], times `rut_stiffness`, in
    the symbols of `EFFECT`. The bracket is at least `LEAST_FACTOR`. On fresh soil, N = 1,
    `passed_over` does not apply it.
    """
    more = passes - 1.0
    gain = fx.multipass_gain * (1.0 - exp(-more / fx.multipass_passes))
    gain += fx.multipass_per_pass * more
    gain += fx.multipass_slip_gain * (1.0 - exp(-abs(slip) / fx.multipass_slip_scale))
    rut = rut_stiffness(passes, exponent, fx.multipass_compaction)
    return rut * power(passes, fx.multipass_hardening) * max(1.0 + gain, LEAST_FACTOR)


@compiled
def passed_over(soil, passage, fx):
    """`soil` in the track of earlier passes: bearing by `pass_factor`, strength and K by powers of
    the pass number; unchanged on the first pass.

    On pass N tan(phi) is multiplied by N^f, the cohesion by N^h and K by N^(-k), in the symbols of
    `EFFECT`.
    """
    passes = passage.passes
    if passes <= 1.0:
        return soil
    stronger = with_strength(
        soil,
        soil.tan_phi * power(passes, fx.multipass_strength),
        soil.cohesion * power(passes, fx.multipass_cohesion),
        soil.shear_modulus * power(passes, -fx.multipass_stiffening),
    )
    return stiffened(stronger, pass_factor(passes, passage.slip, soil.sinkage_exponent, fx))


_SENATORE = "Senatore & Sandu (2011), J. Terramechanics 48:265-276"
_STIFFER = "K_N = K N^(-{stiffening}); "
_STRONGER = "tan(phi_N) = tan(phi) N^{strength}"
_MORE_COHESIVE = "c_N = c N^{cohesion}"
EFFECT = Effect(
    "multipass",
    "multipass",
    (
        P("hardening", "a", -1.0, 3.0, 0.4, "power of the pass number"),
        P("gain", "g", -0.8, 8.0, 0.8, "saturating gain"),
        P("passes", "d", 0.3, 10.0, 0.5, "passes to saturation", neutral=1.0, centre=1.0),
        P("slip_gain", "s", -0.8, 8.0, 0.5, "gain after passes at much slip"),
        P(
            "slip_scale",
            "k1",
            0.02,
            2.0,
            0.5,
            "slip of those passes that brings most of it",
            neutral=0.2,
            centre=0.2,
        ),
        P("per_pass", "p", -0.4, 2.0, 0.2, "gain with each pass"),
        P("stiffening", "k", -1.0, 1.5, 0.15, "on the shear deformation modulus"),
        P("strength", "f", -0.5, 0.5, 0.05, "on the friction"),
        P("cohesion", "h", -1.0, 2.0, 0.2, "on the cohesion"),
        P("compaction", "q", 0.0, 0.8, 0.3, "1 - 1/a of ruts as deep as z_1 N^(1/a)"),
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
        Form(
            "rut_depth",
            ("compaction", "stiffening", "strength"),
            "S_N = S [N^(1 - {compaction}) - (N - 1)^(1 - {compaction})]^(-n - 1/2); "
            + _STIFFER
            + _STRONGER,
            "Saarilahti (1991), the ruts of the simulated world",
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
    explained="Soil that was driven over before is denser and carries and shears otherwise.",
)
