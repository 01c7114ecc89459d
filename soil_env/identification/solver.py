"""Compiled core of the identification: prediction of a measured point, its weight, and the safeguarded iteration.

Unknowns are x = (phi, ln K, ln S). `solve` serves the paper's three points, any larger table and the online window
alike.
"""

from __future__ import annotations

import enum
import math
from typing import NamedTuple

import numpy as np
from numba import njit

from soil_env.contact import (
    JANOSI,
    arc_integrals,
    compaction_resistance,
    entry_angle,
    forces,
    motion_from_slip,
    shear_modulus_rates,
    simpson_integrals,
)


class Status(enum.IntEnum):
    """Outcome of an identification."""

    NO_DATA = 0  # fewer measured values than unknowns
    CONVERGED = 1
    NOT_EXCITED = 2  # the points do not tell the unknowns apart; an online estimate is then the last good one
    AT_BOUND = 3  # the solution lies on a bound
    DIVERGED = 4  # no convergence within the allowed iterations


class Reading(NamedTuple):
    """How a drawbar pull is computed, and what is held fixed while identifying."""

    cohesion: float  # [Pa]
    exponent: float  # n [-]
    radius: float  # [m]
    width: float  # [m]
    simpson: int = 0  # m of the paper's composite Simpson rule; 0 = Gauss-Legendre
    paper_resistance: bool = False  # Eq. (12) instead of the exact Eq. (11)


#: Bounds of (phi [rad], ln K [m], ln S): the box of the paper's Table 4, widened.
LOWER = np.array([math.radians(1.0), math.log(2e-4), math.log(1e3)])
UPPER = np.array([math.radians(89.5), math.log(0.3) - 1e-9, math.log(1e13) - 1e-9])
#: No unknown moves further than this in one iteration.
LONGEST = np.array([0.35, 1.5, 1.5])
_MAX_DAMPINGS = 12

# Columns of a measured point.
SLIP, SINKAGE, DIG_RATIO, DRAWBAR_PULL, LOAD, TORQUE, WEIGHTS, PLACE = 0, 1, 2, 3, 4, 5, 6, 12
POINT_SIZE = 13  # six weights: lower triangle of the matrix that whitens (drawbar pull, load, torque)


@njit(cache=True)
def predict(x, slip, sinkage, dig_ratio, reading, out, jacobian):
    """Drawbar pull, load and torque for unknowns x at one point into `out` [3], derivatives into `jacobian` [3, 4].

    Columns of `jacobian`: phi, ln K, ln S, and cohesion; by ln(dig ratio) it is -n times the column of ln S.
    `dig_ratio` z/z_w >= 1 is how much deeper the wheel stands than its load alone would sink it: the soil then bears
    like one with S (z/z_w)^-n (`effects.slip_sinkage_ratio`).
    """
    r, b, n, c = reading.radius, reading.width, reading.exponent, reading.cohesion
    K, tan_phi = math.exp(x[1]), math.tan(x[0])
    S = math.exp(x[2]) * dig_ratio**-n
    theta1 = entry_angle(sinkage, r)
    rim, travel = motion_from_slip(slip)
    if reading.simpson > 0:
        q, by_rim, by_travel = simpson_integrals(theta1, 0.0, 0.5 * theta1, rim, travel, K, n, r, reading.simpson)
    else:
        q, by_rim, by_travel = arc_integrals(theta1, 0.0, 0.5 * theta1, rim, travel, K, n, r, JANOSI)
    f = forces(q, S, tan_phi, c, r, b, 1.0)
    rb = r * b
    resistance = rb * S * q.p_sin
    thrust = f.drawbar_pull + resistance
    if reading.paper_resistance:
        resistance = compaction_resistance(sinkage, S, n, b)
    out[0] = thrust - resistance
    out[1], out[2] = f.load, f.torque

    d_tan = 1.0 + tan_phi * tan_phi  # d tan(phi) / d phi
    jacobian[0, 0] = rb * S * d_tan * q.pe_cos
    jacobian[1, 0] = rb * S * d_tan * q.pe_sin
    jacobian[2, 0] = r * rb * S * d_tan * q.pe
    k = shear_modulus_rates(by_rim, by_travel, rim, travel, K)
    jacobian[0, 1] = rb * K * (S * tan_phi * k.pe_cos + c * k.e_cos)
    jacobian[1, 1] = rb * K * (S * tan_phi * k.pe_sin + c * k.e_sin)
    jacobian[2, 1] = r * rb * K * (S * tan_phi * k.pe + c * k.e)
    jacobian[0, 2] = rb * S * tan_phi * q.pe_cos - resistance
    jacobian[1, 2] = rb * S * (q.p_cos + tan_phi * q.pe_sin)
    jacobian[2, 2] = r * rb * S * tan_phi * q.pe
    jacobian[0, 3], jacobian[1, 3], jacobian[2, 3] = rb * q.e_cos, rb * q.e_sin, r * rb * q.e


