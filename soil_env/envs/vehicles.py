"""Many vehicles side by side: the world and, where it is asked for, the estimator on board."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from soil_env._compiled.random_streams import seed_stream
from soil_env._io.loading import ParameterError
from soil_env.parameters import Scenario
from soil_env.parameters.readings import AHEAD, COMPLETE, IDLE, RESTART, STEP, TRY, Shown, Stepped

TRIAL_COURSES = 8  # drawn before a scenario is accepted
CHUNKS = 4  # of the vehicles, for each thread: a thread that is done early takes another chunk
# attributes of `Vehicles` that are views of arrays, which a copy has to make anew; `_view` does so
VIEWS = ("_x", "_ready", "_sampled", "worlds", "_order")
LEAST = 32  # vehicles in a chunk, at least, so that handing it to a thread pays; own choice


def processors() -> int:
    """Processors that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _pool(threads: int, process: int) -> ThreadPoolExecutor:
    """Pool of `threads` threads, one pool for each `process` id: a forked process has none of the
    threads of its parent, so it makes a pool of its own.
    """
    return ThreadPoolExecutor(threads, "soil_env")


def asks_for_estimates(scenario: Scenario, variant: str) -> bool:
    """True if the observation or the reward of a scenario asks for an estimate of the soil."""
    return variant == "identified" or scenario.reward.information > 0.0


class Worlds(NamedTuple):
    """All arrays of many vehicles, one row a vehicle, overwritten by each step.

    Those of `WheelWorlds` or `RoverWorlds`, results of the last step, and those of the estimators
    (`identification.online.on_board.OnBoard.views`). None stands for what a vehicle has not.
    """

    state: np.ndarray  # [vehicles]
    courses: np.ndarray  # [vehicles]
    observation: np.ndarray  # [vehicles, D] float32
    terms: np.ndarray  # [vehicles, 4] of the reward
    reward: np.ndarray  # [vehicles]
    cause: np.ndarray  # [vehicles] `Cause`
    samples: Any = None  # of wheels, as in `WheelWorlds`
    ruts: Any = None  # of rovers
    readings: Any = None  # of rovers
    on_board: Any = None  # memory of the estimators
    ids: Any = None  # estimates of each wheel by its own readings
    memory: Any = None  # of wheels: what was learnt of each terrain class
    # of wheels: > 0 where the last step or restart changed the estimate, until an info shows it
    changed: Any = None
    recent: Any = None  # of wheels: averages for the warning of an immobilisation
    known: Any = None  # of rovers: estimates of each wheel by the readings of all


