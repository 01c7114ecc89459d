"""Identification from measurement tables: soils recovered, calibrated intervals, what cannot be
known; its command.

The tables come from `tests.terramechanics.reference`, the independent implementation of Eqs.
(1)-(3).
"""

import json
import math
import re
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from soil_env._io.loading import ParameterError
from soil_env.cli import main
from soil_env.identification.table import identify_table
from soil_env.identification.table.calibration import EXACT
from soil_env.identification.table.fit import UNDETERMINED, _doubts
from soil_env.identification.table.priors import BROAD
from soil_env.identification.table.problem import TableProblem
from soil_env.identification.table.report import text_of
from soil_env.measurement.setup import (
    NoiseLevels,
    Prior,
    Setup,
    SetupWheel,
    SoilPriors,
    read_setup,
)
from soil_env.measurement.table import read_table
from soil_env.parameters import Soil, soils
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from tests.terramechanics import reference

WHEEL = SetupWheel(0.15, 0.12)
SAND = reference.Ground(31.0, 1500.0, 0.018, 9e5, 0.9)
CLAY = reference.Ground(20.0, 68950.0, 0.006, 1861609.0, 0.2)  # Wong: lean clay, 22 % moisture
SD = {"sinkage": 3e-4, "drawbar_pull": 0.7, "torque": 0.1}
SLIPS = tuple(np.round(np.linspace(0.05, 0.7, 8), 3))
LOADS = (60.0, 120.0, 240.0)
NAMES = reference.Ground._fields
COLUMNS = ("slip", "load", "sinkage", "drawbar_pull", "torque")
THREE = ("cohesion", "sinkage_exponent")  # known where phi, K and S are identified
EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "data"


def steady(slip, load, soil=SAND, wheel=WHEEL):
    """(sinkage, drawbar pull, torque) at a load normal to the ground."""
    return reference.steady(soil, slip, load, reference.Site(wheel.radius, wheel.width), {})[:3]


@cache
def clean(soil=SAND, slips=SLIPS, loads=LOADS, wheel=WHEEL):
    """Rows [N, 5] of slip, load, sinkage, drawbar pull, torque without noise."""
    return np.array(
        [(slip, load, *steady(slip, load, soil, wheel)) for load in loads for slip in slips]
    )


def table_of(folder, rows, rng=None, sd=SD, leave_out=(), columns=COLUMNS):
    """A table read back from a CSV file with `rows`, and noise in the last three columns."""
    rows = np.array(rows, dtype=float)
    if rng is not None:
        rows[:, -3:] += rng.normal(size=(len(rows), 3)) * list(sd.values())
    keep = [k for k, name in enumerate(columns) if name not in leave_out]
    header = ",".join(columns[k] for k in keep)
    np.savetxt(
        folder / "data.csv", rows[:, keep], delimiter=",", header=header, comments="", fmt="%.7g"
    )
    return read_table(folder / "data.csv", WHEEL)


def estimate(folder, rows, setup, rng=None, **given):
    """What is identified from `table_of` these rows."""
    return identify_table(table_of(folder, rows, rng, **given), setup)


def setup_of(known=(), noise=SD, soil=SAND, **priors):
    """A setup of a rig without errors in which some parameters are known, some have priors and the
    rest are left out.
    """
    known = {name: Prior(getattr(soil, name), 0.0) for name in known}
    priors = SoilPriors(**known, **priors)
    return Setup(WHEEL, priors, NoiseLevels(**(noise or {})), EXACT)


def predicted(soil, slips, loads):
    """Rows [N, 5] as `clean`, by the model itself for a `Soil`."""
    slip, load = (x.ravel() for x in np.meshgrid(slips, loads))
    found = WheelSoilModel(WHEEL, soil).predict({"slip": slip, "load": load})
    return np.column_stack([slip, load, *found[:3]])


def free_of(e):
    """{name: parameter} of those of the soil that were not known."""
    return {name: e.parameters[name] for name in NAMES if not e.parameters[name].known}


def inside(found):
    """How many of these estimates have an interval that holds the truth, by parameter."""
    hits = Counter()
    for e in found:
        hits.update({n: p.low <= getattr(SAND, n) <= p.high for n, p in free_of(e).items()})
    return hits


def write_example(path):
    """The synthetic table of examples/data."""
    rows = clean(slips=(0.05, 0.15, 0.25, 0.35, 0.5, 0.65)).copy()
    rows[:, 2:] += np.random.default_rng(0).normal(size=(len(rows), 3)) * list(SD.values())
    header = ",".join([*COLUMNS, "run"])
    form = "%g,%g,%.5f,%.2f,%.3f,synthetic"
    np.savetxt(path, rows, fmt=form, header=header, comments="")


