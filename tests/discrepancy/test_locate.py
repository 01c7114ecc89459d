"""Location of disagreement between table and model: planted boxes are found, chance is not."""

import numpy as np
import pytest
from scipy.stats import chi2

from soil_env.discrepancy.locate import boxes, locate
from tests.discrepancy.tables import NOISE, problem, table

SPEEDS = (0.02, 0.06, 0.2)


def test_chance_is_told_as_often_as_it_claims():
    """100 tables without any misfit: at a rate of 1 in 100, 6 or more alarms have p = 0.0005."""
    rng = np.random.default_rng(3)
    data = table()
    false = 0
    for _ in range(100):
        p = problem(data, rng)
        false += bool(locate(p, p.fit()))
    assert false <= 5


def test_chance_with_estimated_noise():
    """The noise known to 5 degrees of freedom only, and off by as much as that."""
    rng = np.random.default_rng(4)
    data = table()
    false = {5.0: 0, np.inf: 0}
    for _ in range(60):
        p = problem(data, rng)
        p.noise = NOISE * np.sqrt(rng.chisquare(5, 3) / 5)
        fit = p.fit()
        for p.freedom in false:
            false[p.freedom] += bool(locate(p, fit))
    assert false[5.0] <= 4
    assert false[np.inf] > false[5.0] + 4  # and it matters


@pytest.mark.parametrize(
    ("channel", "size", "box"),
    [
        (0, 6e-3, {"slip": (0.42, 0.55)}),
        (0, -6e-3, {"slip": (0.42, 0.55)}),
        (1, -9.0, {"load": (220.0, 220.0), "speed": (0.06, 0.2)}),
        (2, 1.5, {"speed": (0.02, 0.02)}),
    ],
)
def test_planted_box_is_found(channel, size, box):
    data = table(speeds=SPEEDS)
    inside = np.ones(data.rows.slip.size, dtype=bool)
    for name, (low, high) in box.items():
        inside &= (data.varied[name].value > low - 1e-9) & (data.varied[name].value < high + 1e-9)
    added = np.zeros_like(data.y)
    added[inside, channel] = size
    p = problem(data, np.random.default_rng(5), added)
    fit = p.fit()
    first = locate(p, fit)[0]
    assert first.channel == ("sinkage", "drawbar_pull", "torque")[channel]
    assert set(first.region) == set(box)
    for name, limits in box.items():
        assert first.region[name] == pytest.approx(limits)
    residual = (p.data.y - fit.output)[inside, channel]
    assert first.size == pytest.approx(residual.mean())
    assert first.size_sd == pytest.approx(first.size / NOISE[channel])
    assert first.size * size > 0.0
    assert first.p_value < 1e-6


@pytest.mark.parametrize("limit", [0.0, 0.35])
def test_p_value_is_that_of_a_refit_with_the_box(limit):
    """Between the chance of one look and of as many as there are boxes, of the fall that a free shift brings."""
    data = table(speeds=SPEEDS)
    shift = np.where((data.rows.slip > limit)[:, None] & (np.arange(3) == 1), -3.0, 0.0)
    p = problem(data, np.random.default_rng(13), shift)
    fit = p.fit()
    first = locate(p, fit)[0]
    inside = np.ones(data.rows.slip.size, dtype=bool)
    for name, (low, high) in first.region.items():
        inside &= (data.varied[name].value >= low) & (data.varied[name].value <= high)
    a, e = fit.linearised()
    column = p.whiten(np.outer(inside, np.array(["sinkage", "drawbar_pull", "torque"]) == first.channel) * NOISE)
    wider = np.column_stack([a, np.concatenate([column, np.zeros(len(e) - column.size)])])
    left = [np.sum((e - m @ np.linalg.lstsq(m, e, rcond=None)[0]) ** 2) for m in (a, wider)]
    alone = chi2.sf(left[0] - left[1], 1)
    assert alone < first.p_value < 3 * len(boxes(p).limits) * alone
