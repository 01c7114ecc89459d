"""Memory of the filter (`filter`): what a bank of eight filters holds, and its prior.

The states are those of `linearised`; on a border (`border`) they are followed by the six of the old soil, the place
[m] of the border and the rise [rad] of the grade from one soil to the next.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, part
from soil_env._numba.lanes import COUNT, fetch, from_array, to_array
from soil_env._numba.rows import Rows, rows, zero_column
from soil_env.identification.linearised import (
    COHESION,
    LN_DEPTH,
    LN_K,
    SINKAGE,
    STATES,
    STRENGTH,
    Reference,
    mobilised_share,
)
from soil_env.identification.mixture_prior import MixturePrior, mixture_prior
from soil_env.identification.readings import sensor_noise
from soil_env.parameters import Scenario

PUBLISHED = 5  # (phi, ln K, ln S, c, ln g)
OLD, PLACE, RISE = STATES, STATES + SINKAGE, STATES + SINKAGE + 1
CROSSING = STATES + SINKAGE + 2  # states on a border
TRIANGLE = CROSSING * (CROSSING + 1) // 2
MEANS, COVARIANCES = CROSSING * COUNT, TRIANGLE * COUNT
CANDIDATES = 2 * COUNT  # places of a border that are tested at a time
STAYS = COUNT - 1  # the filter to which the soil stays the same on a border
#: Power of the likelihood by which the filters of a library are weighed: by the likelihood itself they are too sure
#: behind borders (tempered likelihood: Gruenwald & van Ommen 2017, Bayesian Analysis 12:1069-1103). Set on courses of
#: seeds 7001 and 7002.
POWER_OF_SOILS = 0.5
#: The open point of each bank, sums over its readings, and its clocks.
FilterPoint: type[Rows] = rows(
    "FilterPoint", "slip", "sinkage", "drawbar_pull", "load", "torque", "speed", "rim_speed", "pitch", "motor_torque",
    "acceleration", "path_sum", "sliding_sum", "shock_sum", "time_sum", "readings", "length", "first_slip", "first_rim",
    "path", "sliding", "shock", "time",  # integrals of A dt, |r w - V| dt / l and |d(r w)| dt / l since `forget`; [s]
    "path_at", "sliding_at", "shock_at", "time_at",  # at the last point
    "last_speed", "last_rim", "rim_at", "rim_time", "misfit", "points", "displacement", "stress",
    "place", "furthest", "lowest",  # [m] of the wheel, by slip and rim speed; `digging.onto_fresh_ground`
    "first_place", "place_sum", "place_square",  # [m] of the readings of the open point, the sums from its first on
    "bearing",  # [m] bearing sinkage at the last point
    "crossing", "border", "by_forces",  # 1 on a border; [m] where its middle is; 1 if the forces told of it
    "grade", "grades", "grade_used",  # [rad] of this soil; readings of it; 1 if those of the open point are used
    "nearest",  # [m] first of the places of a border that are tested
)  # fmt: skip


class FilterBanks(NamedTuple):
    """Memory of many banks of filters; eight numbers, one a filter, lie side by side."""

    mean: np.ndarray  # [wheels, CROSSING x 8]
    covariance: np.ndarray  # [wheels, TRIANGLE x 8], the lower triangle row by row, so that the old soil is behind
    log_weight: np.ndarray  # [wheels, 8]
    ln_bearing: np.ndarray  # [wheels, 8] ln of the bearing sinkage [m] at the last point
    point: Rows  # FilterPoint
    candidates: np.ndarray  # [wheels, 2 x CANDIDATES] A and B of the places of a border (`border`)


class FilterNumbers(NamedTuple):
    """What the filter takes from a `Scenario`."""

    radius: float
    width: float
    inertia: float
    gravity: float
    exponent: float  # of the belief
    dig_gain: float
    dig_recovery: float
    relaxation: float  # [m]
    period: float
    prior: MixturePrior
    noise: np.ndarray  # [10] of slip, sinkage, pull, load, torque, speed, rim speed, pitch, motor torque, acceleration
    model_error: float  # of the load
    border: float  # [m] over which one soil passes into the next, as believed
    grade_change: float  # [rad] sd of the rise of the grade from one soil to the next; 0: not looked at
    load_drift: float  # relative sd of the change of the load from point to point; 0: a constant mass under gravity
    power: float  # of the likelihood of a point, by which the filters are weighed
    offsets: np.ndarray  # [CANDIDATES] of the places of a border [m], from the first on


def filter_numbers(scenario: Scenario) -> FilterNumbers:
    """Pack what `take` needs; noise and priors are floored so that all stays finite."""
    b, w = scenario.belief, scenario.wheel
    weight = scenario.weight
    twist, top = weight * w.radius, w.radius * w.no_load_speed
    floor = [1e-3, 1e-4 * w.radius, 1e-3 * weight, 1e-3 * weight, 1e-3 * twist, 1e-3 * top, 1e-4 * top, 1e-4,
             1e-3 * twist, 1e-3 * scenario.gravity]  # fmt: skip
    return FilterNumbers(
        w.radius, w.width, w.inertia, scenario.gravity, b.sinkage_exponent, b.dig_gain, b.dig_recovery,
        scenario.relaxation * w.radius, scenario.control.period, mixture_prior(scenario),
        np.maximum(sensor_noise(scenario), floor), max(0.55 * b.model_error, 1e-3), b.border,
        math.radians(b.grade_change_deg), 0.0, POWER_OF_SOILS if b.soils else 1.0,
        b.border * np.arange(CANDIDATES) / (CANDIDATES - 1),
    )  # fmt: skip


def new_banks(wheels: int) -> FilterBanks:
    """Empty banks; `restart` sets one to the prior."""
    return FilterBanks(
        np.zeros((wheels, MEANS)),
        np.zeros((wheels, COVARIANCES)),
        np.zeros((wheels, COUNT)),
        np.full((wheels, COUNT), LN_DEPTH),
        FilterPoint(wheels),
        np.zeros((wheels, 2 * CANDIDATES)),
    )


@inlined
def element(i, j):
    """Place of element (i, j) of a packed symmetric matrix."""
    return (i * (i + 1) // 2 + j) * COUNT if i >= j else (j * (j + 1) // 2 + i) * COUNT


@inlined
def fetch_bank(banks, k):
    """Bring the covariance of bank k into the cache: with many wheels it is elsewhere."""
    size = COVARIANCES if banks.point.crossing[k] > 0.0 else element(STATES, 0)
    for i in range(0, size, COUNT):
        fetch(banks.covariance[k], i)


@inlined
def reference_of(banks, k):
    """`Reference` of the filters of wheel k."""
    return Reference(banks.point.displacement[k], banks.point.stress[k])


@inlined
def prior_mean(i, numbers, reference):
    """Mean of soil state i of the filters of a bank at its start."""
    prior = numbers.prior
    if i != STRENGTH:
        return from_array(prior.mean, i * COUNT)
    share, _ = mobilised_share(from_array(prior.mean, LN_K * COUNT), reference)
    strength = from_array(prior.tangent, 0) + (1.0 / reference.stress) * from_array(prior.mean, COHESION * COUNT)
    return strength * share


@inlined
def _with_strength(j, numbers, reference):
    """Covariance at the start of the strength mobilised, to first order, with the friction angle (j = 0) or state j."""
    prior = numbers.prior
    share, rate = mobilised_share(from_array(prior.mean, LN_K * COUNT), reference)
    tangent = from_array(prior.tangent, 0)
    strength = tangent + (1.0 / reference.stress) * from_array(prior.mean, COHESION * COUNT)
    return (
        share * (1.0 + tangent * tangent) * from_array(prior.covariance, element(0, j))
        + rate * strength * from_array(prior.covariance, element(LN_K, j))
        + (1.0 / reference.stress) * share * from_array(prior.covariance, element(COHESION, j))
    )


@inlined
def prior_covariance(i, j, numbers, reference):
    """Covariance of soil states i >= j of the filters of a bank at its start."""
    if j != STRENGTH:
        return from_array(numbers.prior.covariance, element(i, j))
    if i != STRENGTH:
        return _with_strength(i, numbers, reference)
    share, rate = mobilised_share(from_array(numbers.prior.mean, LN_K * COUNT), reference)
    tangent = from_array(numbers.prior.tangent, 0)
    strength = tangent + (1.0 / reference.stress) * from_array(numbers.prior.mean, COHESION * COUNT)
    return (
        share * (1.0 + tangent * tangent) * _with_strength(0, numbers, reference)
        + rate * strength * _with_strength(LN_K, numbers, reference)
        + (1.0 / reference.stress) * share * _with_strength(COHESION, numbers, reference)
    )


@inlined
def prior_of_soil(banks, k, numbers):
    """Reset the mean and the covariance of the soil of bank k to its prior; covariances with other states stay."""
    mean, covariance, reference = banks.mean[k], banks.covariance[k], reference_of(banks, k)
    for i in range(SINKAGE):
        to_array(prior_mean(i, numbers, reference), mean, i * COUNT)
        for j in range(i + 1):
            to_array(prior_covariance(i, j, numbers, reference), covariance, element(i, j))
    to_array(from_array(numbers.prior.log_weight, 0), banks.log_weight[k], 0)
    banks.point.misfit[k] = 0.0
    banks.point.points[k] = 0.0


@part
def restart(banks, k, numbers):
    """Set bank k back to its prior: nothing known of mass and sinkage either."""
    zero_column(banks.point, k)
    for i in range(MEANS):
        banks.mean[k, i] = 0.0
    for i in range(COVARIANCES):
        banks.covariance[k, i] = 0.0
    for i in range(COUNT):
        banks.log_weight[k, i], banks.ln_bearing[k, i] = 0.0, LN_DEPTH
    for i in range(2 * CANDIDATES):
        banks.candidates[k, i] = 0.0
    banks.point.displacement[k], banks.point.stress[k] = 0.1 * numbers.radius, 1.0 / (numbers.radius * numbers.width)
    prior_of_soil(banks, k, numbers)
