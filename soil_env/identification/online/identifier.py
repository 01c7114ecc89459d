"""Online identification: estimate, standard deviations and status, by the filter."""

import math
from typing import NamedTuple

import numpy as np

from soil_env.identification.online.best_pull import prior_pull
from soil_env.identification.online.filter import CONTRADICTION_OF_POINTS, take
from soil_env.identification.online.filter_bank import (
    FilterBanks,
    FilterNumbers,
    filter_numbers,
    new_banks,
    restart,
)
from soil_env.identification.online.filter_estimate import OF_PULL, PUBLISHED as SIZE, publish
from soil_env.identification.online.lanes.compiling import (
    compiled_inline,
    compiled_part,
    compiled_root,
)
from soil_env.identification.online.soil_prior import depth_of, prior_of_belief, published_prior
from soil_env.identification.status import Status
from soil_env.parameters import Scenario
from soil_env.parameters.readings import SensorReading

#: Outcomes of a set of readings: the estimate is as before; the wheel moved on a border, and so to
#: other ground; a point was completed.
HELD = 0
MOVED = 1
RENEWED = 2
_MAY_BE_NEXT = 0.02  # `next_square` above which the pull is renewed with every point
_OFTEN = 4.0  # points of a soil after which the best drawbar pull is renewed with every third one
# |ln| of K, of S and of the gain over its prior, beyond which an estimate is that of no soil
FARTHEST = 60.0


class Identifiers(NamedTuple):
    """Memory of many identifiers: arrays with one row a wheel."""

    # [wheels, 5] the published estimate, in the order of `IdentifierNumbers.prior`
    estimate: np.ndarray
    sd: np.ndarray  # [wheels, 5] its standard deviations
    status: np.ndarray  # [wheels] `Status`
    covariance: np.ndarray  # [wheels, 5, 5] of it
    # [wheels, 2] best steady drawbar pull [of load] and its standard deviation
    best_pull: np.ndarray
    banks: FilterBanks
    borders: np.ndarray  # [wheels] to another soil that the filter has found since `forget`


class IdentifierNumbers(NamedTuple):
    """Numbers of a `Scenario` that the identifier needs."""

    prior: np.ndarray  # [5] of (phi, ln K, ln S, cohesion, ln(gain of digging / dig_gain))
    prior_covariance: np.ndarray  # [5, 5]
    prior_pull: np.ndarray  # [2] best steady drawbar pull [of load], its standard deviation
    precision: np.ndarray  # [5] of the prior, each on its own
    off: bool  # nothing is identified
    filter: FilterNumbers


def identifier_numbers(scenario: Scenario) -> IdentifierNumbers:
    """Pack what `observe` needs."""
    prior, covariance = published_prior(scenario)
    pull, variance = prior_pull(*prior_of_belief(scenario), depth_of(scenario), scenario)
    pull_sd = OF_PULL * math.sqrt(variance)
    return IdentifierNumbers(
        prior,
        covariance,
        np.array([pull, pull_sd]),
        1.0 / np.diag(covariance),
        scenario.belief.method == "none",
        filter_numbers(scenario),
    )


def new_identifiers(wheels: int) -> Identifiers:
    """Empty identifiers; `forget` sets one to the prior."""
    estimate, sd = np.zeros((2, wheels, SIZE))
    status, borders = np.zeros((2, wheels), dtype=np.int64)
    covariance = np.zeros((wheels, SIZE, SIZE))
    pull = np.zeros((wheels, 2))
    return Identifiers(estimate, sd, status, covariance, pull, new_banks(wheels), borders)


@compiled_part
def forget(ids, k, numbers):
    """Set identifier k back to its prior."""
    ids.borders[k] = 0
    for i in range(SIZE):
        ids.estimate[k, i] = numbers.prior[i]
        ids.sd[k, i] = 1.0 / math.sqrt(numbers.precision[i])
        for j in range(SIZE):
            ids.covariance[k, i, j] = numbers.prior_covariance[i, j]
    ids.best_pull[k, 0] = numbers.prior_pull[0]
    ids.best_pull[k, 1] = numbers.prior_pull[1]
    ids.status[k] = Status.NO_DATA.value
    restart(ids.banks, k, numbers.filter)


@compiled_inline
def observe(ids, k, reading, numbers):
    """Take one set of readings: `HELD`, `MOVED` or `RENEWED`."""
    if numbers.off:
        return HELD
    p = ids.banks.point
    crossed = ids.banks.point.crossing[k]
    done = take(ids.banks, k, reading, numbers.filter)
    if not done and p.crossing[k] == 0.0:
        return HELD
    if p.mass[k] == 0.0:  # readings that no wheel gives: the filter has started anew
        forget(ids, k, numbers)
        return RENEWED
    if p.crossing[k] > crossed:
        ids.borders[k] += int(p.by_forces[k])
    elif p.crossing[k] < crossed and p.by_forces[k] == 0.0 and p.same[k] == 0.0:
        ids.borders[k] += 1  # the grade showed a border, and the soil changed there
    # on a border the soil under the wheel changes from reading to reading
    often = p.crossing[k] > 0.0 or p.points[k] < _OFTEN or p.next_square[k] > _MAY_BE_NEXT
    anew = done and (often or p.points[k] % 3.0 == 0.0)
    publish(
        ids.banks,
        k,
        numbers.filter,
        ids.estimate[k],
        ids.sd[k],
        ids.covariance[k],
        ids.best_pull[k],
        anew,
    )
    if (
        not max(abs(ids.estimate[k, 1]), abs(ids.estimate[k, 2]), abs(ids.estimate[k, 4]))
        < FARTHEST
    ):
        forget(ids, k, numbers)
        return RENEWED
    learnt = 0.0
    for i in range(2):  # friction and shear deformation modulus need a range of slip
        learnt = max(learnt, ids.sd[k, i] * math.sqrt(numbers.precision[i]))
    if p.flagged[k] > 0.0 or p.misfit[k] > CONTRADICTION_OF_POINTS:
        ids.status[k] = Status.MISFIT.value
    else:
        ids.status[k] = Status.CONVERGED.value if learnt <= 0.6 else Status.NOT_EXCITED.value
    return RENEWED if done else MOVED


@compiled_root(nogil=True)
def observe_values(ids: Identifiers, k: int, values: np.ndarray, numbers: IdentifierNumbers) -> int:
    """`observe` of the `values` [10] of a `SensorReading`."""
    v = values
    return observe(
        ids, k, SensorReading(v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9]), numbers
    )
