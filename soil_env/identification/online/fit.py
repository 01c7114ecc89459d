"""The most probable soil and instruments by all cells, and their covariance (Laplace).

Gauss-Newton is the generalized Newton-Raphson method of the source paper (its Section 4), here with
noise in its conditions and a prior.

`memory`, `setting` and `work` are records `MEMORY`, `SETTING` and `WORK` of memory.py.
"""

import math

from soil_env._compiled.flags import compiled

from .linear import add_gaussian, factorise, invert, solve
from .memory import (
    ALL,
    HERE,
    OLD,
    PLACE,
    PULL,
    PULL_ZERO,
    RESIDUALS,
    SINKAGE,
    SOIL,
    TANGENT,
    TORQUE,
)
from .residuals import LEAST_TANGENT, WEIGHT, residuals, weigh_unknowns

# Steps of Gauss-Newton for a point, at most, own choice; with one the errors of ln K grow by a
# tenth. What two leave of chi-squared at the first point makes the form error grow (`renew`), as
# errors of the laws do.
STEPS = 2
# [variances] squared length of a step, below which it is the last, own choice
SETTLED = 0.3
FARTHEST = 4.0  # [prior standard deviations] of the soil from its mean, at most, own choice
LEAST_CHI_SQUARED = 1e-5  # [-] least chi-squared that a share is formed of, own choice
# Form error of the laws, own choices:
# [of its expectation] chi-squared of the forces above which the laws err: the form error grows
CONTRADICTS = 1.3
GROWS = 1.4  # factor by which it grows, at least
FASTEST = 10.0  # factor by which it grows, at most
# [of `CONTRADICTS`] chi-squared below which it shrinks: 0.78 times the expectation
AGREES = 0.6
SHRINKS = 1.1  # factor by which it shrinks
LARGEST_ERROR = 0.1  # [of load] form error up to which it grows, if the believed one is not larger


@compiled
def _write_prior(memory, setting, work, size):
    """Write normal matrix and gradient at u of the prior of `size` unknowns into `work.prior` and
    `work.prior_gradient`. They are those of soil and instruments (`HERE`), after a border also its
    place and the old soil (`ALL`).

    If the wheel has stood, its pull at rest counts there as a measured zero.
    """
    A = work.prior
    g = work.prior_gradient
    u = memory.u
    g[:size] = 0.0
    A[:size, :size] = 0.0
    add_gaussian(memory.prior_precision, memory.prior_mean, u, 1.0, SOIL, A, g)
    for i in range(SOIL, HERE):
        A[i, i] = 1.0 / work.sd[i] ** 2
        g[i] = -A[i, i] * u[i]
    if size == ALL:
        A[PLACE, PLACE] = 1.0 / memory.border_variance
        g[PLACE] = A[PLACE, PLACE] * (memory.border - u[PLACE])
        old = memory.old_precision
        add_gaussian(old, memory.old_mean, u[OLD:], 1.0, SOIL, A[OLD:, OLD:], g[OLD:])
    if memory.rests > 0.0:
        # the slope is known as well as the zero of the pitch
        variance = setting.zero[0].pitch ** 2 + memory.rest_variance / memory.rests
        A[PULL_ZERO, PULL_ZERO] += 1.0 / variance
        g[PULL_ZERO] += (memory.rest_pull - u[PULL_ZERO]) / variance


@compiled
def _normal_equations(memory, setting, work, size):
    """Write normal matrix, its upper triangle, and gradient of prior and cells at `size` unknowns
    into `work.normal` and `work.gradient`. Return chi-squared (of the forces, of the law of
    sinkage, of the residuals in rows after `SINKAGE`, of which there are none now).

    Only residuals of cells on a border depend on its place and on the old soil.
    """
    _write_prior(memory, setting, work, size)
    A = work.normal
    g = work.gradient
    for i in range(size):
        g[i] = work.prior_gradient[i]
        for j in range(size):
            A[i, j] = work.prior[i, j]
    J = work.slopes
    forces = 0.0
    sinkage = 0.0
    others = 0.0
    for k in range(memory.cells_kept):
        cell = memory.cells[k]
        e = residuals(cell, memory, setting, work)
        forces += e.pull_weight * e.pull**2 + 2.0 * e.joint_weight * e.pull * e.torque
        forces += e.torque_weight * e.torque**2
        sinkage += e.sinkage_weight * e.sinkage**2
        for row in range(SINKAGE + 1, RESIDUALS):
            others += e[WEIGHT + row] * e[row] ** 2
        own = size if cell.place_error > 0.0 else HERE
        for i in range(own):
            p = e.pull_weight * J[PULL, i] + e.joint_weight * J[TORQUE, i]
            t = e.joint_weight * J[PULL, i] + e.torque_weight * J[TORQUE, i]
            down = p * e.pull + t * e.torque
            for row in range(SINKAGE, RESIDUALS):
                down += e[WEIGHT + row] * J[row, i] * e[row]
            g[i] += down
            for j in range(i, own):
                curved = p * J[PULL, j] + t * J[TORQUE, j]
                for row in range(SINKAGE, RESIDUALS):
                    curved += e[WEIGHT + row] * J[row, i] * J[row, j]
                A[i, j] += curved
    return forces, sinkage, others


