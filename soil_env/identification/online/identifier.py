"""Online identification of the soil under a driven wheel, reading by reading
(docs/physics/estimation.md, whose steps are the files of this folder).
"""

import math
import threading

import numpy as np

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import compiled
from soil_env.identification.online.best_pull import renew_best_pull
from soil_env.identification.online.borders import (
    blend_estimates,
    blend_pull,
    end_border,
    feel_border,
    put_on_border,
    see_border,
)
from soil_env.identification.online.cells import remember
from soil_env.identification.online.fit import CONTRADICTS, renew, weigh_instruments
from soil_env.identification.online.forces import reaction
from soil_env.identification.online.library import lean, mix, write_information
from soil_env.identification.online.linear import invert, solve_half
from soil_env.identification.online.memory import (
    ALL,
    COHESION,
    EXPONENT,
    GAIN,
    HERE,
    INSTRUMENTS,
    LN_K,
    LOAD_GAIN,
    MEMORY,
    PRESSURE,
    PUBLISHED,
    PULL,
    SINKAGE_ZERO,
    SLIPS,
    SOIL,
    TANGENT,
    TORQUE,
    WORK,
)
from soil_env.identification.online.points import (
    FIRST_POINTS,
    FIRST_READINGS,
    READINGS,
    advance,
    clear,
    close,
    collect,
    ends_point,
    is_sound,
    is_steady,
    record_rest,
    slip_error,
    weigh,
)
from soil_env.identification.online.residuals import ground_of, residuals
from soil_env.identification.status import Status

#: Outcomes of a set of readings: the estimate is as before; the wheel moved on a border, and so to
#: other ground; a point was completed.
HELD, MOVED, RENEWED = range(3)
# Readings of a point on a border, where the ground changes from one to the next.
READINGS_ON_BORDER = 5.0
# Chi-squared (two degrees of freedom) of the forces of a point: its excess over `EXPECTED` is
# summed, never below 0; a sum above `ANOTHER_SOIL` is another soil. A point above `OUTLIER` is
# left out until then.
EXPECTED = 3.0
ANOTHER_SOIL = 8.0
OUTLIER = 3.5
LONG = 5  # points of a soil, up to which it is the laws that readings contradict
SETTLED_POINTS = 3  # of a soil, before which no point is an outlier
DOUBT = 1.3  # factor of the standard deviations while a point is an outlier
DOUBLED = 4.0  # factor of the form error's variance in that test
BEYOND = 4e-6  # [of load, squared] further error of the laws in that test
OFTEN = 3  # points of a soil after which the best pull is renewed with every third one
CONTRADICTION = 2.5  # chi-squared over its expectation, above which readings contradict the laws
MISFIT = (
    4.0  # [of the belief's model error] form error of the laws above which they contradict them
)
PULL_WIDER = 1.15  # of the best pull, beyond `WIDER`, whose errors have longer tails
WIDER = 1.1  # of standard deviations: what a linearised fit under a Gaussian prior leaves out
LEARNT = 0.6  # [of the prior's] standard deviation of phi and ln K at which both count as known
LEAST_SINKAGE = 1e-3  # [radii] for the bearing sinkage that S is published at
DEEPEST = 2.0  # [radii] of that
DEEPER = 10.0  # of that over the sinkage, at most


@compiled
def begin_pull(memory, setting, work):
    """Set the best pull of a soil of which nothing is known to that of the prior."""
    for k in range(SLIPS):
        memory.steady[k] = 0.0
    load = memory.mass * setting.gravity if memory.mass > 0.0 else setting.weight
    renew_best_pull(memory, load, setting, work)


