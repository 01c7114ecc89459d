"""Train PPO of Ray RLlib on the vector environment.

    pip install soil_env "ray[rllib]>=2.60,<2.61" torch    in an environment of its own: RLlib pins gymnasium 1.2.2
    python examples/rllib_ppo.py                           some minutes
    python examples/rllib_ppo.py --runners 2 --iterations 400

RLlib makes the environment by its name in every env runner, many wheels in one call. Its connectors then handle each
wheel in Python, which takes most of the time.
"""

import argparse
from collections import deque

import numpy as np
import ray
import torch
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module import DefaultPPOTorchRLModule
from ray.rllib.connectors.env_to_module import MeanStdFilter
from ray.rllib.core.rl_module import RLModuleSpec
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig


class Driving(DefaultPPOTorchRLModule):
    """RLlib's policy and value; the untrained policy drives slowly."""

    def setup(self):
        """Begin with the mean action 0.3 and the standard deviation 0.2."""
        super().setup()
        last = [layer for layer in self.pi.modules() if isinstance(layer, torch.nn.Linear)][-1]
        with torch.no_grad():
            last.weight *= 0.01
            last.bias.copy_(torch.tensor([0.3, -1.6]))


def main() -> None:
    """Parse the command line, train."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--iterations", type=int, default=40)
    p.add_argument("--batch", type=int, default=8192, help="steps an iteration (default: 8192)")
    p.add_argument("--wheels", type=int, default=64, help="of each env runner (default: 64)")
    p.add_argument("--runners", type=int, default=0, help="processes that drive (default: 0, this one)")
    options = p.parse_args()
    torch.set_num_threads(1)
    ray.init("local", num_cpus=options.runners + 1, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    config = (
        PPOConfig()
        .environment("soil_env:SoilWheel-v0", env_config={"scenario": "mixed", "observation": "identified"})
        .env_runners(
            num_env_runners=options.runners, num_envs_per_env_runner=options.wheels, rollout_fragment_length="auto",
            gym_env_vectorize_mode="vector_entry_point",
            env_to_module_connector=lambda env, spaces, device: MeanStdFilter(),
        )
        .learners(num_learners=0)
        .rl_module(
            rl_module_spec=RLModuleSpec(
                module_class=Driving,
                model_config=DefaultModelConfig(fcnet_hiddens=[64, 64], fcnet_activation="relu", vf_share_layers=False),
            )
        )
        .training(
            train_batch_size_per_learner=options.batch, minibatch_size=min(1024, options.batch), num_epochs=6,
            lr=[[0, 1e-3], [options.iterations * options.batch, 5e-5]], gamma=0.999, lambda_=0.9, use_kl_loss=False,
            clip_param=0.2, entropy_coeff=0.003, vf_loss_coeff=0.5, vf_clip_param=100.0, grad_clip=0.5,
            grad_clip_by="global_norm",
        )
        .debugging(seed=1)
    )  # fmt: skip
    algorithm, returns = config.build_algo(), deque(maxlen=100)
    for k in range(options.iterations):
        found = algorithm.train()["env_runners"]
        steps, courses = int(found["num_env_steps_sampled_lifetime"]), int(found.get("num_episodes", 0))
        if courses:
            returns.extend([found["episode_return_mean"]] * courses)  # RLlib's mean is of this iteration alone
        mean = np.mean(returns) if returns else np.nan
        print(f"{k + 1:3d}: {steps:,} steps, {courses} courses, return {mean:.2f}", flush=True)
    algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
