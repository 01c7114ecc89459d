"""Friction of the drivetrain between motor and axle."""

from soil_env._numba.compiling import compiled_inline
from soil_env._numba.elementary import where_less
from soil_env.terramechanics.contact import smoothed_sign
from soil_env.terramechanics.effects.entry import (
    TORQUE,
    Bench,
    Effect,
    EffectParameter as P,
    Form,
    Friction,
)


@compiled_inline
def _drive(friction, at, fx):
    """`Friction` with Coulomb and viscous friction and a share of the torque; the floor smooths the sign."""
    turning, turn = smoothed_sign(at.wheel_speed, at.floor)
    size = fx.drivetrain_friction_constant + fx.drivetrain_friction_share * abs(at.torque)
    return Friction(
        friction.torque + turning * size + fx.drivetrain_friction_viscous * at.wheel_speed,
        friction.by_torque
        + turning * fx.drivetrain_friction_share * where_less(at.torque, 0.0, -1.0, 1.0),
        friction.by_wheel_speed + turn * size + fx.drivetrain_friction_viscous,
    )


def _priors(bench: Bench) -> dict[str, tuple[float, float, float]]:
    torque = 0.3 * bench.load * bench.radius
    turning = max(bench.median_speed / bench.radius, 1e-6)
    return {
        "constant": (0.3 * torque, 0.0, 4.0 * torque),
        "viscous": (0.2 * torque / turning, 0.0, 3.0 * torque / turning),
    }


_ARMSTRONG = "Armstrong-Helouvry et al. (1994), Automatica 30:1083-1138"
EFFECT = Effect(
    "drivetrain_friction",
    "friction of the drivetrain",
    (TORQUE,),
    (
        P("constant", "T0", "N m", 0.0, 0.0, 1e6, 0.0, "Coulomb friction"),
        P("share", "e", "", 0.0, 0.0, 1.0, 0.1, "share of the torque"),
        P("viscous", "v", "N m s", 0.0, 0.0, 1e6, 0.0, "viscous friction"),
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
    beside="speed",  # friction of lubricated bearings falls and rises again with the speed (Stribeck)
    symbols={"T_measured": "measured torque", "w": "wheel speed, rad/s"},
    priors=_priors,
    drive=_drive,
)