@pytest.mark.parametrize("known", [THREE, ("cohesion",), ()], ids=["3", "4", "5"])
@pytest.mark.parametrize("soil", [SAND, CLAY], ids=["sand", "clay"])
def test_recovers_the_soil_without_noise(tmp_path, known, soil):
    loads = LOADS if soil is SAND else (2e3, 4e3, 8e3)
    noise = {"sinkage": 1e-5, "drawbar_pull": 0.01 * loads[0] / 60, "torque": 0.002 * loads[0] / 60}
    e = estimate(tmp_path, clean(soil, loads=loads), setup_of(known, noise, soil))
    assert e.converged
    for name, truth in zip(NAMES, soil, strict=True):
        assert e.parameters[name].value == pytest.approx(truth, rel=3e-3), name
        assert e.parameters[name].known == (name in known)
    z = e.reference_sinkage
    truth = soil.sinkage_coefficient * z**soil.sinkage_exponent
    assert e.parameters["reference_pressure"].value == pytest.approx(truth, rel=1e-3)


@pytest.mark.parametrize(
    ("known", "noise"),
    [
        (THREE, SD),
        ((), SD),
        ((), None),
    ],
)
def test_intervals_cover_the_truth(tmp_path, known, noise):
    """95 % intervals: fewer than 24 hits of 30 has a probability below 1e-3 a parameter if they are
    calibrated.

    The laws of these tables are exact, which the intervals do not know: they are up to four times
    as wide as needed, most of all that of the angle, which an error of the shear stress that is the
    same everywhere changes unseen. Noise that is left out is estimated, without bias.
    """
    rng = np.random.default_rng(5)
    setup = setup_of(known, noise)
    found = [estimate(tmp_path, clean(), setup, rng) for _ in range(30)]
    assert all(e.converged and not e.warnings for e in found)
    hits = inside(found)
    assert set(hits) == {*NAMES} - {*known} and min(hits.values()) >= 24, hits
    # off by how many standard deviations: an interval is 3.92 of them wide
    values = [
        [(p.value - getattr(SAND, n)) / (p.high - p.low) * 3.92 for n, p in free_of(e).items()]
        for e in found
    ]
    spread = np.std(values, axis=0)
    assert np.all((0.25 < spread) & (spread < 1.35)), spread
    assert np.all(np.abs(np.mean(values, axis=0)) < 0.6)
    noises = np.mean([[e.fits[name].noise for name in SD] for e in found], axis=0)
    assert noises == pytest.approx(list(SD.values()), rel=0.1)


@pytest.mark.parametrize(
    ("stretched", "smallest"),
    [(lambda slip: slip / 0.35, 0.03), (lambda slip: np.log1p(slip / 0.05), 0.02)],
)
def test_intervals_cover_the_truth_under_wrong_laws(tmp_path, stretched, smallest):
    """30 draws of smooth relative errors of 8 % in sinkage, pull and torque, eight to ten times the
    noise.
    """
    rng = np.random.default_rng(8)
    found = []
    for _ in range(30):
        rows = clean().copy()
        at = np.stack([stretched(rows[:, 0]), np.log(rows[:, 1])], axis=1)
        for k in (2, 3, 4):
            wave = np.cos(at @ rng.normal(size=2) + rng.uniform(0.0, 2.0 * np.pi))
            rows[:, k] += 0.08 * math.sqrt(2.0) * wave * np.abs(rows[:, k])
        found.append(estimate(tmp_path, rows, setup_of(THREE), rng))
    hits = inside(found)
    assert len(hits) == 3 and min(hits.values()) >= 27, hits
    phi = [e.parameters["friction_angle_deg"].value for e in found]
    # deg; 3.7 with errors of the stresses alone
    assert np.sqrt(np.mean(np.square(np.subtract(phi, SAND.friction_angle_deg)))) < 2.0
    sizes = [e.law_error for e in found]
    assert smallest < min(sizes) and max(sizes) < 0.3 and 0.05 < np.median(sizes) < 0.11, sizes


