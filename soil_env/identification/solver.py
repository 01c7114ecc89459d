"""Compiled core of the identification: weighted least squares for the soil under measured points.

Unknowns are x = (phi, ln K, ln S, c, ln g): friction angle [rad], shear deformation modulus [m], sinkage coefficient,
cohesion [Pa] and the gain of digging over the nominal one. The first three are identified; the last two are nuisance
unknowns of the online identifier, which the points tell little of and whose priors carry the doubt about them into the
other three. Elsewhere only the first three are free.

Points are taken eight at a time in lanes, but for the paper's Simpson rule and its Eq. (12). The iteration is
Gauss-Newton with the damping of Levenberg and Marquardt.
"""

from __future__ import annotations

import enum
import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, root
from soil_env._numba.elementary import exp, half_sin_cos, log
from soil_env._numba.lanes import COUNT, fill, first, from_array, lane, made_of, scratch, to_array, totals
from soil_env._numba.rows import rows
from soil_env.identification.point import Points, Reading, channels, channels_at, dot, weights, whitened
from soil_env.terramechanics.contact import (
    JANOSI,
    NODE_COLUMNS,
    ArcFrame,
    Nodes,
    motion_from_slip,
    shear_integrals_by_modulus,
    smooth_arc,
    store_nodes,
)


class Status(enum.IntEnum):
    """Outcome of an identification."""

    NO_DATA = 0  # fewer measured values than unknowns
    CONVERGED = 1
    NOT_EXCITED = 2  # the points do not tell the unknowns apart; an online estimate is then the last good one
    AT_BOUND = 3  # the solution lies on a bound
    DIVERGED = 4  # no convergence within the allowed iterations
    AMBIGUOUS = 5  # converged, but another soil explains the three measured values as exactly


#: Unknowns; the soil's come first.
SIZE, SOIL = 5, 3
COHESION, GAIN = 3, 4
#: Bounds of the unknowns: of (phi, ln K, ln S) the box of the paper's Table 4, widened.
LOWEST = np.array([math.radians(1.0), math.log(2e-4), math.log(1e3), 0.0, -3.0])
HIGHEST = np.array([math.radians(89.5), math.log(0.3) - 1e-9, math.log(1e13) - 1e-9, 2e5, 3.0])
LOWER, UPPER = LOWEST[:SOIL], HIGHEST[:SOIL]
_FARTHEST = np.array([0.35, 1.5, 1.5, 2e5, 2.0])  # in one iteration
_MAX_DAMPINGS = 12
_RIDGE = 1e-12  # of the trace of the normal matrix

# --- points, eight at a time ------------------------------------------------------------------------------------------

#: What does not depend on the unknowns, of points in blocks of eight: how `contact.store_nodes` leaves their arcs.
Prepared = rows("Prepared", "travel", *ArcFrame._fields)


class Workspace(NamedTuple):
    """Memory of the iteration for so many points."""

    prepared: Prepared
    nodes: Nodes


