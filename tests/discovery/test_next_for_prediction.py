"""Runs that serve the prediction: the joint uncertainty, and what runs take from it."""

import copy
import dataclasses

import numpy as np
import pytest

from soil_env.discovery.evidence import settle
from soil_env.discovery.next_for_prediction import Uncertainty, surer_runs
from soil_env.discovery.prediction import WIDER
from soil_env.discovery.predictive import DEEPEST
from soil_env.measurement.setup import Rig
from tests.discovery.files import with_data


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


def test_the_joint_uncertainty_has_the_stated_standard_deviations(learnt):
    at = {"slip": np.array([0.1, 0.4, 0.4]), "load": np.array([80.0, 120.0, 300.0])}
    joint = learnt.joint_at(at)
    own = np.einsum("ncnc->nc", joint) + learnt.variance_of_run
    stated = learnt.at(at).sd / WIDER / learnt.problem.noise
    assert np.sqrt(own) == pytest.approx(stated, rel=1e-6)
    assert np.linalg.eigvalsh(joint.reshape(9, 9)).min() > -1e-9
    assert joint == pytest.approx(joint.transpose(2, 3, 0, 1))


def test_each_run_makes_the_prediction_surer_and_goes_beyond_the_table(planted_problem, learnt):
    evidence = settle(planted_problem, ())
    runs = surer_runs(learnt, evidence, 3)
    left = [run.left for run in runs]
    assert len(runs) == 3 and left == sorted(left, reverse=True) and left[0] < 1.0
    assert runs[0].conditions["load"] > 180.0
    assert surer_runs(learnt, evidence, 0) == ()


def test_a_run_in_which_the_wheel_sinks_too_deep_is_not_proposed(planted_problem, learnt):
    """A table refuses a sinkage beyond the radius."""
    evidence = settle(planted_problem, ())
    for loads, count in (((120.0, 400.0, 800.0), 4), ((5000.0, 9000.0), 0)):
        law = copy.copy(learnt.law)
        setup = planted_problem.data.setup.changed(rig=Rig(loads=loads))
        law.problem = with_data(planted_problem, setup=setup)
        runs = surer_runs(dataclasses.replace(learnt, law=law), evidence, 4)
        assert len(runs) == count
        for run in runs:
            at = {name: np.array([x]) for name, x in run.conditions.items()}
            assert learnt.mean_at(at)[0, 0] < DEEPEST * planted_problem.data.wheel.radius
