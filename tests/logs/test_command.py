"""The command from recording to report; steady windows; the replay over gaps; what a log
identifies.
"""

import csv
import json
import math
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
import yaml

from soil_env._io.files import MANIFEST
from soil_env.cli import main
from soil_env.identification.table import identify_table
from soil_env.identification.table.priors import soil_unknowns
from soil_env.logs import read_map, replay, steady_windows
from soil_env.logs.align import Aligned, Channel
from soil_env.logs.replay import ESTIMATED, PICKED, _grounds, findings
from soil_env.logs.report import _drawn, _ground_table, report_of
from soil_env.logs.steady import Ground, Steady, advice, commands, files, grounds, setup_text
from soil_env.measurement.setup import read_setup
from soil_env.measurement.table import read_table
from soil_env.online import OnlineIdentifier, Status
from soil_env.parameters import Noise, soils
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from tests.logs.bags import write_json_mcap, write_map

pytest.importorskip("mcap")
pytest.importorskip("rosbags")

#: Plan of `made` with four slips of 2 s each.
VARIED = [(slip, 2.0) for slip in (0.1, 0.4, 0.2, 0.6)]
# Parameters of Lete sand that the map states as known.
KNOWN = {"cohesion": 1300, "sinkage_exponent": 0.79}


def made(plan, period=0.1, noise=0.0, soil="lete_sand", **changes):
    """Readings, a row a `period` [s], of a wheel that keeps each slip of `plan` [(slip, seconds)].

    The ground is the preset `soil`, by default Wong's Lete sand, with `changes` and without
    slip-sinkage. `noise`: factor of the standard deviations of the readings; 0 for none.
    """
    model = WheelSoilModel(ModelWheel(0.15, 0.15), replace(soils()[soil], dig_gain=0.0, **changes))
    rng = np.random.default_rng(0)
    slips = np.concatenate([np.full(round(t / period), s) for s, t in plan])
    state = model.predict({"slip": slips, "load": 150.0})
    readings = {
        "wheel_speed": (2.0, 0.0),
        "speed": (0.3 * (1.0 - slips), 1e-4),
        "sinkage": (state.sinkage, 1e-4),
        "drawbar_pull": (state.drawbar_pull, 0.3),
        "load": (150.0, 1.0),
        "torque": (state.torque, 0.05),
    }
    for name, (value, sd) in readings.items():
        readings[name] = value + noise * sd * rng.normal(size=slips.size)
    channels = {name: Channel(name) for name in readings}
    return Aligned(0, period * np.arange(slips.size), readings, channels, period)


def of_two_soils(*changes):
    """Noisy readings of two drives of 16 s at four slips, one after the other.

    `changes`: of each drive the `soil` or parameters of it, as `made` takes them.
    """
    plan = [(s, 4.0) for s in (0.1, 0.3, 0.2, 0.5)]
    one, two = (made(plan, noise=1.0, **own) for own in changes)
    readings = {n: np.concatenate([v, two.readings[n]]) for n, v in one.readings.items()}
    return replace(one, time=np.concatenate([one.time, two.time + 16.0]), readings=readings)


def learnt(log, log_map):
    """(replay of a log, its steady windows)."""
    found = replay(log, log_map)
    return found, steady_windows(log, log_map, found.ground)


def without(log, *names):
    """A log without these readings."""
    return replace(log, readings={n: v for n, v in log.readings.items() if n not in names})


@pytest.fixture()
def log_map(tmp_path):
    """A map for the readings of `made`, with `KNOWN`."""
    return read_map(
        write_map(
            tmp_path, {"wheel": {"radius": 0.15, "width": 0.15, "body_mass": 15.3}, "soil": KNOWN}
        )
    )


@pytest.fixture()
def without_digging(log_map):
    """The map with a belief of hardly any slip-sinkage: `made` has none."""
    return replace(log_map, belief=replace(log_map.belief, dig_gain=0.02))


