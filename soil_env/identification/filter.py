"""The estimator of `Belief.method` "filter": a bank of iterated extended Kalman filters, one a lane.

Each filter of the bank follows the soil under the wheel, the sinkage as the state of the law of slip-sinkage, and the
mass on the wheel (`linearised`). The friction angle and the shear deformation modulus K hide each other along a curved
ridge, on which one Gaussian is sure of what it has not seen; therefore the prior of ln K is split among the filters of
the bank, and the estimate is the mean of their mixture (Gaussian sum filter: Alspach & Sorenson 1972, IEEE Trans.
Automatic Control 17:439-448). Within a filter the update is iterated (Bell & Cathey 1993, IEEE Trans. Automatic Control
38:294-297), and the slip, whose noise is that of an abscissa, is a state too.

Readings are averaged to points first. The sinkage between two points follows the exact solution of its law; that it
comes up to the bearing sinkage at once where it is less is taken in the mean over the uncertainty of both (statistical
linearisation: Gelb 1974, Applied Optimal Estimation, Sec. 6.2). When the readings of a point or two are less likely
than the errors allow, the wheel has come to another soil: the bank starts from the prior of the soil again, and keeps
what it knows of mass and sinkage.
"""

from __future__ import annotations

import math

from soil_env._numba.compiling import inlined
from soil_env._numba.elementary import smaller
from soil_env._numba.lanes import COUNT, fill, from_array, smallest, to_array, total
from soil_env.identification.filter_bank import element, prior_of_soil, restart
from soil_env.identification.filter_update import Point, renew
from soil_env.identification.linearised import (
    MASS,
    SINKAGE,
    SLIP,
    STATES,
)

# of a point at most: readings, [m], range of slip, relative range of rim speed
_READINGS, _LENGTH, _SLIP, _RIM = 5, 0.06, 0.05, 0.1
_SPINNING = 0.85  # slip beyond which a wheel digs on the spot and is passed over
_SLOWEST = 0.02  # [m/s] rim speed below which readings say nothing of shear
_FADES = 0.05  # [m] in which the doubt that is added at a border fades
_FOUND = 0.1  # [m] from where a soil begins to change to where the filter finds it out
#: Of the sum of what the chi-squared of successive points exceeds `_EXPECTED` by, where the soil is another. Both were
#: set on courses of seed 7001, docs/identification.md.
CONTRADICTION_OF_POINTS = 25.0
_EXPECTED = 10.0  # chi-squared of a point, of seven channels, that raises no suspicion
_AT_BORDER = 1.0  # 1-sigma of the model at a border, of the load
_MASS_VARIANCE = 0.04  # relative, of the mass that the first load gives
_SINKAGE_SD = 0.1  # of the radius, of the first sinkage: reached where none is measured


# --- readings to points -----------------------------------------------------------------------------------------------


@inlined
def _advance_clocks(p, k, reading, numbers):
    """Integrals over the last period, of the readings' mean over it."""
    u, i = reading.rim_speed, min(max(reading.slip, -0.95), 0.98)
    v = u * (1.0 - i) if i >= 0.0 else u / (1.0 + i)
    mean_v, mean_u = 0.5 * (v + p.last_speed[k]), 0.5 * (u + p.last_rim[k])
    step = numbers.period / numbers.relaxation
    sliding = abs(mean_u - mean_v) * step
    p.path[k] += abs(mean_v) * step + numbers.dig_recovery * sliding
    p.sliding[k] += sliding
    p.shock[k] += abs(u - p.last_rim[k]) * step
    p.time[k] += numbers.period
    p.last_speed[k], p.last_rim[k] = v, u
    p.since[k] += abs(mean_v) * numbers.period


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
    _advance_clocks(p, k, reading, numbers)
    # a wheel that turns backwards, as when a halt throws it back, is none that the model predicts
    useless = reading.rim_speed < _SLOWEST or reading.sinkage < 1e-3 * numbers.radius
    useless = useless or abs(reading.slip) > _SPINNING
    if p.readings[k] > 0.0:
        other = abs(reading.rim_speed - p.first_rim[k]) > _RIM * max(abs(p.first_rim[k]), 0.05)
        other = other or abs(reading.slip - p.first_slip[k]) > _SLIP
        if useless or other or p.readings[k] >= _READINGS or p.length[k] > _LENGTH:
            _complete(banks, k, before, time, numbers)
            done = True
    if useless:
        return done
    if p.readings[k] == 0.0:
        p.first_slip[k], p.first_rim[k] = reading.slip, reading.rim_speed
        p.rim_at[k], p.rim_time[k] = before, time
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
    error = numbers.model_error + _AT_BORDER * math.exp(-p.since[k] / _FADES)
    point = Point(
        n, min(max(p.slip[k] / n, -0.95), 0.98), max(p.sinkage[k] / n, 1e-3 * numbers.radius), p.drawbar_pull[k] / n,
        p.load[k] / n, p.torque[k] / n, p.speed[k] / n, u, math.cos(min(max(p.pitch[k] / n, -1.5), 1.5)),
        p.motor_torque[k] / n - turned, p.acceleration[k] / n,
        numbers.noise[8] * numbers.noise[8] / n + 2.0 * spin * spin + turned * turned,
        path - p.path_at[k], sliding - p.sliding_at[k], shock - p.shock_at[k], middle - p.time_at[k], error,
        abs(u) * (middle - p.time_at[k]),
    )  # fmt: skip
    p.path_at[k], p.sliding_at[k], p.shock_at[k], p.time_at[k] = path, sliding, shock, middle
    p.slip[k] = p.sinkage[k] = p.drawbar_pull[k] = p.load[k] = p.torque[k] = p.speed[k] = p.rim_speed[k] = 0.0
    p.pitch[k] = p.motor_torque[k] = p.acceleration[k] = p.path_sum[k] = p.sliding_sum[k] = p.shock_sum[k] = 0.0
    p.time_sum[k] = p.readings[k] = p.length[k] = 0.0
    return point


