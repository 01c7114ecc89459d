"""The command from recording to report; steady stretches; the replay over gaps; what a log can tell."""

import dataclasses
import json
import math
import re

import numpy as np
import pytest

from soil_env.identification.table import identify_table
from soil_env.logs import read_map, replay, steady_windows
from soil_env.logs.__main__ import main
from soil_env.logs.align import Aligned
from soil_env.logs.replay import what_can_be_told
from soil_env.measurement.table import read_setup, read_table
from soil_env.parameters import soils
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from tests.logs.bags import write_json_mcap, write_map

pytest.importorskip("mcap")
pytest.importorskip("rosbags")

KNOWN = {"cohesion": 1300, "sinkage_exponent": 0.79}


def made(log_map, plan, period=0.1, noise=0.0):
    """Readings of a wheel that keeps each slip of `plan` [(slip, seconds)] in Wong's Lete sand without slip-sinkage."""
    soil = dataclasses.replace(soils()["lete_sand"], dig_gain=0.0)
    model = WheelSoilModel(ModelWheel(0.15, 0.15), soil)
    rng = np.random.default_rng(0)
    slips = np.concatenate([np.full(round(t / period), s) for s, t in plan])
    state = model.predict({"slip": slips, "load": 150.0})
    rim, load = np.full(slips.size, 2.0), np.full(slips.size, 150.0)
    rows = [rim, 0.3 * (1.0 - slips), state.sinkage, state.drawbar_pull, load, state.torque]
    names = ("wheel_speed", "speed", "sinkage", "drawbar_pull", "load", "torque")
    columns = np.array(rows) + noise * rng.normal(size=(6, slips.size)) * np.array([[0, 1e-4, 1e-4, 0.3, 1, 0.05]]).T
    return Aligned(0, period * np.arange(slips.size), dict(zip(names, columns, strict=True)), {}, period)


@pytest.fixture()
def log_map(tmp_path):
    return read_map(write_map(tmp_path, {"wheel": {"radius": 0.15, "width": 0.15, "body_mass": 15.3}, "soil": KNOWN}))


def test_steady_points_are_the_points_that_were_driven(log_map, tmp_path):
    """Noise-free: rows of exactly the slips, and a fit that gives the soil back; the setup's noise is that put in."""
    driven = [0.1, 0.2, 0.35, 0.5, 0.7]
    log = made(log_map, [(s, 4.0) for s in driven])
    found = steady_windows(log, log_map)
    assert sorted({round(row["slip"], 6) for row in found.rows}) == driven  # no row across a change of slip
    assert len(found.rows) >= 3 * len(driven)
    noisy = steady_windows(made(log_map, [(s, 4.0) for s in driven], noise=1.0), log_map)
    assert noisy.noise["sinkage"] == pytest.approx(1e-4 / math.sqrt(10), rel=0.2)
    assert noisy.noise["torque"] == pytest.approx(0.05 / math.sqrt(10), rel=0.2)
    (tmp_path / "steady.csv").write_text(noisy.table())
    (tmp_path / "setup.yaml").write_text(noisy.setup(log_map))
    setup = read_setup(tmp_path / "setup.yaml")
    soil = soils()["lete_sand"]
    estimate = identify_table(read_table(tmp_path / "steady.csv", setup.wheel), setup)
    assert estimate.parameters["cohesion"].known
    for name, error in (("friction_angle_deg", 1.0), ("shear_modulus", 0.002)):
        assert estimate.parameters[name].value == pytest.approx(getattr(soil, name), abs=error)


def test_what_changes_is_not_steady(log_map):
    """A ramp of slip; a wheel at rest; a sinkage that has not come to its end yet though it changes little."""
    ramp = made(log_map, [(s, 0.1) for s in np.linspace(0.1, 0.9, 60)])
    assert not steady_windows(ramp, log_map).rows
    still = made(log_map, [(0.2, 3.0)])
    assert len(steady_windows(still, log_map).rows) == 3
    still.readings["wheel_speed"][:] = still.readings["speed"][:] = 0.0
    assert not steady_windows(still, log_map).rows
    sinking = made(log_map, [(0.2, 6.0)])
    sinking.readings["speed"] *= 0.05
    sinking.readings["wheel_speed"] *= 0.05
    # 15 mm/s of travel, adaptation length 0.3 m: half of a second brings 2.6 % of what is left, here of 20 mm
    sinking.readings["sinkage"] += 0.02 * (1.0 - np.exp(-0.05 * sinking.time))
    assert not steady_windows(sinking, log_map).rows


