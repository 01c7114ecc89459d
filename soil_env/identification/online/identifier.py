"""Online identification of the soil under a driven wheel, reading by reading
(docs/physics/estimation.md, whose steps are files of this folder).

`memory`, `setting`, `work` and `reading` are records `MEMORY`, `SETTING`, `WORK` and `READING` of
memory.py.
"""

import math

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import compiled, inlined
from soil_env.identification.status import Status

from .best_pull import renew_best_pull
from .borders import begin_soil, blend_estimates, feel_border, put_on_border, take_fresh
from .cells import remember
from .fit import CONTRADICTS, renew
from .forces import LN_S, reaction
from .library import lean, mix, write_information
from .linear import invert, solve_half
from .memory import (
    ALL,
    BEST_PULL,
    COHESION,
    EXPONENT,
    GAIN,
    HERE,
    LN_K,
    LOAD_GAIN,
    PRESSURE,
    PUBLISHED,
    PUBLISHED_COHESION,
    PUBLISHED_GAIN,
    PUBLISHED_LN_K,
    PUBLISHED_LN_S,
    PUBLISHED_PHI,
    PULL,
    SINKAGE_ZERO,
    SOIL,
    TANGENT,
    TORQUE,
)
from .points import (
    FEW_READINGS,
    FIRST_POINTS,
    READINGS,
    advance,
    close,
    collect,
    ends_point,
    is_sound,
    is_steady,
    record_rest,
    slip_error,
    weigh,
)
from .residuals import DEEPER, ground_of, residuals, weigh_unknowns

#: Outcomes of a set of readings: the estimate is as before; the wheel moved on a border, and so to
#: other ground; a point was completed.
HELD, MOVED, RENEWED = range(3)
# Test for another soil by chi-squared (two degrees of freedom) of the forces of each new point,
# under the soil so far (CUSUM, docs/physics/estimation.md): own choices. With the change of sinkage
# beside them a border to a soil that only bears otherwise is found sooner, but readings whose
# sinkage follows the slip at once begin borders too.
ALLOWED = 3.0  # [-] taken off chi-squared before it is summed; the sum is never below 0
ANOTHER_SOIL = 10.0  # [-] sum above which a border is assumed here
OUTLIER = 6.0  # [-] chi-squared above which a point is left out, until the sum decides
SETTLED_POINTS = 3  # of a soil, before which no point is tested
DOUBT = 1.3  # factor of the standard deviations while the last point is an outlier
DOUBLED = 2.0**2  # factor of the form error's square in that test: twice the error
FURTHER_ERROR = 4e-6  # [of load, squared] further variance of the laws in that test: 0.002 of load
# Points of a soil up to which readings that contradict the laws show no missed border, own choice:
# so soon after a border it is the laws that they contradict.
FEW_POINTS = 5
# Points of a soil up to which the best pull is renewed with each, then with every third; own
# choice, since it takes the forces at each `SLIP`.
OFTEN = 3
# Status, own choices (docs/physics/estimation.md):
# [of its expectation] chi-squared of forces or sinkage above which readings contradict the laws
CONTRADICTION = 2.5
# [of the belief's model error] form error above which readings contradict the laws
LARGE_FORM_ERROR = 4.0
LEARNT = 0.6  # [of the prior's] standard deviation of phi and ln K at which both count as known
# Widening of standard deviations, own choices:
WIDER = 1.1  # factor for what a linearised fit under a Gaussian prior leaves out
PULL_WIDER = 1.15  # further factor of the best pull, whose errors have longer tails
# [of the compaction of a rut] its standard deviation: a of z_1 N^(1/a) is 2 to 3
# (`effects.multipass`).
RUT_ERROR = 0.12
LEAST_SINKAGE = 1e-3  # [radii] least sinkage and bearing sinkage that S is published at, own choice
DEEPEST = 2.0  # [radii] largest bearing sinkage that S is published at, own choice


