"""Observations of order one: centre and scale as documented, back again, and what is out of sight."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from soil_env.env import SoilWheelEnv, observation_space
from soil_env.parameters import Belief, load_scenario
from soil_env.rover_env import SoilRoverEnv
from soil_env.simulation.rover.task import rover_layout
from soil_env.simulation.task import VARIANTS, layout
from soil_env.simulation.task.scaling import CENTRE_AND_SCALE, Scaling
from soil_env.vector_env import SoilWheelVectorEnv

ROW = re.compile(r"^\s*\| (\S+) \| (\S+) \| ([\w, ]+) \|$", re.MULTILINE)
ENTRY = re.compile(r"^\s*\| (n\+)?(\d+) \| (\w+) \| .+? \| (\S+) \| (\S+) \|$", re.MULTILINE)
COURSE = load_scenario("two_lines").course


def driven(scenario="two_lines", wheels=16, steps=60, **options):
    env = SoilWheelVectorEnv(wheels, scenario, **options)
    env.reset(seed=0)
    rng = np.random.default_rng(1)
    return env, np.concatenate([env.step(rng.uniform(-0.5, 1.0, (wheels, 1)))[0] for _ in range(steps)])


def test_centres_and_scales_are_the_documented_ones():
    rows = [(float(c), float(s), names.split(", ")) for c, s, names in ROW.findall(SoilWheelEnv.__doc__)
            if re.fullmatch(r"-?[\d.]+", c)]  # fmt: skip
    assert {name: (c, s) for c, s, names in rows for name in names} == CENTRE_AND_SCALE


def documented(env):
    """Rows (number, name, low, high) of the tables in the docstring of an environment."""
    return [(n + number, name, float(low), float(high)) for n, number, name, low, high in ENTRY.findall(env.__doc__)]


@pytest.mark.parametrize("variant", VARIANTS)
def test_entries_are_the_documented_ones(variant):
    """Name and bounds of every entry, and the numbers of those that scenarios without a camera have."""
    rows = documented(SoilWheelEnv)
    bounds, numbered = {row[1:] for row in rows}, {row[:2] for row in rows}
    assert {(e.name.replace("beside", "ahead"), e.low, e.high) for e in layout(variant, COURSE)} <= bounds
    assert {(re.sub("^(middle|rear)", "front", e.name), e.low, e.high) for e in rover_layout(variant, 3)} <= {
        row[1:] for row in documented(SoilRoverEnv)
    }
    assert {(str(number), e.name) for number, e in enumerate(layout(variant))} <= numbered
    env = SoilWheelEnv("mixed", observation=variant, scaled=False)
    assert env.observation_names == tuple(e.name for e in layout(variant))
    np.testing.assert_array_equal(env.observation_space.low, np.float32([e.low for e in layout(variant)]))
    np.testing.assert_array_equal(env.observation_space.high, np.float32([e.high for e in layout(variant)]))


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_drive_is_of_order_one(variant):
    env, seen = driven(observation=variant)
    spread, middle = seen.std(axis=0), seen.mean(axis=0)
    still = [k for k, e in enumerate(env.scaling.entries) if e.unit != "0 or 1" and spread[k] < 0.05]
    assert all("dig_recovery" in env.observation_names[k] for k in still)  # the shipped soils have the same
    assert np.all(np.abs(middle) < 2.0) and np.all(spread < 4.0)
    assert all(env.single_observation_space.contains(row) for row in seen[::37])


@pytest.mark.parametrize("variant", VARIANTS)
def test_scaled_and_physical_are_the_same_drive(variant):
    env, seen = driven(observation=variant)
    other, values = driven(observation=variant, scaled=False)
    np.testing.assert_array_equal(env.scaling(values), seen)
    np.testing.assert_allclose(env.physical(seen), values, rtol=1e-5, atol=2e-6)
    np.testing.assert_array_equal(other.physical(values), values)
    assert other.single_observation_space == observation_space(variant, COURSE, scaled=False)
    assert env.single_observation_space == observation_space(variant, COURSE) != other.single_observation_space


@given(st.lists(st.floats(0.01, 1.0), min_size=66, max_size=66))
def test_there_and_back_within_the_bounds(shares):
    scaling = Scaling(layout("identified", COURSE))
    low, high = (np.array([getattr(e, side) for e in scaling.entries]) for side in ("low", "high"))
    values = (low + np.array(shares) * (high - low)).astype(np.float32)
    seen = scaling(values)
    assert scaling.space.contains(seen)
    np.testing.assert_allclose(scaling.physical(seen), values, rtol=1e-5, atol=1e-5)


def test_a_coefficient_at_its_centre_is_in_sight():
    """S = 1e6 exactly, the value of a line whose class was never met."""
    scenario = replace(load_scenario("two_lines"), belief=Belief(sinkage_coefficient=1e6))
    env, seen = driven(scenario)
    _, values = driven(scenario, scaled=False)
    assert (values[:, env.observation_names.index("ahead_log10_sinkage_coefficient")] == 6.0).any()
    np.testing.assert_allclose(env.physical(seen), values, rtol=1e-5, atol=2e-6)
