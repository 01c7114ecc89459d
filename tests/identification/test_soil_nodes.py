"""The nodes of a soil: priors and moments against numpy, where they are placed, what becomes of them at a border."""

import math
from dataclasses import replace

import numpy as np
import pytest

from soil_env._numba.lanes import COUNT
from soil_env.identification.online.filter_bank import filter_numbers, new_banks, restart
from soil_env.identification.online.sinkage_filter import GAIN as SINKAGE_GAIN, PRESSURE as SINKAGE_PRESSURE, cell
from soil_env.identification.online.soil_nodes import (
    BORDER_PLACE,
    COVARIANCE,
    GAUSSIAN,
    LN_K,
    LOG_PRIOR,
    LOG_WEIGHT,
    NODE_ROWS,
    OLD,
    PRECISION,
    PRIOR_MEAN,
    REACH,
    SAME_SOIL,
    SOIL,
    STAYS,
    TRIANGLE,
    UNKNOWNS,
    begin_next_soil,
    below_diagonal,
    fit_is_sound,
    gather,
    leave_old_soil,
    renew_prior,
    set_priors,
    spread_anew,
)
from soil_env.identification.online.soil_prior import prior_of_belief
from soil_env.parameters import Belief, load_scenario

SCENARIOS = {"library": load_scenario("mixed"), "plain": replace(load_scenario("mixed"), belief=Belief())}
OTHERS = [0, 1, 2]  # tan phi, c, n; ln K is 3


@pytest.fixture(params=list(SCENARIOS))
def filled(request):
    """(banks, numbers, scenario) of one filter that has taken nothing."""
    scenario = SCENARIOS[request.param]
    numbers, banks = filter_numbers(scenario), new_banks(1)
    restart(banks, 0, numbers)
    return banks, numbers, scenario


def rows(banks):
    """Nodes [NODE_ROWS, COUNT]."""
    return banks.nodes[0].reshape(NODE_ROWS, COUNT)


def square(triangle):
    """Symmetric matrix of a lower triangle, row by row."""
    n = round((math.sqrt(8 * len(triangle) + 1) - 1) / 2)
    out = np.zeros((n, n))
    out[np.tril_indices(n)] = triangle
    return out + np.tril(out, -1).T


def known(banks, old=False):
    """(mean [4], covariance [4, 4]) of the newest soil, or of the old one."""
    g = banks.known[0, OLD * old : OLD * old + GAUSSIAN]
    return g[:SOIL].copy(), square(g[SOIL:])


def conditional(mean, covariance, ln_K):
    """(mean [3], covariance [3, 3]) of the other unknowns of a Gaussian, given ln K."""
    slope = covariance[OTHERS, 3] / covariance[3, 3]
    return mean[OTHERS] + slope * (ln_K - mean[3]), covariance[:3, :3] - np.outer(slope, covariance[OTHERS, 3])


def learn(banks, seed=0, same=0.0):
    """Set the nodes to some posterior: random means, covariances and weights; `same` of the last one on a border."""
    rng, n = np.random.default_rng(seed), rows(banks)
    n[:3] += 0.02 * rng.standard_normal((3, COUNT)) * np.array([[1.0], [500.0], [1.0]])
    for k in range(COUNT):
        factor = 0.01 * rng.standard_normal((UNKNOWNS, UNKNOWNS)) * np.array([1.0, 500.0, 1.0, 1.0])[:, None]
        n[COVARIANCE : COVARIANCE + TRIANGLE, k] = (factor @ factor.T)[np.tril_indices(UNKNOWNS)]
    w = rng.uniform(0.1, 1.0, COUNT)
    if same:
        w[STAYS] = same * w[:STAYS].sum() / (1.0 - same)
    n[LOG_WEIGHT] = np.log(w / w.sum())


def test_a_soil_begins_with_the_prior(filled):
    banks, _, scenario = filled
    mean, covariance = prior_of_belief(scenario)
    found, P = known(banks)
    np.testing.assert_allclose(found, mean[:4])
    np.testing.assert_allclose(P, covariance[:4, :4])
    n, sd = rows(banks), math.sqrt(covariance[3, 3])
    np.testing.assert_allclose(n[LN_K], mean[3] + np.linspace(-REACH, REACH, COUNT) * sd)
    for k in range(COUNT):
        np.testing.assert_allclose(n[OTHERS, k], conditional(mean[:4], covariance[:4, :4], n[LN_K, k])[0], rtol=1e-9)
    assert fit_is_sound(banks, 0)


