"""Estimator on board of simulated rovers: an identifier a wheel, and what all wheels of a rover know together.

As `driving.estimator`, it reads the record of a step after the world has made it.
"""

from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_inline, compiled_part, compiled_root
from soil_env.driving.estimator import knowledge
from soil_env.identification.online.identifier import (
    HELD,
    IdentifierNumbers,
    Identifiers,
    forget,
    identifier_numbers,
    new_identifiers,
    observe,
)
from soil_env.identification.online.pooling import share
from soil_env.identification.online.status import Status
from soil_env.identification.online.stretches import (
    PoolNumbers,
    Pools,
    forget_stretches,
    new_pools,
    note,
    pool_numbers,
)
from soil_env.parameters import RoverScenario
from soil_env.simulation.rover.task import first_soil
from soil_env.simulation.task.observation import clip, write_estimate
from soil_env.simulation.task.rules import TaskNumbers, information_term, total_of
from soil_env.simulation.wheels import RESTART, RUNNING, STEP, load_reading
from soil_env.simulation.world.wheel import wheel_of

_LOAD_DRIFT = 0.05  # 1-sigma of the change of the load on a wheel from one point of the identifier to the next
_CONVERGED = Status.CONVERGED.value


class RoverEstimator(NamedTuple):
    """Memory of the estimators of many rovers, one row a wheel."""

    ids: Identifiers
    known: Pools  # what all wheels of a rover have identified of the soil under each


class RoverEstimatorNumbers(NamedTuple):
    """Numbers of the scenario that the estimator needs."""

    identifier: IdentifierNumbers
    pool: PoolNumbers
    task: TaskNumbers
    places: np.ndarray  # [axles] behind the front axle [m]


def new_rover_estimator(wheels: int) -> RoverEstimator:
    """Estimators of so many wheels, to be restarted."""
    return RoverEstimator(new_identifiers(wheels), new_pools(wheels))


def rover_estimator_numbers(scenario: RoverScenario, task: TaskNumbers) -> RoverEstimatorNumbers:
    """Pack the beliefs of a scenario."""
    return RoverEstimatorNumbers(
        _identifier_numbers(scenario),
        pool_numbers(scenario),
        task,
        np.array(scenario.vehicle.axles),
    )


def _identifier_numbers(scenario: RoverScenario) -> IdentifierNumbers:
    """Numbers of an identifier a wheel.

    The body's accelerometer says nothing of one wheel, nor does the body's pitch of the grade under it, and the load on
    a wheel changes with the pull. Nor does the torque of a motor whose speed loop turns the wheel faster or slower:
    that at the end of a period is not the mean over it.
    """
    numbers = identifier_numbers(scenario)
    noise = numbers.filter.noise.copy()
    noise[9] = 1e6 * scenario.gravity
    if scenario.control.action != "torque":
        noise[8] = 1e6 * scenario.weight * scenario.wheel.radius
    own = numbers.filter._replace(noise=noise, grade_change=0.0, load_drift=_LOAD_DRIFT)
    return numbers._replace(filter=own)


@compiled_part
def _restart(estimator, numbers, results, j):
    """Set the estimators of rover j to their prior, at the start of a course."""
    axles = numbers.places.size
    for a in range(axles):
        k = wheel_of(j, a, axles)
        forget(estimator.ids, k, numbers.identifier)
        forget_stretches(estimator.known, estimator.ids, k)
    _show(estimator, numbers, results, j)


@compiled_inline
def _knowledge(estimator, numbers, j):
    """Mean of `knowledge` over the axles of rover j."""
    axles = numbers.places.size
    known = 0.0
    for a in range(axles):
        known += knowledge(estimator.known, wheel_of(j, a, axles), numbers.identifier.precision)
    return known / axles


@compiled_inline
def _after_period(estimator, numbers, record, results, j, period):
    """Take the record of a control period of rover j."""
    axles = numbers.places.size
    task = numbers.task
    furthest = HELD
    paid = task.reward.information > 0.0
    before = _knowledge(estimator, numbers, j) if paid and period == 0 else 0.0
    for a in range(axles):
        k = wheel_of(j, a, axles)
        outcome = observe(
            estimator.ids, k, load_reading(record.readings[k, period]), numbers.identifier
        )
        place = record.places[j, period] - numbers.places[a]
        note(estimator.known, estimator.ids, k, place, outcome, a > 0, numbers.pool)
        furthest = max(furthest, outcome)
    front = wheel_of(j, 0, axles)
    share(estimator.known, estimator.ids, front, axles, furthest, numbers.pool, numbers.identifier)
    if paid:
        after = _knowledge(estimator, numbers, j) if period == task.repeat - 1 else 0.0
        cause = results.cause[j] if period == record.periods[j] - 1 else RUNNING
        results.terms[j, 3] += information_term(cause, before, after, task)


@compiled_part
def _step(estimator, numbers, record, results, j):
    """Take the record of a step of rover j."""
    for period in range(record.periods[j]):
        _after_period(estimator, numbers, record, results, j, period)
    if numbers.task.reward.information > 0.0:
        results.reward[j] = total_of(results.terms[j])
    _show(estimator, numbers, results, j)


@compiled_inline
def _show(estimator, numbers, results, j):
    """Fill what is identified into the observation of rover j, if its variant has it."""
    known = estimator.known
    task = numbers.task
    out = results.observation[j]
    axles = numbers.places.size
    if task.variant != 1:
        return
    for a in range(axles):
        k = wheel_of(j, a, axles)
        converged = known.status[k] == _CONVERGED
        o = out[first_soil(axles) + 13 * a :]
        write_estimate(o, known.estimate[k], known.sd[k], known.best_pull[k], converged, task)
    clip(out, task)


@compiled_root(nogil=True)
def estimate_rovers(estimator, numbers, record, results, what, first, end):
    """Follow the orders `what` [rovers] of the rovers `first` to `end` - 1, which the world has followed."""
    for j in range(first, end):
        if what[j] == STEP:
            _step(estimator, numbers, record, results, j)
        elif what[j] == RESTART:
            _restart(estimator, numbers, results, j)