@compiled
def forget(memory, setting, work):
    """Set the memory of a wheel back to the prior."""
    memory.mass = 0.0
    memory.weighings = 0.0
    memory.place = 0.0
    memory.travel = 0.0
    memory.slide = 0.0
    memory.turning = 0.0
    memory.point_sinkage = 0.0
    memory.last_rim = 0.0
    memory.excess = 0.0
    memory.crossing = 0.0
    memory.form_error = setting.model_error
    memory.misfit = 1.0
    memory.law_misfit = 1.0
    memory.widening = 1.0
    memory.rest_pull = 0.0
    memory.rests = 0.0
    memory.standing = 0.0
    memory.refused = 0.0
    memory.points = 0
    memory.borders = 0
    memory.status = Status.NO_DATA.value
    memory.settled = 0
    memory.cells_kept = 0
    memory.behind = 0
    clear(memory.open[0])
    for i in range(HERE):
        memory.u[i] = 0.0
    for i in range(SOIL):
        memory.u[i] = setting.soil_mean[i]
        memory.prior_mean[i] = setting.soil_mean[i]
        memory.soil[i] = setting.soil_mean[i]
        memory.gradient[i] = 0.0
        for j in range(SOIL):
            memory.covariance[i, j] = setting.soil_covariance[i, j]
            memory.prior_precision[i, j] = setting.soil_precision[i, j]
            memory.spread[i, j] = setting.soil_covariance[i, j]
            memory.information[i, j] = 0.0
    for i in range(PUBLISHED):
        memory.estimate[i] = setting.prior[i]
        memory.sd[i] = setting.prior_sd[i]
    begin_pull(memory, setting, work)
    for i in range(2):
        memory.best_pull[i] = memory.fresh_pull[i]


@compiled
def _surprise(memory, setting, work):
    """Chi-squared of the forces of the newest cell under the soil so far."""
    cell = memory.cells[memory.cells_kept]
    e = residuals(cell, memory, setting, work)
    J = work.slopes
    det = e.pull_weight * e.torque_weight - e.joint_weight**2
    error = (DOUBLED - 1.0) * memory.form_error**2 + BEYOND
    pp = e.torque_weight / det + error
    pt = -e.joint_weight / det
    tt = e.pull_weight / det + error
    size = ALL if memory.behind > 0 else HERE
    of_pull = work.gradient
    of_torque = work.step
    for j in range(HERE, size):
        J[PULL, j] = 0.0
        J[TORQUE, j] = 0.0
    solve_half(memory.factor, size, J[PULL], of_pull)
    solve_half(memory.factor, size, J[TORQUE], of_torque)
    for i in range(size):
        pp += of_pull[i] * of_pull[i]
        pt += of_pull[i] * of_torque[i]
        tt += of_torque[i] * of_torque[i]
    square = tt * e.pull**2 - 2.0 * pt * e.pull * e.torque + pp * e.torque**2
    return square / (pp * tt - pt * pt)


@compiled
def _find_bearing(memory, reading, setting, work):
    """Renew the bearing sinkage under the wheel, and the best pull there."""
    u = memory.soil
    r = setting.radius
    load = memory.mass * setting.gravity * math.cos(reading.pitch)
    ground = ground_of(u, setting)
    z = max(reading.sinkage - memory.u[SINKAGE_ZERO], LEAST_SINKAGE * r)
    slip = min(max(reading.slip, -0.4), 0.9)
    corrected = load * (1.0 - memory.u[LOAD_GAIN])
    f = reaction(work.slope_nodes[0], ground, z, slip, corrected, r, setting.width)
    deeper = setting.depth * math.exp((f.ln_s.value - u[PRESSURE]) / u[EXPONENT])
    bearing = min(max(z * min(deeper, DEEPER), LEAST_SINKAGE * r), DEEPEST * r)
    memory.ln_bearing = math.log(bearing)
    often = memory.points < OFTEN or memory.crossing > 0.0
    if often or memory.points % OFTEN == 0:
        renew_best_pull(memory, load, setting, work)
        memory.fresh_pull[1] *= PULL_WIDER * widening(memory, setting)


@compiled
def widening(memory, setting):
    """Factor of the standard deviations for what the linearised fit leaves out, and for a form
    error beyond the believed one.
    """
    return WIDER * math.sqrt(memory.form_error / setting.model_error)


