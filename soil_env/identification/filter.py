"""The estimator of `Belief.method` "filter": a bank of extended Kalman filters, one a lane.

Each filter of the bank follows the soil under the wheel, the sinkage as the state of the law of slip-sinkage, and the
mass on the wheel (`linearised`). The friction angle and the shear deformation modulus K hide each other along a curved
ridge, on which one Gaussian is sure of what it has not seen; therefore the prior of ln K is split among the filters of
the bank, and the estimate is the mean of their mixture (Gaussian sum filter: Alspach & Sorenson 1972, IEEE Trans.
Automatic Control 17:439-448). The slip, whose noise is that of an abscissa, is a state too.

Readings are averaged to points first. The sinkage between two points follows the exact solution of its law; that it
comes up to the bearing sinkage at once where it is less is taken in the mean over the uncertainty of both (statistical
linearisation: Gelb 1974, Applied Optimal Estimation, Sec. 6.2). When the grade changes, or the readings of a point or
two are less likely than the errors allow, the wheel comes to another soil (`border`): the bank keeps what it knows of
mass and sinkage, follows both soils over the border, and forgets the old one behind it.
"""

from __future__ import annotations

import math

from soil_env._numba.compiling import inlined
from soil_env._numba.elementary import smaller
from soil_env._numba.lanes import COUNT, fill, from_array, smallest, to_array, total
from soil_env.identification.border import cross_here, cross_where_the_grade_changes, end, note_grade
from soil_env.identification.digging import onto_fresh_ground
from soil_env.identification.filter_bank import CROSSING, element, fetch_bank, prior_of_soil, restart
from soil_env.identification.filter_update import Point, renew
from soil_env.identification.linearised import MASS, SINKAGE, SLIP, STATES
from soil_env.slip import motion_from_slip
from soil_env.terramechanics.contact import entry_angle, shear_displacement

# Limits of a point: readings, [m], range of slip, relative range of rim speed.
_READINGS, _LENGTH, _SLIP, _RIM = 8, 0.1, 0.05, 0.1
_ON_BORDER = 0.6  # of the readings and the length where the soil changes
_SPINNING = 0.85  # |slip| beyond which readings are passed over: a wheel that digs on the spot, or is locked
_SLOWEST = 0.02  # [m/s] rim speed below which readings say nothing of shear
#: The excess of the chi-squared of each point over `_EXPECTED` is summed, never below 0; a sum above this means another
#: soil. Both were set on courses of seed 7001, docs/identification.md.
CONTRADICTION_OF_POINTS = 12.0
_EXPECTED = 10.0  # chi-squared of a point, of seven channels, that raises no suspicion
_MASS_VARIANCE = 0.04  # relative, of the mass that the first load gives
_SINKAGE_SD = 0.1  # of the radius, of the first sinkage: reached where none is measured


# --- readings to points -----------------------------------------------------------------------------------------------


@inlined
def _advance_clocks(p, k, reading, numbers):
    """Integrals over the last period, of the readings' mean over it."""
    u, i = reading.rim_speed, min(max(reading.slip, -0.95), 0.98)
    v = u * motion_from_slip(i)[1]
    mean_v, mean_u = 0.5 * (v + p.last_speed[k]), 0.5 * (u + p.last_rim[k])
    step = numbers.period / numbers.relaxation
    sliding = abs(mean_u - mean_v) * step
    travel = onto_fresh_ground(p, k, mean_v * numbers.period)
    p.path[k] += travel / numbers.relaxation + numbers.dig_recovery * sliding
    p.sliding[k] += sliding
    p.shock[k] += abs(u - p.last_rim[k]) * step
    p.time[k] += numbers.period
    p.last_speed[k], p.last_rim[k] = v, u


