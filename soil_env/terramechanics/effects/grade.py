"""Grade: weight along the slope, and weaker bearing on it."""

import math

from soil_env._compiled.elementary import asin_root, power
from soil_env._compiled.flags import compiled
from soil_env.terramechanics.ground import stiffened

from .entry import Effect, EffectParameter as P, Form

LEAST_FRICTION = 1e-3  # [rad] friction angle that a grade is divided by, at least; own choice
LEAST_LEFT = 0.02  # [-] of 1 - |b|/phi, so that S stays > 0 on the steepest slopes; own choice


@compiled
def weight_on_slope(load, sin_grade, fx):
    """(load normal to the ground, component downhill along it) [N] of the weight W = `load` [N].

    On a grade b they are W cos(b) and W sin(b) at a `grade_share` of 1, which is for a vertical
    load. They are W and 0 at a share of 0, for a load that is normal already. Both are linear in
    the share.
    """
    normal = load * (1.0 - fx.grade_share * (1.0 - math.sqrt(1.0 - sin_grade * sin_grade)))
    return normal, fx.grade_share * load * sin_grade


@compiled
def slope_factor(soil, sin_grade, fx):
    """Sinkage coefficient on a slope over that on the level: Meyerhof's (1 - |b|/phi)^2 for a load
    at the angle b of the grade, to the power w, the effect's `weakening`.

    phi is the friction angle of `soil`. It counts as at least `LEAST_FRICTION`, and 1 - |b|/phi as
    at least `LEAST_LEFT`.
    """
    phi = asin_root(soil.tan_phi * soil.tan_phi / (1.0 + soil.tan_phi * soil.tan_phi))
    left = 1.0 - asin_root(sin_grade * sin_grade) / max(phi, LEAST_FRICTION)
    return power(max(left, LEAST_LEFT), 2.0 * fx.grade_weakening)


@compiled
def weakened_on_slope(soil, passage, fx):
    """`soil` with S times the `slope_factor` of the undisturbed soil."""
    return stiffened(soil, slope_factor(passage.undisturbed, passage.sin_grade, fx))


_WEIGHT = "W_n = W [1 - {share} (1 - cos(b))]; DP = DP_0 - {share} W sin(b)"
EFFECT = Effect(
    "grade",
    "grade",
    (
        P("share", "f", -0.5, 2.0, 1.0, "share of the weight that acts along the slope"),
        P("weakening", "w", -1.0, 3.0, 0.7, "loss of bearing on slopes, 1 as Meyerhof has it"),
    ),
    (
        Form(
            "weight",
            ("share",),
            _WEIGHT,
            "Wong (2010), Terramechanics and Off-Road Vehicle Engineering",
        ),
        Form(
            "weight_and_bearing",
            ("share", "weakening"),
            _WEIGHT + "; S_b = S (1 - |b|/phi)^(2 {weakening})",
            "Meyerhof (1953, 1963), factor of inclined loads",
        ),
    ),
    varies="grade_deg",
    symbols={
        "b": "grade",
        "W_n": "load normal to the slope",
        "S_b": "sinkage coefficient on the slope",
    },
    sensed=("share",),
    explained="On a slope a part of the weight acts along the ground, and the ground carries less.",
)
