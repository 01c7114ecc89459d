"""The stock learners of `benchmarks.first_training`, each as its own documentation starts it, with nothing set."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import runpy
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import gymnasium
import numpy as np

import soil_env  # noqa: F401  registers SoilWheel-v0
from benchmarks.common import ROOT
from soil_env._io.loading import ParameterError
from soil_env.parameters import Scenario
from soil_env.simulation.task import LINES, layout
from soil_env.simulation.task.scaling import Scaling

CLEANRL = "cleanrl.ppo_continuous_action"
SKRL_WHEELS = 64
#: (scenario, observation, steps, seed) -> actions [n, 1] of observations [n, D], scaled as the environment scales them
Train = Callable[[Scenario, str, int, int], Callable[[np.ndarray], np.ndarray]]


class Trained:
    """The deterministic policy of a learner, for `run_courses`, whose observations are in their units.

    Counts which line it takes where there is one to choose.
    """

    def __init__(self, act: Callable[[np.ndarray], np.ndarray], variant: str, scaling: Scaling):
        self.act, self.variant, self.scaling = act, variant, scaling
        self.names = [entry.name for entry in scaling.entries]
        self.before = np.empty((0, len(self.names)))
        self.choices = self.beside = self.larger = 0

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """Actions [n, 1]."""
        actions = self.act(self.scaling(observation))
        if "choice" in self.names:
            self._count(observation, np.reshape(actions, -1) < 0.0)
        return actions, state

    def _count(self, observation: np.ndarray, beside: np.ndarray) -> None:
        choosing = observation[:, self.names.index("choice")] > 0.5
        if self.before.shape == observation.shape:
            choosing &= (observation != self.before).any(axis=1)  # rows of ended courses stay as they are
        self.before = observation.copy()
        self.choices += int(choosing.sum())
        self.beside += int((choosing & beside).sum())
        if "ahead_margin" in self.names:
            ahead, other = (observation[:, self.names.index(f"{line}_margin")] for line in LINES)
            self.larger += int((choosing & (beside == (other > ahead))).sum())

    def lines(self) -> str:
        """What it chose, in words."""
        if not self.choices:
            return ""
        better = f", that of the larger margin {100.0 * self.larger / self.choices:.0f} %"
        return f"; line beside {100.0 * self.beside / self.choices:.0f} % of the time" + better * (
            "ahead_margin" in self.names
        )


def trained(name: str, scenario: Scenario, observation: str, steps: int, seed: int) -> Trained:
    """A stock learner after `steps` steps."""
    act = learner(name)(scenario, observation, steps, seed)
    return Trained(act, observation, Scaling(layout(observation, scenario.course)))


def learner(name: str) -> Train:
    """The training of a learner by its name; ParameterError if there is none, or its library is not installed."""
    library, _, algorithm = name.partition(".")
    if name not in ("cleanrl.PPO", "skrl.PPO") and library not in ("sb3", "sbx"):
        raise ParameterError(
            f"learner {name!r}: expected 'constant', 'cleanrl.PPO', 'skrl.PPO', or sb3 or sbx, a dot and a class"
        )
    module = {"sb3": "stable_baselines3", "cleanrl": CLEANRL}.get(library, library)
    try:
        if importlib.util.find_spec(module) is None:
            raise ModuleNotFoundError(f"no module {module}")
        if library == "cleanrl":
            return cleanrl_ppo
        if library == "skrl":
            return skrl_ppo
        return stable_baselines(getattr(importlib.import_module(module), algorithm))
    except ModuleNotFoundError as error:
        raise ParameterError(f"learner {name!r}: {error}") from None
    except AttributeError:
        raise ParameterError(f"learner {name!r}: {module} has no {algorithm!r}") from None


def shown(page: str) -> tuple[Trained, int]:
    """The agent that the one Python block of docs/`page` with a training leaves as `model`, and its steps."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    (block,) = (b for b in re.findall(r"^```python\n(.*?)^```", text, re.M | re.S) if "model.learn(" in b)
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "block.py"
        script.write_text(block, encoding="utf-8")
        model = runpy.run_path(str(script))["model"]
    envs = model.get_env()
    act = lambda rows: model.predict(rows, deterministic=True)[0]  # noqa: E731
    return Trained(act, envs.observation_variant, envs.scaling), model.num_timesteps


def stable_baselines(algorithm) -> Train:
    """Stable-Baselines3, or SBX: `algorithm("MlpPolicy", env)`."""

    def train(scenario: Scenario, observation: str, steps: int, seed: int):
        env = gymnasium.make("SoilWheel-v0", scenario=scenario, observation=observation, info="short")
        model = algorithm("MlpPolicy", env, seed=seed)
        model.learn(steps)
        return lambda rows: model.predict(rows, deterministic=True)[0]

    return train


def skrl_ppo(scenario: Scenario, observation: str, steps: int, seed: int):
    """skrl's PPO with its default configuration on the native vector environment of 64 wheels.

    skrl has no default networks; two hidden layers of 64 units, as in its own examples for Gymnasium.
    """
    import torch
    from skrl.agents.torch.ppo import PPO, PPO_CFG
    from skrl.envs.wrappers.torch import wrap_env
    from skrl.memories.torch import RandomMemory
    from skrl.trainers.torch import SequentialTrainer
    from skrl.utils import set_seed
    from skrl.utils.model_instantiators.torch import deterministic_model, gaussian_model

    set_seed(seed)
    vector = gymnasium.make_vec(
        "SoilWheel-v0", SKRL_WHEELS, "vector_entry_point", autoreset_mode="SameStep",
        scenario=scenario, observation=observation,
    )  # fmt: skip
    env = wrap_env(vector, wrapper="gymnasium")
    network = [{"name": "net", "input": "OBSERVATIONS", "layers": [64, 64], "activations": "relu"}]
    given = {"observation_space": env.observation_space, "action_space": env.action_space, "device": env.device}
    models = {
        "policy": gaussian_model(**given, network=network, output="ACTIONS"),
        "value": deterministic_model(**given, network=network, output="ONE"),
    }
    with tempfile.TemporaryDirectory() as folder:
        files = {"directory": folder, "write_interval": 0, "checkpoint_interval": 0}
        config = PPO_CFG(experiment=files)
        memory = RandomMemory(memory_size=config.rollouts, num_envs=env.num_envs, device=env.device)
        agent = PPO(models=models, memory=memory, cfg=config, **given)
        timesteps = {"timesteps": steps // SKRL_WHEELS, "headless": True, "disable_progressbar": True}
        SequentialTrainer(env=env, agents=agent, cfg=timesteps).train()
    policy = models["policy"]

    def act(rows: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            _, outputs = policy.act({"observations": torch.as_tensor(rows, dtype=torch.float32)}, role="policy")
        return outputs["mean_actions"].numpy()

    return act


def cleanrl_ppo(scenario: Scenario, observation: str, steps: int, seed: int):
    """CleanRL's ppo_continuous_action.py, the file itself, under the Gymnasium it was written for: `as_before_1_0`."""
    import torch

    options = {"env-id": "FirstTraining-v0", "total-timesteps": steps, "seed": seed}
    gymnasium.register(
        options["env-id"], "soil_env.env:SoilWheelEnv",
        kwargs={"scenario": scenario, "observation": observation, "info": "short"},
    )  # fmt: skip
    arguments, here = sys.argv, os.getcwd()
    with tempfile.TemporaryDirectory() as folder, as_before_1_0(), open(os.devnull, "w", encoding="utf-8") as null:
        try:
            os.chdir(folder)  # the file writes runs/
            sys.argv = [CLEANRL, *(f"--{key}={value}" for key, value in options.items())]
            with contextlib.redirect_stdout(null):
                left = runpy.run_module(CLEANRL, run_name="__main__")
        finally:
            os.chdir(here)
            sys.argv = arguments
            del gymnasium.registry[options["env-id"]]
    agent, env = left["agent"], left["envs"].envs[0]
    while not isinstance(env, gymnasium.wrappers.NormalizeObservation):
        env = env.env
    seen = env.obs_rms

    def act(rows: np.ndarray) -> np.ndarray:
        rows = np.clip((rows - seen.mean) / np.sqrt(seen.var + env.epsilon), -10.0, 10.0)
        with torch.no_grad():
            return agent.actor_mean(torch.as_tensor(rows, dtype=torch.float32)).clamp(-1.0, 1.0).numpy()

    return act


@contextlib.contextmanager
def as_before_1_0() -> Iterator[None]:
    """What Gymnasium before 1.0 did and CleanRL 1.2 relies on.

    `TransformObservation` keeps the observation space where none is given, and vector environments are reset within
    the step that ends an episode. That step's infos do without `final_info`, whose shape has changed; the file only
    prints it.
    """
    vector, transform = gymnasium.vector.SyncVectorEnv, gymnasium.wrappers.TransformObservation

    class SameStep(vector):  # type: ignore[misc, valid-type]
        def __init__(self, makers):
            super().__init__(makers, autoreset_mode=gymnasium.vector.AutoresetMode.SAME_STEP)

        def step(self, actions):
            *seen, infos = super().step(actions)
            return *seen, {key: value for key, value in infos.items() if key != "final_info"}

    gymnasium.vector.SyncVectorEnv = SameStep
    gymnasium.wrappers.TransformObservation = lambda env, f: transform(env, f, env.observation_space)
    try:
        yield
    finally:
        gymnasium.vector.SyncVectorEnv, gymnasium.wrappers.TransformObservation = vector, transform
