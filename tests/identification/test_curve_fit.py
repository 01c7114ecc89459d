"""The fit of a soil to the traction curve: exact points, and scipy's maximum a posteriori with
Laplace's covariance.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.special import softmax

from soil_env.identification.online import curve as c, soil_nodes as n
from soil_env.identification.online.curve_fit import begin_bin, fit, share_on_border
from soil_env.identification.online.filter_bank import filter_numbers, new_banks, restart
from soil_env.identification.online.lanes.compiling import compiled_root
from soil_env.identification.online.lanes.contact import share_of_next
from soil_env.identification.online.lanes.lanes import COUNT, fill, to_array
from soil_env.parameters import Belief, load_scenario, soils
from tests.identification.observing import symmetric
from tests.identification.test_contact_slopes import reactions

SCENARIO = replace(load_scenario("mixed"), belief=Belief())
NUMBERS = filter_numbers(SCENARIO)
LOAD_N = 147.0
R = NUMBERS.radius
B = NUMBERS.width
PRIOR = NUMBERS.prior.forces[: n.SOIL].copy()
PRIOR_COVARIANCE = symmetric(NUMBERS.prior.forces[n.SOIL :])
SAND = soils()["lunar_nominal"].state(B)
TRUTH = np.array([SAND.tan_phi, SAND.cohesion, SAND.sinkage_exponent, math.log(SAND.shear_modulus)])


@compiled_root
def _feed(banks, points, border, numbers):
    misfit = 0.0
    for t in range(len(points)):
        p = banks.point
        count, changed, replaced = c.add(banks.bins[0], int(p.bins[0]), points[t], border)
        if replaced >= 0 or count > int(p.bins[0]):
            begin_bin(banks, 0, replaced if replaced >= 0 else changed, points[t, c.KEY])
        p.bins[0] = count
        p.points[0] = p.points[0] + 1.0
        misfit = fit(banks, 0, changed, replaced, numbers)
    return misfit


@compiled_root
def _fit_again(banks, numbers):
    return fit(banks, 0, 0, -1, numbers)


@compiled_root
def _share(x, spread, place, length, out):
    share, slope = share_on_border(fill(x), spread, fill(place), length)
    to_array(share, out, 0)
    to_array(slope, out, COUNT)


SLIPS = np.array([0.03, 0.08, 0.15, 0.24, 0.35, 0.47, 0.6, 0.74])  # as many as there are lanes
SINKAGES = 0.018 * (1.0 + 1.5 * SLIPS)
MEASURED = [c.SLIP, c.SINKAGE, c.PULL, c.TORQUE]
WEIGHTS = [c.SLIP_WEIGHT, c.SINKAGE_WEIGHT, c.PULL_WEIGHT, c.TORQUE_WEIGHT]


def forces(soil, sinkages, slips):
    """(pull, torque) [2, COUNT] of one soil, (tan phi, c, n, ln K)."""
    x = np.vstack([np.repeat(soil[:, None], COUNT, axis=1), sinkages, slips])
    return reactions(x, LOAD_N, R, B)[:2, 0]


def noisy_points(rng, soil=TRUTH, sd=(4e-3, 3e-4, 0.25, 0.04)):
    """Points [COUNT, FIELDS] of a soil as measured; `sd` of slip, sinkage [m], pull [N] and torque
    [N m].
    """
    points = np.zeros((COUNT, c.FIELDS))
    exact = np.vstack([SLIPS, SINKAGES, forces(soil, SINKAGES, SLIPS)]).T
    points[:, MEASURED] = exact + rng.standard_normal((COUNT, 4)) * sd
    points[:, WEIGHTS] = 1.0 / np.square(sd)
    points[:, [c.READINGS, c.LOAD, c.PLACE, c.SPREAD]] = 8.0, LOAD_N, 0.1, 0.02
    points[:, c.KEY] = SLIPS
    return points


class Fitted:
    """A filter whose curve has been fed with points."""

    def __init__(self, points, again=25):
        self.banks = new_banks(1)
        restart(self.banks, 0, NUMBERS)
        self.banks.point.form_error[0] = NUMBERS.model_error
        self.misfit = _feed(self.banks, points, NUMBERS.border, NUMBERS)
        for _ in range(again):
            self.misfit = _fit_again(self.banks, NUMBERS)
        self.nodes = self.banks.nodes[0].reshape(n.NODE_ROWS, COUNT)
        self.mean = self.banks.known[0, : n.SOIL]
        self.covariance = symmetric(self.banks.known[0, n.SOIL : n.GAUSSIAN])


SCALE = np.sqrt(np.diag(PRIOR_COVARIANCE))
BY_LN_K = PRIOR_COVARIANCE[:3, 3] / PRIOR_COVARIANCE[3, 3]
GIVEN_LN_K = np.linalg.cholesky(
    PRIOR_COVARIANCE[:3, :3] - np.outer(BY_LN_K, PRIOR_COVARIANCE[:3, 3])
)


def residual(x, points, ln_K):
    """Residuals of prior, slips, sinkages, pulls and torques; x in standard deviations of the prior
    and of the bins.
    """
    away = np.append(SCALE[:3] * x[:3], ln_K - PRIOR[3])
    of_bins = x[3:].reshape(2, COUNT)
    measured = points[:, MEASURED].T
    weights = points[:, WEIGHTS].T
    slips, sinkages = measured[:2] + of_bins / np.sqrt(weights[:2])
    form = NUMBERS.model_error * LOAD_N * np.array([[1.0], [R]])
    off = (measured[2:] - forces(PRIOR + away, sinkages, slips)) / np.sqrt(
        1.0 / weights[2:] + form**2
    )
    prior = np.linalg.solve(GIVEN_LN_K, away[:3] - BY_LN_K * away[3])
    return np.concatenate([prior, of_bins.ravel(), off.ravel()])


def judge(points, ln_K):
    """(mean, covariance, chi-squared) of tan phi, cohesion and exponent at ln K by scipy.

    Slip and sinkage of each bin are unknowns too.
    """
    start = np.zeros(3 + 2 * COUNT)
    found = least_squares(residual, start, args=(points, ln_K), xtol=1e-12, ftol=1e-12, gtol=1e-10)
    covariance = np.linalg.inv(found.jac.T @ found.jac)[:3, :3] * np.outer(SCALE[:3], SCALE[:3])
    return PRIOR[:3] + SCALE[:3] * found.x[:3], covariance, 2.0 * found.cost


@pytest.mark.parametrize("seed", range(3))
def test_each_node_is_the_least_squares_solution_of_scipy(seed):
    """At its ln K: the other unknowns, their covariance and chi-squared; the weights are those of
    the evidence.
    """
    points = noisy_points(np.random.default_rng(seed))
    fitted = Fitted(points)
    log_weight = np.empty(COUNT)
    nodes = fitted.nodes
    likely = np.exp(nodes[n.LOG_WEIGHT]) > 2e-3
    assert likely.sum() >= 4
    for k in range(COUNT):
        mean, covariance, chi = judge(points, nodes[n.LN_K, k])
        away = (nodes[n.LN_K, k] - PRIOR[3]) / SCALE[3]
        log_weight[k] = -0.5 * away**2 - 0.5 * chi + 0.5 * np.linalg.slogdet(covariance)[1]
        if likely[k]:
            sd = np.sqrt(np.diag(covariance))
            found = symmetric(nodes[n.COVARIANCE : n.COVARIANCE + n.TRIANGLE, k])[:3, :3]
            assert np.all(np.abs(nodes[:3, k] - mean) < 0.15 * sd), (k, (nodes[:3, k] - mean) / sd)
            np.testing.assert_allclose(
                found / np.outer(sd, sd), covariance / np.outer(sd, sd), atol=0.08
            )
            assert nodes[n.COST, k] == pytest.approx(chi, rel=0.03, abs=0.15)
    np.testing.assert_allclose(np.exp(nodes[n.LOG_WEIGHT]), softmax(log_weight), atol=0.03)
    assert fitted.misfit == pytest.approx(nodes[n.COST].min())


def test_the_share_on_a_border_and_its_slope():
    """The mean of the terrain's share over two places; the slope by the place of the border is that
    of differences.
    """
    spread = 0.02
    length = 0.3

    def share(x, place):
        out = np.zeros(2 * COUNT)
        _share(x, spread, place, length, out)
        return out[[0, COUNT]]

    for place in (-0.05, 0.0, 0.03):
        for x in np.linspace(-0.2, 0.2, 9):
            found, slope = share(x, place)
            of_terrain = 0.5 * sum(
                share_of_next((x + s - place) / length)[0] for s in (-spread, spread)
            )
            assert found == pytest.approx(min(max(of_terrain, 1e-4), 1.0 - 1e-4), abs=1e-12)
            if 1e-3 < found < 1.0 - 1e-3:
                rise = share(x, place + 1e-6)[0] - share(x, place - 1e-6)[0]
                assert slope == pytest.approx(rise / 2e-6, rel=1e-4, abs=1e-6)
