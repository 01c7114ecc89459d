"""The residual law: terms and table, their packing, the dimensionless groups, and the ranges that
the groups are held in.
"""

import itertools
import math

import numpy as np
import pytest

from soil_env._io.loading import ParameterError
from soil_env.parameters import SoilState
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env.terramechanics.residual import (
    COLUMNS,
    GROUPS,
    ResidualTable,
    ResidualTerm,
    WorkingPoint,
    dimensionless_groups,
    interpolated,
    residual_at,
    residual_law,
)
from soil_env.terramechanics.steady import Rim

SOIL = SoilState(0.6, 1000.0, 0.02, 8e5, 0.8, 0.0, 0.5)
POINT = (0.3, 0.7, 0.1, 0.05, 0.08, 2.0, 0.1)  # one value of each group


def value(terms, groups=POINT):
    """What terms add to (z/r, DP/W, T/(W r)) at values of the groups in the order of `GROUPS`."""
    return residual_at(residual_law(terms), groups)


def test_a_model_with_too_many_terms_is_refused():
    terms = (ResidualTerm("torque", 1.0),) * 33
    with pytest.raises(ParameterError, match="residual: 33 terms: expected at most 32"):
        WheelSoilModel(ModelWheel(0.15, 0.15), residual=terms)


def test_groups_by_hand():
    """r = 0.15 m, b = 0.12 m, z = 0.03 m, W = 90 N, V = 0.1 m/s, N = 2, sin b = 0.1, on the Moon
    (1.62 m/s2).
    """
    point = WorkingPoint(-0.3, 0.03, 90.0, 0.1, 2.0, 0.1)
    found = dimensionless_groups(point, SOIL, Rim(0.15, 0.12, 0.0, 0.0), 1.62)
    bearing = 8e5 * 0.12 * 0.15**1.8  # S b r^(n+1)
    expected = {
        "slip": -0.3,
        "grip": 0.7,
        "sinkage": 0.2,
        "load": 90.0 / bearing,
        "speed": 0.1 / math.sqrt(1.62 * 0.15),
        "pass": 2.0,
        "grade": 0.1,
    }
    assert tuple(expected) == GROUPS
    assert found == pytest.approx(tuple(expected.values()))


def table_of(function, **axes):
    """A table of (z/r, DP/W, T/(W r)) by a function of the groups; as sd ten times their size."""
    nodes = np.array(list(itertools.product(*axes.values())))
    values = np.array([function(dict(zip(axes, x, strict=True))) for x in nodes])
    columns = np.concatenate([values, 10.0 * np.abs(values)], axis=1).T
    text = [" ".join(map(repr, map(float, column))) for column in columns]
    return ResidualTable(axes, dict(zip(COLUMNS, text, strict=True)))


def test_a_table_is_linear_between_its_nodes_and_held_at_its_ends():
    """Over slip (with its sign), load and pass. The functions are linear in each between nodes,
    with a kink at a node of the slip.
    """

    def values(at):
        return (
            abs(at["slip"] + 0.1) + at["load"],
            (1.0 + at["slip"]) * (2.0 + at["load"]) * at["pass"],
            at["pass"],
        )

    table = table_of(
        values, slip=(-0.4, -0.1, 0.0, 0.3, 0.6), load=(0.01, 0.02, 0.05), **{"pass": (1.0, 3.0)}
    )
    law = residual_law((), table)
    for slip, load, passes in itertools.product((-0.4, -0.25, 0.1, 0.6), (0.01, 0.03), (1.0, 2.0)):
        found = interpolated(law, (slip, 0.0, 0.0, load, 0.0, passes, 0.0), 0)
        expected = values({"slip": slip, "load": load, "pass": passes})
        assert found == pytest.approx(expected)
    held = values({"slip": 0.6, "load": 0.05, "pass": 1.0})
    assert interpolated(law, (0.9, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0), 0) == pytest.approx(held)
    assert interpolated(law, (0.9, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0), 3) == pytest.approx(
        [10.0 * x for x in held]
    )
    both = residual_law([ResidualTerm("torque", 1.0)], table)
    assert residual_at(both, POINT)[2] == pytest.approx(1.0 + 2.0)
    assert interpolated(residual_law(), POINT, 0) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("axes", "values", "message"),
    [
        ({"slip": [0.1]}, {}, "at least two numbers, ascending"),
        ({"slip": [0.1, 0.1]}, {}, "at least two numbers, ascending"),
        ({"slip": [0.1, math.inf]}, {}, "at least two numbers, ascending"),
        ({"grip": [0.1, 0.2]}, {}, "axes: unknown key 'grip'"),
        ({"slip": list(range(4097))}, {}, "4097 combinations of nodes: expected 2 to 4096"),
        ({"slip": [0.1, 0.2]}, {"torq": "1 2"}, "did you mean 'torque'"),
        ({"slip": [0.1, 0.2]}, {"torque": "1 2 3"}, "expected 2 numbers"),
        ({"slip": [0.1, 0.2]}, {"torque": "1 x"}, "expected 2 numbers"),
        ({"slip": [0.1, 0.2]}, {"torque": "1 11"}, r"expected 2 numbers in \[-10, 10\]"),
        ({"slip": [0.1, 0.2]}, {"torque_sd": "1 -1"}, r"torque_sd .* numbers in \[0, 1e\+06\]"),
        ({"slip": [0.1, 0.2]}, {"torque": "1 x"}, r"torque = '1 x'"),
    ],
)
def test_wrong_tables_are_refused(axes, values, message):
    with pytest.raises(ParameterError, match=message):
        ResidualTable({name: tuple(nodes) for name, nodes in axes.items()}, values)


def test_downhill_and_rest():
    """Whole powers keep the sign of a grade; where a power has no value, the term is 0, never inf
    or nan.
    """
    for power, expected in ((1.0, -0.1), (2.0, 0.01), (-1.0, -10.0), (0.5, 0.0)):
        found = value([ResidualTerm("torque", 1.0, {"grade": power})], (*POINT[:6], -0.1))[2]
        assert found == pytest.approx(expected)
    for power in (-6.0, -1.0, -0.5, 0.5, 1.0, 2.0):
        assert value([ResidualTerm("torque", 1.0, {"slip": power})], (0.0, *POINT[1:]))[2] == 0.0
