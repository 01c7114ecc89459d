"""Stresses under a wheel as it moves now, by the compiled functions of the contact."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env.parameters import SoilState
from soil_env.terramechanics.contact import (
    JANOSI,
    entry_angle,
    mirror_angle,
    mobilised,
    motion_from_speeds,
    relative_stress,
    shear_displacement,
)
from soil_env.terramechanics.reaction import REST_SPEED, reaction

ARC_POINTS = 25


class Stresses(NamedTuple):
    """Stress along the contact arc, from the lowest point of the rim to the entry."""

    angle: np.ndarray  # [points] theta [rad]
    normal: np.ndarray  # [points] sigma [Pa], Eqs. (7) and (8)
    shear: np.ndarray  # [points] tau [Pa], Eq. (10), positive where it drives the wheel forward


def contact_stresses(
    soil: SoilState, load: float, speed: float, rim_speed: float, sinkage: float, r: float, b: float
) -> Stresses:
    """`Stresses` under a wheel of radius r and width b [m] at the sinkage coefficient that its load [N] mobilises.

    Speeds of travel and of the rim [m/s]; sinkage [m] below the ground that the wheel meets. The soil's own sinkage
    coefficient does not matter: so the same holds in a rut.
    """
    coefficient = reaction(speed, rim_speed, sinkage, load, soil, r, b).sinkage_coefficient
    rim, travel, _ = motion_from_speeds(rim_speed, speed, REST_SPEED)
    theta1 = entry_angle(sinkage, r)
    angle = np.linspace(0.0, theta1, ARC_POINTS)
    normal, shear = np.empty(ARC_POINTS), np.empty(ARC_POINTS)
    for i, theta in enumerate(angle):
        front = mirror_angle(theta, theta1, 0.0, 0.5 * theta1)
        normal[i] = coefficient * relative_stress(front, math.cos(theta1), soil.sinkage_exponent, r)
        j, _, _ = shear_displacement(theta, theta1, math.sin(theta1), rim, travel, r)
        share, _ = mobilised(j, soil.shear_modulus, JANOSI)
        shear[i] = (soil.cohesion + normal[i] * soil.tan_phi) * share
    return Stresses(angle, normal, shear)
