"""Tuning by Optuna: the best trial is kept, an interrupted tuning ends as one without a break."""

import json
import sys
from functools import partial

import pytest
import yaml

from soil_env._io.loading import config_dir
from soil_env.cli import main as soil_env
from soil_env.cli.running import run
from soil_env.parameters import load_rover, load_scenario
from soil_env.terramechanics.model import WheelSoilModel
from soil_env_agents import tune
from soil_env_agents.controllers import CONTROLLERS, Setting, make_controller
from soil_env_agents.controllers.rover import ROVER_CONTROLLERS
from soil_env_agents.evaluate import tuning
from soil_env_agents.evaluate.driving import TUNING_SET, run_courses
from soil_env_agents.evaluate.own import bounds_of_settings
from soil_env_agents.evaluate.tuning import shipped_settings, tuned_settings
from soil_env_agents.progress import Bar
from tests.conftest import ROOT
from tests.refusals import refused, refused_command

pytest.importorskip("optuna")
SHORT = load_scenario("mixed", {"course": {"length": 2.0}, "control": {"time_limit": 12.0}})


@pytest.fixture
def few(monkeypatch):
    """Six trials on any number of courses."""
    monkeypatch.setattr(tuning, "_COURSES_A_TRIAL", 1)
    monkeypatch.setattr(tuning, "TRIALS", 6)


@pytest.mark.parametrize("vehicle", ["mixed", "field_vehicle"])
def test_every_range_lies_within_the_bounds_of_its_setting(vehicle):
    scenario = load_scenario(vehicle)
    top = scenario.wheel.radius * scenario.wheel.no_load_speed
    for name, controller in CONTROLLERS.items():
        for key, setting in controller.bounds.items():
            low, high = setting.tuned
            assert low <= setting.default <= high, name
            for end in (low, high):
                value = end * top if setting.rim_speed else end
                make_controller(name, scenario, **{key: value})


def test_the_trial_that_finishes_most_is_kept_then_the_highest_return(few):
    chosen = tuned_settings(SHORT, 8, ("constant_torque",))
    space = CONTROLLERS["constant_torque"].bounds
    bar = Bar("Tuning", {"constant_torque": 48}, "courses")
    trials = tuning.tried("constant_torque", space, SHORT, 8, None, None, bar)
    best = max(trials, key=lambda t: (t["finished"], t["return"]))
    assert chosen == {"constant_torque": {"share": best["share"]}}
    assert len({t["finished"] for t in trials}) > 1
    controller = make_controller("constant_torque", SHORT, share=best["share"])
    runs = run_courses(controller, SHORT, TUNING_SET, 8)
    assert runs.metric("finished").mean() == best["finished"]
    assert runs.returns.mean() == best["return"]
    assert trials[0]["share"] == space["share"].default  # tried first


def test_an_interrupted_tuning_ends_as_one_without_a_break(few, tmp_path, monkeypatch):
    """Interrupted three times in a drive, so that its trial is left running: in the first, and
    twice after three more.
    """
    names = ("soft_start", "constant_speed")
    log = tmp_path / "tuning.log"
    drive = tuning.run_courses
    whole = tuned_settings(SHORT, 6, names, anew=True)
    driven = []

    def until_the_ninth(*args, **options):
        """`run_courses`, whose first, fifth and ninth call are interrupted."""
        if len(driven) in (0, 4, 8):
            driven.append("interrupted")
            raise KeyboardInterrupt
        driven.append("driven")
        return drive(*args, **options)

    monkeypatch.setattr(tuning, "run_courses", until_the_ninth)
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            tuned_settings(SHORT, 6, names, log=log, anew=True)
    assert tuned_settings(SHORT, 6, names, log=log, anew=True) == whole
    assert driven.count("driven") == 12  # every trial once
    assert tuned_settings(SHORT, 6, names, log=log, anew=True) == whole and len(driven) == 15


