"""Compiled functions of many rovers: `lay_rovers` draws courses and places rovers at rest,
`step_rovers` drives.

Nothing is identified here.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numba import literal_unroll

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import HUGE, compiled, compiled_finite, inlined, record
from soil_env._compiled.random_streams import NORMALS, between, word
from soil_env.parameters import MOST_AXLES, RoverScenario
from soil_env.parameters.readings import COMPLETE, IDLE, RESTART, STEP, TRY
from soil_env.simulation.task.layout import bounds_of
from soil_env.simulation.task.observation import TRUE_SOIL, clip
from soil_env.simulation.task.rules import RUNNING, begin_step, judge_period, task_of
from soil_env.simulation.wheels import SAMPLE, start_drivable
from soil_env.simulation.world.courses import course_numbers, extend_course, start_course
from soil_env.simulation.world.passability import CourseDistribution
from soil_env.simulation.world.sensors import (
    SensorErrors,
    mount_sensors,
    read_slip,
    roll_odometer,
    sense,
    sense_body,
    sensor_errors,
    sensors_of,
)
from soil_env.simulation.world.terrain import CELL, RUT, grade_on, new_courses, piece_at
from soil_env.simulation.world.wheel import World, acting_in, rig_of, settle_at
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.reaction import Acting

from .body import ROVER, set_pitch, suspension_of
from .dynamics import control_period
from .newton import STAGE, RoverWorld
from .ruts import clear_ruts
from .task import (
    BODY,
    ENTRIES_OF_AXLE,
    ENTRIES_OF_BODY,
    rover_layout,
    write_axle,
    write_body,
    write_true_soils,
)

# [-] factor on the bogged sinkage where a soil is judged for a single wheel: the deepest wheel of a
# rover carries more than the mean and runs in a rut; own choice
DEEPEST_ALONE = 0.5


#: Readings of the sensors of a rover's body in a control period.
OF_BODY = record(*BODY)


class RoverScratch(NamedTuple):
    """Work arrays of a thread."""

    stage: np.ndarray  # [1] `STAGE`
    normals: np.ndarray  # [`NORMALS`]
    readings: np.ndarray  # [axles, 1] `SAMPLE`
    body: np.ndarray  # [1] `OF_BODY`


def new_rover_scratch() -> RoverScratch:
    """Work arrays of one thread."""
    return RoverScratch(
        np.zeros(1, STAGE),
        np.zeros(NORMALS),
        np.zeros((MOST_AXLES, 1), SAMPLE),
        np.zeros(1, OF_BODY),
    )


class RoverWorlds(NamedTuple):
    """Arrays that the compiled step reads and writes, one row a rover; axles from the front on.

    Where nothing is recorded, `readings` has no rows.
    """

    state: np.ndarray  # [rovers] `ROVER`
    ruts: np.ndarray  # [rovers, axles, cells] `RUT`
    courses: np.ndarray  # [rovers] `course_dtype`; what is left in its cells is in `ruts`
    readings: np.ndarray  # [rovers, axles, periods] `SAMPLE` of the last step
    observation: np.ndarray  # [rovers, D] float32


class RoverNumbers(NamedTuple):
    """Constants of a scenario that the compiled step needs."""

    rig: np.ndarray  # [1] `RIG`
    acting: Acting
    suspension: np.ndarray  # [1] `SUSPENSION`
    task: np.ndarray  # [1] `TASK`
    bounds: np.ndarray  # [2, D] float32 of the observation
    sensors: np.ndarray  # [1] `SENSOR_NOISE`
    errors: SensorErrors


def rover_numbers(
    scenario: RoverScenario, variant: str, model: WheelSoilModel | None = None
) -> RoverNumbers:
    """Pack a scenario with an observation `variant`; `model` gives the effects that act in this
    world, on the wheels and on their sensors.
    """
    rig = rig_of(scenario, model)
    return RoverNumbers(
        rig,
        acting_in(model, rig[0].shear_ratio),
        suspension_of(scenario),
        task_of(scenario, variant),
        bounds_of(rover_layout(variant, scenario.axles)),
        sensors_of(scenario),
        sensor_errors(model),
    )


class RoverCourseNumbers(NamedTuple):
    """`CourseNumbers`, and the rover that has to pass the courses."""

    drawn: CourseDistribution
    rig: Any  # `RIG`
    acting: Acting
    suspension: Any  # `SUSPENSION`


def rover_course_numbers(
    scenario: RoverScenario, model: WheelSoilModel | None = None
) -> RoverCourseNumbers:
    """Pack the numbers of `lay_rovers`; `model` gives the effects that are on in this world.

    Courses are longer than the scenario's by the wheelbase (`_with_front`). A soil is judged by a
    single wheel, which counts as bogged at `DEEPEST_ALONE` of the limit.
    """
    numbers = course_numbers(_with_front(scenario), model)
    numbers.drawn.spec.bogged_sinkage *= DEEPEST_ALONE
    return RoverCourseNumbers(*numbers, suspension_of(scenario)[0])


def new_rover_worlds(
    rovers: int, scenario: RoverScenario, numbers: RoverNumbers, recorded: bool
) -> RoverWorlds:
    """Blank worlds of this number of `rovers`, which have to be restarted before they drive.

    `recorded`: keep the readings of each step for estimators.
    """
    axles = scenario.axles
    periods = scenario.control.action_periods
    courses = new_courses(rovers, _with_front(scenario))
    kept_rovers = rovers if recorded else 0
    return RoverWorlds(
        np.zeros(rovers, ROVER),
        np.zeros((rovers, axles, courses["cells"].shape[1]), RUT),
        courses,
        np.zeros((kept_rovers, axles, periods), SAMPLE),
        np.zeros((rovers, numbers.bounds.shape[1]), dtype=np.float32),
    )


def _with_front(scenario: RoverScenario) -> RoverScenario:
    """The scenario with courses as long as the front axle goes when the rear one is at the end."""
    course = scenario.course
    longer = replace(course, length=course.length + scenario.vehicle.base)
    return replace(scenario, course=longer)


@compiled
def _height_at(course, x, border):
    """Height [m] of the ground at x >= 0 [m] above that at 0, by the midpoint rule in steps of at
    most `CELL`; x is the way along the slope, `border` [m] as in `grade_on`.
    """
    steps = math.ceil(x / CELL)
    height = 0.0
    for k in range(steps):
        middle = (k + 0.5) / steps * x
        slope = piece_at(course.slopes, middle, 0)
        height += x / steps * math.sin(grade_on(course.slopes, middle, slope, border))
    return height


@compiled
def _settle(rover, mass, course, ruts, numbers, nodes):
    """Put a rover, whose record is blank but for its stream, at rest at the start of its course.

    `mass` [kg] is the mean on its wheels. The record holds the mass of one side of the vehicle. The
    rear axle stands at 0 of the course, the others ahead of it. Each wheel gets a random stream of
    its own, stands on fresh ground (`settle_at`) and its ruts are cleared. The place of the first
    halt is drawn. `numbers`: `RoverCourseNumbers`; `ruts` [axles, cells]; `nodes` is scratch.
    """
    rig = numbers.rig
    s = numbers.suspension
    world = World(rig, numbers.acting, nodes)
    rover.mass = mass * s.axles
    for a in range(s.axles):
        wheel = rover.wheels[a]
        wheel.stream = word(rover)
        ahead = s.wheelbase - s.places[a]
        settle_at(wheel, ahead, rover.mass * s.shares[a], course, world)
        rover.sinkage = max(rover.sinkage, wheel.sinkage)
        rover.axles[a].height = _height_at(course, ahead, rig.border)
        clear_ruts(ruts[a])
    rover.next_halt = between(rover, rig.halt_low, rig.halt_high)
    rover.converged = 1


@kept
def lay_rovers(worlds, numbers, orders, scratch, first, end):
    """Follow the `orders` [rovers] (`parameters.readings`) for the courses `first` to `end` - 1.

    Return the number of restarts for which no soil was found.

    RESTART starts a new course and puts the rover at rest at its start; the caller has made its
    record blank but for its stream. Where no soil is found, the record stays blank. TRY draws the
    start of a course; the rover's `reward` is then the mean mass on a wheel [kg], or -1 if no soil
    was found. AHEAD draws the ground that the next step needs, COMPLETE the rest; STEP and IDLE do
    nothing. `worlds`: `RoverWorlds`, `numbers`: `RoverCourseNumbers`, `scratch`: `RoverScratch`.
    """
    nodes = scratch.stage[0].nodes[0]
    s = numbers.suspension
    ahead = s.wheelbase + numbers.drawn.spec.ahead  # [m] ahead of the rear axle
    failed = 0
    for j in range(first, end):
        order = orders[j]
        if order == STEP or order == IDLE:
            continue
        rover = worlds.state[j]
        course = worlds.courses[j]
        if order == RESTART:
            mass = start_drivable(course, rover, numbers, nodes)
            if mass < 0.0:
                failed += 1
            else:
                extend_course(course, mass, ahead, numbers, nodes)
                _settle(rover, mass, course, worlds.ruts[j], numbers, nodes)
        elif order == TRY:
            rover.reward = start_course(course, rover, numbers, nodes)
        else:
            x = HUGE if order == COMPLETE else rover.x + ahead
            extend_course(course, rover.mass / s.axles, x, numbers, nodes)
    return failed


class ThreadRecords(NamedTuple):
    """Constants and scratch of a thread as records, see `simulation.wheels.ThreadRecords`."""

    world: RoverWorld
    task: Any  # `TASK`
    sensors: Any  # `SENSOR_NOISE`
    errors: SensorErrors
    normals: np.ndarray  # [`NORMALS`]
    body: Any  # `OF_BODY`


@compiled_finite
def _sense(rover, readings, period, records):
    """Read the sensors of a rover at the end of a control period.

    Fill the readings in the column `period` of `readings` [axles, periods], `SAMPLE`, whose
    `halted` and image stay 0. The readings of the body take the place of those of each wheel,
    before the slip follows from the speeds. `records`: `ThreadRecords`, here and below.
    """
    task = records.task
    body = records.body
    sense_body(rover, body, records.sensors)
    for a in range(records.world.suspension.axles):
        wheel = rover.wheels[a]
        reading = readings[a, period]
        sense(wheel, reading, records.normals, records.sensors, records.errors, task.radius)
        for name in literal_unroll(BODY):
            reading[name] = body[name]
        read_slip(wheel, reading, records.sensors, records.errors)


@compiled_finite
def _restart(rover, readings, records):
    """Begin the episode of a rover that rests at the start of its course: set the pitch of its
    body, draw the errors of its sensors, and read them into column 0.
    """
    set_pitch(rover, records.world.suspension)
    for a in range(records.world.suspension.axles):
        mount_sensors(rover.wheels[a], records.normals, records.sensors)
    rover.cause = RUNNING
    rover.periods = 1  # samples to read, as after a step of one period
    _sense(rover, readings, 0, records)


@compiled_finite
def _step(rover, commands, course, ruts, readings, records):
    """Take a rover through the control periods of `commands` [axles] in [-1, 1], at most to the end
    of its episode: drive, sense, judge, reward.

    `readings` [axles, periods]: of all periods, or one column of the last.
    """
    task = records.task
    begin_step(rover)
    while rover.periods < task.action_periods and rover.cause == RUNNING:
        control_period(rover, commands, course, ruts, records.world)
        period = min(rover.periods, readings.shape[1] - 1)
        _sense(rover, readings, period, records)
        roll_odometer(rover, readings[0, period].speed, task.period)
        judge_period(rover, task)
    # without the term of information, which `identification.online.on_board` adds
    rover.reward = rover.terms.sum()


@inlined
def _observe(rover, readings, course, records, out):
    """Fill the observation `out` [D] of a rover from the last of its `readings` [axles, periods],
    but for the entries that are identified; with `true_soil` also the soils under its axles.
    """
    task = records.task
    axles = records.world.suspension.axles
    last = min(rover.periods, readings.shape[1]) - 1
    write_body(out, rover, readings[0, last], task)
    for a in range(axles):
        write_axle(out, a, rover.wheels[a], readings[a, last], task)
    if task.variant == TRUE_SOIL:
        soils = out[ENTRIES_OF_BODY + axles * ENTRIES_OF_AXLE :]
        write_true_soils(soils, rover, axles, course, records.world.rig.border)


@kept
def step_rovers(worlds, numbers, actions, orders, scratch, first, end):
    """Follow the `orders` [rovers] STEP and RESTART for the rovers `first` to `end` - 1; `actions`
    [rovers, axles] in [-1, 1].

    STEP drives the control periods of the actions, RESTART draws the errors of the sensors and
    reads them. Both write the observation within its bounds. Rovers with another order are left
    alone. `lay_rovers` has drawn their courses before. `worlds`: `RoverWorlds`, `numbers`:
    `RoverNumbers`, `scratch`: `RoverScratch`.
    """
    world = RoverWorld(numbers.rig[0], numbers.acting, numbers.suspension[0], scratch.stage[0])
    records = ThreadRecords(
        world,
        numbers.task[0],
        numbers.sensors[0],
        numbers.errors,
        scratch.normals,
        scratch.body[0],
    )
    recorded = worlds.readings.shape[0] > 0
    for j in range(first, end):
        order = orders[j]
        if order != STEP and order != RESTART:
            continue
        rover = worlds.state[j]
        course = worlds.courses[j]
        readings = worlds.readings[j] if recorded else scratch.readings
        if order == STEP:
            _step(rover, actions[j], course, worlds.ruts[j], readings, records)
        else:
            _restart(rover, readings, records)
        out = worlds.observation[j]
        _observe(rover, readings, course, records, out)
        clip(out, numbers.bounds)


@kept
def observe_true_soils(worlds, numbers, out):
    """Fill `out` [rovers, axles x 7] with the true soils under the axles (`write_true_soils`)."""
    border = numbers.rig[0].border
    axles = numbers.suspension[0].axles
    for j in range(len(out)):
        write_true_soils(out[j], worlds.state[j], axles, worlds.courses[j], border)
