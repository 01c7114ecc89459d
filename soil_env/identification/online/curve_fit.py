"""Fit of the soil to the traction curve (`curve`), for the eight nodes of ln K (`soil_nodes`) side
by side.

Each node has a maximum a posteriori with a covariance (Laplace) by the sum of
docs/physics/estimation.md; the posterior is their mixture, weighted by the evidence. Of the ln of
the determinant in it a quarter counts: all of it prefers low slopes, the more so the more bins
there are (Neyman & Scott 1948, Econometrica 16:1-32). A bin is linearised at the slip that is most
likely under the node.
"""

import math

from soil_env.identification.online import curve, soil_nodes
from soil_env.identification.online.contact_slopes import GroundSoil, reaction
from soil_env.identification.online.lanes.compiling import compiled_inline, compiled_part
from soil_env.identification.online.lanes.contact import share_of_next
from soil_env.identification.online.lanes.elementary import (
    exp,
    fma,
    larger,
    log,
    smaller,
    sqrt,
    where_less,
)
from soil_env.identification.online.lanes.lanes import (
    COUNT,
    fill,
    from_array,
    scratch,
    smallest,
    to_array,
    total,
)
from soil_env.identification.online.soil_nodes import OLD, SOIL, TRIANGLE, UNKNOWNS, below_diagonal

# Rows of `fits`, COUNT numbers each, of one bin: the slip at which it is linearised next; pull and
# torque as affine functions of the unknowns and the slip: constant, slopes; their covariance beside
# that of the sensors.
NEXT_SLIP = 0
OF_PULL = 1
OF_TORQUE = 7
BESIDE = 13
FIT_ROWS = 16
BY_SLIP = UNKNOWNS + 1  # of OF_PULL and OF_TORQUE: the constant, by the four unknowns, by the slip

_SLIP_RANGE = 0.05  # that the slip of a bin may be off its reading
_LOWEST_SLIP = -0.8
_HIGHEST_SLIP = 0.97
_STEP_TANGENT = 0.25  # longest steps; cohesion: of load over r b
_STEP_EXPONENT = 0.3
_STEP_COHESION = 0.3
_LEAST_TANGENT = 0.05
_LEAST_EXPONENT = 0.2
_MOST_EXPONENT = 2.0
# squared length of a step, in standard deviations, after which all bins are linearised anew
_STALE = 2.0
_MOST_STEPS = 6  # of the fit behind a border; squared length of a step below which it ends
_STAYS_THERE = 0.05
_UNLIKELY = -7.0  # ln weight below which a node is not followed closely
_FEW = 3.0  # points of a soil up to which all bins are linearised at each
_LEAST_SHARE = 1e-4  # of either soil on a border
# how much more the covariance of the old soil counts: its error is one for all bins of a border
_OLD_DOUBT = 3.0
# share of the ln of the determinant that counts, errors by slip and sinkage in it
_OF_VOLUME = 0.25
_matrix = scratch(TRIANGLE * COUNT)
_matrix2 = scratch(TRIANGLE * COUNT)
_vector = scratch(UNKNOWNS * COUNT)


@compiled_inline
def share_on_border(x, spread, place, length):
    """(share of the new soil, its derivative by the place of the border) of a wheel at x +- spread
    [m]; lanes.
    """
    low, by_low = share_of_next((x - spread - place) * (1.0 / length))
    high, by_high = share_of_next((x + spread - place) * (1.0 / length))
    return smaller(larger(0.5 * (low + high), _LEAST_SHARE), 1.0 - _LEAST_SHARE), (
        -0.5 / length
    ) * (by_low + by_high)


@compiled_inline
def quadratic_form(c, g, a, b):
    """a' C b of `Slopes` a, b with the lower triangle of C from c[g] on."""
    a0 = a.by_tangent
    a1 = a.by_cohesion
    a2 = a.by_exponent
    a3 = a.by_ln_K
    b0 = b.by_tangent
    b1 = b.by_cohesion
    b2 = b.by_exponent
    b3 = b.by_ln_K
    v = a0 * (c[g] * b0 + c[g + 1] * b1 + c[g + 3] * b2 + c[g + 6] * b3)
    v = v + a1 * (c[g + 1] * b0 + c[g + 2] * b1 + c[g + 4] * b2 + c[g + 7] * b3)
    v = v + a2 * (c[g + 3] * b0 + c[g + 4] * b1 + c[g + 5] * b2 + c[g + 8] * b3)
    return v + a3 * (c[g + 6] * b0 + c[g + 7] * b1 + c[g + 8] * b2 + c[g + 9] * b3)


