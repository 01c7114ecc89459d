"""Stresses under a rigid wheel and the forces they sum to: Eqs. (1)-(10) of the source paper
(docs/physics/contact.md).

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251; the stress
distribution is Wong & Reece (1967), the shear law Janosi & Hanamoto (1961).

The integrals over the contact arc are by Gauss-Legendre quadrature. The nodes of one wheel's arc
are in the lanes; those of eight wheels' arcs, one wheel a lane, are taken one after the other. The
same code does both (`lanes.over_eight`). Beside the contact, the motion of a wheel and its digging.
The wheel travels forward.
"""

from typing import NamedTuple

import numpy as np

from soil_env.identification.online.lanes.compiling import compiled_inline
from soil_env.identification.online.lanes.elementary import (
    asin_root,
    copysign,
    exp,
    fma,
    half_sin_cos,
    larger,
    log,
    power,
    smooth_step,
    where_less,
)
from soil_env.identification.online.lanes.lanes import (
    COUNT,
    alike,
    fill,
    from_array,
    over_eight,
    summed,
    to_array,
    turns,
)
from soil_env.identification.online.lanes.rows import Rows, rows, scratch_rows

#: Gauss-Legendre nodes per zone of the contact arc (front and rear nodes share the normal stress).
NODES_PER_ZONE = 8
_x, _w = np.polynomial.legendre.leggauss(NODES_PER_ZONE)
NODE_DEPTHS = (0.5 * (_x + 1.0)) ** 2  # u^2: relative distance of the node from the end of the arc
NODE_WEIGHTS = 0.5 * _w * 2.0 * (0.5 * (_x + 1.0))  # weight times d(u^2)/du
_depth = over_eight(NODE_DEPTHS)
_weight = over_eight(NODE_WEIGHTS)


#: Nodes of contact arcs: COUNT columns a node, NODE_COLUMNS for eight wheels. Stress for S = 1
#: times the node's weight, cosine and sine of the front node, and of the rear node times the length
#: of its zone over that of the front zone.
Nodes: type[Rows] = rows("Nodes", "stress", "cos_front", "sin_front", "cos_rear", "sin_rear")
NODE_COLUMNS = COUNT * NODES_PER_ZONE
_ShearAtNodes: type[Rows] = rows(
    "_ShearAtNodes", "e_front", "e_rear", "x_front", "x_rear", "y_front", "y_rear"
)
_shear_at_nodes = scratch_rows(_ShearAtNodes, NODE_COLUMNS)
_one_arc = scratch_rows(Nodes, COUNT)


