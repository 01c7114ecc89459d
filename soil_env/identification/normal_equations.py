"""Normal equations of measured points: what they say of the unknowns, linearised.

Unknowns are x = (phi, ln K, ln S, c, ln g): friction angle [rad], shear deformation modulus [m], sinkage coefficient,
cohesion [Pa] and the gain of digging over the nominal one. Points are taken eight at a time in lanes, but for the
paper's Simpson rule and its Eq. (12).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from soil_env._numba.compiling import inlined
from soil_env._numba.elementary import exp, half_sin_cos, log
from soil_env._numba.lanes import COUNT, fill, first, from_array, lane, made_of, to_array, totals
from soil_env._numba.rows import Rows, rows
from soil_env.identification.point import channels, channels_at, dot, weights, whitened
from soil_env.slip import motion_from_slip
from soil_env.terramechanics.arc_integrals import (
    NODE_COLUMNS,
    ArcFrame,
    Nodes,
    shear_integrals_by_modulus,
    store_nodes,
)
from soil_env.terramechanics.contact import (
    JANOSI,
    smooth_arc,
)

#: Unknowns; the soil's come first.
SIZE, SOIL = 5, 3
COHESION, GAIN = 3, 4

# --- points, eight at a time ------------------------------------------------------------------------------------------

#: What does not depend on the unknowns, of points in blocks of eight: as `arc_integrals.store_nodes` leaves their arcs.
Prepared: type[Rows] = rows("Prepared", "travel", *ArcFrame._fields)


class Workspace(NamedTuple):
    """Memory of the iteration for so many points."""

    prepared: Rows  # Prepared
    nodes: Rows  # Nodes


def workspace(points: int) -> Workspace:
    """A `Workspace` for so many points."""
    blocks = -(-points // COUNT)
    return Workspace(Prepared(blocks * COUNT), Nodes(blocks * NODE_COLUMNS))


@inlined
def prepare(points, start, count, reading, work):
    """Fill the `Workspace` for the points start .. start + count - 1 of `Points`; `start` a multiple of eight."""
    for i in range(0, count, COUNT):
        real, p = count - i, start + i
        # beyond the last point a half-sunk wheel fills the lanes: any finite number will do, without weight
        sinkage = first(real, from_array(points.sinkage, p), fill(0.5 * reading.radius))
        _, travel = motion_from_slip(first(real, from_array(points.slip, p), fill(0.0)))
        arc = smooth_arc(sinkage, reading.radius)
        frame = store_nodes(arc, reading.exponent, work.nodes, (i // COUNT) * NODE_COLUMNS)
        to_array(travel, work.prepared.travel, i)
        to_array(frame.theta1, work.prepared.theta1, i)
        to_array(frame.front, work.prepared.front, i)
        to_array(frame.ratio, work.prepared.ratio, i)
        to_array(frame.lever_front, work.prepared.lever_front, i)
        to_array(frame.lever_rear, work.prepared.lever_rear, i)
        to_array(frame.lever_sin, work.prepared.lever_sin, i)
        to_array(frame.p_cos, work.prepared.p_cos, i)
        to_array(frame.p_sin, work.prepared.p_sin, i)


@inlined
def integrals_at(work, i, K, reading):
    """(ArcIntegrals, ArcRates by K) of the eight prepared points from column i on."""
    a = work.prepared
    frame = ArcFrame(
        from_array(a.theta1, i), from_array(a.front, i), from_array(a.ratio, i), from_array(a.lever_front, i),
        from_array(a.lever_rear, i), from_array(a.lever_sin, i), from_array(a.p_cos, i), from_array(a.p_sin, i),
    )  # fmt: skip
    at, one = (i // COUNT) * NODE_COLUMNS, fill(1.0)
    return shear_integrals_by_modulus(frame, work.nodes, at, one, from_array(a.travel, i), K, reading.radius, JANOSI)


@inlined
def _soil_of(x):
    """(tan phi, K, S, g) of unknowns x within the bounds."""
    sin_half, cos_half = half_sin_cos(fill(x[0]))
    sin_half, cos_half = lane(sin_half, 0), lane(cos_half, 0)
    moduli = exp(made_of(x[1], x[2], x[GAIN], x[1], x[2], x[GAIN], x[1], x[2]))
    tan_phi = 2.0 * sin_half * cos_half / (1.0 - 2.0 * sin_half * sin_half)
    return tan_phi, lane(moduli, 0), lane(moduli, 1), lane(moduli, 2)


class Whitened(NamedTuple):
    """Of points: the misfit and its derivatives by the unknowns, each of three channels, whitened."""

    misfit: tuple[Any, ...]
    phi: tuple[Any, ...]
    K: tuple[Any, ...]
    S: tuple[Any, ...]
    c: tuple[Any, ...]
    by_gain: float  # d ln S_effective / d ln g: the derivative by the gain is this share of that by ln S


@inlined
def gain_share(exponent, response, ratio):
    """d ln S_effective / d ln g, of S_effective = S ratio^-n with ratio = R0 + response, response = g R1."""
    return -exponent * (response / ratio)


@inlined
def _block(x, points, p, real, reading, work, i):
    """`Whitened` of eight prepared points, in lanes; those beyond the first `real` have no weight."""
    tan_phi, K, S, g = _soil_of(x)
    one, none = fill(1.0), fill(0.0)
    response = g * first(real, from_array(points.dig_response, p), none)
    ratio = first(real, from_array(points.dig_ratio, p), one) + response
    q, k = integrals_at(work, i, K, reading)
    S = S * exp(-reading.exponent * log(ratio))
    y = channels(q, k, S, tan_phi, K, x[COHESION], reading.radius, reading.width, -1.0)
    w = (
        first(real, from_array(points.w00, p), none), first(real, from_array(points.w10, p), none),
        first(real, from_array(points.w11, p), none), first(real, from_array(points.w20, p), none),
        first(real, from_array(points.w21, p), none), first(real, from_array(points.w22, p), none),
    )  # fmt: skip
    pull = first(real, from_array(points.drawbar_pull, p), none)
    load, torque = first(real, from_array(points.load, p), none), first(real, from_array(points.torque, p), none)
    return Whitened(
        whitened(w, (pull - y.pull, load - y.load, torque - y.torque)),
        whitened(w, y.by_phi), whitened(w, y.by_K), whitened(w, y.by_S), whitened(w, y.by_c),
        gain_share(reading.exponent, response, ratio),
    )  # fmt: skip


@inlined
def _by_the_paper(x, points, p, reading):
    """`Whitened` of one point with what the source paper computes its pull by: Simpson's rule, Eq. (12)."""
    y, _ = channels_at(x, points.slip[p], points.sinkage[p], points.dig_ratio[p], reading)
    w = weights(points, p)
    misfit = (points.drawbar_pull[p] - y.pull, points.load[p] - y.load, points.torque[p] - y.torque)
    return Whitened(
        whitened(w, misfit), whitened(w, y.by_phi), whitened(w, y.by_K), whitened(w, y.by_S), whitened(w, y.by_c), 0.0
    )


