"""Joint knowledge of the wheels of a rover that run over the same ground.

Each wheel has a filter of its own (`filter`), which finds borders by itself. The soil between two
borders is a stretch (`stretches`). Of each stretch a wheel keeps its estimate of (phi, ln K, c), so
that those behind receive

- the place of a border: their filters begin with the new soil there (`border.begin_known_border`);
- the soil. With the posterior (m_o, P_o) of another wheel on the same stretch and the prior
  (m_p, P_p), which both have counted, the own posterior (m, P) becomes

      P'^-1 = P^-1 + P_o^-1 - P_p^-1,    P'^-1 m' = P^-1 m + P_o^-1 m_o - P_p^-1 m_p,

  the rule for Gaussian posteriors of independent readings (channel filter: Grime & Durrant-Whyte
  1994, Control Engineering Practice 2:849-863, with the prior as the only common information). No
  filter is given what is pooled, so nothing is counted twice.

Where the two differ by more than they allow, chi-squared over its three degrees of freedom widens
both (Birge 1932, Physical Review 40:207-227). On a border the ground is a blend of two soils, and
so is what another wheel knows of it.

The sinkage coefficient and the gain of digging are not pooled: a wheel behind another runs on a
floor that this has changed. They follow by their own correlation with what is pooled.
`stretches.ERROR_OF_MODEL` are errors that all wheels have alike, so that no comparison shows them:
the exponent held wrong, the law of sinkage, the curvature of the models.
"""

import math

from soil_env.identification.online import stretches
from soil_env.identification.online.axles import wheel_behind
from soil_env.identification.online.identifier import HELD, RENEWED
from soil_env.identification.online.lanes.compiling import compiled_inline, compiled_part
from soil_env.identification.online.lanes.contact import share_of_next
from soil_env.identification.online.lanes.lanes import scratch
from soil_env.identification.online.stretches import (
    BELIEF,
    COHESION,
    LAG,
    SHARED,
    UNKNOWNS,
    WHICH,
    copy_belief,
)
from soil_env.identification.status import Status

_FAR = 1e6  # [m]
_CONVERGED = Status.CONVERGED.value
_MISFIT = Status.MISFIT.value
_NOT_EXCITED = Status.NOT_EXCITED.value
_NO_DATA = Status.NO_DATA.value
# sd of phi and ln K over that of the prior, at most, for an estimate to count as converged
_LEARNT = 0.6
_LEAST_ANGLE = 0.01  # [rad]
_STEEPEST = 1.5  # [rad]
# share of the prior's information that a posterior must exceed: equal ones differ by rounding
_NEARLY = 0.999
_LEAST_SHARE = 0.02  # of the prior's information that is taken out, if any
_LEAST = 1e-3  # information over that of the own posterior, below which it is left out
_old = scratch(BELIEF)
_new = scratch(BELIEF)
_ground = scratch(BELIEF)
_gain = scratch(BELIEF)
_prior = scratch(BELIEF)
_rest = scratch(BELIEF)
_posterior = scratch(UNKNOWNS * UNKNOWNS)
_product = scratch(UNKNOWNS)


@compiled_inline
def _soil_at(pools, first, x):
    """From where to where [m] the ground is of the soil at x [m], by the borders that wheel `first`
    has found.
    """
    low = stretches.AT_START
    for s in range(pools.left[first]):
        if x < pools.ends[first, s]:
            return low, pools.ends[first, s]
        low = pools.ends[first, s]
    return low, _FAR


@compiled_inline
def _find(pools, o, k, soil, numbers, belief):
    """Store the belief of wheel o on the soil from soil[0] to soil[1] [m], of its newest stretch
    there; True if any.
    """
    low = soil[0] - numbers.border
    high = soil[1] + numbers.border
    latest = high - 2.0 * numbers.border  # a stretch that begins later is of the next soil
    if (
        pools.crossing[o] == 0.0
        and pools.points[o] >= (LAG if o < k else 1)
        and low <= pools.start[o] < latest
    ):
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
def _at(i, j):
    """Offset of element (i, j) of the matrix of a belief, or of information [12]."""
    return SHARED * (i + 1) + j


