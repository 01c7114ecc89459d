"""How far a wheel has dug itself in, from its own speeds and sinkage.

With A = (|V| + recovery u)/l and the sliding speed u = |r w - V| the law of sinkage (`effects.excavation_rate`) reads

    dz/dt = A (z_w - z) + gain (u/l) z_w

Let z_0 be the sinkage at an earlier place and z_w have stayed the same since. With D = exp(-integral of A dt) and G the
response to the digging, dG/dt = gain_0 (u/l) - A G and G = 0 there, for a gain of g times the nominal gain_0

    z = D z_0 + (1 - D + g G) z_w,   so   z/z_w = (1 - D + g G) / (1 - D z_0/z).

This is affine in g, and the place of reference need not be one where the wheel had not dug, nor on the same soil.
"""

from __future__ import annotations

import math

from soil_env._numba.compiling import inlined
from soil_env.terramechanics.effects import excavation_rate

#: Points kept as places of reference.
KEPT = 8
_FADED = 0.4  # D at which a place is far enough back: the nearest such is taken
_LEAST, _LEAST_RATIO = 0.1, 0.3  # 1 - D z_0/z and R0 are taken to be no less

# Columns of the memory of a digging observer: state, sums of the open point, points kept, then (path, response,
# sinkage) of each
_PATH, _RESPONSE, _PATH_SUM, _RESPONSE_SUM, _NUMBER, _DROPPED, _PLACES = 0, 1, 2, 3, 4, 5, 6
#: Floats of that memory. All zero: at rest in soil that carries the wheel, nothing dug.
DIGGING = _PLACES + 3 * KEPT


@inlined
def roll(memory, speed, slip_speed, dt, gain, recovery, length):
    """Take `dt` seconds of motion."""
    a, b = excavation_rate(abs(speed), abs(slip_speed), gain, recovery, length)
    if a > 0.0:
        steady = (b - a) / a
        memory[_RESPONSE] = steady + (memory[_RESPONSE] - steady) * math.exp(-a * dt)
        memory[_PATH] += a * dt


@inlined
def note(memory):
    """Count the present state to the open point."""
    memory[_PATH_SUM] += memory[_PATH]
    memory[_RESPONSE_SUM] += memory[_RESPONSE]


@inlined
def close_point(memory, readings, sinkage, sinkage_sd):
    """(R0, R1, sd): z/z_w = R0 + g R1 at the mean of the open point's readings, its relative error from the sinkages.

    The point becomes a place of reference for those that follow.
    """
    path, response = memory[_PATH_SUM] / readings, memory[_RESPONSE_SUM] / readings
    memory[_PATH_SUM] = memory[_RESPONSE_SUM] = 0.0
    number = int(memory[_NUMBER])
    r0, r1, sd = 1.0, response, 0.0  # from rest at the start
    place, faded = -1, 1.0
    for j in range(number - 1, -1, -1):
        faded = math.exp(memory[_PLACES + 3 * j] - path)
        if faded <= _FADED or (j == 0 and memory[_DROPPED] > 0.0):
            place = _PLACES + 3 * j
            break
    if place >= 0:
        left = max(1.0 - faded * memory[place + 2] / sinkage, _LEAST)
        r0, r1 = max((1.0 - faded) / left, _LEAST_RATIO), (response - faded * memory[place + 1]) / left
        sd = faded * sinkage_sd * math.sqrt(2.0 / readings) / (sinkage * left)
    if number == KEPT:
        for i in range(_PLACES, _PLACES + 3 * (KEPT - 1)):
            memory[i] = memory[i + 3]
        number = KEPT - 1
        memory[_DROPPED] = 1.0
    last = _PLACES + 3 * number
    memory[last], memory[last + 1], memory[last + 2] = path, response, sinkage
    memory[_NUMBER] = number + 1.0
    return r0, r1, sd
