"""`python -m soil_env.discrepancy`: exit status, messages, files, and nothing half written."""

import csv
import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from soil_env.discrepancy import report
from soil_env.discrepancy.__main__ import main
from tests.discrepancy.files import SETUP, table_text, write_files

ROOT = Path(__file__).resolve().parents[2]
NAMES = ["model.yaml", "report.html", "report.json"]
TABLE = table_text({}, loads=(100, 200), slips=(0.1, 0.3, 0.5))


def call(folder, *more, out="out"):
    """Exit status of the command on the files of a folder."""
    data, setup = folder / "data.csv", folder / "setup.yaml"
    return main([str(data), "--setup", str(setup), "--out", str(folder / out), *more])


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def test_a_run_writes_three_files_and_says_so(tmp_path, capsys):
    write_files(tmp_path, TABLE)
    assert call(tmp_path, "--bootstrap", "5") == 0
    shown = capsys.readouterr()
    assert names(tmp_path / "out") == NAMES and names(tmp_path) == ["data.csv", "out", "setup.yaml"]
    for name in NAMES:
        assert f"written: {tmp_path / 'out' / name}" in shown.out
    assert "Held-out error" in shown.out
    assert "\x1b[" not in shown.out + shown.err
    assert "calibrating the base model" in shown.err and shown.err.count("searching") == 1


def test_quiet_is_one_line(tmp_path, capsys):
    write_files(tmp_path, TABLE)
    assert call(tmp_path, "--quiet", "--seed", "3", "--bootstrap", "0", out="deep/er") == 0
    shown = capsys.readouterr()
    assert shown.err == "" and shown.out.count("\n") == 1 and shown.out.startswith("none: Nothing is missing")
    assert json.loads((tmp_path / "deep" / "er" / "report.json").read_text())["settings"]["seed"] == 3


def test_files_of_an_earlier_run_are_replaced_and_others_kept(tmp_path):
    write_files(tmp_path, TABLE)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.json").write_text("old")
    (tmp_path / "out" / "notes.txt").write_text("mine")
    assert call(tmp_path, "--quiet") == 0
    assert names(tmp_path / "out") == sorted([*NAMES, "notes.txt"]) and names(tmp_path) == [
        "data.csv", "out", "setup.yaml",
    ]  # fmt: skip
    assert json.loads((tmp_path / "out" / "report.json").read_text())["verdict"] == "none"


