"""Readings to points: like readings are averaged, two sensors of one quantity by their precision.

Readings of a wheel that nearly rests, locks, spins on the spot or is strongly accelerated belong to
no point, because the laws are those of steady motion.

`memory`, `setting`, `point` and `reading` are records `MEMORY`, `SETTING`, `OPEN` and `READING` of
memory.py.
"""

import math
from typing import NamedTuple

from numba import literal_unroll

from soil_env._compiled.flags import compiled
from soil_env.parameters.sensors import SensorReading

NAMES = SensorReading._fields
# Readings of a point, own choice; with 4 the errors of ln K grow by 5 %.
READINGS = 8.0
# [-] Standard deviation of the slip that a point has at most, if it can, own choice. Noise of slip
# that is taken for slip draws ln K and phi down. A slow wheel needs more readings for it.
SHARPEST_SLIP = 0.012
MOST_READINGS = 3.0 * READINGS  # of a point of a slow wheel, own choice
# Readings of each of the first `FIRST_POINTS` points of a soil, for sooner a first estimate, and of
# each on a border, where the ground changes from one to the next: own choices.
FEW_READINGS = 3.0
FIRST_POINTS = 3
LONGEST = 3.0  # [radii] travel over a point, own choice
# [-] Range of slip of a point beyond three standard deviations, own choice. Forces are curved over
# slip, so their mean is not the force at the mean slip; with 0.08 the errors of ln K grow by 3 %.
SLIP_RANGE = 0.04
# [m/s] Rim or travel speed below which a wheel rests: 20 times the speed below which slip and
# resistance of the world go to zero (docs/physics/wheel.md).
SLOWEST = 0.02
# [-] standard deviation that a slip of 0 would have, above which the rim is too slow, own choice
BLUNTEST = 0.1
SPINNING = 0.9  # [-] slip above which a wheel spins on the spot, own choice
LOCKED = -0.4  # [-] slip below which a wheel is as good as locked, own choice
MOST_TRAVEL = 2.0  # [of rim speed] travel speed in the noise of a slip, at most, own choice
# [of gravity] acceleration of the rim above which the laws of steady motion do not hold, own choice
THROWN = 0.115
# [-] error of a motor torque over the torque that turns wheel and rotor faster, own choice
SPIN_ERROR = 8.0
# [of weight] Load below which a wheel is in the air, own choice; also the least load that a force
# is divided by (`ground`, `immobilisation`).
LIFTED = 0.05
# [periods] of travel from the ground that a reading shows to the place at its end, own choice
LAG = 0.3
RESTS_KEPT = 60.0  # readings over which the pull of a standing wheel is averaged, own choice
# Sizes at which the error of a gain is weighed beside those of zero and white noise: own choices.
TYPICAL_TORQUE = 0.3  # [of weight x radius]
TYPICAL_PULL = 0.2  # [of weight]


@compiled
def is_sound(reading, setting):
    """True if all of a `READING` are numbers that a wheel can give: at most `SETTING.largest`."""
    largest = setting.largest[0]
    sound = True
    for name in literal_unroll(NAMES):
        sound = sound and abs(reading[name]) <= largest[name]
    return sound


@compiled
def slip_error(rim_speed, speed, setting):
    """Standard deviation of the slip [-]: that of a slip sensor where there is one (white noise
    above 0), else by the white noise of rim and travel speed [m/s].

    Rim speeds below `SLOWEST` count as `SLOWEST`, travel speeds above `MOST_TRAVEL` of the rim's as
    that. Braked, the slip is rim over travel speed less 1.
    """
    white = setting.white[0]
    if white.slip > 0.0:
        return white.slip
    rim = max(abs(rim_speed), SLOWEST)
    travel = min(abs(speed) / rim, MOST_TRAVEL)
    rate = 1.0 / max(travel, 1.0) ** 2
    return rate * math.hypot(white.speed, travel * white.rim_speed) / rim