def test_steady_points_are_the_points_that_were_driven(log_map, tmp_path):
    """Noise-free: rows of exactly the slips, and a fit that gives the soil back; the setup's noise
    is that put in.
    """
    driven = [0.1, 0.2, 0.35, 0.5, 0.7]
    log = made([(s, 4.0) for s in driven])
    found = steady_windows(log, log_map)
    # No row across a change of slip.
    assert sorted({round(row["slip"], 6) for row in found.rows}) == driven
    assert len(found.rows) >= 3 * len(driven)
    noisy = steady_windows(made([(s, 4.0) for s in driven], noise=1.0), log_map)
    # A row is the mean of the ten readings of a window of 1 s.
    assert noisy.noise["sinkage"] == pytest.approx(1e-4 / math.sqrt(10), rel=0.2)
    assert noisy.noise["torque"] == pytest.approx(0.05 / math.sqrt(10), rel=0.2)
    (tmp_path / "steady.csv").write_text(noisy.table())
    prior = replace(replay(log, log_map).prior, dig_gain=0.0)  # the soil has none
    (tmp_path / "setup.yaml").write_text(setup_text(log_map, noisy, prior, None))
    setup = read_setup(tmp_path / "setup.yaml")
    soil = soils()["lete_sand"]
    estimate = identify_table(read_table(tmp_path / "steady.csv", setup.wheel), setup)
    assert estimate.parameters["cohesion"].known
    for name, error in (("friction_angle_deg", 1.0), ("shear_modulus", 0.002)):
        assert estimate.parameters[name].value == pytest.approx(getattr(soil, name), abs=error)


def test_a_setup_has_the_errors_of_the_sensors(log_map, tmp_path):
    """As the online identifier believes them: of force sensors, else of accelerometer and motor."""
    of = Noise()
    weight = log_map.weight
    arm = weight * log_map.wheel.radius
    any_source = replace(log_map.channels["sinkage"], unit=None)
    without = {n: x for n, x in log_map.channels.items() if n not in ("drawbar_pull", "torque")}
    forces = replace(log_map, channels=without | {"drawbar_pull": any_source, "torque": any_source})
    mass = log_map.wheel.body_mass
    inertial = (of.acceleration_gain, of.acceleration_zero * mass, of.motor_torque_gain)
    for used, force_gain, force_offset, torque_gain, zero in (
        (forces, of.drawbar_pull_gain, of.drawbar_pull_zero * weight, of.torque_gain, "torque"),
        (replace(log_map, channels=without), *inertial, "motor_torque"),
    ):
        text = setup_text(used, Steady([]), replay(made([(0.2, 3.0)]), log_map).prior, None)
        (tmp_path / "setup.yaml").write_text(text)
        found = read_setup(tmp_path / "setup.yaml").calibration
        torque_offset = getattr(of, f"{zero}_zero") * arm
        assert (found.force_gain, found.torque_gain) == (force_gain, torque_gain)
        assert found.force_offset == pytest.approx(force_offset, rel=1e-3)
        assert found.torque_offset == pytest.approx(torque_offset, rel=1e-3)
        assert found.tilt_deg == pytest.approx(math.degrees(of.pitch_zero), rel=1e-3)


def test_a_setup_has_the_gravity_of_the_map(log_map, tmp_path):
    moon = replace(log_map, gravity=1.62)
    text = setup_text(moon, Steady([]), replay(made([(0.2, 3.0)]), moon).prior, None)
    (tmp_path / "setup.yaml").write_text(text)
    assert read_setup(tmp_path / "setup.yaml").gravity == 1.62


def test_what_changes_is_not_steady(log_map):
    """A ramp of slip; one up and down within a window; a wheel at rest; a sinkage that has not come
    to its end yet though it changes little.
    """
    up_and_down = [0.1, 0.2, 0.3, 0.4, 0.5, 0.5, 0.4, 0.3, 0.2, 0.1]
    for slips in (np.linspace(0.1, 0.9, 60), up_and_down):
        assert not steady_windows(made([(s, 0.1) for s in slips]), log_map).rows
    still = made([(0.2, 3.0)])
    assert len(steady_windows(still, log_map).rows) == 3
    still.readings["wheel_speed"][:] = 0.0
    still.readings["speed"][:] = 0.0
    assert not steady_windows(still, log_map).rows
    sinking = made([(0.2, 6.0)])
    sinking.readings["speed"] *= 0.05
    sinking.readings["wheel_speed"] *= 0.05
    # 15 mm/s of travel, adaptation length 0.3 m: half of a second brings 2.6 % of what is left,
    # here of 20 mm
    sinking.readings["sinkage"] += 0.02 * (1.0 - np.exp(-0.05 * sinking.time))
    assert not steady_windows(sinking, log_map).rows


