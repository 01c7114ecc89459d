"""Compiled functions of many rovers: `lay_rovers` draws courses and places rovers at rest,
`step_rovers` drives.

Nothing is identified here.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import EXACT, FINITE, HUGE, INLINE, record
from soil_env._compiled.random_streams import NORMALS, between, normal_pair, word
from soil_env.parameters import MOST_AXLES, RoverScenario
from soil_env.parameters.readings import COMPLETE, IDLE, RESTART, STEP, TRY, Record
from soil_env.simulation.rover.body import ROVER, suspension_of, take_pitch
from soil_env.simulation.rover.dynamics import control_period
from soil_env.simulation.rover.newton import STAGE, RoverWorld
from soil_env.simulation.rover.ruts import clear_ruts, new_ruts
from soil_env.simulation.rover.task import (
    ENTRIES_OF_AXLE,
    ENTRIES_OF_BODY,
    BodyReading,
    rover_layout,
    write_axle,
    write_body,
    write_true_soils,
)
from soil_env.simulation.task.observation import TRUE_SOIL, clip
from soil_env.simulation.task.rules import (
    REWARD_TERMS,
    RUNNING,
    add_reward,
    judge,
    task_of,
    total_of,
)
from soil_env.simulation.wheels import new_record, start_passable
from soil_env.simulation.world.courses import course_distribution, extend_course, start_course
from soil_env.simulation.world.passability import CourseDistribution, CourseNumbers
from soil_env.simulation.world.sensors import (
    READING,
    SensorErrors,
    roll_odometer,
    sense,
    sensor_deviations,
    sensor_errors,
    start_odometry,
)
from soil_env.simulation.world.terrain import Courses, course_of, new_courses
from soil_env.simulation.world.wheel import World, acting_in, rig_of, settle_at
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.reaction import Acting

DEEPEST_ALONE = 0.5  # [of the limit] sinkage of a wheel by itself on the ground of a course


#: Scratch of a thread: the last readings of the wheels of a rover.
SENSED = record(readings=(READING, MOST_AXLES))


class RoverScratch(NamedTuple):
    """Work arrays of a thread."""

    stage: np.ndarray  # [1] `STAGE`
    normals: np.ndarray  # [1] `NORMALS`
    sensed: np.ndarray  # [1] `SENSED`
    rover: np.ndarray  # [1] `ROVER`, blank


def new_rover_scratch() -> RoverScratch:
    """Work arrays of one thread."""
    return RoverScratch(
        np.zeros(1, STAGE),
        np.zeros(1, NORMALS),
        np.zeros(1, SENSED),
        np.zeros(1, ROVER),
    )


class RoverWorlds(NamedTuple):
    """Arrays that the compiled step reads and writes, one row a rover; axles from the front on.

    In the record wheel `a` of rover j has the row j x axles + a.
    """

    state: np.ndarray  # [rovers] `ROVER`
    ruts: np.ndarray  # [rovers, axles, cells] `ROVER_RUT`
    courses: Courses  # a course a rover; what is left in its cells is in `ruts`
    record: Record
    observation: np.ndarray  # [rovers, D] float32
    terms: np.ndarray  # [rovers, 4] reward terms
    reward: np.ndarray  # [rovers]
    cause: np.ndarray  # [rovers] `Cause`


class RoverNumbers(NamedTuple):
    """Constants of a scenario that the compiled functions need."""

    rig: np.ndarray  # [1] `RIG`
    acting: Acting
    suspension: np.ndarray  # [1] `SUSPENSION`
    drawn: CourseDistribution
    task: np.ndarray  # [1] `TASK`
    low: np.ndarray  # [D] float32 bounds of the observation
    high: np.ndarray
    sd: np.ndarray  # [1] `READING` of the noise
    errors: SensorErrors | None


def rover_numbers(
    scenario: RoverScenario, variant: str, model: WheelSoilModel | None = None
) -> RoverNumbers:
    """Pack a scenario; `model` gives the effects that are on in this world."""
    entries = rover_layout(variant, scenario.axles)
    drawn = course_distribution(_with_front(scenario), model)
    # the deepest wheel of a rover bears more than the mean and runs in a rut
    drawn.spec.bogged_sinkage *= DEEPEST_ALONE
    return RoverNumbers(
        rig_of(scenario, model),
        acting_in(model),
        suspension_of(scenario),
        drawn,
        task_of(scenario, variant),
        np.array([e.low for e in entries], dtype=np.float32),
        np.array([e.high for e in entries], dtype=np.float32),
        sensor_deviations(scenario),
        sensor_errors(model),
    )


def new_rover_worlds(
    rovers: int, scenario: RoverScenario, numbers: RoverNumbers, recorded: bool
) -> RoverWorlds:
    """Worlds for so many rovers, to be restarted; `recorded`: keep the sensor record of each step."""
    axles = scenario.axles
    courses = new_courses(rovers, _with_front(scenario))
    kept_rovers = rovers if recorded else 0
    return RoverWorlds(
        np.zeros(rovers, ROVER),
        new_ruts(rovers, axles, courses.cells.shape[1]),
        courses,
        new_record(kept_rovers, kept_rovers * axles, scenario),
        np.zeros((rovers, numbers.low.size), dtype=np.float32),
        np.zeros((rovers, len(REWARD_TERMS))),
        np.zeros(rovers),
        np.zeros(rovers, dtype=np.int64),
    )


def _with_front(scenario: RoverScenario) -> RoverScenario:
    """The scenario with courses as long as the front axle goes when the rear one is at the end."""
    course = scenario.course
    longer = replace(course, length=course.length + scenario.vehicle.base)
    return replace(scenario, course=longer)


@njit(**EXACT)
def _settle(rover, mass, course, ruts, numbers, scratch):
    """Put a rover, with a mean `mass` [kg] on its wheels, at rest at the start of its course."""
    rig = numbers.rig[0]
    s = numbers.suspension[0]
    world = World(rig, numbers.acting, scratch.stage[0].nodes[0])
    rover.mass = mass * s.axles
    for a in range(s.axles):
        wheel = rover.wheels[a]
        wheel.stream = word(rover)
        ahead = s.wheelbase - s.places[a]
        settle_at(wheel, ahead, rover.mass * s.shares[a], course, world)
        rover.axles[a].height = ahead * math.sin(wheel.grade)
        clear_ruts(ruts[a])
    rover.next_halt = between(rover, rig.halt_low, rig.halt_high)
    rover.converged = 1


@kept
def lay_rovers(worlds, numbers, orders, scratch, first, end):
    """Follow the `orders` [rovers] for the courses `first` to `end` - 1; return the number of those
    not found.

    RESTART starts a new course and puts the rover at rest at its start. After TRY, `reward` is the
    mean mass on a wheel, or -1 if no passable course was found.
    """
    nodes = scratch.stage[0].nodes[0]
    course_numbers = CourseNumbers(numbers.drawn, numbers.rig[0], numbers.acting)
    s = numbers.suspension[0]
    ahead = s.wheelbase + numbers.drawn.spec.ahead  # [m] before the rear axle
    failed = 0
    for j in range(first, end):
        order = orders[j]
        if order == STEP or order == IDLE:
            continue
        rover = worlds.state[j]
        course = course_of(worlds.courses, j)
        if order == RESTART:
            mass = start_passable(course, rover, course_numbers, nodes)
            if mass < 0.0:
                failed += 1
            else:
                extend_course(course, mass, ahead, course_numbers, nodes)
                stream = rover.stream
                worlds.state[j] = scratch.rover[0]
                rover.stream = stream
                _settle(rover, mass, course, worlds.ruts[j], numbers, scratch)
        elif order == TRY:
            worlds.reward[j] = start_course(course, rover, course_numbers, nodes)
        else:
            x = HUGE if order == COMPLETE else rover.x + ahead
            extend_course(course, rover.mass / s.axles, x, course_numbers, nodes)
    return failed


class Sensors(NamedTuple):
    """The sensors of a rover."""

    sd: Any  # `READING` of the noise
    errors: SensorErrors | None
    radius: float  # [m] of the wheels
    axles: int
    normals: Any  # `NORMALS`, scratch


@njit(**FINITE)
def _sense_body(rover, sd):
    """`BodyReading` of a rover."""
    of_speed, of_pitch = normal_pair(rover)
    of_acceleration, _ = normal_pair(rover)
    return BodyReading(
        rover.speed + sd.speed * of_speed,
        rover.pitch + sd.pitch * of_pitch,
        rover.drawbar_pull / rover.mass + sd.acceleration * of_acceleration,
    )


@njit(**FINITE)
def _sense_wheels(rover, of_body, sensors, readings):
    """Fill `readings` [axles] of the wheels of a rover; of speed, pitch and acceleration the body
    has one sensor each.
    """
    for a in range(sensors.axles):
        reading = readings[a]
        sense(rover.wheels[a], reading, sensors.normals, sensors.sd, sensors.errors, sensors.radius)
        reading.speed = of_body.speed
        reading.pitch = of_body.pitch
        reading.acceleration = of_body.acceleration


@njit(**INLINE)
def _keep(sensed, j, period, rover, axles, readings):
    """Keep the sensor record of a control period of rover j."""
    for a in range(axles):
        sensed.readings[j * axles + a, period] = readings[a]
    sensed.periods[j] = period + 1
    sensed.halted[j, period] = rover.halt_left > 0.0
    sensed.places[j, period] = rover.odometer


@kept
def step_rovers(worlds, numbers, actions, orders, scratch, first, end):
    """Follow the `orders` [rovers] STEP and RESTART for the rovers `first` to `end` - 1; `actions`
    [rovers, axles].

    A step has as many control periods as an action lasts, or fewer if the episode ends. Courses are
    laid (`lay_rovers`).
    """
    # records are taken out of their arrays once, since numba counts references to arrays, not to
    # records
    rig = numbers.rig[0]
    suspension = numbers.suspension[0]
    axles = suspension.axles
    task = numbers.task[0]
    sd = numbers.sd[0]
    world = RoverWorld(rig, numbers.acting, suspension, scratch.stage[0])
    sensors = Sensors(sd, numbers.errors, rig.radius, axles, scratch.normals[0])
    readings = scratch.sensed[0].readings
    recorded = worlds.record.periods.size > 0
    for j in range(first, end):
        starts = orders[j] == RESTART
        if not starts and orders[j] != STEP:
            continue
        rover = worlds.state[j]
        course = course_of(worlds.courses, j)
        ruts = worlds.ruts[j]
        commands = actions[j]
        terms = worlds.terms[j]
        terms[:] = 0.0
        cause = RUNNING
        period = 0
        while True:
            if starts:
                take_pitch(rover, suspension)
                start_odometry(rover, task.odometry_scale)
            else:
                control_period(rover, commands, course.patches, ruts, world)
            of_body = _sense_body(rover, sd)
            if not starts:
                roll_odometer(rover, of_body.speed, task.period)
            _sense_wheels(rover, of_body, sensors, readings)
            if recorded:
                _keep(worlds.record, j, period, rover, axles, readings)
            period += 1
            if starts:
                break
            cause = judge(rover, task)
            add_reward(rover, cause, task, terms)
            if period == task.held or cause != RUNNING:
                break
        worlds.cause[j] = cause
        worlds.reward[j] = total_of(terms)
        out = worlds.observation[j]
        write_body(out, rover, of_body, task)
        for a in range(axles):
            write_axle(out, a, rover.wheels[a], readings[a], task)
        if task.variant == TRUE_SOIL:
            soils = out[ENTRIES_OF_BODY + axles * ENTRIES_OF_AXLE :]
            write_true_soils(soils, rover, axles, course, rig.border)
        clip(out, numbers.low, numbers.high)


@kept
def observe_true_soils(worlds, numbers, out):
    """Fill `out` [rovers, axles x 7] with the true soils under the axles."""
    border = numbers.rig[0].border
    axles = numbers.suspension[0].axles
    for j in range(len(out)):
        write_true_soils(out[j], worlds.state[j], axles, course_of(worlds.courses, j), border)
