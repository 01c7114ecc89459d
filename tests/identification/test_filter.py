"""The filter bank: derivatives, the linear-Gaussian limit, consistency on simulated courses, what enters it."""

import math

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from soil_env._numba.compiling import root
from soil_env._numba.lanes import COUNT, fill, from_array
from soil_env.identification import Status
from soil_env.identification import online as identifier
from soil_env.identification.filter_bank import element, filter_numbers
from soil_env.identification.filter_update import absorb
from soil_env.identification.linearised import COLUMNS, STATES, Linearised, Reference, linearise
from soil_env.identification.mixture_prior import (
    SIZE,
    mixture_prior,
    moments,
    of_library,
    plain,
    prior_of_belief,
    split,
)
from soil_env.identification.online import SensorReading
from soil_env.parameters import ParameterError, load_scenario
from soil_env.simulation.worlds import Simulation

SCENARIO = load_scenario("mixed")
LIBRARY = {"belief": {"soils": dict(SCENARIO.soils), "spread": {"shear_modulus": 0.7, "dig_gain": 0.8}}}


@root
def _linearised(x, cos_pitch, reference, numbers, out):
    linearise(x, cos_pitch, reference, numbers, out)


def linearised(x):
    """(drawbar pull, torque, ln bearing sinkage) and derivatives [3, STATES + 1, COUNT] at states x [STATES, COUNT]."""
    out = Linearised(COLUMNS)
    _linearised(np.ascontiguousarray(x).ravel(), 0.98, Reference(0.02, 1.1e4), filter_numbers(SCENARIO), out)
    return np.array([out["pull"], out["torque"], out["ln_bearing"]]).reshape(3, STATES + 1, COUNT)


def test_derivatives_are_those_of_central_differences():
    """Driving and braking; those by sinkage and exponent are differences themselves, of one side."""
    rng = np.random.default_rng(0)
    slips = [0.4, 0.1, 0.02, -0.05, 0.7, 0.3, -0.3, 0.55]
    x = np.array([[0.35, -4.4, 13.9, 600.0, 1.07, 0.3, 0.035, 17.0, slip] for slip in slips]).T
    x[:4] *= 1.0 + 0.05 * rng.standard_normal((4, COUNT))
    found = linearised(x)
    for i, h in enumerate([1e-4, 1e-4, 1e-3, 1.0, 1e-3, 1e-3, 1e-5, 1e-3, 1e-4]):
        away = np.zeros_like(x)
        away[i] = h
        expected = (linearised(x + away)[:, STATES] - linearised(x - away)[:, STATES]) / (2.0 * h)
        size = np.abs(expected).max(axis=1, keepdims=True)
        assert np.all(np.abs(found[:, i] - expected) <= (0.02 if i in (4, 6) else 1e-5) * size + 1e-9), i


@root
def _update(mean, covariance, at, slopes, measured, variance):
    absorb(mean, covariance, at, slopes, fill(0.0), from_array(measured, 0), from_array(variance, 0))


def test_linear_measurements_give_the_exact_kalman_filter():
    """Twenty linear measurements of eight Gaussians of nine states, against the information form in numpy."""
    rng = np.random.default_rng(1)
    factors = rng.standard_normal((COUNT, STATES, STATES))
    P = factors @ factors.transpose(0, 2, 1) + 0.1 * np.eye(STATES)
    m = rng.standard_normal((COUNT, STATES))
    mean, covariance = m.T.copy().ravel(), np.zeros(STATES * (STATES + 1) // 2 * COUNT)
    for i in range(STATES):
        for j in range(i + 1):
            covariance[element(i, j) : element(i, j) + COUNT] = P[:, i, j]
    information, vector = np.linalg.inv(P), np.linalg.solve(P, m[..., None])[..., 0]
    for _ in range(20):
        h, y, r = rng.standard_normal((STATES, COUNT)), rng.standard_normal(COUNT), rng.uniform(0.1, 2.0, COUNT)
        _update(mean, covariance, np.zeros(STATES * COUNT), h.ravel(), y, r)
        information += np.einsum("ik,jk->kij", h, h) / r[:, None, None]
        vector += (h * (y / r)).T
    exact = np.linalg.inv(information)
    np.testing.assert_allclose(mean.reshape(STATES, COUNT).T, (exact @ vector[..., None])[..., 0], rtol=1e-6, atol=1e-9)
    for i in range(STATES):
        for j in range(i + 1):
            found = covariance[element(i, j) : element(i, j) + COUNT]
            np.testing.assert_allclose(found, exact[:, i, j], rtol=1e-6, atol=1e-9)


# --- prior ------------------------------------------------------------------------------------------------------------


def test_a_split_prior_keeps_mean_and_variance():
    whole = plain(SCENARIO)
    parts = split(whole, COUNT)
    mean, covariance = moments(parts)
    np.testing.assert_allclose(mean, whole[1], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), np.sqrt(np.diag(whole[2])), rtol=0.1)
    assert sum(p[0] for p in parts) == pytest.approx(1.0)


