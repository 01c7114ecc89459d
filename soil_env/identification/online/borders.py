"""Borders between soils: where a camera sees another class, and by points whose forces are another
soil's; over a border one soil passes into the next.

`memory`, `setting` and `work` are records `MEMORY`, `SETTING` and `WORK` of memory.py.
"""

import math

from soil_env._compiled.flags import compiled, inlined

from .best_pull import renew_best_pull
from .linear import invert_whole
from .memory import HERE, OLD, PLACE, PUBLISHED, QUANTITIES, SOIL
from .residuals import share_at

# [border lengths] standard deviation of the place of a border that forces show, own choice: its
# middle is assumed where they do
PLACE_SD = 0.3
# Factor of the covariance of the old soil, own choice: the first readings on the border were taken
# for that soil.
OLD_DOUBT = 3.0
CELL_PLACE = 2e-3  # [m] error of the place of a cell on a border, own choice
CELL_SHARE = 0.1  # [of the spread of the cell] added to that error, own choice


@compiled
def begin_soil(memory, setting, work):
    """Set what is known of the ground and of the instruments to the prior, without points, and the
    fresh estimate with it.

    Mass, clocks, places, the open point, the old soil and the published estimate stay.
    """
    memory.excess = 0.0
    memory.form_error = setting.model_error
    memory.misfit = 1.0
    memory.law_misfit = 1.0
    memory.widening = 1.0
    memory.points = 0
    memory.settled = 0
    memory.cells_kept = 0
    memory.u[:HERE] = 0.0
    for i in range(SOIL):
        memory.u[i] = setting.soil_mean[i]
    memory.soil = setting.soil_mean
    memory.prior_mean = setting.soil_mean
    memory.gradient[:] = 0.0
    memory.covariance = setting.soil_covariance
    memory.spread = setting.soil_covariance
    memory.prior_precision = setting.soil_precision
    memory.information[:] = 0.0
    for i in range(PUBLISHED):
        memory.fresh[i] = setting.prior[i]
        memory.fresh_sd[i] = setting.prior_sd[i]
    memory.steady[:] = 0.0
    load = memory.mass * setting.gravity if memory.mass > 0.0 else setting.weight
    renew_best_pull(memory, load, setting, work)


@compiled
def begin_border(memory, setting, work, place, variance):
    """Begin with another soil, whose border has its middle at `place` [m] with a `variance` [m2].

    What was known becomes the old soil. The instruments begin anew: carried over, they were too
    sure.
    """
    memory.border = place
    memory.border_variance = variance
    memory.crossing = 1.0
    memory.behind = 1
    memory.borders += 1
    memory.old = memory.estimate
    memory.old_sd = memory.sd
    memory.u[PLACE] = place
    memory.old_mean = memory.soil
    memory.old_form_error = memory.form_error
    for i in range(SOIL):
        memory.u[OLD + i] = memory.soil[i]
        for j in range(SOIL):
            work.normal[i, j] = OLD_DOUBT * memory.spread[i, j]
    invert_whole(work.normal, SOIL, work, memory.old_precision)
    begin_soil(memory, setting, work)


@inlined
def see_border(memory, sample, rolled, camera_sd, setting, work):
    """Begin a border, where a camera sees another class of ground begin within half the length of a
    border, and empty the open point; True if it did.

    On a border and before the first point none begins. `sample`: an `Image`, taken `rolled` [m]
    ahead of the place of `memory`; `camera_sd` [m]: standard deviation of the place of a border.
    """
    following = sample.label_0 if sample.taken == 0.0 else sample.label_1
    in_sight = sample.seen > 0.0 and sample.left < 0.5 * setting.border
    if memory.crossing > 0.0 or memory.points == 0 or not in_sight or following == sample.here:
        return False
    begin_border(memory, setting, work, memory.place + rolled + sample.left, camera_sd**2)
    memory.open[0] = setting.blank[0].open[0]
    return True


@compiled
def feel_border(memory, setting, work):
    """Begin a border with its middle here, where forces show it.

    The form error begins at the geometric mean of the one before and the believed one: the laws may
    be wrong after the border too.
    """
    form_error = math.sqrt(memory.form_error * setting.model_error)
    begin_border(memory, setting, work, memory.place, (PLACE_SD * setting.border) ** 2)
    memory.form_error = form_error


@compiled
def put_on_border(memory, cell, setting):
    """Set `place_error` [m] of a new cell, if it lies before the end of the last border or the
    wheel is on one.

    A `place_error` above 0 marks a cell whose soil is a blend (`residuals`).
    """
    before_its_end = memory.borders > 0 and cell.place <= memory.border + 0.5 * setting.border
    if before_its_end or memory.crossing > 0.0:
        cell.place_error = CELL_PLACE + CELL_SHARE * cell.spread


@compiled
def blend_estimates(into, memory, setting):
    """Publish, in `estimate` and `sd` of the record `into`, the blend of its old and its fresh
    estimate on a border.

    `memory`: `MEMORY` of the wheel, whose place past the middle of the border gives the shares. The
    variance of the border's place adds to the variances of both estimates.
    """
    share, slope = share_at(memory.place - memory.border, setting.border)
    rest = 1.0 - share
    for i in range(QUANTITIES):
        change = into.fresh[i] - into.old[i]
        into.estimate[i] = into.old[i] + share * change
        variance = (rest * into.old_sd[i]) ** 2 + (share * into.fresh_sd[i]) ** 2
        into.sd[i] = math.sqrt(variance + (slope * change) ** 2 * memory.border_variance)


@compiled
def take_fresh(known):
    """Publish the fresh estimate of a record with `ESTIMATES`, `known`, off borders."""
    known.estimate = known.fresh
    known.sd = known.fresh_sd
