"""The sensors of a wheel: what each reads (`SENSORS`), its errors, and the records of readings."""

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from soil_env._io.loading import Checked, quantity

from .wheel import Wheel

_WEIGHT = "of weight"
_TWIST = "of weight x radius"
_TOP_SPEED = "of top rim speed"


def _error(unit: str, default: float, high: float = 1.0, doc: str = "") -> Any:
    """Field of `Noise`: standard deviation of the white noise or the zero of a sensor, from 0 to
    `high` in `unit`.
    """
    return quantity(unit, 0.0, high, default=default, doc=doc)


def _gain(default: float) -> Any:
    """Field of `Noise`: standard deviation, in [0, 0.3], of the relative gain of a sensor."""
    return quantity("", 0.0, 0.3, default=default)


@dataclass(frozen=True)
class Noise(Checked):
    """Errors of the sensors, all Gaussian: reading = (1 + gain) x truth + zero + white noise.

    `NAME` is the standard deviation of the white noise of a sensor, `NAME_zero` that of its zero
    and `NAME_gain` that of its relative gain. Zero and gain are drawn once a course, for each
    sensor by itself. Forces are shares of the unloaded wheel's weight.

    No rover measures slip: it follows from travel speed and rim speed, unless `slip` gives the
    noise of a sensor of its own. Where a data sheet states a tolerance, a standard deviation is
    half of it:

    - Travel speed is that of visual odometry, which told changes of 2 mm on Mars (Maimone, Cheng &
      Matthies 2007, J. Field Robotics 24:169-186); 5 mm/s is half a millimetre between images ten
      times a second.
    - The zero of a good force transducer moves by up to 0.05 % of its nominal force in 10 K (HBM,
      "Temperature coefficient of the zero point"). One that is made for ten times the weight moves
      by 1 % of the weight in 20 K.
    - The torque constant of a motor is within 10 % (Hiwin TM-04-0-EN-2108, section 8.1).
    - An accelerometer as it is delivered is within 50 thousandths of gravity and 3 % (InvenSense
      PS-MPU-6000A 3.4, section 6.2). Ours counts as turned over once, which leaves a tenth of the
      zero and a sixth of the gain. A zero of 5 thousandths of gravity is a pitch of 0.3 deg.
    - The others are our choice.
    """

    slip: float = _error("", 0.0, doc="of a slip sensor; 0: there is none")
    sinkage: float = _error("m", 0.001)
    sinkage_zero: float = _error("m", 0.002)
    sinkage_gain: float = _gain(0.0)
    drawbar_pull: float = _error(_WEIGHT, 0.01)
    drawbar_pull_zero: float = _error(_WEIGHT, 0.01)
    drawbar_pull_gain: float = _gain(0.01)
    torque: float = _error(_TWIST, 0.01)
    torque_zero: float = _error(_TWIST, 0.005)
    torque_gain: float = _gain(0.02)
    load: float = _error(_WEIGHT, 0.01)
    load_zero: float = _error(_WEIGHT, 0.0)
    load_gain: float = _gain(0.01)
    speed: float = _error("m/s", 0.005, 10.0)
    speed_zero: float = _error("m/s", 0.0, 10.0)
    speed_gain: float = _gain(0.01)
    wheel_speed: float = _error("rad/s", 0.01, 10.0)
    wheel_speed_zero: float = _error("rad/s", 0.0, 10.0)
    wheel_speed_gain: float = _gain(0.0)
    pitch: float = _error("rad", 0.003)
    pitch_zero: float = _error("rad", 0.005)
    pitch_gain: float = _gain(0.0)
    motor_torque: float = _error(_TWIST, 0.01, doc="from the motor's current")
    motor_torque_zero: float = _error(_TWIST, 0.005)
    motor_torque_gain: float = _gain(0.05)
    acceleration: float = _error("m/s2", 0.03, 10.0, doc="accelerometer along the course")
    acceleration_zero: float = _error("m/s2", 0.05, 10.0)
    acceleration_gain: float = _gain(0.005)


def calibrated(noise: Noise) -> Noise:
    """Return the errors of the same sensors after calibration: without zeros and gains."""
    constant = {name: 0.0 for name in vars(noise) if name.endswith(("_zero", "_gain"))}
    return replace(noise, **constant)


class SensorReading(NamedTuple):
    """One set of sensor readings of a wheel, as the world draws it and compiled code takes it; the
    one that a user gives is `Readings`.
    """

    slip: float
    sinkage: float  # [m]
    drawbar_pull: float  # [N]
    load: float  # [N]
    torque: float  # [N m]
    speed: float  # [m/s]
    rim_speed: float  # [m/s]
    pitch: float  # [rad], uphill positive
    motor_torque: float  # [N m]
    acceleration: float  # [m/s2] of an accelerometer along the course: of travel, and g sin(grade)


