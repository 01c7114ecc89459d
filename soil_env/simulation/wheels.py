"""Compiled functions of many wheels: `lay_wheels` draws courses and places wheels at rest,
`step_wheels` drives.

Nothing is identified here.
"""

from typing import Any, NamedTuple

import numpy as np

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import HUGE, compiled_finite, inlined, record
from soil_env._compiled.random_streams import NORMALS, between
from soil_env.parameters import Scenario
from soil_env.parameters.readings import COMPLETE, IDLE, RESTART, STEP, TRY
from soil_env.terramechanics.contact import ARC_NODES
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.reaction import Acting

from .task.layout import bounds_of, layout
from .task.observation import (
    ENTRIES_OF_WHEEL,
    TRUE_SOIL,
    clip,
    write_seen,
    write_sensors,
    write_soil_under,
    write_truth,
)
from .task.rules import RUNNING, TASK, begin_step, judge_period, task_of
from .world.camera import CAMERA, IMAGE, Sight, camera_of, sight_of, take_image
from .world.courses import extend_course, start_course
from .world.dynamics import control_period
from .world.sensors import (
    READING,
    SENSOR_NOISE,
    SensorErrors,
    mount_sensors,
    read_slip,
    roll_odometer,
    sense,
    sensor_errors,
    sensors_of,
)
from .world.terrain import new_courses
from .world.wheel import RIG, WHEEL, World, acting_in, rig_of, settle_at

# [-] seeds that a restart tries for its course, since nobody can change the scenario in the middle
# of a run
ATTEMPTS = 100


#: Of a wheel after a control period, for the estimators on board: whether it was in a commanded
#: halt (0 or 1), a `READING`, an `IMAGE`. The reading is not first: numba takes a
#: record that begins like another for one, and warns.
SAMPLE = record("halted", *READING.names, *IMAGE.names)


#: Stands for the `Sight` of a wheel without a camera; nothing reads it.
NOWHERE = Sight(0, 0.0, 0.0)


class WheelWorlds(NamedTuple):
    """Arrays that the compiled step reads and writes, one row a wheel."""

    state: np.ndarray  # [wheels] `WHEEL`, with its action and order
    courses: np.ndarray  # [wheels] `course_dtype`
    #: [wheels, periods] `SAMPLE` of the last step; [chunks, 1] if nothing on board reads them
    samples: np.ndarray
    observation: np.ndarray  # [wheels, D] float32


class WheelNumbers(NamedTuple):
    """Constants of a scenario that the compiled step needs."""

    rig: np.ndarray  # [1] `RIG`
    acting: Acting
    task: np.ndarray  # [1] `TASK`
    bounds: np.ndarray  # [2, D] float32 of the observation
    sensors: np.ndarray  # [1] `SENSOR_NOISE`
    errors: SensorErrors
    camera: np.ndarray  # [1] `CAMERA`


def wheel_numbers(
    scenario: Scenario, variant: str, model: WheelSoilModel | None = None
) -> WheelNumbers:
    """Pack a scenario with an observation `variant`; `model` gives the effects that act in this
    world, on the wheel and on its sensors.
    """
    rig = rig_of(scenario, model)
    return WheelNumbers(
        rig,
        acting_in(model, rig[0].shear_ratio),
        task_of(scenario, variant),
        bounds_of(layout(variant, scenario.course)),
        sensors_of(scenario),
        sensor_errors(model),
        camera_of(scenario),
    )


# [-] room for the entries of an observation: more than the longest has, with `MOST_CLASSES` and
# two routes
MOST_ENTRIES = 128
#: `WheelNumbers` as compiled code takes them, with the work space of a thread.
SETTING = record(
    rig=(RIG, 1),
    task=(TASK, 1),
    sensors=(SENSOR_NOISE, 1),
    camera=(CAMERA, 1),
    bounds=("f4", (2, MOST_ENTRIES)),  # of the observation, in the first columns
    recorded=("i8",),  # 1 if each step is kept for what runs on board
    chunk=("i8",),  # number of the thread's chunk of the wheels
    nodes=(ARC_NODES, 1),
    normals=("f8", NORMALS),
)


