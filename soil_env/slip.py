"""The slip of a wheel, (r w - V)/(r w) driving and (r w - V)/V braking, and what follows from its definition.

r w is the speed of the rim, V the travel speed. Compiled functions take floats or lanes (`_numba.lanes`), those in the
plural arrays of numpy.
"""

import numpy as np

from soil_env._numba.compiling import compiled_inline, compiled_part, compiled_root
from soil_env._numba.elementary import larger, smaller, where_less
from soil_env._numba.lanes import alike


@compiled_inline
def signed_slip(rim_speed, travel_speed, floor):
    """(slip in [-1, 1], its derivatives by the two speeds [s/m]): (r w - V)/max(|r w|, |V|), of the sign of r w - V.

    `floor` [m/s] bounds the denominator from below, so that a wheel at rest has slip 0.
    """
    u = abs(rim_speed)
    v = abs(travel_speed)
    scale = larger(larger(u, v), floor)
    slip = larger(-1.0, smaller(1.0, (rim_speed - travel_speed) / scale))
    rolling = where_less(v, u, 1.0, 0.0)  # the rim is the faster one
    moving = where_less(larger(u, v), floor, 0.0, 1.0)
    sign_u = where_less(rim_speed, 0.0, -1.0, 1.0)
    sign_v = where_less(travel_speed, 0.0, -1.0, 1.0)
    inside = where_less(abs(slip), 1.0, 1.0, 0.0)
    return (
        slip,
        inside * (1.0 - moving * rolling * slip * sign_u) / scale,
        inside * (-1.0 - moving * (1.0 - rolling) * slip * sign_v) / scale,
    )


@compiled_inline
def slip_ratio(rim_speed, travel_speed, floor):
    """Slip in [-1, 1]: (r w - V)/(r w) when driving, (r w - V)/V when braking; mirrored in reverse (`signed_slip`)."""
    slip, _, _ = signed_slip(rim_speed, travel_speed, floor)
    return where_less(rim_speed + travel_speed, 0.0, -slip, slip)


@compiled_inline
def motion_from_slip(slip):
    """(rim, travel) of a wheel travelling forward at the given slip in [-1, 1]; -1 is locked, 1 spins on the spot."""
    braking = larger(1.0 + slip, 1e-9)  # r w / V
    return alike(1.0, slip), where_less(slip, 0.0, 1.0 / braking, 1.0 - slip)


@compiled_inline
def travel_rate(travel):
    """Derivative of `travel` of `motion_from_slip` by the slip: -1 driving, -travel^2 braking."""
    braking = larger(travel, 1.0)
    return -1.0 * braking * braking


def travel_speeds(rim_speed: float | np.ndarray, slip: float | np.ndarray) -> np.ndarray:
    """`motion_from_slip` of arrays of numpy: V [m/s], [N], at rim speeds r w [m/s] and slips in [-1, 1]."""
    return rim_speed * np.where(slip < 0.0, 1.0 / np.maximum(1.0 + slip, 1e-9), 1.0 - slip)


def rim_speeds(travel_speed: float | np.ndarray, slip: float | np.ndarray) -> np.ndarray:
    """Inverse of `travel_speeds`: r w [m/s], [N], at travel speeds V [m/s] and slips in [-1, 1)."""
    return np.where(slip < 0.0, travel_speed * (1.0 + slip), travel_speed / (1.0 - slip))


@compiled_part
def slip_of_radius(slip, scale):
    """Slip after V/(r w) is multiplied by `scale`, as by another radius; driving or braking."""
    if slip <= -1.0 or scale == 1.0:
        return slip
    ratio = scale * motion_from_slip(slip)[1]
    return 1.0 - ratio if ratio <= 1.0 else 1.0 / ratio - 1.0


@compiled_root
def _slips_of_radius(slip: np.ndarray, scale: np.ndarray, out: np.ndarray) -> None:
    for i in range(out.size):
        out[i] = slip_of_radius(slip[i], scale[i])


def slips_of_radius(slip: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """`slip_of_radius` of arrays [N]."""
    out = np.empty(len(slip))
    _slips_of_radius(slip, scale, out)
    return out
