"""Drawbar pull, torque and mobilised sinkage coefficient at a measured slip and sinkage: Eqs.
(1)-(3) of the source paper with (1) solved for S, and their derivatives
(docs/physics/estimation.md, "Forces").
"""

import math
from typing import NamedTuple

from numba import njit

from soil_env._compiled.elementary import log
from soil_env._compiled.flags import EXACT, SUMS, record
from soil_env.terramechanics.contact import (
    ARC_NODES,
    NODES,
    NODES_PER_ZONE,
    bearing_share,
    forces,
    lay_nodes,
    mobilised_sinkage_coefficient,
    shear_integrals,
    smooth_arc,
)

LEAST_COEFFICIENT = 1.0  # [N/m^(n+2)] least mobilised S whose logarithm is taken
LEAST_SINE = 1e-3  # [-] of the entry angle that a derivative is divided by
SHALLOWEST = 1e-9  # [radii] depth of a node below the entry point whose logarithm is taken
FORWARD = 1.0  # sign of the travel speed

_PER_NODE = ("f8", NODES)
#: Scratch: the nodes of an arc, and the derivatives of ln p at each.
SLOPE_NODES = record(
    arc=(ARC_NODES, 1),
    by_exponent=_PER_NODE,
    by_angle=_PER_NODE,  # [1/rad] by the entry angle, each node at its share of it
)


class Ground(NamedTuple):
    """Soil as the forces depend on it at a given sinkage."""

    tan_phi: float
    cohesion: float  # [Pa]
    exponent: float
    ln_K: float  # of m


class Slopes(NamedTuple):
    """A quantity with its derivatives."""

    value: float
    tan_phi: float
    cohesion: float
    exponent: float
    ln_K: float
    sinkage: float
    slip: float


class Reaction(NamedTuple):
    """What the ground does to the wheel."""

    pull: Slopes  # [N]
    torque: Slopes  # [N m]
    ln_s: Slopes  # ln of the mobilised sinkage coefficient


class _Sums(NamedTuple):
    """Derivatives by one quantity at a given S: of the integrals of p and of tau."""

    p_cos: float
    p_sin: float
    cos: float
    sin: float
    one: float


@njit(**SUMS)
def _lay_slopes(work, theta1, exponent, r):
    """Derivatives of ln p at the nodes; rear partners have the p of the front, Eq. (8)."""
    nodes = work.arc[0]
    rise1 = 0.5 * (1.0 - math.cos(theta1))
    sin1 = math.sin(theta1)
    for k in range(NODES_PER_ZONE):
        below = max(2.0 * (rise1 - nodes.rise[k]), SHALLOWEST)
        share = 1.0 - nodes.by_rim[k] / (r * theta1)
        by_exponent = log(r * below)
        by_angle = exponent * (sin1 - share * nodes.sin[k]) / below
        work.by_exponent[k] = by_exponent
        work.by_exponent[k + NODES_PER_ZONE] = by_exponent
        work.by_angle[k] = by_angle
        work.by_angle[k + NODES_PER_ZONE] = by_angle


@njit(**SUMS)
def _sum_slopes(work, theta1, travel, st, c, K, r):
    """`_Sums` by exponent, ln K, entry angle and travel, with tau = (st p + c) e."""
    nodes = work.arc[0]
    cos1 = math.cos(theta1)
    per_angle = 1.0 / theta1
    n_pc = n_ps = n_c = n_s = n_1 = 0.0
    k_c = k_s = k_1 = 0.0
    a_pc = a_ps = a_c = a_s = a_1 = 0.0
    t_c = t_s = t_1 = 0.0
    for k in range(NODES):
        cos = nodes.cos[k]
        sin = nodes.sin[k]
        p = nodes.stress[k]
        j = nodes.by_rim[k] + travel * nodes.by_travel[k]
        e = math.copysign(1.0 - K * nodes.rate[k], j)
        strength = st * p + c * nodes.weight[k]
        change = strength * nodes.rate[k]
        pn = p * work.by_exponent[k]
        tn = st * pn * e
        n_pc += pn * cos
        n_ps += pn * sin
        n_c += tn * cos
        n_s += tn * sin
        n_1 += tn
        tk = -change * j
        k_c += tk * cos
        k_s += tk * sin
        k_1 += tk
        share = 1.0 - nodes.by_rim[k] * per_angle / r
        pa = p * (work.by_angle[k] + per_angle)
        moved = nodes.by_rim[k] * per_angle + travel * r * (share * cos - cos1)
        ta = (st * pa + c * nodes.weight[k] * per_angle) * e + change * moved
        a_pc += pa * cos - p * share * sin
        a_ps += pa * sin + p * share * cos
        a_c += ta * cos - strength * e * share * sin
        a_s += ta * sin + strength * e * share * cos
        a_1 += ta
        tt = change * nodes.by_travel[k]
        t_c += tt * cos
        t_s += tt * sin
        t_1 += tt
    return (
        _Sums(n_pc, n_ps, n_c, n_s, n_1),
        _Sums(0.0, 0.0, k_c, k_s, k_1),
        _Sums(a_pc, a_ps, a_c, a_s, a_1),
        _Sums(0.0, 0.0, t_c, t_s, t_1),
    )


