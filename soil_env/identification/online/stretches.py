"""Stretches of one soil that the wheels of a rover have run over, with the estimate of each wheel.

The soil between two borders is a stretch. When it leaves one, a wheel keeps its estimate of (phi,
ln K, c) for the wheels that come after it (`pooling`). These also receive the border that the front
wheel has found: their filters begin with the new soil there (`border.begin_known_border`), and do
not first take it for the old.
"""

import math
from typing import NamedTuple

import numpy as np

from soil_env.identification.online.border import begin_known_border
from soil_env.identification.online.identifier import RENEWED, identifier_numbers
from soil_env.identification.online.lanes.compiling import compiled_inline, compiled_part
from soil_env.identification.online.lanes.lanes import COUNT
from soil_env.identification.online.sinkage_filter import PRESSURE, cell
from soil_env.identification.status import Status
from soil_env.parameters import Scenario

UNKNOWNS = 5  # (phi, ln K, ln S, c, ln g), as `Identifiers.estimate`
SHARED = 3  # unknowns that a passing wheel does not change: phi, ln K, c
BELIEF = SHARED + SHARED * SHARED
STRETCHES = 4  # that a wheel remembers
#: 1-sigma of what pooling leaves out of (phi [rad], ln K, ln S, c [Pa], ln g): errors that all
#: wheels have alike, borders that are found late. Set on courses of seed 779, so that 68 %
#: intervals hold as much. Method: docs/physics/estimation.md.
ERROR_OF_MODEL = np.array([math.radians(0.6), 0.06, 0.0, 100.0, 0.0])
COHESION = 3
WHICH = np.array([0, 1, COHESION])  # of the unknowns are shared
# estimates are taken this many points before a border was found, so that they hold nothing from
# behind it
LAG = 3
AT_START = -1e6  # [m] where the first stretch begins, for all wheels
# 1-sigma of the change of ln S along a rut, from one point of the filter to the next
RUT_DRIFT = 0.1
_PLACE_SD = 0.1  # of the length of a border: 1-sigma of the place that another wheel has found
_NO_DATA = Status.NO_DATA.value


class Pools(NamedTuple):
    """Memory of the wheels of many rovers: arrays with one row a wheel (`axles`).

    A belief is (mean [3], covariance [3 x 3]) of (phi, ln K, c). Places [m] are of the odometry.
    """

    estimate: np.ndarray  # [wheels, 5] pooled, of the soil under the wheel
    sd: np.ndarray  # [wheels, 5]
    best_pull: np.ndarray  # [wheels, 2] and its standard deviation, by the wheel's own readings
    status: np.ndarray  # [wheels] `Status`
    place: np.ndarray  # [wheels] where it is
    start: np.ndarray  # [wheels] where the stretch under the wheel begins
    crossing: np.ndarray  # [wheels] 1 while its filter is on a border
    points: np.ndarray  # [wheels] that the filter has taken in on this stretch
    last: np.ndarray  # [wheels, LAG, 12] beliefs after the last points, the newest first
    left: np.ndarray  # [wheels] number of stretches left behind
    begins: np.ndarray  # [wheels, STRETCHES] of those
    ends: np.ndarray  # [wheels, STRETCHES]
    belief: np.ndarray  # [wheels, STRETCHES, 12]; variance 0 where nothing was known


class PoolNumbers(NamedTuple):
    """Numbers of a `Scenario` that `pooling.share` needs."""

    prior: np.ndarray  # [12] belief before any reading
    sd: np.ndarray  # [5] of it
    border: float  # [m] that a border is believed to be long
    rut_drift: float  # 1-sigma of the change of ln S in a rut from point to point
    error: np.ndarray  # [5] `ERROR_OF_MODEL`


def new_pools(wheels: int) -> Pools:
    """Empty memory; `forget_stretches` sets one wheel to the prior."""
    estimate, sd = np.zeros((2, wheels, UNKNOWNS))
    begins, ends = np.zeros((2, wheels, STRETCHES))
    status, left = np.zeros((2, wheels), dtype=np.int64)
    place, crossing, points = np.zeros((3, wheels))
    last = np.zeros((wheels, LAG, BELIEF))
    belief = np.zeros((wheels, STRETCHES, BELIEF))
    start = np.full(wheels, AT_START)
    pull = np.zeros((wheels, 2))
    return Pools(
        estimate, sd, pull, status, place, start, crossing, points, last, left, begins, ends, belief
    )


