"""Many rovers in many worlds, stepped by one compiled call: what the rover's environments are made of."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, part, root, take
from soil_env._numba.lanes import COUNT
from soil_env._numba.random_streams import between, four_normals, word
from soil_env._numba.rows import zero_column
from soil_env.identification.online.identifier import (
    HELD,
    IdentifierNumbers,
    Identifiers,
    SensorReading,
    forget,
    identifier_numbers,
    new_identifiers,
    observe,
)
from soil_env.identification.online.pooling import share
from soil_env.identification.online.stretches import PoolNumbers, Pools, forget_stretches, new_pools, note, pool_numbers
from soil_env.simulation.courses import (
    CourseDistribution,
    CourseNumbers,
    course_numbers,
    draw_ahead,
    extend_course,
    start_course,
)
from soil_env.simulation.rover.body import (
    AxleState,
    BodyCounts,
    BodyState,
    Suspension,
    suspension_of,
)
from soil_env.simulation.rover.dynamics import Rovers, advance, take_pitch
from soil_env.simulation.rover.ruts import Ruts, clear_ruts, new_ruts
from soil_env.simulation.rover.task import BodyReading, rover_task_numbers, write_axle, write_body, write_soils
from soil_env.simulation.sensors import roll_odometer, sense, start_odometry
from soil_env.simulation.task import REWARD_TERMS, Cause, TaskNumbers, judge, knowledge, reward_terms
from soil_env.simulation.terrain import Courses, new_courses
from soil_env.simulation.wheel import WheelCounts, WheelState, WorldNumbers, settle_at, wheel_of, world_numbers
from soil_env.simulation.worlds import COMPLETE, IDLE, RESTART, STEP, TRY
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.vehicle import RoverScenario

_RESTARTS = 100  # attempts at a course in the middle of a run, where there is nobody to change the scenario
_MOST_BLOCKS = 8  # of eight rovers, that a thread takes at a time
_DEEPEST_ALONE = 0.5  # of the limit of sinkage, of a wheel by itself on the ground of a course
_LOAD_DRIFT = 0.05  # 1-sigma of the change of the load on a wheel from one point of the identifier to the next
_RUNNING = Cause.RUNNING.value


class RoverWorlds(NamedTuple):
    """Everything the compiled step reads and writes: one row a rover, or one a wheel (`wheel.wheel_of`)."""

    rovers: Rovers
    courses: Courses  # a course a rover; what is left in its cells is in `ruts`
    ruts: Ruts
    streams: np.ndarray  # [rovers] uint64
    wheel_streams: np.ndarray  # [wheels] uint64
    ids: Identifiers  # one a wheel
    known: Pools  # what all wheels of a rover have identified of the soil under each
    observation: np.ndarray  # [rovers, D] float32
    terms: np.ndarray  # [rovers, 4] reward terms
    reward: np.ndarray  # [rovers]
    cause: np.ndarray  # [rovers] `task.Cause`
    going: np.ndarray  # [rovers] int8, scratch of a step: STEP while the rover drives


def new_rover_worlds(rovers: int, scenario: RoverScenario, task: TaskNumbers) -> RoverWorlds:
    """Worlds for so many rovers, to be restarted."""
    wheels = -(-rovers // COUNT) * COUNT * scenario.axles
    courses = new_courses(rovers, _with_front(scenario))
    return RoverWorlds(
        Rovers(BodyState(rovers), BodyCounts(rovers), WheelState(wheels), WheelCounts(wheels), AxleState(wheels)),
        courses,
        new_ruts(wheels, courses.rut.shape[1]),
        np.zeros(rovers, dtype=np.uint64),
        np.zeros(wheels, dtype=np.uint64),
        new_identifiers(wheels),
        new_pools(wheels),
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
    """The scenario as the compiled step takes it."""

    world: WorldNumbers
    drawn: CourseDistribution
    identifier: IdentifierNumbers
    pool: PoolNumbers
    task: TaskNumbers
    suspension: Suspension


def rover_numbers(scenario: RoverScenario, variant: str, model: WheelSoilModel | None = None) -> RoverNumbers:
    """Pack what the compiled step needs; `model` brings the effects that are on in this world."""
    return RoverNumbers(
        world_numbers(scenario, model, scenario.axles),
        _drawn(scenario, model),
        _identifier_numbers(scenario),
        pool_numbers(scenario),
        rover_task_numbers(scenario, variant, model),
        suspension_of(scenario),
    )


def _drawn(scenario: RoverScenario, model: WheelSoilModel | None) -> CourseDistribution:
    """What courses are drawn from: ground on which a wheel with the mean load sinks by half the limit at most, since
    the deepest wheel of a rover bears more and runs in a rut."""
    drawn = course_numbers(_with_front(scenario), model).drawn
    return drawn._replace(bogged_sinkage=_DEEPEST_ALONE * drawn.bogged_sinkage)


def _identifier_numbers(scenario: RoverScenario) -> IdentifierNumbers:
    """Of an identifier a wheel: the body's accelerometer says nothing of one wheel, nor does the body's pitch of the
    grade under it, and the load on a wheel changes with the pull. Nor does the torque of a motor whose speed loop turns
    the wheel faster or slower: that at the end of a period is not the mean over it."""
    numbers = identifier_numbers(scenario)
    noise = numbers.filter.noise.copy()
    noise[9] = 1e6 * scenario.gravity
    if scenario.control.action != "torque":
        noise[8] = 1e6 * scenario.weight * scenario.wheel.radius
    own = numbers.filter._replace(noise=noise, grade_change=0.0, load_drift=_LOAD_DRIFT)
    return numbers._replace(filter=own)


@inlined
def _course(numbers):
    return CourseNumbers(numbers.drawn, numbers.world.wheel)


# --- one rover --------------------------------------------------------------------------------------------------------


@part
def restart(worlds, numbers, j):
    """Start a new course for rover j, put it at its start, and observe."""
    rovers, s = worlds.rovers, numbers.suspension
    body, wheels = rovers.body, rovers.wheels
    mass, attempts = -1.0, 0
    while mass < 0.0 and attempts < _RESTARTS:
        mass = start_course(j, worlds.courses, worlds.streams, _course(numbers))
        attempts += 1
    if mass < 0.0:
        raise RuntimeError("no passable course found: the soils are too weak for this rover")
    draw_ahead(j, worlds.courses, s.base, mass, _course(numbers))
    zero_column(body, j)
    zero_column(rovers.body_counts, j)
    body.mass[j] = mass * s.axles
    for a in range(s.axles):
        k = wheel_of(j, a, s.axles)
        worlds.wheel_streams[k] = word(worlds.streams, j)
        ahead = s.base - s.places[a]
        settle_at(wheels, rovers.counts, k, ahead, body.mass[j] * s.shares[a], worlds.courses, numbers.world)
        rovers.axles.height[k] = ahead * math.sin(wheels.grade[k])
        rovers.axles.floor[k] = 0.0
        clear_ruts(worlds.ruts, k)
        forget(worlds.ids, k, numbers.identifier)
        forget_stretches(worlds.known, worlds.ids, k)
    body.next_halt[j] = between(worlds.streams, j, numbers.world.halt_low, numbers.world.halt_high)
    take_pitch(rovers, j, s)
    rovers.body_counts.converged[j] = 1
    worlds.cause[j] = _RUNNING
    _clear(worlds, j)
    start_odometry(body, j, worlds.streams, numbers.task.sensors)
    reading = _sense_body(worlds, numbers, j)
    for a in range(s.axles):
        k = wheel_of(j, a, s.axles)
        write_axle(worlds.observation[j], wheels, k, a, _sense_wheel(worlds, numbers, k, reading), numbers.task)
    _observe_rest(worlds, numbers, j, reading)


@inlined
def _clear(worlds, j):
    """What a step sums up, at its start."""
    worlds.reward[j] = 0.0
    for i in range(worlds.terms.shape[1]):
        worlds.terms[j, i] = 0.0


@inlined
def _sense_body(worlds, numbers, j):
    """Readings of the body of rover j: speed, pitch, acceleration."""
    sd, body = numbers.task.sensors.noise, worlds.rovers.body
    a, b, c, _ = four_normals(worlds.streams, j)
    return BodyReading(
        body.speed[j] + sd[5] * a, body.pitch[j] + sd[7] * b, body.drawbar_pull[j] / body.mass[j] + sd[9] * c
    )


@inlined
def _sense_wheel(worlds, numbers, k, of_body):
    """Readings of wheel k; speed, pitch and acceleration are the body's, which has one sensor of each."""
    r = sense(worlds.rovers.wheels, k, worlds.wheel_streams, numbers.task.sensors)
    return SensorReading(
        r.slip, r.sinkage, r.drawbar_pull, r.load, r.torque, of_body.speed, r.rim_speed, of_body.pitch, r.motor_torque,
        of_body.acceleration,
    )  # fmt: skip


