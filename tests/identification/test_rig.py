"""Rigs that are not the ideal one: no sinkage, a vertical load on a grade, free climbing, a tilt,
noise row by row, sensors with the errors of their calibration.

What they measure is made with `tests.terramechanics.reference`, resolved here by hand.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from soil_env._io.loading import ParameterError
from soil_env.identification.table import identify_table
from soil_env.identification.table.calibration import EXACT, SENSORS, sensor_unknowns
from soil_env.identification.table.problem import TableProblem
from soil_env.identification.table.report import text_of
from soil_env.measurement.setup import Calibration, Prior
from soil_env.parameters import Soil
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env.terramechanics.steady import Rows, _predict_rows
from tests.identification import test_table as tables
from tests.identification.test_table import (
    COLUMNS,
    LOADS,
    SAND,
    SD,
    SLIPS,
    THREE,
    clean,
    steady,
    table_of,
)

ON_GRADES = ("slip", "load", "grade_deg", *COLUMNS[2:])


def setup_of(noise=SD, **options):
    return replace(tables.setup_of(THREE, noise), **options)


def within(estimate):
    """True if phi, K and S are within three standard deviations of the truth."""
    k = 3.0 / 1.96  # the intervals reach 1.96 standard deviations to either side
    names = ("friction_angle_deg", "shear_modulus", "sinkage_coefficient")
    found = [(estimate.parameters[name], getattr(SAND, name)) for name in names]
    return all(
        k * (p.low - p.value) <= truth - p.value <= k * (p.high - p.value) for p, truth in found
    )


@pytest.mark.parametrize("seed", range(3))
def test_pull_and_torque_suffice(tmp_path, seed):
    """Without any sinkage the soil is found, with wider intervals than with the sinkages."""
    rows = clean()
    e, full = (
        tables.estimate(tmp_path, rows, setup_of(), np.random.default_rng(seed), leave_out=names)
        for names in (("sinkage",), ())
    )
    assert e.converged and within(e) and "sinkage" not in e.fits
    assert any("No sinkage in 24 of 24 rows: it follows from the load" in w for w in e.warnings)
    assert e.reference_sinkage == pytest.approx(np.median(rows[:, 2]), rel=0.1)
    for name in ("friction_angle_deg", "sinkage_coefficient"):  # what was not measured is missed
        a = e.parameters[name]
        b = full.parameters[name]
        assert a.high - a.low > b.high - b.low


def test_one_force_suffices_with_a_prior_of_the_stiffness(tmp_path):
    setup = tables.setup_of(THREE, sinkage_coefficient=Prior(9e5, 1e5))
    e = tables.estimate(tmp_path, clean(), setup, leave_out=("sinkage", "torque"))
    assert e.parameters["friction_angle_deg"].value == pytest.approx(
        SAND.friction_angle_deg, rel=0.01
    )


def resolved(slip, load, grade_deg):
    """(sinkage [m], pull along the slope [N], torque [N m]) of a wheel with a vertical load on a
    grade, uphill positive.

    It presses less on the ground than its load, a component of which pulls it downhill.
    """
    b = math.radians(grade_deg)
    z, pull, torque = steady(slip, load * math.cos(b))
    return z, pull - load * math.sin(b), torque


def test_a_vertical_load_is_resolved(tmp_path):
    rows = [
        (slip, 120.0, b, *resolved(slip, 120.0, b))
        for b in (-8.0, 0.0, 8.0, 15.0)
        for slip in SLIPS
    ]
    t = table_of(tmp_path, rows, np.random.default_rng(0), columns=ON_GRADES)
    e = identify_table(t, setup_of(load="vertical"))
    assert within(e) and not any("grade" in w or "does not fit" in w for w in e.warnings)
    normal = identify_table(t, setup_of())
    assert normal.law_error > 1.5 * e.law_error and any(
        "taken as level" in w for w in normal.warnings
    )


def test_grades_that_a_level_would_not_show_are_not_told(tmp_path):
    """As of a log on level ground, whose pitch is noise."""
    rng = np.random.default_rng(0)
    rows = [(s, 120.0, rng.normal(0.0, 0.1), *steady(s, 120.0)) for s in SLIPS]
    e = tables.estimate(tmp_path, rows, setup_of(), rng, columns=ON_GRADES)
    assert not any("taken as level" in w for w in e.warnings)


def test_free_climbing_shows_the_soil(tmp_path):
    """No pull is measured: the grade that a slip just climbs is the measurement."""
    rows = []
    for load in LOADS:
        for slip in (0.15, 0.25, 0.4, 0.55, 0.7):
            grade = brentq(
                lambda b, slip=slip, load=load: resolved(slip, load, b)[1], -28.0, 45.0, xtol=1e-6
            )
            z, _, torque = resolved(slip, load, grade)
            rows.append((slip, load, grade, z, 0.0, torque))
    t = table_of(tmp_path, rows, columns=ON_GRADES)
    p = identify_table(t, setup_of(load="vertical")).parameters
    assert p["friction_angle_deg"].value == pytest.approx(SAND.friction_angle_deg, rel=2e-3)
    assert p["shear_modulus"].value == pytest.approx(SAND.shear_modulus, rel=1e-2)
    with pytest.raises(
        ParameterError, match="drawbar_pull = 0 on every grade, .*: expected load: vertical"
    ):
        identify_table(t, setup_of())


@pytest.mark.parametrize("tilt", [-1.5, 2.0])
def test_a_tilt_is_fitted_with_the_soil(tmp_path, tilt):
    """The ground rises by it against the axes of the rig."""
    rows = [(slip, load, *resolved(slip, load, tilt)) for load in LOADS for slip in SLIPS]
    t = table_of(tmp_path, rows, np.random.default_rng(0))
    e = identify_table(t, setup_of(tilt_deg=Prior(0.0, 1.0)))
    p = e.parameters["tilt_deg"]
    assert p.low < tilt < p.high and p.high - p.low < 1.0 and p.unit == "deg" and within(e)
    assert "tilt of the rig" in e.free and e.covariance.shape == (4, 4)
    known = identify_table(t, setup_of(tilt_deg=Prior(tilt, 0.0)))
    assert known.parameters["tilt_deg"].known and within(known)
    level = identify_table(t, setup_of())
    assert level.law_error > 2.0 * e.law_error and "tilt_deg" not in level.parameters


def test_a_noisy_run_weighs_as_little_as_it_says(tmp_path):
    """Half of the rows 20 times as noisy, by their own columns: the estimate is as good as from the
    other half.
    """
    rng = np.random.default_rng(4)
    rows = clean().copy()
    sd = np.array(list(SD.values())) * np.where(np.arange(len(rows)) % 2, 20.0, 1.0)[:, None]
    rows[:, 2:] += sd * rng.normal(size=sd.shape)
    rows[:, 2] = np.maximum(rows[:, 2], 1e-3)
    columns = (*COLUMNS, *(f"{name}_sd" for name in SD))
    e = tables.estimate(tmp_path, np.hstack([rows, sd]), setup_of(None), columns=columns)
    assert within(e) and not any(fit.estimated for fit in e.fits.values()) and not e.warnings
    assert e.fits["torque"].noise == pytest.approx(np.median(sd[:, 2]))
    half = tables.estimate(tmp_path, rows[::2], setup_of())
    width = [p.high - p.low for p in (x.parameters["friction_angle_deg"] for x in (e, half))]
    assert width[0] == pytest.approx(width[1], rel=0.05)


def test_rows_that_nobody_may_write_to_compile_nothing_anew(tmp_path):
    """As those of a table are: code for them would be compiled and kept beside the other."""
    problem = TableProblem(table_of(tmp_path, clean(), np.random.default_rng(0)), setup_of())
    u = np.zeros(len(problem.unknowns))
    expected = problem.steady(u, problem.rows)
    versions = len(_predict_rows._function.overloads)
    locked = Rows(*(column.copy() for column in problem.rows))
    for column in locked:
        column.flags.writeable = False
    np.testing.assert_array_equal(problem.steady(u, locked), expected)
    assert len(_predict_rows._function.overloads) == versions


def misread(tilt=0.0, force=(0.0, 0.0, 0.0), torque=(0.0, 0.0, 0.0)):
    """Rows as `clean`, read by a rig with a `tilt` [deg] and sensors with a zero [N or N m], a gain
    and a crosstalk.
    """
    rows = clean().copy()
    _, load, _, pull, moment = clean().T
    rows[:, 3] = force[0] + (1.0 + force[1]) * pull + force[2] * moment / tables.WHEEL.radius
    rows[:, 3] -= load * math.sin(math.radians(tilt))
    rows[:, 4] = torque[0] + (1.0 + torque[1]) * moment + torque[2] * pull * tables.WHEEL.radius
    return rows


def test_what_a_calibration_allows_is_no_misfit(tmp_path):
    """Errors of the rig drawn as they are believed to be. Where the same setup says that the rig is
    exact, they are taken for a missing effect and draw the soil further off.
    """
    usual = setup_of(calibration=Calibration())
    fits = {"usual": 0, "exact": 0}
    off = {"usual": [], "exact": []}
    for seed in range(8):
        rng = np.random.default_rng([20261130, seed])
        errors = [rng.normal(0.0, x.sd) for x in sensor_unknowns(usual, LOADS[1], 0.15)]
        tilt, zero, gain, torque_zero, torque_gain, share, torque_share = errors
        force = (zero, gain, share)
        t = table_of(tmp_path, misread(tilt, force, (torque_zero, torque_gain, torque_share)), rng)
        for name, setup in (("usual", usual), ("exact", setup_of())):
            e = identify_table(t, setup)
            fits[name] += not e.misfit
            off[name].append(e.parameters["shear_modulus"].value / SAND.shear_modulus - 1.0)
            assert name == "exact" or within(e)
    assert fits["usual"] >= 7 and fits["exact"] <= 5
    assert np.std(off["usual"]) < 0.9 * np.std(off["exact"])


def test_a_sensor_beyond_its_calibration_is_no_fit(tmp_path):
    """A gain that is off by ten standard deviations; within two it is fitted and not doubted."""
    usual = setup_of(calibration=Calibration())
    for gain, doubted in ((0.2, True), (0.03, False)):
        t = table_of(tmp_path, misread(force=(0.0, gain, 0.0)), np.random.default_rng(0))
        e = identify_table(t, usual)
        assert ("times the calibration of the rig" in e.misfit) == doubted
        assert any("the force gain would be" in words for words in e.warnings) == doubted
        assert e.rig["force gain"] > 0.5 and max(e.rig, key=e.rig.get) == "force gain"
        assert f"force gain +{e.rig['force gain']:.1f}" in text_of(e)
    assert identify_table(t, setup_of()).rig == {}


def test_a_rig_that_would_have_to_err_too_much_hides_no_effect(tmp_path):
    """Bulldozing on an exact rig: zeros and tilt take it up, further than a calibration allows."""
    model = WheelSoilModel(
        ModelWheel(tables.WHEEL.radius, tables.WHEEL.width),
        Soil(**SAND._asdict(), source="here"),
        {"bulldozing": {"rankine": 1.0}},
    )
    slip, load = clean()[:, :2].T
    found = model.predict({"slip": slip, "load": load})
    rows = np.column_stack([slip, load, *found[:3]])
    setup = replace(tables.setup_of(), calibration=Calibration())
    e = tables.estimate(tmp_path, rows, setup, np.random.default_rng(0))
    assert "times the calibration of the rig" in e.misfit and "soil-env discover" in e.misfit


def test_a_wheel_that_climbs_by_itself_reads_no_pull(tmp_path):
    """Zeros and gains of a force sensor do not matter where no force is measured, a level does."""
    usual = setup_of(calibration=Calibration(), load="vertical")
    rows = [(s, 100.0, g, 0.02, 0.0, 5.0) for s, g in ((0.2, 5.0), (0.3, 8.0), (0.4, 9.0))]
    problem = TableProblem(table_of(tmp_path, rows, columns=ON_GRADES), usual)
    assert [x.name for x in problem.rig] == [
        name for name in SENSORS.values() if not name.startswith("force")
    ]


def test_only_errors_that_are_not_ruled_out_are_unknown():
    """By a check, a calibration of 0 or a tilt of the setup."""
    usual = setup_of(calibration=Calibration())
    assert [x.name for x in sensor_unknowns(usual, 100.0, 0.15)] == [*SENSORS.values()]
    assert sensor_unknowns(replace(usual, calibration=EXACT), 100.0, 0.15) == ()
    known = replace(
        usual,
        calibration=Calibration(force_gain=0.0, torque_offset=0.3),
        checked=("torque_gain",),
        tilt_deg=Prior(1.0, 0.0),
    )
    left = {x.name: x.sd for x in sensor_unknowns(known, 100.0, 0.15)}
    out = {"tilt", "force_gain_gain", "torque_gain_gain"}
    assert {*left} == {*SENSORS.values()} - out
    assert left["torque_offset_offset"] == 0.3 and left["force_offset_offset"] == 0.3
    assert left["force_crosstalk_share"] == 0.01