@compiled
def _surprise(memory, setting, work):
    """Chi-squared of pull and torque of the newest cell under the soil so far [-], two degrees of
    freedom.

    Their covariance is that of the residuals, with a larger error of the laws, and that of the
    unknowns of the last fit. After a border its place and the old soil count as without influence
    on the cell.
    """
    e = residuals(memory.cells[memory.cells_kept], memory, setting, work)
    J = work.slopes
    det = e.pull_weight * e.torque_weight - e.joint_weight**2
    # less 1, since the covariance of the residuals has the form error once
    error = (DOUBLED - 1.0) * memory.form_error**2 + FURTHER_ERROR
    # the weights are the inverse of a covariance, which is inverted here
    pp = e.torque_weight / det + error
    pt = -e.joint_weight / det
    tt = e.pull_weight / det + error
    size = ALL if memory.behind > 0 else HERE
    of_pull = work.gradient
    of_torque = work.step
    J[:, HERE:size] = 0.0
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
    """Renew `ln_bearing`, of the bearing sinkage under the wheel: the depth at which undisturbed
    ground, or the floor of a rut, carries its present pressure.

    With every point at first and on borders, then with every third (`OFTEN`), also renew the best
    pull, and widen its standard deviation.
    """
    u = memory.soil
    r = setting.radius
    load = memory.mass * setting.gravity * math.cos(reading.pitch)
    # that of the point; where none was measured, what stands for it
    sinkage = memory.point_sinkage if memory.point_sinkage > 0.0 else reading.sinkage
    z = max(sinkage - memory.u[SINKAGE_ZERO], LEAST_SINKAGE * r)
    slip = memory.point_slip
    corrected = load * (1.0 - memory.u[LOAD_GAIN])
    contact = work.contact[0]
    reaction(contact, ground_of(u, setting), z, slip, corrected, r, setting.width)
    n = u[EXPONENT]
    # deeper: bearing sinkage over z, (s/S)^(1/n); `PRESSURE` is ln of S depth^n
    stronger = contact.value[LN_S] - u[PRESSURE] - memory.compaction * (n + 0.5)
    deeper = setting.depth * math.exp(stronger / n)
    bearing = min(max(z * min(deeper, DEEPER), LEAST_SINKAGE * r), DEEPEST * r)
    memory.ln_bearing = math.log(bearing)
    often = memory.points < OFTEN or memory.crossing > 0.0
    if often or memory.points % OFTEN == 0:
        renew_best_pull(memory, load, setting, work)
        memory.fresh_sd[BEST_PULL] *= PULL_WIDER * widening(memory, setting)


@compiled
def widening(memory, setting):
    """Factor of the standard deviations: `WIDER` for what the linearised fit leaves out, times the
    root of the form error over the believed one.

    Errors of laws do not average out as noise does. The field `memory.widening` is another factor,
    after an outlier.
    """
    return WIDER * math.sqrt(memory.form_error / setting.model_error)


@compiled
def publish(u, V, into, memory, setting):
    """Write `fresh` and `fresh_sd` of the record `into`, but for the best pull, by the unknowns u
    [SOIL] of a soil and their covariance V [SOIL, SOIL].

    S gives, with the exponent of the belief, the same pressure at the bearing sinkage. Standard
    deviations are at most those of the prior, then widened after an outlier.
    """
    below = memory.ln_bearing - math.log(setting.depth)
    out = into.fresh
    sd = into.fresh_sd
    out[PUBLISHED_PHI] = math.atan(u[TANGENT])
    sd[PUBLISHED_PHI] = math.sqrt(V[TANGENT, TANGENT]) / (1.0 + u[TANGENT] ** 2)
    for i, j in (
        (PUBLISHED_LN_K, LN_K),
        (PUBLISHED_LN_S, PRESSURE),
        (PUBLISHED_COHESION, COHESION),
        (PUBLISHED_GAIN, GAIN),
    ):
        out[i] = u[j]
        sd[i] = math.sqrt(V[j, j])
    out[PUBLISHED_LN_S] += u[EXPONENT] * below - setting.exponent * memory.ln_bearing
    variance = V[PRESSURE, PRESSURE] + below * below * V[EXPONENT, EXPONENT]
    at_depth = math.sqrt(max(variance + 2.0 * below * V[PRESSURE, EXPONENT], 0.0))
    # The load gives the pressure at the bearing sinkage z_b, so z_b is what is not known there. The
    # sd of ln z_b is `at_depth` over n; that of ln S is as much times the exponent of the belief.
    of_soil = setting.exponent / u[EXPONENT] * at_depth
    of_rut = RUT_ERROR * memory.compaction * (u[EXPONENT] + 0.5)
    sd[PUBLISHED_LN_S] = math.hypot(of_soil, of_rut)
    wider = widening(memory, setting)
    for i in range(PUBLISHED):
        sd[i] = min(sd[i] * wider, setting.prior_sd[i]) * memory.widening


@compiled
def status_of(known, contradicted, setting):
    """Number of the `Status` of a published estimate: MISFIT if readings have `contradicted` the
    laws, else CONVERGED if phi and ln K are both `LEARNT`, else NOT_EXCITED.

    `known`: a record with the published `sd` of `ESTIMATES`.
    """
    if contradicted:
        return Status.MISFIT.value
    of_phi = known.sd[PUBLISHED_PHI] / setting.prior_sd[PUBLISHED_PHI]
    of_modulus = known.sd[PUBLISHED_LN_K] / setting.prior_sd[PUBLISHED_LN_K]
    learnt = max(of_phi, of_modulus) <= LEARNT
    return Status.CONVERGED.value if learnt else Status.NOT_EXCITED.value


@compiled
def _contradicted(memory, setting):
    """True if the readings contradict the laws: by a misfit of the last fit or by the form error
    that it took.
    """
    misfit = max(memory.misfit, memory.law_misfit)
    return misfit > CONTRADICTION or memory.form_error > LARGE_FORM_ERROR * setting.model_error


