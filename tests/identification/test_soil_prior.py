"""The prior of the filter: against draws of the mixture, the soils that courses have and the
numbers of the belief.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml

from soil_env._io.loading import ParameterError
from soil_env.identification.online import soil_prior
from soil_env.logs.mapping import read_map
from soil_env.parameters import (
    Belief,
    SoilState,
    load_rover,
    load_scenario,
    rover_names,
    scenario_names,
    to_dict,
)
from soil_env.simulation.world.courses import course_distribution
from soil_env.simulation.world.terrain import SOIL
from tests.logs.bags import write_map
from tests.simulation.courses import draw_soils, stream_of

MIXED = load_scenario("mixed")
EVERY = [load_scenario(n) for n in scenario_names()] + [load_rover(n) for n in rover_names()]


def test_the_library_is_what_the_world_draws():
    """Moments of the mixture against 4000 soils of `courses.draw_soil`, passable or not."""
    drawn = np.zeros(4000, SOIL)
    draw_soils(stream_of(0), course_distribution(MIXED), drawn)
    tangent, cohesion, K, S, n, gain = (drawn[name] for name in SoilState._fields[:6])
    y = np.log(S) + n * math.log(soil_prior.depth_of(MIXED))
    rows = np.stack([tangent, cohesion, n, np.log(K), y, np.log(gain / MIXED.belief.dig_gain)])
    mean, covariance = soil_prior.prior_of_belief(MIXED)
    sd = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(rows.mean(axis=1) - mean) < 0.1 * sd)
    np.testing.assert_allclose(rows.std(axis=1), sd, rtol=0.1)
    assert np.abs(np.corrcoef(rows) - covariance / np.outer(sd, sd)).max() < 0.1


@pytest.mark.parametrize("scenario", EVERY, ids=lambda s: s.name)
def test_the_prior_of_each_shipped_scenario_is_a_gaussian(scenario):
    """Symmetric, positive definite, and as wide as soils differ."""
    for mean, covariance in (
        soil_prior.prior_of_belief(scenario),
        soil_prior.published_prior(scenario),
    ):
        assert np.all(np.isfinite(mean))
        np.testing.assert_allclose(covariance, covariance.T, rtol=1e-12)
        sd = np.sqrt(np.diag(covariance))
        assert np.linalg.eigvalsh(covariance / np.outer(sd, sd)).min() > 1e-4
    assert np.all((np.degrees(mean[0]) > 15.0) & (np.degrees(mean[0]) < 45.0))
    assert np.all(sd[[0, 1, 2]] > [math.radians(1.0), 0.1, 0.1]) and np.all(sd[[1, 2, 4]] < 3.0)


@pytest.mark.parametrize(
    "scenario", [MIXED, replace(MIXED, belief=Belief())], ids=["library", "plain"]
)
def test_the_regression_is_that_of_the_forces_on_the_sinkage(scenario):
    """Least squares over draws of the joint Gaussian; the rest of the variance is that of the
    residuals.
    """
    mean, covariance = soil_prior.prior_of_belief(scenario)
    rows = np.random.default_rng(1).multivariate_normal(mean, covariance, 200_000) - mean
    prior = soil_prior.soil_prior(scenario)
    sd = np.sqrt(np.diag(covariance))
    found, *_ = np.linalg.lstsq(
        rows[:, soil_prior.PRESSURE :], rows[:, : soil_prior.PRESSURE], rcond=None
    )
    scale = np.outer(sd[soil_prior.PRESSURE :], 1.0 / sd[: soil_prior.PRESSURE])
    np.testing.assert_allclose(prior.regression.reshape(4, 2).T * scale, found * scale, atol=0.02)
    np.testing.assert_array_equal(prior.forces[:4], mean[:4])
    np.testing.assert_array_equal(prior.forces[4:], covariance[:4, :4][np.tril_indices(4)])
    np.testing.assert_array_equal(prior.sinkage, mean[4:])
    np.testing.assert_array_equal(prior.sinkage_covariance.reshape(2, 2), covariance[4:, 4:])


def test_pressures_are_compared_at_one_depth():
    """The prior is the same whatever exponent the belief refers S to; the published S is not."""
    one, other = (load_scenario("mixed", {"belief": {"sinkage_exponent": n}}) for n in (0.8, 1.2))
    for a, b in zip(
        soil_prior.prior_of_belief(one), soil_prior.prior_of_belief(other), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=1e-12)
    at = soil_prior.published_prior(one)[0][2] - soil_prior.published_prior(other)[0][2]
    assert at == pytest.approx(0.4 * math.log(soil_prior.depth_of(one)))


def test_widths_of_a_library_hold_68_percent_of_it():
    """Against draws; soils of two kinds at both ends of the interval need a wider one."""
    gaussians = soil_prior.of_library(load_scenario("sticky"))
    rng = np.random.default_rng(3)
    drawn = np.concatenate(
        [rng.multivariate_normal(mean, covariance, 40_000) for _, mean, covariance in gaussians]
    )
    mean, covariance = soil_prior.moments(gaussians)
    off = np.abs(drawn - mean) / np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        np.mean(off < soil_prior.widths(gaussians), axis=0), 0.683, atol=0.01
    )
    assert soil_prior.widths(gaussians)[soil_prior.TANGENT] > 1.15


def test_numbers_of_the_prior_beside_a_library_are_refused(tmp_path):
    """As a change, in the file of a scenario and in the map of a log; a saved belief with the
    defaults loads.
    """
    belief = {"soils": {"dry_sand": 1.0}, "cohesion_sd": 9.0}
    path = tmp_path / "own.yaml"
    path.write_text(yaml.safe_dump({"soils": {"dry_sand": 1.0}, "belief": belief}))
    for read in (
        lambda: load_scenario(path),
        lambda: load_scenario("mixed", {"belief": {"friction_sd_deg": 5.0}}),
        lambda: read_map(write_map(tmp_path, {"belief": belief})),
    ):
        with pytest.raises(
            ParameterError, match=r"belief\.\w+: without effect beside belief.soils"
        ):
            read()
    assert read_map(write_map(tmp_path, {"belief": to_dict(MIXED.belief)})).belief == MIXED.belief
