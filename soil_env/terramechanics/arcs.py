"""Eight contact arcs at once, one a lane: the integrals of `contact.py` in the base model.

`store_nodes` and `stored_integrals` serve points of known motion at any K, `store_arcs` and `arcs_integrals` wheels on
known soil at any motion.
"""

from __future__ import annotations

from typing import NamedTuple

from soil_env._numba.compiling import inlined
from soil_env._numba.elementary import asin_root, copysign, exp_lanes, fma, half_sin_cos, log_lanes
from soil_env._numba.lanes import COUNT, fill, from_array, scratch, to_array
from soil_env.terramechanics.contact import (
    JANOSI,
    NODE_DEPTHS,
    NODE_WEIGHTS,
    NODES_PER_ZONE,
    ArcIntegrals,
    ArcRates,
    mobilised,
    zone,
)

#: Floats that `store_nodes` writes.
STORED_NODES = COUNT * (7 * NODES_PER_ZONE + 1)


@inlined
def entry_angle_of_many(sinkage, r):
    """`entry_angle` in lanes."""
    return 2.0 * asin_root((0.5 / r) * sinkage)


@inlined
def store_nodes(theta1, travel, n, r, out, at):
    """Nodes of eight wheels of one radius on one exponent, into out[at] .. out[at + STORED_NODES - 1].

    `theta1` and `travel` are lanes, one a wheel; rim = 1, theta2 = 0, thetam = theta1/2. Nodes and stresses are as in
    `arc_nodes`; what is stored serves `stored_integrals` at any K.
    """
    half = 0.5 * theta1
    sin_half1, cos_half1 = half_sin_cos(theta1)
    sin1, rise1 = 2.0 * sin_half1 * cos_half1, sin_half1 * sin_half1
    to_array(half, out, at)
    at += COUNT
    for k in range(NODES_PER_ZONE):
        ahead, behind = theta1 - half * NODE_DEPTHS[k], half * NODE_DEPTHS[k]
        sin_half, cos_half = half_sin_cos(ahead)
        sin_half2, cos_half2 = half_sin_cos(behind)
        p = exp_lanes(n * log_lanes((2.0 * r) * (rise1 - sin_half * sin_half)))
        one = fill(1.0)
        z = zone(theta1, sin1, ahead, sin_half, cos_half, one, one, r)
        y = zone(theta1, sin1, behind, sin_half2, cos_half2, one, one, r)
        to_array(p, out, at)
        to_array(z.w_cos, out, at + COUNT)
        to_array(z.w_sin, out, at + 2 * COUNT)
        to_array(z.lever_rim + travel * z.lever_travel, out, at + 3 * COUNT)
        to_array(y.w_cos, out, at + 4 * COUNT)
        to_array(y.w_sin, out, at + 5 * COUNT)
        to_array(y.lever_rim + travel * y.lever_travel, out, at + 6 * COUNT)
        at += 7 * COUNT


@inlined
def stored_integrals(nodes, at, K):
    """(ArcIntegrals, ArcRates by K) in lanes, of the wheels of `store_nodes`, with the shear law `JANOSI`."""
    half = from_array(nodes, at)
    at += COUNT
    o = fill(0.0)
    p_cos, p_sin, pe_cos, pe_sin, pe, e_cos, e_sin, e_sum = o, o, o, o, o, o, o, o
    kpe_cos, kpe_sin, kpe, ke_cos, ke_sin, ke = o, o, o, o, o, o
    rate = -1.0 / K
    for k in range(NODES_PER_ZONE):
        w = half * NODE_WEIGHTS[k]
        p = from_array(nodes, at)
        c, s, j = from_array(nodes, at + COUNT), from_array(nodes, at + 2 * COUNT), from_array(nodes, at + 3 * COUNT)
        c2, s2 = from_array(nodes, at + 4 * COUNT), from_array(nodes, at + 5 * COUNT)
        j2 = from_array(nodes, at + 6 * COUNT)
        at += 7 * COUNT
        e, g = mobilised(j, K, JANOSI)
        e2, g2 = mobilised(j2, K, JANOSI)
        g, g2 = (rate * j) * g, (rate * j2) * g2
        # the two nodes share weight and stress
        wp = w * p
        ec, es, e = fma(e, c, e2 * c2), fma(e, s, e2 * s2), e + e2
        gc, gs, g = fma(g, c, g2 * c2), fma(g, s, g2 * s2), g + g2
        p_cos, p_sin = fma(wp, c + c2, p_cos), fma(wp, s + s2, p_sin)
        pe_cos, pe_sin, pe = fma(wp, ec, pe_cos), fma(wp, es, pe_sin), fma(wp, e, pe)
        e_cos, e_sin, e_sum = fma(w, ec, e_cos), fma(w, es, e_sin), fma(w, e, e_sum)
        kpe_cos, kpe_sin, kpe = fma(wp, gc, kpe_cos), fma(wp, gs, kpe_sin), fma(wp, g, kpe)
        ke_cos, ke_sin, ke = fma(w, gc, ke_cos), fma(w, gs, ke_sin), fma(w, g, ke)
    return (
        ArcIntegrals(p_cos, p_sin, pe_cos, pe_sin, pe, e_cos, e_sin, e_sum),
        ArcRates(kpe_cos, kpe_sin, kpe, ke_cos, ke_sin, ke),
    )


