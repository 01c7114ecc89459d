"""Many wheels in many worlds, stepped by one compiled call: what the single and the vector environment are made of."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env._numba.compiling import FastCall, inlined, part, root, take
from soil_env._numba.lanes import COUNT
from soil_env._numba.random_streams import seed_stream
from soil_env._numba.rows import Rows
from soil_env._numba.threads import threads
from soil_env.identification.online.class_memory import (
    ClassMemory,
    MemoryNumbers,
    clear_of_borders,
    forget_classes,
    memory_numbers,
    new_memory,
    remember,
)
from soil_env.identification.online.identifier import (
    HELD,
    RENEWED,
    IdentifierNumbers,
    Identifiers,
    forget,
    identifier_numbers,
    new_identifiers,
    observe,
)
from soil_env.identification.online.immobilisation import MEMORY, WarningNumbers, begin, follow, see, warning_numbers
from soil_env.parameters import Scenario
from soil_env.simulation.camera import Sight, label_here, look, way_ahead
from soil_env.simulation.courses import (
    CourseDistribution,
    CourseNumbers,
    course_numbers,
    draw_ahead,
    draw_course,
    extend_course,
    start_course,
)
from soil_env.simulation.dynamics import MANY, advance
from soil_env.simulation.sensors import roll_odometer, sense, start_odometry
from soil_env.simulation.task import (
    REWARD_TERMS,
    VARIANTS,
    Cause,
    TaskNumbers,
    judge,
    knowledge,
    reward_terms,
    task_numbers,
    truth,
    write_observation,
    write_truth,
)
from soil_env.simulation.terrain import Courses, new_courses
from soil_env.simulation.wheel import WheelCounts, WheelState, WorldNumbers, settle, world_numbers
from soil_env.terramechanics.model import WheelSoilModel

_TRIAL_COURSES = 8
_RESTARTS = 100  # attempts at a course in the middle of a run, where there is nobody to change the scenario
_LEAST = 32  # wheels that a thread takes at a time, at least; at most MANY
#: What to do with a wheel: a step (the control periods of an action), a new course, nothing, a whole course drawn as a
#: trial (`reward` is then the mass on the wheel, or -1 if no passable course was found), the rest of its course drawn.
STEP, RESTART, IDLE, TRY, COMPLETE = np.int8(0), np.int8(1), np.int8(2), np.int8(3), np.int8(4)
_RUNNING = Cause.RUNNING.value


class Worlds(NamedTuple):
    """Everything the compiled step reads and writes; arrays have one row a wheel."""

    state: Rows  # WheelState
    counts: Rows  # WheelCounts
    courses: Courses
    streams: np.ndarray  # [wheels] uint64
    ids: Identifiers
    memory: ClassMemory
    observation: np.ndarray  # [wheels, D] float32
    terms: np.ndarray  # [wheels, 4] reward terms
    reward: np.ndarray  # [wheels]
    cause: np.ndarray  # [wheels] `task.Cause`
    changed: np.ndarray  # [wheels] True where the last step changed the estimate
    going: np.ndarray  # [wheels] int8, scratch of a step: STEP while the wheel drives
    recent: np.ndarray  # [wheels, MEMORY] last seconds of the sensors, and the view, for warnings; no rows: none wanted


def new_worlds(wheels: int, scenario: Scenario, task: TaskNumbers, warnings: bool = False) -> Worlds:
    """Worlds for `wheels` wheels, to be restarted; `warnings`: whether they keep the last seconds of the sensors."""
    return Worlds(
        WheelState(wheels),
        WheelCounts(wheels),
        new_courses(wheels, scenario),
        np.zeros(wheels, dtype=np.uint64),
        new_identifiers(wheels),
        new_memory(wheels, scenario.course.classes),
        np.zeros((wheels, task.low.size), dtype=np.float32),
        np.zeros((wheels, len(REWARD_TERMS))),
        np.zeros(wheels),
        np.zeros(wheels, dtype=np.int64),
        np.zeros(wheels, dtype=np.bool_),
        np.full(wheels, IDLE),
        np.zeros((wheels if warnings else 0, MEMORY)),
    )


class Numbers(NamedTuple):
    """The scenario as the compiled step takes it."""

    world: WorldNumbers
    drawn: CourseDistribution
    identifier: IdentifierNumbers
    memory: MemoryNumbers
    task: TaskNumbers
    warning: WarningNumbers


@inlined
def _course(numbers):
    return CourseNumbers(numbers.drawn, numbers.world.wheel)


@part
def restart(worlds, numbers, k):
    """Start a new course for wheel k, put the wheel at its start, and observe."""
    mass, attempts = -1.0, 0
    while mass < 0.0 and attempts < _RESTARTS:
        mass = start_course(k, worlds.courses, worlds.streams, _course(numbers))
        attempts += 1
    if mass < 0.0:
        raise RuntimeError("no passable course found: the soils are too weak for this wheel")
    settle(worlds.state, worlds.counts, k, mass, worlds.courses, worlds.streams, numbers.world)
    forget(worlds.ids, k, numbers.identifier)
    forget_classes(worlds.memory, k, numbers.memory)
    worlds.cause[k] = _RUNNING
    _clear(worlds, k)
    start_odometry(worlds.state, k, worlds.streams, numbers.task.sensors)
    reading = sense(worlds.state, k, worlds.streams, numbers.task.sensors)
    if worlds.recent.shape[0] > 0:
        begin(worlds.recent, k, reading, numbers.warning)
    sight = _look(worlds, numbers, k)
    _foresee(worlds, numbers, k, sight)
    _observation(worlds, numbers, k, reading, sight)


@inlined
def _clear(worlds, k):
    """What a step sums up, at its start."""
    worlds.reward[k] = 0.0
    for i in range(worlds.terms.shape[1]):
        worlds.terms[k, i] = 0.0
    worlds.changed[k] = False


@inlined
def _look(worlds, numbers, k):
    """`Sight` of the camera, if there is one."""
    if numbers.task.camera.classes == 0:
        return Sight(0, 0.0, 0.0)
    return look(worlds.state, worlds.counts, k, worlds.courses, worlds.streams, numbers.task.camera)


@part
def _observation(worlds, numbers, k, reading, sight):
    write_observation(
        worlds.observation[k], worlds.state, worlds.counts, k, reading, worlds.courses, worlds.ids, worlds.memory,
        sight, numbers.task,
    )  # fmt: skip


@inlined
def _learn_class(worlds, numbers, k, renewed, sight):
    """What the camera and the identifier say together of the terrain class under wheel k."""
    if renewed and clear_of_borders(sight.since, sight.left, numbers.memory):
        here = label_here(worlds.courses, k, sight)
        remember(worlds.memory, k, here, sight.patch, worlds.ids, numbers.memory)


@inlined
def _foresee(worlds, numbers, k, sight):
    """Note what the camera shows of the way ahead, for the warning of immobilisation, where it is wanted."""
    if worlds.recent.shape[0] > 0 and numbers.task.camera.classes > 0:
        view = way_ahead(worlds.state, k, worlds.courses, worlds.memory, sight, numbers.task.camera)
        see(worlds.recent, k, view, numbers.warning)


@inlined
def _sum(terms):
    total = terms[0]
    for i in range(1, terms.size):
        total += terms[i]
    return total


@inlined
def after_period(worlds, numbers, k, first, last):
    """After a control period of wheel k: draw the course ahead, sense, identify, judge, reward, observe.

    `first`, `last`: whether it is the first and the last one of the action, if the episode does not end in it.
    """
    draw_ahead(k, worlds.courses, worlds.state.x[k], worlds.state.mass[k], _course(numbers))
    reading = sense(worlds.state, k, worlds.streams, numbers.task.sensors)
    roll_odometer(worlds.state, k, reading.speed, numbers.task.sensors)
    if worlds.recent.shape[0] > 0:
        follow(worlds.recent, k, reading, worlds.state.halt_left[k] > 0.0, numbers.warning)
    paid, prior = numbers.task.reward_information > 0.0, numbers.identifier.precision
    before = knowledge(worlds.ids, k, prior) if paid and first else 0.0
    outcome = observe(worlds.ids, k, reading, numbers.identifier)
    worlds.changed[k] = worlds.changed[k] or outcome != HELD
    sight = _look(worlds, numbers, k)
    if numbers.task.camera.classes > 0:
        _learn_class(worlds, numbers, k, outcome == RENEWED, sight)
        _foresee(worlds, numbers, k, sight)
    cause = judge(worlds.state, worlds.counts, k, numbers.task)
    worlds.cause[k] = cause
    terms = worlds.terms[k]
    after = knowledge(worlds.ids, k, prior) if paid and last else 0.0
    reward_terms(worlds.state, k, cause, before, after, numbers.task, terms)
    if last or cause != _RUNNING:
        worlds.reward[k] = _sum(terms)
        _observation(worlds, numbers, k, reading, sight)


@inlined
def _step(worlds, numbers, commands, start, count, steps):
    """A step of the `steps` wheels start ... start + count - 1 that are `going`: as many control periods as an action
    lasts, until the episode ends."""
    repeat = numbers.task.repeat
    for period in range(repeat):
        if steps == 0:
            return
        advance(
            worlds.state, worlds.counts, start, count, worlds.going, commands, worlds.courses, worlds.streams,
            numbers.world,
        )  # fmt: skip
        for k in range(start, start + count):
            if worlds.going[k] == STEP:
                after_period(worlds, numbers, k, period == 0, period == repeat - 1)
                if worlds.cause[k] != _RUNNING:
                    worlds.going[k] = IDLE
                    steps -= 1


@inlined
def _portion(counter, wheels):
    """Wheels to take next: many at first, and fewer towards the end, so that the threads end together."""
    share = (wheels - counter[0]) // (2 * counter[1]) // COUNT * COUNT
    return MANY if counter[1] == 1 else min(max(share, _LEAST), MANY)


@root(nogil=True)
def step_chunks(worlds, numbers, commands, what, counter):
    """What `what` [wheels] says, chunk by chunk; `counter`: [next wheel, threads at work].

    This is the one function that environments call, so that it is all that has to be compiled for them.
    """
    wheels = what.size
    portion = _portion(counter, wheels)
    start = take(counter, portion)
    while start < wheels:
        count, steps = min(portion, wheels - start), 0
        for k in range(start, start + count):
            worlds.going[k] = STEP if what[k] == STEP else IDLE
            if what[k] == STEP:
                _clear(worlds, k)
                steps += 1
            elif what[k] == RESTART:
                restart(worlds, numbers, k)
            elif what[k] == TRY:
                worlds.reward[k] = draw_course(k, worlds.courses, worlds.streams, _course(numbers))
            elif what[k] == COMPLETE:
                extend_course(k, worlds.courses, worlds.state.mass[k], np.inf, _course(numbers))
        _step(worlds, numbers, commands, start, count, steps)
        portion = _portion(counter, wheels)
        start = take(counter, portion)


@root(nogil=True)
def true_soils(worlds, numbers, out):
    """Fill `out` [wheels, D] with the entries of `task.truth`; `numbers` are those of the variant `true_soil`."""
    for k in range(len(out)):
        write_truth(out[k], worlds.state, worlds.counts, k, worlds.courses, worlds.memory, numbers.task)


def processors() -> int:
    """Processors that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Simulation:
    """`wheels` wheels under one scenario with one observation variant.

    Arrays in `worlds` are overwritten by each step. All randomness of wheel k follows from the seed given to `seed`.
    `warnings`: whether `worlds.recent` follows the sensors, for `identification.immobilisation`.
    """

    def __init__(
        self,
        wheels: int,
        scenario: Scenario,
        variant: str,
        threads: int | None = None,
        model: WheelSoilModel | None = None,
        warnings: bool = False,
    ) -> None:
        self.scenario: Scenario = scenario
        self._threads = threads or processors()
        self._run = FastCall(step_chunks)
        self._commands, self._what = np.zeros(wheels), np.full(wheels, IDLE)
        self._counter = np.ones(2, dtype=np.int64)
        task = task_numbers(scenario, variant, model)
        self.numbers: Numbers = Numbers(
            world_numbers(scenario, model),
            course_numbers(scenario, model).drawn,
            identifier_numbers(scenario),
            memory_numbers(scenario),
            task,
            warning_numbers(scenario),
        )
        self.worlds: Worlds = new_worlds(wheels, scenario, task, warnings)
        self._check_passable(task)

    def _check_passable(self, task: TaskNumbers) -> None:
        """Refuse a scenario whose soils this wheel cannot pass, before it shows in the middle of a training."""
        trial, what, counter = new_worlds(1, self.scenario, task), np.array([TRY]), np.ones(2, dtype=np.int64)
        trial.streams[0] = 1
        for _ in range(_TRIAL_COURSES):
            counter[:] = 0, 1
            self._run(trial, self.numbers, np.zeros(1), what, counter)
            if trial.reward[0] < 0.0:
                raise ParameterError(
                    f"scenario {self.scenario.name!r}: no passable course found for this wheel on these soils; "
                    "expected firmer soils, more stall torque, a lower course.margin or a lower course.grade_deg"
                )

    def wheel(self, k: int) -> dict[str, float]:
        """State and counts of wheel k by name, as they are now."""
        return self.worlds.state[k] | self.worlds.counts[k]

    def seed(self, k: int, rng: np.random.Generator) -> None:
        """Start the random stream of wheel k from a Generator."""
        self.worlds.streams[k] = seed_stream(rng)

    def true_soils(self) -> np.ndarray:
        """What `true_soil` observes of each wheel beside what `blind` does [wheels, D] float32."""
        entries = truth(self.scenario.course)
        out = np.empty((self.worlds.reward.size, len(entries)), dtype=np.float32)
        variant = VARIANTS.index("true_soil")
        true_soils(self.worlds, self.numbers._replace(task=self.numbers.task._replace(variant=variant)), out)
        return np.clip(out, [e.low for e in entries], [e.high for e in entries], dtype=np.float32)

    def restart(self, k: int) -> None:
        """New course and fresh start for wheel k."""
        self._do(k, RESTART)

    def complete(self, k: int) -> None:
        """Draw what is left of the course of wheel k; it goes on as it would have."""
        self._do(k, COMPLETE)

    def step(self, k: int, command: float) -> None:
        """One step of wheel k: the control periods of an action."""
        self._commands[k] = command
        self._do(k, STEP)

    def _do(self, k: int, what: np.int8) -> None:
        self._what[k] = what
        self._counter[:] = 0, 1
        try:
            self._run(self.worlds, self.numbers, self._commands, self._what, self._counter)
        finally:
            self._what[k] = IDLE

    def step_all(self, commands: np.ndarray, what: np.ndarray) -> None:
        """One step with `commands` [wheels] float64; `what` [wheels] int8: STEP, RESTART or IDLE."""
        commands, what = np.ascontiguousarray(commands, np.float64), np.ascontiguousarray(what, np.int8)
        self._in_parallel(commands, what)

    def restart_where(self, which: np.ndarray) -> None:
        """Restart the wheels with `which` True."""
        if np.any(which):
            self._in_parallel(np.zeros(len(which)), np.where(which, RESTART, IDLE))

    def _in_parallel(self, commands: np.ndarray, what: np.ndarray) -> None:
        """`step_chunks` over all wheels in several threads (it holds no lock, and they share no row)."""
        at_work = min(self._threads, -(-self.worlds.reward.size // _LEAST))
        self._counter[:] = 0, at_work
        arguments = (self.worlds, self.numbers, commands, what, self._counter)
        if at_work == 1:
            self._run(*arguments)
        else:
            threads(self._threads).run(self._run, arguments, at_work - 1)