@njit(**EXACT)
def _at_the_load(d, S, by_S, factor):
    """Derivatives of (pull, torque, ln S) by a quantity, S keeping the load; `factor` times them.

    d: `_Sums` for r b = 1; by_S: derivatives of (load, pull, torque) by S.
    """
    rb = factor * by_S[3]
    S_by = -rb * (S * d.p_cos + d.sin) / by_S[0]
    pull = rb * (d.cos - S * d.p_sin) + S_by * by_S[1]
    return pull, rb * by_S[4] * d.one + S_by * by_S[2], S_by / S


@njit(**EXACT)
def reaction(work, ground, sinkage, slip, load, r, b):
    """`Reaction` of a wheel of radius r and width b [m] under a `load` [N] on `Ground`.

    `work`: `SLOPE_NODES`; `sinkage` [m]; `slip` [-] above -1.
    """
    nodes = work.arc[0]
    t = ground.tan_phi
    c = ground.cohesion
    K = math.exp(ground.ln_K)
    travel = 1.0 - slip if slip >= 0.0 else 1.0 / (1.0 + slip)
    arc = smooth_arc(sinkage, r)
    p_cos, p_sin = lay_nodes(nodes, arc, ground.exponent)
    q = shear_integrals(nodes, p_cos, p_sin, (1.0, travel), K, None)
    S = max(mobilised_sinkage_coefficient(q, load, t, c, r, b, FORWARD), LEAST_COEFFICIENT)
    f = forces(q, S, t, c, r, b, FORWARD)
    rb = r * b
    by_S = (
        rb * bearing_share(q, t, FORWARD),
        rb * (t * q.pe_cos - q.p_sin),
        r * rb * t * q.pe,
        rb,
        r,
    )
    _lay_slopes(work, arc.theta1, ground.exponent, r)
    n, k, a, v = _sum_slopes(work, arc.theta1, travel, S * t, c, K, r)
    per_sinkage = 1.0 / (r * max(math.sin(arc.theta1), LEAST_SINE))
    per_slip = -1.0 if slip >= 0.0 else -travel * travel
    by_t = _at_the_load(_Sums(0.0, 0.0, S * q.pe_cos, S * q.pe_sin, S * q.pe), S, by_S, 1.0)
    by_c = _at_the_load(_Sums(0.0, 0.0, q.e_cos, q.e_sin, q.e), S, by_S, 1.0)
    by_n = _at_the_load(n, S, by_S, 1.0)
    by_k = _at_the_load(k, S, by_S, 1.0)
    by_z = _at_the_load(a, S, by_S, per_sinkage)
    by_i = _at_the_load(v, S, by_S, per_slip)
    return Reaction(
        Slopes(f.drawbar_pull, by_t[0], by_c[0], by_n[0], by_k[0], by_z[0], by_i[0]),
        Slopes(f.torque, by_t[1], by_c[1], by_n[1], by_k[1], by_z[1], by_i[1]),
        Slopes(math.log(S), by_t[2], by_c[2], by_n[2], by_k[2], by_z[2], by_i[2]),
    )
