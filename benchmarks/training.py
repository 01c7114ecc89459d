"""Cost of a training step with SB3's update and with ours, and where the wall time of a run of train.py went.

    python benchmarks/training.py                  minutes; writes docs/training.json and the tables of docs/training.md
    python benchmarks/training.py --smoke --out X  every part in seconds, numbers without meaning
    python benchmarks/training.py --run runs/NAME  puts the wall time of that run of train.py on the page as well

One thread throughout: then wall time is processor time even where others use the machine.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import soil_env  # noqa: F401  first: from here on Ctrl-C ends the imports in one line

# isort: split
import torch
from stable_baselines3 import PPO

from agents import ppo
from agents.timing import Times
from benchmarks.common import ROOT, machine, machine_text, range_text, renew_page, spread, study_parser
from soil_env._io.commands import command_line, leave
from soil_env._io.document import Table
from soil_env._io.files import make_folder, write_json
from soil_env._io.loading import read_json
from soil_env.parameters import load_scenario

SMALL = ppo.PPOConfig(num_envs=128, n_steps=128, n_epochs=6, batch_size=1024, activation="tanh", history=0, threads=1)
LARGE = replace(SMALL, num_envs=512, n_steps=64, n_epochs=4, batch_size=4096)


def plain(config: ppo.PPOConfig, seed: int) -> PPO:
    """The agent of `ppo.build`, but by SB3's own PPO, with torch's tanh and without fused Adam."""
    model = ppo.build(load_scenario("mixed"), "identified", config, seed)
    other = PPO(
        "MlpPolicy", model.get_env(), learning_rate=model.learning_rate, n_steps=config.n_steps,
        batch_size=config.batch_size, n_epochs=config.n_epochs, gamma=config.gamma, gae_lambda=config.gae_lambda,
        clip_range=config.clip_range, ent_coef=config.ent_coef, seed=seed, device="cpu",
        policy_kwargs={"net_arch": [config.layer, config.layer], "log_std_init": config.log_std_init},
    )  # fmt: skip
    with torch.no_grad():
        other.policy.action_net.bias.fill_(config.initial_action)
    return other


def ours(config: ppo.PPOConfig, seed: int) -> PPO:
    """The agent of train.py."""
    return ppo.build(load_scenario("mixed"), "identified", config, seed)


def costs(small: ppo.PPOConfig, large: ppo.PPOConfig, steps: int, rounds: int) -> dict:
    """Processor time a step [us], in all and of the update, by SB3's PPO and by ours; measured in turns."""
    tries = {}
    for config in (small, large):
        for who, make in (("SB3", plain), ("ours", ours)):
            tries[f"{who}, {config.num_envs} x {config.n_steps}, {config.n_epochs} epochs, tanh"] = make, config
    title = f"ours, {large.num_envs} x {large.n_steps}, {large.n_epochs} epochs, relu"
    tries[title] = ours, replace(large, activation="relu")
    models = {title: make(config, 0) for title, (make, config) in tries.items()}
    found = {title: {"step": [], "update": []} for title in tries}
    for turn in range(rounds + 1):
        for title, model in models.items():
            updating, before = [], model.num_timesteps

            def train(updating=updating, model=model):
                start = time.process_time()
                type(model).train(model)
                updating.append(time.process_time() - start)

            model.train, start = train, time.process_time()
            model.learn(steps, reset_num_timesteps=False)
            spent, done = time.process_time() - start, model.num_timesteps - before
            if turn:  # the first one warms up
                found[title]["step"].append(1e6 * spent / done)
                found[title]["update"].append(1e6 * sum(updating) / done)
    return {title: {key: spread(values) for key, values in row.items()} for title, row in found.items()}


def sections(result: dict) -> dict[str, str]:
    """Text between the markers of docs/training.md, by marker."""
    rows = [[name, *(range_text(c[key], 1) for key in ("step", "update"))] for name, c in result["update"].items()]
    seconds = result.get("run") or {}
    total = sum(seconds.values())
    parts = [[part, f"{s:.0f}", f"{s / total:.0%}"] for part, s in seconds.items()]
    run = Table(["part", "s", "share"], [*parts, ["all", f"{total:.0f}", "100%"]]).markdown()
    return {
        "machine": f"{machine_text(result['machine'], 'torch', also=', shared with other work')}.",
        "update": Table(["", "us a step in all", "of that the update"], rows).markdown(),
        "run": run if seconds else "Not measured.",
    }


def measure(options: argparse.Namespace) -> None:
    """Measure what training.json does not have yet, and write it and its page."""
    path = options.out / "training.json"
    result = read_json(path) if path.is_file() else {}
    if options.run is not None:
        result["run"] = Times(options.run).seconds
    if "update" not in result:
        result["machine"] = machine() | {"torch": torch.__version__}
        if options.smoke:
            tiny = replace(SMALL, num_envs=8, n_steps=16, n_epochs=2, batch_size=64)
            result["update"] = costs(tiny, replace(tiny, num_envs=16), 300, 1)
        else:
            result["update"] = costs(SMALL, LARGE, 32_768, 3)
    write_json(path, result)
    renew_page(ROOT / "docs" / "training.md", sections(result), options.out / "training.md")


@command_line("benchmarks.training", interrupted="start it again")
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = study_parser("python benchmarks/training.py", __doc__, "training.json and .md")
    parser.add_argument(
        "--run", metavar="RUN", type=Path, help="run folder of train.py whose wall time goes onto the page"
    )
    options = parser.parse_args(arguments)
    make_folder(options.out)
    measure(options)
    return 0


if __name__ == "__main__":
    leave(main())
