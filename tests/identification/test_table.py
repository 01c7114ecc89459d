"""Identification from measurement tables: soils recovered, calibrated intervals, what cannot be told.

The tables come from `tests.terramechanics.reference`, the independent implementation of Eqs. (1)-(3).
"""

import csv
import math
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import linregress, t

from soil_env._io.loading import ParameterError
from soil_env.identification.table import identify_table
from soil_env.identification.table.priors import BROAD
from soil_env.identification.table.problem import TableProblem
from soil_env.identification.table.unknown_noise import Scatter
from soil_env.measurement.setup import NoiseLevels, Prior, Setup, SetupWheel, SoilPriors
from soil_env.measurement.table import read_table
from tests.terramechanics import reference

WHEEL = SetupWheel(0.15, 0.12)
SAND = reference.Ground(31.0, 1500.0, 0.018, 9e5, 0.9)
CLAY = reference.Ground(20.0, 68950.0, 0.006, 1861609.0, 0.2)  # Wong: lean clay, 22 % moisture
SD = {"sinkage": 3e-4, "drawbar_pull": 0.7, "torque": 0.1}
SLIPS, LOADS = tuple(np.round(np.linspace(0.05, 0.7, 8), 3)), (60.0, 120.0, 240.0)
NAMES = ("friction_angle_deg", "cohesion", "shear_modulus", "sinkage_coefficient", "sinkage_exponent")  # as Ground
ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "data"


def steady(slip, load, soil=SAND, wheel=WHEEL):
    """(sinkage, drawbar pull, torque) at a load normal to the ground."""

    def at(z):
        return reference.forces(soil, slip, math.acos(1.0 - z / wheel.radius), wheel.radius, wheel.width)

    z = brentq(lambda z: at(z).load - load, 1e-6, 0.9 * wheel.radius, xtol=1e-10, rtol=1e-9)
    return z, at(z).drawbar_pull, at(z).torque


@cache
def clean(soil=SAND, slips=SLIPS, loads=LOADS, wheel=WHEEL):
    """Rows [N, 5] of slip, load, sinkage, drawbar pull, torque without noise."""
    rows = []
    for load in loads:
        for slip in slips:
            rows.append((slip, load, *steady(slip, load, soil, wheel)))
    return np.array(rows)


def table_of(folder, rows, rng=None, sd=SD, leave_out=()):
    """A table read back from a CSV file with `rows` and noise."""
    rows = rows.copy()
    if rng is not None:
        rows[:, 2:] += rng.normal(size=(len(rows), 3)) * [sd["sinkage"], sd["drawbar_pull"], sd["torque"]]
    names = ("slip", "load", "sinkage", "drawbar_pull", "torque")
    keep = [k for k, name in enumerate(names) if name not in leave_out]
    with (folder / "data.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow([names[k] for k in keep])
        writer.writerows([[f"{row[k]:.6g}" for k in keep] for row in rows])
    return read_table(folder / "data.csv", WHEEL)


def setup_of(known=(), noise=SD, soil=SAND, **priors):
    """A setup in which some parameters are known, some have priors and the rest are left out."""
    truth = dict(zip(NAMES, soil, strict=True))
    return Setup(WHEEL, SoilPriors(**{k: Prior(truth[k], 0.0) for k in known}, **priors), NoiseLevels(**(noise or {})))


def write_example(path):
    """The synthetic table of examples/data."""
    rows = clean(slips=(0.05, 0.15, 0.25, 0.35, 0.5, 0.65))
    rng = np.random.default_rng(0)
    noisy = rows[:, 2:] + rng.normal(size=(len(rows), 3)) * list(SD.values())
    with Path(path).open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["slip", "load", "sinkage", "drawbar_pull", "torque", "run"])
        for (slip, load, *_), (z, pull, torque) in zip(rows, noisy, strict=True):
            writer.writerow([f"{slip:g}", f"{load:g}", f"{z:.5f}", f"{pull:.2f}", f"{torque:.3f}", "synthetic"])


@pytest.mark.parametrize("known", [("cohesion", "sinkage_exponent"), ("cohesion",), ()], ids=["3", "4", "5"])
@pytest.mark.parametrize("soil", [SAND, CLAY], ids=["sand", "clay"])
def test_recovers_the_soil_without_noise(tmp_path, known, soil):
    loads = LOADS if soil is SAND else (2e3, 4e3, 8e3)
    noise = {"sinkage": 1e-5, "drawbar_pull": 0.01 * loads[0] / 60, "torque": 0.002 * loads[0] / 60}
    e = identify_table(table_of(tmp_path, clean(soil, loads=loads)), setup_of(known, noise, soil))
    assert e.converged
    for name, truth in zip(NAMES, soil, strict=True):
        assert e.parameters[name].value == pytest.approx(truth, rel=3e-3), name
        assert e.parameters[name].known == (name in known)
    z = e.reference_sinkage
    truth = soil.sinkage_coefficient * z**soil.sinkage_exponent
    assert e.parameters["reference_pressure"].value == pytest.approx(truth, rel=1e-3)


