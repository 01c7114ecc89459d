"""Updates of a bank of filters (`filter`) by a point."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, part
from soil_env._numba.elementary import exp, larger, log, root, smaller, tanh
from soil_env._numba.lanes import COUNT, fill, from_array, scratch, smallest, to_array, total
from soil_env._numba.rows import scratch_rows
from soil_env.identification.border import blend, by_both_soils
from soil_env.identification.filter_bank import (
    CROSSING,
    MEANS,
    OLD,
    PLACE,
    RISE,
    element,
    reference_of,
)
from soil_env.identification.linearised import (
    COLUMNS,
    GAIN,
    MASS,
    SINKAGE,
    SLIP,
    STATES,
    Linearised,
    linearise,
)
from soil_env.slip import motion_from_slip

_YIELD_RATE = 6.0  # [1/s] at which a wheel comes up to its bearing sinkage, in the mean over a point
_LAG = 0.5  # of the change of the bearing sinkage since the last point: what the wheel has not borne on yet
# 1-sigma of the law of sinkage: of the radius, of the change, of the sinkage, of the change of the bearing sinkage
_LEAST_MOVE, _MOVE, _JOLT, _CHANGE = 6.3e-3, 0.1, 0.9, 0.5
_DRIFT = 2e-3  # [m] of the place of a border between two points: that of the ground which a step was made with
_LOWEST = np.array([0.005, math.log(2e-4), math.log(1e3), -1000.0, 0.3, -3.0, 1e-4, 0.05, -0.95])
_HIGHEST = np.array([5.0, math.log(0.3), math.log(1e13), 2e5, 2.5, 3.0, 6.0, 1e6, 0.98])
_at, _ground, _slopes, _gain = scratch(MEANS), scratch(MEANS), scratch(MEANS), scratch(MEANS)
_linear, _expanded = scratch_rows(Linearised, COLUMNS), scratch_rows(Linearised, (CROSSING + 1) * COUNT)


class Point(NamedTuple):
    """Means over the readings of a point, and the motion since the last."""

    readings: float
    slip: float
    sinkage: float
    drawbar_pull: float
    load: float
    torque: float
    speed: float
    rim_speed: float
    pitch: float
    cos_pitch: float
    motor_torque: float  # [N m] less what turns the wheel faster
    acceleration: float
    motor_variance: float
    path: float
    sliding: float
    shock: float
    time: float
    place: float  # [m] mean
    spread: float  # [m] sd of the places


# --- the update -------------------------------------------------------------------------------------------------------


@inlined
def _copy(source, target, size):
    for i in range(0, size, COUNT):
        to_array(from_array(source, i), target, i)


@inlined
def _clip(x, size):
    for i in range(STATES):
        to_array(smaller(larger(from_array(x, i * COUNT), _LOWEST[i]), _HIGHEST[i]), x, i * COUNT)
    if size > STATES:
        for i in range(SINKAGE):
            j = (OLD + i) * COUNT
            to_array(smaller(larger(from_array(x, j), _LOWEST[i]), _HIGHEST[i]), x, j)


@inlined
def times(covariance, slopes, out, size):
    """Covariance times slopes, both of `size` states, into `out`; slopes . covariance . slopes."""
    square = fill(0.0)
    for i in range(size):
        v, place = fill(0.0), element(i, 0)
        for j in range(i):
            v = v + from_array(covariance, place + j * COUNT) * from_array(slopes, j * COUNT)
        place += i * COUNT
        for j in range(i, size):
            v = v + from_array(covariance, place) * from_array(slopes, j * COUNT)
            place += (j + 1) * COUNT
        to_array(v, out, i * COUNT)
        square = square + v * from_array(slopes, i * COUNT)
    return square


@inlined
def _normal_share(x):
    """(P, p): distribution and density of the standard normal; P to 2e-4 (Page 1977, Applied Statistics 26:75-76)."""
    share = 0.5 + 0.5 * tanh(0.7988 * (x + 0.04417 * x * x * x))
    return share, 0.3989422804014327 * exp(-0.5 * smaller(x * x, 1400.0))


@inlined
def _drive(mean, covariance, ground, gain_slopes, out, size, last_bearing, point, numbers):
    """The sinkage of a bank from the last point to this one (`effects.excavation_rate`), and a slip not yet updated."""
    slopes, product, r = _slopes(), _gain(), numbers.radius
    a = max(point.path, 1e-12)
    left = math.exp(-a)
    come = 1.0 - left
    gain = numbers.dig_gain * exp(from_array(ground, GAIN * COUNT))
    now = exp(smaller(from_array(out.ln_bearing, size * COUNT), math.log(2.0 * r)))
    change = last_bearing - now if last_bearing > 0.0 else fill(0.0)
    z, bearing = from_array(mean, SINKAGE * COUNT), now + _LAG * change
    dug = (point.sliding * come / a) * gain * bearing
    for i in range(size):
        by_bearing = now * from_array(out.ln_bearing, i * COUNT)
        to_array(by_bearing - 1.0 if i == SINKAGE else by_bearing, slopes, i * COUNT)
    to_array(fill(0.0), slopes, SLIP * COUNT)
    # comes up to the bearing sinkage: a share of the mean of what it lacks, where it lacks any
    variance = times(covariance, slopes, product, size)
    spread, lag = root(variance + 1e-7 * r * r), bearing - z
    likely, density = _normal_share(lag / spread)
    lacking = lag * likely + spread * density
    scatter = (lag * lag + spread * spread) * likely + lag * (spread * density) - lacking * lacking
    yields = left * (1.0 - math.exp(-_YIELD_RATE * max(point.time, 0.0)))
    rise = (come * bearing + dug) / bearing
    for i in range(size):
        v = from_array(slopes, i * COUNT) * (yields * likely) + dug * from_array(gain_slopes, i * COUNT)
        to_array(v + rise * (now * from_array(out.ln_bearing, i * COUNT)), slopes, i * COUNT)
    to_array(from_array(slopes, SINKAGE * COUNT) + left, slopes, SINKAGE * COUNT)
    to_array(fill(0.0), slopes, SLIP * COUNT)
    variance = times(covariance, slopes, product, size)
    after = come * bearing + dug + left * z + yields * lacking
    move, jolt, changed = _MOVE * (after - z), _JOLT * point.shock * z, (_CHANGE * come) * change
    own = (
        (_LEAST_MOVE * r) * (_LEAST_MOVE * r)
        + move * move
        + jolt * jolt
        + changed * changed
        + (yields * yields) * larger(scatter - likely * likely * spread * spread, 0.0)
    )
    to_array(after, mean, SINKAGE * COUNT)
    for i in range(size):
        to_array(from_array(product, i * COUNT), covariance, element(SINKAGE, i))
        to_array(fill(0.0), covariance, element(SLIP, i))
    to_array(variance + own, covariance, element(SINKAGE, SINKAGE))
    drift = numbers.load_drift * from_array(mean, MASS * COUNT)
    to_array(from_array(covariance, element(MASS, MASS)) + drift * drift, covariance, element(MASS, MASS))
    to_array(fill(point.slip), mean, SLIP * COUNT)
    to_array(fill(numbers.noise[0] * numbers.noise[0] / point.readings), covariance, element(SLIP, SLIP))


@inlined
def _correct(mean, covariance, product, misfit, expected, size):
    """Kalman update by a value whose covariance with the states is `product`: (chi-squared, ln of its variance)."""
    step, scale, place = misfit / expected, 1.0 / expected, 0
    for i in range(size):
        v = from_array(product, i * COUNT)
        to_array(from_array(mean, i * COUNT) + v * step, mean, i * COUNT)
        v = v * scale
        for j in range(i + 1):
            to_array(from_array(covariance, place) - v * from_array(product, j * COUNT), covariance, place)
            place += COUNT
    return misfit * step, log(expected)


@inlined
def _absorb(mean, covariance, at, slopes, predicted, measured, variance, size):
    """The update of both: of `size` states."""
    product = _gain()
    misfit = measured - predicted
    for i in range(size):
        misfit = misfit - from_array(slopes, i * COUNT) * (from_array(mean, i * COUNT) - from_array(at, i * COUNT))
    expected = times(covariance, slopes, product, size) + variance
    return _correct(mean, covariance, product, misfit, expected, size)


@part
def absorb(mean, covariance, at, slopes, predicted, measured, variance):
    """`absorb_on_border` with the states of one soil only; apart, so that the loops have constant bounds."""
    return _absorb(mean, covariance, at, slopes, predicted, measured, variance, STATES)


@part
def absorb_on_border(mean, covariance, at, slopes, predicted, measured, variance):
    """Kalman update by one value, linearised at `at`: (chi-squared, ln of its expected variance)."""
    return _absorb(mean, covariance, at, slopes, predicted, measured, variance, CROSSING)


@inlined
def _absorb_any(mean, covariance, at, slopes, predicted, measured, variance, size):
    if size > STATES:
        return absorb_on_border(mean, covariance, at, slopes, predicted, measured, variance)
    return absorb(mean, covariance, at, slopes, predicted, measured, variance)


@inlined
def _absorb_state(mean, covariance, at, state, slope, predicted, measured, variance, size):
    """As `_absorb`, of a value that depends on one state only."""
    product = _gain()
    for i in range(size):
        to_array(slope * from_array(covariance, element(i, state)), product, i * COUNT)
    misfit = measured - predicted - slope * (from_array(mean, state * COUNT) - from_array(at, state * COUNT))
    expected = slope * from_array(product, state * COUNT) + variance
    return _correct(mean, covariance, product, misfit, expected, size)


@inlined
def _measure(mean, covariance, at, out, size, point, numbers):
    """All channels of a point: (chi-squared, sum of the logarithms of their expected variances)."""
    slopes, sd, n = _slopes(), numbers.noise, point.readings
    model = numbers.model_error * abs(point.load)
    force, mass, slip = numbers.gravity * point.cos_pitch, from_array(at, MASS * COUNT), from_array(at, SLIP * COUNT)
    v = fill(sd[3] * sd[3] / n)
    x2, logs = _absorb_state(mean, covariance, at, MASS, fill(force), force * mass, fill(point.load), v, size)
    z, v = from_array(at, SINKAGE * COUNT), fill(sd[1] * sd[1] / n)
    a, b = _absorb_state(mean, covariance, at, SINKAGE, fill(1.0), z, fill(point.sinkage), v, size)
    x2, logs = x2 + a, logs + b
    travel = motion_from_slip(slip)[1]
    braking = larger(travel, 1.0)  # V/(r w) where it brakes, whose slope by the slip is its square
    slope, v = (-point.rim_speed) * braking * braking, fill((sd[5] * sd[5] + sd[6] * sd[6]) / n)
    speed = point.rim_speed * travel
    a, b = _absorb_state(mean, covariance, at, SLIP, slope, speed, fill(point.speed), v, size)
    x2, logs = x2 + a, logs + b
    pull, torque = from_array(out.pull, size * COUNT), from_array(out.torque, size * COUNT)
    twist = (model * numbers.radius) * (model * numbers.radius)
    v = fill(sd[2] * sd[2] / n + model * model)
    a, b = _absorb_any(mean, covariance, at, out.pull, pull, fill(point.drawbar_pull), v, size)
    x2, logs = x2 + a, logs + b
    v = fill(sd[4] * sd[4] / n + twist)
    a, b = _absorb_any(mean, covariance, at, out.torque, torque, fill(point.torque), v, size)
    x2, logs = x2 + a, logs + b
    v = fill(point.motor_variance + twist)
    a, b = _absorb_any(mean, covariance, at, out.torque, torque, fill(point.motor_torque), v, size)
    x2, logs = x2 + a, logs + b
    for i in range(size):
        to_array(from_array(out.pull, i * COUNT) / mass, slopes, i * COUNT)
    to_array(from_array(slopes, MASS * COUNT) - pull / (mass * mass), slopes, MASS * COUNT)
    v = (model / mass) * (model / mass) + sd[9] * sd[9] / n
    a, b = _absorb_any(mean, covariance, at, slopes, pull / mass, fill(point.acceleration), v, size)
    return x2 + a, logs + b


@inlined
def _measure_grade(mean, covariance, at, b, grade, grades, point, numbers):
    """The pitch of a point on a border: as `_measure`."""
    slopes, rise = _slopes(), from_array(at, RISE * COUNT)
    for i in range(CROSSING):
        to_array(fill(0.0), slopes, i * COUNT)
    to_array(b.share, slopes, RISE * COUNT)
    to_array(b.by_place * rise, slopes, PLACE * COUNT)
    variance = numbers.noise[7] * numbers.noise[7] * (1.0 / point.readings + 1.0 / max(min(grades, 60.0), 1.0))
    return absorb_on_border(mean, covariance, at, slopes, b.share * rise, fill(point.pitch - grade), fill(variance))


@inlined
def _weigh(log_weight, old, x2, logs):
    """Renew the weights of the filters by the likelihood of a point; its chi-squared under their mixture."""
    least = smallest(x2)
    misfit = least - 2.0 * math.log(max(total(old * exp(-0.5 * (x2 - least))), 1e-300))
    new = from_array(log_weight, 0) - 0.5 * (x2 + logs)
    highest = -smallest(-1.0 * new)
    new = larger(new - highest, -700.0)
    to_array(new - math.log(total(exp(new))), log_weight, 0)
    return misfit


@inlined
def _finish(banks, k, at, out, size):
    """After the update of bank k, linearised at `at`: its states within bounds, its bearing sinkage and border."""
    p, mean, w = banks.point, banks.mean[k], exp(from_array(banks.log_weight[k], 0))
    _clip(mean, size)
    ln_bearing = from_array(out.ln_bearing, size * COUNT)
    for i in range(size):
        away = from_array(mean, i * COUNT) - from_array(at, i * COUNT)
        ln_bearing = ln_bearing + from_array(out.ln_bearing, i * COUNT) * away
    to_array(ln_bearing, banks.ln_bearing[k], 0)
    p.bearing[k] = total(w * exp(smaller(ln_bearing, 1.0)))
    if size > STATES:
        p.border[k] = total(w * from_array(mean, PLACE * COUNT))


@part
def _renew_on_border(banks, k, point, numbers):
    """`renew` where the ground is a blend of two soils."""
    mean, covariance, p = banks.mean[k], banks.covariance[k], banks.point
    at, out, all_, ground, gains = _at(), _linear(), _expanded(), _ground(), _slopes()
    reference = reference_of(banks, k)
    to_array(fill(point.slip), mean, SLIP * COUNT)
    _copy(mean, at, MEANS)
    b = blend(at, point.place, point.spread, reference, ground, numbers)
    linearise(ground, point.cos_pitch, reference, numbers, out)
    by_both_soils(out.pull, at, b, all_.pull)
    by_both_soils(out.torque, at, b, all_.torque)
    by_both_soils(out.ln_bearing, at, b, all_.ln_bearing)
    for i in range(CROSSING):
        to_array(fill(0.0), gains, i * COUNT)
    to_array(b.gain, gains, GAIN * COUNT)
    to_array(b.old_gain, gains, (OLD + GAIN) * COUNT)
    to_array(b.gain_place, gains, PLACE * COUNT)
    _drive(mean, covariance, ground, gains, all_, CROSSING, p.bearing[k], point, numbers)
    variance = from_array(covariance, element(PLACE, PLACE))
    to_array(variance + _DRIFT * _DRIFT, covariance, element(PLACE, PLACE))
    old = exp(from_array(banks.log_weight[k], 0))
    x2, logs = _measure(mean, covariance, at, all_, CROSSING, point, numbers)
    if numbers.grade_change > 0.0 and p.grade_used[k] == 0.0:
        c, d = _measure_grade(mean, covariance, at, b, p.grade[k], p.grades[k], point, numbers)
        x2, logs = x2 + c, logs + d
    misfit = _weigh(banks.log_weight[k], old, x2, logs)
    _finish(banks, k, at, all_, CROSSING)
    return misfit


@part
def _renew_on_one_soil(banks, k, point, numbers):
    """`renew` away from borders."""
    mean, covariance = banks.mean[k], banks.covariance[k]
    at, out, gains = _at(), _linear(), _slopes()
    to_array(fill(point.slip), mean, SLIP * COUNT)
    _copy(mean, at, STATES * COUNT)
    linearise(at, point.cos_pitch, reference_of(banks, k), numbers, out)
    for i in range(STATES):
        to_array(fill(1.0 if i == GAIN else 0.0), gains, i * COUNT)
    _drive(mean, covariance, at, gains, out, STATES, banks.point.bearing[k], point, numbers)
    old = exp(from_array(banks.log_weight[k], 0))
    x2, logs = _measure(mean, covariance, at, out, STATES, point, numbers)
    misfit = _weigh(banks.log_weight[k], old, x2, logs)
    _finish(banks, k, at, out, STATES)
    return misfit


@inlined
def renew(banks, k, point, numbers):
    """Time update and measurement update of bank k by a point; chi-squared of the mixture."""
    if banks.point.crossing[k] > 0.0:
        return _renew_on_border(banks, k, point, numbers)
    return _renew_on_one_soil(banks, k, point, numbers)