class Vehicles:
    """Base of the simulations of many wheels and of many rovers.

    `count`: number of vehicles; `threads`: most threads, None for one a processor. A subclass sets
    `numbers` and `_actions`, and gives the other arrays and the compiled functions to `_begin`. All
    randomness of vehicle k follows from the seed given to `seed`. Restarts and steps raise
    RuntimeError where no soil is found for a course.
    """

    numbers: Any  # constants of the compiled step
    _actions: np.ndarray  # a row a vehicle, a column an action
    _vehicle = "wheel"
    _sampled_by = "samples"  # array of the world that those on board read

    def __init__(self, count: int, scenario: Any, threads: int | None) -> None:
        self.scenario = scenario
        self.count = count
        self._threads = threads or processors()
        self._chunk = count  # vehicles that a thread takes at a time
        if self._threads > 1:
            self._chunk = max(-(-count // (CHUNKS * self._threads)), LEAST)
        self._orders = np.full(count, IDLE)  # the order that `_one` follows; IDLE otherwise

    def _begin(
        self,
        functions: tuple[Any, Any],
        worlds: Any,
        courses: tuple[Any, float],
        scratch: list[Any],
        on_board: Any,
    ) -> None:
        """Take the compiled functions (lay, step) with their arrays.

        `courses`: the numbers that courses are drawn by, and the length [m] of final ground that a
        step needs ahead of the vehicle. `scratch`: a work space for each chunk; `on_board`: the
        estimators, None where nothing is identified.
        """
        self._lay, self._step = functions
        self._world = worlds
        self._heads = worlds.state  # records of the vehicles
        self.course_numbers, self._ahead = courses
        self._scratch = scratch
        self._on_board = on_board
        #: `SETTING` of the identifier
        self.belief = None if on_board is None else on_board.identifier
        self._view()

    def _estimators(self, variant: str, first: int, warns: bool = False) -> Any:
        """The estimators on board; `first`: index of the observation's first entry on the soil;
        `warns`: keep the averages for the warning of an immobilisation.
        """
        from soil_env.identification.online.on_board import OnBoard  # takes a while

        shown = Shown(variant == "identified", first, *self.numbers.bounds)
        return OnBoard(self.count, self.scenario, shown, warns)

    def _view(self) -> None:
        """Make the views of the arrays (`VIEWS`).

        A copy calls it again, since copied views would be arrays of their own.
        """
        heads = self._heads
        self._x = heads["x"]  # [m]
        self._ready = self._world.courses["ready"]  # [m] place up to which the ground is final
        samples = getattr(self._world, self._sampled_by)
        self._sampled = Stepped(heads, samples, self._world.observation)
        results = {name: heads[name] for name in ("terms", "reward", "cause")}
        known = {} if self._on_board is None else self._on_board.views()
        self.worlds = Worlds(**self._world._asdict(), **results, **known)

    def __getstate__(self) -> dict[str, Any]:
        """All but the views, which `__setstate__` makes anew."""
        return {name: value for name, value in self.__dict__.items() if name not in VIEWS}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take the attributes that `__getstate__` gave, and make the views of their arrays."""
        self.__dict__.update(state)
        self._view()

    def _check_drivable(self, trial: Any) -> None:
        """Refuse a scenario whose soils are too weak for this vehicle, before a training begins:
        ParameterError.

        `trial`: the arrays of one vehicle, in which `TRIAL_COURSES` courses are started. Each
        leaves the mass in its reward, or -1 if no soil was found.
        """
        vehicles = trial.state
        vehicles["stream"] = 1  # any seed, the same in every check
        orders = np.array([TRY])
        for _ in range(TRIAL_COURSES):
            self._lay(trial, self.course_numbers, orders, self._scratch[0], 0, 1)
            if vehicles["reward"][0] < 0.0:
                raise ParameterError(
                    f"scenario {self.scenario.name!r}: no soil leaves this {self._vehicle}, with "
                    f"{self.scenario.weight:.4g} N on a wheel, a drawbar pull of "
                    f"course.least_pull = {self.scenario.course.least_pull:g} of its weight; "
                    "expected firmer soils, less mass, more stall torque or a lower least_pull"
                )

    def seed(self, k: int, rng: np.random.Generator) -> None:
        """Start the random stream of vehicle k from a Generator."""
        self._heads["stream"][k] = seed_stream(rng)

    def restart(self, k: int) -> None:
        """Draw a new course for vehicle k and put it at rest at the start, with a blank record."""
        self._clear(k)
        self._one(k, RESTART, self._draw)
        self._one(k, RESTART, self._drive)

    def complete(self, k: int) -> None:
        """Draw the rest of the course of vehicle k: the ground that it would have met later."""
        self._one(k, COMPLETE, self._draw)

    def step(self, k: int, action: Any) -> None:
        """One step of vehicle k: the control periods of an `action`, of a rover one for each
        axle.

        Ground that this step needs and is not drawn yet is drawn first.
        """
        self._actions[k] = action
        if self._ready.item(k) < self._x.item(k) + self._ahead:
            self._one(k, AHEAD, self._draw)
        self._one(k, STEP, self._drive)

    def step_all(self, actions: np.ndarray, orders: np.ndarray) -> None:
        """One step with `actions`, of rovers one for each axle; `orders` [vehicles] int8: STEP,
        RESTART or IDLE.
        """
        restarts = orders == RESTART
        if restarts.any():
            self._clear(restarts)
        self._actions[:] = np.reshape(actions, self._actions.shape)
        self._all(np.ascontiguousarray(orders, np.int8))

    def restart_where(self, which: np.ndarray) -> None:
        """Restart the vehicles with `which` [vehicles] True; the others stay as they are."""
        if np.any(which):
            self._clear(which)
            self._all(np.where(which, RESTART, IDLE))

    def _clear(self, which: Any) -> None:
        """Make the records of vehicles blank but for their random streams; `which`: an index or
        [vehicles] bool.
        """
        streams = self._heads["stream"][which].copy()
        self._heads[which] = 0
        self._heads["stream"][which] = streams

    @property
    def steps(self) -> np.ndarray:
        """Control periods since the reset [vehicles]."""
        return self._heads["steps"]

    def _one(self, k: int, order: np.int8, follow: Callable[..., int]) -> None:
        """Let vehicle k alone `follow` an order, in this thread; `follow`: `_draw` or `_drive`.

        RuntimeError where no soil was found for its course. Afterwards its order is IDLE.
        """
        self._orders[k] = order
        try:
            check_laid(follow(self._orders, self._scratch[0], k, k + 1))
        finally:
            self._orders[k] = IDLE

    def _all(self, orders: np.ndarray) -> None:
        """Follow the orders [vehicles], chunk by chunk, in several threads if there are many
        vehicles. Ground that a restart or a step needs is drawn first; RuntimeError where no soil
        was found for it.
        """
        courses = np.where(orders == RESTART, RESTART, IDLE)
        courses[(orders == STEP) & (self._ready < self._x + self._ahead)] = AHEAD
        laid = np.any(courses != IDLE)

        def run_chunk(number: int) -> int:
            """Follow the orders of the chunk of this `number`, from 0; return for how many vehicles
            no soil was found.
            """
            first = number * self._chunk
            end = min(first + self._chunk, self.count)
            scratch = self._scratch[number]
            failed = 0
            if laid:
                failed = self._draw(courses, scratch, first, end)
            self._drive(orders, scratch, first, end)
            return failed

        chunks = range(len(self._scratch))
        run = map if len(chunks) == 1 else _pool(self._threads, os.getpid()).map
        check_laid(sum(run(run_chunk, chunks)))

    def _draw(self, orders: np.ndarray, scratch: Any, first: int, end: int) -> int:
        """Draw the ground that the `orders` [vehicles] int8 of the vehicles `first` to `end` - 1
        ask for; return for how many of them no soil was found. `scratch`: work space of a chunk.
        """
        return self._lay(self._world, self.course_numbers, orders, scratch, first, end)

    def _drive(self, orders: np.ndarray, scratch: Any, first: int, end: int) -> int:
        """Follow the `orders`, as in `_draw`, of the vehicles `first` to `end` - 1 in the world,
        then in the estimators.

        Returns 0 as `_draw` does, since it cannot fail.
        """
        self._move(orders, scratch, first, end)
        if self._on_board is not None:
            self._on_board.update(self._sampled, orders, first, end)
        return 0

    def _move(self, orders: np.ndarray, scratch: Any, first: int, end: int) -> None:
        """Follow the `orders`, as in `_draw`, of the vehicles `first` to `end` - 1 in the world."""
        self._step(self._world, self.numbers, self._actions, orders, scratch, first, end)


def check_laid(failed: int) -> None:
    """RuntimeError if there are vehicles, `failed` of them, for whose course no soil was found."""
    if failed:
        raise RuntimeError("no soil found that leaves this vehicle course.least_pull")