@compiled
def _apply_step(memory, setting, work, size):
    """Add `work.step` to the first `size` unknowns; return the share of it that is taken, at most
    1.

    The whole step is scaled so that no unknown moves by more than `work.sd` (`weigh_unknowns`).
    Then both soils are cut to within `FARTHEST` of the setting's mean, and tan phi of the present
    one, by which forces are computed, to `LEAST_TANGENT` or above. The returned share does not
    count what that cuts off.
    """
    u = memory.u
    share = 1.0
    for i in range(size):
        share = min(share, work.sd[i] / abs(work.step[i]))  # a step of 0 gives infinity
    for i in range(size):
        u[i] += share * work.step[i]
    for i in range(SOIL):
        low = setting.soil_mean[i] - FARTHEST * setting.soil_sd[i]
        high = setting.soil_mean[i] + FARTHEST * setting.soil_sd[i]
        u[i] = min(max(u[i], low), high)
        u[OLD + i] = min(max(u[OLD + i], low), high)
    u[TANGENT] = max(u[TANGENT], LEAST_TANGENT)
    return share


@compiled
def _fall(work, size, length, share):
    """Fall of chi-squared of the cells over a `share` of `work.step`, as the normal equations of
    `size` unknowns predict it.

    It is the fall of cells and prior together, less that of the prior. Gradients are minus half the
    slope of chi-squared. `length`: step times gradient, the squared length of the whole step in
    standard deviations.
    """
    step = work.step
    fall = share * (2.0 - share) * length
    for i in range(size):
        fall -= 2.0 * share * step[i] * work.prior_gradient[i]
        for j in range(size):
            fall += share * share * step[i] * step[j] * work.prior[i, j]
    return fall


@compiled
def renew(memory, setting, work):
    """Renew the unknowns `u` and the covariance of the soil by all cells, all in `memory`. Then
    renew `misfit` (of the forces), `law_misfit` (of the law of sinkage) and the form error.

    A misfit is chi-squared over the number of its residuals, after the last step. Chi-squared there
    is not computed anew: it is that before the step less the predicted fall (`_fall`). Forces and
    law of sinkage fall by the same share. Where the forces contradict the laws, the form error
    grows by the root of `misfit`, within `GROWS` and `FASTEST`. Where they agree, it shrinks to the
    believed one.
    """
    # Behind a border the soil before it and the place of the border are unknowns too.
    size = ALL if memory.behind > 0 else HERE
    weigh_unknowns(memory, setting, work)
    for _ in range(STEPS):
        forces, sinkage, others = _normal_equations(memory, setting, work, size)
        factorise(work.normal, size, memory.factor)
        solve(memory.factor, size, work.gradient, work.step)
        length = 0.0
        for i in range(size):
            length += work.step[i] * work.gradient[i]
        share = _apply_step(memory, setting, work, size)
        before = max(forces + sinkage + others, LEAST_CHI_SQUARED)
        # chi-squared after the step [of that before]
        left = max(1.0 - _fall(work, size, length, share) / before, 0.0)
        if share == 1.0 and length < SETTLED:
            break
    invert(memory.factor, SOIL, work.scratch, memory.covariance)
    changes = 0.0  # of sinkage, which have a residual of the law of sinkage
    for k in range(memory.cells_kept):
        changes += min(memory.cells[k].changes, 1.0)
    memory.misfit = left * forces / (2.0 * memory.cells_kept)
    memory.law_misfit = left * sinkage / max(changes, 1.0)
    if memory.misfit > CONTRADICTS:
        grown = min(max(math.sqrt(memory.misfit), GROWS), FASTEST) * memory.form_error
        memory.form_error = min(grown, max(LARGEST_ERROR, setting.model_error))
    elif memory.misfit < AGREES * CONTRADICTS:
        memory.form_error = max(memory.form_error / SHRINKS, setting.model_error)
