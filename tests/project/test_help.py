"""`--help` of every command prints its usage and ends with status 0; an unknown option is refused in one line."""

import importlib
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
BENCHMARKS = [
    f"benchmarks.{path.stem}:main"
    for path in sorted((ROOT / "benchmarks").glob("*.py"))
    if "\ndef main(" in path.read_text(encoding="utf-8")
]

pytestmark = pytest.mark.documents


@pytest.fixture(params=[*SCRIPTS.values(), *BENCHMARKS])
def status_of(request, monkeypatch):
    """A function that runs a command with an option; its exit status."""
    module, function = request.param.split(":")

    def run(option: str) -> int:
        monkeypatch.setattr(sys, "argv", [module, option])
        try:
            return getattr(importlib.import_module(module), function)()
        except SystemExit as end:
            return end.code

    return run


def test_an_unknown_option_is_refused_in_one_line(status_of, capsys):
    assert status_of("--no-such-option") == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_help(status_of, capsys):
    assert status_of("--help") == 0
    text = capsys.readouterr().out
    assert text.startswith("usage: ") and "\noptions:\n" in text and "--" in text
