"""The moving window, the cheaper of the two identifiers of `online`: `Belief.method` "window".

Readings of a few control periods at the same slip are averaged to a point; the window keeps the points that are spread
in slip and sinkage, drops the more redundant of two alike, forgets what lies further back than its memory, and starts
anew when a point contradicts the estimate (a new soil). Each completed point triggers one safeguarded generalized
Newton-Raphson solve (`solver`) on drawbar pull, load and torque, with the prior of the `Belief` as a further, weak
measurement.

Slip and sinkage carry noise too. Their first-order effect on the three channels and a model error enter the weight of
each point (errors in variables by effective variance, Fuller 1987, Sec. 1.4). How far the wheel has dug itself in is
followed from its own speeds and sinkage (`identification.digging`). Cohesion and the gain of digging are unknown too,
with the mean and the scatter of the belief, and are solved for with the other three.
"""

from __future__ import annotations

import math

import numpy as np

from soil_env._numba.compiling import inlined, part
from soil_env._numba.lanes import COUNT, fill, first, from_array, lane, smallest
from soil_env._numba.rows import Rows, copy_column, rows, scratch_rows
from soil_env.identification.digging import close_point, note, roll
from soil_env.identification.normal_equations import (
    COHESION,
    GAIN,
    SIZE,
    Prepared,
    Workspace,
    gain_share,
    in_blocks,
    prepare,
)
from soil_env.identification.point import Reading, weigh, weights, whitened
from soil_env.identification.solver import Status, least_squares
from soil_env.terramechanics.arc_integrals import NODE_COLUMNS, Nodes

_prepared, _nodes = scratch_rows(Prepared, COUNT), scratch_rows(Nodes, NODE_COLUMNS)
WINDOW = COUNT  # points: one block of lanes
_BUCKET_READINGS = 5  # readings averaged to one point, at most
_BUCKET_LENGTH = 0.06  # [m] travelled within one point, at most
_BUCKET_SLIP = 0.05  # slip range within one point, at most
# chi-squared of three channels beyond which a point belongs to another soil. Low, since the errors that a point is
# weighed with are larger than the differences between neighbouring points; set on courses of seeds 7 and
# 8, docs/identification.md
CONTRADICTION_OF_POINT = 3.0
RATIO_ERROR = 0.07  # relative error of the digging ratio that the law of sinkage itself makes
_MINIMUM_RIM_SPEED = 0.02  # [m/s] below which readings say nothing of shear

#: The open point of each identifier: sums over its readings, and where it began.
OpenPoint: type[Rows] = rows(
    "OpenPoint",
    "slip",
    "sinkage",
    "drawbar_pull",
    "load",
    "torque",
    "readings",
    "start",  # [m] odometer at its first reading
    "first_slip",
    "odometer",  # [m] travelled since `forget`
    "held",  # 1 once an estimate has converged on this soil
)


@inlined
def take(ids, k, reading, numbers):
    """Take one set of readings; True if it completed a point, and the window was solved."""
    sums, digging, dt = ids.open, ids.digging, numbers.period
    sums.odometer[k] += reading.speed * dt
    roll(
        digging, k, reading.speed, reading.rim_speed - reading.speed, dt, numbers.dig_gain, numbers.dig_recovery,
        numbers.relaxation,
    )  # fmt: skip
    if reading.rim_speed < _MINIMUM_RIM_SPEED or reading.sinkage < 1e-3 * numbers.reading.radius:
        return False
    full, done = False, False
    if sums.readings[k] > 0.0:
        full = abs(reading.slip - sums.first_slip[k]) > _BUCKET_SLIP
        full = full or abs(sums.odometer[k] - sums.start[k]) > _BUCKET_LENGTH
    if full:
        done = _complete(ids, k, numbers)
    if sums.readings[k] == 0.0:
        sums.start[k], sums.first_slip[k] = sums.odometer[k], reading.slip
    sums.slip[k] += reading.slip
    sums.sinkage[k] += reading.sinkage
    note(digging, k)
    sums.drawbar_pull[k] += reading.drawbar_pull
    sums.load[k] += reading.load
    sums.torque[k] += reading.torque
    sums.readings[k] += 1.0
    if sums.readings[k] >= _BUCKET_READINGS:
        done = _complete(ids, k, numbers)
    return done


@part
def _complete(ids, k, numbers):
    """Close the open point, put it into the window and solve."""
    points, newest = ids.points, k * WINDOW + _free_slot(ids, k, numbers)
    ratio_sd = _close(ids, k, newest, numbers)
    readings, x = ids.open.readings[k], ids.trial[k]
    ids.open.readings[k] = 0.0
    share, gain, n = 1.0 / math.sqrt(readings), math.exp(x[GAIN]), numbers.reading
    predicted = weigh(
        points, newest, x, _variances(points.load[newest], readings, numbers), share * numbers.slip_sd,
        share * numbers.sinkage_sd, Reading(x[COHESION], n.exponent, n.radius, n.width, 0, False),
        math.sqrt(RATIO_ERROR * RATIO_ERROR + ratio_sd * ratio_sd), gain,
    )  # fmt: skip
    if newest > k * WINDOW and contradicts(points, newest, predicted, gain, n.exponent, ids.covariance[k]):
        # another soil: keep the newest point only, and nothing of the old estimate
        copy_column(points, newest, points, k * WINDOW)
        newest = k * WINDOW
        ids.open.held[k] = 0.0
    ids.count[k] = newest - k * WINDOW + 1
    _solve_window(ids, k, numbers)
    return True