@inlined
def _collect(p, k, r):
    p.slip[k] += r.slip
    p.sinkage[k] += r.sinkage
    p.drawbar_pull[k] += r.drawbar_pull
    p.load[k] += r.load
    p.torque[k] += r.torque
    p.speed[k] += r.speed
    p.rim_speed[k] += r.rim_speed
    p.pitch[k] += r.pitch
    p.motor_torque[k] += r.motor_torque
    p.acceleration[k] += r.acceleration
    p.path_sum[k] += p.path[k]
    p.sliding_sum[k] += p.sliding[k]
    p.shock_sum[k] += p.shock[k]
    p.time_sum[k] += p.time[k]
    place = p.place[k] - p.first_place[k]
    p.place_sum[k] += place
    p.place_square[k] += place * place
    p.readings[k] += 1.0


@inlined
def take(banks, k, reading, numbers):
    """Take one set of readings; True if it completed a point, with which bank k was renewed."""
    p, done = banks.point, False
    known = reading.slip + reading.sinkage + reading.drawbar_pull + reading.load + reading.torque + reading.speed
    known += reading.rim_speed + reading.pitch + reading.motor_torque + reading.acceleration
    if not abs(known) < 1e12:
        return False
    before, time = p.last_rim[k], p.time[k]
    if p.crossing[k] > 0.0 or p.readings[k] >= _READINGS - 1.0:  # likely to be needed
        fetch_bank(banks, k)
    _advance_clocks(p, k, reading, numbers)
    if numbers.grade_change > 0.0:
        note_grade(banks, k, reading.pitch, numbers)
    # the model does not predict a wheel that turns backwards, as when a halt throws it back
    useless = reading.rim_speed < _SLOWEST or reading.sinkage < 1e-3 * numbers.radius
    useless = useless or abs(reading.slip) > _SPINNING
    if p.readings[k] > 0.0:
        other = abs(reading.rim_speed - p.first_rim[k]) > _RIM * max(abs(p.first_rim[k]), 0.05)
        other = other or abs(reading.slip - p.first_slip[k]) > _SLIP
        most = _ON_BORDER if p.crossing[k] > 0.0 else 1.0
        if useless or other or p.readings[k] >= most * _READINGS or p.length[k] > most * _LENGTH:
            _complete(banks, k, before, time, numbers)
            done = True
    if useless:
        return done
    if p.readings[k] == 0.0:
        p.first_slip[k], p.first_rim[k] = reading.slip, reading.rim_speed
        p.rim_at[k], p.rim_time[k], p.first_place[k] = before, time, p.place[k]
    _collect(p, k, reading)
    p.length[k] += abs(reading.speed) * numbers.period
    return done


@inlined
def _close(p, k, rim, time, numbers):
    """The open point of bank k as `Point`, which ends at this rim speed and time; the next is empty."""
    n = p.readings[k]
    lasted = max(time - p.rim_time[k], numbers.period)
    faster = numbers.inertia / (numbers.radius * lasted)
    path, sliding, shock, middle = p.path_sum[k] / n, p.sliding_sum[k] / n, p.shock_sum[k] / n, p.time_sum[k] / n
    u = p.rim_speed[k] / n
    # a speed loop turns the wheel faster early in a period, and the torque is read at its end
    spin, turned = faster * numbers.noise[6], faster * (rim - p.rim_at[k])
    pitch, place = min(max(p.pitch[k] / n, -1.5), 1.5), p.place_sum[k] / n
    point = Point(
        n, min(max(p.slip[k] / n, -0.95), 0.98), max(p.sinkage[k] / n, 1e-3 * numbers.radius), p.drawbar_pull[k] / n,
        p.load[k] / n, p.torque[k] / n, p.speed[k] / n, u, pitch, math.cos(pitch),
        p.motor_torque[k] / n - turned, p.acceleration[k] / n,
        numbers.noise[8] * numbers.noise[8] / n + 2.0 * spin * spin + turned * turned,
        path - p.path_at[k], sliding - p.sliding_at[k], shock - p.shock_at[k], middle - p.time_at[k],
        p.first_place[k] + place, math.sqrt(max(p.place_square[k] / n - place * place, 0.0)),
    )  # fmt: skip
    p.path_at[k], p.sliding_at[k], p.shock_at[k], p.time_at[k] = path, sliding, shock, middle
    p.slip[k] = p.sinkage[k] = p.drawbar_pull[k] = p.load[k] = p.torque[k] = p.speed[k] = p.rim_speed[k] = 0.0
    p.pitch[k] = p.motor_torque[k] = p.acceleration[k] = p.path_sum[k] = p.sliding_sum[k] = p.shock_sum[k] = 0.0
    p.time_sum[k] = p.readings[k] = p.length[k] = p.place_sum[k] = p.place_square[k] = 0.0
    return point


