"""Drives for training and tests: what the network would read in every control period, and what became of the wheel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from soil_env.driving.wheels import Worlds
from soil_env.env import IMMOBILISED
from soil_env.identification.online.immobilisation import ImmobilisationWarning
from soil_env.parameters import Scenario, load_scenario
from soil_env.simulation.task import Cause, layout
from soil_env.simulation.world.terrain import Courses

from ..evaluate.driving import drive
from ..evaluate.warning import Warnings
from .drivers import make_driver

AHEAD = (0.0, 0.3, 0.6, 1.0, 1.5)  # [m] where the ground is told to the network that knows it
UNKNOWN = 5.0  # [s] before the last progress of a course cut by the time limit, from which on its outcome is not known
_STUCK = [cause.value for cause in IMMOBILISED]
_SLIP, _SINKAGE = (next(i for i, e in enumerate(layout("blind")) if e.name == name) for name in ("slip", "sinkage"))


@dataclass(frozen=True)
class Drives:
    """Courses driven side by side; arrays [periods, courses] unless said otherwise.

    `stop` is the last control period in which a wheel that was immobilised in the end got further than ever before at
    the least mean speed that the task asks for; `last_stretch` the one in which it began the last
    `no_progress_distance` that it got further at all.
    """

    scenario: str
    family: str
    period: float  # [s]
    inputs: np.ndarray  # [periods, courses, inputs] float32
    ground: (
        np.ndarray
    )  # [periods, courses, ...] float32: the true ground here and ahead; no columns where not asked for
    alive: np.ndarray  # bool
    driving: np.ndarray  # bool: alive, and not at a halt
    patch: np.ndarray  # under the wheel
    best: np.ndarray  # [m] furthest point
    signals: dict[str, np.ndarray]  # {what an expert would look at first: its value}
    cause: np.ndarray  # [courses] `task.Cause`
    stop: np.ndarray  # [courses]
    last_stretch: np.ndarray  # [courses]

    @property
    def stuck(self) -> np.ndarray:
        """Immobilised in the end [courses] bool."""
        return np.isin(self.cause, _STUCK)

    @property
    def passed(self) -> np.ndarray:
        """Finished [courses] bool: a course cut by the time limit is neither."""
        return self.cause == Cause.FINISHED.value

    def since(self, period: np.ndarray) -> np.ndarray:
        """[periods, courses] time spent driving [s] between the control periods `period` [courses] and each period."""
        clock = np.cumsum(self.driving, axis=0) * self.period
        return clock - np.take_along_axis(clock, period[None], axis=0)

    @property
    def ahead(self) -> np.ndarray:
        """Seconds of driving until the wheel stops for good, not positive from there on, +inf where it never does."""
        return np.where(self.stuck, -self.since(self.stop), np.inf)

    @property
    def known(self) -> np.ndarray:
        """Periods whose outcome is known: all but the last of a course that was cut by the time limit."""
        cut = (self.cause == Cause.TIME_LIMIT.value) & (self.since(self.last_stretch) > -UNKNOWN)
        return self.alive & ~cut


def drives(
    scenario: str,
    family: str,
    seed: int,
    first: int,
    count: int,
    make: Callable[[Scenario], object] | None = None,
    ground: bool = False,
) -> Drives:
    """Drive courses `first` ... `first + count - 1` of set `seed`; `make` makes another driver than that of `family`,
    which acts as the scenario says, the families by torque.

    `ground`: with the true ground too, which no sensor gives.
    """
    task = load_scenario(scenario, {"control": {"action": "torque"}} if make is None else {})
    driver = make_driver(family, task, [seed, first]) if make is None else make(task)
    foresight, criterion, rows = ImmobilisationWarning(task), Warnings(task, count), np.arange(count)
    kept, places = [], []
    for worlds, alive in drive(driver, task, seed, first, count, threads=1, warnings=True):
        state, ids = worlds.state, worlds.ids
        criterion.step(worlds, alive)
        inputs = foresight.inputs(rows, worlds.recent, ids.estimate, ids.sd).astype(np.float32)
        kept.append((
            inputs, alive.copy(), alive & (state["halt_left"] == 0.0), state["best_x"].copy(),
            worlds.counts["patch"].copy(),
            worlds.observation[:, _SLIP].astype(float), worlds.observation[:, _SINKAGE].astype(float),
            state["idle_time"].copy(), criterion.on.astype(float),
        ))  # fmt: skip
        if ground:
            places.append((state["x"].copy(), state["next_halt"].copy()))
    inputs, alive, driving, best, patch, slip, sinkage, idle, paper = (np.array(x) for x in zip(*kept, strict=True))
    least = task.limits.no_progress_distance / task.limits.no_progress_time * task.control.period
    near = driving & (best >= best[-1] - task.limits.no_progress_distance)
    signals = {
        "slip, least of the last second": held_minimum(slip, driving, max(1, round(1.0 / task.control.period))),
        "sinkage": sinkage,
        "time without progress": idle,
        "criterion of the paper": paper,
    }
    return Drives(
        scenario, family, task.control.period, inputs, _ground(worlds, places, alive.shape), alive, driving,
        patch, best, signals, worlds.cause.copy(), _last(driving & (np.diff(best, axis=0, prepend=0.0) >= least)),
        np.argmax(near, axis=0),
    )  # fmt: skip


def _last(flags: np.ndarray) -> np.ndarray:
    """Index of the last True of each column, 0 where there is none."""
    return np.where(flags.any(axis=0), len(flags) - 1 - np.argmax(flags[::-1], axis=0), 0)


def held_minimum(values: np.ndarray, driving: np.ndarray, window: int) -> np.ndarray:
    """Rolling minimum of each column over the last `window` values while driving; between, the last minimum."""
    recent, out = np.full((window, values.shape[1]), -np.inf), np.empty(values.shape)
    for t, now in enumerate(driving):
        recent[:, now] = np.roll(recent[:, now], -1, axis=0)
        recent[-1, now] = values[t, now]
        out[t] = recent.min(axis=0)
    return out


def _ground(worlds: Worlds, places: list, shape: tuple[int, int]) -> np.ndarray:
    """Soil, grade and reserve of the patches `AHEAD` of the wheels, and the way to the next halt."""
    if not places:
        return np.zeros((*shape, 0), dtype=np.float32)
    x, halt = (np.array(p) for p in zip(*places, strict=True))
    courses: Courses = worlds.courses
    soils = courses.soils.copy()
    soils[..., 2:4] = np.log(np.maximum(soils[..., 2:4], 1e-6))
    wheel, parts = np.arange(shape[1])[None], [np.clip(halt - x, -0.1, 1.0)[..., None]]
    for way in AHEAD:
        patch = sum((x + way >= edge).astype(int) for edge in courses.edges[:, 1:].T)
        patch = np.minimum(patch, courses.patches - 1)
        parts.append(soils[wheel, patch])
        parts += [courses.grades[wheel, patch][..., None], courses.margins[wheel, patch][..., None]]
    return np.concatenate(parts, axis=-1).astype(np.float32)
