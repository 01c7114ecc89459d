"""The filter bank: derivatives, the linear-Gaussian limit, consistency on simulated courses, what enters it."""

import math

import numpy as np
import pytest
from hypothesis import Phase, given, settings, strategies as st

from soil_env._numba.compiling import root
from soil_env._numba.lanes import COUNT, to_array
from soil_env.identification import Status, online as identifier
from soil_env.identification.border import begin, blend, by_both_soils, covariance_of_ground
from soil_env.identification.filter_bank import (
    COVARIANCES,
    CROSSING,
    MEANS,
    OLD,
    PLACE,
    STAYS,
    element,
    filter_numbers,
)
from soil_env.identification.filter_update import Point, measure
from soil_env.identification.linearised import COLUMNS, MASS, SINKAGE, SLIP, STATES, Linearised, Reference, linearise
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
from tests.identification.observing import observe

SCENARIO = load_scenario("mixed")
LIBRARY = {"belief": {"soils": dict(SCENARIO.soils)}}


@root
def _linearised(x, cos_pitch, reference, numbers, out):
    linearise(x, cos_pitch, reference, numbers, out)


def linearised(x):
    """(drawbar pull, torque, ln bearing sinkage) and derivatives [3, STATES + 1, COUNT] at states x [STATES, COUNT]."""
    out = Linearised(COLUMNS)
    _linearised(np.ascontiguousarray(x).ravel(), 0.98, Reference(0.02, 1.1e4), filter_numbers(SCENARIO), out)
    return np.array([out["pull"], out["torque"], out["ln_bearing"]]).reshape(3, STATES + 1, COUNT)


def test_derivatives_are_those_of_central_differences():
    """Driving and braking."""
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
        assert np.all(np.abs(found[:, i] - expected) <= 1e-5 * size + 1e-9), i


@root
def _measured(mean, covariance, at, out, point, numbers, x2):
    to_array(measure(mean, covariance, at, out, STATES, point, numbers)[0], x2, 0)


@root
def _measured_on_border(mean, covariance, at, out, point, numbers, x2):
    to_array(measure(mean, covariance, at, out, CROSSING, point, numbers)[0], x2, 0)