def workspace(points: int) -> Workspace:
    """A `Workspace` for so many points."""
    blocks = -(-points // COUNT)
    return Workspace(Prepared(blocks * COUNT), Nodes(blocks * NODE_COLUMNS))


@inlined
def prepare(points, start, count, reading, work):
    """Fill the `Workspace` for the points start .. start + count - 1 of `Points`; `start` a multiple of eight."""
    for i in range(0, count, COUNT):
        real, p = count - i, start + i
        # in the place of points beyond the last: half-sunk, for nothing but a number
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

    misfit: tuple
    phi: tuple
    K: tuple
    S: tuple
    c: tuple
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
_systems, _vectors = scratch(2 * SYSTEM), scratch(4 * SIZE)


@inlined
def _place(i, j):
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
            system[at + _place(i, j)] += dot(columns[i], columns[j])
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
def _normal(add, x, points, start, count, prior, precision, reading, work, system, at):
    """Normal equations at x [SIZE] into system[at] .. system[at + SYSTEM - 1]; the cost. `add`: `in_blocks` or so."""
    for i in range(SYSTEM):
        system[at + i] = 0.0
    cost = add(x, points, start, count, reading, work, system, at)
    for i in range(SIZE):
        away = prior[i] - x[i]
        system[at + i] += precision[i] * away
        system[at + _place(i, i)] += precision[i]
        cost += precision[i] * away * away
    return cost


@inlined
def _factorise(system, at, damping, held):
    """Lower triangle of J^T J, its diagonal damped, to L and 1/D of L D L^T in place; False unless positive definite.

    held[i] > 0 takes unknown i out.
    """
    for i in range(SIZE):
        row = at + _place(i, 0)
        diagonal = 1.0 if held[i] > 0.0 else system[at + _place(i, i)]
        pivot = diagonal * (1.0 + damping)
        for j in range(i):
            element = 0.0 if held[i] > 0.0 or held[j] > 0.0 else system[row + j]
            for k in range(j):
                element -= system[row + k] * system[at + _place(j, k)]
            system[row + j] = element  # L_ij D_j
        for j in range(i):
            element = system[row + j] * system[at + _place(j, j)]
            pivot -= element * system[row + j]
            system[row + j] = element
        if not pivot > 1e-13 * diagonal:
            return False
        system[row + i] = 1.0 / pivot
    return True


@inlined
def _substitute(system, at, out):
    """Solve L D L^T x = out [SIZE] in place."""
    for i in range(SIZE):
        for j in range(i):
            out[i] -= system[at + _place(i, j)] * out[j]
    for i in range(SIZE - 1, -1, -1):
        out[i] *= system[at + _place(i, i)]
        for j in range(i + 1, SIZE):
            out[i] -= system[at + _place(j, i)] * out[j]


@inlined
def _invert(system, out, column):
    """Inverse of the matrix that `_factorise` left in `system`, into `out` [N, N], N <= SIZE."""
    for i in range(out.shape[0]):
        for j in range(SIZE):
            column[j] = 1.0 if i == j else 0.0
        _substitute(system, 0, column)
        for j in range(out.shape[0]):
            out[i, j] = column[j]


# --- the iteration ----------------------------------------------------------------------------------------------------


@inlined
def _small(step, tolerance):
    return abs(step[0]) < tolerance and abs(step[1]) < tolerance and abs(step[2]) < tolerance


@inlined
def _copy(source, target):
    for i in range(SIZE):
        target[i] = source[i]


@inlined
def _damped_step(x, systems, damping, free, vectors):
    """The damped step from x into vectors[0] .., and where it leads into vectors[2 SIZE] ..; False if singular.

    Of the unknowns the first `free` are, but those that press against a bound. A step is shortened to the longest
    allowed and cut to the bounds.
    """
    held, trial = SIZE, 2 * SIZE
    for i in range(SYSTEM):
        systems[SYSTEM + i] = systems[i]
    if free == SOIL:  # no prior keeps the matrix regular
        trace = systems[_place(0, 0)] + systems[_place(1, 1)] + systems[_place(2, 2)]
        for i in range(SOIL):
            systems[SYSTEM + _place(i, i)] += _RIDGE * trace
    for i in range(SIZE):
        v = systems[i]
        pressed = i >= free or (x[i] <= LOWEST[i] and v < 0.0) or (x[i] >= HIGHEST[i] and v > 0.0)
        vectors[held + i] = 1.0 if pressed else 0.0
        vectors[i] = 0.0 if pressed else v
    if not _factorise(systems, SYSTEM, damping, vectors[held:trial]):
        return False
    _substitute(systems, SYSTEM, vectors)
    share = 1.0
    for i in range(free):
        if abs(vectors[i]) * share > _FARTHEST[i]:
            share = _FARTHEST[i] / abs(vectors[i])
    for i in range(SIZE):
        cut = min(max(x[i] + share * vectors[i], LOWEST[i]), HIGHEST[i])
        vectors[trial + i] = cut if i < free else x[i]
    return True


@inlined
def _finish(x, systems, vectors, status, free, covariance):
    """The covariance of the first unknowns, as it was if singular; the `Status`."""
    held = SIZE
    for i in range(SIZE):
        vectors[held + i] = 0.0 if i < free else 1.0
    if not _factorise(systems, 0, 0.0, vectors[held : 2 * SIZE]):
        return Status.NOT_EXCITED.value
    _invert(systems, covariance, vectors[3 * SIZE :])
    if status == Status.CONVERGED.value:
        for i in range(SOIL):
            if x[i] <= LOWEST[i] or x[i] >= HIGHEST[i]:
                status = Status.AT_BOUND.value
    return status


@inlined
def least_squares(
    add, x, points, start, count, prior, precision, reading, free, max_iterations, tolerance, covariance, work
):
    """Weighted least squares for x [SIZE] in place, from its present value; (`Status`, iterations, cost).

    Minimises |W (measured - predicted)|^2 + (x - prior)^T diag(precision) (x - prior) over the first `free` unknowns.
    Each iteration solves the normal equations with Levenberg-Marquardt damping; the damping rises until the cost
    falls. Converged means that the undamped next step of the soil is shorter than `tolerance` in every unknown.
    `covariance` is left as the inverse of the undamped normal matrix. `add`: `in_blocks`, after `prepare`, or
    `by_the_paper`.
    """
    systems, vectors = _systems(), _vectors()  # present and factors; step, held, trial, column
    trial = vectors[2 * SIZE : 3 * SIZE]
    cost = _normal(add, x, points, start, count, prior, precision, reading, work, systems, 0)
    damping, iterations, new, small = 0.0, 0, 0.0, False
    status = Status.DIVERGED.value
    while iterations < max_iterations and status == Status.DIVERGED.value:
        iterations += 1
        accepted = False
        for _ in range(_MAX_DAMPINGS):
            if _damped_step(x, systems, damping, free, vectors):
                small = _small(vectors, tolerance)
                if damping == 0.0 and small:  # so close the cost may no longer tell
                    _copy(trial, x)
                    status = Status.CONVERGED.value
                    break
                new = _normal(add, trial, points, start, count, prior, precision, reading, work, systems, SYSTEM)
                if new <= cost:
                    accepted = True
                    break
            damping = max(4.0 * damping, 1e-3)
        if not accepted:
            break
        cost = new
        _copy(trial, x)
        for i in range(SYSTEM):
            systems[i] = systems[SYSTEM + i]
        damping = 0.0 if damping < 1e-2 else damping / 8.0
    if status == Status.DIVERGED.value and small:
        status = Status.CONVERGED.value
    return _finish(x, systems, vectors, status, free, covariance), iterations, cost


# --- called from Python -----------------------------------------------------------------------------------------------


@root
def _solve_points(x, points, count, prior, precision, reading, max_iterations, tolerance, covariance, work):
    """`least_squares` of the soil alone; `work` as `workspace` makes it."""
    if reading.simpson > 0 or reading.paper_resistance:
        return least_squares(
            by_the_paper, x, points, 0, count, prior, precision, reading, SOIL, max_iterations, tolerance, covariance,
            work,
        )  # fmt: skip
    prepare(points, 0, count, reading, work)
    return least_squares(
        in_blocks, x, points, 0, count, prior, precision, reading, SOIL, max_iterations, tolerance, covariance, work
    )


def solve(
    start: np.ndarray,
    points: Points,
    prior: np.ndarray,
    precision: np.ndarray,
    reading: Reading,
    max_iterations: int,
    tolerance: float,
    covariance: np.ndarray,
) -> tuple[int, int, float]:
    """`least_squares` of (phi, ln K, ln S) for all `points`: x = `start` [3] in place; (`Status`, iterations, cost).

    `prior`, `precision` [3]; cohesion is that of the `reading`. `covariance` [3, 3] is left as zeros where the points
    do not determine the soil.
    """
    x = np.array([*start, reading.cohesion, 0.0])
    more = [reading.cohesion, 0.0]
    covariance[:] = 0.0
    found = _solve_points(
        x, points, len(points), np.array([*prior, *more]), np.array([*precision, 0.0, 0.0]), reading, max_iterations,
        tolerance, covariance, workspace(len(points)),
    )  # fmt: skip
    start[:] = x[:SOIL]
    return found


@root
def _normal_points(x, points, count, prior, precision, reading, system, work):
    if reading.simpson > 0 or reading.paper_resistance:
        return _normal(by_the_paper, x, points, 0, count, prior, precision, reading, work, system, 0)
    prepare(points, 0, count, reading, work)
    return _normal(in_blocks, x, points, 0, count, prior, precision, reading, work, system, 0)


def normal_equations(x, points: Points, prior, precision, reading: Reading) -> tuple[float, np.ndarray, np.ndarray]:
    """(cost, matrix J^T J + diag(precision) [3, 3], vector J^T residual [3]) at x [3], whitened."""
    system = np.zeros(SYSTEM)
    cost = _normal_points(
        np.array([*x, reading.cohesion, 0.0]), points, len(points), np.array([*prior, reading.cohesion, 0.0]),
        np.array([*precision, 0.0, 0.0]), reading, system, workspace(len(points)),
    )  # fmt: skip
    matrix = np.zeros((SOIL, SOIL))
    for i in range(SOIL):
        for j in range(i + 1):
            matrix[i, j] = matrix[j, i] = system[SIZE + i * (i + 1) // 2 + j]
    return cost, matrix, system[:SOIL].copy()
