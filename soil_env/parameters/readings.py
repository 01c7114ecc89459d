"""Sensor readings of a driven wheel in a control period, and their noise."""

from typing import NamedTuple

import numpy as np

from soil_env.parameters.scenario import Scenario


class SensorReading(NamedTuple):
    """One set of sensor readings."""

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


def sensor_noise(scenario: Scenario) -> np.ndarray:
    """Standard deviations of a `SensorReading` [10], in its units."""
    noise = scenario.noise
    radius = scenario.wheel.radius
    weight = scenario.weight
    return np.array(
        [
            noise.slip,
            noise.sinkage,
            noise.drawbar_pull * weight,
            noise.load * weight,
            noise.torque * weight * radius,
            noise.speed,
            noise.wheel_speed * radius,
            noise.pitch,
            noise.motor_torque * weight * radius,
            noise.acceleration,
        ]
    )
