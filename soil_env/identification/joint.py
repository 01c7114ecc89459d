"""Least squares for a window of eight points in which cohesion and the gain of digging are unknown too.

Unknowns are x = (phi, ln K, ln S, c, ln g): c [Pa] and g, the gain of digging over the nominal one, are nuisance
unknowns, which the points tell little of and whose priors carry the doubt about them into the other three.
"""

from __future__ import annotations

import numpy as np

from soil_env._numba.compiling import inlined
from soil_env._numba.elementary import exp, exp_lanes, log_lanes
from soil_env._numba.lanes import fill, from_array, lane, scratch, totals
from soil_env.identification.solver import DIG, LONGEST, LOWER, RESPONSE, UPPER, Status, dot, whitened_block

#: Unknowns.
SIZE = 5
COHESION, GAIN = 3, 4
_LOWEST = np.append(LOWER, [0.0, -3.0])
_HIGHEST = np.append(UPPER, [2e5, 3.0])
_FARTHEST = np.append(LONGEST, [2e5, 2.0])  # in one iteration
_MAX_DAMPINGS = 12

# A system of normal equations: the vector J^T residual, then the lower triangle of J^T J row by row; with the prior
_TRIANGLE = SIZE
SYSTEM = SIZE + SIZE * (SIZE + 1) // 2
_two_systems, _two_vectors = scratch(2 * SYSTEM), scratch(4 * SIZE)


@inlined
def _place(i, j):
    """Of the matrix element in row i and column j <= i."""
    return _TRIANGLE + i * (i + 1) // 2 + j


@inlined
def by_gain(exponent, response, ratio):
    """d ln S_effective / d ln g, of S_effective = S ratio^-n with ratio = R0 + response, response = g R1."""
    return -exponent * (response / ratio)


@inlined
def _normal(x, prior, precision, reading, work, system, at):
    """Normal equations at x [SIZE] into system[at] .. system[at + SYSTEM - 1]; the cost."""
    gain = lane(exp(fill(x[GAIN])), 0)
    response = gain * from_array(work, RESPONSE)
    ratio = from_array(work, DIG) + response
    u, a, b, s, c = whitened_block(x, exp_lanes(-reading.exponent * log_lanes(ratio)), x[COHESION], work, 0, reading)
    dug = by_gain(reading.exponent, response, ratio)
    su, sa, sb, ss, sc = dot(s, u), dot(s, a), dot(s, b), dot(s, s), dot(s, c)
    first = totals(dot(a, u), dot(b, u), su, dot(c, u), dug * su, dot(a, a), dot(b, a), dot(b, b))
    second = totals(sa, sb, ss, dot(c, a), dot(c, b), sc, dot(c, c), dug * sa)
    third = totals(dug * sb, dug * ss, dug * sc, dug * (dug * ss), dot(u, u), dug, dug, dug)
    for i in range(8):
        system[at + i] = first[i]
        system[at + 8 + i] = second[i]
    for i in range(4):
        system[at + 16 + i] = third[i]
    cost = third[4]
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
        row, diagonal = at + _place(i, 0), system[at + _place(i, i)]
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
    """Inverse of the matrix that `_factorise` left in `system`, into `out` [SIZE, SIZE]."""
    for i in range(SIZE):
        for j in range(SIZE):
            column[j] = 1.0 if i == j else 0.0
        _substitute(system, 0, column)
        for j in range(SIZE):
            out[i, j] = column[j]


@inlined
def solve_joint(x, prior, precision, reading, max_iterations, tolerance, covariance, work):
    """Least squares for x [SIZE] in place, of the one block that `solver.prepare` left in `work`; the `Status`.

    As `solver.solve`, but for the two further unknowns. `covariance` [SIZE, SIZE] is left as the inverse of the normal
    matrix, and as it was if that is singular.
    """
    systems, vectors = _two_systems(), _two_vectors()  # present and factors; step, held, trial, column
    held, trial, column = SIZE, 2 * SIZE, 3 * SIZE
    cost = _normal(x, prior, precision, reading, work, systems, 0)
    damping, iterations = 0.0, 0
    status = Status.DIVERGED.value
    small = False
    while iterations < max_iterations and status == Status.DIVERGED.value:
        iterations += 1
        accepted = False
        for _ in range(_MAX_DAMPINGS):
            for i in range(SYSTEM):
                systems[SYSTEM + i] = systems[i]
            for i in range(SIZE):
                v = systems[i]
                pressed = (x[i] <= _LOWEST[i] and v < 0.0) or (x[i] >= _HIGHEST[i] and v > 0.0)
                vectors[held + i] = 1.0 if pressed else 0.0
                vectors[i] = 0.0 if pressed else v
            if _factorise(systems, SYSTEM, damping, vectors[held:trial]):
                _substitute(systems, SYSTEM, vectors)
                share = 1.0
                for i in range(SIZE):
                    if abs(vectors[i]) * share > _FARTHEST[i]:
                        share = _FARTHEST[i] / abs(vectors[i])
                for i in range(SIZE):
                    vectors[trial + i] = min(max(x[i] + share * vectors[i], _LOWEST[i]), _HIGHEST[i])
                small = abs(vectors[0]) < tolerance and abs(vectors[1]) < tolerance and abs(vectors[2]) < tolerance
                if damping == 0.0 and small:  # so close the cost may no longer tell
                    for i in range(SIZE):
                        x[i] = vectors[trial + i]
                    status = Status.CONVERGED.value
                    break
                new = _normal(vectors[trial:column], prior, precision, reading, work, systems, SYSTEM)
                if new <= cost:
                    accepted = True
                    break
            damping = max(4.0 * damping, 1e-3)
        if not accepted:
            break
        cost = new
        for i in range(SIZE):
            x[i] = vectors[trial + i]
        for i in range(SYSTEM):
            systems[i] = systems[SYSTEM + i]
        damping = 0.0 if damping < 1e-2 else damping / 8.0
    if status == Status.DIVERGED.value and small:
        status = Status.CONVERGED.value
    for i in range(SIZE):
        vectors[held + i] = 0.0
    if not _factorise(systems, 0, 0.0, vectors[held:trial]):
        return Status.NOT_EXCITED.value
    _invert(systems, covariance, vectors[column:])
    if status == Status.CONVERGED.value:
        for i in range(3):
            if x[i] <= _LOWEST[i] or x[i] >= _HIGHEST[i]:
                status = Status.AT_BOUND.value
    return status
