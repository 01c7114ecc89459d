"""Updates of a bank of filters (`filter`) by a point, and the estimate that it gives."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, part
from soil_env._numba.elementary import asin_root, below, exp, larger, log, root, smaller, tanh
from soil_env._numba.lanes import COUNT, fill, from_array, scratch, smallest, to_array, total
from soil_env._numba.rows import scratch_rows
from soil_env.identification.filter_bank import (
    COVARIANCES,
    MEANS,
    PUBLISHED,
    element,
    prior_covariance,
    prior_mean,
    reference_of,
)
from soil_env.identification.linearised import (
    COHESION,
    COLUMNS,
    EXPONENT,
    GAIN,
    LN_DEPTH,
    LN_K,
    MASS,
    SINKAGE,
    SLIP,
    STATES,
    STRENGTH,
    Linearised,
    Q,
    friction,
    linearise,
    mobilised_share,
)

_YIELD_RATE = 6.0  # [1/s] at which a wheel comes up to its bearing sinkage, in the mean over a point
_FADES, _FORGETS = 0.05, 5.0  # [m] in which what is forgotten behind a border fades; [1/m] its rate there
_LEAST_MOVE, _MOVE, _JOLT = (
    2e-3,
    0.1,
    0.9,
)  # 1-sigma of the law of sinkage: of the radius, of the change, of the sinkage
_LOWEST = np.array([0.005, math.log(2e-4), math.log(1e3), -1000.0, 0.3, -3.0, 1e-4, 0.05, -0.95])
_HIGHEST = np.array([5.0, math.log(0.3), math.log(1e13), 2e5, 2.5, 3.0, 6.0, 1e6, 0.98])
_ITERATIONS = 3  # of an update, at most
_NEAR_STRENGTH, _NEAR_LN_K = 0.03, 0.15  # changes of a filter's mean below which its update is not repeated
_saved_mean, _saved_covariance = scratch(MEANS), scratch(COVARIANCES)
_at, _ground, _slopes, _gain = scratch(MEANS), scratch(MEANS), scratch(MEANS), scratch(MEANS)
_linear = scratch_rows(Linearised, COLUMNS)


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
    cos_pitch: float
    motor_torque: float  # [N m] less what turns the wheel faster
    acceleration: float
    motor_variance: float
    path: float
    sliding: float
    shock: float
    time: float
    error: float  # 1-sigma of the model, of the load
    length: float  # [m] travelled


# --- the update -------------------------------------------------------------------------------------------------------


@inlined
def _copy(source, target, size):
    for i in range(0, size, COUNT):
        to_array(from_array(source, i), target, i)


@inlined
def _clip(x):
    for i in range(STATES):
        to_array(smaller(larger(from_array(x, i * COUNT), _LOWEST[i]), _HIGHEST[i]), x, i * COUNT)


@inlined
def _times(covariance, slopes, out):
    """Covariance times slopes into `out`; slopes . covariance . slopes."""
    square = fill(0.0)
    for i in range(STATES):
        v = fill(0.0)
        for j in range(STATES):
            v = v + from_array(covariance, element(i, j)) * from_array(slopes, j * COUNT)
        to_array(v, out, i * COUNT)
        square = square + v * from_array(slopes, i * COUNT)
    return square


@inlined
def _normal_share(x):
    """(P, p): distribution and density of the standard normal; P to 2e-4 (Page 1977, Applied Statistics 26:75-76)."""
    share = 0.5 + 0.5 * tanh(0.7988 * (x + 0.04417 * x * x * x))
    return share, 0.3989422804014327 * exp(-0.5 * smaller(x * x, 1400.0))


@part
def _drive(mean, covariance, ground, share, out, point, numbers):
    """The sinkage of a bank from the last point to this one (`effects.excavation_rate`), and a slip not yet updated."""
    slopes, product, r = _slopes(), _gain(), numbers.radius
    a = max(point.path, 1e-12)
    left = math.exp(-a)
    come = 1.0 - left
    gain = numbers.dig_gain * exp(from_array(ground, GAIN * COUNT))
    bearing = exp(smaller(from_array(out.ln_bearing, STATES * COUNT), math.log(2.0 * r)))
    z = from_array(mean, SINKAGE * COUNT)
    dug = (point.sliding * come / a) * gain * bearing
    for i in range(STATES):
        by_bearing = bearing * from_array(out.ln_bearing, i * COUNT)
        to_array(by_bearing - 1.0 if i == SINKAGE else by_bearing, slopes, i * COUNT)
    to_array(fill(0.0), slopes, SLIP * COUNT)
    # comes up to the bearing sinkage: a share of the mean of what it lacks, where it lacks any
    variance = _times(covariance, slopes, product)
    spread, lag = root(variance + 1e-7 * r * r), bearing - z
    likely, density = _normal_share(lag / spread)
    lacking = lag * likely + spread * density
    scatter = (lag * lag + spread * spread) * likely + lag * (spread * density) - lacking * lacking
    yields = left * (1.0 - math.exp(-_YIELD_RATE * max(point.time, 0.0)))
    rise = (come * bearing + dug) / bearing
    for i in range(MASS + 1):
        v = from_array(slopes, i * COUNT) * (yields * likely)
        to_array(v + rise * (bearing * from_array(out.ln_bearing, i * COUNT)), slopes, i * COUNT)
    to_array(from_array(slopes, SINKAGE * COUNT) + left, slopes, SINKAGE * COUNT)
    to_array(from_array(slopes, GAIN * COUNT) + share * dug, slopes, GAIN * COUNT)
    variance = _times(covariance, slopes, product)
    after = come * bearing + dug + left * z + yields * lacking
    move, jolt = _MOVE * (after - z), _JOLT * point.shock * z
    own = (
        4e-6 * r * r
        + move * move
        + jolt * jolt
        + (yields * yields) * larger(scatter - likely * likely * spread * spread, 0.0)
    )
    to_array(after, mean, SINKAGE * COUNT)
    for i in range(STATES):
        to_array(from_array(product, i * COUNT), covariance, element(SINKAGE, i))
        to_array(fill(0.0), covariance, element(SLIP, i))
    to_array(variance + own, covariance, element(SINKAGE, SINKAGE))
    to_array(fill(point.slip), mean, SLIP * COUNT)
    to_array(fill(numbers.noise[0] * numbers.noise[0] / point.readings), covariance, element(SLIP, SLIP))


@part
def _correct(mean, covariance, product, misfit, expected):
    """Kalman update by a value whose covariance with the states is `product`: (chi-squared, ln of its variance)."""
    step, scale = misfit / expected, 1.0 / expected
    for i in range(STATES):
        v = from_array(product, i * COUNT)
        to_array(from_array(mean, i * COUNT) + v * step, mean, i * COUNT)
        v = v * scale
        for j in range(i + 1):
            place = element(i, j)
            to_array(from_array(covariance, place) - v * from_array(product, j * COUNT), covariance, place)
    return misfit * step, log(expected)


@part
def absorb(mean, covariance, at, slopes, predicted, measured, variance):
    """Kalman update by one value, linearised at `at`: (chi-squared, ln of its expected variance)."""
    product = _gain()
    misfit = measured - predicted
    for i in range(STATES):
        misfit = misfit - from_array(slopes, i * COUNT) * (from_array(mean, i * COUNT) - from_array(at, i * COUNT))
    expected = _times(covariance, slopes, product) + variance
    return _correct(mean, covariance, product, misfit, expected)


@part
def _absorb_state(mean, covariance, at, state, slope, predicted, measured, variance):
    """`absorb` a value that depends on one state only."""
    product = _gain()
    for i in range(STATES):
        to_array(slope * from_array(covariance, element(i, state)), product, i * COUNT)
    misfit = measured - predicted - slope * (from_array(mean, state * COUNT) - from_array(at, state * COUNT))
    expected = slope * from_array(product, state * COUNT) + variance
    return _correct(mean, covariance, product, misfit, expected)


@part
def _measure(mean, covariance, at, out, point, numbers):
    """All channels of a point: (chi-squared, sum of the logarithms of their expected variances)."""
    slopes, sd, n = _slopes(), numbers.noise, point.readings
    model = point.error * abs(point.load)
    force, mass, slip = numbers.gravity * point.cos_pitch, from_array(at, MASS * COUNT), from_array(at, SLIP * COUNT)
    v = fill(sd[3] * sd[3] / n)
    x2, logs = _absorb_state(mean, covariance, at, MASS, fill(force), force * mass, fill(point.load), v)
    z, v = from_array(at, SINKAGE * COUNT), fill(sd[1] * sd[1] / n)
    a, b = _absorb_state(mean, covariance, at, SINKAGE, fill(1.0), z, fill(point.sinkage), v)
    x2, logs = x2 + a, logs + b
    braking = 1.0 / (1.0 + smaller(slip, 0.0))
    slope, v = (-point.rim_speed) * braking * braking, fill((sd[5] * sd[5] + sd[6] * sd[6]) / n)
    speed = point.rim_speed * (1.0 - larger(slip, 0.0)) * braking
    a, b = _absorb_state(mean, covariance, at, SLIP, slope, speed, fill(point.speed), v)
    x2, logs = x2 + a, logs + b
    pull, torque = from_array(out.pull, STATES * COUNT), from_array(out.torque, STATES * COUNT)
    v, twist = model * model, (model * numbers.radius) * (model * numbers.radius)
    a, b = absorb(mean, covariance, at, out.pull, pull, fill(point.drawbar_pull), fill(sd[2] * sd[2] / n + v))
    x2, logs = x2 + a, logs + b
    a, b = absorb(mean, covariance, at, out.torque, torque, fill(point.torque), fill(sd[4] * sd[4] / n + twist))
    x2, logs = x2 + a, logs + b
    v = fill(point.motor_variance + twist)
    a, b = absorb(mean, covariance, at, out.torque, torque, fill(point.motor_torque), v)
    x2, logs = x2 + a, logs + b
    for i in range(STATES):
        to_array(from_array(out.pull, i * COUNT) / mass, slopes, i * COUNT)
    to_array(from_array(slopes, MASS * COUNT) - pull / (mass * mass), slopes, MASS * COUNT)
    v = (model / mass) * (model / mass) + sd[9] * sd[9] / n
    a, b = absorb(mean, covariance, at, slopes, pull / mass, fill(point.acceleration), v)
    return x2 + a, logs + b


@part
def _forget(mean, covariance, log_weight, since, length, reference, numbers):
    """Back towards the prior behind a border, where soil still changes: an Ornstein-Uhlenbeck process."""
    fade = math.exp(-since / _FADES)
    f = math.exp(-length * (_FORGETS * fade))
    if f > 0.9999:  # nothing to forget
        return
    for i in range(SINKAGE):
        middle = prior_mean(i, numbers, reference)
        to_array(middle + f * (from_array(mean, i * COUNT) - middle), mean, i * COUNT)
        for j in range(i + 1):
            place = element(i, j)
            v = (1.0 - f * f) * prior_covariance(i, j, numbers, reference)
            to_array(v + f * f * from_array(covariance, place), covariance, place)
        for j in range(SINKAGE, STATES):
            place = element(i, j)
            to_array(f * from_array(covariance, place), covariance, place)
    to_array(f * from_array(log_weight, 0) + (1.0 - f) * from_array(numbers.prior.log_weight, 0), log_weight, 0)


@part
def _linearise(at, ground, before, share, cos_pitch, reference, numbers, out):
    """`linearise` at the soil under the wheel, written to `ground`: behind a border it has `share` of the new one."""
    _copy(at, ground, MEANS)
    if share < 1.0:
        left, _ = mobilised_share(fill(before[LN_K]), reference)
        strength = (math.tan(before[0]) + before[COHESION] / reference.stress) * left
        for i in range(SINKAGE):
            old = strength if i == STRENGTH else fill(before[i])
            to_array(share * from_array(at, i * COUNT) + (1.0 - share) * old, ground, i * COUNT)
    linearise(ground, cos_pitch, reference, numbers, out)
    if share < 1.0:
        for i in range(0, SINKAGE * COUNT, COUNT):
            to_array(share * from_array(out.pull, i), out.pull, i)
            to_array(share * from_array(out.torque, i), out.torque, i)
            to_array(share * from_array(out.ln_bearing, i), out.ln_bearing, i)


@inlined
def renew(banks, k, point, numbers):
    """Time update and iterated measurement update of bank k by a point; chi-squared of the mixture."""
    mean, covariance, log_weight = banks.mean[k], banks.covariance[k], banks.log_weight[k]
    at, out, saved, saved_covariance = _at(), _linear(), _saved_mean(), _saved_covariance()
    reference = reference_of(banks, k)
    to_array(fill(point.slip), mean, SLIP * COUNT)
    _copy(mean, at, MEANS)
    ground, before, share = _ground(), banks.before[k], banks.point.share[k]
    _linearise(at, ground, before, share, point.cos_pitch, reference, numbers, out)
    _drive(mean, covariance, ground, share, out, point, numbers)
    _forget(mean, covariance, log_weight, banks.point.since[k], point.length, reference, numbers)
    _copy(mean, saved, MEANS)
    _copy(covariance, saved_covariance, COVARIANCES)
    old = exp(from_array(log_weight, 0))
    x2, logs = _measure(mean, covariance, at, out, point, numbers)
    for _ in range(_ITERATIONS - 1):
        _clip(mean)
        far = larger(
            abs(from_array(mean, STRENGTH * COUNT) - from_array(at, STRENGTH * COUNT)) * (1.0 / _NEAR_STRENGTH),
            abs(from_array(mean, LN_K * COUNT) - from_array(at, LN_K * COUNT)) * (1.0 / _NEAR_LN_K),
        )
        if total(below(1.0, far) * below(1e-3, old)) == 0.0:
            break
        _copy(mean, at, MEANS)
        _linearise(at, ground, before, share, point.cos_pitch, reference, numbers, out)
        _copy(saved, mean, MEANS)
        _copy(saved_covariance, covariance, COVARIANCES)
        x2, logs = _measure(mean, covariance, at, out, point, numbers)
    _clip(mean)
    ln_bearing = from_array(out.ln_bearing, STATES * COUNT)
    for i in range(STATES):
        ln_bearing = ln_bearing + from_array(out.ln_bearing, i * COUNT) * (
            from_array(mean, i * COUNT) - from_array(at, i * COUNT)
        )
    to_array(ln_bearing, banks.ln_bearing[k], 0)
    least = smallest(x2)
    misfit = least - 2.0 * math.log(max(total(old * exp(-0.5 * (x2 - least))), 1e-300))
    new = from_array(log_weight, 0) - 0.5 * (x2 + logs)
    highest = -smallest(-1.0 * new)
    new = larger(new - highest, -700.0)
    to_array(new - math.log(total(exp(new))), log_weight, 0)
    return misfit


@inlined
def publish(banks, k, numbers, estimate, sd, covariance):
    """Mean [5], standard deviations [5] and covariance [5, 5] of (phi, ln K, ln S, c, ln g) of the mixture.

    ln S is that at the exponent of the belief which bears the same pressure at the bearing sinkage.
    """
    x, P = banks.mean[k], banks.covariance[k]
    w = exp(from_array(banks.log_weight[k], 0))
    depth = from_array(banks.ln_bearing[k], 0) - LN_DEPTH
    rows_, n = _at(), from_array(x, EXPONENT * COUNT)
    for i in range(PUBLISHED):
        j = GAIN if i == GAIN - 1 else i
        to_array(from_array(x, j * COUNT), rows_, i * COUNT)
    tan = friction(
        from_array(x, STRENGTH * COUNT),
        from_array(x, LN_K * COUNT),
        from_array(x, COHESION * COUNT),
        reference_of(banks, k),
    )
    angle = 2.0 * asin_root(0.5 - 0.5 / root(1.0 + tan.tangent * tan.tangent))
    to_array(angle, rows_, 0)
    to_array(from_array(x, Q * COUNT) + (n - numbers.exponent) * depth, rows_, Q * COUNT)
    for i in range(PUBLISHED):
        estimate[i] = total(w * from_array(rows_, i * COUNT))
    rate, slopes, product = 1.0 / (1.0 + tan.tangent * tan.tangent), _slopes(), _gain()
    for i in range(PUBLISHED):
        for j in range(STATES):
            to_array(fill(0.0), slopes, j * COUNT)
        to_array(fill(1.0), slopes, (GAIN if i == GAIN - 1 else i) * COUNT)
        if i == STRENGTH:
            to_array(rate * tan.by_strength, slopes, STRENGTH * COUNT)
            to_array(rate * tan.by_ln_K, slopes, LN_K * COUNT)
            to_array(rate * tan.by_cohesion, slopes, COHESION * COUNT)
        elif i == Q:
            to_array(depth, slopes, EXPONENT * COUNT)
        _times(P, slopes, product)
        away = from_array(rows_, i * COUNT) - estimate[i]
        for j in range(i + 1):
            b = GAIN if j == GAIN - 1 else j
            v = from_array(product, b * COUNT)
            if j == STRENGTH:
                v = rate * (
                    tan.by_strength * v + tan.by_ln_K * from_array(product, LN_K * COUNT)
                    + tan.by_cohesion * from_array(product, COHESION * COUNT)
                )  # fmt: skip
            elif j == Q:
                v = v + depth * from_array(product, EXPONENT * COUNT)
            covariance[i, j] = covariance[j, i] = total(w * (v + away * (from_array(rows_, j * COUNT) - estimate[j])))
        sd[i] = math.sqrt(max(covariance[i, i], 1e-18))
    estimate[COHESION] = max(estimate[COHESION], 0.0)
    share, before = banks.point.share[k], banks.before[k]
    at_depth = total(w * depth)
    if share < 1.0:
        for i in range(PUBLISHED):
            old = before[GAIN] if i == GAIN - 1 else before[i]
            if i == Q:
                old += (before[EXPONENT] - numbers.exponent) * at_depth
            estimate[i] = share * estimate[i] + (1.0 - share) * old
            for j in range(PUBLISHED):
                covariance[i, j] *= share * share
            covariance[i, i] += ((1.0 - share) * before[SINKAGE + i]) * ((1.0 - share) * before[SINKAGE + i])
            sd[i] = math.sqrt(covariance[i, i])
    elif banks.point.misfit[k] == 0.0:
        for i in range(PUBLISHED):
            before[SINKAGE + i] = sd[i]
        before[0], before[LN_K], before[COHESION], before[GAIN] = estimate[0], estimate[1], estimate[3], estimate[4]
        before[Q], before[EXPONENT] = total(w * from_array(x, Q * COUNT)), total(w * n)
