"""Observation of a rover's agent: readings, true soils, halts, reward."""

import math

import numpy as np
import pytest

from soil_env.envs.rover_env import SoilRoverEnv
from soil_env.identification.online.memory import PUBLISHED
from soil_env.parameters import SoilState, rover_names
from soil_env.simulation.rover.task import axle_names
from soil_env.simulation.world.terrain import places_on


def drive(rover, variant, seed, steps=60, command=0.5, **changes):
    """(env, [(observation by name in its units, info, true soils)]) of a drive."""
    env = SoilRoverEnv(rover, variant, scaled=False, **changes)
    rows = []
    observation, info = env.reset(seed=seed)
    for k in range(steps):
        rows.append(
            (
                dict(zip(env.observation_names, observation.tolist(), strict=True)),
                info,
                env.true_soils(),
            )
        )
        observation, _, over, _, info = env.step(
            np.full(env.scenario.axles, command * (1.0 - 0.3 * (k // 7 % 2)))
        )
        if over:
            break
    return env, rows


@pytest.mark.parametrize("rover", rover_names())
def test_a_rover_starts_on_its_slopes(rover):
    """Height of each axle above the rear one: the integral of the slopes between, each shorter than
    the wheelbase.
    """
    course = {"length": 3.0, "slope_length": [0.2, 0.25], "border": 0.05}
    env = SoilRoverEnv(rover, course=course)
    env.reset(seed=4)
    axles = env.scenario.axles
    worlds = env.simulation.worlds
    places = worlds.state["wheels"]["x"][0, :axles]
    x = np.linspace(0.0, places[0], 20_001)
    slope = np.sin(places_on(worlds.courses, 0, x, 0.05)["grade"])
    height = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(x))])
    found = worlds.state["axles"]["height"][0, :axles]
    assert np.ptp(slope) > 0.02
    np.testing.assert_allclose(found, np.interp(places, x, height), atol=2e-3)


@pytest.mark.parametrize("rover", rover_names())
def test_true_soil_is_that_under_each_axle(rover):
    """As `true_soils` has it, which is the course's: the front axle comes to a patch first."""
    course = {"patch_length": [0.7, 0.9], "border": 0.3}
    env, rows = drive(rover, "true_soil", 1, 100, 0.9, action="wheel_speed", course=course)
    names = axle_names(env.scenario.axles)
    met = {}
    for k, (seen, _, soils) in enumerate(rows):
        for axle, soil in zip(names, soils, strict=True):
            expected = {
                "friction_angle": math.radians(soil.friction_angle_deg),
                "log10_shear_modulus": math.log10(soil.shear_modulus),
                "log10_sinkage_coefficient": math.log10(soil.sinkage_coefficient),
                "cohesion": soil.cohesion / 1e3,
                "sinkage_exponent": soil.sinkage_exponent,
                "dig_gain": soil.dig_gain,
            }
            assert {name: seen[f"{axle}_{name}"] for name in expected} == pytest.approx(
                expected, rel=1e-6
            )
            if soil != rows[0][2][-1]:
                met.setdefault(axle, k)
    courses = env.simulation.worlds.courses
    first = courses["patches"][0, 0]
    width = env.scenario.wheel.width
    assert rows[0][2][-1].state(width) == pytest.approx(
        tuple(first[name] for name in SoilState._fields)
    )
    order = [met.get(axle, len(rows)) for axle in names]
    assert order == sorted(order) and order[0] < order[-1]


def test_energy_and_progress_are_of_the_rover_as_a_whole():
    env, rows = drive("mars_rover", "blind", 4, 40, action="wheel_speed", repeat=1)
    s = env.scenario
    length = env.scenario.course.length
    before = 0.0
    mass = env.simulation.worlds.state["mass"][0]  # of one side: three wheels and their payloads
    payload = mass - 0.5 * s.vehicle.mass
    assert 0.0 <= payload <= 3.0 * s.course.payload[1]
    for _, info, _ in rows[1:]:
        terms = info["reward_terms"]
        state = info["state"]
        assert terms["progress"] == pytest.approx(10.0 * (state["x"] - before) / length, abs=1e-9)
        assert terms["energy"] == pytest.approx(-state["motor_work"] / (mass * s.gravity * length))
        before = state["x"]
    assert before > 0.3


def test_the_information_term_is_the_mean_over_the_axles():
    """It sums up to the fall of entropy, discounted, and is the same whether an action lasts one
    period or five.
    """
    env = SoilRoverEnv(
        "mars_rover",
        action="wheel_speed",
        reward={"information": 1.0, "information_discount": 1.0},
        repeat=5,
    )
    env.reset(seed=0)
    paid = sum(env.step([0.4, 0.5, 0.6])[4]["reward_terms"]["information"] for _ in range(25))
    w = env.simulation.worlds
    assert w.known.sd.shape[:2] == (1, 3)
    left = (w.known.sd[0] / env.simulation.belief["prior_sd"][0])[:, :PUBLISHED]
    known = -np.log(np.clip(left, 1e-6, 1.0)).sum(axis=1)
    assert paid == pytest.approx(known.mean(), abs=1e-9) and paid > 0.5
