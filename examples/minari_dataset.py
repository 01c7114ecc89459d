"""Record a data set of driven courses with Minari, and replay it.

    pip install "soil_env[minari]"                        brings jax, which Minari records with
    python examples/minari_dataset.py
    python examples/minari_dataset.py --controller full_throttle --episodes 20 --name soil/full-throttle-v0

The environment is made again from what the data set says of it; from the stored seeds and actions every observation
and reward comes back bit for bit. Data sets lie in ~/.minari/datasets, or where MINARI_DATASETS_PATH says.
"""

import argparse

import gymnasium
import minari
import numpy as np

from soil_env_agents.controllers import CONTROLLERS, make_controller


def record(name: str, controller: str, episodes: int, scenario: str):
    """The data set of `episodes` courses driven by a classical controller, seeds 0, 1, ..."""
    variant = CONTROLLERS[controller].variant
    env = gymnasium.make("soil_env:SoilWheel-v0", scenario=scenario, observation=variant)
    driver, env = make_controller(controller, env.unwrapped.scenario), minari.DataCollector(env)
    for seed in range(episodes):
        observation, _ = env.reset(seed=seed)
        memory, over, start = None, False, np.array([True])
        while not over:
            action, memory = driver.predict(observation[None], memory, start)
            start = np.array([False])
            observation, _, terminated, truncated, _ = env.step(action[0])
            over = terminated or truncated
    description = f"{episodes} courses of scenario {scenario!r} of soil_env, driven by {controller}"
    made = env.create_dataset(dataset_id=name, algorithm_name=controller, description=description)
    env.close()
    return made


def differences(dataset) -> int:
    """How many steps of a data set do not come back when its actions are replayed from its seeds."""
    env, count = dataset.recover_environment(), 0
    for episode, metadata in zip(dataset, dataset.storage.get_episode_metadata(dataset.episode_indices), strict=True):
        observation, _ = env.reset(seed=int(metadata["seed"]))
        count += not np.array_equal(observation, episode.observations[0])
        for k, action in enumerate(episode.actions):
            observation, reward, terminated, truncated, _ = env.step(action)
            stored = (episode.rewards[k], episode.terminations[k], episode.truncations[k])
            same = np.array_equal(observation, episode.observations[k + 1])
            count += not (same and (reward, terminated, truncated) == stored)
    env.close()
    return count


def main() -> None:
    """Record, replay, say what came back."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--controller", choices=sorted(CONTROLLERS), default="best_slip_identified")
    p.add_argument("--scenario", default="mixed", help="name or YAML file")
    p.add_argument("--episodes", type=int, default=5)
    p.add_argument("--name", default="soil/wheel-v0", help="of the data set; an old one of this name is replaced")
    options = p.parse_args()
    if options.name in minari.list_local_datasets():
        minari.delete_dataset(options.name)
    record(options.name, options.controller, options.episodes, options.scenario)
    dataset = minari.load_dataset(options.name)
    returns = [episode.rewards.sum() for episode in dataset]
    print(f"{dataset.total_episodes} courses, {dataset.total_steps} steps, mean return {np.mean(returns):.2f}")
    print(f"replayed: {differences(dataset)} steps differ")


if __name__ == "__main__":
    main()