def test_errors_are_shared_out_among_their_sources(tmp_path):
    """Their expected squares are those of draws, at the true unknowns: slip and load take a part of
    what a channel is off.
    """
    noise = SD | {"slip": 0.02, "load": 2.0}
    problem = TableProblem(table_of(tmp_path, clean()), setup_of(THREE, noise))
    u = np.zeros(len(problem.unknowns))
    problem.weigh(problem.by_conditions(u))
    true = problem.predict(u)
    rng = np.random.default_rng(0)
    squares = np.zeros((len(true), 5))
    for _ in range(400):
        drawn = rng.normal(size=squares.shape) * np.sqrt(problem.variances)
        problem.y = true + np.einsum("kcj,kj->kc", problem.F, drawn[:, :2]) + drawn[:, 2:]
        squares += problem.errors(u)[0] ** 2 / 400.0
    shared = problem.errors(u)[1]
    assert np.all(np.median(shared / problem.variances, axis=0)[[0, 3, 4]] < 0.9)
    assert np.mean(squares / shared, axis=0) == pytest.approx(np.ones(5), abs=0.06)


@pytest.mark.parametrize("shared", [False, True])
def test_intervals_cover_the_truth_where_slip_and_load_scatter(tmp_path, shared):
    """Scatter that the setup knows is not taken for errors of the laws, nor for a mistake, be it of
    each row or of each quarter of the table.
    """
    rng = np.random.default_rng(11)
    setup = setup_of(("cohesion",), SD | {"slip": 0.02, "load": 4.0})
    soil = Soil(*SAND[:3], SAND.sinkage_exponent, sinkage_coefficient=SAND.sinkage_coefficient)
    found = []
    for _ in range(2):
        slip = rng.uniform(0.05, 0.65, 60)
        load = rng.uniform(80.0, 200.0, 60)
        errors = rng.normal(size=(4 if shared else 60, 2))
        off = np.repeat(errors, 15 if shared else 1, axis=0) * (0.02, 4.0)
        true = {"slip": slip + off[:, 0], "load": load + off[:, 1]}
        rows = np.column_stack([slip, load, *WheelSoilModel(WHEEL, soil).predict(true)[:3]])
        e = estimate(tmp_path, rows, setup, rng)
        assert not e.check_first and len(e.row) == 60
        assert shared or not e.misfit  # four draws may be large together
        assert e.law_error < 0.06
        k = e.parameters["shear_modulus"]
        assert k.high / k.low < 2.0 and abs(math.log(k.value / SAND.shear_modulus)) < 0.2
        found.append(e)
    assert min(inside(found).values()) >= 1


def test_errors_of_the_stresses_are_not_taken_for_errors_of_the_channels(tmp_path):
    """15 draws of errors of 8 % in the stresses: intervals hold, and the size is found."""
    rng = np.random.default_rng(9)
    found = []
    setup = setup_of(THREE)
    problem = TableProblem(table_of(tmp_path, clean()), setup)
    u = np.array([k.at(getattr(SAND, k.name)) for k in problem.unknowns])
    problem.weigh(problem.by_conditions(u))
    stresses = problem.law_errors(u, 0)[0]
    for _ in range(15):
        rows = clean().copy()
        errors = stresses @ (0.08 * rng.normal(size=stresses.shape[1]))
        rows[:, 2:] += errors.reshape(-1, 3) * list(SD.values())
        rows[:, 2] = np.maximum(rows[:, 2], 0.3 * clean()[:, 2])
        found.append(estimate(tmp_path, rows, setup, rng))
    assert inside(found).total() >= 38  # of 45
    assert 0.06 < np.median([e.law_error for e in found]) < 0.1


def test_large_errors_of_sinkage_do_not_bias(tmp_path):
    """Errors in variables: at 10 % noise of the sinkage the mean of 40 estimates is within half an
    sd.
    """
    sd = {"sinkage": 1.5e-3, "drawbar_pull": 2.0, "torque": 0.3}
    rng = np.random.default_rng(6)
    setup = setup_of(THREE, sd)
    found = [estimate(tmp_path, clean(), setup, rng, sd=sd).parameters for _ in range(40)]
    for name in ("friction_angle_deg", "shear_modulus", "sinkage_coefficient"):
        values = [p[name].value for p in found]
        assert abs(np.mean(values) - getattr(SAND, name)) < 0.5 * np.std(values), name