@inlined
def _share_at(since, border):
    """Share of the new soil so far [m] behind where a border was found, as `terrain.ground_at` blends them."""
    t = min((since + _FOUND) / border, 1.0)
    return t * t * (3.0 - 2.0 * t)


@inlined
def _refer(p, k, point, numbers):
    """Compare strength from now on at the mean shear displacement and normal stress of this point."""
    r = numbers.radius
    entry = math.acos(max(1.0 - point.sinkage / r, -0.9))
    middle, slip = 0.5 * entry, max(abs(point.slip), 0.02)
    p.displacement[k] = r * ((entry - middle) - (1.0 - slip) * (math.sin(entry) - math.sin(middle)))
    p.stress[k] = max(point.load, 1e-3) / (r * numbers.width * math.sin(middle) * 2.0)


@inlined
def _sound(banks, k, misfit):
    """Whether all numbers of bank k are finite and its variances positive."""
    every, least = fill(0.0), fill(1.0)
    for i in range(STATES):
        every = every + abs(from_array(banks.mean[k], i * COUNT))
        variance = from_array(banks.covariance[k], element(i, i))
        every, least = every + abs(variance), smaller(least, variance)
    return total(every) < 1e18 and smallest(least) > 0.0 and abs(misfit) < 1e12


@inlined
def _complete(banks, k, rim, time, numbers):
    """Close the open point, and renew bank k by it: twice, the second time from the prior, if it contradicts."""
    p = banks.point
    point = _close(p, k, rim, time, numbers)
    mean, covariance = banks.mean[k], banks.covariance[k]
    unsure = _SINKAGE_SD * numbers.radius
    if covariance[element(MASS, MASS)] == 0.0:
        least = 1e-3 * numbers.noise[3] / numbers.gravity
        mass = max(point.load / (numbers.gravity * point.cos_pitch), least)
        to_array(fill(mass), mean, MASS * COUNT)
        to_array(fill(_MASS_VARIANCE * mass * mass), covariance, element(MASS, MASS))
        to_array(fill(point.sinkage), mean, SINKAGE * COUNT)
        variance = min(1e2 * numbers.noise[1] * numbers.noise[1], unsure * unsure)
        to_array(fill(variance), covariance, element(SINKAGE, SINKAGE))
        to_array(fill(point.slip), mean, SLIP * COUNT)
        _refer(p, k, point, numbers)
        prior_of_soil(banks, k, numbers)
    p.share[k] = _share_at(p.since[k], numbers.border)
    misfit = renew(banks, k, point, numbers)
    if not _sound(banks, k, misfit):  # readings that no wheel gives
        restart(banks, k, numbers)
        return
    p.misfit[k] = max(p.misfit[k] + misfit - _EXPECTED, 0.0)
    p.points[k] += 1.0
    if p.misfit[k] > CONTRADICTION_OF_POINTS and p.points[k] > 2.0:
        _refer(p, k, point, numbers)
        prior_of_soil(banks, k, numbers)
        p.since[k], p.share[k] = 0.0, _share_at(0.0, numbers.border)
        to_array(fill(point.sinkage), mean, SINKAGE * COUNT)
        variance = min(numbers.noise[1] * numbers.noise[1] / point.readings, unsure * unsure)
        to_array(fill(variance), covariance, element(SINKAGE, SINKAGE))