@pytest.mark.parametrize(
    "known, noise, draws, least",
    [(("cohesion", "sinkage_exponent"), SD, 60, 51), (("cohesion",), SD, 60, 51), ((), SD, 60, 51), ((), None, 30, 24)],
    ids=["3", "4", "5", "5, noise estimated"],
)
def test_intervals_cover_the_truth(tmp_path, known, noise, draws, least):
    """95 % intervals: fewer than `least` hits has a probability below 1e-3 a parameter if they are calibrated.

    The laws of these tables are exact, which the intervals do not know: they are up to four times as wide as needed,
    most of all that of the angle, which an error of the shear stress that is the same everywhere changes unseen.
    Noise that is left out is estimated, without bias.
    """
    rng, hits, scaled, noises = np.random.default_rng(5), {}, {}, []
    setup = setup_of(known, noise)
    for _ in range(draws):
        e = identify_table(table_of(tmp_path, clean(), rng), setup)
        assert e.converged and not e.warnings
        noises.append([e.fits[name].noise for name in SD])
        for name, truth in zip(NAMES, SAND, strict=True):
            p = e.parameters[name]
            if not p.known:
                hits[name] = hits.get(name, 0) + (p.low <= truth <= p.high)
                scaled.setdefault(name, []).append((p.value - truth) / (p.high - p.low) * 3.92)
    assert len(hits) == 5 - len(known)
    for name, count in hits.items():
        assert count >= least, (name, count)
        assert 0.25 < np.std(scaled[name]) < 1.35, name
        assert abs(np.mean(scaled[name])) < 0.6, name
    assert np.mean(noises, axis=0) == pytest.approx(list(SD.values()), rel=0.1)


@pytest.mark.parametrize(
    "stretched, smallest",
    [(lambda slip: slip / 0.35, 0.03), (lambda slip: np.log1p(slip / 0.05), 0.02)],
    ids=["with slip", "with its logarithm"],
)
def test_intervals_cover_the_truth_under_wrong_laws(tmp_path, stretched, smallest):
    """30 draws of smooth relative errors of 8 % in sinkage, pull and torque, eight to ten times the noise."""
    rng, hits, sizes, phi, setup = np.random.default_rng(8), {}, [], [], setup_of(("cohesion", "sinkage_exponent"))
    for _ in range(30):
        rows = clean().copy()
        at = np.stack([stretched(rows[:, 0]), np.log(rows[:, 1])], axis=1)
        for k in (2, 3, 4):
            wave = np.cos(at @ rng.normal(size=2) + rng.uniform(0.0, 2.0 * np.pi))
            rows[:, k] += 0.08 * math.sqrt(2.0) * wave * np.abs(rows[:, k])
        e = identify_table(table_of(tmp_path, rows, rng), setup)
        sizes.append(e.law_error)
        phi.append(e.parameters["friction_angle_deg"].value - SAND[NAMES.index("friction_angle_deg")])
        for name, truth in zip(NAMES, SAND, strict=True):
            p = e.parameters[name]
            if not p.known:
                hits[name] = hits.get(name, 0) + (p.low <= truth <= p.high)
    assert all(count >= 27 for count in hits.values()), hits
    assert np.sqrt(np.mean(np.square(phi))) < 2.0  # deg; 3.7 with errors of the stresses alone
    assert smallest < min(sizes) and max(sizes) < 0.3 and 0.05 < np.median(sizes) < 0.11, sizes


def test_errors_of_the_stresses_are_not_taken_for_errors_of_the_channels(tmp_path):
    """15 draws of errors of 8 % in the stresses: intervals hold, and the size is found."""
    rng, sizes, inside, setup = np.random.default_rng(9), [], 0, setup_of(("cohesion", "sinkage_exponent"))
    problem = TableProblem(table_of(tmp_path, clean()), setup)
    truth = dict(zip(NAMES, SAND, strict=True))
    u = np.array([k.at(truth[k.name]) for k in problem.unknowns])
    problem.weigh(problem.by_conditions(u))
    stresses = problem.law_errors(u, 0)[0]
    for _ in range(15):
        rows = clean().copy()
        errors = (stresses @ (0.08 * rng.normal(size=stresses.shape[1]))).reshape(-1, 3) * list(SD.values())
        rows[:, 2:] += errors
        rows[:, 2] = np.maximum(rows[:, 2], 0.3 * clean()[:, 2])
        e = identify_table(table_of(tmp_path, rows, rng), setup)
        sizes.append(e.law_error)
        inside += sum(e.parameters[k.name].low <= truth[k.name] <= e.parameters[k.name].high for k in problem.unknowns)
    assert inside >= 38  # of 45
    assert 0.06 < np.median(sizes) < 0.1, sizes


