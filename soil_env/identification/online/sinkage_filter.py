"""Filter of the sinkage and of the two parameters of the soil that show in it: a bank of extended
Kalman filters.

States, each a value a lane, are (z, y, l), on a border with the old soil's (y, l) behind them. z is
the sinkage [m]; y the ln of S depth^n [Pa], which lets the wheel `depth` deep; l the ln of the gain
of digging over the nominal one. The law between two points: docs/physics/estimation.md. Where the
sinkage is less than the bearing sinkage it comes up at once, in the mean over the uncertainty of
both (statistical linearisation: Gelb 1974, Applied Optimal Estimation, Sec. 6.2). Pressure and gain
hide each other, so the prior of the gain is split among the filters (Gaussian sum).
"""

import math
from typing import NamedTuple

from soil_env.identification.online.lanes.compiling import compiled_inline, compiled_part
from soil_env.identification.online.lanes.elementary import (
    exp,
    fma,
    larger,
    log,
    smaller,
    sqrt,
    tanh,
)
from soil_env.identification.online.lanes.lanes import (
    COUNT,
    fill,
    from_array,
    scratch,
    smallest,
    to_array,
    total,
)

DEPTH, PRESSURE, GAIN, OLD_PRESSURE, OLD_GAIN, STATES = range(6)
HERE = 3  # states away from borders
#: Rows of `sinkage`, COUNT numbers each: states, lower triangle of their covariance, ln weight.
COVARIANCE = STATES
LOG_WEIGHT = COVARIANCE + STATES * (STATES + 1) // 2
SINKAGE_ROWS = LOG_WEIGHT + 1
_REACH = 1.9  # [sd of ln gain] of the outermost filters
_WIDTH = 0.75 * 2.0 * _REACH / (COUNT - 1)  # [sd] of each
# [1/s] at which a wheel comes up to its bearing sinkage, in the mean over a point
_YIELD_RATE = 6.0
_LAG = 0.5  # share of the change in bearing sinkage since the last point that has not acted yet
# 1-sigma of the law of sinkage: of the radius, of the change, of the sinkage, of the change of the
# bearing sinkage, of what the place of the border makes of it
_LEAST_MOVE = 0.02
_MOVE = 0.1
_JOLT = 0.9
_CHANGE = 0.5
_MISPLACED = 2.0
_SPREAD = 0.9984  # variance by which they are weighed, so that all have that of the prior together
_LARGEST_GAIN = 3.0  # |ln| of it
_moments = scratch(16)
_row = scratch(STATES * COUNT)
_row2 = scratch(STATES * COUNT)
_row3 = scratch(STATES * COUNT)


class Ground(NamedTuple):
    """Ground under the wheel at a point, by the forces and the border."""

    ln_s: float  # ln of the mobilised sinkage coefficient
    depth: float  # [m] at this sinkage
    by_depth: float  # d ln_s / d ln z
    exponent: float
    share: float  # of the new soil
    by_place: float  # d share / d place of the border [1/m]
    place_variance: float  # [m2]


class Motion(NamedTuple):
    """Motion since the last point."""

    path: float  # integral of A dt
    sliding: float  # integral of |r w - V| dt / l
    shock: float  # sum of |d(r w)| dt / l
    time: float  # [s]
    sinkage: float  # [m] as measured
    variance: float  # [m2] of that


