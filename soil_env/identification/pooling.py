"""What several wheels of a rover that run over the same ground know of it together.

Each wheel has a filter of its own (`filter`), which finds borders by itself; here they learn of each other. The soil
between two borders is a stretch. Of each a wheel keeps what it knew of (phi, ln K, c) when it left it, so that one
further ahead tells those behind

- where a border is: their filters begin with the new soil there (`border.begin`), and do not first take it for the old;
- what the soil is. With the posterior (m_o, P_o) of another wheel on the same stretch and the prior (m_p, P_p), which
  both have counted, the own posterior (m, P) becomes

      P'^-1 = P^-1 + P_o^-1 - P_p^-1,    P'^-1 m' = P^-1 m + P_o^-1 m_o - P_p^-1 m_p,

  the rule for Gaussian posteriors of independent readings (channel filter: Grime & Durrant-Whyte 1994, Control
  Engineering Practice 2:849-863, with the prior as the only common information). No filter is given what is pooled, so
  nothing is counted twice.

Where the two differ by more than they allow, chi-squared over its three degrees of freedom widens both (Birge 1932,
Physical Review 40:207-227). On a border the ground is a blend of two soils, and so is what another wheel knows of it.

The sinkage coefficient and the gain of digging are not pooled: a wheel behind another runs on a floor that this has
changed. They follow by their own correlation with what is pooled. `ERROR_OF_MODEL` are errors that all wheels have
alike, so that no comparison shows them: the exponent held wrong, the law of sinkage, the curvature of the models.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, part
from soil_env._numba.lanes import COUNT, scratch
from soil_env.identification.border import begin
from soil_env.identification.filter_bank import element
from soil_env.identification.linearised import Q
from soil_env.identification.mixture_prior import moments, prior_of_belief
from soil_env.identification.online import HELD, RENEWED, IdentifierNumbers, identifier_numbers
from soil_env.identification.solver import Status
from soil_env.parameters import Scenario
from soil_env.terramechanics.ground import share_of_next

UNKNOWNS = 5  # (phi, ln K, ln S, c, ln g), as `Identifiers.estimate`
SHARED = 3  # unknowns that a passing wheel does not change: phi, ln K, c
BELIEF = SHARED + SHARED * SHARED
STRETCHES = 4  # that a wheel remembers
#: 1-sigma of the errors that all wheels have alike, of (phi [rad], ln K, ln S, c [Pa], ln g): set on courses of seed
#: 7001, so that 68 % intervals hold as much, docs/rover_identification.md.
ERROR_OF_MODEL = np.array([math.radians(0.2), 0.015, 0.0, 35.0, 0.0])
COHESION = 3
_WHICH = np.array([0, 1, COHESION])  # of the unknowns are shared
_LAG = 3  # estimates are taken this many points before a border was found, so that they hold nothing from behind it
RUT_DRIFT = 0.1  # 1-sigma of the change of ln S along a rut, from one point of the filter to the next
_FAR = 1e6
_AT_START = -1e6  # [m] where the first stretch begins, for all wheels
_PLACE_SD = 0.1  # of the length of a border: 1-sigma of the place that another wheel has found
_CONVERGED, _MISFIT = Status.CONVERGED.value, Status.MISFIT.value
_NOT_EXCITED, _NO_DATA = Status.NOT_EXCITED.value, Status.NO_DATA.value
_LEARNT = 0.6  # sd of phi and ln K over that of the prior, at most, for an estimate to count as converged
_LEAST_ANGLE = 0.01  # [rad], as `linearised.friction` has it
_STEEPEST = 1.5  # [rad]
_NEARLY = 0.999  # share of the prior's information that a posterior must exceed: equal ones differ by rounding
_LEAST_SHARE = 0.02  # of the prior's information that is taken out, if any
_LEAST = 1e-3  # information over that of the own posterior, below which it is left out
_old, _new, _ground = scratch(BELIEF), scratch(BELIEF), scratch(BELIEF)
_gain, _prior = scratch(BELIEF), scratch(BELIEF)
_posterior, _product = scratch(UNKNOWNS * UNKNOWNS), scratch(UNKNOWNS)


class Pools(NamedTuple):
    """Memory of the wheels of many rovers: arrays with one row a wheel, axles `COUNT` rows apart.

    A belief is (mean [3], covariance [3 x 3]) of (phi, ln K, c). Places [m] are of the odometry.
    """

    estimate: np.ndarray  # [wheels, 5] pooled, of the soil under the wheel
    sd: np.ndarray  # [wheels, 5]
    status: np.ndarray  # [wheels] `Status`
    place: np.ndarray  # [wheels] where it is
    start: np.ndarray  # [wheels] where the stretch under the wheel begins
    crossing: np.ndarray  # [wheels] 1 while its filter is on a border
    points: np.ndarray  # [wheels] that the filter has taken in on this stretch
    last: np.ndarray  # [wheels, _LAG, 12] beliefs after the last points, the newest first
    left: np.ndarray  # [wheels] number of stretches left behind
    begins: np.ndarray  # [wheels, STRETCHES] of those
    ends: np.ndarray  # [wheels, STRETCHES]
    belief: np.ndarray  # [wheels, STRETCHES, 12]; variance 0 where nothing was known


class PoolNumbers(NamedTuple):
    """What `share` takes from a `Scenario`."""

    prior: np.ndarray  # [12] belief before any reading
    sd: np.ndarray  # [5] of it
    border: float  # [m] that a border is believed to be long
    rut_drift: float  # 1-sigma of the change of ln S in a rut from point to point
    error: np.ndarray  # [5] `ERROR_OF_MODEL`
    by_filter: bool  # the window knows of no borders, and is not pooled


def new_pools(wheels: int) -> Pools:
    """Empty memory; `forget_stretches` sets one wheel to the prior."""
    return Pools(
        np.zeros((wheels, UNKNOWNS)),
        np.zeros((wheels, UNKNOWNS)),
        np.zeros(wheels, dtype=np.int64),
        np.zeros(wheels),
        np.full(wheels, _AT_START),
        np.zeros(wheels),
        np.zeros(wheels),
        np.zeros((wheels, _LAG, BELIEF)),
        np.zeros(wheels, dtype=np.int64),
        np.zeros((wheels, STRETCHES)),
        np.zeros((wheels, STRETCHES)),
        np.zeros((wheels, STRETCHES, BELIEF)),
    )


def pool_numbers(scenario: Scenario) -> PoolNumbers:
    """Pack what `share` needs."""
    numbers: IdentifierNumbers = identifier_numbers(scenario)
    mean, covariance = moments(prior_of_belief(scenario))
    prior = np.concatenate([mean[_WHICH], covariance[np.ix_(_WHICH, _WHICH)].ravel()])
    sd = 1.0 / np.sqrt(numbers.precision)
    return PoolNumbers(prior, sd, scenario.belief.border, RUT_DRIFT, ERROR_OF_MODEL, numbers.by_filter)


# --- stretches --------------------------------------------------------------------------------------------------------


@part
def forget_stretches(pools, ids, k):
    """Set wheel k, whose identifier has just been reset, back to the prior."""
    pools.start[k], pools.crossing[k], pools.points[k], pools.left[k] = _AT_START, 0.0, 0.0, 0
    _take_own(pools, ids, k)


@inlined
def _take_own(pools, ids, k):
    for i in range(UNKNOWNS):
        pools.estimate[k, i], pools.sd[k, i] = ids.estimate[k, i], ids.sd[k, i]
    pools.status[k] = ids.status[k]


@inlined
def _believe(ids, k, belief):
    """The newest posterior of wheel k into a belief [12]."""
    for i in range(SHARED):
        belief[i] = ids.estimate[k, _WHICH[i]]
        for j in range(SHARED):
            belief[SHARED * (i + 1) + j] = ids.covariance[k, _WHICH[i], _WHICH[j]]


@inlined
def _copy(source, target):
    for i in range(BELIEF):
        target[i] = source[i]


@inlined
def _leave(pools, k, end):
    """Wheel k has come to the end of a stretch [m]."""
    if pools.left[k] == STRETCHES:
        for s in range(STRETCHES - 1):
            pools.begins[k, s], pools.ends[k, s] = pools.begins[k, s + 1], pools.ends[k, s + 1]
            _copy(pools.belief[k, s + 1], pools.belief[k, s])
        pools.left[k] -= 1
    s = pools.left[k]
    pools.begins[k, s], pools.ends[k, s] = pools.start[k], end
    if pools.points[k] >= _LAG:
        _copy(pools.last[k, _LAG - 1], pools.belief[k, s])
    else:
        for i in range(BELIEF):
            pools.belief[k, s, i] = 0.0
    pools.left[k] = s + 1


@part
def note(pools, ids, k, x, outcome, in_rut, numbers):
    """Follow the filter of wheel k at x [m] over stretches and borders; `outcome` of its `observe`.

    `in_rut`: whether it runs behind other wheels.
    """
    p, pools.place[k] = ids.banks.point, x
    if ids.status[k] == _NO_DATA:  # as at the start, and where the filter has just begun anew
        pools.start[k], pools.crossing[k], pools.points[k] = _AT_START if pools.left[k] == 0 else x, 0.0, 0.0
        return
    border = p.border[k] + x - p.place[k]
    if p.crossing[k] > 0.0:
        if pools.crossing[k] == 0.0:
            _leave(pools, k, border)
        pools.ends[k, pools.left[k] - 1] = border
    elif pools.crossing[k] > 0.0:
        pools.start[k], pools.points[k] = pools.ends[k, pools.left[k] - 1], 0.0
    elif outcome == RENEWED:
        if in_rut:
            _loosen(ids, k, numbers)
        for n in range(_LAG - 1, 0, -1):
            _copy(pools.last[k, n - 1], pools.last[k, n])
        _believe(ids, k, pools.last[k, 0])
        pools.points[k] += 1.0
    pools.crossing[k] = p.crossing[k]


@inlined
def _tell(pools, ids, k, first, numbers, identifier):
    """Begin with the new soil where wheel `first` has found a border that wheel k behind it has come to."""
    length, p, x = numbers.border, ids.banks.point, pools.place[k]
    if p.crossing[k] > 0.0 or ids.status[k] == _NO_DATA:
        return
    for s in range(pools.left[first]):
        border = pools.ends[first, s]
        if border > pools.start[k] + length and x > border - 0.5 * length:
            sd = _PLACE_SD * length
            begin(ids.banks, k, identifier.filter, p.place[k] + border - x, sd * sd, 0.0, 1e-12, 0.0)
            return


@inlined
def _loosen(ids, k, numbers):
    """The floor of a rut has another sinkage coefficient from place to place."""
    for i in range(element(Q, Q), element(Q, Q) + COUNT):
        ids.banks.covariance[k, i] += numbers.rut_drift * numbers.rut_drift


# --- what others know -------------------------------------------------------------------------------------------------


@inlined
def _soil_at(pools, first, x):
    """From where to where [m] the ground is of the soil at x [m], by the borders that wheel `first` has found."""
    low = _AT_START
    for s in range(pools.left[first]):
        if x < pools.ends[first, s]:
            return low, pools.ends[first, s]
        low = pools.ends[first, s]
    return low, _FAR


@inlined
def _find(pools, o, k, soil, numbers, belief):
    """What wheel o knows of the soil that lies from soil[0] to soil[1] [m], by its newest stretch there."""
    low, high = soil[0] - numbers.border, soil[1] + numbers.border
    latest = high - 2.0 * numbers.border  # a stretch that begins later is of the next soil
    if pools.crossing[o] == 0.0 and pools.points[o] >= (_LAG if o < k else 1) and low <= pools.start[o] < latest:
        if pools.place[o] <= high:
            _copy(pools.last[o, _LAG - 1 if o < k else 0], belief)
            return True
    for s in range(pools.left[o] - 1, -1, -1):
        known = pools.belief[o, s, SHARED] > 0.0
        if known and low <= pools.begins[o, s] < latest and pools.ends[o, s] <= high:
            _copy(pools.belief[o, s], belief)
            return True
    return False


@inlined
def _information(belief, shrunk, out):
    """Inverse of the covariance of a belief times `shrunk`, and that times its mean, into out [12]; False if none."""
    a, b, c = shrunk * belief[3], shrunk * belief[4], shrunk * belief[5]
    d, e, f = shrunk * belief[7], shrunk * belief[8], shrunk * belief[11]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * A + b * B + c * C
    if not det > 0.0:
        return False
    D, E, F = a * f - c * c, b * c - a * e, a * d - b * b
    out[3], out[4], out[5], out[6], out[7], out[8] = A / det, B / det, C / det, B / det, D / det, E / det
    out[9], out[10], out[11] = C / det, E / det, F / det
    for i in range(SHARED):
        j = SHARED * (i + 1)
        out[i] = out[j] * belief[0] + out[j + 1] * belief[1] + out[j + 2] * belief[2]
    return True


@inlined
def _read(mean, P, first, column1, column2, value, precision):
    """Kalman update of mean [5] and P [25] by a reading of shared unknown `first` and, times columns, of the next."""
    if precision * P[(UNKNOWNS + 1) * _WHICH[first]] < _LEAST:
        return
    v = _product()
    a, b, c = _WHICH[first], _WHICH[min(first + 1, 2)], _WHICH[min(first + 2, 2)]
    for m in range(UNKNOWNS):
        row = UNKNOWNS * m
        v[m] = P[row + a] + column1 * P[row + b] + column2 * P[row + c]
    expected = v[a] + column1 * v[b] + column2 * v[c] + 1.0 / precision
    step = (value - mean[a] - column1 * mean[b] - column2 * mean[c]) / expected
    for m in range(UNKNOWNS):
        mean[m] += v[m] * step
        for n in range(UNKNOWNS):
            P[UNKNOWNS * m + n] -= v[m] * v[n] / expected


@inlined
def _is_positive(g, prior, share):
    """Whether information g [12] less a share of the prior's is positive definite."""
    a, b, c = g[3] - share * prior[3], g[4] - share * prior[4], g[5] - share * prior[5]
    d, e, f = g[7] - share * prior[7], g[8] - share * prior[8], g[11] - share * prior[11]
    minor = a * d - b * b
    return a > 0.0 and minor > 0.0 and f * minor - a * e * e + 2.0 * b * c * e - c * c * d > 0.0


