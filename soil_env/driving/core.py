"""Simulation of many vehicles side by side: the world and, where something asks for it, the estimator on board."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env._numba.compiling import FastCall, compile_aside
from soil_env._numba.random_streams import seed_stream
from soil_env._numba.threads import threads
from soil_env.driving.estimator import Results
from soil_env.parameters import Scenario
from soil_env.simulation.wheels import AHEAD, COMPLETE, IDLE, RESTART, STEP, TRY

_TRIAL_COURSES = 8
_COURSES = 8  # that a thread draws, at least
_ONLY = np.zeros(1, dtype=np.int64)


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
        self._counter = np.ones(2, dtype=np.int64)

    def _begin(self, lay, step, world, trial, commands: int, estimate, estimator, belief) -> None:
        """Take the compiled functions with their arrays, and try the scenario on a `trial` world of one vehicle.

        Functions that are not in the cache yet are compiled side by side.
        """
        self._world, self._commands = world, np.zeros(commands)
        self._lay, self._step, self._estimate = FastCall(lay), FastCall(step), FastCall(estimate)
        self._estimator, self.belief = estimator, belief
        self._results = Results(world.observation, world.terms, world.reward, world.cause)
        calls = zip((step, estimate), self._calls(self._what), strict=False)
        for function, (_, arguments) in reversed(list(calls)):
            compile_aside(function, arguments)
        self._check_passable(trial)

    def _check_passable(self, trial: Any) -> None:
        """Refuse a scenario whose soils this vehicle cannot pass, before it shows in the middle of a training."""
        trial.streams[0] = 1
        for _ in range(_TRIAL_COURSES):
            self._lay(trial, self.numbers, _ONLY, TRY, np.array([0, 1]))
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
        self._draw(k, RESTART)
        self._do(k, RESTART)

    def complete(self, k: int) -> None:
        """Draw the rest of the course of vehicle k; it goes on as it would have."""
        self._draw(k, COMPLETE)

    def step(self, k: int, command: Any) -> None:
        """One step of vehicle k: the control periods of an action."""
        self._commands[self._rows_of(k)] = command
        if self._world.courses.ready.item(k) < self._x().item(k) + self._ahead:
            self._draw(k, AHEAD)
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

    def _draw(self, k: int, order: np.int8) -> None:
        self._counter[:] = 0, 1
        self._lay(self._world, self.numbers, np.array([k]), order, self._counter)

    def _do(self, k: int, order: np.int8) -> None:
        self._what[k] = order
        try:
            for kernel, arguments in self._calls(self._what):
                self._counter[:] = self._first(k), 1
                kernel(*arguments)
        finally:
            self._what[k] = IDLE

    def _all(self, what: np.ndarray) -> None:
        """Follow the orders, in several threads if there are many vehicles."""
        short = (what == STEP) & (self._world.courses.ready < self._x() + self._ahead)
        for which, order in ((what == RESTART, RESTART), (short, AHEAD)):
            rows = np.flatnonzero(which)
            if rows.size:
                arguments = self._world, self.numbers, rows, order, self._counter
                self._in_parallel(self._lay, arguments, -(-rows.size // _COURSES))
        for kernel, arguments in self._calls(what):
            self._in_parallel(kernel, arguments, -(-self.count // self._least))

    def _in_parallel(self, kernel: FastCall, arguments: tuple, most: int) -> None:
        """Run a compiled function in up to `most` threads, which share no row; it holds no lock."""
        at_work = min(self._threads, most)
        self._counter[:] = 0, at_work
        if at_work == 1:
            kernel(*arguments)
        else:
            threads(self._threads).run(kernel, arguments, at_work - 1)

    def _calls(self, what: np.ndarray):
        """Compiled functions with their arguments: the world, then what is on board."""
        yield self._step, (self._world, self.numbers, self._commands, what, self._counter)
        if self._estimator is not None:
            known = self._estimator, self.belief, self._world.record, self._results
            yield self._estimate, (*known, what, self._counter)