@inlined
def _observe_rest(worlds, numbers, j, reading):
    """The observation of rover j but for the readings of its wheels."""
    rovers, out = worlds.rovers, worlds.observation[j]
    write_body(out, rovers.body, j, reading, numbers.task)
    write_soils(
        out, j, numbers.suspension.axles, rovers.wheels, rovers.counts, worlds.courses, worlds.known, numbers.task
    )


@inlined
def _knowledge(worlds, numbers, j):
    """Mean of `task.knowledge` over the axles of rover j."""
    axles, known = numbers.suspension.axles, 0.0
    for a in range(axles):
        known += knowledge(worlds.known, wheel_of(j, a, axles), numbers.identifier.precision)
    return known / axles


@inlined
def after_period(worlds, numbers, j, first, last):
    """After a control period of rover j: draw the course ahead, sense, identify, judge, reward, observe.

    `first`, `last`: whether it is the first and the last one of the action, if the episode does not end in it.
    """
    rovers, s, task = worlds.rovers, numbers.suspension, numbers.task
    body, paid = rovers.body, task.reward_information > 0.0
    before = _knowledge(worlds, numbers, j) if paid and first else 0.0
    draw_ahead(j, worlds.courses, body.x[j] + s.base, body.mass[j] / s.axles, _course(numbers))
    reading = _sense_body(worlds, numbers, j)
    roll_odometer(body, j, reading.speed, task.sensors)
    furthest = HELD
    for a in range(s.axles):
        k = wheel_of(j, a, s.axles)
        of_wheel = _sense_wheel(worlds, numbers, k, reading)
        outcome = observe(worlds.ids, k, of_wheel, numbers.identifier)
        note(worlds.known, worlds.ids, k, body.odometer[j] - s.places[a], outcome, a > 0, numbers.pool)
        furthest = max(furthest, outcome)
        write_axle(worlds.observation[j], rovers.wheels, k, a, of_wheel, task)
    share(worlds.known, worlds.ids, wheel_of(j, 0, s.axles), s.axles, furthest, numbers.pool, numbers.identifier)
    cause = judge(body, rovers.body_counts, j, task)
    worlds.cause[j] = cause
    after = _knowledge(worlds, numbers, j) if paid and last else 0.0
    terms = worlds.terms[j]
    reward_terms(body, j, cause, before, after, task, terms)
    if last or cause != _RUNNING:
        worlds.reward[j] = terms[0] + terms[1] + terms[2] + terms[3]
        _observe_rest(worlds, numbers, j, reading)