_NAN = math.nan


class Readings(NamedTuple):
    """Sensor readings of one wheel at one time, in SI units; NaN where nothing was measured.

    Forward speeds, a pull in the direction of travel and an uphill pitch are positive. Give them by
    name: a further sensor has its place before `time`.
    """

    wheel_speed: float = _NAN  # [rad/s]
    speed: float = _NAN  # [m/s] travel
    sinkage: float = _NAN  # [m] of the lowest point of the rim
    drawbar_pull: float = _NAN  # [N] that the wheel exerts on the vehicle
    load: float = _NAN  # [N] normal to the ground
    torque: float = _NAN  # [N m] soil on wheel
    slip: float = _NAN  # [-] where a sensor gives it; else it follows from the two speeds
    pitch: float = _NAN  # [rad]
    motor_torque: float = _NAN  # [N m] at the wheel, behind the gear
    # [m/s2] of an accelerometer along the course: that of travel, and g sin(pitch)
    acceleration: float = _NAN
    time: float = _NAN  # [s] of any epoch; left out, one `period` after the last


def sizes_of(wheel: Wheel, gravity: float) -> dict[str, float]:
    """{unit: size [SI]} of the units relative to a wheel, in which errors, limits and entries of
    the observation are stated. "of weight" is the weight without payload [N].
    """
    weight = wheel.body_mass * gravity
    return {
        _WEIGHT: weight,
        _TWIST: weight * wheel.radius,
        "of radius": wheel.radius,
        _TOP_SPEED: wheel.radius * wheel.no_load_speed,
        "of gravity": gravity,
    }


class Sensor(NamedTuple):
    """What a sensor reads, the largest sound reading, and its entry of the observation.

    A size is one of `sizes_of`; any other text is that of a unit.
    """

    name: str  # in `Readings` and `Noise`
    unit: str  # in `Readings`
    #: Largest plausible reading, as a multiple of a size or of the unit; a larger one is a fault or
    #: in another unit.
    largest: tuple[float, str]
    #: (size that its entry of the observation is relative to, or its unit; least value, greatest
    #: value, centre and scale of the entry).
    observed: tuple[str, float, float, float, float]
    of_body: bool = False  # a rover has one, and not one for each axle
    #: (quantile, least, most): where the vehicle of a log drives, this quantile of |reading| over
    #: the size in `observed` is usually between the two, else the log is doubted. A quantile, since
    #: a force may be small for a while. None: not compared, as speeds, whose size is that of a
    #: motor which the map of a log need not tell.
    usual: tuple[float, float, float] | None = None


def _of_force(
    name: str, unit: str, size: str, centre: float, scale: float, usual: tuple[float, float, float]
) -> Sensor:
    """A sensor of a force or a torque, which have the same bounds as multiples of their `size`;
    `centre` and `scale` are those of its entry of the observation, the rest is as in `Sensor`.
    """
    return Sensor(name, unit, (100.0, size), (size, -10.0, 10.0, centre, scale), usual=usual)


#: One for each field of `SensorReading`, in its order. Centres and scales were read off the
#: scenarios two_lines, sticky and field_vehicle. A wheel whose sinkage is the radius has its hub at
#: the ground.
SENSORS = (
    Sensor("slip", "", (1.5, ""), ("-", -1.0, 1.0, 0.2, 0.3)),
    Sensor(
        "sinkage",
        "m",
        (1.0, "of radius"),
        ("of radius", -1.0, 3.0, 0.25, 0.15),
        usual=(1.0, 1e-3, math.inf),
    ),
    _of_force("drawbar_pull", "N", _WEIGHT, 0.1, 0.2, (0.75, 1e-3, 2.0)),
    _of_force("load", "N", _WEIGHT, 1.1, 0.1, (0.5, 0.2, 5.0)),
    _of_force("torque", "N m", _TWIST, 0.4, 0.2, (0.75, 5e-3, 3.0)),
    Sensor("speed", "m/s", (40.0, ""), (_TOP_SPEED, -5.0, 5.0, 0.2, 0.2), of_body=True),
    Sensor("wheel_speed", "rad/s", (1e3, ""), (_TOP_SPEED, -5.0, 5.0, 0.2, 0.2)),
    Sensor(
        "pitch",
        "rad",
        (1.5, ""),
        ("rad, uphill positive", -1.6, 1.6, 0.0, 0.15),
        of_body=True,
        usual=(0.5, 0.0, 0.8),
    ),
    _of_force("motor_torque", "N m", _TWIST, 0.4, 0.2, (0.75, 5e-3, 3.0)),
    Sensor(
        "acceleration",
        "m/s2",
        (500.0, ""),
        ("of gravity", -10.0, 10.0, 0.0, 0.15),
        of_body=True,
        usual=(0.5, 0.0, 0.7),  # more with an axis that points down
    ),
)
