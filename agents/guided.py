"""Agents that trim the rim speed of a slip controller instead of setting a torque.

The guide, a controller of `agents.controllers`, proposes a rim speed; the agent's action a in [-1, 1] multiplies it by
exp(trim a), and the guide's own speed loop turns the product into a command. An untrained agent (a = 0) drives as its
guide, so that learning starts from a controller that gets through most courses, and exploration varies a speed by some
tenths instead of jerking a torque (residual policy learning: Silver et al. 2018, arXiv:1812.06298; Johannink et al.
2019, ICRA 6023). The guide reads the same observation as the agent and knows no more than it. The agent's observation
has two further entries: the proposed rim speed [of the top rim speed] and the slip that the guide holds.
"""

from __future__ import annotations

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from soil_env._io.loading import ParameterError
from soil_env.parameters import Scenario

from .config import TrainConfig
from .controllers import CONTROLLERS, FixedSlip, checked_settings, make_controller

ENTRIES = ("guide_rim_speed", "guide_slip")
GUIDES = tuple(name for name, cls in CONTROLLERS.items() if issubclass(cls, FixedSlip))


def check_guide(controller: str, variant: str) -> None:
    """ParameterError unless a controller can guide an agent that reads the observation `variant`."""
    if controller not in GUIDES:
        raise ParameterError(f"guide = {controller!r}: expected one of {', '.join(GUIDES)}")
    if CONTROLLERS[controller].variant not in ("blind", variant):
        raise ParameterError(f"guide = {controller!r}: does not read the observation {variant!r}")


class Guide:
    """The controller with its settings, and how far it may be trimmed; keeps nothing between calls."""

    def __init__(self, scenario: Scenario, controller: str, settings: dict, trim: float, variant: str):
        check_guide(controller, variant)
        self.controller = make_controller(controller, scenario, **settings)
        self.settings, self.trim = settings, trim

    def content(self) -> dict:
        """Metadata for the agent's zip."""
        return {"controller": self.controller.name, "settings": self.settings, "trim": self.trim}

    def observe(self, observation: np.ndarray, state: dict | None, fresh: np.ndarray) -> tuple[np.ndarray, dict]:
        """(observation [n, D + 2] float32, the guide's state) for observations [n, D]; `fresh` [n]: new courses."""
        c, batch = self.controller, np.asarray(observation, dtype=np.float64)
        state = c._begin(batch, None if state is None else state["memory"], fresh)
        target = c.rim_speed(batch, state)
        own = np.stack([target / c.top_speed, c.target_slip(batch, state)], axis=1)
        out = np.concatenate([observation, own], axis=1).astype(np.float32)
        return out, {"memory": state, "batch": batch, "target": target}

    def act(self, actions: np.ndarray, state: dict) -> np.ndarray:
        """Commands [n, 1] float32 for the agent's actions [n, 1] on what was observed last; advances `state`."""
        speed = self.trimmed(np.asarray(actions, dtype=np.float64)[:, 0], state["target"])
        return self.controller.command(state["batch"], speed, state["memory"])

    def trimmed(self, actions: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Rim speed [m/s] for the agent's actions [n] on the proposed one [n] m/s."""
        return np.minimum(target * np.exp(self.trim * np.clip(actions, -1.0, 1.0)), self.controller.top_speed)


def make_guide(config: TrainConfig, scenario: Scenario) -> Guide | None:
    """The controller whose rim speed an agent trims, if there is one; ParameterError where it cannot be made."""
    if not config.guide:
        return None
    settings = checked_settings(config.guide, scenario, config.guide_settings, "guide_settings")
    return Guide(scenario, config.guide, settings, config.trim, config.observation)


def spaces_of(box: spaces.Box) -> tuple[spaces.Box, spaces.Box]:
    """(observation, action) space of a guided agent on an environment with the observation space `box`."""
    wide = np.full(len(ENTRIES), 10.0, dtype=np.float32)
    seen = spaces.Box(np.concatenate([box.low, -wide]), np.concatenate([box.high, wide]), dtype=np.float32)
    return seen, spaces.Box(-1.0, 1.0, (1,), np.float32)


class GuidedVecEnv(VecEnvWrapper):
    """A vector environment whose actions trim a guide, and whose observation has the guide's entries."""

    def __init__(self, venv: VecEnv, guide: Guide):
        super().__init__(venv, *spaces_of(venv.observation_space))
        self.guide, self._state = guide, None

    def reset(self) -> np.ndarray:
        """New courses for all wheels."""
        out, self._state = self.guide.observe(self.venv.reset(), None, np.ones(self.num_envs, dtype=bool))
        return out

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions [num_envs, 1]."""
        self.venv.step_async(self.guide.act(actions, self._state))

    def step_wait(self):
        """One control period; (observations, rewards, dones, infos)."""
        observation, rewards, dones, infos = self.venv.step_wait()
        ended = np.flatnonzero(dones)
        if ended.size:  # the last observation of a course with what the guide would have proposed
            last = np.array([infos[k]["terminal_observation"] for k in ended])
            memory = {name: values[ended] for name, values in self._state["memory"].items()}
            last, _ = self.guide.observe(last, {"memory": memory}, np.zeros(ended.size, dtype=bool))
            for k, row in zip(ended, last, strict=True):
                infos[k]["terminal_observation"] = row
        out, self._state = self.guide.observe(observation, self._state, dones)
        return out, rewards, dones, infos