def test_the_prior_of_a_node_is_that_given_its_ln_K(filled):
    banks, _, scenario = filled
    mean, covariance = (x[:4] for x in prior_of_belief(scenario))
    set_priors(banks, 0)
    n = rows(banks)
    for k in range(COUNT):
        m, P = conditional(mean, covariance[:, :4], n[LN_K, k])
        np.testing.assert_allclose(n[PRIOR_MEAN : PRIOR_MEAN + 3, k], m, rtol=1e-9)
        sd = np.sqrt(np.diag(P))
        found = square(n[PRECISION : PRECISION + 6, k]) * np.outer(sd, sd)
        np.testing.assert_allclose(found, np.linalg.inv(P / np.outer(sd, sd)), rtol=3e-3, atol=3e-3)
    # with the evidence of a Gaussian, that is the determinant of the posterior, the weights sum to one
    weight = n[LOG_PRIOR] - 0.5 * np.linalg.slogdet(square(n[PRECISION : PRECISION + 6, 0]))[1]
    assert np.exp(weight).sum() == pytest.approx(1.0, abs=0.01)


def test_the_prior_follows_what_the_sinkage_has_told(filled):
    """As a Gaussian of all six unknowns that is conditioned on a reading of two of them, by numpy."""
    banks, numbers, scenario = filled
    mean, covariance = prior_of_belief(scenario)
    renew_prior(banks, 0, numbers)
    sd = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(banks.prior[0, 0], mean[3], atol=1e-9)
    np.testing.assert_allclose(banks.prior[0, 1], covariance[3, 3], rtol=0.1)
    R = np.diag([0.2 * sd[4], 0.3 * sd[5]]) ** 2
    H = np.eye(6)[4:]
    gain = covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + R)
    m, P = mean + gain @ ([0.7 * sd[4], -0.5 * sd[5]]), covariance - gain @ H @ covariance
    s = banks.sinkage[0]
    for i, row in ((4, SINKAGE_PRESSURE), (5, SINKAGE_GAIN)):
        s[row * COUNT : (row + 1) * COUNT] = m[i]
        for j, column in ((4, SINKAGE_PRESSURE), (5, SINKAGE_GAIN)):
            s[cell(row, column) : cell(row, column) + COUNT] = P[i, j]
    renew_prior(banks, 0, numbers)
    assert banks.prior[0, 0] == pytest.approx(m[3], abs=1e-6 * sd[3])
    assert banks.prior[0, 1] == pytest.approx(P[3, 3], rel=1e-6)
    set_priors(banks, 0)
    n = rows(banks)
    for k in range(COUNT):
        of_node, Q = conditional(m[:4], P[:4, :4], n[LN_K, k])
        np.testing.assert_allclose(n[PRIOR_MEAN : PRIOR_MEAN + 3, k], of_node, rtol=1e-6, atol=1e-6)
        scale = np.sqrt(np.diag(Q))
        found = square(n[PRECISION : PRECISION + 6, k]) * np.outer(scale, scale)
        np.testing.assert_allclose(found, np.linalg.inv(Q / np.outer(scale, scale)), rtol=3e-3, atol=3e-3)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_known_is_the_mixture_of_the_nodes(filled, seed):
    banks, _, _ = filled
    learn(banks, seed)
    n = rows(banks)
    n[6] = np.arange(COUNT) + 2.0  # chi-squared
    assert gather(banks, 0) == 2.0
    w, values = np.exp(n[LOG_WEIGHT]), n[[0, 1, 2, LN_K]]
    mean = values @ w
    P = (w * (values - mean[:, None])) @ (values - mean[:, None]).T
    for k in range(COUNT):
        P[:3, :3] += w[k] * square(n[COVARIANCE : COVARIANCE + TRIANGLE, k])[:3, :3]
    found, Q = known(banks)
    np.testing.assert_allclose(found, mean, rtol=1e-9)
    np.testing.assert_allclose(Q, P, rtol=1e-9, atol=1e-12)


def test_nodes_come_closer_where_ln_K_becomes_known():
    """They move by a bounded factor each time, until they cover three standard deviations, and stay then."""
    banks, numbers = new_banks(1), filter_numbers(SCENARIOS["plain"])
    restart(banks, 0, numbers)
    truth, sd = -4.0, 0.05
    moves = 0
    for _ in range(12):
        n = rows(banks)
        before = n.copy()
        w = np.exp(-0.5 * ((n[LN_K] - truth) / sd) ** 2) + 1e-300
        n[LOG_WEIGHT] = np.log(w / w.sum())
        gather(banks, 0)
        if not spread_anew(banks, 0):
            break
        moves += 1
        assert np.ptp(rows(banks)[LN_K]) >= 0.5 * np.ptp(before[LN_K])
        for i in range(3):  # between the nodes so far
            expected = np.interp(rows(banks)[LN_K], before[LN_K], before[i])
            inside = (rows(banks)[LN_K] >= before[LN_K, 0]) & (rows(banks)[LN_K] <= before[LN_K, -1])
            np.testing.assert_allclose(rows(banks)[i, inside], expected[inside], rtol=1e-9)
    assert 0 < moves < 11
    found, P = known(banks)
    assert found[3] == pytest.approx(truth, abs=0.1 * sd) and math.sqrt(P[3, 3]) == pytest.approx(sd, rel=0.1)
    n = rows(banks)
    np.testing.assert_allclose(np.diff(n[LN_K]), np.ptp(n[LN_K]) / (COUNT - 1), rtol=1e-9)
    assert n[LN_K, 0] < truth - 2.0 * sd and n[LN_K, -1] > truth + 2.0 * sd


