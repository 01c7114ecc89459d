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

For a given shear deformation modulus and sinkage exponent every force is linear in S, S tan(phi) and c. So there are
integrals over the arc (`ArcIntegrals`), which `forces` combines. The same integrals serve the simulated world, the
steady prediction and the identifier's Jacobian.

Every function takes floats (one wheel) or lanes (eight wheels, `_numba.lanes`). The nodes of one wheel's arc are
themselves in lanes; those of eight wheels' arcs are taken one after the other (`lanes.over_eight`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, part
from soil_env._numba.elementary import (
    asin_root,
    copysign,
    exp,
    fma,
    half_sin_cos,
    larger,
    power,
    root,
    smaller,
    where_less,
)
from soil_env._numba.lanes import COUNT, alike, fill, from_array, over_eight, summed, to_array, turns
from soil_env._numba.rows import rows, scratch_rows

#: Gauss-Legendre nodes per zone of the contact arc (front and rear nodes share the normal stress).
NODES_PER_ZONE = 8
_x, _w = np.polynomial.legendre.leggauss(NODES_PER_ZONE)
NODE_DEPTHS = (0.5 * (_x + 1.0)) ** 2  # u^2: relative distance of the node from the end of the arc
NODE_WEIGHTS = 0.5 * _w * 2.0 * (0.5 * (_x + 1.0))  # weight times d(u^2)/du
_depth, _weight = over_eight(NODE_DEPTHS), over_eight(NODE_WEIGHTS)


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


class Arc(NamedTuple):
    """A contact arc: where it begins and ends, and where its normal stress peaks."""

    theta1: float  # [rad] entry angle
    theta2: float  # [rad] exit angle
    thetam: float  # [rad] angle of the largest normal stress
    sheared_from: float  # [rad] angle from which the soil is sheared: theta1, but for lugs
    radius: float  # [m] that carries the normal stress


# --- motion -----------------------------------------------------------------------------------------------------------


@inlined
def entry_angle(sinkage, r):
    """Entry angle theta1 [rad] of a wheel of radius r [m] at the given sinkage [m]: z0 = r (1 - cos theta1)."""
    return 2.0 * asin_root((0.5 / r) * sinkage)


@inlined
def smooth_arc(sinkage, r):
    """`Arc` of the source paper: theta2 = 0 and the peak midway, Eq. (9)."""
    theta1 = entry_angle(sinkage, r)
    return Arc(theta1, 0.0 * theta1, 0.5 * theta1, theta1, r)


@inlined
def slip_ratio(rim_speed, travel_speed, floor):
    """Slip in [-1, 1]: (r w - V)/(r w) when driving, (r w - V)/V when braking; mirrored in reverse.

    `floor` [m/s] bounds the denominator from below, so that a wheel at rest has slip 0.
    """
    scale = larger(larger(abs(rim_speed), abs(travel_speed)), floor)
    difference = rim_speed - travel_speed
    forward = where_less(rim_speed + travel_speed, 0.0, -difference, difference)
    return larger(-1.0, smaller(1.0, forward / scale))


@inlined
def motion_from_slip(slip):
    """(rim, travel) of a wheel travelling forward at the given slip in [-1, 1]; -1 is locked, 1 spins on the spot."""
    braking = larger(1.0 + slip, 1e-9)  # r w / V
    return alike(1.0, slip), where_less(slip, 0.0, 1.0 / braking, 1.0 - slip)


@inlined
def smoothed_sign(speed, floor):
    """(sign of a speed in (-1, 1), its derivative [s/m]): smooth through rest over about `floor` [m/s]."""
    square = speed * speed + floor * floor
    length = root(square)
    return speed / length, (floor * floor) / (square * length)


