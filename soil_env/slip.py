"""The slip of a wheel, (r w - V)/(r w) driving and (r w - V)/V braking, and what follows from its
definition.

r w is the speed of the rim, V the travel speed. Compiled functions take numbers, those in the
plural arrays of numpy.
"""

import numpy as np

from soil_env._compiled.elementary import smoothed_sign
from soil_env._compiled.flags import compiled

SLOWEST = 1e-3  # [m/s] speed that a slip is relative to, at least: at rest there is none
LEAST_TRAVEL_RATIO = 0.02  # [-] least V / (r w) from which the speed of a rim that spins is known
LEAST_ROLLING = 1e-9  # [-] least r w / V of a braked wheel that anything is divided by


@compiled
def signed_slip(rim_speed, travel_speed, floor):
    """(slip in [-1, 1], its derivatives by the two speeds [s/m]): (r w - V)/max(|r w|, |V|), of the
    sign of r w - V.

    `floor` [m/s] bounds the denominator from below, so that a wheel at rest has slip 0.
    """
    u = abs(rim_speed)
    v = abs(travel_speed)
    scale = max(u, v, floor)
    slip = (rim_speed - travel_speed) / scale
    if slip <= -1.0 or slip >= 1.0:
        return max(-1.0, min(1.0, slip)), 0.0, 0.0
    by_rim = 1.0
    by_travel = -1.0
    if max(u, v) >= floor:  # the faster one of the two is the denominator
        if v < u:
            by_rim -= slip if rim_speed >= 0.0 else -slip
        else:
            by_travel -= slip if travel_speed >= 0.0 else -slip
    return slip, by_rim / scale, by_travel / scale


@compiled
def slip_ratio(rim_speed, travel_speed, floor):
    """Slip in [-1, 1]: (r w - V)/(r w) when driving, (r w - V)/V when braking; mirrored in reverse
    (`signed_slip`).
    """
    slip = signed_slip(rim_speed, travel_speed, floor)[0]
    return -slip if rim_speed + travel_speed < 0.0 else slip


@compiled
def braked_share(rim_speed, travel_speed, floor):
    """Share |i| of its travel that a braked wheel slides, 0 driving; up to 1, of a wheel that is
    locked or turns against its travel.
    """
    slip = signed_slip(rim_speed, travel_speed, floor)[0]
    return max(-slip * smoothed_sign(travel_speed, floor)[0], 0.0)


@compiled
def motion_from_slip(slip):
    """(rim, travel) of a wheel travelling forward at the given slip in [-1, 1]; -1 is locked, 1
    spins on the spot.
    """
    if slip < 0.0:
        return 1.0, 1.0 / max(1.0 + slip, LEAST_ROLLING)
    return 1.0, 1.0 - slip


def travel_speeds(rim_speed: float | np.ndarray, slip: float | np.ndarray) -> np.ndarray:
    """`motion_from_slip` of arrays of numpy: V [m/s], [N], at rim speeds r w [m/s] and slips in
    [-1, 1].
    """
    braked = 1.0 / np.maximum(1.0 + slip, LEAST_ROLLING)
    return rim_speed * np.where(slip < 0.0, braked, 1.0 - slip)


def rim_speeds(travel_speed: float | np.ndarray, slip: float | np.ndarray) -> np.ndarray:
    """Inverse of `travel_speeds`: r w [m/s], [N], at travel speeds V [m/s] and slips in [-1, 1)."""
    return np.where(slip < 0.0, travel_speed * (1.0 + slip), travel_speed / (1.0 - slip))


def slips(rim_speed: np.ndarray, speed: np.ndarray, slow: float = SLOWEST) -> np.ndarray:
    """Slip [N] in [-1, 1] of rim and travel speeds [N] in m/s: (r w - V)/(r w) driving, (r w - V)/V
    braking, mirrored in reverse.

    Speeds below `slow` [m/s], as of a wheel at rest, count as forward and are relative to it.
    """
    scale = np.maximum(np.maximum(np.abs(rim_speed), np.abs(speed)), slow)
    slip = (rim_speed - speed) / scale
    return np.clip(np.where(rim_speed + speed < -slow, -slip, slip), -1.0, 1.0)


def sliding_speeds(travel_speed: np.ndarray, slip: np.ndarray) -> np.ndarray:
    """|r w - V| [m/s], [N], at travel speeds V [m/s] and slips in [-1, 1], as `sliding_speed`."""
    slide = travel_speed * np.abs(slip)
    return np.where(slip < 0.0, slide, slide / np.maximum(1.0 - slip, LEAST_TRAVEL_RATIO))


@compiled
def sliding_speed(slip, travel_speed):
    """|r w - V| [m/s] of a wheel that travels at V >= 0 with a slip, bounded near a slip of 1."""
    slide = travel_speed * abs(slip)
    return slide if slip < 0.0 else slide / max(1.0 - slip, LEAST_TRAVEL_RATIO)


@compiled
def slip_of_radius(slip, scale):
    """Slip after V/(r w) is multiplied by `scale`, as by another radius; driving or braking."""
    if slip <= -1.0 or scale == 1.0:
        return slip
    ratio = scale * motion_from_slip(slip)[1]
    return 1.0 - ratio if ratio <= 1.0 else 1.0 / ratio - 1.0


def slips_of_radius(slip: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """`slip_of_radius` of arrays [N]."""
    ratio = scale * travel_speeds(1.0, slip)
    with np.errstate(divide="ignore"):  # 1/0 of the other branch
        scaled = np.where(ratio <= 1.0, 1.0 - ratio, 1.0 / ratio - 1.0)
    return np.where((slip <= -1.0) | (scale == 1.0), slip, scaled)
