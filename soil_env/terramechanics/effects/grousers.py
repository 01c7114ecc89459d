"""Grousers: soil sheared at a larger radius, or lugs that push like blades."""

import math

from soil_env._compiled.flags import compiled

from .bulldozing import passive_coefficient
from .entry import Bench, Effect, EffectParameter as P, Form, Priors

BLADE_SLIP = 0.015  # [-] slip over which the thrust of the lugs comes in; own choice


@compiled
def contact_radius(wheel, fx):
    """Radius [m] that carries the normal stress: that of the rim, with effects plus a share of the
    lugs' height (above 1: soil packed beyond their tips).
    """
    if fx is None:
        return wheel.radius
    else:
        return wheel.radius + fx.grousers_radius_share * wheel.grouser_height


@compiled
def shear_radius_ratio(wheel, fx):
    """Radius at which the soil between the lugs is sheared, over the `contact_radius`: that radius
    plus another share of the lugs' height, `shear_share`. 1 without effects.
    """
    if fx is None:
        return 1.0
    else:
        return 1.0 + fx.grousers_shear_share * wheel.grouser_height / contact_radius(wheel, fx)


@compiled
def blade_thrust(theta1, sinkage, soil, wheel, fx):
    """Thrust [N] of the lugs in the ground along the rim of a slipping wheel: lugs a radian x
    theta1 [rad] x thrust of one. `blades_at` scales it by the slip.

    One blade of width b and height h pushes soil out with b (1/2 gamma h^2 Kp + q h Kp + 2 c h sqrt
    Kp) (Bekker 1969). q = gamma z/2 is the average pressure of the soil above a blade. A sinkage
    z [m] below 0 counts as 0; lugs a radian are the parameter `blades`.
    """
    height = wheel.grouser_height
    kp = passive_coefficient(soil.tan_phi)
    weight = 0.5 * wheel.unit_weight * height * (height + max(sinkage, 0.0)) * kp
    one = wheel.width * (weight + 2.0 * soil.cohesion * height * math.sqrt(kp))
    return fx.grousers_blades * theta1 * one


@compiled
def blades_at(thrust, slip):
    """(the part of the `blade_thrust` [N] that acts at this slip, its derivative by the slip).

    The part is tanh(slip/`BLADE_SLIP`): 0 where the wheel rolls freely, backward braked.
    """
    share = math.tanh(slip / BLADE_SLIP)
    return thrust * share, thrust * (1.0 - share * share) / BLADE_SLIP


def _priors(bench: Bench) -> Priors:
    """Prior of `blades` [1/rad], normal about 0 and not below it: the standard deviation is the
    number of lugs a radian of rim, the upper bound twice that.

    Own choice: the soil between two lugs is shared by them. Empty where the number of lugs is not
    known: then the prior of the parameter stays.
    """
    if bench.lugs is None:
        return {}
    return {"blades": (bench.lugs / (2.0 * math.pi), 0.0, bench.lugs / math.pi)}


_DING = "Ding et al. (2011), J. Terramechanics 48:27-45"
_AT_RIM = (("slip_at_rim", 1.0),)
EFFECT = Effect(
    "grousers",
    "grousers",
    (
        P("shear_share", "l", 0.0, 2.0, 0.6, "share of the height added to the shear radius"),
        P("radius_share", "l", 0.0, 2.0, 0.6, "share of the height added to the wheel radius"),
        P(
            "slip_at_rim",
            "",
            0.0,
            1.0,
            1.0,
            "1: slip was taken at the rim, so soil between lug tips moves faster",
        ),
        P(
            "blades",
            "m",
            0.0,
            20.0,
            4.0,
            "lugs in the ground for each radian of contact",
            unit="1/rad",
        ),
    ),
    (
        Form("shear_radius", ("shear_share",), "r_s = r + {shear_share} h", _DING),
        Form(
            "shear_radius_rim",
            ("shear_share",),
            "r_s = r + {shear_share} h, slip taken at the rim",
            _DING,
            _AT_RIM,
        ),
        Form("radius", ("radius_share",), "r_w = r + {radius_share} h", _DING),
        Form(
            "radius_rim",
            ("radius_share",),
            "r_w = r + {radius_share} h, slip taken at the rim",
            _DING,
            _AT_RIM,
        ),
        Form(
            "blades",
            ("blades",),
            "F = {blades} theta1 b [1/2 gamma h (h + z) Kp + 2 c h sqrt(Kp)] tanh(i/0.015); "
            "DP = DP_0 + F; T = T_0 + F (r + h/2)",
            "Bekker (1969), Introduction to Terrain-Vehicle Systems",
        ),
    ),
    symbols={
        "r_s": "radius at which the soil is sheared",
        "r_w": "radius of the wheel with its lugs",
        "F": "thrust of the lugs",
        "h": "lug height",
    },
    priors=_priors,
    hidden=lambda bench: "the wheel has no grousers (grouser_height 0)" if bench.smooth else "",
    explained=(
        "Lugs shear the soil at their tips, on a larger circle than the rim, or push against it "
        "as blades."
    ),
)
