"""train.py as its user meets it: run folders, refusals in one line, interrupt, kill and resume."""

import json
import threading
from pathlib import Path
from unittest.mock import Mock

import pytest
import yaml
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import train
from soil_env._io.loading import to_dict
from soil_env.parameters import load_scenario
from soil_env_agents import cells, cli, comparison, training
from soil_env_agents.agent import load_agent, read_info
from soil_env_agents.config import load_config
from soil_env_agents.controllers import CONTROLLERS
from soil_env_agents.evaluate.driving import METRICS
from soil_env_agents.sb3 import SoilWheelVecEnv
from tests.refusals import refused_command

FILES = {"config.yaml", "scenario.yaml", "model.zip", "tensorboard", "comparison"}
TINY = (
    "--timesteps=256 --student=0 --ppo.num_envs=8 --ppo.n_steps=16 --ppo.batch_size=64 "
    "--ppo.n_epochs=1 --ppo.layer=8 --courses=4 --tuning_courses=1 --changes.control.time_limit=5 "
    "--changes.course.length=2"
).split()
ROLLOUT = 128  # steps: 8 wheels of 16


def shown(folder):
    """Names in a folder, but for hidden ones."""
    return {p.name for p in folder.iterdir() if not p.name.startswith(".")}


def run(capsys, *arguments):
    """Return exit status, stdout and stderr of a run in this process."""
    capsys.readouterr()
    return train.main(list(map(str, arguments))), *capsys.readouterr()


def refused(capsys, *arguments):
    """stderr of a run that has to be refused: one line, status 2."""
    return refused_command(capsys, "train.py", train.main, *arguments).err


def steps_logged(folder):
    """Timesteps of the points on the TensorBoard curve, in order of their files."""
    steps = []
    for file in sorted(folder.glob("tensorboard/*/events*"), key=lambda p: p.stat().st_mtime_ns):
        events = EventAccumulator(str(file))
        events.Reload()
        if "train/value_loss" in events.Tags()["scalars"]:
            steps.append([event.step for event in events.Scalars("train/value_loss")])
    return steps


@pytest.mark.usefixtures("unrendered")
def test_a_run_its_folder_and_its_resumption(capsys, tmp_path, monkeypatch):
    """The command line goes over the file; resumed, a finished run does nothing, and compares again
    what is missing.
    """
    file = tmp_path / "my.yaml"
    folder = tmp_path / "r" / "n"
    file.write_text(
        "courses: 9\n"
        "seed: 4\n"
        "ppo: {gamma: 0.9, layer: 6}\n"
        "changes: {course: {length: 3}}\n"
        "oracle_courses: 2"
    )

    asked = ["--config", file, *TINY, f"--runs={folder.parent}", "--name=n"]
    code, _, err = run(capsys, *asked, "--ppo.gamma=0.95", "--changes.course.grade_deg=[0.5, 1.5]")
    assert code == 0 and "Warning" not in err, err
    assert shown(folder) == FILES
    mapping = yaml.safe_load((folder / "config.yaml").read_text())
    config = load_config(mapping, "")
    assert mapping == to_dict(config)
    assert (config.courses, config.seed, config.ppo.gamma, config.ppo.layer) == (4, 4, 0.95, 8)
    scenario = load_scenario(folder / "scenario.yaml")
    agent = load_agent(folder)
    assert (scenario.course.length, scenario.course.grade_deg) == (2.0, (0.5, 1.5))
    assert scenario.control.time_limit == 5.0 and agent.info.task == scenario
    assert (agent.timesteps, agent.name) == (256, "agent_identified")
    result = json.loads((folder / comparison.DONE).read_text())
    assert (result["scenario"], result["courses"]) == ("two_lines", 4)
    assert result["limit"]["courses"] == 2
    assert set(result["controllers"]) == {*CONTROLLERS, "default_policy", "agent_identified"}
    assert all(set(METRICS) <= set(row) for row in result["controllers"].values())

    model = (folder / "model.zip").read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(comparison, "compare", None)  # a call would be a TypeError
        assert run(capsys, "--resume", folder)[0] == 0
    (folder / comparison.DONE).unlink()
    edited = (folder / "config.yaml").read_text().replace("seed: 4", "seed: 5")
    (folder / "config.yaml").write_text(edited)
    code, out, _ = run(capsys, "--resume", folder)
    assert code == 0 and "edited since the run began: seed 4 -> 5." in " ".join(out.split())
    assert json.loads((folder / comparison.DONE).read_text()) == result
    assert (folder / "model.zip").read_bytes() == model
    (folder / comparison.DONE).unlink()
    own = folder / comparison.FOLDER / "study.yaml"
    own.write_text("of: mine\n")
    assert "study.yaml: is a file of yours" in refused(capsys, "--resume", folder)
    assert own.read_text() == "of: mine\n"
    edited = edited.replace("scenario: two_lines", "scenario: mixed")
    (folder / "config.yaml").write_text(edited)
    said = "scenario = 'mixed': expected 'two_lines', as the run began: its task is in scenario"
    assert said in refused(capsys, "--resume", folder)
    (folder / "config.yaml").write_text("")
    assert "config.yaml: is empty: expected the keys" in refused(capsys, "--resume", folder)