@inlined
def _close(ids, k, p, numbers):
    """The mean of the open point into point p of the window; the relative error of its digging ratio."""
    sums, points = ids.open, ids.points
    readings = sums.readings[k]
    points.slip[p] = min(max(sums.slip[k] / readings, -0.999), 1.0)
    points.sinkage[p] = sums.sinkage[k] / readings
    points.drawbar_pull[p] = sums.drawbar_pull[k] / readings
    points.load[p] = sums.load[k] / readings
    points.torque[p] = sums.torque[k] / readings
    points.place[p] = sums.odometer[k]
    sums.slip[k] = sums.sinkage[k] = sums.drawbar_pull[k] = sums.load[k] = sums.torque[k] = 0.0
    r0, r1, ratio_sd = close_point(ids.digging, ids.places, k, readings, points.sinkage[p], numbers.sinkage_sd)
    points.dig_ratio[p], points.dig_response[p] = r0, r1
    return ratio_sd


@inlined
def _variances(load, readings, numbers):
    """Variances of drawbar pull, load and torque of a point: of the sensors and of the model."""
    error, sd = numbers.model_error * abs(load), numbers.force_sd
    twist = error * numbers.reading.radius
    return (
        sd[0] * sd[0] / readings + error * error,
        sd[1] * sd[1] / readings + error * error,
        sd[2] * sd[2] / readings + twist * twist,
    )


@inlined
def contradicts(points, p, predicted, gain, exponent, covariance):
    """Whether a point is further from its prediction than its own error and that of the estimate explain."""
    w, y = weights(points, p), predicted
    u = whitened(w, (points.drawbar_pull[p] - y.pull, points.load[p] - y.load, points.torque[p] - y.torque))
    response = gain * points.dig_response[p]
    dug = gain_share(exponent, response, points.dig_ratio[p] + response)
    s = whitened(w, y.by_S)
    j = (whitened(w, y.by_phi), whitened(w, y.by_K), s, whitened(w, y.by_c), (dug * s[0], dug * s[1], dug * s[2]))
    # I + J C J^T
    m00 = m11 = m22 = 1.0
    m10 = m20 = m21 = 0.0
    for p in range(SIZE):
        for q in range(SIZE):
            e, a, b = covariance[p, q], j[p], j[q]
            m00 += e * a[0] * b[0]
            m10 += e * a[1] * b[0]
            m11 += e * a[1] * b[1]
            m20 += e * a[2] * b[0]
            m21 += e * a[2] * b[1]
            m22 += e * a[2] * b[2]
    l10, l20 = m10 / m00, m20 / m00
    d1 = m11 - l10 * m10
    l21 = (m21 - l20 * m10) / d1
    y1 = u[1] - l10 * u[0]
    y2 = u[2] - l20 * u[0] - l21 * y1
    d2 = m22 - l20 * m20 - l21 * l21 * d1
    return u[0] * u[0] / m00 + y1 * y1 / d1 + y2 * y2 / d2 > CONTRADICTION_OF_POINT


@inlined
def _more_redundant(points, first_point, by_slip, by_sinkage):
    """Index of the older one of the two points of a full window that are closest in slip and sinkage."""
    slips = by_slip * from_array(points.slip, first_point)
    sinkages, far = by_sinkage * from_array(points.sinkage, first_point), fill(np.inf)
    closest, drop = np.inf, 0
    for p in range(WINDOW - 1):
        d = abs(slips - lane(slips, p)) + abs(sinkages - lane(sinkages, p))
        d = smallest(first(p + 1, far, d))  # p is the older one
        if d < closest:
            closest, drop = d, p
    return drop


@inlined
def _free_slot(ids, k, numbers):
    """Index for the next point, after dropping what is too far back, or the older of the two most alike if full."""
    points, start, place = ids.points, k * WINDOW, ids.open.odometer[k]
    kept = 0
    for p in range(ids.count[k]):
        if abs(place - points.place[start + p]) <= numbers.memory:
            if kept != p:
                copy_column(points, start + p, points, start + kept)
            kept += 1
    if kept == WINDOW:
        drop = _more_redundant(points, start, 1.0 / 0.1, 1.0 / (0.05 * numbers.reading.radius))
        for p in range(drop, WINDOW - 1):
            copy_column(points, start + p + 1, points, start + p)
        kept = WINDOW - 1
    ids.count[k] = kept
    return kept


@inlined
def _solve_window(ids, k, numbers):
    """Solve for the window and publish, or hold the last good estimate while the points do not excite."""
    covariance, trial, count = ids.covariance[k], ids.trial[k], ids.count[k]
    work = Workspace(_prepared(), _nodes())
    prepare(ids.points, k * WINDOW, count, numbers.reading, work)
    status, _, _ = least_squares(
        in_blocks, trial, ids.points, k * WINDOW, count, numbers.prior, numbers.precision, numbers.reading, SIZE, 20,
        1e-2, covariance, work,
    )  # fmt: skip
    learnt = 0.0
    for i in range(2):  # S shows in every point; friction and shear deformation modulus need a range of slip
        learnt = max(learnt, math.sqrt(covariance[i, i] * numbers.precision[i]))
    ids.condition[k] = learnt
    if status == Status.CONVERGED.value and learnt > 0.6:
        status = Status.NOT_EXCITED.value
    if status == Status.DIVERGED.value:
        for i in range(SIZE):
            trial[i] = numbers.prior[i]
    good = status == Status.CONVERGED.value
    if good:
        ids.open.held[k] = 1.0
    if good or (status == Status.NOT_EXCITED.value and ids.open.held[k] == 0.0):
        for i in range(SIZE):
            ids.estimate[k, i] = trial[i]
            ids.sd[k, i] = math.sqrt(covariance[i, i])
    else:  # held: the ground may have changed unseen
        for i in range(SIZE):
            ids.sd[k, i] = min(1.05 * ids.sd[k, i], 1.0 / math.sqrt(numbers.precision[i]))
    ids.status[k] = status