def test_the_library_is_what_the_world_draws():
    """Moments of the mixture against 4000 soils as `courses.draw_soil` draws them, of all patches, passable or not."""
    from soil_env._numba.random_streams import seed_stream
    from soil_env.simulation.courses import course_numbers, draw_soil

    @root
    def drawn(streams, numbers, out):
        for k in range(len(out)):
            soil = draw_soil(streams, 0, numbers)
            for j in range(7):
                out[k, j] = soil[j]

    scenario, out = load_scenario("mixed", LIBRARY), np.empty((4000, 7))
    drawn(np.array([seed_stream(np.random.default_rng(0))]), course_numbers(scenario), out)
    depth, n = 0.03, scenario.belief.sinkage_exponent
    q = np.log(out[:, 3]) + (out[:, 4] - n) * math.log(depth)
    rows = np.stack([np.arctan(out[:, 0]), np.log(out[:, 2]), q, out[:, 1], out[:, 4],
                     np.log(out[:, 5] / scenario.belief.dig_gain)])  # fmt: skip
    mean, covariance = moments(of_library(scenario, depth))
    sd = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(rows.mean(axis=1) - mean) < 0.1 * sd)
    np.testing.assert_allclose(rows.std(axis=1), sd, rtol=0.1)
    assert np.abs(np.corrcoef(rows) - covariance / np.outer(sd, sd)).max() < 0.1


def test_more_soils_than_filters_are_merged():
    names = list(load_scenario("mixed").library)[: COUNT + 3]
    prior = mixture_prior(load_scenario("mixed", {"belief": {"soils": dict.fromkeys(names, 1.0)}}))
    assert prior.mean.size == SIZE * COUNT and np.exp(prior.log_weight).sum() == pytest.approx(1.0)


def test_an_unknown_soil_of_the_belief_is_refused():
    with pytest.raises(ParameterError, match="belief.soils"):
        load_scenario("mixed", {"belief": {"soils": {"dry_sandd": 1}}})


# --- on courses -------------------------------------------------------------------------------------------------------


def drive(changes=None, wheels=12, steps=250, seed=5):
    """Errors, standard deviations [n, 3] and the distance since the start [n], every fifth step of driving wheels."""
    sim = Simulation(wheels, load_scenario("mixed", changes or {}), "identified", threads=1)
    for k in range(wheels):
        sim.seed(k, np.random.default_rng([seed, k]))
        sim.restart(k)
    what, rows = np.zeros(wheels, np.int8), []
    w, n = sim.worlds, sim.scenario.belief.sinkage_exponent
    for step in range(steps):
        sim.step_all(np.full(wheels, 0.35 + 0.15 * math.sin(0.1 * step)), what)
        for k in range(wheels):
            first_patch = w.state.x[k] < w.courses.edges[k, 1] - 0.2 and step % 5 == 0 and step > 20
            if first_patch and w.cause[k] == 0 and w.state.halt_left[k] == 0.0:
                tan_phi, _, K, S, m, _, _ = w.courses.soils[k, 0]
                depth = max(w.state.bearing_sinkage[k], 1e-4)
                truth = [math.atan(tan_phi), math.log(K), math.log(S) + (m - n) * math.log(depth)]
                rows.append([*(w.ids.estimate[k, :3] - truth), *w.ids.sd[k, :3]])
    rows = np.array(rows)
    return rows[:, :3], rows[:, 3:]


def test_errors_are_those_that_it_states_and_small():
    """In the first soil of 12 courses: errors well below the prior, and of the size of the stated ones."""
    error, sd = drive({"control": {"action": "wheel_speed"}})
    prior = np.sqrt(np.diag(plain(SCENARIO)[2]))[:3]
    rms = np.sqrt(np.mean(error**2, axis=0))
    assert np.all(rms < [0.75 * prior[0], 0.5 * prior[1], 0.5 * prior[2]])
    scaled = np.sqrt(np.mean((error / sd) ** 2, axis=0))
    assert np.all((scaled > 0.4) & (scaled < 2.0)), scaled


