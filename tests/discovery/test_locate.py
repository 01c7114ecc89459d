"""Location of disagreement between table and model: planted boxes are found, chance is not."""

import numpy as np
import pytest

from soil_env.discovery.evidence import settle
from soil_env.discovery.locate import locate, structure
from tests.discovery.files import problem_of, table_text
from tests.discovery.tables import NOISE, law_error, problem, table

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
        for p.freedom in false:  # of the noise, set anew in each round
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


def test_a_model_that_leaves_a_pattern_is_told_from_laws_that_err():
    """A band of slip in the pull, and an error of the laws of a tenth."""
    data = table(speeds=SPEEDS)
    law = law_error(data, np.random.default_rng(6), 0.1)
    band = np.where(np.abs(data.rows.slip - 0.3) < 0.08, 15.0, 0.0)
    for added, left in ((law, False), (np.outer(band, [0.0, 1.0, 0.0]), True)):
        p = problem(data, np.random.default_rng(7), added)
        assert (structure(p, settle(p, ())) < 1e-3) == left


@pytest.mark.parametrize("loads", [(100.0,), (60.0, 160.0)])
def test_a_table_too_small_for_any_box_has_no_disagreement(tmp_path, loads):
    """Two rows: the least table that is read."""
    p = problem_of(tmp_path, "\n".join(table_text({}, loads).split("\n")[:3]))
    assert len(p.data.table) == 2
    assert locate(p, p.fit()) == ()