def test_on_a_border_one_node_is_the_soil_so_far(filled):
    banks, numbers, _ = filled
    learn(banks)
    gather(banks, 0)
    before = known(banks)
    banks.point.border[0] = 3.2
    begin_next_soil(banks, 0, numbers)
    mean, P = known(banks, old=True)
    np.testing.assert_array_equal(mean, before[0])
    np.testing.assert_array_equal(P, before[1])
    n = rows(banks)
    np.testing.assert_array_equal(n[SAME_SOIL], [0.0] * STAYS + [1.0])
    np.testing.assert_array_equal(n[BORDER_PLACE], 3.2)
    np.testing.assert_allclose(n[[0, 1, 2, LN_K], STAYS], before[0])
    fresh = np.linspace(-REACH, REACH, STAYS) * math.sqrt(numbers.prior.forces[SOIL + 9]) + numbers.prior.forces[3]
    np.testing.assert_allclose(n[LN_K, :STAYS], fresh)
    np.testing.assert_array_equal(banks.known[0, :GAUSSIAN], numbers.prior.forces)
    assert banks.point.points[0] == banks.point.bins[0] == 0.0
    set_priors(banks, 0)
    np.testing.assert_allclose(n[PRIOR_MEAN : PRIOR_MEAN + 3, STAYS], before[0][:3])
    P[OTHERS, OTHERS] += 1e-4 * numbers.prior.forces[[4, 6, 9]]  # it may differ a little
    within = conditional(before[0], P, 0.0)[1]
    sd = np.sqrt(np.diag(within))
    precision = square(n[PRECISION : PRECISION + 6, STAYS]) * np.outer(sd, sd)
    np.testing.assert_allclose(precision @ (within / np.outer(sd, sd)), np.eye(3), atol=0.01)


def test_a_soil_that_stays_the_same_is_known_as_well_as_before():
    """The node of it stands at one ln K, whose uncertainty moves the other unknowns too."""
    banks, numbers = new_banks(1), filter_numbers(SCENARIOS["library"])
    restart(banks, 0, numbers)
    before = known(banks)[1]  # of the library, in which the others are correlated with ln K
    begin_next_soil(banks, 0, numbers)
    n = rows(banks)
    n[LOG_WEIGHT] = [-700.0] * STAYS + [0.0]
    given = conditional(known(banks, old=True)[0], before, 0.0)[1]
    n[COVARIANCE : COVARIANCE + TRIANGLE, STAYS] = 0.0
    for i in range(3):
        for j in range(i + 1):
            n[COVARIANCE + below_diagonal(i, j), STAYS] = given[i, j]
    gather(banks, 0)
    sd = np.sqrt(np.diag(before))
    np.testing.assert_allclose(known(banks)[1] / np.outer(sd, sd), before / np.outer(sd, sd), atol=0.01)


@pytest.mark.parametrize(("same", "stays"), [(0.9, True), (0.1, False)])
def test_behind_a_border_the_likelier_soil_is_taken(filled, same, stays):
    banks, numbers, _ = filled
    learn(banks)
    gather(banks, 0)
    begin_next_soil(banks, 0, numbers)
    set_priors(banks, 0)
    new = rows(banks)[LN_K].copy()
    learn(banks, 1, same)
    w = np.exp(rows(banks)[LOG_WEIGHT, :STAYS])
    banks.point.points[0], banks.point.bins[0] = 5.0, 3.0
    assert leave_old_soil(banks, 0) == stays
    n = rows(banks)
    np.testing.assert_array_equal(n[SAME_SOIL], 0.0)
    assert (banks.point.points[0], banks.point.bins[0]) == (5.0, 3.0)
    old, P = known(banks, old=True)
    centre, half = n[LN_K].mean(), 0.5 * np.ptp(n[LN_K])
    if stays:
        assert centre == pytest.approx(old[3]) and half == pytest.approx(REACH * math.sqrt(P[3, 3]), rel=1e-6)
        assert banks.prior[0, 0] == old[3]
    else:
        mean = (w @ new[:STAYS]) / w.sum()
        sd = math.sqrt((w @ (new[:STAYS] - mean) ** 2) / w.sum())
        assert centre == pytest.approx(mean) and half == pytest.approx(REACH * sd, rel=1e-6)