@inlined
def motion_from_speeds(rim_speed, travel_speed, floor):
    """(rim, travel, direction) from rim speed r w and travel speed V [m/s], smooth through rest and reversal.

    `direction` in (-1, 1) is the smoothed sign of V; `floor` [m/s] is the speed below which the wheel counts as
    resting.
    """
    v = root(rim_speed * rim_speed + floor * floor)
    return rim_speed / v, travel_speed / v, smoothed_sign(travel_speed, floor)[0]


# --- stresses ---------------------------------------------------------------------------------------------------------


@part
def relative_stress(depth, n):
    """Normal stress for S = 1 at `depth` [m] on the rim below the entry point, Eq. (7): sigma / S = depth^n."""
    return depth**n if depth > 0.0 else (1.0 if n == 0.0 else 0.0)


@part
def mirror_angle(theta, theta1, theta2, thetam):
    """Angle in the front zone with the same normal stress as `theta`, Eq. (8) for the rear zone, itself in front."""
    if theta >= thetam:
        return theta
    return theta1 - (theta - theta2) / (thetam - theta2) * (theta1 - thetam)


@inlined
def mobilised(j, K, law):
    """(e, de/dj): share of the shear strength mobilised at shear displacement j [m], `ShearLaw`, signed as j."""
    distance, rate = abs(j), 1.0 / K
    decay = exp(-rate * distance)
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


@part
def shear_displacement(theta, theta1, sin1, rim, travel, r):
    """(j, dj/d(rim), dj/d(travel)) [m] of Eq. (10) at one angle; sin1 = sin(theta1)."""
    by_rim, by_travel = r * (theta1 - theta), -r * (sin1 - math.sin(theta))
    return rim * by_rim + travel * by_travel, by_rim, by_travel


# --- integrals over the arc -------------------------------------------------------------------------------------------

#: Nodes of contact arcs: COUNT columns a node, NODE_COLUMNS for eight wheels. Stress for S = 1 times the node's weight,
#: cosine and sine of the front node, and of the rear node times the length of its zone over that of the front zone.
Nodes = rows("Nodes", "stress", "cos_front", "sin_front", "cos_rear", "sin_rear")
NODE_COLUMNS = COUNT * NODES_PER_ZONE
_ShearAtNodes = rows("_ShearAtNodes", "e_front", "e_rear", "x_front", "x_rear", "y_front", "y_rear")
_shear_at_nodes = scratch_rows(_ShearAtNodes, NODE_COLUMNS)
_one_arc = scratch_rows(Nodes, COUNT)


class ArcFrame(NamedTuple):
    """What the nodes of an arc have in common, beside what `store_nodes` writes."""

    theta1: float  # [rad]
    front: float  # [rad] length of the front zone
    ratio: float  # length of the rear zone over it
    lever_front: float  # [m] dj/d(rim) at the entry
    lever_rear: float  # [m] dj/d(rim) at the exit
    lever_sin: float  # [m] r sin(sheared_from)
    p_cos: float  # as in `ArcIntegrals`
    p_sin: float


