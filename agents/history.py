"""Past sensor readings beside the observation: a memory of fixed length for a feed-forward network.

The readings of the last `steps` steps, those that say how the wheel answered the ground, follow the present observation
(as stacked frames follow a picture, Mnih et al. 2015, Nature 518:529; here only of the readings that matter).
"""

from __future__ import annotations

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from soil_env.simulation.task import layout

#: Entries of the observation that are kept. The pitch and what was commanded follow from them or from the observation.
READINGS = ("slip", "sinkage", "drawbar_pull", "load", "torque", "speed", "rim_speed")


class History:
    """Which entries of an observation are kept, and for how many steps; keeps nothing itself."""

    def __init__(self, variant: str, steps: int):
        names = [entry.name for entry in layout(variant)]
        self.steps, self.entries = steps, len(names)
        self.columns = [names.index(name) for name in READINGS]
        self.size = steps * len(self.columns)  # numbers that come to the observation

    @property
    def kept(self) -> int:
        """Numbers that are kept from one step to the next for each wheel: the present readings, then the past ones."""
        return self.size + len(self.columns)

    def observe(self, seen, kept, fresh, others: int = 0):
        """(observation with its history, what to keep for the next step) for observations [n, D + others].

        The history comes after the D entries of the layout and before the others, newest step first. On a new course,
        `fresh` [n] bool, the present readings stand in for the past, whatever `kept` [n, self.kept] holds. All are
        arrays, or values of an ONNX graph (`agents.export`).
        """
        m, entries = len(self.columns), list(range(self.entries))
        rest = list(range(self.entries, self.entries + others))
        moved = np.concatenate([seen[:, self.columns], kept[:, list(range(self.size))]], axis=1)
        kept = np.where(fresh[:, None], seen[:, self.columns * (self.steps + 1)], moved)
        past = kept[:, list(range(m, m + self.size))]
        return np.concatenate([seen[:, entries], past, *([seen[:, rest]] if others else [])], axis=1), kept

    def space(self, box: spaces.Box) -> spaces.Box:
        """Observation space with the history in the place where `observe` puts it."""
        bounds = []
        for side in (box.low, box.high):
            own = side[self.columns]
            bounds.append(np.concatenate([side[: self.entries], np.tile(own, self.steps), side[self.entries :]]))
        return spaces.Box(*bounds, dtype=np.float32)


class HistoryVecEnv(VecEnvWrapper):
    """A vector environment whose observation has a history."""

    def __init__(self, venv: VecEnv, history: History):
        super().__init__(venv, history.space(venv.observation_space))
        self.history = history
        self._others = venv.observation_space.shape[0] - history.entries
        self.kept = np.zeros((self.num_envs, history.kept), dtype=np.float32)

    def reset(self) -> np.ndarray:
        """New courses for all wheels."""
        out, self.kept[:] = self.history.observe(
            self.venv.reset(), self.kept, np.ones(self.num_envs, dtype=bool), self._others
        )
        return out

    def step_wait(self):
        """One step; (observations, rewards, dones, infos)."""
        observation, rewards, dones, infos = self.venv.step_wait()
        ended = np.flatnonzero(dones)
        if ended.size:
            last = np.array([infos[k]["terminal_observation"] for k in ended])
            last, _ = self.history.observe(last, self.kept[ended], np.zeros(ended.size, dtype=bool), self._others)
            for k, row in zip(ended, last, strict=True):
                infos[k]["terminal_observation"] = row
        out, self.kept[:] = self.history.observe(observation, self.kept, dones, self._others)
        return out, rewards, dones, infos
