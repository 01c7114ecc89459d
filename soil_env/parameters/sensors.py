"""Noise of the sensors of a wheel."""

from dataclasses import dataclass

from soil_env._io.loading import Checked, quantity


@dataclass(frozen=True)
class Noise(Checked):
    """Standard deviations of the sensors, white and Gaussian.

    Forces are shares of the unloaded wheel's weight.

    Odometry integrates the readings of the speed sensor, with their noise, times a scale that is
    drawn once a course. The scale is of the order of errors of visual odometry (Maimone, Cheng &
    Matthies 2007, J. Field Robotics 24:169-186). The speed sensor has no such scale. An agent that
    sees all its readings (`repeat` 1) can find the scale.
    """

    slip: float = quantity("", 0.0, 1.0, default=0.01)
    sinkage: float = quantity("m", 0.0, 1.0, default=0.001)
    drawbar_pull: float = quantity("of weight", 0.0, 1.0, default=0.01)
    torque: float = quantity("of weight x radius", 0.0, 1.0, default=0.01)
    load: float = quantity("of weight", 0.0, 1.0, default=0.01)
    speed: float = quantity("m/s", 0.0, 10.0, default=0.005)
    wheel_speed: float = quantity("rad/s", 0.0, 10.0, default=0.01)
    pitch: float = quantity("rad", 0.0, 1.0, default=0.003)
    odometry_scale: float = quantity(
        "", 0.0, 0.3, default=0.015, doc="scale error of odometry, constant on a course"
    )
    motor_torque: float = quantity(
        "of weight x radius", 0.0, 1.0, default=0.01, doc="from the motor's current"
    )
    acceleration: float = quantity(
        "m/s2", 0.0, 10.0, default=0.03, doc="accelerometer along the course"
    )