def test_the_verdict_is_against_the_best_that_does_not_know_the_soil():
    rates = {"agent_blind": 0.9, "soft_start": 0.89, "full_throttle": 0.5, "best_slip_true": 0.93}
    rows = {name: {"finished": {"value": x}} for name, x in rates.items()}
    finished = {"value": 0.01, "low": -0.02, "high": 0.04}
    paired = {"agent_blind": {"soft_start": {"finished": finished}}}
    text = comparison.verdict({"controllers": rows, "paired": paired}, "agent_blind")
    assert "agent_blind against soft_start" in text
    assert "+1.0 [-2.0, +4.0] percentage points" in text


def test_overrides_are_read_as_yaml_and_names_as_text():
    arguments = "--a 1 --b.c=x=y --b.d [1,2] --e-f 1e6 --g -3 --h {".split()
    expected = {"a": 1, "b": {"c": "x=y", "d": [1, 2]}, "e_f": "1e6", "g": -3, "h": "{"}
    assert cli.overrides(arguments) == expected
    for value in ("7", "2026-11-20", "on", "null", "[a", ""):
        assert load_config(cli.overrides(["--name", value]), "command line").name == value


REFUSED = {  # options: parts of the message
    "--timestep 5": "timestep ... did you mean 'timesteps'",
    "--ppo.batch_size 1000": "command line ... batch_size ... 1000 ... 65536",
    "--hidden_worlds 256": "hidden_worlds = 256 ... num_envs",
    "--config nowhere.yaml": "nowhere.yaml ... No such file",
    "--courses": "courses ... value",
    "smoke.yaml": "'smoke.yaml': expected --key value; did you mean --config smoke.yaml?",
    "--ppo.gamma 1 --ppo.gamma=0.9": "--ppo.gamma: given twice: expected one value",
    # No abbreviations: a misspelt key is no other option.
    "--resum=x.yaml": "unknown key 'resum'",
    "--name a/b": "a/b ... name",
    "--name a,b": "name = 'a,b': expected a name without ',', which lists of controllers",
    "--name a*": "name = 'a*': expected a name without '*'",
    "--config smoke.yaml --rover mars_rover": "smoke.yaml, command line: oracle_courses = 2: ",
    # Also where it is what a wheel has by default.
    "--config rover.yaml --oracle_courses 50": "oracle_courses = 50: expected none beside rover",
    "--config rover.yaml --scenario two_lines": "scenario = 'two_lines': expected none beside rov",
    "--resume nowhere": "nowhere ... no such run folder",
    "--resume .": "config.yaml",
    "--config c.yaml --seed 3": "error: c.yaml: unknown key 'cources'",
    # It would be the default training of hours.
    "--config d.yaml": "d.yaml: is empty: expected keys",
}


