"""The command line of train.py."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml

from agents.extras import needing_train
from soil_env._io.commands import command, label
from soil_env._io.loading import ParameterError, config_dir, merge, parse_yaml, read_yaml
from soil_env._io.signals import terminable

_FILES = """
The run folder, runs/NAME, holds
  config.yaml, scenario.yaml   what was asked, every key resolved; --resume reads them
  model.zip                    the agent with its normalisation; agents.ppo.load_agent(folder) loads it
  checkpoint.zip               the agent on the way, until it is done
  tensorboard/                 curves of the training: tensorboard --logdir runs
  comparison.json, .csv, .png  every controller on the held-out courses, with 95 % intervals
  course.png                   one course in detail
  time.json                    where the wall time went, in seconds

Interrupted with Ctrl-C, a run leaves a checkpoint and says how to go on; killed, it goes on from the last checkpoint.

Exit status: 0 done, 2 bad input (one line on stderr says what, where, and what was expected), 130 interrupted.
"""


def _keys() -> str:
    """The config keys by group: option with default, what it is, and its bounds."""
    from agents.config import PPOConfig, TrainConfig

    lines = ["Keys of the config with their defaults, in the YAML file or as options:"]
    for title, prefix, cls in (("The run", "", TrainConfig), ("PPO", "ppo.", PPOConfig)):
        lines.append(f"\n  {title}")
        for f in dataclasses.fields(cls):
            if f.name not in ("ppo", "changes"):
                default = "" if f.default in ("", dataclasses.MISSING) else str(f.default)
                lines.append(f"    --{prefix + f.name:22s} {default:12s} {_about(f)}".rstrip())
    lines.append(f"\n  The scenario\n    --changes.KEY{'':24s} any key, e.g. --changes.course.margin '[0.05, 0.1]'")
    return "\n".join(lines)


def _about(f: dataclasses.Field) -> str:
    """What a key is, with its bounds."""
    text, low, high = (f.metadata.get(key) for key in ("doc", "low", "high"))
    return text if low is None else f"{text}, {low:g} to {high:g}"


_STARTED_AS = ("agents.train", "train.py")


def parser(description: str) -> argparse.ArgumentParser:
    """Options of train.py; the keys of the config are listed from `TrainConfig` itself."""
    typed = command(*_STARTED_AS).removeprefix("python ")
    p = argparse.ArgumentParser(
        label(*_STARTED_AS),
        usage=f"{typed} [--config YAML] [--KEY VALUE ...]\n       {typed} --resume RUN",
        description=description,
        epilog=_keys() + "\n" + _FILES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    p.add_argument(
        "--config",
        metavar="YAML",
        help="file of config keys, or a shipped one as smoke.yaml; the command line goes over it",
    )
    p.add_argument("--resume", metavar="RUN", help="run folder to go on with; config keys may not be given then")
    return p


_TEXT = ("scenario", "name", "runs", "observation", "model")  # keys whose value is text, whatever YAML makes of it


def overrides(arguments: list[str]) -> dict:
    """['--ppo.gamma', '0.9'] or ['--ppo.gamma=0.9'] -> {'ppo': {'gamma': 0.9}}; values are read as YAML."""
    out: dict = {}
    rest = list(arguments)
    while rest:
        key = rest.pop(0)
        if not key.startswith("--") or key == "--":
            raise ParameterError(f"{key!r}: expected --key value")
        name, equals, value = key[2:].partition("=")
        if not equals:
            if not rest:
                raise ParameterError(f"{key}: expected a value after it")
            value = rest.pop(0)
        try:
            entry = value if name in _TEXT else parse_yaml(value)
        except yaml.YAMLError:
            entry = value
        for part in reversed(name.replace("-", "_").split(".")):
            entry = {part: entry}
        out = merge(out, entry)
    return out


@contextmanager
def as_options(**names: str) -> Iterator[None]:
    """Errors of a dataclass made from options name the option: "Study.courses = 0" becomes "--courses = 0".

    `names`: {field: option} where they differ.
    """
    try:
        yield
    except ParameterError as error:
        own = re.match(r"[A-Z]\w*\.(\w+)(?= = )", str(error))
        if own is None:
            raise
        option = names.get(own[1], own[1]).replace("_", "-")
        raise ParameterError(f"--{option}{str(error)[own.end() :]}") from None


def config_file(name: str | Path) -> Path:
    """The file of --config; a bare name that is no file here is one of the configs that come with the package."""
    path = Path(name)
    shipped = config_dir() / path.name
    return shipped if not path.exists() and path.name == str(path) and shipped.is_file() else path


def check_folder(path: Path) -> None:
    """ParameterError where a folder of results is something else."""
    if path.exists() and not path.is_dir():
        raise ParameterError(f"{path}: is a file: expected a folder")


def main(arguments: list[str] | None = None, description: str = "") -> int:
    """Run train.py; returns its exit status: 0 done, 2 bad input, 130 interrupted."""
    options, rest = parser(description).parse_known_args(arguments)
    with needing_train(label(*_STARTED_AS)):
        importlib.import_module("agents.training")  # takes seconds, in which Ctrl-C ends the process at once
    return _run(options, rest)


@terminable
def _run(options: argparse.Namespace, rest: list[str]) -> int:
    from agents import ppo, training

    name = label(*_STARTED_AS)
    from soil_env.parameters import load_scenario

    folder = None
    try:
        for option in ("config", "resume"):
            if getattr(options, option) == "":
                raise ParameterError(f"--{option}: expected a path, got nothing")
        changes = overrides(rest)
        if options.resume is not None:
            if options.config is not None or changes:
                raise ParameterError("--resume takes no other option: the run folder has its config")
            folder = Path(options.resume)
            config, scenario = training.open_run(folder)
        else:
            mapping = {} if options.config is None else read_yaml(config_file(options.config))
            where = " and ".join(filter(None, (options.config, "command line" if changes else "")))
            config = ppo.load_config(merge(mapping, changes), where or "defaults")
            scenario = load_scenario(config.scenario, config.changes)
            folder = training.make_run_folder(config, scenario)
        training.console.print(f"Run folder: {folder}")
        agent = training.train(folder, config, scenario)
        training.compare(folder, config, scenario, {agent.name: agent})
        training.console.print(
            f"Written to {folder}: comparison.json, comparison.csv, comparison.png, course.png, time.json"
        )
    except ParameterError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{name}: {error.filename or folder}: {error.strerror}", file=sys.stderr)
        return 2
    except MemoryError as error:
        print(f"{name}: not enough memory ({error}); expected smaller ppo.num_envs or ppo.n_steps", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        again = f"; go on with: {command(*_STARTED_AS)} --resume {folder}" if folder else ""
        print(f"\n{name}: interrupted{again}", file=sys.stderr)
        return 130
    return 0