@compiled
def publish(u, V, into, memory, setting):
    """Write `fresh` and its standard deviations by `u` and `covariance` of a record: S is that at
    the bearing sinkage, for the exponent of the belief.
    """
    below = memory.ln_bearing - math.log(setting.depth)
    out = into.fresh
    sd = into.fresh_sd
    out[0] = math.atan(u[TANGENT])
    out[1] = u[LN_K]
    out[2] = u[PRESSURE] + u[EXPONENT] * below - setting.exponent * memory.ln_bearing
    out[3] = u[COHESION]
    out[4] = u[GAIN]
    sd[0] = math.sqrt(V[TANGENT, TANGENT]) / (1.0 + u[TANGENT] ** 2)
    sd[1] = math.sqrt(V[LN_K, LN_K])
    variance = V[PRESSURE, PRESSURE] + below * below * V[EXPONENT, EXPONENT]
    sd[2] = math.sqrt(max(variance + 2.0 * below * V[PRESSURE, EXPONENT], 0.0))
    sd[3] = math.sqrt(V[COHESION, COHESION])
    sd[4] = math.sqrt(V[GAIN, GAIN])
    wider = widening(memory, setting)
    for i in range(PUBLISHED):
        sd[i] = min(sd[i] * wider, setting.prior_sd[i]) * memory.widening


@compiled
def _judge(memory, setting):
    """Status of the estimate."""
    learnt = max(memory.sd[0] / setting.prior_sd[0], memory.sd[1] / setting.prior_sd[1])
    contradicted = max(memory.misfit, memory.law_misfit) > CONTRADICTION
    if memory.form_error > MISFIT * setting.model_error or contradicted:
        memory.status = Status.MISFIT.value
    elif learnt <= LEARNT:
        memory.status = Status.CONVERGED.value
    else:
        memory.status = Status.NOT_EXCITED.value


@compiled
def _complete(memory, reading, alone, setting, work):
    """Close the open point and renew what is known by it."""
    cell = memory.cells[memory.cells_kept]
    close(memory.open[0], memory, cell, setting)
    if setting.border > 0.0:
        put_on_border(memory, cell, setting)
    memory.points += 1
    contradicted = memory.form_error > MISFIT * setting.model_error
    contradicted = contradicted or max(memory.misfit, memory.law_misfit) > CONTRADICTION
    alone = alone and memory.crossing == 0.0
    late = memory.settled > 0 and memory.points > LONG and memory.cells_kept > 1
    if alone and contradicted and late:
        feel_border(memory, setting, work)  # a border has been missed
        begin_pull(memory, setting, work)
        return
    if alone and not contradicted and memory.points >= SETTLED_POINTS:
        surprise = _surprise(memory, setting, work)
        memory.excess = max(memory.excess + surprise - EXPECTED, 0.0)
        if memory.excess > ANOTHER_SOIL:
            feel_border(memory, setting, work)
            begin_pull(memory, setting, work)
            return
        if surprise > OUTLIER:  # the next ones decide
            for i in range(PUBLISHED):
                memory.sd[i] *= DOUBT / memory.widening
            memory.widening = DOUBT
            return
        memory.widening = 1.0
    remember(memory)
    renew(memory, setting, work)
    write_information(memory, work)
    mix(memory, memory.u, setting, work)
    if setting.library > 1:
        lean(memory, setting, work)
    _find_bearing(memory, reading, setting, work)
    publish(memory.soil, memory.spread, memory, memory, setting)
    if memory.points >= SETTLED_POINTS and memory.misfit < CONTRADICTS:
        memory.settled = 1
    if memory.crossing == 0.0:
        for i in range(2):
            memory.best_pull[i] = memory.fresh_pull[i]
        for i in range(PUBLISHED):
            memory.estimate[i] = memory.fresh[i]
            memory.sd[i] = memory.fresh_sd[i]
    _judge(memory, setting)


@compiled
def _is_finite(memory):
    """True if all that is published is a number."""
    total = abs(memory.best_pull[0]) + memory.best_pull[1] + memory.form_error
    for i in range(PUBLISHED):
        total += abs(memory.estimate[i]) + memory.sd[i] + abs(memory.fresh[i]) + memory.fresh_sd[i]
    for i in range(ALL):
        total += abs(memory.u[i])
    return math.isfinite(total)


