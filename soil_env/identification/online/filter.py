"""The filter of the online identifier: the soil under a wheel by its readings
(docs/physics/estimation.md).

Readings are averaged to points, over times in which little changes; a quantity of two sensors is
their mean by precision. Where the grade changes, or the forces of a few points are less likely than
the errors allow, the wheel comes to another soil (`border`). Where even other readings contradict
the laws, these have a form error.
"""

import math
from typing import NamedTuple

from soil_env.identification.online import border, curve
from soil_env.identification.online.contact_slopes import GroundSoil, Slopes, reaction
from soil_env.identification.online.curve_fit import begin_bin, fit, quadratic_form
from soil_env.identification.online.filter_bank import restart
from soil_env.identification.online.lanes.compiling import compiled_inline, compiled_part
from soil_env.identification.online.lanes.contact import motion_from_slip, onto_fresh
from soil_env.identification.online.lanes.elementary import larger, smaller
from soil_env.identification.online.lanes.lanes import COUNT, fill, from_array, scratch, to_array
from soil_env.identification.online.lanes.rows import zero_column
from soil_env.identification.online.sinkage_filter import (
    DEPTH,
    Ground,
    Motion,
    follow,
    mean,
    spread,
    start,
)
from soil_env.identification.online.soil_nodes import OLD, SOIL, fit_is_sound, renew_prior

SLOWEST = 0.02  # [m/s] rim speed below which readings are passed over
# Limits of a point: readings, [wheel radii], range of slip, relative range of the rim speed.
_READINGS = 8
_LENGTH = 0.67
_SLIP_RANGE = 0.1
_RIM_RANGE = 0.25
_ON_BORDER = 0.6  # of the readings and the length where the soil changes
_SPINNING = 0.9  # slips beyond which they are
_LOCKED = -0.4
_THROWN = 0.115  # [of gravity] acceleration of the rim above which they are
# 1-sigma error of a motor torque, of the mean torque that turns the wheel faster in the period
_TURNED = 8.0
_MASS_DOUBT = 0.05  # relative, of the mass by the first point
_LIFTED = 0.05  # [of the weight] load below which readings are passed over before the first point
_SINKAGE_DOUBT = 0.1  # [wheel radii] of the first sinkage: reached where none is measured
# variance of the sinkage in the fit over that of the sinkage filter, whose errors go on
_SINKAGE_SHARE = 2.0
_KEY_ERROR = 3e-3  # 1-sigma error of the laws where points are grouped by slip, of the load
#: The excess of the chi-squared of each point over `_EXPECTED` is summed, never below 0; a sum
#: above this contradicts the laws, and one above `_ANOTHER_SOIL` the soil.
CONTRADICTION_OF_POINTS = 10.0
_ANOTHER_SOIL = 7.0
# Points of a soil up to which readings contradict the laws, not the soil; where the grade shows no
# borders.
_SHORT = 12.0
_SHORTER = 4.0
_EXPECTED = 3.5  # chi-squared of pull and torque that raises no suspicion
# The same of the sinkage, how much the excess counts, and at most: the errors of its law are ample,
# 0.7 is seldom.
_SINKAGE_EXPECTED = 0.7
_OF_SINKAGE = 3.0
_MOST_OF_SINKAGE = 5.0
# Form error: where chi-squared exceeds its mean by so many standard deviations it begins, and grows
# until that is below the mean over _HARDER^2, since errors of the laws do not average out as noise
# does.
_BEGINS = 4.0
_HARDER = 5.0
_GROWS = 1.3
_SHRINKS = 1.1
_LARGEST = 0.3
# `_BEGINS` where only forces show borders, which are found after they have spoilt the fit
_LATER = 12.0
_FIELDS = len(Slopes._fields)
_PULL = 0  # rows of `_slopes`
_TORQUE = _FIELDS
_LN_S = 2 * _FIELDS
_slopes = scratch(3 * _FIELDS * COUNT)


