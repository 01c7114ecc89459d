"""Borders between soils: where the filter takes one to begin, and the ground on it.

Over `Belief.border` metres the ground passes from one soil to the next, moduli geometrically and all else linearly
(`ground.blend`) with the share of the new soil (`ground.share_of_next`), a cubic of the distance from the middle of the
border. On a border the state of a filter has the old soil too, the place of the border, and by how much the grade rises
from one soil to the next (`filter_bank`): readings on it tell of both soils, in proportion to their shares.

The soils of a course have a grade each, which passes with them, so the grade tells where a border is before the forces
do. `CANDIDATES` places, evenly over the length of a border, are tested by every reading of the pitch: with y the pitch
less that of this soil so far, w the share of the new soil if the border were there, d = N(0, t^2) the unknown rise and
v the variance of a reading, the likelihood of a border over that of none is (Bayesian linear regression)

    (1 + A t^2/v)^-1/2 exp(B^2 / (2 v (A + v/t^2))),   A = sum w^2, B = sum w y.

At even places these are the delayed hypotheses of where the border is; once one is likely enough, their mean and
variance enter the filter (`begin`). One filter of the bank holds that the soil stays the same there, so that a change
of the grade within one soil loses little of what is known of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from soil_env._numba.compiling import inlined, part
from soil_env._numba.elementary import exp, larger, log, smaller
from soil_env._numba.lanes import COUNT, fill, from_array, scratch, smallest, to_array, total
from soil_env.identification.filter_bank import (
    CANDIDATES,
    COVARIANCES,
    CROSSING,
    MEANS,
    OLD,
    PLACE,
    RISE,
    STAYS,
    element,
    prior_of_soil,
)
from soil_env.identification.linearised import GAIN, LN_K, MASS, SINKAGE, SLIP, STATES, STRENGTH, mobilised_share
from soil_env.terramechanics.ground import share_of_next

_ODDS = 3.0  # ln odds at which a change of the grade is a border
_HAZARD = 0.5  # [1/m] of borders, as believed
_KEPT = 60.0  # readings that the grade of a soil is the mean of, at most
_KNOWN = 5.0  # readings that the grade of a new soil counts for when its border, on which it was estimated, ends
_FOUND = 1.0 / 6.0  # [border lengths] ahead of its middle at which forces show a border, and the sd of that
_SAME = 0.1  # probability that the soil stays the same
_LEAST = 1e-4  # share of either soil on a border
_packed = scratch((MASS + 1) * (MASS + 2) // 2)
_middle = scratch(MASS + 1)
_source, _first = scratch(MEANS), scratch(SINKAGE * MEANS)


class Blend(NamedTuple):
    """How the ground under the wheel follows from both soils and the place of the border; a value a lane."""

    share: object  # of the new soil in the ground
    by_place: object  # d share / d place of the border
    strength: object  # d strength of the ground / d strength of the new soil
    strength_K: object  # d strength of the ground / d ln K of the new soil
    old_strength: object  # d strength of the ground / d strength of the old soil
    old_strength_K: object  # d strength of the ground / d ln K of the old soil
    strength_place: object  # d strength of the ground / d place of the border
    gain: object  # d ln g of the ground / d ln g of the new soil
    old_gain: object  # d ln g of the ground / d ln g of the old soil
    gain_place: object  # d ln g of the ground / d place of the border


# --- where a border is ------------------------------------------------------------------------------------------------


@inlined
def search(banks, k, numbers):
    """Begin to look for a border, ahead of where the wheel is."""
    banks.point.nearest[k] = banks.point.place[k] - 0.5 * numbers.border + numbers.offsets[1]
    for i in range(2 * CANDIDATES):
        banks.candidates[k, i] = 0.0


@inlined
def _share(x, place, length):
    """(share of the new soil at x, its derivative by the place of the border)."""
    w, rate = share_of_next((x - place) * (1.0 / length))
    return w, (-1.0 / length) * rate


@part
def note_grade(banks, k, pitch, numbers):
    """Take a reading of the pitch [rad]."""
    p, found, x = banks.point, banks.candidates[k], banks.point.place[k]
    if p.grades[k] == 0.0 or abs(x - p.nearest[k]) > 2.0 * numbers.border:
        search(banks, k, numbers)
    if p.crossing[k] == 0.0:
        while p.nearest[k] < x - 0.5 * numbers.border:  # its border is passed: make room for one ahead
            for i in range(CANDIDATES - 1):
                found[i], found[CANDIDATES + i] = found[i + 1], found[CANDIDATES + i + 1]
            found[CANDIDATES - 1] = found[2 * CANDIDATES - 1] = 0.0
            p.nearest[k] += numbers.offsets[1]
    y = pitch - p.grade[k]
    if p.grades[k] > 0.0:
        for i in range(0, CANDIDATES, COUNT):
            w, _ = _share(fill(x), from_array(numbers.offsets, i) + p.nearest[k], numbers.border)
            to_array(from_array(found, i) + w * w, found, i)
            to_array(from_array(found, CANDIDATES + i) + y * w, found, CANDIDATES + i)
    if p.crossing[k] == 0.0:
        p.grades[k] += 1.0
        p.grade[k] += y / min(p.grades[k], _KEPT)


@inlined
def _likelihoods(found, i, v, ratio):
    """ln likelihood ratios of the candidates i ... i + 7; `ratio` = v/t^2."""
    a, b = from_array(found, i), from_array(found, CANDIDATES + i)
    return b * b / (2.0 * v * (a + ratio)) - 0.5 * log(1.0 + a * (1.0 / ratio))


@part
def cross_where_the_grade_changes(banks, k, numbers):
    """`begin` at the border that the grade tells of, if it tells of one."""
    p, found = banks.point, banks.candidates[k]
    spread = numbers.grade_change * numbers.grade_change
    v = numbers.noise[7] * numbers.noise[7] * (1.0 + 1.0 / max(min(p.grades[k], _KEPT), 1.0))
    ratio = v / spread
    first, second = _likelihoods(found, 0, v, ratio), _likelihoods(found, COUNT, v, ratio)
    highest = -min(smallest(-1.0 * first), smallest(-1.0 * second))
    first, second = exp(first - highest), exp(second - highest)
    weight = total(first + second)
    if highest + math.log(weight) + math.log(_HAZARD * numbers.offsets[1]) < _ODDS:
        return
    place = rise = 0.0
    squares = products = rises = 0.0
    for i in range(0, CANDIDATES, COUNT):
        w = (first if i == 0 else second) * (1.0 / weight)
        precision = from_array(found, i) + ratio
        e, d = from_array(numbers.offsets, i), from_array(found, CANDIDATES + i) / precision
        place += total(w * e)
        rise += total(w * d)
        squares += total(w * e * e)
        products += total(w * e * d)
        rises += total(w * (d * d + v / precision))
    least = 0.3 * numbers.offsets[1]
    begin(
        banks, k, numbers, p.nearest[k] + place, max(squares - place * place, least * least), rise,
        max(rises - rise * rise, 1e-12), products - place * rise,
    )  # fmt: skip
    p.grade_used[k] = 1.0  # its readings are in the candidates


@inlined
def cross_here(banks, k, numbers):
    """`begin` where the forces tell of a border."""
    ahead = _FOUND * numbers.border
    place, spread = banks.point.place[k] + ahead, max(numbers.grade_change * numbers.grade_change, 1e-12)
    misfit = banks.point.misfit[k]
    begin(banks, k, numbers, place, ahead * ahead, 0.0, spread, 0.0)
    banks.point.misfit[k], banks.point.by_forces[k] = misfit, 1.0  # the misfit until the next point


# --- both soils in the state ------------------------------------------------------------------------------------------


@inlined
def _collapse(banks, k, middle, packed):
    """Mean and covariance, over all filters of bank k, of soil, sinkage and mass."""
    mean, covariance = banks.mean[k], banks.covariance[k]
    w = exp(from_array(banks.log_weight[k], 0))
    w = w * (1.0 / total(w))
    for i in range(MASS + 1):
        middle[i] = total(w * from_array(mean, i * COUNT))
    for i in range(MASS + 1):
        away = from_array(mean, i * COUNT) - middle[i]
        for j in range(i + 1):
            other = from_array(mean, j * COUNT) - middle[j]
            packed[i * (i + 1) // 2 + j] = total(w * (from_array(covariance, element(i, j)) + away * other))


@part
def begin(banks, k, numbers, place, place_variance, rise, rise_variance, both):
    """Come to a border at `place` [m]: the soil so far becomes the old one, the new one is that of the prior."""
    mean, covariance, p = banks.mean[k], banks.covariance[k], banks.point
    middle, packed = _middle(), _packed()
    _collapse(banks, k, middle, packed)
    for i in range(COVARIANCES):
        covariance[i] = 0.0
    for i in range(MASS + 1):
        a = i if i >= SINKAGE else OLD + i
        to_array(fill(middle[i]), mean, a * COUNT)
        for j in range(i + 1):
            b = j if j >= SINKAGE else OLD + j
            to_array(fill(packed[i * (i + 1) // 2 + j]), covariance, element(a, b))
    prior_of_soil(banks, k, numbers)
    for i in range(MASS + 1):  # in the filter `STAYS` the new soil is the old one
        a = i if i >= SINKAGE else OLD + i
        for j in range(SINKAGE):
            v = packed[i * (i + 1) // 2 + j] if i >= j else packed[j * (j + 1) // 2 + i]
            covariance[element(a, j) + STAYS] = v
            if i < SINKAGE and i >= j:
                covariance[element(i, j) + STAYS] = v
        if i < SINKAGE:
            mean[i * COUNT + STAYS] = middle[i]
    to_array(fill(place), mean, PLACE * COUNT)
    to_array(fill(rise), mean, RISE * COUNT)
    to_array(fill(place_variance), covariance, element(PLACE, PLACE))
    to_array(fill(rise_variance), covariance, element(RISE, RISE))
    to_array(fill(both), covariance, element(RISE, PLACE))
    to_array(from_array(banks.log_weight[k], 0) + math.log(1.0 - _SAME), banks.log_weight[k], 0)
    banks.log_weight[k, STAYS] = math.log(_SAME)
    p.crossing[k], p.border[k], p.grade_used[k], p.by_forces[k] = 1.0, place, 0.0, 0.0


@inlined
def end(banks, k, numbers):
    """Leave a border behind: the old soil is forgotten."""
    p = banks.point
    p.crossing[k] = 0.0
    w = exp(from_array(banks.log_weight[k], 0))
    p.grade[k] += total(w * from_array(banks.mean[k], RISE * COUNT)) / total(w)
    p.grades[k], p.points[k] = _KNOWN, 0.0
    search(banks, k, numbers)


# --- the ground under the wheel ---------------------------------------------------------------------------------------


@part
def blend(mean, at, spread, reference, ground, numbers):
    """`Blend`, and into `ground` the states of `linearised`, of a wheel on a border at `at` +- `spread` [m]."""
    place = from_array(mean, PLACE * COUNT)
    low, by_low = _share(at - spread, place, numbers.border)
    high, by_high = _share(at + spread, place, numbers.border)
    w, rate = smaller(larger(0.5 * (low + high), _LEAST), 1.0 - _LEAST), 0.5 * (by_low + by_high)
    v = 1.0 - w
    for i in range(LN_K, GAIN):
        new, old = from_array(mean, i * COUNT), from_array(mean, (OLD + i) * COUNT)
        to_array(v * old + w * new, ground, i * COUNT)
    for i in range(SINKAGE, STATES):
        to_array(from_array(mean, i * COUNT), ground, i * COUNT)
    new, old = exp(from_array(mean, GAIN * COUNT)), exp(from_array(mean, (OLD + GAIN) * COUNT))
    gain = v * old + w * new
    to_array(log(gain), ground, GAIN * COUNT)
    K, old_K = from_array(mean, LN_K * COUNT), from_array(mean, (OLD + LN_K) * COUNT)
    share, by_K = mobilised_share(K, reference)
    old_share, old_by_K = mobilised_share(old_K, reference)
    here, here_by_K = mobilised_share(from_array(ground, LN_K * COUNT), reference)
    t, old_t = from_array(mean, STRENGTH * COUNT) / share, from_array(mean, OLD * COUNT) / old_share
    strength = v * old_t + w * t
    to_array(strength * here, ground, STRENGTH * COUNT)
    return Blend(
        w, rate, w * here / share, w * (strength * here_by_K - here * t * by_K / share),
        v * here / old_share, v * (strength * here_by_K - here * old_t * old_by_K / old_share),
        rate * (here * (t - old_t) + strength * here_by_K * (K - old_K)),
        w * new / gain, v * old / gain, rate * (new - old) / gain,
    )  # fmt: skip


@part
def by_both_soils(row, mean, b, out):
    """Derivatives by the states of `linearised`, and the value, to derivatives by all states, and the value."""
    of_place = from_array(row, 0) * b.strength_place + from_array(row, GAIN * COUNT) * b.gain_place
    for i in range(LN_K, GAIN):
        d = from_array(row, i * COUNT)
        to_array(b.share * d, out, i * COUNT)
        to_array((1.0 - b.share) * d, out, (OLD + i) * COUNT)
        of_place = of_place + d * b.by_place * (from_array(mean, i * COUNT) - from_array(mean, (OLD + i) * COUNT))
    d = from_array(row, STRENGTH * COUNT)
    to_array(b.strength * d, out, STRENGTH * COUNT)
    to_array(b.old_strength * d, out, OLD * COUNT)
    to_array(from_array(out, LN_K * COUNT) + b.strength_K * d, out, LN_K * COUNT)
    to_array(from_array(out, (OLD + LN_K) * COUNT) + b.old_strength_K * d, out, (OLD + LN_K) * COUNT)
    d = from_array(row, GAIN * COUNT)
    to_array(b.gain * d, out, GAIN * COUNT)
    to_array(b.old_gain * d, out, (OLD + GAIN) * COUNT)
    for i in range(SINKAGE, STATES):
        to_array(from_array(row, i * COUNT), out, i * COUNT)
    to_array(of_place, out, PLACE * COUNT)
    to_array(fill(0.0), out, RISE * COUNT)
    to_array(from_array(row, STATES * COUNT), out, CROSSING * COUNT)


@inlined
def _of_ground(i, source, at, mean, b):
    """Soil state i of the ground, of a quantity that is given by both soils and the place from source[at] on, to first
    order."""
    new, old = from_array(source, at + i * COUNT), from_array(source, at + (OLD + i) * COUNT)
    place = from_array(source, at + PLACE * COUNT)
    if i == STRENGTH:
        K, old_K = from_array(source, at + LN_K * COUNT), from_array(source, at + (OLD + LN_K) * COUNT)
        return (
            b.strength * new
            + b.strength_K * K
            + b.old_strength * old
            + b.old_strength_K * old_K
            + b.strength_place * place
        )
    if i == GAIN:
        return b.gain * new + b.old_gain * old + b.gain_place * place
    change = b.by_place * (from_array(mean, i * COUNT) - from_array(mean, (OLD + i) * COUNT))
    return b.share * new + (1.0 - b.share) * old + change * place


@part
def covariance_of_ground(covariance, mean, b, out):
    """Covariance of the six soil states of the ground under the wheel into `out`, packed as that of a bank."""
    source, half = _source(), _first()
    for q in range(PLACE + 1):
        if SINKAGE <= q <= SLIP:
            continue
        for p in range(PLACE + 1):
            if not SINKAGE <= p <= SLIP:
                to_array(from_array(covariance, element(p, q)), source, p * COUNT)
        for i in range(SINKAGE):
            to_array(_of_ground(i, source, 0, mean, b), half, (i * CROSSING + q) * COUNT)
    for i in range(SINKAGE):
        for j in range(i + 1):
            to_array(_of_ground(j, half, i * CROSSING * COUNT, mean, b), out, element(i, j))
