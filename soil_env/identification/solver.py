"""Compiled core of the identification: the normal equations of measured points and the safeguarded iteration.

Unknowns are x = (phi, ln K, ln S). `solve` serves the paper's three points, any larger table and the online window
alike. It takes the points eight at a time in lanes (`prepare`), but for the paper's Simpson rule.
"""

from __future__ import annotations

import enum
import math
from typing import NamedTuple

import numpy as np
from numba import njit

from soil_env._numba.compiling import CACHE, inlined, kernel
from soil_env._numba.elementary import exp, exp_lanes, half_sin_cos, log_lanes, where_below
from soil_env._numba.lanes import COUNT, fill, first, from_array, lane, made_of, to_array, total, totals, transposed
from soil_env.identification.point import (
    DIG_RATIO,
    DIG_RESPONSE,
    DRAWBAR_PULL,
    LOAD,
    POINT_SIZE,
    SINKAGE,
    SLIP,
    TORQUE,
    WEIGHTS,
    channels,
    channels_at,
)
from soil_env.terramechanics.arcs import STORED_NODES, entry_angle_of_many, store_nodes, stored_integrals


class Status(enum.IntEnum):
    """Outcome of an identification."""

    NO_DATA = 0  # fewer measured values than unknowns
    CONVERGED = 1
    NOT_EXCITED = 2  # the points do not tell the unknowns apart; an online estimate is then the last good one
    AT_BOUND = 3  # the solution lies on a bound
    DIVERGED = 4  # no convergence within the allowed iterations
    AMBIGUOUS = 5  # converged, but another soil explains the three measured values as exactly


#: Bounds of (phi [rad], ln K [m], ln S): the box of the paper's Table 4, widened.
LOWER = np.array([math.radians(1.0), math.log(2e-4), math.log(1e3)])
UPPER = np.array([math.radians(89.5), math.log(0.3) - 1e-9, math.log(1e13) - 1e-9])
#: No unknown moves further than this in one iteration.
LONGEST = np.array([0.35, 1.5, 1.5])
_MAX_DAMPINGS = 12


@inlined
def _soil_of(x):
    """(tan phi, K, S) of unknowns x within the bounds."""
    sin_half, cos_half = half_sin_cos(fill(x[0]))
    sin_half, cos_half = lane(sin_half, 0), lane(cos_half, 0)
    moduli = exp_lanes(made_of(x[1], x[2], x[1], x[2], x[1], x[2], x[1], x[2]))
    return 2.0 * sin_half * cos_half / (1.0 - 2.0 * sin_half * sin_half), lane(moduli, 0), lane(moduli, 1)


# Floats of a block of eight points as `prepare` leaves them: nodes, dig ratio and response, factor on S of the ratio,
# channels, weights.
DIG, RESPONSE, _FACTOR, _CHANNELS = (STORED_NODES + i * COUNT for i in range(4))
_WHITE = _CHANNELS + 3 * COUNT
BLOCK = _WHITE + 6 * COUNT


@inlined
def blocks(count):
    """Blocks of eight that hold `count` points."""
    return (count + COUNT - 1) // COUNT


