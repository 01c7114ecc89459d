"""Commissioning drives: steady points of the log against the model of the world, and the noise of repeats."""

import dataclasses

import numpy as np
import pytest
import yaml

from agents.study import commissioning, steady as table
from agents.study.commissioning import Commissioning, Log, proposed_drive
from agents.study.steady import CHANNELS, COLUMNS, LEFT, Steady, misread, repeat_noise, steady
from soil_env._io.loading import ParameterError, config_dir
from soil_env.measurement.setup import read_setup
from soil_env.measurement.table import read_table
from soil_env.parameters import load_scenario, soils
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env.terramechanics.residual import ResidualTerm

SCENARIO = load_scenario("mixed", {"course": {"length": 2.0}, "control": {"time_limit": 10.0}})
PLAN = Commissioning(
    grades_deg=(-12.0, -9.0, -6.0, -4.0, -2.0, 0.0, 3.0, 6.0), payloads=(0.0, 8.0), rim_speeds=(0.08, 0.2), hold=10.0
)
ROWS = np.arange(40)


@pytest.fixture(scope="module")
def drives():
    """(world, log, points) of a hidden world with bulldozing."""
    world = WheelSoilModel.load(config_dir() / "worlds" / "bulldozing.yaml")
    log = commissioning.drive_all(SCENARIO, world, PLAN, 3)
    return world, log, table.steady_points(log, SCENARIO, PLAN)


def test_table_and_setup_are_read_back(drives, tmp_path):
    world, _, points = drives
    table.write_table(points, tmp_path / "table.csv")
    (tmp_path / "setup.yaml").write_text(yaml.safe_dump(table.setup(SCENARIO, world.wheel, PLAN, points)))
    setup = read_setup(tmp_path / "setup.yaml")
    read = read_table(tmp_path / "table.csv", setup.wheel)
    assert len(read) == len(points) > 10 and read.given == set(COLUMNS)
    assert np.allclose(read.slip, [p.mean["slip"] for p in points], rtol=1e-5)
    assert setup.soil.dig_gain.value == soils()[PLAN.soil].dig_gain and setup.soil.dig_gain.known
    assert setup.soil.friction_angle_deg.sd == SCENARIO.belief.friction_sd_deg


def test_points_are_steady_values_of_the_world_on_its_bed(drives):
    """Means of the log agree with the steady prediction of the true model, within the noise that the setup states."""
    world, _, points = drives
    bed = commissioning.bed_soil(SCENARIO, PLAN, np.random.default_rng([3, 7]))
    at = {name: np.array([p.mean[name] for p in points]) for name in ("slip", "load", "speed")}
    expected = WheelSoilModel(world.wheel, bed, world.effects).predict(at)
    noise = repeat_noise(PLAN, points)
    for name in CHANNELS:
        e = (np.array([p.mean[name] for p in points]) - getattr(expected, name)) / noise[name]
        assert np.sqrt(np.mean(e**2)) < 1.4, name
        assert abs(e.mean()) < 0.6, name


@pytest.mark.parametrize(
    ("name", "change"),
    [("speed", 0.002 * ROWS), ("sinkage", 0.0003 * ROWS), ("slip", 0.002 * ROWS), ("slip", 0.1 * (ROWS % 2)),
     ("speed", -0.1)],
)  # fmt: skip
def test_a_window_that_drifts_scatters_or_stands_is_not_steady(name, change):
    flat = {"slip": 0.1, "sinkage": 0.03, "drawbar_pull": 10.0, "load": 150.0, "torque": 5.0, "speed": 0.1}
    readings, zero = {key: np.full(40, value) for key, value in flat.items()}, np.zeros(40, dtype=int)
    log = Log(zero, zero, SCENARIO.control.period * ROWS, np.ones(40, dtype=bool), readings)
    assert steady(log, ROWS, SCENARIO, PLAN)
    readings[name] += change
    assert not steady(log, ROWS, SCENARIO, PLAN)


