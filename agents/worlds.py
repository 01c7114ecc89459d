"""Training in several worlds side by side, some with effects that the model of the identifier does not have."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from soil_env.parameters import Scenario
from soil_env.terramechanics.effects import CATALOGUE
from soil_env.terramechanics.effects.entry import Effect, EffectParameter
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

#: Effects that act in the simulated world on a course driven once; the others need a measuring rig or a second pass.
HIDDEN = (
    "rear_contact", "stress_peak_shift", "grousers", "bulldozing", "penetration_rate", "shear_rate", "shear_softening",
)  # fmt: skip
_HEIGHT = 0.07  # of lugs, as a share of the radius


def hidden_worlds(scenario: Scenario, count: int, seed: int) -> list[WheelSoilModel]:
    """`count` worlds with one effect of the catalogue each, its published form and its size drawn by `seed`.

    Sizes are drawn from the prior of the catalogue, cut at one standard deviation, so that most are of the size of the
    disagreement between published laws.
    """
    rng = np.random.default_rng([seed, count, 7])
    return [_drawn(scenario, CATALOGUE[HIDDEN[k % len(HIDDEN)]], rng) for k in range(count)]


def _drawn(scenario: Scenario, effect: Effect, rng: np.random.Generator) -> WheelSoilModel:
    form = effect.forms[rng.integers(len(effect.forms))]
    values = {name: _size(effect.parameter(name), rng) for name in form.free} | dict(form.fixed)
    wheel, height = scenario.wheel, _HEIGHT * scenario.wheel.radius if effect.name == "grousers" else 0.0
    return WheelSoilModel(ModelWheel(wheel.radius, wheel.width, height), effects={effect.name: values})


def _size(p: EffectParameter, rng: np.random.Generator) -> float:
    share = rng.uniform(-1.0, 1.0)
    if p.centre is not None:
        return float(np.clip(p.centre * np.exp(p.scale * share), p.low, p.high))
    low = max(p.low, p.neutral - p.scale)
    return float(rng.uniform(low, min(p.high, p.neutral + p.scale)))


class SeveralWorlds(VecEnv):
    """Vector environments of one observation and action space as one; their wheels follow each other."""

    def __init__(self, parts: Sequence[VecEnv]):
        self.parts = list(parts)
        first = self.parts[0]
        self.render_mode = None
        super().__init__(sum(p.num_envs for p in self.parts), first.observation_space, first.action_space)
        self._ends = np.cumsum([p.num_envs for p in self.parts])

    def reset(self) -> np.ndarray:
        """New courses for all wheels."""
        return np.concatenate([p.reset() for p in self.parts])

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed wheel k with seed + k, from the next reset on."""
        starts = [0, *self._ends[:-1].tolist()]
        return [s for p, k in zip(self.parts, starts, strict=True) for s in p.seed(None if seed is None else seed + k)]

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions [num_envs, 1]."""
        for part, own in zip(self.parts, np.split(np.asarray(actions), self._ends[:-1]), strict=True):
            part.step_async(own)

    def step_wait(self):
        """One step; (observations, rewards, dones, infos)."""
        observation, rewards, dones, infos = zip(*(p.step_wait() for p in self.parts), strict=True)
        together = [info for some in infos for info in some]
        return np.concatenate(observation), np.concatenate(rewards), np.concatenate(dones), together

    def close(self) -> None:
        """Nothing to release."""

    def get_attr(self, attr_name: str, indices=None) -> list[Any]:
        """The attribute of each wheel."""
        return self._of_each(lambda part: part.get_attr(attr_name), indices)

    def set_attr(self, attr_name: str, value: Any, indices=None) -> None:
        """Set an attribute for all wheels."""
        for part in self.parts:
            part.set_attr(attr_name, value)

    def env_method(self, method_name: str, *args, indices=None, **kwargs) -> list[Any]:
        """Call a method of every part; the result is repeated for each of its wheels."""
        return self._of_each(lambda part: part.env_method(method_name, *args, **kwargs), indices)

    def env_is_wrapped(self, wrapper_class, indices=None) -> list[bool]:
        """Single wheels are never wrapped."""
        return [False] * len(list(self._get_indices(indices)))

    def _of_each(self, value: Callable[[VecEnv], list[Any]], indices) -> list[Any]:
        every = [x for part in self.parts for x in value(part)]
        return [every[k] for k in self._get_indices(indices)]