def test_a_gap_starts_the_identifier_anew(log_map):
    log = made(VARIED)
    one = replay(log, log_map)
    assert one.restarts == 0 and one.renewed.sum() > 10
    # 100 s of silence before reading 40, and what follows it alone
    two = replay(replace(log, time=log.time + 100.0 * (log.time > 3.95)), log_map)
    rest = {n: v[40:] for n, v in log.readings.items()}
    again = replay(replace(log, time=log.time[40:], readings=rest), log_map)
    assert two.restarts == 1 and two.warnings
    before, both, after = (x.values["shear_modulus"] for x in (one, two, again))
    assert both[39] == before[39] and both[-1] != before[-1]
    assert both[-1] == pytest.approx(after[-1], rel=1e-9)


def test_no_line_of_a_picture_leads_over_a_gap():
    """First and last point and those beside the gap are drawn, few of very many others."""
    time = np.array([0.0, 0.1, 0.2, 30.0, 30.1])
    drawn, shown = _drawn(time, 0.1)
    assert np.array_equal(shown, [0.0, 0.1, 0.2, math.nan, 30.0, 30.1], equal_nan=True)
    assert np.array_equal(time[drawn][np.isfinite(shown)], time)
    many = 0.1 * np.arange(100_000) + 50.0 * (np.arange(100_000) >= 70_000)
    drawn, shown = _drawn(many, 0.1)
    assert np.isnan(shown).sum() == 1 and shown.size < 4100
    assert (shown[0], shown[-1]) == (many[0], many[-1])
    assert [_drawn(many[:n], 0.1)[1].tolist() for n in (0, 1)] == [[], [0.0]]


def test_a_gap_that_the_map_allows_warns_of_nothing(log_map):
    """A gap of 15 s where 60 s are allowed, and the shortest period, whose steps are rounded."""
    allowed = replace(log_map, restart_gap=60.0)
    log = made(VARIED)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        late = replace(log, time=log.time + 15.0 * (log.time > 3.95))
        assert replay(late, allowed).restarts == 0
        fine = made([(0.2, 0.1)], period=1e-3)
        replay(fine, replace(log_map, period=1e-3))


def test_readings_of_a_lifted_wheel_are_replayed(log_map):
    """A load of nothing or less, as of a sensor with noise, is judged under the least load."""
    log = made(VARIED)
    log.readings["load"][40:] = np.tile([0.0, -0.5], 20)
    out = replay(log, log_map)
    assert out.renewed[40:].any() and np.isfinite(out.values["drawbar_margin"][-1])


def test_findings_say_what_was_learnt(log_map):
    log = made(VARIED, noise=1.0)
    part = without(log, "drawbar_pull", "torque")
    logs = (log, part, without(part, "sinkage"), without(log, "sinkage"))
    # Standard deviations over those of the prior; 1: nothing learnt.
    found = [replay(x, log_map) for x in logs]
    whole, kinematic, blind, unseen = (x.learnt() for x in found)
    assert whole["friction_angle_deg"] < 0.8 and whole["shear_modulus"] < 0.8
    assert kinematic["friction_angle_deg"] > 0.6  # correlations of the belief
    assert kinematic["sinkage_coefficient"] < 0.8
    assert min(blind.values()) == pytest.approx(1.0, abs=0.15)
    assert unseen["shear_modulus"] < 0.5
    assert len(findings(found[1], part, log_map)) > len(findings(found[0], log, log_map))


def test_a_motor_torque_without_inertia_is_left_out(log_map):
    """One line of the findings says so. With the inertia it narrows the estimate of K; a channel
    without a reading is not mentioned.
    """
    log = made(VARIED, noise=1.0)
    none = without(log, "drawbar_pull", "torque")
    motor = replace(none, readings=none.readings | {"motor_torque": log.readings["torque"]})
    bare = replay(motor, log_map)
    expected = replay(none, log_map).values["shear_modulus"]
    assert np.array_equal(bare.values["shear_modulus"], expected)
    assert sum("wheel.inertia" in line for line in findings(bare, motor, log_map)) == 1
    known = replace(log_map, wheel=replace(log_map.wheel, inertia=0.5))
    found = replay(motor, known)
    assert found.learnt()["shear_modulus"] < 0.7 * bare.learnt()["shear_modulus"]
    assert not any("wheel.inertia" in line for line in findings(found, motor, known))
    dead = replace(none, readings=none.readings | {"motor_torque": np.full(len(none), math.nan)})
    assert not any("wheel.inertia" in line for line in findings(replay(dead, known), dead, known))


