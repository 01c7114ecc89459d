"""Compiled functions of many wheels: `lay_wheels` draws courses and places wheels at rest,
`step_wheels` drives.

Nothing is identified here.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import EXACT, FINITE, HUGE, INLINE, record
from soil_env._compiled.random_streams import NORMALS, between
from soil_env.parameters import Scenario
from soil_env.parameters.readings import COMPLETE, IDLE, RESTART, STEP, TRY
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
    RUNNING,
    TASK,
    add_reward,
    judge,
    task_of,
    total_of,
)
from soil_env.simulation.world.camera import CAMERA, IMAGE, Sight, camera_of, look, take_image
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
from soil_env.simulation.world.terrain import new_courses
from soil_env.simulation.world.wheel import RIG, WHEEL, World, acting_in, rig_of, settle_at
from soil_env.terramechanics.contact import ARC_NODES, ShearLaw
from soil_env.terramechanics.effects import Effects
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.reaction import Acting
from soil_env.terramechanics.residual import ResidualLaw

ATTEMPTS = 100  # at a course in the middle of a run, where nobody can change the scenario


#: What a wheel hands to those on board after a control period: whether it was in a commanded halt
#: (0 or 1), its odometry [m], a `READING`, an `IMAGE`. The reading is not first: numba takes a
#: record that begins like another for one, and warns.
NOTE = record("halted", "place", *READING.names, *IMAGE.names)


NOWHERE = Sight(0, 0.0, 0.0)  # place of a wheel without a camera


#: Work space of a thread, and the number of its share of the wheels.
SCRATCH = record(share=("i8",), nodes=(ARC_NODES, 1), normals=(NORMALS, 1))


def new_scratch() -> np.ndarray:
    """Work space of one thread, `SCRATCH` [1]."""
    return np.zeros(1, SCRATCH)


class WheelWorlds(NamedTuple):
    """Arrays that the compiled step reads and writes, one row a wheel."""

    state: np.ndarray  # [wheels] `WHEEL`
    courses: np.ndarray  # [wheels] `course_dtype`
    #: [wheels, held] `NOTE` of the last step; [shares, 1] if nothing on board reads them.
    notes: np.ndarray
    observation: np.ndarray  # [wheels, D] float32
    actions: np.ndarray  # [wheels] in [-1, 1]
    orders: np.ndarray  # [wheels] int8, STEP, RESTART or IDLE


class WheelNumbers(NamedTuple):
    """Constants of a scenario that the compiled step needs."""

    rig: np.ndarray  # [1] `RIG`
    acting: Acting
    task: np.ndarray  # [1] `TASK`
    bounds: np.ndarray  # [2, D] float32 of the observation
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
        np.array([[e.low for e in entries], [e.high for e in entries]], dtype=np.float32),
        sensor_deviations(scenario),
        sensor_errors(model),
        camera_of(scenario) if scenario.course.classes else None,
    )


MOST_ENTRIES = 128  # of an observation
#: `WheelNumbers` as compiled code takes them, with the bounds of the observation in the first
#: columns.
CONSTANTS = record(
    rig=(RIG, 1),
    task=(TASK, 1),
    sd=(READING, 1),
    camera=(CAMERA, 1),
    bounds=("f4", (2, MOST_ENTRIES)),
    recorded=("?",),  # True if each step is noted for what runs on board
)


class Options(NamedTuple):
    """What is on in a world; what is None compiles to no code."""

    effects: Effects | None
    law: ShearLaw | None
    residual: ResidualLaw | None
    errors: SensorErrors | None
    camera: bool | None


def constants_of(numbers: WheelNumbers, recorded: bool) -> tuple[np.ndarray, Options]:
    """Pack `WheelNumbers` into `CONSTANTS` [1] and `Options`."""
    constants = np.zeros(1, CONSTANTS)
    constants["rig"] = numbers.rig
    constants["task"] = numbers.task
    constants["sd"] = numbers.sd
    constants["recorded"] = recorded
    if numbers.camera is not None:
        constants["camera"] = numbers.camera
    entries = numbers.bounds.shape[1]
    if entries > MOST_ENTRIES:
        raise ValueError(f"observation of {entries} entries: expected at most {MOST_ENTRIES}")
    constants["bounds"][0, :, :entries] = numbers.bounds
    camera = None if numbers.camera is None else True
    return constants, Options(*numbers.acting, numbers.errors, camera)


def new_wheel_worlds(
    wheels: int, scenario: Scenario, numbers: WheelNumbers, notes: tuple[int, int]
) -> WheelWorlds:
    """Worlds for so many wheels, to be restarted, with `notes` of that shape."""
    return WheelWorlds(
        np.zeros(wheels, WHEEL),
        new_courses(wheels, scenario),
        np.zeros(notes, NOTE),
        np.zeros((wheels, numbers.bounds.shape[1]), dtype=np.float32),
        np.zeros(wheels),
        np.full(wheels, IDLE),
    )


class Setting(NamedTuple):
    """Constants and scratch of a thread as records.

    No arrays: numba counts references to those whenever a function takes one, which costs more than
    small functions.
    """

    rig: Any  # `RIG`
    acting: Acting
    task: Any  # `TASK`
    sd: Any  # `READING`
    errors: SensorErrors | None
    nodes: Any  # `ARC_NODES`
    normals: Any  # `NORMALS`


@njit(**EXACT)
def camera_in(constants, on):
    """`CAMERA` of a world that has one, else None."""
    if on is None:
        return None
    else:
        return constants.camera[0]


@njit
def start_passable(course, owner, numbers, scratch):
    """Start a course with a seed of `owner`; the loaded mass [kg], or -1 if none is passable."""
    mass = -1.0
    attempts = 0
    while mass < 0.0 and attempts < ATTEMPTS:
        mass = start_course(course, owner, numbers, scratch)
        attempts += 1
    return mass


@kept
def lay_wheels(worlds, numbers, orders, scratch, first, end):
    """Follow the `orders` [wheels] for the courses `first` to `end` - 1; return the number of those
    not found.

    RESTART starts a new course and puts the wheel, whose record is blank but for its stream, at
    rest at its start. After TRY, the wheel's `reward` is the mass on it, or -1 if no passable
    course was found. `numbers`: `CourseNumbers`.
    """
    rig = numbers.rig
    nodes = scratch[0].nodes[0]
    world = World(rig, numbers.acting, nodes)
    failed = 0
    for k in range(first, end):
        order = orders[k]
        if order == STEP or order == IDLE:
            continue
        wheel = worlds.state[k]
        course = worlds.courses[k]
        if order == RESTART:
            mass = start_passable(course, wheel, numbers, nodes)
            if mass < 0.0:
                failed += 1
            else:
                settle_at(wheel, 0.0, mass, course, world)
                wheel.next_halt = between(wheel, rig.halt_low, rig.halt_high)
        elif order == TRY:
            wheel.reward = draw_course(course, wheel, numbers, nodes)
        else:
            x = HUGE if order == COMPLETE else wheel.x + numbers.drawn.spec.ahead
            extend_course(course, wheel.mass, x, numbers, nodes)
    return failed


@njit(**FINITE)
def _sense(wheel, note, course, setting, camera):
    """Fill the `NOTE` of a wheel after a control period; return its camera's `Sight`, if any."""
    task = setting.task
    sense(wheel, note, setting.normals, setting.sd, setting.errors, task.radius)
    if wheel.steps > 0:  # not at the start of a course
        roll_odometer(wheel, note.speed, task.period)
    note.halted = 1.0 if wheel.halt_left > 0.0 else 0.0
    note.place = wheel.odometer
    if camera is None:
        return NOWHERE
    else:
        sight = look(wheel, course, camera)
        take_image(note, wheel, course, sight, camera)
        return sight