@inlined
def _less_the_prior(g, prior):
    """Take the prior's information out of g [12]; half, a quarter ... of it, where a posterior is wider than the prior
    in some direction, as those of mixtures and of nonlinear models may be."""
    share = 1.0
    while share > _LEAST_SHARE and not _is_positive(g, prior, _NEARLY * share):
        share *= 0.5
    share = share if share > _LEAST_SHARE else 0.0
    for i in range(BELIEF):
        g[i] -= share * prior[i]


@inlined
def _absorb(mean, P, g):
    """Take information g [12] into mean [5] and P [25]; g is L D L', each column of L a reading of variance 1/D."""
    d, e, f = g[7], g[8], g[11]
    y1, y2 = g[1], g[2]
    if g[3] > 0.0:
        l1, l2 = g[4] / g[3], g[5] / g[3]
        _read(mean, P, 0, l1, l2, g[0] / g[3], g[3])
        d, e, f = d - l1 * g[4], e - l1 * g[5], f - l2 * g[5]
        y1, y2 = y1 - l1 * g[0], y2 - l2 * g[0]
    if d > 0.0:
        l2 = e / d
        _read(mean, P, 1, l2, 0.0, y1 / d, d)
        f, y2 = f - l2 * e, y2 - l2 * y1
    if f > 0.0:
        _read(mean, P, 2, 0.0, 0.0, y2 / f, f)


