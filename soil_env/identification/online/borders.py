"""Borders between soils: by the pitch, where each soil has a grade, and by points whose forces are
another soil's; over a border one soil passes into the next.
"""

import math

from numba import njit

from soil_env._compiled.elementary import smooth_step
from soil_env._compiled.flags import EXACT
from soil_env.identification.online.linear import factorise, invert
from soil_env.identification.online.memory import (
    OLD,
    PITCHES,
    PLACE,
    PUBLISHED,
    SOIL,
)

# [standard deviations] of a pitch from the mean so far, beyond which it is of another grade; two
# in a row show a border
JUMP = 3.0
GRADES = 6.0  # readings of a grade before it can be left
GRADES_KEPT = 60.0  # readings that a mean grade remembers
# Places of a border relative to the first other pitch, and its sd, in lengths of a border, before
# pitches on it have been read.
NOTICED_BY_PITCH = 0.25
NOTICED_BY_FORCES = 0.0
PLACE_SD = 0.15
RISE_VARIANCE = 0.02  # [rad2] of a change of grade
TRIED = 25  # places that are compared
TRIED_FROM = -0.3  # [border lengths] from the first other pitch on, over one length
LEAST_PLACE_SD = 0.02  # [border lengths] of a border's place
OLD_DOUBT = (
    3.0  # factor of the covariance of the old soil, which the border's first readings spoilt
)
SAMPLED = 0.01  # [border lengths] between two pitches that are kept


@njit(**EXACT)
def share_at(behind, length):
    """(share of the new soil, its slope [1/m]) at a distance behind the middle of a border [m]."""
    share, slope = smooth_step(behind / length + 0.5)
    return share, slope / length


@njit(**EXACT)
def _locate(memory, setting):
    """Renew the place of a border and its variance by the pitches on it, the rise unknown."""
    length = setting.border
    noise = setting.white[0].pitch ** 2 + memory.border_grade_variance
    best = -math.inf
    weight = 0.0
    mean = 0.0
    square = 0.0
    for k in range(TRIED):
        place = length * (k / (TRIED - 1.0) + TRIED_FROM)
        a = 0.0
        b = 0.0
        for j in range(memory.pitches_kept):
            w, _ = share_at(memory.border_places[j] - memory.border_first - place, length)
            a += w * w
            b += w * (memory.border_pitches[j] - memory.border_grade)
        log = 0.5 * b * b / (noise * (a + noise / RISE_VARIANCE))
        log -= 0.5 * math.log(1.0 + a * RISE_VARIANCE / noise)
        if log > best:
            shrink = math.exp(best - log)
            weight *= shrink
            mean *= shrink
            square *= shrink
            best = log
        w = math.exp(log - best)
        weight += w
        mean += w * place
        square += w * place * place
    mean /= weight
    memory.border = memory.border_first + mean
    memory.u[PLACE] = memory.border
    spread = max(square / weight - mean * mean, 0.0)
    memory.border_variance = spread + (LEAST_PLACE_SD * length) ** 2


@njit(**EXACT)
def begin_border(memory, setting, work, place, variance):
    """Begin with another soil, whose border has its middle at `place` [m]; what was known becomes
    the old soil. Instruments begin anew: carried over, they were too sure.
    """
    memory.border = place
    memory.border_variance = variance
    memory.border_first = memory.place
    memory.border_grade = memory.grade
    memory.border_grade_variance = setting.white[0].pitch ** 2 / max(memory.grades, 1.0)
    memory.crossing = 1.0
    memory.pitches_kept = 0
    memory.behind = 1
    memory.borders += 1
    for i in range(PUBLISHED):
        memory.old[i] = memory.estimate[i]
        memory.old_sd[i] = memory.sd[i]
        memory.fresh[i] = setting.prior[i]
        memory.fresh_sd[i] = setting.prior_sd[i]
    V = memory.covariance
    for i in range(SOIL):
        memory.old_mean[i] = memory.soil[i]
        for j in range(SOIL):
            work.normal[i, j] = OLD_DOUBT * memory.spread[i, j]
    factorise(work.normal, SOIL, work.factor)
    invert(work.factor, SOIL, work.scratch, memory.old_precision)
    for i in range(SOIL):
        memory.gradient[i] = 0.0
        memory.soil[i] = setting.soil_mean[i]
        memory.u[OLD + i] = memory.old_mean[i]
        memory.u[i] = setting.soil_mean[i]
        memory.prior_mean[i] = setting.soil_mean[i]
        memory.u[SOIL + i] = 0.0
        for j in range(SOIL):
            V[i, j] = setting.soil_covariance[i, j]
            memory.prior_precision[i, j] = setting.soil_precision[i, j]
            memory.spread[i, j] = setting.soil_covariance[i, j]
            memory.information[i, j] = 0.0
    memory.u[PLACE] = place
    memory.form_error = setting.model_error
    for i in range(2):
        memory.old_pull[i] = memory.best_pull[i]
    memory.settled = 0
    memory.misfit = 1.0
    memory.law_misfit = 1.0
    memory.cells_kept = 0
    memory.points = 0
    memory.jumps = 0.0
    memory.odd = 0.0
    memory.widening = 1.0


