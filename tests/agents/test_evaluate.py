"""`soil-env evaluate`: what it writes, that it goes on where it was, and bad input in one line."""

import csv
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy import stats

from agents import cells
from agents.controllers import make_controller
from agents.evaluate import HELD_OUT_SET, Runs, comparing, evaluation, run_courses
from agents.evaluate.driving import METRICS, RATES
from agents.evaluate.statistics import wilson
from agents.evaluate.tuning import tuned_settings
from soil_env.cli import main as soil_env
from soil_env.parameters import load_scenario
from soil_env.simulation.task import Cause
from tests.agents.evaluating import SHORT, evaluate, everything, result_of, same

ROOT = Path(__file__).resolve().parents[2]
FIXED = "--settings.fixed_slip.slip=0.2"
OTHERS = [("--courses=8", "courses"), ("--settings.fixed_slip.slip=0.3", "controllers")]


def main(arguments):
    """Exit status of `soil-env evaluate`."""
    return soil_env(["evaluate", *arguments])


def started(*arguments):
    """Ended process of `soil-env evaluate`."""
    command = [sys.executable, "-m", "soil_env.cli", "evaluate", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)


def runs_of(returns, finished=None):
    """`Runs` with these returns, that are finished or bogged."""
    returns = np.asarray(returns, dtype=float)
    ended = np.where(np.ones(returns.size) if finished is None else finished, Cause.FINISHED.value, Cause.BOGGED.value)
    return Runs(ended, *np.ones((5, returns.size)), returns)


# --- the comparison on known cases ------------------------------------------------------------------------------------


def test_a_comparison_of_known_runs():
    """Two training seeds of `a`, one of `b`, whose return is 1 less on every course; a quarter of `a` is bogged."""
    rng, scenario = np.random.default_rng(0), load_scenario("mixed")
    returns, ends = rng.normal(5.0, 2.0, (2, 40)), np.arange(40) >= 10
    runs = {"a": [runs_of(row, ends) for row in returns], "b": runs_of(returns.mean(axis=0) - 1.0)}
    found = comparing.comparison(scenario, 3, runs, resamples=400)
    assert found["members"] == {"a": 2, "b": 1} and found["courses"] == 40 and found["scenario"] == "mixed"
    a, b = found["controllers"]["a"], found["controllers"]["b"]
    assert a["finished"]["value"] == pytest.approx(0.75) and a["immobilised"]["value"] == pytest.approx(0.25)
    assert (b["finished"]["low"], b["finished"]["high"]) == pytest.approx(wilson(40, 40))
    assert found["by_seed"]["a"]["return"] == pytest.approx(returns.mean(axis=1))
    assert found["iqm"]["a"]["value"] == pytest.approx(stats.trim_mean(returns, 0.25, axis=None))
    paired = found["paired"]["a"]["b"]
    assert paired["return"]["value"] == pytest.approx(1.0) and paired["finished"]["value"] == pytest.approx(-0.25)
    assert paired["return"]["low"] <= 1.0 <= paired["return"]["high"]
    assert found["paired"]["b"]["a"]["return"]["high"] == pytest.approx(-paired["return"]["low"])
    p, q = found["improvement"]["a"]["b"], found["improvement"]["b"]["a"]
    assert p["value"] + q["value"] == pytest.approx(1.0) and p["low"] == pytest.approx(1.0 - q["high"])
    assert found == comparing.comparison(scenario, 3, runs, resamples=400)


@pytest.mark.parametrize("n", [1, 9, 500])
def test_one_outcome_for_all_courses_gives_intervals_that_contain_it(n):
    """At 0 % and 100 %, and with equal courses, rounding may not put the value outside its interval."""
    found = comparing.comparison(load_scenario(), 0, {"a": runs_of(np.full(n, 0.1))}, resamples=20)
    for name, m in found["controllers"]["a"].items():
        assert m["low"] <= m["value"] <= m["high"], name


