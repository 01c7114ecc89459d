"""Joint knowledge of the wheels of a rover that run over the same ground.

The front wheel finds borders by its forces, and those behind cross them where it has found them: so
the soils that they meet are numbered alike. Of each soil a wheel keeps what its readings say of
(tan phi, c, n, ln K). Its information is the inverse of their covariance less that of the prior,
which counts once (channel filter: Grime & Durrant-Whyte 1994, Control Engineering Practice
2:849-863). The information of the others is added to that of the wheel itself. No identifier is
given what is pooled, so nothing is counted twice.

`TRUST` of it counts, and less where two differ by more than they allow, by chi-squared over its
degrees of freedom (Birge 1932, Physical Review 40:207-227). Sinkage coefficient and gain of
slip-sinkage are not pooled: a wheel behind another bears on a floor whose stiffness has a scatter.
"""

import math

from soil_env._compiled.flags import compiled, inlined, record
from soil_env.identification.status import Status

from .borders import begin_border, blend_estimates, take_fresh
from .identifier import publish, status_of
from .library import join, mix, solve_joined
from .linear import add_gaussian, factorise, invert_whole, solve_half
from .memory import (
    BEST_PULL,
    ESTIMATES,
    KNOWLEDGE,
    OF_GROUND,
    PLACE,
    PUBLISHED_COHESION,
    PUBLISHED_LN_K,
    PUBLISHED_PHI,
)

# Soils that are kept of a wheel, own choice: the wheels behind are still on earlier ones.
SOILS = 4
SHARED = OF_GROUND  # unknowns that a passing wheel does not change: tan phi, c, n, ln K
# Standard deviations of errors that all wheels have alike, so that no comparison shows them: own
# choices.
ANGLE_ERROR = math.radians(0.6)  # [rad]
MODULUS_ERROR = 0.06  # [-] of ln K
COHESION_ERROR = 50.0  # [Pa]; with 100 intervals of cohesion that should hold 68 % held 92 %
# [-] Share of another wheel's information that counts, own choice: borders are found late, and all
# wheels err alike where the laws do.
TRUST = 0.5
# [border lengths] standard deviation of the place of a border that another wheel has found, own
# choice
PLACE_SD = 0.25

#: What the wheels of a rover know of the ground under one of them, and what it gives the others.
POOL = record(
    borders=("i8", SOILS),  # number of the soil in each place, -1: none
    border_places=("f8", SOILS),  # [m] middle of the border before that soil, by odometry
    shared=("f8", (SOILS, SHARED)),  # the shared unknowns by the wheel's own readings
    shared_covariance=("f8", (SOILS, SHARED, SHARED)),
    **KNOWLEDGE,  # by the readings of all wheels on the soil under this one
    status=("i8",),
    **ESTIMATES,
)


@compiled
def forget_pool(pool, memory):
    """Set a wheel's pool to the estimate of its identifier before the first point, with no soil."""
    pool.borders[:] = -1
    pool.status = memory.status
    pool.fresh = memory.estimate
    pool.fresh_sd = memory.sd
    _publish_fresh(pool)


@compiled
def _publish_fresh(pool):
    """Publish the fresh estimate of a `POOL`, and keep it as the old one for the next border."""
    take_fresh(pool)
    pool.old = pool.fresh
    pool.old_sd = pool.fresh_sd


@inlined
def keep_knowledge(pool, memory, setting, work):
    """Keep what a renewed identifier (`memory`) knows of its soil for the other wheels, in the
    `POOL` of its wheel.

    Kept are mean and covariance of the shared unknowns, under the prior of one Gaussian.

    The soil after the border with number n, counted by `memory.borders`, has the place n modulo
    `SOILS`, and replaces an earlier one there.
    """
    s = memory.borders % SOILS
    pool.borders[s] = memory.borders
    pool.border_places[s] = memory.u[PLACE]  # of the fit: sharper than where it was felt
    join(memory, memory.u, setting.soil_mean, setting.soil_precision, work)
    solve_joined(work)
    for i in range(SHARED):
        pool.shared[s, i] = memory.u[i] + work.step[i]
        for j in range(SHARED):
            pool.shared_covariance[s, i, j] = work.inverse[i, j]