@compiled
def advance(memory, reading, turned, setting):
    """Advance place and clocks by a period, with the means of the speeds at its beginning and end.

    The clocks count relaxation lengths: of travel, of sliding, and of changes of the rim speed.
    `turned` [m/s]: change of the rim speed in the period, without sign.
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
def is_steady(reading, turned, setting):
    """True if the wheel drives on the ground without spinning, locking or a jump of its speed, and
    its slip is well enough known.

    `turned` [m/s]: change of the rim speed in the period, without sign. How well a slip is known
    is judged at the same rim speed without slip. Judged at the noisy travel speed, readings of a
    braked wheel would be chosen by that noise.
    """
    drives = reading.rim_speed > SLOWEST and LOCKED <= reading.slip <= SPINNING
    touches = reading.load >= LIFTED * setting.weight and reading.sinkage > 0.0
    return (
        drives
        and touches
        and slip_error(reading.rim_speed, reading.rim_speed, setting) < BLUNTEST
        and turned < THROWN * setting.gravity * setting.period
    )


@compiled
def ends_point(point, reading, error, wanted, setting):
    """True if the open point has enough readings or is too long, or the slip of this reading is
    unlike that of its first.

    Enough are `wanted` readings and a slip as sharp as `SHARPEST_SLIP`, or `MOST_READINGS`.
    `error`: standard deviation of the slip of the reading.
    """
    enough = point.readings >= wanted and (
        point.slip_weight * SHARPEST_SLIP**2 >= 1.0 or point.readings >= MOST_READINGS
    )
    long = abs(reading.speed) * setting.period * point.readings > LONGEST * setting.radius
    return enough or long or abs(reading.slip - point.first_slip) > SLIP_RANGE + 3.0 * error


@compiled
def weigh(memory, reading, setting):
    """Renew the mass [kg] on the wheel by a reading of the load; before the first it is the body's.

    It is the mean over all readings, or where the load varies an average over about the last
    `READINGS`. What was not measured and what a lifted wheel shows does not count.
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
    """One of two sensors of a quantity: its reading and standard deviations of its errors."""

    reading: float
    white: float  # of the white noise
    zero: float  # of the zero
    gain: float  # of the error by the gain at a typical reading


@compiled
def _combine(one, other, unit):
    """(mean of two sensors `one` and `other`, variance of its white noise, share of `other` in it);
    the mean in a `unit` [SI], the variance in its square.

    Sensors count by their precision: 1 over the sum of the variances of all three errors.
    """
    own = 1.0 / (one.white**2 + one.zero**2 + one.gain**2)
    others = 1.0 / (other.white**2 + other.zero**2 + other.gain**2)
    share = others / (own + others)
    mean = (1.0 - share) * one.reading + share * other.reading
    variance = ((1.0 - share) * one.white) ** 2 + (share * other.white) ** 2
    return mean / unit, variance / (unit * unit), share


@compiled
def combined_pull(memory, reading, setting):
    """Pull by force sensor and accelerometer: (mean [of weight], its variance, share of the
    accelerometer), as of `_combine`.

    The accelerometer reads the sum of acceleration and g sin(grade); the pull is that sum times the
    mass on the wheel.
    """
    white = setting.white[0]
    zero = setting.zero[0]
    gain = setting.gain[0]
    weight = setting.weight
    mass = memory.mass
    typical = TYPICAL_PULL * weight
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
            typical * math.hypot(gain.load, gain.acceleration),
        ),
        weight,
    )


