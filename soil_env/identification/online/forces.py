"""Drawbar pull, torque and mobilised sinkage coefficient at a measured slip and sinkage: Eqs.
(1)-(3) of the source paper with (1) solved for S, and their derivatives
(docs/physics/estimation.md, "Forces").
"""

import math
from typing import NamedTuple

from soil_env._compiled.elementary import log
from soil_env._compiled.flags import compiled, compiled_sums, record
from soil_env.terramechanics.contact import (
    ARC_NODES,
    FRONT_AHEAD,
    NODES,
    NODES_PER_ZONE,
    REAR_AHEAD,
    bearing_share,
    braked_shift,
    carried_share,
    forces,
    grown_modulus,
    held_below,
    lay_nodes,
    mobilised_sinkage_coefficient,
    most_by_angle,
    most_carried,
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
    rim_flow: float  # these are known, as in `Soil`
    braked_peak: float
    shear_growth: float
    shear_length: float  # [m]


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


class _Motion(NamedTuple):
    """Motion of the sheared soil, and what the share of soil carried along the rim adds."""

    rim: float
    travel: float
    rim_tan_phi: float  # d rim/d tan(phi)
    rim_angle: float  # [1/rad] d rim/d theta1
    rim_travel: float  # d rim/d travel
    modulus: float  # [m] K at this length of contact
    growth: float  # d ln K/d ln theta1


class _Sums(NamedTuple):
    """Derivatives by one quantity at a given S: of the integrals of p and of tau."""

    p_cos: float
    p_sin: float
    cos: float
    sin: float
    one: float


@compiled_sums
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


@compiled
def _motion_of(ground, arc, travel):
    """`_Motion` on `Ground` at a travel speed over that of the rim."""
    free, _, free_travel = carried_share(1.0, travel, 0.0)
    carry = ground.rim_flow * ground.tan_phi
    most = most_carried(arc)
    share, by_share, by_most = held_below(carry * free, most)
    return _Motion(
        1.0 + share * travel,
        travel,
        travel * by_share * ground.rim_flow * free,
        travel * by_most * most_by_angle(arc),
        share + travel * by_share * carry * free_travel,
        grown_modulus(math.exp(ground.ln_K), ground, arc),
        ground.shear_growth,
    )


@compiled_sums
def _sum_slopes(work, theta1, motion, st, c, r):
    """`_Sums` by exponent, ln K, entry angle, travel and tan(phi) through the soil carried along
    the rim, with tau = (st p + c) e.
    """
    nodes = work.arc[0]
    K = motion.modulus
    travel = motion.travel
    cos1 = math.cos(theta1)
    per_angle = 1.0 / theta1
    n_pc = n_ps = n_c = n_s = n_1 = 0.0
    k_c = k_s = k_1 = 0.0
    a_pc = a_ps = a_c = a_s = a_1 = 0.0
    t_c = t_s = t_1 = 0.0
    f_c = f_s = f_1 = 0.0
    for k in range(NODES):
        cos = nodes.cos[k]
        sin = nodes.sin[k]
        p = nodes.stress[k]
        j = motion.rim * nodes.by_rim[k] + travel * nodes.by_travel[k]
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
        moved = (motion.rim * per_angle + motion.rim_angle) * nodes.by_rim[k]
        moved += travel * r * (share * cos - cos1)
        ta = (st * pa + c * nodes.weight[k] * per_angle) * e + change * moved
        ta += tk * motion.growth * per_angle
        a_pc += pa * cos - p * share * sin
        a_ps += pa * sin + p * share * cos
        a_c += ta * cos - strength * e * share * sin
        a_s += ta * sin + strength * e * share * cos
        a_1 += ta
        tf = change * nodes.by_rim[k]
        tt = change * nodes.by_travel[k] + motion.rim_travel * tf
        t_c += tt * cos
        t_s += tt * sin
        t_1 += tt
        tf *= motion.rim_tan_phi
        f_c += tf * cos
        f_s += tf * sin
        f_1 += tf
    return (
        _Sums(n_pc, n_ps, n_c, n_s, n_1),
        _Sums(0.0, 0.0, k_c, k_s, k_1),
        _Sums(a_pc, a_ps, a_c, a_s, a_1),
        _Sums(0.0, 0.0, t_c, t_s, t_1),
        _Sums(0.0, 0.0, f_c, f_s, f_1),
    )


@compiled_sums
def _sum_shifted(work, arc, motion, st, c, exponent):
    """`_Sums` by the angle of the stress peak, with which the nodes of both zones move."""
    nodes = work.arc[0]
    r = arc.radius
    cos1 = math.cos(arc.theta1)
    in_front = -1.0 / (arc.theta1 - arc.thetam)
    behind = 1.0 / (arc.thetam - arc.theta2)
    p_c = p_s = s_c = s_s = s_1 = 0.0
    for k in range(NODES):
        cos = nodes.cos[k]
        sin = nodes.sin[k]
        p = nodes.stress[k]
        j = motion.rim * nodes.by_rim[k] + motion.travel * nodes.by_travel[k]
        e = math.copysign(1.0 - motion.modulus * nodes.rate[k], j)
        partner = k % NODES_PER_ZONE  # in front, with the same normal stress
        moves = FRONT_AHEAD[k] - REAR_AHEAD[k]
        wider = in_front if k < NODES_PER_ZONE else behind
        below = max(nodes.cos[partner] - cos1, SHALLOWEST)
        pm = p * (wider - exponent * nodes.sin[partner] * FRONT_AHEAD[partner] / below)
        strength = st * p + c * nodes.weight[k]
        tm = (st * pm + c * nodes.weight[k] * wider) * e
        tm += strength * nodes.rate[k] * moves * r * (motion.travel * cos - motion.rim)
        p_c += pm * cos - p * sin * moves
        p_s += pm * sin + p * cos * moves
        s_c += tm * cos - strength * e * sin * moves
        s_s += tm * sin + strength * e * cos * moves
        s_1 += tm
    return _Sums(p_c, p_s, s_c, s_s, s_1)


@compiled
def _at_the_load(d, S, by_S, factor):
    """Derivatives of (pull, torque, ln S) by a quantity, S keeping the load; `factor` times them.

    d: `_Sums` for r b = 1; by_S: derivatives of (load, pull, torque) by S.
    """
    rb = factor * by_S[3]
    S_by = -rb * (S * d.p_cos + d.sin) / by_S[0]
    pull = rb * (d.cos - S * d.p_sin) + S_by * by_S[1]
    return pull, rb * by_S[4] * d.one + S_by * by_S[2], S_by / S


@compiled
def reaction(work, ground, sinkage, slip, load, r, b):
    """`Reaction` of a wheel of radius r and width b [m] under a `load` [N] on `Ground`.

    `work`: `SLOPE_NODES`; `sinkage` [m]; `slip` [-] above -1.
    """
    nodes = work.arc[0]
    t = ground.tan_phi
    c = ground.cohesion
    travel = 1.0 - slip if slip >= 0.0 else 1.0 / (1.0 + slip)
    braked = max(-slip, 0.0)
    arc = smooth_arc(sinkage, r, braked_shift(braked, ground))
    motion = _motion_of(ground, arc, travel)
    p = lay_nodes(nodes, arc, ground.exponent)
    q = shear_integrals(nodes, p, (motion.rim, travel), motion.modulus, None, False)
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
    n, k, a, v, f_t = _sum_slopes(work, arc.theta1, motion, S * t, c, r)
    per_sinkage = 1.0 / (r * max(math.sin(arc.theta1), LEAST_SINE))
    per_slip = -1.0 if slip >= 0.0 else -travel * travel
    t_cos = S * q.pe_cos + f_t.cos
    by_t = _at_the_load(
        _Sums(0.0, 0.0, t_cos, S * q.pe_sin + f_t.sin, S * q.pe + f_t.one), S, by_S, 1.0
    )
    by_c = _at_the_load(_Sums(0.0, 0.0, q.e_cos, q.e_sin, q.e), S, by_S, 1.0)
    by_n = _at_the_load(n, S, by_S, 1.0)
    by_k = _at_the_load(k, S, by_S, 1.0)
    by_z = _at_the_load(a, S, by_S, per_sinkage)
    by_i = _at_the_load(v, S, by_S, per_slip)
    if braked > 0.0 and ground.braked_peak > 0.0:
        shifted = _sum_shifted(work, arc, motion, S * t, c, ground.exponent)
        per_shift = -ground.braked_peak / (1.0 + braked) ** 2 * arc.theta1
        by_m = _at_the_load(shifted, S, by_S, per_shift)
        by_i = by_i[0] + by_m[0], by_i[1] + by_m[1], by_i[2] + by_m[2]
    return Reaction(
        Slopes(f.drawbar_pull, by_t[0], by_c[0], by_n[0], by_k[0], by_z[0], by_i[0]),
        Slopes(f.torque, by_t[1], by_c[1], by_n[1], by_k[1], by_z[1], by_i[1]),
        Slopes(math.log(S), by_t[2], by_c[2], by_n[2], by_k[2], by_z[2], by_i[2]),
    )
