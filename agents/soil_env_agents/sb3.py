"""The native vector environments as Stable-Baselines3 `VecEnv`s."""

import time
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from soil_env._io.loading import ParameterError
from soil_env.envs.rover_env import SoilRoverVectorEnv
from soil_env.envs.rovers import RoverSimulation
from soil_env.envs.wheel_env import SoilWheelVectorEnv
from soil_env.envs.wheels import Simulation
from soil_env.simulation.task import Cause, layout, truth

# Keywords that `CourseVecEnv` makes its environment with; a user may not give them.
_OWN = {"autoreset_mode": AutoresetMode.DISABLED, "info": "none"}


class NativeVecEnv(VecEnv):
    """Base: a `VecEnv` of courses that are stepped in one call; no course is an object of its own.

    So attributes and methods of a course are those of the vector environment that has it.
    """

    render_mode = None

    def owners(self, indices) -> list[VecEnv]:
        """For each of these courses the vector environment that has its attributes."""
        own: list[VecEnv] = [self] * self.num_envs
        return [own[k] for k in self._get_indices(indices)]

    def set_options(self, options=None) -> None:
        """Refuse options of a reset, of which a course has none."""
        super().set_options(options)
        if any(self._options):
            raise ParameterError(
                f"reset options = {options!r:.80}: expected none; scenarios are set when the "
                "environment is made"
            )

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
        found = {
            owner: getattr(owner, method_name)(*args, **kwargs) for owner in dict.fromkeys(owners)
        }
        return [found[owner] for owner in owners]

    def env_is_wrapped(self, wrapper_class, indices=None) -> list[bool]:
        """Single courses are never wrapped."""
        return [False for _ in self.owners(indices)]


class CourseVecEnv(NativeVecEnv):
    """Base: a vector environment of many courses for SB3, a finished one reset within the same
    step, as SB3 expects.

    Infos of finished courses carry `terminal_observation`, `TimeLimit.truncated`, `episode` {r, l,
    t} and `cause`; all others share one empty dict, which must not be written to. The time limit of
    the scenario terminates an episode, as being stuck does; `TimeLimit.truncated` is True only
    where `max_episode_steps` or a wrapper of `env` truncates.

    `kind` makes the environment; `task`, its scenario or rover and the observation, and the
    `options` are its arguments.
    """

    kind: type[Any]

    def __init__(self, num_envs: int = 1, *task: Any, **options: Any):
        for name, value in _OWN.items():
            if name in options:
                raise ParameterError(
                    f"{name} = {options[name]!r:.60}: expected none: {type(self).__name__} sets "
                    f"{value!r}, as Stable-Baselines3 needs it"
                )
        env = self.kind(num_envs, *task, **_OWN, **options)
        self.env: Any = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.model = env.model
        self.scenario = env.scenario
        self.simulation = env.simulation
        self.observation_names = env.observation_names
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, dtype=np.int64)
        self._start = time.time()
        self._actions: np.ndarray | None = None
        self._begun = False  # there are courses

    @property
    def scaling(self):
        """Scaling of the observations."""
        return self.env.unwrapped.scaling

    def reset(self) -> np.ndarray:
        """New courses; follows the seeds set by `seed`, else goes on."""
        seen, _ = self.env.reset(seed=self._seeds)
        self._reset_seeds()
        self._begun = True
        self._actions = None
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return seen

    def true_soil(self) -> np.ndarray:
        """Observations of the variant `true_soil` now, in its units [num_envs, D]; ResetNeeded
        before the first reset.
        """
        if not self._begun:
            raise ResetNeeded("true_soil() before reset()")
        return self._true_soil()

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions [num_envs, ...]."""
        self._actions = actions

    def step_wait(self):
        """Carry out the actions of `step_async`; (observations, rewards, dones, infos).

        Courses that ended are reset: their observation is the first of a new course, their last one
        is in their info. ResetNeeded without `step_async`; ValueError for an action that is not
        finite.
        """
        if self._actions is None:
            raise ResetNeeded("step_wait() before step_async(actions)")
        seen, rewards, terminated, truncated, _ = self.env.step(self._actions)
        self._actions = None
        done = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [{}] * self.num_envs
        if done.any():
            now = round(time.time() - self._start, 6)
            for k in np.flatnonzero(done):
                infos[k] = {
                    "terminal_observation": seen[k],
                    "TimeLimit.truncated": bool(truncated[k] and not terminated[k]),
                    "episode": {"r": float(self._returns[k]), "l": int(self._lengths[k]), "t": now},
                    "cause": Cause(self.simulation.worlds.cause[k]).name,
                }
            seen, _ = self.env.reset(options={"reset_mask": done})
            self._returns[done] = 0.0
            self._lengths[done] = 0
        return seen, rewards.astype(np.float32), done, infos


class SoilWheelVecEnv(CourseVecEnv):
    """`num_envs` wheels; arguments as in `SoilWheelVectorEnv`."""

    kind = SoilWheelVectorEnv
    simulation: Simulation

    def _true_soil(self):
        """The entries that are observed, and those of the true soil, in the order of the layout
        `true_soil`.
        """
        observed = self.simulation.worlds.observation
        own = dict(zip(self.env.unwrapped.observation_names, observed.T, strict=True))
        own |= zip(
            (e.name for e in truth(self.scenario.course)),
            self.simulation.true_soils().T,
            strict=True,
        )
        return np.column_stack([own[e.name] for e in layout("true_soil", self.scenario.course)])


class SoilRoverVecEnv(CourseVecEnv):
    """`num_envs` rovers; arguments as in `SoilRoverVectorEnv`."""

    kind = SoilRoverVectorEnv
    simulation: RoverSimulation

    def _true_soil(self):
        """The observation `true_soil` of the rovers, which the simulation makes."""
        return self.simulation.true_soil()
