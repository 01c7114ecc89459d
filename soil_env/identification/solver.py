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

import numpy as np
from numpy.typing import ArrayLike

from soil_env._numba.compiling import inlined, root
from soil_env._numba.lanes import scratch
from soil_env._numba.rows import Rows
from soil_env.identification.normal_equations import (
    SIZE,
    SOIL,
    SYSTEM,
    by_the_paper,
    in_blocks,
    normal_system,
    place,
    prepare,
    workspace,
)
from soil_env.identification.point import Reading


class Status(enum.IntEnum):
    """Outcome of an identification."""

    NO_DATA = 0  # fewer measured values than unknowns
    CONVERGED = 1
    NOT_EXCITED = 2  # the points do not tell the unknowns apart; online: phi or ln K hardly narrower than the prior
    AT_BOUND = 3  # the solution lies on a bound
    DIVERGED = 4  # no convergence within the allowed iterations
    AMBIGUOUS = 5  # converged, but another soil explains the three measured values as exactly
    MISFIT = 6  # online: the last readings are further from their prediction than their errors explain


#: Bounds of the unknowns: of (phi, ln K, ln S) the box of the paper's Table 4, widened.
LOWEST = np.array([math.radians(1.0), math.log(2e-4), math.log(1e3), 0.0, -3.0])
HIGHEST = np.array([math.radians(89.5), math.log(0.3) - 1e-9, math.log(1e13) - 1e-9, 2e5, 3.0])
LOWER, UPPER = LOWEST[:SOIL], HIGHEST[:SOIL]
_FARTHEST = np.array([0.35, 1.5, 1.5, 2e5, 2.0])  # in one iteration
_MAX_DAMPINGS = 12
_RIDGE = 1e-12  # of the trace of the normal matrix

_systems, _vectors = scratch(2 * SYSTEM), scratch(4 * SIZE)


# --- linear equations -------------------------------------------------------------------------------------------------


@inlined
def _factorise(system, at, damping, held):
    """Lower triangle of J^T J, its diagonal damped, to L and 1/D of L D L^T in place; False unless positive definite.

    held[i] > 0 takes unknown i out.
    """
    for i in range(SIZE):
        row = at + place(i, 0)
        diagonal = 1.0 if held[i] > 0.0 else system[at + place(i, i)]
        pivot = diagonal * (1.0 + damping)
        for j in range(i):
            element = 0.0 if held[i] > 0.0 or held[j] > 0.0 else system[row + j]
            for k in range(j):
                element -= system[row + k] * system[at + place(j, k)]
            system[row + j] = element  # L_ij D_j
        for j in range(i):
            element = system[row + j] * system[at + place(j, j)]
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
            out[i] -= system[at + place(i, j)] * out[j]
    for i in range(SIZE - 1, -1, -1):
        out[i] *= system[at + place(i, i)]
        for j in range(i + 1, SIZE):
            out[i] -= system[at + place(j, i)] * out[j]


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
        trace = systems[place(0, 0)] + systems[place(1, 1)] + systems[place(2, 2)]
        for i in range(SOIL):
            systems[SYSTEM + place(i, i)] += _RIDGE * trace
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
    cost = normal_system(add, x, points, start, count, prior, precision, reading, work, systems, 0)
    damping, iterations, new, small = 0.0, 0, 0.0, False
    status = Status.DIVERGED.value
    while iterations < max_iterations and status == Status.DIVERGED.value:
        iterations += 1
        accepted = False
        for _ in range(_MAX_DAMPINGS):
            if _damped_step(x, systems, damping, free, vectors):
                small = _small(vectors, tolerance)
                if damping == 0.0 and small:  # near the solution, rounding hides the decrease of the cost
                    _copy(trial, x)
                    status = Status.CONVERGED.value
                    break
                new = normal_system(add, trial, points, start, count, prior, precision, reading, work, systems, SYSTEM)
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
    points: Rows,
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
        return normal_system(by_the_paper, x, points, 0, count, prior, precision, reading, work, system, 0)
    prepare(points, 0, count, reading, work)
    return normal_system(in_blocks, x, points, 0, count, prior, precision, reading, work, system, 0)


def normal_equations(
    x: ArrayLike, points: Rows, prior: ArrayLike, precision: ArrayLike, reading: Reading
) -> tuple[float, np.ndarray, np.ndarray]:
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
