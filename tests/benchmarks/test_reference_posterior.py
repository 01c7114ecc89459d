"""benchmarks/reference_posterior.py: on a course drawn from the prior the reference has learnt and is not wrong."""

import json

import numpy as np
import pytest

from benchmarks import reference_posterior as study
from benchmarks.drives import controller_of, record
from benchmarks.reference_particles import END, HERE, useful
from soil_env.identification.online.soil_prior import published_prior
from soil_env.parameters import load_scenario

STEPS = 60


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("two_lines")


@pytest.fixture(scope="module")
def log(scenario):
    """The beginning of a course drawn from the prior, on which the wheel gets on."""
    driven = record(controller_of("best_slip_identified", scenario), scenario, 1, study.SEED)[0]
    return study.cut(study.drawn(driven, scenario, 2), STEPS)


def test_course_drawn_from_the_prior(log, scenario):
    assert len(log["x"]) == STEPS and log["x"][-1] > 0.3 and useful(log, scenario).mean() > 0.5
    for name in ("truth", "estimate", "sd", "readings"):
        assert len(log[name]) == STEPS and np.isfinite(log[name]).all()
    assert set(study.places(log, scenario)) <= set(range(len(study.PLACES)))


@pytest.mark.parametrize("motion", study.MOTIONS)
def test_posterior(log, scenario, motion):
    particles = study.MOTIONS[motion](log, scenario, 64, 0, study.DRAWN_GRADE_SD)
    steps, mean, sd = particles.run()
    weights = particles.weights()
    assert np.isfinite(weights).all() and weights.sum() == pytest.approx(1.0) and weights.max() < 0.5
    before = np.sqrt(np.diag(published_prior(scenario)[1]))
    assert steps[-1] == STEPS - 1 and (sd[-1, :3] < 0.8 * before[:3]).all() and (sd > 0.0).all()
    assert (np.abs(mean[-1] - log["truth"][-1, :5]) < 4.0 * sd[-1]).all()


@pytest.mark.parametrize("motion", study.MOTIONS)
def test_window_shifts_without_a_change_of_weights(log, scenario, motion):
    """What the readings said before a shift of the window they say behind it."""
    particles = study.MOTIONS[motion](log, scenario, 16, 0, study.DRAWN_GRADE_SD)
    particles.x[:, END] = 0.9 * log["x"][-1] * np.linspace(0.5, 0.6, 16)
    out = particles.simulate(particles.x, STEPS)
    here = particles.x[:, HERE].copy()
    particles._shift(STEPS, out)
    assert 0 < particles.since < STEPS and set(particles.before[:, 0]) <= set(here[:, 0])
    assert np.abs(particles.ln_weight).max() < 1e-6 * STEPS


def test_study_goes_on_where_it_was(tmp_path, monkeypatch):
    arguments = ["--smoke", "--scenarios", "two_lines", "--out", str(tmp_path)]
    assert study.main(arguments) == 0
    result = json.loads((tmp_path / "reference_posterior.json").read_text(encoding="utf-8"))
    page = (tmp_path / "reference_posterior.md").read_text(encoding="utf-8")
    assert len(result["courses"]) == 2 and page.count("| phi [deg] |") == 4
    monkeypatch.setattr(study, "judge", None)  # nothing is made again
    assert study.main(arguments) == 0
    assert (tmp_path / "reference_posterior.md").read_text(encoding="utf-8") == page
