"""The command line of train.py."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

import yaml

from soil_env.loading import ParameterError, merge, read_yaml


def parser(description: str) -> argparse.ArgumentParser:
    """Options of train.py; the keys of the config are listed from `TrainConfig` itself."""
    from agents.ppo import PPOConfig, TrainConfig

    lines = []
    for prefix, cls in (("", TrainConfig), ("ppo.", PPOConfig)):
        for f in dataclasses.fields(cls):
            if f.name == "model":
                lines.append(f"  --{f.name:24s} {'':12s} model.yaml with the effects that are on in this world")
            elif f.name not in ("ppo", "changes"):
                note = f.metadata.get("unit", "")
                lines.append(f"  --{prefix + f.name:24s} {f.default!s:12s} {note}".rstrip())
    keys = "config keys and their defaults:\n" + "\n".join(lines)
    keys += "\n  --changes.KEY              any key of the scenario, e.g. --changes.course.margin '[0.05, 0.1]'"
    p = argparse.ArgumentParser(
        "train.py",
        description=description,
        epilog=keys,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    p.add_argument("--config", metavar="YAML", help="file of config keys; the command line goes over it")
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
            entry = value if name in _TEXT else yaml.safe_load(value)
        except yaml.YAMLError:
            entry = value
        for part in reversed(name.replace("-", "_").split(".")):
            entry = {part: entry}
        out = merge(out, entry)
    return out


def main(arguments: list[str] | None = None, description: str = "") -> int:
    """Run train.py; returns its exit status: 0 done, 2 bad input, 130 interrupted."""
    options, rest = parser(description).parse_known_args(arguments)
    folder = None
    try:
        for name in ("config", "resume"):
            if getattr(options, name) == "":
                raise ParameterError(f"--{name}: expected a path, got nothing")
        changes = overrides(rest)
        from agents import ppo, training
        from soil_env.parameters import load_scenario

        if options.resume is not None:
            if options.config is not None or changes:
                raise ParameterError("--resume takes no other option: the run folder has its config")
            folder = Path(options.resume)
            config, scenario = training.open_run(folder)
        else:
            mapping = {} if options.config is None else read_yaml(Path(options.config))
            where = " and ".join(filter(None, (options.config, "command line" if changes else "")))
            config = ppo.load_config(merge(mapping, changes), where or "defaults")
            scenario = load_scenario(config.scenario, config.changes)
            folder = training.make_run_folder(config, scenario)
        training.console.print(f"Run folder: {folder}")
        agent = training.train(folder, config, scenario)
        training.compare(folder, config, scenario, {agent.name: agent})
        training.console.print(f"Written to {folder}: comparison.json, comparison.csv, comparison.png, course.png")
    except ParameterError as error:
        print(f"train.py: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"train.py: {error.filename or folder}: {error.strerror}", file=sys.stderr)
        return 2
    except MemoryError as error:
        print(f"train.py: not enough memory ({error}); expected smaller ppo.num_envs or ppo.n_steps", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        again = f"; go on with: python train.py --resume {folder}" if folder else ""
        print(f"\ntrain.py: interrupted{again}", file=sys.stderr)
        return 130
    return 0
