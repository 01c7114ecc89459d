"""Sensors of a wheel: readings with noise and errors."""

from math import hypot
from typing import NamedTuple

import numpy as np
from numba import literal_unroll

from soil_env._compiled.flags import compiled_finite, inlined, record
from soil_env._compiled.random_streams import NORMALS, draw_normals, normal_pair
from soil_env.parameters import Scenario
from soil_env.parameters.readings import reading_errors
from soil_env.parameters.sensors import SensorReading
from soil_env.slip import SLOWEST, signed_slip
from soil_env.terramechanics.effects.slip_bias import measured_slip
from soil_env.terramechanics.effects.slip_sinkage import slip_sinkage_ratio
from soil_env.terramechanics.model import WheelSoilModel

NAMES = SensorReading._fields
#: A `SensorReading` as a record, or the standard deviations of one.
READING = record(*NAMES)
#: Errors of the sensors: standard deviations of white noise, zeros and gains.
SENSOR_NOISE = record(
    "slow",  # [m/s] least speed that a slip from the two speeds is divided by
    white=(READING, 1),
    zero=(READING, 1),
    gain=(READING, 1),
)
#: Pairs of normal numbers of all sensors of a wheel; a pair is that of two readings, one after the
#: other.
PAIRS = (len(NAMES) + 1) // 2
assert PAIRS <= NORMALS[1]
# [-] `slow` of `SENSOR_NOISE` over the white noise of both speeds, so that a wheel at rest reads
# little slip; own choice
SLOW = 3.0


class SensorErrors(NamedTuple):
    """Numbers of the effects that change a reading and not the wheel, as they are called in
    `Effects`.
    """

    slip_bias_offset: float
    slip_bias_radius_error: float
    sinkage_offset_offset: float
    slip_sinkage_gain: float  # of a sinkage that is seen, not felt
    slip_sinkage_recovery: float


NO_ERRORS = SensorErrors(*[0.0] * len(SensorErrors._fields))


def sensor_errors(model: WheelSoilModel | None) -> SensorErrors:
    """Pack the errors of the sensors in the world of a `model`; without one there are none.

    Slip-sinkage is one of them only in its form `apparent`, in which the sensor shows it and the
    wheel does not sink. Else it acts on the wheel.
    """
    if model is None:
        return NO_ERRORS
    fx = model.numbers
    if fx.slip_sinkage_apparent == 0.0:
        fx = fx._replace(slip_sinkage_gain=0.0)
    return SensorErrors(*(getattr(fx, name) for name in SensorErrors._fields))


def sensors_of(scenario: Scenario) -> np.ndarray:
    """Pack the standard deviations of the errors of a scenario's sensors, and `slow`, as
    `SENSOR_NOISE` [1].
    """
    sensors = np.zeros(1, SENSOR_NOISE)
    for name, sd in zip(("white", "zero", "gain"), reading_errors(scenario), strict=True):
        sensors[name] = sd.view(READING)
    speed = hypot(scenario.noise.speed, scenario.noise.wheel_speed * scenario.wheel.radius)
    sensors["slow"] = max(SLOW * speed, SLOWEST)
    return sensors


