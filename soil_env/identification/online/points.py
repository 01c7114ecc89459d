"""Readings to points: like readings are averaged, two sensors of one quantity by their precision.

Readings of a wheel that nearly rests, locks, spins on the spot or is strongly accelerated belong to
no point, because the laws are those of steady motion.
"""

import math
from typing import NamedTuple

from numba import literal_unroll

from soil_env._compiled.flags import compiled
from soil_env.parameters.sensors import SensorReading

NAMES = SensorReading._fields
# Readings of a point; with 4 the errors of ln K grow by 5 %.
READINGS = 8.0
# [-] Standard deviation of the slip that a point has at most, if it can: noise of slip that is
# taken for slip draws ln K and phi down. A slow wheel needs more readings for it, up to three times
# as many.
SHARPEST_SLIP = 0.012
MOST_READINGS = 3.0 * READINGS
# Readings of each of the first points of a soil: sooner a first estimate.
FIRST_READINGS = 3.0
FIRST_POINTS = 3
LONGEST = 3.0  # [radii] of a point
SLIP_RANGE = 0.08  # [-] of the readings of a point, beyond three standard deviations
SLOWEST = 0.02  # [m/s] rim speed below which a wheel rests
BLUNTEST = 0.1  # [-] standard deviation of a slip above which it says nothing
SPINNING = 0.9  # [-] slip above which a wheel spins on the spot
LOCKED = -0.4  # [-] slip below which it is as good as locked
THROWN = 0.115  # [of gravity] acceleration of the rim above which the laws do not hold
SPIN_ERROR = 8.0  # [-] error of a motor torque over the one that turns the wheel faster
LIFTED = 0.05  # [of weight] load below which a wheel is in the air
LAG = 0.3  # [periods] between the ground that a reading shows and the place at its end
RESTS_KEPT = 60.0  # readings that the mean pull of a standing wheel remembers
TYPICAL_TORQUE = 0.3  # [of weight x radius] at which a gain counts as an error of a torque
TYPICAL_PULL = 0.2  # [of weight] the same of a pull


@compiled
def is_sound(reading, setting):
    """True if all readings are numbers that a wheel can give."""
    largest = setting.largest[0]
    sound = True
    for name in literal_unroll(NAMES):
        sound = sound and abs(reading[name]) <= largest[name]
    return sound


@compiled
def slip_error(reading, setting):
    """Standard deviation of the slip: of its own sensor, or by the white noise of the speeds."""
    white = setting.white[0]
    if white.slip > 0.0:
        return white.slip
    rim = max(abs(reading.rim_speed), SLOWEST)
    travel = min(abs(reading.speed) / rim, 2.0)
    rate = 1.0 / max(travel, 1.0) ** 2
    return rate * math.hypot(white.speed, travel * white.rim_speed) / rim


@compiled
def advance(memory, reading, turned, setting):
    """Advance place and clocks by a period, with the means of the speeds at its beginning and end;
    `turned`: change of the rim speed in it [m/s].
    """
    step = setting.period / setting.length
    speed = 0.5 * (memory.last_speed + reading.speed)
    rim = 0.5 * (memory.last_rim + reading.rim_speed)
    memory.place += speed * setting.period
    memory.travel += abs(speed) * step
    memory.slide += abs(rim - speed) * step
    memory.turning += turned * step
    memory.last_speed = reading.speed
    memory.last_rim = reading.rim_speed


@compiled
def is_steady(reading, error, turned, setting):
    """True if the wheel drives on the ground without spinning, locking or a jump of its speed."""
    drives = reading.rim_speed > SLOWEST and LOCKED <= reading.slip <= SPINNING
    touches = reading.load >= LIFTED * setting.weight and reading.sinkage > 0.0
    return (
        drives
        and touches
        and error < BLUNTEST
        and turned < THROWN * setting.gravity * setting.period
    )


@compiled
def ends_point(point, reading, error, most, setting):
    """True if the open point has enough readings, or this one is unlike its first."""
    enough = point.readings >= most and (
        point.slip_weight * SHARPEST_SLIP**2 >= 1.0 or point.readings >= MOST_READINGS
    )
    long = abs(reading.speed) * setting.period * point.readings > LONGEST * setting.radius
    return enough or long or abs(reading.slip - point.first_slip) > SLIP_RANGE + 3.0 * error


@compiled
def weigh(memory, reading, setting):
    """Renew the mass on the wheel by a reading of the load, if there is one; first it is the
    body's.
    """
    if memory.mass == 0.0:
        memory.mass = setting.weight / setting.gravity
    if setting.white[0].load > setting.weight or reading.load < LIFTED * setting.weight:
        return
    memory.weighings += 1.0
    share = 1.0 / memory.weighings
    if setting.load_varies > 0:
        share = max(share, 1.0 / READINGS)
    mass = reading.load / (setting.gravity * math.cos(reading.pitch))
    memory.mass += share * (mass - memory.mass)


class Sensor(NamedTuple):
    """One of two sensors of a quantity."""

    reading: float
    white: float  # standard deviation of its noise
    zero: float  # of its zero
    gain: float  # of what its gain makes of a typical reading


@compiled
def _combine(one, other, unit):
    """(mean of two sensors by their precision, its white variance, share of the other), over a
    unit.
    """
    own = 1.0 / (one.white**2 + one.zero**2 + one.gain**2)
    theirs = 1.0 / (other.white**2 + other.zero**2 + other.gain**2)
    share = theirs / (own + theirs)
    mean = (1.0 - share) * one.reading + share * other.reading
    variance = ((1.0 - share) * one.white) ** 2 + (share * other.white) ** 2
    return mean / unit, variance / (unit * unit), share


