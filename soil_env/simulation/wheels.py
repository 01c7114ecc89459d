"""Compiled functions of many wheels: `lay_wheels` draws courses and places wheels at rest, `step_wheels` drives.

Nothing is identified here.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import FINITE, HUGE
from soil_env._compiled.random_streams import NORMALS, between
from soil_env.parameters import Scenario
from soil_env.parameters.readings import COMPLETE, IDLE, RESTART, STEP, TRY, Record
from soil_env.simulation.task.layout import layout
from soil_env.simulation.task.observation import (
    SENSORS,
    TRUE_SOIL,
    clip,
    write_seen,
    write_sensors,
    write_soil_under,
    write_truth,
)
from soil_env.simulation.task.rules import (
    REWARD_TERMS,
    RUNNING,
    add_reward,
    judge,
    task_of,
    total_of,
)
from soil_env.simulation.world.camera import IMAGE, Sight, camera_of, look, take_image
from soil_env.simulation.world.courses import (
    draw_course,
    extend_course,
    start_course,
)
from soil_env.simulation.world.dynamics import control_period
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
from soil_env.simulation.world.wheel import WHEEL, World, acting_in, rig_of, settle_at
from soil_env.terramechanics.contact import ARC_NODES
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.reaction import Acting

ATTEMPTS = 100  # at a course in the middle of a run, where nobody can change the scenario


def new_record(vehicles: int, wheels: int, scenario: Scenario) -> Record:
    """Empty sensor record of so many vehicles with their wheels; readings are `READING`, images `IMAGE`."""
    held = scenario.control.held
    return Record(
        np.zeros(vehicles, dtype=np.int64),
        np.zeros((wheels, held), READING),
        np.zeros((vehicles, held), dtype=np.bool_),
        np.zeros((vehicles, held)),
        np.zeros((wheels if scenario.course.classes else 0, held), IMAGE),
    )


class Scratch(NamedTuple):
    """Work arrays of a thread."""

    nodes: np.ndarray  # [1] `ARC_NODES`
    normals: np.ndarray  # [1] `NORMALS`
    reading: np.ndarray  # [1] `READING`
    wheel: np.ndarray  # [1] `WHEEL`, blank


def new_scratch() -> Scratch:
    """Work arrays of one thread."""
    return Scratch(
        np.zeros(1, ARC_NODES), np.zeros(1, NORMALS), np.zeros(1, READING), np.zeros(1, WHEEL)
    )


class WheelWorlds(NamedTuple):
    """Arrays that the compiled step reads and writes, one row a wheel."""

    state: np.ndarray  # [wheels] `WHEEL`
    courses: Courses
    record: Record
    observation: np.ndarray  # [wheels, D] float32
    terms: np.ndarray  # [wheels, 4] reward terms
    reward: np.ndarray  # [wheels]
    cause: np.ndarray  # [wheels] `Cause`


class WheelNumbers(NamedTuple):
    """Constants of a scenario that the compiled step needs."""

    rig: np.ndarray  # [1] `RIG`
    acting: Acting
    task: np.ndarray  # [1] `TASK`
    low: np.ndarray  # [D] float32 bounds of the observation
    high: np.ndarray
    sd: np.ndarray  # [1] `READING` of the noise
    errors: SensorErrors | None
    camera: np.ndarray | None  # [1] `CAMERA`


def wheel_numbers(
    scenario: Scenario, variant: str, model: WheelSoilModel | None = None
) -> WheelNumbers:
    """Pack a scenario; `model` gives the effects that are on in this world."""
    entries = layout(variant, scenario.course)
    return WheelNumbers(
        rig_of(scenario, model),
        acting_in(model),
        task_of(scenario, variant),
        np.array([e.low for e in entries], dtype=np.float32),
        np.array([e.high for e in entries], dtype=np.float32),
        sensor_deviations(scenario),
        sensor_errors(model),
        camera_of(scenario) if scenario.course.classes else None,
    )


def new_wheel_worlds(
    wheels: int, scenario: Scenario, numbers: WheelNumbers, recorded: bool
) -> WheelWorlds:
    """Worlds for so many wheels, to be restarted; `recorded`: keep the sensor record of each step."""
    return WheelWorlds(
        np.zeros(wheels, WHEEL),
        new_courses(wheels, scenario),
        new_record(wheels, wheels, scenario) if recorded else new_record(0, 0, scenario),
        np.zeros((wheels, numbers.low.size), dtype=np.float32),
        np.zeros((wheels, len(REWARD_TERMS))),
        np.zeros(wheels),
        np.zeros(wheels, dtype=np.int64),
    )


@njit
def start_passable(course, owner, numbers, scratch):
    """Start a new course with a seed of `owner`; the mass [kg] on the wheel with payload, -1 if none is passable."""
    mass = -1.0
    attempts = 0
    while mass < 0.0 and attempts < ATTEMPTS:
        mass = start_course(course, owner, numbers, scratch)
        attempts += 1
    return mass


@njit
def clear_reward(worlds, k):
    """Set the reward of a step of vehicle k to zero."""
    worlds.reward[k] = 0.0
    for i in range(worlds.terms.shape[1]):
        worlds.terms[k, i] = 0.0


@kept
def lay_wheels(worlds, numbers, orders, scratch, first, end):
    """Follow the `orders` [wheels] for the courses `first` to `end` - 1; return the number of those not found.

    RESTART starts a new course and puts the wheel at rest at its start. After TRY, `reward` is the mass on the wheel,
    or -1 if no passable course was found. `numbers`: `CourseNumbers`.
    """
    rig = numbers.rig
    nodes = scratch.nodes[0]
    world = World(rig, numbers.acting, nodes)
    failed = 0
    for k in range(first, end):
        order = orders[k]
        if order == STEP or order == IDLE:
            continue
        wheel = worlds.state[k]
        course = course_of(worlds.courses, k)
        if order == RESTART:
            mass = start_passable(course, wheel, numbers, nodes)
            if mass < 0.0:
                failed += 1
            else:
                stream = wheel.stream
                worlds.state[k] = scratch.wheel[0]
                wheel.stream = stream
                settle_at(wheel, 0.0, mass, course, world)
                wheel.next_halt = between(wheel, rig.halt_low, rig.halt_high)
        elif order == TRY:
            worlds.reward[k] = draw_course(course, wheel, numbers, nodes)
        else:
            x = HUGE if order == COMPLETE else wheel.x + numbers.drawn.spec.ahead
            extend_course(course, wheel.mass, x, numbers, nodes)
    return failed


@njit(**FINITE)
def _image(wheel, course, camera):
    """`Sight` of the camera after a control period, if there is one."""
    if camera is None:
        return Sight(0, 0.0, 0.0)
    else:
        return look(wheel, course, camera[0])


@njit(**FINITE)
def _keep_image(record, k, period, wheel, course, sight, camera):
    if camera is None:
        return
    else:
        take_image(record.images[k, period], wheel, course, sight, camera[0])


@njit(**FINITE)
def _sense(worlds, numbers, k, period, course, scratch):
    """Readings of wheel k after a control period, and what its camera sees; kept if anything on board asks for them."""
    wheel = worlds.state[k]
    record = worlds.record
    kept_readings = record.periods.size > 0
    reading = record.readings[k, period] if kept_readings else scratch.reading[0]
    sense(wheel, reading, scratch.normals[0], numbers.sd[0], numbers.errors, numbers.rig[0].radius)
    return reading


@njit(**FINITE)
def _look(worlds, numbers, k, period, course):
    """`Sight` of wheel k, kept with what runs on board, if anything does."""
    wheel = worlds.state[k]
    record = worlds.record
    sight = _image(wheel, course, numbers.camera)
    if record.periods.size > 0:
        record.periods[k] = period + 1
        record.halted[k, period] = wheel.halt_left > 0.0
        record.places[k, period] = wheel.odometer
        _keep_image(record, k, period, wheel, course, sight, numbers.camera)
    return sight


@njit(**FINITE)
def _observe(out, wheel, reading, course, sight, numbers):
    """Fill the observation `out` [D] of a wheel but for what is identified, cut to the bounds of the layout."""
    task = numbers.task[0]
    write_sensors(out, wheel, reading, task)
    truth = task.variant == TRUE_SOIL
    if truth:
        write_soil_under(out[SENSORS:], wheel, course, numbers.rig[0].border)
    _observe_lines(out[task.seen :], wheel, course, sight, numbers.camera, truth)
    clip(out, numbers.low, numbers.high)


@njit(**FINITE)
def _observe_lines(out, wheel, course, sight, camera, truth):
    if camera is None:
        return
    else:
        write_seen(out, wheel, course, sight, camera[0], truth)


@njit(**FINITE)
def _restart(worlds, numbers, k, course, scratch):
    """Observe wheel k at the start of its course."""
    worlds.cause[k] = RUNNING
    clear_reward(worlds, k)
    start_odometry(worlds.state[k], numbers.task[0].odometry_scale)
    reading = _sense(worlds, numbers, k, 0, course, scratch)
    sight = _look(worlds, numbers, k, 0, course)
    _observe(worlds.observation[k], worlds.state[k], reading, course, sight, numbers)


@njit(**FINITE)
def _step(worlds, numbers, k, action, course, scratch):
    """The control periods of an action of wheel k, until its episode ends: drive, sense, judge, reward; then observe."""
    wheel = worlds.state[k]
    task = numbers.task[0]
    terms = worlds.terms[k]
    world = World(numbers.rig[0], numbers.acting, scratch.nodes[0])
    clear_reward(worlds, k)
    period = 0
    while True:
        control_period(wheel, action, course, world)
        reading = _sense(worlds, numbers, k, period, course, scratch)
        roll_odometer(wheel, reading.speed, task.period)
        sight = _look(worlds, numbers, k, period, course)
        cause = judge(wheel, task)
        add_reward(wheel, cause, task, terms)
        period += 1
        if period == task.held or cause != RUNNING:
            break
    worlds.cause[k] = cause
    worlds.reward[k] = total_of(terms)
    _observe(worlds.observation[k], wheel, reading, course, sight, numbers)


@kept
def step_wheels(worlds, numbers, actions, orders, scratch, first, end):
    """Follow the `orders` [wheels] STEP and RESTART for the wheels `first` to `end` - 1; `actions` [wheels] in [-1, 1].

    Their courses are laid (`lay_wheels`).
    """
    for k in range(first, end):
        order = orders[k]
        if order == STEP:
            _step(worlds, numbers, k, actions[k], course_of(worlds.courses, k), scratch)
        elif order == RESTART:
            _restart(worlds, numbers, k, course_of(worlds.courses, k), scratch)


@kept
def write_true_soils(worlds, numbers, out):
    """Fill `out` [wheels, D] with the entries of `layout.truth`."""
    for k in range(len(out)):
        _write_truth(
            out[k], worlds.state[k], course_of(worlds.courses, k), numbers.rig[0], numbers.camera
        )


@njit
def _write_truth(out, wheel, course, rig, camera):
    if camera is None:
        write_truth(out, wheel, course, rig.border, None)
    else:
        write_truth(out, wheel, course, rig.border, camera[0])
