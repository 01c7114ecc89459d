"""A measured point: its columns, what is predicted for it, and its weight."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, kernel
from soil_env.terramechanics.contact import (
    JANOSI,
    arc_nodes,
    compaction_resistance,
    entry_angle,
    forces,
    motion_from_slip,
    shear_integrals,
    shear_modulus_rates,
    simpson_integrals,
)


class Reading(NamedTuple):
    """How a drawbar pull is computed, and what is held fixed while identifying."""

    cohesion: float  # [Pa]
    exponent: float  # n [-]
    radius: float  # [m]
    width: float  # [m]
    simpson: int = 0  # m of the paper's composite Simpson rule; 0 = Gauss-Legendre
    paper_resistance: bool = False  # Eq. (12) instead of the exact Eq. (11)


# Columns of a measured point. Its digging ratio is DIG_RATIO + g DIG_RESPONSE where the gain of digging is unknown too
# (`joint.py`); elsewhere the response is 0.
SLIP, SINKAGE, DIG_RATIO, DRAWBAR_PULL, LOAD, TORQUE, WEIGHTS, PLACE, DIG_RESPONSE = 0, 1, 2, 3, 4, 5, 6, 12, 13
POINT_SIZE = (
    16  # six weights: lower triangle of the matrix that whitens (drawbar pull, load, torque); two rows of lanes
)


class Channels(NamedTuple):
    """Drawbar pull, load and torque at a point, each with its derivatives by phi, ln K, ln S and cohesion."""

    pull: float
    load: float
    torque: float
    by_phi: tuple
    by_K: tuple
    by_S: tuple
    by_c: tuple


@inlined
def channels(q, k, S, tan_phi, K, c, r, b, paper_resistance):
    """`Channels` from `ArcIntegrals` q and their `ArcRates` k by K, of one point or in lanes.

    `paper_resistance` replaces the resistance of Eq. (11) in the drawbar pull, unless it is negative.
    """
    f = forces(q, S, tan_phi, c, r, b, 1.0)
    rb = r * b
    resistance = rb * (S * q.p_sin)
    pull = f.drawbar_pull
    if paper_resistance >= 0.0:
        pull = pull + resistance - paper_resistance
        resistance = resistance * 0.0 + paper_resistance
    s_phi = S * (rb * (1.0 + tan_phi * tan_phi))  # d tan(phi) / d phi
    st, ck = S * tan_phi, rb * K
    friction = rb * (st * q.pe_cos)
    return Channels(
        pull,
        f.load,
        f.torque,
        (s_phi * q.pe_cos, s_phi * q.pe_sin, r * (s_phi * q.pe)),
        (ck * (st * k.pe_cos + c * k.e_cos), ck * (st * k.pe_sin + c * k.e_sin), (r * ck) * (st * k.pe + c * k.e)),
        (friction - resistance, rb * (S * q.p_cos + st * q.pe_sin), (r * rb) * (st * q.pe)),
        (rb * q.e_cos, rb * q.e_sin, (r * rb) * q.e),
    )


@kernel
def channels_at(x, slip, sinkage, dig_ratio, reading):
    """(`Channels`, their derivatives by slip) of one point."""
    r, n = reading.radius, reading.exponent
    K, tan_phi = math.exp(x[1]), math.tan(x[0])
    S = math.exp(x[2]) * dig_ratio**-n
    theta1 = entry_angle(sinkage, r)
    rim, travel = motion_from_slip(slip)
    if reading.simpson > 0:
        q, by_rim, by_travel = simpson_integrals(theta1, 0.0, 0.5 * theta1, rim, travel, K, n, r, reading.simpson)
    else:
        nodes = arc_nodes(theta1, 0.0, 0.5 * theta1, n, r, theta1)
        q, by_rim, by_travel = shear_integrals(nodes, rim, travel, K, JANOSI)
    resistance = compaction_resistance(sinkage, S, n, reading.width) if reading.paper_resistance else -1.0
    k = shear_modulus_rates(by_rim, by_travel, rim, travel, K)
    y = channels(q, k, S, tan_phi, K, reading.cohesion, r, reading.width, resistance)
    rate = -1.0 if slip >= 0.0 else -travel * travel  # d travel/d slip
    st, c, rb, z = S * tan_phi, reading.cohesion, rate * r * reading.width, by_travel
    by_slip = (
        rb * (st * z.pe_cos + c * z.e_cos), rb * (st * z.pe_sin + c * z.e_sin), r * rb * (st * z.pe + c * z.e)
    )  # fmt: skip
    return y, by_slip


@kernel
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


@inlined
def weigh(row, x, variances, slip_sd, sinkage_sd, reading, ratio_sd=0.0, gain=1.0):
    """Set the whitening weights of a point from the noise of all its channels, at unknowns x; its `Channels` there.

    `variances` [3] of drawbar pull, load and torque; infinite where not measured. The noise of slip and sinkage moves
    all three channels together; its first-order effect is added to their covariance (effective variance, Fuller 1987,
    Measurement Error Models, Sec. 1.4). So is that of the digging ratio, from `ratio_sd`, its relative standard
    deviation.
    """
    ratio = row[DIG_RATIO] + gain * row[DIG_RESPONSE]
    y, by_slip = channels_at(x, row[SLIP], row[SINKAGE], ratio, reading)
    a0, a1, a2 = slip_sd * by_slip[0], slip_sd * by_slip[1], slip_sd * by_slip[2]
    b0 = b1 = b2 = 0.0
    if sinkage_sd > 0.0:
        h = 0.02 * row[SINKAGE]
        z, _ = channels_at(x, row[SLIP], row[SINKAGE] + h, ratio, reading)
        scale = sinkage_sd / h
        b0, b1, b2 = scale * (z.pull - y.pull), scale * (z.load - y.load), scale * (z.torque - y.torque)
    g = ratio_sd * reading.exponent
    c0, c1, c2 = g * y.by_S[0], g * y.by_S[1], g * y.by_S[2]
    # a channel that was not measured: no covariance, no weight
    w0 = 0.0 if variances[0] == np.inf else 1.0
    w1 = 0.0 if variances[1] == np.inf else 1.0
    w2 = 0.0 if variances[2] == np.inf else 1.0
    v00 = variances[0] + a0 * a0 + b0 * b0 + c0 * c0 if w0 > 0.0 else 1.0
    v11 = variances[1] + a1 * a1 + b1 * b1 + c1 * c1 if w1 > 0.0 else 1.0
    v22 = variances[2] + a2 * a2 + b2 * b2 + c2 * c2 if w2 > 0.0 else 1.0
    v10, v20, v21 = (
        w1 * w0 * (a1 * a0 + b1 * b0 + c1 * c0),
        w2 * w0 * (a2 * a0 + b2 * b0 + c2 * c0),
        w2 * w1 * (a2 * a1 + b2 * b1 + c2 * c1),
    )
    # inverse of the Cholesky factor of v
    l00 = math.sqrt(v00)
    l10, l20 = v10 / l00, v20 / l00
    l11 = math.sqrt(max(v11 - l10 * l10, 1e-12 * v11))
    l21 = (v21 - l20 * l10) / l11
    l22 = math.sqrt(max(v22 - l20 * l20 - l21 * l21, 1e-12 * v22))
    row[WEIGHTS] = w0 / l00
    row[WEIGHTS + 1] = -w1 * l10 / (l00 * l11)
    row[WEIGHTS + 2] = w1 / l11
    row[WEIGHTS + 3] = w2 * (l10 * l21 - l20 * l11) / (l00 * l11 * l22)
    row[WEIGHTS + 4] = -w2 * l21 / (l11 * l22)
    row[WEIGHTS + 5] = w2 / l22
    return y