def test_controllers_of_a_rover_are_tuned_in_the_space_of_their_wheels(few):
    short = {"course": {"length": 1.0}, "control": {"time_limit": 6.0}}
    rover = load_rover("lunar_micro_rover", short)
    for name, settings in tuned_settings(rover, 2, ("velocity_sync", "slip_limiter")).items():
        assert settings.keys() == CONTROLLERS[ROVER_CONTROLLERS[name].of_wheel].bounds.keys()


def test_a_class_with_settings_is_tuned_set_and_driven_as_a_shipped_one(
    few, tmp_path, monkeypatch, capsys
):
    """The template of examples/, in a world with an effect."""
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    source = "own_controller:Uphill"
    world = str(config_dir() / "worlds" / "bulldozing.yaml")
    short = ["--changes.course.length=2", "--changes.control.time_limit=12", "--courses=6"]
    asked = ["evaluate", f"--controllers=soft_start,mine={source}", *short, f"--model={world}"]

    def evaluated(*options):
        """Results of an evaluation with these options, in a folder named by the first."""
        assert soil_env([*asked, *options, f"--out={tmp_path / options[0]}"]) == 0
        return json.loads((tmp_path / options[0] / "evaluation.json").read_text())

    found = evaluated("--tuning-courses=6")
    assert found["chosen"] == {"soft_start": "tuned", "mine": "tuned"}
    settings = found["settings"]["mine"].keys()
    assert settings == {"acceleration", "speed", "creep_sinkage", "caution"}
    model = WheelSoilModel.load(world)
    chosen = tuned_settings(load_scenario("mixed"), 4, (source,), model, anew=True)
    assert chosen[source].keys() == settings
    found = evaluated("--settings.mine.caution=2.5", "--tuning-courses=0")
    assert found["settings"]["mine"]["caution"] == 2.5
    for wrong, said in (("caution=99", "expected a number in (0, 10]"), ("cation=1", "caution")):
        more = [f"--settings.mine.{wrong}", f"--out={tmp_path / 'x'}"]
        assert said in refused_command(capsys, "soil-env", soil_env, *asked, *more).err


def test_without_optuna_nothing_is_left(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "optuna", None)
    out = tmp_path / "o"
    asked = ["tune", "--controllers=soft_start", "--courses=2", f"--out={out}"]
    said = refused_command(capsys, "soil-env tune", soil_env, *asked).err
    assert "tuning needs Optuna; expected: pip install" in said and not out.exists()


@pytest.mark.parametrize(
    "ends, said",
    [
        ((0.0, 1.0), "bounds['gain'].tuned = (0.0, 1.0): expected 0 <= low <= high"),
        ((2.0, 1.0), "bounds['gain'].tuned = (2.0, 1.0): expected 0 <= low <= high"),
        ((1.0,), "expected {name: Setting}"),
    ],
)
def test_a_range_that_cannot_be_drawn_from_is_refused(ends, said, monkeypatch):
    wrong = type("Wrong", (), {"bounds": {"gain": Setting(1.0, "1", "any", ends, True)}})
    monkeypatch.setitem(globals(), "Wrong", wrong)
    refused(lambda: bounds_of_settings(f"{__name__}:Wrong", load_scenario("mixed")), said)


def test_a_class_that_fails_in_a_tuning_is_an_error_of_one_line(tmp_path, monkeypatch, capsys):
    """The error names the class and the line of its file, as in an evaluation."""
    monkeypatch.syspath_prepend(str(tmp_path))
    code = """
from soil_env_agents.controllers import Controller, Setting

class Fails(Controller):
    bounds = {"gain": Setting(1.0, "1", "any", (0.5, 2.0))}

    def predict(self, *arguments, **more):
        return 1 / 0
"""
    (tmp_path / "fails_when_tuned.py").write_text(code)
    asked = ["tune", "--controllers=fails_when_tuned:Fails", "--actions=torque", "--courses=2"]
    said = refused_command(capsys, "soil-env tune", soil_env, *asked, f"--out={tmp_path / 'o'}")
    assert "fails_when_tuned:Fails: predict failed (ZeroDivisionError" in said.err
    assert "fails_when_tuned.py line 8" in said.err