@pytest.mark.parametrize("options, said", REFUSED.items())
def test_bad_input_is_refused_in_one_line(capsys, tmp_path, monkeypatch, options, said):
    monkeypatch.setattr(training, "train", lambda *_: pytest.fail("training was started"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.yaml").write_text("cources: 5\n")
    (tmp_path / "d.yaml").write_text("# nothing yet\n")
    runs = [] if "--resume" in options else ["--runs=runs"]
    err = refused(capsys, *runs, *options.split())
    assert all(part in err for part in said.split(" ... ")), err
    assert not list(tmp_path.glob("runs/*")), "a refused run left a folder behind"


def test_runs_that_are_a_file_are_named(capsys, tmp_path):
    (tmp_path / "mine").write_text("x")
    err = refused(capsys, *TINY, "--runs", tmp_path / "mine")
    assert f"mine': {tmp_path / 'mine'} is a file: expected a folder" in err


def test_a_training_that_fails_before_any_work_leaves_no_folder(capsys, tmp_path, monkeypatch):
    checkpoint = tmp_path / "n" / training.CHECKPOINT
    asked = [*TINY, "--runs", tmp_path, "--name", "n"]
    monkeypatch.setattr(training, "train", Mock(side_effect=MemoryError))
    assert "keeps" not in refused(capsys, *asked)
    assert not list(tmp_path.iterdir())

    def fail_late(*_):
        """A training that fails once it has written a checkpoint."""
        checkpoint.write_bytes(b"work")
        raise MemoryError

    monkeypatch.setattr(training, "train", fail_late)
    said = refused(capsys, *asked)
    assert f"go on with: soil-env train --resume {tmp_path / 'n'}\n" in said
    assert checkpoint.is_file()


def test_an_existing_run_is_not_overwritten(capsys, tmp_path):
    (tmp_path / "n").mkdir()
    (tmp_path / "n" / "precious").write_text("x")
    err = refused(capsys, *TINY, "--runs", tmp_path, "--name", "n")
    assert all(part in err for part in (str(tmp_path / "n"), "exists", "--resume"))
    assert shown(tmp_path / "n") == {"precious"}


class Killed(BaseException):
    """Ends a training at once, as kill -9 does."""


@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize(
    "end", [KeyboardInterrupt, Killed, SystemExit, OSError(28, "full", "curves")]
)
def test_a_training_that_was_stopped_is_resumed(capsys, tmp_path, monkeypatch, end):
    """In the third of four rollouts: steps of it, which nothing was learnt from, do not count. An
    interrupt, a full disk and a reader that has gone need no checkpoint before.
    """
    step = SoilWheelVecEnv.step_wait
    calls = []
    folder = tmp_path / "n"
    every = ROLLOUT if end is Killed else 10**6
    more = ["--timesteps=512", f"--checkpoint_every={every}", f"--runs={tmp_path}", "--name=n"]

    def stopped(self):
        """A step of the environment, of which the fortieth raises `end`."""
        calls.append(1)
        if len(calls) == 40:  # a rollout has 16
            raise end
        return step(self)

    with monkeypatch.context() as patch:
        patch.setattr(SoilWheelVecEnv, "step_wait", stopped)
        if end in (Killed, SystemExit):
            with pytest.raises(end):
                run(capsys, *TINY[1:], *more)
        else:
            code, _, err = run(capsys, *TINY[1:], *more)
            assert code == (130 if end is KeyboardInterrupt else 2)
            assert f"--resume {folder}" in err and "Traceback" not in err
    checkpoint = folder / "checkpoint.zip"
    assert read_info(checkpoint).timesteps == 2 * ROLLOUT
    assert not (folder / "model.zip").exists()
    whole = checkpoint.read_bytes()
    checkpoint.write_bytes(whole[: len(whole) // 2])
    code, _, err = run(capsys, "--resume", folder)
    assert code == 2 and "without this file the run begins again" in err, err
    checkpoint.write_bytes(whole)
    code, out, err = run(capsys, "--resume", folder)
    assert code == 0, err
    assert "Resuming at 256 of 512 steps" in out and load_agent(folder).timesteps >= 512
    assert shown(folder) == FILES  # no checkpoint left
    assert [p.name for p in (folder / "tensorboard").iterdir()] == ["PPO_0"]
    _, again = steps_logged(folder)
    assert again and min(again) > 2 * ROLLOUT


@pytest.mark.usefixtures("unrendered")
def test_a_model_that_is_trained_again_is_compared_again(capsys, tmp_path, monkeypatch):
    """Also where the comparison with the new model is interrupted, or cannot begin. The other
    drivers keep their runs.
    """
    folder = tmp_path / "n"
    assert run(capsys, *TINY, "--runs", tmp_path, "--name", "n")[0] == 0
    before = json.loads((folder / comparison.DONE).read_text())
    driven = {p: p.stat().st_mtime_ns for p in (folder / comparison.FOLDER / "cells").iterdir()}
    (folder / "model.zip").unlink()
    edited = (folder / "config.yaml").read_text().replace("seed: 0", "seed: 1")
    (folder / "config.yaml").write_text(edited)
    full = OSError(28, "full", "study.yaml")
    for where, name, error, status in (
        (comparison, "compare", KeyboardInterrupt, 130),
        (cells, "save_study", full, 2),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(where, name, Mock(side_effect=error))
            assert run(capsys, "--resume", folder)[0] == status
    code, out, err = run(capsys, "--resume", folder)
    assert code == 0 and "Already finished" not in out, err
    after = json.loads((folder / comparison.DONE).read_text())["controllers"]
    assert after["agent_identified"] != before["controllers"]["agent_identified"]
    anew = {p.name for p, at in driven.items() if p.stat().st_mtime_ns != at}
    assert len(driven) > 3 and len(anew) == 1 and "agent_identified" in anew.pop()


def test_an_error_of_the_thread_of_tensorboard_names_its_folder(capsys):
    failed = OSError(28, "full")
    thread = threading.Thread(target=Mock(side_effect=failed))
    with (
        pytest.raises(OSError, match="curves"),
        training._naming_tensorboard_folder(Path("curves")),
    ):
        thread.start()
        thread.join()
        raise failed
    assert capsys.readouterr().err == ""


def test_an_error_of_another_thread_is_printed_at_the_end(monkeypatch):
    """Where nothing raises it again, nothing else would tell of it."""
    printed = Mock()
    monkeypatch.setattr(threading, "excepthook", printed)
    failed = OSError(28, "no space for another")
    thread = threading.Thread(target=Mock(side_effect=failed))
    with training._naming_tensorboard_folder(Path("curves")):
        thread.start()
        thread.join()
        printed.assert_not_called()
    (told,) = printed.call_args.args
    assert told.exc_value is failed


def test_a_shipped_config_is_found_by_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert yaml.safe_load(cli.config_file("smoke.yaml").read_text())["timesteps"] == 8192
    (tmp_path / "smoke.yaml").write_text("timesteps: 5\n")
    assert cli.config_file("smoke.yaml") == Path("smoke.yaml")
    assert cli.config_file("no/smoke.yaml") == Path("no/smoke.yaml")
