"""Train PPO by rl-baselines3-zoo on the native vector environment.

    pip install "soil_env[train]" "rl_zoo3>=2.9,<3" pandas requests
    python examples/rl_zoo_ppo.py                          a minute
    python examples/rl_zoo_ppo.py -n 3000000 --seed 1      any option of rl_zoo3.train goes over those below
    python -m rl_zoo3.enjoy --algo ppo --env SoilWheel-v0 --gym-packages soil_env rl_zoo_ppo -f logs --no-render

This file is the configuration too: rl_zoo3 reads `hyperparams` from it. The wrapper `native` replaces the single
environments of rl_zoo3 by one call for all wheels. It also shifts the actions, so that 0, the mean action of an
untrained policy, drives slowly. The last command is run in examples/, where it finds the wrapper.
"""

import sys
from pathlib import Path

import numpy as np
from gymnasium.spaces import Box
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecEnvWrapper, VecMonitor
from torch import nn

from soil_env_agents.sb3 import SoilWheelVecEnv

hyperparams = {
    "SoilWheel-v0": {
        "vec_env_wrapper": [{"rl_zoo_ppo.native": {"initial_action": 0.1}}],
        "normalize": True, "n_envs": 128, "n_timesteps": 500_000, "policy": "MlpPolicy", "n_steps": 64,
        "batch_size": 2048, "n_epochs": 6, "learning_rate": "lin_1e-3", "gamma": 0.999, "gae_lambda": 0.95,
        "clip_range": 0.2, "ent_coef": 0.0,
        "policy_kwargs": {"net_arch": [64, 64], "activation_fn": nn.ReLU, "log_std_init": -1.0},
    }
}  # fmt: skip


class Shifted(VecEnvWrapper):
    """Actions [n, 1] from -1 - `shift` to 1 - `shift`; the environment receives them with `shift` added."""

    def __init__(self, venv: VecEnv, shift: float):
        super().__init__(venv, action_space=Box(-1.0 - shift, 1.0 - shift, (1,), np.float32))
        self.shift = shift

    def reset(self) -> np.ndarray:
        """Reset the wrapped environment; its observations."""
        return self.venv.reset()

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions [n, 1]."""
        self.venv.step_async(np.clip(np.asarray(actions) + self.shift, -1.0, 1.0))

    def step_wait(self):
        """Observations, rewards, ends and infos of the wrapped environment."""
        return self.venv.step_wait()


def native(venv: VecEnv, initial_action: float) -> VecEnv:
    """The wheels of `venv`, made by make_vec_env of SB3, driven together; `initial_action`: meaning of the action 0."""
    if isinstance(venv, DummyVecEnv) and venv.render_mode is None:
        wheel, seed = venv.envs[0].unwrapped, venv._seeds[0]
        made = SoilWheelVecEnv(
            venv.num_envs, wheel.scenario, wheel.observation_variant, model=wheel.model, scaled=wheel.scaling.scaled
        )
        made.seed(seed)
        venv = VecMonitor(made)
    return Shifted(venv, initial_action)


def main() -> None:
    """Run rl_zoo3.train with this file as its configuration."""
    from rl_zoo3.train import train

    options = "--algo ppo --env SoilWheel-v0 --gym-packages soil_env --eval-freq -1 --num-threads 1 -conf".split()
    sys.argv = [sys.argv[0], *options, str(Path(__file__)), *sys.argv[1:]]
    train()


if __name__ == "__main__":
    main()
