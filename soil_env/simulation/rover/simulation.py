"""Rovers in Python's hands: how many of them under one scenario, seeded, restarted and stepped."""

from __future__ import annotations

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env._numba.compiling import FastCall
from soil_env._numba.lanes import COUNT
from soil_env._numba.random_streams import seed_stream
from soil_env._numba.threads import threads
from soil_env.simulation.rover.worlds import RoverNumbers, RoverWorlds, new_rover_worlds, rover_numbers, step_rovers
from soil_env.simulation.worlds import COMPLETE, IDLE, RESTART, STEP, TRY, processors
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.vehicle import RoverScenario

_TRIAL_COURSES = 8


class RoverSimulation:
    """So many rovers under one scenario with one observation variant.

    Arrays in `worlds` are overwritten by each step. All randomness of rover j follows from the seed given to `seed`.
    """

    def __init__(
        self,
        rovers: int,
        scenario: RoverScenario,
        variant: str,
        threads: int | None = None,
        model: WheelSoilModel | None = None,
    ) -> None:
        self.scenario: RoverScenario = scenario
        self.rovers: int = rovers
        self._threads = threads or processors()
        self._run = FastCall(step_rovers)
        self.numbers: RoverNumbers = rover_numbers(scenario, variant, model)
        self.worlds: RoverWorlds = new_rover_worlds(rovers, scenario, self.numbers.task)
        axles = np.arange(scenario.axles)
        #: [rovers, axles] the row of each wheel in the arrays of wheels
        self.wheels: np.ndarray = (np.arange(rovers)[:, None] // COUNT * scenario.axles + axles) * COUNT
        self.wheels += np.arange(rovers)[:, None] % COUNT
        self._commands, self._what = np.zeros(self.worlds.wheel_streams.size), np.full(rovers, IDLE)
        self._counter = np.ones(2, dtype=np.int64)
        self._check_passable()

    def _check_passable(self) -> None:
        """Refuse a scenario whose soils this rover cannot pass, before it shows in the middle of a training."""
        trial, what = new_rover_worlds(1, self.scenario, self.numbers.task), np.array([TRY])
        trial.streams[0] = 1
        for _ in range(_TRIAL_COURSES):
            counter = np.array([0, 1])
            self._run(trial, self.numbers, np.zeros(trial.wheel_streams.size), what, counter)
            if trial.reward[0] < 0.0:
                raise ParameterError(
                    f"scenario {self.scenario.name!r}: no passable course found for this rover on these soils; "
                    "expected firmer soils, more stall torque, a lower course.margin or a lower course.grade_deg"
                )

    def seed(self, j: int, rng: np.random.Generator) -> None:
        """Start the random stream of rover j from a Generator."""
        self.worlds.streams[j] = seed_stream(rng)

    def restart(self, j: int) -> None:
        """New course and fresh start for rover j."""
        self._do(j, RESTART)

    def complete(self, j: int) -> None:
        """Draw what is left of the course of rover j; it goes on as it would have."""
        self._do(j, COMPLETE)

    def step(self, j: int, commands: np.ndarray) -> None:
        """One step of rover j with `commands` [axles]: the control periods of an action."""
        self._commands[self.wheels[j]] = commands
        self._do(j, STEP)

    def _do(self, j: int, what: np.int8) -> None:
        self._what[j] = what
        self._counter[:] = 0 if self.rovers <= COUNT else j // COUNT, 1
        try:
            self._run(self.worlds, self.numbers, self._commands, self._what, self._counter)
        finally:
            self._what[j] = IDLE

    def step_all(self, commands: np.ndarray, what: np.ndarray) -> None:
        """One step with `commands` [rovers, axles]; `what` [rovers] int8: STEP, RESTART or IDLE."""
        self._commands[self.wheels] = commands
        self._in_parallel(np.ascontiguousarray(what, np.int8))

    def restart_where(self, which: np.ndarray) -> None:
        """Restart the rovers with `which` True."""
        if np.any(which):
            self._in_parallel(np.where(which, RESTART, IDLE))

    def _in_parallel(self, what: np.ndarray) -> None:
        """`step_rovers` over all rovers in several threads (it holds no lock, and they share no row)."""
        at_work = min(self._threads, -(-self.rovers // COUNT))
        self._counter[:] = 0, at_work
        arguments = (self.worlds, self.numbers, self._commands, what, self._counter)
        if at_work == 1:
            self._run(*arguments)
        else:
            threads(self._threads).run(self._run, arguments, at_work - 1)
