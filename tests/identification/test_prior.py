"""The prior of the soil and the constants of the identifier: against draws of the mixture, the
soils that courses have and the numbers of the belief.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml

from soil_env._io.loading import ParameterError
from soil_env.identification.online import prior
from soil_env.identification.online.memory import (
    COHESION,
    EXPONENT,
    GAIN,
    LEAST_SD,
    LN_K,
    PRESSURE,
    SETTING,
    TANGENT,
)
from soil_env.logs.mapping import read_map
from soil_env.parameters import (
    Belief,
    SoilSpread,
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
    y = np.log(S) + n * math.log(prior.depth_of(MIXED.wheel))
    rows = np.stack([tangent, cohesion, n, np.log(K), y, np.log(gain / MIXED.belief.dig_gain)])
    mean, covariance = prior.prior_of_belief(MIXED)
    sd = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(rows.mean(axis=1) - mean) < 0.1 * sd)
    np.testing.assert_allclose(rows.std(axis=1), sd, rtol=0.1)
    assert np.abs(np.corrcoef(rows) - covariance / np.outer(sd, sd)).max() < 0.1


@pytest.mark.parametrize("scenario", EVERY, ids=lambda s: s.name)
def test_the_prior_of_each_shipped_scenario_is_a_gaussian(scenario):
    """Symmetric, positive definite, and as wide as soils differ."""
    mean, covariance = prior.prior_of_belief(scenario)
    assert np.all(np.isfinite(mean))
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-12)
    sd = np.sqrt(np.diag(covariance))
    assert np.linalg.eigvalsh(covariance / np.outer(sd, sd)).min() > 1e-4
    mean, sd = prior.published_prior(scenario)
    assert np.all(np.isfinite(mean))
    assert np.all((np.degrees(mean[0]) > 15.0) & (np.degrees(mean[0]) < 45.0))
    assert np.all(sd[[0, 1, 2]] > [math.radians(1.0), 0.1, 0.1]) and np.all(sd[[1, 2, 4]] < 3.0)


def test_pressures_are_compared_at_one_depth():
    """The prior is the same whatever exponent the belief refers S to; the published S is not."""
    one, other = (load_scenario("mixed", {"belief": {"sinkage_exponent": n}}) for n in (0.8, 1.2))
    for a, b in zip(prior.prior_of_belief(one), prior.prior_of_belief(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)
    at = prior.published_prior(one)[0][2] - prior.published_prior(other)[0][2]
    assert at == pytest.approx(0.4 * math.log(prior.depth_of(one.wheel)))


def test_widths_of_a_library_hold_68_percent_of_it():
    """Against draws; soils of two kinds at both ends of the interval need a wider one."""
    gaussians = prior.of_library(load_scenario("sticky"))
    rng = np.random.default_rng(3)
    drawn = np.concatenate(
        [rng.multivariate_normal(mean, covariance, 40_000) for _, mean, covariance in gaussians]
    )
    mean, covariance = prior.moments(gaussians)
    off = np.abs(drawn - mean) / np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(np.mean(off < prior.widths(gaussians), axis=0), 0.683, atol=0.01)
    assert prior.widths(gaussians)[TANGENT] > 1.15


def test_numbers_of_the_prior_beside_a_library_are_refused(tmp_path):
    """In Python, as a change, in the file of a scenario and in the map of a log; a saved belief
    with the defaults loads.
    """
    belief = {"soils": {"dry_sand": 1.0}, "cohesion_sd": 9.0}
    path = tmp_path / "own.yaml"
    path.write_text(yaml.safe_dump({"soils": {"dry_sand": 1.0}, "belief": belief}))
    for read in (
        lambda: Belief(**belief),
        lambda: load_scenario(path),
        lambda: load_scenario("mixed", {"belief": {"friction_sd_deg": 4.0}}),
        lambda: read_map(write_map(tmp_path, {"belief": belief})),
    ):
        with pytest.raises(
            ParameterError, match=r"[Bb]elief\.\w+: without effect beside belief.soils"
        ):
            read()
    assert read_map(write_map(tmp_path, {"belief": to_dict(MIXED.belief)})).belief == MIXED.belief


def test_the_published_prior_is_that_of_the_unknowns():
    """(phi, ln K, ln S, c, ln of the gain), by draws: S at the exponent of the belief for the
    pressure at one depth; as wide as the intervals of the library.
    """
    mean, covariance = prior.prior_of_belief(MIXED)
    rng = np.random.default_rng(1)
    u = rng.multivariate_normal(mean, covariance, 100_000)
    n = MIXED.belief.sinkage_exponent
    ln_S = u[:, PRESSURE] - n * math.log(prior.depth_of(MIXED.wheel))
    rows = np.column_stack([np.arctan(u[:, TANGENT]), u[:, LN_K], ln_S, u[:, COHESION], u[:, GAIN]])
    published, sd = prior.published_prior(MIXED)
    assert np.all(np.abs(rows.mean(axis=0) - published) < 0.1 * sd)
    each = prior.widths(prior.of_library(MIXED))[[TANGENT, LN_K, PRESSURE, COHESION, GAIN]]
    np.testing.assert_allclose(
        sd, np.maximum(each, prior._LEAST_WIDTH) * rows.std(axis=0), rtol=0.06
    )


@pytest.mark.parametrize("plain", [True, False])
def test_the_identifier_takes_nothing_from_the_world_but_its_shape(plain):
    """Constants are the same whatever the soils of the courses, their scatter and their grades.

    The soils of a library scatter as those of the courses where the belief does not say how.
    """
    changes = {
        "soils": {"snow": 1, "heavy_clay_25": 2},
        "spread": {"friction": 0.3, "stiffness": 1.0},
        "course": {"length": 30.0, "grade_deg": [2.0, 3.0], "least_pull": 0.2},
    }
    own = replace(MIXED.belief, spread=SoilSpread(shear_modulus=0.5))
    belief = Belief() if plain else own
    scenarios = [replace(load_scenario("mixed", c), belief=belief) for c in ({}, changes)]
    a, b = (prior.setting_of(scenario) for scenario in scenarios)
    assert a.tobytes() == b.tobytes() and a.dtype == SETTING


def test_what_is_known_is_no_unknown():
    """A belief without doubt of the exponent: next to none, so that no matrix is singular."""
    belief = replace(Belief(), sinkage_exponent_sd=0.0, cohesion=0.0, cohesion_sd=0.0)
    setting = prior.setting_of(replace(MIXED, belief=belief))[0]
    assert setting.soil_sd[EXPONENT] == prior.KNOWN
    product = setting.soil_precision @ setting.soil_covariance
    np.testing.assert_allclose(product, np.eye(len(product)), atol=1e-6)


def test_the_sensors_are_those_of_the_scenario():
    """White noise, zeros and gains in the units of readings; an exact sensor has a little noise."""
    noise = {"drawbar_pull": 0.02, "torque": 0.05, "sinkage": 0.003, "speed": 0.007}
    others = {"torque_zero": 0.03, "speed_gain": 0.04, "load": 0.0}
    scenario = load_scenario("mixed", {"noise": noise | others})
    setting = prior.setting_of(scenario)[0]
    weight = scenario.weight
    radius = scenario.wheel.radius
    units = {"drawbar_pull": weight, "torque": weight * radius, "sinkage": 1.0, "speed": 1.0}
    for name, size in noise.items():
        assert setting.white[0][name] == pytest.approx(size * units[name]), name
    assert setting.zero[0].torque == pytest.approx(0.03 * weight * radius)
    assert setting.gain[0].speed == pytest.approx(0.04)
    assert setting.white[0].load == pytest.approx(LEAST_SD * weight)
    assert setting.white[0].slip == 0.0  # there is none
