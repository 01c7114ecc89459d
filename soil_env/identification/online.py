"""Online identification: estimate, standard deviations and status, by the filter or by the moving window.

Both (`filter`, `window`) see sensor readings only, and publish the same numbers of their estimates.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, part, root
from soil_env._numba.rows import Rows, zero_column
from soil_env.identification.digging import KEPT, Digging, DiggingPlaces
from soil_env.identification.filter import CONTRADICTION_OF_POINTS, take as take_by_filter
from soil_env.identification.filter_bank import STAYS, FilterBanks, FilterNumbers, filter_numbers, new_banks, restart
from soil_env.identification.filter_estimate import publish
from soil_env.identification.mixture_prior import moments, prior_of_belief
from soil_env.identification.normal_equations import SIZE
from soil_env.identification.point import Points, Reading
from soil_env.identification.readings import SensorReading, sensor_noise
from soil_env.identification.solver import Status
from soil_env.identification.window import WINDOW, OpenPoint, take as take_by_window
from soil_env.parameters import Scenario

#: What a set of readings did to the estimate: nothing; the wheel is elsewhere on a border, and so on other ground; it
#: completed a point.
HELD, MOVED, RENEWED = 0, 1, 2
FARTHEST = 60.0  # |ln| of K, of S and of the gain over its prior, beyond which an estimate is that of no soil
KNOWN = 1e-4  # standard deviation, relative, of what the belief holds for known
_HALF = math.log(0.5)  # ln probability of the soil having stayed the same, below which a border is counted


class Identifiers(NamedTuple):
    """Memory of many identifiers: arrays with one row a wheel."""

    points: Rows  # Points, WINDOW columns a wheel
    count: np.ndarray  # [wheels] points in the window
    open: Rows  # OpenPoint
    digging: Rows  # Digging
    places: Rows  # DiggingPlaces, KEPT columns a wheel
    estimate: np.ndarray  # [wheels, 5] the published estimate, in the order of `IdentifierNumbers.prior`
    sd: np.ndarray  # [wheels, 5] its standard deviations
    status: np.ndarray  # [wheels] `Status`
    trial: np.ndarray  # [wheels, 5] the newest solution, published or not
    covariance: np.ndarray  # [wheels, 5, 5] of it
    condition: np.ndarray  # [wheels] largest posterior over prior standard deviation (1 = nothing learnt)
    banks: FilterBanks  # of the method "filter"
    borders: np.ndarray  # [wheels] to another soil that the filter has found since `forget`


class Replay(NamedTuple):
    """What each of T sets of readings did, and what was known after it."""

    outcome: np.ndarray  # [T] `HELD`, `MOVED` or `RENEWED`
    estimate: np.ndarray  # [T, 5] as in `Identifiers`
    sd: np.ndarray  # [T, 5]
    status: np.ndarray  # [T] `Status`


def new_replay(count: int) -> Replay:
    """For `observe_rows` with `count` sets of readings."""
    whole = np.zeros((2, count), dtype=np.int64)
    return Replay(whole[0], np.zeros((count, 5)), np.zeros((count, 5)), whole[1])


class IdentifierNumbers(NamedTuple):
    """What the identifier takes from a `Scenario`."""

    reading: Reading
    prior: np.ndarray  # [5] of (phi, ln K, ln S, cohesion, ln(gain of digging / dig_gain))
    precision: np.ndarray  # [5] of the prior
    slip_sd: float
    sinkage_sd: float
    force_sd: np.ndarray  # [3] drawbar pull [N], load [N], torque [N m]
    model_error: float
    dig_gain: float
    dig_recovery: float
    relaxation: float  # [m]
    memory: float  # [m]
    period: float  # [s]
    by_filter: bool
    off: bool  # nothing is identified
    filter: FilterNumbers


def identifier_numbers(scenario: Scenario) -> IdentifierNumbers:
    """Pack what `observe` needs; the noise of a channel is floored at a millionth so that weights stay finite."""
    b, w, weight, noise = scenario.belief, scenario.wheel, scenario.weight, sensor_noise(scenario)
    prior = [math.radians(b.friction_angle_deg), math.log(b.shear_modulus), math.log(b.sinkage_coefficient)]
    sd = [math.radians(b.friction_sd_deg), b.shear_modulus_sd, b.sinkage_coefficient_sd]
    sd += [max(b.cohesion_sd, KNOWN * weight / (w.radius * w.width)), max(b.dig_gain_sd, KNOWN)]
    if b.method == "filter" and b.soils:  # the first two moments of the library
        mean, covariance = moments(prior_of_belief(scenario))
        prior, sd = [*mean[:3]], [*np.sqrt(np.diag(covariance))[:3], *sd[3:]]
    return IdentifierNumbers(
        Reading(b.cohesion, b.sinkage_exponent, w.radius, w.width, 0, False),
        np.array([*prior, b.cohesion, 0.0]),
        1.0 / np.square(sd),
        noise[0],
        noise[1],
        np.maximum(noise[2:5], 1e-6 * weight),
        b.model_error,
        b.dig_gain,
        b.dig_recovery,
        scenario.relaxation * w.radius,
        b.memory,
        scenario.control.period,
        b.method == "filter",
        b.method == "none",
        filter_numbers(scenario),
    )


def new_identifiers(wheels: int) -> Identifiers:
    """Empty identifiers; `forget` sets one to the prior."""
    return Identifiers(
        Points(wheels * WINDOW),
        np.zeros(wheels, dtype=np.int64),
        OpenPoint(wheels),
        Digging(wheels),
        DiggingPlaces(wheels * KEPT),
        np.zeros((wheels, SIZE)),
        np.zeros((wheels, SIZE)),
        np.zeros(wheels, dtype=np.int64),
        np.zeros((wheels, SIZE)),
        np.zeros((wheels, SIZE, SIZE)),
        np.ones(wheels),
        new_banks(wheels),
        np.zeros(wheels, dtype=np.int64),
    )


@part
def forget(ids, k, numbers):
    """Set identifier k back to its prior."""
    ids.count[k] = ids.borders[k] = 0
    zero_column(ids.open, k)
    zero_column(ids.digging, k)
    for i in range(SIZE):
        ids.estimate[k, i] = ids.trial[k, i] = numbers.prior[i]
        ids.sd[k, i] = 1.0 / math.sqrt(numbers.precision[i])
    ids.status[k] = Status.NO_DATA.value
    ids.condition[k] = 1.0
    restart(ids.banks, k, numbers.filter)


@inlined
def observe(ids, k, reading, numbers):
    """Take one set of readings: `HELD`, `MOVED` or `RENEWED`."""
    if numbers.off:
        return HELD
    if numbers.by_filter:
        return _observe_by_filter(ids, k, reading, numbers)
    return RENEWED if take_by_window(ids, k, reading, numbers) else HELD


@root(nogil=True)
def observe_rows(
    ids: Identifiers,
    wheels: np.ndarray,
    readings: np.ndarray,
    numbers: IdentifierNumbers,
    replay: Replay,
) -> None:
    """`observe` of `readings` [T, 10], in the order of `SensorReading`; row t is of wheel `wheels[t]`."""
    for t in range(wheels.size):
        k, r = wheels[t], readings[t]
        reading = SensorReading(r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9])
        replay.outcome[t] = observe(ids, k, reading, numbers)
        for i in range(replay.estimate.shape[1]):
            replay.estimate[t, i], replay.sd[t, i] = ids.estimate[k, i], ids.sd[k, i]
        replay.status[t] = ids.status[k]


@inlined
def _observe_by_filter(ids, k, reading, numbers):
    p, crossed = ids.banks.point, ids.banks.point.crossing[k]
    done = take_by_filter(ids.banks, k, reading, numbers.filter)
    if not done and p.crossing[k] == 0.0:
        return HELD
    if p.crossing[k] > crossed:
        ids.borders[k] += int(p.by_forces[k])
    elif p.crossing[k] < crossed and p.by_forces[k] == 0.0 and ids.banks.log_weight[k, STAYS] < _HALF:
        ids.borders[k] += 1  # the grade told of a border, and it was one of soil
    # on a border the soil under the wheel changes from reading to reading
    publish(ids.banks, k, numbers.filter, ids.estimate[k], ids.sd[k], ids.covariance[k])
    if max(abs(ids.estimate[k, 1]), abs(ids.estimate[k, 2]), abs(ids.estimate[k, 4])) > FARTHEST:
        forget(ids, k, numbers)
        return RENEWED
    learnt = 0.0
    for i in range(2):  # friction and shear deformation modulus need a range of slip
        learnt = max(learnt, ids.sd[k, i] * math.sqrt(numbers.precision[i]))
    ids.condition[k] = learnt
    if p.misfit[k] > CONTRADICTION_OF_POINTS:
        ids.status[k] = Status.MISFIT.value
    else:
        ids.status[k] = Status.CONVERGED.value if learnt <= 0.6 else Status.NOT_EXCITED.value
    return RENEWED if done else MOVED