def packed(P):
    """Covariances [COUNT, n, n] as a bank holds them."""
    n = P.shape[1]
    out = np.zeros(n * (n + 1) // 2 * COUNT)
    for i in range(n):
        for j in range(i + 1):
            out[element(i, j) : element(i, j) + COUNT] = P[:, i, j]
    return out


def unpacked(covariance):
    """Inverse of `packed`."""
    n = int((2 * covariance.size // COUNT) ** 0.5)
    return np.array([[covariance[element(i, j) : element(i, j) + COUNT] for j in range(n)] for i in range(n)]).T


@pytest.mark.parametrize(("update", "states"), [(_measured, STATES), (_measured_on_border, CROSSING)])
def test_the_channels_of_points_give_the_exact_kalman_filter(update, states):
    """Five points, of seven channels each, of eight Gaussians, on one soil and on a border, against the information
    form: what each channel is by each state, and how sure it is, written down anew."""
    rng = np.random.default_rng(1)
    factors = rng.standard_normal((COUNT, states, states))
    P = factors @ factors.transpose(0, 2, 1) + 0.1 * np.eye(states)
    m = rng.standard_normal((COUNT, states))
    mean, covariance = m.T.copy().ravel(), packed(P)
    information, vector = np.linalg.inv(P), np.linalg.solve(P, m[..., None])[..., 0]
    numbers, x2 = filter_numbers(SCENARIO), np.zeros(COUNT)
    sd, g, r = numbers.noise, numbers.gravity, numbers.radius
    for _ in range(5):
        at, out = rng.standard_normal((states, COUNT)), Linearised((states + 1) * COUNT)
        at[MASS] = rng.uniform(10.0, 20.0, COUNT)
        at[SLIP] = rng.uniform(-0.5, 0.5, COUNT)
        for name in ("pull", "torque"):
            out[name][:] = 10.0 * rng.standard_normal((states + 1) * COUNT)
        pull, torque = (out[name].reshape(states + 1, COUNT) for name in ("pull", "torque"))
        read = rng.standard_normal(8)
        point = Point(
            4.0, 0.2, read[0], read[1], 100.0 + read[2], read[3], read[4], 0.3, 0.0, 0.98, read[5], read[6],
            0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        )  # fmt: skip
        prior = mean.reshape(states, COUNT).copy(), unpacked(covariance)
        update(mean, covariance, at.ravel().copy(), out, point, numbers, x2)
        model = (numbers.model_error * point.load) ** 2
        braking = np.where(at[SLIP] < 0.0, 1.0 / (1.0 + at[SLIP]), 0.0)
        travel = np.where(at[SLIP] < 0.0, braking, 1.0 - at[SLIP])
        speed = -point.rim_speed * np.maximum(braking, 1.0) ** 2
        unit, n, share = np.eye(states), point.readings, pull[-1] / at[MASS] ** 2
        channels = [
            (np.outer(unit[MASS], np.full(COUNT, 0.98 * g)), 0.98 * g * at[MASS], point.load, sd[3] ** 2 / n),
            (np.outer(unit[SINKAGE], np.ones(COUNT)), at[SINKAGE], point.sinkage, sd[1] ** 2 / n),
            (np.outer(unit[SLIP], speed), point.rim_speed * travel, point.speed, (sd[5] ** 2 + sd[6] ** 2) / n),
            (pull[:-1], pull[-1], point.drawbar_pull, sd[2] ** 2 / n + model),
            (torque[:-1], torque[-1], point.torque, sd[4] ** 2 / n + model * r * r),
            (torque[:-1], torque[-1], point.motor_torque, point.motor_variance + model * r * r),
            (pull[:-1] / at[MASS] - np.outer(unit[MASS], share), pull[-1] / at[MASS], point.acceleration,
             model / at[MASS] ** 2 + sd[9] ** 2 / n),
        ]  # fmt: skip
        H = np.array([h for h, *_ in channels])  # [channels, states, COUNT]
        away = np.array([y - p - (h * (prior[0] - at)).sum(axis=0) for h, p, y, _ in channels])
        R = np.array([np.broadcast_to(v, (COUNT,)) for *_, v in channels])
        for k in range(COUNT):
            expected = H[..., k] @ prior[1][k] @ H[..., k].T + np.diag(R[:, k])
            assert x2[k] == pytest.approx(away[:, k] @ np.linalg.solve(expected, away[:, k]), rel=1e-5)
        for h, predicted, y, variance in channels:
            weight = np.broadcast_to(1.0 / np.asarray(variance), (COUNT,))
            information += np.einsum("ik,jk,k->kij", h, h, weight)
            vector += (h * weight * (y - predicted + (h * at).sum(axis=0))).T
    exact = np.linalg.inv(information)
    np.testing.assert_allclose(covariance, packed(exact), rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(mean.reshape(states, COUNT).T, (exact @ vector[..., None])[..., 0], rtol=1e-5, atol=1e-7)


# --- on a border ------------------------------------------------------------------------------------------------------


@root
def _blended(mean, at, spread, numbers, ground):
    blend(mean, at, spread, Reference(0.02, 1.1e4), ground, numbers)


@root
def _by_both(row, mean, at, spread, numbers, ground, out):
    by_both_soils(row, mean, blend(mean, at, spread, Reference(0.02, 1.1e4), ground, numbers), out)


@root
def _ground_covariance(covariance, mean, at, numbers, ground, out):
    covariance_of_ground(covariance, mean, blend(mean, at, 0.0, Reference(0.02, 1.1e4), ground, numbers), out)


def two_soils():
    """States [CROSSING, COUNT] of eight wheels between two soils, on a border at 1 m, and their `FilterNumbers`."""
    rng, x = np.random.default_rng(0), np.zeros((CROSSING, COUNT))
    x[:STATES] = np.array([0.35, -4.4, 13.9, 600.0, 1.07, 0.3, 0.035, 17.0, 0.2])[:, None]
    x[OLD : OLD + SINKAGE] = np.array([0.45, -3.7, 13.4, 300.0, 1.0, -0.2])[:, None]
    x *= 1.0 + 0.03 * rng.standard_normal(x.shape)
    x[PLACE], x[CROSSING - 1] = 1.0 + 0.02 * rng.standard_normal(COUNT), 0.1
    return x, filter_numbers(SCENARIO)


def ground(x, at, spread, numbers):
    out = np.zeros(MEANS)
    _blended(np.ascontiguousarray(x).ravel(), at, spread, numbers, out)
    return out.reshape(CROSSING, COUNT)[:STATES]


def test_the_ground_on_a_border_is_that_of_the_terrain():
    """Strength apart, which is compared by tan(phi): the mean over two places of `ground.blend`."""
    from soil_env.parameters import SoilState
    from soil_env.terramechanics.ground import blend as terrain_blend

    x, numbers = two_soils()
    found = ground(x, 1.03, 0.0, numbers)
    for k in range(COUNT):
        t = (1.03 - x[PLACE, k]) / numbers.border + 0.5
        soils = []
        for first in (OLD, 0):
            t_, ln_K, q, c, n, g = x[first : first + SINKAGE, k]
            tan = t_ / -np.expm1(-0.02 / np.exp(ln_K)) - c / 1.1e4
            ln_S = q - (n - numbers.exponent) * math.log(0.03)
            soils.append(SoilState(tan, c, math.exp(ln_K), math.exp(ln_S), n, math.exp(g), 0.5))
        s = terrain_blend(*soils, t * t * (3.0 - 2.0 * t))
        strength = (s.tan_phi + s.cohesion / 1.1e4) * -math.expm1(-0.02 / s.shear_modulus)
        q = math.log(s.sinkage_coefficient) + (s.sinkage_exponent - numbers.exponent) * math.log(0.03)
        expected = [strength, math.log(s.shear_modulus), q, s.cohesion, s.sinkage_exponent, math.log(s.dig_gain)]
        np.testing.assert_allclose(found[:SINKAGE, k], expected, rtol=1e-9)


def test_derivatives_by_both_soils_are_those_of_central_differences():
    x, numbers = two_soils()
    for i in range(SINKAGE):
        row, out = np.zeros((STATES + 1, COUNT)), np.zeros((CROSSING + 1) * COUNT)
        row[i] = 1.0
        _by_both(row.ravel(), x.ravel(), 1.03, 0.02, numbers, np.zeros(MEANS), out)
        found = out.reshape(CROSSING + 1, COUNT)
        for j in (*range(SINKAGE), *range(OLD, PLACE + 1)):
            h = np.zeros_like(x)
            h[j] = 1e-5 * np.abs(x[j])
            rise = ground(x + h, 1.03, 0.02, numbers)[i] - ground(x - h, 1.03, 0.02, numbers)[i]
            np.testing.assert_allclose(found[j], rise / (2.0 * h[j]), rtol=1e-5, atol=1e-7)


def test_the_covariance_of_the_ground_follows_from_that_of_both_soils():
    x, numbers = two_soils()
    rng = np.random.default_rng(3)
    factors = rng.standard_normal((COUNT, CROSSING, CROSSING))
    P, out = factors @ factors.transpose(0, 2, 1), np.zeros(COVARIANCES)
    G = np.zeros((COUNT, SINKAGE, CROSSING))
    for i in range(SINKAGE):
        row, slopes = np.zeros((STATES + 1, COUNT)), np.zeros((CROSSING + 1) * COUNT)
        row[i] = 1.0
        _by_both(row.ravel(), x.ravel(), 1.03, 0.0, numbers, np.zeros(MEANS), slopes)
        G[:, i] = slopes.reshape(CROSSING + 1, COUNT)[:CROSSING].T
    _ground_covariance(packed(P), x.ravel(), 1.03, numbers, np.zeros(MEANS), out)
    expected = packed(G @ P @ G.transpose(0, 2, 1))
    np.testing.assert_allclose(out[: expected.size], expected, rtol=1e-9, atol=1e-12)


@root
def _begin(banks, numbers, place):
    begin(banks, 0, numbers, place, 1e-4, 0.1, 1e-3, 0.0)


def found_borders(scenario, seeds, steps=420):
    """Of each border that a wheel passes: how far before its middle [m] one was found, and the error [m] of its place
    behind it, of the nearest one found."""
    sim, rows = Simulation(1, scenario, "identified", threads=1), []
    w, p = sim.worlds, sim.worlds.ids.banks.point
    for seed in seeds:
        sim.seed(0, np.random.default_rng(seed))
        sim.restart(0)
        was, begun, middles = 0.0, [], []
        for step in range(steps):
            sim.step(0, 0.42 + 0.1 * math.sin(0.1 * step))
            if w.cause[0] != 0:
                break
            if was == 0.0 and p.crossing[0] == 1.0:
                begun.append(w.state.x[0])
            if was == 1.0 and p.crossing[0] == 0.0:
                middles.append(p.border[0] + w.state.x[0] - p.place[0])
            was = p.crossing[0]
        edges = w.courses.edges[0, 1 : w.courses.patches[0]]
        for edge in edges[edges < w.state.x[0] - 0.5]:
            at = np.array(begun)[np.argmin(np.abs(np.array(begun) - edge))] if begun else np.inf
            middle = np.array(middles)[np.argmin(np.abs(np.array(middles) - edge))] if middles else np.inf
            rows.append((edge - at, middle - edge))
    return np.array(rows)


WHEEL_SPEED = {"control": {"action": "wheel_speed"}}


def test_the_grade_tells_of_a_border_before_its_middle():
    """And its place behind it is right to two centimetres in most cases."""
    rows = found_borders(load_scenario("mixed", WHEEL_SPEED), range(10))
    assert len(rows) >= 15
    assert np.median(rows[:, 0]) > 0.03  # m
    assert np.median(np.abs(rows[:, 1])) < 0.02


def test_the_forces_alone_find_borders_later():
    rows = found_borders(load_scenario("mixed", WHEEL_SPEED | {"belief": {"grade_change_deg": 0.0}}), range(10))
    assert len(rows) >= 15
    assert -0.2 < np.median(rows[:, 0]) < 0.03


def test_a_slope_on_the_same_soil_costs_little():
    """Patches of one soil whose grades differ: the filter to which the soil stays the same wins."""
    changes = WHEEL_SPEED | {
        "soils": {"dry_sand": 1},
        "spread": dict.fromkeys(("friction", "cohesion", "shear_modulus", "stiffness", "exponent", "dig_gain"), 0.0),
        "course": {"margin": [0.0, 0.15]},
    }
    sim, weights = Simulation(1, load_scenario("mixed", changes), "identified", threads=1), []
    banks = sim.worlds.ids.banks
    for seed in range(6):
        sim.seed(0, np.random.default_rng(seed))
        sim.restart(0)
        was = 0.0
        for step in range(420):
            sim.step(0, 0.42 + 0.1 * math.sin(0.1 * step))
            if was == 1.0 and banks.point.crossing[0] == 0.0:
                weights.append(math.exp(banks.log_weight[0, STAYS]))
            was = banks.point.crossing[0]
    assert len(weights) >= 8
    assert np.mean(np.array(weights) > 0.5) >= 0.8


def test_a_border_keeps_what_is_known_of_sinkage_and_mass():
    """At its beginning sinkage and mass, and the old soil, are those of the mixture; the new soil is the prior's."""
    sim = Simulation(1, SCENARIO, "identified", threads=1)
    sim.seed(0, np.random.default_rng(2))
    sim.restart(0)
    for k in range(60):
        sim.step(0, 0.35 + 0.15 * math.sin(0.1 * k))
    ids, numbers = sim.worlds.ids, filter_numbers(SCENARIO)
    banks = ids.banks
    assert banks.point.crossing[0] == 0.0
    w = np.exp(banks.log_weight[0])
    before = banks.mean[0].reshape(CROSSING, COUNT).copy() @ w / w.sum()
    _begin(banks, numbers, 1.0)
    after = banks.mean[0].reshape(CROSSING, COUNT)
    np.testing.assert_allclose(after[SINKAGE : SINKAGE + 2], np.tile(before[SINKAGE : SINKAGE + 2, None], COUNT))
    np.testing.assert_allclose(after[OLD:PLACE], np.tile(before[:SINKAGE, None], COUNT))
    np.testing.assert_allclose(after[:SINKAGE, STAYS], before[:SINKAGE])
    prior = mixture_prior(SCENARIO).mean.reshape(SIZE, COUNT)
    np.testing.assert_allclose(after[1:SINKAGE, :STAYS], prior[1:, :STAYS])
    # to the filter that stays, new and old soil are the same number
    P = banks.covariance[0]
    for i in range(SINKAGE):
        for j in range(i + 1):
            same = [P[element(a, b) + STAYS] for a, b in ((i, j), (OLD + i, j), (OLD + i, OLD + j))]
            np.testing.assert_allclose(same, same[0], rtol=1e-12)


# --- prior ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", range(1, COUNT))
def test_a_split_prior_keeps_mean_and_variance(count):
    whole = plain(SCENARIO)
    parts = split(whole, count)
    mean, covariance = moments(parts)
    np.testing.assert_allclose(mean, whole[1], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), np.sqrt(np.diag(whole[2])), rtol=0.035)
    weights = np.array([p[0] for p in parts])
    assert len(parts) == count and weights.sum() == pytest.approx(1.0) and weights.min() > 0.02


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


def test_a_library_scatters_as_the_soils_of_the_courses_unless_told_otherwise():
    told = {"belief": LIBRARY["belief"] | {"spread": {"shear_modulus": 0.7, "dig_gain": 0.8}}}
    other = {"belief": LIBRARY["belief"] | {"spread": {"shear_modulus": 0.2}}}
    own, same, narrow = (mixture_prior(load_scenario("mixed", changes)) for changes in (LIBRARY, told, other))
    np.testing.assert_array_equal(own.covariance, same.covariance)
    assert np.any(own.covariance != narrow.covariance)


def test_soils_of_a_library_are_weighed_by_the_root_of_the_likelihood():
    changed = []
    for changes, power in ((LIBRARY, 1.0), (LIBRARY, None), ({}, 1.0), ({}, None)):
        numbers = identifier.identifier_numbers(load_scenario("mixed", changes))
        if power:
            numbers = numbers._replace(filter=numbers.filter._replace(power=power))
        ids = identifier.new_identifiers(1)
        identifier.forget(ids, 0, numbers)
        for _ in range(8):
            observe(ids, 0, CONTRARY._replace(load=14.7), numbers)
        moved = (ids.banks.log_weight[0] - numbers.filter.prior.log_weight)[: COUNT - 1]
        changed.append(moved - moved[0])
    full, library, plain_full, plain = changed
    assert np.abs(full).max() > 0.1
    np.testing.assert_allclose(library, 0.5 * full, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(plain, plain_full)


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
            observe(ids, 0, reading, numbers)
        assert np.all(np.isfinite(numbers_of(ids))) and np.all(ids.sd > 0.0)
        assert isinstance(Status(ids.status[0]), Status)


def test_a_reading_that_is_not_a_number_is_passed_over():
    numbers, ids = identifier.identifier_numbers(SCENARIO), identifier.new_identifiers(1)
    identifier.forget(ids, 0, numbers)
    before = numbers_of(ids)
    for _ in range(20):
        observe(ids, 0, SensorReading(0.2, math.nan, *[1.0] * 8), numbers)
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
        observe(ids, 0, CONTRARY, numbers)
        seen.add(Status(ids.status[0]))
        if ids.status[0] != Status.MISFIT:
            assert np.all(np.abs(ids.estimate[0, :3] - numbers.prior[:3]) < 3.0 / np.sqrt(numbers.precision[:3]))
    assert Status.CONVERGED not in seen and Status.MISFIT in seen


def test_forget_leaves_nothing_of_the_course_before():
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
            observe(ids, 0, CONTRARY._replace(load=14.7), numbers)
    np.testing.assert_array_equal(numbers_of(used), numbers_of(fresh))
    np.testing.assert_array_equal(used.banks.candidates, fresh.banks.candidates)
    assert used.banks.point.tobytes() == fresh.banks.point.tobytes()


def test_the_length_of_a_border_is_believed():
    assert filter_numbers(load_scenario("mixed", {"belief": {"border": 0.5}})).border == 0.5


def test_the_library_may_be_what_is_believed():
    sim = Simulation(1, load_scenario("mixed", LIBRARY), "identified", threads=1)
    sim.seed(0, np.random.default_rng(0))
    sim.restart(0)
    mean, covariance = moments(prior_of_belief(load_scenario("mixed", LIBRARY)))
    np.testing.assert_allclose(sim.worlds.ids.estimate[0, :3], mean[:3])
    np.testing.assert_allclose(sim.worlds.ids.sd[0, :3], np.sqrt(np.diag(covariance))[:3])
