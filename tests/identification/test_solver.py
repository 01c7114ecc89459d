"""Identification: derivatives, an independent judge, recovery of soils, calibrated errors, outcomes, bad input."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from soil_env.identification import (
    LOWER,
    UPPER,
    Reading,
    Status,
    generalized_newton_raphson,
    newton_raphson,
    predict,
)
from soil_env.parameters import Soil
from soil_env.terramechanics.contact import (
    entry_angle,
)
from tests.terramechanics import reference

R, B, N, C = 0.6274, 0.1524, 0.47, 690.0  # the wheel and soil of the source paper
GAUSS = Reading(C, N, R, B)
READINGS = {
    "gauss": GAUSS,
    "gauss, paper resistance": GAUSS._replace(paper_resistance=True),
    "simpson": GAUSS._replace(simpson=2),
    "simpson, paper resistance": GAUSS._replace(simpson=2, paper_resistance=True),
}
SOIL = np.array([math.radians(33.3), math.log(0.0381), math.log(583792.0)])
SD = (15.0, 30.0, 10.0)  # N, N, N m


def unknowns(soil):
    """(phi, ln K, ln S) of a `Soil`."""
    return np.array([math.radians(soil.friction_angle_deg), math.log(soil.shear_modulus), math.log(soil.lumped(B))])


def soil_of(x):
    return Soil(math.degrees(x[0]), C, math.exp(x[1]), N, sinkage_coefficient=math.exp(x[2]))


def prediction(x, slip, sinkage, reading=GAUSS, dig_ratio=1.0):
    """(channels [3], Jacobian [3, 4]) at one point."""
    out, jacobian = np.empty(3), np.empty((3, 4))
    predict(np.asarray(x, dtype=float), slip, sinkage, dig_ratio, reading, out, jacobian)
    return out, jacobian


def measured(x, slip, sinkage, reading=GAUSS):
    """Channels [3, M] at many points."""
    return np.array([prediction(x, s, z, reading)[0] for s, z in zip(slip, sinkage, strict=True)]).T


def spread_points(rng, count):
    """Slips and sinkages [count] that tell the unknowns apart."""
    return np.linspace(0.03, 0.9, count), rng.uniform(0.05, 0.2, count)


# --- the model --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reading", READINGS.values(), ids=READINGS)
@pytest.mark.parametrize("seed", range(10))
def test_jacobian_against_central_differences(seed, reading):
    rng = np.random.default_rng(seed)
    for _ in range(5):
        x = rng.uniform([0.1, math.log(0.005), math.log(1e4)], [1.2, math.log(0.2), math.log(1e8)])
        slip, sinkage, dig = rng.uniform(-0.9, 1.0), rng.uniform(0.02, 0.8) * R, rng.uniform(1.0, 3.0)
        at, found = prediction(x, slip, sinkage, reading, dig)

        sides = []
        for d in 1e-5 * np.vstack([np.eye(4), -np.eye(4)]):  # by phi, ln K, ln S and cohesion [kPa]
            changed = reading._replace(cohesion=C + 1e3 * d[3])
            sides.append(prediction(x + d[:3], slip, sinkage, changed, dig)[0])
        expected = (np.array(sides[:4]) - sides[4:]).T / 2e-5
        found[:, 3] *= 1e3
        size = np.maximum(np.abs(found).max(axis=1), np.abs(at))[:, None]
        np.testing.assert_allclose(found / size, expected / size, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("paper", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_prediction_agrees_with_quadrature(seed, paper):
    rng = np.random.default_rng(seed)
    x = rng.uniform([0.2, math.log(0.01), math.log(1e5)], [0.8, math.log(0.2), math.log(1e7)])
    slip, sinkage, dig = rng.uniform(0.0, 1.0), rng.uniform(0.03, 0.5) * R, rng.uniform(1.0, 3.0)
    # a hole z/z_w times deeper bears like soil with S (z/z_w)^-n
    ground = reference.Ground(math.degrees(x[0]), C, math.exp(x[1]), math.exp(x[2]) * dig**-N, N)
    judge = reference.forces(ground, slip, entry_angle(sinkage, R), R, B)
    out, _ = prediction(x, slip, sinkage, GAUSS._replace(paper_resistance=paper), dig)
    pull = judge.drawbar_pull_paper if paper else judge.drawbar_pull
    assert np.abs(out - [pull, judge.load, judge.torque])[:2].max() < 1e-4 * judge.scale
    assert abs(out[2] - judge.torque) < 1e-4 * judge.scale * R
    assert abs(judge.drawbar_pull - judge.drawbar_pull_paper) > 1e-2 * judge.scale  # the readings can be told apart


# --- three points -----------------------------------------------------------------------------------------------------


def three_points(rng, reading):
    """(unknowns, slips, sinkages, drawbar pulls) of a random soil that three points determine well."""
    while True:
        x = rng.uniform([0.35, math.log(0.02), math.log(2e5)], [0.73, math.log(0.07), math.log(2e6)])
        slip = np.array([rng.uniform(0.03, 0.12), rng.uniform(0.2, 0.4), rng.uniform(0.6, 0.95)])
        sinkage = rng.uniform(0.05, 0.2, 3)
        jacobian = np.array([prediction(x, s, z, reading)[1][0, :3] for s, z in zip(slip, sinkage, strict=True)])
        if np.linalg.cond(jacobian) < 30.0:
            return x, slip, sinkage, measured(x, slip, sinkage, reading)[0]


@pytest.mark.parametrize("name", ["gauss", "simpson, paper resistance"])
def test_three_exact_points_give_the_soil_from_anywhere_in_the_box(name):
    """200 soils, each from a random guess in the box of the paper's Table 4."""
    rng, reading = np.random.default_rng(1), READINGS[name]
    alone = right = 0
    for _ in range(200):
        x, slip, sinkage, pull = three_points(rng, reading)
        estimate = newton_raphson(slip, sinkage, pull, reading=reading, guess=any_guess(rng))
        alone += estimate.status == Status.CONVERGED
        right += np.abs(unknowns(estimate.soil) - x).max() < 1e-4
        if estimate.status == Status.CONVERGED:
            assert np.abs(unknowns(estimate.soil) - x).max() < 1e-4
        else:
            assert_two_exact(estimate, slip, sinkage, pull, reading)
    assert alone >= 180 and right >= 198


