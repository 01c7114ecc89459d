"""The residual law: terms, their packing, the dimensionless groups, and the ranges that the groups are held in."""

import math

import pytest
from hypothesis import given, settings, strategies as st

from soil_env._io.loading import ParameterError, load, to_dict
from soil_env.parameters import SoilState
from soil_env.terramechanics.residual import (
    CHANNELS,
    GROUPS,
    ResidualTerm,
    dimensionless_groups,
    residual_at,
    residual_law,
)

SOIL = SoilState(0.6, 1000.0, 0.02, 8e5, 0.8, 0.0, 0.5)
POINT = (0.3, 0.7, 0.1, 0.05, 0.08, 2.0, 0.1)  # one value of each group


def value(terms, groups=POINT):
    """(z/r, DP/W, T/(W r)) of terms."""
    return residual_at(residual_law(terms), groups)


def test_groups_by_hand():
    """r = 0.15 m, b = 0.12 m, z = 0.03 m, W = 90 N, V = 0.1 m/s, N = 2, sin b = 0.1, on the Moon (1.62 m/s2)."""
    found = dimensionless_groups(-0.3, 0.03, 90.0, 0.1, 2.0, 0.1, SOIL, 0.15, 0.12, 1.62)
    bearing = 8e5 * 0.12 * 0.15**1.8  # S b r^(n+1)
    expected = {
        "slip": 0.3, "grip": 0.7, "sinkage": 0.2, "load": 90.0 / bearing, "speed": 0.1 / math.sqrt(1.62 * 0.15),
        "pass": 2.0, "grade": 0.1,
    }  # fmt: skip
    assert tuple(expected) == GROUPS
    assert found == pytest.approx(tuple(expected.values()))


@settings(deadline=None)
@given(length=st.floats(0.1, 10.0), force=st.floats(0.01, 100.0), n=st.floats(0.0, 2.0), time=st.floats(0.1, 10.0))
def test_groups_have_no_dimension(length, force, n, time):
    soil = SOIL._replace(sinkage_exponent=n)
    scaled = soil._replace(sinkage_coefficient=8e5 * force / length ** (n + 2.0))
    found = dimensionless_groups(0.3, 0.03, 90.0, 0.1, 2.0, 0.1, soil, 0.15, 0.12, 9.81)
    same = dimensionless_groups(
        0.3, 0.03 * length, 90.0 * force, 0.1 * length / time, 2.0, 0.1, scaled, 0.15 * length, 0.12 * length,
        9.81 * length / time**2,
    )  # fmt: skip
    assert same == pytest.approx(found)


def test_terms_are_products_and_add_up():
    terms = [
        ResidualTerm("torque", 2.0, {"slip": 2.0, "pass": -1.0}),
        ResidualTerm("torque", -0.1, {"grip": 0.5}),
        ResidualTerm("sinkage", 1.0, {"sinkage": 1.0, "load": 1.0, "speed": 1.0, "grade": 1.0}),
    ]
    z, pull, torque = value(terms)
    assert torque == pytest.approx(2.0 * 0.09 / 2.0 - 0.1 * math.sqrt(0.7))
    assert z == pytest.approx(0.1 * 0.05 * 0.08 * 0.1)
    assert pull == 0.0


@pytest.mark.parametrize(("x", "held"), [(0.05, 0.2), (0.2, 0.2), (0.3, 0.3), (0.5, 0.4)])
def test_groups_are_held_inside_their_range(x, held):
    term = ResidualTerm("torque", 2.0, {"slip": 1.0}, {"slip": [0.2, 0.4], "pass": [5.0, 6.0]})
    assert value([term], (x, *POINT[1:]))[2] == pytest.approx(2.0 * held)


def test_downhill_and_rest():
    """Whole powers keep the sign of a grade; where a power has no value, the term is 0, never inf or nan."""
    downhill = (*POINT[:6], -0.1)
    assert value([ResidualTerm("torque", 1.0, {"grade": 1.0})], downhill)[2] == pytest.approx(-0.1)
    assert value([ResidualTerm("torque", 1.0, {"grade": 2.0})], downhill)[2] == pytest.approx(0.01)
    assert value([ResidualTerm("torque", 1.0, {"grade": -1.0})], downhill)[2] == pytest.approx(-10.0)
    assert value([ResidualTerm("torque", 1.0, {"grade": 0.5})], downhill)[2] == 0.0
    for power in (-6.0, -1.0, -0.5, 0.5, 1.0, 2.0):
        assert value([ResidualTerm("torque", 1.0, {"slip": power})], (0.0, *POINT[1:]))[2] == 0.0


powers = st.dictionaries(st.sampled_from(GROUPS), st.floats(-2.0, 2.0), max_size=3)


@settings(max_examples=60, deadline=None)
@given(coefficient=st.floats(-5.0, 5.0), powers=powers, channel=st.sampled_from(CHANNELS))
def test_a_term_survives_yaml_and_packing(coefficient, powers, channel):
    term = ResidualTerm(channel, coefficient, powers, {name: [0.01, 3.0] for name in powers})
    assert load(ResidualTerm, to_dict(term)) == term
    law = residual_law([term])
    assert law.channel.tolist() == [CHANNELS.index(channel)] and law.coefficient.tolist() == [coefficient]
    expected = coefficient * math.prod(POINT[GROUPS.index(name)] ** p for name, p in powers.items())
    assert residual_at(law, POINT)[CHANNELS.index(channel)] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("torque", math.nan), "coefficient = nan: expected a number"),
        (("torque", 1.0, {"slope": 1.0}), "residual: powers: unknown key 'slope'"),
        (("torque", 1.0, {}, {"spede": [0, 1]}), "residual: ranges: unknown key 'spede'; did you mean 'speed'"),
        (("torque", 1.0, {"slip": 7.0}), r"powers: slip = 7.0: expected a number in \[-6, 6\]"),
        (("torque", 1.0, {}, {"slip": [0.4, 0.2]}), r"ranges: slip = \[0.4, 0.2\]: expected \[low, high\]"),
        (("torque", 1.0, {}, {"slip": [math.nan, 0.2]}), r"expected \[low, high\]"),
    ],
    ids=str,
)
def test_wrong_terms_are_refused_in_one_line(arguments, message):
    with pytest.raises(ParameterError, match=message) as error:
        ResidualTerm(*arguments)
    assert "\n" not in str(error.value)
