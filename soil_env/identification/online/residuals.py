"""Residuals of a cell with their covariance and slopes: pull and torque at its slip and sinkage,
and the law of slip-sinkage from point to point.

Slip and sinkage have noise, which enters as effective variance (Orear 1982, Am. J. Phys.
50:912-916) at the most likely slip.

`cell`, `memory`, `setting` and `work` are records `CELL`, `MEMORY`, `SETTING` and `WORK` of
memory.py.
"""

import math
from typing import NamedTuple

from soil_env._compiled.elementary import smooth_step
from soil_env._compiled.flags import compiled

from .forces import BY_SINKAGE, BY_SLIP, LN_S, OF_GROUND, Ground, reaction
from .memory import (
    COHESION,
    EXPONENT,
    GAIN,
    HERE,
    LN_K,
    LOAD_GAIN,
    OLD,
    PLACE,
    PRESSURE,
    PULL,
    PULL_ZERO,
    RESIDUALS,
    SINKAGE,
    SINKAGE_ZERO,
    SOIL,
    SPEED_GAIN,
    TANGENT,
    TORQUE,
    TORQUE_GAIN,
    TORQUE_ZERO,
)
from .points import TYPICAL_PULL

# [of the product of both variances] least determinant of the covariance of pull and torque, own
# choice: slopes by one noisy slip make both err as one
SINGULAR = 1e-9
SHALLOWEST = 0.01  # [radii] least sinkage less its zero, own choice
MOST_SLIP = 0.96  # [-] slip at which forces are computed, at most, own choice
FARTHEST_SLIP = 0.08  # [-] that the most likely slip may be from its reading, own choice
LEAST_TANGENT = 0.05  # [-] of the friction angle, about 3 deg, own choice
# [-] bearing sinkage over the sinkage, at most, as in the world (docs/physics/wheel.md)
DEEPER = 10.0
# [of load] Form error of a cell on a border, where the blend of two soils is a model too; of load x
# radius in the torque. Own choice.
BORDER_ERROR = 2e-3
# [of z_b (1 - exp(-A))] Error of the law of sinkage, own choice; with 0.1 the errors of ln S grow
# by a tenth.
LAW_ERROR = 0.06
BORDER_LAW_ERROR = 0.3  # [of z_b (1 - exp(-A))] that of a cell on a border, own choice
# [standard deviations] of a residual of the law of sinkage beyond which its variance grows with its
# square, own choice. A residual that is cut there and keeps its weight makes the fit sure of a
# wrong S.
LINEAR_TO = 3.0


class Residuals(NamedTuple):
    """Residuals of a cell by rows, then their weights, the inverse of their covariance; pull and
    torque, which are correlated, have a joint weight too.
    """

    pull: float  # [of weight]
    torque: float  # [of weight x radius]
    sinkage: float  # [m]
    pull_weight: float
    joint_weight: float
    torque_weight: float
    sinkage_weight: float  # 0 where the cell shows no change of sinkage


# Distance in `Residuals` from a residual to its weight, of rows from `SINKAGE` on.
WEIGHT = RESIDUALS + 1


@compiled
def share_at(behind, length):
    """(share of the new soil, its slope [1/m] by the distance) at `behind` [m] past the middle of a
    border of this `length` [m].
    """
    share, slope = smooth_step(behind / length + 0.5)
    return share, slope / length


@compiled
def _blend(cell, memory, setting, work):
    """Write the soil under a cell into `work.soil`; return (share of the new soil, its slope [1/m]
    by the place of the border).

    On a border the share is the mean of those at both ends of the cell's places, one sd from their
    mean. Elsewhere it is 1.
    """
    u = memory.u
    for i in range(SOIL):
        work.soil[i] = u[i]
    if cell.place_error == 0.0:
        return 1.0, 0.0
    length = setting.border
    front, front_by = share_at(cell.place + cell.spread - u[PLACE], length)
    rear, rear_by = share_at(cell.place - cell.spread - u[PLACE], length)
    share = 0.5 * (front + rear)
    for j in range(SOIL):
        work.soil[j] = share * u[j] + (1.0 - share) * u[OLD + j]
    return share, -0.5 * (front_by + rear_by)