def test_repeat_noise_is_that_of_the_readings_and_of_slip():
    """y = 100 i + noise of 0.5, slip off by 0.004: the noise of y at its slip is hypot(0.5, 0.4)."""
    rng, plan = np.random.default_rng(5), dataclasses.replace(PLAN, repeats=20)
    points = []
    for run in range(len(plan.payloads) * len(plan.grades_deg) * plan.repeats):
        true = 0.1 * (run // plan.repeats % len(plan.grades_deg))
        slip = true + 0.004 * rng.standard_normal()
        mean = {name: 100.0 * true + 0.5 * rng.standard_normal() for name in CHANNELS}
        points.append(Steady(run, 0, 1.0, {"slip": slip, **mean}))
    for value in repeat_noise(plan, points).values():
        assert value == pytest.approx(np.hypot(0.5, 0.4), rel=0.15)


def test_errors_of_the_instrument_are_those_of_the_calibration_and_checks_leave_a_tenth(drives):
    _, _, points = drives
    read = {checked: misread(points, SCENARIO, 5, checked) for checked in ((), ("wheel_radius",))}
    slip = np.array([p.mean["slip"] for p in points])
    off = {checked: np.array([p.mean["slip"] for p in r]) - slip for checked, r in read.items()}
    error = off[()] / (slip - 1.0)  # of the rolling radius, the same in every point
    assert np.ptp(error) < 1e-9 and 0.0 < abs(error[0]) < 4.0 * 0.005
    assert np.allclose(off["wheel_radius",], LEFT * off[()], atol=1e-12)
    assert [p.mean["torque"] for p in read[()]] == [p.mean["torque"] for p in read["wheel_radius",]]
    assert [p.mean["sinkage"] for p in read[()]] == [p.mean["sinkage"] for p in points]
    assert Commissioning(checks=("plate",)).decided == ("sinkage_offset", "slip_bias", "wheel_radius")
    with pytest.raises(ParameterError, match="'plaet'"):
        Commissioning(checks=("plaet",))


def test_a_further_drive_is_near_the_proposed_run(drives):
    _, _, points = drives
    p = points[len(points) // 2]
    run = type("Run", (), {"conditions": {n: p.mean[n] for n in ("slip", "load", "speed")}})
    report = type("Report", (), {"next_tests": (run,)})
    one = proposed_drive(report, points, SCENARIO, PLAN, 1.5)
    payload, grade = divmod(p.run // PLAN.repeats, len(PLAN.grades_deg))
    assert one.payloads == (PLAN.payloads[payload],)
    assert one.grades_deg[0] == pytest.approx(PLAN.grades_deg[grade], abs=0.5)
    assert one.rim_speeds[0] == pytest.approx(PLAN.rim_speeds[p.stretch], rel=0.05)
    run.conditions["slip"] = 0.9  # more than any drive had
    steepest = max(PLAN.grades_deg[q.run // PLAN.repeats % len(PLAN.grades_deg)] for q in points)
    assert proposed_drive(report, points, SCENARIO, PLAN, 0.5).grades_deg[0] == min(
        steepest + 0.5, max(PLAN.grades_deg)
    )


def test_named_effects_are_carried_over_and_a_law_is_not(drives, tmp_path, monkeypatch):
    """A first report proposes a drive, the second one names an effect."""
    hidden, log, points = drives
    term = ResidualTerm("drawbar_pull", -0.04, {"slip": 1.0}, {"slip": [0.1, 0.3]})
    model = WheelSoilModel(ModelWheel(0.15, 0.15), soils()["dry_sand"], {"bulldozing": {"rankine": 1.0}}, (term,))
    run = type("Run", (), {"conditions": {n: points[0].mean[n] for n in ("slip", "load", "speed")}})
    reports = [type("Report", (), {"effects": e, "model": model, "next_tests": (run,)}) for e in ((), ("bulldozing",))]
    first, sizes = [], []
    stuck = [ParameterError("cannot climb")]

    def drive(*x):
        first.append(x[4:])
        if len(first) > 1 and stuck:
            raise stuck.pop()
        return log

    monkeypatch.setattr(commissioning, "drive_all", drive)

    def find(data, *_, **__):
        sizes.append(len(data.read_text().splitlines()) - 1)
        return reports[len(sizes) - 1]

    monkeypatch.setattr(commissioning, "find_discrepancy", find)
    found = commissioning.found_world(SCENARIO, hidden, PLAN, tmp_path)
    assert found.soil is None and found.effects == model.effects and found.residual == ()
    assert WheelSoilModel.load(tmp_path / "found.yaml") == found
    assert sizes == [len(points), 2 * len(points)] and first == [(), *[(PLAN.drives * PLAN.repeats,)] * 2]
