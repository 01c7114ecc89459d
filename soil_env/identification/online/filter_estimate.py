"""The estimate that a filter gives of the soil under the wheel."""

import math

from soil_env.identification.online.best_pull import best_pull
from soil_env.identification.online.border import share_here
from soil_env.identification.online.lanes.compiling import compiled_inline, compiled_part
from soil_env.identification.online.lanes.elementary import exp, log
from soil_env.identification.online.lanes.lanes import COUNT, from_array, scratch, total
from soil_env.identification.online.sinkage_filter import (
    GAIN,
    OLD_GAIN,
    OLD_PRESSURE,
    PRESSURE,
    cell,
    mean,
    weights,
)
from soil_env.identification.online.soil_nodes import GAUSSIAN, OLD, SOIL, below_diagonal

PUBLISHED = 5  # (phi, ln K, ln S, c, ln g)
PHI, LN_K, LN_S, COHESION, LN_GAIN = range(PUBLISHED)
_ground = scratch(GAUSSIAN)
_product = scratch(SOIL)
_change = scratch(SOIL + 2)
# Unknowns of a soil in the order of `soil_nodes`, which are (tan phi, c, n, ln K), and where they
# are published.
_TANGENT, _C, _N, _LN_K = range(SOIL)
_LEAST_VARIANCE = 1e-18
_LEAST_TANGENT = 0.01  # of the friction angle that is published
# Standard deviations as published are those of the filter times `SoilPrior.widths`. The best pull
# has its own factor, `OF_PULL`; laws that are contradicted err by `_AWAY` times as much at other
# slips. Pressure and gain (their ln) have an error of their own and one by the exponent, which the
# filter of the sinkage holds known. Where readings begin to contradict the soil so far, all grow by
# the misfit over `_DOUBTED`, at most `_MOST`, and by `_CONTRADICTED` where they contradict the
# laws.
OF_PULL = 0.83
_AWAY = 2.0
_DOUBTED = 6.0
_MOST = 12.0
_CONTRADICTED = 1.7
_OF_PRESSURE = (0.03, 0.65)
_OF_GAIN = (0.2, 1.5)


@compiled_part
def _of_forces(banks, k, share, by_place, prior, out):
    """Gaussian [GAUSSIAN] of the ground under the wheel by the forces: a blend of two soils on a
    border.

    Away from borders it is a blend with the `prior`, as far as the grade makes a next soil likely.
    """
    known = banks.known[k]
    if share >= 1.0:
        m = banks.point.next_share[k]
        q = banks.point.next_square[k]
        for i in range(GAUSSIAN):
            out[i] = known[i]
        if q <= 0.0:
            return
        for i in range(SOIL):
            off = prior[i] - known[i]
            out[i] += m * off
            for j in range(i + 1):
                n = SOIL + below_diagonal(i, j)
                out[n] = (
                    (1.0 - 2.0 * m + q) * known[n]
                    + q * prior[n]
                    + (q - m * m) * off * (prior[j] - known[j])
                )
        return
    w = share
    v = 1.0 - share
    for i in range(SOIL):
        out[i] = w * known[i] + v * known[OLD + i]
    spread = by_place * by_place * banks.point.border_variance[k]
    for i in range(SOIL):
        apart = known[i] - known[OLD + i]
        for j in range(i + 1):
            n = SOIL + below_diagonal(i, j)
            out[n] = (
                w * w * known[n]
                + v * v * known[OLD + n]
                + spread * apart * (known[j] - known[OLD + j])
            )