@compiled_part
def linearise(banks, k, b, numbers):
    """Linearise bin b of wheel k at the unknowns of its nodes."""
    nodes = banks.nodes[k]
    bins = banks.bins[k]
    at = b * curve.FIELDS
    fits = banks.fits[k]
    f = b * FIT_ROWS * COUNT
    tangent = from_array(nodes, soil_nodes.TANGENT * COUNT)
    cohesion = from_array(nodes, soil_nodes.COHESION * COUNT)
    exponent = from_array(nodes, soil_nodes.EXPONENT * COUNT)
    ln_K = from_array(nodes, soil_nodes.LN_K * COUNT)
    w = fill(1.0)
    by_place = fill(0.0)
    slip = from_array(fits, f + NEXT_SLIP * COUNT)
    known = banks.known[k]
    soil = GroundSoil(tangent, cohesion, exponent, ln_K)
    on_border = bins[at + curve.ON_BORDER] > 0.0
    away = GroundSoil(
        tangent - known[OLD],
        cohesion - known[OLD + 1],
        exponent - known[OLD + 2],
        ln_K - known[OLD + 3],
    )
    if on_border:
        place = from_array(nodes, soil_nodes.BORDER_PLACE * COUNT)
        same = from_array(nodes, soil_nodes.SAME_SOIL * COUNT)
        w, by_place = share_on_border(
            fill(bins[at + curve.PLACE]), bins[at + curve.SPREAD], place, numbers.border
        )
        w = larger(w, same)
        by_place = (1.0 - same) * by_place
        v = 1.0 - w
        soil = GroundSoil(
            tangent - v * away.tangent,
            cohesion - v * away.cohesion,
            exponent - v * away.exponent,
            ln_K - v * away.ln_K,
        )
    found = reaction(
        soil,
        fill(bins[at + curve.SINKAGE]),
        slip,
        bins[at + curve.LOAD],
        numbers.radius,
        numbers.width,
    )
    p = found.pull
    t = found.torque
    of_sinkage = 1.0 / bins[at + curve.SINKAGE_WEIGHT]
    _store(nodes, fits, f + OF_PULL * COUNT, p, w, by_place, away, slip)
    _store(nodes, fits, f + OF_TORQUE * COUNT, t, w, by_place, away, slip)
    pp = of_sinkage * p.by_sinkage * p.by_sinkage
    pt = of_sinkage * p.by_sinkage * t.by_sinkage
    tt = of_sinkage * t.by_sinkage * t.by_sinkage
    if on_border:  # what is not known of the old soil
        rest = _OLD_DOUBT * (1.0 - w) * (1.0 - w)
        c = OLD + SOIL
        pp = pp + rest * quadratic_form(known, c, p, p)
        pt = pt + rest * quadratic_form(known, c, p, t)
        tt = tt + rest * quadratic_form(known, c, t, t)
    to_array(pp, fits, f + BESIDE * COUNT)
    to_array(pt, fits, f + (BESIDE + 1) * COUNT)
    to_array(tt, fits, f + (BESIDE + 2) * COUNT)


@compiled_inline
def _store(nodes, fits, f, q, w, by_place, away, slip):
    """A quantity at a bin as an affine function of the unknowns and the slip."""
    change = (
        q.by_tangent * away.tangent + q.by_cohesion * away.cohesion + q.by_exponent * away.exponent
    )
    to_array(w * q.by_tangent, fits, f + COUNT)
    to_array(w * q.by_cohesion, fits, f + 2 * COUNT)
    to_array(w * q.by_exponent, fits, f + 3 * COUNT)
    to_array(by_place * (change + q.by_ln_K * away.ln_K), fits, f + 4 * COUNT)
    to_array(q.by_slip, fits, f + BY_SLIP * COUNT)
    constant = q.value - q.by_slip * slip
    for i in range(UNKNOWNS):
        constant = constant - from_array(fits, f + (1 + i) * COUNT) * from_array(nodes, i * COUNT)
    to_array(constant, fits, f)


@compiled_inline
def begin_bin(banks, k, b, slip):
    """Linearise bin b at this slip from now on."""
    to_array(fill(slip), banks.fits[k], (b * FIT_ROWS + NEXT_SLIP) * COUNT)