@compiled
def observe(memory, reading, alone, setting, work):
    """Take one set of readings: `HELD`, `MOVED` or `RENEWED`.

    `alone`: look for borders by it.
    """
    alone = alone and setting.border > 0.0
    if setting.off > 0:
        return HELD
    if not is_sound(reading, setting):
        memory.refused += 1.0
        return HELD
    turned = abs(reading.rim_speed - memory.last_rim)
    memory.last_rim = reading.rim_speed
    advance(memory, reading, turned, setting)
    weigh(memory, reading, setting)
    record_rest(memory, reading, setting)
    point = memory.open[0]
    error = slip_error(reading, setting)
    steady = is_steady(reading, error, turned, setting)
    most = READINGS
    if memory.crossing > 0.0:
        most = READINGS_ON_BORDER
    elif memory.points < FIRST_POINTS:
        most = FIRST_READINGS
    outcome = HELD
    if point.readings > 0.0 and (not steady or ends_point(point, reading, error, most, setting)):
        _complete(memory, reading, alone, setting, work)
        outcome = RENEWED
        if not _is_finite(memory):  # readings that no soil explains
            forget(memory, setting, work)
            return RENEWED
    if steady:
        collect(point, memory, reading, error, turned, setting)
    if memory.crossing > 0.0:
        blend_estimates(memory, memory, setting)
        blend_pull(memory, setting)
        outcome = max(outcome, MOVED)
        if memory.place > memory.border + 0.5 * setting.border:
            end_border(memory)
    return outcome


@compiled
def observe_image(memory, image, camera_sd, setting, work):
    """Take an `Image`: where another class of ground begins, so does another soil.

    `camera_sd` [m]: of the place of a border in it.
    """
    if setting.off == 0 and see_border(memory, image, camera_sd, setting, work):
        clear(memory.open[0])
        begin_pull(memory, setting, work)


@kept
def start(memory, setting, work):
    """Set all of `memory` [wheels] back to the prior."""
    for k in range(len(memory)):
        forget(memory[k], setting[0], work[0])


@kept
def observe_all(memory, readings, setting, work, out):
    """Take `readings` [T] `READING` one after another into `memory` [1]; their outcomes into `out`
    [T] int64.
    """
    for t in range(len(readings)):
        out[t] = observe(memory[0], readings[t], True, setting[0], work[0])


@kept
def instruments(memory, setting, work, out):
    """Write means and standard deviations of the instruments of `memory` [1] into `out` [2, 6]."""
    one = memory[0]
    scratch = work[0]
    weigh_instruments(one, setting[0], scratch)
    if one.points > 0:
        invert(one.factor, HERE, scratch.scratch, scratch.inverse)
    for i in range(INSTRUMENTS):
        variance = scratch.instruments[i]
        if one.points > 0:
            variance = scratch.inverse[LOAD_GAIN + i, LOAD_GAIN + i]
        out[0, i] = one.u[LOAD_GAIN + i]
        out[1, i] = math.sqrt(variance)


def new_memory(wheels: int) -> np.ndarray:
    """Memory of so many wheels, to be started."""
    return np.zeros(wheels, MEMORY)


def new_work() -> np.ndarray:
    """Work space of a thread."""
    return np.zeros(1, WORK)


class WorkSpaces:
    """Work space of each thread that asks for it, made once."""

    def __init__(self) -> None:
        self._of: dict[int, np.ndarray] = {}

    def mine(self) -> np.ndarray:
        """Work space of the present thread, `WORK` [1]."""
        thread = threading.get_ident()
        if thread not in self._of:
            self._of[thread] = new_work()
        return self._of[thread]


def prior_pull(setting: np.ndarray) -> tuple[float, float]:
    """Best steady drawbar pull of the prior [of load] and its standard deviation."""
    memory = new_memory(1)
    start(memory, setting, new_work())
    pull, sd = memory["best_pull"][0]
    return float(pull), float(sd)
