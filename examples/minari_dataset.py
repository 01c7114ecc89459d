"""Record a data set of driven courses with Minari, replay it, and check that every step comes back.

    pip install soil_env "minari[create,hdf5]>=0.5.4,<0.6"    brings jax, which Minari records with
    python examples/minari_dataset.py
    python examples/minari_dataset.py --controller full_throttle --episodes 20

Episode k is the course of seed SEED + k, the same for every controller. Data sets are in ~/.minari/datasets, or in
MINARI_DATASETS_PATH; one of the same name is replaced.
"""

import argparse
import sys

import gymnasium
import minari
import numpy as np

import soil_env
from soil_env_agents.controllers import CONTROLLERS, make_controller

SEED = 3_000_011  # far from the seeds of trainings, which count from their `seed`


def record(name: str, controller: str, scenario: str, episodes: int) -> None:
    """Drive the courses and write the data set."""
    variant = CONTROLLERS[controller].variant
    env = gymnasium.make("soil_env:SoilWheel-v0", scenario=scenario, observation=variant, scaled=False)
    driver = make_controller(controller, env.unwrapped.scenario)
    env = minari.DataCollector(env)
    for k in range(episodes):
        observation, _ = env.reset(seed=SEED + k)
        memory, over, start = None, False, np.array([True])
        while not over:
            action, memory = driver.predict(observation[None], memory, start)
            start = np.array([False])
            observation, _, terminated, truncated, _ = env.step(action[0])
            over = terminated or truncated
    said = f"{episodes} courses of scenario {scenario!r}, seeds from {SEED}, driven by {controller}"
    needs = [f"soil_env=={soil_env.__version__}"]
    env.create_dataset(dataset_id=name, algorithm_name=controller, description=said, requirements=needs)
    env.close()


def differences(dataset) -> int:
    """Number of steps that differ when the actions are replayed from the stored seeds."""
    env, count = dataset.recover_environment(), 0
    for episode, metadata in zip(dataset, dataset.storage.get_episode_metadata(dataset.episode_indices), strict=True):
        observation, _ = env.reset(seed=int(metadata["seed"]))
        count += not np.array_equal(observation, episode.observations[0])
        for k, action in enumerate(episode.actions):
            observation, reward, *_ = env.step(action)
            count += not (np.array_equal(observation, episode.observations[k + 1]) and reward == episode.rewards[k])
    env.close()
    return count


def main() -> int:
    """Record, replay, print."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--controller", choices=sorted(CONTROLLERS), default="best_slip_identified")
    p.add_argument("--scenario", default="two_lines", help="name or YAML file")
    p.add_argument("--episodes", type=int, default=5)
    options = p.parse_args()
    name = f"soil/{options.controller}-v0"
    if name in minari.list_local_datasets():
        minari.delete_dataset(name)
    record(name, options.controller, options.scenario, options.episodes)
    dataset = minari.load_dataset(name)
    returns = [episode.rewards.sum() for episode in dataset]
    print(f"{name}: {dataset.total_episodes} courses, {dataset.total_steps} steps, return {np.mean(returns):.2f}")
    count = differences(dataset)
    print(f"replayed: {count} steps differ")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