@compiled_inline
def _residual(nodes, fits, f, q, value, slip):
    """Residual of pull or torque (rows from q on) at a slip under the linearised bin."""
    e = value - from_array(fits, f + q * COUNT) - from_array(fits, f + (q + BY_SLIP) * COUNT) * slip
    for i in range(UNKNOWNS):
        e = e - from_array(fits, f + (q + 1 + i) * COUNT) * from_array(nodes, i * COUNT)
    return e


@compiled_part
def solve(banks, k, numbers):
    """One Gauss-Newton step of all nodes on the linearised bins; the largest squared length of the
    step of a likely one in standard deviations.

    Renews unknowns, posterior covariances and weights of the nodes, and the slips at which bins are
    linearised next.
    """
    nodes = banks.nodes[k]
    bins = banks.bins[k]
    fits = banks.fits[k]
    A = _matrix()
    g = _vector()
    away = _vector()
    cost = fill(0.0)
    volumes = fill(1.0)
    place = banks.point.border[k]
    form_error = banks.point.form_error[k]
    of_place = 1.0 / max(banks.point.border_variance[k], 1e-8)
    for i in range(3):
        to_array(
            from_array(nodes, i * COUNT) - from_array(nodes, (soil_nodes.PRIOR_MEAN + i) * COUNT),
            away,
            i * COUNT,
        )
    to_array(from_array(nodes, soil_nodes.BORDER_PLACE * COUNT) - place, away, 3 * COUNT)
    for i in range(3):
        v = fill(0.0)
        for j in range(3):
            n = below_diagonal(max(i, j), min(i, j))
            p = from_array(nodes, (soil_nodes.PRECISION + n) * COUNT)
            if j <= i:
                to_array(p, A, n * COUNT)
            v = fma(p, from_array(away, j * COUNT), v)
        to_array(-1.0 * v, g, i * COUNT)
        cost = fma(v, from_array(away, i * COUNT), cost)
    place_away = from_array(away, 3 * COUNT)
    to_array((-of_place) * place_away, g, 3 * COUNT)
    cost = cost + of_place * place_away * place_away
    for j in range(3):
        to_array(fill(0.0), A, below_diagonal(3, j) * COUNT)
    to_array(fill(of_place), A, below_diagonal(3, 3) * COUNT)
    for b in range(int(banks.point.bins[k])):
        chi, volume = _add_bin(
            nodes, bins, b * curve.FIELDS, fits, b * FIT_ROWS * COUNT, A, g, form_error, numbers
        )
        cost = cost + chi
        volumes = volumes * volume
    return _step(banks, k, A, g, cost, _OF_VOLUME * log(volumes), numbers)


@compiled_inline
def _add_bin(nodes, bins, at, fits, f, A, g, form_error, numbers):
    """Add a bin to normal matrix and gradient: (its chi-squared, determinant of its covariance over
    the sensors').
    """
    slip = bins[at + curve.SLIP]
    of_slip = 1.0 / bins[at + curve.SLIP_WEIGHT]
    error = form_error * bins[at + curve.LOAD]
    p = _residual(nodes, fits, f, OF_PULL, bins[at + curve.PULL], slip)
    t = _residual(nodes, fits, f, OF_TORQUE, bins[at + curve.TORQUE], slip)
    p_slip = from_array(fits, f + (OF_PULL + BY_SLIP) * COUNT)
    t_slip = from_array(fits, f + (OF_TORQUE + BY_SLIP) * COUNT)
    twist = error * numbers.radius
    of_pull = 1.0 / bins[at + curve.PULL_WEIGHT] + error * error
    of_torque = 1.0 / bins[at + curve.TORQUE_WEIGHT] + twist * twist
    pp = from_array(fits, f + BESIDE * COUNT) + of_slip * p_slip * p_slip + of_pull
    pt = from_array(fits, f + (BESIDE + 1) * COUNT) + of_slip * p_slip * t_slip
    tt = from_array(fits, f + (BESIDE + 2) * COUNT) + of_slip * t_slip * t_slip
    tt = tt + of_torque
    det = 1.0 / (pp * tt - pt * pt)
    ipp = tt * det
    itt = pp * det
    ipt = -1.0 * pt * det
    fp = ipp * p + ipt * t
    ft = ipt * p + itt * t
    best = smaller(
        larger(slip + of_slip * (p_slip * fp + t_slip * ft), slip - _SLIP_RANGE), slip + _SLIP_RANGE
    )
    to_array(smaller(larger(best, _LOWEST_SLIP), _HIGHEST_SLIP), fits, f + NEXT_SLIP * COUNT)
    for i in range(UNKNOWNS):
        jp = from_array(fits, f + (OF_PULL + 1 + i) * COUNT)
        jt = from_array(fits, f + (OF_TORQUE + 1 + i) * COUNT)
        up = ipp * jp + ipt * jt
        ut = ipt * jp + itt * jt
        to_array(fma(up, p, fma(ut, t, from_array(g, i * COUNT))), g, i * COUNT)
        for j in range(i + 1):
            n = below_diagonal(i, j) * COUNT
            v = fma(up, from_array(fits, f + (OF_PULL + 1 + j) * COUNT), from_array(A, n))
            to_array(fma(ut, from_array(fits, f + (OF_TORQUE + 1 + j) * COUNT), v), A, n)
    return fp * p + ft * t, (pp * tt - pt * pt) * (1.0 / (of_pull * of_torque))


