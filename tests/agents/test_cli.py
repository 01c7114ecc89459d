"""Lines that call a command again, as the user called it."""

import shutil
import sys

import pytest

from soil_env_agents.cli import again

#: (command as it was typed, line that calls it again).
CALLS = [
    ([".venv/bin/python", "train.py", "--seed", "3"], ".venv/bin/python train.py --resume 'a b'"),
    (["python3", "train.py"], "python3 train.py --resume 'a b'"),
    (
        ["python", "-m", "soil_env.cli", "train"],
        "python -m soil_env.cli train --resume 'a b'",
    ),
    (
        [".venv/bin/python", ".venv/bin/soil-env", "train"],
        ".venv/bin/soil-env train --resume 'a b'",
    ),
    (["/venv/bin/python", "/on/path/soil-env", "train"], "soil-env train --resume 'a b'"),
    (["python", "mine.py"], "soil-env train --resume 'a b'"),  # a script that calls `main`
    (["python", "train.py", "export"], "python -m soil_env.cli export --resume 'a b'"),
]


@pytest.mark.parametrize("typed, line", CALLS)
def test_a_command_is_called_again_as_it_was_called(typed, line, monkeypatch):
    script = "/lib/soil_env/cli/__main__.py" if typed[1] == "-m" else typed[1]
    found = {"soil-env": "/on/path/soil-env"}
    monkeypatch.setattr(sys, "orig_argv", typed)
    monkeypatch.setattr(sys, "argv", [script])
    monkeypatch.setattr(shutil, "which", lambda name: found.get(name, name))
    command = "export" if "export" in typed else "train"
    assert again(command, "--resume", "a b") == line
