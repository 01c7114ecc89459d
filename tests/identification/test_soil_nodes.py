"""The nodes of a soil: priors and moments against numpy, where they are placed, what becomes of
them at a border.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import log_softmax

from soil_env.identification.online import soil_nodes as soil
from soil_env.identification.online.filter_bank import filter_numbers, new_banks, restart
from soil_env.identification.online.lanes.lanes import COUNT
from soil_env.identification.online.sinkage_filter import (
    GAIN as SINKAGE_GAIN,
    PRESSURE as SINKAGE_PRESSURE,
    cell,
)
from soil_env.identification.online.soil_prior import prior_of_belief
from soil_env.parameters import Belief, load_scenario
from tests.identification.observing import symmetric

SCENARIOS = {
    "library": load_scenario("mixed"),
    "plain": replace(load_scenario("mixed"), belief=Belief()),
}
OTHERS = [0, 1, 2]  # tan phi, c, n; ln K is 3


@pytest.fixture(params=list(SCENARIOS))
def filled(request):
    """(banks, numbers, scenario) of one filter that has taken nothing."""
    scenario = SCENARIOS[request.param]
    numbers = filter_numbers(scenario)
    banks = new_banks(1)
    restart(banks, 0, numbers)
    return banks, numbers, scenario


def rows(banks):
    """Nodes [NODE_ROWS, COUNT]."""
    return banks.nodes[0].reshape(soil.NODE_ROWS, COUNT)


def known(banks, old=False):
    """(mean [4], covariance [4, 4]) of the newest soil, or of the old one."""
    g = banks.known[0, soil.OLD * old : soil.OLD * old + soil.GAUSSIAN]
    return g[: soil.SOIL].copy(), symmetric(g[soil.SOIL :])


def conditional(mean, covariance, ln_K):
    """(mean [3], covariance [3, 3]) of the other unknowns of a Gaussian, given ln K."""
    slope = covariance[OTHERS, 3] / covariance[3, 3]
    return mean[OTHERS] + slope * (ln_K - mean[3]), covariance[:3, :3] - np.outer(
        slope, covariance[OTHERS, 3]
    )


def test_the_prior_follows_the_sinkage(filled):
    """As a Gaussian of all six unknowns, conditioned on a reading of two of them by numpy."""
    banks, numbers, scenario = filled
    mean, covariance = prior_of_belief(scenario)
    n = rows(banks)
    s = banks.sinkage[0]
    sd = np.sqrt(np.diag(covariance))
    soil.renew_prior(banks, 0, numbers)
    np.testing.assert_allclose(banks.prior[0, 0], mean[3], atol=1e-9)
    np.testing.assert_allclose(banks.prior[0, 1], covariance[3, 3], rtol=0.1)
    R = np.diag([0.2 * sd[4], 0.3 * sd[5]]) ** 2
    H = np.eye(6)[4:]
    gain = covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + R)
    m = mean + gain @ ([0.7 * sd[4], -0.5 * sd[5]])
    P = covariance - gain @ H @ covariance
    states = ((4, SINKAGE_PRESSURE), (5, SINKAGE_GAIN))
    for i, row in states:
        s[row * COUNT :][:COUNT] = m[i]
        for j, column in states:
            s[cell(row, column) :][:COUNT] = P[i, j]
    soil.renew_prior(banks, 0, numbers)
    assert banks.prior[0, 0] == pytest.approx(m[3], abs=1e-6 * sd[3])
    assert banks.prior[0, 1] == pytest.approx(P[3, 3], rel=1e-6)
    soil.set_priors(banks, 0)
    for k in range(COUNT):
        of_node, Q = conditional(m[:4], P[:4, :4], n[soil.LN_K, k])
        np.testing.assert_allclose(
            n[soil.PRIOR_MEAN : soil.PRIOR_MEAN + 3, k], of_node, rtol=1e-6, atol=1e-6
        )
        scale = np.sqrt(np.diag(Q))
        found = symmetric(n[soil.PRECISION : soil.PRECISION + 6, k]) * np.outer(scale, scale)
        np.testing.assert_allclose(
            found, np.linalg.inv(Q / np.outer(scale, scale)), rtol=3e-3, atol=3e-3
        )
    # with the evidence of a Gaussian, the determinant of the posterior, weights sum to the
    # probability of their range
    weight = (
        n[soil.LOG_PRIOR]
        - 0.5 * np.linalg.slogdet(symmetric(n[soil.PRECISION : soil.PRECISION + 6, 0]))[1]
    )
    assert np.exp(weight).sum() == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_known_is_the_mixture_of_the_nodes(filled, seed):
    """Nodes have random means, covariances and weights."""
    rng = np.random.default_rng(seed)
    banks = filled[0]
    unknowns = soil.UNKNOWNS
    n = rows(banks)
    units = np.array([[1.0], [500.0], [1.0], [1.0]])
    n[:3] += 0.02 * rng.standard_normal((3, COUNT)) * units[:3]
    for k in range(COUNT):
        factor = 0.01 * rng.standard_normal((unknowns, unknowns)) * units
        n[soil.COVARIANCE :][: soil.TRIANGLE, k] = (factor @ factor.T)[np.tril_indices(unknowns)]
    n[soil.LOG_WEIGHT] = log_softmax(np.log(rng.uniform(0.1, 1.0, COUNT)))
    n[6] = np.arange(COUNT) + 2.0  # chi-squared
    assert soil.gather(banks, 0) == 2.0
    w = np.exp(n[soil.LOG_WEIGHT])
    values = n[[0, 1, 2, soil.LN_K]]
    mean = values @ w
    P = (w * (values - mean[:, None])) @ (values - mean[:, None]).T
    for k in range(COUNT):
        P[:3, :3] += (
            w[k] * symmetric(n[soil.COVARIANCE : soil.COVARIANCE + soil.TRIANGLE, k])[:3, :3]
        )
    found, Q = known(banks)
    np.testing.assert_allclose(found, mean, rtol=1e-9)
    np.testing.assert_allclose(Q, P, rtol=1e-9, atol=1e-12)


def test_nodes_come_closer_where_ln_K_becomes_known():
    """They move by a bounded factor each time, until they cover three standard deviations, and stay
    then.
    """
    banks = new_banks(1)
    numbers = filter_numbers(SCENARIOS["plain"])
    restart(banks, 0, numbers)
    n = rows(banks)
    truth = -4.0
    sd = 0.05
    ln_K = n[soil.LN_K]
    for moves in range(12):  # noqa: B007 (read below)
        before = n.copy()
        n[soil.LOG_WEIGHT] = log_softmax(-0.5 * ((ln_K - truth) / sd) ** 2)
        soil.gather(banks, 0)
        if not soil.spread_anew(banks, 0):
            break
        was = before[soil.LN_K]
        assert np.ptp(ln_K) >= 0.5 * np.ptp(was)
        inside = (ln_K >= was[0]) & (ln_K <= was[-1])
        for i in range(3):  # between the nodes so far
            np.testing.assert_allclose(
                n[i, inside], np.interp(ln_K, was, before[i])[inside], rtol=1e-9
            )
    assert 0 < moves < 11
    found, P = known(banks)
    assert found[3] == pytest.approx(truth, abs=0.1 * sd) and math.sqrt(P[3, 3]) == pytest.approx(
        sd, rel=0.1
    )
    np.testing.assert_allclose(np.diff(ln_K), np.ptp(ln_K) / (COUNT - 1), rtol=1e-9)
    assert ln_K[0] < truth - 2.0 * sd and ln_K[-1] > truth + 2.0 * sd


def test_a_soil_that_stays_the_same_is_known_as_well_as_before():
    """The node of it stands at one ln K, whose uncertainty moves the other unknowns too."""
    banks = new_banks(1)
    numbers = filter_numbers(SCENARIOS["library"])
    restart(banks, 0, numbers)
    before = known(banks)[1]  # of the library, in which the others are correlated with ln K
    soil.begin_next_soil(banks, 0, numbers)
    n = rows(banks)
    n[soil.LOG_WEIGHT] = [-700.0] * soil.STAYS + [0.0]
    given = np.zeros((soil.UNKNOWNS, soil.UNKNOWNS))
    given[:3, :3] = conditional(known(banks, old=True)[0], before, 0.0)[1]
    n[soil.COVARIANCE : soil.COVARIANCE + soil.TRIANGLE, soil.STAYS] = given[
        np.tril_indices(soil.UNKNOWNS)
    ]
    soil.gather(banks, 0)
    sd = np.sqrt(np.diag(before))
    np.testing.assert_allclose(
        known(banks)[1] / np.outer(sd, sd), before / np.outer(sd, sd), atol=0.01
    )
