"""PPO agents (Stable-Baselines3): build, save and resume, with their observation normalisation; `trained` loads them.

A saved agent is one zip in SB3's own format with a further member, soil_env.json, which holds the
running mean and variance of the observations, the names of the observation layout and the resolved scenario. It is
loaded without unpickling anything (`agents.zips`); SB3's own `PPO.load` would unpickle parts of it.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from soil_env._io.files import replace_file
from soil_env._io.loading import ParameterError, to_dict
from soil_env.parameters import Scenario
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.vehicle import RoverScenario

from . import checkpoint, recurrent, zips
from .asymmetric import AsymmetricPolicy
from .config import NAMES, PPOConfig, TrainConfig, load_config
from .history import History, HistoryVecEnv
from .learner import Learner, Tanh
from .sb3 import CourseVecEnv, SoilRoverVecEnv, SoilWheelVecEnv, privileged
from .trained import META, Agent, agent_of, agent_spaces, check_layout, load_agent, read_meta
from .worlds import SeveralWorlds

__all__ = [
    "NAMES", "Agent", "PPOConfig", "TrainConfig", "agent_of", "agent_spaces", "build", "check_layout",
    "hyperparameters", "load_agent", "load_config", "normalised", "read_meta", "reopened", "resume", "save", "schedule",
]  # fmt: skip

#: Effects that are on in the worlds of a training: none, those of a model, or of several on equal shares of the wheels.
World = WheelSoilModel | None | Sequence[WheelSoilModel | None]


def build(
    scenario: Scenario,
    observation: str,
    config: PPOConfig,
    seed: int,
    tensorboard: Path | None = None,
    world: World = None,
    algorithm: str = "ppo",
) -> PPO:
    """A fresh agent with its normalised vector environment.

    `world`: the model whose effects are on there, or several, on equal shares of the wheels. `algorithm`: as in
    `TrainConfig`.
    """
    cls, policy, network = _algorithm(algorithm, config, scenario)
    model = cls(
        policy,
        normalised(scenario, observation, config, seed, world),
        **hyperparameters(config),
        policy_kwargs=network | {"log_std_init": config.log_std_init},
        tensorboard_log=None if tensorboard is None else str(tensorboard),
        seed=seed,
        device="cpu",
    )
    with torch.no_grad():  # exploring around full stop would teach little but how to stall
        model.policy.action_net.bias.fill_(config.initial_action)
    model.update_threads = config.threads
    return model


def _algorithm(name: str, config: PPOConfig, scenario: Scenario) -> tuple[type, str, dict]:
    """(class, name of its policy, arguments of its network)."""
    torch.set_num_threads(1)  # its tensors are too small to be shared out; `Learner` shares out whole minibatches
    if name == "recurrent_ppo":
        return recurrent.algorithm(), "MlpLstmPolicy", recurrent.network(config)
    network = {
        "net_arch": [config.layer, config.layer],
        "activation_fn": {"relu": nn.ReLU, "tanh": Tanh}[config.activation],
        "optimizer_kwargs": {"fused": True},
    }
    if config.critic:
        return Learner, AsymmetricPolicy, network | {"privileged": len(privileged(config.critic, scenario.course))}
    return Learner, "MlpPolicy", network


def hyperparameters(config: PPOConfig) -> dict:
    """Keyword arguments common to PPO and RecurrentPPO."""
    same = ("n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range", "ent_coef")
    return {"learning_rate": schedule(config)} | {name: getattr(config, name) for name in same}


def normalised(
    scenario: Scenario,
    observation: str,
    config: PPOConfig,
    seed: int,
    world: World = None,
) -> VecNormalize:
    """The vector environment of `config.num_envs` wheels with running normalisation of observations and rewards."""
    worlds = list(world) if isinstance(world, Sequence) else [world]
    shares = np.diff(np.linspace(0, config.num_envs, len(worlds) + 1).astype(int))
    parts = [_courses(share, scenario, observation, config, one) for share, one in zip(shares, worlds, strict=True)]
    wheels = parts[0] if len(parts) == 1 else SeveralWorlds(parts)
    if config.history:
        wheels = HistoryVecEnv(wheels, History(parts[0].observation_names, config.history))
    env = VecNormalize(wheels, gamma=config.gamma)
    env.seed(seed)
    return env


def _courses(count: int, scenario: Scenario, observation: str, config: PPOConfig, world) -> CourseVecEnv:
    """The vector environment of `count` wheels or rovers."""
    if isinstance(scenario, RoverScenario):
        if config.critic:
            raise ParameterError(f"ppo.critic = {config.critic!r}: expected none for a rover")
        return SoilRoverVecEnv(count, scenario, observation, threads=config.threads, model=world)
    return SoilWheelVecEnv(count, scenario, observation, threads=config.threads, model=world, critic=config.critic)


def schedule(config: PPOConfig):
    """Learning rate as a function of the share of the training that is left."""
    rate = config.learning_rate

    def learning_rate(left: float) -> float:
        return rate * max(left, 0.05)

    return learning_rate


_STATE = "training.npz"  # member of the zip of a training that goes on


def save(model: PPO, path: Path, between_rollouts: bool = False) -> None:
    """Save the agent to `path` (.zip) by an atomic write.

    `between_rollouts`: keep the state of the training too (`agents.checkpoint`), from which it goes on as if it had
    not been interrupted.
    """
    env = model.get_vec_normalize_env()
    meta = {
        "timesteps": int(model.num_timesteps),
        "observation": env.get_attr("observation_variant")[0],
        "observation_names": list(env.get_attr("observation_names")[0]),
        "mean": env.obs_rms.mean.tolist(),
        "var": env.obs_rms.var.tolist(),
        "count": float(env.obs_rms.count),
        "return_mean": float(env.ret_rms.mean),
        "return_var": float(env.ret_rms.var),
        "return_count": float(env.ret_rms.count),
        "clip": float(env.clip_obs),
        "scenario": to_dict(env.get_attr("scenario")[0]),
        "history": env.venv.history.steps if isinstance(env.venv, HistoryVecEnv) else 0,
        "critic": env.get_attr("critic")[0],
        "scaled": True,
    }
    world = env.get_attr("model")[0]
    if world is not None:
        meta["model"] = world.content()
    stream = io.BytesIO()
    model.save(stream)
    with zipfile.ZipFile(stream, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(META, json.dumps(meta, indent=1))
        if between_rollouts and isinstance(model, Learner):
            archive.writestr(_STATE, checkpoint.content(model))
    replace_file(path, stream.getvalue())


def resume(
    path: Path,
    scenario: Scenario,
    observation: str,
    config: PPOConfig,
    seed: int,
    log: Path | None,
    world: World = None,
    algorithm: str = "ppo",
) -> PPO:
    """The agent of a checkpoint, ready to go on learning; arguments as of `build`.

    Where the checkpoint has the state of the training, it goes on as the run would have; else, as with
    recurrent_ppo, its worlds start new courses.
    """
    cls, _, _ = _algorithm(algorithm, config, scenario)
    meta, env = reopened(path, scenario, observation, config, seed, world)
    rate = schedule(config)
    known = {"learning_rate": rate, "lr_schedule": rate, "clip_range": config.clip_range}
    objects = zips.without_pickles(path, *agent_spaces(meta), **known)
    model = zips.load(cls, path, objects, env=env, tensorboard_log=None if log is None else str(log))
    model.update_threads = config.threads
    model.set_random_seed((seed + meta["timesteps"]) % 2**31)  # loading has set the seed of the start of the run
    state = zips.read_bytes(path, _STATE)
    if state is not None:
        checkpoint.restore(model, state, path)
    return model


def reopened(path: Path, scenario, observation: str, config: PPOConfig, seed: int, world: World):
    """(metadata of a checkpoint, the vector environment with its normalisation)."""
    meta = read_meta(path)
    if meta["observation"] != observation:
        raise ParameterError(f"{path}: trained with observation {meta['observation']!r}, not {observation!r}")
    check_layout(meta, path)
    for key in ("history", "critic"):
        if meta[key] != getattr(config, key):
            raise ParameterError(f"{path}: trained with {key} {meta[key]!r}, not {getattr(config, key)!r}")
    env = normalised(scenario, observation, config, seed, world)
    env.obs_rms = _running(meta["mean"], meta["var"], meta["count"])
    env.ret_rms = _running(meta["return_mean"], meta["return_var"], meta["return_count"])
    return meta, env


def _running(mean, var, count) -> RunningMeanStd:
    out = RunningMeanStd(shape=np.shape(mean))
    out.mean, out.var, out.count = np.asarray(mean, dtype=np.float64), np.asarray(var, dtype=np.float64), count
    return out
