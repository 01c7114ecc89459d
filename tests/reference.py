"""Independent judge: Eqs. (1)-(12) of the source paper by adaptive quadrature.

Written from the equations, not from `soil_env` (which it must never import): Hutangkabodee, Zweiri, Seneviratne &
Althoefer (2006), IJAC 3:244-251, with the corrections in the notes on physics (r/K in the exponent of Eq. (10)).
Steady forward travel only. SI units, angles in rad.
"""

import math
from typing import NamedTuple

from scipy.integrate import quad
from scipy.optimize import brentq


class Ground(NamedTuple):
    """A soil in the terms of the paper."""

    friction_angle_deg: float
    cohesion: float  # c [Pa]
    shear_modulus: float  # K [m]
    sinkage_coefficient: float  # S [N/m^(n+2)]
    sinkage_exponent: float  # n [-]


class Result(NamedTuple):
    """Load W [N], drawbar pull by (11) and by (12) [N], torque T [N m]; `scale` [N] sums the sizes of all forces."""

    load: float
    drawbar_pull: float
    drawbar_pull_paper: float
    torque: float
    scale: float


def normal_stress(theta, soil, r, theta1, theta2, thetam):
    """Normal stress [Pa]: Eq. (7) in front of thetam, Eq. (8) behind it."""
    if theta < thetam:
        theta = theta1 - (theta - theta2) / (thetam - theta2) * (theta1 - thetam)
    depth = r * (math.cos(theta) - math.cos(theta1))
    return soil.sinkage_coefficient * max(depth, 0.0) ** soil.sinkage_exponent


def travel_over_rim(slip):
    """V/(r w): 1 - i when driving, 1/(1 + i) when braking."""
    return 1.0 - slip if slip >= 0.0 else 1.0 / (1.0 + slip)


def shear_displacement(theta, slip, r, theta1):
    """j [m] of Eq. (10)."""
    return r * ((theta1 - theta) - travel_over_rim(slip) * (math.sin(theta1) - math.sin(theta)))


def shear_stress(theta, slip, soil, r, theta1, theta2, thetam):
    """Shear stress [Pa], Eq. (10), with the sign of the shear displacement."""
    if slip == -1.0:
        mobilised = -1.0  # locked: the displacement is infinite, backward
    else:
        j = shear_displacement(theta, slip, r, theta1)
        mobilised = math.copysign(1.0 - math.exp(-abs(j) / soil.shear_modulus), j)
    sigma = normal_stress(theta, soil, r, theta1, theta2, thetam)
    return (soil.cohesion + sigma * math.tan(math.radians(soil.friction_angle_deg))) * mobilised


def _turning_point(slip, r, theta1, theta2):
    """Angle inside the arc at which the shear displacement changes sign, if there is one."""
    if not -1.0 < slip < 0.0:
        return None
    low, high = theta2, theta1 - 1e-6
    if shear_displacement(low, slip, r, theta1) * shear_displacement(high, slip, r, theta1) >= 0.0:
        return None
    return brentq(shear_displacement, low, high, args=(slip, r, theta1))


def integrate(function, points):
    """Integral over the zones between consecutive points."""
    pairs = zip(points[:-1], points[1:], strict=True)
    return sum(quad(function, a, b, epsabs=0.0, epsrel=1e-10, limit=400)[0] for a, b in pairs)


def forces(soil, slip, theta1, r, b, theta2=0.0, thetam=None):
    """`Result` of Eqs. (1), (2) and (3), and the drawbar pull with the resistance of Eq. (12)."""
    thetam = 0.5 * (theta1 + theta2) if thetam is None else thetam  # Eq. (9)
    arc = (soil, r, theta1, theta2, thetam)
    kinks = {theta2, thetam, theta1, _turning_point(slip, r, theta1, theta2)} - {None}
    points = sorted(kinks)

    def total(stress, shape):
        return integrate(lambda theta: stress(theta) * shape(theta), points)

    def sigma(theta):
        return normal_stress(theta, *arc)

    def tau(theta):
        return shear_stress(theta, slip, *arc)

    def one(theta):
        return 1.0

    load = r * b * (total(sigma, math.cos) + total(tau, math.sin))  # (1)
    thrust = r * b * total(tau, math.cos)
    resistance = r * b * total(sigma, math.sin)  # (11)
    z0, n = r * (1.0 - math.cos(theta1)), soil.sinkage_exponent
    resistance_paper = r * b * soil.sinkage_coefficient * z0 ** (n + 1.0) / (r * (n + 1.0))  # (12)
    torque = r * r * b * total(tau, one)  # (3)
    scale = r * b * (total(sigma, one) + total(lambda theta: abs(tau(theta)), one))
    return Result(load, thrust - resistance, thrust - resistance_paper, torque, scale)