def test_wheels_of_two_widths_share_k_c_and_k_phi(tmp_path):
    k_c = 2e4
    k_phi = 7e5
    parts = []
    for wheel in (WHEEL, SetupWheel(0.15, 0.2)):
        soil = SAND._replace(sinkage_coefficient=k_c / wheel.width + k_phi)
        rows = clean(soil, slips=(0.1, 0.3, 0.5), loads=(80.0, 160.0), wheel=wheel)
        parts.append(np.insert(rows, 2, wheel.width, axis=1))
    columns = ("slip", "load", "wheel_width", *COLUMNS[2:])
    priors = {"k_c": Prior(k_c, 0.0), "k_phi": Prior(k_phi, 2e5)}
    table = table_of(tmp_path, np.concatenate(parts), columns=columns)
    e = identify_table(table, setup_of(THREE, **priors))
    # The soil that is found has them as well, so that its model predicts both wheels.
    model = WheelSoilModel(ModelWheel.of(WHEEL), e.soil)
    assert model.predict(table).sinkage == pytest.approx(table.sinkage, rel=1e-2)
    assert e.parameters["sinkage_coefficient"].value == pytest.approx(k_c / 0.12 + k_phi, rel=5e-3)
    assert e.parameters["friction_angle_deg"].value == pytest.approx(31.0, rel=5e-3)


def test_a_warning_of_s_is_not_of_the_stiffness_that_the_data_determine(tmp_path):
    """S follows its prior through n, while the data determine S z^n."""
    n = Prior(SAND.sinkage_exponent, 0.05)
    S = Prior(SAND.sinkage_coefficient, 0.12 * SAND.sinkage_coefficient)
    setup = setup_of((), sinkage_exponent=n, sinkage_coefficient=S)
    e = estimate(tmp_path, clean()[:8], setup, np.random.default_rng(1))
    assert e.parameters["sinkage_coefficient"].sd_over_prior > UNDETERMINED
    assert e.parameters["reference_pressure"].sd_over_prior < 0.5
    words = " ".join(e.warnings)
    assert "do not determine the sinkage coefficient S" in words
    assert "determine the stiffness" not in words


def test_names_what_the_data_cannot_tell(tmp_path):
    """One load and no torque: cohesion and friction look alike, and a prior stays what it was."""
    setup = setup_of((), sinkage_exponent=Prior(0.9, 0.02))
    e = estimate(tmp_path, clean()[:8], setup, np.random.default_rng(1), leave_out=("torque",))
    words = " ".join(e.warnings)
    assert "do not determine the sinkage exponent" in words
    assert (
        "friction angle and cohesion together" in words
        or "do not determine the friction angle" in words
    )
    # An end of an interval that is no result of the data is marked where it stands.
    cohesion = e.parameters["cohesion"]
    assert cohesion.low == 0.0 and cohesion.at_bound == ("low",)
    assert re.search(r"cohesion c +\S+ +0 \(bound\) \.\. [\d.e+]+ ", text_of(e))
    p = e.parameters["sinkage_exponent"]
    assert p.at_bound == ()
    assert p.sd_over_prior > 0.7 and p.high - p.low == pytest.approx(2 * 1.96 * 0.02, rel=0.3)
    assert e.condition > estimate(tmp_path, clean(), setup_of()).condition


def test_says_what_was_not_measured(tmp_path):
    """And the estimate is no surer than with it."""
    rng = np.random.default_rng(2)
    table = table_of(tmp_path, clean(), rng)
    e = identify_table(table, setup_of(THREE))
    less = identify_table(replace(table, torque=np.full(len(table), np.nan)), setup_of(THREE))
    assert any(w.startswith("Not measured: torque.") for w in less.warnings) and not e.warnings
    wide = [
        less.parameters[n].sd_over_prior / e.parameters[n].sd_over_prior
        for n in NAMES
        if n not in THREE
    ]
    assert min(wide) > 0.95


@pytest.mark.parametrize(("column", "noise"), [(2, SD), (2, None), (3, SD)])
def test_says_that_the_model_does_not_fit(tmp_path, column, noise):
    """By residuals that are larger than their noise, not those under the form error, which takes a
    part of the misfit of the pull away from the sinkage.
    """
    rows = clean().copy()
    rows[:, column] *= 1.0 + 0.8 * rows[:, 0]  # as by an effect that the base model lacks
    e = estimate(tmp_path, rows, setup_of(THREE, noise))
    sizes = re.findall(r"([\d.]+) times the noise of", e.misfit)
    assert "does not fit" in e.misfit and "noise of sinkage" in e.misfit and e.converged
    assert noise is None or (len(sizes) == 3 and min(map(float, sizes)) > 1.0)
    assert text_of(e).index("soil-env discover") < text_of(e).index("95 % interval")


