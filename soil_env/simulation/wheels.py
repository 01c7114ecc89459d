"""Compiled functions of many wheels: `lay_wheels` draws courses and places wheels at rest, `step_wheels` drives.

Nothing is identified here. The two are compiled by themselves, side by side if there is a second processor.
"""

from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_inline, compiled_part, compiled_root
from soil_env._numba.records import row_record
from soil_env._numba.rows import Rows
from soil_env.parameters import Scenario
from soil_env.readings import IDLE, RESTART, RUNNING, STEP, Image, Record, SensorReading
from soil_env.simulation.task.observation import write_observation, write_truth
from soil_env.simulation.task.rules import (
    REWARD_TERMS,
    TaskNumbers,
    judge,
    reward_terms,
    total_of,
)
from soil_env.simulation.world.camera import Sight, image_of, look
from soil_env.simulation.world.courses import (
    CourseDistribution,
    CourseNumbers,
    draw_course,
    extend_course,
    start_course,
)
from soil_env.simulation.world.dynamics import MANY, advance
from soil_env.simulation.world.sensors import roll_odometer, sense, start_odometry
from soil_env.simulation.world.terrain import Courses, new_courses
from soil_env.simulation.world.wheel import WheelCounts, WheelState, WorldNumbers, settle

_RESTARTS = 100  # attempts at a course in the middle of a run, where nobody can change the scenario
LEAST = 32  # wheels that a thread takes at a time, at least
#: Orders for a course: a whole one drawn as a trial (`reward` is then the mass on the wheel, or -1 if no passable one
#: was found), the rest of it drawn, the ground ahead drawn.
TRY = np.int8(3)
COMPLETE = np.int8(4)
AHEAD = np.int8(5)
_load_reading, store_reading = row_record(SensorReading)
_load_image, _store_image = row_record(Image)


def new_record(vehicles: int, wheels: int, scenario: Scenario) -> Record:
    """Empty record of so many vehicles with their wheels."""
    repeat = scenario.control.held
    return Record(
        np.zeros(vehicles, dtype=np.int64),
        np.zeros((wheels, repeat, len(SensorReading._fields))),
        np.zeros((vehicles, repeat), dtype=np.bool_),
        np.zeros((vehicles, repeat)),
        np.zeros((wheels if scenario.course.classes else 0, repeat, len(Image._fields))),
    )


class WheelWorlds(NamedTuple):
    """Arrays that the compiled step reads and writes, one row a wheel."""

    state: Rows  # WheelState
    counts: Rows  # WheelCounts
    courses: Courses
    streams: np.ndarray  # [wheels] uint64
    record: Record
    observation: np.ndarray  # [wheels, D] float32
    terms: np.ndarray  # [wheels, 4] reward terms
    reward: np.ndarray  # [wheels]
    cause: np.ndarray  # [wheels] `Cause`
    going: np.ndarray  # [wheels] int8, scratch of a step: STEP while the wheel drives


class WheelNumbers(NamedTuple):
    """Numbers of the scenario that the compiled step needs."""

    world: WorldNumbers
    drawn: CourseDistribution
    task: TaskNumbers


def new_wheel_worlds(
    wheels: int, scenario: Scenario, task: TaskNumbers, recorded: bool
) -> WheelWorlds:
    """Worlds for so many wheels, to be restarted; `recorded`: keep the sensor record of each step."""
    return WheelWorlds(
        WheelState(wheels),
        WheelCounts(wheels),
        new_courses(wheels, scenario),
        np.zeros(wheels, dtype=np.uint64),
        new_record(wheels, wheels, scenario) if recorded else new_record(0, 0, scenario),
        np.zeros((wheels, task.low.size), dtype=np.float32),
        np.zeros((wheels, len(REWARD_TERMS))),
        np.zeros(wheels),
        np.zeros(wheels, dtype=np.int64),
        np.full(wheels, IDLE),
    )


@compiled_inline
def clear_reward(worlds, k):
    """Set the sums of a step of wheel k to zero."""
    worlds.reward[k] = 0.0
    for i in range(worlds.terms.shape[1]):
        worlds.terms[k, i] = 0.0


@compiled_inline
def start_passable(k, courses, streams, numbers):
    """Start a new course k; the mass [kg] on the wheel with payload, or -1 if no passable course was found."""
    mass = -1.0
    attempts = 0
    while mass < 0.0 and attempts < _RESTARTS:
        mass = start_course(k, courses, streams, numbers)
        attempts += 1
    return mass


