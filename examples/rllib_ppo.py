"""Train PPO of Ray RLlib on the vector environment.

    pip install "soil_env[rllib]"                          in an environment of its own: RLlib pins gymnasium 1.2.2
    python examples/rllib_ppo.py                           prints the mean return after each iteration
    python examples/rllib_ppo.py --runners 2 --iterations 50

RLlib makes the environment by its name in every env runner, many wheels in one call. Its connectors then handle wheel
by wheel in Python, which takes most of the time: expect hours where Stable-Baselines3 takes minutes, and a mean return
near -10 (immobilised at the start) for the first iterations.
"""

import argparse

import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.connectors.env_to_module import MeanStdFilter


def main() -> None:
    """Parse the command line, train."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--iterations", type=int, default=10)
    p.add_argument("--batch", type=int, default=32768, help="steps an iteration (default: 32768)")
    p.add_argument("--wheels", type=int, default=128, help="of each env runner (default: 128)")
    p.add_argument("--runners", type=int, default=0, help="processes that drive (default: 0, this one)")
    options = p.parse_args()
    ray.init(include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    config = (
        PPOConfig()
        .environment("soil_env:SoilWheel-v0", env_config={"scenario": "mixed", "observation": "identified"})
        .env_runners(
            num_env_runners=options.runners,
            num_envs_per_env_runner=options.wheels,
            gym_env_vectorize_mode="vector_entry_point",
            rollout_fragment_length="auto",
            env_to_module_connector=lambda env, spaces, device: MeanStdFilter(),
        )
        .learners(num_learners=0)
        .training(
            train_batch_size_per_learner=options.batch,
            minibatch_size=min(1024, options.batch),
            num_epochs=6,
            lr=1e-3,
            gamma=0.999,
            lambda_=0.9,
            vf_clip_param=100.0,
        )
        .debugging(seed=1)
    )
    algorithm = config.build_algo()
    for k in range(options.iterations):
        found = algorithm.train()["env_runners"]
        steps, courses = int(found["num_env_steps_sampled_lifetime"]), found.get("num_episodes", 0)
        mean = found.get("episode_return_mean", float("nan"))
        print(f"{k + 1:3d}: {steps:,} steps, {courses} courses, return {mean:.2f}")
    algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