def test_large_errors_of_sinkage_do_not_bias(tmp_path):
    """Errors in variables: at 10 % noise of the sinkage the mean of 40 estimates is within half an sd."""
    sd = {"sinkage": 1.5e-3, "drawbar_pull": 2.0, "torque": 0.3}
    rng, setup = np.random.default_rng(6), setup_of(("cohesion", "sinkage_exponent"), sd)
    found = [identify_table(table_of(tmp_path, clean(), rng, sd), setup).parameters for _ in range(40)]
    for name, truth in zip(NAMES, SAND, strict=True):
        if not found[0][name].known:
            values = np.array([p[name].value for p in found])
            assert abs(np.mean(values) - truth) < 0.5 * np.std(values), name


def test_wheels_of_two_widths_share_k_c_and_k_phi(tmp_path):
    wide = SetupWheel(0.15, 0.2)
    k_c, k_phi = 2e4, 7e5
    parts = []
    for wheel in (WHEEL, wide):
        soil = SAND._replace(sinkage_coefficient=k_c / wheel.width + k_phi)
        rows = clean(soil, slips=(0.1, 0.3, 0.5), loads=(80.0, 160.0), wheel=wheel)
        parts.append(np.column_stack([rows, np.full(len(rows), wheel.width)]))
    path = tmp_path / "data.csv"
    header = "slip,load,sinkage,drawbar_pull,torque,wheel_width"
    np.savetxt(path, np.concatenate(parts), delimiter=",", header=header, comments="", fmt="%.7g")
    priors = {"k_c": Prior(k_c, 0.0), "k_phi": Prior(k_phi, 2e5)}
    e = identify_table(read_table(path), setup_of(("cohesion", "sinkage_exponent"), **priors))
    assert e.parameters["sinkage_coefficient"].value == pytest.approx(k_c / 0.12 + k_phi, rel=5e-3)
    assert e.parameters["friction_angle_deg"].value == pytest.approx(31.0, rel=5e-3)


def test_names_what_the_data_cannot_tell(tmp_path):
    """One load and no torque: cohesion cannot be told from friction, and a prior stays what it was."""
    rows = clean()[:8]
    table = table_of(tmp_path, rows, np.random.default_rng(1), leave_out=("torque",))
    e = identify_table(table, setup_of((), sinkage_exponent=Prior(0.9, 0.02)))
    words = " ".join(e.warnings)
    assert "do not determine the sinkage exponent" in words
    assert "friction angle and cohesion together" in words or "do not determine the friction angle" in words
    p = e.parameters["sinkage_exponent"]
    assert p.sd_over_prior > 0.7 and p.high - p.low == pytest.approx(2 * 1.96 * 0.02, rel=0.3)
    assert e.condition > identify_table(table_of(tmp_path, clean()), setup_of()).condition


def test_says_that_the_model_does_not_fit(tmp_path):
    rows = clean().copy()
    rows[:, 2] *= 1.0 + 0.8 * rows[:, 0]  # a slip-sinkage that the base model lacks
    e = identify_table(table_of(tmp_path, rows), setup_of(("cohesion", "sinkage_exponent")))
    assert any("does not fit the sinkage" in w for w in e.warnings) and e.converged
    e = identify_table(table_of(tmp_path, rows), setup_of(("cohesion", "sinkage_exponent"), None))
    assert any("follow slip and load" in w for w in e.warnings)


@pytest.mark.parametrize(
    "leave_out, rows, setup, words",
    [
        (("sinkage", "torque"), slice(None), setup_of(), "no row has a sinkage, or both drawbar_pull and torque"),
        ((), slice(None), setup_of(NAMES), "setup: soil: every parameter is known"),
        (("torque",), slice(0, 2), setup_of(("cohesion",), None), "4 parameters .*sinkage noise .* at least 6"),
    ],
)
def test_refuses_what_it_cannot_identify(tmp_path, leave_out, rows, setup, words):
    with pytest.raises(ParameterError, match=words):
        identify_table(table_of(tmp_path, clean()[rows], leave_out=leave_out), setup)


def test_a_very_wide_prior_tells_no_more_than_the_admissible_range(tmp_path):
    table, known = table_of(tmp_path, clean(), np.random.default_rng(3)), ("cohesion", "sinkage_exponent")
    wide = [identify_table(table, setup_of(known, friction_angle_deg=Prior(30.0, sd))) for sd in (1e12, 1e300)]
    usual = identify_table(table, setup_of(known))
    for e in wide:
        assert e.converged and e.warnings == ()
        assert e.parameters["friction_angle_deg"].value == pytest.approx(
            usual.parameters["friction_angle_deg"].value, abs=0.02
        )


