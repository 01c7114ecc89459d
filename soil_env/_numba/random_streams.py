"""Random numbers inside compiled code: one independent 64-bit stream per wheel.

SplitMix64 (Steele, Lea & Flood 2014, OOPSLA): a Weyl counter and a mixing function, state of one word. Each stream is
seeded from a `numpy.random.Generator` (`seed_streams`), so that everything random follows from `reset(seed=...)`;
numpy's own generators cannot be handed to a parallel compiled loop.
"""

import math

import numpy as np

from soil_env._numba.compiling import compiled_inline, compiled_part
from soil_env._numba.elementary import half_sin_cos, log, sqrt
from soil_env._numba.lanes import lane, made_of

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX2 = np.uint64(0x94D049BB133111EB)
_S30 = np.uint64(30)
_S27 = np.uint64(27)
_S31 = np.uint64(31)
_S11 = np.uint64(11)
_TO_UNIT = 2.0**-53


def seed_stream(rng: np.random.Generator) -> np.uint64:
    """A starting word for one stream, drawn from a Generator."""
    return rng.integers(0, 2**64, dtype=np.uint64)


@compiled_inline
def word(streams, k):
    """Next 64 bits of stream k; `streams` is uint64 [wheels]. Another stream may start from them."""
    streams[k] += _GAMMA
    z = streams[k]
    z = (z ^ (z >> _S30)) * _MIX1
    z = (z ^ (z >> _S27)) * _MIX2
    return z ^ (z >> _S31)


@compiled_inline
def uniform(streams, k):
    """Next number in [0, 1) of stream k."""
    return float(word(streams, k) >> _S11) * _TO_UNIT


@compiled_inline
def between(streams, k, low, high):
    """Next number of stream k, uniform in [low, high)."""
    return low + (high - low) * uniform(streams, k)


@compiled_inline
def within(streams, k, bounds):
    """Next number of stream k, uniform in `bounds` [low, high)."""
    return between(streams, k, bounds[0], bounds[1])


@compiled_part
def normal_pair(streams, k):
    """Two independent standard normal numbers of stream k (Box & Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(streams, k)))
    angle = 2.0 * math.pi * uniform(streams, k)
    return radius * math.cos(angle), radius * math.sin(angle)


@compiled_inline
def _normals(u, v):
    """Standard normal numbers in lanes, two of each lane, from uniform ones, as `normal_pair`."""
    radius = sqrt(-2.0 * log(1.0 - u))
    sin_half, cos_half = half_sin_cos(
        math.pi * (2.0 * v - 1.0)
    )  # half a turn back, so both functions change sign
    return radius * (2.0 * sin_half * sin_half - 1.0), radius * (-2.0 * sin_half * cos_half)


@compiled_inline
def four_normals(streams, k):
    """Four independent standard normal numbers of stream k: two `normal_pair` at once."""
    a = uniform(streams, k)
    b = uniform(streams, k)
    c = uniform(streams, k)
    d = uniform(streams, k)
    x, y = _normals(made_of(a, c, a, c, a, c, a, c), made_of(b, d, b, d, b, d, b, d))
    return lane(x, 0), lane(y, 0), lane(x, 1), lane(y, 1)


@compiled_inline
def ten_normals(streams, k):
    """Ten independent standard normal numbers of stream k: five `normal_pair` at once."""
    a = uniform(streams, k)
    b = uniform(streams, k)
    c = uniform(streams, k)
    d = uniform(streams, k)
    e = uniform(streams, k)
    f = uniform(streams, k)
    g = uniform(streams, k)
    h = uniform(streams, k)
    i = uniform(streams, k)
    j = uniform(streams, k)
    x, y = _normals(made_of(a, c, e, g, i, a, c, e), made_of(b, d, f, h, j, b, d, f))
    return (
        lane(x, 0),
        lane(y, 0),
        lane(x, 1),
        lane(y, 1),
        lane(x, 2),
        lane(y, 2),
        lane(x, 3),
        lane(y, 3),
        lane(x, 4),
        lane(y, 4),
    )