@compiled_root(nogil=True)
def lay_wheels(worlds, numbers, orders, first, end):
    """Follow the `orders` [wheels] for the courses `first` to `end` - 1; return the number of those not found.

    RESTART starts a new course and puts the wheel at rest at its start.
    """
    courses = worlds.courses
    streams = worlds.streams
    course = CourseNumbers(numbers.drawn, numbers.world.wheel)
    failed = 0
    for k in range(first, end):
        order = orders[k]
        if order == RESTART:
            mass = start_passable(k, courses, streams, course)
            if mass < 0.0:
                failed += 1
            else:
                settle(worlds.state, worlds.counts, k, mass, courses, streams, numbers.world)
        elif order == TRY:
            worlds.reward[k] = draw_course(k, courses, streams, course)
        elif order == COMPLETE or order == AHEAD:
            x = np.inf if order == COMPLETE else worlds.state.x[k] + course.drawn.ahead
            extend_course(k, courses, worlds.state.mass[k], x, course)
    return failed


@compiled_part
def _restart(worlds, numbers, k):
    """Observe wheel k at the start of its course."""
    worlds.cause[k] = RUNNING
    clear_reward(worlds, k)
    start_odometry(worlds.state, k, worlds.streams, numbers.task.sensors)
    reading = sense(worlds.state, k, worlds.streams, numbers.task.sensors)
    sight = _look(worlds, numbers, k)
    _record(worlds, numbers, k, 0, reading, sight)
    _observation(worlds, numbers, k, reading, sight)


@compiled_inline
def _look(worlds, numbers, k):
    """`Sight` of the camera, if there is one."""
    if numbers.task.camera.classes == 0:
        return Sight(0, 0.0, 0.0)
    return look(worlds.state, worlds.counts, k, worlds.courses, worlds.streams, numbers.task.camera)


@compiled_inline
def _record(worlds, numbers, k, period, reading, sight):
    """Keep readings and image of wheel k in a control period, if anything on board asks for them."""
    record = worlds.record
    if record.periods.size == 0:
        return
    record.periods[k] = period + 1
    store_reading(reading, record.readings[k, period])
    record.halted[k, period] = worlds.state.halt_left[k] > 0.0
    record.places[k, period] = worlds.state.odometer[k]
    if numbers.task.camera.classes > 0:
        image = image_of(worlds.state, k, worlds.courses, sight, numbers.task.camera)
        _store_image(image, record.images[k, period])


@compiled_part
def _observation(worlds, numbers, k, reading, sight):
    write_observation(
        worlds.observation[k],
        worlds.state,
        worlds.counts,
        k,
        reading,
        worlds.courses,
        sight,
        numbers.task,
    )


@compiled_inline
def _after_period(worlds, numbers, k, period):
    """End of a control period of wheel k: sense, judge, reward, observe."""
    reading = sense(worlds.state, k, worlds.streams, numbers.task.sensors)
    roll_odometer(worlds.state, k, reading.speed, numbers.task.sensors)
    sight = _look(worlds, numbers, k)
    _record(worlds, numbers, k, period, reading, sight)
    cause = judge(worlds.state, worlds.counts, k, numbers.task)
    worlds.cause[k] = cause
    terms = worlds.terms[k]
    reward_terms(worlds.state, k, cause, numbers.task, terms)
    if period == numbers.task.repeat - 1 or cause != RUNNING:
        worlds.reward[k] = total_of(terms)
        _observation(worlds, numbers, k, reading, sight)


@compiled_inline
def _step(worlds, numbers, commands, start, count, steps):
    """Step the `steps` wheels of start ... start + count - 1 that are `going`, until their episodes end."""
    for period in range(numbers.task.repeat):
        if steps == 0:
            return
        advance(
            worlds.state,
            worlds.counts,
            start,
            count,
            worlds.going,
            commands,
            worlds.courses,
            worlds.streams,
            numbers.world,
        )
        for k in range(start, start + count):
            if worlds.going[k] == STEP:
                _after_period(worlds, numbers, k, period)
                if worlds.cause[k] != RUNNING:
                    worlds.going[k] = IDLE
                    steps -= 1


@compiled_root(nogil=True)
def step_wheels(worlds, numbers, commands, what, first, end):
    """Follow the orders `what` [wheels] STEP and RESTART for the wheels `first` to `end` - 1, chunk by chunk.

    Their courses are laid (`lay_wheels`); `first` is a multiple of `COUNT`.
    """
    for start in range(first, end, MANY):
        count = min(MANY, end - start)
        steps = 0
        for k in range(start, start + count):
            worlds.going[k] = STEP if what[k] == STEP else IDLE
            if what[k] == STEP:
                clear_reward(worlds, k)
                steps += 1
            elif what[k] == RESTART:
                _restart(worlds, numbers, k)
        _step(worlds, numbers, commands, start, count, steps)


@compiled_root(nogil=True)
def write_true_soils(worlds, numbers, out):
    """Fill `out` [wheels, D] with the entries of `task.truth`; `numbers` are those of the variant `true_soil`."""
    for k in range(len(out)):
        write_truth(out[k], worlds.state, worlds.counts, k, worlds.courses, numbers.task)
