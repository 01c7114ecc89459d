"""Estimator on board of rovers: an identifier a wheel, and what all wheels of a rover know
together.

As `on_board`, it reads the record of a step after the world has made it.
"""

from typing import NamedTuple

import numpy as np

from soil_env.identification.online.axles import front_wheel, wheel_behind
from soil_env.identification.online.board import (
    OF_SOIL,
    BoardNumbers,
    OnBoard,
    add_information,
    board_numbers,
    clip,
    knowledge,
    load_reading,
    sum_reward,
    write_estimate,
)
from soil_env.identification.online.identifier import (
    HELD,
    IdentifierNumbers,
    Identifiers,
    forget,
    identifier_numbers,
    new_identifiers,
    observe,
)
from soil_env.identification.online.lanes.compiling import (
    compiled_inline,
    compiled_part,
    compiled_root,
)
from soil_env.identification.online.pooling import share
from soil_env.identification.online.stretches import (
    PoolNumbers,
    Pools,
    forget_stretches,
    new_pools,
    note,
    pool_numbers,
)
from soil_env.parameters import RoverScenario
from soil_env.parameters.readings import RESTART, STEP, Shown

_LOAD_DRIFT = 0.05  # 1-sigma, relative, of the load on a wheel from one point to the next


class RoverEstimator(NamedTuple):
    """Memory of the estimators of many rovers, one row a wheel (`axles`)."""

    ids: Identifiers
    known: Pools  # what all wheels of a rover have identified of the soil under each


class RoverEstimatorNumbers(NamedTuple):
    """Numbers of the scenario that the estimator needs."""

    identifier: IdentifierNumbers
    pool: PoolNumbers
    board: BoardNumbers
    places: np.ndarray  # [axles] behind the front axle [m]


def rovers_on_board(wheels: int, scenario: RoverScenario, shown: Shown) -> OnBoard:
    """Estimators of rovers with so many rows of wheels in all, to be restarted."""
    numbers = RoverEstimatorNumbers(
        rover_identifier_numbers(scenario),
        pool_numbers(scenario),
        board_numbers(scenario, shown),
        np.array(scenario.vehicle.axles),
    )
    return OnBoard(
        RoverEstimator(new_identifiers(wheels), new_pools(wheels)), numbers, estimate_rovers
    )


def rover_identifier_numbers(scenario: RoverScenario) -> IdentifierNumbers:
    """Numbers of an identifier a wheel.

    The body's accelerometer says nothing of one wheel, nor does the body's pitch of the grade under
    it, and the load on a wheel changes with the pull. Nor does the torque of a motor whose speed
    loop turns the wheel faster or slower: that at the end of a period is not the mean over it.
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
    front = front_wheel(j, axles)
    for a in range(axles):
        k = wheel_behind(front, a)
        forget(estimator.ids, k, numbers.identifier)
        forget_stretches(estimator.known, estimator.ids, k)
    _show(estimator, numbers, results, j)


@compiled_inline
def _knowledge(estimator, numbers, front):
    """Mean of `knowledge` over the axles of the rover whose front wheel is in row `front`."""
    axles = numbers.places.size
    known = 0.0
    for a in range(axles):
        k = wheel_behind(front, a)
        known += knowledge(estimator.known, k, numbers.identifier.precision)
    return known / axles


@compiled_inline
def _after_period(estimator, numbers, record, results, j, period):
    """Take the record of a control period of rover j."""
    axles = numbers.places.size
    front = front_wheel(j, axles)
    board = numbers.board
    furthest = HELD
    paid = board.information > 0.0
    before = _knowledge(estimator, numbers, front) if paid and period == 0 else 0.0
    for a in range(axles):
        k = wheel_behind(front, a)
        reading = load_reading(record.readings[k, period])
        outcome = observe(estimator.ids, k, reading, numbers.identifier)
        place = record.places[j, period] - numbers.places[a]
        note(estimator.known, estimator.ids, k, place, outcome, a > 0, numbers.pool)
        furthest = max(furthest, outcome)
    share(estimator.known, estimator.ids, front, axles, furthest, numbers.pool, numbers.identifier)
    if paid:
        after = _knowledge(estimator, numbers, front) if period == board.repeat - 1 else 0.0
        add_information(results, j, before, after, period == record.periods[j] - 1, board)


@compiled_part
def _step(estimator, numbers, record, results, j):
    """Take the record of a step of rover j."""
    for period in range(record.periods[j]):
        _after_period(estimator, numbers, record, results, j, period)
    if numbers.board.information > 0.0:
        sum_reward(results, j)
    _show(estimator, numbers, results, j)


@compiled_inline
def _show(estimator, numbers, results, j):
    """Fill what is identified into the observation of rover j, if it has that."""
    board = numbers.board
    if not board.shown.on:
        return
    out = results.observation[j]
    axles = numbers.places.size
    front = front_wheel(j, axles)
    for a in range(axles):
        o = out[board.shown.first + OF_SOIL * a :]
        write_estimate(o, estimator.known, wheel_behind(front, a), board.dig_gain)
    clip(out, board.shown)


@compiled_root(nogil=True)
def estimate_rovers(estimator, numbers, record, results, what, first, end):
    """Follow the orders `what` [rovers] of the rovers `first` to `end` - 1."""
    for j in range(first, end):
        if what[j] == STEP:
            _step(estimator, numbers, record, results, j)
        elif what[j] == RESTART:
            _restart(estimator, numbers, results, j)
