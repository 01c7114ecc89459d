"""Sensor readings of a driven wheel in a control period, and their noise."""

from typing import NamedTuple

import numpy as np

from soil_env.parameters.scenario import Scenario

STEP = np.int8(0)  # order to a vehicle: the control periods of an action
RESTART = np.int8(1)  # order: a new course, at rest at its start
IDLE = np.int8(2)  # order: nothing
TRY = np.int8(3)  # order: draw a course as a trial, of a wheel a whole one
COMPLETE = np.int8(4)  # order: draw the rest of the course
AHEAD = np.int8(5)  # order: draw the ground ahead of the vehicle
RUNNING = 0  # `task.Cause` while an episode goes on


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


class Image(NamedTuple):
    """Numbers of an image, in this order in a record; those of the lines mean something only if
    `seen`.
    """

    patch: float  # that the wheel seems to be on
    since: float  # [m] from the beginning of it
    left: float  # [m] to its end
    here: float  # label of the ground under the wheel
    seen: float  # 1 if the patch ahead is in sight
    chosen: float  # 1 if there is no choice of a line any more
    lines: float  # over the patch ahead
    taken: float  # line that the wheel is on the way to
    label_0: float
    label_1: float
    grade_0: float  # [rad]
    grade_1: float


class Record(NamedTuple):
    """Sensor record of the last step, for what runs on board; no rows if nothing does.

    After a restart it holds one set of readings.
    """

    periods: np.ndarray  # [vehicles] control periods of the last step
    readings: np.ndarray  # [wheels, repeat, 10] `SensorReading`
    halted: np.ndarray  # [vehicles, repeat] True in a commanded halt
    places: np.ndarray  # [vehicles, repeat] odometry [m]
    images: np.ndarray  # [wheels, repeat, 12] `Image`; no rows without a camera


class Results(NamedTuple):
    """Arrays of the world to which an estimator adds what it knows, a row a vehicle."""

    observation: np.ndarray  # [vehicles, D] float32
    terms: np.ndarray  # [vehicles, 4] reward terms
    reward: np.ndarray  # [vehicles]
    cause: np.ndarray  # [vehicles] `task.Cause`


class Shown(NamedTuple):
    """Where an observation has the estimate of the soil."""

    on: bool  # it has one at all
    first: int  # index of its first entry
    low: np.ndarray  # [D] float32 bounds of all entries
    high: np.ndarray


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
