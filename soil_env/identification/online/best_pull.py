"""Best steady drawbar pull of the ground under the wheel, of the load, with its standard deviation.

At the slips `SLIPS`, a lane each, the steady sinkage z is the root of ln s(z) + n ln(ratio z_b) =
ln p_b. s(z) is the sinkage coefficient that the load mobilises, p_b the pressure that the soil
bears at the bearing sinkage z_b so far, ratio that of digging (`effects.digging_ratio`). A step of
Newton's method a point follows it. Friction, cohesion, K and stiffness err together, so the pull is
known better than any of them: its variance is by the whole covariance.
"""

import math

import numpy as np

from soil_env.identification.online.contact_slopes import GroundSoil, reaction
from soil_env.identification.online.lanes.compiling import compiled_inline, compiled_part
from soil_env.identification.online.lanes.contact import digging_ratio
from soil_env.identification.online.lanes.elementary import exp, larger, log, smaller
from soil_env.identification.online.lanes.lanes import COUNT, fill, from_array, scratch, to_array
from soil_env.identification.online.lanes.steady import best_points
from soil_env.identification.online.soil_nodes import SOIL, below_diagonal
from soil_env.parameters import Scenario, SoilState

#: Slips at which the drawbar pull is compared.
SLIPS = np.array([0.08, 0.15, 0.23, 0.33, 0.45, 0.6, 0.78, 0.97])
_FIRST_STEPS = 4
_FAR = 0.7  # largest step of ln z
_LEAST = 1e-3  # [radii] of the sinkage
_DEEPEST = 1.5
_rows = scratch(8 * COUNT)
_STEP = 0.03  # of finite differences, of the sd of the prior


@compiled_inline
def _newton(x, soil, y, gain, ln_bearing, load, numbers):
    """(ln z after a step, `Reaction` at x, slope of the condition by ln z, ln of ratio z_b, share
    of digging).
    """
    slip = from_array(numbers.slips, 0)
    r = numbers.radius
    z = exp(x)
    found = reaction(soil, z, slip, load, r, numbers.width)
    ratio = digging_ratio(slip, 1.0 - slip, gain, numbers.dig_recovery)
    deep = log(ratio) + ln_bearing
    slope = smaller(found.ln_s.by_sinkage * z, -0.1)
    step = (y - found.ln_s.value - soil.exponent * deep) / slope
    after = x + smaller(larger(step, -_FAR), _FAR)
    return (
        larger(smaller(after, math.log(_DEEPEST * r)), math.log(_LEAST * r)),
        found,
        slope,
        deep,
        1.0 - 1.0 / ratio,
    )


@compiled_part
def best_pull(steady, g, slopes, y, ln_gain, of_sinkage, bearing, load, along, numbers):
    """(best drawbar pull [of load], its variance, its derivative `along` [6]) of a soil.

    g: Gaussian of (tan phi, c, n, ln K).

    `steady` [COUNT]: ln of the steady sinkages, renewed; 0 before the first time. y: ln of the
    pressure that the soil bears at the sinkage `bearing` [m], `slopes` [4] its derivatives by
    these. `of_sinkage`: variances and covariance (yy, yg, gg) of what the sinkage adds to y and to
    the ln of the gain. `along`: a change of these six.
    """
    soil = GroundSoil(fill(g[0]), fill(g[1]), fill(g[2]), fill(g[3]))
    gain = numbers.dig_gain * math.exp(ln_gain)
    ln_bearing = math.log(bearing)
    rows = _rows()
    x = from_array(steady, 0)
    if steady[0] == 0.0:
        slip = from_array(numbers.slips, 0)
        x = ln_bearing + log(digging_ratio(slip, 1.0 - slip, gain, numbers.dig_recovery)) * (
            g[2] / (g[2] + 0.5)
        )
        for _ in range(_FIRST_STEPS):
            x = _newton(x, soil, y, gain, ln_bearing, load, numbers)[0]
    after, found, slope, deep, digs = _newton(x, soil, y, gain, ln_bearing, load, numbers)
    to_array(after, steady, 0)
    by_x = found.pull.by_sinkage * exp(x)
    moves = -1.0 * by_x / slope  # of the pull by the condition
    to_array(found.pull.value + by_x * (after - x), rows, 0)
    to_array(found.torque.value, rows, COUNT)
    to_array(found.pull.by_tangent + moves * (found.ln_s.by_tangent - slopes[0]), rows, 2 * COUNT)
    to_array(found.pull.by_cohesion + moves * (found.ln_s.by_cohesion - slopes[1]), rows, 3 * COUNT)
    to_array(
        found.pull.by_exponent + moves * (found.ln_s.by_exponent + deep - slopes[2]),
        rows,
        4 * COUNT,
    )
    to_array(found.pull.by_ln_K + moves * (found.ln_s.by_ln_K - slopes[3]), rows, 5 * COUNT)
    to_array(-1.0 * moves, rows, 6 * COUNT)
    to_array(moves * (g[2] * digs), rows, 7 * COUNT)
    best = -1
    for j in range(COUNT):
        if rows[COUNT + j] <= numbers.stall_torque and (best < 0 or rows[j] > rows[best]):
            best = j
    if best < 0:
        return -1.0, 1.0, 0.0
    variance = 0.0
    rate = 0.0
    k = 2 * COUNT + best
    for i in range(SOIL):
        rate += rows[k + i * COUNT] * along[i]
        for j in range(SOIL):
            variance += (
                rows[k + i * COUNT]
                * rows[k + j * COUNT]
                * g[SOIL + below_diagonal(max(i, j), min(i, j))]
            )
    by_y = rows[6 * COUNT + best]
    by_gain = rows[7 * COUNT + best]
    variance += (
        by_y * by_y * of_sinkage[0]
        + 2.0 * by_y * by_gain * of_sinkage[1]
        + by_gain * by_gain * of_sinkage[2]
    )
    rate += by_y * along[SOIL] + by_gain * along[SOIL + 1]
    if not math.isfinite(rows[best] + variance + rate):
        # readings that no soil explains: begun anew
        steady[0] = 0.0
        return -1.0, 1.0, 0.0
    return max(rows[best] / load, -1.0), variance / (load * load), rate / load


def prior_pull(
    mean: np.ndarray, covariance: np.ndarray, depth: float, scenario: Scenario
) -> tuple[float, float]:
    """(best drawbar pull of the weight, its variance) of a Gaussian [6] of the unknowns of
    `soil_prior`.
    """
    b = scenario.belief
    wheel = scenario.wheel
    points = np.tile(mean, (13, 1))
    steps = _STEP * np.sqrt(np.diag(covariance))
    points[1:7] += np.diag(steps)
    points[7:] -= np.diag(steps)
    tangent, c, n, ln_K, y, ln_gain = points.T
    soils = SoilState(
        tangent,
        np.maximum(c, 0.0),
        np.exp(ln_K),
        np.exp(y - n * math.log(depth)),
        n,
        b.dig_gain * np.exp(ln_gain),
        np.full(13, b.dig_recovery),
    )
    slip, pull = np.empty((2, 13))
    load = np.full(13, scenario.weight)
    best_points(
        np.arange(13),
        np.column_stack(soils),
        load,
        wheel.radius,
        wheel.width,
        wheel.stall_torque,
        slip,
        pull,
    )
    pull = np.maximum(pull / scenario.weight, -1.0)
    slopes = (pull[1:7] - pull[7:]) / (2.0 * steps)
    return float(pull[0]), float(slopes @ covariance @ slopes)
