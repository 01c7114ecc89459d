"""Posterior of the soil under a wheel as eight nodes of ln K, each a Gaussian of the other
unknowns.

Unknowns of a node are tan phi, cohesion and the exponent n, and the place of the border where the
soil passes into the next. Why: docs/physics/estimation.md.
"""

import math

from soil_env.identification.online.lanes.compiling import compiled_inline, compiled_part
from soil_env.identification.online.lanes.elementary import exp
from soil_env.identification.online.lanes.lanes import (
    COUNT,
    fill,
    from_array,
    scratch,
    smallest,
    to_array,
    total,
)
from soil_env.identification.online.sinkage_filter import DEPTH, GAIN, PRESSURE, mean, spread

#: Rows of `nodes`, COUNT numbers each: the unknowns, ln K ...
TANGENT, COHESION, EXPONENT, BORDER_PLACE, LN_K = range(5)
UNKNOWNS = 4
SOIL = 4
TRIANGLE = UNKNOWNS * (UNKNOWNS + 1) // 2
# ... ln weight, chi-squared, 1 for the node of a soil that stays the same, prior mean and
# precision, ln prior, and the posterior covariance, lower triangles row by row.
LOG_WEIGHT = 5
COST = 6
SAME_SOIL = 7
PRIOR_MEAN = 8
PRECISION = 11
LOG_PRIOR = 17
COVARIANCE = 18
NODE_ROWS = COVARIANCE + TRIANGLE
# A Gaussian of a soil: mean of (tan phi, cohesion, exponent, ln K), then the lower triangle of the
# covariance. `known` has that of the newest soil, then that of the soil before.
GAUSSIAN = SOIL + SOIL * (SOIL + 1) // 2
OLD = GAUSSIAN
# Conditional prior of a soil, `prior`: mean and variance of ln K, mean of the others and their
# slopes by it, precision of the others given it, ln of the determinant of that.
PRIOR_K = 0
PRIOR_OTHERS = 2
PRIOR_SLOPES = 5
PRIOR_PRECISION = 8
PRIOR_LOG = 14
PRIOR_SIZE = 15
STAYS = COUNT - 1  # the node to which the soil stays the same on a border

REACH = 3.0  # [sd of ln K] of the outermost nodes
_CLOSER = 4.0  # [steps of the nodes] that the range of new ones has at least
_LEAST_SD = 0.02  # of ln K, that the nodes resolve
_BETWEEN = 0.4  # [steps of the nodes] least sd of ln K: nodes resolve no less
_WIDE = 1.35  # of the range: where nodes are spread anew
_OFF = 0.25
_NARROW = 0.7
_SAME = 0.05  # probability that the soil stays the same where a border is found
_SURELY = 0.85  # the probability from which it counts as the same
_LOOSER = 1e-4  # share of the prior variance by which a soil that stays the same may differ
_rows = scratch(5 * COUNT)
_gaussian = scratch(GAUSSIAN)
_of_sinkage = scratch(8)


@compiled_inline
def below_diagonal(i, j):
    """Place of element (i, j), i >= j, in a lower triangle."""
    return i * (i + 1) // 2 + j


