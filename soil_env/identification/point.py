"""A measured point: its quantities, what is predicted for it, and its weight."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, part, root
from soil_env._numba.rows import Rows, rows
from soil_env.slip import motion_from_slip, travel_rate
from soil_env.terramechanics.arc_integrals import (
    integrals_of,
    shear_modulus_rates,
    simpson_integrals,
)
from soil_env.terramechanics.contact import (
    JANOSI,
    compaction_resistance,
    forces,
    shear_forces,
    smooth_arc,
)


class Reading(NamedTuple):
    """How a drawbar pull is computed, and what is held fixed while identifying."""

    cohesion: float  # [Pa]
    exponent: float  # n [-]
    radius: float  # [m]
    width: float  # [m]
    simpson: int = 0  # m of the paper's composite Simpson rule; 0 = Gauss-Legendre
    paper_resistance: bool = False  # Eq. (12) instead of the exact Eq. (11)


#: Measured points, a column each. The digging ratio is dig_ratio + g dig_response where the gain of digging is unknown
#: too; elsewhere the response is 0. The weights are the lower triangle of the matrix that whitens (drawbar pull, load,
#: torque).
Points: type[Rows] = rows(
    "Points",
    "slip",
    "sinkage",  # [m]
    "dig_ratio",
    "dig_response",
    "drawbar_pull",  # [N]
    "load",  # [N]
    "torque",  # [N m]
    "w00",
    "w10",
    "w11",
    "w20",
    "w21",
    "w22",
    "place",  # [m] travelled
)


class Channels(NamedTuple):
    """Drawbar pull, load and torque at a point, each with its derivatives by phi, ln K, ln S and cohesion."""

    pull: float
    load: float
    torque: float
    by_phi: tuple[Any, ...]
    by_K: tuple[Any, ...]
    by_S: tuple[Any, ...]
    by_c: tuple[Any, ...]


@inlined
def _in_order(f):
    """(drawbar pull, load, torque) of `Forces`."""
    return f.drawbar_pull, f.load, f.torque


@inlined
def channels(q, k, S, tan_phi, K, c, r, b, paper_resistance):
    """`Channels` from `ArcIntegrals` q and their `ArcRates` k by K, of one point or in lanes.

    `paper_resistance` replaces the resistance of Eq. (11) in the drawbar pull, unless it is negative.
    """
    st = S * tan_phi
    f = forces(q, S, tan_phi, c, r, b, 1.0)
    by_ln_S = forces(q, S, tan_phi, 0.0 * c, r, b, 1.0)
    by_phi = shear_forces(q, S * (1.0 + tan_phi * tan_phi), 0.0 * c, r, b, 1.0)
    by_c = shear_forces(q, 0.0 * S, 0.0 * c + 1.0, r, b, 1.0)
    by_ln_K = shear_forces(k, st * K, c * K, r, b, 1.0)
    more = 0.0 * q.p_sin
    if paper_resistance >= 0.0:
        more = r * b * S * q.p_sin - paper_resistance
    return Channels(
        f.drawbar_pull + more,
        f.load,
        f.torque,
        _in_order(by_phi),
        _in_order(by_ln_K),
        (by_ln_S.drawbar_pull + more, by_ln_S.load, by_ln_S.torque),
        _in_order(by_c),
    )


@part
def channels_at(x, slip, sinkage, dig_ratio, reading):
    """(`Channels`, their derivatives by slip) of one point."""
    r, n, b = reading.radius, reading.exponent, reading.width
    K, tan_phi = math.exp(x[1]), math.tan(x[0])
    S = math.exp(x[2]) * dig_ratio**-n
    arc = smooth_arc(sinkage, r)
    rim, travel = motion_from_slip(slip)
    if reading.simpson > 0:
        q, by_rim, by_travel = simpson_integrals(
            arc.theta1, arc.theta2, arc.thetam, rim, travel, K, n, r, reading.simpson
        )
    else:
        q, by_rim, by_travel = integrals_of(arc, rim, travel, K, n, JANOSI)
    resistance = compaction_resistance(sinkage, S, n, b) if reading.paper_resistance else -1.0
    k = shear_modulus_rates(by_rim, by_travel, rim, travel, K)
    y = channels(q, k, S, tan_phi, K, reading.cohesion, r, b, resistance)
    rate = travel_rate(travel)
    return y, _in_order(shear_forces(by_travel, rate * S * tan_phi, rate * reading.cohesion, r, b, 1.0))


@part
def predict(x, slip, sinkage, dig_ratio, reading, out, jacobian):
    """Drawbar pull, load and torque for unknowns x at one point into `out` [3], derivatives into `jacobian` [3, 4].

    Columns of `jacobian`: phi, ln K, ln S, and cohesion; by ln(dig ratio) it is -n times the column of ln S.
    `dig_ratio` z/z_w >= 1 is how much deeper the wheel stands than its load alone would sink it: the soil then bears
    like one with S (z/z_w)^-n (`effects.slip_sinkage_ratio`).
    """
    y, _ = channels_at(x, slip, sinkage, dig_ratio, reading)
    out[0], out[1], out[2] = y.pull, y.load, y.torque
    for i in range(3):
        jacobian[i, 0], jacobian[i, 1], jacobian[i, 2], jacobian[i, 3] = y.by_phi[i], y.by_K[i], y.by_S[i], y.by_c[i]


class Covariance(NamedTuple):
    """Of (drawbar pull, load, torque): the lower triangle."""

    v00: float
    v10: float
    v11: float
    v20: float
    v21: float
    v22: float


@inlined
def _with_error(v, a):
    """Covariance `v` with an error of one standard deviation (a0, a1, a2) in all channels together."""
    return Covariance(
        v.v00 + a[0] * a[0], v.v10 + a[1] * a[0], v.v11 + a[1] * a[1], v.v20 + a[2] * a[0], v.v21 + a[2] * a[1],
        v.v22 + a[2] * a[2],
    )  # fmt: skip


@inlined
def _times(factor, a):
    return factor * a[0], factor * a[1], factor * a[2]


@part
def weigh(points, p, x, variances, slip_sd, sinkage_sd, reading, ratio_sd=0.0, gain=1.0):
    """Set the whitening weights of point p from the noise of all its channels, at unknowns x; its `Channels` there.

    `variances` [3] of drawbar pull, load and torque; infinite where not measured. The noise of slip and sinkage moves
    all three channels together; its first-order effect is added to their covariance (effective variance, Fuller 1987,
    Measurement Error Models, Sec. 1.4). So is that of the digging ratio, from `ratio_sd`, its relative standard
    deviation.
    """
    sinkage = points.sinkage[p]
    ratio = points.dig_ratio[p] + gain * points.dig_response[p]
    y, by_slip = channels_at(x, points.slip[p], sinkage, ratio, reading)
    v = _with_error(Covariance(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), _times(slip_sd, by_slip))
    v = _with_error(v, _times(ratio_sd * reading.exponent, y.by_S))
    if sinkage_sd > 0.0:
        h = 0.02 * sinkage
        z, _ = channels_at(x, points.slip[p], sinkage + h, ratio, reading)
        v = _with_error(v, _times(sinkage_sd / h, (z.pull - y.pull, z.load - y.load, z.torque - y.torque)))
    _whiten(points, p, variances, v)
    return y


@root
def weigh_all(points, count, x, variances, slip_sd, sinkage_sd, reading):
    """`weigh` the first `count` points."""
    for p in range(count):
        weigh(points, p, x, variances, slip_sd, sinkage_sd, reading)


@inlined
def _whiten(points, p, variances, v):
    """Inverse of the Cholesky factor of the covariance of point p: that of its channels, and `v`, common to them.

    A channel that was not measured (infinite variance) has no covariance and no weight.
    """
    w0 = 0.0 if variances[0] == np.inf else 1.0
    w1 = 0.0 if variances[1] == np.inf else 1.0
    w2 = 0.0 if variances[2] == np.inf else 1.0
    v00 = variances[0] + v.v00 if w0 > 0.0 else 1.0
    v11 = variances[1] + v.v11 if w1 > 0.0 else 1.0
    v22 = variances[2] + v.v22 if w2 > 0.0 else 1.0
    v10, v20, v21 = w1 * w0 * v.v10, w2 * w0 * v.v20, w2 * w1 * v.v21
    l00 = math.sqrt(v00)
    l10, l20 = v10 / l00, v20 / l00
    l11 = math.sqrt(max(v11 - l10 * l10, 1e-12 * v11))
    l21 = (v21 - l20 * l10) / l11
    l22 = math.sqrt(max(v22 - l20 * l20 - l21 * l21, 1e-12 * v22))
    points.w00[p] = w0 / l00
    points.w10[p] = -w1 * l10 / (l00 * l11)
    points.w11[p] = w1 / l11
    points.w20[p] = w2 * (l10 * l21 - l20 * l11) / (l00 * l11 * l22)
    points.w21[p] = -w2 * l21 / (l11 * l22)
    points.w22[p] = w2 / l22


@inlined
def whitened(w, a):
    """Lower triangle w of the whitening matrix times (drawbar pull, load, torque) a."""
    return w[0] * a[0], w[1] * a[0] + w[2] * a[1], w[3] * a[0] + w[4] * a[1] + w[5] * a[2]


@inlined
def weights(points, p):
    """The whitening matrix of point p, row by row."""
    return points.w00[p], points.w10[p], points.w11[p], points.w20[p], points.w21[p], points.w22[p]


@inlined
def dot(a, b):
    """Scalar product of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