@inlined
def prepare(points, count, reading, work):
    """What does not depend on the unknowns, of `count` > 0 points into `work` [blocks(count) BLOCK]."""
    for block in range(blocks(count)):
        at, start = block * BLOCK, block * COUNT
        p0, p1 = start * POINT_SIZE, min(start + 1, count - 1) * POINT_SIZE  # beyond the last, it again without weight
        p2, p3 = min(start + 2, count - 1) * POINT_SIZE, min(start + 3, count - 1) * POINT_SIZE
        p4, p5 = min(start + 4, count - 1) * POINT_SIZE, min(start + 5, count - 1) * POINT_SIZE
        p6, p7 = min(start + 6, count - 1) * POINT_SIZE, min(start + 7, count - 1) * POINT_SIZE
        a = transposed(
            from_array(points, p0), from_array(points, p1), from_array(points, p2), from_array(points, p3),
            from_array(points, p4), from_array(points, p5), from_array(points, p6), from_array(points, p7),
        )  # fmt: skip
        w = transposed(
            from_array(points, p0 + COUNT), from_array(points, p1 + COUNT), from_array(points, p2 + COUNT),
            from_array(points, p3 + COUNT), from_array(points, p4 + COUNT), from_array(points, p5 + COUNT),
            from_array(points, p6 + COUNT), from_array(points, p7 + COUNT),
        )  # fmt: skip
        slip = a[SLIP]
        one = fill(1.0)
        free = where_below(-slip, 1.0 - 1e-9, 1.0 + slip, fill(1e-9))
        travel = where_below(slip, 0.0, one / free, 1.0 - slip)  # `motion_from_slip`
        store_nodes(entry_angle_of_many(a[SINKAGE], reading.radius), travel, reading.exponent, reading.radius, work, at)
        to_array(a[DIG_RATIO], work, at + DIG)
        to_array(w[DIG_RESPONSE - COUNT], work, at + RESPONSE)
        to_array(exp(-reading.exponent * log_lanes(a[DIG_RATIO])), work, at + _FACTOR)
        to_array(a[DRAWBAR_PULL], work, at + _CHANNELS)
        to_array(a[LOAD], work, at + _CHANNELS + COUNT)
        to_array(a[TORQUE], work, at + _CHANNELS + 2 * COUNT)
        none, real = fill(0.0), count - start
        to_array(first(real, a[WEIGHTS], none), work, at + _WHITE)
        to_array(first(real, a[WEIGHTS + 1], none), work, at + _WHITE + COUNT)
        to_array(first(real, w[WEIGHTS + 2 - COUNT], none), work, at + _WHITE + 2 * COUNT)
        to_array(first(real, w[WEIGHTS + 3 - COUNT], none), work, at + _WHITE + 3 * COUNT)
        to_array(first(real, w[WEIGHTS + 4 - COUNT], none), work, at + _WHITE + 4 * COUNT)
        to_array(first(real, w[WEIGHTS + 5 - COUNT], none), work, at + _WHITE + 5 * COUNT)


class Normal(NamedTuple):
    """Normal equations: cost, J^T residual and the upper triangle of J^T J, all whitened and with the prior."""

    cost: float
    v0: float
    v1: float
    v2: float
    m00: float
    m01: float
    m02: float
    m11: float
    m12: float
    m22: float


@inlined
def whitened(w, a0, a1, a2):
    """Lower triangle w times (a0, a1, a2)."""
    return w[0] * a0, w[1] * a0 + w[2] * a1, w[3] * a0 + w[4] * a1 + w[5] * a2


@inlined
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def whitened_block(x, factor, cohesion, work, at, reading):
    """(misfit, by phi, by ln K, by ln S, by cohesion) of eight prepared points, each whitened, in lanes.

    `factor`, in lanes, is S_effective over S: of the digging ratio.
    """
    tan_phi, K, S = _soil_of(x)
    q, k = stored_integrals(work, at, K)
    y = channels(q, k, S * factor, tan_phi, K, cohesion, reading.radius, reading.width, -1.0)
    i = at + _WHITE
    w = (
        from_array(work, i), from_array(work, i + COUNT), from_array(work, i + 2 * COUNT),
        from_array(work, i + 3 * COUNT), from_array(work, i + 4 * COUNT), from_array(work, i + 5 * COUNT),
    )  # fmt: skip
    i = at + _CHANNELS
    misfit = whitened(
        w,
        from_array(work, i) - y.pull,
        from_array(work, i + COUNT) - y.load,
        from_array(work, i + 2 * COUNT) - y.torque,
    )
    return (
        misfit,
        whitened(w, y.by_phi[0], y.by_phi[1], y.by_phi[2]),
        whitened(w, y.by_K[0], y.by_K[1], y.by_K[2]),
        whitened(w, y.by_S[0], y.by_S[1], y.by_S[2]),
        whitened(w, y.by_c[0], y.by_c[1], y.by_c[2]),
    )


