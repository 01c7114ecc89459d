"""Drives of a controller over courses that are the same for every controller."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.driving.wheels import IDLE, STEP, Simulation, Worlds
from soil_env.env import IMMOBILISED
from soil_env.parameters import Scenario
from soil_env.simulation.task import Cause
from soil_env.terramechanics.model import WheelSoilModel

#: Course sets (`course_rng`), disjoint from each other and from all courses of training.
TUNING_SET, HELD_OUT_SET = 1_000_001, 3_000_011
_RUNNING = Cause.RUNNING.value


class ControllerError(ParameterError):
    """A controller returned an action of the wrong shape, or one that is not finite."""


#: Metric -> (unit, what it is). Rates carry Wilson intervals, means bootstrap intervals over courses.
METRICS = {
    "immobilised": ("share of courses", "entrapped, stalled or bogged"),
    "entrapped": ("share of courses", "no progress, though the wheel turned"),
    "stalled": ("share of courses", "no progress, and the wheel did not turn"),
    "bogged": ("share of courses", "sinkage over the limit"),
    "time_limit": ("share of courses", "neither finished nor immobilised in time; costs as much"),
    "finished": ("share of courses", "reached the end of the course"),
    "distance": ("m", "furthest point reached"),
    "time": ("s", "episode length"),
    "speed": ("m/s", "distance over time"),
    "energy_per_metre": ("J/m", "motor work over distance, at least 0.1 m"),
    "slip": ("-", "mean slip over time, halts left out"),
    "sinkage": ("mm", "mean sinkage over time"),
    "return": ("-", "sum of rewards, not discounted"),
}
RATES = ("immobilised", "entrapped", "stalled", "bogged", "time_limit", "finished")


@dataclass(frozen=True)
class Runs:
    """One controller on many courses; arrays [courses]."""

    cause: np.ndarray
    distance: np.ndarray  # [m]
    time: np.ndarray  # [s]
    energy: np.ndarray  # [J]
    slip: np.ndarray  # mean
    sinkage: np.ndarray  # mean [m]
    returns: np.ndarray

    def metric(self, name: str) -> np.ndarray:
        """Value of a metric for each course [courses]."""
        if name == "immobilised":
            return np.isin(self.cause, [c.value for c in IMMOBILISED]).astype(float)
        if name in RATES:
            return (self.cause == Cause[name.upper()].value).astype(float)
        return {
            "distance": self.distance,
            "time": self.time,
            "speed": self.distance / self.time,
            "energy_per_metre": self.energy / np.maximum(self.distance, 0.1),
            "slip": self.slip,
            "sinkage": 1000.0 * self.sinkage,
            "return": self.returns,
        }[name]

    @classmethod
    def join(cls, parts: Sequence[Runs]) -> Runs:
        """The courses of all parts, in their order."""
        return cls(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)})


def course_rng(seed: int, course: int) -> np.random.Generator:
    """The Generator of one course of the set `seed`; no environment seeded with a single number ever gets it."""
    return np.random.default_rng([seed, course, 1])


def run_courses(
    controller,
    scenario: Scenario,
    seed: int,
    courses: int,
    first: int = 0,
    progress: Callable[[int], None] | None = None,
    batch: int = 500,
    model: WheelSoilModel | None = None,
) -> Runs:
    """Drive `controller` over courses `first` ... `first + courses - 1` of the set named by `seed`.

    `controller` has `predict` and `variant` (the observation it reads). Course k of a set is the same for every
    controller. `progress` is called with the number of courses done since its last call. `model` brings the effects
    that are on in the world.
    """
    parts = []
    for start in range(first, first + courses, batch):
        totals = Totals(min(batch, first + courses - start))
        for worlds, alive in drive(controller, scenario, seed, start, totals.count, model=model):
            totals.add(worlds, alive)
        parts.append(Runs(**totals.runs(worlds, scenario)))
        if progress is not None:
            progress(totals.count)
    return Runs.join(parts)


class Totals:
    """Sums over the time of `count` courses side by side."""

    def __init__(self, count: int):
        self.count = count
        self.energy, self.slip, self.driving, self.sinkage, self.returns, self.steps = np.zeros((6, count))

    def add(self, worlds: Worlds, alive: np.ndarray) -> np.ndarray:
        """Take in one control period; which of the `alive` courses were driving, that is not at a halt [count]."""
        s = worlds.state
        driving = alive & (s["halt_left"] == 0.0)
        self.energy += np.where(alive, np.maximum(s["motor_work"], 0.0), 0.0)
        self.slip += np.where(driving, s["slip"], 0.0)
        self.driving += driving
        self.sinkage += np.where(alive, s["sinkage"], 0.0)
        self.returns += np.where(alive, worlds.reward, 0.0)
        self.steps += alive
        return driving

    def runs(self, worlds: Worlds, scenario: Scenario) -> dict[str, np.ndarray]:
        """The fields of `Runs`, at the end."""
        return {
            "cause": worlds.cause.copy(),
            "distance": worlds.state["best_x"].copy(),
            "time": self.steps * scenario.control.period,
            "energy": self.energy,
            "slip": self.slip / np.maximum(self.driving, 1.0),
            "sinkage": self.sinkage / self.steps,
            "returns": self.returns,
        }


def drive(
    controller,
    scenario: Scenario,
    seed: int,
    first: int,
    count: int,
    threads: int | None = None,
    model: WheelSoilModel | None = None,
    warnings: bool = False,
) -> Iterator[tuple[Worlds, np.ndarray]]:
    """Drive courses `first` ... `first + count - 1` of set `seed` side by side, each to its end.

    Yields (worlds, alive) after every control period: the arrays of the simulation, one row a course, and which
    courses were still under way in that period [count] bool. The controller is asked as often as the scenario says
    (`control.repeat`); between, its action is held. Rows of ended courses stay as they ended. Raises
    `ControllerError` where an action is not of shape [count, 1] or not finite. The reward has no term `information`,
    whatever the scenario says: it helps to learn, and is no merit of a drive. `warnings`: whether the last seconds of
    the sensors are kept in `worlds.recent`.
    """
    held, longest = scenario.control.held, scenario.periods
    scenario = replace(
        scenario,
        reward=replace(scenario.reward, information=0.0),
        control=replace(scenario.control, repeat=1),
    )
    sim = Simulation(count, scenario, controller.variant, threads=threads, model=model, warnings=warnings)
    for k in range(count):
        sim.seed(k, course_rng(seed, first + k))
    alive = np.ones(count, dtype=bool)
    sim.restart_where(alive)
    if hasattr(controller, "attach"):  # a planner, that tries out what the world would do
        controller.attach(sim, threads, model)
    w = sim.worlds
    what = np.full(count, STEP)
    memory, fresh = None, np.ones(count, dtype=bool)
    for period in range(longest):
        if period % held == 0:
            action, memory = controller.predict(w.observation, state=memory, episode_start=fresh, deterministic=True)
            fresh = np.zeros(count, dtype=bool)
            commands = _commands(action, alive, f"in step {period // held} of course", first)
        sim.step_all(commands, what)
        yield w, alive
        ended = alive & (w.cause != _RUNNING)
        alive = alive & ~ended
        what[ended] = IDLE
        if not alive.any():
            return


def _commands(action, alive: np.ndarray, when: str, first: int) -> np.ndarray:
    """The `action` of a controller as commands [count]; ControllerError where that of an `alive` course is none."""
    action, count = np.asarray(action, dtype=np.float64), len(alive)
    if action.shape != (count, 1):
        raise ControllerError(f"action of shape {action.shape}: expected {(count, 1)}")
    if not np.isfinite(action[alive]).all():
        bad = int(np.flatnonzero(alive & ~np.isfinite(action[:, 0]))[0])
        raise ControllerError(f"action {action[bad, 0]} {when} {first + bad}: expected a number")
    return np.clip(np.nan_to_num(action[:, 0]), -1.0, 1.0)
