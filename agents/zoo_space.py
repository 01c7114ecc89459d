"""Search space of PPO for Optuna studies of rl-baselines3-zoo; importing this module puts it in place of rl_zoo3's own.

    python -m rl_zoo3.train --algo ppo --env SoilWheel-v0 --gym-packages soil_env soil_env_agents.zoo_space ...

rl_zoo3's own space takes rollouts of up to 4096 steps of each wheel, two million before the first update of the 512
wheels of configs/rl_zoo3/ppo.yml, and minibatches from four rows; and it forgets the initial standard deviation.
"""

from __future__ import annotations

from typing import Any

import optuna
from rl_zoo3 import hyperparams_opt
from rl_zoo3.utils import SimpleLinearSchedule
from torch import nn

ACTIVATIONS = {"relu": nn.ReLU, "tanh": nn.Tanh}


def hyperparameters(params: dict[str, Any]) -> dict[str, Any]:
    """Arguments of PPO, as rl_zoo3 reads them from a file, for the parameters of a trial."""
    layers = [2 ** params["layer_pow"]] * 2
    return {
        "n_steps": 2 ** params["n_steps_pow"],
        "batch_size": 2 ** params["batch_size_pow"],
        "n_epochs": params["n_epochs"],
        "learning_rate": f"lin_{params['learning_rate']}",
        "gamma": 1.0 - params["one_minus_gamma"],
        "gae_lambda": 1.0 - params["one_minus_gae_lambda"],
        "clip_range": params["clip_range"],
        "ent_coef": params["ent_coef"],
        "policy_kwargs": {
            "net_arch": layers,
            "activation_fn": ACTIVATIONS[params["activation_fn"]],
            "log_std_init": params["log_std_init"],
        },
    }


def sample(trial: optuna.Trial, n_actions: int, n_envs: int, additional_args: dict) -> dict[str, Any]:
    """Arguments of PPO for a trial; the other arguments are rl_zoo3's and do not matter.

    Rollouts of 512 wheels are 8 to 128 steps long, and minibatches divide them.
    """
    params = {
        "n_steps_pow": trial.suggest_int("n_steps_pow", 3, 7),
        "batch_size_pow": trial.suggest_int("batch_size_pow", 10, 12),
        "n_epochs": trial.suggest_int("n_epochs", 2, 8),
        "learning_rate": trial.suggest_float("learning_rate", 2e-4, 4e-3, log=True),
        "one_minus_gamma": trial.suggest_float("one_minus_gamma", 3e-4, 1e-2, log=True),
        "one_minus_gae_lambda": trial.suggest_float("one_minus_gae_lambda", 0.02, 0.2, log=True),
        "clip_range": trial.suggest_float("clip_range", 0.1, 0.3),
        "ent_coef": trial.suggest_float("ent_coef", 1e-4, 2e-2, log=True),
        "layer_pow": trial.suggest_int("layer_pow", 5, 7),
        "activation_fn": trial.suggest_categorical("activation_fn", list(ACTIVATIONS)),
        "log_std_init": trial.suggest_float("log_std_init", -2.5, -0.5),
    }
    made = hyperparameters(params)
    return made | {"learning_rate": SimpleLinearSchedule(params["learning_rate"])}


hyperparams_opt.HYPERPARAMS_SAMPLER["ppo"] = sample
hyperparams_opt.HYPERPARAMS_CONVERTER["ppo"] = hyperparameters
