"""The native vector environments as Stable-Baselines3 `VecEnv`s."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from .cli import lacks_training

try:
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError as error:
    if not lacks_training(error):
        raise
    said = f"{__name__} needs Stable-Baselines3: pip install 'soil_env[train]'"
    raise ModuleNotFoundError(said, name=error.name) from None

from soil_env.course_env import actions_of, check_count
from soil_env.driving.rovers import RoverSimulation
from soil_env.driving.wheels import STEP, Simulation
from soil_env.env import action_space, build_scenario
from soil_env.parameters import DEFAULT_SCENARIO
from soil_env.rover_env import build_rover, rover_action_space
from soil_env.simulation.rover.task import rover_layout
from soil_env.simulation.task import Cause, layout, truth
from soil_env.simulation.task.scaling import Scaling
from soil_env.terramechanics.model import load_model
from soil_env.vehicle import DEFAULT_ROVER

#: Keywords that are no part of a scenario.
_OWN = ("num_envs", "scenario", "observation", "action", "repeat", "threads", "model", "scaled")
_OWN_OF_ROVER = ("num_envs", "rover", "observation", "action", "repeat", "threads", "model", "scaled")
_RUNNING = Cause.RUNNING.value


class NativeVecEnv(VecEnv):
    """Base: courses that are stepped in one call, so that none is an object of its own."""

    render_mode = None

    def owners(self, indices=None) -> list[VecEnv]:
        """The object that has the attributes of each of these courses."""
        return [self for _ in self._get_indices(indices)]

    def close(self) -> None:
        """Nothing to release."""

    def get_attr(self, attr_name: str, indices=None) -> list[Any]:
        """The attribute of each course."""
        return [getattr(owner, attr_name) for owner in self.owners(indices)]

    def set_attr(self, attr_name: str, value: Any, indices=None) -> None:
        """Set an attribute; courses share it."""
        for owner in dict.fromkeys(self.owners(indices)):
            setattr(owner, attr_name, value)

    def env_method(self, method_name: str, *args, indices=None, **kwargs) -> list[Any]:
        """Call a method once for all courses that share it; the result for each course."""
        owners = self.owners(indices)
        found = {owner: getattr(owner, method_name)(*args, **kwargs) for owner in dict.fromkeys(owners)}
        return [found[owner] for owner in owners]

    def env_is_wrapped(self, wrapper_class, indices=None) -> list[bool]:
        """Single courses are never wrapped."""
        return [False for _ in self._get_indices(indices)]


class CourseVecEnv(NativeVecEnv):
    """Base: many courses for SB3, a finished one reset within the same step, as SB3 expects.

    Infos of finished courses carry `terminal_observation`, `TimeLimit.truncated` (False: the time limit of the scenario
    ends an episode as being stuck does), `episode` {r, l, t} and `cause`; all others share one empty dict, which must
    not be written to. A subclass makes `simulation`.
    """

    def __init__(self, num_envs, threads, scenario, observation, scaling, actions, model):
        check_count("num_envs", num_envs)
        if threads is not None:
            check_count("threads", threads)
        num_envs = int(num_envs)
        self.scenario, self.scaling = scenario, scaling
        super().__init__(num_envs, scaling.space, actions)
        self.observation_variant = observation
        self.observation_names = tuple(e.name for e in scaling.entries)
        self.model = load_model(model)
        self._commands = np.zeros((num_envs, *actions.shape))
        self._drive = np.full(num_envs, STEP)
        self._all = np.ones(num_envs, dtype=np.bool_)
        self._returns = np.zeros(num_envs)
        self._lengths = np.zeros(num_envs, dtype=np.int64)
        self._start = time.time()
        self._unseeded = True

    def reset(self) -> np.ndarray:
        """New courses; follows the seeds set by `seed`, else fresh entropy."""
        if self._unseeded:
            seeds = self._seeds if self._seeds[0] is not None else [None] * self.num_envs
            for k in range(self.num_envs):
                self.simulation.seed(k, np.random.default_rng(seeds[k]))
            self._unseeded = False
        self._reset_seeds()
        self.simulation.restart_where(self._all)
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return self._seen()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed course k with seed + k, from the next reset on."""
        self._unseeded = True
        return super().seed(seed)

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions [num_envs, ...]; NaN raises ValueError."""
        self._commands[:] = actions_of(actions, self._commands.shape)

    def step_wait(self):
        """One action; (observations, rewards, dones, infos)."""
        worlds = self.simulation.worlds
        self._step(self._commands)
        self._returns += worlds.reward
        self._lengths += 1
        rewards, done = worlds.reward.astype(np.float32), worlds.cause != _RUNNING
        infos: list[dict[str, Any]] = [{}] * self.num_envs
        if done.any():
            now, last = round(time.time() - self._start, 6), self._seen()
            for k in np.flatnonzero(done):
                infos[k] = {
                    "terminal_observation": last[k],
                    "TimeLimit.truncated": False,
                    "episode": {"r": float(self._returns[k]), "l": int(self._lengths[k]), "t": now},
                    "cause": Cause(worlds.cause[k]).name,
                }
            self.simulation.restart_where(done)
            self._returns[done] = 0.0
            self._lengths[done] = 0
        return self._seen(), rewards, done, infos

    def _seen(self) -> np.ndarray:
        """Observations."""
        return self.scaling(self.simulation.worlds.observation)


class SoilWheelVecEnv(CourseVecEnv):
    """`num_envs` wheels; keyword arguments as in `SoilWheelEnv`."""

    def __init__(
        self, num_envs: int, scenario=DEFAULT_SCENARIO, observation="identified", action=None, repeat=None,
        threads=None, model=None, scaled=True, **changes,
    ):  # fmt: skip
        scenario = build_scenario(scenario, action, repeat, changes, _OWN)
        scaling = Scaling(layout(observation, scenario.course), scaled)
        super().__init__(num_envs, threads, scenario, observation, scaling, action_space(), model)
        self.simulation = Simulation(self.num_envs, scenario, observation, threads=threads, model=self.model)

    def _step(self, commands: np.ndarray) -> None:
        self.simulation.step_all(commands[:, 0], self._drive)

    def true_soil(self) -> np.ndarray:
        """Observations of the variant `true_soil` now, in its units [num_envs, D]."""
        names = [e.name for e in layout(self.observation_variant, self.scenario.course)]
        own = dict(zip(names, self.simulation.worlds.observation.T, strict=True))
        own |= zip((e.name for e in truth(self.scenario.course)), self.simulation.true_soils().T, strict=True)
        return np.column_stack([own[e.name] for e in layout("true_soil", self.scenario.course)])


class SoilRoverVecEnv(CourseVecEnv):
    """`num_envs` rovers; keyword arguments as in `SoilRoverEnv`."""

    def __init__(
        self, num_envs: int, rover=DEFAULT_ROVER, observation="identified", action=None, repeat=None, threads=None,
        model=None, scaled=True, **changes,
    ):  # fmt: skip
        scenario = build_rover(rover, action, repeat, changes, _OWN_OF_ROVER)
        scaling = Scaling(rover_layout(observation, scenario.axles), scaled)
        actions = rover_action_space(scenario.axles)
        super().__init__(num_envs, threads, scenario, observation, scaling, actions, model)
        self.simulation = RoverSimulation(self.num_envs, scenario, observation, threads, self.model)

    def _step(self, commands: np.ndarray) -> None:
        self.simulation.step_all(commands, self._drive)

    def true_soil(self) -> np.ndarray:
        """Observations of the variant `true_soil` now, in its units [num_envs, D]."""
        return self.simulation.true_soil()
