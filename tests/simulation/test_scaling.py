"""Observations of order one: centre and scale as documented, back again, and what is out of sight."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from soil_env.env import SoilWheelEnv, observation_space
from soil_env.parameters import Belief, ParameterError, load_scenario
from soil_env.simulation.task import VARIANTS, layout
from soil_env.simulation.task.scaling import CENTRE_AND_SCALE, Scaling
from soil_env.vector_env import SoilWheelVectorEnv

ROW = re.compile(r"^\s*\| (\S+) \| (\S+) \| ([\w, ]+) \|$", re.MULTILINE)
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


def test_a_line_out_of_sight_is_0():
    scaling = Scaling(layout("identified", COURSE))
    names = [e.name for e in scaling.entries]
    lines = [k for k, name in enumerate(names) if name.startswith(("ahead_", "beside_"))]
    seen = scaling(np.zeros((2, len(names)), np.float32))
    assert np.all(seen[:, lines] == 0.0) and np.all(scaling.physical(seen) == 0.0)
    assert seen[0, names.index("log10_sinkage_coefficient")] == pytest.approx(-20.0)


def test_a_coefficient_at_its_centre_is_in_sight():
    """S = 1e6 exactly, the value of a line whose class was never met."""
    scenario = replace(load_scenario("two_lines"), belief=Belief(sinkage_coefficient=1e6))
    env, seen = driven(scenario)
    _, values = driven(scenario, scaled=False)
    assert (values[:, env.observation_names.index("ahead_log10_sinkage_coefficient")] == 6.0).any()
    np.testing.assert_allclose(env.physical(seen), values, rtol=1e-5, atol=2e-6)


def test_what_it_refuses():
    scaling = Scaling(layout("blind"))
    with pytest.raises(ValueError, match=r"shape \(3,\): expected \(..., 14\)"):
        scaling.physical(np.zeros(3))
    with pytest.raises(ValueError, match="'abc': expected 14 numbers"):
        scaling.physical("abc")
    for wrong in ("no", None, 1, np.ones(2)):
        with pytest.raises(ParameterError, match="scaled = .*expected True or False"):
            SoilWheelVectorEnv(2, scaled=wrong)
    with pytest.raises(ParameterError, match="scale.*'scaled'"):
        SoilWheelEnv(scale=True)