@pytest.mark.parametrize(("share", "place"), [(0.05, None), (0.3, "- "), (0.9, "check first: ")])
def test_readings_that_contradict_the_model_are_told_first_where_most_do(
    log_map, unrendered, share, place
):
    log = made(VARIED, noise=1.0)
    found, steady = learnt(log, log_map)
    status = np.full(len(found.status), Status.CONVERGED)
    status[: round(share * status.size)] = Status.MISFIT
    found = replace(found, status=status)
    text = report_of("a.csv", log, log_map, found, steady)[1]
    said = [line for line in text.splitlines() if "% of the steps the readings contra" in line]
    assert len(said) == (place is not None)
    assert all(line.startswith(place) for line in said)


@pytest.mark.parametrize(("name", "value"), [("shear_modulus", 1e300), ("cohesion", math.inf)])
def test_an_estimate_of_no_soil_is_refused_in_one_line(log_map, monkeypatch, name, value):
    """In the middle of a log and at its end: no picture, table or file has it."""
    log = made(VARIED, noise=1.0)
    update = OnlineIdentifier.update

    def absurd(self, readings):
        """`update`, with an impossible value from 3 to 3.5 s and after 7 s."""
        estimate = update(self, readings)
        far = readings.time > 7.0 or 3.0 < readings.time < 3.5
        return replace(estimate, **{name: value}) if far else estimate

    monkeypatch.setattr(OnlineIdentifier, "update", absurd)
    found, steady = learnt(log, log_map)
    written, _ = report_of("a.csv", log, log_map, found, steady)
    refused = [line for line in found.warnings if "No soil has the values" in line]
    assert (
        len(refused) == 1
        and "13 of 80" in refused[0]  # at 3.1 to 3.4 s, and from 7.1 s on
        and written["report.html"].count("No soil has the values") == 1
    )
    rows = list(csv.DictReader(written["estimates.csv"].splitlines()))
    assert rows[-1][name] == rows[34][name] == "" and rows[29][name] and rows[39][name]
    assert json.loads(written["log.json"])["estimate"][name] is None


def test_a_cohesion_below_zero_counts_as_zero(log_map, monkeypatch):
    update = OnlineIdentifier.update
    monkeypatch.setattr(
        OnlineIdentifier,
        "update",
        lambda self, readings: replace(update(self, readings), cohesion=-0.2),
    )
    found, _ = learnt(made(VARIED, noise=1.0), log_map)
    assert not found.warnings and np.all(found.values["cohesion"] == 0.0)
    assert np.isfinite(found.values["friction_angle_deg"]).all()


def test_a_map_may_state_the_exponent_with_its_standard_deviation(without_digging):
    log_map = replace(without_digging, soil={"sinkage_exponent": {"value": "8e-1", "sd": 0.1}})
    found, steady = learnt(made([(s, 4.0) for s in (0.1, 0.3, 0.5)]), log_map)
    text = setup_text(log_map, steady, found.prior, None)
    S = yaml.safe_load(text)["soil"]["sinkage_coefficient"]["value"]
    b = log_map.belief
    deep = (0.2 * log_map.wheel.radius) ** (b.sinkage_exponent - 0.8)
    assert S == pytest.approx(b.sinkage_coefficient * deep, rel=1e-3)


def test_the_setup_of_a_log_has_the_belief_as_priors(without_digging, tmp_path):
    """The identifier of tables reads the same mean and standard deviation from it, of K and S in
    their logarithm; what the map knows stays known.
    """
    log_map = without_digging
    log = made([(s, 4.0) for s in (0.1, 0.3, 0.5)], noise=1.0)
    found, steady = learnt(log, log_map)
    written = files(grounds(found, steady), steady, log_map, found.prior)
    (tmp_path / "setup.yaml").write_text(written["setup.yaml"])
    read = read_setup(tmp_path / "setup.yaml")
    b = log_map.belief
    unknowns, known = soil_unknowns(read, np.full(3, 150.0), np.full(3, 0.01))
    # the same pressure at 0.2 radii, where the identifier compares soils
    deep = (0.2 * log_map.wheel.radius) ** (b.sinkage_exponent - KNOWN["sinkage_exponent"])
    seen = {u.name: (u.value(0.0), u.sd) for u in unknowns}
    assert seen == {
        "friction_angle_deg": pytest.approx((b.friction_angle_deg, b.friction_sd_deg), rel=1e-3),
        "shear_modulus": pytest.approx((b.shear_modulus, b.shear_modulus_sd), rel=1e-3),
        "sinkage_coefficient": pytest.approx(
            (b.sinkage_coefficient * deep, b.sinkage_coefficient_sd), rel=1e-3
        ),
    }
    assert known == KNOWN  # of the map, in place of the belief
    # Where an estimate was current.
    gain = (found.surest_on(1) or {"dig_gain": b.dig_gain})["dig_gain"]
    assert read.soil.dig_gain.value == pytest.approx(gain, rel=1e-3)
    without = setup_text(log_map, steady, found.prior, None)
    assert "# dig_gain: that of the belief, as if it were known" in without


