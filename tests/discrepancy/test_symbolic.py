"""The simplest law of what is left: planted laws come back, chance adds nothing, the saved model
says the same.
"""

import math

import numpy as np
import pytest

from soil_env.discrepancy import symbolic
from soil_env.identification.table.data import folds
from soil_env.parameters import EARTH_GRAVITY, Soil
from soil_env.terramechanics.model import WheelSoilModel
from tests.discrepancy.tables import NOISE, SLIPS, WHEEL, problem, table

SPEEDS = (0.02, 0.06, 0.2)
PASSES = (1, 2, 3)


@pytest.fixture(scope="module")
def rich():
    return table(speeds=SPEEDS, passes=PASSES)


def planted(data, channel, coefficient, **powers):
    """Contribution of a law of the conditions to a table [N, 3]."""
    rows = data.rows
    known = {
        "slip": rows.slip,
        "speed": rows.conditions[:, 0] / math.sqrt(EARTH_GRAVITY * WHEEL.radius),
        "pass": rows.conditions[:, 1],
    }
    value = coefficient * np.prod([known[g] ** p for g, p in powers.items()], axis=0)
    scale = (WHEEL.radius, rows.load, rows.load * WHEEL.radius)[channel]
    return np.outer(value * scale, np.arange(3) == channel)


def saved(found):
    """`WheelSoilModel` of a law and its soil."""
    return WheelSoilModel(
        WHEEL,
        Soil(
            **{k: float(v) for k, v in found.fit.parameters().items()}, density=1600.0, dig_gain=0.0
        ),
        {},
        found.terms,
    )


@pytest.mark.parametrize(
    ("channel", "coefficient", "powers"),
    [
        (0, 0.1, {"slip": 1.0, "pass": 1.0}),
        (1, -0.3, {"slip": 2.0}),
        (1, -0.4, {"slip": 2.0, "speed": 0.5}),
        (2, 1.0, {"speed": 1.0}),
    ],
)
def test_planted_law_comes_back(rich, channel, coefficient, powers):
    p = problem(rich, np.random.default_rng(1), planted(rich, channel, coefficient, **powers))
    base = p.fit()
    found = symbolic.symbolic(p, base)
    assert len(found.terms) == 1
    term = found.terms[0]
    assert term.channel == ("sinkage", "drawbar_pull", "torque")[channel]
    assert term.powers == powers
    assert term.coefficient == pytest.approx(coefficient, rel=0.2)
    count = int(p.used.sum())
    assert base.residual @ base.residual > count + 3.0 * math.sqrt(2.0 * count)
    left = found.fit.residual @ found.fit.residual
    assert left < count + 2.0 * math.sqrt(2.0 * count)
    # Of soil and law, in which the sinkage drives the groups.
    got = saved(found).predict(rich.table)
    assert np.stack(got[:3], axis=1) == pytest.approx(
        found.fit.output, abs=1e-9 + 0.05 * NOISE.min()
    )
    assert 0.0 < found.gain < base.residual @ base.residual + base.u @ base.u - left


def test_chance_adds_nothing():
    data = table(speeds=SPEEDS)
    rng = np.random.default_rng(2)
    for _ in range(20):
        p = problem(data, rng)
        base = p.fit()
        found = symbolic.symbolic(p, base)
        assert found.terms == ()
        assert found.fit is base
        assert not found.offset.any()


def test_gradient_vanishes_with_the_coefficients(rich):
    """Coefficients are unknowns of the final fit, so that intervals count them."""
    p = problem(rich, np.random.default_rng(5), planted(rich, 2, 1.0, speed=1.0))
    found = symbolic.symbolic(p, p.fit())
    weight = np.array([t.coefficient for t in found.terms]) / found.width
    a, e = symbolic.with_terms(*found.fit.linearised(), found.column)
    e[a.shape[0] - weight.size :] = -weight
    assert np.all(np.abs(a.T @ e) < 0.05 * np.linalg.norm(a, axis=0))
    sd = math.sqrt(found.covariance()[0, 0])
    assert abs(found.terms[0].coefficient - 1.0) < 4.0 * sd < 1.0


def test_a_law_is_chosen_anew_without_each_group(rich):
    """Held-out values of a law that only one group asks for are worse than those of the law that
    has seen it.
    """
    added = planted(rich, 1, -0.4, slip=2.0)
    p = problem(rich, np.random.default_rng(12), added)
    base = p.fit()
    held = symbolic.held_out_predictions(p, base, lambda text: None)
    error = (p.data.y - held) / NOISE
    # A law that all groups share is found without any of them.
    assert np.sqrt(np.mean(error**2)) < 1.3
    only = np.where((rich.rows.slip > 0.5)[:, None] & (np.arange(3) == 2), 2.0, 0.0)
    q = problem(rich, np.random.default_rng(13), only)
    base = q.fit()
    found = symbolic.symbolic(q, base)
    held = symbolic.held_out_predictions(q, base, lambda text: None)
    inside = rich.rows.slip > 0.5
    rms = [
        np.sqrt(np.mean((((q.data.y - x) / NOISE)[inside, 2]) ** 2))
        for x in (found.fit.output, held)
    ]
    assert found.terms and rms[1] > 2.0 * rms[0]


def test_ranges_are_those_of_the_data(rich):
    p = problem(rich, np.random.default_rng(7), planted(rich, 1, -0.4, slip=2.0, speed=0.5))
    found = symbolic.symbolic(p, p.fit())
    term = found.terms[0]
    assert term.ranges["slip"] == pytest.approx([min(SLIPS), max(SLIPS)])
    froude = np.array([min(SPEEDS), max(SPEEDS)]) / math.sqrt(EARTH_GRAVITY * WHEEL.radius)
    assert term.ranges["speed"] == pytest.approx(froude)
    assert term.ranges.keys() == term.powers.keys()


def test_held_out_against_refits():
    """The closed form against a refit without each group, in a linear model."""
    rng = np.random.default_rng(11)
    data = table(speeds=SPEEDS)
    p = problem(data, rng)
    a, e = p.fit().linearised()
    e = e + rng.normal(size=e.size)
    rows = np.nonzero(p.used)[0]
    member = np.stack([group[rows] for group in folds(data)[1]])
    expected = 0.0
    for out in member:
        keep = np.concatenate([~out, np.ones(a.shape[0] - out.size, dtype=bool)])
        x = np.linalg.lstsq(a[keep], e[keep], rcond=None)[0]
        top = a[: out.size][out]
        s = np.eye(out.sum()) + top @ np.linalg.inv(a[keep].T @ a[keep]) @ top.T
        left = e[: out.size][out] - top @ x
        expected += -0.5 * left @ np.linalg.inv(s) @ left - 0.5 * np.linalg.slogdet(s)[1]
    assert symbolic.held_out(member, a, e) == pytest.approx(expected)
