"""PPO of Stable-Baselines3 on the native environments: build, save and resume an agent in
training.
"""

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecNormalize

from soil_env._io.files import replace_file
from soil_env._io.loading import ParameterError, to_dict
from soil_env.parameters import RoverScenario, Scenario
from soil_env.simulation.task import VERSION

from .agent import INFO, OPTIMIZER, WEIGHTS, Info, check_layout, load_weights, network, read_info
from .config import PPOConfig
from .environment import World, normalised

#: Keys of `PPOConfig` that are arguments of SB3's PPO by the same name.
_SAME = ("n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range", "ent_coef")


def build(
    scenario: Scenario | RoverScenario,
    observation: str,
    config: PPOConfig,
    seed: int,
    tensorboard: Path | None = None,
    world: World = None,
) -> PPO:
    """A fresh agent (`learner`) in the vector environment `normalised(scenario, observation,
    config, seed, world)`.

    `tensorboard`: folder of the logs. `save` needs the attribute `origin` that the agent gets here.
    """
    model = learner(
        normalised(scenario, observation, config, seed, world), config, seed, tensorboard
    )
    model.origin = {"observation": observation, "ppo": to_dict(config)}
    return model


def learner(
    env: VecNormalize, config: PPOConfig, seed: int, tensorboard: Path | None = None
) -> PPO:
    """A fresh agent in this vector environment, with the network of `config` (`agent.network`).

    It learns on the CPU, torch on one thread in the whole process. The learning rate falls linearly
    to 5 %. At first the mean action is about `initial_action`, and no route is preferred.
    `tensorboard`: folder of the logs, None: no logs.
    """
    torch.set_num_threads(1)  # the tensors are too small to be shared out
    policy, arguments = network(config, env.get_attr("observation_names")[0])
    model = PPO(
        policy,
        env,
        # SB3 calls it with the share of the training that is left.
        learning_rate=lambda left: config.learning_rate * max(left, 0.05),
        **{name: getattr(config, name) for name in _SAME},
        policy_kwargs=arguments,
        tensorboard_log=None if tensorboard is None else str(tensorboard),
        seed=seed,
        device="cpu",
    )
    if tensorboard is None:  # SB3's own logger leaves an empty folder in /tmp for each training
        model.set_logger(Logger(None, []))
    with torch.no_grad():  # exploring around full stop would teach little but how to stall
        model.policy.action_net.bias.fill_(config.initial_action)
        if hasattr(model.policy.mlp_extractor, "line_net"):  # no route is preferred at first
            model.policy.mlp_extractor.line_net[-1].weight.mul_(0.01)  # scores near 0
    return model


class Schedules(BaseCallback):
    """Schedules that fall linearly over a training: the exploration noise and the penalty for
    leaving the teacher.

    The logarithm of the noise falls from `log_std_init` to `log_std_final`, and is learned where
    that is None. The weight of the penalty is `penalty` at step 0, and falls to 0 at half of the
    training. Steps as a student count: after them both have fallen already.
    Schmitt et al. 2018 (arXiv:1803.03835) let a loss fade in the same way.
    """

    def __init__(self, config: PPOConfig, penalty: float = 0.0):
        super().__init__()
        self.config = config
        self.penalty = penalty

    def _on_step(self) -> bool:
        """True, so that the training goes on; SB3 asks every callback."""
        return True

    def _on_rollout_start(self) -> None:
        """Set noise and penalty for the rollout, by the share of the training that is done, steps
        as a student included.
        """
        done = self.model.num_timesteps / self.locals["total_timesteps"]
        config = self.config
        if config.log_std_final is not None:
            log_std = config.log_std_init + done * (config.log_std_final - config.log_std_init)
            self.model.policy.log_std.requires_grad_(False).fill_(log_std)
        self.model.get_vec_normalize_env().penalise(self.penalty * max(0.0, 1.0 - 2.0 * done))


def save(model: PPO, path: Path) -> None:
    """Save an agent of `build` to `path` (.zip) by an atomic write, with what `resume` needs.

    It is SB3's zip with an `agent.Info` as one more member. Of several worlds the `Info` keeps the
    effects of the first one.
    """
    env = model.get_vec_normalize_env()
    world = env.get_attr("model")[0]
    info = Info(
        **{**model.origin, "ppo": PPOConfig(**model.origin["ppo"])},
        observation_names=tuple(env.get_attr("observation_names")[0]),
        observation_version=VERSION,
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
) -> PPO:
    """The agent of a checkpoint, ready to go on learning on new courses: weights, optimizer,
    moments and steps are those of the file. Arguments as of `build`.

    ParameterError where the file was trained with another observation, history or network.
    """
    info = read_info(path)
    for key, stored, asked in (
        ("observation", info.observation, observation),
        *(
            (key, getattr(info.ppo, key), getattr(config, key))
            for key in ("history", "layer", "activation")
        ),
    ):
        if stored != asked:
            raise ParameterError(f"{path}: trained with {key} {stored!r}, not {asked!r}")
    check_layout(info, path, scenario)
    model = build(scenario, observation, config, seed, tensorboard, world)
    restore(model, path, info)
    return model


def restore(model: PPO, path: Path, info: Info) -> None:
    """Give a fresh `model` weights, optimizer, moments and steps of a file of `save`, whose content
    is `info`.

    Courses and noise are others than at the start of the run.
    """
    load_weights(path, WEIGHTS, model.policy)
    load_weights(path, OPTIMIZER, model.policy.optimizer)
    model.num_timesteps = info.timesteps
    env = model.get_vec_normalize_env()
    seen = env.obs_rms
    returns = env.ret_rms
    seen.mean = np.array(info.mean)
    seen.var = np.array(info.var)
    seen.count = info.count
    returns.mean = np.array(info.return_mean)
    returns.var = np.array(info.return_var)
    returns.count = info.return_count
    model.set_random_seed((model.seed + info.timesteps) % 2**31)
