"""Command `soil-env`, with a subcommand for each task.

The module of a subcommand is imported when it is asked for.
"""

import sys
from collections.abc import Sequence
from importlib import import_module

import click

from soil_env._io.loading import nearest

from .running import leave, run

_AGENTS = "soil_env_agents"
#: Module of each subcommand, with the summary that `soil-env --help` shows without importing it.
_COMMANDS = {
    "drive": (f"{_AGENTS}.drive", "Drive one course and save a picture or a video."),
    "train": (f"{_AGENTS}.train", "Train an agent and compare it with the classical controllers."),
    "evaluate": (
        f"{_AGENTS}.evaluate.command",
        "Compare controllers and agents on held-out courses.",
    ),
    "tune": (f"{_AGENTS}.tune", "Tune the classical controllers."),
    "study": (f"{_AGENTS}.study.command", "Train and compare arms over seeds and scenarios."),
    "export": (f"{_AGENTS}.export.command", "Export a trained agent as ONNX with its policy file."),
    "identify": ("soil_env.cli.identify", "Identify a soil from a table of wheel measurements."),
    "discover": ("soil_env.cli.discover", "Name the effect that a wheel-soil model lacks."),
    "logs": ("soil_env.cli.logs", "Identify the soil along the log of a rover."),
    "paper": ("soil_env.cli.paper", "Recompute the printed values of the source paper."),
    "describe": ("soil_env.cli.describe", "Print the keys of a YAML file, with units and bounds."),
    "warmup": ("soil_env.cli.warmup", "Compile all kernels once."),
    "examples": ("soil_env.cli.examples", "Copy the example scripts and their data."),
}


class _Commands(click.Group):
    """Subcommands imported on demand."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the subcommands, in the order of `_COMMANDS`."""
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command:
        """Import the subcommand of this name; `click.UsageError` for an unknown one, and for one
        that needs a package which is not installed.
        """
        if name not in _COMMANDS:
            known = ", ".join(_COMMANDS)
            raise click.UsageError(
                f"unknown command {name!r}{nearest(name, _COMMANDS)} (known: {known})"
            )
        try:
            return import_module(_COMMANDS[name][0]).command
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] in ("soil_env", _AGENTS):
                raise
            extra = "[train]" if _COMMANDS[name][0].startswith(_AGENTS) else ""
            raise click.UsageError(
                f"{name} needs the package {error.name}: pip install 'soil_env{extra}'"
            ) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the subcommands with their summaries."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, summary) for name, (_, summary) in _COMMANDS.items()])


@click.group(
    cls=_Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.version_option(package_name="soil_env")
def soil_env() -> None:
    """Wheels on soil they do not know: drive, train, identify, discover.

    Exit status: 0 done; 2 bad input, with one line on stderr; 130 interrupted, 143 by SIGTERM.
    The line of a command that can go on also names the folder of what is finished.
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `soil-env` with these arguments, by default those of the process; return the exit status.

    Without any it prints the help.
    """
    given = sys.argv[1:] if arguments is None else arguments
    return run(soil_env, given or ["--help"], "soil-env")


def entry() -> None:
    """Entry point of the installed command and of `python -m soil_env.cli`."""
    leave(main())
