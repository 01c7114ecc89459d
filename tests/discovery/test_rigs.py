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
from tests.discovery.files import NOISE, SETUP, SLIPS, data_of, world, write_files

LUGS = {"grousers": {"shear_share": 1.0}}


def two_wheels(
    sizes=((0.15, 0.0), (0.15, 0.02)), loads=(100, 150, 220), seed=0, tilt=0.0, **columns
) -> str:
    """A table with noise of wheels of (radius, grouser height), on the same soil at the same slips
    and loads.
    """
    rng = np.random.default_rng(seed)
    lines = []
    for radius, height in sizes:
        for load in loads:
            normal = load * math.cos(math.radians(tilt))
            along = load * math.sin(math.radians(tilt))
            at = {"slip": SLIPS, "load": normal, "wheel_radius": radius, "grouser_height": height}
            values = np.stack(world(LUGS).predict(at)[:3], axis=1) - [0.0, along, 0.0]
            values += rng.normal(size=values.shape) * list(NOISE.values())
            more = [str(x) for x in columns.values()]
            lines += [
                ",".join([*map(repr, (i, load, radius, height, *map(float, v))), *more])
                for i, v in zip(SLIPS, values, strict=True)
            ]
    names = (
        "slip",
        "load",
        "wheel_radius",
        "grouser_height",
        "sinkage",
        "drawbar_pull",
        "torque",
        *columns,
    )
    return "\n".join([",".join(names), *lines]) + "\n"


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
    lines = two_wheels(torque_sd=0.1).splitlines()
    for k in range(7, 13):
        cells = lines[k].split(",")
        cells[-2:] = [repr(float(cells[-2]) + rng.normal()), "1.0"]
        lines[k] = ",".join(cells)
    setup = SETUP.replace(", torque: 0.1", "")
    data = data_of(tmp_path, "\n".join(lines) + "\n", setup)
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
    lines = ["slip,load,grade_deg,sinkage,drawbar_pull,torque"]
    for load, grade in itertools.product((100.0, 200.0), (-8.0, 0.0, 8.0)):
        b = math.radians(grade)
        values = np.stack(
            world({}).predict({"slip": SLIPS, "load": load * math.cos(b)})[:3], axis=1
        )
        values[:, 1] -= load * math.sin(b)
        values += rng.normal(size=values.shape) * list(NOISE.values())
        lines += [
            ",".join(f"{x:.7g}" for x in (i, load, grade, *v))
            for i, v in zip(SLIPS, values, strict=True)
        ]
    return "\n".join(lines) + "\n"


def fitted(folder, text, more=""):
    """(rms of what the base model leaves, in noise; the problem; its fit)"""
    problem = calibrate(data_of(folder, text, SETUP + more))[0]
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
    report = run(
        *write_files(tmp_path, two_wheels(tilt=1.0), SETUP + "tilt_deg: {value: 0, sd: 1}\n")
    )
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
    slips = np.linspace(-0.3, 0.6, 14)
    lines = ["slip,load,sinkage,drawbar_pull,torque"]
    for load in (60.0, 100.0, 150.0, 220.0):
        found = world({"slip_sinkage": {"gain": 1.5}}).predict({"slip": slips, "load": load})
        rows = zip(slips, *found[:3], strict=True)
        lines += [",".join(f"{x:.9g}" for x in (i, load, *v)) for i, *v in rows]
    text = "\n".join(lines) + "\n"
    assert calibrate(data_of(tmp_path, text, setup))[1].used.all()
    wrong = text.replace(lines[20], lines[20].replace(lines[20].split(",")[3], "90"))
    used = calibrate(data_of(tmp_path, wrong, setup))[1].used
    assert np.argwhere(~used).tolist() == [[19, 1]]
