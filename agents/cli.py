"""Command-line options shared by the commands: config keys as --KEY VALUE, YAML files, help texts."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml

from soil_env._io.commands import command, command_parser
from soil_env._io.loading import ParameterError, config_dir, merge, parse_yaml, read_yaml


def manual(text: str) -> str:
    """Text of --help with the present name of this package."""
    return text.replace("python -m agents.", f"python -m {__package__}.")


def manual_parser(prog: str, description: str, epilog: str = "", **options) -> argparse.ArgumentParser:
    """`command_parser` with the present name of this package in its texts; options are not abbreviated."""
    return command_parser(prog, manual(description), manual(epilog), allow_abbrev=False, **options)


@contextmanager
def go_on_with(module: str, folder: Path | None) -> Iterator[None]:
    """Add the command for going on to an interrupt, once `folder` holds a study."""
    try:
        yield
    except KeyboardInterrupt:
        known = folder is not None and (folder / "study.yaml").is_file()
        raise KeyboardInterrupt(f"go on with: {command(module)} --resume {folder}" if known else "") from None


_TEXT = ("scenario", "name", "runs", "observation", "model")  # keys whose value is always text


def overrides(arguments: list[str], file_option: str = "") -> dict:
    """['--ppo.gamma', '0.9'] or ['--ppo.gamma=0.9'] -> {'ppo': {'gamma': 0.9}}; values are read as YAML.

    ParameterError for a key given twice and for anything else; `file_option`, if any, is the option of a YAML file.
    """
    out: dict = {}
    rest = list(arguments)
    given: set[str] = set()
    while rest:
        key = rest.pop(0)
        if not key.startswith("--") or key == "--":
            is_file = file_option and key.endswith((".yaml", ".yml"))
            meant = f"; did you mean {file_option} {key}?" if is_file else ""
            raise ParameterError(f"{key!r}: expected --key value{meant}")
        name, equals, value = key[2:].partition("=")
        if name.replace("-", "_") in given:
            raise ParameterError(f"--{name}: given twice: expected one value")
        given.add(name.replace("-", "_"))
        if not equals:
            if not rest:
                raise ParameterError(f"{key}: expected a value after it")
            value = rest.pop(0)
        if not value and name not in _TEXT:
            raise ParameterError(f"--{name}: is empty: expected a value")
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


def config_mapping(name: str | Path) -> dict:
    """The keys in the file of --config; ParameterError if it has none, because the defaults are a long run."""
    path = config_file(name)
    mapping = read_yaml(path)
    if not mapping:
        raise ParameterError(f"{path}: is empty: expected keys with their values; for the defaults leave out --config")
    return mapping


def config_file(name: str | Path) -> Path:
    """The file of --config; a bare name of no local file is a config that comes with the package."""
    path = Path(name)
    shipped = config_dir() / path.name
    return shipped if not path.exists() and path.name == str(path) and shipped.is_file() else path
