"""Commands that could not write their results: status 2 and one line that names the path, before the work."""

import os

import pytest

from agents import tune
from agents.evaluate import __main__ as evaluate
from agents.study import __main__ as study
from benchmarks import clients, cmu, fuzz, memory, table_fits, throughput, training
from benchmarks.blind import __main__ as blind
from soil_env._io import examples
from soil_env._io.loading import shipped_dir
from soil_env.discrepancy import __main__ as discrepancy, cmu as cmu_tables
from soil_env.identification import __main__ as identification_command
from soil_env.logs import __main__ as logs
from soil_env.paper import __main__ as paper

OUT, PAGE = ["--out", "{}"], ["--page", "{}/page.md"]
#: command -> (module, its name in messages, arguments, what does the work)
COMMANDS = {
    "blind": (blind, "benchmarks.blind", ["draw", *OUT], "_names"),
    "clients": (clients, "benchmarks.clients", ["zoo", *OUT], "environment"),
    "cmu": (cmu, "benchmarks.cmu", OUT, "study"),
    "fuzz": (fuzz, "benchmarks.fuzz", PAGE, "run"),
    "memory": (memory, "benchmarks.memory", PAGE, "vector"),
    "paper": (paper, "soil_env.paper", OUT, "compute"),
    "study": (study, "agents.study", ["--config", "study_smoke.yaml", *OUT], "results"),
    "table_fits": (table_fits, "benchmarks.table_fits", OUT, "study"),
    "throughput": (throughput, "benchmarks.throughput", OUT, "run"),
    "training": (training, "benchmarks.training", OUT, "measure"),
}


NAMED = {name: module for name, (module, *_) in COMMANDS.items() if name in ("cmu", "paper", "study")} | {
    "cmu_tables": cmu_tables, "discrepancy": discrepancy, "evaluate": evaluate,
    "identification": identification_command, "logs": logs, "tune": tune,
}  # fmt: skip


FOLDERS = [(name, "--out") for name in NAMED] + [
    ("evaluate", "--resume"),
]  # fmt: skip


@pytest.mark.parametrize("command, option", FOLDERS)
def test_an_empty_folder_name_is_refused(command, option, capsys):
    with pytest.raises(SystemExit) as end:
        NAMED[command].main([option, ""])
    err = capsys.readouterr().err
    assert end.value.code == 2 and err.count("\n") == 1
    assert err.endswith(f": error: argument {option}: is empty: expected a folder\n")


FILES = [
    ("study", "--config"), ("logs", "--map"), ("logs", "recording"),
    *((name, option) for name in ("discrepancy", "identification") for option in ("--setup", "data")),
]  # fmt: skip


@pytest.mark.parametrize("command, option", FILES)
def test_an_empty_file_name_is_refused(command, option, capsys):
    with pytest.raises(SystemExit) as end:
        NAMED[command].main([option, ""] if option.startswith("--") else [""])
    err = capsys.readouterr().err
    name = {"data": "DATA.csv", "recording": "RECORDING"}.get(option, option)
    assert end.value.code == 2 and err.count("\n") == 1
    assert err.endswith(f": error: argument {name}: is empty: expected a file\n")


def test_the_examples_of_a_clone_are_said_to_be_there(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(shipped_dir("examples").parent)
    assert examples.main([]) == 2
    err = capsys.readouterr().err
    assert (
        err.endswith(": examples: has the examples already, as every clone: nothing to copy\n") and err.count("\n") == 1
    )
    (tmp_path / "mine").write_text("")
    assert examples.main([str(tmp_path)]) == 2
    assert capsys.readouterr().err.endswith(f": {tmp_path}: is not empty: expected a folder to be made\n")


NUMBERS = [(name, option) for name in ("evaluate", "study") for option in ("--workers", "--seeds")] + [
    ("evaluate", "--courses"), ("evaluate", "--seed"), ("evaluate", "--tuning-courses"),
    ("evaluate", "--oracle-courses"), ("evaluate", "--block"), ("evaluate", "--resamples"),
    ("tune", "--courses"),
]  # fmt: skip
NUMBERS.remove(("evaluate", "--seeds"))


@pytest.mark.parametrize("command, option", NUMBERS)
def test_what_is_no_whole_number_is_refused(command, option, capsys):
    with pytest.raises(SystemExit) as end:
        NAMED[command].main([option, "abc"])
    err = capsys.readouterr().err
    assert end.value.code == 2 and err.count("\n") == 1
    assert f": error: argument {option}: 'abc': expected a whole number" in err


@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder_that_cannot_be_is_refused_before_the_work(command, capsys, monkeypatch, tmp_path):
    module, name, arguments, work = COMMANDS[command]
    monkeypatch.setattr(module, work, lambda *args, **kw: pytest.fail("worked for nothing"))
    (tmp_path / "file").write_text("mine")
    assert module.main([a.format(tmp_path / "file" / "out") for a in arguments]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"{name}: ") and err.count("\n") == 1 and str(tmp_path / "file") in err, err
    assert os.listdir(tmp_path) == ["file"]