@compiled_inline
def _advance_clocks(p, k, reading, numbers):
    """Integrals over the last period, of the readings' mean over it."""
    u = reading.rim_speed
    i = min(max(reading.slip, -0.9), 0.98)
    v = u * motion_from_slip(i)[1]
    mean_v = 0.5 * (v + p.last_speed[k])
    mean_u = 0.5 * (u + p.last_rim[k])
    step = numbers.period / numbers.relaxation
    sliding = abs(mean_u - mean_v) * step
    place = p.place[k] + mean_v * numbers.period
    high = p.furthest[k]
    low = p.lowest[k]
    p.place[k] = place
    p.furthest[k] = max(place, high)
    p.lowest[k] = min(place, low)
    p.path[k] += onto_fresh(place, low, high) / numbers.relaxation + numbers.dig_recovery * sliding
    p.sliding[k] += sliding
    p.shock[k] += abs(u - p.last_rim[k]) * step
    p.time[k] += numbers.period
    p.last_speed[k] = v
    p.last_rim[k] = u


@compiled_inline
def _slip_of_speeds(r, noise):
    """(slip, its sd) by travel and rim speed."""
    travel = r.speed / r.rim_speed
    if travel <= 1.0:
        slip = 1.0 - travel
        rate = 1.0
    else:
        slip = 1.0 / travel - 1.0
        rate = 1.0 / (travel * travel)
    return slip, rate * math.hypot(noise[5], min(travel, 2.0) * noise[6]) / r.rim_speed


@compiled_inline
def _collect(o, p, k, r, turned, numbers):
    """Add a reading to the open point; `turned`: change of the rim speed [m/s] in its period."""
    sd = numbers.noise
    if o.readings[k] == 0.0:
        o.first_slip[k] = r.slip
        o.first_rim[k] = r.rim_speed
        o.first_place[k] = p.place[k]
    slip, error = _slip_of_speeds(r, sd)
    a = 1.0 / (sd[0] * sd[0])
    b = 1.0 / (error * error)
    o.slip[k] += r.slip * a + slip * b
    o.slip_weight[k] += a + b
    mass = (
        p.mass[k] if p.mass[k] > 0.0 else max(r.load, 0.0) / (numbers.gravity * math.cos(r.pitch))
    )
    a = 1.0 / (sd[2] * sd[2])
    b = 1.0 / (mass * sd[9]) ** 2 if mass > 0.0 else 0.0
    o.pull[k] += r.drawbar_pull * a + mass * r.acceleration * b
    o.pull_weight[k] += a + b
    excess = max(turned * turned - 2.0 * sd[6] * sd[6], 0.0)
    accelerated = _TURNED * numbers.inertia / (numbers.radius * numbers.period)
    a = 1.0 / (sd[4] * sd[4])
    b = 1.0 / (sd[8] * sd[8] + accelerated * accelerated * excess)
    o.torque[k] += r.torque * a + r.motor_torque * b
    o.torque_weight[k] += a + b
    a = 1.0 / (sd[1] * sd[1])
    b = 1.0 / (sd[3] * sd[3])
    o.sinkage[k] += r.sinkage * a
    o.sinkage_weight[k] += a
    o.load[k] += r.load * b
    o.load_weight[k] += b
    o.pitch[k] += r.pitch
    o.path[k] += p.path[k]
    o.sliding[k] += p.sliding[k]
    o.shock[k] += p.shock[k]
    o.time[k] += p.time[k]
    place = p.place[k] - o.first_place[k]
    o.place[k] += place
    o.place_square[k] += place * place
    o.length[k] += abs(r.speed) * numbers.period
    o.readings[k] += 1.0


@compiled_inline
def _is_finite(r):
    """True if all readings are numbers of a plausible size."""
    total = r.slip + r.sinkage + r.drawbar_pull + r.load + r.torque + r.speed
    return abs(total + r.rim_speed + r.pitch + r.motor_torque + r.acceleration) < 1e12


