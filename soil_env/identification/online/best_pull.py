"""Best steady drawbar pull of the ground under the wheel, of the load, with its standard deviation.

At each of `SLIP` the steady sinkage z is the root of ln s(z) + n ln q - ln S: s is the sinkage
coefficient that the load mobilises, q the ratio of slip-sinkage. A step of Newton's method a point
follows it. Friction, cohesion, K and stiffness err together, so the pull is known better than any
of them: its variance is by their whole covariance.
"""

import math

import numpy as np

from soil_env._compiled.flags import compiled
from soil_env.terramechanics.effects.slip_sinkage import slip_sinkage_ratio

from .forces import (
    BY_SINKAGE,
    LEAST_COEFFICIENT,
    LN_S,
    OF_GROUND,
    PULL,
    TORQUE,
    reaction,
)
from .memory import (
    BEST_PULL,
    EXPONENT,
    GAIN,
    LOAD_GAIN,
    PRESSURE,
    SLIPS,
    SOIL,
)
from .residuals import ground_of

SLIP = np.array([0.08, 0.15, 0.23, 0.33, 0.45, 0.6, 0.78, 0.97])  # [-] at which pulls are compared
assert len(SLIP) == SLIPS
FLOORED = math.log(2.0 * LEAST_COEFFICIENT)  # ln of a mobilised coefficient that counts as none
FIRST_STEPS = 12  # of Newton's method, from a first guess; one step follows what is known
FAR = 0.7  # largest step of ln z
SHALLOWEST = 1e-5  # [radii]
DEEPEST = 1.5  # [radii]
FLATTEST = -0.1  # slope of the condition by ln z, at least


@compiled
def _newton(x, slip, load, memory, setting, work):
    """(ln z after a step, slope of the condition by ln z, ratio q); `work.contact` at x."""
    u = memory.soil
    contact = work.contact[0]
    ground = ground_of(u, setting)
    z = math.exp(x)
    reaction(contact, ground, z, slip, load, setting.radius, setting.width)
    ln_s = contact.value[LN_S]
    gain = setting.dig_gain * math.exp(u[GAIN])
    ratio = slip_sinkage_ratio(slip, gain, setting.dig_recovery)
    n = u[EXPONENT]
    ln_S = u[PRESSURE] + memory.compaction * (n + 0.5) - n * math.log(setting.depth)
    slope = min(contact.by[LN_S, BY_SINKAGE] * z, FLATTEST)
    step = -(ln_s + u[EXPONENT] * math.log(ratio) - ln_S) / slope
    if ln_s <= FLOORED:  # cohesion alone carries the load
        step = -FAR
    after = x + min(max(step, -FAR), FAR)
    low = math.log(SHALLOWEST * setting.radius)
    high = math.log(DEEPEST * setting.radius)
    return min(max(after, low), high), slope, ratio


@compiled
def _slopes(deeper, slope, ratio, memory, setting, work):
    """Slopes of the steady pull by the soil, S keeping the condition, into `work.step`; `deeper`:
    that at a given soil by ln z.
    """
    by = work.contact[0].by
    through = -deeper / slope
    for i in range(OF_GROUND):
        work.step[i] = by[PULL, i] + through * by[LN_S, i]
    of_exponent = math.log(ratio) + math.log(setting.depth) - memory.compaction
    work.step[EXPONENT] += through * of_exponent
    work.step[PRESSURE] = -through
    work.step[GAIN] = through * memory.soil[EXPONENT] * (1.0 - 1.0 / ratio)


@compiled
def renew_best_pull(memory, load, setting, work):
    """Renew the fresh best pull under a measured `load` [N]."""
    load *= 1.0 - memory.u[LOAD_GAIN]
    contact = work.contact[0]
    best = -math.inf
    variance = 1.0
    for k in range(SLIPS):
        x = memory.steady[k]
        if x == 0.0:
            x = math.log(setting.depth)
            for _ in range(FIRST_STEPS):
                x, _, _ = _newton(x, SLIP[k], load, memory, setting, work)
        after, slope, ratio = _newton(x, SLIP[k], load, memory, setting, work)
        memory.steady[k] = after
        deeper = contact.by[PULL, BY_SINKAGE] * math.exp(x)
        pull = contact.value[PULL] + deeper * (after - x)
        if contact.value[TORQUE] > setting.stall_torque or pull <= best:
            continue
        best = pull
        _slopes(deeper, slope, ratio, memory, setting, work)
        variance = 0.0
        for i in range(SOIL):
            for j in range(SOIL):
                variance += work.step[i] * work.step[j] * memory.spread[i, j]
    if math.isfinite(best) and math.isfinite(variance):
        memory.fresh[BEST_PULL] = max(best / load, -1.0)
        memory.fresh_sd[BEST_PULL] = math.sqrt(max(variance, 0.0)) / load
    else:
        memory.fresh[BEST_PULL] = -1.0
        memory.fresh_sd[BEST_PULL] = 1.0
        for k in range(SLIPS):
            memory.steady[k] = 0.0
