"""`python -m agents.evaluate` interrupted, killed, out of disk: it goes on where it was, with the same results."""

import json
import resource
import shutil
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from agents.evaluate import study
from agents.evaluate.__main__ import main
from soil_env._io.loading import ParameterError
from tests.agents.evaluating import SHORT, evaluate, everything, same


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
    out, controllers = tmp_path / "out", everything(models)
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


def test_kill_9_and_resume_give_the_same_table(tmp_path, monkeypatch):
    """A controller that kills the process in the middle of a block."""
    out, calm, mark = tmp_path / "out", tmp_path / "calm", tmp_path / "killed"
    asked = [*SHORT, "--changes.control.action=torque"]
    asked.append("--controllers=half=tests.agents.drivers:Half,tests.agents.drivers:Killer")
    monkeypatch.setenv("SOIL_ENV_TEST_KILL", str(mark))
    command = [sys.executable, "-m", "agents.evaluate", *asked, f"--out={out}"]
    killed = subprocess.run(command, cwd=Path(__file__).resolve().parents[2], capture_output=True, timeout=300)
    assert killed.returncode == -9 and mark.exists()
    assert len((out / "courses.jsonl").read_text().splitlines()) == 1
    assert main(["--resume", str(out)]) == 0
    assert main([*asked, f"--out={calm}"]) == 0
    same(out, calm)


def test_two_evaluations_do_not_write_one_folder(capsys, tmp_path, done):
    out = tmp_path / "copy"
    shutil.copytree(done, out)
    with study.log_of(study.load_study(out), out):
        assert main(["--resume", str(out)]) == 2
    assert "another process is writing it" in capsys.readouterr().err


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
    own = [] if controllers == "full_throttle" or "fixed_slip" in option else ["--settings.fixed_slip.slip=0.2"]
    names = controllers.format(all=everything(models))
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


def test_disk_full_while_driving_keeps_whole_blocks(capsys, tmp_path, done, models):
    """A limit on the size of files in the middle of a block, beyond the size of study.yaml."""
    out, controllers = tmp_path / "out", everything(models)
    lines = (done / "courses.jsonl").read_bytes().splitlines(keepends=True)
    whole = next(k for k in range(len(lines)) if sum(map(len, lines[:k])) > (done / "study.yaml").stat().st_size)
    with limited_files(sum(map(len, lines[:whole])) + 100):
        assert evaluate(out, controllers, "--settings.fixed_slip.slip=0.2") == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "courses.jsonl: File too large" in error
    assert (out / "courses.jsonl").read_bytes() == b"".join(lines[:whole])
    assert main(["--resume", str(out)]) == 0
    same(out, done)


@contextmanager
def limited_files(size):
    """No file can be longer than `size` bytes: writes end there, as on a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
