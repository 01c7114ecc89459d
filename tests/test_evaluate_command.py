"""`python -m agents.evaluate`: what it writes, that it goes on where it was, and what it refuses."""

import csv
import errno
import json
import os
import re
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
import yaml
from scipy.stats import binomtest

from agents import ppo
from agents.evaluate import HELD_OUT_SET, study
from agents.evaluate.__main__ import main, parser
from agents.evaluate.records import METRICS, RATES
from soil_env.loading import ParameterError
from soil_env.parameters import load_scenario
from tests.saved import edit, rewrite

CLASSES = "half=tests.drivers:Half,tests.drivers:Counting"
SHORT = (
    "--changes.control.time_limit=6 --changes.course.length=2 --courses=7 --block=3 --resamples=50 --seed=11"
).split()
FILES = {"report.html", "evaluation.json", "evaluation.csv", "courses.csv", "study.yaml", "courses.jsonl",
         "metrics.png", "causes.png", "profiles.png", "improvement.png"}  # fmt: skip
TINY = ppo.PPOConfig(num_envs=4, n_steps=8, batch_size=32, n_epochs=1, layer=4)


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Two training seeds of an agent, as train.py leaves them, with hardly any training."""
    folder = tmp_path_factory.mktemp("models")
    for seed in (0, 1):
        model = ppo.build(load_scenario(), "blind", TINY, seed)
        model.learn(64)
        (folder / f"seed_{seed}").mkdir()
        ppo.save(model, folder / f"seed_{seed}" / "model.zip")
    return folder


def evaluate(out, controllers, *more):
    return main(["--controllers", controllers, "--out", str(out), *SHORT, *more])


def result_of(folder):
    def refuse(constant):
        raise AssertionError(constant)

    return json.loads((folder / "evaluation.json").read_text(), parse_constant=refuse)


def same(a, b):
    """Two folders hold the same results, to the byte; figures and report included."""
    for name in FILES - {"courses.jsonl", "study.yaml"}:
        assert (a / name).read_bytes() == (b / name).read_bytes(), name
    lines = [sorted((f / "courses.jsonl").read_text().splitlines()) for f in (a, b)]
    assert lines[0] == lines[1]


@pytest.fixture(scope="module")
def done(models, tmp_path_factory):
    """A finished evaluation of a classical controller, two classes and two training seeds."""
    out = tmp_path_factory.mktemp("done") / "made" / "here"
    assert evaluate(out, f"{CLASSES},fixed_slip,ppo={models}/seed_*", "--settings.fixed_slip.slip=0.2") == 0
    return out


# --- what it writes ---------------------------------------------------------------------------------------------------


def test_the_folder_holds_what_is_promised(done):
    assert {p.name for p in done.iterdir()} == FILES
    result = result_of(done)
    assert list(result["controllers"]) == ["half", "tests.drivers:Counting", "fixed_slip", "ppo"]
    assert result["controllers"]["ppo"]["members"] == 2 and len(result["controllers"]["ppo"]["sources"]) == 2
    assert result["controllers"]["fixed_slip"]["settings"] == {"slip": 0.2}
    assert (result["courses"], result["seed"], result["scenario"]) == (7, 11, "mixed")
    for name, entry in result["controllers"].items():
        assert set(entry["metrics"]) == set(METRICS)
        for metric, m in entry["metrics"].items():
            if m["value"] is None:
                assert m["runs"] == 0
            else:
                assert m["low"] <= m["value"] <= m["high"], (name, metric)
        assert "stratified" in entry["iqm"]["return"] or entry["members"] == 1
        assert entry["profile"]["distance"]["share"] == sorted(entry["profile"]["distance"]["share"], reverse=True)


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


def test_the_report_loads_nothing_from_elsewhere(done):
    text = (done / "report.html").read_text()
    sources = re.findall(r"(?:src|href|url)\s*[=(]\s*['\"]?([^'\">)]{0,30})", text)
    assert len(sources) == 4 and all(s.startswith("data:image/png;base64,") for s in sources)
    assert not re.search(r"<(script|link|iframe|object)|@import|https?://", text)
    for name in ("half", "tests.drivers:Counting", "fixed_slip", "ppo", "Other conditions", "1.8 m"):
        assert name in text
    assert text.count("<table>") == text.count("</table>") == 4


def test_the_figures_are_drawn(done):
    for name in (n for n in FILES if n.endswith(".png")):
        picture = plt.imread(done / name)
        assert picture.shape[1] > 400 and picture[..., :3].std() > 0.01, name


def test_names_are_escaped_in_the_report(tmp_path):
    file = tmp_path / "a<b>&c.yaml"
    file.write_text((Path(study.__file__).parents[2] / "configs/scenarios/mixed.yaml").read_text())
    out = tmp_path / "out"
    assert evaluate(out, "full_throttle", f"--scenario={file}") == 0
    text = (out / "report.html").read_text()
    assert "a&lt;b&gt;&amp;c" in text and "a<b>" not in text


def test_the_printed_table_names_all_and_the_reference(capsys, tmp_path, models):
    assert evaluate(tmp_path / "out", f"half=tests.drivers:Half,ppo={models}/seed_*") == 0
    out = capsys.readouterr().out
    assert "7 courses of scenario 'mixed'" in out and "half" in out and "ppo (2 seeds)" in out
    assert "1.8 m and 2.9 s" in out and "Other conditions" in out and "report.html" in out
    assert "Driving: 21 of 21 courses" in out


def test_all_forms_of_a_class_path(tmp_path):
    forms = ("make", "half", "Half", "WithScenario")
    assert evaluate(tmp_path / "out", ",".join(f"{f}=tests.drivers:{f}" for f in forms)) == 0
    rows = result_of(tmp_path / "out")["controllers"]
    assert rows["make"]["metrics"] == rows["half"]["metrics"] == rows["Half"]["metrics"]
    assert rows["Half"]["metrics"] != rows["WithScenario"]["metrics"]


def test_tuning_is_kept_and_not_done_again(tmp_path, capsys):
    more = ("--tuning-courses=2", "--settings.constant_speed.speed=0.3")
    names = "fixed_slip,constant_speed,full_throttle"
    assert evaluate(tmp_path / "out", names, *more) == 0
    assert "Tuning: 50 of 50 courses" in capsys.readouterr().out  # 25 settings of fixed_slip on 2 courses
    kept = yaml.safe_load((tmp_path / "out" / "study.yaml").read_text())
    assert set(kept["tuned"]) == {"fixed_slip"} and set(kept["tuned"]["fixed_slip"]) == {"slip", "start"}
    rows = result_of(tmp_path / "out")["controllers"]
    assert rows["fixed_slip"]["settings"] == kept["tuned"]["fixed_slip"]
    assert rows["constant_speed"]["settings"] == {"speed": 0.3}
    assert evaluate(tmp_path / "out", names, *more) == 0
    assert "Tuning" not in capsys.readouterr().out


# --- going on ---------------------------------------------------------------------------------------------------------


def interrupted_after(monkeypatch, blocks, error=KeyboardInterrupt):
    """Have the driving of a block fail after that many."""
    original, count = study.record, []

    def record(*args, **kw):
        if len(count) == blocks:
            raise error()
        count.append(1)
        return original(*args, **kw)

    monkeypatch.setattr(study, "record", record)


@pytest.mark.parametrize("again", ["resume", "the same command"])
def test_an_interrupt_keeps_what_is_done(capsys, tmp_path, monkeypatch, done, models, again):
    out, controllers = tmp_path / "out", f"{CLASSES},fixed_slip,ppo={models}/seed_*"
    with monkeypatch.context() as patch:
        interrupted_after(patch, 4)
        assert evaluate(out, controllers, "--settings.fixed_slip.slip=0.2") == 130
    assert f"go on with: python -m agents.evaluate --resume {out}" in capsys.readouterr().err
    assert len((out / "courses.jsonl").read_text().splitlines()) == 4
    assert not (out / "evaluation.json").exists()
    driven = []
    original = study.record
    monkeypatch.setattr(study, "record", lambda *args, **kw: driven.append(args[4]) or original(*args, **kw))
    if again == "resume":
        assert main(["--resume", str(out)]) == 0
    else:
        assert evaluate(out, controllers, "--settings.fixed_slip.slip=0.2") == 0
    assert len(driven) == 3 * 5 - 4 and sorted(set(driven)) == [1, 3]
    same(out, done)


def test_a_finished_evaluation_is_told_again_without_driving(monkeypatch, tmp_path, done):
    out = tmp_path / "copy"
    shutil.copytree(done, out)
    (out / "report.html").unlink()
    monkeypatch.setattr(study, "record", lambda *args, **kw: pytest.fail("driven again"))
    assert main(["--resume", str(out)]) == 0
    same(out, done)


def test_a_line_cut_off_by_a_crash_is_driven_again(tmp_path, done):
    out = tmp_path / "copy"
    shutil.copytree(done, out)
    content = (out / "courses.jsonl").read_bytes()
    (out / "courses.jsonl").write_bytes(content[:-200])
    assert main(["--resume", str(out)]) == 0
    same(out, done)


@pytest.mark.parametrize("damage", ["text", "twice", "unknown", "short"])
def test_a_damaged_log_is_refused_in_one_line(capsys, tmp_path, done, damage):
    out = tmp_path / "copy"
    shutil.copytree(done, out)
    lines = (out / "courses.jsonl").read_text().splitlines()
    if damage == "text":
        lines[2] = lines[2][:40]
    elif damage == "twice":
        lines[2] = lines[0]
    elif damage == "unknown":
        lines[2] = lines[2].replace('"first": 0', '"first": 1')
    else:
        entry = json.loads(lines[2])
        entry["columns"]["time"].pop()
        lines[2] = json.dumps(entry)
    (out / "courses.jsonl").write_text("\n".join(lines) + "\n")
    assert main(["--resume", str(out)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "courses.jsonl: line 3 is damaged" in error and "delete the line" in error


def test_kill_9_and_resume_give_the_same_table(tmp_path):
    """A controller that kills the process in the middle of a block."""
    out, calm, mark = tmp_path / "out", tmp_path / "calm", tmp_path / "killed"
    command = [sys.executable, "-m", "agents.evaluate", *SHORT]
    command.append("--controllers=half=tests.drivers:Half,tests.drivers:Killer")
    env = {**os.environ, "SOIL_ENV_TEST_KILL": str(mark), "MPLBACKEND": "Agg"}
    root = Path(__file__).resolve().parent.parent
    killed = subprocess.run([*command, f"--out={out}"], cwd=root, env=env, capture_output=True, timeout=300)
    assert killed.returncode == -9 and mark.exists()
    assert len((out / "courses.jsonl").read_text().splitlines()) == 1
    for more in (("--resume", str(out)), (*command[3:], f"--out={calm}")):
        again = subprocess.run([*command[:3], *more], cwd=root, env=env, capture_output=True, text=True, timeout=300)
        assert again.returncode == 0, again.stderr
    same(out, calm)


def test_two_evaluations_do_not_write_one_folder(capsys, tmp_path, done):
    out = tmp_path / "copy"
    shutil.copytree(done, out)
    with study.Log(study.load_study(out), out):
        assert main(["--resume", str(out)]) == 2
    assert "another evaluation is writing it" in capsys.readouterr().err


@pytest.mark.parametrize(
    "controllers, option, differs",
    [
        ("{all}", "--courses=8", "courses"),
        ("{all}", "--block=4", "block"),
        ("{all}", "--changes.course.length=3", "scenario"),
        ("{all}", "--settings.fixed_slip.slip=0.3", "controllers"),
        ("full_throttle", "--seed=11", "controllers"),
    ],
)
def test_a_folder_of_another_evaluation_is_refused(capsys, tmp_path, done, models, controllers, option, differs):
    out = tmp_path / "copy"
    shutil.copytree(done, out)
    before = {p.name: p.read_bytes() for p in out.iterdir()}
    own = [] if controllers == "full_throttle" else ["--settings.fixed_slip.slip=0.2"]
    names = controllers.format(all=f"{CLASSES},fixed_slip,ppo={models}/seed_*")
    assert evaluate(out, names, *own, option) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and f"it differs in {differs})" in error
    assert {p.name: p.read_bytes() for p in out.iterdir()} == before


def test_a_model_that_has_changed_is_refused(capsys, tmp_path, models):
    mine, out = tmp_path / "model.zip", tmp_path / "out"
    shutil.copy(models / "seed_0" / "model.zip", mine)
    assert evaluate(out, f"ppo={mine}") == 0
    shutil.copy(models / "seed_1" / "model.zip", mine)
    assert main(["--resume", str(out)]) == 2
    assert "the model has changed since the study began" in capsys.readouterr().err


def test_a_study_of_another_version_of_the_code_is_refused(capsys, tmp_path, monkeypatch, done):
    out = tmp_path / "copy"
    shutil.copytree(done, out)
    text = (out / "study.yaml").read_text()
    assert f"version: {study.code_version()}\n" in text
    (out / "study.yaml").write_text(text.replace("version: 0.1.0+", "version: 0.0.9+"))
    assert main(["--resume", str(out)]) == 2
    assert "begun with soil_env 0.0.9+" in capsys.readouterr().err


def test_a_worker_with_other_code_is_refused(monkeypatch, done):
    own = study.load_study(done)
    job = study.Job(own)
    monkeypatch.setattr(study, "code_version", lambda: "0.1.0+other")
    with pytest.raises(ParameterError, match=r"a worker has soil_env 0.1.0\+other"):
        job(own.tasks()[0])


def test_the_version_follows_the_code(monkeypatch):
    version = study.code_version()
    original = Path.read_bytes

    def edited(path):
        return original(path) + (b"# edited" if path.name == "contact.py" else b"")

    monkeypatch.setattr(Path, "read_bytes", edited)
    assert study.code_version.__wrapped__() != version
    monkeypatch.undo()
    assert study.code_version.__wrapped__() == version


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments, parts",
    [
        (["--controllers=fixd_slip"], ("'fixd_slip'", "did you mean 'fixed_slip'?", "model.zip", "module:Class")),
        (["--controllers="], ("expected at least one",)),
        (["--controllers=half=tests.drivers:Half,,"], ("empty entry",)),
        (["--controllers=a="], ("empty entry",)),
        (["--controllers=missing.zip"], ("missing.zip", "No such file")),
        (["--controllers=runs/none"], ("runs/none", "No such file")),
        (["--controllers=ppo=none/*"], ("none/*", "no model matches")),
        (["--controllers={models}/seed_*"], ("2 models", "NAME=")),
        (["--controllers={models}/seed_0,{models}/seed_0"], ("'seed_0' twice",)),
        (["--controllers=no.such.module:Thing"], ("no.such.module:Thing", "cannot be imported", "No module named")),
        (["--controllers=tests.drivers:Halve"], ("'Halve'", "did you mean 'Half'?")),
        (["--controllers=tests.drivers:NoPredict"], ("no method predict",)),
        (["--controllers=tests.drivers:WrongShape"], ("tests.drivers:WrongShape", "shape (3,)", "expected", "(3, 1)")),
        (["--controllers=tests.drivers:NoState"], ("gave a ndarray", "expected (action, state)")),
        (["--controllers=tests.drivers:OtherVariant"], ("'blnd'", "expected one of blind, identified, true_soil")),
        (["--controllers=tests.drivers:Raises"], ("cannot be made", "OSError: no such device", "drivers.py line")),
        (["--controllers=tests.drivers"], ("'tests.drivers'", "unknown controller")),
        (["--courses=0"], ("courses = 0", "[1, 100000]")),
        (["--courses=-5"], ("courses = -5",)),
        (["--block=0"], ("block = 0",)),
        (["--seed=-1"], ("seed = -1",)),
        (["--scenario=mixd"], ("'mixd'", "did you mean 'mixed'?")),
        (["--changes.course.lenght=2"], ("lenght", "did you mean 'length'?")),
        (["--curses=5"], ("'curses'", "did you mean 'courses'?")),
        (["--settings.fixed_slip.slpi=0.2", "--controllers=fixed_slip"], ("'slpi'", "did you mean 'slip'?")),
        (["--settings.fixed_slip.slip=0.2", "--controllers=full_throttle"], ("settings", "'fixed_slip'")),
        (["--settings.fixed_slip=0.2"], ("--settings.fixed_slip.KEY VALUE",)),
        (["--settings=3"], ("--settings.KEY VALUE",)),
        (["--engine=rai"], ("'rai'", "did you mean 'ray'?")),
        (["--workers=0"], ("--workers 0",)),
        (["--address=auto"], ("only with --engine ray",)),
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
    assert captured.err.startswith("agents.evaluate: ") and captured.err.count("\n") == 1 and len(captured.err) < 700
    for part in parts:
        assert part in captured.err
    assert not out.exists() and not list(tmp_path.iterdir())


def test_nothing_at_all_is_refused(capsys, tmp_path):
    assert main([]) == 2
    assert "--controllers and --out, or --resume" in capsys.readouterr().err
    assert main(["--resume", str(tmp_path / "none")]) == 2
    assert "no such folder" in capsys.readouterr().err
    assert main(["--resume", str(tmp_path)]) == 2
    assert "study.yaml: cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize(
    "change, part",
    [
        (lambda p: edit(p, observation_names=[f"n{k}" for k in range(11)]), "another observation layout"),
        (lambda p: edit(p, scenario={"control": {"action": "wheel_speed"}}), "trained with action 'wheel_speed'"),
        (lambda p: rewrite(p, b"{"), "not a model saved by train.py"),
        (lambda p: p.write_bytes(b"PK no"), "not a model of Stable-Baselines3"),
        (lambda p: p.write_bytes(p.read_bytes()[:-3000]), "not a model of Stable-Baselines3"),
    ],
)
def test_a_model_that_cannot_be_used_is_refused(capsys, tmp_path, models, change, part):
    path = tmp_path / "model.zip"
    shutil.copy(models / "seed_0" / "model.zip", path)
    change(path)
    assert evaluate(tmp_path / "out", f"fixed_slip,ppo={path}") == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and part in error and str(path) in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name, part", [("Late", "ZeroDivisionError: late"), ("LateNaN", "action nan in step 3")])
def test_a_controller_that_fails_on_the_way_is_named(capsys, tmp_path, name, part):
    assert evaluate(tmp_path / "out", f"full_throttle,mine=tests.drivers:{name}") == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and part in error and f"tests.drivers:{name}" in error
    assert len((tmp_path / "out" / "courses.jsonl").read_text().splitlines()) == 1  # what was done before is kept


@pytest.mark.parametrize("out", ["{tmp}/file/out", "/proc/evaluation", "{tmp}/other"])
def test_a_folder_that_cannot_be_used_is_refused(capsys, tmp_path, out):
    (tmp_path / "file").write_text("text")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").write_text("mine")
    out = out.format(tmp=tmp_path)
    assert main([*SHORT, "--controllers=full_throttle", f"--out={out}"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and out.rsplit("/", 1)[0] in error
    assert [p.name for p in (tmp_path / "other").iterdir()] == ["thesis.txt"]


def test_disk_full_while_driving_keeps_whole_blocks(capsys, tmp_path, monkeypatch, done, models):
    out, controllers = tmp_path / "out", f"{CLASSES},fixed_slip,ppo={models}/seed_*"
    written, write = [], os.write

    def full(file, data):
        if len(written) == 3:
            write(file, data[:100])
            written.append(0)
        if len(written) > 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written.append(1)
        return write(file, data)

    with monkeypatch.context() as patch:
        patch.setattr(study.os, "write", full)
        assert evaluate(out, controllers, "--settings.fixed_slip.slip=0.2") == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "courses.jsonl: No space left on device" in error
    assert len((out / "courses.jsonl").read_bytes().splitlines()) == 3
    assert (out / "courses.jsonl").read_bytes().endswith(b"\n")
    assert main(["--resume", str(out)]) == 0
    same(out, done)


def test_disk_full_while_writing_results_leaves_no_half_file(capsys, tmp_path, done):
    """A limit on the size of files, which the report does not keep."""
    out = tmp_path / "out"
    shutil.copytree(done, out)
    for name in FILES - {"courses.jsonl", "study.yaml"}:
        (out / name).unlink()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        status = main(["--resume", str(out)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert status == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "File too large" in error
    assert "report.html" not in {p.name for p in out.iterdir()}
    assert not [p.name for p in out.iterdir() if p.name.startswith(".")]
    assert main(["--resume", str(out)]) == 0
    same(out, done)


def test_too_little_memory_gives_one_line(capsys, tmp_path, monkeypatch):
    interrupted_after(monkeypatch, 0, MemoryError)
    assert evaluate(tmp_path / "out", "full_throttle") == 2
    assert "not enough memory" in capsys.readouterr().err


def test_help_explains_the_entries(capsys):
    with pytest.raises(SystemExit) as status:
        main(["--help"])
    assert status.value.code == 0
    text = capsys.readouterr().out
    for part in ("path/to/model.zip", "my.module:Thing", "NAME=...", "--resume", "--engine", "Only what you trust"):
        assert part.lower() in text.lower()
    assert max(map(len, parser().format_help().splitlines())) <= 121


def test_the_default_courses_are_the_held_out_set():
    assert parser().get_default("seed") == HELD_OUT_SET