@compiled_inline
def _publish_forces(g, slopes, of_load, along, estimate, covariance):
    """Mean and covariance of (phi, ln K, c) from the Gaussian `g` by the forces; variance of ln(s
    z^n) by them.

    `along` [SOIL]: covariance of the unknowns with ln(s z^n), whose derivatives are `slopes`
    [SOIL]. `of_load`: relative variance of the load, which scales all strengths.
    """
    tangent = g[_TANGENT]
    c = SOIL
    rate = 1.0 / (1.0 + tangent * tangent)
    estimate[PHI] = math.atan(max(tangent, _LEAST_TANGENT))
    estimate[LN_K] = g[_LN_K]
    estimate[COHESION] = max(g[_C], 0.0)
    covariance[PHI, PHI] = rate * rate * (g[c] + of_load * tangent * tangent)
    covariance[COHESION, PHI] = rate * (g[c + 1] + of_load * tangent * g[_C])
    covariance[COHESION, COHESION] = g[c + 2] + of_load * g[_C] * g[_C]
    covariance[LN_K, PHI] = rate * g[c + 6]
    covariance[COHESION, LN_K] = g[c + 7]
    covariance[LN_K, LN_K] = g[c + 9]
    variance = 0.0
    for i in range(SOIL):
        along[i] = 0.0
        for j in range(SOIL):
            along[i] += g[c + below_diagonal(max(i, j), min(i, j))] * slopes[j]
        variance += along[i] * slopes[i]
    covariance[LN_S, PHI] = rate * (along[_TANGENT] + of_load * tangent)
    covariance[LN_S, LN_K] = along[_LN_K]
    covariance[COHESION, LN_S] = along[_C] + of_load * g[_C]
    return variance


@compiled_inline
def _with_next_soil(found, prior, m, q):
    """`_of_sinkage` of ground that is of a next soil by a share of mean m and mean square q."""
    y, gain, yy, yg, gg = found
    off = prior.sinkage[0] - y
    lag = prior.sinkage[1] - gain
    y = y + m * off
    gain = gain + m * lag
    left = 1.0 - 2.0 * m + q
    apart = q - m * m
    yy = left * yy + q * prior.sinkage_covariance[0] + apart * off * off
    yg = left * yg + q * prior.sinkage_covariance[1] + apart * off * lag
    gg = left * gg + q * prior.sinkage_covariance[3] + apart * lag * lag
    return y, gain, yy, yg, gg


@compiled_inline
def _widen(doubt, widths, covariance, sd):
    """Scale the lower triangle of the covariance by `doubt` and `widths` [5], mirror it, and fill
    `sd` [5].
    """
    for i in range(PUBLISHED):
        for j in range(i + 1):
            covariance[i, j] *= doubt * doubt * widths[i] * widths[j]
            covariance[j, i] = covariance[i, j]
        sd[i] = math.sqrt(max(covariance[i, i], _LEAST_VARIANCE))


@compiled_part
def publish(banks, k, numbers, estimate, sd, covariance, pull, anew):
    """Estimate of the ground under the wheel: mean [5], sd [5] and covariance [5, 5] of (phi, ln K,
    ln S, c, ln g).

    `pull` [2], best drawbar pull of the load and its sd, is computed `anew` or follows the share of
    the new soil. ln S is that at the exponent of the belief which bears the same pressure at the
    bearing sinkage.
    """
    p = banks.point
    g = _ground()
    along = _product()
    prior = numbers.prior
    share, by_place = share_here(banks, k, p.place[k], 0.0, numbers)
    _of_forces(banks, k, share, by_place, prior.forces, g)
    slopes = (p.ln_s_tangent[k], p.ln_s_cohesion[k], p.ln_s_exponent[k], p.ln_s_ln_K[k])
    of_load = p.mass_variance[k] / max(p.mass[k] * p.mass[k], 1e-300)
    variance = _publish_forces(g, slopes, of_load, along, estimate, covariance)
    found = _of_sinkage(banks.sinkage[k], share, by_place * by_place * p.border_variance[k])
    if share >= 1.0 and p.next_square[k] > 0.0:
        found = _with_next_soil(found, prior, p.next_share[k], p.next_square[k])
    y, gain, yy, yg, gg = found
    depth = p.bearing[k] if p.bearing[k] > 1e-6 else numbers.depth
    bearing = math.log(depth)
    of_exponent = g[SOIL + 5]
    pressure = y + g[_N] * (bearing - math.log(numbers.depth))
    estimate[LN_S] = pressure - numbers.exponent * bearing
    estimate[LN_GAIN] = gain
    covariance[LN_S, LN_S] = (
        yy + variance + of_load + _OF_PRESSURE[0] ** 2 + _OF_PRESSURE[1] ** 2 * of_exponent
    )
    covariance[LN_GAIN, LN_GAIN] = gg + _OF_GAIN[0] ** 2 + _OF_GAIN[1] ** 2 * of_exponent
    covariance[LN_GAIN, PHI] = 0.0
    covariance[LN_GAIN, LN_K] = 0.0
    covariance[LN_GAIN, COHESION] = 0.0
    covariance[LN_GAIN, LN_S] = yg
    doubt = (1.0 + min(p.misfit[k], _MOST) / _DOUBTED) * (
        _CONTRADICTED if p.flagged[k] > 0.0 else 1.0
    )
    _widen(doubt, prior.widths, covariance, sd)
    if anew:
        load = p.mass[k] * numbers.gravity
        across = _change()
        _across(banks, k, share, across)
        pull[0], of_pull, p.pull_by_share[k] = best_pull(
            banks.steady[k], g, slopes, pressure, gain, (yy, yg, gg), depth, load, across, numbers
        )
        away = _AWAY * p.form_error[k]
        pull[1] = OF_PULL * doubt * math.sqrt(max(of_pull + away * away, _LEAST_VARIANCE))
        p.pull_share[k] = share
    elif share < 1.0:
        pull[0] += p.pull_by_share[k] * (share - p.pull_share[k])
        p.pull_share[k] = share


