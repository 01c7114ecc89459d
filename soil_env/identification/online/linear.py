"""Positive definite systems by triangular factors, in arrays of which the first n rows count.

A = U U' with U upper triangular. The last unknown is eliminated first, so that the covariance of
the first m unknowns follows from the first m rows of U.
"""

import math

from soil_env._compiled.flags import compiled

LEAST_PIVOT = 1e-12  # [of the diagonal] to which a smaller pivot is raised: a singular matrix


@compiled
def factorise(a, n, factor):
    """Write the U of a [n, n] into `factor`; only the upper triangle of a is read.

    A pivot below `LEAST_PIVOT` of its diagonal element is raised to that. The triangle of `factor`
    below its diagonal stays as it is.
    """
    for back in range(n):
        j = n - 1 - back
        pivot = a[j, j]
        for k in range(j + 1, n):
            pivot -= factor[j, k] * factor[j, k]
        root = math.sqrt(max(pivot, LEAST_PIVOT * abs(a[j, j])))
        factor[j, j] = root
        for i in range(j):
            rest = a[i, j]
            for k in range(j + 1, n):
                rest -= factor[i, k] * factor[j, k]
            factor[i, j] = rest / root


@compiled
def solve_half(factor, n, right, x):
    """Write x [n] with U x = `right` [n], by the U of `factorise`; x' x is then right' A^-1
    right.
    """
    for back in range(n):
        i = n - 1 - back
        rest = right[i]
        for k in range(i + 1, n):
            rest -= factor[i, k] * x[k]
        x[i] = rest / factor[i, i]


@compiled
def solve(factor, n, right, x):
    """Write x [n] with A x = `right` [n], by the `factor` U of A."""
    solve_half(factor, n, right, x)
    for i in range(n):
        rest = x[i]
        for k in range(i):
            rest -= factor[k, i] * x[k]
        x[i] = rest / factor[i, i]


@compiled
def invert(factor, m, scratch, inverse):
    """Write the first m rows and columns of A^-1 into `inverse`, both triangles, and those of U^-1
    into `scratch`, its upper triangle; by the `factor` U of A.
    """
    for j in range(m):
        scratch[j, j] = 1.0 / factor[j, j]
        for back in range(j):
            i = j - 1 - back
            rest = 0.0
            for k in range(i + 1, j + 1):
                rest -= factor[i, k] * scratch[k, j]
            scratch[i, j] = rest / factor[i, i]
    for i in range(m):
        for j in range(i, m):
            product = 0.0
            for k in range(i + 1):
                product += scratch[k, i] * scratch[k, j]
            inverse[i, j] = product
            inverse[j, i] = product


@compiled
def invert_whole(a, n, work, inverse):
    """Write A^-1 of a [n, n] into `inverse`, both triangles; overwrites `factor` and `scratch` of
    the work space `work` (`memory.WORK`).
    """
    factorise(a, n, work.factor)
    invert(work.factor, n, work.scratch, inverse)


@compiled
def add_gaussian(precision, mean, u, share, n, normal, gradient):
    """Add `share` times the log-density of a Gaussian of n unknowns, given by `precision` [n, n]
    and `mean` [n]; a negative `share` takes it away.

    The `normal` matrix [n, n] gets its precision, `gradient` [n] its gradient at the unknowns u
    [n]: precision (mean - u).
    """
    for i in range(n):
        for j in range(n):
            more = share * precision[i, j]
            normal[i, j] += more
            gradient[i] += more * (mean[j] - u[j])