def any_guess(rng):
    """A soil from the box of the paper's Table 4."""
    return Soil(rng.uniform(5.0, 89.0), C, rng.uniform(0.015, 0.089), N,
                sinkage_coefficient=10.0 ** rng.uniform(math.log10(7e4), math.log10(3.1e12)))  # fmt: skip


def assert_two_exact(estimate, slip, sinkage, pull, reading):
    """Both soils of an ambiguous estimate give the drawbar pulls, and they differ."""
    assert estimate.status == Status.AMBIGUOUS and estimate.converged
    for soil in (estimate.soil, estimate.other):
        np.testing.assert_allclose(measured(unknowns(soil), slip, sinkage, reading)[0], pull, rtol=1e-5, atol=1e-3)
    assert abs(math.log(estimate.soil.shear_modulus / estimate.other.shear_modulus)) > 1e-3


@pytest.mark.parametrize("name", READINGS)
def test_a_second_exact_soil_is_told_whichever_is_found(name):
    """At sinkages alike, as under one load, two soils often give the same three drawbar pulls."""
    rng, reading = np.random.default_rng(2), READINGS[name]
    problems = {Status.CONVERGED: 0, Status.AMBIGUOUS: 0}
    for _ in range(150):
        x = rng.uniform([0.3, math.log(0.015), math.log(3e5)], [0.8, math.log(0.089), math.log(1e7)])
        slip, sinkage = np.sort(rng.uniform(0.03, 0.8, 3)), rng.uniform(0.09, 0.13, 3)
        jacobian = np.array([prediction(x, s, z, reading)[1][0, :3] for s, z in zip(slip, sinkage, strict=True)])
        pull = measured(x, slip, sinkage, reading)[0]
        if np.linalg.cond(jacobian) > 300.0:
            continue
        found = [newton_raphson(slip, sinkage, pull, reading=reading, guess=any_guess(rng)) for _ in range(5)]
        found = [e for e in found if e.converged]
        assert len({e.status for e in found}) == 1
        problems[found[0].status] += 1
        for e in found:
            if e.status == Status.AMBIGUOUS:
                assert_two_exact(e, slip, sinkage, pull, reading)
            else:
                assert np.abs(unknowns(e.soil) - x).max() < 1e-4
    assert min(problems.values()) >= 3


