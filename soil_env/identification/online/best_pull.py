"""Best steady drawbar pull of the ground under the wheel, of the load, with its standard deviation.

At each of `SLIP` the steady sinkage z is the root of ln s(z) + n ln q - ln S: s is the sinkage
coefficient that the load mobilises, q the ratio of slip-sinkage. A step of Newton's method a point
follows it. Friction, cohesion, K and stiffness err together, so the pull is known better than any
of them: its variance is by their whole covariance.
"""

import math

import numpy as np

from soil_env._compiled.flags import compiled
from soil_env.identification.online.forces import LEAST_COEFFICIENT, reaction
from soil_env.identification.online.memory import (
    BEST_PULL,
    COHESION,
    EXPONENT,
    GAIN,
    LN_K,
    LOAD_GAIN,
    PRESSURE,
    SLIPS,
    SOIL,
    TANGENT,
)
from soil_env.identification.online.residuals import ground_of
from soil_env.terramechanics.effects.slip_sinkage import slip_sinkage_ratio

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
    """(ln z after a step, `Reaction` at x, slope of the condition by ln z, ratio q)."""
    u = memory.soil
    ground = ground_of(u, setting)
    z = math.exp(x)
    f = reaction(work.slope_nodes[0], ground, z, slip, load, setting.radius, setting.width)
    gain = setting.dig_gain * math.exp(u[GAIN])
    ratio = slip_sinkage_ratio(slip, gain, setting.dig_recovery)
    ln_S = u[PRESSURE] - u[EXPONENT] * math.log(setting.depth)
    slope = min(f.ln_s.sinkage * z, FLATTEST)
    step = -(f.ln_s.value + u[EXPONENT] * math.log(ratio) - ln_S) / slope
    if f.ln_s.value <= FLOORED:  # cohesion alone carries the load
        step = -FAR
    after = x + min(max(step, -FAR), FAR)
    low = math.log(SHALLOWEST * setting.radius)
    high = math.log(DEEPEST * setting.radius)
    return min(max(after, low), high), f, slope, ratio


@compiled
def _slopes(x, f, slope, ratio, memory, setting, work):
    """Slopes of the steady pull by the soil, S keeping the condition, into `work.step`."""
    u = memory.soil
    through = -f.pull.sinkage * math.exp(x) / slope
    deeper = math.log(ratio) + math.log(setting.depth)
    by = work.step
    by[TANGENT] = f.pull.tan_phi + through * f.ln_s.tan_phi
    by[COHESION] = f.pull.cohesion + through * f.ln_s.cohesion
    by[EXPONENT] = f.pull.exponent + through * (f.ln_s.exponent + deeper)
    by[LN_K] = f.pull.ln_K + through * f.ln_s.ln_K
    by[PRESSURE] = -through
    by[GAIN] = through * u[EXPONENT] * (1.0 - 1.0 / ratio)


@compiled
def renew_best_pull(memory, load, setting, work):
    """Renew the fresh best pull under a measured `load` [N]."""
    load *= 1.0 - memory.u[LOAD_GAIN]
    best = -math.inf
    variance = 1.0
    for k in range(SLIPS):
        x = memory.steady[k]
        if x == 0.0:
            x = math.log(setting.depth)
            for _ in range(FIRST_STEPS):
                x, _, _, _ = _newton(x, SLIP[k], load, memory, setting, work)
        after, f, slope, ratio = _newton(x, SLIP[k], load, memory, setting, work)
        memory.steady[k] = after
        pull = f.pull.value + f.pull.sinkage * math.exp(x) * (after - x)
        if f.torque.value > setting.stall_torque or pull <= best:
            continue
        best = pull
        _slopes(x, f, slope, ratio, memory, setting, work)
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