# --- what is written --------------------------------------------------------------------------------------------------


def test_values_are_means_over_the_courses_that_are_listed(done):
    result = result_of(done)
    rows = list(csv.DictReader((done / "courses.csv").read_text().splitlines()))
    assert len(rows) == 7 * 5
    for name, metrics in result["controllers"].items():
        own = [row for row in rows if row["controller"] == name]
        assert len(own) == 7 * result["members"][name]
        for metric in set(result["metrics"]) - set(RATES):
            values = [float(row[metric]) for row in own if row[metric]]
            if values:
                assert metrics[metric]["value"] == pytest.approx(np.mean(values), rel=1e-4, abs=1e-9)
            else:
                assert metrics[metric]["value"] is None
        for cause in ("ENTRAPPED", "STALLED", "BOGGED", "TIME_LIMIT", "FINISHED"):
            share = sum(row["cause"] == cause for row in own) / len(own)
            assert metrics[cause.lower()]["value"] == pytest.approx(share)
    table = list(csv.DictReader((done / "evaluation.csv").read_text().splitlines()))
    assert [row["controller"] for row in table] == list(result["controllers"])
    assert float(table[0]["return_low"]) == pytest.approx(result["controllers"]["half"]["return"]["low"], rel=1e-4)


def test_the_table_of_train_comes_out_again(tmp_path):
    """For the classical controllers, with the same tuning: the default set of courses is that of train.py."""
    scenario, names = load_scenario(), ("fixed_slip", "best_slip_identified")
    chosen, _ = tuned_settings(scenario, 2, names)
    arguments = ["--courses=5", "--block=3", "--resamples=20", "--tuning-courses=2"]
    assert main([f"--controllers={','.join(names)}", f"--out={tmp_path / 'out'}", *arguments]) == 0
    result = result_of(tmp_path / "out")
    for name, row in result["controllers"].items():
        assert result["settings"][name] | chosen[name] == result["settings"][name] and result["chosen"][name] == "tuned"
        theirs = run_courses(make_controller(name, scenario, **chosen[name]), scenario, HELD_OUT_SET, 5)
        for metric in METRICS:
            assert row[metric]["value"] == pytest.approx(theirs.metric(metric).mean(), rel=1e-12), (name, metric)


def test_tuning_is_kept_and_not_done_again(tmp_path, capsys):
    more = ("--tuning-courses=2", "--settings.constant_speed.speed=0.3")
    names = "fixed_slip,constant_speed,full_throttle"
    assert evaluate(tmp_path / "out", names, *more) == 0
    assert "Tuning: 2 of 2 courses" in capsys.readouterr().out  # on 2 courses there is one trial
    kept = yaml.safe_load((tmp_path / "out" / "study.yaml").read_text())
    assert set(kept["tuned"]) == {"fixed_slip"} and set(kept["tuned"]["fixed_slip"]) == {"slip", "start", "speed"}
    result = result_of(tmp_path / "out")
    assert result["settings"]["fixed_slip"] == kept["tuned"]["fixed_slip"]
    assert result["settings"]["constant_speed"] == {"speed": 0.3}
    assert evaluate(tmp_path / "out", names, *more) == 0
    assert "Tuning" not in capsys.readouterr().out


