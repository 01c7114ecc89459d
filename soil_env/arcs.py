"""The contact arcs of eight wheels at once, one wheel a lane: the integrals of `contact.py` in the base model."""

from __future__ import annotations

from soil_env.compiled import inlined
from soil_env.contact import (
    NODE_DEPTHS,
    NODE_WEIGHTS,
    NODES_PER_ZONE,
    ArcIntegrals,
    ArcRates,
)
from soil_env.lanes import COUNT, copysign, exp_lanes, fill, fma, from_array, half_sin_cos, log_lanes, to_array

#: Floats that `store_arcs` writes.
ARCS = COUNT * 5 * NODES_PER_ZONE


@inlined
def store_arcs(theta1, n, r, out):
    """What the nodes of `contact.arc_nodes` need whatever the motion and K, into `out` [ARCS]; sin(theta1).

    `theta1` and `n` are lanes; theta2 = 0, thetam = theta1/2.
    """
    half = 0.5 * theta1
    sin_half1, cos_half1 = half_sin_cos(theta1)
    rise1 = sin_half1 * sin_half1
    at = 0
    for k in range(NODES_PER_ZONE):
        sin_half, cos_half = half_sin_cos(theta1 - half * NODE_DEPTHS[k])
        sin_half2, cos_half2 = half_sin_cos(half * NODE_DEPTHS[k])
        p = exp_lanes(n * log_lanes((2.0 * r) * (rise1 - sin_half * sin_half)))
        to_array(NODE_WEIGHTS[k] * p, out, at)
        to_array(fma(-2.0 * sin_half, sin_half, fill(1.0)), out, at + COUNT)
        to_array(2.0 * sin_half * cos_half, out, at + 2 * COUNT)
        to_array(fma(-2.0 * sin_half2, sin_half2, fill(1.0)), out, at + 3 * COUNT)
        to_array(2.0 * sin_half2 * cos_half2, out, at + 4 * COUNT)
        at += 5 * COUNT
    return 2.0 * sin_half1 * cos_half1


@inlined
def _mobilised(j, rate):
    """`contact.mobilised` by Janosi's law, rate = 1/K."""
    decay = exp_lanes(-rate * abs(j))
    return copysign(1.0 - decay, j), rate * decay


@inlined
def arcs_integrals(nodes, theta1, sin1, rim, travel, K, r):
    """(ArcIntegrals, ArcRates by `rim`, ArcRates by `travel`) in lanes, of the wheels of `store_arcs`."""
    half, rate = 0.5 * theta1, 1.0 / K
    o = fill(0.0)
    p_cos, p_sin, pe_cos, pe_sin, pe, e_cos, e_sin, e_sum = o, o, o, o, o, o, o, o
    ape_cos, ape_sin, ape, ae_cos, ae_sin, ae = o, o, o, o, o, o
    zpe_cos, zpe_sin, zpe, ze_cos, ze_sin, ze = o, o, o, o, o, o
    at = 0
    for k in range(NODES_PER_ZONE):
        wp, w = from_array(nodes, at), NODE_WEIGHTS[k]
        c, s = from_array(nodes, at + COUNT), from_array(nodes, at + 2 * COUNT)
        c2, s2 = from_array(nodes, at + 3 * COUNT), from_array(nodes, at + 4 * COUNT)
        at += 5 * COUNT
        depth = half * NODE_DEPTHS[k]
        a, a2 = r * depth, r * (theta1 - depth)  # dj/d(rim)
        z, z2 = r * (s - sin1), r * (s2 - sin1)  # dj/d(travel)
        e, g = _mobilised(fma(rim, a, travel * z), rate)
        e2, g2 = _mobilised(fma(rim, a2, travel * z2), rate)
        a, a2, z, z2 = g * a, g2 * a2, g * z, g2 * z2
        # the two nodes share weight and stress
        ec, es, e = fma(e, c, e2 * c2), fma(e, s, e2 * s2), e + e2
        ac, as_, a = fma(a, c, a2 * c2), fma(a, s, a2 * s2), a + a2
        zc, zs, z = fma(z, c, z2 * c2), fma(z, s, z2 * s2), z + z2
        p_cos, p_sin = fma(wp, c + c2, p_cos), fma(wp, s + s2, p_sin)
        pe_cos, pe_sin, pe = fma(wp, ec, pe_cos), fma(wp, es, pe_sin), fma(wp, e, pe)
        e_cos, e_sin, e_sum = fma(w, ec, e_cos), fma(w, es, e_sin), fma(w, e, e_sum)
        ape_cos, ape_sin, ape = fma(wp, ac, ape_cos), fma(wp, as_, ape_sin), fma(wp, a, ape)
        ae_cos, ae_sin, ae = fma(w, ac, ae_cos), fma(w, as_, ae_sin), fma(w, a, ae)
        zpe_cos, zpe_sin, zpe = fma(wp, zc, zpe_cos), fma(wp, zs, zpe_sin), fma(wp, z, zpe)
        ze_cos, ze_sin, ze = fma(w, zc, ze_cos), fma(w, zs, ze_sin), fma(w, z, ze)
    h = half
    return (
        ArcIntegrals(h * p_cos, h * p_sin, h * pe_cos, h * pe_sin, h * pe, h * e_cos, h * e_sin, h * e_sum),
        ArcRates(h * ape_cos, h * ape_sin, h * ape, h * ae_cos, h * ae_sin, h * ae),
        ArcRates(h * zpe_cos, h * zpe_sin, h * zpe, h * ze_cos, h * ze_sin, h * ze),
    )
