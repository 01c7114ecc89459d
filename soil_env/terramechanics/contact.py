"""Stresses under a rigid wheel and the forces they sum to: Eqs. (1)-(10) of the source paper (docs/physics/contact.md).

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251; the stress distribution is
Wong & Reece (1967), the shear law Janosi & Hanamoto (1961).

Angles [rad] are measured from the lowest point of the rim, positive toward the front, *front* meaning the side the
wheel travels to. The motion enters through two numbers without unit, `rim` = r w / v* and `travel` = V / v*, where v*
is the rim speed (`slip.motion_from_slip`, `motion_from_speeds`). `forces` combines integrals over the arc
(`ArcIntegrals`), the same for the world, the steady prediction and the identifier. Every function takes floats (one
wheel) or lanes (eight wheels, `_numba.lanes`).
"""

import math
from typing import NamedTuple

from soil_env._numba.compiling import compiled_inline, compiled_part
from soil_env._numba.elementary import asin_root, copysign, exp, sqrt, where_less


class ShearLaw(NamedTuple):
    """Mobilised share of the shear strength: e(j) = (1 - x)(a + b x + c y), x = exp(-|j|/K).

    y = exp(-(|j| - onset)/length) beyond the onset, 1 before it.
    """

    a: float
    b: float
    c: float
    length: float  # [m]
    onset: float  # [m]


#: Janosi & Hanamoto (1961), Eq. (10): e = 1 - exp(-|j|/K).
JANOSI = ShearLaw(1.0, 0.0, 0.0, 1.0, 0.0)


class ArcIntegrals(NamedTuple):
    """Integrals over the contact arc [theta2, theta1], for S = 1 [m^n] or without stress [-].

    p(theta) is the normal stress for S = 1, e(theta) in [-1, 1] the mobilised share of the shear strength.
    """

    p_cos: float  # Int p cos(theta)
    p_sin: float  # Int p sin(theta)
    pe_cos: float  # Int p e cos(theta)
    pe_sin: float  # Int p e sin(theta)
    pe: float  # Int p e
    e_cos: float  # Int e cos(theta)
    e_sin: float  # Int e sin(theta)
    e: float  # Int e


class ArcRates(NamedTuple):
    """Derivatives of the six shear integrals of `ArcIntegrals`, all with one motion variable."""

    pe_cos: float
    pe_sin: float
    pe: float
    e_cos: float
    e_sin: float
    e: float


class Forces(NamedTuple):
    """Forces of the soil on the wheel."""

    load: float  # W [N], Eq. (1), upward on the wheel
    drawbar_pull: float  # DP [N], Eq. (2), positive forward
    torque: float  # T [N m], Eq. (3), the torque the soil takes from the axle


class Arc(NamedTuple):
    """A contact arc: where it begins and ends, and where its normal stress peaks."""

    theta1: float  # [rad] entry angle
    theta2: float  # [rad] exit angle
    thetam: float  # [rad] angle of the largest normal stress
    sheared_from: float  # [rad] angle from which the soil is sheared: theta1, but for lugs
    radius: float  # [m] that carries the normal stress


@compiled_inline
def entry_angle(sinkage, r):
    """Entry angle theta1 [rad] of a wheel of radius r [m] at the given sinkage [m]: z0 = r (1 - cos theta1)."""
    return 2.0 * asin_root((0.5 / r) * sinkage)


@compiled_inline
def smooth_arc(sinkage, r):
    """`Arc` of the source paper: theta2 = 0 and the peak midway, Eq. (9)."""
    theta1 = entry_angle(sinkage, r)
    return Arc(theta1, 0.0 * theta1, 0.5 * theta1, theta1, r)


@compiled_inline
def smoothed_sign(speed, floor):
    """(sign of a speed in (-1, 1), its derivative [s/m]): smooth through rest over about `floor` [m/s]."""
    square = speed * speed + floor * floor
    length = sqrt(square)
    return speed / length, (floor * floor) / (square * length)