class Additions(NamedTuple):
    """What acts in a world beside the base model, on its wheels and on their sensors."""

    acting: Acting
    errors: SensorErrors


def new_setting(numbers: WheelNumbers, recorded: bool, chunk: int) -> np.ndarray:
    """Constants and work space of the thread of a chunk of the wheels, `SETTING` [1].

    A chunk is what a thread steps at a time (`envs.vehicles`); `chunk` is its number, from 0.
    `recorded`: True if a sample is kept of each wheel and period.
    """
    setting = np.zeros(1, SETTING)
    for name in ("rig", "task", "sensors", "camera"):
        setting[name] = getattr(numbers, name)
    setting["recorded"] = recorded
    setting["chunk"] = chunk
    setting["bounds"][0, :, : numbers.bounds.shape[1]] = numbers.bounds
    return setting


def new_wheel_worlds(
    wheels: int, scenario: Scenario, numbers: WheelNumbers, samples: tuple[int, int]
) -> WheelWorlds:
    """Blank worlds of this number of `wheels`, which have to be restarted before they drive.

    `samples`: shape of their samples, as in `WheelWorlds`.
    """
    return WheelWorlds(
        np.zeros(wheels, WHEEL),
        new_courses(wheels, scenario),
        np.zeros(samples, SAMPLE),
        np.zeros((wheels, numbers.bounds.shape[1]), dtype=np.float32),
    )


class ThreadRecords(NamedTuple):
    """Records of the `SETTING` of a thread, and the `Additions`.

    Of the arrays [1] it has the records: numba counts references to an array whenever a function
    takes one, which costs more than small functions. Only `normals` is an array.
    """

    world: World
    task: Any  # `TASK`
    sensors: Any  # `SENSOR_NOISE`
    errors: SensorErrors
    camera: Any  # `CAMERA`
    normals: np.ndarray  # [`NORMALS`]


@inlined
def start_drivable(course, owner, numbers, nodes):
    """Start a course by `start_course`, whose arguments these are; return the mass [kg] on the
    wheel with payload.

    Where no soil is found, try another seed, at most `ATTEMPTS` times; then return -1.
    """
    for _ in range(ATTEMPTS):
        mass = start_course(course, owner, numbers, nodes)
        if mass >= 0.0:
            return mass
    return -1.0


@kept
def lay_wheels(worlds, numbers, orders, setting, first, end):
    """Follow the `orders` [wheels] (`parameters.readings`) for the courses `first` to `end` - 1.

    Return the number of restarts for which no soil was found.

    RESTART starts a new course and puts the wheel at rest at its start; the caller has made its
    record blank but for its stream. Where no soil is found, the record stays blank. TRY draws the
    start of a course; the wheel's `reward` is then the mass on it [kg], or -1 if no soil was found.
    AHEAD draws the ground that the next step needs, COMPLETE the rest; STEP and IDLE do nothing.
    `worlds`: `WheelWorlds`, `numbers`: `CourseNumbers`, `setting`: `SETTING` [1], whose nodes are
    scratch.
    """
    rig = numbers.rig
    nodes = setting[0].nodes[0]
    world = World(rig, numbers.acting, nodes)
    failed = 0
    for k in range(first, end):
        order = orders[k]
        if order == STEP or order == IDLE:
            continue
        wheel = worlds.state[k]
        course = worlds.courses[k]
        if order == RESTART:
            mass = start_drivable(course, wheel, numbers, nodes)
            if mass < 0.0:
                failed += 1
            else:
                settle_at(wheel, 0.0, mass, course, world)
                wheel.next_halt = between(wheel, rig.halt_low, rig.halt_high)
        elif order == TRY:
            wheel.reward = start_course(course, wheel, numbers, nodes)
        else:
            x = HUGE if order == COMPLETE else wheel.x + numbers.drawn.spec.ahead
            extend_course(course, wheel.mass, x, numbers, nodes)
    return failed


