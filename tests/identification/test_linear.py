"""Triangular factors against numpy."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from soil_env.identification.online.linear import LEAST_PIVOT
from tests.identification.observing import solve_system

LARGEST = 19  # unknowns behind a border
SHAPE = (LARGEST + 2, LARGEST + 2)  # arrays may be larger than the system


def solved(a, right, m):
    """(U, U^-1 right, A^-1 right, first block of A^-1) with rubbish beyond what counts."""
    n = len(a)
    matrix, factor, scratch, inverse = np.full((4, *SHAPE), np.nan)
    given_right, half, x = np.full((3, SHAPE[0]), np.nan)
    matrix[:n, :n] = np.where(np.tri(n, k=-1) > 0, np.nan, a)  # the upper triangle is given
    given_right[:n] = right
    solve_system(matrix, n, m, given_right, factor, half, x, scratch, inverse)
    for array, size in ((factor, n), (scratch, m), (inverse, m)):
        beyond = np.ones(SHAPE, dtype=bool)
        beyond[:size, :size] = False
        assert np.all(np.isnan(array[beyond]))
    return np.triu(factor[:n, :n]), half[:n], x[:n], inverse[:m, :m]


@settings(max_examples=60, deadline=None)
@given(st.integers(1, LARGEST), st.integers(0, 2**32 - 1), st.floats(0.0, 3.0), st.data())
def test_systems_are_solved_as_by_numpy(n, seed, decades, data):
    """For matrices with unknowns of very different size and condition numbers of up to 1e6."""
    rng = np.random.default_rng(seed)
    rotation = np.linalg.qr(rng.normal(size=(n, n)))[0]
    core = rotation * 10.0 ** rng.uniform(-decades, decades, n) @ rotation.T
    scale = 10.0 ** rng.uniform(-6.0, 6.0, n)
    a = core * np.outer(scale, scale)
    a = 0.5 * (a + a.T)
    right = rng.normal(size=n) * scale
    m = data.draw(st.integers(1, n))
    U, half, x, block = solved(a, right, m)
    np.testing.assert_allclose((U @ U.T) / np.outer(scale, scale), core, atol=1e-9 * 10**decades)
    expected = np.linalg.solve(core, right / scale) / scale
    size = np.abs(expected * scale).max()
    np.testing.assert_allclose(x * scale, expected * scale, atol=1e-9 * size)
    assert half @ half == pytest.approx(right @ expected, rel=1e-8)
    inverse = np.linalg.inv(core)[:m, :m]
    found = block * np.outer(scale, scale)[:m, :m]
    np.testing.assert_allclose(found, inverse, atol=1e-9 * np.abs(inverse).max())
    np.testing.assert_array_equal(block, block.T)


def test_a_singular_matrix_is_solved_as_one_that_nearly_is():
    """A pivot of a millionth of a millionth of the diagonal: finite, and as good as unknown."""
    a = np.ones((2, 2))
    U, _, x, inverse = solved(a, np.array([1.0, 0.0]), 2)
    assert np.all(np.isfinite([*U.ravel(), *x]))
    assert inverse[0, 0] == pytest.approx(1.0 / LEAST_PIVOT, rel=1e-3)
