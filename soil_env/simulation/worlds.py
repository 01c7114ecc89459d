"""Many wheels in many worlds, stepped by one compiled call: what the single and the vector environment are made of."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np
from numba import njit

from soil_env._io.loading import ParameterError
from soil_env._numba.compiling import CACHE, Entry, inlined, kernel, pasted, take
from soil_env._numba.lanes import COUNT, scratch
from soil_env._numba.random_streams import seed_stream
from soil_env._numba.threads import crew
from soil_env.identification.online import (
    IdentifierNumbers,
    Identifiers,
    forget,
    identifier_numbers,
    new_identifiers,
    observe,
)
from soil_env.parameters import Scenario
from soil_env.simulation.courses import (
    CourseNumbers,
    course_numbers,
    draw_ahead,
    draw_course,
    extend_course,
    start_course,
)
from soil_env.simulation.dynamics import WHEEL_STATE, WorldNumbers, advance, settle, world_numbers
from soil_env.simulation.lockstep import MANY, advance_many
from soil_env.simulation.task import (
    REWARD_TERMS,
    Cause,
    TaskNumbers,
    judge,
    knowledge,
    reward_terms,
    sense,
    task_numbers,
    write_observation,
)
from soil_env.simulation.terrain import Courses, new_courses
from soil_env.terramechanics.model import WheelSoilModel

_many = scratch(MANY)
_TRIAL_COURSES = 8
_RESTARTS = 100  # attempts at a course in the middle of a run, where there is nobody to change the scenario
_LEAST = 32  # wheels that a thread takes at a time, at least; in a step up to MANY
STEP, RESTART, IDLE = np.int8(0), np.int8(1), np.int8(2)
_TIME_LIMIT, _RUNNING = Cause.TIME_LIMIT.value, Cause.RUNNING.value


class Worlds(NamedTuple):
    """Everything the compiled step reads and writes; arrays have one row a wheel."""

    state: np.ndarray  # [wheels] WHEEL_STATE
    courses: Courses
    streams: np.ndarray  # [wheels] uint64
    ids: Identifiers
    observation: np.ndarray  # [wheels, D] float32
    terms: np.ndarray  # [wheels, 4] reward terms
    reward: np.ndarray  # [wheels]
    cause: np.ndarray  # [wheels] `task.Cause`
    solved: np.ndarray  # [wheels] True where the last step renewed the estimate


class Numbers(NamedTuple):
    """The scenario as the compiled step takes it."""

    world: WorldNumbers
    course: CourseNumbers
    identifier: IdentifierNumbers
    task: TaskNumbers


@kernel
def restart(worlds, numbers, k):
    """Start a new course for wheel k, put the wheel at its start, and observe."""
    mass, attempts = -1.0, 0
    while mass < 0.0 and attempts < _RESTARTS:
        mass = start_course(k, worlds.courses, worlds.streams, numbers.course)
        attempts += 1
    if mass < 0.0:
        raise RuntimeError("no passable course found: the soils are too weak for this wheel")
    settle(worlds.state, k, mass, worlds.courses, worlds.streams, numbers.world)
    forget(worlds.ids, k, numbers.identifier)
    worlds.cause[k] = _RUNNING
    worlds.reward[k] = 0.0
    for i in range(worlds.terms.shape[1]):
        worlds.terms[k, i] = 0.0
    worlds.solved[k] = False
    reading, pitch = sense(worlds.state, k, worlds.streams, numbers.task)
    write_observation(
        worlds.observation[k], worlds.state, k, reading, pitch, worlds.courses, worlds.ids, numbers.task
    )  # fmt: skip


@pasted
def report(worlds, numbers, k):
    """What follows on the drive of wheel k in a control period: sense, identify, judge, reward, observe."""
    draw_ahead(k, worlds.courses, worlds.state[k].x, worlds.state[k].mass, numbers.course)
    reading, pitch = sense(worlds.state, k, worlds.streams, numbers.task)
    paid, prior = numbers.task.reward_information > 0.0, numbers.identifier.precision
    before = knowledge(worlds.ids, k, prior) if paid else 0.0
    worlds.solved[k] = observe(worlds.ids, k, reading, numbers.identifier)
    cause = judge(worlds.state, k, numbers.task)
    worlds.cause[k] = cause
    terms = worlds.terms[k]
    after = knowledge(worlds.ids, k, prior) if paid else 0.0
    reward_terms(worlds.state, k, cause, before, after, numbers.task, terms)
    worlds.reward[k] = terms[0] + terms[1] + terms[2] + terms[3]
    write_observation(
        worlds.observation[k], worlds.state, k, reading, pitch, worlds.courses, worlds.ids, numbers.task
    )  # fmt: skip


@inlined
def _portion(counter, wheels):
    """Wheels to take next: many at first, and fewer towards the end, so that the threads end together."""
    share = (wheels - counter[0]) // (2 * counter[1]) // COUNT * COUNT
    return MANY if counter[1] == 1 else min(max(share, _LEAST), MANY)


@njit(cache=CACHE, error_model="numpy", _nrt=False, nogil=True)
def step_chunks(worlds, numbers, commands, what, counter):
    """A control period of wheels (what[k] = STEP), `restart` (RESTART) or nothing (IDLE), by chunks.

    `counter`: [next wheel, threads at work].
    """
    which, given = _many(), _many()
    wheels = what.size
    portion = _portion(counter, wheels)
    start = take(counter, portion)
    while start < wheels:
        stop, count = min(start + portion, wheels), 0
        for k in range(start, stop):
            if what[k] == STEP:
                which[count], given[count] = k, commands[k]
                count += 1
            elif what[k] == RESTART:
                restart(worlds, numbers, k)
            if count > 0 and k == stop - 1:
                advance_many(
                    worlds.state, which, count, given, worlds.courses, worlds.streams, numbers.world
                )  # fmt: skip
                for i in range(count):
                    report(worlds, numbers, int(which[i]))
                count = 0
        portion = _portion(counter, wheels)
        start = take(counter, portion)


@njit(cache=CACHE, error_model="numpy", _nrt=False, nogil=True)
def step_chunks_with_effects(worlds, numbers, commands, what, counter):
    """`step_chunks` of worlds with effects, one wheel after the other."""
    wheels = what.size
    start = take(counter, _LEAST)
    while start < wheels:
        for k in range(start, min(start + _LEAST, wheels)):
            if what[k] == STEP:
                advance(worlds.state, k, commands[k], worlds.courses, worlds.streams, numbers.world)
                report(worlds, numbers, k)
            elif what[k] == RESTART:
                restart(worlds, numbers, k)
        start = take(counter, _LEAST)


@njit(cache=CACHE, error_model="numpy", _nrt=False, nogil=True)
def restart_chunks(worlds, numbers, which, counter):
    """`restart` the wheels with `which` True, by chunks; `counter` as in `step_chunks`."""
    wheels = which.size
    start = take(counter, _LEAST)
    while start < wheels:
        for k in range(start, min(start + _LEAST, wheels)):
            if which[k]:
                restart(worlds, numbers, k)
        start = take(counter, _LEAST)


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Simulation:
    """`wheels` wheels under one scenario with one observation variant.

    Arrays in `worlds` are overwritten by each step. All randomness of wheel k follows from the seed given to `seed`.
    """

    def __init__(
        self,
        wheels: int,
        scenario: Scenario,
        variant: str,
        max_episode_steps: int | None = None,
        threads: int | None = None,
        model: WheelSoilModel | None = None,
    ):
        self.scenario = scenario
        self._threads = threads or _processors()
        self._restart = Entry(restart)
        self._restart_chunks = Entry(restart_chunks)
        self._commands, self._what = np.zeros(wheels), np.full(wheels, IDLE)
        self._counter = np.ones(2, dtype=np.int64)
        task = task_numbers(scenario, variant, model)
        if max_episode_steps is not None:
            task = task._replace(steps=min(task.steps, int(max_episode_steps)))
        self.numbers = Numbers(
            world_numbers(scenario, model), course_numbers(scenario, model), identifier_numbers(scenario), task
        )
        effects = self.numbers.world.with_effects
        self._step_chunks = Entry(step_chunks_with_effects if effects else step_chunks)
        self.worlds = Worlds(
            np.zeros(wheels, dtype=WHEEL_STATE),
            new_courses(wheels, scenario),
            np.zeros(wheels, dtype=np.uint64),
            new_identifiers(wheels),
            np.zeros((wheels, task.low.size), dtype=np.float32),
            np.zeros((wheels, len(REWARD_TERMS))),
            np.zeros(wheels),
            np.zeros(wheels, dtype=np.int64),
            np.zeros(wheels, dtype=np.bool_),
        )

        self._check_passable()

    def _check_passable(self) -> None:
        """Refuse a scenario whose soils this wheel cannot pass, before it shows in the middle of a training."""
        courses, streams = new_courses(1, self.scenario), np.array([1], dtype=np.uint64)
        for _ in range(_TRIAL_COURSES):
            if draw_course(0, courses, streams, self.numbers.course) < 0.0:
                raise ParameterError(
                    f"scenario {self.scenario.name!r}: no passable course found for this wheel on these soils; "
                    "expected firmer soils, more stall torque, a lower course.margin or a lower course.grade_deg"
                )

    def seed(self, k: int, rng: np.random.Generator) -> None:
        """Start the random stream of wheel k from a Generator."""
        self.worlds.streams[k] = seed_stream(rng)

    def restart(self, k: int) -> None:
        """New course and fresh start for wheel k."""
        self._restart(self.worlds, self.numbers, int(k))

    def complete(self, k: int) -> None:
        """Draw what is left of the course of wheel k; it goes on as it would have."""
        extend_course(int(k), self.worlds.courses, float(self.worlds.state["mass"][k]), np.inf, self.numbers.course)

    def step(self, k: int, command: float) -> None:
        """One control period of wheel k."""
        self._commands[k], self._what[k] = command, STEP
        self._counter[:] = 0, 1
        self._step_chunks(self.worlds, self.numbers, self._commands, self._what, self._counter)
        self._what[k] = IDLE

    def step_all(self, commands: np.ndarray, what: np.ndarray) -> None:
        """One control period with `commands` [wheels] float64; `what` [wheels] int8: STEP, RESTART or IDLE."""
        commands, what = np.ascontiguousarray(commands, np.float64), np.ascontiguousarray(what, np.int8)
        self._in_parallel(self._step_chunks, commands, what)

    def restart_where(self, which: np.ndarray) -> None:
        """Restart the wheels with `which` True."""
        which = np.ascontiguousarray(which, np.bool_)
        if which.any():
            self._in_parallel(self._restart_chunks, which)

    def _in_parallel(self, kernel, *arrays) -> None:
        """Run a kernel over all wheels in several threads (it holds no lock, and they share no row)."""
        threads = min(self._threads, -(-self.worlds.reward.size // _LEAST))
        self._counter[:] = 0, threads
        arguments = (self.worlds, self.numbers, *arrays, self._counter)
        if threads == 1:
            kernel(*arguments)
        else:
            crew(self._threads).run(kernel, arguments, threads - 1)