def test_points_of_two_soils_are_not_one_table(without_digging, tmp_path):
    """Each ground has its own table, of which the fit is its soil; that of all points has both."""
    log_map = replace(without_digging, soil={})
    names = ("dry_sand", "quartz_sand")
    log = of_two_soils(*({"soil": name} for name in names))
    found, steady = learnt(log, log_map)
    parts = grounds(found, steady)
    assert len(parts) == 2 and parts[1].begin == pytest.approx(16.0, abs=1.0)
    assert {row["run"].split(".")[0] for row in steady.rows} == {"ground1", "ground2"}
    written = files(parts, steady, log_map, found.prior)
    tables = {f"ground{k}.{kind}" for k in (1, 2) for kind in ("csv", "yaml")}
    assert set(written) == tables | {"steady.csv", "setup.yaml"}
    for name, content in written.items():
        (tmp_path / name).write_text(content)
    fits = []
    for name, late in (("ground1", {False}), ("ground2", {True})):
        known = read_setup(tmp_path / f"{name}.yaml")
        table = read_table(tmp_path / f"{name}.csv", known.wheel)
        fits.append(identify_table(table, known).parameters["shear_modulus"].value)
        assert set(table.time > 16.0) == late
    known = read_setup(tmp_path / "setup.yaml")
    assert set(read_table(tmp_path / "steady.csv", known.wheel).time > 16.0) == {False, True}
    assert fits == pytest.approx([soils()[name].shear_modulus for name in names], rel=0.4)
    run = commands(parts, tmp_path)
    assert len(run) == 4 and not any("steady.csv" in line for line in run)
    assert parts[1].differs > 0.8 and "Grounds found: 2." in advice(found, parts, steady)[0]
    assert any(
        "16." in line and "one ground at a time" in line for line in advice(found, parts, steady)
    )
    # Where one of them alone has steady points, these are the table.
    parts[1] = replace(parts[1], points=Steady())
    written = files(parts, parts[0].points, log_map, found.prior)
    assert set(written) == {"steady.csv", "setup.yaml"} and "#" not in written["steady.csv"]
    said = " ".join(advice(found, parts, parts[0].points))
    assert "of one ground. Its setup is setup.yaml." in said and "on ground 2" in said


def test_soils_that_differ_in_sinkage_alone_are_two_grounds(without_digging):
    log_map = replace(without_digging, soil={})
    stiff = soils()["lete_sand"].lumped(0.15)
    soft = {"k_c": None, "k_phi": None, "sinkage_coefficient": stiff / 4.0}
    found = replay(of_two_soils({}, soft), log_map)
    assert len(found.differs) == 2 and found.differs[1] > 0.8


def test_the_estimate_of_a_ground_is_its_surest(log_map):
    """Not the last, which is the prior's behind a border that is none."""
    found = replay(made([(0.2, 1.0)]), log_map)
    size = found.time.size
    values = {name: np.full(size, 1.0) for name in found.values}
    values["friction_angle_sd_deg"] = np.where(np.arange(size) == 3, 0.5, 1.0)
    values["cohesion"] = np.arange(size, dtype=float)
    status = np.full(size, Status.CONVERGED)
    border = np.arange(size) == 5  # a blend is of no ground, however sure
    values["friction_angle_sd_deg"][border] = 0.1
    some = replace(found, values=values, status=status, ground=np.ones(size, int), on_border=border)
    assert some.surest_on(1)["cohesion"] == 3.0 and some.surest_on(2) is None
    assert some.surest_on(1)["friction_angle_sd_deg"] == PICKED * 0.5
    for name in ("best_pull", "drawbar_margin"):
        assert (some.surest_on(1)[name], some.surest_on(1)[f"{name}_sd"]) == (1.0, PICKED)