@compiled_inline
def _factor(A, L):
    """Cholesky factor of A [4 x 4], packed, with the reciprocals of its diagonal; (ln det A)."""
    log_det = fill(0.0)
    for i in range(UNKNOWNS):
        for j in range(i + 1):
            v = from_array(A, below_diagonal(i, j) * COUNT)
            for m in range(j):
                x = from_array(L, below_diagonal(i, m) * COUNT)
                v = fma(-1.0 * x, from_array(L, below_diagonal(j, m) * COUNT), v)
            if i == j:
                v = larger(v, 1e-300)
                log_det = log_det + log(v)
                to_array(1.0 / sqrt(v), L, below_diagonal(i, i) * COUNT)
            else:
                to_array(
                    v * from_array(L, below_diagonal(j, j) * COUNT), L, below_diagonal(i, j) * COUNT
                )
    return log_det


@compiled_inline
def _inverse(L, out, at):
    """Inverse of A from its factor, the lower triangle, into rows from `at` on."""
    M = _matrix2()
    for j in range(UNKNOWNS):  # M = inverse of L
        to_array(from_array(L, below_diagonal(j, j) * COUNT), M, below_diagonal(j, j) * COUNT)
        for i in range(j + 1, UNKNOWNS):
            v = fill(0.0)
            for m in range(j, i):
                x = from_array(L, below_diagonal(i, m) * COUNT)
                v = fma(x, from_array(M, below_diagonal(m, j) * COUNT), v)
            to_array(
                -1.0 * v * from_array(L, below_diagonal(i, i) * COUNT),
                M,
                below_diagonal(i, j) * COUNT,
            )
    for i in range(UNKNOWNS):
        for j in range(i + 1):
            v = fill(0.0)
            for m in range(i, UNKNOWNS):
                x = from_array(M, below_diagonal(m, i) * COUNT)
                v = fma(x, from_array(M, below_diagonal(m, j) * COUNT), v)
            to_array(v, out, (at + below_diagonal(i, j)) * COUNT)


@compiled_inline
def _step(banks, k, A, g, cost, volume, numbers):
    """Take the step A^-1 g of all nodes within the limits, and renew their covariances and weights;
    as `solve`.
    """
    nodes = banks.nodes[k]
    L = _matrix2()
    step = _vector()
    log_det = _factor(A, L)
    _inverse(L, nodes, soil_nodes.COVARIANCE)
    gain = fill(0.0)
    for i in range(UNKNOWNS):
        v = fill(0.0)
        for j in range(UNKNOWNS):
            n = below_diagonal(max(i, j), min(i, j))
            v = fma(
                from_array(nodes, (soil_nodes.COVARIANCE + n) * COUNT), from_array(g, j * COUNT), v
            )
        to_array(v, step, i * COUNT)
        gain = fma(v, from_array(g, i * COUNT), gain)
    tangent = from_array(nodes, soil_nodes.TANGENT * COUNT)
    exponent = from_array(nodes, soil_nodes.EXPONENT * COUNT)
    d_tangent = from_array(step, soil_nodes.TANGENT * COUNT)
    d_exponent = from_array(step, soil_nodes.EXPONENT * COUNT)
    longest = _STEP_COHESION * banks.bins[k, curve.LOAD] / (numbers.radius * numbers.width)
    share = _within(fill(1.0), d_tangent, _STEP_TANGENT)
    share = _within(share, from_array(step, soil_nodes.COHESION * COUNT), longest)
    share = _within(share, d_exponent, _STEP_EXPONENT)
    share = _above(share, tangent - _LEAST_TANGENT, -1.0 * d_tangent)
    share = _above(share, exponent - _LEAST_EXPONENT, -1.0 * d_exponent)
    share = _above(share, _MOST_EXPONENT - exponent, d_exponent)
    for i in range(UNKNOWNS):
        to_array(
            fma(share, from_array(step, i * COUNT), from_array(nodes, i * COUNT)), nodes, i * COUNT
        )
    cost = cost - share * (2.0 - share) * gain
    to_array(cost, nodes, soil_nodes.COST * COUNT)
    weight = from_array(nodes, soil_nodes.LOG_PRIOR * COUNT) - 0.5 * (cost + volume + log_det)
    highest = -smallest(-1.0 * weight)
    weight = larger(weight - highest, -700.0)
    weight = weight - math.log(total(exp(weight)))
    to_array(weight, nodes, soil_nodes.LOG_WEIGHT * COUNT)
    return -smallest(where_less(weight, _UNLIKELY, 0.0 * gain, -1.0 * gain))


