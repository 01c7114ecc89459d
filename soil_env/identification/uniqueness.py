"""Whether another soil explains three measured values as exactly as the one found.

Three values and three unknowns: the equations may have more than one root, and no solver can tell which is the soil.
At a given K every channel is linear in S and S tan(phi) (Eqs. (1)-(3) with the stresses of Eqs. (7)-(10)), so three
values are consistent where a 3 x 3 determinant vanishes: one scalar equation in K, whose roots within the bounds are
the soils that explain the values.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from soil_env._numba.compiling import CACHE, inlined, kernel
from soil_env._numba.lanes import fill, from_array, to_array
from soil_env.identification.point import DIG_RATIO, DRAWBAR_PULL, SINKAGE, SLIP, WEIGHTS, channels, channels_at
from soil_env.identification.solver import _FACTOR, BLOCK, LOWER, UPPER, blocks, prepare
from soil_env.terramechanics.arcs import stored_integrals

_CELLS = 64  # of ln K within its bounds, each searched for one root
_QUARTER = np.array([math.pi / 4.0, 0.0, 0.0])  # tan(phi) = 1, S = 1
_DIAGONAL = np.array([0, 2, 5])  # weights of drawbar pull, load and torque


@kernel
def _coefficients(ln_k, points, reading, work, lanes, values):
    """Fill `values` [3, 3] with the linear equations (a, b | m) of a S + b S tan(phi) = m at one K."""
    count = 0
    if reading.simpson > 0 or reading.paper_resistance:
        for p in range(len(points)):
            row = points[p]
            x = (_QUARTER[0], ln_k, 0.0)
            y, _ = channels_at(x, row[SLIP], row[SINKAGE], row[DIG_RATIO], reading)
            for channel in range(3):
                if row[WEIGHTS + _DIAGONAL[channel]] > 0.0:
                    by_tan = 0.5 * y.by_phi[channel]  # d tan(phi) / d phi = 2
                    values[count, 0] = y.by_S[channel] - by_tan
                    values[count, 1] = by_tan
                    values[count, 2] = row[DRAWBAR_PULL + channel] - reading.cohesion * y.by_c[channel]
                    count += 1
        return
    K = math.exp(ln_k)
    q, k = stored_integrals(work, 0, K)
    y = channels(
        q, k, from_array(work, _FACTOR), 1.0, K, reading.cohesion, reading.radius, reading.width, -1.0
    )  # fmt: skip
    for channel in range(3):
        to_array(y.by_S[channel], lanes, 24 * channel)
        to_array(y.by_phi[channel], lanes, 24 * channel + 8)
        to_array(fill(reading.cohesion) * y.by_c[channel], lanes, 24 * channel + 16)
    for p in range(len(points)):
        for channel in range(3):
            if points[p, WEIGHTS + _DIAGONAL[channel]] > 0.0:
                by_tan = 0.5 * lanes[24 * channel + 8 + p]
                values[count, 0] = lanes[24 * channel + p] - by_tan
                values[count, 1] = by_tan
                values[count, 2] = points[p, DRAWBAR_PULL + channel] - lanes[24 * channel + 16 + p]
                count += 1


@inlined
def _determinant(v):
    return (
        v[0, 0] * (v[1, 1] * v[2, 2] - v[1, 2] * v[2, 1])
        - v[0, 1] * (v[1, 0] * v[2, 2] - v[1, 2] * v[2, 0])
        + v[0, 2] * (v[1, 0] * v[2, 1] - v[1, 1] * v[2, 0])
    )


@kernel
def _soil_at(ln_k, v, out):
    """(phi, ln K, ln S) that solve the equations `v` best into `out`; False if no soil within the bounds does."""
    aa = ab = bb = am = bm = 0.0
    for i in range(3):
        a, b, m = v[i, 0], v[i, 1], v[i, 2]
        aa, ab, bb, am, bm = aa + a * a, ab + a * b, bb + b * b, am + a * m, bm + b * m
    det = aa * bb - ab * ab
    if not det > 1e-14 * aa * bb:
        return False
    S, friction = (am * bb - bm * ab) / det, (bm * aa - am * ab) / det
    if not (S > 0.0 and friction > 0.0):
        return False
    out[0], out[1], out[2] = math.atan(friction / S), ln_k, math.log(S)
    return LOWER[0] <= out[0] <= UPPER[0] and LOWER[2] <= out[2] <= UPPER[2]


@njit(cache=CACHE)
def other_soil(x, points, reading, out):
    """True if another soil than x [3] within the bounds explains the three measured values of `points`; into `out` [3].

    A search of `_CELLS` cells of ln K for a change of sign of the determinant over (ln K - ln K of x), refined by
    bisection. Two further roots within one cell, 12 % of K apart at most, pass unseen.
    """
    work = np.empty(blocks(len(points)) * BLOCK)
    prepare(points, len(points), reading, work)
    lanes, values = np.empty(72), np.empty((3, 3))
    before = 0.0
    for cell in range(_CELLS + 1):
        high = LOWER[1] + cell * (UPPER[1] - LOWER[1]) / _CELLS
        _coefficients(high, points, reading, work, lanes, values)
        after = _determinant(values) / (high - x[1])
        if cell > 0 and before * after < 0.0:
            low, below = high - (UPPER[1] - LOWER[1]) / _CELLS, before
            while high - low > 1e-10:
                middle = 0.5 * (low + high)
                _coefficients(middle, points, reading, work, lanes, values)
                at = _determinant(values) / (middle - x[1])
                if below * at <= 0.0:
                    high = middle
                else:
                    low = middle
            if _soil_at(high, values, out) and abs(high - x[1]) > 1e-6:
                return True
            high = LOWER[1] + cell * (UPPER[1] - LOWER[1]) / _CELLS
        before = after
    return False