@compiled_inline
def _is_steady(p, k, r, turned, numbers):
    """True if the wheel drives on the ground without spinning, locking or a jump of speed."""
    drives = r.rim_speed >= SLOWEST and _LOCKED <= r.slip <= _SPINNING
    touches = r.sinkage >= 1e-3 * numbers.radius and (
        p.mass[k] > 0.0 or r.load >= _LIFTED * numbers.weight
    )
    return drives and touches and turned <= _THROWN * numbers.gravity * numbers.period


@compiled_inline
def _ends_point(o, k, r, on_border, numbers):
    """True if a reading is too unlike the open point to join it, or the point is long enough."""
    faster = abs(r.rim_speed - o.first_rim[k]) > _RIM_RANGE * max(o.first_rim[k], 2.5 * SLOWEST)
    slips = abs(r.slip - o.first_slip[k]) > _SLIP_RANGE
    most = _ON_BORDER if on_border else 1.0
    return (
        faster
        or slips
        or o.readings[k] >= most * _READINGS
        or o.length[k] > most * _LENGTH * numbers.radius
    )


@compiled_inline
def take(banks, k, reading, numbers):
    """Take one set of readings; True if it completed a point, with which bank k was renewed."""
    o = banks.open
    p = banks.point
    done = False
    if not _is_finite(reading):
        return False
    turned = abs(reading.rim_speed - p.last_rim[k])
    _advance_clocks(p, k, reading, numbers)
    if numbers.grade_change > 0.0:
        border.note_grade(banks, k, reading.pitch, numbers)
    steady = _is_steady(p, k, reading, turned, numbers)
    if o.readings[k] > 0.0 and (
        not steady or _ends_point(o, k, reading, p.crossing[k] > 0.0, numbers)
    ):
        _complete(banks, k, numbers)
        done = True
    if steady:
        _collect(o, p, k, reading, turned, numbers)
    return done


class Point(NamedTuple):
    """Means over the readings of a point, with their variances, and the motion since the last."""

    readings: float
    slip: float
    slip_variance: float
    sinkage: float
    sinkage_variance: float
    pull: float
    pull_variance: float
    torque: float
    torque_variance: float
    load: float
    load_variance: float
    cos_pitch: float
    place: float  # [m] mean
    spread: float  # [m] sd of the places
    path: float  # integral of A dt
    sliding: float  # integral of |r w - V| dt / l
    shock: float  # sum of |d(r w)| dt / l
    time: float  # [s]


@compiled_inline
def _close(o, p, k, numbers):
    """The open point of bank k as `Point`; the next is empty."""
    n = o.readings[k]
    path = o.path[k] / n
    sliding = o.sliding[k] / n
    shock = o.shock[k] / n
    middle = o.time[k] / n
    place = o.place[k] / n
    point = Point(
        n,
        min(max(o.slip[k] / o.slip_weight[k], -0.5), 0.97),
        1.0 / o.slip_weight[k],
        min(max(o.sinkage[k] / o.sinkage_weight[k], 1e-3 * numbers.radius), 1.9 * numbers.radius),
        1.0 / o.sinkage_weight[k],
        o.pull[k] / o.pull_weight[k],
        1.0 / o.pull_weight[k],
        o.torque[k] / o.torque_weight[k],
        1.0 / o.torque_weight[k],
        o.load[k] / o.load_weight[k],
        1.0 / o.load_weight[k],
        math.cos(min(max(o.pitch[k] / n, -1.5), 1.5)),
        o.first_place[k] + place,
        math.sqrt(max(o.place_square[k] / n - place * place, 0.0)),
        path - p.path_at[k],
        sliding - p.sliding_at[k],
        shock - p.shock_at[k],
        middle - p.time_at[k],
    )
    p.path_at[k] = path
    p.sliding_at[k] = sliding
    p.shock_at[k] = shock
    p.time_at[k] = middle
    zero_column(o, k)
    return point


