"""The online solve of five unknowns against scipy, and the digging that it is told of against the law of sinkage."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from soil_env.identification import LOWER, UPPER, Status, predict
from soil_env.identification import online as identifier
from soil_env.identification.digging import DIGGING, close_point, note, roll
from soil_env.identification.joint import GAIN, SIZE, solve_joint
from soil_env.identification.point import (
    DIG_RATIO,
    DIG_RESPONSE,
    DRAWBAR_PULL,
    POINT_SIZE,
    SINKAGE,
    SLIP,
    WEIGHTS,
    Reading,
    weigh,
)
from soil_env.identification.solver import BLOCK, prepare
from soil_env.parameters import load_scenario
from soil_env.terramechanics.effects import excavation_rate

NUMBERS = identifier.identifier_numbers(load_scenario("mixed"))
READING = NUMBERS.reading
NOISE = np.square([2.0, 2.0, 0.3])


def predicted(x, row):
    """(drawbar pull, load, torque) of a point for the five unknowns."""
    out, jacobian = np.empty(3), np.empty((3, 4))
    reading = Reading(float(x[3]), READING.exponent, READING.radius, READING.width)
    predict(np.array(x[:3]), row[SLIP], row[SINKAGE], row[DIG_RATIO] + math.exp(x[GAIN]) * row[DIG_RESPONSE], reading,
            out, jacobian)  # fmt: skip
    return out


def whitening(row):
    w = row[WEIGHTS : WEIGHTS + 6]
    return np.array([[w[0], 0.0, 0.0], [w[1], w[2], 0.0], [w[3], w[4], w[5]]])


def window(rng, count=8):
    """(points, true unknowns): a soil from the prior, points at random slips and digging, with noise."""
    truth = NUMBERS.prior + rng.standard_normal(SIZE) / np.sqrt(NUMBERS.precision)
    truth[3] = abs(truth[3])
    points = np.zeros((identifier.WINDOW, POINT_SIZE))
    for row in points[:count]:
        row[[SLIP, SINKAGE, DIG_RATIO, DIG_RESPONSE]] = rng.uniform([0.02, 0.01, 0.8, 0.1], [0.7, 0.05, 1.1, 1.2])
        row[DRAWBAR_PULL : DRAWBAR_PULL + 3] = predicted(truth, row) + np.sqrt(NOISE) * rng.standard_normal(3)
        weigh(row, truth[:3], NOISE, 0.0, 0.0, READING, 0.0, math.exp(truth[GAIN]))
    return points, truth


def solved(points, count, start=None):
    """(x, status, covariance) by `solve_joint`."""
    x, covariance, work = (NUMBERS.prior if start is None else start).copy(), np.zeros((SIZE, SIZE)), np.empty(BLOCK)
    prepare(points, count, READING, work)
    status = solve_joint(x, NUMBERS.prior, NUMBERS.precision, READING, 30, 1e-7, covariance, work)
    return x, Status(status), covariance


def residual(x, points):
    rows = [whitening(p) @ (predicted(x, p) - p[DRAWBAR_PULL : DRAWBAR_PULL + 3]) for p in points]
    return np.concatenate([*rows, np.sqrt(NUMBERS.precision) * (x - NUMBERS.prior)])


@pytest.mark.parametrize("seed", range(12))
def test_it_is_the_least_squares_solution_of_scipy(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 9))
    points, _ = window(rng, count)
    x, status, covariance = solved(points, count)
    assert status == Status.CONVERGED
    scale = 1.0 / np.sqrt(NUMBERS.precision)
    bounds = np.append(LOWER, [0.0, -3.0]), np.append(UPPER, [2e5, 3.0])
    tight = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-12)
    start = np.clip(NUMBERS.prior, *bounds)
    rival = least_squares(residual, start, x_scale=scale, bounds=bounds, args=(points[:count],), **tight)
    cost = 0.5 * np.sum(residual(x, points[:count]) ** 2)
    assert cost <= rival.cost * (1.0 + 1e-6) + 1e-9
    np.testing.assert_allclose(x / scale, rival.x / scale, atol=2e-3)
    # covariance: inverse of J^T J by central differences
    J = np.empty((3 * count + SIZE, SIZE))
    for i in range(SIZE):
        h = 1e-5 * scale[i]
        J[:, i] = (residual(x + h * np.eye(SIZE)[i], points[:count]) - residual(x - h * np.eye(SIZE)[i], points[:count])
                   ) / (2.0 * h)  # fmt: skip
    np.testing.assert_allclose(covariance / np.outer(scale, scale), np.linalg.inv(J.T @ J) / np.outer(scale, scale),
                               atol=2e-5)  # fmt: skip


def test_its_errors_are_as_large_as_it_says():
    """200 soils of the prior: normalised errors of all five unknowns have about unit variance."""
    rng, errors = np.random.default_rng(0), []
    for _ in range(200):
        points, truth = window(rng)
        x, status, covariance = solved(points, 8)
        if status == Status.CONVERGED and x[3] > 0.0:
            errors.append((x - truth) / np.sqrt(np.diag(covariance)))
    assert len(errors) > 120
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(spread > 0.75) and np.all(spread < 1.25), spread


def test_garbage_gives_a_status_and_finite_numbers():
    points, _ = window(np.random.default_rng(0))
    points[:, DRAWBAR_PULL : DRAWBAR_PULL + 3] *= -1e5
    x, status, covariance = solved(points, 8)
    assert status in (Status.DIVERGED, Status.AT_BOUND, Status.CONVERGED, Status.NOT_EXCITED)
    assert np.all(np.isfinite(x)) and np.all(np.isfinite(covariance))


@pytest.mark.parametrize("seed", range(6))
def test_a_point_contradicts_by_its_error_and_that_of_the_estimate(seed):
    """`contradicts` against u^T (I + J C J^T)^-1 u by numpy, J by differences."""
    rng = np.random.default_rng(seed)
    points, truth = window(rng)
    x, _, covariance = solved(points, 7)
    row, gain = points[7], math.exp(x[GAIN])
    reading = Reading(float(x[3]), READING.exponent, READING.radius, READING.width)
    for off in np.linspace(0.0, 12.0, 13):
        moved = row.copy()
        moved[DRAWBAR_PULL] += off
        y = weigh(moved, x[:3], NOISE, 0.005, 0.0, reading, 0.05, gain)
        W, J = whitening(moved), np.empty((3, SIZE))
        for i in range(SIZE):
            h = 1e-5 / np.sqrt(NUMBERS.precision[i]) * np.eye(SIZE)[i]
            J[:, i] = W @ (predicted(x + h, moved) - predicted(x - h, moved)) / (2.0 * h[i])
        u = W @ (moved[DRAWBAR_PULL : DRAWBAR_PULL + 3] - predicted(x, moved))
        chi_squared = u @ np.linalg.solve(np.eye(3) + J @ covariance @ J.T, u)
        if abs(chi_squared - identifier.CONTRADICTION) > 1e-3:
            found = identifier.contradicts(moved, y, gain, READING.exponent, covariance)
            assert found == (chi_squared > identifier.CONTRADICTION)


# --- digging ----------------------------------------------------------------------------------------------------------

DT, LENGTH, RECOVERY, NOMINAL = 0.05, 0.15, 0.5, 2.0


def drive(speeds, z0, bearing, gain):
    """(sinkage at the end of each period) by the law of sinkage, integrated by scipy over constant speeds."""
    z, out = z0, []
    for (speed, slip_speed), z_w in zip(speeds, bearing, strict=True):
        a, b = excavation_rate(speed, slip_speed, gain, RECOVERY, LENGTH)
        z = solve_ivp(lambda _, y, a=a, b=b, z_w=z_w: b * z_w - a * y, (0.0, DT), [z], rtol=1e-9, atol=1e-12).y[0, -1]
        out.append(z)
    return out


def observed(speeds, sinkages):
    """(R0, R1) of one point a reading."""
    memory, out = np.zeros(DIGGING), []
    for (speed, slip_speed), z in zip(speeds, sinkages, strict=True):
        roll(memory, speed, slip_speed, DT, NOMINAL, RECOVERY, LENGTH)
        note(memory)
        out.append(close_point(memory, 1.0, z, 0.001)[:2])
    return np.array(out)


@settings(max_examples=25, deadline=None)
@given(gain=st.floats(0.2, 6.0), seed=st.integers(0, 10**6))
def test_the_digging_ratio_is_affine_in_the_gain(gain, seed):
    """From rest on one soil, whatever the speeds: z/z_w = R0 + (gain/nominal) R1, exactly."""
    speeds = np.random.default_rng(seed).uniform([0.05, 0.0], [0.4, 0.4], (25, 2))
    z = drive(speeds, 0.02, np.full(25, 0.02), gain)
    r = observed(speeds, z)
    np.testing.assert_allclose(r[:, 0] + gain / NOMINAL * r[:, 1], np.array(z) / 0.02, rtol=1e-6)


@settings(max_examples=25, deadline=None)
@given(gain=st.floats(0.2, 6.0), jump=st.floats(0.5, 2.0), seed=st.integers(0, 10**6))
def test_the_ratio_is_right_again_a_little_behind_a_border(gain, jump, seed):
    """The wheel comes onto another soil with the depth of the last: right once the place of reference lies behind."""
    speeds = np.random.default_rng(seed).uniform([0.1, 0.0], [0.4, 0.2], (60, 2))
    bearing = np.where(np.arange(60) < 20, 0.02, 0.02 * jump)
    z = drive(speeds, 0.02, bearing, gain)
    r = observed(speeds, z)
    ratio = r[:, 0] + gain / NOMINAL * r[:, 1]
    np.testing.assert_allclose(ratio[40:], np.array(z)[40:] / bearing[40:], rtol=1e-4)


def test_noise_of_the_sinkages_is_propagated():
    """Scatter of the ratio under noisy sinkages against the error that is told of."""
    rng, speeds = np.random.default_rng(0), np.tile([0.2, 0.1], (12, 1))
    z = np.array(drive(speeds, 0.02, np.full(12, 0.02), NOMINAL))
    ratios = []
    for _ in range(4000):
        memory, noisy = np.zeros(DIGGING), z + 3e-4 * rng.standard_normal(12)
        for (speed, slip_speed), depth in zip(speeds, noisy, strict=True):
            roll(memory, speed, slip_speed, DT, NOMINAL, RECOVERY, LENGTH)
            note(memory)
            r0, r1, sd = close_point(memory, 1.0, depth, 3e-4)
        ratios.append((math.log(r0 + r1), sd))
    ratios = np.array(ratios)
    assert ratios[:, 0].std() == pytest.approx(ratios[:, 1].mean(), rel=0.15)