@compiled
def _combined_torque(reading, turned, setting):
    """Torque by its sensor and the motor's: (mean [of weight x radius], its variance, share of the
    motor), as of `_combine`.

    A change `turned` [m/s] of the rim speed in the period takes a torque of the motor. `SPIN_ERROR`
    times that torque counts as white noise of the motor's. First the variance that white noise
    gives the difference of two rim speeds is taken off the square of the change.
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
    """Add a reading to the open point, with the place of the ground that it shows.

    Pull and torque also count by the precision of the slip: their means are then those at its mean,
    though a wheel that slows down is less sure of it from reading to reading. That precision is by
    the noisy travel speed, so the mean slip of a slow braked wheel is a little too low: by 0.009 at
    6 cm/s. By the rim speed alone it would not be, but the errors of ln K and ln S grow by 2 %.

    `error`: standard deviation of its slip; `turned` [m/s]: change of the rim speed in the period.
    """
    place = memory.place - LAG * reading.speed * setting.period
    if point.readings == 0.0:
        point.first_slip = reading.slip
        point.first_place = place
    point.readings += 1.0
    weight = 1.0 / (error * error)
    point.slip += weight * reading.slip
    point.slip_weight += weight
    if setting.white[0].slip == 0.0:
        point.by_speeds += weight
    pull, variance, share = combined_pull(memory, reading, setting)
    of_pull = weight / variance
    point.pull += of_pull * pull
    point.pull_weight += of_pull
    point.pull_noise += of_pull * weight
    point.inertial += of_pull * share
    torque, variance, share = _combined_torque(reading, turned, setting)
    of_torque = weight / variance
    point.torque += of_torque * torque
    point.torque_weight += of_torque
    point.torque_noise += of_torque * weight
    point.motor += of_torque * share
    weight = 1.0 / setting.white[0].sinkage ** 2
    point.sinkage += weight * reading.sinkage
    point.sinkage_weight += weight
    if setting.white[0].load <= setting.weight:  # it was measured
        point.load += reading.load
        point.loads += 1.0
    point.cos_pitch += math.cos(reading.pitch)
    past = place - point.first_place
    point.place += past
    point.place_square += past * past
    point.travel += memory.travel
    point.slide += memory.slide
    point.turning += memory.turning


# [relaxation lengths] Advance of the clock `turning` (summed changes of rim speed) from point to
# point, above which the wheel has stopped between them, own choice. Soil yields under a standing
# wheel, which the law of sinkage does not know.
STOPPED = 0.1


@compiled
def close(memory, cell, setting):
    """Write the means of the open point into `cell`, with the change of sinkage since the point
    before, and open an empty one.

    `memory`: `MEMORY` of a wheel, `cell`: `CELL`, `setting`: `SETTING`. The first point, one before
    which the wheel has stopped, and one whose sinkage or that before it was not measured have
    `changes` 0: their change does not count. Where the load [N] does not vary, or was not measured,
    it is that of `memory.mass` at the mean slope of the point.
    """
    point = memory.open[0]
    n = point.readings
    sinkage = point.sinkage / point.sinkage_weight
    measured = point.sinkage_weight * setting.radius**2 > 1.0
    travel = point.travel / n
    slide = point.slide / n
    turning = point.turning / n
    cell.slip = point.slip / point.slip_weight
    cell.slip_variance = 1.0 / point.slip_weight
    cell.most_likely_slip = cell.slip
    cell.by_speeds = point.by_speeds / point.slip_weight
    cell.sinkage = sinkage
    cell.sinkage_variance = 1.0 / point.sinkage_weight
    cell.pull = point.pull / point.pull_weight
    cell.pull_variance = point.pull_noise / point.pull_weight**2
    cell.inertial = point.inertial / point.pull_weight
    cell.torque = point.torque / point.torque_weight
    cell.torque_variance = point.torque_noise / point.torque_weight**2
    cell.motor = point.motor / point.torque_weight
    cell.load = memory.mass * setting.gravity * point.cos_pitch / n
    if setting.load_varies > 0 and point.loads > 0.0:
        cell.load = max(point.load / point.loads, LIFTED * setting.weight)
    cell.readings = n
    mean = point.place / n
    cell.place = point.first_place + mean
    cell.spread = math.sqrt(max(point.place_square / n - mean * mean, 0.0))
    cell.place_error = 0.0
    rolled = memory.point_sinkage > 0.0 and turning - memory.point_turning < STOPPED
    cell.changes = 1.0 if rolled and measured else 0.0
    cell.rise = sinkage - memory.point_sinkage
    cell.rise_variance = cell.sinkage_variance + memory.point_variance
    cell.travel = travel - memory.point_travel
    cell.slide = slide - memory.point_slide
    cell.middle = 0.5 * (sinkage + memory.point_sinkage)
    cell.compaction = memory.compaction
    memory.point_sinkage = sinkage if measured else 0.0
    memory.point_variance = cell.sinkage_variance
    memory.point_slip = cell.slip
    memory.point_travel = travel
    memory.point_slide = slide
    memory.point_turning = turning
    memory.open[0] = setting.blank[0].open[0]


STANDSTILL = 3.0  # readings after which a wheel that stands has settled, own choice


@compiled
def record_rest(memory, reading, setting):
    """Average what a settled, standing wheel pulls beyond its weight on the slope: the zero of the
    pull, over about the last `RESTS_KEPT` readings. Those without pull or pitch do not count, nor
    does a wheel of a rover: its axles brace against each other.
    """
    white = setting.white[0]
    variance = (white.drawbar_pull / setting.weight) ** 2 + white.pitch**2
    standing = abs(reading.rim_speed) < SLOWEST and abs(reading.speed) < SLOWEST
    memory.standing = memory.standing + 1.0 if standing else 0.0
    if memory.standing > STANDSTILL and variance < 1.0 and not setting.load_varies:
        pull = combined_pull(memory, reading, setting)[0]
        slope = memory.mass * setting.gravity * math.sin(reading.pitch) / setting.weight
        memory.rests = min(memory.rests + 1.0, RESTS_KEPT)
        memory.rest_pull += (pull - slope - memory.rest_pull) / memory.rests
        memory.rest_variance += (variance - memory.rest_variance) / memory.rests