@compiled_inline
def _within(share, step, longest):
    """The largest share of a step, at most `share`, that is not longer than `longest`."""
    return smaller(share, longest / larger(abs(step), 1e-12))


@compiled_inline
def _above(share, room, step):
    """The largest share of a step that uses up nine tenths of `room` at most."""
    room = larger(room, 0.0)
    return where_less(room, share * step, larger(0.9 * room / larger(step, 1e-12), 0.02), share)


@compiled_inline
def _linearise_all(banks, k, numbers):
    for b in range(int(banks.point.bins[k])):
        linearise(banks, k, b, numbers)


@compiled_part
def fit(banks, k, changed, replaced, numbers):
    """Renew what is known of the soil of wheel k after bins `changed` and `replaced` (or -1) have
    become others; the least chi-squared.

    These and one other are linearised anew; all where much has changed.
    """
    p = banks.point
    soil_nodes.set_priors(banks, k)
    if p.points[k] <= _FEW:
        _linearise_all(banks, k, numbers)
    else:
        p.stale[k] = p.stale[k] + 1.0 if p.stale[k] + 1.0 < p.bins[k] else 0.0
        stale = int(p.stale[k])
        linearise(banks, k, changed, numbers)
        if replaced >= 0:
            linearise(banks, k, replaced, numbers)
        if stale != changed and stale != replaced:
            linearise(banks, k, stale, numbers)
    if solve(banks, k, numbers) > _STALE:
        _linearise_all(banks, k, numbers)
        solve(banks, k, numbers)
    misfit = soil_nodes.gather(banks, k)
    if banks.nodes[k, soil_nodes.SAME_SOIL * COUNT + COUNT - 1] == 0.0 and soil_nodes.spread_anew(
        banks, k
    ):
        misfit = fit_anew(banks, k, numbers)
    return misfit


@compiled_inline
def fit_anew(banks, k, numbers):
    """Fit nodes that have moved; the least chi-squared."""
    soil_nodes.set_priors(banks, k)
    _linearise_all(banks, k, numbers)
    solve(banks, k, numbers)
    return soil_nodes.gather(banks, k)


@compiled_part
def fit_behind_border(banks, k, numbers):
    """Fit the nodes, which have all moved, until they stay where they are."""
    soil_nodes.set_priors(banks, k)
    for _ in range(_MOST_STEPS):
        _linearise_all(banks, k, numbers)
        if solve(banks, k, numbers) < _STAYS_THERE:
            break
    soil_nodes.gather(banks, k)


@compiled_part
def drop_border(banks, k):
    """Drop the bins on a border from the curve of wheel k, and begin its fit from the prior on."""
    p = banks.point
    bins = banks.bins[k]
    fits = banks.fits[k]
    kept = 0
    for b in range(int(p.bins[k])):
        if bins[b * curve.FIELDS + curve.ON_BORDER] == 0.0:
            for i in range(curve.FIELDS):
                bins[kept * curve.FIELDS + i] = bins[b * curve.FIELDS + i]
            begin_bin(banks, k, kept, fits[(b * FIT_ROWS + NEXT_SLIP) * COUNT])
            kept += 1
    soil_nodes.begin_again(banks, k)
    p.bins[k] = kept
    p.points[k] = min(p.points[k], _FEW - 1.0)
