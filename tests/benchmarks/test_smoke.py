"""Smaller benchmarks: smoke runs write numbers and a page, finished parts are not made again, choices are as stated."""

import json

import numpy as np

from benchmarks import logs, throughput, value_of_soil
from soil_env.parameters import load_scenario
from soil_env.simulation.task import layout


def test_throughput_measures_wheels_and_rovers_side_by_side(tmp_path):
    assert throughput.main(["--smoke", "--out", str(tmp_path)]) == 0
    result = json.loads((tmp_path / "throughput.json").read_text(encoding="utf-8"))
    assert {"wheels, mixed", "rovers, two axles", "one wheel, mixed"} <= set(result["rates"])
    assert all(0.0 < v["low"] <= v["median"] <= v["high"] for v in result["rates"].values())
    assert (tmp_path / "throughput.md").exists()


def test_logs_have_all_quantities(tmp_path):
    assert logs.main(["--smoke", "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "logs.json").read_text(encoding="utf-8"))["logs"]
    assert set(found) == set(logs.LOGS) and all(len(log["quantities"]) == 5 for log in found.values())
    assert found["all readings, 10 Hz, stepped speed"]["quantities"]["ln K"]["rms"] < 0.5
    assert (tmp_path / "logs.md").exists()


def chosen(name, **entries):
    """Action of an arm at a halt where the line is chosen, with these entries of the observation."""
    arm, scenario = value_of_soil.ARMS[name], load_scenario("two_lines")
    names = [e.name for e in layout(arm.variant, scenario.course)]
    observation = np.zeros((1, len(names)))
    for key, value in {"halted": 1.0, "choice": 1.0, **entries}.items():
        observation[0, names.index(key)] = value
    return value_of_soil.SoftStart(scenario, arm, 0.08, 0.45, 0.9).predict(observation)[0][0, 0]


def test_each_arm_chooses_by_its_knowledge():
    grades = {"ahead_grade": 0.2, "beside_grade": 0.1}
    assert chosen("straight", **grades) == 1.0 and chosen("less steep", **grades) == -1.0
    for name in ("identified", "true soil"):
        assert chosen(name, **grades, ahead_margin=0.05, beside_margin=-0.05) == 1.0
        assert chosen(name, ahead_grade=0.1, beside_grade=0.2, ahead_margin=-0.05, beside_margin=0.05) == -1.0
