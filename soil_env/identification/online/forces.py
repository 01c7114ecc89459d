"""Drawbar pull, torque and mobilised sinkage coefficient at a measured slip and sinkage: Eqs.
(1)-(3) of the source paper with (1) solved for S, and their derivatives
(docs/physics/estimation.md, "Forces").
"""

import math
from typing import NamedTuple

import numpy as np

from soil_env._compiled.elementary import half_cos, half_sin, log
from soil_env._compiled.flags import compiled, compiled_sums, record
from soil_env.slip import motion_from_slip
from soil_env.terramechanics.contact import (
    ARC_NODES,
    FRONT_AHEAD,
    NODES,
    NODES_PER_ZONE,
    REAR_AHEAD,
    Arc,
    Forces,
    ShearRates,
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
    shear_rates,
    smooth_arc,
)

# [N/m^(n+2)] least mobilised S, whose logarithm is taken, own choice: where cohesion alone carries
# the load, the balance would need S <= 0
LEAST_COEFFICIENT = 1.0
LEAST_SINE = 1e-3  # [-] sine of the entry angle that a derivative is divided by, own choice
# [radii] least depth of a node below the entry point, whose logarithm is taken, own choice
SHALLOWEST = 1e-9
FORWARD = 1.0  # sign of the travel speed

#: Results of `reaction`: pull [N], torque [N m], ln of the mobilised sinkage coefficient.
PULL, TORQUE, LN_S = range(3)


class Ground(NamedTuple):
    """Soil as the forces depend on it at a given sinkage.

    The fields before `rim_flow` are unknowns of the identifier; the others, of the shear law beyond
    Eq. (10), are constants that it takes for known.
    """

    tan_phi: float
    cohesion: float  # [Pa]
    exponent: float  # n of the pressure S z^n
    ln_K: float  # ln of K [m]
    rim_flow: float  # this and those below as in `Soil`
    braked_peak: float
    shear_growth: float
    shear_length: float  # [m]


#: Columns of the derivatives of the results of `reaction`: by the unknown fields of `Ground`, then
#: by sinkage and slip.
OF_GROUND = Ground._fields.index("rim_flow")
TANGENT, COHESION, EXPONENT, LN_K = range(OF_GROUND)
BY_SINKAGE, BY_SLIP = range(OF_GROUND, OF_GROUND + 2)

# [-] length of the front zone between the entry and the node in front with the same stress
PEER_AHEAD = np.tile(FRONT_AHEAD[:NODES_PER_ZONE], 2)

#: Scratch: the nodes of an arc, and results and derivatives of the last `reaction`.
CONTACT = record(
    "sin1",  # of the entry angle
    "cos1",
    arc=(ARC_NODES, 1),
    peer_sin=("f8", NODES),  # of the node in front with the same stress, Eq. (8)
    per_depth=("f8", NODES),  # n over its depth below the entry point [1/radii]
    ln_depth=("f8", NODES),  # of m
    value=("f8", 3),
    by=("f8", (3, BY_SLIP + 1)),
)


@compiled_sums
def _lay_depths(contact, theta1, exponent, r):
    """Write `sin1` and `cos1` of the entry angle `theta1` [rad] into a `CONTACT`, and of each node
    what derivatives of its normal stress need: `peer_sin`, `per_depth` and `ln_depth`.

    They follow from its depth below the entry point, at least `SHALLOWEST`; r [m]: radius. A node
    of the rear zone has the stress of a node in front (Eq. (8)), and so the depth of that.
    """
    nodes = contact.arc[0]
    sine = half_sin(theta1)
    contact.sin1 = 2.0 * sine * half_cos(theta1)
    contact.cos1 = 1.0 - 2.0 * sine * sine
    for k in range(NODES):
        peer = k % NODES_PER_ZONE
        depth = max(2.0 * (sine * sine - nodes.rise[peer]), SHALLOWEST)
        contact.peer_sin[k] = nodes.sin[peer]
        contact.per_depth[k] = exponent / depth
        contact.ln_depth[k] = log(r * depth)