@njit(cache=True)
def normal_equations(x, points, count, prior, precision, reading, matrix, vector):
    """Sum of squared whitened residuals; fills `matrix` (J^T J + prior precision) and `vector` (J^T residual)."""
    out, jac = np.empty(3), np.empty((3, 4))
    matrix[:, :] = 0.0
    cost = 0.0
    for i in range(3):
        d = prior[i] - x[i]
        matrix[i, i] = precision[i]
        vector[i] = precision[i] * d
        cost += precision[i] * d * d
    for p in range(count):
        row = points[p]
        predict(x, row[SLIP], row[SINKAGE], row[DIG_RATIO], reading, out, jac)
        d0, d1, d2 = row[DRAWBAR_PULL] - out[0], row[LOAD] - out[1], row[TORQUE] - out[2]
        for channel in range(3):
            if channel == 0:
                w0, w1, w2 = row[WEIGHTS], 0.0, 0.0
            elif channel == 1:
                w0, w1, w2 = row[WEIGHTS + 1], row[WEIGHTS + 2], 0.0
            else:
                w0, w1, w2 = row[WEIGHTS + 3], row[WEIGHTS + 4], row[WEIGHTS + 5]
            u = w0 * d0 + w1 * d1 + w2 * d2
            cost += u * u
            g0 = w0 * jac[0, 0] + w1 * jac[1, 0] + w2 * jac[2, 0]
            g1 = w0 * jac[0, 1] + w1 * jac[1, 1] + w2 * jac[2, 1]
            g2 = w0 * jac[0, 2] + w1 * jac[1, 2] + w2 * jac[2, 2]
            vector[0] += g0 * u
            vector[1] += g1 * u
            vector[2] += g2 * u
            matrix[0, 0] += g0 * g0
            matrix[0, 1] += g0 * g1
            matrix[0, 2] += g0 * g2
            matrix[1, 1] += g1 * g1
            matrix[1, 2] += g1 * g2
            matrix[2, 2] += g2 * g2
    matrix[1, 0], matrix[2, 0], matrix[2, 1] = matrix[0, 1], matrix[0, 2], matrix[1, 2]
    return cost


@njit(cache=True)
def invert3(m, out):
    """Inverse of a symmetric 3 x 3 matrix into `out`; False if it is singular to working precision."""
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    c01 = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c02 = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    det = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
    if not det > 1e-14 * abs(m[0, 0] * m[1, 1] * m[2, 2]):
        return False
    out[0, 0], out[0, 1], out[0, 2] = c00 / det, c01 / det, c02 / det
    out[1, 1] = (m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2]) / det
    out[1, 2] = (m[0, 2] * m[0, 1] - m[0, 0] * m[1, 2]) / det
    out[2, 2] = (m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]) / det
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return True


@njit(cache=True)
def _damped_step(x, matrix, vector, damping, step):
    """Levenberg-Marquardt step from x into `step`; False if the damped normal matrix is singular.

    An unknown that presses against its bound stays there.
    """
    damped, inverse = matrix.copy(), np.empty((3, 3))
    trace = matrix[0, 0] + matrix[1, 1] + matrix[2, 2]
    pressed = np.zeros(3, dtype=np.bool_)
    for i in range(3):
        damped[i, i] += damping * matrix[i, i] + 1e-12 * trace
        pressed[i] = (x[i] <= LOWER[i] and vector[i] < 0.0) or (x[i] >= UPPER[i] and vector[i] > 0.0)
        if pressed[i]:
            for j in range(3):
                if j != i:
                    damped[i, j] = damped[j, i] = 0.0
    if not invert3(damped, inverse):
        return False
    for i in range(3):
        step[i] = 0.0
        if not pressed[i]:
            step[i] = inverse[i, 0] * vector[0] + inverse[i, 1] * vector[1] + inverse[i, 2] * vector[2]
    return True


@njit(cache=True)
def _small(step, tolerance):
    return abs(step[0]) < tolerance and abs(step[1]) < tolerance and abs(step[2]) < tolerance


@njit(cache=True)
def _moved(x, step, out):
    """x + step into `out`, shortened to the longest step allowed and cut to the bounds."""
    share = 1.0
    for i in range(3):
        if abs(step[i]) * share > LONGEST[i]:
            share = LONGEST[i] / abs(step[i])
    for i in range(3):
        out[i] = min(max(x[i] + share * step[i], LOWER[i]), UPPER[i])


