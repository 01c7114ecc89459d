"""Drives of a controller over courses that are the same for every controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from soil_env.driving.rovers import RoverSimulation
from soil_env.driving.wheels import IDLE, STEP
from soil_env.simulation.task import Cause
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.vehicle import RoverScenario

from ..evaluate.driving import METRICS, ControllerError, Runs, course_rng

_RUNNING = Cause.RUNNING.value
#: Metrics of rovers: those of wheels, and how the wheels share the work.
ROVER_METRICS = METRICS | {
    "energy_per_metre": ("J/m", "work of all motors over distance, at least 0.1 m"),
    "sinkage": ("mm", "mean sinkage of the deepest wheel over time"),
    "fighting": ("% of weight", "pull of wheels that others pull against: half of sum |DP| - |sum DP|, mean over time"),
    "wheel_force": (
        "% of share",
        "largest |torque|/radius of a wheel over its share of the weight, mean over time",
    ),
}


@dataclass(frozen=True)
class RoverRuns(Runs):
    """One controller on many courses; arrays [courses]."""

    fighting: np.ndarray  # [of the weight]
    wheel_force: np.ndarray  # [of a wheel's mean share of the weight]

    def metric(self, name: str) -> np.ndarray:
        """Value of a metric for each course [courses]."""
        own = {"fighting": 100.0 * self.fighting, "wheel_force": 100.0 * self.wheel_force}
        return own[name] if name in own else super().metric(name)


class _Totals:
    """Sums over the time of `count` courses side by side."""

    def __init__(self, simulation: RoverSimulation):
        self.simulation = simulation
        count = simulation.count
        self.energy, self.slip, self.driving, self.sinkage, self.returns, self.steps = np.zeros((6, count))
        self.fighting, self.force = np.zeros((2, count))

    def add(self, alive: np.ndarray) -> None:
        """Take in one control period of the `alive` courses."""
        worlds, scenario = self.simulation.worlds, self.simulation.scenario
        body, wheels, rows = worlds.rovers.body, worlds.rovers.wheels, self.simulation.wheels
        driving = alive & (body["halt_left"] == 0.0)
        pull, weight = wheels["drawbar_pull"][rows], body["mass"] * scenario.gravity
        force = np.abs(wheels["torque"][rows]).max(axis=1) / scenario.wheel.radius
        self.energy += np.where(alive, 2.0 * body["motor_work"], 0.0)  # of both sides
        self.slip += np.where(driving, body["slip"], 0.0)
        self.fighting += np.where(driving, 0.5 * (np.abs(pull).sum(axis=1) - np.abs(pull.sum(axis=1))) / weight, 0.0)
        self.force += np.where(driving, force * scenario.axles / weight, 0.0)
        self.driving += driving
        self.sinkage += np.where(alive, body["sinkage"], 0.0)
        self.returns += np.where(alive, worlds.reward, 0.0)
        self.steps += alive

    def runs(self) -> RoverRuns:
        """At the end."""
        worlds, driving = self.simulation.worlds, np.maximum(self.driving, 1.0)
        return RoverRuns(
            cause=worlds.cause.copy(),
            distance=worlds.rovers.body["best_x"].copy(),
            time=self.steps * self.simulation.scenario.control.period,
            energy=self.energy,
            slip=self.slip / driving,
            sinkage=self.sinkage / self.steps,
            returns=self.returns,
            fighting=self.fighting / driving,
            wheel_force=self.force / driving,
        )


def run_courses(
    controller,
    scenario: RoverScenario,
    seed: int,
    courses: int,
    first: int = 0,
    progress: Callable[[int], None] | None = None,
    batch: int = 500,
    model: WheelSoilModel | None = None,
) -> RoverRuns:
    """Drive `controller` over courses `first` ... `first + courses - 1` of the set named by `seed`.

    `controller` has `predict` and `variant` (the observation it reads), and `drives` where it takes another action than
    the scenario's. Course k of a set is the same for every controller. `progress` is called with the number of courses
    done since its last call. Raises `ControllerError` where an action is of the wrong shape or not finite.
    """
    parts = []
    for start in range(first, first + courses, batch):
        count = min(batch, first + courses - start)
        parts.append(_drive(controller, scenario, seed, start, count, model))
        if progress is not None:
            progress(count)
    return RoverRuns.join(parts)


def _drive(controller, scenario: RoverScenario, seed: int, first: int, count: int, model) -> RoverRuns:
    control = replace(scenario.control, **getattr(controller, "drives", {}))
    held = control.held
    scenario = replace(
        scenario, reward=replace(scenario.reward, information=0.0), control=replace(control, repeat=1)
    )  # fmt: skip
    simulation = RoverSimulation(count, scenario, controller.variant, model=model)
    for j in range(count):
        simulation.seed(j, course_rng(seed, first + j))
    alive, what, memory = np.ones(count, dtype=bool), np.full(count, STEP), None
    simulation.restart_where(alive)
    totals, worlds = _Totals(simulation), simulation.worlds
    for period in range(scenario.periods):
        if period % held == 0:
            action, memory = controller.predict(
                worlds.observation, state=memory, episode_start=np.full(count, period == 0), deterministic=True
            )
            commands = _commands(action, alive, scenario.axles, first)
        simulation.step_all(commands, what)
        totals.add(alive)
        ended = alive & (worlds.cause != _RUNNING)
        alive, what[ended] = alive & ~ended, IDLE
        if not alive.any():
            break
    return totals.runs()


def _commands(action, alive: np.ndarray, axles: int, first: int) -> np.ndarray:
    """The `action` of a controller as commands [count, axles]; ControllerError where that of an `alive` one is none."""
    action = np.asarray(action, dtype=np.float64)
    if action.shape != (len(alive), axles):
        raise ControllerError(f"action of shape {action.shape}: expected {(len(alive), axles)}")
    bad = np.flatnonzero(alive & ~np.isfinite(action).all(axis=1))
    if bad.size:
        raise ControllerError(f"action {action[bad[0]].tolist()} on course {first + bad[0]}: expected numbers")
    return np.clip(np.nan_to_num(action), -1.0, 1.0)
