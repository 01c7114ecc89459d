"""Integrals over the contact arc by Gauss-Legendre quadrature.

The nodes of one wheel's arc are in the lanes; those of eight wheels' arcs, one wheel a lane, are taken one after the
other. The same code does both (`lanes.over_eight`).
"""

from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_inline, compiled_part
from soil_env._numba.elementary import fma, half_sin_cos, larger, log, power, where_less
from soil_env._numba.lanes import COUNT, fill, from_array, over_eight, summed, to_array, turns
from soil_env._numba.rows import Rows, rows, scratch_rows
from soil_env.terramechanics.contact import JANOSI, Arc, ArcIntegrals, ArcRates, mobilised

#: Gauss-Legendre nodes per zone of the contact arc (front and rear nodes share the normal stress).
NODES_PER_ZONE = 8
_x, _w = np.polynomial.legendre.leggauss(NODES_PER_ZONE)
NODE_DEPTHS = (0.5 * (_x + 1.0)) ** 2  # u^2: relative distance of the node from the end of the arc
NODE_WEIGHTS = 0.5 * _w * 2.0 * (0.5 * (_x + 1.0))  # weight times d(u^2)/du
_depth = over_eight(NODE_DEPTHS)
_weight = over_eight(NODE_WEIGHTS)


#: Nodes of contact arcs: COUNT columns a node, NODE_COLUMNS for eight wheels. Stress for S = 1 times the node's weight,
#: cosine and sine of the front node, and of the rear node times the length of its zone over that of the front zone.
Nodes: type[Rows] = rows("Nodes", "stress", "cos_front", "sin_front", "cos_rear", "sin_rear")
NODE_COLUMNS = COUNT * NODES_PER_ZONE
_ShearAtNodes: type[Rows] = rows(
    "_ShearAtNodes", "e_front", "e_rear", "x_front", "x_rear", "y_front", "y_rear"
)
_shear_at_nodes = scratch_rows(_ShearAtNodes, NODE_COLUMNS)
_one_arc = scratch_rows(Nodes, COUNT)


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
def store_nodes(arc, n, nodes, at):
    """Write what quadrature nodes of an `Arc` need at any motion and K to columns at.. of `Nodes`; return `ArcFrame`.

    Gauss-Legendre nodes are at theta1 - (theta1 - thetam) u^2 in front and theta2 + (thetam - theta2) u^2 behind. That
    removes the singularity (theta1 - theta)^n at both ends. By Eq. (8) the two nodes have the same normal stress.
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
    """dj/d(rim) and dj/d(travel) [m] at the front node, then at the rear node: Eq. (10) split by the motion."""
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
    """Six sums over an arc of values at its nodes: with the stress times cos, sin and 1, and without the stress.

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
def _shear(frame, nodes, at, rim, travel, K, r, law, shear):
    """Mobilised share at the nodes of `store_nodes` and its derivatives, x by `rim` and y by `travel`, into `shear`."""
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


@compiled_inline
def _shear_sums(frame, nodes, at, shear):
    e = _sums(frame, nodes, at, shear.e_front, shear.e_rear)
    by_rim = _sums(frame, nodes, at, shear.x_front, shear.x_rear)
    return _integrals(frame, e), by_rim, _sums(frame, nodes, at, shear.y_front, shear.y_rear)


@compiled_inline
def shear_integrals(frame, nodes, at, rim, travel, K, r, law):
    """(ArcIntegrals, ArcRates by `rim`, ArcRates by `travel`) of the nodes of `store_nodes` at one motion."""
    shear = _shear_at_nodes()
    _shear(frame, nodes, at, rim, travel, K, r, law, shear)
    return _shear_sums(frame, nodes, at, shear)


@compiled_inline
def smooth_integrals(frame, nodes, rim, travel, K, n, r, law):
    """Integrals of an arc of `smooth_arc`, from the first column of nodes on, and their derivatives.

    (ArcIntegrals, ArcRates by `rim`, by `travel`, ArcIntegrals by the entry angle [1/rad], by the sinkage exponent).
    """
    shear = _shear_at_nodes()
    _shear(frame, nodes, 0, rim, travel, K, r, law, shear)
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
def integrals_alone(arc, rim, travel, K, n, law):
    """`ArcIntegrals` of one wheel's `Arc`, without derivatives."""
    nodes = _one_arc()
    shear = _shear_at_nodes()
    frame = store_nodes(arc, n, nodes, 0)
    for k in range(turns(frame.theta1)):
        a, z, a2, z2 = _levers(frame, nodes, k * COUNT, k, arc.radius)
        to_array(mobilised(fma(rim, a, travel * z), K, law)[0], shear.e_front, k * COUNT)
        to_array(mobilised(fma(rim, a2, travel * z2), K, law)[0], shear.e_rear, k * COUNT)
    return _integrals(frame, _sums(frame, nodes, 0, shear.e_front, shear.e_rear))


@compiled_inline
def integrals_of(arc, rim, travel, K, n, law):
    """(ArcIntegrals, ArcRates by `rim`, ArcRates by `travel`) of one wheel's `Arc`, by the rule of `store_nodes`."""
    nodes = _one_arc()
    frame = store_nodes(arc, n, nodes, 0)
    return shear_integrals(frame, nodes, 0, rim, travel, K, arc.radius, law)


@compiled_part
def arc_integrals(theta1, theta2, thetam, rim, travel, K, n, r):
    """Integrals of Eqs. (1)-(3) and their derivatives: (ArcIntegrals, ArcRates by `rim`, ArcRates by `travel`).

    Rule and nodes: `store_nodes`. Relative error about 1e-5 when driving; when braking j changes sign within the arc
    and it reaches 5.5e-3 of the load for K/r of 0.02 to 0.05 (docs/results/README.md). The derivative by K
    needs no further integrals: see `shear_modulus_rates`.
    """
    return integrals_of(Arc(theta1, theta2, thetam, theta1, r), rim, travel, K, n, JANOSI)


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