def numbers_of(ids):
    return np.concatenate([ids.estimate.ravel(), ids.sd.ravel(), ids.banks.mean.ravel(), ids.banks.covariance.ravel()])


@settings(max_examples=25, deadline=None, phases=[Phase.generate])
@given(data=st.data())
def test_wild_readings_never_give_nan(data):
    numbers, ids = identifier.identifier_numbers(SCENARIO), identifier.new_identifiers(1)
    identifier.forget(ids, 0, numbers)
    wild, speed = st.floats(-1e6, 1e6), st.floats(-3.0, 3.0)
    for _ in range(data.draw(st.integers(5, 25))):
        reading = SensorReading(
            data.draw(st.floats(-1.0, 1.0)), data.draw(st.floats(-0.2, 0.4)), *[data.draw(wild)] * 3,
            data.draw(speed), data.draw(speed), data.draw(st.floats(-1.6, 1.6)), data.draw(wild), data.draw(wild),
        )  # fmt: skip
        for _ in range(5):
            identifier.observe(ids, 0, reading, numbers)
        assert np.all(np.isfinite(numbers_of(ids))) and np.all(ids.sd > 0.0)
        assert isinstance(Status(ids.status[0]), Status)


def test_a_reading_that_is_not_a_number_is_passed_over():
    numbers, ids = identifier.identifier_numbers(SCENARIO), identifier.new_identifiers(1)
    identifier.forget(ids, 0, numbers)
    before = numbers_of(ids)
    for _ in range(20):
        identifier.observe(ids, 0, SensorReading(0.2, math.nan, *[1.0] * 8), numbers)
    np.testing.assert_array_equal(numbers_of(ids), before)


CONTRARY = SensorReading(0.25, 0.022, 14.0, 147.0, 5.5, 0.28, 0.375, 0.0, 12.0, -3.0)


def test_readings_that_contradict_each_other_give_no_current_estimate():
    """A motor torque of twice the torque and an acceleration against the pull, for sensors next to exact.

    The filter takes them for a new soil time and again: what it states is about the prior, or marked.
    """
    exact = dict.fromkeys(("slip", "sinkage", "drawbar_pull", "torque", "load", "speed", "motor_torque"), 1e-6)
    scenario = load_scenario("mixed", {"noise": exact})
    numbers, ids, seen = identifier.identifier_numbers(scenario), identifier.new_identifiers(1), set()
    identifier.forget(ids, 0, numbers)
    for _ in range(100):
        identifier.observe(ids, 0, CONTRARY, numbers)
        seen.add(Status(ids.status[0]))
        if ids.status[0] != Status.MISFIT:
            assert np.all(np.abs(ids.estimate[0, :3] - numbers.prior[:3]) < 3.0 / np.sqrt(numbers.precision[:3]))
    assert Status.CONVERGED not in seen and Status.MISFIT in seen


def test_a_border_before_anything_was_learnt_blends_with_the_prior():
    """Not with zeros, nor with the soil of the course before; `forget` leaves nothing of it."""
    numbers, fresh = identifier.identifier_numbers(SCENARIO), identifier.new_identifiers(1)
    sim = Simulation(1, SCENARIO, "identified", threads=1)
    sim.seed(0, np.random.default_rng(1))
    sim.restart(0)
    for k in range(80):
        sim.step(0, 0.35 + 0.15 * math.sin(0.1 * k))
    used = sim.worlds.ids
    for ids in (used, fresh):
        identifier.forget(ids, 0, numbers)
        for _ in range(60):
            identifier.observe(ids, 0, CONTRARY._replace(load=14.7), numbers)
    np.testing.assert_array_equal(numbers_of(used), numbers_of(fresh))
    np.testing.assert_array_equal(used.banks.before, fresh.banks.before)


def test_the_length_of_a_border_is_believed():
    assert filter_numbers(load_scenario("mixed", {"belief": {"border": 0.5}})).border == 0.5


def test_the_library_may_be_what_is_believed():
    sim = Simulation(1, load_scenario("mixed", LIBRARY), "identified", threads=1)
    sim.seed(0, np.random.default_rng(0))
    sim.restart(0)
    mean, covariance = moments(prior_of_belief(load_scenario("mixed", LIBRARY)))
    np.testing.assert_allclose(sim.worlds.ids.estimate[0, :3], mean[:3])
    np.testing.assert_allclose(sim.worlds.ids.sd[0, :3], np.sqrt(np.diag(covariance))[:3])