@inlined
def _complete(memory, reading, alone, setting, work):
    """Close the open point and take it into account, in one of three ways.

    Where the sum of excesses shows another soil, or a soil that had fitted contradicts the laws, a
    border begins here and the point is dropped. That is asked only off borders, of a wheel that is
    `alone` as in `observe`. An outlier is left out, and the published standard deviations grow by
    `DOUBT`. To any other point the soil is fitted, and published.

    An excess is chi-squared of a point (`_surprise`) less `ALLOWED`. Their sum, never below 0,
    shows another soil above `ANOTHER_SOIL`. An outlier has chi-squared above `OUTLIER`.
    """
    cell = memory.cells[memory.cells_kept]
    close(memory, cell, setting)
    if setting.border > 0.0:
        put_on_border(memory, cell, setting)
    memory.points += 1
    alone = alone and setting.border > 0.0 and memory.crossing == 0.0
    contradicted = _contradicted(memory, setting)
    surprise = 0.0
    if alone and not contradicted and memory.points >= SETTLED_POINTS:
        surprise = _surprise(memory, setting, work)
        if surprise > OUTLIER:  # fitted to the end before a point is doubted
            renew(memory, setting, work)
            surprise = _surprise(memory, setting, work)
        memory.excess = max(memory.excess + surprise - ALLOWED, 0.0)
    # a settled soil that contradicts the laws: a border that the sum of excesses has not shown
    late = memory.settled > 0 and memory.points > FEW_POINTS and memory.cells_kept > 1
    if alone and (contradicted and late or memory.excess > ANOTHER_SOIL):
        feel_border(memory, setting, work)
        return
    if surprise > OUTLIER:  # the next ones decide
        for i in range(PUBLISHED):
            # once in a row only: after another outlier `widening` is `DOUBT` already
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
        take_fresh(memory)


@compiled
def _is_finite(memory):
    """True if form error, unknowns and the fresh estimate with its standard deviations are finite;
    what is published follows from that and from the old one.
    """
    known = memory.fresh.sum() + memory.fresh_sd.sum()
    return math.isfinite(memory.form_error + known + memory.u.sum())


@compiled
def observe(memories, k, reading, alone, setting, work):
    """Take one set of readings into `memories` [k]; its outcome `HELD`, `MOVED` or `RENEWED`.

    `alone`: forces may show a border; False of a wheel that another one tells of borders. Readings
    that no wheel gives are counted and left out. On a border the blend of old and new soil is
    published, from its end on the new soil. Where the estimate is not finite, the memory is set to
    the prior.
    """
    memory = memories[k]
    if setting.off > 0:
        return HELD
    if not is_sound(reading, setting):
        memory.refused += 1.0
        return HELD
    turned = abs(reading.rim_speed - memory.last_rim)
    advance(memory, reading, turned, setting)
    weigh(memory, reading, setting)
    record_rest(memory, reading, setting)
    point = memory.open[0]
    error = slip_error(reading.rim_speed, reading.speed, setting)
    steady = is_steady(reading, turned, setting)
    few = memory.crossing > 0.0 or memory.points < FIRST_POINTS
    wanted = FEW_READINGS if few else READINGS
    outcome = HELD
    if point.readings > 0.0 and (not steady or ends_point(point, reading, error, wanted, setting)):
        _complete(memory, reading, alone, setting, work)
        outcome = RENEWED
        if not _is_finite(memory):  # readings that no soil explains
            memories[k] = setting.blank[0]
            return RENEWED
    if steady:
        collect(point, memory, reading, error, turned, setting)
    if memory.crossing > 0.0:
        blend_estimates(memory, memory, setting)
        outcome = max(outcome, MOVED)
        if memory.place > memory.border + 0.5 * setting.border:
            memory.crossing = 0.0
            # what it grew on the border is of the blend of two soils, not of the laws
            largest = max(memory.old_form_error, LARGE_FORM_ERROR * setting.model_error)
            memory.form_error = min(memory.form_error, largest)
            take_fresh(memory)
    # a wheel without a point that another one has told of a border knows no more than before
    if outcome == RENEWED or (outcome == MOVED and memory.status != Status.NO_DATA.value):
        memory.status = status_of(memory, _contradicted(memory, setting), setting)
    return outcome


@kept
def start(memory, setting, work):
    """Set a `memory` [1] of zeros to the prior: the blank memory of a `SETTING` [1]."""
    begin_soil(memory[0], setting[0], work[0])
    take_fresh(memory[0])


@kept
def observe_all(memory, readings, setting, work, out):
    """Take `readings` [T] `READING` one after another into `memory` [1]; their outcomes into `out`
    [T] int64.
    """
    for t in range(len(readings)):
        out[t] = observe(memory, 0, readings[t], True, setting[0], work[0])


@kept
def instruments(memory, setting, work, out):
    """Write means and standard deviations of the instruments of `memory` [1] into `out` [2, 6], in
    the order of `Instruments`; before the first point those of the prior.
    """
    one = memory[0]
    scratch = work[0]
    weigh_unknowns(one, setting[0], scratch)
    if one.points > 0:
        invert(one.factor, HERE, scratch.scratch, scratch.inverse)
    for i in range(SOIL, HERE):
        out[0, i - SOIL] = one.u[i]
        out[1, i - SOIL] = math.sqrt(scratch.inverse[i, i]) if one.points > 0 else scratch.sd[i]
