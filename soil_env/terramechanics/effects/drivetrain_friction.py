"""Friction of the drivetrain between motor and axle."""

from typing import NamedTuple

from soil_env._compiled.elementary import smoothed_sign
from soil_env._compiled.flags import compiled

from .entry import TORQUE, Bench, Effect, EffectParameter as P, Form, Priors

SLOWEST_TURNING = 1e-6  # [rad/s] wheel speed that a prior is divided by, at least; own choice


class Friction(NamedTuple):
    """Torque lost between motor and axle, with its derivatives."""

    torque: float  # [N m]
    by_torque: float  # by the torque at the axle
    by_wheel_speed: float  # [N m s]


@compiled
def friction_at(torque, wheel_speed, floor, fx):
    """`Friction` against the turning: Coulomb friction, a share of the |torque| [N m] at the axle,
    and viscous friction. The sign of the wheel speed [rad/s] is smoothed below `floor` [rad/s].
    """
    direction, direction_slope = smoothed_sign(wheel_speed, floor)
    share = fx.drivetrain_friction_share
    viscous = fx.drivetrain_friction_viscous
    size = fx.drivetrain_friction_constant + share * abs(torque)
    return Friction(
        direction * size + viscous * wheel_speed,
        direction * (-share if torque < 0.0 else share),
        direction_slope * size + viscous,
    )


def _priors(bench: Bench) -> Priors:
    """(standard deviation, low, high) of the priors of constant and viscous friction; own choice.

    Both scale with 0.3 of load times radius, which is about the torque of a driven wheel. That of
    viscous friction is divided by the wheel speed [rad/s] at the table's median speed.
    """
    torque = 0.3 * bench.load * bench.radius
    turning = max(bench.median_speed / bench.radius, SLOWEST_TURNING)
    return {
        "constant": (0.3 * torque, 0.0, 4.0 * torque),
        "viscous": (0.2 * torque / turning, 0.0, 3.0 * torque / turning),
    }


_ARMSTRONG = "Armstrong-Helouvry et al. (1994), Automatica 30:1083-1138"
EFFECT = Effect(
    "drivetrain_friction",
    "friction of the drivetrain",
    (
        P("constant", "T0", 0.0, 1e6, 0.0, "Coulomb friction", unit="N m"),
        P("share", "e", 0.0, 1.0, 0.1, "share of the torque"),
        P("viscous", "v", 0.0, 1e6, 0.0, "viscous friction", unit="N m s"),
    ),
    (
        Form("coulomb", ("constant",), "T_measured = T + {constant}", _ARMSTRONG),
        Form(
            "coulomb_and_load",
            ("constant", "share"),
            "T_measured = T + {constant} + {share} |T|",
            _ARMSTRONG,
        ),
        Form(
            "coulomb_and_viscous",
            ("constant", "viscous"),
            "T_measured = T + {constant} + {viscous} w",
            _ARMSTRONG,
            needs_speed=True,
        ),
    ),
    moves=(TORQUE,),
    beside="speed",  # lubricated friction falls and rises again with the speed (Stribeck)
    symbols={"T_measured": "measured torque", "w": "wheel speed, rad/s"},
    priors=_priors,
    explained="Bearings, gears and seals take torque between the sensor and the wheel.",
)
