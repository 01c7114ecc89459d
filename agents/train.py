"""Train a PPO agent on randomised soil and compare it with slip controllers at avoiding immobilisation.

Examples:
  soil-env train                                       observation "identified", scenario "two_lines"
  soil-env train --config smoke.yaml                   a run of seconds, to see that everything works
  soil-env train --observation blind --timesteps 5e6   any key of the config; nested ones as --ppo.gamma 0.995
  soil-env train --changes.course.length 20            any key of the scenario
  soil-env train --resume runs/NAME                    go on with a run that was interrupted or killed
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import textwrap
from pathlib import Path

from soil_env._io.commands import command, command_line, command_parser, label, leave
from soil_env._io.loading import ParameterError, merge

from .cli import config_mapping, overrides
from .config import PPOConfig, TrainConfig, load_config
from .extras import needing

_STARTED_AS = f"{__package__}.train", "train.py"
_FILES = """
The run folder, runs/NAME, holds config.yaml and scenario.yaml (every key resolved; --resume reads them), model.zip
(soil_env_agents.agent.load_agent loads it), checkpoint.zip on the way, tensorboard/ (tensorboard --logdir runs),
comparison.json, .csv, .png (every controller on the held-out courses, with 95 % intervals) and course.png.
"""


def _keys() -> str:
    """The config keys: those of the run with their meaning, those of PPO with their defaults."""
    lines = ["Keys of the config with their defaults, in the YAML file or as options:"]
    for f in dataclasses.fields(TrainConfig):
        if f.name not in ("ppo", "changes"):
            default = "" if f.default in ("", None, dataclasses.MISSING) else str(f.default)
            lines.append(f"  --{f.name:17s}{default:11s} {f.metadata.get('doc', '')}".rstrip())
    own = " ".join(f"{f.name}={f.default}" for f in dataclasses.fields(PPOConfig))
    lines += textwrap.wrap(f"--ppo.KEY          {own}", 110, initial_indent="  ", subsequent_indent=" " * 21)
    return "\n".join(lines)


def parser() -> argparse.ArgumentParser:
    """Options of the command; the keys of the config are listed from `TrainConfig` itself."""
    typed = command(*_STARTED_AS)
    p = command_parser(
        label(*_STARTED_AS),
        __doc__,
        _keys() + "\n" + _FILES,
        usage=f"{typed} [--config YAML] [--KEY VALUE ...]\n       {typed} --resume RUN",
        allow_abbrev=False,
    )
    p.add_argument("--config", metavar="YAML", help="file of config keys, or a shipped one; options go over it")
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

    folder, config, scenario = _opened(options, rest)
    try:
        training.console.print(f"Run folder: {folder}")
        if all((folder / name).is_file() for name in (training.MODEL, *comparison.written(config))):
            training.console.print("Already finished. Delete its comparison.json to compare again.")
            return 0
        agent = training.train(folder, config, scenario)
        comparison.compare(folder, config, scenario, agent)
        training.console.print(f"Written to {folder}: {', '.join(comparison.written(config))}")
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"go on with: {command(*_STARTED_AS)} --resume {folder}") from None
    return 0


def _opened(options: argparse.Namespace, rest: list[str]) -> tuple:
    """(folder, config, scenario) of a new run, or of the one to resume."""
    from . import training

    for option in ("config", "resume"):
        if getattr(options, option) == "":
            raise ParameterError(f"--{option}: expected a path, got nothing")
    changes = overrides(rest, "--config")
    if options.resume is not None:
        if options.config is not None or changes:
            raise ParameterError("--resume takes no other option: the run folder has its config")
        return Path(options.resume), *training.open_run(Path(options.resume))
    mapping, where = {}, "command line"
    if options.config is not None:
        mapping, where = config_mapping(options.config), f"{options.config}, command line"
        load_config(mapping, options.config)  # errors of the file alone name the file alone
    config = load_config(merge(mapping, changes), where)
    scenario = training.scenario_of(config)
    return training.make_run_folder(config, scenario), config, scenario


if __name__ == "__main__":
    leave(main())