@inlined
def _normal(x, points, count, prior, precision, reading, work):
    """`Normal` at unknowns x, of prepared points."""
    d0, d1, d2 = prior[0] - x[0], prior[1] - x[1], prior[2] - x[2]
    v0, v1, v2 = precision[0] * d0, precision[1] * d1, precision[2] * d2
    cost = v0 * d0 + v1 * d1 + v2 * d2
    m00, m11, m22 = precision[0], precision[1], precision[2]
    m01 = m02 = m12 = 0.0
    if reading.simpson > 0 or reading.paper_resistance:
        for p in range(count):
            row = points[p]
            y, _ = channels_at(x, row[SLIP], row[SINKAGE], row[DIG_RATIO], reading)
            w = (
                row[WEIGHTS], row[WEIGHTS + 1], row[WEIGHTS + 2], row[WEIGHTS + 3], row[WEIGHTS + 4], row[WEIGHTS + 5]
            )  # fmt: skip
            u = whitened(w, row[DRAWBAR_PULL] - y.pull, row[LOAD] - y.load, row[TORQUE] - y.torque)
            a = whitened(w, y.by_phi[0], y.by_phi[1], y.by_phi[2])
            b = whitened(w, y.by_K[0], y.by_K[1], y.by_K[2])
            c = whitened(w, y.by_S[0], y.by_S[1], y.by_S[2])
            cost += dot(u, u)
            v0, v1, v2 = v0 + dot(a, u), v1 + dot(b, u), v2 + dot(c, u)
            m00, m01, m02 = m00 + dot(a, a), m01 + dot(a, b), m02 + dot(a, c)
            m11, m12, m22 = m11 + dot(b, b), m12 + dot(b, c), m22 + dot(c, c)
    else:
        for block in range(blocks(count)):
            factor = from_array(work, block * BLOCK + _FACTOR)
            u, a, b, c, _ = whitened_block(x, factor, reading.cohesion, work, block * BLOCK, reading)
            s = totals(dot(u, u), dot(a, u), dot(b, u), dot(c, u), dot(a, a), dot(a, b), dot(a, c), dot(b, b))
            cost += s[0]
            v0, v1, v2 = v0 + s[1], v1 + s[2], v2 + s[3]
            m00, m01, m02 = m00 + s[4], m01 + s[5], m02 + s[6]
            m11, m12, m22 = m11 + s[7], m12 + total(dot(b, c)), m22 + total(dot(c, c))
    return Normal(cost, v0, v1, v2, m00, m01, m02, m11, m12, m22)


@njit(cache=CACHE)
def normal_equations(x, points, count, prior, precision, reading, matrix, vector):
    """Sum of squared whitened residuals; fills `matrix` (J^T J + prior precision) and `vector` (J^T residual)."""
    work = np.empty(blocks(count) * BLOCK)
    prepare(points, count, reading, work)
    m = _normal(x, points, count, prior, precision, reading, work)
    vector[0], vector[1], vector[2] = m.v0, m.v1, m.v2
    matrix[0, 0], matrix[1, 1], matrix[2, 2] = m.m00, m.m11, m.m22
    matrix[0, 1], matrix[0, 2], matrix[1, 2] = m.m01, m.m02, m.m12
    matrix[1, 0], matrix[2, 0], matrix[2, 1] = m.m01, m.m02, m.m12
    return m.cost


@inlined
def _inverse(m00, m01, m02, m11, m12, m22):
    """(found, upper triangle of the inverse) of a symmetric 3 x 3 matrix; found unless singular."""
    c00 = m11 * m22 - m12 * m12
    c01 = m02 * m12 - m01 * m22
    c02 = m01 * m12 - m02 * m11
    det = m00 * c00 + m01 * c01 + m02 * c02
    d = 1.0 / det
    inverse = (
        c00 * d, c01 * d, c02 * d, (m00 * m22 - m02 * m02) * d, (m02 * m01 - m00 * m12) * d, (m00 * m11 - m01 * m01) * d
    )  # fmt: skip
    return det > 1e-14 * abs(m00 * m11 * m22), inverse


@kernel
def invert3(m, out):
    """Inverse of a symmetric 3 x 3 matrix into `out`; False if it is singular to working precision."""
    found, i = _inverse(m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2])
    if found:
        out[0, 0], out[0, 1], out[0, 2], out[1, 1], out[1, 2], out[2, 2] = i
        out[1, 0], out[2, 0], out[2, 1] = i[1], i[2], i[4]
    return found


@inlined
def _pressed(x, v, i):
    """True where unknown i presses against its bound."""
    return (x <= LOWER[i] and v < 0.0) or (x >= UPPER[i] and v > 0.0)


