"""A controller driven over courses that are the same for every controller."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.env import IMMOBILISED
from soil_env.parameters import Scenario
from soil_env.simulation.task import Cause
from soil_env.simulation.worlds import IDLE, STEP, Simulation, Worlds
from soil_env.terramechanics.model import WheelSoilModel

#: Course sets (`course_rng`), disjoint from each other and from all courses of training.
TUNING_SET, HELD_OUT_SET = 1_000_001, 3_000_011
_RUNNING = Cause.RUNNING.value


class ControllerError(ParameterError):
    """A controller gave what no wheel can be driven with."""


#: Metric -> (unit, what it is). Rates carry Wilson intervals, means bootstrap intervals over courses.
METRICS = {
    "immobilised": ("share of courses", "entrapped, stalled or bogged"),
    "entrapped": ("share of courses", "slip stayed high without progress"),
    "stalled": ("share of courses", "the wheel did not turn outside a halt"),
    "bogged": ("share of courses", "sinkage over the limit"),
    "time_limit": ("share of courses", "neither finished nor immobilised in time"),
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
        count = min(batch, first + courses - start)
        parts.append(_run_batch(controller, scenario, seed, start, count, model))
        if progress is not None:
            progress(count)
    names = Runs.__dataclass_fields__
    return Runs(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in names})


def _run_batch(controller, scenario, seed, start, count, model):
    total = {name: np.zeros(count) for name in ("energy", "slip", "driving", "sinkage", "returns", "steps")}
    for w, alive in drive(controller, scenario, seed, start, count, model=model):
        driving = alive & (w.state["halt_left"] == 0.0)
        total["energy"] += np.where(alive, np.maximum(w.state["motor_work"], 0.0), 0.0)
        total["slip"] += np.where(driving, w.state["slip"], 0.0)
        total["driving"] += driving
        total["sinkage"] += np.where(alive, w.state["sinkage"], 0.0)
        total["returns"] += np.where(alive, w.reward, 0.0)
        total["steps"] += alive
    steps = total["steps"]
    return Runs(
        w.cause.copy(),
        w.state["best_x"].copy(),
        steps * scenario.control.period,
        total["energy"],
        total["slip"] / np.maximum(total["driving"], 1.0),
        total["sinkage"] / steps,
        total["returns"],
    )


def drive(
    controller,
    scenario: Scenario,
    seed: int,
    first: int,
    count: int,
    threads: int | None = None,
    model: WheelSoilModel | None = None,
) -> Iterator[tuple[Worlds, np.ndarray]]:
    """Drive courses `first` ... `first + count - 1` of set `seed` side by side, each to its end.

    Yields (worlds, alive) after every control period: the arrays of the simulation, one row a course, and which
    courses were still under way in that period [count] bool. Rows of ended courses stay as they ended. Raises
    `ControllerError` where an action is not of shape [count, 1] or not finite. The reward has no term `information`,
    whatever the scenario says: it helps to learn, and is no merit of a drive.
    """
    scenario = replace(scenario, reward=replace(scenario.reward, information=0.0))
    sim = Simulation(count, scenario, controller.variant, threads=threads, model=model)
    for k in range(count):
        sim.seed(k, course_rng(seed, first + k))
    alive = np.ones(count, dtype=bool)
    sim.restart_where(alive)
    w = sim.worlds
    what = np.full(count, STEP)
    memory, fresh = None, np.ones(count, dtype=bool)
    for step in range(scenario.steps):
        action, memory = controller.predict(w.observation, state=memory, episode_start=fresh, deterministic=True)
        fresh = np.zeros(count, dtype=bool)
        action = np.asarray(action, dtype=np.float64)
        if action.shape != (count, 1):
            raise ControllerError(f"action of shape {action.shape}: expected {(count, 1)}")
        if not np.isfinite(action[alive]).all():
            bad = int(np.flatnonzero(alive & ~np.isfinite(action[:, 0]))[0])
            raise ControllerError(f"action {action[bad, 0]} in step {step} of course {first + bad}: expected a number")
        sim.step_all(np.clip(np.nan_to_num(action[:, 0]), -1.0, 1.0), what)
        yield w, alive
        ended = alive & (w.cause != _RUNNING)
        alive = alive & ~ended
        what[ended] = IDLE
        if not alive.any():
            return


def tune(make, candidates: list[dict], scenario: Scenario, seed: int, courses: int, progress=None, model=None):
    """The settings whose controller `make(**settings)` finishes most courses of set `seed`, the return breaking ties.

    Returns (settings, [{**settings, "finished": share, "return": mean return} for each candidate]).
    """
    tried = []
    for settings in candidates:
        runs = run_courses(make(**settings), scenario, seed, courses, progress=progress, model=model)
        score = {"finished": float(runs.metric("finished").mean()), "return": float(runs.returns.mean())}
        tried.append({**settings, **score})
    best = max(range(len(tried)), key=lambda k: (tried[k]["finished"], tried[k]["return"]))
    return candidates[best], tried
