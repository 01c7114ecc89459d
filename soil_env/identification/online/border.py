"""Borders between soils: where one is, by the grade and by the forces (docs/physics/estimation.md).

Every reading of the pitch tests `CANDIDATES` places, evenly over the length of a border. The
likelihood of a border over that of none is (Bayesian linear regression)

    (1 + A t^2/v)^-1/2 exp(B^2 / (2 v (A + v/t^2))),   A = sum w^2, B = sum w y

with y the pitch less that of this soil so far and w the share of the new soil if the border were
there. t is the sd of the unknown rise, v the variance of a reading. Place and rise are the means
over all places by their likelihoods.
"""

import math

from soil_env.identification.online.curve_fit import drop_border, fit_behind_border
from soil_env.identification.online.filter_bank import CANDIDATES
from soil_env.identification.online.lanes.compiling import compiled_inline, compiled_part
from soil_env.identification.online.lanes.contact import share_of_next
from soil_env.identification.online.lanes.elementary import exp, larger, log
from soil_env.identification.online.lanes.lanes import (
    COUNT,
    fill,
    from_array,
    smallest,
    to_array,
    total,
)
from soil_env.identification.online.sinkage_filter import begin_next_sinkage, keep_old_sinkage
from soil_env.identification.online.soil_nodes import begin_next_soil, leave_old_soil

_ODDS = 2.5  # ln odds at which a change of the grade is a border
# [border lengths] ahead of a point at which the share of a next soil is taken: until the next point
_AHEAD = 0.1
_HAZARD = 0.5  # [1/m] of borders, as believed
_KEPT = 60.0  # readings that the grade of a soil is the mean of, at most
# readings that the grade of a new soil counts for when its border, on which it was estimated, ends
_KNOWN = 5.0
# [squared distances of the places tested] least variance of a place, ampler than that between two
_BETWEEN = 0.4
_KEPT_ERROR = 0.25  # of the form error, that the next soil begins with
# [border lengths] ahead of its middle at which forces show a border, and the sd of that
_FOUND = 1.0 / 6.0
# [border lengths] sd of a border's place beyond which readings on it do not count behind it
_UNSURE = 0.08


@compiled_inline
def search(banks, k, numbers):
    """Begin to look for a border, ahead of where the wheel is."""
    banks.point.nearest[k] = banks.point.place[k] - 0.5 * numbers.border + numbers.offsets[1]
    for i in range(2 * CANDIDATES):
        banks.candidates[k, i] = 0.0


@compiled_inline
def _share(x, place, length):
    """(share of the new soil at x, its derivative by the place of the border)."""
    w, rate = share_of_next((x - place) * (1.0 / length))
    return w, (-1.0 / length) * rate


@compiled_inline
def share_here(banks, k, x, spread, numbers):
    """(share of the new soil, its derivative by the place) of wheel k at x +- spread [m]; 1 away
    from borders.
    """
    if banks.point.crossing[k] == 0.0:
        return 1.0, 0.0
    place = banks.point.border[k]
    low, by_low = _share(x - spread, place, numbers.border)
    high, by_high = _share(x + spread, place, numbers.border)
    return 0.5 * (low + high), 0.5 * (by_low + by_high)


@compiled_inline
def _variance_of_pitch(p, k, numbers):
    """Variance [rad2] of a reading less the grade of this soil so far."""
    return numbers.noise[7] * numbers.noise[7] * (1.0 + 1.0 / max(min(p.grades[k], _KEPT), 1.0))


@compiled_part
def note_grade(banks, k, pitch, numbers):
    """Take a reading of the pitch [rad]."""
    p = banks.point
    found = banks.candidates[k]
    x = banks.point.place[k]
    y = pitch - p.grade[k]
    if p.crossing[k] > 0.0:
        if p.fixed[k] == 0.0:
            _add_pitch(banks, k, y, numbers)
        return
    if p.grades[k] == 0.0 or abs(x - p.nearest[k]) > 2.0 * numbers.border:
        search(banks, k, numbers)
    while p.nearest[k] < x - 0.5 * numbers.border:  # its border is passed: make room for one ahead
        for i in range(CANDIDATES - 1):
            found[i] = found[i + 1]
            found[CANDIDATES + i] = found[CANDIDATES + i + 1]
        found[CANDIDATES - 1] = 0.0
        found[2 * CANDIDATES - 1] = 0.0
        p.nearest[k] += numbers.offsets[1]
    if p.grades[k] > 0.0:
        _add_pitch(banks, k, y, numbers)
    p.grades[k] += 1.0
    p.grade[k] += y / min(p.grades[k], _KEPT)


@compiled_inline
def _add_pitch(banks, k, y, numbers):
    """Add a pitch that is y [rad] above the grade of this soil to A and B of all places."""
    p = banks.point
    found = banks.candidates[k]
    for i in range(0, CANDIDATES, COUNT):
        w, _ = _share(
            fill(p.place[k]), from_array(numbers.offsets, i) + p.nearest[k], numbers.border
        )
        to_array(from_array(found, i) + w * w, found, i)
        to_array(from_array(found, CANDIDATES + i) + y * w, found, CANDIDATES + i)


