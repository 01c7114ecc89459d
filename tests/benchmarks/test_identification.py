"""Calibration of the online identifier: rows, their names, and what is refused."""

import numpy as np

from benchmarks import identification as study
from benchmarks.common import RESULTS, read_json
from soil_env.cli.running import run


def test_rows_are_finite_and_measured_once(tmp_path, monkeypatch, capsys):
    published = read_json(RESULTS / "identification.json")["rows"]
    every = study.cases()
    assert every.keys() <= published.keys()
    two = {
        name: every[name]
        for name in ("two_lines/-/swinging_speed/torque", "field_rover/-/swinging slip/-")
    }
    made = []
    measure = study.measure
    arguments = ["--courses", "2", "--out", str(tmp_path)]
    monkeypatch.setattr(study, "cases", lambda: two)
    monkeypatch.setattr(
        study, "measure", lambda case, *given: made.append(case) or measure(case, *given)
    )
    assert [run(study.command, arguments, "") for _ in range(2)] == [0, 0] and made == [
        *two.values()
    ]
    for name, row in read_json(tmp_path / "identification.json")["rows"].items():
        assert row.keys() == published[name].keys()
        assert {study.SHIPPED, *study.SENSORS} <= row.keys()
        for kind in (study.SHIPPED, *study.SENSORS):
            found = row[kind]
            assert found.keys() == published[name][kind].keys()
            assert np.all(np.isfinite(np.concatenate([np.ravel(v) for v in found.values()])))
            assert np.all(np.array(found["rms"]) > 0.0) and found["holds_68"] != [0.0] * 3
    capsys.readouterr()
    assert run(study.command, ["--only", "stickyy", *arguments], "") == 2
    said = capsys.readouterr().err
    assert "stickyy" in said and said.count("\n") == 1