class _Sums(NamedTuple):
    """Derivatives of integrals over the arc by one quantity, at a given S: of the normal stress p
    for S = 1, and of the shear stress tau.
    """

    p_cos: float  # of Int p cos
    p_sin: float  # of Int p sin
    cos: float  # of Int tau cos
    sin: float  # of Int tau sin
    one: float  # of Int tau, from which the torque follows


class _State(NamedTuple):
    """What the derivatives by all quantities have in common."""

    S: float  # [N/m^(n+2)] that carries the load
    b: float  # [m] width
    arc: Arc
    rim: float  # [of r w] of the motion in `contact`: 1, and more by soil carried along the rim
    travel: float  # [of r w] of that motion: the travel speed
    modulus: float  # [m] K at this length of contact
    by_S: Forces  # derivatives of the forces by S
    rates: ShearRates  # derivatives of the integrals of tau by the motion


@compiled_sums
def _sums_by(contact, ground, state, by_entry, by_peak, by_exponent):
    """`_Sums` by a quantity on which entry angle, angle of the stress peak and exponent depend;
    `by_entry`, `by_peak` and `by_exponent` are their derivatives by it.

    The nodes move with the arc, and their weights grow with the lengths of its zones. Changes of a
    node in the loop: `moved` of its angle [rad], `sunk` of its depth below the entry point [radii],
    `slid` of its shear displacement [m], and `wider` of its weight, relative.
    """
    nodes = contact.arc[0]
    arc = state.arc
    r = arc.radius
    st = state.S * ground.tan_phi
    c = ground.cohesion
    front = by_entry - by_peak  # change of the length of the front zone; of the rear one: by_peak
    wider_front = front / (arc.theta1 - arc.thetam)
    wider_rear = by_peak / arc.thetam
    sin1 = contact.sin1 * by_entry
    cos1 = contact.cos1 * by_entry
    p_cos = p_sin = tau_cos = tau_sin = tau = 0.0
    for k in range(NODES):
        cos = nodes.cos[k]
        sin = nodes.sin[k]
        p = nodes.stress[k]
        weight = nodes.weight[k]
        wider = wider_front if k < NODES_PER_ZONE else wider_rear
        moved = by_entry - front * FRONT_AHEAD[k] - by_peak * REAR_AHEAD[k]
        sunk = sin1 - contact.peer_sin[k] * (by_entry - front * PEER_AHEAD[k])
        stress = p * (wider + sunk * contact.per_depth[k] + by_exponent * contact.ln_depth[k])
        j = state.rim * nodes.by_rim[k] + state.travel * nodes.by_travel[k]
        # mobilised share of the shear strength, from its slope by j: Eq. (10)
        e = math.copysign(1.0 - state.modulus * nodes.rate[k], j)
        strength = st * p + c * weight
        slid = r * (state.rim * (by_entry - moved) - state.travel * (cos1 - cos * moved))
        shear = (st * stress + c * weight * wider) * e + strength * nodes.rate[k] * slid
        p_cos += stress * cos - p * sin * moved
        p_sin += stress * sin + p * cos * moved
        tau_cos += shear * cos - strength * e * sin * moved
        tau_sin += shear * sin + strength * e * cos * moved
        tau += shear
    return _Sums(p_cos, p_sin, tau_cos, tau_sin, tau)


@compiled
def _derive(contact, i, sums, rim_change, travel_change, state):
    """Write the derivatives of pull, torque and ln S by quantity i into `contact.by`, while S
    changes so that the load stays.

    `sums`: by the quantity at a given S; `rim_change`, `travel_change`: derivatives by it of the
    motion (`_State.rim`, `_State.travel`).
    """
    S = state.S
    rates = state.rates
    by_S = state.by_S
    rb = state.arc.radius * state.b
    tau_cos = sums.cos + rim_change * rates.cos_rim + travel_change * rates.cos_travel
    tau_sin = sums.sin + rim_change * rates.sin_rim + travel_change * rates.sin_travel
    tau = sums.one + rim_change * rates.one_rim + travel_change * rates.one_travel
    stiffer = -rb * (S * sums.p_cos + tau_sin) / by_S.load
    contact.by[PULL, i] = rb * (tau_cos - S * sums.p_sin) + stiffer * by_S.drawbar_pull
    contact.by[TORQUE, i] = state.arc.radius * rb * tau + stiffer * by_S.torque
    contact.by[LN_S, i] = stiffer / S