@inlined
def _refer(p, k, point, numbers):
    """Compare strength from now on at the mean shear displacement and normal stress of this point."""
    r = numbers.radius
    entry = entry_angle(min(point.sinkage, 1.9 * r), r)
    middle = 0.5 * entry
    rim, travel = motion_from_slip(max(abs(point.slip), 0.02))
    p.displacement[k] = shear_displacement(middle, entry, math.sin(entry), rim, travel, r)[0]
    p.stress[k] = max(point.load, 1e-3) / (r * numbers.width * math.sin(middle) * 2.0)


@inlined
def _sound(banks, k, misfit):
    """Whether all numbers of bank k are finite and its variances positive."""
    every, least = fill(0.0), fill(1.0)
    for i in range(CROSSING if banks.point.crossing[k] > 0.0 else STATES):
        every = every + abs(from_array(banks.mean[k], i * COUNT))
        variance = from_array(banks.covariance[k], element(i, i))
        every, least = every + abs(variance), smaller(least, variance)
    return total(every) < 1e18 and smallest(least) > 0.0 and abs(misfit) < 1e12


@inlined
def _start(banks, k, point, numbers):
    """The first point of bank k: a mass, a sinkage, and where strength is compared."""
    mean, covariance, unsure = banks.mean[k], banks.covariance[k], _SINKAGE_SD * numbers.radius
    least = 1e-3 * numbers.noise[3] / numbers.gravity
    mass = max(point.load / (numbers.gravity * point.cos_pitch), least)
    to_array(fill(mass), mean, MASS * COUNT)
    to_array(fill(_MASS_VARIANCE * mass * mass), covariance, element(MASS, MASS))
    to_array(fill(point.sinkage), mean, SINKAGE * COUNT)
    variance = min(1e2 * numbers.noise[1] * numbers.noise[1], unsure * unsure)
    to_array(fill(variance), covariance, element(SINKAGE, SINKAGE))
    to_array(fill(point.slip), mean, SLIP * COUNT)
    _refer(banks.point, k, point, numbers)
    prior_of_soil(banks, k, numbers)


@inlined
def _complete(banks, k, rim, time, numbers):
    """Close the open point, see whether a border begins or ends with it, and renew bank k by it."""
    p = banks.point
    first = p.first_place[k]
    point = _close(p, k, rim, time, numbers)
    if banks.covariance[k, element(MASS, MASS)] == 0.0:
        _start(banks, k, point, numbers)
    if p.crossing[k] == 0.0:
        if numbers.grade_change > 0.0:
            cross_where_the_grade_changes(banks, k, numbers)
    elif first > p.border[k] + 0.5 * numbers.border:
        end(banks, k, numbers)
    misfit = renew(banks, k, point, numbers)
    if not _sound(banks, k, misfit):  # readings that no wheel gives
        restart(banks, k, numbers)
        return
    p.grade_used[k] = 0.0
    before = p.misfit[k] if p.points[k] > 0.0 else 0.0
    expected = _EXPECTED + p.crossing[k]  # on a border the pitch is a channel more
    p.misfit[k] = max(before + misfit - expected, 0.0)
    p.points[k] += 1.0
    if p.misfit[k] > CONTRADICTION_OF_POINTS and p.points[k] > 2.0 and p.crossing[k] == 0.0:
        cross_here(banks, k, numbers)