@inlined
def store_nodes(arc, n, nodes, at):
    """What the quadrature nodes of an `Arc` need whatever the motion and K, into columns at.. of `Nodes`; `ArcFrame`.

    Gauss-Legendre nodes at theta1 - (theta1 - thetam) u^2 in front and theta2 + (thetam - theta2) u^2 behind, which
    removes the singularity (theta1 - theta)^n at both ends; by Eq. (8) the two nodes have the same normal stress.
    """
    front, rear = arc.theta1 - arc.thetam, arc.thetam - arc.theta2
    ratio = where_less(0.0, front, rear / front, 1.0)
    sin_half1, _ = half_sin_cos(fill(arc.theta1))
    rise1 = sin_half1 * sin_half1
    p_cos, p_sin = fill(0.0), fill(0.0)
    for k in range(turns(arc.theta1)):
        depth, i = _depth(arc.theta1, k), at + k * COUNT
        sin_half, cos_half = half_sin_cos(arc.theta1 - front * depth)
        sin_half2, cos_half2 = half_sin_cos(arc.theta2 + rear * depth)
        stress = _weight(arc.theta1, k) * power((2.0 * arc.radius) * (rise1 - sin_half * sin_half), n)
        c, s = fma(-2.0 * sin_half, sin_half, 1.0), 2.0 * sin_half * cos_half
        c2, s2 = ratio * fma(-2.0 * sin_half2, sin_half2, 1.0), (2.0 * ratio) * (sin_half2 * cos_half2)
        p_cos, p_sin = fma(stress, c + c2, p_cos), fma(stress, s + s2, p_sin)
        to_array(stress, nodes.stress, i)
        to_array(c, nodes.cos_front, i)
        to_array(s, nodes.sin_front, i)
        to_array(c2, nodes.cos_rear, i)
        to_array(s2, nodes.sin_rear, i)
    sin_half, cos_half = half_sin_cos(fill(arc.sheared_from))
    r = arc.radius
    return ArcFrame(
        arc.theta1,
        front,
        ratio,
        r * (arc.sheared_from - arc.theta1),
        r * (arc.sheared_from - arc.theta2),
        (2.0 * r) * (sin_half * cos_half),
        summed(front * p_cos, arc.theta1),
        summed(front * p_sin, arc.theta1),
    )


@inlined
def _levers(frame, nodes, i, k, r):
    """dj/d(rim) and dj/d(travel) [m] at the front node, then at the rear node: Eq. (10) split by the motion."""
    depth = _depth(frame.theta1, k)
    ahead = (r * frame.front) * depth
    return (
        frame.lever_front + ahead,
        fma(r, from_array(nodes.sin_front, i), -frame.lever_sin),
        frame.lever_rear - frame.ratio * ahead,
        fma(r / frame.ratio, from_array(nodes.sin_rear, i), -frame.lever_sin),
    )


@inlined
def _sums(frame, nodes, at, in_front, behind):
    """Six sums over an arc of values at its nodes: with the stress times cos, sin and 1, and without the stress.

    One value at a time, as the sums of all of them do not fit into the registers.
    """
    o, pattern = fill(0.0), frame.theta1
    p_cos, p_sin, p, cos_, sin_, plain = o, o, o, o, o, o
    for k in range(turns(pattern)):
        i = at + k * COUNT
        stress, w = from_array(nodes.stress, i), _weight(pattern, k)
        e, e2 = from_array(in_front, k * COUNT), from_array(behind, k * COUNT)
        ec = fma(e, from_array(nodes.cos_front, i), e2 * from_array(nodes.cos_rear, i))
        es = fma(e, from_array(nodes.sin_front, i), e2 * from_array(nodes.sin_rear, i))
        e = fma(e2, frame.ratio, e)
        p_cos, p_sin, p = fma(stress, ec, p_cos), fma(stress, es, p_sin), fma(stress, e, p)
        cos_, sin_, plain = fma(w, ec, cos_), fma(w, es, sin_), fma(w, e, plain)
    front = frame.front
    return ArcRates(
        summed(front * p_cos, pattern), summed(front * p_sin, pattern), summed(front * p, pattern),
        summed(front * cos_, pattern), summed(front * sin_, pattern), summed(front * plain, pattern),
    )  # fmt: skip


@inlined
def _integrals(frame, e):
    """`ArcIntegrals` from the six sums `e` of the mobilised share."""
    return ArcIntegrals(frame.p_cos, frame.p_sin, e.pe_cos, e.pe_sin, e.pe, e.e_cos, e.e_sin, e.e)


