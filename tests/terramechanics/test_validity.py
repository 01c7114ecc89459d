"""The range of conditions that a fitted model keeps, and the warning beyond it."""

import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest

from soil_env._io.loading import ParameterError
from soil_env.parameters import Soil
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel, load_model
from soil_env.terramechanics.validity import OutsideValidity, checked

SOIL = Soil(friction_angle_deg=31.0, cohesion=3500.0, shear_modulus=0.028, sinkage_coefficient=740000.0,
            sinkage_exponent=0.6)  # fmt: skip
RANGE = {
    "slip": (0.05, 0.6),
    "load": (100.0, 200.0),
    "speed": (0.02, 0.1),
    "pass": (1.0, 3.0),
    "grade_deg": (-5.0, 5.0),
}


@pytest.fixture
def model():
    return WheelSoilModel(ModelWheel(0.15, 0.12), SOIL, validity=RANGE)


def test_it_survives_saving_and_loading(tmp_path, model):
    model.save(tmp_path / "model.yaml")
    again = WheelSoilModel.load(tmp_path / "model.yaml")
    assert again == model and again.validity == RANGE
    again.save(tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_bytes() == (tmp_path / "model.yaml").read_bytes()
    assert pickle.loads(pickle.dumps(model)) == model


@pytest.mark.parametrize(
    "conditions, word",
    [
        ({"slip": 0.7, "load": 150}, r"slip 0.7 \(fitted to 0.05 to 0.6\)"),
        ({"slip": [0.1, 0.2], "load": [150, 250]}, r"load 150 to 250 \(fitted to 100 to 200 N\)"),
        ({"slip": 0.1, "load": 150, "speed": 0.3}, r"speed 0.3 \(fitted to 0.02 to 0.1 m/s\)"),
    ],
)
def test_beyond_it_warns_once_and_predicts_all_the_same(model, conditions, word):
    with pytest.warns(OutsideValidity, match=word):
        there = model.predict(conditions)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.array_equal(model.predict(conditions).sinkage, there.sinkage)
    plain = replace(model, validity={}).predict(conditions)
    assert np.array_equal(plain.sinkage, there.sinkage) and np.array_equal(plain.torque, there.torque)


def test_within_it_and_at_its_ends_there_is_no_warning(model):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.predict({"slip": [0.05, 0.6], "load": [100, 200], "speed": [0.02, 0.1], "pass": 3, "grade_deg": -5})
        model.predict({"slip": 0.1, "load": 150})  # the speed is not known


@pytest.mark.parametrize(
    "validity, message",
    [
        ({"slop": [0, 1]}, "validity: unknown key 'slop'; did you mean 'slip'"),
        ({"slip": [1, 0]}, r"validity.slip = \[1, 0\]: expected \[lowest, highest\]"),
        ({"slip": [0, float("nan")]}, "validity.slip = "),
        ([0, 1], "validity: expected a mapping"),
    ],
)
def test_what_is_no_range_is_refused(validity, message):
    with pytest.raises(ParameterError, match=message):
        checked(validity)
    with pytest.raises(ParameterError, match=message):
        WheelSoilModel.from_content({"wheel": {"radius": 0.15, "width": 0.1}, "validity": validity})


@pytest.mark.parametrize("path", [3, ""])
def test_load_of_what_is_no_path_is_one_line(path):
    with pytest.raises(ParameterError, match="expected the path of a model.yaml") as error:
        WheelSoilModel.load(path)
    assert "\n" not in str(error.value)
    with pytest.raises(ParameterError, match="expected the path of a model.yaml"):
        load_model(path)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda m: m.predict(None), "conditions = None: expected a Table or a mapping"),
        (lambda m: WheelSoilModel(None), "WheelSoilModel.wheel = None: expected a ModelWheel"),
        (lambda m: WheelSoilModel(m.wheel, m.soil, {}, None), "residual = None: expected a sequence"),
    ],
)
def test_wrong_types_are_one_line(model, make, message):
    with pytest.raises(ParameterError, match=message):
        make(model)