@compiled_inline
def _condition_on_ln_K(gaussian, prior):
    """Store the Gaussian [GAUSSIAN] of the other unknowns given ln K into the conditional `prior`
    [PRIOR_SIZE].

    phi stands for its tangent, c for the cohesion, n for the exponent.
    """
    covariance = gaussian[SOIL:]
    phi_K = covariance[6]
    c_K = covariance[7]
    n_K = covariance[8]
    variance = max(covariance[9], 1e-6)
    prior[PRIOR_K] = gaussian[3]
    prior[PRIOR_K + 1] = variance
    for i in range(3):
        prior[PRIOR_OTHERS + i] = gaussian[i]
        prior[PRIOR_SLOPES + i] = covariance[6 + i] / variance
    phi_phi = covariance[0] - phi_K**2 / variance
    c_phi = covariance[1] - c_K * phi_K / variance
    c_c = covariance[2] - c_K**2 / variance
    n_phi = covariance[3] - n_K * phi_K / variance
    n_c = covariance[4] - n_K * c_K / variance
    n_n = covariance[5] - n_K**2 / variance
    phi_phi = 1.0001 * abs(phi_phi)
    c_c = 1.0001 * abs(c_c)
    n_n = 1.0001 * abs(n_n)
    # cofactors of the first column, by which the determinant is expanded
    of_phi = c_c * n_n - n_c * n_c
    of_c = n_c * n_phi - c_phi * n_n
    of_n = c_phi * n_c - c_c * n_phi
    determinant = max(phi_phi * of_phi + c_phi * of_c + n_phi * of_n, 1e-300)
    precision = prior[PRIOR_PRECISION:]
    precision[0] = of_phi / determinant
    precision[1] = of_c / determinant
    precision[3] = of_n / determinant
    precision[2] = (phi_phi * n_n - n_phi * n_phi) / determinant
    precision[4] = (c_phi * n_phi - phi_phi * n_c) / determinant
    precision[5] = (phi_phi * c_c - c_phi * c_phi) / determinant
    prior[PRIOR_LOG] = -math.log(determinant)


@compiled_inline
def renew_prior(banks, k, numbers):
    """The prior of the soil of wheel k, given the Gaussian of its sinkage filter."""
    prior = numbers.prior
    s = banks.sinkage[k]
    g = _gaussian()
    covariance = numbers.prior.sinkage_covariance
    a = mean(s, PRESSURE) - prior.sinkage[0]
    b = mean(s, GAIN) - prior.sinkage[1]
    aa = covariance[0] - spread(s, PRESSURE, PRESSURE)
    ab = covariance[1] - spread(s, PRESSURE, GAIN)
    bb = covariance[3] - spread(s, GAIN, GAIN)
    r = prior.regression
    for i in range(SOIL):
        g[i] = prior.forces[i] + r[2 * i] * a + r[2 * i + 1] * b
        along = r[2 * i] * aa + r[2 * i + 1] * ab
        across = r[2 * i] * ab + r[2 * i + 1] * bb
        for j in range(i + 1):
            n = SOIL + below_diagonal(i, j)
            g[n] = prior.forces[n] - along * r[2 * j] - across * r[2 * j + 1]
    _condition_on_ln_K(g, banks.prior[k])


@compiled_inline
def set_priors(banks, k):
    """The prior of each node, given its ln K; that of the node of a soil that stays the same is the
    old soil.
    """
    nodes = banks.nodes[k]
    prior = banks.prior[k]
    away = from_array(nodes, LN_K * COUNT) - prior[PRIOR_K]
    v = prior[PRIOR_K + 1]
    step = nodes[LN_K * COUNT + 1] - nodes[LN_K * COUNT]
    for i in range(3):
        to_array(
            prior[PRIOR_SLOPES + i] * away + prior[PRIOR_OTHERS + i],
            nodes,
            (PRIOR_MEAN + i) * COUNT,
        )
    for i in range(6):
        to_array(fill(prior[PRIOR_PRECISION + i]), nodes, (PRECISION + i) * COUNT)
    of_node = math.log(step) - 0.5 * math.log(2.0 * math.pi * v) + 0.5 * prior[PRIOR_LOG]
    to_array(of_node - (0.5 / v) * away * away, nodes, LOG_PRIOR * COUNT)
    if nodes[SAME_SOIL * COUNT + STAYS] > 0.0:
        old = banks.old_prior[k]
        to_array(
            from_array(nodes, LOG_PRIOR * COUNT) + math.log(1.0 - _SAME), nodes, LOG_PRIOR * COUNT
        )
        for i in range(3):
            nodes[(PRIOR_MEAN + i) * COUNT + STAYS] = old[PRIOR_OTHERS + i]
        for i in range(6):
            nodes[(PRECISION + i) * COUNT + STAYS] = old[PRIOR_PRECISION + i]
        nodes[LOG_PRIOR * COUNT + STAYS] = math.log(_SAME) + 0.5 * old[PRIOR_LOG]


