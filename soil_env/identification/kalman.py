"""Kalman updates of a bank of filters by the channels of one point at once.

All channels of a point are linearised at one state, so what the covariance P loses by them is a sum of products v v' of
one vector a channel (scalar measurements one after the other: Bierman 1977, Factorization Methods for Discrete
Sequential Estimation). Each vector is P times the slopes of its channel less what channels before have taken, so that P
itself need not be renewed between channels.

A vector is an array of `size` states, eight filters in the lanes; P is packed as `filter_bank.element` says.
"""

from __future__ import annotations

from soil_env._numba.compiling import inlined
from soil_env._numba.elementary import fma, log, sqrt
from soil_env._numba.lanes import COUNT, fill, from_array, to_array
from soil_env.identification.filter_bank import element


@inlined
def column(covariance, state, out, size):
    """Covariance with one state, into `out`."""
    for i in range(size):
        to_array(from_array(covariance, element(i, state)), out, i * COUNT)


@inlined
def dot(a, b, size):
    """Sum of the products of two vectors."""
    v = fill(0.0)
    for i in range(size):
        v = fma(from_array(a, i * COUNT), from_array(b, i * COUNT), v)
    return v


@inlined
def times(covariance, slopes, out, size):
    """Covariance times slopes, into `out`."""
    for i in range(size):
        v, place = fill(0.0), element(i, 0)
        for j in range(i):
            v = fma(from_array(covariance, place + j * COUNT), from_array(slopes, j * COUNT), v)
        place += i * COUNT
        for j in range(i, size):
            v = fma(from_array(covariance, place), from_array(slopes, j * COUNT), v)
            place += (j + 1) * COUNT
        to_array(v, out, i * COUNT)


@inlined
def times_both(covariance, first, second, out, other, size):
    """Covariance times two vectors of slopes, into `out` and `other`."""
    for i in range(size):
        v, w, place = fill(0.0), fill(0.0), element(i, 0)
        for j in range(i):
            c = from_array(covariance, place + j * COUNT)
            v, w = fma(c, from_array(first, j * COUNT), v), fma(c, from_array(second, j * COUNT), w)
        place += i * COUNT
        for j in range(i, size):
            c = from_array(covariance, place)
            v, w = fma(c, from_array(first, j * COUNT), v), fma(c, from_array(second, j * COUNT), w)
            place += (j + 1) * COUNT
        to_array(v, out, i * COUNT)
        to_array(w, other, i * COUNT)


@inlined
def take_in(mean, vector, slope, own, misfit, variance, size):
    """Update the mean by a channel: (chi-squared, ln of the expected variance, scale).

    `vector` is the covariance with a quantity that the channel is `slope` times, `own` the variance of that quantity.
    It is multiplied by `scale`, so that v v' is what the covariance loses.
    """
    expected = slope * slope * own + variance
    scale = slope / sqrt(expected)
    step = misfit / sqrt(expected)
    for i in range(size):
        v = from_array(vector, i * COUNT) * scale
        to_array(fma(v, step, from_array(mean, i * COUNT)), mean, i * COUNT)
        to_array(v, vector, i * COUNT)
    return step * step, log(expected), scale


@inlined
def less(vector, v, share, size):
    """vector -= share v, v being the vector of an earlier channel."""
    for i in range(size):
        to_array(fma(-1.0 * share, from_array(v, i * COUNT), from_array(vector, i * COUNT)), vector, i * COUNT)


@inlined
def lose(covariance, vector, size):
    """Take v v' out of the covariance."""
    place = 0
    for i in range(size):
        v = -1.0 * from_array(vector, i * COUNT)
        for j in range(i + 1):
            to_array(fma(v, from_array(vector, j * COUNT), from_array(covariance, place)), covariance, place)
            place += COUNT


@inlined
def lose_three(covariance, a, b, c, size):
    """Take a a' + b b' + c c' out of the covariance."""
    place = 0
    for i in range(size):
        x, y, z = -1.0 * from_array(a, i * COUNT), -1.0 * from_array(b, i * COUNT), -1.0 * from_array(c, i * COUNT)
        for j in range(i + 1):
            v = fma(x, from_array(a, j * COUNT), from_array(covariance, place))
            v = fma(y, from_array(b, j * COUNT), v)
            to_array(fma(z, from_array(c, j * COUNT), v), covariance, place)
            place += COUNT
