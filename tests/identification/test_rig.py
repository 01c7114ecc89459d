"""Rigs that are not the ideal one: no sinkage, a vertical load on a grade, free climbing, a tilt, noise row by row.

What they measure is made with `tests.terramechanics.reference`, resolved here by hand.
"""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from soil_env._io.loading import ParameterError
from soil_env.identification.table import identify_table
from soil_env.measurement.setup import NoiseLevels, Prior, Setup, SoilPriors
from soil_env.measurement.table import read_table
from tests.identification.test_table import LOADS, SAND, SD, SLIPS, WHEEL, clean, steady, table_of

KNOWN = {"cohesion": Prior(SAND.cohesion, 0.0), "sinkage_exponent": Prior(SAND.sinkage_exponent, 0.0)}


def setup_of(noise=SD, **options) -> Setup:
    return Setup(WHEEL, SoilPriors(**KNOWN), NoiseLevels(**(noise or {})), **options)


def table(folder, names: str, rows, seed: int | None = 0):
    """A table read back, with noise in the last three columns."""
    rows = np.array(rows, dtype=float)
    if seed is not None:
        rows[:, -3:] += np.random.default_rng(seed).normal(size=(len(rows), 3)) * list(SD.values())
    np.savetxt(folder / "data.csv", rows, delimiter=",", header=names, comments="", fmt="%.7g")
    return read_table(folder / "data.csv", WHEEL)


def found(estimate, name="friction_angle_deg"):
    return estimate.parameters[name].value


def within(estimate, sds: float = 3.0):
    """True if phi, K and S are within some standard deviations of the truth."""
    truth = dict(friction_angle_deg=SAND.friction_angle_deg, shear_modulus=SAND.shear_modulus,
                 sinkage_coefficient=SAND.sinkage_coefficient)  # fmt: skip
    half = sds / 1.96
    for name, value in truth.items():
        p = estimate.parameters[name]
        if not p.value - half * (p.value - p.low) <= value <= p.value + half * (p.high - p.value):
            return False
    return True


@pytest.mark.parametrize("seed", range(3))
def test_pull_and_torque_suffice(tmp_path, seed):
    rows = clean()
    whole = table_of(tmp_path, rows, np.random.default_rng(seed))
    bare = table_of(tmp_path, rows, np.random.default_rng(seed), leave_out=("sinkage",))
    e, full = identify_table(bare, setup_of()), identify_table(whole, setup_of())
    assert e.converged and within(e) and "sinkage" not in e.fits
    assert any("24 of 24 rows have no sinkage: it follows from the load" in w for w in e.warnings)
    assert e.reference_sinkage == pytest.approx(np.median(rows[:, 2]), rel=0.1)
    for name in ("friction_angle_deg", "sinkage_coefficient"):  # what was not measured is missed
        a, b = e.parameters[name], full.parameters[name]
        assert a.high - a.low > b.high - b.low


def test_one_force_needs_a_prior_of_the_stiffness(tmp_path):
    bare = table_of(tmp_path, clean(), leave_out=("sinkage", "torque"))
    with pytest.raises(ParameterError, match="no row has a sinkage, or both drawbar_pull and torque"):
        identify_table(bare, setup_of())
    setup = Setup(WHEEL, SoilPriors(**KNOWN, sinkage_coefficient=Prior(9e5, 1e5)), NoiseLevels(**SD))
    assert found(identify_table(bare, setup)) == pytest.approx(SAND.friction_angle_deg, rel=0.01)


GRADES = (-8.0, 0.0, 8.0, 15.0)


def on_grades(load=120.0):
    """Rows of a wheel with a vertical load on several grades: it presses less, and its weight acts along the slope."""
    out = []
    for grade in GRADES:
        b = math.radians(grade)
        for slip in SLIPS:
            z, pull, torque = steady(slip, load * math.cos(b))
            out.append((slip, load, grade, z, pull - load * math.sin(b), torque))
    return out