@inlined
def _known_by(pools, o, k, first, numbers, ground):
    """Into `ground` what wheel o knows of the ground under wheel k; whether that is anything, and by how much more the
    prior knows of the ground than of one soil: on a border it is a blend of two."""
    x, length, old, new = pools.place[k], numbers.border, _old(), _new()
    here = _soil_at(pools, first, x)
    if pools.crossing[k] > 0.0:
        border = pools.ends[k, pools.left[k] - 1]
        before, behind = _soil_at(pools, first, border - 0.5 * length), _soil_at(pools, first, border + 0.5 * length)
        if before[0] != behind[0]:
            w, _ = share_of_next((x - border) / length)
            v = 1.0 - w
            knows_old, knows_new = _find(pools, o, k, before, numbers, old), _find(pools, o, k, behind, numbers, new)
            if not knows_old:
                _copy(numbers.prior, old)
            if not knows_new:
                _copy(numbers.prior, new)
            for i in range(BELIEF):
                ground[i] = v * old[i] + w * new[i] if i < SHARED else v * v * old[i] + w * w * new[i]
            return knows_old or knows_new, v * v + w * w
    return _find(pools, o, k, here, numbers, ground), 1.0


@inlined
def _disagreement(mean, P, belief, both):
    """Chi-squared over its three degrees of freedom between an estimate and another one's belief (Birge ratio)."""
    for i in range(SHARED):
        both[i] = belief[i] - mean[_WHICH[i]]
        for j in range(SHARED):
            n = SHARED * (i + 1) + j
            both[n] = belief[n] + P[UNKNOWNS * _WHICH[i] + _WHICH[j]]
    d0, d1, d2, inverse = both[0], both[1], both[2], _new()
    if not _information(both, 1.0, inverse):
        return 1.0
    return (d0 * inverse[0] + d1 * inverse[1] + d2 * inverse[2]) / SHARED