@compiled_inline
def _cofactor(belief, i, j):
    """Cofactor (i, j) of the matrix [3, 3] of a belief."""
    r = (i + 1) % 3
    s = (i + 2) % 3
    c = (j + 1) % 3
    d = (j + 2) % 3
    return belief[_at(r, c)] * belief[_at(s, d)] - belief[_at(r, d)] * belief[_at(s, c)]


@compiled_inline
def _determinant(belief):
    first = belief[3] * _cofactor(belief, 0, 0)
    second = belief[4] * _cofactor(belief, 0, 1)
    return first + second + belief[5] * _cofactor(belief, 0, 2)


@compiled_inline
def _information(belief, out):
    """Inverse of the covariance of a belief, and that times its mean, into out [12]; False if
    singular.
    """
    det = _determinant(belief)
    if not det > 0.0:
        return False
    for i in range(SHARED):
        out[i] = 0.0
        for j in range(SHARED):
            out[_at(i, j)] = _cofactor(belief, i, j) / det
            out[i] += out[_at(i, j)] * belief[j]
    return True


@compiled_inline
def _read(mean, P, first, column1, column2, value, precision):
    """Kalman update of mean [5] and P [25] by a reading of shared unknown `first` and, times
    columns, of the next.
    """
    if precision * P[(UNKNOWNS + 1) * WHICH[first]] < _LEAST:
        return
    v = _product()
    a = WHICH[first]
    b = WHICH[min(first + 1, 2)]
    c = WHICH[min(first + 2, 2)]
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
def _is_positive(g, prior, share, rest):
    """True if information g [12] less a share of the prior's is positive definite; `rest` [12] is
    scratch.
    """
    for i in range(SHARED, BELIEF):
        rest[i] = g[i] - share * prior[i]
    return rest[3] > 0.0 and _cofactor(rest, 2, 2) > 0.0 and _determinant(rest) > 0.0


@compiled_inline
def _remove_prior(g, prior):
    """Subtract the prior's information from g [12] in place.

    Half of it, a quarter ..., where the posterior is wider than the prior in some direction, as
    those of mixtures and of nonlinear models may be.
    """
    share = 1.0
    rest = _rest()
    while share > _LEAST_SHARE and not _is_positive(g, prior, _NEARLY * share, rest):
        share *= 0.5
    share = share if share > _LEAST_SHARE else 0.0
    for i in range(BELIEF):
        g[i] -= share * prior[i]


@compiled_inline
def _absorb(mean, P, g):
    """Take information g [12] into mean [5] and P [25]; g is L D L', each column of L a reading of
    variance 1/D.

    g is overwritten.
    """
    for i in range(SHARED):
        row = SHARED * (i + 1)
        d = g[row + i]
        if d > 0.0:
            one = g[row + i + 1] / d if i < 2 else 0.0
            two = g[row + i + 2] / d if i < 1 else 0.0
            _read(mean, P, i, one, two, g[i] / d, d)
            for j in range(i + 1, SHARED):
                share = g[row + j] / d
                g[j] -= share * g[i]
                for m in range(j, SHARED):
                    g[SHARED * (j + 1) + m] -= share * g[row + m]