def test_the_command_writes_settings_that_the_package_finds(tmp_path, monkeypatch):
    """Two controllers, two trials on two courses; begun again, nothing is driven twice."""
    drives = []
    drive = tuning.run_courses
    monkeypatch.setattr(tuning, "TRIALS", 2)
    monkeypatch.setattr(tuning, "_COURSES_A_TRIAL", 1)
    monkeypatch.setattr(tuning, "run_courses", lambda *a, **k: drives.append(1) or drive(*a, **k))
    out = tmp_path / "tuned"
    asked = ["--scenario=mixed", "--courses=2", "--actions=torque,wheel_speed", f"--out={out}"]
    asked += ["--controllers=constant_torque,soft_start"]
    for _ in range(2):
        # two trials of two controllers with two actions
        assert run(tune.command, asked, "soil-env tune") == 0 and len(drives) == 8
    content = yaml.safe_load((out / "mixed.yaml").read_text())
    assert (content["courses"], content["trials"]) == (2, 2)
    monkeypatch.setattr(tuning, "config_dir", lambda: tmp_path)
    for action in ("torque", "wheel_speed", "rim_acceleration"):
        scenario = load_scenario("mixed", {"control": {"action": action}})
        assert shipped_settings(scenario, 2) == content["settings"].get(action, {})


@pytest.mark.parametrize(
    "name", sorted(path.stem for path in (config_dir() / tuning.TUNED).glob("*.yaml"))
)
def test_shipped_settings_serve_an_unchanged_scenario_only(name):
    def of(changes):
        """The scenario, with changes of it."""
        return load_scenario(name, {"control": {"action": "rim_acceleration"}, **changes})

    shipped = shipped_settings(of({}), 200)
    assert set(shipped) == {name for name, c in CONTROLLERS.items() if c.bounds}
    assert tuned_settings(of({}), 200, ("soft_start",)) == {"soft_start": shipped["soft_start"]}
    assert shipped_settings(of({}), 10**6) == {}  # more courses than they were tuned on
    assert shipped_settings(of({"course": {"length": 9.0}}), 2) == {}
    assert shipped_settings(of({"control": {"action": "rim_acceleration", "repeat": 2}}), 2) == {}
    assert shipped_settings(of({"reward": {"energy": 3.0}}), 2) == shipped


def test_controllers_without_settings_are_refused(tmp_path, capsys):
    for names in ("full_throttle", "soft_start,full_throttle"):
        asked = ["tune", f"--controllers={names}", f"--out={tmp_path / 'out'}"]
        error = refused_command(capsys, "soil-env tune", soil_env, *asked).err
        assert "--controllers: full_throttle: nothing to tune" in error
    assert not (tmp_path / "out").exists()


def test_a_torn_last_line_is_cut_off(tmp_path):
    path = tmp_path / "record"
    for content, kept in (("1\n2\n", "1\n2\n"), ("1\n2", "1\n"), ("1", ""), ("", "")):
        path.write_text(content)
        tuning.drop_torn_line(path)
        assert path.read_text() == kept
    tuning.drop_torn_line(tmp_path / "none")


@pytest.mark.parametrize("content", [{}, {"courses": "many", "settings": {}}, {"courses": 9}])
def test_a_file_that_no_tuning_wrote_is_refused(content, tmp_path, monkeypatch):
    (tmp_path / tuning.TUNED).mkdir()
    (tmp_path / tuning.TUNED / "mixed.yaml").write_text(yaml.safe_dump(content))
    monkeypatch.setattr(tuning, "config_dir", lambda: tmp_path)
    reading = partial(shipped_settings, load_scenario("mixed"), 2)
    refused(reading, "mixed.yaml: expected courses and settings")