@compiled_inline
def motion_from_speeds(rim_speed, travel_speed, floor):
    """(rim, travel, direction) from rim speed r w and travel speed V [m/s], smooth through rest and reversal.

    `direction` in (-1, 1) is the smoothed sign of V; `floor` [m/s] is the speed below which the wheel counts as
    resting.
    """
    v = sqrt(rim_speed * rim_speed + floor * floor)
    return rim_speed / v, travel_speed / v, smoothed_sign(travel_speed, floor)[0]


@compiled_part
def relative_stress(theta, cos1, n, r):
    """Normal stress for S = 1 at an angle of the front zone, Eq. (7): its depth [m] below the entry point, to the n.

    cos1 = cos(theta1).
    """
    depth = r * (math.cos(theta) - cos1)
    return depth**n if depth > 0.0 else (1.0 if n == 0.0 else 0.0)


@compiled_part
def mirror_angle(theta, theta1, theta2, thetam):
    """Angle in the front zone with the same normal stress as `theta`, Eq. (8) for the rear zone, itself in front."""
    if theta >= thetam:
        return theta
    return theta1 - (theta - theta2) / (thetam - theta2) * (theta1 - thetam)


@compiled_inline
def mobilised(j, K, law):
    """(e, de/dj): mobilised share of the shear strength at displacement j [m], signed as j; Eq. (10) and `ShearLaw`."""
    distance = abs(j)
    rate = 1.0 / K
    decay = exp(-1.0 * (rate * distance))
    free = 1.0 - decay
    if law.a == 1.0 and law.b == 0.0 and law.c == 0.0:
        return copysign(free, j), rate * decay
    share = law.a + law.b * decay
    slope = rate * (law.b * decay)
    if law.c != 0.0:
        beyond = distance - law.onset
        slow = law.c * exp(-(0.5 / law.length) * (beyond + abs(beyond)))
        share = share + slow
        slope = slope + (1.0 / law.length) * where_less(beyond, 0.0, 0.0, slow)
    return copysign(free, j) * share, rate * decay * share - free * slope


@compiled_part
def shear_displacement(theta, theta1, sin1, rim, travel, r):
    """(j, dj/d(rim), dj/d(travel)) [m] of Eq. (10) at one angle; sin1 = sin(theta1)."""
    by_rim = r * (theta1 - theta)
    by_travel = -r * (sin1 - math.sin(theta))
    return rim * by_rim + travel * by_travel, by_rim, by_travel


@compiled_inline
def shear_forces(q, st, c, r, b, direction):
    """`Forces` of the shear stress alone, st = S tan(phi), from `ArcIntegrals`; from `ArcRates`, their derivatives."""
    rb = r * b
    return Forces(
        direction * rb * (st * q.pe_sin + c * q.e_sin),
        rb * (st * q.pe_cos + c * q.e_cos),
        r * rb * (st * q.pe + c * q.e),
    )


@compiled_inline
def forces(integrals, S, tan_phi, c, r, b, direction):
    """`Forces` from `ArcIntegrals`: Eqs. (1)-(3) with the exact resistance integral of Eq. (11) ("consistent").

    `direction` is the smoothed sign of the travel speed, 1 in a steady forward run. In reverse the horizontal part of
    the normal stress and the vertical part of the shear stress change sign.
    """
    shear = shear_forces(integrals, S * tan_phi, c, r, b, direction)
    normal = r * b * S
    return Forces(
        normal * integrals.p_cos + shear.load,
        shear.drawbar_pull - direction * normal * integrals.p_sin,
        shear.torque,
    )


@compiled_inline
def bearing_share(integrals, tan_phi, direction):
    """Load borne by the normal stress and by the friction in proportion to it, over S r b [m^n]; Eq. (1)."""
    return integrals.p_cos + direction * tan_phi * integrals.pe_sin


@compiled_inline
def mobilised_sinkage_coefficient(integrals, load, tan_phi, c, r, b, direction):
    """Sinkage coefficient s [N/m^(n+2)] at which Eq. (1) carries `load` [N] on this arc; at least 0.

    Eq. (1) is linear in S, so at a given sinkage the coefficient the load mobilises has a closed form.
    """
    q = integrals
    bearing = bearing_share(q, tan_phi, direction)
    rest = load / (r * b) - direction * c * q.e_sin
    return where_less(1e-12 * q.p_cos, bearing, where_less(0.0, rest, rest / bearing, 0.0), 0.0)