def test_convergence_is_quadratic():
    """Newton's method from nearby needs a handful of iterations."""
    slip, sinkage = np.array([0.08, 0.3, 0.8]), np.array([0.08, 0.15, 0.1])
    estimate = newton_raphson(
        slip, sinkage, measured(SOIL, slip, sinkage)[0], reading=GAUSS, guess=soil_of(SOIL + [0.02, -0.05, 0.05])
    )
    assert estimate.converged and estimate.iterations <= 6
    assert estimate.residual < 1e-4 and 1.0 < estimate.condition < 1e4
    np.testing.assert_allclose(unknowns(estimate.soil), SOIL, atol=1e-7)


# --- many points ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("channels", ["drawbar_pull", "load", "drawbar_pull load", "drawbar_pull load torque"])
def test_errors_are_calibrated(channels):
    """300 noisy data sets: unbiased within the error of the mean, chi-squared of three, 95 % intervals that hold."""
    rng = np.random.default_rng(2)
    slip, sinkage = spread_points(rng, 20)
    exact = measured(SOIL, slip, sinkage)
    names = ("drawbar_pull", "load", "torque")
    sd = 0.2 * np.array(SD)
    errors, chi, residuals = [], [], []
    for _ in range(300):
        noisy = exact + sd[:, None] * rng.standard_normal(exact.shape)
        data = {name: noisy[i] for i, name in enumerate(names) if name in channels.split()}
        e = generalized_newton_raphson(slip, sinkage, **data, reading=GAUSS, guess=soil_of(SOIL), sd=tuple(sd))
        assert e.status == Status.CONVERGED
        error = unknowns(e.soil) - SOIL
        errors.append(error / np.sqrt(np.diag(e.covariance)))
        chi.append(error @ np.linalg.solve(e.covariance, error))
        residuals.append(e.residual)
    errors = np.array(errors)
    assert np.abs(errors.mean(axis=0)).max() < 4.0 / math.sqrt(300)
    assert np.all(np.abs(errors.std(axis=0) - 1.0) < 0.15)
    coverage = np.mean(np.abs(errors) < 1.96, axis=0)
    assert np.all(coverage > 0.90) and np.all(coverage < 0.99), coverage
    assert 0.90 < np.mean(np.array(chi) < 7.815) < 0.99  # chi-squared of 3, 95 %
    measurements = 20 * len(channels.split())
    assert np.mean(np.square(residuals)) == pytest.approx(1.0 - 3.0 / measurements, abs=0.05)


@pytest.mark.parametrize("channel", ["drawbar_pull", "load"])
def test_precise_data_converge_too(channel):
    """With noise near the rounding of the cost the iteration must still know that it has arrived."""
    rng = np.random.default_rng(2)
    slip, sinkage = spread_points(rng, 20)
    exact, sd = measured(SOIL, slip, sinkage), np.array(SD) * 0.02
    for _ in range(300):
        noisy = exact + sd[:, None] * rng.standard_normal(exact.shape)
        data = {channel: noisy[("drawbar_pull", "load").index(channel)]}
        e = generalized_newton_raphson(slip, sinkage, **data, reading=GAUSS, guess=soil_of(SOIL), sd=tuple(sd))
        assert e.status == Status.CONVERGED


def test_more_channels_say_more():
    rng = np.random.default_rng(3)
    slip, sinkage = spread_points(rng, 12)
    pull, load, torque = measured(SOIL, slip, sinkage)
    sets = ({"drawbar_pull": pull}, {"drawbar_pull": pull, "load": load},
            {"drawbar_pull": pull, "load": load, "torque": torque})  # fmt: skip
    found = [
        generalized_newton_raphson(slip, sinkage, **data, reading=GAUSS, guess=soil_of(SOIL), sd=SD) for data in sets
    ]
    sds = np.array([np.sqrt(np.diag(e.covariance)) for e in found])
    assert np.all(sds[1] < sds[0]) and np.all(sds[2] < sds[1])


