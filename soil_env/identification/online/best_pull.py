"""Best steady drawbar pull of the ground under the wheel, of the load, with its standard deviation.

At each `SLIP` the steady sinkage z is the root of the condition ln s(z) + n ln q - ln S = 0. Here s
is the sinkage coefficient that the load mobilises, and q the ratio of slip-sinkage. One step of
Newton's method at each renewal follows the root. Friction, cohesion, K and stiffness err together,
so the pull is known better than any of them: its variance is by their whole covariance.

`memory`, `setting` and `work` are records `MEMORY`, `SETTING` and `WORK` of memory.py.
"""

import math

from soil_env._compiled.flags import compiled
from soil_env.terramechanics.effects.slip_sinkage import slip_sinkage_ratio
from soil_env.terramechanics.steady import DEEPEST

from .forces import BY_SINKAGE, LEAST_COEFFICIENT, LN_S, OF_GROUND, PULL, TORQUE, reaction
from .memory import BEST_PULL, EXPONENT, GAIN, LOAD_GAIN, PRESSURE, SLIP, SLIPS, SOIL
from .residuals import ground_of

# ln of a mobilised coefficient that counts as none: twice the floor of `forces.reaction`
FLOORED = math.log(2.0 * LEAST_COEFFICIENT)
# Steps of Newton's method from a first guess, own choice; one step follows a sinkage that is known.
FIRST_STEPS = 12
LARGEST_STEP = 0.7  # [-] of ln z in a step of Newton's method, own choice: a factor of 2
SHALLOWEST = 1e-5  # [radii] least steady sinkage, own choice: ln z stays finite
# [-] slope of the condition by ln z is cut to at most this, own choice: it falls with z, and a
# slope near 0 gives no step
FLATTEST = -0.1


@compiled
def _newton(x, slip, load, memory, setting, work):
    """One step of Newton's method for the steady sinkage z [m] at a `slip` under a `load` [N], from
    x = ln z. Return (ln z after it, slope of the condition by ln z at x, ratio q of slip-sinkage).

    The condition is ln s(z) + n ln q - ln S = 0; its slope is at most `FLATTEST`. Leaves the forces
    at x in `work.contact`. Where cohesion alone carries the load ln z falls by a whole
    `LARGEST_STEP`. z stays within `SHALLOWEST` and `DEEPEST`.
    """
    u = memory.soil
    n = u[EXPONENT]
    contact = work.contact[0]
    z = math.exp(x)
    reaction(contact, ground_of(u, setting), z, slip, load, setting.radius, setting.width)
    ln_s = contact.value[LN_S]
    gain = setting.dig_gain * math.exp(u[GAIN])
    ratio = slip_sinkage_ratio(slip, gain, setting.dig_recovery)
    # of the ground under the wheel: `PRESSURE` is ln of S depth^n, and the floor of a rut is denser
    ln_S = u[PRESSURE] + memory.compaction * (n + 0.5) - n * math.log(setting.depth)
    slope = min(contact.by[LN_S, BY_SINKAGE] * z, FLATTEST)
    step = -(ln_s + n * math.log(ratio) - ln_S) / slope
    if ln_s <= FLOORED:  # cohesion alone carries the load
        step = -LARGEST_STEP
    after = x + min(max(step, -LARGEST_STEP), LARGEST_STEP)
    low = math.log(SHALLOWEST * setting.radius)
    high = math.log(DEEPEST * setting.radius)
    return min(max(after, low), high), slope, ratio


@compiled
def _pull_slopes(deeper, slope, ratio, memory, setting, work):
    """Write the slopes of the steady pull [N] by the unknowns of the soil into `work.step`, from
    the forces in `work.contact`.

    The steady sinkage changes with the soil so that the condition still holds. `deeper` [N]: slope
    of the pull by ln z at a given soil; `slope`: that of the condition by ln z; `ratio`: q of
    slip-sinkage.
    """
    by = work.contact[0].by
    through = -deeper / slope  # [N] slope of the pull by the condition, through the sinkage
    for i in range(OF_GROUND):
        work.step[i] = by[PULL, i] + through * by[LN_S, i]
    of_exponent = math.log(ratio) + math.log(setting.depth) - memory.compaction
    work.step[EXPONENT] += through * of_exponent
    work.step[PRESSURE] = -through
    # the condition has n ln q, and q - 1 is in proportion to the gain
    work.step[GAIN] = through * memory.soil[EXPONENT] * (1.0 - 1.0 / ratio)


@compiled
def renew_best_pull(memory, load, setting, work):
    """Renew the best pull [of load] in `fresh` and its standard deviation in `fresh_sd`. In
    `steady`, renew the ln of the steady sinkages [m].

    The best pull is the largest at any `SLIP`, and at least -1 of load. Slips at which the torque
    exceeds the motor's, or the pull is not a number, are left out. Where no slip is left, or the
    result is not finite, it is -1 with a standard deviation of 1, and the sinkages start anew. The
    measured `load` [N] is corrected by the gain of its sensor.
    """
    load *= 1.0 - memory.u[LOAD_GAIN]
    contact = work.contact[0]
    best = -math.inf
    variance = 1.0
    for k in range(SLIPS):
        x = memory.steady[k]
        if x == 0.0:  # no sinkage is known yet: begin at the depth where pressures are compared
            x = math.log(setting.depth)
            for _ in range(FIRST_STEPS):
                x, _, _ = _newton(x, SLIP[k], load, memory, setting, work)
        after, slope, ratio = _newton(x, SLIP[k], load, memory, setting, work)
        memory.steady[k] = after if math.isfinite(after) else 0.0
        deeper = contact.by[PULL, BY_SINKAGE] * math.exp(x)
        # the forces are those before the last step: the pull is extended over it
        pull = contact.value[PULL] + deeper * (after - x)
        if contact.value[TORQUE] > setting.stall_torque or not pull > best:
            continue
        best = pull
        _pull_slopes(deeper, slope, ratio, memory, setting, work)
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
        memory.steady[:] = 0.0