@compiled_finite
def _sense(wheel, sample, course, records):
    """Fill the `SAMPLE` of a wheel after a control period; return its camera's `Sight`, `NOWHERE`
    where no image is taken. `records`: `ThreadRecords`, here and below.
    """
    task = records.task
    sense(wheel, sample, records.normals, records.sensors, records.errors, task.radius)
    read_slip(wheel, sample, records.sensors, records.errors)
    sample.halted = 1.0 if wheel.halt_left > 0.0 else 0.0
    if records.camera.lines == 0:
        return NOWHERE
    sight = sight_of(wheel, course, records.camera)
    take_image(sample, wheel, course, sight, records.camera)
    return sight


@inlined
def _observe(wheel, sample, course, records, sight, out):
    """Fill the observation `out` [D] of a wheel, but for the entries that are identified: sensors,
    with the variant `true_soil` the soil, with a camera what it sees. `sight`: that of `_sense`.
    """
    task = records.task
    write_sensors(out, wheel, sample, task)
    truth = task.variant == TRUE_SOIL
    if truth:
        write_soil_under(out[ENTRIES_OF_WHEEL:], wheel, course, records.world.rig.border)
    if records.camera.lines > 0:
        write_seen(out[task.seen :], wheel, sample, course, sight, records.camera, truth)


@compiled_finite
def _restart(wheel, sample, course, records, out):
    """Begin the episode of a wheel that rests at the start of its course: draw the errors of its
    sensors, read the sensors into `sample` and fill the observation `out` [D].
    """
    mount_sensors(wheel, records.normals, records.sensors)
    wheel.cause = RUNNING
    wheel.periods = 1  # samples to read, as after a step of one period
    sight = _sense(wheel, sample, course, records)
    _observe(wheel, sample, course, records, sight, out)


@compiled_finite
def _step(wheel, action, course, records, samples, out):
    """Take a wheel through the control periods of an `action` in [-1, 1], at most to the end of its
    episode: drive, sense, judge, reward. Then fill the observation `out` [D].

    `samples` [periods]: of all periods, or [1] of the last.
    """
    task = records.task
    sample = samples[0]
    sight = NOWHERE
    begin_step(wheel)
    while wheel.periods < task.action_periods and wheel.cause == RUNNING:
        control_period(wheel, action, course, records.world)
        sample = samples[min(wheel.periods, samples.size - 1)]
        sight = _sense(wheel, sample, course, records)
        roll_odometer(wheel, sample.speed, task.period)
        judge_period(wheel, task)
    # without the term of information, which `identification.online.on_board` adds
    wheel.reward = wheel.terms.sum()
    _observe(wheel, sample, course, records, sight, out)


@kept
def step_wheels(state, courses, samples, observation, setting, added, span):
    """Follow the order of each wheel from `span[0]` to `span[1]` - 1, then set it to IDLE.

    STEP drives the control periods of the action in the wheel's record. RESTART draws the errors of
    the sensors and reads them; `lay_wheels` has placed the wheel before. Both write the observation
    within its bounds. Wheels with another order are left alone.

    The first four are the arrays of `WheelWorlds`; `setting` [1] is the `SETTING` of the thread,
    `added` what acts beside the base model (`Additions`).
    """
    own = setting[0]
    world = World(own.rig[0], added.acting, own.nodes[0])
    records = ThreadRecords(
        world, own.task[0], own.sensors[0], added.errors, own.camera[0], own.normals
    )
    for k in range(span[0], span[1]):
        wheel = state[k]
        if wheel.order != STEP and wheel.order != RESTART:
            continue
        course = courses[k]
        # a row for each wheel if something on board reads them, else one for the chunk
        own_samples = samples[k if own.recorded > 0 else own.chunk]
        out = observation[k]
        if wheel.order == STEP:
            _step(wheel, wheel.action, course, records, own_samples, out)
        else:
            _restart(wheel, own_samples[0], course, records, out)
        clip(out, own.bounds)
        wheel.order = IDLE  # it is done


@kept
def observe_true_soils(state, courses, setting, out):
    """Fill `out` [wheels, D] with the entries of `layout.truth` of each wheel.

    `state`, `courses`, `setting` as in `step_wheels`.
    """
    own = setting[0]
    border = own.rig[0].border
    for k in range(len(out)):
        write_truth(out[k], state[k], courses[k], border, own.camera[0])
