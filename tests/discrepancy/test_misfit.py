"""What a fit leaves: along smooth and along physical directions."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from soil_env.discrepancy.calibrate import Choice
from soil_env.discrepancy.misfit import (
    _apart,
    lack_of_fit,
    looks,
    physical_directions,
    probability,
    responses,
    smooth_directions,
)
from soil_env.terramechanics.model import WheelSoilModel
from tests.discrepancy.tables import SOIL, WHEEL, problem, table

DATA = table(speeds=(0.03, 0.12))


def noisy(seed, y=None):
    data = DATA if y is None else dataclasses.replace(DATA, y=y)
    return problem(data, np.random.default_rng(seed))


def with_soil(scale):
    """The noise-free table [N, 3] of soils that differ by row: `scale` [N] times the sinkage coefficient."""
    out = np.empty_like(DATA.y)
    for s in np.unique(scale):
        soil = dataclasses.replace(SOIL, sinkage_coefficient=SOIL.sinkage_coefficient * float(s))
        there = WheelSoilModel(WHEEL, soil, {}).predict(
            {"slip": DATA.rows.slip, "load": DATA.rows.load, "speed": DATA.rows.conditions[:, 0]}
        )
        out[scale == s] = np.stack(there[:3], axis=1)[scale == s]
    return out


def test_looks_are_as_many_as_independent_directions():
    axes = np.eye(12)[:, :5]
    assert looks(axes) == pytest.approx(5.0)
    assert looks(np.repeat(axes[:, :1], 7, axis=1)) == pytest.approx(1.0)
    near = np.stack([axes[:, 0], (axes[:, 0] + 0.1 * axes[:, 1]) / np.sqrt(1.01)], axis=1)
    assert 1.0 < looks(near) < 2.1


def test_noise_alone_looks_as_it_should():
    """The null distribution of the largest of all directions, simulated."""
    p = noisy(2)
    fit = p.fit()
    q, _ = np.linalg.qr(fit.linearised()[0])
    noise = np.random.default_rng(0).standard_normal((q.shape[0], 4000))
    count, largest_of = 0.0, np.zeros(4000)
    for directions in (smooth_directions(p), physical_directions(p, fit)):
        left, seen = _apart(q, directions)
        c = left[:, seen] / np.linalg.norm(left[:, seen], axis=0)
        count += looks(c)
        largest_of = np.maximum(largest_of, np.max((c.T @ noise) ** 2, axis=0))
    for level in (0.1, 0.02):
        threshold = chi2.isf(-np.expm1(np.log1p(-level) / count), 1)
        assert 0.5 < np.mean(largest_of > threshold) / level < 1.5


def test_a_response_is_the_difference_of_two_predictions():
    p = noisy(0)
    fit = p.fit()
    found = responses(p, fit)
    assert set(found) == {
        "friction_angle_deg", "cohesion", "shear_modulus", "sinkage_coefficient", "sinkage_exponent", "load", "radius",
        "slip",
    }  # fmt: skip
    values = fit.parameters()
    more = values | {"sinkage_coefficient": 1.02 * values["sinkage_coefficient"]}
    less = values | {"sinkage_coefficient": 0.98 * values["sinkage_coefficient"]}
    guess = p.sinkage_guess(fit)
    central = p.whiten(p.predict(more, (), guess.copy()) - p.predict(less, (), guess.copy())) / 0.04
    size = np.linalg.norm(central)
    assert np.linalg.norm(found["sinkage_coefficient"] - central) < 0.01 * size


def test_what_the_unknowns_explain_is_taken_out():
    p = noisy(1)
    a, _ = p.fit().linearised()
    q, _ = np.linalg.qr(a)
    for directions in (smooth_directions(p), physical_directions(p, p.fit())):
        left, seen = _apart(q, directions)
        assert np.max(np.abs(q.T @ left)) < 1e-8 * np.max(np.abs(directions))
        assert seen.sum() > 10 and not seen.all() or directions.shape[1] == seen.sum()


def largest(p, fit, directions):
    """Square of what is left along the one direction that explains most."""
    a, e = fit.linearised()
    left, seen = _apart(np.linalg.qr(a)[0], directions)
    return np.max((left[:, seen].T @ e / np.linalg.norm(left[:, seen], axis=0)) ** 2)


def test_a_soil_that_changes_with_load_and_speed_shows_more_in_all_channels_together():
    load, speed = DATA.varied["load"].scaled, DATA.varied["speed"].scaled
    y = with_soil(1.0 + 0.08 * np.round(load * speed, 3))
    for seed in range(3):
        p = noisy(seed, y)
        fit = p.fit()
        assert lack_of_fit(p, fit) < 1e-3
        assert largest(p, fit, physical_directions(p, fit)) > 5.0 + largest(p, fit, smooth_directions(p))


def test_an_effect_of_the_right_name_leaves_nothing():
    effects = {"slip_sinkage": {"gain": 0.8}}
    full = table(effects, speeds=(0.03, 0.12))
    chances = []
    for seed in range(12):
        p = problem(full, np.random.default_rng(seed))
        chances.append(lack_of_fit(p, p.fit((Choice("slip_sinkage", 0),))))
    assert min(chances) > 1e-3 and np.mean(np.array(chances) < 0.2) < 0.5


def test_probability_is_that_of_a_known_or_an_estimated_noise():
    assert probability(-1.0, 1, np.inf) == 1.0
    assert probability(3.841, 1, np.inf) == pytest.approx(0.05, abs=1e-4)
    assert probability(4.965, 1, 10.0) == pytest.approx(0.05, abs=1e-4)  # F(1, 10)