# --- normal equations -------------------------------------------------------------------------------------------------

# A system: the vector J^T residual [SIZE], then the lower triangle of J^T J row by row, both with the prior.
SYSTEM = SIZE + SIZE * (SIZE + 1) // 2


@inlined
def place(i, j):
    """Of the matrix element in row i and column j <= i."""
    return SIZE + i * (i + 1) // 2 + j


@inlined
def _add_block(system, at, u):
    """Add `Whitened` points in lanes to a system; their sum of squares."""
    a, b, s, c, g = u.phi, u.K, u.S, u.c, u.by_gain
    su, sa, sb, ss, sc = dot(s, u.misfit), dot(s, a), dot(s, b), dot(s, s), dot(s, c)
    one = totals(dot(a, u.misfit), dot(b, u.misfit), su, dot(c, u.misfit), g * su, dot(a, a), dot(b, a), dot(b, b))
    two = totals(sa, sb, ss, dot(c, a), dot(c, b), sc, dot(c, c), g * sa)
    three = totals(g * sb, g * ss, g * sc, g * (g * ss), dot(u.misfit, u.misfit), g, g, g)
    for i in range(8):
        system[at + i] += one[i]
        system[at + 8 + i] += two[i]
    for i in range(4):
        system[at + 16 + i] += three[i]
    return three[4]


@inlined
def _add_point(system, at, u):
    """Add one `Whitened` point, of which only the soil is unknown, to a system; its sum of squares."""
    columns = (u.phi, u.K, u.S)
    for i in range(SOIL):
        system[at + i] += dot(columns[i], u.misfit)
        for j in range(i + 1):
            system[at + place(i, j)] += dot(columns[i], columns[j])
    return dot(u.misfit, u.misfit)


@inlined
def in_blocks(x, points, start, count, reading, work, system, at):
    """The points' share of a system, eight at a time; their sum of squares."""
    cost = 0.0
    for i in range(0, count, COUNT):
        cost += _add_block(system, at, _block(x, points, start + i, count - i, reading, work, i))
    return cost


@inlined
def by_the_paper(x, points, start, count, reading, work, system, at):
    """The points' share of a system, one by one, as the source paper computes them; their sum of squares."""
    cost = 0.0
    for p in range(start, start + count):
        cost += _add_point(system, at, _by_the_paper(x, points, p, reading))
    return cost


@inlined
def normal_system(add, x, points, start, count, prior, precision, reading, work, system, at):
    """Normal equations at x [SIZE] into system[at] .. system[at + SYSTEM - 1]; the cost. `add`: `in_blocks` or so."""
    for i in range(SYSTEM):
        system[at + i] = 0.0
    cost = add(x, points, start, count, reading, work, system, at)
    for i in range(SIZE):
        away = prior[i] - x[i]
        system[at + i] += precision[i] * away
        system[at + place(i, i)] += precision[i]
        cost += precision[i] * away * away
    return cost