@compiled_inline
def _place_nodes(nodes, centre, half, count):
    for j in range(count):
        nodes[LN_K * COUNT + j] = centre + half * (2.0 * j / (count - 1) - 1.0)


@compiled_inline
def _begin(banks, k, count):
    """Nothing is known of a soil but its prior: `count` nodes."""
    nodes = banks.nodes[k]
    prior = banks.prior[k]
    banks.point.points[k] = 0.0
    banks.point.bins[k] = 0.0
    banks.point.misfit[k] = 0.0
    banks.point.stale[k] = 0.0
    _place_nodes(nodes, prior[PRIOR_K], REACH * math.sqrt(prior[PRIOR_K + 1]), count)
    for j in range(COUNT):
        away = nodes[LN_K * COUNT + j] - prior[PRIOR_K]
        for i in range(3):
            nodes[i * COUNT + j] = prior[PRIOR_OTHERS + i] + prior[PRIOR_SLOPES + i] * away
        nodes[BORDER_PLACE * COUNT + j] = banks.point.border[k]
        nodes[SAME_SOIL * COUNT + j] = 0.0
        nodes[LOG_WEIGHT * COUNT + j] = 0.0


@compiled_part
def begin_soil(banks, k, numbers):
    """Set what is known of the soil of wheel k to its prior."""
    for i in range(GAUSSIAN):
        banks.known[k, i] = numbers.prior.forces[i]
    _condition_on_ln_K(numbers.prior.forces, banks.prior[k])
    _begin(banks, k, COUNT)


@compiled_part
def begin_next_soil(banks, k, numbers):
    """Begin a new soil, which is the same with some probability; the soil so far becomes the old
    one.
    """
    nodes = banks.nodes[k]
    known = banks.known[k]
    old = banks.old_prior[k]
    for i in range(GAUSSIAN):
        known[OLD + i] = known[i]
    for diagonal in (0, 2, 5):
        known[SOIL + diagonal] += _LOOSER * numbers.prior.forces[SOIL + diagonal]
    _condition_on_ln_K(known, old)
    _condition_on_ln_K(numbers.prior.forces, banks.prior[k])
    _begin(banks, k, STAYS)
    nodes[LN_K * COUNT + STAYS] = known[OLD + 3]
    for i in range(3):
        nodes[i * COUNT + STAYS] = known[OLD + i]
    nodes[SAME_SOIL * COUNT + STAYS] = 1.0
    for i in range(GAUSSIAN):
        known[i] = numbers.prior.forces[i]


@compiled_part
def leave_old_soil(banks, k):
    """Behind a border: spread all nodes over the new soil; True if that is the old one."""
    nodes = banks.nodes[k]
    prior = banks.prior[k]
    p = LN_K * COUNT
    same = math.exp(nodes[LOG_WEIGHT * COUNT + STAYS])
    if same > _SURELY:
        for i in range(PRIOR_SIZE):
            prior[i] = banks.old_prior[k, i]
        begin_again(banks, k)
        return True
    centre = 0.0
    square = 0.0
    for j in range(STAYS):
        w = math.exp(nodes[LOG_WEIGHT * COUNT + j]) / max(1.0 - same, 1e-12)
        centre += w * nodes[p + j]
        square += w * nodes[p + j] * nodes[p + j]
    _respread(
        nodes, centre, REACH * max(math.sqrt(max(square - centre * centre, 0.0)), 0.05), STAYS
    )
    return False


@compiled_inline
def begin_again(banks, k):
    """Nodes at their prior, fitted to the bins so far."""
    p = banks.point
    points = p.points[k]
    bins = p.bins[k]
    _begin(banks, k, COUNT)
    p.points[k] = points
    p.bins[k] = bins


