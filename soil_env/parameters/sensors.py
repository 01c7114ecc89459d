"""Errors of the sensors of a wheel: white noise, zeros and gains."""

from dataclasses import dataclass

from soil_env._io.loading import Checked, quantity


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
      PS-MPU-6000A 3.4, section 6.2). Ours was turned over once, which leaves a tenth of the zero
      and a sixth of the gain; a zero of 5 thousandths of gravity is a pitch of 0.3 deg.
    - The others are our choice.
    """

    slip: float = quantity("", 0.0, 1.0, default=0.0, doc="of a slip sensor; 0: there is none")
    sinkage: float = quantity("m", 0.0, 1.0, default=0.001)
    sinkage_zero: float = quantity("m", 0.0, 1.0, default=0.002)
    sinkage_gain: float = quantity("", 0.0, 0.3, default=0.0)
    drawbar_pull: float = quantity("of weight", 0.0, 1.0, default=0.01)
    drawbar_pull_zero: float = quantity("of weight", 0.0, 1.0, default=0.01)
    drawbar_pull_gain: float = quantity("", 0.0, 0.3, default=0.01)
    torque: float = quantity("of weight x radius", 0.0, 1.0, default=0.01)
    torque_zero: float = quantity("of weight x radius", 0.0, 1.0, default=0.005)
    torque_gain: float = quantity("", 0.0, 0.3, default=0.02)
    load: float = quantity("of weight", 0.0, 1.0, default=0.01)
    load_zero: float = quantity("of weight", 0.0, 1.0, default=0.0)
    load_gain: float = quantity("", 0.0, 0.3, default=0.01)
    speed: float = quantity("m/s", 0.0, 10.0, default=0.005)
    speed_zero: float = quantity("m/s", 0.0, 10.0, default=0.0)
    speed_gain: float = quantity("", 0.0, 0.3, default=0.01)
    wheel_speed: float = quantity("rad/s", 0.0, 10.0, default=0.01)
    wheel_speed_zero: float = quantity("rad/s", 0.0, 10.0, default=0.0)
    wheel_speed_gain: float = quantity("", 0.0, 0.3, default=0.0)
    pitch: float = quantity("rad", 0.0, 1.0, default=0.003)
    pitch_zero: float = quantity("rad", 0.0, 1.0, default=0.005)
    pitch_gain: float = quantity("", 0.0, 0.3, default=0.0)
    motor_torque: float = quantity(
        "of weight x radius", 0.0, 1.0, default=0.01, doc="from the motor's current"
    )
    motor_torque_zero: float = quantity("of weight x radius", 0.0, 1.0, default=0.005)
    motor_torque_gain: float = quantity("", 0.0, 0.3, default=0.05)
    acceleration: float = quantity(
        "m/s2", 0.0, 10.0, default=0.03, doc="accelerometer along the course"
    )
    acceleration_zero: float = quantity("m/s2", 0.0, 10.0, default=0.05)
    acceleration_gain: float = quantity("", 0.0, 0.3, default=0.005)


def calibrated(noise: Noise) -> Noise:
    """Return the same sensors without zeros and gains."""
    constant = {name: 0.0 for name in vars(noise) if name.endswith(("_zero", "_gain"))}
    return Noise(**{**vars(noise), **constant})
