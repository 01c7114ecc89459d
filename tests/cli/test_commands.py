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
TABLE = [
    str(EXAMPLES / "data" / "single_wheel.csv"),
    "--setup",
    str(EXAMPLES / "data" / "setup.yaml"),
]


def refusal(capsys, *arguments):
    """The line that a refused command prints."""
    shown = refused_command(capsys, "soil-env", main, *arguments)
    assert shown.out == ""
    return shown.err


@pytest.mark.parametrize("name", _COMMANDS)
def test_help_fits_a_screen_and_an_unknown_option_is_refused(name, capsys):
    assert main([name, "--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert (
        lines[0].startswith(f"Usage: soil-env {name}")
        and len(lines) <= 50
        and max(map(len, lines)) <= 110
    )
    assert refusal(capsys, name, "--no-such-option").startswith(f"soil-env {name}: error: ")


def test_an_unknown_command_is_refused_with_the_nearest(capsys):
    assert "unknown command 'identfy'; did you mean 'identify'? (known: drive, " in refusal(
        capsys, "identfy"
    )


def test_without_arguments_the_help_is_printed(capsys):
    assert main([]) == 0
    assert len(capsys.readouterr().out.splitlines()) > 15


@pytest.mark.parametrize("arguments", [["identify", *TABLE], ["discover", *TABLE], ["paper"]])
def test_a_folder_that_cannot_be_made_is_refused_before_the_work(arguments, capsys, tmp_path):
    assert "'--out': is empty: expected a path" in refusal(capsys, *arguments, "--out", "")
    (tmp_path / "file").write_text("mine")
    assert str(tmp_path / "file") in refusal(
        capsys, *arguments, "--out", str(tmp_path / "file" / "out")
    )
    assert os.listdir(tmp_path) == ["file"]


def test_discover_says_nothing_but_why_it_refuses(capsys, tmp_path):
    (tmp_path / "table.csv").write_text("slip,load\n0.1,100\n")
    said = refusal(
        capsys, "discover", str(tmp_path / "table.csv"), *TABLE[1:], "--out", str(tmp_path / "out")
    )
    assert "table.csv" in said


def test_examples_on_a_full_disk_name_the_file_that_is_not_written(capsys, monkeypatch, tmp_path):
    def full(content):
        raise OSError(28, "full")

    monkeypatch.setattr(files, "_bytes", full)
    assert f"{tmp_path / 'mine'}" in refusal(capsys, "examples", str(tmp_path / "mine"))
    assert not [p for p in (tmp_path / "mine").rglob("*") if p.is_file()]


def test_examples_are_copied_once(capsys, monkeypatch, tmp_path):
    assert main(["examples", str(tmp_path / "mine")]) == 0
    assert (tmp_path / "mine" / "README.md").is_file()
    capsys.readouterr()
    assert "is not empty: expected a new folder" in refusal(
        capsys, "examples", str(tmp_path / "mine")
    )
    monkeypatch.chdir(EXAMPLES.parent)
    assert "has the examples already" in refusal(capsys, "examples")