@compiled
def _over_border(row, share, by_place, memory, work):
    """Split the slopes of a residual by the blended soil, in `work.slopes`, into those by new soil,
    by old soil and by the place of the border; return the last.

    `row`: that of the residual in `work.slopes`; `share`: of the new soil in the blend; `by_place`
    [1/m]: slope of the share by the place.
    """
    u = memory.u
    slopes = work.slopes
    change = 0.0
    for j in range(SOIL):
        change += slopes[row, j] * (u[j] - u[OLD + j])
        slopes[row, OLD + j] = (1.0 - share) * slopes[row, j]
        slopes[row, j] *= share
    slope = by_place * change
    slopes[row, PLACE] = slope
    return slope


@compiled
def ground_of(unknowns, setting):
    """`Ground` of the unknowns of a soil and the constants of its shear law; tan phi is at least
    `LEAST_TANGENT`.
    """
    return Ground(
        max(unknowns[TANGENT], LEAST_TANGENT),
        unknowns[COHESION],
        unknowns[EXPONENT],
        unknowns[LN_K],
        setting.rim_flow,
        setting.braked_peak,
        setting.shear_growth,
        setting.shear_length,
    )


@compiled
def slip_slope(cell, slip):
    """Slope of a `slip` [-] of a cell by a relative error of the speeds (`SPEED_GAIN`): 1 - |slip|,
    times the share of slips that follow from the speeds.
    """
    return cell.by_speeds * (1.0 - abs(slip))


