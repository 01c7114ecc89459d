"""`python -m agents.evaluate`: what it writes and prints."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.stats import binomtest

from agents.controllers import make_controller
from agents.evaluate import HELD_OUT_SET, report, run_courses, study, summary
from agents.evaluate.__main__ import _asked, main, parser
from agents.evaluate.records import METRICS, RATES
from agents.evaluate.tuning import tuned_settings
from soil_env.parameters import load_scenario
from tests.agents.evaluating import CLASSES, FILES, evaluate, result_of


def test_the_folder_holds_what_is_promised(done):
    assert {p.name for p in done.iterdir()} == FILES
    result = result_of(done)
    assert list(result["controllers"]) == ["half", "tests.agents.drivers:Counting", "fixed_slip", "ppo"]
    assert result["controllers"]["ppo"]["members"] == 2 and len(result["controllers"]["ppo"]["sources"]) == 2
    assert result["controllers"]["fixed_slip"]["settings"] == pytest.approx({"slip": 0.2, "start": 0.03, "speed": 0.75})
    assert (result["courses"], result["seed"], result["scenario"]) == (7, 11, "two_lines")
    for name, entry in result["controllers"].items():
        assert set(entry["metrics"]) == set(METRICS)
        for metric, m in entry["metrics"].items():
            if m["value"] is None:
                assert m["runs"] == 0
            else:
                assert m["low"] <= m["value"] <= m["high"], (name, metric)
        assert "stratified" in entry["iqm"]["return"] or entry["members"] == 1
        assert entry["profile"]["distance"]["share"] == sorted(entry["profile"]["distance"]["share"], reverse=True)


def test_the_columns_are_explained_where_they_are_printed(done, capsys):
    report.print_table(result_of(done))
    said = " ".join(capsys.readouterr().out.split())
    assert "foreseen [%]: share of immobilised courses, the probability of immobilisation gave warning then;" in said
    assert "tractive eff.: drawbar work over motor work" in said and "slip: median slip" in said


def test_values_are_means_over_the_courses_that_are_listed(done):
    result = result_of(done)
    with open(done / "courses.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 7 * 5
    for name, entry in result["controllers"].items():
        own = [row for row in rows if row["controller"] == name]
        assert len(own) == 7 * entry["members"]
        for metric in set(METRICS) - set(RATES):
            values = [float(row[metric]) for row in own if row[metric]]
            m = entry["metrics"][metric]
            assert len(values) == m["runs"]
            if values:
                assert m["value"] == pytest.approx(np.mean(values), rel=1e-4, abs=1e-9)
        stuck = [row for row in own if row["cause"] in ("ENTRAPPED", "STALLED", "BOGGED")]
        assert entry["metrics"]["immobilised"]["value"] == pytest.approx(len(stuck) / len(own))
        assert entry["metrics"]["warned"]["runs"] == len(stuck)
        for cause in ("ENTRAPPED", "STALLED", "BOGGED", "TIME_LIMIT", "FINISHED"):
            share = sum(row["cause"] == cause for row in own) / len(own)
            assert entry["metrics"][cause.lower()]["value"] == pytest.approx(share)
        if entry["members"] == 1:
            expected = binomtest(len(stuck), 7).proportion_ci(0.95, method="wilson")
            m = entry["metrics"]["immobilised"]
            assert (m["low"], m["high"]) == pytest.approx((expected.low, expected.high), abs=1e-9)


def test_the_table_is_the_json(done):
    result = result_of(done)
    with open(done / "evaluation.csv", newline="") as file:
        rows = {row["controller"]: row for row in csv.DictReader(file)}
    assert list(rows) == list(result["controllers"])
    for name, row in rows.items():
        for metric, m in result["controllers"][name]["metrics"].items():
            for part, key in (("", "value"), ("_low", "low"), ("_high", "high")):
                if m[key] is None:
                    assert row[metric + part] == ""
                else:
                    assert float(row[metric + part]) == pytest.approx(m[key], rel=1e-5, abs=1e-9)


def test_paired_differences_and_probabilities_are_consistent(done):
    result = result_of(done)
    for a, others in result["paired"].items():
        for b, row in others.items():
            values = [result["controllers"][n]["metrics"] for n in (a, b)]
            for metric, m in row.items():
                assert m["value"] == pytest.approx(values[0][metric]["value"] - values[1][metric]["value"])
                back = result["paired"][b][a][metric]
                assert (m["low"], m["high"]) == pytest.approx((-back["high"], -back["low"]))
            p, q = result["improvement"][a][b], result["improvement"][b][a]
            assert p["value"] + q["value"] == pytest.approx(1.0)
            assert p["low"] == pytest.approx(1.0 - q["high"])


def test_names_are_escaped_in_the_report(tmp_path):
    file = tmp_path / "a<b>&c.yaml"
    file.write_text((Path(study.__file__).parents[2] / "configs/scenarios/mixed.yaml").read_text())
    out = tmp_path / "out"
    assert evaluate(out, "full_throttle", f"--scenario={file}") == 0
    text = (out / "report.html").read_text()
    assert "a&lt;b&gt;&amp;c" in text and "a<b>" not in text
    assert not re.search(r"<(script|link|iframe|object)|@import|https?://", text)  # one page, nothing from elsewhere


def test_all_forms_of_a_class_path(tmp_path):
    forms = ("make", "half", "Half", "WithScenario")
    assert evaluate(tmp_path / "out", ",".join(f"{f}=tests.agents.drivers:{f}" for f in forms)) == 0
    rows = result_of(tmp_path / "out")["controllers"]
    assert rows["make"]["metrics"] == rows["half"]["metrics"] == rows["Half"]["metrics"]
    assert rows["Half"]["metrics"] != rows["WithScenario"]["metrics"]


def test_tuning_is_kept_and_not_done_again(tmp_path, capsys):
    more = ("--tuning-courses=2", "--settings.constant_speed.speed=0.3")
    names = "fixed_slip,constant_speed,full_throttle"
    assert evaluate(tmp_path / "out", names, *more) == 0
    assert "Tuning: 2 of 2 courses" in capsys.readouterr().out  # on 2 courses there is one trial
    kept = yaml.safe_load((tmp_path / "out" / "study.yaml").read_text())
    assert set(kept["tuned"]) == {"fixed_slip"} and set(kept["tuned"]["fixed_slip"]) == {"slip", "start", "speed"}
    rows = result_of(tmp_path / "out")["controllers"]
    assert rows["fixed_slip"]["settings"] == kept["tuned"]["fixed_slip"]
    assert rows["constant_speed"]["settings"] == {"speed": 0.3}
    assert evaluate(tmp_path / "out", names, *more) == 0
    assert "Tuning" not in capsys.readouterr().out


# --- what the classical controllers are set to ------------------------------------------------------------------------


def test_classical_controllers_beside_others_are_tuned_unless_asked_not_to(tmp_path):
    asked = [f"--controllers=best_slip_identified,{CLASSES}", "--out=x", "--courses=3"]
    for more, expected in (([], 3), (["--tuning-courses=0"], 0), (["--courses=500"], 200)):
        options, rest = parser().parse_known_args([*asked, *more])
        assert _asked(options, rest).tuning_courses == expected
    for alone in ("best_slip_identified,fixed_slip", "full_throttle"):
        options, rest = parser().parse_known_args([f"--controllers={alone}", "--out=x"])
        assert _asked(options, rest).tuning_courses == 0


def test_the_table_of_train_comes_out_again(tmp_path):
    """For the classical controllers, with the same tuning: the default set of courses is that of train.py."""
    scenario, names = load_scenario(), ("fixed_slip", "best_slip_identified")
    chosen, _ = tuned_settings(scenario, 2, names, lambda count, name: None)
    arguments = ["--courses=5", "--block=3", "--resamples=20", "--tuning-courses=2"]
    assert main([f"--controllers={','.join(names)}", f"--out={tmp_path / 'out'}", *arguments]) == 0
    for name, row in result_of(tmp_path / "out")["controllers"].items():
        assert row["settings"] | chosen[name] == row["settings"] and row["chosen"] == "tuned"
        theirs = summary(run_courses(make_controller(name, scenario, **chosen[name]), scenario, HELD_OUT_SET, 5))
        for metric, entry in theirs.items():
            assert row["metrics"][metric]["value"] == pytest.approx(entry["value"], rel=1e-14), (name, metric)
