"""Bad input of `python -m agents.evaluate`: one line, exit status 2, nothing half written."""

import shutil

import pytest

from agents.evaluate.__main__ import main
from soil_env.parameters import load_scenario
from soil_env.simulation.task import layout
from tests.agents.evaluating import SHORT, evaluate
from tests.agents.saved import edit, rewrite


@pytest.mark.parametrize(
    "arguments, parts",
    [
        (["--controllers=fixd_slip"], ("'fixd_slip'", "did you mean 'fixed_slip'?")),
        (["--controllers="], ("expected at least one",)),
        (["--controllers=a="], ("empty entry",)),
        (["--controllers=missing.zip"], ("missing.zip", "No such file")),
        (["--controllers=ppo=none/*"], ("none/*", "no model matches")),
        (["--controllers={models}/seed_*"], ("2 models", "NAME=")),
        (["--controllers={models}/seed_0,{models}/seed_0"], ("'seed_0' twice",)),
        (["--controllers=no.such.module:Thing"], ("no.such.module:Thing", "No module named")),
        (["--controllers=tests.agents.drivers:Halve"], ("'Halve'", "did you mean 'Half'?")),
        (["--controllers=tests.agents.drivers:NoPredict"], ("no method predict",)),
        (["--controllers=tests.agents.drivers:WrongShape"], ("tests.agents.drivers:WrongShape", "(3,)", "(3, 1)")),
        (["--controllers=tests.agents.drivers:OneNaN"], ("predict gave nan for wheel 1: expected finite numbers",)),
        (["--controllers=tests.agents.drivers:NoState"], ("expected (action, state)",)),
        (["--controllers=tests.agents.drivers:OtherVariant"], ("'blnd'", "blind, identified, true_soil")),
        (["--controllers=tests.agents.drivers:Raises"], ("OSError: no such device", "drivers.py line")),
        (["--controllers=a=fixed_slip,a=constant_speed"], ("'a'", "constant_speed beside fixed_slip")),
        (["--contollers=x"], ("'contollers'", "did you mean 'controllers'?")),
        (["--settings.fixed_slip.slip=7", "--controllers=fixed_slip"], ("--settings.fixed_slip.slip = 7", "[0, 0.95]")),
        (["--settings.full_throttle.slip=0.1", "--controllers=full_throttle"], ("full_throttle has no settings",)),
        (["--courses=0"], ("--courses = 0: expected", "[1, 100000]")),
        (["--scenario=mixd"], ("'mixd'", "did you mean 'mixed'?")),
        (["--changes.course.lenght=2"], ("lenght", "did you mean 'length'?")),
        (["--settings.fixed_slip.slip=0.2", "--controllers=full_throttle"], ("settings", "'fixed_slip'")),
        (["--settings=3"], ("--settings.KEY VALUE",)),
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
        (
            lambda p: edit(p, observation_names=[f"n{k}" for k in range(len(layout("blind", load_scenario().course)))]),
            "another observation layout",
        ),
        (lambda p: edit(p, scenario={"control": {"action": "wheel_speed"}}), "trained with action 'wheel_speed'"),
        (lambda p: rewrite(p, b"{"), "not a model saved by train.py"),
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
    assert evaluate(tmp_path / "out", f"full_throttle,mine=tests.agents.drivers:{name}") == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and part in error and f"tests.agents.drivers:{name}" in error
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
