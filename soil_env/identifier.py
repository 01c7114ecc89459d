"""Online identification: a moving window of informative points, an estimate, its standard deviation and its status.

The identifier sees sensor readings only. Readings of a few control periods at the same slip are averaged to a point;
the window keeps the points that are spread in slip and sinkage, drops the more redundant of two alike, forgets what
lies further back than its memory, and starts anew when a point contradicts the estimate (a new soil). Each completed
point triggers one safeguarded generalized Newton-Raphson solve (`identification.solve`) on drawbar pull, load and
torque, with the prior of the `Belief` as a further, weak measurement.

Slip and sinkage carry noise too. Their first-order effect on the three channels and a model error enter the weight of
each point (errors in variables by effective variance, Fuller 1987, Sec. 1.4). So does the doubt about the digging: a
point at which the wheel has dug says less of S. Cohesion and the gain of digging are held at the values of the belief,
wrongly: what that does to the estimate is the same error in all points and does not average out. It is added to the
covariance after the solve ("consider parameters", Schmidt 1966, Adv. Control Syst. 3:293-340).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env.compiled import inlined, kernel, pasted
from soil_env.effects import excavation_rate
from soil_env.identification.point import (
    DIG_RATIO,
    DRAWBAR_PULL,
    LOAD,
    PLACE,
    POINT_SIZE,
    SINKAGE,
    SLIP,
    TORQUE,
    Reading,
    weigh,
)
from soil_env.identification.solver import BLOCK, DIG, Status, dot, prepare, solve_prepared, whitened_block
from soil_env.lanes import COUNT, fill, first, from_array, lane, scratch, smallest, to_array, totals, transposed
from soil_env.parameters import Scenario

_work = scratch(BLOCK)
WINDOW = COUNT  # points: one block of lanes
_BUCKET_READINGS = 5  # readings averaged to one point, at most
_BUCKET_LENGTH = 0.06  # [m] travelled within one point, at most
_BUCKET_SLIP = 0.05  # slip range within one point, at most
_CONTRADICTION = 9.0  # chi-squared of three channels beyond which a point belongs to another soil
_MINIMUM_RIM_SPEED = 0.02  # [m/s] below which readings say nothing of shear

# Columns of `Identifiers.running`: sums of the open point, then the observers
_COUNT, _START, _FIRST_SLIP, _ODOMETER, _DIG, _HELD = 6, 7, 8, 9, 10, 11


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
    running: np.ndarray  # [wheels, 12]
    estimate: np.ndarray  # [wheels, 3] (phi [rad], ln K, ln S), the published estimate
    sd: np.ndarray  # [wheels, 3] its standard deviations
    status: np.ndarray  # [wheels] `Status`
    trial: np.ndarray  # [wheels, 3] the newest solution, published or not
    covariance: np.ndarray  # [wheels, 3, 3] scratch
    condition: np.ndarray  # [wheels] largest posterior over prior standard deviation (1 = nothing learnt)


class IdentifierNumbers(NamedTuple):
    """What the identifier takes from a `Scenario`."""

    reading: Reading
    prior: np.ndarray  # [3]
    precision: np.ndarray  # [3] of the prior
    slip_sd: float
    sinkage_sd: float
    force_sd: np.ndarray  # [3] drawbar pull [N], load [N], torque [N m]
    model_error: float
    cohesion_sd: float  # [Pa]
    dig_gain_sd: float  # relative
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
    sd = np.array([math.radians(b.friction_sd_deg), b.shear_modulus_sd, b.sinkage_coefficient_sd])
    forces_sd = np.array([n.drawbar_pull * weight, n.load * weight, n.torque * weight * w.radius])
    return IdentifierNumbers(
        Reading(b.cohesion, b.sinkage_exponent, w.radius, w.width, 0, False),
        np.array(prior),
        1.0 / sd**2,
        n.slip,
        n.sinkage,
        np.maximum(forces_sd, 1e-6 * weight),
        b.model_error,
        b.cohesion_sd,
        b.dig_gain_sd,
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
        np.zeros((wheels, 12)),
        np.zeros((wheels, 3)),
        np.zeros((wheels, 3)),
        np.zeros(wheels, dtype=np.int64),
        np.zeros((wheels, 3)),
        np.zeros((wheels, 3, 3)),
        np.ones(wheels),
    )


@kernel
def forget(ids, k, numbers):
    """Set identifier k back to its prior."""
    ids.count[k] = 0
    for i in range(ids.running.shape[1]):
        ids.running[k, i] = 0.0
    ids.running[k, _DIG] = 1.0
    for i in range(3):
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
    # how much deeper than its load requires the wheel stands: the world's law of sinkage driven by measured speeds
    a, b = excavation_rate(
        abs(reading.speed), abs(reading.rim_speed - reading.speed), numbers.dig_gain, numbers.dig_recovery,
        numbers.relaxation,
    )  # fmt: skip
    if a > 0.0:
        run[_DIG] = b / a + (run[_DIG] - b / a) * math.exp(-a * dt)
    run[_DIG] = max(run[_DIG], 1.0)

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
    run[DIG_RATIO] += run[_DIG]
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
    for i in range(6):
        row[i] = run[i] / run[_COUNT]
    row[SLIP] = min(max(row[SLIP], -0.999), 1.0)
    row[PLACE] = run[_ODOMETER]
    readings = run[_COUNT]
    error, sd = numbers.model_error * abs(row[LOAD]), numbers.force_sd
    twist = error * numbers.reading.radius
    variances = (
        sd[0] * sd[0] / readings + error * error, sd[1] * sd[1] / readings + error * error,
        sd[2] * sd[2] / readings + twist * twist,
    )  # fmt: skip
    share = 1.0 / math.sqrt(readings)
    weigh(
        row, ids.trial[k], variances, share * numbers.slip_sd, share * numbers.sinkage_sd, numbers.reading,
        numbers.dig_gain_sd,
    )  # fmt: skip
    for i in range(6):
        run[i] = 0.0
    run[_COUNT] = 0.0
    ids.count[k] += 1
    for _ in range(2):
        chi_squared = _solve_window(ids, k, numbers)
        if ids.count[k] == 1 or chi_squared <= _CONTRADICTION:
            break
        _copy_point(points, slot, 0)  # another soil: keep the newest point only, and nothing of the old estimate
        ids.count[k] = 1
        run[_HELD] = 0.0
    return True


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


@inlined
def _consider(x, count, numbers, covariance, work):
    """Widen `covariance` C by the uncertainty of cohesion and digging: + (C b)(C b)^T each, b = sum J^T W dy/dp sd.

    Returns the squared misfit of the last point under unknowns x, whitened by its noise alone.
    """
    misfit, phi, K, S, c = whitened_block(x, work, 0, numbers.reading)
    # d ln S_effective per sd of the gain
    dug = (-numbers.reading.exponent * numbers.dig_gain_sd) * (1.0 - 1.0 / from_array(work, DIG))
    chi = dot(misfit, misfit)
    c0, c1, c2, d0, d1, d2, _, _ = totals(
        dot(phi, c), dot(K, c), dot(S, c), dug * dot(phi, S), dug * dot(K, S), dug * dot(S, S), chi, chi
    )
    sd = numbers.cohesion_sd
    c0, c1, c2 = sd * c0, sd * c1, sd * c2
    m = covariance
    a0 = m[0, 0] * c0 + m[0, 1] * c1 + m[0, 2] * c2
    a1 = m[1, 0] * c0 + m[1, 1] * c1 + m[1, 2] * c2
    a2 = m[2, 0] * c0 + m[2, 1] * c1 + m[2, 2] * c2
    b0 = m[0, 0] * d0 + m[0, 1] * d1 + m[0, 2] * d2
    b1 = m[1, 0] * d0 + m[1, 1] * d1 + m[1, 2] * d2
    b2 = m[2, 0] * d0 + m[2, 1] * d1 + m[2, 2] * d2
    m[0, 0] += a0 * a0 + b0 * b0
    m[1, 1] += a1 * a1 + b1 * b1
    m[2, 2] += a2 * a2 + b2 * b2
    m[0, 1] = m[1, 0] = m[0, 1] + a0 * a1 + b0 * b1
    m[0, 2] = m[2, 0] = m[0, 2] + a0 * a2 + b0 * b2
    m[1, 2] = m[2, 1] = m[1, 2] + a1 * a2 + b1 * b2
    # without the doubt about digging in the weights (Sherman & Morrison 1950), which the window shares
    newest = count - 1
    along, size = lane(dug * dot(misfit, S), newest), lane(dug * dug * dot(S, S), newest)
    return lane(chi, newest) + along * along / max(1.0 - size, 0.05)


@pasted
def _solve_window(ids, k, numbers):
    """Solve for the window and publish, or hold the last good estimate while the points do not excite.

    Returns the squared whitened misfit of the newest point.
    """
    covariance, trial, count = ids.covariance[k], ids.trial[k], ids.count[k]
    work = _work()
    prepare(ids.points[k], count, numbers.reading, work)
    status, _, _ = solve_prepared(
        trial, ids.points[k], count, numbers.prior, numbers.precision, numbers.reading, 20, 1e-2, covariance, work
    )
    singular = covariance[0, 0] <= 0.0  # then the points say nothing, and there is no standard deviation to publish
    chi_squared = _consider(trial, count, numbers, covariance, work)
    learnt = 1.0 if singular else 0.0
    for i in range(2):  # S shows in every point; friction and shear modulus need a range of slip
        learnt = max(learnt, math.sqrt(covariance[i, i] * numbers.precision[i]))
    ids.condition[k] = learnt
    if status == Status.CONVERGED.value and learnt > 0.6:
        status = Status.NOT_EXCITED.value
    if status == Status.DIVERGED.value:
        for i in range(3):
            trial[i] = numbers.prior[i]
        misfit = whitened_block(trial, work, 0, numbers.reading)[0]
        chi_squared = lane(dot(misfit, misfit), count - 1)
    good = status == Status.CONVERGED.value
    if good:
        ids.running[k, _HELD] = 1.0
    if not singular and (good or (status == Status.NOT_EXCITED.value and ids.running[k, _HELD] == 0.0)):
        for i in range(3):
            ids.estimate[k, i] = trial[i]
            ids.sd[k, i] = math.sqrt(covariance[i, i])
    elif not good:  # held: the ground may have changed unseen
        for i in range(3):
            ids.sd[k, i] = min(1.05 * ids.sd[k, i], 1.0 / math.sqrt(numbers.precision[i]))
    ids.status[k] = status
    return chi_squared