def test_a_prior_that_the_table_contradicts_is_said_first(tmp_path):
    """The model fits the rows alone, not with the prior: the soil lies between the two. That of
    another gravity is such a prior.
    """
    for times, there in ((1.0, False), (6.0, True)):
        S = SAND.sinkage_coefficient * times
        setup = setup_of(("cohesion",), sinkage_coefficient=Prior(S, 0.1 * S))
        e = estimate(tmp_path, clean(), setup)
        assert not e.misfit
        assert any("standard deviations from its prior" in w for w in e.check_first) == there


def test_says_that_the_soil_of_a_misfit_is_not_to_be_simulated(tmp_path):
    """Fitted with an allowance for errors of the laws, it can miss the rows by far more than the
    fit with exact laws.
    """
    rows = clean().copy()
    rows[:, 3] = rows[:, 4] / WHEEL.radius  # nothing holds the wheel back
    e = estimate(tmp_path, rows, setup_of(THREE))
    assert "Do not simulate with this soil" in e.misfit


@pytest.mark.parametrize(
    ("leave_out", "rows", "setup", "words"),
    [
        (
            ("sinkage", "torque"),
            slice(None),
            setup_of(),
            "no row has a sinkage, or both drawbar_pull and torque",
        ),
        ((), slice(None), setup_of(NAMES), "setup: soil: every parameter is known"),
        (
            ("torque",),
            slice(0, 2),
            setup_of(("cohesion",), None),
            "4 parameters .*sinkage noise .* at least 6",
        ),
    ],
)
def test_refuses_what_it_cannot_identify(tmp_path, leave_out, rows, setup, words):
    with pytest.raises(ParameterError, match=words):
        estimate(tmp_path, clean()[rows], setup, leave_out=leave_out)


@pytest.mark.parametrize("check", [True, False], ids=["examined", "as it is"])
def test_a_refusal_names_the_file_of_the_setup(tmp_path, check):
    known = "".join(f"  {name}: {value:g}\n" for name, value in zip(NAMES, SAND, strict=True))
    path = tmp_path / "rig.yaml"
    path.write_text(f"wheel: {{radius: 0.15, width: 0.12}}\nsoil:\n{known}")
    with pytest.raises(ParameterError, match=r"rig\.yaml: soil: every parameter is known"):
        identify_table(table_of(tmp_path, clean()), read_setup(path), check=check)


def test_a_very_wide_prior_says_no_more_than_the_admissible_range(tmp_path):
    table = table_of(tmp_path, clean(), np.random.default_rng(3))
    wide = [
        identify_table(table, setup_of(THREE, friction_angle_deg=Prior(30.0, sd)))
        for sd in (1e12, 1e300)
    ]
    usual = identify_table(table, setup_of(THREE))
    for e in wide:
        angle, expected = (x.parameters["friction_angle_deg"].value for x in (e, usual))
        assert e.converged and e.warnings == () and angle == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("leave_out", [(), ("torque",)])
def test_intervals_stay_within_what_a_soil_can_be(tmp_path, leave_out):
    """Four rows of one load, five unknowns and their noise: Student's t would reach beyond every
    bound.
    """
    setup = setup_of(THREE if leave_out else (), None)
    e = estimate(tmp_path, clean()[:4], setup, np.random.default_rng(0), leave_out=leave_out)
    for name, unknown in BROAD.items():
        p = e.parameters[name]
        low, high = (math.exp(x) if unknown.log else x for x in (unknown.low, unknown.high))
        assert p.known or low * (1.0 - 1e-9) <= p.low <= p.value <= p.high <= high * (1.0 + 1e-9), (
            name
        )
    angle = e.parameters["friction_angle_deg"]
    assert leave_out or (angle.low, angle.high) == pytest.approx((2.0, 65.0))
    assert not leave_out or any("degrees of freedom" in w for w in e.warnings)


def test_a_solution_close_to_a_bound_is_said_to_be_at_it(tmp_path):
    """The search may stop a little before a bound."""
    problem = TableProblem(table_of(tmp_path, clean()), setup_of())
    for off, said in ((1e-4, True), (0.1, False)):
        u = np.zeros(len(problem.unknowns))
        u[0] = problem.unknowns[0].at(BROAD["friction_angle_deg"].high - off)
        words = " ".join(_doubts(problem, u, [], True, False))
        assert ("At the end of its admissible range: friction angle" in words) == said


