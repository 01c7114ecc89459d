"""Compiled functions of many rovers: `lay_rovers` draws courses and places rovers at rest, `step_rovers` drives.

Nothing is identified here.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_inline, compiled_part, compiled_root
from soil_env._numba.lanes import COUNT
from soil_env._numba.random_streams import between, four_normals, word
from soil_env._numba.rows import zero_column
from soil_env.parameters import RoverScenario, SensorReading
from soil_env.simulation.rover.body import (
    AxleState,
    BodyCounts,
    BodyState,
    Suspension,
    suspension_of,
)
from soil_env.simulation.rover.dynamics import Rovers, advance, take_pitch
from soil_env.simulation.rover.ruts import Ruts, clear_ruts, new_ruts
from soil_env.simulation.rover.task import (
    BodyReading,
    rover_task_numbers,
    write_axle,
    write_body,
    write_true_soils,
)
from soil_env.simulation.task.observation import clip
from soil_env.simulation.task.rules import REWARD_TERMS, TaskNumbers, judge, reward_terms, total_of
from soil_env.simulation.wheels import (
    AHEAD,
    COMPLETE,
    IDLE,
    RESTART,
    RUNNING,
    STEP,
    TRY,
    Record,
    clear_reward,
    new_record,
    start_passable,
    store_reading,
)
from soil_env.simulation.world.courses import (
    CourseDistribution,
    CourseNumbers,
    course_numbers,
    extend_course,
    start_course,
)
from soil_env.simulation.world.sensors import roll_odometer, sense, start_odometry
from soil_env.simulation.world.terrain import Courses, new_courses
from soil_env.simulation.world.wheel import (
    WheelCounts,
    WheelState,
    WorldNumbers,
    settle_at,
    wheel_of,
    world_numbers,
)
from soil_env.terramechanics.model import WheelSoilModel

_DEEPEST_ALONE = 0.5  # of the limit of sinkage, of a wheel by itself on the ground of a course


class RoverWorlds(NamedTuple):
    """Arrays that the compiled step reads and writes: one row a rover, or one a wheel (`wheel.wheel_of`)."""

    rovers: Rovers
    courses: Courses  # a course a rover; what is left in its cells is in `ruts`
    ruts: Ruts
    streams: np.ndarray  # [rovers] uint64
    wheel_streams: np.ndarray  # [wheels] uint64
    record: Record
    observation: np.ndarray  # [rovers, D] float32
    terms: np.ndarray  # [rovers, 4] reward terms
    reward: np.ndarray  # [rovers]
    cause: np.ndarray  # [rovers] `Cause`
    going: np.ndarray  # [rovers] int8, scratch of a step: STEP while the rover drives


def new_rover_worlds(
    rovers: int, scenario: RoverScenario, task: TaskNumbers, recorded: bool
) -> RoverWorlds:
    """Worlds for so many rovers, to be restarted; `recorded`: keep the sensor record of each step."""
    wheels = -(-rovers // COUNT) * COUNT * scenario.axles
    courses = new_courses(rovers, _with_front(scenario))
    return RoverWorlds(
        Rovers(
            BodyState(rovers),
            BodyCounts(rovers),
            WheelState(wheels),
            WheelCounts(wheels),
            AxleState(wheels),
        ),
        courses,
        new_ruts(wheels, courses.rut.shape[1]),
        np.zeros(rovers, dtype=np.uint64),
        np.zeros(wheels, dtype=np.uint64),
        new_record(rovers, wheels, scenario) if recorded else new_record(0, 0, scenario),
        np.zeros((rovers, task.low.size), dtype=np.float32),
        np.zeros((rovers, len(REWARD_TERMS))),
        np.zeros(rovers),
        np.zeros(rovers, dtype=np.int64),
        np.full(rovers, IDLE),
    )


def _with_front(scenario: RoverScenario) -> RoverScenario:
    """The scenario with courses as long as the front axle goes when the rear one is at the end."""
    course = scenario.course
    return replace(scenario, course=replace(course, length=course.length + scenario.vehicle.base))


class RoverNumbers(NamedTuple):
    """Numbers of the scenario that the compiled step needs."""

    world: WorldNumbers
    drawn: CourseDistribution
    task: TaskNumbers
    suspension: Suspension


def rover_numbers(
    scenario: RoverScenario, variant: str, model: WheelSoilModel | None = None
) -> RoverNumbers:
    """Pack a scenario; `model` gives the effects that are on in this world."""
    return RoverNumbers(
        world_numbers(scenario, model, scenario.axles),
        _drawn(scenario, model),
        rover_task_numbers(scenario, variant, model),
        suspension_of(scenario),
    )


def _drawn(scenario: RoverScenario, model: WheelSoilModel | None) -> CourseDistribution:
    """Distribution of courses on which a wheel with the mean load sinks by half the limit at most.

    The deepest wheel of a rover bears more and runs in a rut.
    """
    drawn = course_numbers(_with_front(scenario), model).drawn
    return drawn._replace(bogged_sinkage=_DEEPEST_ALONE * drawn.bogged_sinkage)


@compiled_part
def _settle(worlds, numbers, j, mass):
    """Put rover j at rest at the start of its course."""
    rovers = worlds.rovers
    s = numbers.suspension
    body = rovers.body
    wheels = rovers.wheels
    zero_column(body, j)
    zero_column(rovers.body_counts, j)
    body.mass[j] = mass * s.axles
    for a in range(s.axles):
        k = wheel_of(j, a, s.axles)
        worlds.wheel_streams[k] = word(worlds.streams, j)
        ahead = s.base - s.places[a]
        settle_at(
            wheels,
            rovers.counts,
            k,
            ahead,
            body.mass[j] * s.shares[a],
            worlds.courses,
            numbers.world,
        )
        rovers.axles.height[k] = ahead * math.sin(wheels.grade[k])
        rovers.axles.floor[k] = 0.0
        clear_ruts(worlds.ruts, k)
    body.next_halt[j] = between(worlds.streams, j, numbers.world.halt_low, numbers.world.halt_high)
    rovers.body_counts.converged[j] = 1


@compiled_root(nogil=True)
def lay_rovers(worlds, numbers, orders, first, end):
    """Follow the `orders` [rovers] for the courses `first` to `end` - 1; return the number of those not found.

    RESTART starts a new course and puts the rover at rest at its start.
    """
    courses = worlds.courses
    s = numbers.suspension
    body = worlds.rovers.body
    course = CourseNumbers(numbers.drawn, numbers.world.wheel)
    failed = 0
    for j in range(first, end):
        order = orders[j]
        if order == RESTART:
            mass = start_passable(j, courses, worlds.streams, course)
            if mass < 0.0:
                failed += 1
            else:
                extend_course(j, courses, mass, s.base + course.drawn.ahead, course)
                _settle(worlds, numbers, j, mass)
        elif order == TRY:
            worlds.reward[j] = start_course(j, courses, worlds.streams, course)
        elif order == COMPLETE or order == AHEAD:
            x = np.inf if order == COMPLETE else body.x[j] + s.base + course.drawn.ahead
            extend_course(j, courses, body.mass[j] / s.axles, x, course)
    return failed


@compiled_part
def _restart(worlds, numbers, j):
    """Observe rover j at the start of its course."""
    take_pitch(worlds.rovers, j, numbers.suspension)
    worlds.cause[j] = RUNNING
    clear_reward(worlds, j)
    start_odometry(worlds.rovers.body, j, worlds.streams, numbers.task.sensors)
    _observe(worlds, numbers, j, 0, _sense_body(worlds, numbers, j))


@compiled_inline
def _sense_body(worlds, numbers, j):
    """Readings of the body of rover j: speed, pitch, acceleration."""
    sd = numbers.task.sensors.noise
    body = worlds.rovers.body
    a, b, c, _ = four_normals(worlds.streams, j)
    return BodyReading(
        body.speed[j] + sd[5] * a,
        body.pitch[j] + sd[7] * b,
        body.drawbar_pull[j] / body.mass[j] + sd[9] * c,
    )


@compiled_inline
def _sense_wheel(worlds, numbers, k, of_body):
    """Readings of wheel k; speed, pitch and acceleration are the body's, which has one sensor of each."""
    r = sense(worlds.rovers.wheels, k, worlds.wheel_streams, numbers.task.sensors)
    return SensorReading(
        r.slip,
        r.sinkage,
        r.drawbar_pull,
        r.load,
        r.torque,
        of_body.speed,
        r.rim_speed,
        of_body.pitch,
        r.motor_torque,
        of_body.acceleration,
    )


