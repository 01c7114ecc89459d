"""Online identification by the filter (`filter`) or by the moving window: estimate, standard deviations, status.

Both see sensor readings only. The window, the cheaper one, is in this file. Readings of a few control periods at the
same slip are averaged to a point; the window keeps the points that are spread in slip and sinkage, drops the more
redundant of two alike, forgets what lies further back than its memory, and starts anew when a point contradicts the
estimate (a new soil). Each completed point triggers one safeguarded generalized Newton-Raphson solve (`solver`) on
drawbar pull, load and torque, with the prior of the `Belief` as a further, weak measurement.

Slip and sinkage carry noise too. Their first-order effect on the three channels and a model error enter the weight of
each point (errors in variables by effective variance, Fuller 1987, Sec. 1.4). How far the wheel has dug itself in is
followed from its own speeds and sinkage (`identification.digging`). Cohesion and the gain of digging are unknown too,
with the mean and the scatter of the belief, and are solved for with the other three.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, part, root
from soil_env._numba.lanes import COUNT, fill, first, from_array, lane, smallest
from soil_env._numba.rows import Rows, copy_column, rows, scratch_rows, zero_column
from soil_env.identification.digging import KEPT, Digging, DiggingPlaces, close_point, note, roll
from soil_env.identification.filter import CONTRADICTION_OF_POINTS, take
from soil_env.identification.filter_bank import STAYS, FilterBanks, FilterNumbers, filter_numbers, new_banks, restart
from soil_env.identification.filter_estimate import publish
from soil_env.identification.mixture_prior import moments, prior_of_belief
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
from soil_env.identification.point import Points, Reading, weigh, weights, whitened
from soil_env.identification.solver import (
    Status,
    least_squares,
)
from soil_env.parameters import Scenario
from soil_env.terramechanics.arc_integrals import (
    NODE_COLUMNS,
    Nodes,
)

_prepared, _nodes = scratch_rows(Prepared, COUNT), scratch_rows(Nodes, NODE_COLUMNS)
WINDOW = COUNT  # points: one block of lanes
_BUCKET_READINGS = 5  # readings averaged to one point, at most
_BUCKET_LENGTH = 0.06  # [m] travelled within one point, at most
_BUCKET_SLIP = 0.05  # slip range within one point, at most
# chi-squared of three channels beyond which a point belongs to another soil. Low, since the doubts that a point is
# weighed with are larger than what differs between neighbours; set on courses of seeds 7 and 8, docs/identification.md
CONTRADICTION_OF_POINT = 3.0
RATIO_ERROR = 0.07  # relative error of the digging ratio that the law of sinkage itself makes
#: What a set of readings did to the estimate: nothing; the wheel is elsewhere on a border, and so on other ground; it
#: completed a point.
HELD, MOVED, RENEWED = 0, 1, 2
FARTHEST = 60.0  # |ln| of K, of S and of the gain over its prior, beyond which an estimate is that of no soil
KNOWN = 1e-4  # standard deviation, relative, of what the belief holds for known
_HALF = math.log(0.5)  # ln probability of the soil having stayed the same, below which a border is counted
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


class SensorReading(NamedTuple):
    """One set of sensor readings."""

    slip: float
    sinkage: float  # [m]
    drawbar_pull: float  # [N]
    load: float  # [N]
    torque: float  # [N m]
    speed: float  # [m/s]
    rim_speed: float  # [m/s]
    pitch: float  # [rad], uphill positive
    motor_torque: float  # [N m]
    acceleration: float  # [m/s2] of an accelerometer along the course: that of travel, and g sin(grade)


class Identifiers(NamedTuple):
    """Memory of many identifiers: arrays with one row a wheel."""

    points: Rows  # Points, WINDOW columns a wheel
    count: np.ndarray  # [wheels] points in the window
    open: Rows  # OpenPoint
    digging: Rows  # Digging
    places: Rows  # DiggingPlaces, KEPT columns a wheel
    estimate: np.ndarray  # [wheels, 5] the published estimate, in the order of `IdentifierNumbers.prior`
    sd: np.ndarray  # [wheels, 5] its standard deviations
    status: np.ndarray  # [wheels] `Status`
    trial: np.ndarray  # [wheels, 5] the newest solution, published or not
    covariance: np.ndarray  # [wheels, 5, 5] of it
    condition: np.ndarray  # [wheels] largest posterior over prior standard deviation (1 = nothing learnt)
    banks: FilterBanks  # of the method "filter"
    borders: np.ndarray  # [wheels] to another soil that the filter has found since `forget`


class Replay(NamedTuple):
    """What each of T sets of readings did, and what was known after it."""

    outcome: np.ndarray  # [T] `HELD`, `MOVED` or `RENEWED`
    estimate: np.ndarray  # [T, 5] as in `Identifiers`
    sd: np.ndarray  # [T, 5]
    status: np.ndarray  # [T] `Status`


def new_replay(count: int) -> Replay:
    """For `observe_rows` with `count` sets of readings."""
    whole = np.zeros((2, count), dtype=np.int64)
    return Replay(whole[0], np.zeros((count, 5)), np.zeros((count, 5)), whole[1])


class IdentifierNumbers(NamedTuple):
    """What the identifier takes from a `Scenario`."""

    reading: Reading
    prior: np.ndarray  # [5] of (phi, ln K, ln S, cohesion, ln(gain of digging / dig_gain))
    precision: np.ndarray  # [5] of the prior
    slip_sd: float
    sinkage_sd: float
    force_sd: np.ndarray  # [3] drawbar pull [N], load [N], torque [N m]
    model_error: float
    dig_gain: float
    dig_recovery: float
    relaxation: float  # [m]
    memory: float  # [m]
    period: float  # [s]
    by_filter: bool
    off: bool  # nothing is identified
    filter: FilterNumbers


def identifier_numbers(scenario: Scenario) -> IdentifierNumbers:
    """Pack what `observe` needs; the noise of a channel is floored at a millionth so that weights stay finite."""
    b, n, w = scenario.belief, scenario.noise, scenario.wheel
    weight = scenario.weight
    prior = [math.radians(b.friction_angle_deg), math.log(b.shear_modulus), math.log(b.sinkage_coefficient)]
    sd = [math.radians(b.friction_sd_deg), b.shear_modulus_sd, b.sinkage_coefficient_sd]
    sd += [max(b.cohesion_sd, KNOWN * weight / (w.radius * w.width)), max(b.dig_gain_sd, KNOWN)]
    if b.method == "filter" and b.soils:  # the first two moments of the library
        mean, covariance = moments(prior_of_belief(scenario))
        prior, sd = [*mean[:3]], [*np.sqrt(np.diag(covariance))[:3], *sd[3:]]
    forces_sd = np.array([n.drawbar_pull * weight, n.load * weight, n.torque * weight * w.radius])
    return IdentifierNumbers(
        Reading(b.cohesion, b.sinkage_exponent, w.radius, w.width, 0, False),
        np.array([*prior, b.cohesion, 0.0]),
        1.0 / np.square(sd),
        n.slip,
        n.sinkage,
        np.maximum(forces_sd, 1e-6 * weight),
        b.model_error,
        b.dig_gain,
        b.dig_recovery,
        scenario.relaxation * w.radius,
        b.memory,
        scenario.control.period,
        b.method == "filter",
        b.method == "none",
        filter_numbers(scenario),
    )


def new_identifiers(wheels: int) -> Identifiers:
    """Empty identifiers; `forget` sets one to the prior."""
    return Identifiers(
        Points(wheels * WINDOW),
        np.zeros(wheels, dtype=np.int64),
        OpenPoint(wheels),
        Digging(wheels),
        DiggingPlaces(wheels * KEPT),
        np.zeros((wheels, SIZE)),
        np.zeros((wheels, SIZE)),
        np.zeros(wheels, dtype=np.int64),
        np.zeros((wheels, SIZE)),
        np.zeros((wheels, SIZE, SIZE)),
        np.ones(wheels),
        new_banks(wheels),
        np.zeros(wheels, dtype=np.int64),
    )


@part
def forget(ids, k, numbers):
    """Set identifier k back to its prior."""
    ids.count[k] = ids.borders[k] = 0
    zero_column(ids.open, k)
    zero_column(ids.digging, k)
    for i in range(SIZE):
        ids.estimate[k, i] = ids.trial[k, i] = numbers.prior[i]
        ids.sd[k, i] = 1.0 / math.sqrt(numbers.precision[i])
    ids.status[k] = Status.NO_DATA.value
    ids.condition[k] = 1.0
    restart(ids.banks, k, numbers.filter)


@inlined
def observe(ids, k, reading, numbers):
    """Take one set of readings: `HELD`, `MOVED` or `RENEWED`."""
    if numbers.off:
        return HELD
    if numbers.by_filter:
        return _observe_by_filter(ids, k, reading, numbers)
    return _observe_by_window(ids, k, reading, numbers)


@root(nogil=True)
def observe_rows(
    ids: Identifiers,
    wheels: np.ndarray,
    readings: np.ndarray,
    numbers: IdentifierNumbers,
    replay: Replay,
) -> None:
    """`observe` of `readings` [T, 10], in the order of `SensorReading`; row t is of wheel `wheels[t]`."""
    for t in range(wheels.size):
        k, r = wheels[t], readings[t]
        reading = SensorReading(r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9])
        replay.outcome[t] = observe(ids, k, reading, numbers)
        for i in range(replay.estimate.shape[1]):
            replay.estimate[t, i], replay.sd[t, i] = ids.estimate[k, i], ids.sd[k, i]
        replay.status[t] = ids.status[k]


@inlined
def _observe_by_filter(ids, k, reading, numbers):
    p, crossed = ids.banks.point, ids.banks.point.crossing[k]
    done = take(ids.banks, k, reading, numbers.filter)
    if not done and p.crossing[k] == 0.0:
        return HELD
    if p.crossing[k] > crossed:
        ids.borders[k] += int(p.by_forces[k])
    elif p.crossing[k] < crossed and p.by_forces[k] == 0.0 and ids.banks.log_weight[k, STAYS] < _HALF:
        ids.borders[k] += 1  # the grade told of a border, and it was one of soil
    # on a border the soil under the wheel changes from reading to reading
    publish(ids.banks, k, numbers.filter, ids.estimate[k], ids.sd[k], ids.covariance[k])
    if max(abs(ids.estimate[k, 1]), abs(ids.estimate[k, 2]), abs(ids.estimate[k, 4])) > FARTHEST:
        forget(ids, k, numbers)
        return RENEWED
    learnt = 0.0
    for i in range(2):  # friction and shear deformation modulus need a range of slip
        learnt = max(learnt, ids.sd[k, i] * math.sqrt(numbers.precision[i]))
    ids.condition[k] = learnt
    if p.misfit[k] > CONTRADICTION_OF_POINTS:
        ids.status[k] = Status.MISFIT.value
    else:
        ids.status[k] = Status.CONVERGED.value if learnt <= 0.6 else Status.NOT_EXCITED.value
    return RENEWED if done else MOVED


@inlined
def _observe_by_window(ids, k, reading, numbers):
    """`observe` by the moving window."""
    sums, digging, dt = ids.open, ids.digging, numbers.period
    sums.odometer[k] += reading.speed * dt
    roll(
        digging, k, reading.speed, reading.rim_speed - reading.speed, dt, numbers.dig_gain, numbers.dig_recovery,
        numbers.relaxation,
    )  # fmt: skip
    if reading.rim_speed < _MINIMUM_RIM_SPEED or reading.sinkage < 1e-3 * numbers.reading.radius:
        return HELD
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
    return RENEWED if done else HELD


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
