"""The compiled random streams: reproducible, independent, and of the right distribution."""

import numpy as np
import pytest
from scipy import stats

from soil_env._numba import random_streams as streams


def start(*seeds):
    return np.array([streams.seed_stream(np.random.default_rng(seed)) for seed in seeds], dtype=np.uint64)


def draw(words, count=20_000, k=0):
    return np.array([streams.uniform(words, k) for _ in range(count)])


def test_golden_values():
    """SplitMix64 from state 0: the first outputs of the reference implementation (Vigna, splitmix64.c)."""
    words = np.zeros(1, dtype=np.uint64)
    for expected in (0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F):
        assert streams.uniform(words, 0) == (expected >> 11) * 2.0**-53


def test_same_seed_same_numbers_other_seed_others():
    a, b, c = (draw(start(seed), 100) for seed in (1, 1, 2))
    assert np.array_equal(a, b)
    assert not np.any(a == c)


def test_streams_do_not_disturb_each_other():
    words = start(1, 2)
    alone = draw(start(1), 50)
    mixed = []
    for _ in range(50):
        mixed.append(streams.uniform(words, 0))
        streams.uniform(words, 1)
    assert np.array_equal(alone, mixed)


@pytest.mark.parametrize("seed", range(3))
def test_uniform(seed):
    x = draw(start(seed))
    assert x.min() >= 0.0 and x.max() < 1.0
    assert stats.kstest(x, "uniform").pvalue > 1e-4
    assert abs(np.corrcoef(x[:-1], x[1:])[0, 1]) < 4.0 / np.sqrt(x.size)


def test_neighbouring_streams_are_uncorrelated():
    words = start(7, 8)
    x, y = draw(words, k=0), draw(words, k=1)
    assert abs(np.corrcoef(x, y)[0, 1]) < 4.0 / np.sqrt(x.size)


def test_between():
    words = start(3)
    x = np.array([streams.between(words, 0, -2.0, 5.0) for _ in range(5000)])
    assert x.min() >= -2.0 and x.max() < 5.0
    assert x.mean() == pytest.approx(1.5, abs=4 * 7 / np.sqrt(12 * x.size))


def test_normal_pair():
    words = start(4)
    pairs = np.array([streams.normal_pair(words, 0) for _ in range(20_000)])
    assert stats.kstest(pairs.ravel(), "norm").pvalue > 1e-4
    assert pairs.mean() == pytest.approx(0.0, abs=4 / np.sqrt(pairs.size))
    assert pairs.var() == pytest.approx(1.0, abs=4 * np.sqrt(2 / pairs.size))
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 4 / np.sqrt(len(pairs))