@compiled_inline
def _weigh(p, k, point, numbers):
    """Renew the mass on wheel k by a point; the load on it [N]."""
    gravity = numbers.gravity * point.cos_pitch
    if p.mass[k] == 0.0:
        p.mass[k] = max(point.load, 1e-3 * math.sqrt(point.load_variance)) / gravity
        p.mass_variance[k] = (_MASS_DOUBT * p.mass[k]) ** 2
    drift = numbers.load_drift * p.mass[k]
    before = p.mass_variance[k] + drift * drift
    gain = before / (before + point.load_variance / (gravity * gravity))
    p.mass[k] = max(p.mass[k] + gain * (point.load / gravity - p.mass[k]), 0.05 * p.mass[k])
    p.mass_variance[k] = (1.0 - gain) * before
    return p.mass[k] * gravity


@compiled_inline
def _short(numbers):
    """Points of a soil up to which contradictions are of the laws."""
    return _SHORT if numbers.grade_change > 0.0 else _SHORTER


@compiled_inline
def _doubt_soil_or_laws(banks, k, numbers):
    """Begin another soil, or a form error of the laws, where the last points contradict the soil so
    far.
    """
    p = banks.point
    if p.misfit[k] <= _ANOTHER_SOIL or p.points[k] <= 2.0 or p.crossing[k] > 0.0:
        return
    if p.points[k] > _short(numbers):
        border.cross_here(banks, k, numbers)
    elif p.misfit[k] > CONTRADICTION_OF_POINTS:
        p.misfit[k] = 0.0
        p.flagged[k] = 1.0
        p.form_error[k] = max(_GROWS * p.form_error[k], 2.0 * numbers.model_error)


@compiled_inline
def _complete(banks, k, numbers):
    """Close the open point, begin or end a border with it, and renew bank k by it."""
    p = banks.point
    first = banks.open.first_place[k]
    point = _close(banks.open, p, k, numbers)
    begun = p.mass[k] > 0.0
    load = _weigh(p, k, point, numbers)
    if not begun:
        unsure = _SINKAGE_DOUBT * numbers.radius
        start(banks, k, point.sinkage, min(1e2 * point.sinkage_variance, unsure * unsure))
    if p.crossing[k] == 0.0:
        if numbers.grade_change > 0.0 and p.points[k] > 0.0:
            border.cross_where_the_grade_changes(banks, k, numbers)
        _doubt_soil_or_laws(banks, k, numbers)
    else:
        border.follow_border(banks, k, numbers)
        if first > p.border[k] + 0.5 * numbers.border:
            border.end(banks, k, numbers)
    _renew(banks, k, point, load, numbers)
    if not fit_is_sound(banks, k):  # readings that no wheel gives
        restart(banks, k, numbers)


@compiled_inline
def ground_of(banks, k, share):
    """`GroundSoil`, as means, where the new soil has this share."""
    known = banks.known[k]
    w = share
    v = 1.0 - share
    if w >= 1.0:
        return GroundSoil(known[0], known[1], known[2], known[3])
    return GroundSoil(
        w * known[0] + v * known[OLD],
        w * known[1] + v * known[OLD + 1],
        w * known[2] + v * known[OLD + 2],
        w * known[3] + v * known[OLD + 3],
    )


@compiled_inline
def _store(slopes, into, row):
    """Store `Slopes` in lanes, a row a field."""
    for i in range(_FIELDS):
        to_array(slopes[i], into, (row + i) * COUNT)


@compiled_inline
def _one(rows, row, lane):
    """`Slopes` of one lane."""
    i = row * COUNT + lane
    return Slopes(
        rows[i],
        rows[i + COUNT],
        rows[i + 2 * COUNT],
        rows[i + 3 * COUNT],
        rows[i + 4 * COUNT],
        rows[i + 5 * COUNT],
        rows[i + 6 * COUNT],
    )


_HERE = 3  # the lane at the slip of the point


@compiled_inline
def _slips(point):
    """Slips at which the forces of a point are predicted, a value a lane; that of the point is in
    lane `_HERE`.
    """
    lanes = _lane_numbers()
    step = max(0.8 * math.sqrt(point.slip_variance), 2e-3)
    for j in range(COUNT):
        lanes[j] = (
            min(max(point.slip + (j - _HERE) * step, _LOCKED), 0.95) if j != _HERE else point.slip
        )
    return from_array(lanes, 0)


