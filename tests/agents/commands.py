"""Subcommands of soil-env as this clone has them: `evaluate(arguments)`, or `python -m tests.agents.commands evaluate`.

The installed command may belong to another clone.
"""

import sys
from importlib import import_module

from soil_env.cli.running import leave, run

_MODULES = {"evaluate": "agents.evaluate.command", "study": "agents.study.command", "train": "agents.train"}


def call(name: str, arguments: list[str]) -> int:
    """Exit status of a subcommand."""
    return run(import_module(_MODULES[name]).command, list(map(str, arguments)), f"soil-env {name}")


def evaluate(arguments: list[str]) -> int:
    """Exit status of `soil-env evaluate`."""
    return call("evaluate", arguments)


def study(arguments: list[str]) -> int:
    """Exit status of `soil-env study`."""
    return call("study", arguments)


def train(arguments: list[str]) -> int:
    """Exit status of `soil-env train`."""
    return call("train", arguments)


def typed(name: str, *arguments: str) -> list[str]:
    """Command line of a process that runs a subcommand."""
    return [sys.executable, "-m", "tests.agents.commands", name, *arguments]


if __name__ == "__main__":
    leave(call(sys.argv[1], sys.argv[2:]))
