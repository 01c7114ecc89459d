"""The estimate that a bank of filters (`filter`) gives of the soil under the wheel."""

from __future__ import annotations

import math
from typing import NamedTuple

from soil_env._numba.compiling import inlined, part
from soil_env._numba.elementary import asin_root, exp, sqrt
from soil_env._numba.lanes import COUNT, from_array, scratch, to_array, total
from soil_env.identification.border import blend, covariance_of_ground
from soil_env.identification.filter_bank import COVARIANCES, MEANS, PUBLISHED, element, reference_of
from soil_env.identification.linearised import (
    COHESION,
    EXPONENT,
    GAIN,
    LN_DEPTH,
    LN_K,
    STRENGTH,
    Q,
    friction,
)

_ground, _published = scratch(MEANS), scratch(PUBLISHED * COUNT)
_of_ground = scratch(COVARIANCES)


@inlined
def publish(banks, k, numbers, estimate, sd, covariance):
    """Of the soil under the wheel: mean [5], standard deviations [5], covariance [5, 5] of (phi, ln K, ln S, c, ln g).

    ln S is that at the exponent of the belief which bears the same pressure at the bearing sinkage.
    """
    if banks.point.crossing[k] > 0.0:
        ground, of_ground = _ground(), _of_ground()
        b = blend(banks.mean[k], banks.point.place[k], 0.0, reference_of(banks, k), ground, numbers)
        covariance_of_ground(banks.covariance[k], banks.mean[k], b, of_ground)
        _publish(banks, k, ground, of_ground, numbers, estimate, sd, covariance)
    else:
        _publish(banks, k, banks.mean[k], banks.covariance[k], numbers, estimate, sd, covariance)


class _Slopes(NamedTuple):
    """Derivatives of the friction angle by the states; a value a lane."""

    by_strength: object
    by_ln_K: object
    by_cohesion: object


@inlined
def _with_state(P, i, state, angle, depth):
    """Covariance of published number i with a state."""
    if i == STRENGTH:
        return (
            angle.by_strength * from_array(P, element(STRENGTH, state))
            + angle.by_ln_K * from_array(P, element(LN_K, state))
            + angle.by_cohesion * from_array(P, element(COHESION, state))
        )
    v = from_array(P, element(GAIN if i == GAIN - 1 else i, state))
    return v + depth * from_array(P, element(EXPONENT, state)) if i == Q else v


@part
def _publish(banks, k, x, P, numbers, estimate, sd, covariance):
    """`publish` from the soil states x and their covariance P, eight filters each."""
    w = exp(from_array(banks.log_weight[k], 0))
    depth = from_array(banks.ln_bearing[k], 0) - LN_DEPTH
    rows_, n = _published(), from_array(x, EXPONENT * COUNT)
    for i in range(PUBLISHED):
        j = GAIN if i == GAIN - 1 else i
        to_array(from_array(x, j * COUNT), rows_, i * COUNT)
    tan = friction(
        from_array(x, STRENGTH * COUNT),
        from_array(x, LN_K * COUNT),
        from_array(x, COHESION * COUNT),
        reference_of(banks, k),
    )
    angle = 2.0 * asin_root(0.5 - 0.5 / sqrt(1.0 + tan.tangent * tan.tangent))
    to_array(angle, rows_, 0)
    to_array(from_array(x, Q * COUNT) + (n - numbers.exponent) * depth, rows_, Q * COUNT)
    for i in range(PUBLISHED):
        estimate[i] = total(w * from_array(rows_, i * COUNT))
    rate = 1.0 / (1.0 + tan.tangent * tan.tangent)
    of_angle = _Slopes(rate * tan.by_strength, rate * tan.by_ln_K, rate * tan.by_cohesion)
    for i in range(PUBLISHED):
        away = from_array(rows_, i * COUNT) - estimate[i]
        for j in range(i + 1):
            if j == STRENGTH:
                v = of_angle.by_strength * _with_state(P, i, STRENGTH, of_angle, depth)
                v = v + of_angle.by_ln_K * _with_state(P, i, LN_K, of_angle, depth)
                v = v + of_angle.by_cohesion * _with_state(P, i, COHESION, of_angle, depth)
            else:
                v = _with_state(P, i, GAIN if j == GAIN - 1 else j, of_angle, depth)
                if j == Q:
                    v = v + depth * _with_state(P, i, EXPONENT, of_angle, depth)
            covariance[i, j] = covariance[j, i] = total(w * (v + away * (from_array(rows_, j * COUNT) - estimate[j])))
        sd[i] = math.sqrt(max(covariance[i, i], 1e-18))
    estimate[COHESION] = max(estimate[COHESION], 0.0)
