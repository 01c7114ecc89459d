"""Runs that serve the prediction: the joint uncertainty, and what runs take from it."""

import copy
import dataclasses

import numpy as np
import pytest

from soil_env.discovery.calibrate import calibrate
from soil_env.discovery.evidence import settle
from soil_env.discovery.next_for_prediction import Uncertainty, surer_runs
from soil_env.discovery.prediction import WIDER, fit_prediction
from soil_env.discovery.predictive import DEEPEST
from soil_env.measurement.setup import Rig
from tests.discovery.files import PLANTED, data_of, table_text


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    text = table_text(PLANTED, loads=(80.0, 120.0, 180.0))
    return calibrate(data_of(tmp_path_factory.mktemp("table"), text))[0]


@pytest.fixture(scope="module")
def model(problem):
    return fit_prediction(problem)


def normal(rng, runs, channels):
    """Covariance [runs, channels, runs, channels] of random values."""
    root = rng.normal(size=(runs * channels, 4))
    joint = root @ root.T + 0.1 * np.eye(runs * channels)
    return joint.reshape(runs, channels, runs, channels)


def test_runs_leave_what_the_conditional_normal_distribution_has():
    """Two runs one after the other, as both in one conditional distribution."""
    rng = np.random.default_rng(0)
    joint = normal(rng, 5, 2)
    noise = np.array([0.5, 2.0])
    uncertain = Uncertainty(joint, noise)
    foreseen = uncertain.after(1)
    uncertain.make(1)
    assert uncertain.mean_sd() == pytest.approx(foreseen)
    uncertain.make(4)
    flat = joint.reshape(10, 10)
    made = [2, 3, 8, 9]
    of_made = flat[np.ix_(made, made)] + np.diag(np.tile(noise, 2))
    left = flat - flat[:, made] @ np.linalg.solve(of_made, flat[made])
    assert uncertain.covariance.reshape(10, 10) == pytest.approx(left)
    assert uncertain.mean_sd() == pytest.approx(np.mean(np.sqrt(np.diag(left))))


def test_the_joint_uncertainty_has_the_stated_standard_deviations(model):
    at = {"slip": np.array([0.1, 0.4, 0.4]), "load": np.array([80.0, 120.0, 300.0])}
    joint = model.joint_at(at)
    own = np.einsum("ncnc->nc", joint) + model.variance_of_run
    stated = model.at(at).sd / WIDER / model.problem.noise
    assert np.sqrt(own) == pytest.approx(stated, rel=1e-6)
    assert np.linalg.eigvalsh(joint.reshape(9, 9)).min() > -1e-9
    assert joint == pytest.approx(joint.transpose(2, 3, 0, 1))


def test_each_run_makes_the_prediction_surer_and_goes_beyond_the_table(problem, model):
    runs = surer_runs(model, settle(problem, ()), 3)
    left = [run.left for run in runs]
    assert len(runs) == 3 and left == sorted(left, reverse=True) and left[0] < 1.0
    assert runs[0].conditions["load"] > 180.0
    assert surer_runs(model, settle(problem, ()), 0) == ()


def test_a_run_in_which_the_wheel_sinks_too_deep_is_not_proposed(problem, model):
    """A table refuses a sinkage beyond the radius."""
    evidence = settle(problem, ())
    for loads, count in (((120.0, 400.0, 800.0), 4), ((5000.0, 9000.0), 0)):
        there = copy.copy(problem)
        setup = dataclasses.replace(problem.data.setup, rig=Rig(loads=loads))
        there.data = dataclasses.replace(problem.data, setup=setup)
        law = copy.copy(model.law)
        law.problem = there
        runs = surer_runs(dataclasses.replace(model, law=law), evidence, 4)
        assert len(runs) == count
        for run in runs:
            at = {name: np.array([x]) for name, x in run.conditions.items()}
            assert model.mean_at(at)[0, 0] < DEEPEST * problem.data.wheel.radius