@inlined
def _damped_step(x, m, damping):
    """(found, Levenberg-Marquardt step from x); not found if the damped normal matrix is singular.

    An unknown that presses against its bound stays there.
    """
    ridge = 1e-12 * (m.m00 + m.m11 + m.m22)
    p0, p1, p2 = _pressed(x[0], m.v0, 0), _pressed(x[1], m.v1, 1), _pressed(x[2], m.v2, 2)
    m01 = 0.0 if p0 or p1 else m.m01
    m02 = 0.0 if p0 or p2 else m.m02
    m12 = 0.0 if p1 or p2 else m.m12
    scale = 1.0 + damping
    found, i = _inverse(m.m00 * scale + ridge, m01, m02, m.m11 * scale + ridge, m12, m.m22 * scale + ridge)
    if not found:
        return False, (0.0, 0.0, 0.0)
    return True, (
        0.0 if p0 else i[0] * m.v0 + i[1] * m.v1 + i[2] * m.v2,
        0.0 if p1 else i[1] * m.v0 + i[3] * m.v1 + i[4] * m.v2,
        0.0 if p2 else i[2] * m.v0 + i[4] * m.v1 + i[5] * m.v2,
    )


@inlined
def _small(step, tolerance):
    return abs(step[0]) < tolerance and abs(step[1]) < tolerance and abs(step[2]) < tolerance


@inlined
def _moved(x, step):
    """x + step, shortened to the longest step allowed and cut to the bounds."""
    share = 1.0
    for i in range(3):
        if abs(step[i]) * share > LONGEST[i]:
            share = LONGEST[i] / abs(step[i])
    return (
        min(max(x[0] + share * step[0], LOWER[0]), UPPER[0]),
        min(max(x[1] + share * step[1], LOWER[1]), UPPER[1]),
        min(max(x[2] + share * step[2], LOWER[2]), UPPER[2]),
    )


@njit(cache=CACHE)
def solve(start, points, count, prior, precision, reading, max_iterations, tolerance, covariance):
    """Weighted least squares for x = `start` [3] in place, from its present value; (Status, iterations, cost).

    Minimises |W (measured - predicted)|^2 + (x - prior)^T diag(precision) (x - prior). Each iteration solves the normal
    equations with Levenberg-Marquardt damping; the damping rises until the cost falls, and a step across a bound is
    cut back to it. Converged means that the undamped next step is shorter than `tolerance` in every unknown.
    `covariance` [3, 3] is left as the inverse of the undamped normal matrix (zeros if that is singular).
    """
    work = np.empty(blocks(count) * BLOCK)
    prepare(points, count, reading, work)
    x = (start[0], start[1], start[2])
    m = _normal(x, points, count, prior, precision, reading, work)
    damping, iterations = 0.0, 0
    step = (0.0, 0.0, 0.0)
    status = Status.DIVERGED.value
    while iterations < max_iterations and status == Status.DIVERGED.value:
        iterations += 1
        accepted = False
        trial, new = x, m
        for _ in range(_MAX_DAMPINGS):
            found, damped = _damped_step(x, m, damping)
            if found:
                step = damped
                trial = _moved(x, step)
                if damping == 0.0 and _small(step, tolerance):  # so close the cost may no longer tell
                    x = trial
                    status = Status.CONVERGED.value
                    break
                new = _normal(trial, points, count, prior, precision, reading, work)
                if new.cost <= m.cost:
                    accepted = True
                    break
            damping = max(4.0 * damping, 1e-3)
        if not accepted:
            break
        x, m = trial, new
        damping = 0.0 if damping < 1e-2 else damping / 8.0
    start[0], start[1], start[2] = x
    if status == Status.DIVERGED.value and _small(step, tolerance):
        status = Status.CONVERGED.value
    found, i = _inverse(m.m00, m.m01, m.m02, m.m11, m.m12, m.m22)
    if not found:
        for j in range(9):
            covariance[j // 3, j % 3] = 0.0
        return Status.NOT_EXCITED.value, iterations, m.cost
    covariance[0, 0], covariance[0, 1], covariance[0, 2], covariance[1, 1], covariance[1, 2], covariance[2, 2] = i
    covariance[1, 0], covariance[2, 0], covariance[2, 1] = i[1], i[2], i[4]
    if status == Status.CONVERGED.value:
        for k in range(3):
            if x[k] <= LOWER[k] or x[k] >= UPPER[k]:
                status = Status.AT_BOUND.value
    return status, iterations, m.cost
