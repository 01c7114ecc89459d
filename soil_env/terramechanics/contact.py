"""Stresses under a rigid wheel and the forces they sum to: Eqs. (1)-(12) and (18) of the source paper.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251; the stress distribution is
Wong & Reece (1967), the shear law Janosi & Hanamoto (1961), the compaction resistance Bekker (1956).

Angles [rad] are measured from the lowest point of the rim, positive toward the front, *front* meaning the side the
wheel travels to. The contact arc runs from the exit angle `theta2` to the entry angle `theta1`; the normal stress peaks
at `thetam`.

The motion enters through two numbers without unit, `rim` = r w / v* and `travel` = V / v*, where v* is the rim speed
(`motion_from_slip`, `motion_from_speeds`). They make Eq. (10) one expression for driving, braking, a locked wheel and
reverse: j = r [rim (theta1 - theta) - travel (sin theta1 - sin theta)], the sign of j being the sign of the shear
stress.

For a given shear modulus and sinkage exponent every force is linear in S, S tan(phi) and c. The kernels therefore
return integrals over the arc (`ArcIntegrals`), and `forces` combines them. The same integrals serve the simulated
world, the steady prediction and the identifier's Jacobian.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, kernel
from soil_env._numba.elementary import copysign, exp, exp_lanes, fma, half_sin_cos, log_lanes, root, where_less
from soil_env._numba.lanes import constant, fill, total, totals

#: Gauss-Legendre nodes per zone of the contact arc (front and rear nodes share the normal stress).
NODES_PER_ZONE = 8
_x, _w = np.polynomial.legendre.leggauss(NODES_PER_ZONE)
NODE_DEPTHS = (0.5 * (_x + 1.0)) ** 2  # u^2: relative distance of the node from the end of the arc
NODE_WEIGHTS = 0.5 * _w * 2.0 * (0.5 * (_x + 1.0))  # weight times d(u^2)/du
_u2, _du2 = constant(NODE_DEPTHS), constant(NODE_WEIGHTS)


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
    """What the soil does to the wheel."""

    load: float  # W [N], Eq. (1), upward on the wheel
    drawbar_pull: float  # DP [N], Eq. (2), positive forward
    torque: float  # T [N m], Eq. (3), the torque the soil takes from the axle


@inlined
def entry_angle(sinkage, r):
    """Entry angle theta1 [rad] of a wheel of radius r [m] at the given sinkage [m]: z0 = r (1 - cos theta1)."""
    return math.acos(max(-1.0, min(1.0, 1.0 - sinkage / r)))


@inlined
def slip_ratio(rim_speed, travel_speed, floor):
    """Slip in [-1, 1]: (r w - V)/(r w) when driving, (r w - V)/V when braking; mirrored in reverse.

    `floor` [m/s] bounds the denominator from below, so that a wheel at rest has slip 0.
    """
    scale = max(abs(rim_speed), abs(travel_speed), floor)
    direction = 1.0 if rim_speed + travel_speed >= 0.0 else -1.0
    return max(-1.0, min(1.0, direction * (rim_speed - travel_speed) / scale))


@inlined
def motion_from_slip(slip):
    """(rim, travel) of a wheel travelling forward at the given slip in [-1, 1]; -1 is locked, 1 spins on the spot."""
    if slip >= 0.0:
        return 1.0, 1.0 - slip
    braking = max(1.0 + slip, 1e-9)  # r w / V
    return 1.0, 1.0 / braking


@inlined
def motion_from_speeds(rim_speed, travel_speed, floor):
    """(rim, travel, direction) from rim speed r w and travel speed V [m/s], smooth through rest and reversal.

    `direction` in (-1, 1) is the smoothed sign of V; `floor` [m/s] is the speed below which the wheel counts as
    resting. Of floats or in lanes.
    """
    v = root(rim_speed * rim_speed + floor * floor)
    return rim_speed / v, travel_speed / v, travel_speed / root(travel_speed * travel_speed + floor * floor)


@kernel
def relative_stress(depth, n):
    """Normal stress for S = 1 at `depth` [m] on the rim below the entry point, Eq. (7): sigma / S = depth^n."""
    return depth**n if depth > 0.0 else (1.0 if n == 0.0 else 0.0)


@kernel
def mirror_angle(theta, theta1, theta2, thetam):
    """Angle in the front zone with the same normal stress as `theta`, Eq. (8) for the rear zone, itself in front."""
    if theta >= thetam:
        return theta
    return theta1 - (theta - theta2) / (thetam - theta2) * (theta1 - thetam)


@inlined
def mobilised(j, K, law):
    """(e, de/dj): share of the shear strength mobilised at shear displacement j [m], `ShearLaw`, signed as j.

    j is a float or `lanes`.
    """
    distance, rate = abs(j), 1.0 / K
    decay = exp(-rate * distance)
    share = law.a + law.b * decay
    slope = rate * (law.b * decay)
    if law.c != 0.0:
        beyond = distance - law.onset
        slow = law.c * exp(-(0.5 / law.length) * (beyond + abs(beyond)))
        share = share + slow
        slope = slope + (1.0 / law.length) * (copysign(0.0 * beyond + 0.5, beyond) + 0.5) * slow
    free = 1.0 - decay
    return copysign(free, j) * share, rate * decay * share - free * slope


@kernel
def arc_node(theta, theta1, sin1, rim, travel, r, K):
    """What Eq. (10) gives at one angle: (sin, cos, e, g, lever_rim, lever_travel).

    g = de/dj [1/m]; the levers dj/d(rim) and dj/d(travel) are in metres.
    """
    s, c = math.sin(theta), math.cos(theta)
    lever_rim = r * (theta1 - theta)
    lever_travel = -r * (sin1 - s)
    e, g = mobilised(rim * lever_rim + travel * lever_travel, K, JANOSI)
    return s, c, e, g, lever_rim, lever_travel


@kernel
def _add_node(t, w, p, node):
    """Running sums `t` of the arc integrals and their rates after one node of weight w and stress p (for S = 1)."""
    s, c, e, g, lever_rim, lever_travel = node
    wc, ws = w * c, w * s
    x, y = g * lever_rim, g * lever_travel
    return (
        t[0] + p * wc, t[1] + p * ws,
        t[2] + p * e * wc, t[3] + p * e * ws, t[4] + p * e * w, t[5] + e * wc, t[6] + e * ws, t[7] + e * w,
        t[8] + p * x * wc, t[9] + p * x * ws, t[10] + p * x * w, t[11] + x * wc, t[12] + x * ws, t[13] + x * w,
        t[14] + p * y * wc, t[15] + p * y * ws, t[16] + p * y * w, t[17] + y * wc, t[18] + y * ws, t[19] + y * w,
    )  # fmt: skip


@kernel
def _packed(t):
    return (
        ArcIntegrals(t[0], t[1], t[2], t[3], t[4], t[5], t[6], t[7]),
        ArcRates(t[8], t[9], t[10], t[11], t[12], t[13]),
        ArcRates(t[14], t[15], t[16], t[17], t[18], t[19]),
    )


_NOTHING = (0.0,) * 20


class Zone(NamedTuple):
    """Eight nodes of one zone of the arc, as lanes: what they need of Eqs. (1)-(10) whatever the motion and K."""

    w: float  # weight [rad]
    w_cos: float
    w_sin: float
    pw: float  # stress for S = 1 [m^n] times weight
    pw_cos: float
    pw_sin: float
    lever_rim: float  # dj/d(rim) [m]
    lever_travel: float  # dj/d(travel) [m]


@inlined
def zone(theta1, sin1, theta, sin_half, cos_half, w, p, r):
    """`Zone` of nodes at theta with weights w and normal stress p over S: j of Eq. (10) split by rim and by travel."""
    s, c = 2.0 * sin_half * cos_half, fma(-2.0 * sin_half, sin_half, 1.0)
    pw = p * w
    return Zone(w, w * c, w * s, pw, pw * c, pw * s, r * (theta1 - theta), r * (s - sin1))


@inlined
def arc_nodes(theta1, theta2, thetam, n, r, sheared_from):
    """The nodes of the contact arc, `Zone` in front and `Zone` behind; soil is sheared from the angle `sheared_from`.

    Gauss-Legendre nodes at theta1 - (theta1 - thetam) u^2 in front and theta2 + (thetam - theta2) u^2 behind, which
    removes the singularity (theta1 - theta)^n at both ends; by Eq. (8) the two nodes have the same normal stress.
    """
    front, rear = theta1 - thetam, thetam - theta2
    ahead, behind = theta1 - front * _u2(), theta2 + rear * _u2()
    sin_half, cos_half = half_sin_cos(ahead)
    sin_half1, cos_half1 = half_sin_cos(fill(theta1))
    rise = sin_half1 * sin_half1 - sin_half * sin_half  # depth over 2 r
    p = exp_lanes(n * log_lanes((2.0 * r) * rise))
    sin1 = 2.0 * sin_half1 * cos_half1
    sin_half2, cos_half2 = half_sin_cos(behind)
    if sheared_from != theta1:
        sin1 = fill(math.sin(sheared_from))
    return (
        zone(sheared_from, sin1, ahead, sin_half, cos_half, front * _du2(), p, r),
        zone(sheared_from, sin1, behind, sin_half2, cos_half2, rear * _du2(), p, r),
    )


@inlined
def shear_integrals(zones, rim, travel, K, law):
    """(ArcIntegrals, ArcRates by `rim`, ArcRates by `travel`) of the nodes of `arc_nodes` at one motion."""
    f, b = zones
    e, g = mobilised(rim * f.lever_rim + travel * f.lever_travel, K, law)
    e2, g2 = mobilised(rim * b.lever_rim + travel * b.lever_travel, K, law)
    x, x2 = g * f.lever_rim, g2 * b.lever_rim
    y, y2 = g * f.lever_travel, g2 * b.lever_travel
    s = totals(
        f.pw_cos + b.pw_cos, f.pw_sin + b.pw_sin,
        fma(e, f.pw_cos, e2 * b.pw_cos), fma(e, f.pw_sin, e2 * b.pw_sin), fma(e, f.pw, e2 * b.pw),
        fma(e, f.w_cos, e2 * b.w_cos), fma(e, f.w_sin, e2 * b.w_sin), fma(e, f.w, e2 * b.w),
    )  # fmt: skip
    t = totals(
        fma(x, f.pw_cos, x2 * b.pw_cos), fma(x, f.pw_sin, x2 * b.pw_sin), fma(x, f.pw, x2 * b.pw),
        fma(x, f.w_cos, x2 * b.w_cos), fma(x, f.w_sin, x2 * b.w_sin), fma(x, f.w, x2 * b.w),
        fma(y, f.pw_cos, y2 * b.pw_cos), fma(y, f.pw_sin, y2 * b.pw_sin),
    )  # fmt: skip
    return (
        ArcIntegrals(s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7]),
        ArcRates(t[0], t[1], t[2], t[3], t[4], t[5]),
        ArcRates(
            t[6], t[7], total(fma(y, f.pw, y2 * b.pw)),
            total(fma(y, f.w_cos, y2 * b.w_cos)), total(fma(y, f.w_sin, y2 * b.w_sin)), total(fma(y, f.w, y2 * b.w)),
        ),
    )  # fmt: skip


@inlined
def arc_integrals(theta1, theta2, thetam, rim, travel, K, n, r, law=JANOSI):
    """Integrals of Eqs. (1)-(3) and their derivatives: (ArcIntegrals, ArcRates by `rim`, ArcRates by `travel`).

    Rule and nodes: `arc_nodes`. Relative error about 1e-5 when driving; when braking j changes sign within the arc, and
    it is 5e-4 for K = 0.07 r. The derivative by K needs no further integrals: see `shear_modulus_rates`.
    """
    return shear_integrals(arc_nodes(theta1, theta2, thetam, n, r, theta1), rim, travel, K, law)


@kernel
def simpson_integrals(theta1, theta2, thetam, rim, travel, K, n, r, m):
    """`arc_integrals` by the paper's rule: composite Simpson with 2m subintervals in each zone, Eq. (18)."""
    sin1, cos1 = math.sin(theta1), math.cos(theta1)
    t = _NOTHING
    for zone in range(2):
        low, high = (theta2, thetam) if zone == 0 else (thetam, theta1)
        h = (high - low) / (2 * m)
        for k in range(2 * m + 1):
            w = h / 3.0 * (1.0 if k == 0 or k == 2 * m else (4.0 if k % 2 == 1 else 2.0))
            theta = low + k * h
            p = relative_stress(r * (math.cos(mirror_angle(theta, theta1, theta2, thetam)) - cos1), n)
            t = _add_node(t, w, p, arc_node(theta, theta1, sin1, rim, travel, r, K))
    return _packed(t)


