"""Record drives of controllers and agents on held-out courses as Minari data sets, replay them, and write their card.

CONTROLLERS is a list as of agents.evaluate. Each becomes one data set, PREFIX/NAME-v0: episode k is the course of seed
SEED + k, the same for all. The environment is made again from what the data set says of it; from the stored seeds and
actions every observation and reward comes back bit for bit, which is checked. Data sets lie in ~/.minari/datasets, or
where MINARI_DATASETS_PATH says; one of the same name is replaced. The card, README.md, goes beside them.

Examples:
  python -m agents.dataset --controllers full_throttle,soft_start,best_slip_identified --episodes 20
  python -m agents.dataset --controllers 'ppo=runs/NAME' --scenario mixed --prefix mine
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gymnasium
import numpy as np

import soil_env
from soil_env._io.commands import command, command_line, leave, whole_number
from soil_env._io.document import Table, wrapped
from soil_env._io.files import replace_file
from soil_env._io.loading import ParameterError
from soil_env.parameters import DEFAULT_SCENARIO, Scenario, load_scenario

from .cli import manual_parser
from .evaluate import contestants, loading
from .progress import show

_NAME = f"{__package__}.dataset"
SEED = 3_000_011  # far from the seeds of trainings, which count from their `seed`
LICENCE = "MIT"


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    p = manual_parser(command(_NAME), __doc__)
    p.add_argument("--controllers", metavar="CONTROLLERS", required=True, help="whose drives, with commas")
    p.add_argument("--scenario", metavar="NAME", default=DEFAULT_SCENARIO, help="or YAML file (default: %(default)s)")
    p.add_argument("--episodes", metavar="N", type=whole_number(1), default=20, help="of each (default: 20)")
    p.add_argument("--seed", metavar="N", type=whole_number(), default=SEED, help=f"of episode 0 (default: {SEED})")
    p.add_argument("--prefix", metavar="NAME", default="soil", help="namespace of the data sets (default: soil)")
    return p


@command_line(_NAME)
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 1 a step did not come back, 2 bad input, 130 interrupted."""
    options = parser().parse_args(arguments)
    try:
        import minari
    except ImportError:
        raise ParameterError("needs Minari: pip install 'soil_env[minari]'") from None
    scenario = load_scenario(options.scenario)
    asked = contestants.parse(options.controllers)
    for contestant in asked.values():
        loading.check(contestant, scenario)
    rows, differing = [], 0
    for contestant in asked.values():
        member = f"-{contestant.member}" if contestant.member else ""
        name = f"{options.prefix}/{contestant.name}{member}-v0"
        if name in minari.list_local_datasets():
            minari.delete_dataset(name)
        record(name, contestant, options.scenario, options.episodes, options.seed)
        dataset = minari.load_dataset(name)
        returns = [episode.rewards.sum() for episode in dataset]
        ended = [bool(episode.terminations[-1]) for episode in dataset]
        count = differences(dataset)
        differing += count
        rows.append((name, contestant.label, len(returns), dataset.total_steps, f"{np.mean(returns):.2f}",
                     f"{np.std(returns):.2f}", sum(not e for e in ended), count))  # fmt: skip
    heads = ("data set", "controller", "episodes", "steps", "mean return", "its sd over episodes", "cut by time",
             "steps that differ when replayed")  # fmt: skip
    table = Table(heads, rows)
    show(table)
    folder = Path(minari.storage.get_dataset_path(options.prefix))
    replace_file(folder / "README.md", card(options, scenario, table))
    show(f"Card: {folder / 'README.md'}")
    show(f"replayed: {differing} steps differ")
    return 1 if differing else 0


def record(name: str, contestant: contestants.Contestant, scenario: str, episodes: int, seed: int):
    """The data set of the courses with seeds `seed`, `seed` + 1, ..., driven by one contestant; `scenario` is a name or
    the path of a file."""
    import minari

    driver = loading.load(contestant, load_scenario(scenario))
    env = gymnasium.make("soil_env:SoilWheel-v0", scenario=scenario, observation=driver.variant, scaled=False)
    env = minari.DataCollector(env)
    for k in range(episodes):
        observation, _ = env.reset(seed=seed + k)
        memory, over, start = None, False, np.array([True])
        while not over:
            action, memory = driver.predict(observation[None], state=memory, episode_start=start, deterministic=True)
            start = np.array([False])
            observation, _, terminated, truncated, _ = env.step(np.asarray(action[0], dtype=np.float32))
            over = terminated or truncated
    made = env.create_dataset(
        dataset_id=name,
        algorithm_name=contestant.label,
        author="soil_env developers",
        description=f"{episodes} courses of scenario {scenario!r} of soil_env {soil_env.__version__}, seeds {seed} "
        f"to {seed + episodes - 1}, driven by {contestant.label}. Licence: {LICENCE}.",
        requirements=[f"soil_env=={soil_env.__version__}"],
    )
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


def card(options, scenario: Scenario, table: Table) -> str:
    """README.md of the data sets, with the header that the Hugging Face Hub reads."""
    header = "---\nlicense: mit\ntags: [minari, reinforcement-learning, offline-rl, SoilWheel-v0]\n---\n\n"
    text = f"""# Drives of a wheel on soil that it does not know

Scenario `{scenario.name}` of soil_env {soil_env.__version__}: courses of {scenario.course.length:g} m with seeds
{options.seed} to {options.seed + options.episodes - 1}, the same for every controller. No training and no tuning used
these seeds.

{table.markdown()}

Observations are raw; their names, units and bounds are those of `SoilWheelEnv`. Actions are in [-1, 1]. The environment
comes back with `minari.load_dataset(NAME).recover_environment()`, and from seed and actions every step does. Simulated,
not measured on a vehicle.

Licence: {LICENCE}. Made by `python -m agents.dataset --controllers '{options.controllers}' --scenario
{options.scenario} --episodes {options.episodes} --seed {options.seed} --prefix {options.prefix}`.
"""
    return header + wrapped(text)


if __name__ == "__main__":
    leave(main())
