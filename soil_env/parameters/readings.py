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
    """Numbers of an image, in this order in a record.

    A patch is a part of the course with one class of ground on each of its routes. A label is the
    number of a class by its looks, 0 to `camera.classes` - 1. What is after `seen` is of the patch
    ahead, and means something only if that is 1.
    """

    patch: float  # number of the patch that the wheel seems to be on, from 0
    since: float  # [m] from the beginning of that patch, where the camera sees it
    left: float  # [m] from the wheel to its end
    here: float  # label of the ground under the wheel
    seen: float  # 1 if the patch ahead is within `camera.sight`, else 0
    chosen: float  # 1 if it has one route, or the wheel has come too near to choose, else 0
    lines: float  # number of routes over the patch ahead, 1 or 2
    taken: float  # route over it that the wheel heads for: 0 straight on, 1 beside
    label_0: float  # label of the ground on route 0
    label_1: float  # on route 1; that of route 0 where there is one route
    grade_0: float  # [rad] steepest grade ahead on route 0, uphill positive
    grade_1: float  # [rad] on route 1


class Shown(NamedTuple):
    """Where an observation has the estimate of the soil."""

    on: bool  # it has one at all
    first: int  # index of its first entry
    low: np.ndarray  # [D] float32 bounds of all entries
    high: np.ndarray


def reading_errors(scenario: Scenario) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Standard deviations of white noise, zeros and gains of a `SensorReading` [10] each."""
    units = reading_units(scenario)
    of = vars(scenario.noise)
    names = ["wheel_speed" if name == "rim_speed" else name for name in units._fields]
    white = np.array([of[name] for name in names])
    zero = np.array([of.get(f"{name}_zero", 0.0) for name in names])
    gain = np.array([of.get(f"{name}_gain", 0.0) for name in names])
    return white * units, zero * units, gain


def reading_units(scenario: Scenario) -> SensorReading:
    """Units of `Noise` in those of a `SensorReading`."""
    weight = scenario.weight
    twist = weight * scenario.wheel.radius
    return SensorReading(
        slip=1.0,
        sinkage=1.0,
        drawbar_pull=weight,
        load=weight,
        torque=twist,
        speed=1.0,
        rim_speed=scenario.wheel.radius,
        pitch=1.0,
        motor_torque=twist,
        acceleration=1.0,
    )


def sensor_noise(scenario: Scenario) -> np.ndarray:
    """Standard deviations of the white noise of a `SensorReading` [10], in its units."""
    return reading_errors(scenario)[0]
