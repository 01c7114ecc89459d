"""Slip-sinkage: a slipping wheel digs."""

from soil_env._compiled.flags import compiled
from soil_env.terramechanics.ground import with_digging

from .entry import Bench, Effect, EffectParameter as P, Form, Priors

LEAST_WAY = 1e-6  # [unit of `way`] way + recovery slid in `digging_ratio`, at least
MOST_SLIP = 0.95  # [-] slip above which `excavated_depth` grows no more; own choice


@compiled
def slip_sinkage_ratio(slip, gain, recovery):
    """Steady sinkage over the depth at which undisturbed soil carries the same pressure: 1 + gain
    |i| / (1 - |i| + recovery |i|).

    A deeper wheel has a longer contact and less pressure. So its sinkage over that of the same load
    without digging is less, about the ratio to the power n/(n + 1/2).

    gain = 1.5 and recovery = 0.5 give (1 + i)/(1 - 0.5 i) of Lyasko (2010), J. Terramechanics
    47(1):21-31; recovery = 0 gives the i/(1 - i) law of Reece for the soil a wheel excavates. For a
    braked wheel the digging is driven by the share |i| of its travel that it slides: 1 + gain |i| /
    (1 + recovery |i|).

    Both branches are the steady states of `excavation_rate`.
    """
    return digging_ratio(abs(slip), 1.0 if slip < 0.0 else 1.0 - slip, gain, recovery)


@compiled
def digging_ratio(slid, way, gain, recovery):
    """`slip_sinkage_ratio` where the rim slides by `slid` while the wheel travels by `way`: 1 +
    gain slid / (way + recovery slid).

    Both are ways, speeds or shares of either in one unit, and >= 0. The divisor is at least
    `LEAST_WAY`.
    """
    return 1.0 + gain * slid / max(way + recovery * slid, LEAST_WAY)


@compiled
def onto_fresh(x, low, high):
    """Distance [m] of a wheel at the place x [m] from the section of ground, from `low` to `high`
    [m], that it had touched before; 0 within the section.
    """
    return max(x - high, 0.0) + max(low - x, 0.0)


@compiled
def excavation_rate(travel_speed, slip_speed, gain, recovery, length):
    """Coefficients (A, B) [1/s] of the sinkage law dz/dt = B z_w - A z, which on fresh ground is

    dz/dt = { |V| (z_w - z) + |r w - V| [gain z_w - recovery (z - z_w)] } / length

    z_w [m] is the depth at which undisturbed soil carries the same pressure. `travel_speed` is |V|,
    `slip_speed` |r w - V| [m/s]; `length` [m] is the distance in which sinkage adapts.
    """
    a = (travel_speed + recovery * slip_speed) / length
    b = (travel_speed + (gain + recovery) * slip_speed) / length
    return a, b


@compiled
def digging(soil, fx):
    """(gain, recovery) of `slip_sinkage_ratio`: those of the effect where its gain is not 0 and it
    is not only `apparent`, else those of the soil.
    """
    if fx is None:
        return soil.dig_gain, soil.dig_recovery
    else:
        if fx.slip_sinkage_gain != 0.0 and fx.slip_sinkage_apparent == 0.0:
            return fx.slip_sinkage_gain, fx.slip_sinkage_recovery
        return soil.dig_gain, soil.dig_recovery


@compiled
def apparent_ratio(slip, fx):
    """Measured sinkage over that of the wheel: the `slip_sinkage_ratio` of the effect in its form
    `apparent`, else 1.
    """
    if fx is None:
        return 1.0
    else:
        if fx.slip_sinkage_apparent == 0.0:
            return 1.0
        return slip_sinkage_ratio(slip, fx.slip_sinkage_gain, fx.slip_sinkage_recovery)


@compiled
def excavated_depth(slip, fx):
    """Depth [m] that a slipping wheel excavates whatever its load: l |i| / (1 - |i|), the law of
    Reece with a length l. |i| counts as at most `MOST_SLIP`.
    """
    i = min(abs(slip), MOST_SLIP)
    return fx.slip_sinkage_length * i / (1.0 - i)


@compiled
def dug(soil, passage, fx):
    """`soil` with the exponent n + n1 |i|, at least 0, and with the gain and recovery of `digging`.

    i is the slip of a `Passage`, n1 the effect's `exponent_slope`.
    """
    n = max(soil.sinkage_exponent + fx.slip_sinkage_exponent_slope * abs(passage.slip), 0.0)
    gain, recovery = digging(soil, fx)
    return with_digging(soil, n, gain, recovery)


def _priors(bench: Bench) -> Priors:
    """Priors of the excavation length [m], by the median sinkage of the table, and of the
    exponent's slope, each (standard deviation, low, high); own choice.
    """
    return {
        "length": (0.3 * bench.sinkage, 0.0, 5.0 * bench.sinkage),
        "exponent_slope": (0.5, 0.0, 2.0),  # slip digs; below 0 it would raise the wheel
    }


_RATIO = "[1 + {gain} i/(1 - i + {recovery} i)]"
EFFECT = Effect(
    "slip_sinkage",
    "slip-sinkage",
    (
        P("gain", "g", 0.0, 10.0, 1.5, "digging"),
        P("recovery", "h", 0.0, 3.0, 0.5, "recovery", neutral=0.5, centre=0.5),
        P("exponent_slope", "n1", -1.0, 2.0, 0.5, "exponent per slip"),
        P("length", "l", 0.0, 0.3, 0.02, "excavation length", unit="m"),
        P(
            "apparent",
            "",
            0.0,
            1.0,
            1.0,
            "1: only the reading is deeper, the stresses stay as they are",
        ),
    ),
    (
        Form(
            "ratio",
            ("gain", "recovery"),
            f"z = z_w {_RATIO}",
            "Lyasko (2010), J. Terramechanics 47:21-31",
        ),
        Form(
            "exponent",
            ("exponent_slope",),
            "n(i) = n + {exponent_slope} i",
            "Ding et al. (2010), J. Cent. South Univ. Technol. 17:129-135",
        ),
        Form(
            "excavation",
            ("length",),
            "z = z_w + {length} i/(1 - i)",
            "Reece (1965-66), Proc. IMechE 180:45-66",
        ),
        Form(
            "apparent",
            ("gain", "recovery"),
            f"z_measured = z {_RATIO}",
            "Lyasko (2010), applied to the sinkage alone",
            (("apparent", 1.0),),
        ),
    ),
    symbols={
        "z_w": "depth at which undisturbed soil carries the same pressure",
        "z_measured": "measured sinkage",
    },
    priors=_priors,
    explained=(
        "A wheel that slips digs soil out from under itself and sinks deeper the more it slips."
    ),
)
