"""Borders between soils: where a camera sees another class, and by points whose forces are another
soil's; over a border one soil passes into the next.
"""

import math

from soil_env._compiled.flags import compiled

from .best_pull import renew_best_pull
from .linear import invert_whole
from .memory import (
    HERE,
    OLD,
    PLACE,
    PUBLISHED,
    QUANTITIES,
    SOIL,
)
from .residuals import share_at

PLACE_SD = 0.3  # [border lengths] of the place of a border that forces show, which is where they do
# factor of the covariance of the old soil, which the border's first readings spoilt
OLD_DOUBT = 3.0


@compiled
def begin_soil(memory, setting, work):
    """Set what is known of the ground and of the instruments to the prior."""
    memory.excess = 0.0
    memory.form_error = setting.model_error
    memory.misfit = 1.0
    memory.law_misfit = 1.0
    memory.widening = 1.0
    memory.points = 0
    memory.settled = 0
    memory.cells_kept = 0
    memory.u[:HERE] = 0.0
    memory.u[:SOIL] = setting.soil_mean
    memory.soil[:] = setting.soil_mean
    memory.prior_mean[:] = setting.soil_mean
    memory.gradient[:] = 0.0
    memory.covariance[:] = setting.soil_covariance
    memory.spread[:] = setting.soil_covariance
    memory.prior_precision[:] = setting.soil_precision
    memory.information[:] = 0.0
    memory.fresh[:PUBLISHED] = setting.prior[:PUBLISHED]
    memory.fresh_sd[:PUBLISHED] = setting.prior_sd[:PUBLISHED]
    memory.steady[:] = 0.0
    load = memory.mass * setting.gravity if memory.mass > 0.0 else setting.weight
    renew_best_pull(memory, load, setting, work)


@compiled
def begin_border(memory, setting, work, place, variance):
    """Begin with another soil, whose border has its middle at `place` [m]; what was known becomes
    the old soil. Instruments begin anew: carried over, they were too sure.
    """
    memory.border = place
    memory.border_variance = variance
    memory.crossing = 1.0
    memory.behind = 1
    memory.borders += 1
    memory.old[:] = memory.estimate
    memory.old_sd[:] = memory.sd
    memory.u[PLACE] = place
    memory.u[OLD:] = memory.soil
    memory.old_mean[:] = memory.soil
    work.normal[:SOIL, :SOIL] = OLD_DOUBT * memory.spread
    invert_whole(work.normal, SOIL, work, memory.old_precision)
    begin_soil(memory, setting, work)


@compiled
def see_border(memory, sample, camera_sd, setting, work):
    """Begin a border where a camera sees ground of another class begin, and another point; True if
    it did.

    `sample`: an `Image`; `camera_sd` [m]: of the place of a border in it.
    """
    following = sample.label_0 if sample.taken == 0.0 else sample.label_1
    in_sight = sample.seen > 0.0 and sample.left < 0.5 * setting.border
    if memory.crossing > 0.0 or memory.points == 0 or not in_sight or following == sample.here:
        return False
    begin_border(memory, setting, work, memory.place + sample.left, camera_sd**2)
    memory.open[0] = setting.blank[0].open[0]
    return True


@compiled
def feel_border(memory, setting, work):
    """Begin a border that forces show here.

    The form error begins between that before and the believed one: the laws may be wrong here too.
    """
    form_error = math.sqrt(memory.form_error * setting.model_error)
    begin_border(memory, setting, work, memory.place, (PLACE_SD * setting.border) ** 2)
    memory.form_error = form_error


# [m] and [of the spread of a cell] error of the place of a cell on a border
CELL_PLACE = 2e-3
CELL_SHARE = 0.1


@compiled
def put_on_border(memory, cell, setting):
    """Set the error of the place of a new cell on a border, from which its soil follows."""
    before_its_end = memory.borders > 0 and cell.place <= memory.border + 0.5 * setting.border
    if before_its_end or memory.crossing > 0.0:
        cell.place_error = CELL_PLACE + CELL_SHARE * cell.spread


@compiled
def blend_estimates(into, memory, setting):
    """Publish the blend of the old and the fresh estimate of a record on a border."""
    share, slope = share_at(memory.place - memory.border, setting.border)
    rest = 1.0 - share
    for i in range(QUANTITIES):
        change = into.fresh[i] - into.old[i]
        into.estimate[i] = into.old[i] + share * change
        variance = (rest * into.old_sd[i]) ** 2 + (share * into.fresh_sd[i]) ** 2
        into.sd[i] = math.sqrt(variance + (slope * change) ** 2 * memory.border_variance)


@compiled
def take_fresh(known):
    """Publish the fresh estimate of a record."""
    known.estimate[:] = known.fresh
    known.sd[:] = known.fresh_sd