def test_no_number_of_a_ground_is_cut_on_the_terminal():
    estimate = {
        "friction_angle_deg": 33.2,
        "friction_angle_sd_deg": 12.9,
        "shear_modulus": 8.27e-3,
        "shear_modulus_relative_sd": 0.32,
        "sinkage_coefficient": 1.96e6,
        "sinkage_coefficient_relative_sd": 0.33,
    }
    points = Steady([{"slip": -0.1}, {"slip": -0.2}])
    parts = [
        Ground(10, 1000.0, 1005.0, math.nan, points, estimate),
        Ground(11, 1005.1, 1009.0, 0.7, Steady(), None),
    ]
    said = _ground_table(parts).text(2)
    assert "33.2 +- 12.9 deg" in said and "..." not in said


def test_borders_without_another_soil_are_no_grounds(log_map):
    """Of 13 borders only the two at steps 500 and 900 have another soil behind them: those two
    count, and so does a gap.
    """
    steps = 1400
    time = 0.1 * np.arange(steps)
    shown = {"wheel_speed": np.full(steps, 2.0), "speed": np.full(steps, 0.25)}
    prior = replay(made([(0.2, 1.0)]), log_map).prior
    soil = np.repeat([0.0, 1.5, 0.0], [500, 400, 500])
    values = {n: np.full(steps, getattr(prior, n)) for n in ESTIMATED}
    rng = np.random.default_rng(0)
    for value, sd in (("friction_angle_deg", "friction_angle_sd_deg"), ("cohesion", "cohesion_sd")):
        values[sd] *= 0.1
        values[value] += values[sd] / 0.1 * (soil + 0.1 * np.repeat(rng.normal(size=14), 100))
    found = np.arange(steps) // 100
    current = np.full(steps, int(Status.CONVERGED))
    for gap, last, unknown in ((0.0, [499, 899], 0), (100.0, [299, 499, 899], 1)):
        log = Aligned(0, time + gap * (time > 29.95), shown, {}, 0.1)
        ground, differs = _grounds(log, log_map, found, values, current, prior)
        # Last step of each ground but the last.
        assert np.flatnonzero(np.diff(ground)).tolist() == last and math.isnan(differs[unknown])
        assert gap or min(differs[1:]) > 0.9
    unknown = np.where((found > 6) & (found < 9), int(Status.NO_DATA), current)
    ground, differs = _grounds(log, log_map, found, values, unknown, prior)
    # What tells nothing belongs to the ground after it.
    assert np.flatnonzero(np.diff(ground)).tolist() == [299, 499, 699]


def test_command(tmp_path, capsys):
    out = tmp_path / "out"
    given = ["--map", str(write_map(tmp_path)), "--out", str(out)]
    assert main(["logs", str(write_json_mcap(tmp_path / "drive.mcap")), *given]) == 0
    always = {"report.html", "log.json", "estimates.csv", "estimates.png", "readings.png"}
    written = {p.name for p in out.iterdir() if not p.name.startswith("ground")}
    assert written == always | {"steady.csv", "setup.yaml", MANIFEST}
    page = (out / "report.html").read_text()
    assert not re.search(r"(src|href)=.(?!data:)", page) and page.count("<img") == 2
    facts = json.loads((out / "log.json").read_text())
    lines = (out / "estimates.csv").read_text().splitlines()
    assert facts["steps"] == 200 == len(lines) - 1
    assert float(lines[-1].split(",")[1]) == pytest.approx(facts["estimate"]["friction_angle_deg"])
    said = capsys.readouterr().out
    assert "/drive" in said and "steady.csv" in said
    assert "N/m^(n+2), n 1.07" in said  # of the belief; the map gives none
    assert said.startswith("From 1.000 s of its clock, 19.9 s, 200 steps of 0.1 s.")
    mine = {"ground1.csv", "ground1.yaml", "mine.csv"}
    for name in mine:
        (out / name).write_text("of the user")
    assert main(["logs", str(write_json_mcap(tmp_path / "short.mcap", steps=8)), *given]) == 0
    # nothing of the other log, and all that the user has put there
    assert {p.name for p in out.iterdir()} == always | mine | {MANIFEST}
