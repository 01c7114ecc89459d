"""`soil-env discover`: exit status, messages, files, and nothing half written."""

import json
import re

import pytest

from soil_env._io.files import MANIFEST, write_own
from soil_env.cli import main
from soil_env.discovery import report, workflow
from tests.discovery.files import SETUP, changed, table_text, write_files

NAMES = ["model.yaml", "report.html", "report.json"]
TABLE = table_text({}, loads=(100, 200), slips=(0.1, 0.3, 0.5))


def call(folder, *more, out="out"):
    """Exit status of the command on the files of a folder."""
    data = folder / "data.csv"
    setup = folder / "setup.yaml"
    return main(["discover", str(data), "--setup", str(setup), "--out", str(folder / out), *more])


def names(folder):
    """Files of a folder, without the list of those that commands wrote."""
    return sorted(p.name for p in folder.iterdir() if p.name != MANIFEST)


@pytest.mark.usefixtures("unrendered")
def test_a_run_writes_three_files_and_says_so(tmp_path, capsys):
    table = table_text({"slip_sinkage": {"gain": 0.6}}, loads=(100, 200), slips=(0.1, 0.3, 0.5))
    write_files(tmp_path, table, SETUP + "rig: {slips: [0.2, 0.6], loads: [150, 300]}\n")
    assert call(tmp_path, "--next", "2") == 0
    shown = capsys.readouterr()
    content = json.loads((tmp_path / "out" / "report.json").read_text())
    assert 0 < len(content["next_tests"]) <= 2 and "Runs to make next" in shown.out
    for k, said in enumerate(content["next_tests"], start=1):
        point = said["conditions"]
        assert point["slip"] in (0.2, 0.6) and point["load"] in (150, 300)
        assert re.search(rf"^ +{k} +{point['slip']} +{point['load']:g} ", shown.out, re.M)
        assert {"name", "probability", "mean", "sd"} == {*said["predicted"][0]}
    assert "Runs to make next" in (tmp_path / "out" / "report.html").read_text()
    assert names(tmp_path / "out") == NAMES and names(tmp_path) == ["data.csv", "out", "setup.yaml"]
    for name in NAMES:
        assert f"written: {tmp_path / 'out' / name}" in shown.out


# what every reader of tables and setups refuses is in tests/measurement; doubts in test_doubts
BAD = {
    "sinkage upward": (
        changed(TABLE, "sinkage", -1.0),
        SETUP,
        r"sinkage is negative in every row: .* downward",
    ),
    "torque in N mm": (
        changed(TABLE, "torque", 1e3),
        SETUP,
        r"torque is \d+ times load times radius .* newton metres",
    ),
    "speed partly empty": (
        "slip,load,speed,torque\n0.1,100,0.1,2\n0.2,100,,3\n",
        SETUP,
        r"row 3, speed is empty",
    ),
    "misspelt key": (
        TABLE,
        SETUP.replace("cohesion:", "cohesoin:", 1),
        r"'cohesoin'; did you mean 'cohesion'\?",
    ),
    "too few for the noise": (
        table_text({}, loads=(100,), slips=(0.1, 0.3, 0.5)),
        SETUP.split("noise:")[0],
        r"noise of sinkage: cannot be estimated from 3 values",
    ),
}


@pytest.mark.parametrize("table, setup, message", BAD.values(), ids=BAD)
def test_bad_input_is_one_line(tmp_path, capsys, table, setup, message):
    write_files(tmp_path, table, setup)
    before = names(tmp_path)
    assert call(tmp_path, "--quiet") == 2
    shown = capsys.readouterr()
    assert (
        shown.out == ""
        and shown.err.count("\n") == 1
        and shown.err.startswith("soil-env discover: ")
    )
    assert re.search(message, shown.err), shown.err
    assert names(tmp_path) == before


@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize(
    "step, error, status",
    [
        ("write_own", OSError(28, "No space left on device"), 2),
        ("page", KeyboardInterrupt(), 130),
    ],
)
def test_nothing_is_left_when_writing_fails(
    tmp_path, capsys, monkeypatch, nothing, step, error, status
):
    """The report is there; what is judged is how it is written."""
    write_files(tmp_path, TABLE)
    monkeypatch.setattr(workflow, "_conclude", lambda *arguments: nothing)
    write_own(tmp_path / "out", {"report.json": "old"})

    def fail(*arguments):
        raise error

    monkeypatch.setattr(report, step, fail)
    for out, left in (("out", ["report.json"]), ("new", None)):
        assert call(tmp_path, "--quiet", out=out) == status
        shown = capsys.readouterr()
        assert shown.out == "" and shown.err.strip().count("\n") == 0
        assert ("No space left" if status == 2 else "interrupted") in shown.err
        assert (names(tmp_path / out) if (tmp_path / out).exists() else None) == left
    assert (tmp_path / "out" / "report.json").read_text() == "old"
