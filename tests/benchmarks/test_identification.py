"""Calibration of the online identifier: statistics, rows and their page."""

import argparse
import json

import numpy as np

from benchmarks import identification as study
from benchmarks.drives import QUANTITIES, UNITS


def test_statistics_of_errors_as_stated_hold_as_stated():
    rng = np.random.default_rng(0)
    sd = np.tile(np.array([0.1, 0.2, 0.3, 400.0, 0.4, 0.05]), (20_000, 1))
    error = sd * rng.standard_normal(sd.shape)
    found = study.statistics(error, sd, 3.0 * sd, np.repeat(np.arange(200), 100), UNITS)
    np.testing.assert_allclose(found["holds_68"], 68.3, atol=1.5)
    np.testing.assert_allclose(found["holds_95"], 95.0, atol=0.7)
    np.testing.assert_allclose(found["rms"], found["sd"], rtol=0.03)
    assert np.all(found["far"] < 0.6) and np.all(np.abs(found["bias_over_sd"]) < 0.05)
    biased = study.statistics(error + sd, sd, 3.0 * sd, np.repeat(np.arange(200), 100), UNITS)
    np.testing.assert_allclose(biased["bias_over_sd"], 1.0, atol=0.05)
    assert np.all(biased["holds_68"] < 55.0)


def test_rows_of_a_wheel_and_a_rover():
    options = argparse.Namespace(courses=2, seed=3)
    case = study.Case("two_lines", "", "best_slip_identified")
    assert case in study.cases() and len(set(study.cases())) == len(study.cases())
    row = study.measure(case, options)
    assert len(row["rms"]) == len(QUANTITIES) and row["steps"] > 100
    other = study.measure(study.Case("mixed", "grousers", "soft_start"), options)
    rover = study.measure_rover(study.Case("field_rover", "", "swinging slip"), options)
    assert len(rover["rms"]) == 3 and rover["rms"][1] < rover["prior_rms"][1]
    tables = study.tables({"rows": {"a": row, "b": other, "c": rover}})
    medians = next(iter(tables.values()))
    assert [r[0] for r in medians.rows] == ["two_lines", "mixed with grousers", "field_rover"]


def test_study_goes_on_where_it_was_and_makes_named_rows_anew(tmp_path, monkeypatch):
    made = []

    def row(case, options):
        made.append(case.name)
        sizes = dict.fromkeys(
            ("bias_over_sd", "rms", "prior_rms", "holds_68", "holds_95", "far", "farthest"), [0.1] * 6
        )
        return case._asdict() | sizes

    monkeypatch.setattr(study, "OWN", ("two_lines", "sticky"))
    monkeypatch.setattr(study, "OTHERS", study.OTHERS[:1])
    monkeypatch.setattr(study, "measure", row)
    monkeypatch.setattr(study, "measure_rover", row)
    arguments = ["--smoke", "--out", str(tmp_path)]
    assert study.main(arguments) == 0
    result = json.loads((tmp_path / "identification.json").read_text(encoding="utf-8"))
    assert sorted(made) == sorted(result["rows"]) and "| two_lines |" in (tmp_path / "identification.md").read_text()
    del result["rows"][made[7]]
    (tmp_path / "identification.json").write_text(json.dumps(result), encoding="utf-8")
    lost, all_made = made[7], list(made)
    made.clear()
    assert study.main(arguments) == 0 and made == [lost]
    made.clear()
    assert study.main([*arguments, "--only", "sticky"]) == 0
    assert made == [name for name in all_made if name.startswith("sticky/")]
    assert study.main([*arguments, "--only", "stickyy"]) == 2