@njit(cache=True)
def solve(x, points, count, prior, precision, reading, max_iterations, tolerance, covariance):
    """Weighted least squares for x [3] in place, from its present value; (Status, iterations, cost).

    Minimises |W (measured - predicted)|^2 + (x - prior)^T diag(precision) (x - prior). Each iteration solves the normal
    equations with Levenberg-Marquardt damping; the damping rises until the cost falls, and a step across a bound is
    cut back to it. Converged means that the undamped next step is shorter than `tolerance` in every unknown.
    `covariance` [3, 3] is left as the inverse of the undamped normal matrix (zeros if that is singular).
    """
    matrix, trial_matrix = np.empty((3, 3)), np.empty((3, 3))
    vector, trial_vector = np.empty(3), np.empty(3)
    step, trial = np.zeros(3), np.empty(3)
    cost = normal_equations(x, points, count, prior, precision, reading, matrix, vector)
    damping, iterations = 0.0, 0
    status = Status.DIVERGED.value
    while iterations < max_iterations and status == Status.DIVERGED.value:
        iterations += 1
        accepted = False
        for _ in range(_MAX_DAMPINGS):
            if _damped_step(x, matrix, vector, damping, step):
                _moved(x, step, trial)
                if damping == 0.0 and _small(step, tolerance):  # so close the cost may no longer tell
                    x[:] = trial
                    status = Status.CONVERGED.value
                    break
                trial_cost = normal_equations(
                    trial, points, count, prior, precision, reading, trial_matrix, trial_vector
                )
                if trial_cost <= cost:
                    accepted = True
                    break
            damping = max(4.0 * damping, 1e-3)
        if not accepted:
            break
        x[:] = trial
        cost = trial_cost
        matrix[:, :] = trial_matrix
        vector[:] = trial_vector
        damping = 0.0 if damping < 1e-2 else damping / 8.0
    if status == Status.DIVERGED.value and _small(step, tolerance):
        status = Status.CONVERGED.value
    if not invert3(matrix, covariance):
        covariance[:, :] = 0.0
        return Status.NOT_EXCITED.value, iterations, cost
    if status == Status.CONVERGED.value:
        for i in range(3):
            if x[i] <= LOWER[i] or x[i] >= UPPER[i]:
                status = Status.AT_BOUND.value
    return status, iterations, cost


@njit(cache=True)
def weigh(row, x, variances, slip_sd, sinkage_sd, reading):
    """Set the whitening weights of a point from the noise of all its channels, at unknowns x.

    `variances` [3] of drawbar pull, load and torque; infinite where not measured. The noise of slip and sinkage moves
    all three channels together; its first-order effect is added to their covariance (effective variance, Fuller 1987,
    Measurement Error Models, Sec. 1.4).
    """
    at, jac = np.empty(3), np.empty((3, 4))
    moved, unused = np.empty(3), np.empty((3, 4))
    v = np.zeros((3, 3))
    for i in range(3):
        v[i, i] = variances[i] if variances[i] < np.inf else 0.0
    predict(x, row[SLIP], row[SINKAGE], row[DIG_RATIO], reading, at, jac)
    for source in range(2):
        sd = slip_sd if source == 0 else sinkage_sd
        if sd == 0.0:
            continue
        if source == 0:
            h = 0.01 if row[SLIP] < 0.98 else -0.01
            predict(x, row[SLIP] + h, row[SINKAGE], row[DIG_RATIO], reading, moved, unused)
        else:
            h = 0.02 * row[SINKAGE]
            predict(x, row[SLIP], row[SINKAGE] + h, row[DIG_RATIO], reading, moved, unused)
        scale = sd / h
        for i in range(3):
            for j in range(i + 1):
                v[i, j] += scale * scale * (moved[i] - at[i]) * (moved[j] - at[j])
    for i in range(3):  # a channel that was not measured: no covariance, no weight
        if variances[i] == np.inf:
            v[i, :] = 0.0
            v[:, i] = 0.0
            v[i, i] = 1.0
    # inverse of the Cholesky factor of v
    l00 = math.sqrt(v[0, 0])
    l10, l20 = v[1, 0] / l00, v[2, 0] / l00
    l11 = math.sqrt(max(v[1, 1] - l10 * l10, 1e-12 * v[1, 1]))
    l21 = (v[2, 1] - l20 * l10) / l11
    l22 = math.sqrt(max(v[2, 2] - l20 * l20 - l21 * l21, 1e-12 * v[2, 2]))
    w0 = 0.0 if variances[0] == np.inf else 1.0
    w1 = 0.0 if variances[1] == np.inf else 1.0
    w2 = 0.0 if variances[2] == np.inf else 1.0
    row[WEIGHTS] = w0 / l00
    row[WEIGHTS + 1] = -w1 * l10 / (l00 * l11)
    row[WEIGHTS + 2] = w1 / l11
    row[WEIGHTS + 3] = w2 * (l10 * l21 - l20 * l11) / (l00 * l11 * l22)
    row[WEIGHTS + 4] = -w2 * l21 / (l11 * l22)
    row[WEIGHTS + 5] = w2 / l22