@compiled
def combined_pull(memory, reading, setting):
    """`_combine` of force sensor and accelerometer, of the weight."""
    white = setting.white[0]
    zero = setting.zero[0]
    gain = setting.gain[0]
    weight = setting.weight
    mass = memory.mass
    typical = TYPICAL_PULL * weight
    of_mass = typical * math.hypot(gain.load, gain.acceleration)
    return _combine(
        Sensor(
            reading.drawbar_pull,
            white.drawbar_pull,
            zero.drawbar_pull,
            typical * gain.drawbar_pull,
        ),
        Sensor(
            mass * reading.acceleration,
            mass * white.acceleration,
            mass * zero.acceleration,
            of_mass,
        ),
        weight,
    )


@compiled
def _combined_torque(reading, turned, setting):
    """`_combine` of torque sensor and motor torque, of weight x radius; `turned`: change of the rim
    speed [m/s] in the period, which costs the motor a torque of its own.
    """
    white = setting.white[0]
    zero = setting.zero[0]
    gain = setting.gain[0]
    unit = setting.weight * setting.radius
    typical = TYPICAL_TORQUE * unit
    spin = SPIN_ERROR * setting.inertia / (setting.radius * setting.period)
    accelerated = spin * spin * max(turned * turned - 2.0 * white.rim_speed**2, 0.0)
    of_motor = math.sqrt(white.motor_torque**2 + accelerated)
    return _combine(
        Sensor(reading.torque, white.torque, zero.torque, typical * gain.torque),
        Sensor(reading.motor_torque, of_motor, zero.motor_torque, typical * gain.motor_torque),
        unit,
    )


@compiled
def collect(point, memory, reading, error, turned, setting):
    """Add a reading to the open point."""
    place = memory.place - LAG * reading.speed * setting.period
    if point.readings == 0.0:
        point.first_slip = reading.slip
        point.first_place = place
    point.readings += 1.0
    weight = 1.0 / (error * error)
    point.slip += weight * reading.slip
    point.slip_weight += weight
    point.sinkage += reading.sinkage
    pull, variance, share = combined_pull(memory, reading, setting)
    point.pull += pull / variance
    point.pull_weight += 1.0 / variance
    point.inertial += share / variance
    torque, variance, share = _combined_torque(reading, turned, setting)
    point.torque += torque / variance
    point.torque_weight += 1.0 / variance
    point.motor += share / variance
    point.load += reading.load
    point.cos_pitch += math.cos(reading.pitch)
    behind = place - point.first_place
    point.place += behind
    point.place_square += behind * behind
    point.travel += memory.travel
    point.slide += memory.slide
    point.turning += memory.turning


# [relaxation lengths] that the rim turns faster or slower between two points, above which the wheel
# has stopped between them: soil yields under it there
STOPPED = 0.1


@compiled
def close(memory, cell, setting):
    """Write the means of the open point into `cell`, with the change of sinkage since the last."""
    point = memory.open[0]
    n = point.readings
    sinkage = point.sinkage / n
    travel = point.travel / n
    slide = point.slide / n
    turning = point.turning / n
    cell.slip = point.slip / point.slip_weight
    cell.slip_variance = 1.0 / point.slip_weight
    cell.most_likely_slip = cell.slip
    cell.sinkage = sinkage
    cell.sinkage_variance = setting.white[0].sinkage ** 2 / n
    cell.pull = point.pull / point.pull_weight
    cell.pull_variance = 1.0 / point.pull_weight
    cell.inertial = point.inertial / point.pull_weight
    cell.torque = point.torque / point.torque_weight
    cell.torque_variance = 1.0 / point.torque_weight
    cell.motor = point.motor / point.torque_weight
    cell.load = memory.mass * setting.gravity * point.cos_pitch / n
    if setting.load_varies > 0:
        cell.load = max(point.load / n, LIFTED * setting.weight)
    cell.readings = n
    mean = point.place / n
    cell.place = point.first_place + mean
    cell.spread = math.sqrt(max(point.place_square / n - mean * mean, 0.0))
    cell.place_error = 0.0
    rolled = memory.point_sinkage > 0.0 and turning - memory.point_turning < STOPPED
    cell.changes = 1.0 if rolled else 0.0
    cell.rise = sinkage - memory.point_sinkage
    cell.travel = travel - memory.point_travel
    cell.slide = slide - memory.point_slide
    cell.middle = 0.5 * (sinkage + memory.point_sinkage)
    cell.compaction = memory.compaction
    memory.point_sinkage = sinkage
    memory.point_travel = travel
    memory.point_slide = slide
    memory.point_turning = turning
    memory.open[0] = setting.blank[0].open[0]


STANDSTILL = 3.0  # readings after which a wheel that stands has settled


@compiled
def record_rest(memory, reading, setting):
    """Where the wheel stands, its pull is that of its weight on the slope: the rest is the zero."""
    standing = abs(reading.rim_speed) < SLOWEST and abs(reading.speed) < SLOWEST
    memory.standing = memory.standing + 1.0 if standing else 0.0
    if memory.standing > STANDSTILL:
        pull, _, _ = combined_pull(memory, reading, setting)
        slope = memory.mass * setting.gravity * math.sin(reading.pitch) / setting.weight
        memory.rests = min(memory.rests + 1.0, RESTS_KEPT)
        memory.rest_pull += (pull - slope - memory.rest_pull) / memory.rests