def test_a_wrong_torque_moves_the_estimate_and_the_residual():
    rng = np.random.default_rng(4)
    slip, sinkage = spread_points(rng, 12)
    pull, load, torque = measured(SOIL, slip, sinkage)
    at = {"reading": GAUSS, "guess": soil_of(SOIL), "sd": SD}
    right = generalized_newton_raphson(slip, sinkage, pull, load, torque, **at)
    wrong = generalized_newton_raphson(slip, sinkage, pull, load, 1.2 * torque, **at)
    np.testing.assert_allclose(unknowns(right.soil), SOIL, atol=1e-6)
    assert np.abs(unknowns(wrong.soil) - SOIL).max() > 0.02 and wrong.residual > right.residual + 1.0


def test_the_dig_ratio_is_used():
    """A wheel that stands deeper by digging looks as if on softer soil: S times ratio^-n."""
    slip, sinkage = spread_points(np.random.default_rng(5), 12)
    ratio = np.linspace(1.0, 3.0, 12)
    data = np.array([prediction(SOIL, *p)[0] for p in zip(slip, sinkage, [GAUSS] * 12, ratio, strict=True)]).T
    at = {"reading": GAUSS, "guess": soil_of(SOIL), "sd": SD}
    right = generalized_newton_raphson(slip, sinkage, *data, dig_ratio=ratio, **at)
    np.testing.assert_allclose(unknowns(right.soil), SOIL, atol=1e-6)
    wrong = generalized_newton_raphson(slip, sinkage, *data, **at)
    assert unknowns(wrong.soil)[2] < SOIL[2] - 0.05


def test_weights_count():
    """Two channels that contradict each other: the one with the smaller standard deviation wins."""
    slip, sinkage = spread_points(np.random.default_rng(6), 12)
    other = SOIL + [0.0, 0.0, 0.2]
    pull, load = measured(SOIL, slip, sinkage)[0], measured(other, slip, sinkage)[1]
    for sd, winner in (((0.1, 1e3, 1.0), SOIL), ((1e4, 0.1, 1.0), other)):
        e = generalized_newton_raphson(slip, sinkage, pull, load, reading=GAUSS, guess=soil_of(SOIL), sd=sd)
        assert abs(unknowns(e.soil)[2] - winner[2]) < 0.01


# --- outcomes ---------------------------------------------------------------------------------------------------------


def test_no_data():
    for count in (0, 1, 2):
        points = [[x] * count for x in (0.2, 0.1, 900.0)]
        e = generalized_newton_raphson(*points, reading=GAUSS, guess=soil_of(SOIL))
        assert e.status == Status.NO_DATA and e.soil is None and not e.covariance.any()
    one = generalized_newton_raphson([0.2], [0.1], [900.0], [9000.0], [2e3], reading=GAUSS, guess=soil_of(SOIL))
    assert one.status != Status.NO_DATA  # three values at one point


@pytest.mark.parametrize("count", [3, 10])
def test_not_excited_at_one_slip_and_sinkage(count):
    slip, sinkage = np.full(count, 0.2), np.full(count, 0.1)
    pull = measured(SOIL, slip, sinkage)[0]
    e = generalized_newton_raphson(slip, sinkage, pull, reading=GAUSS, guess=soil_of(SOIL + [0.05, 0.1, 0.1]))
    assert e.status == Status.NOT_EXCITED
    assert not e.covariance.any() and e.condition > 1e5 and np.all(np.isfinite(unknowns(e.soil)))


@pytest.mark.parametrize(("unknown", "beyond", "bound"), [
    (0, math.radians(0.2), LOWER), (1, math.log(2.0), UPPER), (2, math.log(100.0), LOWER), (2, math.log(1e14), UPPER),
])  # fmt: skip
def test_at_bound(unknown, beyond, bound):
    """Exact measurements of a soil outside the bounds end on the bound, and say so."""
    x = SOIL.copy()
    x[unknown] = beyond
    slip, sinkage = spread_points(np.random.default_rng(7), 12)
    data = measured(x, slip, sinkage)
    e = generalized_newton_raphson(slip, sinkage, *data, reading=GAUSS, guess=soil_of(SOIL), sd=SD)
    assert e.status == Status.AT_BOUND
    assert unknowns(e.soil)[unknown] == pytest.approx(bound[unknown], abs=1e-9)


