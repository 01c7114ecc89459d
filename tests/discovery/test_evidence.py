"""Evidence of a model under form errors: against normal densities written out, and what it promises
and detects.
"""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from soil_env.discovery import evidence
from soil_env.discovery.calibrate import Law, Sizes, sinkage_guess
from soil_env.discovery.instrument import Choice
from soil_env.discovery.search import forms
from tests.discovery.tables import NOISE, law_error, problem, table

SPEEDS = (0.03, 0.12)


@pytest.fixture(scope="module")
def data():
    return table(speeds=SPEEDS)


def density(fit, sizes):
    """Log density of the whitened table of a linear model, unknowns and form errors normal, less
    its constant.
    """
    j = fit.jacobian
    b = fit.columns(sizes)
    mean = -j @ fit.u  # of the residual, under the prior
    covariance = np.eye(j.shape[0]) + j @ j.T + b @ b.T
    return multivariate_normal.logpdf(fit.residual, mean, covariance) + 0.5 * j.shape[0] * math.log(
        2.0 * math.pi
    )


@pytest.mark.parametrize("effect", [None, "bulldozing"])
def test_the_evidence_is_the_density_of_the_table(data, effect):
    """Soil unknowns are far within their bounds; a one-sided strength has its share of the prior
    beside.
    """
    p = problem(data, np.random.default_rng(0))
    fit = p.fit(() if effect is None else (Choice(effect, 0),))
    sizes, log_prior = evidence.grid((effect,) if effect else ())
    result = evidence.weigh(p, fit)
    logs = np.array([density(fit, s) for s in sizes]) + log_prior
    allowed = np.zeros(len(sizes))
    for k, s in enumerate(sizes):
        b = fit.columns(s)
        j = fit.jacobian
        precision = np.linalg.inv(np.eye(j.shape[0]) + b @ b.T)
        cov = np.linalg.inv(np.eye(fit.u.size) + j.T @ precision @ j)
        mean = fit.u + cov @ (j.T @ precision @ fit.residual - fit.u)
        for i, unknown in enumerate(fit.unknowns):
            low, high = unknown.bounds
            at = norm(mean[i], math.sqrt(cov[i, i]))
            sd = norm()
            allowed[k] += math.log((at.cdf(high) - at.cdf(low)) / (sd.cdf(high) - sd.cdf(low)))
    assert result.log == pytest.approx(np.logaddexp.reduce(logs + allowed), abs=1e-6)
    assert sum(result.share.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("size", [0.0, 0.1])
def test_the_size_of_the_law_error_is_learned(data, size):
    rng = np.random.default_rng(1)
    result = evidence.settle(problem(data, rng, law_error(data, rng, size)), ())
    assert result.typical("law") < 0.05 if size == 0.0 else 0.05 < result.typical("law") < 0.2


def test_the_posterior_covers_the_soil_under_a_law_error(data):
    """Intervals under form error cover soils where those of noise alone do not."""
    rng = np.random.default_rng(2)
    true = {"friction_angle_deg": 31.0, "shear_modulus": 0.028, "sinkage_coefficient": 740000.0}
    inside = {"form error": 0, "noise alone": 0}
    for _ in range(15):
        p = problem(data, rng, law_error(data, rng, 0.1))
        result = evidence.settle(p, ())
        plain = p.fit()
        a, _ = plain.linearised()
        for k, unknown in enumerate(plain.unknowns):
            if unknown.name in true:
                at = unknown.at(true[unknown.name])
                inside["form error"] += abs(result.mean[k] - at) < 2.0 * math.sqrt(
                    result.covariance[k, k]
                )
                inside["noise alone"] += abs(plain.u[k] - at) < 2.0 * math.sqrt(
                    np.linalg.inv(a.T @ a)[k, k]
                )
    assert inside["form error"] >= 39 > inside["noise alone"] + 5  # of 45


@pytest.mark.parametrize("name", ["drivetrain_friction", "bulldozing", "sinkage_offset"])
def test_what_is_detectable_is_detected(data, name):
    """An effect 2.5 times as strong as the least is favoured over none; one of 0.3 times is not."""
    threshold = math.log(2.0 * 13.0)  # [nat] of evidence, against odds of 1 to 26
    p = problem(data, np.random.default_rng(4))
    base = evidence.settle(p, ())
    least = evidence.detectable(p, base, forms(p, name), threshold)
    assert 0.0 <= least.power <= 1.0
    for factor, seen in ((2.5, True), (0.3, False)):
        there = table({name: {least.parameter: factor * least.size}}, speeds=SPEEDS)
        q = problem(there, np.random.default_rng(5))
        alone = evidence.settle(q, ())
        gain = max(evidence.settle(q, (c,), alone).log for c in forms(q, name)) - alone.log
        assert (gain > threshold) == seen, (factor, gain)


def test_noise_that_is_hardly_known_says_less(data):
    """Stated at half of what it is, and known to three degrees of freedom or for sure."""
    p = problem(table({"bulldozing": {"rankine": 0.4}}, speeds=SPEEDS), np.random.default_rng(6))
    p = dataclasses.replace(p, noise=0.5 * NOISE)
    gains = []
    for p.freedom in (math.inf, 3.0):  # of the noise, set anew in each round
        base = evidence.settle(p, ())
        gains.append(evidence.settle(p, (Choice("bulldozing", 0),), base).log - base.log)
    assert 0.0 < gains[1] < 0.8 * gains[0]
    assert (
        evidence.noise_scales(math.inf) == pytest.approx([1.0])
        and evidence.noise_scales(4.0)[2] > 1.0
    )


@pytest.mark.parametrize(
    "place, pattern",
    [((0.0, 8.0, 0.0), "drawbar_pull with slip"), ((8.0, 0.0, 0.0), "sinkage with slip and speed")],
)
def test_an_anonymous_contribution_is_found_in_its_place(data, place, pattern):
    slip = data.rows.slip
    speed = data.rows.conditions[:, 0]
    wave = np.sin(7.0 * slip) * (np.sign(speed - 0.06) if "speed" in pattern else 1.0)
    p = problem(data, np.random.default_rng(7), np.outer(wave, place * NOISE))
    base = evidence.settle(p, ())
    free = evidence.anonymous(p, base)
    assert free.log > base.log + 10.0
    assert free.sizes.patterns[0][0] == pattern and free.sizes.scatter == 1.0
    assert base.sizes.patterns == () and base.sizes.free == Sizes().free


def test_rows_that_scatter_are_told_from_a_smooth_contribution(data):
    rng = np.random.default_rng(8)
    p = problem(data, rng, 3.0 * NOISE * rng.normal(size=data.y.shape))
    free = evidence.anonymous(p, evidence.settle(p, ()))
    assert free.sizes.scatter == pytest.approx(3.0, abs=1.1) and free.sizes.patterns == ()
    fit = p.fit((), sizes=Sizes(scatter=3.0))
    a, e = fit.linearised()
    assert fit.sizes.scatter == 3.0 and np.mean(e[: fit.residual.size] ** 2) == pytest.approx(
        1.1, abs=0.3
    )
    assert a[: fit.residual.size] * 3.0 == pytest.approx(fit.jacobian[:, fit.free_unknowns])


def test_beds_that_differ_are_a_pattern_of_the_stress():
    """Six beds of one run each, of which every one bears otherwise; with a bed for each row there
    is no pattern.
    """
    data = table(speeds=SPEEDS)
    bed = np.unique(
        np.stack([data.rows.load, data.rows.conditions[:, 0]]), axis=1, return_inverse=True
    )[1].ravel()
    there = dataclasses.replace(data, table=dataclasses.replace(data.table, run=bed.astype(str)))
    assert np.array_equal(there.beds, bed) and len(np.unique(data.beds)) == len(data.y)
    p = problem(there, np.random.default_rng(3))
    assert not [
        name
        for name in evidence.patterns(problem(data, np.random.default_rng(3)), p.fit())
        if "bed" in name
    ]
    fit = p.fit()
    softer = Law(p, (), sinkage_guess(fit.output)).stresses(fit.u, fit.output)[0]
    off = np.array([0.2, -0.15, 0.1, -0.2, 0.15, -0.1])[bed]
    q = problem(there, np.random.default_rng(3), softer * off[:, None])
    free = evidence.anonymous(q, evidence.settle(q, ()))
    assert free.sizes.patterns[0][0] == "normal stress with bed"


def test_a_law_of_the_freedom_of_an_effect_takes_what_has_another_form(data):
    """Contribution of bulldozing, as it is published, and turned about over slip and load."""
    there = problem(
        table({"bulldozing": {"rankine": 1.0}}, speeds=SPEEDS), np.random.default_rng(9)
    )
    added = there.data.y - data.y - NOISE * np.random.default_rng(9).normal(size=data.y.shape)
    turned = added * (1.0 + 1.5 * np.sin(9.0 * data.rows.slip + data.rows.load / 40.0))[:, None]
    for p, listed in ((there, True), (problem(data, np.random.default_rng(9), turned), False)):
        named = evidence.settle(p, (Choice("bulldozing", 0),), evidence.settle(p, ()))
        assert (named.log > evidence.in_place_of_effects(p, named).log) == listed