@compiled_inline
def _row(i):
    """Row of `nodes` of unknown i of a soil."""
    return LN_K if i == 3 else i


@compiled_part
def gather(banks, k):
    """Mean and covariance of (tan phi, cohesion, exponent, ln K) over all nodes into `known`; the
    least chi-squared.
    """
    nodes = banks.nodes[k]
    known = banks.known[k]
    w = exp(from_array(nodes, LOG_WEIGHT * COUNT))
    for i in range(SOIL):
        known[i] = total(w * from_array(nodes, _row(i) * COUNT))
    for i in range(SOIL):
        away = from_array(nodes, _row(i) * COUNT) - known[i]
        for j in range(i + 1):
            v = away * (from_array(nodes, _row(j) * COUNT) - known[j])
            if i < 3:
                v = v + from_array(nodes, (COVARIANCE + below_diagonal(i, j)) * COUNT)
            known[SOIL + below_diagonal(i, j)] = total(w * v)
    if nodes[SAME_SOIL * COUNT + STAYS] > 0.0:  # of its ln K that node has the mean only
        slopes = banks.old_prior[k]
        v = math.exp(nodes[LOG_WEIGHT * COUNT + STAYS]) * known[OLD + SOIL + 9]
        known[SOIL + 9] += v
        for i in range(3):
            known[SOIL + 6 + i] += v * slopes[PRIOR_SLOPES + i]
            for j in range(i + 1):
                known[SOIL + below_diagonal(i, j)] += (
                    v * slopes[PRIOR_SLOPES + i] * slopes[PRIOR_SLOPES + j]
                )
    between = _BETWEEN * (nodes[LN_K * COUNT + 1] - nodes[LN_K * COUNT])
    known[SOIL + 9] = max(known[SOIL + 9], between * between)
    return smallest(from_array(nodes, COST * COUNT))


@compiled_part
def spread_anew(banks, k):
    """Spread the nodes over what is known of ln K now, if they lie too close or too far apart: True
    if they moved.
    """
    nodes = banks.nodes[k]
    known = banks.known[k]
    p = LN_K * COUNT
    first = nodes[p]
    last = nodes[p + COUNT - 1]
    reach = last - first
    middle = 0.5 * (first + last)
    least = 0.5 * _CLOSER / REACH * reach / (COUNT - 1)
    sd = max(math.sqrt(max(known[SOIL + 9], 0.0)), _LEAST_SD, least)
    goal = 2.0 * REACH * sd
    if reach <= _WIDE * goal and reach >= _NARROW * goal and abs(known[3] - middle) <= _OFF * reach:
        return False
    _respread(nodes, known[3], 0.5 * goal, COUNT)
    return True


@compiled_inline
def _respread(nodes, centre, half, before):
    """All nodes, at centre +- half; their unknowns are between those of the `before` first ones."""
    old = _rows()
    for i in range(5 * COUNT):
        old[i] = nodes[i]
    _place_nodes(nodes, centre, half, COUNT)
    for j in range(COUNT):
        x = nodes[LN_K * COUNT + j]
        m = 0
        while m < before - 2 and old[LN_K * COUNT + m + 1] < x:
            m += 1
        at = LN_K * COUNT + m
        h = min(max((x - old[at]) / (old[at + 1] - old[at]), -0.5), 1.5)
        for i in range(UNKNOWNS):
            a = old[i * COUNT + m]
            nodes[i * COUNT + j] = a + h * (old[i * COUNT + m + 1] - a)
        nodes[SAME_SOIL * COUNT + j] = 0.0


@compiled_inline
def fit_is_sound(banks, k):
    """True if all that is known of the soil is finite."""
    known = banks.known[k]
    all_ = total(from_array(banks.sinkage[k], DEPTH * COUNT))
    for i in range(GAUSSIAN):
        all_ += abs(known[i])
    return abs(all_) < 1e18
