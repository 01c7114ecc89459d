"""The model that is simulated: what it predicts, its table, what of the rig is not in it, and a
drive in its world.
"""

import dataclasses
import math

import numpy as np
import pytest

from soil_env.discovery.corrected import MOST, corrected, least_sure, model_of
from soil_env.discovery.prediction import fit_prediction
from soil_env.parameters import Noise
from tests.discovery.files import (
    LOADS,
    NOISE,
    PLANTED,
    SETUP,
    changed,
    problem_of,
    table_text,
    with_column,
)
from tests.simulation import wheels


@pytest.fixture(scope="module")
def prediction(tmp_path_factory):
    text = changed(table_text(PLANTED, loads=LOADS), "drawbar_pull", lambda x: x + 6.0)
    return fit_prediction(problem_of(tmp_path_factory.mktemp("table"), text))


@pytest.fixture(scope="module")
def model(prediction):
    return corrected(prediction)


def test_the_model_predicts_what_the_prediction_does(prediction, model):
    rng = np.random.default_rng(0)
    at = {"slip": rng.uniform(0.06, 0.6, 60), "load": rng.uniform(50.0, 350.0, 60)}
    known = prediction.at(at)
    found = dataclasses.replace(model, validity={}).predict(at)
    off = (np.stack(found[:3], axis=1) - known.mean) / list(NOISE.values())
    assert np.sqrt(np.mean(off**2)) < 0.1 and np.abs(off).max() < 0.5
    assert found.sd == pytest.approx(known.sd, rel=0.15)
    assert math.prod(map(len, model.remainder.axes.values())) <= MOST
    assert "slip_sinkage" in model.effects
    assert not {"slip_bias", "sinkage_offset", "force_offset"} & set(model.effects)


def test_an_error_of_the_rig_that_is_named_is_not_in_the_model(prediction, model):
    at = {"slip": np.array([0.1, 0.4]), "load": 120.0}
    names = ("force_offset", "slip_bias")
    without = corrected(prediction, names)
    offset = prediction.values["force_offset_offset"]
    assert abs(offset) > 1.0 and "slip_bias" in without.effects
    level = ("tilt_deg",)
    means = (prediction.at(at, left).mean[:, 1] for left in (level, ("force_offset", *level)))
    assert np.subtract(*means) == pytest.approx(offset)
    change = model.predict(at).drawbar_pull - without.predict(at).drawbar_pull
    assert change == pytest.approx(offset, abs=0.15)  # between the nodes of two tables


def test_lugs_of_the_rows_are_those_of_the_model(tmp_path):
    """Where the setup does not give their height."""
    text = with_column(table_text({}), "grouser_height", lambda row: 0.02)
    p = problem_of(tmp_path, text, SETUP.replace(", grouser_height: 0.01", ""))
    assert p.data.wheel.grouser_height == 0.02 and not p.data.lugs_unknown
    assert model_of(p, (), p.fit(()).parameters()).wheel.grouser_height == 0.02


def test_the_least_sure_conditions_are_beyond_the_table(prediction):
    guess = least_sure(prediction)
    # half the least and twice the largest load of the table
    assert guess.conditions["load"] in (pytest.approx(40.0), pytest.approx(360.0))
    assert guess.times > 1.5
    there = prediction.at({name: np.array([x]) for name, x in guess.conditions.items()})
    assert there.sd[0] == pytest.approx(guess.sd)


def test_a_guess_tells_the_wheel_where_the_table_has_several(tmp_path, prediction):
    """It is that of the setup, and loads of another wheel are no loads of its own."""
    assert "wheel_radius" not in least_sure(prediction).conditions
    problem = problem_of(tmp_path, table_text({}, LOADS, wheel_radius=(0.12, 0.2)))
    there = least_sure(fit_prediction(problem)).conditions
    assert there["wheel_radius"] == 0.15 and "wheel_width" not in there


def test_a_model_has_the_stiffness_of_each_width_that_the_fit_has(tmp_path):
    moduli = "k_c: {value: 2e4, sd: 1e4}\n  k_phi: {value: 6e5, sd: 8e4}"
    setup = SETUP.replace("sinkage_coefficient: {value: 770000, sd: 88000}", moduli)
    text = table_text({}, LOADS, wheel_width=(0.08, 0.16))
    problem = problem_of(tmp_path, text, setup)
    fit = problem.fit(())
    found = model_of(problem, (), fit.parameters()).predict(problem.data.table)
    assert np.stack(found[:3], axis=1) == pytest.approx(fit.output, rel=1e-4, abs=1e-4)


@pytest.mark.filterwarnings("ignore::soil_env.terramechanics.validity.OutsideValidity")
def test_a_drive_in_the_world_of_the_model_is_as_it_predicts(model):
    still = {
        "course": {"length": 40.0},
        "noise": {f.name: 0.0 for f in dataclasses.fields(Noise)},
        "wheel": {"radius": model.wheel.radius, "width": model.wheel.width},
    }
    soil = model.soil.state(model.wheel.width)
    drive = wheels.on_uniform_ground(soil, 0.0, "wheel_speed", model, **still)
    drive.drive([0.35] * 250)
    w = drive.now()
    weight = w.mass * drive.rig.gravity
    at = {"slip": w.slip, "load": weight}
    stated = np.concatenate(model.predict(at)[:3])
    sunk = drive.simulation.worlds.observation[0, 1] * model.wheel.radius
    size = np.array([model.wheel.radius, weight, weight * model.wheel.radius])
    assert np.array([sunk, w.drawbar_pull, w.torque]) / size == pytest.approx(
        stated / size, abs=1e-3
    )


def test_a_vertical_load_and_a_tilted_rig(tmp_path):
    """The tilt of the setup is the rig's, and the model has none."""
    setup = SETUP + "tilt_deg: {value: 2, sd: 0.01}\n"
    found = fit_prediction(problem_of(tmp_path, table_text({}, loads=LOADS), setup))
    at = {"slip": np.array([0.2]), "load": np.array([120.0])}
    tilted, level = found.at(at).mean[0, 1], corrected(found).predict(at).drawbar_pull[0]
    assert level - tilted == pytest.approx(120.0 * math.sin(math.radians(2.0)), rel=0.1)
