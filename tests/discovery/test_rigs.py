"""Tables as rigs make them: two wheels in one table, noise of each row, slip by lug tips, rigs that
are not level.
"""

import itertools
import math

import numpy as np
import pytest

from soil_env.discovery import run
from soil_env.discovery.calibrate import calibrate
from soil_env.discovery.corrected import model_of
from soil_env.discovery.instrument import Choice
from soil_env.discovery.locate import boxes
from soil_env.discovery.next_tests import conditions
from soil_env.discovery.report.pictures import groups
from soil_env.identification.table.data import WHEEL, folds
from tests.discovery.files import (
    NOISE,
    PLANTED,
    SETUP,
    SLIPS,
    csv_text,
    data_of,
    problem_of,
    table_text,
    with_column,
    world,
    write_files,
)

LUGS = {"grousers": {"shear_share": 1.0}}


def two_wheels(seed=0) -> str:
    """A table of wheels without lugs and with lugs of 2 cm."""
    return table_text(LUGS, seed=seed, grouser_height=(0.0, 0.02))


@pytest.mark.parametrize("seed", range(4))
def test_no_clean_value_of_two_wheels_is_struck_out(tmp_path, seed):
    """Lugs make two curves over slip: neither is noise, nor outliers of the other."""
    for setup in (SETUP, SETUP.split("noise:")[0]):
        problem, noise = calibrate(data_of(tmp_path, two_wheels(seed=seed), setup))
        assert np.array_equal(noise.used, problem.data.measured)
        assert noise.sd == pytest.approx(list(NOISE.values()), rel=0.6)


def test_wheels_are_a_condition(tmp_path):
    data = data_of(tmp_path, two_wheels())
    assert list(data.varied) == ["slip", "load", "grouser_height"]
    assert [way.max() + 1 for way in folds(data)] == [6, 6]  # slips; loads with wheels
    assert data.cell.max() + 1 == 36
    problem = calibrate(data)[0]
    assert any(set(limit) == {"grouser_height"} for limit in boxes(problem)[0])
    grid = conditions(problem, ())
    wheels = np.unique(np.stack([grid.value[name] for name in WHEEL], axis=1), axis=0)
    assert (
        np.array_equal(wheels, np.unique(data.rows.wheels, axis=0))
        and "grouser_height" in grid.asked
    )


def test_the_noise_of_a_row_is_its_own(tmp_path):
    """One run ten times as noisy as the others: said so, its values weigh a hundredth and are no
    outliers.
    """
    rng = np.random.default_rng(3)

    def noisy(row):
        return row["load"] == 100.0 and row["grouser_height"] > 0.0

    text = with_column(two_wheels(), "torque_sd", lambda row: 1.0 if noisy(row) else 0.1)
    text = with_column(text, "torque", lambda row: row["torque"] + noisy(row) * rng.normal())
    data = data_of(tmp_path, text, SETUP.replace(", torque: 0.1", ""))
    problem, noise = calibrate(data)
    assert noise.used.all() and noise.sd[2] == 0.1 and data.relative_sd[8, 2] == 10.0
    whitened = np.full(problem.used.shape, np.nan)
    whitened[problem.used] = problem.whiten(np.ones_like(data.y))
    assert whitened[8, 2] == pytest.approx(1.0) and whitened[0, 2] == pytest.approx(10.0)


def hilly() -> str:
    """A table with noise of the base model: vertical load and pull of a rig, resolved by hand on
    the grade.
    """
    rng = np.random.default_rng(0)
    rows = []
    for load, grade in itertools.product((100.0, 200.0), (-8.0, 0.0, 8.0)):
        b = math.radians(grade)
        values = np.stack(
            world({}).predict({"slip": SLIPS, "load": load * math.cos(b)})[:3], axis=1
        )
        values[:, 1] -= load * math.sin(b)
        values += rng.normal(size=values.shape) * list(NOISE.values())
        rows += [(i, load, grade, *v) for i, v in zip(SLIPS, values, strict=True)]
    return csv_text(("slip", "load", "grade_deg", *NOISE), rows)


def fitted(folder, text, more=""):
    """(rms of what the base model leaves, in noise; the problem; its fit)"""
    problem = problem_of(folder, text, SETUP + more)
    fit = problem.fit()
    return float(np.sqrt(np.mean(fit.residual**2))), problem, fit


def test_a_vertical_load_is_resolved_on_the_grade(tmp_path):
    """Geometry is no missing effect, and the written model contains it."""
    rms, problem, fit = fitted(tmp_path, hilly(), "load: vertical\n")
    assert rms < 1.2
    assert fitted(tmp_path, hilly())[0] > 5.0
    model = model_of(problem, fit.choices, fit.parameters())
    assert model.effects == {"grade": {"share": 1.0}}
    assert np.stack(model.predict(problem.data.table)[:3], axis=1) == pytest.approx(
        fit.output, rel=1e-5, abs=1e-6
    )


def test_the_model_of_a_vertical_load_has_a_share_of_the_weight_within_bounds(tmp_path):
    """A further share is fitted up to where the sum is still that of a model."""
    _, problem, fit = fitted(tmp_path, hilly(), "load: vertical\n")
    choices = (Choice("grade", 0),)
    (share,) = problem.unknowns(choices)[len(problem.soil) :]
    values = fit.parameters() | {share.name: share.high}
    assert model_of(problem, choices, values).effects["grade"]["share"] == 2.0


def test_a_report_of_two_wheels_on_a_rig_that_is_not_level(tmp_path):
    """The whole workflow: the lugs are named, a curve is drawn for each wheel, the tilt stands
    beside the soil.
    """
    tilted = with_column(
        two_wheels(),
        "drawbar_pull",
        lambda row: row["drawbar_pull"] - row["load"] * math.sin(math.radians(1.0)),
    )
    files = write_files(tmp_path, tilted, SETUP + "tilt_deg: {value: 0, sd: 1}\n")
    report = run(*files, leave_out=False)
    assert "grousers" in {e.name for e in report.effects}
    assert report.soil["tilt_deg"].low < 1.0 < report.soil["tilt_deg"].high
    assert {label.partition(", ")[2] for label, _ in groups(report)} == {
        "grouser height 0 m",
        "grouser height 0.02 m",
    }


def test_values_of_little_noise_are_no_outliers_of_a_surface_that_is_off(tmp_path):
    """Computed values with a missing effect: smooth, and a thousand times nearer to their law than
    any polynomial comes.
    """
    setup = SETUP.split("noise:")[0] + "noise: {sinkage: 1e-6, drawbar_pull: 1e-3, torque: 2e-4}\n"
    loads = (60.0, 100.0, 150.0, 220.0)
    text = table_text(PLANTED, loads, np.linspace(-0.3, 0.6, 14), noise=0.0)
    assert calibrate(data_of(tmp_path, text, setup))[1].used.all()
    # the pull of row 19, counted from 0; line 0 has the names
    wrong = text.replace(text.splitlines()[20].split(",")[3], "90")
    used = calibrate(data_of(tmp_path, wrong, setup))[1].used
    assert np.argwhere(~used).tolist() == [[19, 1]]
