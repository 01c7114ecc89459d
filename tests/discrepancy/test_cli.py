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


BAD_TABLES = {
    "empty file": ("", r"data\.csv: empty file: expected a header"),
    "header alone": ("slip,load,sinkage\n", r"no rows below the header"),
    "missing column": (edited("load", "time", TABLE), r"missing column 'load'"),
    "nothing measured": (rows("slip,load", "0.1,100", "0.2,100"), r"expected at least one of sinkage"),
    "unknown column": (edited("drawbar_pull", "drawbar_pul", TABLE), r"'drawbar_pul'; did you mean 'drawbar_pull'\?"),
    "NaN": (rows("slip,load,torque", "0.1,100,2", "0.2,100,nan"), r"row 3, torque = 'nan': expected a finite number"),
    "text": (rows("slip,load,torque", "0.1,100,2", "0.2,heavy,3"), r"row 3, load = 'heavy': expected a finite number"),
    "sinkage in mm": (column("sinkage", lambda z: 1e3 * z), r"row 2, sinkage = [\d.]+: expected metres .*millimetres"),
    "slip in percent": (column("slip", lambda i: 100 * i), r"row 2, slip = 10.0: .* percent: divide by 100"),
    "negative load": (column("load", lambda w: -w), r"row 2, load = -100.0: expected a load > 0 N"),
    "load in kN": (column("load", lambda w: 1e-3 * w), r"load is 0.\d+ N .* expected newtons \(if it is kN"),
    "sinkage upward": (column("sinkage", lambda z: -z), r"sinkage is negative in every row: .* positive downward"),
    "torque backward": (column("torque", lambda t: -t), r"torque is negative in every row with slip > 0.05"),
    "torque in N mm": (column("torque", lambda t: 1e3 * t), r"torque is \d+ times load times radius .* newton metres"),
    "pull in mN": (column("drawbar_pull", lambda p: 1e3 * p), r"drawbar_pull is [\d.]+ times the load .* newtons"),
    "duplicate rows": (TABLE + TABLE.splitlines()[3] + "\n", r"row 8 repeats row 4"),
    "one slip": (table_text({}, slips=(0.2,)), r"slip = 0.2 in every row"),
    "speed partly empty": (rows("slip,load,speed,torque", "0.1,100,0.1,2", "0.2,100,,3"), r"row 3, speed is empty"),
    "semicolons": ("slip;load;torque\n0.1;100;2\n", r"semicolons between the columns"),
    "European": (
        "slip;load;torque\n0,1;100;2,5\n",
        r"semicolons .* and decimal commas: expected commas .* decimal points",
    ),
    "tabs": ("slip\tload\ttorque\n0.1\t100\t2\n", r"tabs between the columns: expected commas"),
    "decimal commas": (rows("slip,load,torque", '"0,1",100,2'), r"slip = '0,1': .* with a decimal point"),
    "ragged": ("slip,load,torque\n0.1,100\n", r"row 2 has 2 cells: expected 3"),
    "not text": (b"\xff\xfe\x00s", r"not UTF-8"),
}
BAD_SETUPS = {
    "misspelt section": (edited("noise:", "nosie:", SETUP), r"unknown key 'nosie'; did you mean 'noise'\?"),
    "misspelt key": (edited("cohesion:", "cohesoin:", SETUP), r"unknown key 'cohesoin'; did you mean 'cohesion'\?"),
    "noise of zero": (
        edited("sinkage: 0.0006", "sinkage: 0", SETUP),
        r"sinkage = 0: expected a standard deviation > 0",
    ),
    "negative noise": (edited("torque: 0.1", "torque: -1", SETUP), r"torque = -1: expected a standard deviation > 0"),
    "prior without sd": (edited(", sd: 700", "", SETUP), r"cohesion: missing sd"),
    "sd of zero": (edited("sd: 700", "sd: 0", SETUP), r"cohesion: sd = 0: expected > 0 \(write a known value"),
    "no wheel": (SETUP.split("\n", 1)[1], r"missing wheel"),
    "radius in mm": (edited("radius: 0.15", "radius: 150", SETUP), r"setup\.yaml: wheel\.radius = 150.0: expected a"),
    "radius of text": (edited("radius: 0.15", "radius: big", SETUP), r"setup\.yaml: wheel\.radius = 'big': expected a"),
    "not a mapping": ("- 1\n", r"expected a mapping at the top"),
    "not YAML": ("wheel: {radius", r"not valid YAML"),
    "friction in radians": (edited("value: 30,", "value: -30,", SETUP), r"friction_angle_deg = -30: expected"),
}


@pytest.mark.parametrize("table, message", BAD_TABLES.values(), ids=BAD_TABLES)
def test_a_bad_table_is_one_line(tmp_path, capsys, table, message):
    write_files(tmp_path, "")
    (tmp_path / "data.csv").write_bytes(table if isinstance(table, bytes) else table.encode())
    refused(tmp_path, capsys, message)


def test_a_byte_order_mark_is_read_over(tmp_path):
    write_files(tmp_path, TABLE)
    (tmp_path / "data.csv").write_bytes(b"\xef\xbb\xbf" + TABLE.replace("\n", "\r\n").encode())
    assert call(tmp_path, "--quiet", "--bootstrap", "0") == 0


@pytest.mark.parametrize("setup, message", BAD_SETUPS.values(), ids=BAD_SETUPS)
def test_a_bad_setup_is_one_line(tmp_path, capsys, setup, message):
    write_files(tmp_path, TABLE, setup)
    refused(tmp_path, capsys, message)


def refused(folder, capsys, message, *more, out="out"):
    """Exit status 2, one line that matches `message`, nothing printed and nothing written."""
    before = names(folder)
    assert call(folder, "--quiet", *more, out=out) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and shown.err.startswith("soil_env.discrepancy: ")
    assert re.search(message, shown.err), shown.err
    assert names(folder) == before


def test_values_that_hardly_scatter_need_a_noise(tmp_path, capsys):
    lines = [line.split(",") for line in table_text({}).splitlines()]
    text = rows("slip,load,sinkage", *(f"{line[1]},{line[0]},0.02" for line in lines[1:]))
    write_files(tmp_path, text, SETUP.split("noise:")[0])
    refused(tmp_path, capsys, r"noise of sinkage: the values hardly scatter, .* expected noise in the setup")


def test_too_few_values_to_tell_the_noise(tmp_path, capsys):
    write_files(tmp_path, table_text({}, loads=(100,), slips=(0.1, 0.3, 0.5)), SETUP.split("noise:")[0])
    refused(tmp_path, capsys, r"noise of sinkage: cannot be told from 3 values without repeats")


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
    said = [line for line in done.stderr.splitlines() if "cannot be printed (No space left on device)" in line]
    assert done.returncode == 2 and len(said) == 1 and done.stderr.splitlines()[-1] == said[0]
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
    assert shown.out == "" and shown.err.count("\n") == 1
    assert ("No space left" if status == 2 else "interrupted, nothing written") in shown.err
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
    assert err.splitlines()[-1] == "soil_env.discrepancy: interrupted, nothing written"
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
