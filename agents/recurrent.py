"""RecurrentPPO of sb3-contrib: an agent with a memory, which may find out for itself what the identifier would tell it.

The counterpart of `agents.ppo` for `TrainConfig.algorithm = "recurrent_ppo"`; models are saved by `ppo.save`. One LSTM
serves policy and value; its sequences are the rollouts of single wheels, cut at the ends of episodes.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import torch

from soil_env._io.loading import ParameterError
from soil_env.parameters import Scenario
from soil_env.terramechanics.model import WheelSoilModel

from . import ppo, zips
from .guided import Guide


def algorithm():
    """RecurrentPPO; ParameterError where sb3-contrib is not installed."""
    try:
        from sb3_contrib import RecurrentPPO
    except ImportError:
        raise ParameterError("recurrent_ppo: needs sb3-contrib; expected: pip install 'soil_env[recurrent]'") from None
    return RecurrentPPO


def build(
    scenario: Scenario,
    observation: str,
    config: ppo.PPOConfig,
    seed: int,
    tensorboard: Path | None = None,
    world: WheelSoilModel | None = None,
    guide: Guide | None = None,
):
    """A fresh RecurrentPPO agent with its normalised vector environment; arguments as of `ppo.build`."""
    torch.set_num_threads(1)
    model = algorithm()(
        "MlpLstmPolicy",
        ppo.normalised(scenario, observation, config, seed, world, guide),
        **ppo.hyperparameters(config),
        policy_kwargs={
            "lstm_hidden_size": config.layer,
            "shared_lstm": True,
            "enable_critic_lstm": False,
            "net_arch": [config.layer],
            "log_std_init": config.log_std_init,
        },
        tensorboard_log=None if tensorboard is None else str(tensorboard),
        seed=seed,
        device="cpu",
    )
    with torch.no_grad():
        model.policy.action_net.bias.fill_(config.initial_action if guide is None else 0.0)
    return model


def resume(
    path: Path,
    scenario: Scenario,
    observation: str,
    config: ppo.PPOConfig,
    seed: int,
    log: Path | None,
    world: WheelSoilModel | None = None,
    guide: Guide | None = None,
):
    """The agent of a checkpoint, ready to go on learning; its worlds start new courses, its memory is empty."""
    meta, env = ppo.reopened(path, scenario, observation, config, seed, world, guide)
    cls, rate = algorithm(), ppo.schedule(config)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = cls.load(
                path,
                device="cpu",
                env=env,
                custom_objects=zips.without_pickles(
                    path, *ppo.agent_spaces(meta), learning_rate=rate, lr_schedule=rate, clip_range=config.clip_range
                ),
                tensorboard_log=None if log is None else str(log),
            )
    except Exception as error:  # SB3 raises whatever zipfile, torch or pickle do
        reason = (str(error).splitlines() or [""])[0][:200]
        raise ParameterError(
            f"{path}: cannot be loaded as a RecurrentPPO model ({type(error).__name__}: {reason})"
        ) from None
    model.set_random_seed((seed + meta["timesteps"]) % 2**31)
    return model
