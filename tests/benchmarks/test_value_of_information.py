"""The benchmark of what knowing the soil is worth."""

import json

import numpy as np
import pytest

from benchmarks import value_of_information as study
from soil_env.simulation.task import layout

BY_NAME = {arm.name: arm for arm in study.ARMS}


def chosen(name, weights=None, **entries):
    """The action of an arm at a halt where the line is chosen, with these entries of the observation."""
    arm = BY_NAME[name]
    scenario = study.task(arm)
    names = [e.name for e in layout(arm.variant, scenario.course)]
    observation = np.zeros((1, len(names)))
    for key, value in {"halted": 1.0, "choice": 1.0, **entries}.items():
        observation[0, names.index(key)] = value
    drive = study.SoftStart(scenario, arm, 0.08, 0.45, 0.9, weights)
    return drive.predict(observation)[0][0, 0]


def test_each_arm_chooses_by_what_it_knows():
    grades = {"ahead_grade": 0.2, "beside_grade": 0.1}
    assert chosen("straight", **grades) == 1.0
    assert chosen("less steep", **grades) == -1.0
    assert chosen("less steep", ahead_grade=0.1, beside_grade=0.2) == 1.0
    for name in ("identified", "true soil"):
        assert chosen(name, **grades, ahead_margin=0.05, beside_margin=-0.05) == 1.0
        assert chosen(name, ahead_grade=0.1, beside_grade=0.2, ahead_margin=-0.05, beside_margin=0.05) == -1.0


def test_what_was_felt_is_remembered_by_class():
    """A class that pulled well is chosen over one of which only the mean is known, and over a poor one not at all."""
    arm = BY_NAME["felt"]
    scenario = study.task(arm)
    names = [e.name for e in layout("blind", scenario.course)]
    weights = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.2])  # capacity is the pull; 0.2 where a class was not met
    for pull, expected in ((0.4, 1.0), (0.05, -1.0)):
        rolling, halt = np.zeros((1, len(names))), np.zeros((1, len(names)))
        for key, value in {
            "drawbar_pull": pull,
            "load": 1.0,
            "slip": 0.2,
            "rim_speed": 0.4,
            "here_class_2": 1.0,
        }.items():
            rolling[0, names.index(key)] = value
        for key in ("halted", "choice", "ahead_class_2", "beside_class_3", "here_class_2"):
            halt[0, names.index(key)] = 1.0
        drive = study.SoftStart(scenario, arm, 0.08, 0.45, 0.9, weights)
        _, state = drive.predict(rolling)
        assert drive.predict(halt, state)[0][0, 0] == expected


def test_settings_are_the_same_for_all_arms_and_within_bounds():
    drawn = study.candidates(50)
    assert drawn == study.candidates(50) and drawn[:10] == study.candidates(10)
    for name, (low, high) in study.BOUNDS.items():
        values = [settings[name] for settings in drawn]
        assert low <= min(values) < 1.5 * low and 0.7 * high < max(values) <= high


@pytest.mark.benchmarks
def test_what_was_driven_is_not_driven_again(tmp_path, monkeypatch):
    assert study.main(["--smoke", "--out", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "value_of_information.json").read_text())
    assert set(content) == set(BY_NAME) and all(len(found["finished"]) == 8 for found in content.values())
    page = (tmp_path / "value_of_information.md").read_text()
    assert "true soil | less steep" in page
    kept = content.pop("identified")
    (tmp_path / "value_of_information.json").write_text(json.dumps(content))
    driven = []
    monkeypatch.setattr(study, "measure", lambda arm, *_: driven.append(arm.name) or kept)
    assert study.main(["--smoke", "--out", str(tmp_path)]) == 0
    assert driven == ["identified"] and (tmp_path / "value_of_information.md").read_text() == page
