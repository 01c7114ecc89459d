"""Compiled functions of many wheels: `lay_wheels` draws courses and places wheels at rest, `step_wheels` drives.

Nothing is identified here.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import EXACT, FINITE, HUGE, INLINE
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
    """Empty sensor record of so many vehicles with their wheels; `periods` is empty if nothing is recorded."""
    held = scenario.control.held
    rows = max(vehicles, 1)
    return Record(
        np.zeros(vehicles, dtype=np.int64),
        np.zeros((max(wheels, 1), held), READING),
        np.zeros((rows, held), dtype=np.bool_),
        np.zeros((rows, held)),
        np.zeros((rows if scenario.course.classes else 1, held), IMAGE),
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


class Setting(NamedTuple):
    """Constants and scratch of a thread as records.

    No arrays: numba counts references to those whenever a function takes one, which costs more than small functions.
    """

    rig: Any  # `RIG`
    acting: Acting
    task: Any  # `TASK`
    sd: Any  # `READING`
    errors: SensorErrors | None
    camera: Any  # `CAMERA`, or None
    nodes: Any  # `ARC_NODES`
    normals: Any  # `NORMALS`


class Notes(NamedTuple):
    """Rows of one wheel in the sensor record of a step; one reading is overwritten where nothing is recorded."""

    recorded: bool
    readings: np.ndarray  # [held] `READING`
    halted: np.ndarray  # [held]
    places: np.ndarray  # [held]
    images: np.ndarray  # [held] `IMAGE`


@njit(**EXACT)
def _first(array):
    """The only record of an array; None for None."""
    if array is None:
        return None
    else:
        return array[0]


@njit(**INLINE)
def setting_of(numbers, scratch):
    """Records of `WheelNumbers` and `Scratch`."""
    return Setting(
        numbers.rig[0],
        numbers.acting,
        numbers.task[0],
        numbers.sd[0],
        numbers.errors,
        _first(numbers.camera),
        scratch.nodes[0],
        scratch.normals[0],
    )


@njit(**INLINE)
def notes_of(record, reading, k):
    """Rows of wheel k in a sensor record; `reading` [1] of the thread where nothing is recorded."""
    recorded = record.periods.size > 0
    row = k if recorded else 0
    image = row if record.images.shape[0] > 1 else 0
    return Notes(
        recorded,
        record.readings[row] if recorded else reading,
        record.halted[row],
        record.places[row],
        record.images[image],
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


@njit(**EXACT)
def clear_reward(terms):
    """Set the reward terms of a step to zero."""
    for i in range(terms.size):
        terms[i] = 0.0


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
def _look(wheel, course, notes, period, camera):
    """`Sight` of the camera after a control period, and its image among the notes of the wheel."""
    if camera is None:
        return Sight(0, 0.0, 0.0)
    else:
        sight = look(wheel, course, camera)
        if notes.recorded:
            take_image(notes.images[period], wheel, course, sight, camera)
        return sight


@njit(**FINITE)
def _sense(wheel, reading, course, notes, period, setting):
    """Fill the readings of a wheel after a control period; its `Sight`. Both are noted if anything on board asks."""
    task = setting.task
    sense(wheel, reading, setting.normals, setting.sd, setting.errors, task.radius)
    if wheel.steps > 0:  # not at the start of a course
        roll_odometer(wheel, reading.speed, task.period)
    sight = _look(wheel, course, notes, period, setting.camera)
    if notes.recorded:
        notes.halted[period] = wheel.halt_left > 0.0
        notes.places[period] = wheel.odometer
    return sight


@njit(**FINITE)
def _observe(out, wheel, reading, course, sight, setting):
    """Fill the observation `out` [D] of a wheel but for what is identified."""
    task = setting.task
    write_sensors(out, wheel, reading, task)
    truth = task.variant == TRUE_SOIL
    if truth:
        write_soil_under(out[SENSORS:], wheel, course, setting.rig.border)
    write_seen(out[task.seen :], wheel, course, sight, setting.camera, truth)


@njit(**FINITE)
def _restart(wheel, course, setting, notes, out):
    """Observe a wheel at the start of its course."""
    start_odometry(wheel, setting.task.odometry_scale)
    reading = notes.readings[0]
    sight = _sense(wheel, reading, course, notes, 0, setting)
    _observe(out, wheel, reading, course, sight, setting)


@njit(**FINITE)
def _step(wheel, action, course, setting, notes, terms, out):
    """The control periods of an action of a wheel, until its episode ends: drive, sense, judge, reward; then observe.

    Returns the `Cause` and the number of periods.
    """
    task = setting.task
    world = World(setting.rig, setting.acting, setting.nodes)
    period = 0
    while True:
        control_period(wheel, action, course, world)
        reading = notes.readings[period if notes.recorded else 0]
        sight = _sense(wheel, reading, course, notes, period, setting)
        cause = judge(wheel, task)
        add_reward(wheel, cause, task, terms)
        period += 1
        if period == task.held or cause != RUNNING:
            break
    _observe(out, wheel, reading, course, sight, setting)
    return cause, period


@kept
def step_wheels(worlds, numbers, actions, orders, scratch, first, end):
    """Follow the `orders` [wheels] STEP and RESTART for the wheels `first` to `end` - 1; `actions` [wheels] in [-1, 1].

    Their courses are laid (`lay_wheels`).
    """
    setting = setting_of(numbers, scratch)
    record = worlds.record
    for k in range(first, end):
        if orders[k] != STEP and orders[k] != RESTART:
            continue
        wheel = worlds.state[k]
        course = course_of(worlds.courses, k)
        notes = notes_of(record, scratch.reading, k)
        out = worlds.observation[k]
        terms = worlds.terms[k]
        clear_reward(terms)
        if orders[k] == STEP:
            cause, periods = _step(wheel, actions[k], course, setting, notes, terms, out)
        else:
            _restart(wheel, course, setting, notes, out)
            cause = RUNNING
            periods = 1
        clip(out, numbers.low, numbers.high)
        worlds.cause[k] = cause
        worlds.reward[k] = total_of(terms)
        if notes.recorded:
            record.periods[k] = periods


@kept
def write_true_soils(worlds, numbers, out):
    """Fill `out` [wheels, D] with the entries of `layout.truth`."""
    border = numbers.rig[0].border
    camera = _first(numbers.camera)
    for k in range(len(out)):
        write_truth(out[k], worlds.state[k], course_of(worlds.courses, k), border, camera)
