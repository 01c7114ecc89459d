"""The soil that an estimate of the identifier stands for."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from soil_env._numba.compiling import compiled_inline, uncompiled
from soil_env.parameters import Belief, Scenario, SoilState

STIFFEST = 1e13  # largest sinkage coefficient that an estimate may stand for, whatever its exponent
MOST_DIGGING = 20.0  # largest gain of digging that an estimate may stand for
LEAST_LOAD = 0.05  # share of the weight below which a measured load counts as this share


@compiled_inline
def soil_of_estimate(x, dig_gain, exponent, dig_recovery):
    """`SoilState` of the estimate x [5] of (phi [rad], ln K, ln S, cohesion, ln(gain of digging / `dig_gain`)).

    Exponent and recovery of digging are those of the belief.
    """
    return SoilState(
        math.tan(x[0]), x[3], math.exp(x[1]), min(math.exp(x[2]), STIFFEST), exponent,
        min(dig_gain * math.exp(x[4]), MOST_DIGGING), dig_recovery,
    )  # fmt: skip


def published(x: Any, sd: Any, pull: Any, dig_gain: float, of: Any = math) -> dict[str, Any]:
    """Published numbers of an estimate x [5] with its sd [5] and of the best drawbar pull [2] with its sd.

    Of arrays [5, wheels] and [2, wheels] with `of` numpy.
    """
    return {
        "friction_angle_deg": of.degrees(x[0]),
        "shear_modulus": of.exp(x[1]),
        "sinkage_coefficient": of.exp(x[2]),
        "cohesion": x[3],
        "dig_gain": dig_gain * of.exp(x[4]),
        "friction_angle_sd_deg": of.degrees(sd[0]),
        "shear_modulus_relative_sd": sd[1],
        "sinkage_coefficient_relative_sd": sd[2],
        "cohesion_sd": sd[3],
        "dig_gain_relative_sd": sd[4],
        "best_pull": pull[0],
        "best_pull_sd": pull[1],
    }


def traversability(
    estimate: np.ndarray,
    pull: np.ndarray,
    load: float,
    pitch: float,
    scenario: Scenario,
    best_point: Callable[..., Any],
) -> tuple[float, float, float, float, float, bool]:
    """(best slip, drawbar margin and its sd, torque required, torque available, whether passable) of the ground.

    By an estimate [5] and its best drawbar pull [2], under `load` [N] at `pitch` [rad]; `best_point`:
    `best_working_point`.
    """
    wheel = scenario.wheel
    soil = soil_as_identified(estimate, scenario.belief)
    best = best_point(load, soil, wheel.radius, wheel.width, wheel.stall_torque)
    turns = best.drawbar_pull > -math.inf  # at some slip the motor has the torque
    margin, sd = max(float(pull[0]) - math.tan(pitch), -1.0) if turns else -1.0, float(pull[1])
    return best.slip, margin, sd, best.torque, wheel.stall_torque, margin > 0.0


def soil_as_identified(estimate: np.ndarray, belief: Belief) -> SoilState:
    """`soil_of_estimate` of an estimate [5] under a belief; the friction angle to the bit as published, in degrees."""
    phi, *rest = estimate.tolist()
    x = math.radians(math.degrees(phi)), *rest
    return uncompiled(soil_of_estimate)(x, belief.dig_gain, belief.sinkage_exponent, belief.dig_recovery)
