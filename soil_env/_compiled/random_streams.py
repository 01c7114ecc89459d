"""Random numbers inside compiled code: one independent 64-bit stream for each wheel.

SplitMix64 (Steele, Lea & Flood 2014, OOPSLA): a Weyl counter and a mixing function, state of one
word. A stream is the field `stream` of a record. It is seeded from a `numpy.random.Generator`, so
that everything random follows from `reset(seed=...)`; numpy's own generators cannot be handed to
compiled code that runs in threads.
"""

import math

import numpy as np

from .elementary import half_cos, half_sin, log
from .flags import compiled, compiled_sums

WEYL = np.uint64(0x9E3779B97F4A7C15)  # odd, 2^64 over the golden ratio
# multipliers and shifts of the mixing function (Stafford's variant 13)
MIX_FIRST = np.uint64(0xBF58476D1CE4E5B9)
MIX_SECOND = np.uint64(0x94D049BB133111EB)
SHIFT_FIRST = np.uint64(30)
SHIFT_SECOND = np.uint64(27)
SHIFT_LAST = np.uint64(31)
SHIFT_TO_UNIT = np.uint64(11)  # leaves the 53 bits of a float64
TO_UNIT = 2.0**-53

#: Shape of the scratch of `draw_normals`: the numbers of pair i are [0, i] and [1, i]; eight for
#: the width of a register.
NORMALS = (2, 8)


def seed_stream(rng: np.random.Generator) -> np.uint64:
    """Return a starting word for one stream, drawn from a Generator."""
    return rng.integers(0, 2**64, dtype=np.uint64)


@compiled
def word(owner):
    """Next 64 bits of the stream of the record `owner`. Another stream may start from them."""
    owner.stream += WEYL
    z = owner.stream
    z = (z ^ (z >> SHIFT_FIRST)) * MIX_FIRST
    z = (z ^ (z >> SHIFT_SECOND)) * MIX_SECOND
    return z ^ (z >> SHIFT_LAST)


@compiled
def uniform(owner):
    """Next number in [0, 1), from one word of the stream of `owner`."""
    return float(word(owner) >> SHIFT_TO_UNIT) * TO_UNIT


@compiled
def between(owner, low, high):
    """Next number of the stream of `owner`, uniform in [low, high)."""
    return low + (high - low) * uniform(owner)


@compiled
def normal_pair(owner):
    """Two independent standard normal numbers (Box & Muller 1958), from two words of the stream of
    `owner`.
    """
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(owner)))
    angle = 2.0 * math.pi * uniform(owner)
    return radius * math.cos(angle), radius * math.sin(angle)


@compiled
def draw_normals(owner, normals, pairs):
    """Fill the first `pairs`, at most 8, of `normals` [`NORMALS`] with standard normal numbers,
    two words of the stream of `owner` a pair.

    The others become 0 and take nothing from the stream.
    """
    for i in range(8):
        normals[0, i] = uniform(owner) if i < pairs else 0.0
        normals[1, i] = uniform(owner) if i < pairs else 0.0
    _to_normal(normals)


@compiled_sums
def _to_normal(normals):
    """Turn uniform numbers in [0, 1) into normal ones (Box & Muller 1958), all eight pairs at once.

    It is `normal_pair` by functions that LLVM vectorises, so results differ by rounding.
    """
    for i in range(8):
        radius = math.sqrt(-2.0 * log(1.0 - normals[0, i]))
        # Half a turn back brings the angle into the range of `half_sin`, and turns the sign of its
        # sine and cosine. By s and c of half the angle these are -2 s c and 2 s^2 - 1.
        angle = math.pi * (2.0 * normals[1, i] - 1.0)
        s = half_sin(angle)
        c = half_cos(angle)
        normals[0, i] = radius * (2.0 * s * s - 1.0)
        normals[1, i] = radius * (-2.0 * s * c)
