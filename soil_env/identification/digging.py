"""Digging observer: how far a wheel has dug itself in, from its own speeds and sinkage.

With A = (|V| + recovery u)/l and the sliding speed u = |r w - V| the law of sinkage (`effects.excavation_rate`) reads

    dz/dt = A (z_w - z) + gain (u/l) z_w

Let z_0 be the sinkage at an earlier place and z_w have stayed the same since. With D = exp(-integral of A dt) and G the
response to the digging, dG/dt = gain_0 (u/l) - A G and G = 0 there, for a gain of g times the nominal gain_0

    z = D z_0 + (1 - D + g G) z_w,   so   z/z_w = (1 - D + g G) / (1 - D z_0/z).

This is affine in g, and the place of reference need not be one where the wheel had not dug, nor on the same soil.
Travel counts where it leads onto ground that the wheel has not touched: back and forth in its own rut it stays as deep.
"""

from __future__ import annotations

import math

from soil_env._numba.compiling import inlined
from soil_env._numba.rows import Rows, copy_column, rows
from soil_env.terramechanics.effects import excavation_rate, onto_fresh

#: Points kept as places of reference.
KEPT = 8
_FADED = 0.4  # D at which a place is far enough back: the nearest such is taken
_LEAST, _LEAST_RATIO = 0.1, 0.3  # 1 - D z_0/z and R0 are taken to be no less

#: Observers, a column a wheel. All zero: at rest in soil that carries the wheel, nothing dug.
Digging: type[Rows] = rows(
    "Digging",
    "path",  # integral of A dt
    "response",  # G
    "path_sum",  # over the readings of the open point
    "response_sum",
    "places",  # of reference, kept so far
    "dropped",  # 1 once more than KEPT have been passed
    "place",  # [m] by the speed readings
    "furthest",  # [m] ground beyond it is fresh
    "lowest",  # [m] ground before it is fresh
)
#: Their places of reference, KEPT columns a wheel, the oldest first.
DiggingPlaces: type[Rows] = rows("DiggingPlaces", "path", "response", "sinkage")


@inlined
def onto_fresh_ground(memory, k, moved):
    """Move wheel k by `moved` [m]: how far of that it came onto ground that it had not touched."""
    place, high, low = memory.place[k] + moved, memory.furthest[k], memory.lowest[k]
    memory.place[k], memory.furthest[k], memory.lowest[k] = place, max(place, high), min(place, low)
    return onto_fresh(place, low, high)


@inlined
def roll(memory, k, speed, slip_speed, dt, gain, recovery, length):
    """Take `dt` seconds of motion."""
    travel = onto_fresh_ground(memory, k, speed * dt) / dt
    a, b = excavation_rate(travel, abs(slip_speed), gain, recovery, length)
    if a > 0.0:
        steady = (b - a) / a
        memory.response[k] = steady + (memory.response[k] - steady) * math.exp(-a * dt)
        memory.path[k] += a * dt


@inlined
def note(memory, k):
    """Count the present state to the open point."""
    memory.path_sum[k] += memory.path[k]
    memory.response_sum[k] += memory.response[k]


@inlined
def close_point(memory, places, k, readings, sinkage, sinkage_sd):
    """(R0, R1, sd): z/z_w = R0 + g R1 at the mean of the open point's readings, its relative error from the sinkages.

    The point becomes a place of reference for those that follow.
    """
    path, response = memory.path_sum[k] / readings, memory.response_sum[k] / readings
    memory.path_sum[k] = memory.response_sum[k] = 0.0
    number, first = int(memory.places[k]), k * KEPT
    r0, r1, sd = 1.0, response, 0.0  # from rest at the start
    place, faded = -1, 1.0
    for j in range(number - 1, -1, -1):
        faded = math.exp(places.path[first + j] - path)
        if faded <= _FADED or (j == 0 and memory.dropped[k] > 0.0):
            place = first + j
            break
    if place >= 0:
        left = max(1.0 - faded * places.sinkage[place] / sinkage, _LEAST)
        r0, r1 = max((1.0 - faded) / left, _LEAST_RATIO), (response - faded * places.response[place]) / left
        sd = faded * sinkage_sd * math.sqrt(2.0 / readings) / (sinkage * left)
    if number == KEPT:
        for j in range(first, first + KEPT - 1):
            copy_column(places, j + 1, places, j)
        number = KEPT - 1
        memory.dropped[k] = 1.0
    last = first + number
    places.path[last], places.response[last], places.sinkage[last] = path, response, sinkage
    memory.places[k] = number + 1.0
    return r0, r1, sd