@njit(**INLINE)
def _observe(wheel, note, course, setting, camera, sight, out):
    """Fill the observation `out` [D] of a wheel but for what is identified."""
    task = setting.task
    write_sensors(out, wheel, note, task)
    truth = task.variant == TRUE_SOIL
    if truth:
        write_soil_under(out[SENSORS:], wheel, course, setting.rig.border)
    if camera is not None:
        write_seen(out[task.seen :], wheel, course, sight, camera, truth)


@njit(**FINITE)
def _restart(wheel, note, course, setting, camera, out):
    """Observe a wheel at the start of its course."""
    start_odometry(wheel, setting.task.odometry_scale)
    wheel.cause = RUNNING
    wheel.periods = 1
    sight = _sense(wheel, note, course, setting, camera)
    _observe(wheel, note, course, setting, camera, sight, out)


@njit(**FINITE)
def _step(wheel, action, course, setting, camera, notes, out):
    """The control periods of an action of a wheel, until its episode ends: drive, sense, judge,
    reward; then observe.

    `notes` [held], or [1] to overwrite.
    """
    task = setting.task
    world = World(setting.rig, setting.acting, setting.nodes)
    terms = wheel.terms
    for i in range(4):
        terms[i] = 0.0
    note = notes[0]
    sight = NOWHERE
    wheel.periods = 0
    wheel.cause = RUNNING
    while wheel.periods < task.held and wheel.cause == RUNNING:
        control_period(wheel, action, course, camera, world)
        note = notes[min(wheel.periods, notes.size - 1)]
        sight = _sense(wheel, note, course, setting, camera)
        wheel.cause = judge(wheel, task)
        add_reward(wheel, wheel.cause, task, terms)
        wheel.periods += 1
    wheel.reward = total_of(terms)
    _observe(wheel, note, course, setting, camera, sight, out)


@kept
def step_wheels(worlds, constants, options, scratch, first, end):
    """Follow the orders STEP and RESTART for the wheels `first` to `end` - 1, with their actions in
    [-1, 1].

    Their courses are laid (`lay_wheels`).
    """
    numbers = constants[0]
    work = scratch[0]
    setting = Setting(
        numbers.rig[0],
        Acting(options.effects, options.law, options.residual),
        numbers.task[0],
        numbers.sd[0],
        options.errors,
        work.nodes[0],
        work.normals[0],
    )
    camera = camera_in(numbers, options.camera)
    # taken out of their tuple once: see `Setting`
    state = worlds.state
    courses = worlds.courses
    all_notes = worlds.notes
    observation = worlds.observation
    actions = worlds.actions
    orders = worlds.orders
    for k in range(first, end):
        order = orders[k]
        if order != STEP and order != RESTART:
            continue
        wheel = state[k]
        course = courses[k]
        notes = all_notes[k if numbers.recorded else work.share]
        out = observation[k]
        if order == STEP:
            _step(wheel, actions[k], course, setting, camera, notes, out)
        else:
            _restart(wheel, notes[0], course, setting, camera, out)
        clip(out, numbers.bounds)


@kept
def write_true_soils(worlds, constants, options, out):
    """Fill `out` [wheels, D] with the entries of `layout.truth`."""
    numbers = constants[0]
    camera = camera_in(numbers, options.camera)
    border = numbers.rig[0].border
    for k in range(len(out)):
        write_truth(out[k], worlds.state[k], worlds.courses[k], border, camera)
