"""Simulation of many vehicles side by side: the world and, where something asks for it, the estimator on board."""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env._numba.compiling import FastCall, compile_aside
from soil_env._numba.lanes import COUNT
from soil_env._numba.random_streams import seed_stream
from soil_env.parameters import Scenario
from soil_env.parameters.readings import Results
from soil_env.simulation.wheels import AHEAD, COMPLETE, IDLE, RESTART, STEP, TRY

_TRIAL_COURSES = 8
_SHARES = 4  # of the vehicles, for each thread: those that are done early take another


def processors() -> int:
    """Processors that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _pool(threads: int, process: int) -> ThreadPoolExecutor:
    """Threads of a process; those of another do not survive its fork."""
    return ThreadPoolExecutor(threads, "soil_env")


def asks_for_estimates(scenario: Scenario, variant: str) -> bool:
    """True if the observation or the reward of a scenario asks for an estimate of the soil."""
    return variant == "identified" or scenario.reward.information > 0.0


class Vehicles:
    """Base of the simulations of many wheels and of many rovers.

    A subclass makes the arrays and numbers of the compiled functions and gives them to `_begin`. All randomness of
    vehicle k follows from the seed given to `seed`.
    """

    numbers: Any
    belief: Any  # numbers of the estimator on board; None where nothing is identified
    worlds: Any  # all arrays, overwritten by each step
    _vehicle = "wheel"
    _ahead: float  # [m] final ground that a vehicle needs before it

    def __init__(self, count: int, scenario: Any, threads: int | None, least: int) -> None:
        self.scenario = scenario
        self.count: int = count
        self._threads = threads or processors()
        self._least = (
            least  # vehicles that a thread takes at a time, at least; a multiple of `COUNT`
        )
        self._what = np.full(count, IDLE)

    def _begin(self, lay, step, world, trial, commands: int, on_board: Any) -> None:
        """Take the compiled functions with their arrays, and try the scenario on a `trial` world of one vehicle.

        `on_board`: `identification.online.board.OnBoard`, or None where nothing is identified. Functions that are not
        in the cache yet are compiled side by side.
        """
        self._world = world
        self._commands = np.zeros(commands)
        self._lay = FastCall(lay)
        self._step = FastCall(step)
        self._on_board = on_board
        self.belief = None if on_board is None else on_board.numbers
        self._results = Results(world.observation, world.terms, world.reward, world.cause)
        if on_board is not None:
            on_board.prepare(world.record, self._results, self._what)
        compile_aside(step, self._motion(self._what, 0, self.count))
        self._check_passable(trial)

    def _check_passable(self, trial: Any) -> None:
        """Refuse a scenario whose soils this vehicle cannot pass, before it shows in the middle of a training."""
        trial.streams[0] = 1
        for _ in range(_TRIAL_COURSES):
            self._lay(trial, self.numbers, np.array([TRY]), 0, 1)
            if trial.reward[0] < 0.0:
                raise ParameterError(
                    f"scenario {self.scenario.name!r}: no passable course found for this {self._vehicle} on these "
                    "soils; expected firmer soils, more stall torque, a lower course.margin or a lower course.grade_deg"
                )

    def seed(self, k: int, rng: np.random.Generator) -> None:
        """Start the random stream of vehicle k from a Generator."""
        self.worlds.streams[k] = seed_stream(rng)

    def restart(self, k: int) -> None:
        """New course and fresh start for vehicle k."""
        self._lay_one(k, RESTART)
        self._do(k, RESTART)

    def complete(self, k: int) -> None:
        """Draw the rest of the course of vehicle k; it goes on as it would have."""
        self._lay_one(k, COMPLETE)

    def step(self, k: int, command: Any) -> None:
        """One step of vehicle k: the control periods of an action."""
        self._commands[self._rows_of(k)] = command
        if self._world.courses.ready.item(k) < self._x().item(k) + self._ahead:
            self._lay_one(k, AHEAD)
        self._do(k, STEP)

    def step_all(self, commands: np.ndarray, what: np.ndarray) -> None:
        """One step with `commands`, one a motor; `what` [vehicles] int8: STEP, RESTART or IDLE."""
        rows = self._rows_of(slice(None))
        self._commands[rows] = np.reshape(commands, self._commands[rows].shape)
        self._all(np.ascontiguousarray(what, np.int8))

    def restart_where(self, which: np.ndarray) -> None:
        """Restart the vehicles with `which` True."""
        if np.any(which):
            self._all(np.where(which, RESTART, IDLE))

    def _rows_of(self, k: Any) -> Any:
        """Rows of the motors of vehicle k."""
        return k

    @property
    def steps(self) -> np.ndarray:
        """Control periods since the reset [vehicles]."""
        return self._counts()["steps"]

    def _counts(self) -> Any:
        return self._world.counts

    def _x(self) -> np.ndarray:
        """Places [m] of the vehicles along their courses [vehicles]."""
        return self._world.state["x"]

    def _lay_one(self, k: int, order: np.int8) -> None:
        self._what[k] = order
        try:
            _check_laid(self._lay(self._world, self.numbers, self._what, k, k + 1))
        finally:
            self._what[k] = IDLE

    def _do(self, k: int, order: np.int8) -> None:
        first = k // COUNT * COUNT
        self._what[k] = order
        try:
            self._drive(self._what, first, min(first + COUNT, self.count))
        finally:
            self._what[k] = IDLE

    def _all(self, what: np.ndarray) -> None:
        """Follow the orders, in several threads if there are many vehicles."""
        courses = what.copy()
        courses[(what == STEP) & (self._world.courses.ready < self._x() + self._ahead)] = AHEAD
        laid = np.any((courses == RESTART) | (courses == AHEAD))
        share = self.count if self._threads == 1 else -(-self.count // (_SHARES * self._threads))
        share = max(-(-share // COUNT) * COUNT, self._least)

        def follow(first: int) -> int:
            end = min(first + share, self.count)
            failed = 0
            if laid:
                failed = self._lay(self._world, self.numbers, courses, first, end)
            self._drive(what, first, end)
            return failed

        begins = range(0, self.count, share)
        run = map if len(begins) == 1 else _pool(self._threads, os.getpid()).map
        _check_laid(sum(run(follow, begins)))

    def _drive(self, what: np.ndarray, first: int, end: int) -> None:
        """Follow the orders for vehicles `first` to `end` - 1: the world, then what is on board."""
        self._step(*self._motion(what, first, end))
        if self._on_board is not None:
            self._on_board.follow(self._world.record, self._results, what, first, end)

    def _motion(self, what: np.ndarray, first: int, end: int) -> tuple[Any, ...]:
        """Arguments of the compiled step of the world."""
        return self._world, self.numbers, self._commands, what, first, end


def _check_laid(failed: int) -> None:
    if failed:
        raise RuntimeError("no passable course found: the soils are too weak for this vehicle")