class ArcIntegrals(NamedTuple):
    """Integrals over the contact arc [theta2, theta1], for S = 1 [m^n] or without stress [-].

    p(theta) is the normal stress for S = 1, e(theta) in [-1, 1] the mobilised share of the shear
    strength.
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


class ArcFrame(NamedTuple):
    """Quantities that the nodes of an arc share, beside those that `store_nodes` writes."""

    theta1: float  # [rad]
    front: float  # [rad] length of the front zone
    ratio: float  # length of the rear zone over it
    lever_front: float  # [m] dj/d(rim) at the entry
    lever_rear: float  # [m] dj/d(rim) at the exit
    lever_sin: float  # [m] r sin(sheared_from)
    p_cos: float  # as in `ArcIntegrals`
    p_sin: float


@compiled_inline
def motion_from_slip(slip):
    """(rim, travel) of a wheel travelling forward at the given slip in [-1, 1]; -1 is locked, 1
    spins on the spot.
    """
    braking = larger(1.0 + slip, 1e-9)  # r w / V
    return alike(1.0, slip), where_less(slip, 0.0, 1.0 / braking, 1.0 - slip)


@compiled_inline
def travel_rate(travel):
    """Derivative of `travel` of `motion_from_slip` by the slip: -1 driving, -travel^2 braking."""
    braking = larger(travel, 1.0)
    return -1.0 * braking * braking


@compiled_inline
def digging_ratio(slid, way, gain, recovery):
    """Steady sinkage over that without slip, at least 1, where the rim slides by `slid` on a `way`
    of the same unit.
    """
    return 1.0 + gain * slid / larger(way + recovery * slid, 1e-6)


@compiled_inline
def onto_fresh(x, low, high):
    """Distance [m] by which a wheel at x has left the stretch from `low` to `high` that it had
    touched before.
    """
    return larger(x - high, 0.0) + larger(low - x, 0.0)


@compiled_inline
def share_of_next(distance):
    """(share of the next soil on a border, its derivative) at a distance from its middle, in
    lengths of the border.

    A cubic from 0 half a length before the middle to 1 half a length behind it.
    """
    return smooth_step(distance + 0.5)


@compiled_inline
def entry_angle(sinkage, r):
    """Entry angle theta1 [rad] of a wheel of radius r [m] at the given sinkage [m]: z0 = r (1 - cos
    theta1).
    """
    return 2.0 * asin_root((0.5 / r) * sinkage)


@compiled_inline
def smooth_arc(sinkage, r):
    """`Arc` of the source paper: theta2 = 0 and the peak midway, Eq. (9)."""
    theta1 = entry_angle(sinkage, r)
    return Arc(theta1, 0.0 * theta1, 0.5 * theta1, theta1, r)


@compiled_inline
def mobilised(j, K):
    """(e, de/dj): mobilised share of the shear strength at displacement j [m], signed as j; Eq.
    (10).
    """
    rate = 1.0 / K
    decay = exp(-1.0 * (rate * abs(j)))
    return copysign(1.0 - decay, j), rate * decay


@compiled_inline
def store_nodes(arc, n, nodes, at):
    """Write what quadrature nodes of an `Arc` need at any motion and K to columns at.. of `Nodes`;
    return `ArcFrame`.

    Gauss-Legendre nodes are at theta1 - (theta1 - thetam) u^2 in front and theta2 + (thetam -
    theta2) u^2 behind. That removes the singularity (theta1 - theta)^n at both ends. By Eq. (8) the
    two nodes have the same normal stress.
    """
    front = arc.theta1 - arc.thetam
    rear = arc.thetam - arc.theta2
    ratio = where_less(0.0, front, rear / front, 1.0)
    sin_half1, _ = half_sin_cos(fill(arc.theta1))
    rise1 = sin_half1 * sin_half1
    p_cos = fill(0.0)
    p_sin = fill(0.0)
    for k in range(turns(arc.theta1)):
        depth = _depth(arc.theta1, k)
        i = at + k * COUNT
        sin_half, cos_half = half_sin_cos(arc.theta1 - front * depth)
        sin_half2, cos_half2 = half_sin_cos(arc.theta2 + rear * depth)
        stress = _weight(arc.theta1, k) * power(
            (2.0 * arc.radius) * (rise1 - sin_half * sin_half), n
        )
        c = fma(-2.0 * sin_half, sin_half, 1.0)
        s = 2.0 * sin_half * cos_half
        c2 = ratio * fma(-2.0 * sin_half2, sin_half2, 1.0)
        s2 = (2.0 * ratio) * (sin_half2 * cos_half2)
        p_cos = fma(stress, c + c2, p_cos)
        p_sin = fma(stress, s + s2, p_sin)
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


@compiled_inline
def _levers(frame, nodes, i, k, r):
    """dj/d(rim) and dj/d(travel) [m] at the front node, then at the rear node: Eq. (10) split by
    the motion.
    """
    depth = _depth(frame.theta1, k)
    ahead = (r * frame.front) * depth
    return (
        frame.lever_front + ahead,
        fma(r, from_array(nodes.sin_front, i), -frame.lever_sin),
        frame.lever_rear - frame.ratio * ahead,
        fma(r / frame.ratio, from_array(nodes.sin_rear, i), -frame.lever_sin),
    )


@compiled_inline
def _sums(frame, nodes, at, in_front, behind):
    """Six sums over an arc of values at its nodes: with the stress times cos, sin and 1, and
    without the stress.

    One value at a time, as the sums of all of them do not fit into the registers.
    """
    o = fill(0.0)
    pattern = frame.theta1
    p_cos = o
    p_sin = o
    p = o
    cos_ = o
    sin_ = o
    plain = o
    for k in range(turns(pattern)):
        i = at + k * COUNT
        stress = from_array(nodes.stress, i)
        w = _weight(pattern, k)
        e = from_array(in_front, k * COUNT)
        e2 = from_array(behind, k * COUNT)
        ec = fma(e, from_array(nodes.cos_front, i), e2 * from_array(nodes.cos_rear, i))
        es = fma(e, from_array(nodes.sin_front, i), e2 * from_array(nodes.sin_rear, i))
        e = fma(e2, frame.ratio, e)
        p_cos = fma(stress, ec, p_cos)
        p_sin = fma(stress, es, p_sin)
        p = fma(stress, e, p)
        cos_ = fma(w, ec, cos_)
        sin_ = fma(w, es, sin_)
        plain = fma(w, e, plain)
    front = frame.front
    return ArcRates(
        summed(front * p_cos, pattern),
        summed(front * p_sin, pattern),
        summed(front * p, pattern),
        summed(front * cos_, pattern),
        summed(front * sin_, pattern),
        summed(front * plain, pattern),
    )


@compiled_inline
def _integrals(frame, e):
    """`ArcIntegrals` from the six sums `e` of the mobilised share."""
    return ArcIntegrals(frame.p_cos, frame.p_sin, e.pe_cos, e.pe_sin, e.pe, e.e_cos, e.e_sin, e.e)


@compiled_inline
def _shear(frame, nodes, at, rim, travel, K, r, shear):
    """Mobilised share at the nodes of `store_nodes` and its derivatives, x by `rim` and y by
    `travel`, into `shear`.
    """
    for k in range(turns(frame.theta1)):
        i = k * COUNT
        a, z, a2, z2 = _levers(frame, nodes, at + i, k, r)
        e, g = mobilised(fma(rim, a, travel * z), K)
        e2, g2 = mobilised(fma(rim, a2, travel * z2), K)
        to_array(e, shear.e_front, i)
        to_array(e2, shear.e_rear, i)
        to_array(g * a, shear.x_front, i)
        to_array(g2 * a2, shear.x_rear, i)
        to_array(g * z, shear.y_front, i)
        to_array(g2 * z2, shear.y_rear, i)


@compiled_inline
def _shear_sums(frame, nodes, at, shear):
    e = _sums(frame, nodes, at, shear.e_front, shear.e_rear)
    by_rim = _sums(frame, nodes, at, shear.x_front, shear.x_rear)
    return _integrals(frame, e), by_rim, _sums(frame, nodes, at, shear.y_front, shear.y_rear)


@compiled_inline
def smooth_integrals(frame, nodes, rim, travel, K, n, r):
    """Integrals of an arc of `smooth_arc`, from the first column of nodes on, and their
    derivatives.

    (ArcIntegrals, ArcRates by `rim`, by `travel`, ArcIntegrals by the entry angle [1/rad], by the
    sinkage exponent).
    """
    shear = _shear_at_nodes()
    _shear(frame, nodes, 0, rim, travel, K, r, shear)
    q, by_rim, by_travel = _shear_sums(frame, nodes, 0, shear)
    sin_half1, cos_half1 = half_sin_cos(fill(frame.theta1))
    sin1 = 2.0 * sin_half1 * cos_half1
    cos1 = fma(-2.0 * sin_half1, sin_half1, 1.0)
    by_angle = _by_entry_angle(frame, nodes, q, sin1, cos1, rim, travel, n, shear)
    return q, by_rim, by_travel, by_angle, _by_exponent(frame, nodes, cos1, r, shear)


@compiled_inline
def _by_entry_angle(frame, nodes, q, sin1, cos1, rim, travel, n, shear):
    """All angles of `smooth_arc` are in proportion to the entry angle, those of the nodes too."""
    o = fill(0.0)
    pattern = frame.theta1
    front = frame.front
    p_cos = o
    p_sin = o
    pe_cos = o
    pe_sin = o
    pe = o
    e_cos = o
    e_sin = o
    plain = o
    for k in range(turns(pattern)):
        i = k * COUNT
        behind = 0.5 * _depth(pattern, k)
        ahead = 1.0 - behind  # angles of the two nodes over the entry angle
        stress = from_array(nodes.stress, i)
        w = _weight(pattern, k)
        c = from_array(nodes.cos_front, i)
        s = from_array(nodes.sin_front, i)
        c2 = from_array(nodes.cos_rear, i)
        s2 = from_array(nodes.sin_rear, i)
        e = from_array(shear.e_front, i)
        e2 = from_array(shear.e_rear, i)
        change = stress * n * (sin1 - ahead * s) / (c - cos1)
        d = from_array(shear.x_front, i) * fma(travel, (ahead * c - cos1) / behind, rim)
        d2 = from_array(shear.x_rear, i) * fma(travel, (behind * c2 - cos1) / ahead, rim)
        d = d / frame.theta1
        d2 = d2 / frame.theta1
        ec = fma(d, c, d2 * c2) - fma(ahead * e, s, behind * e2 * s2)
        es = fma(d, s, d2 * s2) + fma(ahead * e, c, behind * e2 * c2)
        p_cos = fma(change, c + c2, p_cos) - stress * fma(ahead, s, behind * s2)
        p_sin = fma(change, s + s2, p_sin) + stress * fma(ahead, c, behind * c2)
        pe_cos = fma(change, fma(e, c, e2 * c2), fma(stress, ec, pe_cos))
        pe_sin = fma(change, fma(e, s, e2 * s2), fma(stress, es, pe_sin))
        pe = fma(change, e + e2, fma(stress, d + d2, pe))
        e_cos = fma(w, ec, e_cos)
        e_sin = fma(w, es, e_sin)
        plain = fma(w, d + d2, plain)
    share = 1.0 / frame.theta1  # of the length of a zone
    return ArcIntegrals(
        summed(front * p_cos, pattern) + share * q.p_cos,
        summed(front * p_sin, pattern) + share * q.p_sin,
        summed(front * pe_cos, pattern) + share * q.pe_cos,
        summed(front * pe_sin, pattern) + share * q.pe_sin,
        summed(front * pe, pattern) + share * q.pe,
        summed(front * e_cos, pattern) + share * q.e_cos,
        summed(front * e_sin, pattern) + share * q.e_sin,
        summed(front * plain, pattern) + share * q.e,
    )


@compiled_inline
def _by_exponent(frame, nodes, cos1, r, shear):
    """The stress at each node changes by sigma ln(depth)."""
    o = fill(0.0)
    pattern = frame.theta1
    front = frame.front
    p_cos = o
    p_sin = o
    pe_cos = o
    pe_sin = o
    pe = o
    for k in range(turns(pattern)):
        i = k * COUNT
        c = from_array(nodes.cos_front, i)
        s = from_array(nodes.sin_front, i)
        c2 = from_array(nodes.cos_rear, i)
        s2 = from_array(nodes.sin_rear, i)
        e = from_array(shear.e_front, i)
        e2 = from_array(shear.e_rear, i)
        change = from_array(nodes.stress, i) * log(larger(r * (c - cos1), 1e-300))
        p_cos = fma(change, c + c2, p_cos)
        p_sin = fma(change, s + s2, p_sin)
        pe_cos = fma(change, fma(e, c, e2 * c2), pe_cos)
        pe_sin = fma(change, fma(e, s, e2 * s2), pe_sin)
        pe = fma(change, e + e2, pe)
    none = 0.0 * front
    return ArcIntegrals(
        summed(front * p_cos, pattern),
        summed(front * p_sin, pattern),
        summed(front * pe_cos, pattern),
        summed(front * pe_sin, pattern),
        summed(front * pe, pattern),
        none,
        none,
        none,
    )


@compiled_inline
def integrals_alone(arc, rim, travel, K, n):
    """`ArcIntegrals` of one wheel's `Arc`, without derivatives."""
    nodes = _one_arc()
    shear = _shear_at_nodes()
    frame = store_nodes(arc, n, nodes, 0)
    for k in range(turns(frame.theta1)):
        a, z, a2, z2 = _levers(frame, nodes, k * COUNT, k, arc.radius)
        to_array(mobilised(fma(rim, a, travel * z), K)[0], shear.e_front, k * COUNT)
        to_array(mobilised(fma(rim, a2, travel * z2), K)[0], shear.e_rear, k * COUNT)
    return _integrals(frame, _sums(frame, nodes, 0, shear.e_front, shear.e_rear))