def test_a_gap_starts_the_identifier_anew(log_map):
    log = made(log_map, [(s, 2.0) for s in (0.1, 0.4, 0.2, 0.6)])
    one = replay(log, log_map)
    assert one.restarts == 0 and one.renewed.sum() > 10
    late = Aligned(0, log.time + 100.0 * (log.time > 3.95), log.readings, {}, log.period)
    two = replay(late, log_map)
    again = replay(Aligned(0, log.time[40:], {n: v[40:] for n, v in log.readings.items()}, {}, log.period), log_map)
    assert two.restarts == 1 and two.warnings
    assert two.values["shear_modulus"][39] == one.values["shear_modulus"][39]
    assert two.values["shear_modulus"][-1] == pytest.approx(again.values["shear_modulus"][-1], rel=1e-9)
    assert two.values["shear_modulus"][-1] != one.values["shear_modulus"][-1]


@pytest.mark.parametrize("method", ["filter", "window"])
def test_what_is_told_is_what_was_learnt(log_map, method):
    log_map = dataclasses.replace(log_map, belief=dataclasses.replace(log_map.belief, method=method))
    log = made(log_map, [(s, 2.0) for s in (0.1, 0.4, 0.2, 0.6)], noise=1.0)
    whole = replay(log, log_map).learnt()
    assert whole["friction_angle_deg"] < 0.8 and whole["shear_modulus"] < 0.8
    kept = {n: v for n, v in log.readings.items() if n not in ("drawbar_pull", "torque")}
    part = replay(Aligned(0, log.time, kept, {}, log.period), log_map)
    assert part.learnt()["friction_angle_deg"] > (0.7 if method == "filter" else 0.9)  # correlations of the belief
    assert part.learnt()["sinkage_coefficient"] < 0.8
    lines = [len(what_can_be_told(part, set(kept))), len(what_can_be_told(part, set(log.readings)))]
    assert lines[0] > lines[1]
    del kept["sinkage"]
    blind = replay(Aligned(0, log.time, kept, {}, log.period), log_map)
    assert min(blind.learnt().values()) == pytest.approx(1.0, abs=0.15 if method == "filter" else 1e-6)
    seen = {n: v for n, v in log.readings.items() if n != "sinkage"}
    unseen = replay(Aligned(0, log.time, seen, {}, log.period), log_map)
    assert (unseen.learnt()["shear_modulus"] < 0.5) == (method == "filter")
    said = next(line for line in what_can_be_told(unseen, set(seen)) if line.startswith("No sinkage"))
    assert ("follows" in said) == (method == "filter")


def test_command(tmp_path, capsys):
    bag = write_json_mcap(tmp_path / "drive.mcap")
    (tmp_path / "out").mkdir()
    assert main([str(bag), "--map", str(write_map(tmp_path)), "--out", str(tmp_path / "out")]) == 0
    written = {p.name for p in (tmp_path / "out").iterdir()}
    assert written == {
        "report.html", "log.json", "estimates.csv", "estimates.png", "readings.png", "steady.csv", "setup.yaml",
    }  # fmt: skip
    page = (tmp_path / "out" / "report.html").read_text()
    assert not re.search(r"(src|href)=.(?!data:)", page) and page.count("<img") == 2
    facts = json.loads((tmp_path / "out" / "log.json").read_text())
    lines = (tmp_path / "out" / "estimates.csv").read_text().splitlines()
    assert facts["steps"] == 200 == len(lines) - 1
    assert float(lines[-1].split(",")[1]) == pytest.approx(facts["estimate"]["friction_angle_deg"])
    said = capsys.readouterr().out
    assert "/drive" in said and "steady.csv" in said
    bag = write_json_mcap(tmp_path / "short.mcap", steps=8)
    assert main([str(bag), "--map", str(tmp_path / "map.yaml"), "--out", str(tmp_path / "out")]) == 0
    assert not (tmp_path / "out" / "steady.csv").exists()  # that of the other log


def test_command_refuses_in_one_line(tmp_path, capsys):
    bag = write_json_mcap(tmp_path / "drive.mcap", steps=5)
    changed = {"speed": {"topic": "/odom", "field": "twist.y"}}
    assert main([str(bag), "--map", str(write_map(tmp_path, changed)), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "twist.y" in said and "/odom" in said
    assert not (tmp_path / "out").exists()