def test_a_module_in_the_current_folder_is_found(tmp_path, monkeypatch):
    """And a class, a function that makes one, and an object drive alike."""
    text = "from tests.agents.drivers import Half, make\nhalf = Half()\n"
    (tmp_path / "mine_of_test.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    forms = ("make", "half", "Half")
    assert evaluate(tmp_path / "out", ",".join(f"{f}=mine_of_test:{f}" for f in forms)) == 0
    rows = result_of(tmp_path / "out")["controllers"]
    assert rows["make"] == rows["half"] == rows["Half"]


def test_effects_of_a_world_and_the_limit_of_the_oracle(tmp_path):
    world = ROOT / "configs/worlds/bulldozing.yaml"
    assert evaluate(tmp_path / "with", "soft_start", f"--model={world}", "--courses=3", "--oracle-courses=2") == 0
    assert evaluate(tmp_path / "without", "soft_start", "--courses=3") == 0
    there, plain = result_of(tmp_path / "with"), result_of(tmp_path / "without")
    assert list(there["model"]["effects"]) == ["bulldozing"] and "model" not in plain
    assert there["controllers"]["soft_start"]["return"] != plain["controllers"]["soft_start"]["return"]
    assert there["limit"]["courses"] == 2 and set(there["limit"]["avoidable"]) == {"soft_start"}
    assert "oracle (first 2 courses)" in (tmp_path / "with" / "evaluation.md").read_text()


# --- going on ---------------------------------------------------------------------------------------------------------


def test_an_interrupt_keeps_what_is_done(capsys, tmp_path, monkeypatch, done, models):
    out, controllers, original, count = tmp_path / "out", everything(models), evaluation.run_courses, []

    def interrupted(*args, **kw):
        if len(count) == 4:
            raise KeyboardInterrupt
        count.append(1)
        return original(*args, **kw)

    with monkeypatch.context() as patch:
        patch.setattr("soil_env_agents.evaluate.evaluation.run_courses", interrupted)
        assert evaluate(out, controllers, FIXED) == 130
    assert f"--resume {out}" in capsys.readouterr().err
    assert len(list((out / "cells").iterdir())) == 4 and not (out / "evaluation.json").exists()
    before = {p.name: p.stat().st_mtime_ns for p in (out / "cells").iterdir()}
    assert main(["--resume", str(out)]) == 0
    assert {name: (out / "cells" / name).stat().st_mtime_ns for name in before} == before
    same(out, done)


def test_kill_9_and_processes_give_the_same_table(tmp_path, monkeypatch, importable):
    """A controller that kills the process in the middle of a block; then two processes do the rest."""
    out, calm, mark = tmp_path / "out", tmp_path / "calm", tmp_path / "killed"
    asked = [*SHORT, "--changes.control.action=torque"]
    asked.append("--controllers=half=tests.agents.drivers:Half,tests.agents.drivers:Killer")
    monkeypatch.setenv("SOIL_ENV_TEST_KILL", str(mark))
    killed = started(*asked, f"--out={out}")
    assert killed.returncode == -9 and mark.exists() and len(list((out / "cells").iterdir())) == 1
    assert main(["--resume", str(out), "--workers=2"]) == 0
    assert main([*asked, f"--out={calm}"]) == 0
    same(out, calm)


def test_ray_gives_what_one_process_gives(cluster, models, done, tmp_path):
    """The models travel with the cells."""
    command = [f"--controllers={everything(models)}", FIXED, *SHORT, "--engine=ray"]
    ended = started(*command, f"--out={tmp_path}", f"--address={cluster.address}")
    assert ended.returncode == 0, ended.stderr[-2000:]
    same(tmp_path, done)


@pytest.mark.parametrize(
    "option, differs", [("--courses=8", "courses"), ("--settings.fixed_slip.slip=0.3", "controllers")]
)
def test_a_folder_of_another_evaluation_is_refused(capsys, tmp_path, done, models, option, differs):
    out = tmp_path / "copy"
    shutil.copytree(done, out)
    before = {p.name: p.read_bytes() for p in out.iterdir() if p.is_file()}
    own = [] if "fixed_slip" in option else [FIXED]
    assert evaluate(out, everything(models), *own, option) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and f"it differs in {differs})" in error
    assert {p.name: p.read_bytes() for p in out.iterdir() if p.is_file()} == before


def test_a_model_or_code_that_has_changed_is_refused(capsys, tmp_path, models):
    mine, out = tmp_path / "model.zip", tmp_path / "out"
    shutil.copy(models / "seed_0" / "model.zip", mine)
    assert evaluate(out, f"ppo={mine}", "--courses=2") == 0
    shutil.copy(models / "seed_1" / "model.zip", mine)
    assert main(["--resume", str(out)]) == 2
    assert "the model has changed since the study began" in capsys.readouterr().err
    text = (out / "study.yaml").read_text()
    assert f"version: {cells.code_version()}\n" in text
    (out / "study.yaml").write_text(text.replace("version: 0.1.0+", "version: 0.0.9+"))
    assert main(["--resume", str(out)]) == 2
    assert "begun with soil_env 0.0.9+" in capsys.readouterr().err


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments, parts",
    [
        (["--controllers=fixd_slip"], ("'fixd_slip'", "did you mean 'fixed_slip'?")),
        (["--controllers=missing.zip"], ("missing.zip", "No such file")),
        (["--controllers={models}/seed_*"], ("2 models", "NAME=")),
        (["--controllers={models}/seed_0,{models}/seed_0"], ("'seed_0' twice",)),
        (["--controllers=tests.agents.drivers:Halve"], ("'Halve'", "did you mean 'Half'?")),
        (["--controllers=tests.agents.drivers:NoPredict"], ("no method predict",)),
        (["--controllers=tests.agents.drivers:WrongShape"], ("tests.agents.drivers:WrongShape", "(3,)", "(3, 1)")),
        (["--controllers=tests.agents.drivers:OneNaN"], ("predict gave nan for wheel 1: expected finite numbers",)),
        (["--controllers=tests.agents.drivers:NoState"], ("expected (action, state)",)),
        (["--controllers=tests.agents.drivers:OtherVariant"], ("'blnd'", "blind, identified, true_soil")),
        (["--controllers=tests.agents.drivers:Raises"], ("OSError: no such device", "drivers.py line")),
        (["--controllers=oracle"], ("--oracle-courses N",)),
        (["--oracle-courses=9"], ("--oracle-courses = 9",)),
        (["--settings.full_throttle.slip=0.1", "--controllers=full_throttle"], ("full_throttle has no settings",)),
        (["--changes.course.lenght=2"], ("lenght", "did you mean 'length'?")),
        (["--tuning-courses=2", "--seed=1000001"], ("--seed 1000001", "tuned on")),
        (["--resume={models}"], ("takes only the engine",)),
    ],
)
def test_bad_input_is_refused_in_one_line_and_nothing_is_written(capsys, tmp_path, models, arguments, parts):
    arguments = [a.format(models=models) for a in arguments]
    given = {a.split("=")[0] for a in arguments}
    out = tmp_path / "out"
    command = [a for a in (*SHORT, f"--out={out}") if a.split("=")[0] not in given]
    if "--controllers" not in given:
        command.append("--controllers=full_throttle")
    assert main([*command, *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("soil-env evaluate: error: ")
    assert captured.err.count("\n") == 1 and len(captured.err) < 700
    for part in parts:
        assert part in captured.err
    assert not out.exists() and not list(tmp_path.iterdir())


def test_a_controller_that_fails_on_the_way_is_named(capsys, tmp_path):
    assert evaluate(tmp_path / "out", "full_throttle,mine=tests.agents.drivers:LateNaN") == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "action nan in step 3" in error and "tests.agents.drivers:LateNaN" in error
    assert len(list((tmp_path / "out" / "cells").iterdir())) == 1  # what was done before is kept


@pytest.mark.parametrize("out", ["{tmp}/file/out", "{tmp}/other"])
def test_a_folder_that_cannot_be_used_is_refused(capsys, tmp_path, out):
    (tmp_path / "file").write_text("text")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").write_text("mine")
    out = out.format(tmp=tmp_path)
    assert main([*SHORT, "--controllers=full_throttle", f"--out={out}"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and out.rsplit("/", 1)[0] in error
    assert [p.name for p in (tmp_path / "other").iterdir()] == ["thesis.txt"]
