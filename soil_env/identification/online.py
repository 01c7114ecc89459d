"""Online identification: a moving window of informative points, an estimate, its standard deviation and its status.

The identifier sees sensor readings only. Readings of a few control periods at the same slip are averaged to a point;
the window keeps the points that are spread in slip and sinkage, drops the more redundant of two alike, forgets what
lies further back than its memory, and starts anew when a point contradicts the estimate (a new soil). Each completed
point triggers one safeguarded generalized Newton-Raphson solve (`identification.joint`) on drawbar pull, load and
torque, with the prior of the `Belief` as a further, weak measurement.

Slip and sinkage carry noise too. Their first-order effect on the three channels and a model error enter the weight of
each point (errors in variables by effective variance, Fuller 1987, Sec. 1.4). How far the wheel has dug itself in is
followed from its own speeds and sinkage (`identification.digging`). Cohesion and the gain of digging are unknown too,
with the mean and the scatter of the belief, and are solved for with the other three.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, kernel, pasted
from soil_env._numba.lanes import COUNT, fill, first, from_array, lane, scratch, smallest, to_array, transposed
from soil_env.identification.digging import DIGGING, close_point, note, roll
from soil_env.identification.joint import COHESION, GAIN, SIZE, by_gain, solve_joint
from soil_env.identification.point import (
    DIG_RATIO,
    DIG_RESPONSE,
    DRAWBAR_PULL,
    LOAD,
    PLACE,
    POINT_SIZE,
    SINKAGE,
    SLIP,
    TORQUE,
    WEIGHTS,
    Reading,
    weigh,
)
from soil_env.identification.solver import BLOCK, Status, prepare, whitened
from soil_env.parameters import Scenario

_work = scratch(BLOCK)
WINDOW = COUNT  # points: one block of lanes
_BUCKET_READINGS = 5  # readings averaged to one point, at most
_BUCKET_LENGTH = 0.06  # [m] travelled within one point, at most
_BUCKET_SLIP = 0.05  # slip range within one point, at most
# chi-squared of three channels beyond which a point belongs to another soil. Low, since the doubts that a point is
# weighed with are larger than what differs between neighbours; set on courses of seeds 7 and 8, docs/identification.md
CONTRADICTION = 3.0
RATIO_ERROR = 0.07  # relative error of the digging ratio that the law of sinkage itself makes
KNOWN = 1e-4  # standard deviation, relative, of what the belief holds for known
_MINIMUM_RIM_SPEED = 0.02  # [m/s] below which readings say nothing of shear

# Columns of `Identifiers.running`: sums of the open point (one not used), then the observers
_COUNT, _START, _FIRST_SLIP, _ODOMETER, _HELD, _RUNNING = 6, 7, 8, 9, 10, 11


class SensorReading(NamedTuple):
    """One set of sensor readings."""

    slip: float
    sinkage: float  # [m]
    drawbar_pull: float  # [N]
    load: float  # [N]
    torque: float  # [N m]
    speed: float  # [m/s]
    rim_speed: float  # [m/s]


class Identifiers(NamedTuple):
    """Memory of many identifiers: arrays with one row a wheel."""

    points: np.ndarray  # [wheels, WINDOW, POINT_SIZE]
    count: np.ndarray  # [wheels] points in the window
    running: np.ndarray  # [wheels, 11]
    digging: np.ndarray  # [wheels, DIGGING]
    estimate: np.ndarray  # [wheels, 5] the published estimate, in the order of `IdentifierNumbers.prior`
    sd: np.ndarray  # [wheels, 5] its standard deviations
    status: np.ndarray  # [wheels] `Status`
    trial: np.ndarray  # [wheels, 5] the newest solution, published or not
    covariance: np.ndarray  # [wheels, 5, 5] of it
    condition: np.ndarray  # [wheels] largest posterior over prior standard deviation (1 = nothing learnt)


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


def identifier_numbers(scenario: Scenario) -> IdentifierNumbers:
    """Pack what `observe` needs; the noise of a channel is floored at a millionth so that weights stay finite."""
    b, n, w = scenario.belief, scenario.noise, scenario.wheel
    weight = scenario.weight
    prior = [math.radians(b.friction_angle_deg), math.log(b.shear_modulus), math.log(b.sinkage_coefficient)]
    sd = [math.radians(b.friction_sd_deg), b.shear_modulus_sd, b.sinkage_coefficient_sd]
    sd += [max(b.cohesion_sd, KNOWN * weight / (w.radius * w.width)), max(b.dig_gain_sd, KNOWN)]
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
    )


def new_identifiers(wheels: int) -> Identifiers:
    """Empty identifiers; `forget` sets one to the prior."""
    return Identifiers(
        np.zeros((wheels, WINDOW, POINT_SIZE)),
        np.zeros(wheels, dtype=np.int64),
        np.zeros((wheels, _RUNNING)),
        np.zeros((wheels, DIGGING)),
        np.zeros((wheels, SIZE)),
        np.zeros((wheels, SIZE)),
        np.zeros(wheels, dtype=np.int64),
        np.zeros((wheels, SIZE)),
        np.zeros((wheels, SIZE, SIZE)),
        np.ones(wheels),
    )


@kernel
def forget(ids, k, numbers):
    """Set identifier k back to its prior."""
    ids.count[k] = 0
    for i in range(ids.running.shape[1]):
        ids.running[k, i] = 0.0
    for i in range(DIGGING):
        ids.digging[k, i] = 0.0
    for i in range(SIZE):
        ids.estimate[k, i] = ids.trial[k, i] = numbers.prior[i]
        ids.sd[k, i] = 1.0 / math.sqrt(numbers.precision[i])
    ids.status[k] = Status.NO_DATA.value
    ids.condition[k] = 1.0


@pasted
def observe(ids, k, reading, numbers):
    """Take one set of readings; True if it completed a point and the estimate was solved again."""
    run = ids.running[k]
    dt = numbers.period
    run[_ODOMETER] += reading.speed * dt
    digging = ids.digging[k]
    roll(
        digging, reading.speed, reading.rim_speed - reading.speed, dt, numbers.dig_gain, numbers.dig_recovery,
        numbers.relaxation,
    )  # fmt: skip
    if abs(reading.rim_speed) < _MINIMUM_RIM_SPEED or reading.sinkage < 1e-3 * numbers.reading.radius:
        return False
    done = False
    if run[_COUNT] > 0.0 and (
        abs(reading.slip - run[_FIRST_SLIP]) > _BUCKET_SLIP or abs(run[_ODOMETER] - run[_START]) > _BUCKET_LENGTH
    ):
        done = _complete(ids, k, numbers)
    if run[_COUNT] == 0.0:
        run[_START], run[_FIRST_SLIP] = run[_ODOMETER], reading.slip
    run[SLIP] += reading.slip
    run[SINKAGE] += reading.sinkage
    note(digging)
    run[DRAWBAR_PULL] += reading.drawbar_pull
    run[LOAD] += reading.load
    run[TORQUE] += reading.torque
    run[_COUNT] += 1.0
    if run[_COUNT] >= _BUCKET_READINGS:
        done = _complete(ids, k, numbers)
    return done


@pasted
def _complete(ids, k, numbers):
    """Close the open point, put it into the window and solve."""
    run, points = ids.running[k], ids.points[k]
    slot = _free_slot(ids, k, run[_ODOMETER], numbers)
    row = points[slot]
    readings = run[_COUNT]
    for i in range(6):
        row[i] = run[i] / readings
        run[i] = 0.0
    run[_COUNT] = 0.0
    row[SLIP] = min(max(row[SLIP], -0.999), 1.0)
    row[PLACE] = run[_ODOMETER]
    row[DIG_RATIO], row[DIG_RESPONSE], ratio_sd = close_point(
        ids.digging[k], readings, row[SINKAGE], numbers.sinkage_sd
    )  # fmt: skip
    error, sd, x = numbers.model_error * abs(row[LOAD]), numbers.force_sd, ids.trial[k]
    twist = error * numbers.reading.radius
    variances = (
        sd[0] * sd[0] / readings + error * error, sd[1] * sd[1] / readings + error * error,
        sd[2] * sd[2] / readings + twist * twist,
    )  # fmt: skip
    share, gain, n = 1.0 / math.sqrt(readings), math.exp(x[GAIN]), numbers.reading
    predicted = weigh(
        row, x, variances, share * numbers.slip_sd, share * numbers.sinkage_sd,
        Reading(x[COHESION], n.exponent, n.radius, n.width, 0, False),
        math.sqrt(RATIO_ERROR * RATIO_ERROR + ratio_sd * ratio_sd), gain,
    )  # fmt: skip
    if slot > 0 and contradicts(row, predicted, gain, n.exponent, ids.covariance[k]):
        # another soil: keep the newest point only, and nothing of the old estimate
        _copy_point(points, slot, 0)
        slot = 0
        run[_HELD] = 0.0
    ids.count[k] = slot + 1
    _solve_window(ids, k, numbers)
    return True


@inlined
def contradicts(row, predicted, gain, exponent, covariance):
    """Whether a point is further from its prediction than its own error and that of the estimate explain."""
    w = row[WEIGHTS:]
    u = whitened(w, row[DRAWBAR_PULL] - predicted.pull, row[LOAD] - predicted.load, row[TORQUE] - predicted.torque)
    s, c = predicted.by_S, predicted.by_c
    response = gain * row[DIG_RESPONSE]
    dug = by_gain(exponent, response, row[DIG_RATIO] + response)
    s = whitened(w, s[0], s[1], s[2])
    j = (
        whitened(w, predicted.by_phi[0], predicted.by_phi[1], predicted.by_phi[2]),
        whitened(w, predicted.by_K[0], predicted.by_K[1], predicted.by_K[2]),
        s,
        whitened(w, c[0], c[1], c[2]),
        (dug * s[0], dug * s[1], dug * s[2]),
    )
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
    return u[0] * u[0] / m00 + y1 * y1 / d1 + y2 * y2 / d2 > CONTRADICTION


@inlined
def _copy_point(points, source, target):
    for start in range(0, POINT_SIZE, COUNT):
        to_array(from_array(points, source * POINT_SIZE + start), points, target * POINT_SIZE + start)


@inlined
def _more_redundant(points, by_slip, by_sinkage):
    """Index of the older one of the two points of a full window that are closest in slip and sinkage."""
    columns = transposed(
        from_array(points, 0), from_array(points, POINT_SIZE), from_array(points, 2 * POINT_SIZE),
        from_array(points, 3 * POINT_SIZE), from_array(points, 4 * POINT_SIZE), from_array(points, 5 * POINT_SIZE),
        from_array(points, 6 * POINT_SIZE), from_array(points, 7 * POINT_SIZE),
    )  # fmt: skip
    slips, sinkages, far = by_slip * columns[SLIP], by_sinkage * columns[SINKAGE], fill(np.inf)
    closest, drop = np.inf, 0
    for p in range(WINDOW - 1):
        d = abs(slips - lane(slips, p)) + abs(sinkages - lane(sinkages, p))
        d = smallest(first(p + 1, far, d))  # p is the older one
        if d < closest:
            closest, drop = d, p
    return drop


@inlined
def _free_slot(ids, k, place, numbers):
    """Index for the next point, after dropping what is too far back, or the older of the two most alike if full."""
    points = ids.points[k]
    kept = 0
    for p in range(ids.count[k]):
        if abs(place - points[p, PLACE]) <= numbers.memory:
            if kept != p:
                _copy_point(points, p, kept)
            kept += 1
    if kept == WINDOW:
        drop = _more_redundant(points, 1.0 / 0.1, 1.0 / (0.05 * numbers.reading.radius))
        for p in range(drop, WINDOW - 1):
            _copy_point(points, p + 1, p)
        kept = WINDOW - 1
    ids.count[k] = kept
    return kept


@pasted
def _solve_window(ids, k, numbers):
    """Solve for the window and publish, or hold the last good estimate while the points do not excite."""
    covariance, trial, count = ids.covariance[k], ids.trial[k], ids.count[k]
    work = _work()
    prepare(ids.points[k], count, numbers.reading, work)
    status = solve_joint(trial, numbers.prior, numbers.precision, numbers.reading, 20, 1e-2, covariance, work)
    learnt = 0.0
    for i in range(2):  # S shows in every point; friction and shear modulus need a range of slip
        learnt = max(learnt, math.sqrt(covariance[i, i] * numbers.precision[i]))
    ids.condition[k] = learnt
    if status == Status.CONVERGED.value and learnt > 0.6:
        status = Status.NOT_EXCITED.value
    if status == Status.DIVERGED.value:
        for i in range(SIZE):
            trial[i] = numbers.prior[i]
    good = status == Status.CONVERGED.value
    if good:
        ids.running[k, _HELD] = 1.0
    if good or (status == Status.NOT_EXCITED.value and ids.running[k, _HELD] == 0.0):
        for i in range(SIZE):
            ids.estimate[k, i] = trial[i]
            ids.sd[k, i] = math.sqrt(covariance[i, i])
    else:  # held: the ground may have changed unseen
        for i in range(SIZE):
            ids.sd[k, i] = min(1.05 * ids.sd[k, i], 1.0 / math.sqrt(numbers.precision[i]))
    ids.status[k] = status