@compiled_inline
def shear_modulus_rates(by_rim, by_travel, rim, travel, K):
    """`ArcRates` by K [1/m]: de/dK = -(j/K) de/dj with j linear in (rim, travel)."""
    x = -rim / K
    y = -travel / K
    return ArcRates(
        x * by_rim.pe_cos + y * by_travel.pe_cos,
        x * by_rim.pe_sin + y * by_travel.pe_sin,
        x * by_rim.pe + y * by_travel.pe,
        x * by_rim.e_cos + y * by_travel.e_cos,
        x * by_rim.e_sin + y * by_travel.e_sin,
        x * by_rim.e + y * by_travel.e,
    )


@compiled_inline
def shear_forces(q, st, c, r, b):
    """`Forces` of the shear stress alone, st = S tan(phi), from `ArcIntegrals`; from `ArcRates`,
    their derivatives.
    """
    rb = r * b
    return Forces(
        rb * (st * q.pe_sin + c * q.e_sin),
        rb * (st * q.pe_cos + c * q.e_cos),
        r * rb * (st * q.pe + c * q.e),
    )


@compiled_inline
def forces(integrals, S, tan_phi, c, r, b):
    """`Forces` from `ArcIntegrals`: Eqs. (1)-(3) with the exact resistance integral of Eq. (11)
    ("consistent").
    """
    shear = shear_forces(integrals, S * tan_phi, c, r, b)
    normal = r * b * S
    return Forces(
        normal * integrals.p_cos + shear.load,
        shear.drawbar_pull - normal * integrals.p_sin,
        shear.torque,
    )


@compiled_inline
def bearing_share(integrals, tan_phi):
    """Load borne by the normal stress and by the friction in proportion to it, over S r b [m^n];
    Eq. (1).
    """
    return integrals.p_cos + tan_phi * integrals.pe_sin


@compiled_inline
def mobilised_sinkage_coefficient(integrals, load, tan_phi, c, r, b):
    """Sinkage coefficient s [N/m^(n+2)] at which Eq. (1) carries `load` [N] on this arc; at least
    0.

    Eq. (1) is linear in S, so at a given sinkage the coefficient the load mobilises has a closed
    form.
    """
    q = integrals
    bearing = bearing_share(q, tan_phi)
    rest = load / (r * b) - c * q.e_sin
    return where_less(1e-12 * q.p_cos, bearing, where_less(0.0, rest, rest / bearing, 0.0), 0.0)
