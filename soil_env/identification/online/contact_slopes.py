"""Drawbar pull, torque and mobilised sinkage coefficient at a slip and a sinkage, with their
derivatives by the soil.

At a given sinkage the known load mobilises the sinkage coefficient s
(`contact.mobilised_sinkage_coefficient`), from which pull and torque follow. They do not depend on
the sinkage coefficient S of the soil: only the change of the sinkage shows it (`sinkage_filter`).
"""

from typing import NamedTuple

from soil_env.identification.online.lanes.compiling import compiled_inline
from soil_env.identification.online.lanes.contact import (
    NODE_COLUMNS,
    Nodes,
    forces,
    mobilised_sinkage_coefficient,
    motion_from_slip,
    shear_forces,
    shear_modulus_rates,
    smooth_arc,
    smooth_integrals,
    store_nodes,
    travel_rate,
)
from soil_env.identification.online.lanes.elementary import exp, half_sin_cos, larger, log
from soil_env.identification.online.lanes.rows import scratch_rows

# lower bound of sin(entry angle), by which is divided: no contact, or a buried wheel
_LEAST_RISE = 1e-3
_nodes = scratch_rows(Nodes, NODE_COLUMNS)


class GroundSoil(NamedTuple):
    """The soil under the wheel as the forces show it; a value a lane."""

    tangent: float  # of the friction angle
    cohesion: float  # [Pa]
    exponent: float  # n
    ln_K: float  # K the shear deformation modulus [m]


class Slopes(NamedTuple):
    """A quantity and its derivatives."""

    value: float
    by_tangent: float
    by_cohesion: float
    by_exponent: float
    by_ln_K: float
    by_sinkage: float
    by_slip: float


class Reaction(NamedTuple):
    """Forces of the ground on the wheel."""

    pull: Slopes  # [N]
    torque: Slopes  # [N m]
    ln_s: Slopes  # ln of the mobilised sinkage coefficient


@compiled_inline
def _slope(partial, of_s, s):
    """(d pull, d torque, d ln s) from the `Forces` that change at a given s, which the load then
    moves.
    """
    ds = -partial.load / of_s.load
    return partial.drawbar_pull + ds * of_s.drawbar_pull, partial.torque + ds * of_s.torque, ds / s


@compiled_inline
def reaction(soil, sinkage, slip, load, r, b):
    """`Reaction` of eight soils at sinkages [m] and slips under a load [N]; wheel of radius r and
    width b [m].
    """
    c = soil.cohesion
    n = soil.exponent
    tan_phi = soil.tangent
    K = exp(soil.ln_K)
    nodes = _nodes()
    rim, travel = motion_from_slip(slip)
    arc = smooth_arc(sinkage, r)
    frame = store_nodes(arc, n, nodes, 0)
    q, by_rim, by_travel, by_angle, by_n = smooth_integrals(frame, nodes, rim, travel, K, n, r)
    s = larger(mobilised_sinkage_coefficient(q, load, tan_phi, c, r, b), 1.0)
    f = forces(q, s, tan_phi, c, r, b)
    none = 0.0 * c
    of_s = forces(q, none + 1.0, tan_phi, none, r, b)
    st = s * tan_phi
    rate = travel_rate(travel)
    by_K = shear_modulus_rates(by_rim, by_travel, rim, travel, K)
    tangent = _slope(shear_forces(q, s, none, r, b), of_s, s)
    cohesion = _slope(shear_forces(q, none, none + 1.0, r, b), of_s, s)
    exponent = _slope(forces(by_n, s, tan_phi, none, r, b), of_s, s)
    ln_K = _slope(shear_forces(by_K, st * K, c * K, r, b), of_s, s)
    sin_half, cos_half = half_sin_cos(arc.theta1)
    # d theta1/dz of z = r (1 - cos theta1)
    rise = 1.0 / larger((2.0 * r) * sin_half * cos_half, _LEAST_RISE * r)
    angle = _slope(forces(by_angle, s, tan_phi, c, r, b), of_s, s)
    slipping = _slope(shear_forces(by_travel, rate * st, rate * c, r, b), of_s, s)
    return Reaction(
        Slopes(
            f.drawbar_pull,
            tangent[0],
            cohesion[0],
            exponent[0],
            ln_K[0],
            rise * angle[0],
            slipping[0],
        ),
        Slopes(
            f.torque, tangent[1], cohesion[1], exponent[1], ln_K[1], rise * angle[1], slipping[1]
        ),
        Slopes(log(s), tangent[2], cohesion[2], exponent[2], ln_K[2], rise * angle[2], slipping[2]),
    )
