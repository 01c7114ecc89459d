"""Every subcommand of `soil-env`: help, refusals in one line before any work, files that cannot be
written.
"""

import os

import pytest

from soil_env._io import files
from soil_env._io.loading import shipped_dir
from soil_env.cli import _COMMANDS, main
from tests.refusals import refused_command

EXAMPLES = shipped_dir("examples")
DATA = EXAMPLES / "data"
# Arguments of `identify` and `discover`.
TABLE = [DATA / "single_wheel.csv", "--setup", DATA / "setup.yaml"]


def refusal(capsys, *arguments):
    """The line on stderr of a refused command, which prints nothing on stdout."""
    shown = refused_command(capsys, "soil-env", main, *arguments)
    assert shown.out == ""
    return shown.err


@pytest.mark.parametrize("name", _COMMANDS)
def test_help_fits_a_screen_and_an_unknown_option_is_refused(name, capsys):
    assert main([name, "--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"Usage: soil-env {name}")
    assert len(lines) <= 50 and max(map(len, lines)) <= 110
    assert refusal(capsys, name, "--no-such-option").startswith(f"soil-env {name}: error: ")


def test_an_unknown_command_is_refused_with_the_nearest(capsys):
    said = "unknown command 'identfy'; did you mean 'identify'? (known: drive, "
    assert said in refusal(capsys, "identfy")


def test_without_arguments_the_help_is_printed(capsys):
    assert main([]) == 0
    assert len(capsys.readouterr().out.splitlines()) > 15


@pytest.mark.parametrize("arguments", [["identify", *TABLE], ["discover", *TABLE], ["paper"]])
def test_a_folder_that_cannot_be_made_is_refused_before_the_work(arguments, capsys, tmp_path):
    assert "'--out': is empty: expected a path" in refusal(capsys, *arguments, "--out", "")
    (tmp_path / "file").write_text("mine")
    file = tmp_path / "file"
    assert str(file) in refusal(capsys, *arguments, "--out", file / "out")
    assert os.listdir(tmp_path) == ["file"]


def test_discover_says_nothing_but_why_it_refuses(capsys, tmp_path):
    """No progress and no heading go to stdout before it; this table has no measured column."""
    table = tmp_path / "table.csv"
    table.write_text("slip,load\n0.1,100\n")
    assert "table.csv" in refusal(capsys, "discover", table, *TABLE[1:], "--out", tmp_path / "out")


def test_examples_on_a_full_disk_name_the_file_that_is_not_written(capsys, monkeypatch, tmp_path):
    def full(content):
        """Content for a disk without room."""
        raise OSError(28, "full")  # ENOSPC

    monkeypatch.setattr(files, "_bytes", full)
    mine = tmp_path / "mine"
    assert str(mine) in refusal(capsys, "examples", mine)
    assert not [p for p in mine.rglob("*") if p.is_file()]


def test_examples_are_copied_once(capsys, monkeypatch, tmp_path):
    mine = tmp_path / "mine"
    assert main(["examples", str(mine)]) == 0
    assert (mine / "README.md").is_file()
    assert "is not empty: expected a new folder" in refusal(capsys, "examples", mine)
    monkeypatch.chdir(EXAMPLES.parent)
    assert "has the examples already" in refusal(capsys, "examples")
