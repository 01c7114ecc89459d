"""The window of the online identifier: its least squares against scipy, its digging against the law of sinkage."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import optimize
from scipy.integrate import solve_ivp

from soil_env._numba.compiling import root
from soil_env.identification import LOWER, UPPER, Points, Status, predict
from soil_env.identification.digging import KEPT, Digging, DiggingPlaces, close_point, note, roll
from soil_env.identification.normal_equations import (
    GAIN,
    SIZE,
    in_blocks,
    prepare,
    workspace,
)
from soil_env.identification.online import identifier_numbers
from soil_env.identification.point import Reading, weigh
from soil_env.identification.solver import (
    least_squares,
)
from soil_env.identification.window import CONTRADICTION_OF_POINT, WINDOW, contradicts
from soil_env.parameters import load_scenario
from soil_env.terramechanics.effects import excavation_rate

NUMBERS = identifier_numbers(load_scenario("mixed"))
READING = NUMBERS.reading
NOISE = np.square([2.0, 2.0, 0.3])


def predicted(x, p):
    """(drawbar pull, load, torque) of a point (a dict) for the five unknowns."""
    out, jacobian = np.empty(3), np.empty((3, 4))
    reading = Reading(float(x[3]), READING.exponent, READING.radius, READING.width)
    ratio = p["dig_ratio"] + math.exp(x[GAIN]) * p["dig_response"]
    predict(np.array(x[:3]), p["slip"], p["sinkage"], ratio, reading, out, jacobian)
    return out


def measured(p):
    return np.array([p["drawbar_pull"], p["load"], p["torque"]])


def whitening(p):
    return np.array([[p["w00"], 0.0, 0.0], [p["w10"], p["w11"], 0.0], [p["w20"], p["w21"], p["w22"]]])


def window(rng, count=8):
    """(`Points`, true unknowns): a soil from the prior, points at random slips and digging, with noise."""
    truth = NUMBERS.prior + rng.standard_normal(SIZE) / np.sqrt(NUMBERS.precision)
    truth[3] = abs(truth[3])
    points = Points(WINDOW)
    for p in range(count):
        values = rng.uniform([0.02, 0.01, 0.8, 0.1], [0.7, 0.05, 1.1, 1.2])
        points.slip[p], points.sinkage[p], points.dig_ratio[p], points.dig_response[p] = values
        values = predicted(truth, points[p]) + np.sqrt(NOISE) * rng.standard_normal(3)
        points.drawbar_pull[p], points.load[p], points.torque[p] = values
        weigh(points, p, truth[:3], NOISE, 0.0, 0.0, READING, 0.0, math.exp(truth[GAIN]))
    return points, truth


@root
def solve(x, points, count, prior, precision, reading, covariance, work):
    """`Status` of the least squares of all five unknowns, as the online identifier calls them."""
    prepare(points, 0, count, reading, work)
    status, _, _ = least_squares(
        in_blocks, x, points, 0, count, prior, precision, reading, SIZE, 30, 1e-7, covariance, work
    )
    return status


def solved(points, count):
    """(x, status, covariance) from the prior."""
    x, covariance, work = NUMBERS.prior.copy(), np.zeros((SIZE, SIZE)), workspace(WINDOW)
    status = solve(x, points, count, NUMBERS.prior, NUMBERS.precision, READING, covariance, work)
    return x, Status(status), covariance


def residual(x, points, count):
    rows = [whitening(p) @ (predicted(x, p) - measured(p)) for p in map(points.__getitem__, range(count))]
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
    rival = optimize.least_squares(residual, start, x_scale=scale, bounds=bounds, args=(points, count), **tight)
    cost = 0.5 * np.sum(residual(x, points, count) ** 2)
    assert cost <= rival.cost * (1.0 + 1e-6) + 1e-9
    np.testing.assert_allclose(x / scale, rival.x / scale, atol=2e-3)
    # covariance: inverse of J^T J by central differences
    J = np.empty((3 * count + SIZE, SIZE))
    for i in range(SIZE):
        h = 1e-5 * scale[i]
        up, down = (residual(x + d * np.eye(SIZE)[i], points, count) for d in (h, -h))
        J[:, i] = (up - down) / (2.0 * h)
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
    for name in ("drawbar_pull", "load", "torque"):
        points[name] *= -1e5
    x, status, covariance = solved(points, 8)
    assert status in (Status.DIVERGED, Status.AT_BOUND, Status.CONVERGED, Status.NOT_EXCITED)
    assert np.all(np.isfinite(x)) and np.all(np.isfinite(covariance))


@pytest.mark.parametrize("seed", range(6))
def test_a_point_contradicts_by_its_error_and_that_of_the_estimate(seed):
    """`contradicts` against u^T (I + J C J^T)^-1 u by numpy, J by differences."""
    rng = np.random.default_rng(seed)
    points, truth = window(rng)
    x, _, covariance = solved(points, 7)
    gain, pull = math.exp(x[GAIN]), points.drawbar_pull[7]
    reading = Reading(float(x[3]), READING.exponent, READING.radius, READING.width)
    for off in np.linspace(0.0, 12.0, 13):
        points.drawbar_pull[7] = pull + off
        y = weigh(points, 7, x[:3], NOISE, 0.005, 0.0, reading, 0.05, gain)
        moved = points[7]
        W, J = whitening(moved), np.empty((3, SIZE))
        for i in range(SIZE):
            h = 1e-5 / np.sqrt(NUMBERS.precision[i]) * np.eye(SIZE)[i]
            J[:, i] = W @ (predicted(x + h, moved) - predicted(x - h, moved)) / (2.0 * h[i])
        u = W @ (measured(moved) - predicted(x, moved))
        chi_squared = u @ np.linalg.solve(np.eye(3) + J @ covariance @ J.T, u)
        if abs(chi_squared - CONTRADICTION_OF_POINT) > 1e-3:
            found = contradicts(points, 7, y, gain, READING.exponent, covariance)
            assert found == (chi_squared > CONTRADICTION_OF_POINT)


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


def observed(speeds, sinkages, sinkage_sd=0.001):
    """(R0, R1, sd) of one point a reading."""
    memory, places, out = Digging(1), DiggingPlaces(KEPT), []
    for (speed, slip_speed), z in zip(speeds, sinkages, strict=True):
        roll(memory, 0, speed, slip_speed, DT, NOMINAL, RECOVERY, LENGTH)
        note(memory, 0)
        out.append(close_point(memory, places, 0, 1.0, z, sinkage_sd))
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


def test_rocking_in_its_own_rut_is_no_travel():
    """3 mm forth and back for 20 s: only the first of it is fresh ground; 0.2 m onwards is that again."""
    memory, before = Digging(1), 0.0
    for k in range(400):
        roll(memory, 0, 0.06 if k % 2 == 0 else -0.06, 0.0, DT, NOMINAL, RECOVERY, LENGTH)
    assert memory["path"][0] == pytest.approx(0.003 / LENGTH, rel=1e-6)
    before = memory["path"][0]
    for _ in range(20):
        roll(memory, 0, 0.2, 0.0, DT, NOMINAL, RECOVERY, LENGTH)
    assert memory["path"][0] - before == pytest.approx((0.2 - 0.003) / LENGTH, rel=1e-6)


def test_noise_of_the_sinkages_is_propagated():
    """Scatter of the ratio under noisy sinkages against the error that is told of."""
    rng, speeds = np.random.default_rng(0), np.tile([0.2, 0.1], (12, 1))
    z = np.array(drive(speeds, 0.02, np.full(12, 0.02), NOMINAL))
    ratios = []
    for _ in range(4000):
        r0, r1, sd = observed(speeds, z + 3e-4 * rng.standard_normal(12), 3e-4)[-1]
        ratios.append((math.log(r0 + r1), sd))
    ratios = np.array(ratios)
    assert ratios[:, 0].std() == pytest.approx(ratios[:, 1].mean(), rel=0.15)
