"""Simulation of many vehicles side by side: the world and, where something asks for it, the estimator on board."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env._numba.compiling import FastCall, compile_aside
from soil_env._numba.random_streams import seed_stream
from soil_env._numba.threads import threads
from soil_env.driving.estimator import Results
from soil_env.parameters import Scenario
from soil_env.simulation.wheels import AHEAD, COMPLETE, DRIVEN, IDLE, LAID, RESTART, STEP, TRY

_TRIAL_COURSES = 8


def processors() -> int:
    """Processors that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def asks_for_estimates(scenario: Scenario, variant: str) -> bool:
    """True if the observation or the reward of a scenario asks for an estimate of the soil."""
    return variant == "identified" or scenario.reward.information > 0.0


class Vehicles:
    """Base of the simulations of many wheels and of many rovers.

    A subclass makes the arrays and numbers of the compiled functions and gives them to `_begin`. All randomness of
    vehicle k follows from the seed given to `seed`.
    """

    numbers: Any
    worlds: Any  # all arrays, overwritten by each step
    _vehicle = "wheel"
    _ahead: float  # [m] final ground that a vehicle needs before it

    def __init__(self, count: int, scenario: Any, threads: int | None, least: int) -> None:
        self.scenario = scenario
        self.count: int = count
        self._threads = threads or processors()
        self._least = least  # vehicles that a thread takes at a time, at least
        self._what = np.full(count, IDLE)
        self._progress = np.full(count, DRIVEN, dtype=np.int64)
        self._counters = np.ones((3, 3), dtype=np.int64)  # of each function: [next, threads at work, failures]

    def _begin(self, lay, step, world, trial, commands: int, estimate, estimator, belief) -> None:
        """Take the compiled functions with their arrays, and try the scenario on a `trial` world of one vehicle.

        Functions that are not in the cache yet are compiled side by side.
        """
        self._world, self._commands = world, np.zeros(commands)
        self._lay, self._step, self._estimate = FastCall(lay), FastCall(step), FastCall(estimate)
        self._estimator, self.belief = estimator, belief
        self._results = Results(world.observation, world.terms, world.reward, world.cause)
        for function, (_, arguments) in reversed(list(zip((step, estimate), self._drive(self._what), strict=False))):
            compile_aside(function, arguments)
        self._check_passable(trial)

    def _check_passable(self, trial: Any) -> None:
        """Refuse a scenario whose soils this vehicle cannot pass, before it shows in the middle of a training."""
        trial.streams[0] = 1
        only, orders, counter = np.zeros(1, dtype=np.int64), np.array([TRY]), self._counters[0]
        for _ in range(_TRIAL_COURSES):
            counter[:] = 0
            self._lay(trial, self.numbers, only, orders, self._progress, counter)
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

    def _first(self, k: int) -> int:
        """Value of the counter that leads to vehicle k."""
        return 0

    def _lay_one(self, k: int, order: np.int8) -> None:
        function, arguments = self._courses(np.array([k]), np.array([order]))
        self._counters[:] = 0, 1, 0
        function(*arguments)
        self._check_laid()

    def _check_laid(self) -> None:
        if self._counters[0, 2]:
            raise RuntimeError("no passable course found: the soils are too weak for this vehicle")

    def _do(self, k: int, order: np.int8) -> None:
        self._what[k] = order
        self._counters[:] = self._first(k), 1, 0
        try:
            for function, arguments in self._drive(self._what):
                function(*arguments)
        finally:
            self._what[k] = IDLE

    def _all(self, what: np.ndarray) -> None:
        """Follow the orders, in several threads if there are many vehicles."""
        orders = what.copy()
        orders[(what == STEP) & (self._world.courses.ready < self._x() + self._ahead)] = AHEAD
        rows = np.flatnonzero((orders == RESTART) | (orders == AHEAD))
        self._progress[:] = LAID
        self._progress[rows] = 0
        calls = [self._courses(rows, orders[rows]), *self._drive(what)] if rows.size else list(self._drive(what))
        at_work = min(self._threads, -(-self.count // self._least))
        self._counters[:] = 0, at_work, 0
        threads(self._threads).run(calls, at_work - 1)
        self._check_laid()

    def _courses(self, rows: np.ndarray, orders: np.ndarray) -> tuple[FastCall, tuple]:
        """Compiled function with its arguments that lays courses."""
        return self._lay, (self._world, self.numbers, rows, orders, self._progress, self._counters[0])

    def _drive(self, what: np.ndarray) -> Iterator[tuple[FastCall, tuple]]:
        """Compiled functions with their arguments: the world, then what is on board."""
        yield self._step, (self._world, self.numbers, self._commands, what, self._progress, self._counters[1])
        if self._estimator is not None:
            known = self._estimator, self.belief, self._world.record, self._results
            yield self._estimate, (*known, what, self._progress, self._counters[2])