def test_intervals_stay_within_what_a_soil_can_be(tmp_path):
    """Four rows of one load, five unknowns and their noise: Student's t would reach beyond every bound."""
    e = identify_table(table_of(tmp_path, clean()[:4], np.random.default_rng(0)), setup_of((), None))
    for name, (_, _, low, high, logarithmic) in BROAD.items():
        p = e.parameters[name]
        low, high = (math.exp(x) if logarithmic else x for x in (low, high))
        assert low * (1.0 - 1e-9) <= p.low <= p.value <= p.high <= high * (1.0 + 1e-9), name
    angle = e.parameters["friction_angle_deg"]
    assert (angle.low, angle.high) == pytest.approx((2.0, 65.0))


def test_digging_that_the_setup_knows_is_taken_out(tmp_path):
    """Lyasko (2010): under the same load the sinkage grows by (1 + i)/(1 - 0.5 i), so S falls by it to the n."""
    rows = []
    for slip in (0.1, 0.25, 0.4, 0.55):
        softer = ((1.0 + slip) / (1.0 - 0.5 * slip)) ** -SAND.sinkage_exponent
        soil = SAND._replace(sinkage_coefficient=SAND.sinkage_coefficient * softer)
        rows += clean(soil, slips=(slip,), loads=(60.0, 120.0)).tolist()
    table, known = table_of(tmp_path, np.array(rows)), ("cohesion", "sinkage_exponent")
    e = identify_table(table, setup_of(known, dig_gain=Prior(1.5, 0.0)))
    assert not any("does not fit" in w for w in e.warnings)
    for name in ("friction_angle_deg", "shear_modulus", "sinkage_coefficient"):
        assert e.parameters[name].value == pytest.approx(dict(zip(NAMES, SAND, strict=True))[name], rel=3e-3), name
    assert any("does not fit" in w for w in identify_table(table, setup_of(known)).warnings)


def line(x, y, sd):
    """Problem for `Scatter`: a straight line through one channel (the last), its noise not known.

    The unknowns have priors a thousand times wider than what the line tells of them.
    """
    count, wide = len(x), 1e3
    J = np.zeros((count, 3, 2))
    J[:, 2] = wide * np.stack([np.ones(count), x], axis=1)
    e = np.zeros((count, 3))
    e[:, 2] = y
    return SimpleNamespace(
        estimated=np.arange(5) == 4, F=np.zeros((count, 3, 2)), measured=np.tile([False, False, True], (count, 1)),
        noise=np.full(5, sd), floor=np.full(5, 1e-3 * sd), relative=np.ones((1, 3)),
        residual=lambda u: e, by_unknowns=lambda u: J,
    ), wide  # fmt: skip


@pytest.mark.parametrize("count", [4, 6, 12])
def test_intervals_from_one_channel_are_students(count):
    """With one channel and no prior, integrating its noise out gives the interval of linear regression."""
    x, rng = np.linspace(0.0, 1.0, count), np.random.default_rng(count)
    y = 1.0 + 2.0 * x + rng.normal(size=count)
    problem, wide = line(x, y, 1.0)
    low, high = Scatter(problem, np.zeros(2)).interval(np.array([0.0, wide]))
    found = linregress(x, y)
    half = t.ppf(0.975, count - 2) * found.stderr
    assert (low, high) == pytest.approx((found.slope - half, found.slope + half), abs=0.05 * half)


def test_intervals_from_few_points_at_one_load(tmp_path):
    """Two channels of unknown noise, four points: 95 % intervals; fewer than 51 of 60 has probability 5e-4."""
    rows, rng = clean(slips=(0.05, 0.267, 0.483, 0.7), loads=(120.0,)), np.random.default_rng(9)
    hits = {"friction_angle_deg": 0, "shear_modulus": 0}
    for _ in range(60):
        e = identify_table(table_of(tmp_path, rows, rng), setup_of(("cohesion", "sinkage_exponent"), None))
        assert e.converged
        for name in hits:
            p = e.parameters[name]
            hits[name] += p.low <= dict(zip(NAMES, SAND, strict=True))[name] <= p.high
    assert min(hits.values()) >= 51, hits


def test_intervals_from_four_drawbar_pulls_are_finite(tmp_path):
    """Four slips, no torque, 20 draws: the sampling of the noise stays within its box, and intervals are finite."""
    rows, rng = clean(slips=(0.05, 0.267, 0.483, 0.7), loads=(120.0,)), np.random.default_rng(10)
    for _ in range(20):
        table = table_of(tmp_path, rows, rng, leave_out=("torque",))
        e = identify_table(table, setup_of(("cohesion", "sinkage_exponent"), None))
        assert all(0.0 < p.low <= p.value <= p.high < math.inf for p in e.parameters.values())
        assert any("degrees of freedom" in w for w in e.warnings)
