"""Contact behind the lowest point of the rim."""

from soil_env._compiled.flags import compiled

from .entry import Effect, EffectParameter as P, Form


@compiled
def exit_and_peak(theta1, fx):
    """(exit angle theta2 = -l theta1, angle of the stress peak) [rad].

    The peak is midway between entry and exit with `rear_contact_peak_follows` 1, at theta1/2 with
    0.
    """
    theta2 = -fx.rear_contact_ratio * theta1
    return theta2, 0.5 * (theta1 + fx.rear_contact_peak_follows * theta2)


EFFECT = Effect(
    "rear_contact",
    "contact behind the lowest point",
    (
        P("ratio", "l", 0.0, 0.95, 0.35, "exit angle over entry angle"),
        P(
            "peak_follows",
            "",
            0.0,
            1.0,
            1.0,
            "1: the stress peak stays midway; 0: it stays at theta1/2",
            neutral=1.0,
        ),
    ),
    (
        Form(
            "midway",
            ("ratio",),
            "theta2 = -{ratio} theta1; thetam = (theta1 + theta2)/2",
            "Iagnemma et al. (2004), IEEE Trans. Robotics 20:921-927",
        ),
        Form(
            "peak_kept",
            ("ratio",),
            "theta2 = -{ratio} theta1; thetam = theta1/2",
            "own assumption",
            (("peak_follows", 0.0),),
        ),
    ),
    explained=(
        "Soil that rebounds touches the wheel behind its lowest point too, and carries and shears "
        "there."
    ),
)
