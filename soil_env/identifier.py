"""Online identification: a moving window of informative points, an estimate, its standard deviation and its status.

The identifier sees sensor readings only. Readings of a few control periods at the same slip are averaged to a point;
the window keeps the points that are spread in slip and sinkage, drops the more redundant of two alike, forgets what
lies further back than its memory, and starts anew when a point contradicts the estimate (a new soil). Each completed
point triggers one safeguarded generalized Newton-Raphson solve (`identification.solve`) on drawbar pull, load and
torque, with the prior of the `Belief` as a further, weak measurement.

Slip and sinkage carry noise too. Their first-order effect on the three channels and a model error enter the weight of
each point (errors in variables by effective variance, Fuller 1987, Sec. 1.4). Cohesion and digging are held at the
values of the belief, wrongly: what that does to the estimate is the same error in all points and does not average
out. It is added to the covariance after the solve ("consider parameters", Schmidt 1966, Adv. Control Syst.
3:293-340).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from soil_env.effects import excavation_rate
from soil_env.identification.solver import (
    DIG_RATIO,
    DRAWBAR_PULL,
    LOAD,
    PLACE,
    POINT_SIZE,
    SINKAGE,
    SLIP,
    TORQUE,
    WEIGHTS,
    Reading,
    Status,
    predict,
    solve,
    weigh,
)
from soil_env.parameters import Scenario

WINDOW = 8  # points
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


@njit(cache=True)
def forget(ids, k, numbers):
    """Set identifier k back to its prior."""
    ids.count[k] = 0
    ids.running[k, :] = 0.0
    ids.running[k, _DIG] = 1.0
    ids.estimate[k, :] = numbers.prior
    ids.trial[k, :] = numbers.prior
    for i in range(3):
        ids.sd[k, i] = 1.0 / math.sqrt(numbers.precision[i])
    ids.status[k] = Status.NO_DATA.value
    ids.condition[k] = 1.0


@njit(cache=True)
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


@njit(cache=True)
def _complete(ids, k, numbers):
    """Close the open point, put it into the window and solve."""
    run, points = ids.running[k], ids.points[k]
    slot = _free_slot(ids, k, run[_ODOMETER], numbers)
    row = points[slot]
    for i in range(6):
        row[i] = run[i] / run[_COUNT]
    row[SLIP] = min(max(row[SLIP], -0.999), 1.0)
    row[PLACE] = run[_ODOMETER]
    variances, readings = np.empty(3), run[_COUNT]
    for i in range(3):
        error = numbers.model_error * abs(row[LOAD]) * (numbers.reading.radius if i == 2 else 1.0)
        variances[i] = numbers.force_sd[i] ** 2 / readings + error * error
    share = 1.0 / math.sqrt(readings)
    weigh(row, ids.trial[k], variances, share * numbers.slip_sd, share * numbers.sinkage_sd, numbers.reading)
    for i in range(6):
        run[i] = 0.0
    run[_COUNT] = 0.0
    ids.count[k] += 1
    _solve_window(ids, k, numbers)
    if ids.count[k] > 1 and _chi_squared(row, ids.trial[k], numbers.reading) > _CONTRADICTION:
        points[0, :] = row  # another soil: keep the newest point only, and nothing of the old estimate
        ids.count[k] = 1
        run[_HELD] = 0.0
        _solve_window(ids, k, numbers)
    return True


@njit(cache=True)
def _free_slot(ids, k, place, numbers):
    """Index for the next point, after dropping what is too far back, or the older of the two most alike if full."""
    points = ids.points[k]
    kept = 0
    for p in range(ids.count[k]):
        if abs(place - points[p, PLACE]) <= numbers.memory:
            if kept != p:
                points[kept, :] = points[p]
            kept += 1
    if kept == WINDOW:
        closest, drop = np.inf, 0
        for p in range(WINDOW):
            for q in range(p + 1, WINDOW):  # p is the older one
                d = abs(points[p, SLIP] - points[q, SLIP]) / 0.1
                d += abs(points[p, SINKAGE] - points[q, SINKAGE]) / (0.05 * numbers.reading.radius)
                if d < closest:
                    closest, drop = d, p
        for p in range(drop, WINDOW - 1):
            points[p, :] = points[p + 1]
        kept = WINDOW - 1
    ids.count[k] = kept
    return kept


@njit(cache=True)
def _chi_squared(row, x, reading):
    """Squared whitened misfit of one point under unknowns x."""
    out, jac = np.empty(3), np.empty((3, 4))
    predict(x, row[SLIP], row[SINKAGE], row[DIG_RATIO], reading, out, jac)
    d0, d1, d2 = row[DRAWBAR_PULL] - out[0], row[LOAD] - out[1], row[TORQUE] - out[2]
    u0 = row[WEIGHTS] * d0
    u1 = row[WEIGHTS + 1] * d0 + row[WEIGHTS + 2] * d1
    u2 = row[WEIGHTS + 3] * d0 + row[WEIGHTS + 4] * d1 + row[WEIGHTS + 5] * d2
    return u0 * u0 + u1 * u1 + u2 * u2


@njit(cache=True)
def _consider(x, points, count, numbers, covariance):
    """Widen `covariance` C by the uncertainty of cohesion and digging: + (C b)(C b)^T each, b = sum J^T W dy/dp sd."""
    out, jac = np.empty(3), np.empty((3, 4))
    white, effect = np.empty((3, 3)), np.empty((3, 2))
    by = np.zeros((3, 2))
    n = numbers.reading.exponent
    for p in range(count):
        row = points[p]
        predict(x, row[SLIP], row[SINKAGE], row[DIG_RATIO], numbers.reading, out, jac)
        dug = -n * (1.0 - 1.0 / row[DIG_RATIO]) * numbers.dig_gain_sd  # d ln S_effective per sd of the gain
        for c in range(3):
            w0 = row[WEIGHTS + (0 if c == 0 else (1 if c == 1 else 3))]
            w1 = 0.0 if c == 0 else row[WEIGHTS + (2 if c == 1 else 4)]
            w2 = row[WEIGHTS + 5] if c == 2 else 0.0
            for i in range(3):
                white[c, i] = w0 * jac[0, i] + w1 * jac[1, i] + w2 * jac[2, i]
            effect[c, 0] = numbers.cohesion_sd * (w0 * jac[0, 3] + w1 * jac[1, 3] + w2 * jac[2, 3])
            effect[c, 1] = dug * white[c, 2]
        for i in range(3):
            for q in range(2):
                by[i, q] += white[0, i] * effect[0, q] + white[1, i] * effect[1, q] + white[2, i] * effect[2, q]
    for q in range(2):
        s0 = covariance[0, 0] * by[0, q] + covariance[0, 1] * by[1, q] + covariance[0, 2] * by[2, q]
        s1 = covariance[1, 0] * by[0, q] + covariance[1, 1] * by[1, q] + covariance[1, 2] * by[2, q]
        s2 = covariance[2, 0] * by[0, q] + covariance[2, 1] * by[1, q] + covariance[2, 2] * by[2, q]
        jac[0, q], jac[1, q], jac[2, q] = s0, s1, s2
    for i in range(3):
        for j in range(3):
            covariance[i, j] += jac[i, 0] * jac[j, 0] + jac[i, 1] * jac[j, 1]


@njit(cache=True)
def _solve_window(ids, k, numbers):
    """Solve for the window and publish, or hold the last good estimate while the points do not excite."""
    covariance = ids.covariance[k]
    status, _, _ = solve(
        ids.trial[k], ids.points[k], ids.count[k], numbers.prior, numbers.precision, numbers.reading, 20, 1e-2,
        covariance,
    )  # fmt: skip
    _consider(ids.trial[k], ids.points[k], ids.count[k], numbers, covariance)
    learnt = 0.0
    for i in range(2):  # S shows in every point; friction and shear modulus need a range of slip
        learnt = max(learnt, math.sqrt(covariance[i, i] * numbers.precision[i]))
    ids.condition[k] = learnt
    if status == Status.CONVERGED.value and learnt > 0.6:
        status = Status.NOT_EXCITED.value
    if status == Status.DIVERGED.value:
        ids.trial[k, :] = numbers.prior
    good = status == Status.CONVERGED.value
    if good:
        ids.running[k, _HELD] = 1.0
    if good or (status == Status.NOT_EXCITED.value and ids.running[k, _HELD] == 0.0):
        ids.estimate[k, :] = ids.trial[k]
        for i in range(3):
            ids.sd[k, i] = math.sqrt(covariance[i, i])
    elif not good:  # held: the ground may have changed unseen
        for i in range(3):
            ids.sd[k, i] = min(1.05 * ids.sd[k, i], 1.0 / math.sqrt(numbers.precision[i]))
    ids.status[k] = status