@compiled_inline
def cell(i, j):
    """Offset of element (i, j) of the covariance."""
    return (COVARIANCE + (i * (i + 1) // 2 + j if i >= j else j * (j + 1) // 2 + i)) * COUNT


@compiled_inline
def new_soil(banks, k, numbers):
    """Set pressure and gain of the filters of wheel k to their prior; they are correlated with
    nothing else.
    """
    s = banks.sinkage[k]
    prior = numbers.prior
    variance = prior.sinkage_covariance[3]
    both = prior.sinkage_covariance[1]
    sd = math.sqrt(variance)
    kept = 1.0 - _WIDTH * _WIDTH
    for j in range(COUNT):
        at = _REACH * (2.0 * j / (COUNT - 1) - 1.0)
        s[PRESSURE * COUNT + j] = prior.sinkage[0] + both / sd * at
        s[GAIN * COUNT + j] = prior.sinkage[1] + sd * at
        s[LOG_WEIGHT * COUNT + j] = -0.5 * at * at / _SPREAD
    for i in range(STATES):
        to_array(fill(0.0), s, cell(i, PRESSURE))
        to_array(fill(0.0), s, cell(i, GAIN))
    to_array(
        fill(prior.sinkage_covariance[0] - kept * both * both / variance),
        s,
        cell(PRESSURE, PRESSURE),
    )
    to_array(fill(both * _WIDTH * _WIDTH), s, cell(GAIN, PRESSURE))
    to_array(fill(variance * _WIDTH * _WIDTH), s, cell(GAIN, GAIN))
    w = from_array(s, LOG_WEIGHT * COUNT)
    to_array(w - math.log(total(exp(w))), s, LOG_WEIGHT * COUNT)


@compiled_inline
def weights(s):
    """Weights of the filters."""
    return exp(from_array(s, LOG_WEIGHT * COUNT))


@compiled_inline
def mean(s, i):
    """Mean of a state over all filters."""
    return total(weights(s) * from_array(s, i * COUNT))


@compiled_inline
def spread(s, i, j):
    """Covariance of two states over all filters."""
    away = from_array(s, i * COUNT) - mean(s, i)
    return total(
        weights(s) * (from_array(s, cell(i, j)) + away * (from_array(s, j * COUNT) - mean(s, j)))
    )


@compiled_part
def begin_next_sinkage(banks, k, numbers):
    """The soil so far becomes the old one, and a new one begins, with the prior of its sinkage."""
    s = banks.sinkage[k]
    before = _moments()
    becomes = (DEPTH, OLD_PRESSURE, OLD_GAIN)
    for i in range(HERE):
        before[i] = mean(s, i)
        for j in range(i + 1):
            before[HERE * (i + 1) + j] = spread(s, j, i)
    new_soil(banks, k, numbers)
    for i in range(HERE):
        to_array(fill(before[i]), s, becomes[i] * COUNT)
        for j in range(i + 1):
            to_array(fill(before[HERE * (i + 1) + j]), s, cell(becomes[i], becomes[j]))


@compiled_part
def keep_old_sinkage(banks, k):
    """The soil behind the border is the old one."""
    s = banks.sinkage[k]
    for i, j in ((PRESSURE, OLD_PRESSURE), (GAIN, OLD_GAIN)):
        to_array(from_array(s, j * COUNT), s, i * COUNT)
        to_array(from_array(s, cell(j, DEPTH)), s, cell(i, DEPTH))
        to_array(from_array(s, cell(j, j)), s, cell(i, i))
    to_array(from_array(s, cell(OLD_GAIN, OLD_PRESSURE)), s, cell(GAIN, PRESSURE))
    to_array(fill(-math.log(COUNT)), s, LOG_WEIGHT * COUNT)


@compiled_inline
def pressure_here(s, ground):
    """State y of the ground under the wheel, a value a lane."""
    new = from_array(s, PRESSURE * COUNT)
    old = from_array(s, OLD_PRESSURE * COUNT)
    return ground.share * new + (1.0 - ground.share) * old if ground.share < 1.0 else new


@compiled_inline
def ln_bearing(s, ground, depth):
    """ln of the bearing sinkage [m] at which undisturbed soil has the pressure mobilised now, a
    value a lane.
    """
    n = ground.exponent
    deeper = log(from_array(s, DEPTH * COUNT)) - math.log(ground.depth)
    pressure = ground.ln_s + n * math.log(ground.depth) + (ground.by_depth + n) * deeper
    return math.log(depth) + (pressure - pressure_here(s, ground)) * (1.0 / n)


@compiled_inline
def _normal_share(x):
    """(P, p): distribution and density of the standard normal; P to 2e-4 (Page 1977, Applied
    Statistics 26:75-76).
    """
    share = 0.5 + 0.5 * tanh(0.7988 * (x + 0.04417 * x * x * x))
    return share, 0.3989422804014327 * exp(-0.5 * smaller(x * x, 1400.0))


@compiled_inline
def _lacking(lag, scatter):
    """Mean and variance of max(lag, 0), and the probability of lag > 0, of a normal `lag` with sd
    `scatter`.
    """
    likely, density = _normal_share(lag / scatter)
    lacking = lag * likely + scatter * density
    square = (
        (lag * lag + scatter * scatter) * likely + lag * (scatter * density) - lacking * lacking
    )
    return lacking, square, likely


@compiled_inline
def _covariance_with(s, slopes, size, out):
    """Covariance of the states with a quantity that has these slopes by them, into `out`; its
    variance.
    """
    variance = fill(0.0)
    for i in range(size):
        v = fill(0.0)
        for j in range(size):
            v = fma(from_array(s, cell(i, j)), from_array(slopes, j * COUNT), v)
        to_array(v, out, i * COUNT)
        variance = fma(v, from_array(slopes, i * COUNT), variance)
    return variance


@compiled_inline
def _read_sinkage(s, of_depth, e, expected, size, r):
    """Kalman update by a reading `e` above its prediction; `of_depth`: covariance of the states
    with the sinkage.
    """
    for i in range(size):
        to_array(from_array(of_depth, i * COUNT), s, cell(i, DEPTH))
    for i in range(size):
        v = from_array(of_depth, i * COUNT) / expected
        to_array(fma(v, e, from_array(s, i * COUNT)), s, i * COUNT)
        for j in range(i + 1):
            c = from_array(s, cell(i, j))
            to_array(fma(-1.0 * v, from_array(of_depth, j * COUNT), c), s, cell(i, j))
    to_array(smaller(larger(from_array(s, DEPTH * COUNT), 1e-3 * r), 1.9 * r), s, DEPTH * COUNT)
    to_array(
        smaller(larger(from_array(s, GAIN * COUNT), -_LARGEST_GAIN), _LARGEST_GAIN), s, GAIN * COUNT
    )


@compiled_inline
def _follow(s, ground, motion, last_bearing, size, numbers):
    """Time update of the sinkage, and its update by the reading: (innovation, its variance), a
    value a lane.
    """
    slopes = _row()
    of_bearing = _row2()
    of_depth = _row3()
    r = numbers.radius
    n = ground.exponent
    share = ground.share
    a = max(motion.path, 1e-12)
    left = math.exp(-a)
    come = 1.0 - left
    z = from_array(s, DEPTH * COUNT)
    now = exp(smaller(ln_bearing(s, ground, numbers.depth), math.log(2.0 * r)))
    change = last_bearing - now if last_bearing > 0.0 else fill(0.0)
    bearing = now + _LAG * change
    gain = exp(from_array(s, GAIN * COUNT))
    old_gain = fill(0.0)
    if size > HERE:
        gain = share * gain
        old_gain = (1.0 - share) * exp(from_array(s, OLD_GAIN * COUNT))
    per_gain = (numbers.dig_gain * motion.sliding * come / a) * bearing
    dug = per_gain * (gain + old_gain)
    to_array(now * (ground.by_depth + n) / (n * z), slopes, DEPTH * COUNT)
    to_array((-share / n) * now, slopes, PRESSURE * COUNT)
    to_array(fill(0.0), slopes, GAIN * COUNT)
    if size > HERE:
        to_array(((share - 1.0) / n) * now, slopes, OLD_PRESSURE * COUNT)
        to_array(fill(0.0), slopes, OLD_GAIN * COUNT)
    variance = _covariance_with(s, slopes, size, of_bearing)
    for i in range(size):
        to_array(from_array(s, cell(i, DEPTH)), of_depth, i * COUNT)
    # comes up to the bearing sinkage: a share of the mean of what it lacks, where it lacks any
    variance = variance + from_array(of_depth, 0) - 2.0 * from_array(of_bearing, 0)
    scatter = sqrt(larger(variance, 0.0) + 1e-7 * r * r)
    lag = bearing - z
    lacking, square, likely = _lacking(lag, scatter)
    yields = left * (1.0 - math.exp(-_YIELD_RATE * max(motion.time, 0.0)))
    rise = (come * bearing + dug) / bearing + yields * likely
    stay = left - yields * likely
    for i in range(size):  # covariance with the sinkage after the motion
        v = fma(rise, from_array(of_bearing, i * COUNT), stay * from_array(of_depth, i * COUNT))
        v = fma(per_gain * gain, from_array(s, cell(i, GAIN)), v)
        if size > HERE:
            v = fma(per_gain * old_gain, from_array(s, cell(i, OLD_GAIN)), v)
        to_array(v, of_bearing, i * COUNT)
    after = come * bearing + dug + left * z + yields * lacking
    variance = fma(
        stay,
        from_array(of_bearing, DEPTH * COUNT),
        (per_gain * gain) * from_array(of_bearing, GAIN * COUNT),
    )
    for i in range(size):
        variance = fma(
            rise * from_array(slopes, i * COUNT), from_array(of_bearing, i * COUNT), variance
        )
    if size > HERE:
        variance = fma(per_gain * old_gain, from_array(of_bearing, OLD_GAIN * COUNT), variance)
    move = _MOVE * (after - z)
    jolt = _JOLT * motion.shock * z
    changed = (_CHANGE * come) * change
    own = (_LEAST_MOVE * r) * (_LEAST_MOVE * r) + move * move + jolt * jolt + changed * changed
    own = own + (yields * yields) * larger(square - likely * likely * scatter * scatter, 0.0)
    if size > HERE:
        apart = from_array(s, PRESSURE * COUNT) - from_array(s, OLD_PRESSURE * COUNT)
        misplaced = (come + yields * likely) * bearing * apart * (_MISPLACED * ground.by_place / n)
        own = own + ground.place_variance * misplaced * misplaced
    variance = variance + own
    to_array(variance, of_bearing, DEPTH * COUNT)
    expected = variance + motion.variance
    e = motion.sinkage - after
    to_array(after, s, DEPTH * COUNT)
    _read_sinkage(s, of_bearing, e, expected, size, r)
    return e, expected


@compiled_part
def follow(banks, k, ground, motion, numbers):
    """Follow the sinkage of wheel k from the last point to this one; chi-squared of its reading."""
    s = banks.sinkage[k]
    last = banks.point.bearing[k]
    if ground.share < 1.0:
        e, expected = _follow(s, ground, motion, last, STATES, numbers)
    else:
        e, expected = _follow(s, ground, motion, last, HERE, numbers)
    own = weights(s)
    middle = total(own * e)
    surprise = middle * middle / total(own * (expected + (e - middle) * (e - middle)))
    w = from_array(s, LOG_WEIGHT * COUNT) - 0.5 * (e * e / expected + log(expected))
    highest = -smallest(-1.0 * w)
    w = larger(w - highest, -700.0)
    to_array(w - math.log(total(exp(w))), s, LOG_WEIGHT * COUNT)
    bearing = exp(smaller(ln_bearing(s, ground, numbers.depth), math.log(2.0 * numbers.radius)))
    banks.point.bearing[k] = total(weights(s) * bearing)
    return surprise


@compiled_inline
def start(banks, k, sinkage, variance):
    """A first sinkage [m] with its variance [m2]."""
    s = banks.sinkage[k]
    to_array(fill(sinkage), s, DEPTH * COUNT)
    to_array(fill(variance), s, cell(DEPTH, DEPTH))
