"""Points to cells: points of like pull, slip and sinkage are averaged, so that noise does not count
as excitation (regression dilution: Fuller 1987, Measurement Error Models, ch. 1).
"""

import math

from numba import literal_unroll

from soil_env._compiled.flags import compiled

from .memory import CELLS, MEANS, OF_CHANGES, VARIANCES

# Differences at which two cells without noise are at a distance of 1, from which on they are kept
# apart: own choices.
PULL_UNIT = 0.003  # [of weight]
SLIP_UNIT = 0.025  # [-]
SINKAGE_UNIT = 0.05  # [of the mean sinkage of both]
# [1/m2] Squared distance of two cells on a border over that of their places, own choice. With
# `NEAREST` it is never below 1: such cells are merged only for want of room, after others.
ON_BORDER = 1e9
NEAREST = 1e-6  # [m2] added to the square of the distance of their places
# [m2] Variance of a reading of the sinkage from which on it was not measured: such have 1e4.
UNKNOWN_SINKAGE = 1.0


@compiled
def _distance(a, b):
    """Squared distance [-] of two cells by pull, slip and sinkage. The unit of each is the root of
    `PULL_UNIT`, `SLIP_UNIT` or `SINKAGE_UNIT` squared plus the variances of both.
    """
    pull = PULL_UNIT**2 + a.pull_variance + b.pull_variance
    slip = SLIP_UNIT**2 + a.slip_variance + b.slip_variance
    sinkage = 0.5 * SINKAGE_UNIT * (a.sinkage + b.sinkage)
    depth = sinkage * sinkage + a.sinkage_variance + b.sinkage_variance
    square = (a.pull - b.pull) ** 2 / pull + (a.slip - b.slip) ** 2 / slip
    return square + (a.sinkage - b.sinkage) ** 2 / depth


@compiled
def _merge(into, cell):
    """Average a `cell` into the cell `into`.

    One share, by the precision of the slip, serves all `MEANS`, so that they stay those of one
    condition. Places are averaged by the number of readings, `OF_CHANGES` by that of changes.
    """
    share = into.slip_variance / (into.slip_variance + cell.slip_variance)
    for name in literal_unroll(MEANS):
        into[name] += share * (cell[name] - into[name])
    for name in literal_unroll(VARIANCES):
        into[name] = (1.0 - share) ** 2 * into[name] + share * share * cell[name]
    by_readings = cell.readings / (into.readings + cell.readings)
    off = cell.place - into.place
    square = (1.0 - by_readings) * into.spread**2 + by_readings * cell.spread**2
    into.spread = math.sqrt(square + by_readings * (1.0 - by_readings) * off * off)
    into.place += by_readings * off
    into.place_error += by_readings * (cell.place_error - into.place_error)
    into.readings += cell.readings
    into.changes += cell.changes
    if into.changes > 0.0:
        share = cell.changes / into.changes
        for name in literal_unroll(OF_CHANGES):
            into[name] += share * (cell[name] - into[name])


@compiled
def _apart(a, b):
    """Squared distance [-] by which cells are kept apart.

    It is `_distance` if neither is on a border, and that of their places (`ON_BORDER`) if both are.
    It is infinite if only one is on a border, or if the sinkage of only one was measured.
    """
    measured = a.sinkage_variance * a.readings < UNKNOWN_SINKAGE  # of one reading
    if measured != (b.sinkage_variance * b.readings < UNKNOWN_SINKAGE):
        return math.inf
    if a.place_error > 0.0 and b.place_error > 0.0:
        return ON_BORDER * ((a.place - b.place) ** 2 + NEAREST)
    if a.place_error > 0.0 or b.place_error > 0.0:
        return math.inf
    return _distance(a, b)


@compiled
def remember(memory):
    """Put the newest cell, that after the `cells_kept` ones of a `MEMORY`, among these.

    It is merged into the nearest one if their squared distance is below 1, else kept beside them.
    Where there is no room, the two of all cells whose merging loses least are merged: squared
    distance times the fewer readings. The newest one, if it is neither, takes the place set free.
    """
    kept = memory.cells_kept
    newest = memory.cells[kept]
    nearest = math.inf
    into = -1
    for k in range(kept):
        distance = _apart(memory.cells[k], newest)
        if distance < nearest:
            nearest = distance
            into = k
    if into >= 0 and nearest < 1.0:
        _merge(memory.cells[into], newest)
        return
    if kept < CELLS:
        memory.cells_kept = kept + 1
        return
    least = math.inf
    first = 0
    second = 1
    for b in range(1, kept + 1):
        for a in range(b):
            lost = _apart(memory.cells[a], memory.cells[b])
            lost *= min(memory.cells[a].readings, memory.cells[b].readings)
            if lost < least:
                least = lost
                first = a
                second = b
    _merge(memory.cells[first], memory.cells[second])
    if second < kept:  # `second` = `kept` is the newest, which is merged now
        memory.cells[second] = memory.cells[kept]
