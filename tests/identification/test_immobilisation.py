"""Warning of immobilisation: its inputs by their definitions, its network against numpy."""

import math
from collections import Counter
from itertools import zip_longest

import numpy as np
import pytest

from soil_env.envs.wheel_env import SoilWheelEnv
from soil_env.identification.online import immobilisation as im
from soil_env.identification.online.prior import setting_of
from soil_env.parameters import load_scenario
from soil_env.parameters.sensors import SensorReading
from soil_env.simulation.task import layout
from tests.identification.observing import readings_of

SCENARIO = load_scenario("mixed")
READING = SensorReading(0.3, 0.03, 10.0, 150.0, 5.0, 0.1, 0.15, 0.1, 6.0, 1.2)


def follow(readings, halted=(), scenario=SCENARIO):
    """Memory of one wheel [RECENT] after the first of `readings` at the start and the others in a
    period each.
    """
    recent = np.zeros(im.RECENT)
    settings = setting_of(scenario)[0], im.warning_setting(scenario)[0]
    first, *others = readings_of(readings)
    im.begin_averages(recent, first, *settings)
    for reading, stands in zip_longest(others, halted, fillvalue=False):
        im.average(recent, reading, float(stands), *settings)
    return recent


AVERAGES = len(im.SCALES) * len(im.Channels._fields)


def test_the_compiled_network_is_the_one_of_matrices():
    rng = np.random.default_rng(1)
    recent = np.abs(rng.normal(size=(200, im.RECENT)))
    estimate = 0.3 * rng.normal(size=(200, 6))
    sd = np.abs(rng.normal(size=(200, 6)))
    found = im.ImmobilisationWarning(SCENARIO).assess(np.arange(200), recent, estimate, sd)
    net = im.shipped_network()
    x = np.clip((found.inputs - net.mean) * net.scale, -im.LARGEST, im.LARGEST)
    x = np.tanh(np.tanh(x @ net.first + net.first_bias) @ net.second + net.second_bias)
    early, late = (0.5 + 0.5 * np.tanh(0.5 * (x @ net.last + net.last_bias))).T
    expected = np.stack([early, early + (1.0 - early) * late], axis=1)
    np.testing.assert_allclose(found.probabilities, expected, rtol=1e-10)


def test_averages_answer_a_step_with_their_time_constants():
    period = SCENARIO.control.period
    after = 7
    recent = follow([READING] + [READING._replace(slip=0.8)] * after)
    found = dict(zip(im.INPUTS, recent[:AVERAGES], strict=False))
    for scale in im.SCALES:
        left = math.exp(-after * period / scale)
        assert found[f"slip_{scale:g}s"] == pytest.approx(0.8 - 0.5 * left, rel=1e-12)
        assert found[f"sinkage_{scale:g}s"] == pytest.approx(0.2)


def test_halts_are_left_out():
    other = READING._replace(slip=0.0, rim_speed=0.0, speed=0.0)
    driven = follow([READING] * 5)
    halted = follow([READING] * 5 + [other] * 3, [False] * 4 + [True] * 3)
    np.testing.assert_array_equal(halted[:AVERAGES], driven[:AVERAGES])
    assert (driven[AVERAGES], halted[AVERAGES]) == (pytest.approx(0.4), 0.0)


def test_a_wheel_of_another_size_reads_the_same():
    """Lengths by the radius, forces by the load, speeds in radii a second: similar wheels are the
    same to it.
    """
    wheel = {
        "radius": 0.45,
        "width": 0.45,
        "body_mass": 15.0 * 8.0,
        "stall_torque": 35.0 * 24.0,
        "inertia": 40.0,
    }
    large = load_scenario("mixed", {"wheel": wheel})
    # lengths and speeds are 3 times as large, forces 8 times and torques 24 times
    similar = SensorReading(*np.multiply(READING, (1, 3, 8, 8, 24, 3, 3, 1, 24, 1)))
    np.testing.assert_allclose(
        follow([similar] * 3, scenario=large), follow([READING] * 3), rtol=1e-12
    )


def test_inputs_have_the_estimate_without_dimension():
    estimate = np.array([[0.5, math.log(0.015), math.log(8e5), 600.0, 0.2, 0.3]])
    sd = np.array([[0.1, 0.2, 0.3, 400.0, 0.5, 0.1]])
    found = im.ImmobilisationWarning(SCENARIO).assess(
        np.array([0]), follow([READING])[None], estimate, sd
    )
    found = dict(zip(im.INPUTS, found.inputs[0], strict=True))
    wheel = SCENARIO.wheel
    n = SCENARIO.belief.sinkage_exponent
    area = wheel.radius * wheel.width
    expected = {
        "strength": math.tan(0.5) + 600.0 * area / 150.0,
        "log_modulus": math.log(0.015 / wheel.radius),
        "log_bearing": math.log(8e5 * wheel.radius**n * area / SCENARIO.weight),
        "log_digging": math.log(SCENARIO.belief.dig_gain) + 0.2,
        "phi_sd": 0.1,
        "modulus_sd": 0.2,
        "bearing_sd": 0.3,
        "digging_sd": 0.5,
    }
    assert {name: found[name] for name in expected} == pytest.approx(expected)


def test_with_a_camera_the_view_is_that_of_the_observation():
    """On the way to the line with more margin."""
    env = SoilWheelEnv("two_lines", observation="identified", action="torque", repeat=1)
    env.reset(seed=3)
    worlds = env.simulation.worlds
    warning = im.ImmobilisationWarning(env.scenario)
    radius = env.scenario.wheel.radius
    names = [e.name for e in layout("identified", env.scenario.course)]
    observed = dict(zip(names, worlds.observation[0].tolist(), strict=True))
    ways = set()
    forks = Counter()
    before = None
    ended = False
    for _ in range(1200):
        if ended:
            env.reset()
            observed = dict(zip(names, worlds.observation[0].tolist(), strict=True))
        beside = observed["choice"] and observed["beside_margin"] > observed["ahead_margin"]
        *_, ended, _, _ = env.step([-0.1 if beside else 0.45])
        known = worlds.ids
        assessed = warning.assess(np.array([0]), worlds.recent, known.estimate, known.sd)
        found = dict(zip(im.INPUTS, assessed.inputs[0].tolist(), strict=True))
        observed = dict(zip(names, worlds.observation[0].tolist(), strict=True))
        assert found["camera"] == 1.0
        assert found["ahead_seen"] == (observed["ahead_friction_angle"] > 0.0)
        if not found["ahead_seen"]:
            before = None
            continue
        near = pytest.approx(observed["border_distance"], abs=1e-6)
        assert found["border_ahead"] * radius == near
        two = observed["beside_friction_angle"] > 0.0
        ahead = observed["ahead_margin"]
        margins = sorted([ahead, observed["beside_margin"] if two else ahead])
        seen = sorted([found["line_margin"], found["beside_margin"]])
        assert seen == pytest.approx(margins, abs=1e-6)
        settled = found["line_chosen"] == 1.0
        assert settled or two
        if two:
            forks[settled] += 1
            ways.add(found["line_margin"] == pytest.approx(ahead, abs=1e-6))
            # not back over a border, by noise
            if settled and before is False and observed["border_distance"] > 0.2:
                assert observed["choice"] == 1.0  # it is settled at the halt before the fork
        before = settled if two else None
    assert min(forks[True], forks[False]) > 20 and ways == {True, False}
