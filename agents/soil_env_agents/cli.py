"""Options that several commands share: config keys as --KEY VALUE, YAML files, engines, optional
packages.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import yaml

from soil_env._io.loading import (
    FieldError,
    ParameterError,
    config_dir,
    merge,
    nearest,
    parse_yaml,
    read_yaml,
)
from soil_env.cli.running import WholeNumber

#: Settings of a click command that takes --KEY VALUE beside its options, as the argument `keys`.
WITH_KEYS = {"ignore_unknown_options": True}
_TEXT = ("scenario", "name", "runs", "observation", "model")  # keys whose value is always text
_PACKAGES = ("stable_baselines3", "tensorboard", "torch", "tqdm")  # of the extra `train`


def keys_argument(command: Callable) -> Callable:
    """Add the argument `keys`: all options that the command does not have."""
    return click.argument("keys", nargs=-1, type=click.UNPROCESSED, metavar="[--KEY VALUE]...")(
        command
    )


def allow_code_option(command: Callable) -> Callable:
    """Add --allow-code."""
    return click.option(
        "--allow-code", is_flag=True, help="Import the modules that the study's file names."
    )(command)


def engine_options(command: Callable) -> Callable:
    """Add --engine, --workers and --address."""
    for option in (
        click.option(
            "--address",
            metavar="ADDRESS",
            help="Ray cluster (default: RAY_ADDRESS, else this machine).",
        ),
        click.option(
            "--workers",
            metavar="N",
            type=WholeNumber(),
            help="Processes (default: this one; Ray: all).",
        ),
        click.option(
            "--engine",
            metavar="ENGINE",
            default="local",
            help="local or ray, with the same results.",
        ),
    ):
        command = option(command)
    return command


def overrides(arguments: list[str] | tuple[str, ...], file_option: str = "") -> dict:
    """['--ppo.gamma', '0.9'] or ['--ppo.gamma=0.9'] -> {'ppo': {'gamma': 0.9}}; values are read as
    YAML.

    ParameterError for a key given twice and for anything else; `file_option`, if any, is the option
    of a YAML file.
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
            entry: Any = value if name in _TEXT else parse_yaml(value)
        except yaml.YAMLError:
            entry = value
        for part in reversed(name.replace("-", "_").split(".")):
            entry = {part: entry}
        out = merge(out, entry)
    return out


def unknown_option(key: str, known: Iterable[str]) -> ParameterError:
    """The error for an option that does not exist, with the nearest of the known ones."""
    names = {f"--{name.replace('_', '-')}" for name in known}
    option = f"--{key.replace('_', '-')}"
    return ParameterError(
        f"unknown option {option}{nearest(option, names)} (known: {', '.join(sorted(names))})"
    )


@contextmanager
def as_options() -> Iterator[None]:
    """Inside the block a wrong field of a dataclass is an error of the option of that name."""
    try:
        yield
    except FieldError as error:
        raise ParameterError(f"--{error.name.replace('_', '-')}{error.problem}") from None


@contextmanager
def controllers_as(option: str) -> Iterator[None]:
    """Inside the block an error of the controllers is one of this option."""
    try:
        yield
    except ParameterError as error:
        text = str(error)
        own = text.removeprefix("controllers: ")
        raise ParameterError(text if own == text else f"{option}: {own}") from None


@contextmanager
def continued_by(command: str) -> Iterator[None]:
    """Add the command that continues the work to the message of an interrupt."""
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"continue with: {command}") from None


def lacks_training(error: ImportError) -> bool:
    """True if an import failed because a package of the extra `train` is missing."""
    return (
        isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in _PACKAGES
    )


@contextmanager
def needing_training() -> Iterator[None]:
    """Around imports of the training: ParameterError with the installation line if its packages are
    missing.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if not lacks_training(error):
            raise
        raise ParameterError("needs Stable-Baselines3: pip install 'soil_env[train]'") from None


def config_mapping(name: str | Path) -> dict:
    """The keys in the file of --config; ParameterError if it has none, because the defaults are a
    long run.
    """
    path = config_file(name)
    mapping = read_yaml(path)
    if not mapping:
        raise ParameterError(
            f"{path}: is empty: expected keys with their values; for the defaults leave out "
            "--config"
        )
    return mapping


def config_file(name: str | Path) -> Path:
    """The file of --config; a bare name of no local file is a config that comes with the
    package.
    """
    path = Path(name)
    shipped = config_dir() / path.name
    return shipped if not path.exists() and path.name == str(path) and shipped.is_file() else path