@compiled_inline
def _known_by(pools, o, k, first, numbers, ground):
    """Store the belief of wheel o on the ground under wheel k into `ground`.

    Returns (True if there is one, covariance of the prior of this ground over that of one soil): on
    a border the ground is a blend of two soils.
    """
    x = pools.place[k]
    length = numbers.border
    old = _old()
    new = _new()
    here = _soil_at(pools, first, x)
    if pools.crossing[k] > 0.0:
        border = pools.ends[k, pools.left[k] - 1]
        before = _soil_at(pools, first, border - 0.5 * length)
        behind = _soil_at(pools, first, border + 0.5 * length)
        if before[0] != behind[0]:
            w, _ = share_of_next((x - border) / length)
            v = 1.0 - w
            knows_old = _find(pools, o, k, before, numbers, old)
            knows_new = _find(pools, o, k, behind, numbers, new)
            if not knows_old:
                copy_belief(numbers.prior, old)
            if not knows_new:
                copy_belief(numbers.prior, new)
            for i in range(BELIEF):
                ground[i] = (
                    v * old[i] + w * new[i] if i < SHARED else v * v * old[i] + w * w * new[i]
                )
            return knows_old or knows_new, v * v + w * w
    return _find(pools, o, k, here, numbers, ground), 1.0


@compiled_inline
def _disagreement(mean, P, belief, both):
    """Chi-squared over its three degrees of freedom between an estimate and another one's belief
    (Birge ratio).
    """
    for i in range(SHARED):
        both[i] = belief[i] - mean[WHICH[i]]
        for j in range(SHARED):
            n = SHARED * (i + 1) + j
            both[n] = belief[n] + P[UNKNOWNS * WHICH[i] + WHICH[j]]
    d0 = both[0]
    d1 = both[1]
    d2 = both[2]
    inverse = _new()
    if not _information(both, inverse):
        return 1.0
    return (d0 * inverse[0] + d1 * inverse[1] + d2 * inverse[2]) / SHARED


@compiled_part
def pool(pools, ids, k, first, axles, numbers):
    """Renew what is pooled of the ground under wheel k of a rover whose front wheel is in row
    `first`.
    """
    stretches.take_own(pools, ids, k)
    if ids.status[k] == _NO_DATA:
        return
    mean = pools.estimate[k]
    P = _posterior()
    ground = _ground()
    gain = _gain()
    prior = _prior()
    for i in range(UNKNOWNS):
        for j in range(UNKNOWNS):
            P[UNKNOWNS * i + j] = ids.covariance[k, i, j]
    for a in range(axles):
        o = wheel_behind(first, a)
        if o == k:
            continue
        known, spread = _known_by(pools, o, k, first, numbers, ground)
        if known and _information(ground, gain) and _information(numbers.prior, prior):
            for i in range(BELIEF):
                prior[i] /= spread
            apart = _disagreement(mean, P, ground, _old())
            if apart > 1.0:
                for i in range(UNKNOWNS * UNKNOWNS):
                    P[i] *= apart
            else:
                apart = 1.0
            _remove_prior(gain, prior)
            for i in range(BELIEF):
                gain[i] /= apart
            _absorb(mean, P, gain)
    mean[0] = min(max(mean[0], _LEAST_ANGLE), _STEEPEST)
    mean[COHESION] = max(mean[COHESION], 0.0)
    learnt = 0.0
    for i in range(UNKNOWNS):
        pools.sd[k, i] = math.sqrt(
            max(P[(UNKNOWNS + 1) * i], 1e-18) + numbers.error[i] * numbers.error[i]
        )
        if i < 2:  # friction and shear deformation modulus need a range of slip
            learnt = max(learnt, pools.sd[k, i] / numbers.sd[i])
    if pools.status[k] != _MISFIT:
        pools.status[k] = _CONVERGED if learnt <= _LEARNT else _NOT_EXCITED


@compiled_inline
def share(pools, ids, first, axles, outcome, numbers, identifier):
    """Exchange the knowledge of the wheels of a rover, after a set of readings and `note` of each.

    `first`: row of the front wheel; `outcome`: the furthest of `observe` of its wheels. Where no
    filter was renewed, only wheels on a border are on other ground than before.
    """
    if outcome == HELD:
        return
    for a in range(1, axles):
        stretches.hand_over_border(pools, ids, wheel_behind(first, a), first, numbers, identifier)
    for a in range(axles):
        k = wheel_behind(first, a)
        if outcome == RENEWED or pools.crossing[k] > 0.0:
            pool(pools, ids, k, first, axles, numbers)
