"""Random streams against SplitMix64 in Python's integers, and against the normal distribution."""

import math

import numpy as np
import pytest
from numba import njit
from scipy import stats

from soil_env._compiled import random_streams as streams
from soil_env._compiled.flags import record

PAIRS = 5  # of normal numbers by one call of `draw_normals`

OWNER = record(stream=("u8",))
WORD = 2**64 - 1


def owner_of(seed):
    """One record [1] whose stream begins at `seed`."""
    owner = np.zeros(1, OWNER)
    owner["stream"] = seed
    return owner


def split_mix(seed, count):
    """The first `count` words of SplitMix64 (Steele, Lea & Flood 2014), integers of 64 bits."""
    out = []
    for _ in range(count):
        seed = (seed + 0x9E3779B97F4A7C15) & WORD
        z = ((seed ^ (seed >> 30)) * 0xBF58476D1CE4E5B9) & WORD
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & WORD
        out.append(z ^ (z >> 31))
    return out


@njit
def draw(owner, words, uniforms, pairs):
    """Fill the arrays one after the other from the stream of the first record."""
    for i in range(words.size):
        words[i] = streams.word(owner[0])
    for i in range(uniforms.size):
        uniforms[i] = streams.uniform(owner[0])
    for i in range(len(pairs)):
        pairs[i] = streams.normal_pair(owner[0])


@njit
def draw_many(owner, normals, pairs):
    """Fill `pairs` [n, 5, 2] by `draw_normals`."""
    for i in range(len(pairs)):
        streams.draw_normals(owner[0], normals, PAIRS)
        for j in range(PAIRS):
            pairs[i, j, 0] = normals[0, j]
            pairs[i, j, 1] = normals[1, j]


@pytest.mark.parametrize("seed", [0, 1, WORD, 0x0123456789ABCDEF])
def test_words_and_uniform_numbers_are_those_of_split_mix(seed):
    words = np.zeros(50, np.uint64)
    uniforms = np.zeros(50)
    owner = owner_of(seed)
    with np.errstate(over="ignore"):
        draw(owner, words, uniforms, np.zeros((0, 2)))
    expected = split_mix(seed, 100)
    assert words.tolist() == expected[:50]
    # the upper 53 bits: as many as a float has
    assert uniforms.tolist() == [(word >> 11) / 2**53 for word in expected[50:]]
    assert owner["stream"][0] == (seed + 100 * 0x9E3779B97F4A7C15) & WORD


def test_normal_numbers_are_those_of_box_and_muller():
    """One pair at a time and all pairs of a wheel at once, from the same uniform numbers."""
    count = 40
    one = np.zeros((count * PAIRS, 2))
    many = np.zeros((count, PAIRS, 2))
    with np.errstate(over="ignore"):
        draw(owner_of(7), np.zeros(0, np.uint64), np.zeros(0), one)
        draw_many(owner_of(7), np.zeros(streams.NORMALS), many)
    uniforms = np.array([(word >> 11) / 2**53 for word in split_mix(7, 2 * len(one))])
    radius = np.sqrt(-2.0 * np.log(1.0 - uniforms[::2]))
    angle = 2.0 * math.pi * uniforms[1::2]
    stated = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    np.testing.assert_allclose(one, stated, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(many.reshape(-1, 2), stated, rtol=0.0, atol=1e-13)


def test_normal_numbers_are_normal_and_streams_independent():
    seeds = [streams.seed_stream(np.random.default_rng(k)) for k in range(2)]
    drawn = np.zeros((2, 4000, PAIRS, 2))
    with np.errstate(over="ignore"):
        for seed, out in zip(seeds, drawn, strict=True):
            draw_many(owner_of(seed), np.zeros(streams.NORMALS), out)
    first, second = drawn.reshape(2, -1)
    assert stats.kstest(first, "norm").pvalue > 1e-3 and stats.kstest(second, "norm").pvalue > 1e-3
    for a, b in ((first, second), (first[:-1], first[1:]), (first[::2], first[1::2])):
        assert abs(np.corrcoef(a, b)[0, 1]) < 4.0 / math.sqrt(len(a))