# --- many rovers ------------------------------------------------------------------------------------------------------


@inlined
def _step_block(worlds, numbers, commands, block):
    """A step of those of the rovers `block` ... `block` + 7 that are `going`: as many control periods as an action
    lasts, until the episode ends."""
    repeat, end = numbers.task.repeat, min(block + COUNT, worlds.going.size)
    for period in range(repeat):
        advance(
            worlds.rovers, block, worlds.going, commands, worlds.courses, worlds.ruts, worlds.streams, numbers.world,
            numbers.suspension,
        )  # fmt: skip
        left = 0
        for j in range(block, end):
            if worlds.going[j] == STEP:
                after_period(worlds, numbers, j, period == 0, period == repeat - 1)
                if worlds.cause[j] != _RUNNING:
                    worlds.going[j] = IDLE
                else:
                    left += 1
        if left == 0:
            return


@root(nogil=True)
def step_rovers(worlds, numbers, commands, what, counter):
    """What `what` [rovers] says, block by block; `commands` [wheels]; `counter`: [next block, threads at work]."""
    rovers = what.size
    blocks = (rovers + COUNT - 1) // COUNT
    portion = min(max(blocks // (4 * counter[1]), 1), _MOST_BLOCKS)
    block = take(counter, portion)
    while block < blocks:
        for b in range(block, min(block + portion, blocks)):
            steps = 0
            for j in range(b * COUNT, min((b + 1) * COUNT, rovers)):
                worlds.going[j] = STEP if what[j] == STEP else IDLE
                if what[j] == STEP:
                    _clear(worlds, j)
                    steps += 1
                elif what[j] == RESTART:
                    restart(worlds, numbers, j)
                elif what[j] == TRY:
                    worlds.reward[j] = start_course(j, worlds.courses, worlds.streams, _course(numbers))
                elif what[j] == COMPLETE:
                    mass = worlds.rovers.body.mass[j] / numbers.suspension.axles
                    extend_course(j, worlds.courses, mass, np.inf, _course(numbers))
            if steps > 0:
                _step_block(worlds, numbers, commands, b * COUNT)
        block = take(counter, portion)