@njit(**EXACT)
def note_pitch(memory, pitch, setting):
    """Follow the grade of a soil; True if two pitches in a row are of another."""
    if setting.by_pitch == 0:
        return False
    if memory.crossing > 0.0:
        last = memory.pitches_kept
        if 0 < last < PITCHES:
            if abs(memory.place - memory.border_places[last - 1]) > SAMPLED * setting.border:
                memory.border_places[last] = memory.place
                memory.border_pitches[last] = pitch
                memory.pitches_kept = last + 1
        return False
    off = pitch - memory.grade
    sd = setting.white[0].pitch * math.sqrt(1.0 + 1.0 / max(memory.grades, 1.0))
    if memory.grades >= GRADES and abs(off) > JUMP * sd:
        memory.jumps += 1.0
        return memory.jumps >= 2.0
    memory.jumps = 0.0
    memory.grades = min(memory.grades + 1.0, GRADES_KEPT)
    memory.grade += off / memory.grades
    return False


@njit(**EXACT)
def begin_grade(memory, pitch):
    """Begin the mean grade of a soil anew."""
    memory.grade = pitch
    memory.grades = 1.0
    memory.jumps = 0.0


@njit(**EXACT)
def cross(memory, pitch, by_pitch, setting, work):
    """Begin a border that has just been noticed."""
    ahead = NOTICED_BY_PITCH if by_pitch else NOTICED_BY_FORCES
    place = memory.place + ahead * setting.border
    begin_border(memory, setting, work, place, (PLACE_SD * setting.border) ** 2)
    if by_pitch:
        memory.border_places[0] = memory.place
        memory.border_pitches[0] = pitch
        memory.pitches_kept = 1


# [m] and [of the spread of a cell] error of the place of a cell on a border
CELL_PLACE = 2e-3
CELL_SHARE = 0.1


@njit(**EXACT)
def put_on_border(memory, cell, setting):
    """Note the place of a new cell, if it is on the border, and find that anew."""
    if memory.borders == 0 or cell.place > memory.border + 0.5 * setting.border:
        if memory.crossing == 0.0:
            return
    cell.place_error = CELL_PLACE + CELL_SHARE * cell.spread
    if memory.pitches_kept > 2:
        _locate(memory, setting)


@njit(**EXACT)
def blend_estimates(into, memory, setting):
    """Publish the blend of the old and the fresh estimate of a record on a border."""
    share, slope = share_at(memory.place - memory.border, setting.border)
    rest = 1.0 - share
    for i in range(PUBLISHED):
        change = into.fresh[i] - into.old[i]
        into.estimate[i] = into.old[i] + share * change
        variance = (rest * into.old_sd[i]) ** 2 + (share * into.fresh_sd[i]) ** 2
        into.sd[i] = math.sqrt(variance + (slope * change) ** 2 * memory.border_variance)


@njit(**EXACT)
def blend_pull(memory, setting):
    """Publish the blend of old and fresh best pull on a border."""
    share, slope = share_at(memory.place - memory.border, setting.border)
    change = memory.fresh_pull[0] - memory.old_pull[0]
    memory.best_pull[0] = memory.old_pull[0] + share * change
    variance = ((1.0 - share) * memory.old_pull[1]) ** 2 + (share * memory.fresh_pull[1]) ** 2
    variance += (slope * change) ** 2 * memory.border_variance
    memory.best_pull[1] = math.sqrt(variance)


@njit(**EXACT)
def end_border(memory):
    """Leave a border behind: the ground is of the new soil."""
    memory.crossing = 0.0
    memory.grade = 0.0
    memory.grades = 0.0
    for i in range(2):
        memory.best_pull[i] = memory.fresh_pull[i]
    for i in range(PUBLISHED):
        memory.estimate[i] = memory.fresh[i]
        memory.sd[i] = memory.fresh_sd[i]
