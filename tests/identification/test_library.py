"""The library of soils as prior, against the same mixture by numpy and scipy."""

import numpy as np
from hypothesis import given, settings, strategies as st
from scipy.special import softmax
from scipy.stats import multivariate_normal

from soil_env.identification.online.library import UNLIKELY
from soil_env.identification.online.memory import SOIL
from soil_env.identification.online.prior import STRANGE, of_library, prior_of_belief
from tests.identification.observing import PLAIN, SCENARIO, Identified


def fitted(wheel, info, truth):
    """Give a wheel the fit of such information [SOIL, SOIL] under the prior that it has."""
    covariance = np.linalg.inv(info + wheel.now.prior_precision)
    h = info @ truth + wheel.now.prior_precision @ wheel.now.prior_mean
    wheel.now.u[:SOIL] = covariance @ h
    wheel.now.covariance[:] = 0.5 * (covariance + covariance.T)


def random_information(wheel, rng, strength):
    """(information [SOIL, SOIL], the soil that it shows)."""
    sd = wheel.set.soil_sd
    J = strength * rng.normal(size=(SOIL, SOIL)) / sd
    info = J.T @ J / SOIL + np.diag((1e-3 / sd) ** 2)
    return info, wheel.set.soil_mean + 0.8 * sd * rng.normal(size=SOIL)


def soils_of(scenario):
    """[(weight, mean, covariance)] of the library, and one of soils that are like none of it."""
    soils = of_library(scenario)
    total = sum(weight for weight, _, _ in soils)
    return [*soils, (STRANGE * total or 1.0, *prior_of_belief(scenario))]


def moments(weights, means, spreads):
    """(mean, covariance) of a mixture of Gaussians."""
    mean = weights @ means
    away = means - mean
    return mean, np.tensordot(weights, spreads, 1) + (away.T * weights) @ away


def mixture(scenario, info, truth):
    """(weights, mean, covariance) of the posterior of a library, each soil by its evidence."""
    soils = soils_of(scenario)
    noise = np.linalg.inv(info)
    scale = np.sqrt(np.diag(prior_of_belief(scenario)[1]))
    unit = np.outer(scale, scale)
    logs = [
        np.log(weight)
        + multivariate_normal(mean / scale, (covariance + noise) / unit).logpdf(truth / scale)
        for weight, mean, covariance in soils
    ]
    weights = softmax(logs)
    means = []
    spreads = []
    for _, mean, covariance in soils:
        spread = np.linalg.inv(np.linalg.inv(covariance) + info)
        means.append(spread @ (np.linalg.solve(covariance, mean) + info @ truth))
        spreads.append(spread)
    return weights, *moments(weights, np.array(means), spreads)


@settings(max_examples=40, deadline=None)
@given(st.sampled_from([SCENARIO, PLAIN]), st.integers(0, 2**32 - 1), st.floats(0.1, 10.0))
def test_the_posterior_is_the_mixture_of_those_of_its_soils(scenario, seed, strength):
    """Whatever prior the fit was linearised under: after the first fit it is another. Without a
    library it is that of the fit.
    """
    wheel = Identified(scenario)
    rng = np.random.default_rng(seed)
    sd = wheel.set.soil_sd
    unit = np.outer(sd, sd)
    for _ in range(2):
        info, truth = random_information(wheel, rng, strength)
        fitted(wheel, info, truth)
        wheel.mix()
        _, mean, spread = mixture(scenario, info, truth)
        np.testing.assert_allclose((wheel.now["soil"] - mean) / sd, 0.0, atol=1e-4)
        np.testing.assert_allclose(wheel.now.spread / unit, spread / unit, atol=1e-4)


def test_the_next_fit_has_the_soils_that_are_left_for_a_prior():
    """Their mean and covariance before any reading, by their weights now."""
    wheel = Identified(SCENARIO)
    _, truth, covariance = of_library(SCENARIO)[0]
    info = np.linalg.inv(0.1 * covariance)
    fitted(wheel, info, truth)
    wheel.mix()
    weights, _, _ = mixture(SCENARIO, info, truth)
    weights = np.where(weights < UNLIKELY * weights.max(), 0.0, weights)
    weights /= weights.sum()
    assert 1 <= np.count_nonzero(weights) < len(weights)
    _, means, spreads = zip(*soils_of(SCENARIO), strict=True)
    mean, covariance = moments(weights, np.array(means), spreads)
    sd = wheel.set.soil_sd
    np.testing.assert_allclose(wheel.now.prior_mean / sd, mean / sd, atol=1e-4)
    product = wheel.now.prior_precision @ covariance / np.outer(1.0 / sd, sd)
    np.testing.assert_allclose(product, np.eye(SOIL), atol=1e-3)
