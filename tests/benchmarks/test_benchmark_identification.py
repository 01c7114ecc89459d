"""benchmarks/identification.py: every part gives numbers, the page is written, and parts can be made anew alone."""

import json

import numpy as np
import pytest

from benchmarks import identification
from benchmarks.identification_contenders import is_informative
from soil_env.identification.online import SensorReading, identifier_numbers
from soil_env.parameters import load_scenario


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("study")
    assert identification.main(["--smoke", "--out", str(out)]) == 0
    return out


def _read(folder):
    return json.loads((folder / "identification.json").read_text(encoding="utf-8"))


def test_smoke_run(folder):
    result = _read(folder)
    for part in identification.PARTS:
        assert result[part] and result["made"][part]["command"] == "python benchmarks/identification.py --smoke"
    assert (folder / "identification.md").read_text(encoding="utf-8").startswith("# ")


def test_every_estimator_stands_beside_the_bound(folder):
    bound = _read(folder)["bound"]
    assert len(bound["ratio"]) == len(bound["inside_68"]) == 9
    for label, ratio in bound["ratio"].items():
        direct = np.divide(bound["rms"][label]["all"], bound["rms"]["bound, all sensors"]["all"])
        np.testing.assert_allclose(ratio["value"], direct, rtol=1e-9)
    rows = bound["loss"]
    assert sum(row[2] for row in rows) == pytest.approx(1.0)
    np.testing.assert_allclose(np.sum([row[5] for row in rows], axis=0), 1.0)


def test_parts_made_anew_keep_the_others(folder):
    before = _read(folder)
    assert identification.main(["--smoke", "--parts", "speed", "--seed", "3", "--out", str(folder)]) == 0
    after = _read(folder)
    assert after["made"]["speed"] == before["made"]["speed"] | {
        "command": "python benchmarks/identification.py --smoke --parts speed",
        "seed": 3,
    }
    assert all(after[part] == before[part] for part in identification.PARTS if part != "speed")
    assert "--parts speed`, seed 3" in (folder / "identification.md").read_text(encoding="utf-8")


def test_parts_without_the_others_are_refused(tmp_path, capsys):
    (tmp_path / "identification.json").write_text('{"made": {}}')
    assert identification.main(["--smoke", "--parts", "speed", "--out", str(tmp_path)]) == 2
    assert (
        "has no bound, convergence, efficiency, identifiability, manoeuvre, one_soil, online, other_seed"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize("content", ["{broken", "[]", '{"made": 3}', "\\xff", '{"made": {"online": "x"}}'])
def test_a_broken_file_of_the_other_parts_is_refused_before_anything_is_made(tmp_path, capsys, content, monkeypatch):
    monkeypatch.setattr(identification, "study", lambda *_: pytest.fail("made"))
    (tmp_path / "identification.json").write_bytes(content.encode().decode("unicode_escape").encode("latin-1"))
    assert identification.main(["--smoke", "--parts", "speed", "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err.strip()
    assert "identification.json: " in said and "\n" not in said


def test_parts_of_another_version_lose_nothing(folder, tmp_path, capsys):
    kept = _read(folder) | {"one_soil": {}}
    (tmp_path / "identification.json").write_text(json.dumps(kept))
    assert identification.main(["--smoke", "--parts", "speed", "--out", str(tmp_path)]) == 2
    assert "is of another version (KeyError" in capsys.readouterr().err
    assert _read(tmp_path)["speed"] != kept["speed"]


def test_no_contender_reads_a_wheel_that_turns_backwards():
    scenario = load_scenario("mixed")
    reading = SensorReading(0.3, 0.03, 20.0, 150.0, 10.0, 0.1, 0.15, 0.0, 10.0, 0.0)
    numbers = identifier_numbers(scenario)
    assert is_informative(reading, numbers)
    assert not is_informative(reading._replace(rim_speed=-0.15), numbers)
