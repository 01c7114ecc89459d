"""Calibration and search: what is named, what is not, and the likelihood by which it is judged."""

import dataclasses

import numpy as np
import pytest

from soil_env.discrepancy import run
from soil_env.discrepancy.calibrate import Choice, Problem, calibrate
from soil_env.discrepancy.data import folds, prepare
from soil_env.discrepancy.noise import NoiseEstimate
from soil_env.discrepancy.search import candidates, held_out, lack_of_fit, search
from soil_env.measurement.table import read_setup, read_table
from tests.discrepancy.files import SETUP, write_files
from tests.discrepancy.tables import problem, table

SMALL = SETUP.split("noise:")[0].replace("grouser_height: 0.01", "grouser_height: 0")
NOISE = "noise:" + SETUP.split("noise:")[1]


def planted(effects, seed=0):
    """A noisy table of 80 rows in which all conditions vary."""
    data = table(effects, (0.05, 0.15, 0.3, 0.45, 0.6), (100.0, 200.0), (0.03, 0.2), (1, 2), (-6.0, 6.0))
    return problem(data, np.random.default_rng(seed))


@pytest.mark.parametrize(
    "effects",
    [
        {"slip_sinkage": {"gain": 0.6}},
        {"bulldozing": {"rankine": 1.0}},
        {"multipass": {"hardening": 0.2}},
        {"drivetrain_friction": {"constant": 1.0}},
        {"grade": {"share": 1.0}},
    ],
)
def test_a_planted_effect_is_named(effects):
    finding = search(planted(effects))
    assert [n.name for n in finding.named] == list(effects)


def test_two_planted_effects_are_named():
    effects = {"slip_sinkage": {"gain": 0.6}, "drivetrain_friction": {"constant": 1.0}}
    finding = search(planted(effects))
    assert sorted(n.name for n in finding.named) == sorted(effects)


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_named_where_nothing_is_missing(seed):
    finding = search(planted({}, seed))
    assert finding.verdict == "none" and finding.named == () and finding.best is finding.base


def test_a_fit_covers_the_true_soil():
    """Every unknown within four standard deviations of the truth, as its own covariance has them."""
    fit = planted({}).fit()
    true = {"friction_angle_deg": 31.0, "cohesion": 3500.0, "shear_modulus": 0.028, "sinkage_coefficient": 740000.0,
            "sinkage_exponent": 0.64}  # fmt: skip
    a, _ = fit.linearised()
    sd = np.sqrt(np.diag(np.linalg.inv(a.T @ a)))
    off = np.array([u - k.at(true[k.name]) for k, u in zip(fit.unknowns, fit.u, strict=True)])
    assert np.all(np.abs(off) < 4.0 * sd) and np.all(sd < 1.0)


def test_held_out_likelihood_is_that_of_the_predictive_normal():
    """The closed form against the covariance matrix of every fold, written out."""
    p = planted({"slip_sinkage": {"gain": 0.3}})
    fit = p.fit((Choice("slip_sinkage", 0),))
    a, e = fit.linearised()
    rows, total = np.nonzero(p.used)[0], 0.0
    j, r = a[: fit.residual.size], e[: fit.residual.size]
    ways = folds(p.data)
    for fold in (g for way in ways for g in way):
        out = fold[rows]
        keep = np.linalg.inv(a.T @ a - j[out].T @ j[out])
        left = r[out] + j[out] @ keep @ j[out].T @ r[out]
        s = np.eye(out.sum()) + j[out] @ keep @ j[out].T
        total += -0.5 * left @ np.linalg.solve(s, left) - 0.5 * np.linalg.slogdet(s)[1]
    assert held_out(p, fit) == pytest.approx(total / len(ways), abs=1e-6)


def test_lack_of_fit_is_rarely_small_by_chance():
    chances = [lack_of_fit(p, p.fit()) for p in (planted({}, s) for s in range(30))]
    assert np.mean(np.array(chances) < 0.1) < 0.3 and min(chances) > 1e-4


def test_what_the_table_cannot_show_is_untestable(tmp_path):
    text = "slip,load,sinkage,drawbar_pull\n" + "".join(
        f"{s},100,{0.007 - 0.0003 * k},{-8 + 6 * k}\n" for k, s in enumerate((0.05, 0.15, 0.25, 0.35, 0.45))
    )
    data, setup = write_files(tmp_path, text, SMALL + NOISE)
    p, _ = calibrate(prepare(read_table(data), read_setup(setup)))
    names, reasons = candidates(p)
    assert set(reasons) == {"grousers", "multipass", "penetration_rate", "shear_rate", "grade", "drivetrain_friction"}
    assert "speed" in reasons["penetration_rate"] and "torque" in reasons["drivetrain_friction"]
    assert not set(names) & set(reasons)


@pytest.mark.parametrize(
    "rows", ["0.1,80,0.02,1\n0.4,80,0.06,30\n", "0.1,80,0.02,1\n0.3,80,0.05,20\n0.5,80,0.002,-30\n"]
)
def test_a_few_rows_that_disagree_are_judged(tmp_path, rows):
    report = run(*write_files(tmp_path, "slip,load,sinkage,drawbar_pull\n" + rows, SMALL + NOISE), bootstrap=0)
    assert report.finding.verdict == "unlisted" and report.finding.named == ()
    assert report.finding.base.misfit < 1e-6 and report.where == ()


def test_an_outlier_is_left_out():
    clean = planted({"bulldozing": {"rankine": 0.7}})
    y = clean.data.y.copy()
    y[40, 1] += 20.0 * clean.noise[1]
    p, noise = calibrate(dataclasses.replace(clean.data, y=y))
    assert isinstance(noise, NoiseEstimate) and isinstance(p, Problem)
    assert not p.used[40, 1] and noise.outliers <= 2
    assert [n.name for n in search(p).named] == ["bulldozing"]