@inlined
def shear_integrals(frame, nodes, at, rim, travel, K, r, law):
    """(ArcIntegrals, ArcRates by `rim`, ArcRates by `travel`) of the nodes of `store_nodes` at one motion."""
    shear = _shear_at_nodes()
    for k in range(turns(frame.theta1)):
        i = k * COUNT
        a, z, a2, z2 = _levers(frame, nodes, at + i, k, r)
        e, g = mobilised(fma(rim, a, travel * z), K, law)
        e2, g2 = mobilised(fma(rim, a2, travel * z2), K, law)
        to_array(e, shear.e_front, i)
        to_array(e2, shear.e_rear, i)
        to_array(g * a, shear.x_front, i)
        to_array(g2 * a2, shear.x_rear, i)
        to_array(g * z, shear.y_front, i)
        to_array(g2 * z2, shear.y_rear, i)
    e = _sums(frame, nodes, at, shear.e_front, shear.e_rear)
    by_rim = _sums(frame, nodes, at, shear.x_front, shear.x_rear)
    return _integrals(frame, e), by_rim, _sums(frame, nodes, at, shear.y_front, shear.y_rear)


@inlined
def integrals_alone(arc, rim, travel, K, n, law):
    """`ArcIntegrals` of one wheel's `Arc`, without derivatives."""
    nodes, shear, r = _one_arc(), _shear_at_nodes(), arc.radius
    frame = store_nodes(arc, n, nodes, 0)
    for k in range(turns(frame.theta1)):
        a, z, a2, z2 = _levers(frame, nodes, k * COUNT, k, r)
        to_array(mobilised(fma(rim, a, travel * z), K, law)[0], shear.e_front, k * COUNT)
        to_array(mobilised(fma(rim, a2, travel * z2), K, law)[0], shear.e_rear, k * COUNT)
    return _integrals(frame, _sums(frame, nodes, 0, shear.e_front, shear.e_rear))


@inlined
def shear_integrals_by_modulus(frame, nodes, at, rim, travel, K, r, law):
    """(ArcIntegrals, ArcRates by K [1/m]) of the nodes of `store_nodes`: de/dK = -(j/K) de/dj (Janosi's law)."""
    shear, rate = _shear_at_nodes(), -1.0 / K
    for k in range(turns(frame.theta1)):
        i = k * COUNT
        a, z, a2, z2 = _levers(frame, nodes, at + i, k, r)
        j, j2 = fma(rim, a, travel * z), fma(rim, a2, travel * z2)
        e, g = mobilised(j, K, law)
        e2, g2 = mobilised(j2, K, law)
        to_array(e, shear.e_front, i)
        to_array(e2, shear.e_rear, i)
        to_array((rate * j) * g, shear.x_front, i)
        to_array((rate * j2) * g2, shear.x_rear, i)
    e = _sums(frame, nodes, at, shear.e_front, shear.e_rear)
    return _integrals(frame, e), _sums(frame, nodes, at, shear.x_front, shear.x_rear)


@inlined
def integrals_of(arc, rim, travel, K, n, law):
    """(ArcIntegrals, ArcRates by `rim`, ArcRates by `travel`) of one wheel's `Arc`, by the rule of `store_nodes`."""
    nodes = _one_arc()
    frame = store_nodes(arc, n, nodes, 0)
    return shear_integrals(frame, nodes, 0, rim, travel, K, arc.radius, law)


@part
def arc_integrals(theta1, theta2, thetam, rim, travel, K, n, r, law=JANOSI):
    """Integrals of Eqs. (1)-(3) and their derivatives: (ArcIntegrals, ArcRates by `rim`, ArcRates by `travel`).

    Rule and nodes: `store_nodes`. Relative error about 1e-5 when driving; when braking j changes sign within the arc,
    and it is 5e-4 for K = 0.07 r. The derivative by K needs no further integrals: see `shear_modulus_rates`.
    """
    return integrals_of(Arc(theta1, theta2, thetam, theta1, r), rim, travel, K, n, law)


