"""Calibration of the online identifier: rows, their names, and what is refused."""

from functools import partial

import numpy as np

from benchmarks import identification as study
from benchmarks.common import RESULTS, read_json
from soil_env.cli.running import run
from tests.refusals import refused_command


def test_rows_are_finite_and_measured_once(tmp_path, monkeypatch, capsys):
    """Two of the cases, of a wheel and of a rover: a second run measures nothing. The published
    rows have the same keys.
    """
    published = read_json(RESULTS / "identification.json")["rows"]
    every = study.cases()
    assert every.keys() <= published.keys()
    names = ("two_lines/-/swinging_speed/torque", "field_rover/-/swinging slip/-")
    two = {name: every[name] for name in names}
    made = []
    measure = study.measure
    arguments = ["--courses=2", f"--out={tmp_path}"]
    monkeypatch.setattr(study, "cases", lambda: two)
    monkeypatch.setattr(study, "measure", lambda case, *of: made.append(case) or measure(case, *of))
    assert [run(study.command, arguments, "") for _ in range(2)] == [0, 0]
    assert made == [*two.values()]
    for name, row in read_json(tmp_path / "identification.json")["rows"].items():
        assert row.keys() == published[name].keys()
        for kind in (study.SHIPPED, *study.SENSORS):
            found = row[kind]
            assert found.keys() == published[name][kind].keys()
            assert all(np.all(np.isfinite(values)) for values in found.values())
            assert np.all(np.array(found["rms"]) > 0.0) and found["holds_68"] != [0.0] * 3
    wrong = partial(run, study.command, name="identification")
    said = refused_command(capsys, "identification", wrong, "--courses=3", f"--out={tmp_path}")
    assert f"identification.json: rows of seed {study.SEED} and courses 2; expected" in said.err
    said = refused_command(capsys, "identification", wrong, "--only=stickyy", *arguments)
    assert "stickyy" in said.err