@compiled_finite
def _scatter(out, sd, wheel, normals):
    """Fill the record `out` with random normal numbers, whose standard deviations the record `sd`
    has, from the stream of a wheel. Both are a `READING`; `normals` is scratch [`NORMALS`].
    """
    draw_normals(wheel, normals, PAIRS)
    i = 0
    for name in literal_unroll(NAMES):
        out[name] = sd[name] * normals[i % 2, i // 2]
        i += 1


@compiled_finite
def mount_sensors(wheel, normals, sensors):
    """Draw zeros and gains of the sensors of a wheel for a course into `wheel.zero` and
    `wheel.gain`.

    `sensors`: `SENSOR_NOISE`; `normals` is scratch.
    """
    _scatter(wheel.zero[0], sensors.zero[0], wheel, normals)
    _scatter(wheel.gain[0], sensors.gain[0], wheel, normals)


@compiled_finite
def roll_odometer(vehicle, speed, period):
    """Advance the odometry by a control `period` [s] at the `speed` [m/s] that was read at its end.

    It sums readings, so the difference of two places tells no more of the truth than they do.
    """
    vehicle.odometer += speed * period


@compiled_finite
def sense(wheel, reading, normals, sensors, errors, radius):
    """Fill the record `reading` (`READING`) with readings of a wheel of `radius` [m]: the truth,
    then gain, zero and white noise as `Noise` says.

    The sinkage is changed as `errors` say, and has that of a residual law, which the wheel does not
    feel (`unfelt`).

    The slip of the `reading` gets the white noise only, and `read_slip` completes it. `sensors`:
    `SENSOR_NOISE`, `errors`: `SensorErrors`; `normals` is scratch.
    """
    reading.slip = 0.0  # its sensor has neither gain nor zero
    reading.sinkage = _seen_sinkage(wheel.slip, wheel.sinkage, errors) + wheel.unfelt
    reading.drawbar_pull = wheel.drawbar_pull
    reading.load = wheel.load
    reading.torque = wheel.torque
    reading.speed = wheel.speed
    reading.rim_speed = wheel.wheel_speed * radius
    reading.pitch = wheel.grade
    reading.motor_torque = wheel.motor_torque
    # dV/dt + g sin(grade), as an accelerometer reads
    reading.acceleration = wheel.drawbar_pull / wheel.mass
    zero = wheel.zero[0]
    gain = wheel.gain[0]
    white = sensors.white[0]
    draw_normals(wheel, normals, PAIRS)
    i = 0
    for name in literal_unroll(NAMES):
        value = (1.0 + gain[name]) * reading[name] + zero[name]
        reading[name] = value + white[name] * normals[i % 2, i // 2]
        i += 1


@compiled_finite
def read_slip(wheel, reading, sensors, errors):
    """Add the slip to that of a `reading`, which is white noise so far, and cut it to [-1, 1].

    With noise of a slip sensor it is the true slip, else the slip of the two speeds that were read.
    Either is biased as the `errors` say (`SensorErrors`). In reverse, below a sum of both speeds of
    -`slow` [m/s], the slip of the speeds changes sign: it is positive for a wheel that drives.
    """
    slip = wheel.slip
    if sensors.white[0].slip == 0.0:
        slip, _, _ = signed_slip(reading.rim_speed, reading.speed, sensors.slow)
        if reading.rim_speed + reading.speed < -sensors.slow:
            slip = -slip  # in reverse
    slip = measured_slip(slip, errors)
    reading.slip = min(max(slip + reading.slip, -1.0), 1.0)


@compiled_finite
def _seen_sinkage(slip, sinkage, errors):
    """Sinkage [m] as a sensor with `SensorErrors` shows it, without noise: times the apparent
    `slip_sinkage_ratio` at the true slip, plus the offset.
    """
    ratio = slip_sinkage_ratio(slip, errors.slip_sinkage_gain, errors.slip_sinkage_recovery)
    return sinkage * ratio + errors.sinkage_offset_offset


@inlined
def sense_body(rover, reading, sensors):
    """Fill speed, pitch and acceleration of the record `reading`: the sensors that the body of a
    rover has. Truth, then gain, zero and white noise as in `sense`.

    Their zeros and gains are those in the record of the front wheel, the noise is from the stream
    of the `rover`. `sensors`: `SENSOR_NOISE`.
    """
    of_speed, of_pitch = normal_pair(rover)
    of_acceleration, _ = normal_pair(rover)
    sd = sensors.white[0]
    zero = rover.wheels[0].zero[0]
    gain = rover.wheels[0].gain[0]
    felt = rover.drawbar_pull / rover.mass  # as in `sense`
    reading.speed = (1.0 + gain.speed) * rover.speed + zero.speed + sd.speed * of_speed
    reading.pitch = (1.0 + gain.pitch) * rover.pitch + zero.pitch + sd.pitch * of_pitch
    noise = sd.acceleration * of_acceleration
    reading.acceleration = (1.0 + gain.acceleration) * felt + zero.acceleration + noise
