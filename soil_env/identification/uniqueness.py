"""Whether another soil explains three measured values as exactly as the one found.

Three values and three unknowns: the equations may have more than one root, and no solver can tell which is the soil.
At a given K every channel is linear in S and S tan(phi) (Eqs. (1)-(3) with the stresses of Eqs. (7)-(10)), so three
values are consistent where a 3 x 3 determinant vanishes: one scalar equation in K, whose roots within the bounds are
the soils that explain the values.
"""

from __future__ import annotations

import math

import numpy as np

from soil_env._numba.compiling import inlined, part, root
from soil_env._numba.rows import Rows
from soil_env.identification.point import Reading, channels_at, weights
from soil_env.identification.solver import (
    LOWER,
    UPPER,
)

_CELLS = 64  # of ln K within its bounds, each searched for one root
_QUARTER = math.pi / 4.0  # tan(phi) = 1


@part
def _coefficients(ln_k, points, count, reading, values):
    """Fill `values` [3, 3] with the linear equations (a, b | m) of a S + b S tan(phi) = m at one K."""
    row = 0
    for p in range(count):
        w = weights(points, p)
        measured = (points.drawbar_pull[p], points.load[p], points.torque[p])
        y, _ = channels_at((_QUARTER, ln_k, 0.0), points.slip[p], points.sinkage[p], points.dig_ratio[p], reading)
        for channel, weight in enumerate((w[0], w[2], w[5])):
            if weight > 0.0:
                by_tan = 0.5 * y.by_phi[channel]  # d tan(phi) / d phi = 2
                values[row, 0], values[row, 1] = y.by_S[channel] - by_tan, by_tan
                values[row, 2] = measured[channel] - reading.cohesion * y.by_c[channel]
                row += 1


@inlined
def _determinant(v):
    return (
        v[0, 0] * (v[1, 1] * v[2, 2] - v[1, 2] * v[2, 1])
        - v[0, 1] * (v[1, 0] * v[2, 2] - v[1, 2] * v[2, 0])
        + v[0, 2] * (v[1, 0] * v[2, 1] - v[1, 1] * v[2, 0])
    )


@part
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


@root(allocates=True)
def _search(x, points, count, reading, out):
    """`other_soil`: a search of `_CELLS` cells of ln K for a change of sign of the determinant over (ln K - ln K of x).

    Refined by bisection. Two further roots within one cell, 12 % of K apart at most, pass unseen.
    """
    values = np.empty((3, 3))
    before = 0.0
    for cell in range(_CELLS + 1):
        high = LOWER[1] + cell * (UPPER[1] - LOWER[1]) / _CELLS
        _coefficients(high, points, count, reading, values)
        after = _determinant(values) / (high - x[1])
        if cell > 0 and before * after < 0.0:
            low, below = high - (UPPER[1] - LOWER[1]) / _CELLS, before
            while high - low > 1e-10:
                middle = 0.5 * (low + high)
                _coefficients(middle, points, count, reading, values)
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


def other_soil(x: np.ndarray, points: Rows, reading: Reading, out: np.ndarray) -> bool:
    """Whether another soil than x [3] within the bounds explains the three values of `points`; that one into `out`."""
    return bool(_search(x, points, len(points), reading, out))
