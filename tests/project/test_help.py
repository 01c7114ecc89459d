"""`--help` of every command prints its usage and ends with status 0."""

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


@pytest.mark.parametrize("command", [*SCRIPTS.values(), *BENCHMARKS])
def test_help(command, capsys, monkeypatch):
    module, function = command.split(":")
    monkeypatch.setattr(sys, "argv", [module, "--help"])
    with pytest.raises(SystemExit) as end:
        getattr(importlib.import_module(module), function)()
    assert end.value.code == 0
    text = capsys.readouterr().out
    assert text.startswith("usage: ") and "\noptions:\n" in text and "--" in text
