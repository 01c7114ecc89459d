"""Predicted readings and bearing sinkage of a point, with their derivatives by the state of the filter.

State, each a value a lane: (t, ln K, q, c, n, ln g, z, m, i): strength mobilised at one slip, over the normal stress; K
the shear deformation modulus [m]; q the ln of the sinkage coefficient, compared at one depth; cohesion [Pa]; exponent;
gain of digging over the nominal one; sinkage [m]; mass on the wheel [kg]; slip. With the shear displacement J and the
normal stress P of a `Reference`,

    t = (tan phi + c/P) (1 - exp(-J/K)),

which is what readings at that slip tell at once. By phi, K and c they tell it along a curved ridge, on which a filter
would take the change of its own linearisation for knowledge. The load is m g cos(pitch), so the sinkage coefficient s
that it mobilises at the sinkage follows from Eq. (1), and drawbar pull and torque from s: they do not depend on q,
which shows in how the sinkage changes only (`effects.excavation_rate`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from soil_env._numba.compiling import inlined
from soil_env._numba.elementary import exp, half_sin_cos, larger, log
from soil_env._numba.lanes import COUNT, fill, from_array, to_array
from soil_env._numba.rows import Rows, rows, scratch_rows
from soil_env.slip import motion_from_slip, travel_rate
from soil_env.terramechanics.arc_integrals import (
    NODE_COLUMNS,
    Nodes,
    shear_modulus_rates,
    smooth_integrals,
    store_nodes,
)
from soil_env.terramechanics.contact import (
    JANOSI,
    Forces,
    forces,
    janosi_hanamoto,
    mobilised_sinkage_coefficient,
    shear_forces,
    smooth_arc,
)

STATES = 9
STRENGTH, LN_K, Q, COHESION, EXPONENT, GAIN, SINKAGE, MASS, SLIP = range(STATES)
LN_DEPTH = math.log(0.03)  # sinkage [m] at which the sinkage coefficients of different exponents are compared
_LEAST_RISE = 1e-3  # lower bound of sin(entry angle), by which is divided: no contact, or a buried wheel

#: Predictions, then their derivatives; eight columns a state.
Linearised: type[Rows] = rows("Linearised", "pull", "torque", "ln_bearing")
COLUMNS = (STATES + 1) * COUNT  # the value itself is in the last block
_nodes = scratch_rows(Nodes, NODE_COLUMNS)


class Reference(NamedTuple):
    """Where the strength mobilised is compared."""

    displacement: float  # J [m]
    stress: float  # P [Pa]


class Friction(NamedTuple):
    """tan(phi) with its derivatives by t, ln K and c."""

    tangent: float
    by_strength: float
    by_ln_K: float
    by_cohesion: float


@inlined
def mobilised_share(ln_K, reference):
    """(1 - exp(-J/K), its derivative by ln K)."""
    ratio = reference.displacement * exp(-1.0 * ln_K)
    share, rest = janosi_hanamoto(ratio)
    return share, -1.0 * ratio * rest


@inlined
def friction(strength, ln_K, cohesion, reference):
    """`Friction` of the states; tan(phi) at least 0.01."""
    share, rate = mobilised_share(ln_K, reference)
    all_ = strength / share
    return Friction(
        larger(all_ - cohesion * (1.0 / reference.stress), 0.01), 1.0 / share, -1.0 * all_ * rate / share,
        fill(-1.0 / reference.stress),
    )  # fmt: skip


@inlined
def _loaded(q, load, tan_phi, c, r, b):
    """(s, drawbar pull, torque) where Eq. (1) carries `load`."""
    s = larger(mobilised_sinkage_coefficient(q, load, tan_phi, c, r, b, 1.0), 1.0)
    f = forces(q, s, tan_phi, c, r, b, 1.0)
    return s, f.drawbar_pull, f.torque


@inlined
def _store(out, state, pull, torque, ln_bearing):
    to_array(pull, out.pull, state * COUNT)
    to_array(torque, out.torque, state * COUNT)
    to_array(ln_bearing, out.ln_bearing, state * COUNT)


@inlined
def _by(out, state, partial, of_s, s, n, of_depth):
    """Store the derivative by a state from the `Forces` that it changes at a given s, which the load then moves;
    `of_depth`: of ln(bearing sinkage) at a given s."""
    ds = -partial.load / of_s.load
    pull, torque = partial.drawbar_pull + ds * of_s.drawbar_pull, partial.torque + ds * of_s.torque
    _store(out, state, pull, torque, ds / (s * n) + of_depth)


@inlined
def _scaled(f, share):
    return Forces(share * f.load, share * f.drawbar_pull, share * f.torque)


@inlined
def _sum(f, g):
    return Forces(f.load + g.load, f.drawbar_pull + g.drawbar_pull, f.torque + g.torque)


@inlined
def linearise(x, cos_pitch, reference, numbers, out):
    """Fill `Linearised` at the states x [STATES x COUNT]; `numbers`: `FilterNumbers`."""
    r, b, nodes = numbers.radius, numbers.width, _nodes()
    c, n = from_array(x, COHESION * COUNT), from_array(x, EXPONENT * COUNT)
    z, slip = from_array(x, SINKAGE * COUNT), from_array(x, SLIP * COUNT)
    ln_K = from_array(x, LN_K * COUNT)
    phi, K = friction(from_array(x, STRENGTH * COUNT), ln_K, c, reference), exp(ln_K)
    tan_phi, force = phi.tangent, numbers.gravity * cos_pitch
    load = force * from_array(x, MASS * COUNT)
    rim, travel = motion_from_slip(slip)
    arc = smooth_arc(z, r)
    frame = store_nodes(arc, n, nodes, 0)
    q, by_rim, by_travel, by_angle, by_n = smooth_integrals(frame, nodes, rim, travel, K, n, r, JANOSI)
    s, pull, torque = _loaded(q, load, tan_phi, c, r, b)
    none = 0.0 * c
    of_s = forces(q, none + 1.0, tan_phi, none, r, b, 1.0)
    st, by_K = s * tan_phi, shear_modulus_rates(by_rim, by_travel, rim, travel, K)
    rate = travel_rate(travel)
    _by(out, STRENGTH, shear_forces(q, s * phi.by_strength, none, r, b, 1.0), of_s, s, n, none)
    through_phi = shear_forces(q, s * phi.by_ln_K, none, r, b, 1.0)
    directly = shear_forces(by_K, st * K, c * K, r, b, 1.0)
    _by(out, LN_K, _sum(directly, through_phi), of_s, s, n, none)
    _by(out, COHESION, shear_forces(q, s * phi.by_cohesion, none + 1.0, r, b, 1.0), of_s, s, n, none)
    _by(out, SLIP, shear_forces(by_travel, rate * st, rate * c, r, b, 1.0), of_s, s, n, none)
    by_load = force / of_s.load
    _store(out, MASS, by_load * of_s.drawbar_pull, by_load * of_s.torque, by_load / (s * n))
    ln_S = from_array(x, Q * COUNT) - (n - numbers.exponent) * LN_DEPTH
    ln_ratio = log(s) - ln_S
    _store(out, Q, none, none, -1.0 / n)
    _store(out, GAIN, none, none, none)
    sin_half, cos_half = half_sin_cos(arc.theta1)
    rise = 1.0 / larger((2.0 * r) * sin_half * cos_half, _LEAST_RISE * r)  # d theta1/dz of z = r (1 - cos theta1)
    by_z = _scaled(forces(by_angle, s, tan_phi, c, r, b, 1.0), rise)
    _by(out, SINKAGE, by_z, of_s, s, n, 1.0 / z)
    _by(out, EXPONENT, forces(by_n, s, tan_phi, none, r, b, 1.0), of_s, s, n, (LN_DEPTH - ln_ratio / n) / n)
    _store(out, STATES, pull, torque, log(z) + ln_ratio / n)