_lane_numbers = scratch(COUNT)


@compiled_inline
def _key(rows, point, load, numbers):
    """Most likely slip by slip, pull and torque of a point together, under the soil so far."""
    error = _KEY_ERROR * load
    of_pull = 1.0 / (point.pull_variance + error * error)
    of_torque = 1.0 / (point.torque_variance + (error * numbers.radius) ** 2)
    of_slip = 1.0 / point.slip_variance
    lanes = _lane_numbers()
    slips = _slips(point)
    p = point.pull - from_array(rows, _PULL * COUNT)
    t = point.torque - from_array(rows, _TORQUE * COUNT)
    s = point.slip - slips
    by_slip = from_array(rows, (_PULL + 6) * COUNT)
    twist_by_slip = from_array(rows, (_TORQUE + 6) * COUNT)
    to_array(of_pull * p * p + of_torque * t * t + of_slip * s * s, lanes, 0)
    best = 0
    for j in range(1, COUNT):
        if lanes[j] < lanes[best]:
            best = j
    curvature = of_pull * by_slip * by_slip + of_torque * twist_by_slip * twist_by_slip + of_slip
    step = (of_pull * p * by_slip + of_torque * t * twist_by_slip + of_slip * s) / curvature
    to_array(smaller(larger(slips + smaller(larger(step, -0.05), 0.05), _LOCKED), 0.95), lanes, 0)
    return lanes[best]


@compiled_inline
def _surprise(banks, k, rows, point, load, moved, variance, numbers):
    """Chi-squared of pull and torque under the soil so far; the sinkage has `moved` [m] and has
    this variance.
    """
    p = _one(rows, _PULL, _HERE)
    t = _one(rows, _TORQUE, _HERE)
    error = banks.point.form_error[k] * load
    pp = point.pull_variance + error * error + p.by_slip * p.by_slip * point.slip_variance
    pt = p.by_slip * t.by_slip * point.slip_variance + p.by_sinkage * t.by_sinkage * variance
    tt = (
        point.torque_variance
        + (error * numbers.radius) ** 2
        + t.by_slip * t.by_slip * point.slip_variance
    )
    pp += p.by_sinkage * p.by_sinkage * variance + quadratic_form(banks.known[k], SOIL, p, p)
    pt += quadratic_form(banks.known[k], SOIL, p, t)
    tt += t.by_sinkage * t.by_sinkage * variance + quadratic_form(banks.known[k], SOIL, t, t)
    a = point.pull - p.value - p.by_sinkage * moved
    b = point.torque - t.value - t.by_sinkage * moved
    return (tt * a * a - 2.0 * pt * a * b + pp * b * b) / (pp * tt - pt * pt)


@compiled_inline
def _predict_forces(banks, k, soil, depth, point, load, rows, numbers):
    """`Slopes` of pull, torque and ln s at the slips of a point into `rows`; those by the soil into
    the bank.
    """
    p = banks.point
    lanes = GroundSoil(
        fill(soil.tangent), fill(soil.cohesion), fill(soil.exponent), fill(soil.ln_K)
    )
    found = reaction(lanes, fill(depth), _slips(point), load, numbers.radius, numbers.width)
    _store(found.pull, rows, _PULL)
    _store(found.torque, rows, _TORQUE)
    _store(found.ln_s, rows, _LN_S)
    of_s = _one(rows, _LN_S, _HERE)
    p.ln_s_tangent[k] = of_s.by_tangent
    p.ln_s_cohesion[k] = of_s.by_cohesion
    p.ln_s_ln_K[k] = of_s.by_ln_K
    p.ln_s_exponent[k] = of_s.by_exponent + math.log(depth)
    return of_s