@compiled
def reaction(contact, ground, sinkage, slip, load, r, b):
    """Write pull [N], torque [N m] and ln S into `value` of a `CONTACT`, and their derivatives into
    `by`.

    The derivatives are by the unknowns of the ground, by sinkage and by slip, each while the load
    stays what it is. The wheel has radius r and width b [m], and stands under a `load` [N] on a
    `Ground`, at a `sinkage` [m] and a `slip` [-] above -1. S is the one that carries the load at
    this sinkage, at least `LEAST_COEFFICIENT`.
    """
    nodes = contact.arc[0]
    t = ground.tan_phi
    travel = motion_from_slip(slip)[1]
    braked = max(-slip, 0.0)
    shift = braked_shift(braked, ground)
    arc = smooth_arc(sinkage, r, shift)
    # soil carried along the rim: its share for rim_flow tan(phi) = 1, then the share of this ground
    free, _, free_by_travel = carried_share(1.0, travel, 0.0)
    carry = ground.rim_flow * t
    share, by_share, by_most = held_below(carry * free, most_carried(arc))
    rim = 1.0 + share * travel
    K = grown_modulus(math.exp(ground.ln_K), ground, arc)
    p = lay_nodes(nodes, arc, ground.exponent)
    q = shear_integrals(nodes, p, (rim, travel), K, None, False)
    S = mobilised_sinkage_coefficient(q, load, t, ground.cohesion, r, b, FORWARD)
    S = max(S, LEAST_COEFFICIENT)
    f = forces(q, S, t, ground.cohesion, r, b, FORWARD)
    contact.value[PULL] = f.drawbar_pull
    contact.value[TORQUE] = f.torque
    contact.value[LN_S] = math.log(S)
    _lay_depths(contact, arc.theta1, ground.exponent, r)
    by_S = forces(q, 1.0, t, 0.0, r, b, FORWARD)  # which are linear in S
    rates = shear_rates(nodes, S * t, ground.cohesion)
    state = _State(S, b, arc, rim, travel, K, by_S, rates)
    none = _Sums(0.0, 0.0, 0.0, 0.0, 0.0)
    # tau = (S p tan phi + c) e is linear in tan phi and c; tan phi also carries soil along the rim
    by_t = _Sums(0.0, 0.0, S * q.pe_cos, S * q.pe_sin, S * q.pe)
    _derive(contact, TANGENT, by_t, travel * by_share * ground.rim_flow * free, 0.0, state)
    _derive(contact, COHESION, _Sums(0.0, 0.0, q.e_cos, q.e_sin, q.e), 0.0, 0.0, state)
    _derive(contact, EXPONENT, _sums_by(contact, ground, state, 0.0, 0.0, 1.0), 0.0, 0.0, state)
    # e depends on j/K: a larger K acts as a motion that is slower by as much
    _derive(contact, LN_K, none, -rim, -travel, state)
    # with sinkage the entry angle grows, on which K and the bound on carried soil depend too
    entry_by_z = 1.0 / (r * max(contact.sin1, LEAST_SINE))
    by_z = _sums_by(contact, ground, state, entry_by_z, (0.5 + shift) * entry_by_z, 0.0)
    growth = ground.shear_growth / arc.theta1 * entry_by_z  # [1/m] of ln K
    rim_by_z = travel * by_most * most_by_angle(arc) * entry_by_z
    _derive(contact, BY_SINKAGE, by_z, rim_by_z - growth * rim, -growth * travel, state)
    # travel is 1 - i driving and 1/(1 + i) braking, where the stress peak moves too
    travel_by_i = -1.0 if slip >= 0.0 else -travel * travel
    by_i = none
    if braked > 0.0 and ground.braked_peak > 0.0:
        peak_by_i = -ground.braked_peak / (1.0 + braked) ** 2 * arc.theta1
        by_i = _sums_by(contact, ground, state, 0.0, peak_by_i, 0.0)
    rim_by_i = (share + travel * by_share * carry * free_by_travel) * travel_by_i
    _derive(contact, BY_SLIP, by_i, rim_by_i, travel_by_i, state)