@compiled_inline
def _across(banks, k, share, out):
    """`out` [6]: change of (tan phi, c, n, ln K, y, ln gain) from the old soil to the new one; 0
    away from borders.
    """
    known = banks.known[k]
    s = banks.sinkage[k]
    for i in range(SOIL):
        out[i] = known[i] - known[OLD + i]
    out[SOIL] = mean(s, PRESSURE) - mean(s, OLD_PRESSURE)
    out[SOIL + 1] = mean(s, GAIN) - mean(s, OLD_GAIN)
    if share >= 1.0:
        for i in range(SOIL + 2):
            out[i] = 0.0


@compiled_part
def _of_sinkage(s, share, place):
    """(mean of y, of ln gain; their variances and covariance: yy, yg, gg) of the ground."""
    w = share
    own = weights(s)
    y = from_array(s, PRESSURE * COUNT)
    gain = from_array(s, GAIN * COUNT)
    yy = from_array(s, cell(PRESSURE, PRESSURE))
    yg = from_array(s, cell(GAIN, PRESSURE))
    gg = from_array(s, cell(GAIN, GAIN))
    if share < 1.0:
        v = 1.0 - w
        old_y = from_array(s, OLD_PRESSURE * COUNT)
        old_gain = from_array(s, OLD_GAIN * COUNT)
        new = w * exp(gain)
        old = v * exp(old_gain)
        a = new / (new + old)
        b = old / (new + old)
        yg = (w * a) * yg + (v * b) * from_array(s, cell(OLD_GAIN, OLD_PRESSURE))
        yy = (w * w) * yy + (v * v) * from_array(s, cell(OLD_PRESSURE, OLD_PRESSURE))
        yy = yy + (2.0 * v * w) * from_array(s, cell(OLD_PRESSURE, PRESSURE))
        gg = a * a * gg + b * b * from_array(s, cell(OLD_GAIN, OLD_GAIN))
        gg = gg + 2.0 * a * b * from_array(s, cell(OLD_GAIN, GAIN))
        apart = y - old_y
        faster = gain - old_gain
        yy = yy + place * apart * apart
        yg = yg + place * apart * faster
        gg = gg + place * faster * faster
        y = w * y + v * old_y
        gain = log(new + old)
    mean_y = total(own * y)
    mean_gain = total(own * gain)
    away = y - mean_y
    off = gain - mean_gain
    yy = total(own * (yy + away * away))
    yg = total(own * (yg + away * off))
    gg = total(own * (gg + off * off))
    return mean_y, mean_gain, yy, yg, gg