@compiled_inline
def _add_to_curve(banks, k, point, load, sinkage, variance, key, on_border, numbers):
    """Add a point to the traction curve: (bin that changed, bin that another took the place of, or
    -1).
    """
    p = banks.point
    new = curve.new_point()
    new[curve.READINGS] = point.readings
    new[curve.SLIP] = point.slip
    new[curve.SLIP_WEIGHT] = 1.0 / point.slip_variance
    new[curve.SINKAGE] = sinkage
    new[curve.SINKAGE_WEIGHT] = 1.0 / variance
    new[curve.PULL] = point.pull
    new[curve.PULL_WEIGHT] = 1.0 / point.pull_variance
    new[curve.TORQUE] = point.torque
    new[curve.TORQUE_WEIGHT] = 1.0 / point.torque_variance
    new[curve.LOAD] = load
    new[curve.PLACE] = point.place
    new[curve.SPREAD] = point.spread
    new[curve.KEY] = key
    new[curve.ON_BORDER] = 1.0 if on_border else 0.0
    count, changed, replaced = curve.add(banks.bins[k], int(p.bins[k]), new, numbers.border)
    if replaced >= 0 or count > int(p.bins[k]):
        begin_bin(banks, k, replaced if replaced >= 0 else changed, key)
    p.bins[k] = count
    p.points[k] = p.points[k] + 1.0
    return changed, replaced


@compiled_part
def _renew(banks, k, point, load, numbers):
    """Renew soil and sinkage of wheel k by a point."""
    p = banks.point
    s = banks.sinkage[k]
    rows = _slopes()
    least = 2e-3 * numbers.radius
    share, by_place = border.share_here(banks, k, point.place, point.spread, numbers)
    soil = ground_of(banks, k, share)
    before = max(mean(s, DEPTH), least)
    of_s = _predict_forces(banks, k, soil, before, point, load, rows, numbers)
    ground = Ground(
        of_s.value,
        before,
        of_s.by_sinkage * before,
        soil.exponent,
        share,
        by_place,
        p.border_variance[k],
    )
    motion = Motion(
        point.path, point.sliding, point.shock, point.time, point.sinkage, point.sinkage_variance
    )
    of_sinkage = follow(banks, k, ground, motion, numbers)
    after = max(mean(s, DEPTH), least)
    variance = _SINKAGE_SHARE * max(spread(s, DEPTH, DEPTH), 1e-12)
    if p.points[k] > 0.0 and p.crossing[k] == 0.0:
        surprise = _surprise(banks, k, rows, point, load, after - before, variance, numbers)
        if p.points[k] > _short(numbers):
            surprise += min(
                _OF_SINKAGE * max(of_sinkage - _SINKAGE_EXPECTED, 0.0), _MOST_OF_SINKAGE
            )
        p.misfit[k] = max(p.misfit[k] + surprise - _EXPECTED, 0.0)
    key = _key(rows, point, load, numbers)
    changed, replaced = _add_to_curve(
        banks, k, point, load, after, variance, key, share < 0.999, numbers
    )
    if p.same[k] == 0.0:
        renew_prior(banks, k, numbers)
    _adapt(p, k, fit(banks, k, changed, replaced, numbers), numbers)


@compiled_inline
def _adapt(p, k, misfit, numbers):
    """Renew the form error by the least chi-squared of a fit."""
    if p.bins[k] < 3.0 or p.crossing[k] > 0.0 or p.misfit[k] > _EXPECTED:  # it may be another soil
        return
    free = 2.0 * p.bins[k]
    aim = free / (_HARDER * _HARDER)
    least = numbers.model_error
    begins = _BEGINS if numbers.grade_change > 0.0 else _LATER
    if p.flagged[k] == 0.0:
        if misfit > free + begins * math.sqrt(2.0 * free):
            p.flagged[k] = 1.0
            p.form_error[k] = 2.0 * least
    elif misfit > aim:
        p.form_error[k] = min(_GROWS * p.form_error[k], _LARGEST)
    elif misfit < 0.5 * aim:
        p.form_error[k] /= _SHRINKS
        if p.form_error[k] <= 1.2 * least:
            p.flagged[k] = 0.0
            p.form_error[k] = least
