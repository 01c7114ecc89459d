"""The functions on eight lanes against numpy, and their edges."""

import math

import numpy as np
import pytest

from soil_env.identification.online.lanes import elementary, lanes
from soil_env.identification.online.lanes.compiling import compiled_inline, compiled_root


@compiled_root
def over(which, x, out):
    """Function `which` on x [8 m] into `out` [2, 8 m]."""
    for i in range(0, x.size, 8):
        a = lanes.from_array(x, i)
        b = a
        if which == 0:
            a = elementary.exp(a)
        elif which == 1:
            a = elementary.log(a)
        elif which == 2:
            a, b = elementary.half_sin_cos(a)
        elif which == 3:
            a = elementary.asin_root(a)
        lanes.to_array(a, out[0], i)
        lanes.to_array(b, out[1], i)


def of(which, x):
    x = np.asarray(x, dtype=float)
    padded = np.resize(x, -(-x.size // 8) * 8)
    out = np.empty((2, padded.size))
    over(which, padded, out)
    return out[:, : x.size]


RNG = np.random.default_rng(0)


SMALL = 10.0 ** RNG.uniform(-12, 0, 1000)


@pytest.mark.parametrize(
    ("which", "exact", "x", "rtol"),
    [
        (
            0,
            np.exp,
            np.concatenate(
                [-(10.0 ** RNG.uniform(-12, 2.8, 20_000)), RNG.uniform(0.0, 30.0, 20_000)]
            ),
            4e-15,
        ),
        (
            1,
            np.log,
            np.concatenate([10.0 ** RNG.uniform(-300, 300, 40_000), 1.0 + 1e-3 * SMALL, [1.0]]),
            1e-15,
        ),
        (
            2,
            lambda x: np.sin(0.5 * x),
            np.concatenate([RNG.uniform(-math.pi, math.pi, 40_000), SMALL]),
            2e-15,
        ),
        (
            3,
            lambda t: np.arcsin(np.sqrt(t)),
            np.concatenate([RNG.uniform(0.0, 1.0, 40_000), SMALL, [0.0, 1.0]]),
            2e-15,
        ),
    ],
    ids=["exp", "log", "half sine", "asin of a root"],
)
def test_functions_are_those_of_numpy(which, exact, x, rtol):
    first, second = of(which, x)
    np.testing.assert_allclose(first, exact(x), rtol=rtol)
    if which == 2:
        np.testing.assert_allclose(second, np.cos(0.5 * x), atol=3e-16)


def test_functions_at_their_edges():
    at = of(0, [0.0, -0.0, -700.0, -1e6, -np.inf, 700.0, 1e6, np.inf])[0]
    np.testing.assert_allclose(
        at, np.exp([0.0, 0.0, -700.0, -700.0, -700.0, 700.0, 700.0, 700.0]), rtol=2e-13
    )
    assert at[0] == at[1] == 1.0  # a wheel at rest has no shear at all
    np.testing.assert_allclose(of(3, [-0.1, 1.2])[0], [0.0, 0.5 * math.pi])


@compiled_inline
def law(x, y):
    """An expression in all operations that floats and lanes have in common."""
    z = elementary.fma(x, y, 1.0) / (2.0 - x) - elementary.exp(-abs(x)) * elementary.tanh(y)
    z = elementary.where_less(z, 0.3, -z, elementary.power(abs(y), 1.5)) + elementary.asin_root(
        x * x
    )
    z = elementary.larger(z, elementary.sqrt(abs(z))) + elementary.copysign(
        elementary.log(1.0 + abs(x)), y
    )
    return elementary.smaller(z, 2.0) + elementary.where_less(x, y, z, lanes.alike(0.25, z))


@compiled_root
def law_in_lanes(x, y, out):
    for i in range(0, x.size, 8):
        lanes.to_array(law(lanes.from_array(x, i), lanes.from_array(y, i)), out, i)


def test_a_law_gives_the_same_of_floats_and_in_lanes():
    x, y = RNG.uniform(-1.5, 1.5, (2, 4000))
    out = np.empty(4000)
    law_in_lanes(x, y, out)
    np.testing.assert_allclose(
        out, [law(a, b) for a, b in zip(x, y, strict=True)], rtol=1e-13, atol=1e-14
    )