def test_too_few_iterations_are_not_called_converged():
    slip, sinkage = spread_points(np.random.default_rng(8), 12)
    data = measured(SOIL, slip, sinkage)
    far = Soil(70.0, C, 0.08, N, sinkage_coefficient=1e11)
    at = {"reading": GAUSS, "guess": far, "sd": SD}
    assert generalized_newton_raphson(slip, sinkage, *data, max_iterations=2, **at).status == Status.DIVERGED
    assert generalized_newton_raphson(slip, sinkage, *data, **at).status == Status.CONVERGED


@settings(max_examples=150, deadline=None)
@given(data=st.data(), count=st.integers(3, 8), name=st.sampled_from(sorted(READINGS)))
def test_garbage_gives_data_and_never_nan(data, count, name):
    def draw(low, high):
        return data.draw(st.lists(st.floats(low, high), min_size=count, max_size=count))

    slip, sinkage = draw(-1.0, 1.0), draw(1e-6, R)
    channels = [draw(-1e7, 1e7) if data.draw(st.booleans()) else None for _ in range(2)]
    guess = Soil(data.draw(st.floats(0.0, 89.9)), C, data.draw(st.floats(1e-4, 0.3)), N,
                 sinkage_coefficient=10.0 ** data.draw(st.floats(0.0, 13.0)))  # fmt: skip
    e = generalized_newton_raphson(slip, sinkage, draw(-1e7, 1e7), *channels, reading=READINGS[name], guess=guess)
    assert isinstance(e.status, Status) and e.status != Status.NO_DATA
    x = unknowns(e.soil)
    assert np.all(np.isfinite(x)) and np.all(x >= LOWER - 1e-9) and np.all(x <= UPPER + 1e-9)
    assert np.all(np.isfinite(e.covariance)) and np.all(np.diag(e.covariance) >= 0.0)
    assert math.isfinite(e.residual) and e.condition >= 1.0
    assert e.iterations <= 100 + 18 * 40  # with every restart


# --- bad input --------------------------------------------------------------------------------------------------------

GOOD = {"slip": [0.1, 0.3, 0.6], "sinkage": [0.1, 0.12, 0.15], "drawbar_pull": [500.0, 900.0, 1200.0]}


@pytest.mark.parametrize(("change", "words"), [
    ({"sinkage": [0.1, 0.1]}, "sinkage: expected 3 values, got shape (2,)"),
    ({"dig_ratio": [1.0, 0.0, 1.0]}, "dig_ratio"),
    ({"slip": [0.1, math.nan, 0.2]}, "slip: expected finite values, got nan in row 1"),
    ({"slip": [0.1, 0.2, 1.5]}, "slip = 1.5: expected values in [-1, 1]"),
    ({"sinkage": [0.1, 0.2, -0.01]}, "sinkage: expected values in (0, 0.6274] m"),
    ({"drawbar_pull": None}, "at least one of drawbar_pull, load, torque"),
    ({"sd": (0.0, 1.0, 1.0)}, "sd = (0.0, 1.0, 1.0): expected positive standard deviations"),
])  # fmt: skip
def test_bad_input_is_named(change, words):
    with pytest.raises(ValueError) as raised:
        generalized_newton_raphson(**{**GOOD, **change}, reading=GAUSS, guess=soil_of(SOIL))
    assert words in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.parametrize("count", [2, 4])
def test_newton_raphson_wants_three_points(count):
    with pytest.raises(ValueError, match=f"expected three points, got {count}"):
        newton_raphson([0.1] * count, [0.1] * count, [1.0] * count, reading=GAUSS, guess=soil_of(SOIL))


@pytest.mark.parametrize("field, value", [("radius", -0.6), ("cohesion", math.nan)])
def test_refuses_a_reading_that_cannot_be(field, value):
    reading = Reading(3000.0, 0.47, 0.6274, 0.1524)._replace(**{field: value})
    guess = Soil(30.0, 3000.0, 0.03, 0.47, sinkage_coefficient=5e5)
    with pytest.raises(ValueError, match=f"reading.{field} = {value}: expected"):
        newton_raphson([0.1, 0.2, 0.5], [0.12, 0.12, 0.12], [500.0, 900.0, 1500.0], reading=reading, guess=guess)
