"""`soil-env discover`: exit status, messages, files, and nothing half written."""

import csv
import re

import pytest

from soil_env.cli import main
from soil_env.discrepancy import report
from tests.discrepancy.files import SETUP, table_text, write_files

NAMES = ["model.yaml", "report.html", "report.json"]
TABLE = table_text({}, loads=(100, 200), slips=(0.1, 0.3, 0.5))


def call(folder, *more, out="out"):
    """Exit status of the command on the files of a folder."""
    data, setup = folder / "data.csv", folder / "setup.yaml"
    return main(["discover", str(data), "--setup", str(setup), "--out", str(folder / out), *more])


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def test_a_run_writes_three_files_and_says_so(tmp_path, capsys):
    write_files(tmp_path, TABLE)
    assert call(tmp_path) == 0
    shown = capsys.readouterr()
    assert names(tmp_path / "out") == NAMES and names(tmp_path) == ["data.csv", "out", "setup.yaml"]
    for name in NAMES:
        assert f"written: {tmp_path / 'out' / name}" in shown.out
    assert "Held-out error" in shown.out
    assert "\x1b[" not in shown.out + shown.err
    assert "calibrating the base model" in shown.err and shown.err.count("searching") == 1


def times(name: str, factor: float) -> str:
    """The table with one column times a factor."""
    lines = list(csv.reader(TABLE.splitlines()))
    k = lines[0].index(name)
    for line in lines[1:]:
        line[k] = str(factor * float(line[k]))
    return "".join(",".join(line) + "\n" for line in lines)


# what every reader of tables and setups refuses is in tests/measurement
BAD = {
    "load in kN": (times("load", 1e-3), SETUP, r"load is 0.\d+ N .* expected newtons \(if it is kN"),
    "sinkage upward": (times("sinkage", -1.0), SETUP, r"sinkage is negative in every row: .* positive downward"),
    "torque backward": (times("torque", -1.0), SETUP, r"torque is negative in every row with slip > 0.05"),
    "torque in N mm": (times("torque", 1e3), SETUP, r"torque is \d+ times load times radius .* newton metres"),
    "pull in mN": (times("drawbar_pull", 1e3), SETUP, r"drawbar_pull is [\d.]+ times the load .* newtons"),
    "speed partly empty": (
        "slip,load,speed,torque\n0.1,100,0.1,2\n0.2,100,,3\n",
        SETUP,
        r"row 3, speed is empty",
    ),
    "unknown column": (TABLE.replace("drawbar_pull", "drawbar_pul", 1), SETUP, r"'drawbar_pul'; .*'drawbar_pull'"),
    "misspelt key": (TABLE, SETUP.replace("cohesion:", "cohesoin:", 1), r"'cohesoin'; did you mean 'cohesion'\?"),
    "no scatter": (
        "slip,load,sinkage\n" + "".join(f"{i},{w},0.02\n" for w in (100, 200, 300) for i in (0.1, 0.2, 0.3, 0.4, 0.5)),
        SETUP.split("noise:")[0],
        r"noise of sinkage: .* expected noise in the setup",
    ),
    "too few to tell the noise": (
        table_text({}, loads=(100,), slips=(0.1, 0.3, 0.5)),
        SETUP.split("noise:")[0],
        r"noise of sinkage: cannot be estimated from 3 values",
    ),
}


@pytest.mark.parametrize("table, setup, message", BAD.values(), ids=BAD)
def test_bad_input_is_one_line(tmp_path, capsys, table, setup, message):
    write_files(tmp_path, table, setup)
    refused(tmp_path, capsys, message)


def refused(folder, capsys, message, *more, out="out"):
    """Exit status 2, one line that matches `message`, nothing printed and nothing written."""
    before = names(folder)
    assert call(folder, "--quiet", *more, out=out) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and shown.err.startswith("soil-env discover: ")
    assert re.search(message, shown.err), shown.err
    assert names(folder) == before


@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize(
    "step, error, status",
    [("replace_files", OSError(28, "No space left on device"), 2), ("page", KeyboardInterrupt(), 130)],
)
@pytest.mark.parametrize("exists", [False, True])
def test_nothing_is_left_when_writing_fails(tmp_path, capsys, monkeypatch, step, error, status, exists):
    write_files(tmp_path, TABLE)
    if exists:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "report.json").write_text("old")

    def fail(*arguments):
        raise error

    monkeypatch.setattr(report, step, fail)
    before = names(tmp_path)
    assert call(tmp_path, "--quiet") == status
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.strip().count("\n") == 0
    assert ("No space left" if status == 2 else "interrupted") in shown.err
    assert names(tmp_path) == before
    if exists:
        assert names(tmp_path / "out") == ["report.json"]
        assert (tmp_path / "out" / "report.json").read_text() == "old"