def test_a_vertical_load_is_resolved(tmp_path):
    t = table(tmp_path, "slip,load,grade_deg,sinkage,drawbar_pull,torque", on_grades())
    e = identify_table(t, setup_of(load="vertical"))
    assert within(e) and not any("grade" in w or "does not fit" in w for w in e.warnings)
    normal = identify_table(t, setup_of())
    assert normal.law_error > 1.5 * e.law_error and any("taken as level" in w for w in normal.warnings)


def test_free_climbing_tells_the_soil(tmp_path):
    """No pull is measured: the grade that a slip just climbs is the measurement."""
    rows = []
    for load in LOADS:
        for slip in (0.15, 0.25, 0.4, 0.55, 0.7):

            def left(b, slip=slip, load=load):
                return steady(slip, load * math.cos(b))[1] - load * math.sin(b)

            b = brentq(left, -0.5, 0.8, xtol=1e-8)
            z, _, torque = steady(slip, load * math.cos(b))
            rows.append((slip, load, math.degrees(b), z, 0.0, torque))
    names = "slip,load,grade_deg,sinkage,drawbar_pull,torque"
    t = table(tmp_path, names, rows, None)
    assert np.all(t.drawbar_pull == 0.0)
    e = identify_table(t, setup_of(load="vertical"))
    assert found(e) == pytest.approx(SAND.friction_angle_deg, rel=2e-3)
    assert found(e, "shear_modulus") == pytest.approx(SAND.shear_modulus, rel=1e-2)
    with pytest.raises(ParameterError, match="drawbar_pull = 0 on every grade, .*: expected load: vertical"):
        identify_table(t, setup_of())


def tilted(tilt_deg: float, loads=LOADS):
    """Rows of a rig whose axes the ground rises against by a tilt."""
    d, out = math.radians(tilt_deg), []
    for load in loads:
        for slip in SLIPS:
            z, pull, torque = steady(slip, load * math.cos(d))
            out.append((slip, load, z, pull - load * math.sin(d), torque))
    return out


@pytest.mark.parametrize("tilt", [-1.5, 2.0])
def test_a_tilt_is_fitted_with_the_soil(tmp_path, tilt):
    t = table(tmp_path, "slip,load,sinkage,drawbar_pull,torque", tilted(tilt))
    e = identify_table(t, setup_of(tilt_deg=Prior(0.0, 1.0)))
    p = e.parameters["tilt_deg"]
    assert p.low < tilt < p.high and p.high - p.low < 1.0 and p.unit == "deg" and within(e)
    assert "tilt of the rig" in e.free and e.covariance.shape == (4, 4)
    known = identify_table(t, setup_of(tilt_deg=Prior(tilt, 0.0)))
    assert known.parameters["tilt_deg"].known and within(known)
    level = identify_table(t, setup_of())
    assert level.law_error > 2.0 * e.law_error and "tilt_deg" not in level.parameters


def test_a_noisy_run_weighs_as_little_as_it_says(tmp_path):
    """Half of the rows 20 times as noisy: told so, the estimate is as good as from the other half, and fits."""
    rng, rows = np.random.default_rng(4), clean()
    sd = np.array(list(SD.values())) * np.where(np.arange(len(rows)) % 2, 20.0, 1.0)[:, None]
    values = rows[:, 2:] + sd * rng.normal(size=sd.shape)
    values[:, 0] = np.clip(values[:, 0], 1e-3, None)
    head = "slip,load,sinkage,drawbar_pull,torque"
    told = head + ",sinkage_sd,drawbar_pull_sd,torque_sd"
    np.savetxt(tmp_path / "told.csv", np.hstack([rows[:, :2], values, sd]), delimiter=",", header=told, comments="")
    t = read_table(tmp_path / "told.csv", WHEEL)
    e = identify_table(t, setup_of(None))
    assert within(e) and not any(fit.estimated for fit in e.fits.values()) and not e.warnings
    assert e.fits["torque"].noise == pytest.approx(np.median(sd[:, 2]))
    quiet = table_of(tmp_path, np.hstack([rows[:, :2], values])[::2])
    half = identify_table(quiet, setup_of())
    width = [p.high - p.low for p in (x.parameters["friction_angle_deg"] for x in (e, half))]
    assert width[0] == pytest.approx(width[1], rel=0.05)