@inlined
def hand_over_border(front, memory, behind, setting, work):
    """Begin the next border of a wheel that runs `behind` [m] behind the front one, where the front
    wheel has found it.

    It begins once the wheel has come within half a border's length of its middle.

    `front`: `POOL` of the front wheel; `memory`: `MEMORY` of the wheel behind. Nothing begins on a
    border, or if the front wheel has not found the next one. A border is passed over if a later
    soil has replaced its soil in the `POOL`.
    """
    number = memory.borders + 1
    while front.borders[number % SOILS] > number:
        number += 1
    s = number % SOILS
    if front.borders[s] != number or memory.crossing > 0.0:
        return
    place = front.border_places[s] + behind  # the odometry of each wheel begins at its own start
    if memory.place > place - 0.5 * setting.border:
        memory.borders = number - 1  # `begin_border` adds 1
        begin_border(memory, setting, work, place, (PLACE_SD * setting.border) ** 2)


@compiled
def _disagreement(memory, other, s, work):
    """Chi-squared, over its degrees of freedom, by which two wheels differ in the shared unknowns.

    One knows what its `memory` has, the other what its `POOL` `other` has kept of the soil in its
    place s of `SOILS`.
    """
    for i in range(SHARED):
        work.gradient[i] = other.shared[s, i] - memory.soil[i]
        for j in range(SHARED):
            work.normal[i, j] = other.shared_covariance[s, i, j] + memory.spread[i, j]
    factorise(work.normal, SHARED, work.factor)
    solve_half(work.factor, SHARED, work.gradient, work.step)
    total = 0.0
    for i in range(SHARED):
        total += work.step[i] ** 2
    return total / SHARED


@compiled
def _add_share(pool, u, covariance, mean, share, work):
    """Add a share of a Gaussian of the shared unknowns to the information of a `POOL`, and to the
    gradient of its log-likelihood at u.

    The Gaussian has this `covariance` [4, 4] and `mean` [4]. A negative share takes it away.
    """
    invert_whole(covariance, SHARED, work, work.inverse)
    add_gaussian(work.inverse, mean, u, share, SHARED, pool.information, pool.gradient)


@inlined
def pool_with(pools, axles, own, memory, setting, work):
    """Renew what all wheels of a rover know of the ground under the one on the axle `own`, in its
    `POOL` of `pools` [axles]; `memory`: `MEMORY` of its identifier.

    Of each other wheel that has kept this soil a share of its Gaussian is added, less the same
    share of the prior in it. Errors that all wheels share are added to the sds of phi, ln K and c.
    On a border the blend with the old estimate is published. The best pull stays that of this
    wheel's own readings. Before the first point, the pool is reset.
    """
    pool = pools[own]
    if memory.status == Status.NO_DATA.value:
        forget_pool(pool, memory)
        return
    pool.information = memory.information
    pool.gradient = memory.gradient
    s = memory.borders % SOILS
    u = memory.u
    for a in range(axles):
        other = pools[a]
        if a != own and other.borders[s] == memory.borders:
            share = TRUST / max(_disagreement(memory, other, s, work), 1.0)
            _add_share(pool, u, other.shared_covariance[s], other.shared[s], share, work)
            _add_share(pool, u, setting.soil_covariance, setting.soil_mean, -share, work)
    mix(pool, u, setting, work)
    publish(pool.soil, pool.spread, pool, memory, setting)
    sd = pool.fresh_sd
    for i, error in (
        (PUBLISHED_PHI, ANGLE_ERROR),
        (PUBLISHED_LN_K, MODULUS_ERROR),
        (PUBLISHED_COHESION, COHESION_ERROR),
    ):
        sd[i] = math.hypot(sd[i], error)
    if memory.crossing > 0.0:
        blend_estimates(pool, memory, setting)
    else:
        _publish_fresh(pool)
    pool.estimate[BEST_PULL] = memory.estimate[BEST_PULL]  # by the readings of this wheel alone
    pool.sd[BEST_PULL] = memory.sd[BEST_PULL]
    pool.status = status_of(pool, memory.status == Status.MISFIT.value, setting)
