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


@pytest.mark.parametrize("seed", range(3))
def test_uniform(seed):
    x = draw(start(seed))
    assert x.min() >= 0.0 and x.max() < 1.0
    assert stats.kstest(x, "uniform").pvalue > 1e-4
    assert abs(np.corrcoef(x[:-1], x[1:])[0, 1]) < 4.0 / np.sqrt(x.size)


def test_normal_pair():
    words = start(4)
    pairs = np.array([streams.normal_pair(words, 0) for _ in range(20_000)])
    assert stats.kstest(pairs.ravel(), "norm").pvalue > 1e-4
    assert pairs.mean() == pytest.approx(0.0, abs=4 / np.sqrt(pairs.size))
    assert pairs.var() == pytest.approx(1.0, abs=4 * np.sqrt(2 / pairs.size))
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 4 / np.sqrt(len(pairs))