@compiled
def residuals(cell, memory, setting, work):
    """`Residuals` of a cell at the unknowns. Also write minus their slopes by the unknowns into
    `work.slopes`, and renew the most likely slip of the cell.

    Forces are computed at the most likely slip and extended to the measured one by their slopes.
    Residuals are the measured less the predicted values, with gains and zeros of the instruments.
    Their covariance has noise, form error, and what errors of slip, sinkage and place do to both.
    """
    u = memory.u
    J = work.slopes
    radius = setting.radius
    weight = setting.weight
    share, by_place = _blend(cell, memory, setting, work)
    soil = work.soil
    sinkage = max(cell.sinkage - u[SINKAGE_ZERO], SHALLOWEST * radius)
    load = cell.load * (1.0 - u[LOAD_GAIN])
    slip = min(cell.most_likely_slip, MOST_SLIP)
    contact = work.contact[0]
    reaction(contact, ground_of(soil, setting), sinkage, slip, load, radius, setting.width)
    by = contact.by
    to_pull = 1.0 / weight
    to_torque = (1.0 + u[TORQUE_GAIN]) / (weight * radius)
    pull = contact.value[PULL] * to_pull
    torque = contact.value[TORQUE] / (weight * radius)
    faster = slip_slope(cell, slip)
    off = cell.slip + u[SPEED_GAIN] * faster - slip  # from `slip` to the corrected measured one
    p_slip = by[PULL, BY_SLIP] * to_pull
    t_slip = by[TORQUE, BY_SLIP] * to_torque
    p_depth = by[PULL, BY_SINKAGE] * to_pull
    t_depth = by[TORQUE, BY_SINKAGE] * to_torque
    # residuals of pull and torque; `pull` and `torque` are those of the soil
    p = cell.pull - pull * (1.0 + cell.inertial * u[LOAD_GAIN]) - u[PULL_ZERO] - p_slip * off
    t = cell.torque - torque * (1.0 + u[TORQUE_GAIN]) - u[TORQUE_ZERO] - t_slip * off
    for j in range(OF_GROUND):
        J[PULL, j] = to_pull * by[PULL, j]
        J[TORQUE, j] = to_torque * by[TORQUE, j]
    # At a given sinkage pull and torque double where load and cohesion do. So their slope by ln of
    # the load is the value less cohesion times its slope by cohesion. A gain lowers the load.
    J[PULL, LOAD_GAIN] = (cell.inertial - 1.0) * pull + soil[COHESION] * J[PULL, COHESION]
    J[TORQUE, LOAD_GAIN] = soil[COHESION] * J[TORQUE, COHESION] - (1.0 + u[TORQUE_GAIN]) * torque
    J[PULL, PULL_ZERO] = 1.0
    J[TORQUE, TORQUE_GAIN] = torque
    J[TORQUE, TORQUE_ZERO] = 1.0
    J[PULL, SINKAGE_ZERO] = -p_depth
    J[TORQUE, SINKAGE_ZERO] = -t_depth
    J[PULL, SPEED_GAIN] = p_slip * faster
    J[TORQUE, SPEED_GAIN] = t_slip * faster

    form = memory.form_error**2
    p_place = 0.0
    t_place = 0.0
    if cell.place_error > 0.0:
        form += BORDER_ERROR**2
        p_place = _over_border(PULL, share, by_place, memory, work)
        t_place = _over_border(TORQUE, share, by_place, memory, work)
    # covariance of pull and torque: noise, form error, and what both owe to slip, sinkage and place
    pp = cell.pull_variance + form
    pt = 0.0
    tt = cell.torque_variance + form
    for p_by, t_by, variance in (
        (p_slip, t_slip, cell.slip_variance),
        (p_depth, t_depth, cell.sinkage_variance),
        (p_place, t_place, cell.place_error**2),
    ):
        pp += p_by * p_by * variance
        pt += p_by * t_by * variance
        tt += t_by * t_by * variance
    det = max(pp * tt - pt * pt, SINGULAR * pp * tt)
    pull_weight = tt / det
    joint_weight = -pt / det
    torque_weight = pp / det
    by_pull = p_slip * (pull_weight * p + joint_weight * t)
    by_torque = t_slip * (joint_weight * p + torque_weight * t)
    likely = slip + off + cell.slip_variance * (by_pull + by_torque)
    cell.most_likely_slip = min(max(likely, cell.slip - FARTHEST_SLIP), cell.slip + FARTHEST_SLIP)
    s, sinkage_weight = _sinkage_residual(cell, sinkage, share, by_place, memory, setting, work)
    return Residuals(p, t, s, pull_weight, joint_weight, torque_weight, sinkage_weight)


@compiled
def _sinkage_residual(cell, sinkage, share, by_place, memory, setting, work):
    """(residual [m] of the law of slip-sinkage, its weight [1/m2]); both 0 without a change of
    sinkage. `share` and `by_place`: of `_blend`.

    The law is z' - z = come (B z_b - A z) from point to point, with come = (1 - exp(-A))/A. A and B
    are integrals over the way, z_b is the bearing sinkage. `work.contact` has the forces at
    `sinkage` [m]; their S is extended to the middle of the way.
    """
    u = memory.u
    J = work.slopes
    if cell.changes == 0.0:
        J[SINKAGE, :] = 0.0
        return 0.0, 0.0
    soil = work.soil
    n = soil[EXPONENT]
    middle = max(cell.middle - u[SINKAGE_ZERO], SHALLOWEST * setting.radius)
    contact = work.contact[0]
    by = contact.by
    at_middle = contact.value[LN_S] + by[LN_S, BY_SINKAGE] * (middle - sinkage)
    # bearing sinkage z_b = z (s/S)^(1/n), s being the mobilised S; `PRESSURE` is ln of S depth^n
    stronger = at_middle - soil[PRESSURE] - cell.compaction * (n + 0.5)
    bearing = middle * min(setting.depth * math.exp(stronger / n), DEEPER)
    gain = setting.dig_gain * math.exp(soil[GAIN])
    a = cell.travel + setting.dig_recovery * cell.slide
    b = a + gain * cell.slide
    come = -math.expm1(-a) / a if a > 0.0 else 1.0
    residual = cell.rise - come * (b * bearing - a * (middle - 0.5 * cell.rise))
    less = come * b * bearing / n  # [m] fall of the predicted change by ln of the soil's S
    for j in range(OF_GROUND):
        J[SINKAGE, j] = less * by[LN_S, j]
    J[SINKAGE, EXPONENT] -= less * (stronger / n + cell.compaction)
    J[SINKAGE, PRESSURE] = -less
    J[SINKAGE, GAIN] = come * gain * cell.slide * bearing
    J[SINKAGE, LOAD_GAIN] = soil[COHESION] * J[SINKAGE, COHESION] - less
    J[SINKAGE, SINKAGE_ZERO] = come * (a - b * bearing / middle) - less * by[LN_S, BY_SINKAGE]
    law = LAW_ERROR
    place = 0.0
    if cell.place_error > 0.0:
        law = BORDER_LAW_ERROR
        place = _over_border(SINKAGE, share, by_place, memory, work) * cell.place_error
    # of both sinkages, as if both points had as many readings: that of the later one enters wholly,
    # that of the earlier one less
    variance = 0.5 * (1.0 + (1.0 - come * a) ** 2) * cell.rise_variance / cell.changes
    variance += (law * come * a * bearing) ** 2 + place * place
    return residual, 1.0 / max(variance, (residual / LINEAR_TO) ** 2)


