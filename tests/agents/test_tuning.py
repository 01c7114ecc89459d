"""Tuning by Optuna: spaces are strict, the best trial is kept, an interrupted tuning ends as one without a break."""

import pytest
import yaml

from agents.controllers import CONTROLLERS, make_controller
from agents.controllers.rover import ROVER_CONTROLLERS
from agents.evaluate import TUNING_SET, run_courses, tuning
from agents.evaluate.tuning import load_spaces, shipped_settings, tuned_settings
from soil_env._io.loading import ParameterError, config_dir
from soil_env.parameters import load_scenario
from soil_env.vehicle import load_rover

pytest.importorskip("optuna")
SHORT = {"course": {"length": 2.0}, "control": {"time_limit": 12.0}}


@pytest.fixture(scope="module")
def short():
    return load_scenario("mixed", SHORT)


@pytest.fixture
def few(monkeypatch):
    """Six trials on any number of courses."""
    monkeypatch.setattr(tuning, "_COURSES_A_TRIAL", 1)
    spaces = load_spaces()
    monkeypatch.setattr(tuning, "load_spaces", lambda: tuning.replace(spaces, trials=6))


# --- spaces -----------------------------------------------------------------------------------------------------------


def test_every_controller_with_settings_has_a_space_within_its_bounds():
    spaces = load_spaces()
    assert set(spaces.controllers) == {name for name, c in CONTROLLERS.items() if c.bounds}
    for vehicle in ("mixed", "field_vehicle"):
        scenario = load_scenario(vehicle)
        for name, space in spaces.controllers.items():
            for end in (0, 1):
                make_controller(name, scenario, **{key: r.bounds(scenario)[end] for key, r in space.items()})


@pytest.mark.parametrize(
    "change, said",
    [
        ({"controllers": {"soft_strat": {}}}, "soft_start"),
        ({"controllers": {"soft_start": {"speed": {"low": 2.0, "high": 1.0}}}}, "low below high"),
        ({"controllers": {"soft_start": {"speed": {"low": 0.0, "high": 1.0, "log": True}}}}, "low > 0"),
        ({"controllers": {"soft_start": {"speed": {"low": 0.1, "high": 1.0, "of": "wheel"}}}}, "top_rim_speed"),
    ],
)
def test_a_wrong_space_is_refused_with_one_line(tmp_path, change, said):
    path = tmp_path / "spaces.yaml"
    path.write_text(yaml.safe_dump({"trials": 3} | change))
    with pytest.raises(ParameterError) as error:
        load_spaces(path)
    assert said in str(error.value) and "\n" not in str(error.value)
    assert str(error.value).startswith("spaces.yaml: ")


# --- what is found ----------------------------------------------------------------------------------------------------


def test_the_trial_that_finishes_most_is_kept_then_the_highest_return(short, few):
    chosen, tried = tuned_settings(short, 8, ("constant_torque",))
    trials = tried["constant_torque"]
    best = max(trials, key=lambda t: (t["finished"], t["return"]))
    assert chosen == {"constant_torque": {"share": best["share"]}}
    assert len({t["finished"] for t in trials}) > 1
    runs = run_courses(make_controller("constant_torque", short, share=best["share"]), short, TUNING_SET, 8)
    assert runs.metric("finished").mean() == best["finished"] and runs.returns.mean() == best["return"]
    assert (
        trials[0]["share"] == make_controller("constant_torque", short).settings["share"]
    )  # the defaults are tried first


def test_an_interrupted_tuning_ends_as_one_without_a_break(short, few, tmp_path, monkeypatch):
    """Interrupted in the middle of a drive, in which a trial is left running, and killed between two trials."""
    names, log, drive = ("soft_start", "constant_speed"), tmp_path / "tuning.log", tuning.run_courses
    whole, driven = tuned_settings(short, 6, names, anew=True), []

    def until_the_ninth(*args, **options):
        if len(driven) in (0, 4, 8):
            driven.append("interrupted")
            raise KeyboardInterrupt
        driven.append("driven")
        return drive(*args, **options)

    monkeypatch.setattr(tuning, "run_courses", until_the_ninth)
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            tuned_settings(short, 6, names, log=log, anew=True)
    assert tuned_settings(short, 6, names, log=log, anew=True) == whole
    assert driven.count("driven") == 12  # every trial once
    assert tuned_settings(short, 6, names, log=log, anew=True) == whole and len(driven) == 15


def test_controllers_of_a_rover_are_tuned_in_the_space_of_their_wheels(few):
    rover = load_rover("lunar_micro_rover", {"course": {"length": 1.0}, "control": {"time_limit": 6.0}})
    chosen, tried = tuned_settings(rover, 2, ("velocity_sync", "slip_limiter"))
    spaces = load_spaces().controllers
    assert {n: set(c) for n, c in chosen.items()} == {n: set(spaces[ROVER_CONTROLLERS[n].of_wheel]) for n in chosen}
    assert all(len(trials) == 2 for trials in tried.values())


# --- settings that come with the package ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(path.stem for path in (config_dir() / tuning.TUNED).glob("*.yaml")))
def test_shipped_settings_serve_an_unchanged_scenario_only(name):
    act = {"control": {"action": "rim_acceleration"}}
    scenario = load_scenario(name, act)
    shipped = shipped_settings(scenario, 200)
    assert set(shipped) == {name for name, c in CONTROLLERS.items() if c.bounds}
    assert tuned_settings(scenario, 200, ("soft_start",)) == ({"soft_start": shipped["soft_start"]}, {})
    assert shipped_settings(scenario, 10**6) == {}  # more courses than they were tuned on
    assert shipped_settings(load_scenario(name, act | {"course": {"length": 9.0}}), 2) == {}
    assert shipped_settings(load_scenario(name, {"control": {"action": "rim_acceleration", "repeat": 2}}), 2) == {}
    assert shipped_settings(load_scenario(name, act | {"reward": {"energy": 3.0}}), 2) == shipped