@part
def pool(pools, ids, k, first, axles, numbers):
    """Renew what is pooled of the ground under wheel k of a rover whose front wheel is in row `first`."""
    _take_own(pools, ids, k)
    if ids.status[k] == _NO_DATA:
        return
    mean, P, ground, gain, prior = pools.estimate[k], _posterior(), _ground(), _gain(), _prior()
    for i in range(UNKNOWNS):
        for j in range(UNKNOWNS):
            P[UNKNOWNS * i + j] = ids.covariance[k, i, j]
    for a in range(axles):
        o = first + a * COUNT
        if o == k or not numbers.by_filter:
            continue
        known, spread = _known_by(pools, o, k, first, numbers, ground)
        if known and _information(ground, 1.0, gain) and _information(numbers.prior, spread, prior):
            apart = _disagreement(mean, P, ground, _old())
            if apart > 1.0:
                for i in range(UNKNOWNS * UNKNOWNS):
                    P[i] *= apart
            else:
                apart = 1.0
            _less_the_prior(gain, prior)
            for i in range(BELIEF):
                gain[i] /= apart
            _absorb(mean, P, gain)
    mean[0], mean[COHESION] = min(max(mean[0], _LEAST_ANGLE), _STEEPEST), max(mean[COHESION], 0.0)
    learnt = 0.0
    for i in range(UNKNOWNS):
        pools.sd[k, i] = math.sqrt(max(P[(UNKNOWNS + 1) * i], 1e-18) + numbers.error[i] * numbers.error[i])
        if i < 2:  # friction and shear deformation modulus need a range of slip
            learnt = max(learnt, pools.sd[k, i] / numbers.sd[i])
    if pools.status[k] != _MISFIT:
        pools.status[k] = _CONVERGED if learnt <= _LEARNT else _NOT_EXCITED


@inlined
def share(pools, ids, first, axles, outcome, numbers, identifier):
    """After a set of readings of each wheel of a rover, and `note` of each: let them tell each other what they know.

    `first`: row of the front wheel; `outcome`: the furthest of `observe` of its wheels. Where no filter was renewed,
    only wheels on a border are on other ground than before.
    """
    if outcome == HELD:
        return
    if numbers.by_filter:
        for a in range(1, axles):
            _tell(pools, ids, first + a * COUNT, first, numbers, identifier)
    for a in range(axles):
        if outcome == RENEWED or pools.crossing[first + a * COUNT] > 0.0:
            pool(pools, ids, first + a * COUNT, first, axles, numbers)