@compiled_inline
def _likelihoods(found, i, v, ratio):
    """ln likelihood ratios of the candidates i ... i + 7; `ratio` = v/t^2."""
    a = from_array(found, i)
    b = from_array(found, CANDIDATES + i)
    return b * b / (2.0 * v * (a + ratio)) - 0.5 * log(1.0 + a * (1.0 / ratio))


@compiled_part
def _locate(banks, k, numbers):
    """(ln evidence of a border over none, mean [m] and variance [m2] of its place, rise [rad] of
    the grade, mean and mean square of the new soil's share here)."""
    p = banks.point
    found = banks.candidates[k]
    v = _variance_of_pitch(p, k, numbers)
    ratio = v / (numbers.grade_change * numbers.grade_change)
    first = _likelihoods(found, 0, v, ratio)
    second = _likelihoods(found, COUNT, v, ratio)
    highest = -min(smallest(-1.0 * first), smallest(-1.0 * second))
    first = exp(larger(first - highest, -700.0))
    second = exp(larger(second - highest, -700.0))
    weight = total(first + second)
    place = 0.0
    rise = 0.0
    square = 0.0
    here = 0.0
    here_square = 0.0
    for i in range(0, CANDIDATES, COUNT):
        w = (first if i == 0 else second) * (1.0 / weight)
        e = from_array(numbers.offsets, i)
        place += total(w * e)
        square += total(w * e * e)
        rise += total(w * from_array(found, CANDIDATES + i) / (from_array(found, i) + ratio))
        share, _ = _share(
            fill(p.place[k] + _AHEAD * numbers.border), e + p.nearest[k], numbers.border
        )
        here += total(w * share)
        here_square += total(w * share * share)
    variance = max(square - place * place, 0.0) + _BETWEEN * numbers.offsets[1] * numbers.offsets[1]
    return highest + math.log(weight), p.nearest[k] + place, variance, rise, here, here_square


@compiled_part
def cross_where_the_grade_changes(banks, k, numbers):
    """`begin` at the border that the grade shows, if it shows one."""
    odds, place, variance, rise, share, square = _locate(banks, k, numbers)
    odds += math.log(_HAZARD * numbers.offsets[1])
    if odds >= _ODDS:
        begin(banks, k, numbers, place, variance, rise)
    else:
        likely = 1.0 / (1.0 + math.exp(-odds))
        banks.point.next_share[k] = likely * share
        banks.point.next_square[k] = likely * square


@compiled_inline
def follow_border(banks, k, numbers):
    """Renew place and rise of the border under wheel k, unless its place is fixed."""
    p = banks.point
    if p.fixed[k] == 0.0 and numbers.grade_change > 0.0:
        _, p.border[k], p.border_variance[k], p.rise[k], _, _ = _locate(banks, k, numbers)


@compiled_inline
def cross_here(banks, k, numbers):
    """`begin` where the forces show a border."""
    ahead = _FOUND * numbers.border
    misfit = banks.point.misfit[k]
    begin_known_border(banks, k, numbers, banks.point.place[k] + ahead, ahead * ahead)
    banks.point.misfit[k] = misfit  # the misfit until the next point
    banks.point.by_forces[k] = 1.0


@compiled_part
def begin(banks, k, numbers, place, place_variance, rise):
    """Come to a border at `place` [m] with this `rise` of the grade [rad].

    The soil so far becomes the old one, the new one is that of the prior.
    """
    p = banks.point
    p.crossing[k] = 1.0
    p.by_forces[k] = 0.0
    p.fixed[k] = 0.0
    p.same[k] = 0.0
    p.next_share[k] = 0.0
    p.next_square[k] = 0.0
    p.border[k] = place
    p.border_variance[k] = place_variance
    p.rise[k] = rise
    p.form_error[k] = max(_KEPT_ERROR * p.form_error[k], numbers.model_error)
    p.flagged[k] = 1.0 if p.form_error[k] > numbers.model_error else 0.0
    begin_next_soil(banks, k, numbers)
    begin_next_sinkage(banks, k, numbers)


@compiled_inline
def begin_known_border(banks, k, numbers, place, place_variance):
    """`begin` at a place that the grade does not move; the contradictions of the laws so far came
    from the border.
    """
    begin(banks, k, numbers, place, place_variance, 0.0)
    banks.point.fixed[k] = 1.0
    banks.point.form_error[k] = numbers.model_error
    banks.point.flagged[k] = 0.0


@compiled_inline
def end(banks, k, numbers):
    """Leave a border behind: the old soil counts for the readings on the border only, if they count
    at all.
    """
    p = banks.point
    p.crossing[k] = 0.0
    p.misfit[k] = 0.0
    p.grade[k] += p.rise[k]
    p.grades[k] = _KNOWN
    if leave_old_soil(banks, k):
        keep_old_sinkage(banks, k)
        p.same[k] = 1.0
    if p.fixed[k] > 0.0 or p.border_variance[k] > (_UNSURE * numbers.border) ** 2:
        drop_border(banks, k)
    fit_behind_border(banks, k, numbers)
    search(banks, k, numbers)
