"""Updates of a bank of filters (`filter`) by a point."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, part
from soil_env._numba.elementary import exp, fma, larger, smaller, sqrt, tanh
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
from soil_env.identification.kalman import column, dot, less, lose, lose_three, take_in, times, times_both
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
from soil_env.slip import motion_from_slip, travel_rate

_YIELD_RATE = 6.0  # [1/s] at which a wheel comes up to its bearing sinkage, in the mean over a point
_LAG = 0.5  # share of the change in bearing sinkage since the last point that has not acted yet
# 1-sigma of the law of sinkage: of the radius, of the change, of the sinkage, of the change of the bearing sinkage
_LEAST_MOVE, _MOVE, _JOLT, _CHANGE = 6.3e-3, 0.1, 0.9, 0.5
_DRIFT = 2e-3  # [m] random walk of a border's place per point: a step uses the ground at its middle, not at its end
_LOWEST = np.array([0.005, math.log(2e-4), math.log(1e3), -1000.0, 0.3, -3.0, 1e-4, 0.05, -0.95])
_HIGHEST = np.array([5.0, math.log(0.3), math.log(1e13), 2e5, 2.5, 3.0, 6.0, 1e6, 0.98])
_vector = scratch(MEANS)
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
def _normal_share(x):
    """(P, p): distribution and density of the standard normal; P to 2e-4 (Page 1977, Applied Statistics 26:75-76)."""
    share = 0.5 + 0.5 * tanh(0.7988 * (x + 0.04417 * x * x * x))
    return share, 0.3989422804014327 * exp(-0.5 * smaller(x * x, 1400.0))


@inlined
def _drive(mean, covariance, ground, gain_slopes, of_gain, out, size, last_bearing, point, numbers):
    """The sinkage of a bank from the last point to this one (`effects.excavation_rate`), and a slip not yet updated.

    `gain_slopes`: derivative of ln g of the ground by the states; `of_gain`: covariance of ln g with them.
    """
    slopes, of_bearing, of_sinkage, r = _vector(), _vector(), _vector(), numbers.radius
    a = max(point.path, 1e-12)
    left = math.exp(-a)
    come = 1.0 - left
    gain = numbers.dig_gain * exp(from_array(ground, GAIN * COUNT))
    now = exp(smaller(from_array(out.ln_bearing, size * COUNT), math.log(2.0 * r)))
    change = last_bearing - now if last_bearing > 0.0 else fill(0.0)
    z, bearing = from_array(mean, SINKAGE * COUNT), now + _LAG * change
    dug = (point.sliding * come / a) * gain * bearing
    for i in range(size):
        to_array(now * from_array(out.ln_bearing, i * COUNT), slopes, i * COUNT)
    to_array(fill(0.0), slopes, SLIP * COUNT)
    times(covariance, slopes, of_bearing, size)
    column(covariance, SINKAGE, of_sinkage, size)
    # comes up to the bearing sinkage: a share of the mean of what it lacks, where it lacks any
    variance = dot(slopes, of_bearing, size) + from_array(of_sinkage, SINKAGE * COUNT)
    variance = variance - 2.0 * from_array(of_bearing, SINKAGE * COUNT)
    spread, lag = sqrt(variance + 1e-7 * r * r), bearing - z
    likely, density = _normal_share(lag / spread)
    lacking = lag * likely + spread * density
    scatter = (lag * lag + spread * spread) * likely + lag * (spread * density) - lacking * lacking
    yields = left * (1.0 - math.exp(-_YIELD_RATE * max(point.time, 0.0)))
    rise, stay = (come * bearing + dug) / bearing + yields * likely, left - yields * likely
    variance = fill(0.0)
    for i in range(size):
        i *= COUNT
        v = fma(rise, from_array(of_bearing, i), fma(stay, from_array(of_sinkage, i), dug * from_array(of_gain, i)))
        to_array(v, of_bearing, i)
        variance = fma(fma(rise, from_array(slopes, i), dug * from_array(gain_slopes, i)), v, variance)
    variance = fma(stay, from_array(of_bearing, SINKAGE * COUNT), variance)
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
        to_array(from_array(of_bearing, i * COUNT), covariance, element(SINKAGE, i))
        to_array(fill(0.0), covariance, element(SLIP, i))
    to_array(variance + own, covariance, element(SINKAGE, SINKAGE))
    drift = numbers.load_drift * from_array(mean, MASS * COUNT)
    to_array(from_array(covariance, element(MASS, MASS)) + drift * drift, covariance, element(MASS, MASS))
    to_array(fill(point.slip), mean, SLIP * COUNT)
    to_array(fill(numbers.noise[0] * numbers.noise[0] / point.readings), covariance, element(SLIP, SLIP))


@inlined
def _away(slopes, mean, at, size):
    """The change of a prediction from `at`, where it was linearised, to the mean."""
    v = fill(0.0)
    for i in range(size):
        away = from_array(mean, i * COUNT) - from_array(at, i * COUNT)
        v = fma(from_array(slopes, i * COUNT), away, v)
    return v


@inlined
def _take_state(mean, vector, at, state, slope, misfit, variance, size):
    """`take_in` of a channel that depends on one state only; `vector`: its column of the covariance."""
    misfit = misfit - slope * (from_array(mean, state * COUNT) - from_array(at, state * COUNT))
    return take_in(mean, vector, slope, from_array(vector, state * COUNT), misfit, variance, size)


@inlined
def _torque_of(point, model):
    """The two readings of the torque as one: (mean, variance, chi-squared of their difference); `model`: variance that
    each has by the model."""
    sensor, motor = model[0], model[1]
    both, apart = sensor + motor, point.torque - point.motor_torque
    return (point.torque * motor + point.motor_torque * sensor) / both, sensor * motor / both, apart * apart / both


@inlined
def measure(mean, covariance, at, out, size, point, numbers):
    """All channels of a point: (chi-squared, sum of the logarithms of their expected variances but for a constant)."""
    sd, n, one = numbers.noise, point.readings, fill(1.0)
    model = numbers.model_error * abs(point.load)
    force, mass, slip = numbers.gravity * point.cos_pitch, from_array(at, MASS * COUNT), from_array(at, SLIP * COUNT)
    of_mass, of_sinkage, of_slip = _vector(), _vector(), _vector()
    of_pull, of_torque, last = _vector(), _vector(), _vector()
    column(covariance, MASS, of_mass, size)
    column(covariance, MASS, last, size)  # what is left of it for the accelerometer
    column(covariance, SINKAGE, of_sinkage, size)
    column(covariance, SLIP, of_slip, size)
    times_both(covariance, out.pull, out.torque, of_pull, of_torque, size)

    misfit = fill(point.load) - force * mass
    x2, logs, scale = _take_state(mean, of_mass, at, MASS, fill(force), misfit, fill(sd[3] * sd[3] / n), size)
    less(of_pull, of_mass, scale * from_array(of_pull, MASS * COUNT), size)
    less(of_torque, of_mass, scale * from_array(of_torque, MASS * COUNT), size)
    less(of_sinkage, of_mass, from_array(of_mass, SINKAGE * COUNT), size)
    less(of_slip, of_mass, from_array(of_mass, SLIP * COUNT), size)
    less(last, of_mass, from_array(of_mass, MASS * COUNT), size)

    misfit = point.sinkage - from_array(at, SINKAGE * COUNT)
    a, b, scale = _take_state(mean, of_sinkage, at, SINKAGE, one, misfit, fill(sd[1] * sd[1] / n), size)
    x2, logs = x2 + a, logs + b
    less(of_pull, of_sinkage, scale * from_array(of_pull, SINKAGE * COUNT), size)
    less(of_torque, of_sinkage, scale * from_array(of_torque, SINKAGE * COUNT), size)
    less(of_slip, of_sinkage, from_array(of_sinkage, SLIP * COUNT), size)
    less(last, of_sinkage, from_array(of_sinkage, MASS * COUNT), size)

    travel = motion_from_slip(slip)[1]
    slope, misfit = point.rim_speed * travel_rate(travel), point.speed - point.rim_speed * travel
    variance = fill((sd[5] * sd[5] + sd[6] * sd[6]) / n)
    a, b, scale = _take_state(mean, of_slip, at, SLIP, slope, misfit, variance, size)
    x2, logs = x2 + a, logs + b
    less(of_pull, of_slip, scale * from_array(of_pull, SLIP * COUNT), size)
    less(of_torque, of_slip, scale * from_array(of_torque, SLIP * COUNT), size)
    less(last, of_slip, from_array(of_slip, MASS * COUNT), size)

    twist = (model * numbers.radius) * (model * numbers.radius)
    torque, variance, disagreement = _torque_of(point, (sd[4] * sd[4] / n + twist, point.motor_variance + twist))
    misfit = torque - from_array(out.torque, size * COUNT) - _away(out.torque, mean, at, size)
    own = dot(out.torque, of_torque, size)
    a, b, _ = take_in(mean, of_torque, one, own, misfit, fill(variance), size)
    x2, logs = x2 + a + disagreement, logs + b
    less(of_pull, of_torque, dot(out.pull, of_torque, size), size)
    less(last, of_torque, from_array(of_torque, MASS * COUNT), size)
    lose_three(covariance, of_mass, of_sinkage, of_slip, size)
    a, b = _measure_pull(mean, at, out, size, point, numbers, of_pull, last)
    lose_three(covariance, of_torque, of_pull, last, size)
    return x2 + a, logs + b


@inlined
def _measure_pull(mean, at, out, size, point, numbers, of_pull, last):
    """Drawbar pull and the acceleration that it gives the mass: as `measure`.

    `of_pull`, `last`: covariance with the pull and with the mass, less what other channels have taken; the vectors that
    the covariance loses by both.
    """
    sd, n, mass, one = numbers.noise, point.readings, from_array(at, MASS * COUNT), fill(1.0)
    model = numbers.model_error * abs(point.load)
    pull, own = from_array(out.pull, size * COUNT), dot(out.pull, of_pull, size)
    variance, with_mass = fill(sd[2] * sd[2] / n + model * model), from_array(of_pull, MASS * COUNT)
    misfit = point.drawbar_pull - pull - _away(out.pull, mean, at, size)
    x2, logs, scale = take_in(mean, of_pull, one, own, misfit, variance, size)
    less(last, of_pull, scale * with_mass, size)
    share, kept = pull / mass, variance * scale
    for i in range(size):
        v = kept * from_array(of_pull, i * COUNT) - share * from_array(last, i * COUNT)
        to_array(v / mass, last, i * COUNT)
    away = _away(out.pull, mean, at, size) - share * (from_array(mean, MASS * COUNT) - mass)
    own = (dot(out.pull, last, size) - share * from_array(last, MASS * COUNT)) / mass
    variance = (model / mass) * (model / mass) + sd[9] * sd[9] / n
    a, b, _ = take_in(mean, last, one, own, point.acceleration - (pull + away) / mass, variance, size)
    return x2 + a, logs + b


@inlined
def _measure_grade(mean, covariance, at, b, grade, grades, point, numbers):
    """The pitch of a point on a border: as `measure`."""
    vector, of_place = _vector(), _vector()
    rise = from_array(at, RISE * COUNT)
    by_place = b.by_place * rise
    column(covariance, RISE, vector, CROSSING)
    column(covariance, PLACE, of_place, CROSSING)
    for i in range(CROSSING):
        v = b.share * from_array(vector, i * COUNT) + by_place * from_array(of_place, i * COUNT)
        to_array(v, vector, i * COUNT)
    own = b.share * from_array(vector, RISE * COUNT) + by_place * from_array(vector, PLACE * COUNT)
    away = b.share * (from_array(mean, RISE * COUNT) - rise)
    away = away + by_place * (from_array(mean, PLACE * COUNT) - from_array(at, PLACE * COUNT))
    variance = numbers.noise[7] * numbers.noise[7] * (1.0 / point.readings + 1.0 / max(min(grades, 60.0), 1.0))
    misfit = (point.pitch - grade) - b.share * rise - away
    x2, logs, _ = take_in(mean, vector, fill(1.0), own, misfit, fill(variance), CROSSING)
    lose(covariance, vector, CROSSING)
    return x2, logs


@inlined
def _weigh(log_weight, old, x2, logs, power):
    """Renew the weights of the filters by the likelihood of a point; its chi-squared under their mixture."""
    least = smallest(x2)
    misfit = least - 2.0 * math.log(max(total(old * exp(-0.5 * (x2 - least))), 1e-300))
    new = from_array(log_weight, 0) - (0.5 * power) * (x2 + logs)
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


@inlined
def _covariance_with_gain(covariance, b, out):
    """Covariance with ln g of the ground on a border, into `out`."""
    for i in range(CROSSING):
        new, old = from_array(covariance, element(i, GAIN)), from_array(covariance, element(i, OLD + GAIN))
        of_place = from_array(covariance, element(i, PLACE))
        to_array(fma(b.gain, new, fma(b.old_gain, old, b.gain_place * of_place)), out, i * COUNT)


@part
def _renew_on_border(banks, k, point, numbers):
    """`renew` where the ground is a blend of two soils."""
    mean, covariance, p = banks.mean[k], banks.covariance[k], banks.point
    at, out, all_, ground = _vector(), _linear(), _expanded(), _vector()
    gains, of_gain = _vector(), _vector()
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
    _covariance_with_gain(covariance, b, of_gain)
    _drive(mean, covariance, ground, gains, of_gain, all_, CROSSING, p.bearing[k], point, numbers)
    variance = from_array(covariance, element(PLACE, PLACE))
    to_array(variance + _DRIFT * _DRIFT, covariance, element(PLACE, PLACE))
    old = exp(from_array(banks.log_weight[k], 0))
    x2, logs = measure(mean, covariance, at, all_, CROSSING, point, numbers)
    if numbers.grade_change > 0.0 and p.grade_used[k] == 0.0:
        c, d = _measure_grade(mean, covariance, at, b, p.grade[k], p.grades[k], point, numbers)
        x2, logs = x2 + c, logs + d
    misfit = _weigh(banks.log_weight[k], old, x2, logs, numbers.power)
    _finish(banks, k, at, all_, CROSSING)
    return misfit


@part
def _renew_on_one_soil(banks, k, point, numbers):
    """`renew` away from borders."""
    mean, covariance = banks.mean[k], banks.covariance[k]
    at, out, gains, of_gain = _vector(), _linear(), _vector(), _vector()
    to_array(fill(point.slip), mean, SLIP * COUNT)
    _copy(mean, at, STATES * COUNT)
    linearise(at, point.cos_pitch, reference_of(banks, k), numbers, out)
    for i in range(STATES):
        to_array(fill(1.0 if i == GAIN else 0.0), gains, i * COUNT)
    column(covariance, GAIN, of_gain, STATES)
    _drive(mean, covariance, at, gains, of_gain, out, STATES, banks.point.bearing[k], point, numbers)
    old = exp(from_array(banks.log_weight[k], 0))
    x2, logs = measure(mean, covariance, at, out, STATES, point, numbers)
    misfit = _weigh(banks.log_weight[k], old, x2, logs, numbers.power)
    _finish(banks, k, at, out, STATES)
    return misfit


@inlined
def renew(banks, k, point, numbers):
    """Time update and measurement update of bank k by a point; chi-squared of the mixture."""
    if banks.point.crossing[k] > 0.0:
        return _renew_on_border(banks, k, point, numbers)
    return _renew_on_one_soil(banks, k, point, numbers)