# [of weight] standard deviation of the load where no sensor measures it, own choice
PAYLOAD = 0.05
# [units of `Instruments`] added to the standard deviation of each instrument, as another error of
# it, so that none is singular: own choice
EXACTLY = 1e-5


@compiled
def weigh_unknowns(memory, setting, work):
    """Write scales of all unknowns [ALL], in their units, into `work.sd`.

    Of the instruments they are prior standard deviations, which follow from zeros and gains of the
    sensors. Where two sensors measure one quantity, each counts by its mean share in the cells.
    Where no load was weighed, that of the load gain includes `PAYLOAD`. Those of the soils are of
    the setting, whatever prior the memory has. That of the place of a border is its length.
    """
    sd = work.sd
    sd[PLACE] = setting.border
    for i in range(SOIL):
        sd[i] = setting.soil_sd[i]
        sd[OLD + i] = setting.soil_sd[i]
    inertial = 0.0
    motor = 0.0
    readings = 0.0
    for k in range(memory.cells_kept):
        cell = memory.cells[k]
        readings += cell.readings
        inertial += cell.readings * cell.inertial
        motor += cell.readings * cell.motor
    inertial /= max(readings, 1.0)
    motor /= max(readings, 1.0)
    zero = setting.zero[0]
    gain = setting.gain[0]
    weight = setting.weight
    torque_unit = weight * setting.radius
    # [of weight] where nothing was weighed, the mass on the wheel is taken to be the body's
    payload = PAYLOAD if memory.weighings == 0.0 else 0.0
    of_force = math.hypot(zero.drawbar_pull / weight, TYPICAL_PULL * gain.drawbar_pull)
    of_mass = math.hypot(memory.mass * zero.acceleration / weight, TYPICAL_PULL * gain.acceleration)
    rest = 1.0 - motor
    sd[LOAD_GAIN] = math.hypot(gain.load, math.hypot(zero.load / weight, payload))
    sd[PULL_ZERO] = math.hypot((1.0 - inertial) * of_force, inertial * of_mass)
    sd[TORQUE_GAIN] = math.hypot(rest * gain.torque, motor * gain.motor_torque)
    sd[TORQUE_ZERO] = math.hypot(rest * zero.torque, motor * zero.motor_torque) / torque_unit
    sd[SINKAGE_ZERO] = zero.sinkage
    sd[SPEED_GAIN] = math.hypot(gain.speed, gain.rim_speed)
    for i in range(SOIL, HERE):
        sd[i] = math.hypot(sd[i], EXACTLY)
