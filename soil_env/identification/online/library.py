"""The library of soils as prior: a mixture of Gaussians in the place of the one that the fit has.

The fit leaves the information of the readings on the soil, linearised at the most probable one.
With each Gaussian of the library it gives a posterior and its weight; their mixture is published
(Alspach & Sorenson 1972, IEEE Trans. Autom. Control 17:439-448).

`memory`, `setting` and `work` are records `MEMORY`, `SETTING` and `WORK` of memory.py.
"""

import math

from soil_env._compiled.flags import compiled, inlined

from .linear import add_gaussian, factorise, invert, invert_whole, solve, solve_half
from .memory import SOIL

# [of the likeliest] weight below which a soil of the library counts as excluded, own choice: left
# out, it costs no inversion
UNLIKELY = 1e-6


@compiled
def write_information(memory, work):
    """Write what the readings alone say after a fit, without its prior, into a `MEMORY`: their
    information into `information`, the gradient of their log-likelihood at its soil into
    `gradient`.
    """
    invert_whole(memory.covariance, SOIL, work, memory.information)
    memory.gradient[:] = 0.0
    mean = memory.prior_mean
    precision = memory.prior_precision
    add_gaussian(precision, mean, memory.u, -1.0, SOIL, memory.information, memory.gradient)


@compiled
def join(known, u, mean, precision, work):
    """Multiply the likelihood of the readings by a Gaussian of a `mean` and a `precision`.

    Write the factor of the precision of the product into `work.factor`, the gradient of its
    log-density at the soil u into `work.gradient`. `known`: a record with the `information` of the
    readings and the `gradient` of their log-likelihood at u.
    """
    for i in range(SOIL):
        work.gradient[i] = known.gradient[i]
        for j in range(SOIL):
            work.normal[i, j] = known.information[i, j]
    add_gaussian(precision, mean, u, 1.0, SOIL, work.normal, work.gradient)
    factorise(work.normal, SOIL, work.factor)


@compiled
def solve_joined(work):
    """Write the mean of the product of `join`, less u, into `work.step`, and its covariance into
    `work.inverse`.
    """
    solve(work.factor, SOIL, work.gradient, work.step)
    invert(work.factor, SOIL, work.scratch, work.inverse)


@compiled
def _log_weight(known, u, setting, work, k):
    """ln of the weight of the Gaussian k of the library under the readings, up to a constant.

    This is the weight in the library times the integral of Gaussian times likelihood over the soil.
    The exponents are expanded about the soil u. `known` and what is written into `work`: see
    `join`; `work.step` is overwritten too.
    """
    mean = setting.library_mean[k]
    join(known, u, mean, setting.library_precision[k], work)
    solve_half(work.factor, SOIL, work.gradient, work.step)
    log = setting.library_log[k]
    for i in range(SOIL):
        log -= 0.5 * (mean[i] - u[i]) * (work.gradient[i] - known.gradient[i])
        log += 0.5 * work.step[i] ** 2 - math.log(work.factor[i, i])
    return log


@compiled
def mix(known, u, setting, work):
    """Write mean and covariance of the soil under the whole library into `soil` and `spread` of
    `known`, by its `information` and `gradient` at the soil u. The weights of the library, whose
    sum is 1, go into `work.weights`.

    Sums are divided by the likeliest weight so far, so that none overflows. Soils below `UNLIKELY`
    of the likeliest count as nothing.
    """
    mean = known.soil
    spread = known.spread
    total = 0.0
    mean[:] = 0.0
    spread[:] = 0.0
    best = -math.inf
    for k in range(setting.library):
        log = _log_weight(known, u, setting, work, k)
        work.weights[k] = log
        if log > best:  # what is summed so far counts less
            less = math.exp(best - log)
            best = log
            total *= less
            mean *= less
            spread *= less
        weight = math.exp(log - best)
        if weight < UNLIKELY:
            continue
        total += weight
        solve_joined(work)
        for i in range(SOIL):
            mean[i] += weight * work.step[i]
            for j in range(SOIL):
                spread[i, j] += weight * (work.inverse[i, j] + work.step[i] * work.step[j])
    mean /= total
    for i in range(SOIL):
        for j in range(SOIL):
            spread[i, j] = spread[i, j] / total - mean[i] * mean[j]
    mean += u[:SOIL]
    for k in range(setting.library):
        weight = math.exp(work.weights[k] - best)
        work.weights[k] = weight / total if weight >= UNLIKELY else 0.0


@inlined
def lean(memory, setting, work):
    """Give the next fit one Gaussian as prior, in `prior_mean` and `prior_precision`: mean and
    covariance of the mixture of the library's own Gaussians, by `work.weights` of `mix`.

    It only moves the point of linearisation near the soils that are left. What the readings tell
    is what the fit adds to this prior (`write_information`), so none counts twice.
    """
    mean = memory.prior_mean
    mean[:] = 0.0
    for i in range(SOIL):
        for k in range(setting.library):
            mean[i] += work.weights[k] * setting.library_mean[k, i]
    for i in range(SOIL):
        for j in range(SOIL):
            work.normal[i, j] = 0.0
            for k in range(setting.library):
                off = setting.library_mean[k, i] - mean[i]
                moment = off * (setting.library_mean[k, j] - mean[j])
                moment += setting.library_covariance[k, i, j]
                work.normal[i, j] += work.weights[k] * moment
    invert_whole(work.normal, SOIL, work, memory.prior_precision)
