"""What several wheels of a rover that run over the same ground know of it together.

Each wheel has a filter of its own (`filter`), which finds borders by itself; here they learn of each other. The soil
between two borders is a stretch (`stretches`). Of each a wheel keeps what it knew of (phi, ln K, c) when it left it, so
that one further ahead tells those behind

- where a border is: their filters begin with the new soil there (`border.begin_told`), and do not take it for the old;
- what the soil is. With the posterior (m_o, P_o) of another wheel on the same stretch and the prior (m_p, P_p), which
  both have counted, the own posterior (m, P) becomes

      P'^-1 = P^-1 + P_o^-1 - P_p^-1,    P'^-1 m' = P^-1 m + P_o^-1 m_o - P_p^-1 m_p,

  the rule for Gaussian posteriors of independent readings (channel filter: Grime & Durrant-Whyte 1994, Control
  Engineering Practice 2:849-863, with the prior as the only common information). No filter is given what is pooled, so
  nothing is counted twice.

Where the two differ by more than they allow, chi-squared over its three degrees of freedom widens both (Birge 1932,
Physical Review 40:207-227). On a border the ground is a blend of two soils, and so is what another wheel knows of it.

The sinkage coefficient and the gain of digging are not pooled: a wheel behind another runs on a floor that this has
changed. They follow by their own correlation with what is pooled. `stretches.ERROR_OF_MODEL` are errors that all wheels
have alike, so that no comparison shows them: the exponent held wrong, the law of sinkage, the curvature of the models.
"""

from __future__ import annotations

import math

from soil_env._numba.compiling import compiled_inline, compiled_part
from soil_env._numba.lanes import COUNT, scratch
from soil_env.identification.online.identifier import HELD, RENEWED
from soil_env.identification.online.status import Status
from soil_env.identification.online.stretches import (
    AT_START,
    BELIEF,
    COHESION,
    LAG,
    SHARED,
    UNKNOWNS,
    WHICH,
    copy_belief,
    take_own,
    tell,
)
from soil_env.terramechanics.ground import share_of_next

_FAR = 1e6  # [m]
_CONVERGED, _MISFIT = Status.CONVERGED.value, Status.MISFIT.value
_NOT_EXCITED, _NO_DATA = Status.NOT_EXCITED.value, Status.NO_DATA.value
_LEARNT = 0.6  # sd of phi and ln K over that of the prior, at most, for an estimate to count as converged
_LEAST_ANGLE = 0.01  # [rad]
_STEEPEST = 1.5  # [rad]
_NEARLY = 0.999  # share of the prior's information that a posterior must exceed: equal ones differ by rounding
_LEAST_SHARE = 0.02  # of the prior's information that is taken out, if any
_LEAST = 1e-3  # information over that of the own posterior, below which it is left out
_old, _new, _ground = scratch(BELIEF), scratch(BELIEF), scratch(BELIEF)
_gain, _prior = scratch(BELIEF), scratch(BELIEF)
_posterior, _product = scratch(UNKNOWNS * UNKNOWNS), scratch(UNKNOWNS)


@compiled_inline
def _soil_at(pools, first, x):
    """From where to where [m] the ground is of the soil at x [m], by the borders that wheel `first` has found."""
    low = AT_START
    for s in range(pools.left[first]):
        if x < pools.ends[first, s]:
            return low, pools.ends[first, s]
        low = pools.ends[first, s]
    return low, _FAR


@compiled_inline
def _find(pools, o, k, soil, numbers, belief):
    """What wheel o knows of the soil that lies from soil[0] to soil[1] [m], by its newest stretch there."""
    low, high = soil[0] - numbers.border, soil[1] + numbers.border
    latest = high - 2.0 * numbers.border  # a stretch that begins later is of the next soil
    if pools.crossing[o] == 0.0 and pools.points[o] >= (LAG if o < k else 1) and low <= pools.start[o] < latest:
        if pools.place[o] <= high:
            copy_belief(pools.last[o, LAG - 1 if o < k else 0], belief)
            return True
    for s in range(pools.left[o] - 1, -1, -1):
        known = pools.belief[o, s, SHARED] > 0.0
        if known and low <= pools.begins[o, s] < latest and pools.ends[o, s] <= high:
            copy_belief(pools.belief[o, s], belief)
            return True
    return False


@compiled_inline
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