def pool_numbers(scenario: Scenario) -> PoolNumbers:
    """Pack what `share` needs."""
    numbers = identifier_numbers(scenario)
    prior = np.concatenate(
        [numbers.prior[WHICH], numbers.prior_covariance[np.ix_(WHICH, WHICH)].ravel()]
    )
    sd = 1.0 / np.sqrt(numbers.precision)
    return PoolNumbers(prior, sd, scenario.belief.border, RUT_DRIFT, ERROR_OF_MODEL)


@compiled_part
def forget_stretches(pools, ids, k):
    """Set wheel k, whose identifier has just been reset, back to the prior."""
    pools.start[k] = AT_START
    pools.crossing[k] = 0.0
    pools.points[k] = 0.0
    pools.left[k] = 0
    take_own(pools, ids, k)


@compiled_inline
def take_own(pools, ids, k):
    """Set the pooled estimate of wheel k to that of its own filter."""
    for i in range(UNKNOWNS):
        pools.estimate[k, i] = ids.estimate[k, i]
        pools.sd[k, i] = ids.sd[k, i]
    pools.best_pull[k, 0] = ids.best_pull[k, 0]
    pools.best_pull[k, 1] = ids.best_pull[k, 1]
    pools.status[k] = ids.status[k]


@compiled_inline
def _believe(ids, k, belief):
    """The newest posterior of wheel k into a belief [12]."""
    for i in range(SHARED):
        belief[i] = ids.estimate[k, WHICH[i]]
        for j in range(SHARED):
            belief[SHARED * (i + 1) + j] = ids.covariance[k, WHICH[i], WHICH[j]]


@compiled_inline
def copy_belief(source, target):
    """A belief [12] into another."""
    for i in range(BELIEF):
        target[i] = source[i]


@compiled_inline
def _leave(pools, k, end):
    """Store the stretch that wheel k leaves at `end` [m]."""
    if pools.left[k] == STRETCHES:
        for s in range(STRETCHES - 1):
            pools.begins[k, s] = pools.begins[k, s + 1]
            pools.ends[k, s] = pools.ends[k, s + 1]
            copy_belief(pools.belief[k, s + 1], pools.belief[k, s])
        pools.left[k] -= 1
    s = pools.left[k]
    pools.begins[k, s] = pools.start[k]
    pools.ends[k, s] = end
    if pools.points[k] >= LAG:
        copy_belief(pools.last[k, LAG - 1], pools.belief[k, s])
    else:
        for i in range(BELIEF):
            pools.belief[k, s, i] = 0.0
    pools.left[k] = s + 1


@compiled_part
def note(pools, ids, k, x, outcome, in_rut, numbers):
    """Follow the filter of wheel k at x [m] over stretches and borders; `outcome` of its `observe`.

    `in_rut`: True if it runs behind other wheels.
    """
    p = ids.banks.point
    pools.place[k] = x
    if ids.status[k] == _NO_DATA:  # as at the start, and where the filter has just begun anew
        pools.start[k] = AT_START if pools.left[k] == 0 else x
        pools.crossing[k] = 0.0
        pools.points[k] = 0.0
        return
    border = p.border[k] + x - p.place[k]
    if p.crossing[k] > 0.0:
        if pools.crossing[k] == 0.0:
            _leave(pools, k, border)
        pools.ends[k, pools.left[k] - 1] = border
    elif pools.crossing[k] > 0.0:
        pools.start[k] = pools.ends[k, pools.left[k] - 1]
        pools.points[k] = 0.0
    elif outcome == RENEWED:
        if in_rut:
            _loosen(ids, k, numbers)
        for n in range(LAG - 1, 0, -1):
            copy_belief(pools.last[k, n - 1], pools.last[k, n])
        _believe(ids, k, pools.last[k, 0])
        pools.points[k] += 1.0
    pools.crossing[k] = p.crossing[k]


@compiled_inline
def hand_over_border(pools, ids, k, first, numbers, identifier):
    """Begin with the new soil where wheel `first` has found a border that wheel k behind it has
    come to.
    """
    length = numbers.border
    p = ids.banks.point
    x = pools.place[k]
    if p.crossing[k] > 0.0 or ids.status[k] == _NO_DATA:
        return
    for s in range(pools.left[first]):
        border = pools.ends[first, s]
        if border > pools.start[k] + length and x > border - 0.5 * length:
            sd = _PLACE_SD * length
            begin_known_border(ids.banks, k, identifier.filter, p.place[k] + border - x, sd * sd)
            return


@compiled_inline
def _loosen(ids, k, numbers):
    """Widen ln S: the floor of a rut has another sinkage coefficient from place to place."""
    for i in range(cell(PRESSURE, PRESSURE), cell(PRESSURE, PRESSURE) + COUNT):
        ids.banks.sinkage[k, i] += numbers.rut_drift * numbers.rut_drift