def edited(old: str, new: str, text: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


def rows(*lines: str) -> str:
    return "\n".join(lines) + "\n"


def column(name: str, value) -> str:
    """The table with one column replaced by a function of its values."""
    lines = list(csv.reader(TABLE.splitlines()))
    k = lines[0].index(name)
    for line in lines[1:]:
        line[k] = str(value(float(line[k])))
    return rows(*(",".join(line) for line in lines))


BAD = {  # tests/measurement has what every reader of tables and setups refuses
    "unknown column": (
        edited("drawbar_pull", "drawbar_pul", TABLE),
        SETUP,
        r"'drawbar_pul'; did you mean 'drawbar_pull'\?",
    ),
    "load in kN": (column("load", lambda w: 1e-3 * w), SETUP, r"load is 0.\d+ N .* expected newtons \(if it is kN"),
    "sinkage upward": (
        column("sinkage", lambda z: -z),
        SETUP,
        r"sinkage is negative in every row: .* positive downward",
    ),
    "torque backward": (column("torque", lambda t: -t), SETUP, r"torque is negative in every row with slip > 0.05"),
    "torque in N mm": (
        column("torque", lambda t: 1e3 * t),
        SETUP,
        r"torque is \d+ times load times radius .* newton metres",
    ),
    "pull in mN": (
        column("drawbar_pull", lambda p: 1e3 * p),
        SETUP,
        r"drawbar_pull is [\d.]+ times the load .* newtons",
    ),
    "speed partly empty": (
        rows("slip,load,speed,torque", "0.1,100,0.1,2", "0.2,100,,3"),
        SETUP,
        r"row 3, speed is empty",
    ),
    "misspelt key": (TABLE, edited("cohesion:", "cohesoin:", SETUP), r"'cohesoin'; did you mean 'cohesion'\?"),
    "no scatter": (
        rows("slip,load,sinkage", *(f"{i},{w},0.02" for w in (100, 200, 300) for i in (0.1, 0.2, 0.3, 0.4, 0.5))),
        SETUP.split("noise:")[0],
        r"noise of sinkage: the values hardly scatter, .* expected noise in the setup",
    ),
    "too few to tell the noise": (
        table_text({}, loads=(100,), slips=(0.1, 0.3, 0.5)),
        SETUP.split("noise:")[0],
        r"noise of sinkage: cannot be told from 3 values without repeats",
    ),
}


@pytest.mark.parametrize("table, setup, message", BAD.values(), ids=BAD)
def test_bad_input_is_one_line(tmp_path, capsys, table, setup, message):
    write_files(tmp_path, table, setup)
    refused(tmp_path, capsys, message)


def test_a_byte_order_mark_is_read_over(tmp_path):
    write_files(tmp_path, TABLE)
    (tmp_path / "data.csv").write_bytes(b"\xef\xbb\xbf" + TABLE.replace("\n", "\r\n").encode())
    assert call(tmp_path, "--quiet", "--bootstrap", "0") == 0


def refused(folder, capsys, message, *more, out="out"):
    """Exit status 2, one line that matches `message`, nothing printed and nothing written."""
    before = names(folder)
    assert call(folder, "--quiet", *more, out=out) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and shown.err.startswith("soil_env.discrepancy: ")
    assert re.search(message, shown.err), shown.err
    assert names(folder) == before


@pytest.mark.parametrize("missing", ["data.csv", "setup.yaml"])
def test_a_missing_file_is_one_line(tmp_path, capsys, missing):
    write_files(tmp_path, TABLE)
    (tmp_path / missing).unlink()
    refused(tmp_path, capsys, rf"{missing}: cannot be read \(No such file")


def test_a_file_in_the_place_of_the_folder_is_refused_before_the_work(tmp_path, capsys, monkeypatch):
    write_files(tmp_path, TABLE)
    (tmp_path / "out").write_text("mine")
    monkeypatch.setattr("soil_env.discrepancy.workflow.read_setup", pytest.fail)
    refused(tmp_path, capsys, "is a file: expected a folder")
    assert (tmp_path / "out").read_text() == "mine"


@pytest.mark.parametrize(
    "out, more, message",
    [
        ("out", ("--bootstrap", "100001"), r"bootstrap = 100001: expected at most 100000"),
        ("held", (), r"model\.yaml: is a folder"),
    ],
)
def test_what_cannot_end_well_is_refused_before_the_work(tmp_path, capsys, monkeypatch, out, more, message):
    write_files(tmp_path, TABLE)
    (tmp_path / "held" / "model.yaml").mkdir(parents=True)
    monkeypatch.setattr("soil_env.discrepancy.workflow.read_setup", pytest.fail)
    refused(tmp_path, capsys, message, *more, out=out)
    assert names(tmp_path / "held") == ["model.yaml"]


def test_an_empty_folder_name_is_refused(tmp_path, capsys, monkeypatch):
    data, setup = write_files(tmp_path, TABLE)
    monkeypatch.chdir(tmp_path)
    assert main([str(data), "--setup", str(setup), "--out", ""]) == 2
    assert "out is empty: expected a folder" in capsys.readouterr().err
    assert names(tmp_path) == ["data.csv", "setup.yaml"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("more", [["--quiet"], []])
def test_a_conclusion_that_cannot_be_printed_is_one_line(tmp_path, more):
    data, setup = write_files(tmp_path, TABLE)
    command = [sys.executable, "-m", "soil_env.discrepancy", str(data), "--setup", str(setup), "--out",
               str(tmp_path / "out"), "--bootstrap", "0", *more]  # fmt: skip
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True, timeout=300)
    assert done.returncode == 2 and "No space left on device" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr and names(tmp_path / "out") == NAMES


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
    assert ("No space left" if status == 2 else "interrupted; nothing written") in shown.err
    assert names(tmp_path) == before
    if exists:
        assert names(tmp_path / "out") == ["report.json"]
        assert (tmp_path / "out" / "report.json").read_text() == "old"


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_is_exit_status_130(tmp_path):
    write_files(tmp_path, table_text({}, speed=(0.02, 0.1), **{"pass": (1, 2)}))
    command = [sys.executable, "-m", "soil_env.discrepancy", str(tmp_path / "data.csv"), "--setup",
               str(tmp_path / "setup.yaml"), "--out", str(tmp_path / "out"), "--bootstrap", "100000"]  # fmt: skip
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    line = process.stderr.readline()
    assert "reading" in line
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130 and out == ""
    assert err.splitlines()[-1] == "soil_env.discrepancy: interrupted; nothing written"
    assert names(tmp_path) == ["data.csv", "setup.yaml"]


@pytest.mark.parametrize("option", [["--seed", "-1"], ["--bootstrap", "many"], ["--sed", "1"], []])
def test_a_bad_option_is_exit_status_2(tmp_path, capsys, option):
    with pytest.raises(SystemExit) as stop:
        main([str(tmp_path / "data.csv"), *option] + (["--setup", "s", "--out", "o"] if option else []))
    assert stop.value.code == 2 and "error:" in capsys.readouterr().err


def test_the_table_and_setup_of_the_help_are_read(tmp_path):
    """What the manual shows is what the command takes."""
    from soil_env.discrepancy import __main__ as command
    from soil_env.measurement.table import read_setup, read_table

    lines = command.__doc__.splitlines()
    start = next(k for k, line in enumerate(lines) if line.strip().startswith("slip,load"))
    (tmp_path / "data.csv").write_text(rows(*(line.strip() for line in lines[start : start + 4])))
    (tmp_path / "setup.yaml").write_text(rows(*lines[lines.index("setup.yaml:") + 1 :]).replace("\n    ", "\n").strip())
    setup = read_setup(tmp_path / "setup.yaml")
    assert len(read_table(tmp_path / "data.csv", setup.wheel)) == 3
    assert setup.noise.torque == 0.1 and setup.soil.density.known