def test_digging_that_the_setup_knows_is_taken_out(tmp_path):
    """Lyasko (2010): under the same load the sinkage grows by (1 + i)/(1 - 0.5 i), so S falls by it
    to the n.
    """
    rows = []
    for slip in (0.1, 0.25, 0.4, 0.55):
        softer = ((1.0 + slip) / (1.0 - 0.5 * slip)) ** -SAND.sinkage_exponent
        soil = SAND._replace(sinkage_coefficient=SAND.sinkage_coefficient * softer)
        rows += clean(soil, slips=(slip,), loads=(60.0, 120.0)).tolist()
    table = table_of(tmp_path, rows)
    e = identify_table(table, setup_of(THREE, dig_gain=Prior(1.5, 0.0)))
    assert not any("does not fit" in w for w in e.warnings)
    for name in ("friction_angle_deg", "shear_modulus", "sinkage_coefficient"):
        assert e.parameters[name].value == pytest.approx(getattr(SAND, name), rel=3e-3), name
    assert any("does not fit" in w for w in identify_table(table, setup_of(THREE)).warnings)


def test_a_given_shear_law_is_that_of_the_soil(tmp_path):
    """Rows of soil that flows along the rim are fitted with its constants, which a soil keeps."""
    law = {"rim_flow": 0.1, "braked_peak": 0.5, "shear_growth": 1.0, "shear_length": 0.06}
    truth = Soil(31.0, 1500.0, 0.018, 0.9, sinkage_coefficient=9e5, **law)
    rows = predicted(truth, (-0.3, -0.1, 0.1, 0.3, 0.5), (60.0, 120.0))
    given = {name: Prior(value, 0.0) for name, value in law.items()}
    e = estimate(tmp_path, rows, setup_of(THREE, **given))
    found = (e.soil.friction_angle_deg, e.soil.shear_modulus)
    assert found == pytest.approx((31.0, 0.018), rel=3e-3)
    assert {name: getattr(e.soil, name) for name in law} == law
    with pytest.raises(ParameterError, match="rim_flow: expected a plain number"):
        setup_of(THREE, rim_flow=Prior(0.1, 0.02))


def test_a_soil_that_flows_has_a_smaller_modulus_by_equation_10(tmp_path):
    """By a quarter to a third for driving rows, as docs/guide/tables.md says."""
    sand = soils()["dry_sand"]
    still = replace(sand, dig_gain=0.0)
    rows = predicted(still, (0.05, 0.1, 0.2, 0.35, 0.5, 0.7), (60.0, 100.0, 160.0))
    found = estimate(tmp_path, rows, setup_of(THREE)).soil.shear_modulus
    assert found / sand.shear_modulus == pytest.approx(0.71, abs=0.06)


def test_intervals_from_few_points_at_one_load(tmp_path):
    """Two channels of unknown noise, four points: 95 % intervals; fewer than 24 of 30 has
    probability 5e-4.
    """
    rng = np.random.default_rng(9)
    setup = setup_of(THREE, None)
    four = clean(slips=(0.05, 0.267, 0.483, 0.7), loads=(120.0,))
    found = [estimate(tmp_path, four, setup, rng) for _ in range(30)]
    assert all(e.converged for e in found)
    hits = inside(found)
    assert min(hits["friction_angle_deg"], hits["shear_modulus"]) >= 24, hits


def test_a_check_that_nothing_has_is_refused_as_by_discover(tmp_path, capsys):
    setup = tmp_path / "setup.yaml"
    setup.write_text((EXAMPLE / "setup.yaml").read_text() + "checked: [tiltt]\n")
    for command in ("identify", "discover"):
        arguments = [command, str(EXAMPLE / "single_wheel.csv"), "--setup", str(setup)]
        assert main([*arguments, "--out", str(tmp_path / command)]) == 2
        said = capsys.readouterr().err.splitlines()[-1]
        assert "checked: unknown value 'tiltt'; did you mean 'tilt'?" in said


def test_command(tmp_path, capsys):
    arguments = [
        "identify",
        str(EXAMPLE / "single_wheel.csv"),
        "--setup",
        str(EXAMPLE / "setup.yaml"),
    ]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    for word in (
        "friction angle",
        "95 % interval",
        "Correlation",
        "drawbar pull",
        "identification.png",
    ):
        assert word in said.out
    assert "\x1b" not in said.out and said.err == ""
    report = json.loads((tmp_path / "out" / "identification.json").read_text())
    assert set(report["parameters"]) == {*NAMES, "reference_pressure"} and len(report["slip"]) == 18
    assert 0.0 < report["parameters"]["friction_angle_deg"]["sd_over_prior"] < 1.0
    assert (tmp_path / "out" / "identification.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert len(list((tmp_path / "out").glob("identification.*"))) == 2
