"""PPO of Stable-Baselines3 on the native environments: build, save and resume an agent in training."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize

from soil_env._io.files import replace_file
from soil_env._io.loading import ParameterError, to_dict
from soil_env.parameters import Scenario
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.vehicle import RoverScenario

from .agent import INFO, OPTIMIZER, WEIGHTS, Info, contrib, load_weights, network, read_info
from .config import PPOConfig
from .history import History, HistoryVecEnv
from .sb3 import CourseVecEnv, SoilRoverVecEnv, SoilWheelVecEnv
from .worlds import SeveralWorlds

#: Effects that are on in the worlds of a training: none, those of a model, or of several on equal shares of the wheels.
World = WheelSoilModel | None | Sequence[WheelSoilModel | None]
_SAME = ("n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range", "ent_coef")  # named as in SB3


def build(
    scenario: Scenario | RoverScenario,
    observation: str,
    config: PPOConfig,
    seed: int,
    tensorboard: Path | None = None,
    world: World = None,
    algorithm: str = "ppo",
) -> PPO:
    """A fresh agent with its normalised vector environment; `algorithm` as in `TrainConfig`."""
    torch.set_num_threads(1)  # the tensors are too small to be shared out
    policy, arguments = network(algorithm, config, scenario)
    model = (contrib() if algorithm == "recurrent_ppo" else PPO)(
        policy,
        normalised(scenario, observation, config, seed, world),
        learning_rate=schedule(config),
        **{name: getattr(config, name) for name in _SAME},
        policy_kwargs=arguments,
        tensorboard_log=None if tensorboard is None else str(tensorboard),
        seed=seed,
        device="cpu",
    )
    with torch.no_grad():  # exploring around full stop would teach little but how to stall
        model.policy.action_net.bias.fill_(config.initial_action)
    model.origin = {"algorithm": algorithm, "observation": observation, "ppo": to_dict(config)}
    return model


def normalised(
    scenario: Scenario | RoverScenario, observation: str, config: PPOConfig, seed: int, world: World = None
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


def _courses(count: int, scenario, observation: str, config: PPOConfig, world) -> CourseVecEnv:
    """The vector environment of `count` wheels or rovers."""
    if isinstance(scenario, RoverScenario):
        return SoilRoverVecEnv(count, scenario, observation, threads=config.threads, model=world)
    return SoilWheelVecEnv(count, scenario, observation, threads=config.threads, model=world, critic=config.critic)


def schedule(config: PPOConfig) -> Callable[[float], float]:
    """Learning rate as a function of the share of the training that is left."""
    rate = config.learning_rate
    return lambda left: rate * max(left, 0.05)


def save(model: PPO, path: Path) -> None:
    """Save the agent to `path` (.zip) by an atomic write, with what `resume` needs."""
    env = model.get_vec_normalize_env()
    world = env.get_attr("model")[0]
    info = Info(
        **{**model.origin, "ppo": PPOConfig(**model.origin["ppo"])},
        observation_names=tuple(env.get_attr("observation_names")[0]),
        timesteps=int(model.num_timesteps),
        mean=tuple(env.obs_rms.mean.tolist()),
        var=tuple(env.obs_rms.var.tolist()),
        count=float(env.obs_rms.count),
        return_mean=float(env.ret_rms.mean),
        return_var=float(env.ret_rms.var),
        return_count=float(env.ret_rms.count),
        clip=float(env.clip_obs),
        scenario=to_dict(env.get_attr("scenario")[0]),
        model={} if world is None else world.content(),
    )
    stream = io.BytesIO()
    model.save(stream)
    with zipfile.ZipFile(stream, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(INFO, json.dumps(to_dict(info), indent=1))
    replace_file(path, stream.getvalue())


def resume(
    path: Path,
    scenario: Scenario | RoverScenario,
    observation: str,
    config: PPOConfig,
    seed: int,
    tensorboard: Path | None,
    world: World = None,
    algorithm: str = "ppo",
) -> PPO:
    """The agent of a checkpoint, ready to go on learning on new courses; arguments as of `build`."""
    info = read_info(path)
    for key, stored, asked in (
        ("observation", info.observation, observation),
        ("algorithm", info.algorithm, algorithm),
        *((key, getattr(info.ppo, key), getattr(config, key)) for key in ("history", "critic", "layer", "activation")),
    ):
        if stored != asked:
            raise ParameterError(f"{path}: trained with {key} {stored!r}, not {asked!r}")
    seed = (seed + info.timesteps) % 2**31  # other courses and other noise than at the start of the run
    model = build(scenario, observation, config, seed, tensorboard, world, algorithm)
    load_weights(path, WEIGHTS, model.policy)
    load_weights(path, OPTIMIZER, model.policy.optimizer)
    model.num_timesteps = info.timesteps
    env = model.get_vec_normalize_env()
    env.obs_rms = _running(info.mean, info.var, info.count)
    env.ret_rms = _running(info.return_mean, info.return_var, info.return_count)
    return model


def _running(mean, var, count) -> RunningMeanStd:
    out = RunningMeanStd(shape=np.shape(mean))
    out.mean, out.var, out.count = np.asarray(mean, dtype=np.float64), np.asarray(var, dtype=np.float64), count
    return out
