"""Options that several commands share: config keys as --KEY VALUE, YAML files, engines, optional
packages.
"""

import shlex
import shutil
import sys
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
from soil_env.parameters import DEFAULT_SCENARIO

#: Settings of a click command that takes --KEY VALUE beside its options, as the argument `keys`.
WITH_KEYS = {"ignore_unknown_options": True, "help_option_names": ["-h", "--help"]}
_TEXT = ("scenario", "name", "runs", "observation", "model")  # keys whose value is always text
_PACKAGES = ("stable_baselines3", "tensorboard", "torch")  # of the extra `train`
_FAILURES = (ParameterError, OSError, MemoryError)  # that end a command with one line
#: Files of a folder in which no work is done yet, beside hidden ones.
_BEGINNINGS = ("study.yaml", "config.yaml", "scenario.yaml")


#: The argument `keys`: all arguments that are no option of the command; `overrides` reads them.
keys_argument = click.argument("keys", nargs=-1, type=click.UNPROCESSED, metavar="[--KEY VALUE]...")
allow_code_option = click.option(
    "--allow-code", is_flag=True, help="Import the modules that the study's file names."
)
#: --scenario, with a default.
scenario_option = click.option(
    "--scenario",
    metavar="NAME",
    default=DEFAULT_SCENARIO,
    help=f"Or YAML (default {DEFAULT_SCENARIO}).",
)


def engine_options(command: Callable) -> Callable:
    """Add the options --engine, --workers and --address (`cells.choose`) to a click command."""
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
    """['--ppo.gamma', '0.9'] or ['--ppo.gamma=0.9'] -> {'ppo': {'gamma': 0.9}}.

    A - in a key is read as _, but in NAME of settings.NAME.KEY, which may have points too. Values
    are read as YAML, but those of `_TEXT`, and what is no YAML, stay text.

    ParameterError for a key given twice or without a value, and for an argument that is no --KEY.
    If it is a YAML file the message proposes `file_option`, the option that takes files.
    """
    out: dict = {}
    rest = list(arguments)
    given: set[tuple[str, ...]] = set()
    while rest:
        key = rest.pop(0)
        if not key.startswith("--") or key == "--":
            is_file = file_option and key.endswith((".yaml", ".yml"))
            meant = f"; did you mean {file_option} {key}?" if is_file else ""
            raise ParameterError(f"{key!r}: expected --key value{meant}")
        name, equals, value = key[2:].partition("=")
        path = _path(name)
        if path in given:
            raise ParameterError(f"--{name}: given twice: expected one value")
        given.add(path)
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
        for part in reversed(path):
            entry = {part: entry}
        out = merge(out, entry)
    return out


def _path(name: str) -> tuple[str, ...]:
    """Nested keys, the outermost first, of the option --NAME: "ppo.n-steps" -> ("ppo", "n_steps").

    Of settings.NAME.KEY there are three, whatever points NAME has.
    """
    head, _, rest = name.partition(".")
    owner, _, key = rest.rpartition(".")
    if head == "settings" and owner:
        return head, owner, key.replace("-", "_")
    return tuple(name.replace("-", "_").split("."))


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
    """Inside the block a ParameterError that begins with "controllers: " begins with the name of
    this `option` instead; other errors stay as they are.
    """
    try:
        yield
    except ParameterError as error:
        text = str(error)
        own = text.removeprefix("controllers: ")
        if own == text:
            raise
        renamed = ParameterError(f"{option}: {own}")
        for note in getattr(error, "__notes__", ()):
            renamed.add_note(note)
        raise renamed from None


@contextmanager
def continued_by(command: str, folder: Path) -> Iterator[None]:
    """Inside the block an interrupt gets the `command` that continues the work as its message; an
    error of `_FAILURES` gets it as a note if work is done in `folder`.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"continue with: {command}") from None
    except _FAILURES as error:
        if _has_work(folder):
            error.add_note(
                f"{folder} keeps what is done; once that is mended go on with: {command}"
            )
        raise


@contextmanager
def begun_in(folder: Path, new: bool, made: bool) -> Iterator[None]:
    """Undo the beginning of a command in `folder` where an error (`_FAILURES`) ends the block
    before any work is done.

    A folder that is `new` (missing or unused before) is emptied, and removed if the command `made`
    it. Another one stays as it is.
    """
    try:
        yield
    except FileExistsError:  # another command is at work there
        raise
    except _FAILURES:
        if new and folder.is_dir() and not _has_work(folder):
            for path in folder.iterdir():
                shutil.rmtree(path) if path.is_dir() else path.unlink()
            if made:
                folder.rmdir()
        raise


def _has_work(folder: Path) -> bool:
    """True if a folder holds files beside `_BEGINNINGS`, which a command writes before its work,
    and hidden ones.
    """
    return any(
        path.is_file() and path.name not in _BEGINNINGS and not path.name.startswith(".")
        for path in folder.rglob("*")
    )


def again(subcommand: str, *arguments: object) -> str:
    """The command line that runs a subcommand of this program, in the way the user started it:
    `soil-env`, a script of that name elsewhere, `python -m soil_env.cli` or `python train.py`.
    """
    script = Path(sys.argv[0])
    interpreter = (sys.orig_argv or [sys.executable])[0]
    of_package = [interpreter, "-m", "soil_env.cli", subcommand]
    if script.name == "train.py":
        program = [interpreter, sys.argv[0]] if subcommand == "train" else of_package
    elif script.parts[-3:] == ("soil_env", "cli", "__main__.py"):
        program = of_package
    elif script.name == "soil-env" and shutil.which(script.name) != shutil.which(sys.argv[0]):
        program = [sys.argv[0], subcommand]
    else:
        program = ["soil-env", subcommand]
    return shlex.join([*program, *map(str, arguments)])


@contextmanager
def needing_training() -> Iterator[None]:
    """Around imports of the training: ParameterError with the installation line if a package of the
    extra `train` is missing.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in _PACKAGES:
            raise
        raise ParameterError("needs Stable-Baselines3: pip install 'soil_env[train]'") from None


def config_mapping(name: str | Path) -> dict:
    """The mapping in the file of --config; ParameterError if it has no key, since it would begin a
    long run of defaults that nobody asked for.
    """
    path = config_file(name)
    mapping = read_yaml(path)
    if not mapping:
        raise ParameterError(f"{path}: is empty: expected keys with their values")
    return mapping


def config_file(name: str | Path) -> Path:
    """The file of --config; a bare name of no local file is a config that comes with the
    package.
    """
    path = Path(name)
    shipped = config_dir() / path.name
    return shipped if not path.exists() and path.name == str(path) and shipped.is_file() else path