@compiled_inline
def _read(mean, P, first, column1, column2, value, precision):
    """Kalman update of mean [5] and P [25] by a reading of shared unknown `first` and, times columns, of the next."""
    if precision * P[(UNKNOWNS + 1) * WHICH[first]] < _LEAST:
        return
    v = _product()
    a, b, c = WHICH[first], WHICH[min(first + 1, 2)], WHICH[min(first + 2, 2)]
    for m in range(UNKNOWNS):
        row = UNKNOWNS * m
        v[m] = P[row + a] + column1 * P[row + b] + column2 * P[row + c]
    expected = v[a] + column1 * v[b] + column2 * v[c] + 1.0 / precision
    step = (value - mean[a] - column1 * mean[b] - column2 * mean[c]) / expected
    for m in range(UNKNOWNS):
        mean[m] += v[m] * step
        for n in range(UNKNOWNS):
            P[UNKNOWNS * m + n] -= v[m] * v[n] / expected


@compiled_inline
def _is_positive(g, prior, share):
    """Whether information g [12] less a share of the prior's is positive definite."""
    a, b, c = g[3] - share * prior[3], g[4] - share * prior[4], g[5] - share * prior[5]
    d, e, f = g[7] - share * prior[7], g[8] - share * prior[8], g[11] - share * prior[11]
    minor = a * d - b * b
    return a > 0.0 and minor > 0.0 and f * minor - a * e * e + 2.0 * b * c * e - c * c * d > 0.0


@compiled_inline
def _less_the_prior(g, prior):
    """Take the prior's information out of g [12]; half, a quarter ... of it, where a posterior is wider than the prior
    in some direction, as those of mixtures and of nonlinear models may be."""
    share = 1.0
    while share > _LEAST_SHARE and not _is_positive(g, prior, _NEARLY * share):
        share *= 0.5
    share = share if share > _LEAST_SHARE else 0.0
    for i in range(BELIEF):
        g[i] -= share * prior[i]


@compiled_inline
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


@compiled_inline
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
                copy_belief(numbers.prior, old)
            if not knows_new:
                copy_belief(numbers.prior, new)
            for i in range(BELIEF):
                ground[i] = v * old[i] + w * new[i] if i < SHARED else v * v * old[i] + w * w * new[i]
            return knows_old or knows_new, v * v + w * w
    return _find(pools, o, k, here, numbers, ground), 1.0


@compiled_inline
def _disagreement(mean, P, belief, both):
    """Chi-squared over its three degrees of freedom between an estimate and another one's belief (Birge ratio)."""
    for i in range(SHARED):
        both[i] = belief[i] - mean[WHICH[i]]
        for j in range(SHARED):
            n = SHARED * (i + 1) + j
            both[n] = belief[n] + P[UNKNOWNS * WHICH[i] + WHICH[j]]
    d0, d1, d2, inverse = both[0], both[1], both[2], _new()
    if not _information(both, 1.0, inverse):
        return 1.0
    return (d0 * inverse[0] + d1 * inverse[1] + d2 * inverse[2]) / SHARED


@compiled_part
def pool(pools, ids, k, first, axles, numbers):
    """Renew what is pooled of the ground under wheel k of a rover whose front wheel is in row `first`."""
    take_own(pools, ids, k)
    if ids.status[k] == _NO_DATA:
        return
    mean, P, ground, gain, prior = pools.estimate[k], _posterior(), _ground(), _gain(), _prior()
    for i in range(UNKNOWNS):
        for j in range(UNKNOWNS):
            P[UNKNOWNS * i + j] = ids.covariance[k, i, j]
    for a in range(axles):
        o = first + a * COUNT
        if o == k:
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


@compiled_inline
def share(pools, ids, first, axles, outcome, numbers, identifier):
    """After a set of readings of each wheel of a rover, and `note` of each: let them tell each other what they know.

    `first`: row of the front wheel; `outcome`: the furthest of `observe` of its wheels. Where no filter was renewed,
    only wheels on a border are on other ground than before.
    """
    if outcome == HELD:
        return
    for a in range(1, axles):
        tell(pools, ids, first + a * COUNT, first, numbers, identifier)
    for a in range(axles):
        if outcome == RENEWED or pools.crossing[first + a * COUNT] > 0.0:
            pool(pools, ids, first + a * COUNT, first, axles, numbers)