@compiled_part
def _observe(worlds, numbers, j, period, reading):
    """Sense the wheels of rover j after a control period, keep the record, and fill the observation."""
    rovers = worlds.rovers
    axles = numbers.suspension.axles
    record = worlds.record
    recorded = record.periods.size > 0
    out = worlds.observation[j]
    for a in range(axles):
        k = wheel_of(j, a, axles)
        of_wheel = _sense_wheel(worlds, numbers, k, reading)
        write_axle(out, rovers.wheels, k, a, of_wheel, numbers.task)
        if recorded:
            store_reading(of_wheel, record.readings[k, period])
    if recorded:
        record.periods[j] = period + 1
        record.places[j, period] = rovers.body.odometer[j]
        record.halted[j, period] = rovers.body.halt_left[j] > 0.0
    write_body(out, rovers.body, j, reading, numbers.task)
    if numbers.task.variant == 2:
        write_true_soils(out, j, axles, rovers.wheels, rovers.counts, worlds.courses, numbers.task)
    clip(out, numbers.task)


@compiled_inline
def _after_period(worlds, numbers, j, period):
    """End of a control period of rover j: sense, judge, reward, observe."""
    task = numbers.task
    body = worlds.rovers.body
    reading = _sense_body(worlds, numbers, j)
    roll_odometer(body, j, reading.speed, task.sensors)
    _observe(worlds, numbers, j, period, reading)
    cause = judge(body, worlds.rovers.body_counts, j, task)
    worlds.cause[j] = cause
    terms = worlds.terms[j]
    reward_terms(body, j, cause, task, terms)
    worlds.reward[j] = total_of(terms)