#: Floats that `store_arcs` writes.
ARCS = COUNT * 5 * NODES_PER_ZONE
_shear = scratch(COUNT * 6 * NODES_PER_ZONE)


class Arcs(NamedTuple):
    """Eight contact arcs, in lanes, beside what `store_arcs` writes."""

    theta1: float  # [rad]
    sin1: float
    p_cos: float  # as in `ArcIntegrals`
    p_sin: float


@inlined
def store_arcs(theta1, n, r, out, at):
    """What the nodes of `contact.arc_nodes` need whatever the motion and K, into out[at] .. out[at + ARCS - 1]; `Arcs`.

    `theta1` and `n` are lanes; theta2 = 0, thetam = theta1/2.
    """
    half = 0.5 * theta1
    sin_half1, cos_half1 = half_sin_cos(theta1)
    rise1 = sin_half1 * sin_half1
    p_cos, p_sin = fill(0.0), fill(0.0)
    for k in range(NODES_PER_ZONE):
        sin_half, cos_half = half_sin_cos(theta1 - half * NODE_DEPTHS[k])
        sin_half2, cos_half2 = half_sin_cos(half * NODE_DEPTHS[k])
        wp = NODE_WEIGHTS[k] * exp_lanes(n * log_lanes((2.0 * r) * (rise1 - sin_half * sin_half)))
        c, s = fma(-2.0 * sin_half, sin_half, fill(1.0)), 2.0 * sin_half * cos_half
        c2, s2 = fma(-2.0 * sin_half2, sin_half2, fill(1.0)), 2.0 * sin_half2 * cos_half2
        p_cos, p_sin = fma(wp, c + c2, p_cos), fma(wp, s + s2, p_sin)
        to_array(wp, out, at)
        to_array(c, out, at + COUNT)
        to_array(s, out, at + 2 * COUNT)
        to_array(c2, out, at + 3 * COUNT)
        to_array(s2, out, at + 4 * COUNT)
        at += 5 * COUNT
    return Arcs(theta1, 2.0 * sin_half1 * cos_half1, half * p_cos, half * p_sin)


@inlined
def _mobilised(j, rate):
    """`contact.mobilised` by Janosi's law, rate = 1/K."""
    decay = exp_lanes(-rate * abs(j))
    return copysign(1.0 - decay, j), rate * decay


@inlined
def _sums(nodes, at, shear, which, half):
    """Six sums over the arcs of the values of front and rear nodes at shear[which]: with and without the stress.

    One value at a time, as the sums of all of them do not fit into the registers.
    """
    o = fill(0.0)
    p_cos, p_sin, p, cos_, sin_, plain = o, o, o, o, o, o
    i = which * COUNT
    for k in range(NODES_PER_ZONE):
        wp, w = from_array(nodes, at), NODE_WEIGHTS[k]
        c, s = from_array(nodes, at + COUNT), from_array(nodes, at + 2 * COUNT)
        c2, s2 = from_array(nodes, at + 3 * COUNT), from_array(nodes, at + 4 * COUNT)
        e, e2 = from_array(shear, i), from_array(shear, i + COUNT)
        at, i = at + 5 * COUNT, i + 6 * COUNT
        # the two nodes share weight and stress
        ec, es, e = fma(e, c, e2 * c2), fma(e, s, e2 * s2), e + e2
        p_cos, p_sin, p = fma(wp, ec, p_cos), fma(wp, es, p_sin), fma(wp, e, p)
        cos_, sin_, plain = fma(w, ec, cos_), fma(w, es, sin_), fma(w, e, plain)
    return half * p_cos, half * p_sin, half * p, half * cos_, half * sin_, half * plain


@inlined
def arcs_integrals(nodes, start, arcs, rim, travel, K, r):
    """(ArcIntegrals, ArcRates by `rim`, ArcRates by `travel`) in lanes, of what `store_arcs` left at nodes[start]."""
    half, rate, shear = 0.5 * arcs.theta1, 1.0 / K, _shear()
    at, i = start, 0
    for k in range(NODES_PER_ZONE):
        depth = half * NODE_DEPTHS[k]
        a, a2 = r * depth, r * (arcs.theta1 - depth)  # dj/d(rim)
        z = r * (from_array(nodes, at + 2 * COUNT) - arcs.sin1)  # dj/d(travel)
        z2 = r * (from_array(nodes, at + 4 * COUNT) - arcs.sin1)
        e, g = _mobilised(fma(rim, a, travel * z), rate)
        e2, g2 = _mobilised(fma(rim, a2, travel * z2), rate)
        to_array(e, shear, i)
        to_array(e2, shear, i + COUNT)
        to_array(g * a, shear, i + 2 * COUNT)
        to_array(g2 * a2, shear, i + 3 * COUNT)
        to_array(g * z, shear, i + 4 * COUNT)
        to_array(g2 * z2, shear, i + 5 * COUNT)
        at, i = at + 5 * COUNT, i + 6 * COUNT
    e = _sums(nodes, start, shear, 0, half)
    a = _sums(nodes, start, shear, 2, half)
    z = _sums(nodes, start, shear, 4, half)
    return (
        ArcIntegrals(arcs.p_cos, arcs.p_sin, e[0], e[1], e[2], e[3], e[4], e[5]),
        ArcRates(a[0], a[1], a[2], a[3], a[4], a[5]),
        ArcRates(z[0], z[1], z[2], z[3], z[4], z[5]),
    )