@inlined
def shear_modulus_rates(by_rim, by_travel, rim, travel, K):
    """`ArcRates` by K [1/m]: de/dK = -(j/K) de/dj with j linear in (rim, travel)."""
    x, y = -rim / K, -travel / K
    return ArcRates(
        x * by_rim.pe_cos + y * by_travel.pe_cos,
        x * by_rim.pe_sin + y * by_travel.pe_sin,
        x * by_rim.pe + y * by_travel.pe,
        x * by_rim.e_cos + y * by_travel.e_cos,
        x * by_rim.e_sin + y * by_travel.e_sin,
        x * by_rim.e + y * by_travel.e,
    )


@inlined
def forces(integrals, S, tan_phi, c, r, b, direction):
    """`Forces` from `ArcIntegrals`: Eqs. (1)-(3) with the exact resistance integral of Eq. (11) ("consistent").

    `direction` is the smoothed sign of the travel speed (1 in a steady forward run): behind a turned-round wheel the
    horizontal part of the normal stress and the vertical part of the shear stress change sign.
    """
    q = integrals
    load = r * b * (S * (q.p_cos + direction * tan_phi * q.pe_sin) + direction * c * q.e_sin)
    thrust = r * b * (S * tan_phi * q.pe_cos + c * q.e_cos)
    resistance = direction * r * b * S * q.p_sin
    torque = r * r * b * (S * tan_phi * q.pe + c * q.e)
    return Forces(load, thrust - resistance, torque)


@kernel
def compaction_resistance(sinkage, S, n, b):
    """Resistance [N] of Eq. (12), b S z0^(n+1) / (n+1): equal to Eq. (11) only without the rear branch (8)."""
    return b * S * sinkage ** (n + 1.0) / (n + 1.0)


@inlined
def mobilised_modulus(integrals, load, tan_phi, c, r, b, direction):
    """Sinkage coefficient s [N/m^(n+2)] at which Eq. (1) carries `load` [N] on this arc; at least 0.

    Eq. (1) is linear in S, so at a given sinkage the coefficient the load mobilises has a closed form.
    """
    q = integrals
    bearing = q.p_cos + direction * tan_phi * q.pe_sin
    rest = load / (r * b) - direction * c * q.e_sin
    return where_less(1e-12 * q.p_cos, bearing, where_less(0.0, rest, rest / bearing, 0.0), 0.0)