@compiled_inline
def _step_block(worlds, numbers, commands, block):
    """A step of those of the rovers `block` ... `block` + 7 that are `going`: as many control periods as an action
    lasts, until the episode ends."""
    end = min(block + COUNT, worlds.going.size)
    for period in range(numbers.task.repeat):
        advance(
            worlds.rovers,
            block,
            worlds.going,
            commands,
            worlds.courses,
            worlds.ruts,
            worlds.streams,
            numbers.world,
            numbers.suspension,
        )
        left = 0
        for j in range(block, end):
            if worlds.going[j] == STEP:
                _after_period(worlds, numbers, j, period)
                if worlds.cause[j] != RUNNING:
                    worlds.going[j] = IDLE
                else:
                    left += 1
        if left == 0:
            return


@compiled_root(nogil=True)
def step_rovers(worlds, numbers, commands, what, first, end):
    """Follow the orders `what` [rovers] STEP and RESTART for the rovers `first` to `end` - 1, block by block.

    `commands` [wheels]. Courses are laid (`lay_rovers`); `first` is a multiple of `COUNT`.
    """
    for block in range(first, end, COUNT):
        steps = 0
        for j in range(block, min(block + COUNT, end)):
            worlds.going[j] = STEP if what[j] == STEP else IDLE
            if what[j] == STEP:
                clear_reward(worlds, j)
                steps += 1
            elif what[j] == RESTART:
                _restart(worlds, numbers, j)
        if steps > 0:
            _step_block(worlds, numbers, commands, block)


@compiled_root(nogil=True)
def observe_true_soils(worlds, numbers, out):
    """Fill the true soils under the axles into observations `out` [rovers, D] of the variant `true_soil`."""
    rovers = worlds.rovers
    axles = numbers.suspension.axles
    for j in range(len(out)):
        write_true_soils(
            out[j], j, axles, rovers.wheels, rovers.counts, worlds.courses, numbers.task
        )
