"""Sensors of a wheel: readings with noise and errors."""

from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_inline
from soil_env._numba.random_streams import normal_pair, ten_normals
from soil_env.parameters import Scenario, SensorReading, sensor_noise
from soil_env.terramechanics.effects import NO_EFFECTS, measured_slip, slip_sinkage_ratio
from soil_env.terramechanics.model import WheelSoilModel


class SensorErrors(NamedTuple):
    """Errors of the sensors: the `Effects`, by their names, that do not act on the wheel."""

    slip_bias_offset: float
    slip_bias_radius_error: float
    sinkage_offset_offset: float
    slip_sinkage_gain: float  # of a sinkage that is seen, not felt
    slip_sinkage_recovery: float
    slip_sinkage_apparent: float


class SensorNumbers(NamedTuple):
    """Numbers of the sensors from a `Scenario`."""

    radius: float
    # [10] sd of slip, sinkage, pull, load, torque, speed, rim speed, pitch, motor torque, acceleration
    noise: np.ndarray
    odometry_scale: float  # sd
    period: float  # [s]
    errors: SensorErrors


def sensor_numbers(scenario: Scenario, model: WheelSoilModel | None = None) -> SensorNumbers:
    """Pack the numbers of `sense`; `model` gives the errors of the sensors in this world."""
    effects = NO_EFFECTS if model is None else model.numbers
    errors = SensorErrors(*(getattr(effects, name) for name in SensorErrors._fields))
    return SensorNumbers(
        scenario.wheel.radius,
        sensor_noise(scenario),
        scenario.noise.odometry_scale,
        scenario.control.period,
        errors,
    )


@compiled_inline
def start_odometry(state, k, streams, sensors):
    """Odometry of wheel k at the start of a course, with a scale that stays the same over it."""
    state.odometer[k] = 0.0
    state.odometer_scale[k] = 1.0 + sensors.odometry_scale * normal_pair(streams, k)[0]


@compiled_inline
def roll_odometer(state, k, speed, sensors):
    """Odometry of wheel k after a control period at whose end the sensor read this `speed` [m/s].

    It integrates the readings of the speed sensor, so that its difference holds no truth beyond theirs.
    """
    state.odometer[k] += state.odometer_scale[k] * speed * sensors.period


@compiled_inline
def sense(state, k, streams, sensors):
    """Noisy `SensorReading` of wheel k."""
    sd = sensors.noise
    slip = state.slip[k]
    depth = state.sinkage[k]
    a, b, c, d, e, f, g, h, i, j = ten_normals(streams, k)
    fx = sensors.errors
    sinkage = depth + fx.sinkage_offset_offset
    if fx.slip_sinkage_apparent > 0.0:
        sinkage += depth * (
            slip_sinkage_ratio(slip, fx.slip_sinkage_gain, fx.slip_sinkage_recovery) - 1.0
        )
    return SensorReading(
        min(max(measured_slip(slip, fx) + sd[0] * a, -1.0), 1.0),
        sinkage + sd[1] * b,
        state.drawbar_pull[k] + sd[2] * c,
        state.load[k] + sd[3] * d,
        state.torque[k] + sd[4] * e,
        state.speed[k] + sd[5] * f,
        state.wheel_speed[k] * sensors.radius + sd[6] * g,
        state.grade[k] + sd[7] * h,
        state.motor_torque[k] + sd[8] * i,
        state.drawbar_pull[k] / state.mass[k] + sd[9] * j,
    )
