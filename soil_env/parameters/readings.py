"""What world and estimators of a vehicle hand to each other: orders, images, records, and the
errors and units of readings.
"""

from dataclasses import fields
from typing import NamedTuple

import numpy as np

from .scenario import Scenario
from .sensors import SENSORS, Noise, Readings, SensorReading, sizes_of
from .soil import EARTH_GRAVITY
from .wheel import Wheel

STEP = np.int8(0)  # order to a vehicle: the control periods of an action
RESTART = np.int8(1)  # order: a new course, at rest at its start
IDLE = np.int8(2)  # order: nothing
TRY = np.int8(3)  # order: draw the start of a course as a trial, to see if a soil is found
COMPLETE = np.int8(4)  # order: draw the rest of the course
AHEAD = np.int8(5)  # order: draw the ground ahead of the vehicle
RUNNING = 0  # `task.Cause` while an episode goes on


class Image(NamedTuple):
    """Numbers of an image, in this order in a record.

    A patch is a part of the course with one class of ground on each of its routes. A label is the
    number of a class by its looks, 0 to `course.classes` - 1. What is after `seen` is of the patch
    ahead, and means something only if that is 1; labels are those of classes then too, as 0.
    """

    patch: float  # number of the patch that the wheel seems to be on, from 0
    since: float  # [m] from the beginning of that patch, where the camera sees it
    left: float  # [m] from the wheel to its end
    here: float  # label of the ground under the wheel
    seen: float  # 1 if the patch ahead is within `camera.sight`, else 0
    # 1 if it has one route or the wheel has reached the halt before it, where it chooses; else 0
    chosen: float
    lines: float  # number of routes over the patch ahead, 1 or 2
    taken: float  # route over it that the wheel heads for: 0 straight on, 1 beside
    label_0: float  # label of the ground on route 0
    label_1: float  # on route 1; that of route 0 where there is one route
    grade_0: float  # [rad] steepest grade ahead on route 0, uphill positive
    grade_1: float  # [rad] on route 1


class Shown(NamedTuple):
    """Where an observation has the estimate of the soil, and the bounds of all its entries."""

    on: bool  # it has one at all
    first: int  # index of its first entry
    low: np.ndarray  # [D] float32 bounds of all entries
    high: np.ndarray


class Stepped(NamedTuple):
    """Records of vehicles as a step of the world has left them."""

    state: np.ndarray  # [vehicles] `WHEEL` or `ROVER` of `simulation`
    samples: np.ndarray  # [vehicles, axles, control periods] `SAMPLE`, readings and image
    observation: np.ndarray  # [vehicles, D] float32


def largest_readings(wheel: Wheel, gravity: float = EARTH_GRAVITY) -> Readings:
    """Largest plausible readings (`Sensor.largest`), in SI units, of a wheel at a gravity [m/s2];
    larger ones are faults or in another unit. `time` is NaN.
    """
    sizes = sizes_of(wheel, gravity)
    return Readings(**{s.name: s.largest[0] * sizes.get(s.largest[1], 1.0) for s in SENSORS})


def largest_sensed(wheel: Wheel, gravity: float) -> SensorReading:
    """`largest_readings` as a `SensorReading`, with a rim speed in place of a wheel speed."""
    largest = largest_readings(wheel, gravity)
    largest = largest._replace(wheel_speed=largest.wheel_speed * wheel.radius)  # the rim speed
    return SensorReading(*(getattr(largest, sensor.name) for sensor in SENSORS))


def observed_units(scenario: Scenario) -> SensorReading:
    """Size that the entry of each sensor in the observation is relative to, in the unit of a
    `SensorReading`; 1 where the entry is in that unit.
    """
    sizes = sizes_of(scenario.wheel, scenario.gravity)
    return SensorReading(*(sizes.get(sensor.observed[0], 1.0) for sensor in SENSORS))


def reading_units(scenario: Scenario) -> SensorReading:
    """Size that the errors of each sensor in `Noise` are relative to, in the unit of a
    `SensorReading`; 1 where they are in that unit.
    """
    sizes = sizes_of(scenario.wheel, scenario.gravity)
    of = {f.name: sizes.get(f.metadata["unit"], 1.0) for f in fields(Noise)}
    of["wheel_speed"] = scenario.wheel.radius  # its reading is the rim speed
    return SensorReading(*(of[sensor.name] for sensor in SENSORS))


def reading_errors(scenario: Scenario) -> np.ndarray:
    """Standard deviations of white noise, zeros and gains, [3, sensors]: the first two in the units
    of a `SensorReading`, gains relative. 0 for an error that `Noise` does not have.
    """
    of = vars(scenario.noise)
    found = [[of.get(s.name + kind, 0.0) for s in SENSORS] for kind in ("", "_zero", "_gain")]
    units = reading_units(scenario)
    return np.array(found) * [units, units, np.ones(len(units))]
