"""Train a PPO agent on randomised soil and compare it with slip controllers at avoiding immobilisation.

The run trains the agent, takes the classical controllers as they come tuned for the scenario (another scenario: tunes
them on courses of their own), drives all of them over the same
held-out courses, prints the comparison, and says where the wall time went. On two cores the defaults take a few
minutes. Everything is kept in one run folder.

Examples:
    python -m agents.train                                      observation "identified", scenario "two_lines"
    python -m agents.train --config smoke.yaml                  a run of seconds, to see that everything works
    python -m agents.train --observation blind --timesteps 5e6  any key of the config; nested ones as --ppo.gamma 0.995
    python -m agents.train --changes.course.length 20           any key of the scenario
    python -m agents.train --resume runs/NAME                   go on with a run that was interrupted or killed
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import re
from pathlib import Path

from soil_env._io.commands import command, command_line, label, leave
from soil_env._io.loading import ParameterError, merge
from soil_env.vehicle import load_rover

from .cli import config_mapping, manual_parser, overrides
from .config import PPOConfig, TrainConfig, load_config
from .extras import needing

_STARTED_AS = f"{__package__}.train", "train.py"
_FILES = """
The run folder, runs/NAME, holds
  config.yaml, scenario.yaml   what was asked, every key resolved; --resume reads them
  model.zip                    the agent with its normalisation; soil_env_agents.ppo.load_agent(folder) loads it
  checkpoint.zip               the agent on the way, until it is done
  tensorboard/                 curves of the training: tensorboard --logdir runs
  comparison.json, .csv, .png  every controller on the held-out courses, with 95 % intervals
  course.png                   one course in detail
  time.json                    where the wall time went, in seconds

Interrupted with Ctrl-C, a run leaves a checkpoint and says how to go on; killed, it goes on from the last checkpoint.
"""


def _keys() -> str:
    """The config keys by group: option with default, what it is, and its bounds."""
    lines = ["Keys of the config with their defaults, in the YAML file or as options:"]
    for title, prefix, cls in (("The run", "", TrainConfig), ("PPO", "ppo.", PPOConfig)):
        lines.append(f"\n  {title}")
        for f in dataclasses.fields(cls):
            if f.name not in ("ppo", "changes"):
                default = "" if f.default in ("", None, dataclasses.MISSING) else str(f.default)
                lines.append(f"    --{prefix + f.name:22s} {default:12s} {_about(f)}".rstrip())
    lines.append(f"\n  The scenario\n    --changes.KEY{'':24s} any key, e.g. --changes.course.margin '[0.05, 0.1]'")
    return "\n".join(lines)


def _about(f: dataclasses.Field) -> str:
    """What a key is, with its bounds."""
    text, low, high = (f.metadata.get(key) for key in ("doc", "low", "high"))
    return text if low is None else f"{text}, {low:g} to {high:g}"


def parser() -> argparse.ArgumentParser:
    """Options of the command; the keys of the config are listed from `TrainConfig` itself."""
    typed = command(*_STARTED_AS)
    p = manual_parser(
        label(*_STARTED_AS),
        __doc__.replace("python -m agents.train", typed),
        _keys() + "\n" + _FILES,
        usage=f"{typed} [--config YAML] [--KEY VALUE ...]\n       {typed} --resume RUN",
    )
    p.add_argument(
        "--config",
        metavar="YAML",
        help="file of config keys, or a shipped one as smoke.yaml; the command line goes over it",
    )
    p.add_argument("--resume", metavar="RUN", help="run folder to go on with; config keys may not be given then")
    return p


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 2 bad input, 130 interrupted."""
    options, rest = parser().parse_known_args(arguments)
    with needing("train", label(*_STARTED_AS)):
        importlib.import_module(".training", __package__)  # takes seconds, in which Ctrl-C ends the process at once
    return _run(options, rest)


@command_line(*_STARTED_AS, memory="smaller ppo.num_envs or ppo.n_steps")
def _run(options: argparse.Namespace, rest: list[str]) -> int:
    from . import comparison, training

    for option in ("config", "resume"):
        if getattr(options, option) == "":
            raise ParameterError(f"--{option}: expected a path, got nothing")
    changes = overrides(rest, "--config")
    if options.resume is not None:
        if options.config is not None or changes:
            raise ParameterError("--resume takes no other option: the run folder has its config")
        folder = Path(options.resume)
        config, scenario = training.open_run(folder)
    else:
        mapping = {} if options.config is None else config_mapping(options.config)
        config = load_config(mapping, options.config or "defaults")
        if changes:
            config = _over(mapping, changes, options.config)
        scenario = training.scenario_of(config)
        folder = training.make_run_folder(config, scenario)
    try:
        training.console.print(f"Run folder: {folder}")
        if training.finished(folder, config):
            training.console.print("Already finished. Delete its comparison.json to compare again.")
            return 0
        agent = training.train(folder, config, scenario)
        training.compare(folder, config, scenario, {agent.name: agent})
        training.show(f"Written to {folder}: {', '.join(comparison.written(config))}")
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"go on with: {command(*_STARTED_AS)} --resume {folder}") from None
    return 0


def _over(mapping: dict, changes: dict, file: str | None) -> TrainConfig:
    """The config of a file's `mapping` and the command line's `changes`; errors name where the key is from."""
    try:
        return load_config(merge(mapping, changes), "command line")
    except ParameterError as error:
        if changes.get("rover"):
            load_rover(str(changes["rover"]))  # a misspelt name first
        key = re.match(r"command line: (\w+)", str(error))
        if key and key[1] in mapping and key[1] not in changes:
            raise ParameterError(str(error).replace("command line", str(file), 1)) from None
        raise


if __name__ == "__main__":
    leave(main())