@part
def simpson_integrals(theta1, theta2, thetam, rim, travel, K, n, r, m):
    """`arc_integrals` by the paper's rule: composite Simpson with 2m subintervals in each zone, Eq. (18)."""
    sin1, cos1 = math.sin(theta1), math.cos(theta1)
    p_cos = p_sin = 0.0
    e_sums = by_rim = by_travel = ArcRates(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for zone in range(2):
        low, high = (theta2, thetam) if zone == 0 else (thetam, theta1)
        h = (high - low) / (2 * m)
        for k in range(2 * m + 1):
            w = h / 3.0 * (1.0 if k == 0 or k == 2 * m else (4.0 if k % 2 == 1 else 2.0))
            theta = low + k * h
            p = relative_stress(r * (math.cos(mirror_angle(theta, theta1, theta2, thetam)) - cos1), n)
            j, lever_rim, lever_travel = shear_displacement(theta, theta1, sin1, rim, travel, r)
            e, g = mobilised(j, K, JANOSI)
            wc, ws = w * math.cos(theta), w * math.sin(theta)
            p_cos, p_sin = p_cos + p * wc, p_sin + p * ws
            e_sums = _with_node(e_sums, e, p, w, wc, ws)
            by_rim = _with_node(by_rim, g * lever_rim, p, w, wc, ws)
            by_travel = _with_node(by_travel, g * lever_travel, p, w, wc, ws)
    s = e_sums
    return ArcIntegrals(p_cos, p_sin, s.pe_cos, s.pe_sin, s.pe, s.e_cos, s.e_sin, s.e), by_rim, by_travel


@inlined
def _with_node(t, value, p, w, wc, ws):
    """The six sums `t` with one more node."""
    return ArcRates(
        t.pe_cos + p * value * wc,
        t.pe_sin + p * value * ws,
        t.pe + p * value * w,
        t.e_cos + value * wc,
        t.e_sin + value * ws,
        t.e + value * w,
    )


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


# --- forces -----------------------------------------------------------------------------------------------------------


@inlined
def shear_forces(q, st, c, r, b, direction):
    """`Forces` of the shear stress alone, st = S tan(phi), from `ArcIntegrals`; from `ArcRates`, their derivatives."""
    rb = r * b
    return Forces(
        direction * rb * (st * q.pe_sin + c * q.e_sin),
        rb * (st * q.pe_cos + c * q.e_cos),
        r * rb * (st * q.pe + c * q.e),
    )


@inlined
def forces(integrals, S, tan_phi, c, r, b, direction):
    """`Forces` from `ArcIntegrals`: Eqs. (1)-(3) with the exact resistance integral of Eq. (11) ("consistent").

    `direction` is the smoothed sign of the travel speed (1 in a steady forward run): behind a turned-round wheel the
    horizontal part of the normal stress and the vertical part of the shear stress change sign.
    """
    shear = shear_forces(integrals, S * tan_phi, c, r, b, direction)
    normal = r * b * S
    return Forces(
        normal * integrals.p_cos + shear.load,
        shear.drawbar_pull - direction * normal * integrals.p_sin,
        shear.torque,
    )


@part
def compaction_resistance(sinkage, S, n, b):
    """Resistance [N] of Eq. (12), b S z0^(n+1) / (n+1): equal to Eq. (11) only without the rear branch (8)."""
    return b * S * sinkage ** (n + 1.0) / (n + 1.0)


@inlined
def bearing_share(integrals, tan_phi, direction):
    """Load over S r b [m^n]: what the normal stress and the friction that it brings carry, Eq. (1)."""
    return integrals.p_cos + direction * tan_phi * integrals.pe_sin


@inlined
def mobilised_modulus(integrals, load, tan_phi, c, r, b, direction):
    """Sinkage coefficient s [N/m^(n+2)] at which Eq. (1) carries `load` [N] on this arc; at least 0.

    Eq. (1) is linear in S, so at a given sinkage the coefficient the load mobilises has a closed form.
    """
    q = integrals
    bearing = bearing_share(q, tan_phi, direction)
    rest = load / (r * b) - direction * c * q.e_sin
    return where_less(1e-12 * q.p_cos, bearing, where_less(0.0, rest, rest / bearing, 0.0), 0.0)
