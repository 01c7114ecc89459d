"""The library of soils as prior: a mixture of Gaussians in the place of the one that the fit has.

The fit leaves the information of the readings on the soil, linearised at the most probable one.
With each Gaussian of the library it gives a posterior and its weight; their mixture is published
(Alspach & Sorenson 1972, IEEE Trans. Autom. Control 17:439-448).
"""

import math

from soil_env._compiled.flags import compiled
from soil_env.identification.online.linear import factorise, invert, solve, solve_half
from soil_env.identification.online.memory import SOIL

UNLIKELY = 1e-6  # [of the likeliest] weight below which a soil of the library counts as excluded


@compiled
def write_information(memory, work):
    """Write the information of the readings of a fit, less its prior, into `information`, and the
    gradient of their log-likelihood at its soil into `gradient`.
    """
    factorise(memory.covariance, SOIL, work.factor)
    invert(work.factor, SOIL, work.scratch, work.inverse)
    for i in range(SOIL):
        memory.gradient[i] = 0.0
        for j in range(SOIL):
            prior = memory.prior_precision[i, j]
            memory.information[i, j] = work.inverse[i, j] - prior
            memory.gradient[i] += prior * (memory.u[j] - memory.prior_mean[j])


@compiled
def _join(known, u, setting, work, k):
    """Posterior under the Gaussian k of the library: its factor into `work.factor`, its gradient at
    the soil u into `work.gradient`; ln of its weight.
    """
    precision = setting.library_precision[k]
    gradient = work.gradient
    apart = 0.0
    for i in range(SOIL):
        gradient[i] = known.gradient[i]
        for j in range(SOIL):
            force = precision[i, j] * (setting.library_mean[k, j] - u[j])
            gradient[i] += force
            apart += (setting.library_mean[k, i] - u[i]) * force
            work.normal[i, j] = known.information[i, j] + precision[i, j]
    factorise(work.normal, SOIL, work.factor)
    solve_half(work.factor, SOIL, gradient, work.step)
    log = setting.library_log[k] - 0.5 * apart
    for i in range(SOIL):
        log += 0.5 * work.step[i] ** 2 - math.log(work.factor[i, i])
    return log


@compiled
def mix(known, u, setting, work):
    """Write `soil` and `spread` of `known` by its `information` and `gradient` at the soil u, and
    the weights of the library into `work.weights`.
    """
    mean = known.soil
    spread = known.spread
    total = 0.0
    for i in range(SOIL):
        mean[i] = 0.0
        for j in range(SOIL):
            spread[i, j] = 0.0
    best = -math.inf
    for k in range(setting.library):
        log = _join(known, u, setting, work, k)
        work.weights[k] = log
        if log > best:  # what is summed so far counts less
            less = math.exp(best - log)
            best = log
            total *= less
            for i in range(SOIL):
                mean[i] *= less
                for j in range(SOIL):
                    spread[i, j] *= less
        weight = math.exp(log - best)
        if weight < UNLIKELY:
            continue
        total += weight
        solve(work.factor, SOIL, work.gradient, work.step)
        invert(work.factor, SOIL, work.scratch, work.inverse)
        for i in range(SOIL):
            mean[i] += weight * work.step[i]
            for j in range(SOIL):
                spread[i, j] += weight * (work.inverse[i, j] + work.step[i] * work.step[j])
    for i in range(SOIL):
        mean[i] /= total
    for i in range(SOIL):
        for j in range(SOIL):
            spread[i, j] = spread[i, j] / total - mean[i] * mean[j]
    for i in range(SOIL):
        mean[i] += u[i]
    for k in range(setting.library):
        weight = math.exp(work.weights[k] - best)
        work.weights[k] = weight / total if weight >= UNLIKELY else 0.0


@compiled
def lean(memory, setting, work):
    """Give the next fit a prior of the moments of the soils that are left, by `work.weights`, so
    that it is linearised near them.
    """
    mean = memory.prior_mean
    for i in range(SOIL):
        mean[i] = 0.0
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
    factorise(work.normal, SOIL, work.factor)
    invert(work.factor, SOIL, work.scratch, memory.prior_precision)
