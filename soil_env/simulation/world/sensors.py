"""Sensors of a wheel: readings with noise and errors."""

from typing import NamedTuple

import numpy as np
from numba import njit

from soil_env._compiled.flags import FINITE, record
from soil_env._compiled.random_streams import PAIRS, draw_normals, normal_pair
from soil_env.parameters import Scenario, SensorReading, sensor_noise
from soil_env.terramechanics.effects.slip_bias import measured_slip
from soil_env.terramechanics.effects.slip_sinkage import slip_sinkage_ratio
from soil_env.terramechanics.model import WheelSoilModel

#: A `SensorReading` as a record, or the standard deviations of one.
READING = record(*SensorReading._fields)


class SensorErrors(NamedTuple):
    """Errors of the sensors: the `Effects`, by their names, that do not act on the wheel."""

    slip_bias_offset: float
    slip_bias_radius_error: float
    sinkage_offset_offset: float
    slip_sinkage_gain: float  # of a sinkage that is seen, not felt
    slip_sinkage_recovery: float
    slip_sinkage_apparent: float


def sensor_errors(model: WheelSoilModel | None) -> SensorErrors | None:
    """Pack the errors of the sensors in the world of a `model`; None without one."""
    if model is None:
        return None
    return SensorErrors(*(getattr(model.numbers, name) for name in SensorErrors._fields))


def sensor_deviations(scenario: Scenario) -> np.ndarray:
    """Standard deviations of the sensors, `READING` [1]."""
    return sensor_noise(scenario).view(READING)


@njit(**FINITE)
def start_odometry(vehicle, scale):
    """Odometry at the start of a course, with a constant gain; `scale`: its sd [-]."""
    vehicle.odometer = 0.0
    vehicle.odometer_scale = 1.0 + scale * normal_pair(vehicle)[0]


@njit(**FINITE)
def roll_odometer(vehicle, speed, period):
    """Odometry after a control period [s] at whose end the sensor read this `speed` [m/s].

    It integrates the readings of the speed sensor, so that its difference holds no truth beyond
    theirs.
    """
    vehicle.odometer += vehicle.odometer_scale * speed * period


@njit(**FINITE)
def sense(wheel, reading, normals, sd, errors, radius):
    """Fill the record `reading` (`READING`) with noisy readings of a wheel of `radius` [m]."""
    draw_normals(wheel, normals, PAIRS)
    first = normals.first
    second = normals.second
    slip, sinkage = _seen(wheel.slip, wheel.sinkage, errors)
    reading.slip = min(max(slip + sd.slip * first[0], -1.0), 1.0)
    reading.sinkage = sinkage + sd.sinkage * second[0]
    reading.drawbar_pull = wheel.drawbar_pull + sd.drawbar_pull * first[1]
    reading.load = wheel.load + sd.load * second[1]
    reading.torque = wheel.torque + sd.torque * first[2]
    reading.speed = wheel.speed + sd.speed * second[2]
    reading.rim_speed = wheel.wheel_speed * radius + sd.rim_speed * first[3]
    reading.pitch = wheel.grade + sd.pitch * second[3]
    reading.motor_torque = wheel.motor_torque + sd.motor_torque * first[4]
    reading.acceleration = wheel.drawbar_pull / wheel.mass + sd.acceleration * second[4]


@njit(**FINITE)
def _seen(slip, sinkage, errors):
    """(slip, sinkage [m]) as sensors with `SensorErrors` show them, without noise."""
    if errors is None:
        return slip, sinkage
    else:
        seen = sinkage + errors.sinkage_offset_offset
        if errors.slip_sinkage_apparent > 0.0:
            gain = errors.slip_sinkage_gain
            ratio = slip_sinkage_ratio(slip, gain, errors.slip_sinkage_recovery)
            seen += sinkage * (ratio - 1.0)
        return measured_slip(slip, errors), seen
