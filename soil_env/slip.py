"""The slip of a wheel, (r w - V)/(r w) driving and (r w - V)/V braking, and what follows from its
definition.

r w is the speed of the rim, V the travel speed, both in m/s. Compiled functions take numbers; those
whose name is in the plural take arrays of numpy.
"""

import numpy as np

from soil_env._compiled.elementary import smoothed_sign
from soil_env._compiled.flags import compiled

#: [m/s] least speed that a slip is divided by, so that a wheel at rest has slip 0.
SLOWEST = 1e-3
#: [-] least V/(r w) from which the rim speed of a spinning wheel is known; also least r w/V from
#: which the travel speed of a braked one is.
LEAST_TRAVEL_RATIO = 0.02
LEAST_ROLLING = 1e-9  # [-] least r w / V of a braked wheel that anything is divided by


@compiled
def signed_slip(rim_speed, travel_speed, floor):
    """Slip (r w - V)/max(|r w|, |V|, floor), cut to [-1, 1], and its derivatives by the speed of
    the rim and of travel [s/m].

    Its sign is that of r w - V, forward and in reverse. The `floor` [m/s] of the denominator gives
    a wheel at rest the slip 0. At -1 and 1 (locked, spinning on the spot, rim against travel) the
    derivatives are 0.
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
    """Slip in [-1, 1]: (r w - V)/(r w) when driving, (r w - V)/V when braking.

    It is `signed_slip`, with its `floor`, and with the sign turned in reverse (r w + V < 0). So a
    wheel that drives has a positive slip in both directions.
    """
    slip = signed_slip(rim_speed, travel_speed, floor)[0]
    return -slip if rim_speed + travel_speed < 0.0 else slip


@compiled
def braked_share(rim_speed, travel_speed, floor):
    """Share |i| of its travel that a braked wheel slides: 0 when driving, 1 for a wheel that is
    locked or turns against its travel.

    It is -`signed_slip` times the sign of the travel, at least 0. That sign is smooth over `floor`
    [m/s], so that the share falls to 0 at rest.
    """
    slip = signed_slip(rim_speed, travel_speed, floor)[0]
    return max(-slip * smoothed_sign(travel_speed, floor)[0], 0.0)


@compiled
def motion_from_slip(slip):
    """(1, V/(r w)): speeds of rim and travel over that of the rim, of a wheel that travels forward
    at a slip in [-1, 1].

    Travel is 0 at the slip 1 (spinning on the spot), and 1/`LEAST_ROLLING` at -1 (locked).
    """
    if slip < 0.0:
        return 1.0, 1.0 / max(1.0 + slip, LEAST_ROLLING)
    return 1.0, 1.0 - slip


def travel_speeds(rim_speed: float | np.ndarray, slip: float | np.ndarray) -> np.ndarray:
    """Travel speeds V [m/s], [N], at rim speeds r w [m/s] and slips in [-1, 1]: `motion_from_slip`
    for arrays.
    """
    braked = 1.0 / np.maximum(1.0 + slip, LEAST_ROLLING)
    return rim_speed * np.where(slip < 0.0, braked, 1.0 - slip)


def rim_speeds(travel_speed: float | np.ndarray, slip: float | np.ndarray) -> np.ndarray:
    """Inverse of `travel_speeds`: r w [m/s], [N], at travel speeds V [m/s] and slips in [-1, 1];
    infinite at 1, at rest NaN there.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        driven = np.divide(travel_speed, 1.0 - slip)
    return np.where(slip < 0.0, travel_speed * (1.0 + slip), driven)


def slips(
    rim_speed: float | np.ndarray, speed: float | np.ndarray, slow: float = SLOWEST
) -> np.ndarray:
    """Slip [N] in [-1, 1] of rim and travel speeds [N] in m/s: (r w - V)/(r w) driving, (r w - V)/V
    braking.

    It is positive for a wheel that drives, in reverse too. It is divided by at least `slow` [m/s],
    so that a wheel at rest has slip 0. Unlike in `slip_ratio`, reverse begins at r w + V < -`slow`.
    """
    scale = np.maximum(np.maximum(np.abs(rim_speed), np.abs(speed)), slow)
    slip = (rim_speed - speed) / scale
    return np.clip(np.where(rim_speed + speed < -slow, -slip, slip), -1.0, 1.0)


@compiled
def sliding_speed(slip, travel_speed):
    """|r w - V| [m/s] of a wheel that travels at V >= 0 [m/s] with a slip in [-1, 1].

    It is V |slip| of a braked wheel and V slip/(1 - slip) of a driving one, whose divisor is at
    least `LEAST_TRAVEL_RATIO`. At V = 0 it is 0, also of a wheel that spins: the slip does not tell
    its rim speed.
    """
    return travel_speed * abs(slip) / min(max(1.0 - slip, LEAST_TRAVEL_RATIO), 1.0)


def sliding_speeds(slip: np.ndarray, travel_speed: np.ndarray) -> np.ndarray:
    """`sliding_speed` for arrays: |r w - V| [m/s], [N], at slips [N] and travel speeds [N] V >= 0
    [m/s].
    """
    return travel_speed * np.abs(slip) / np.clip(1.0 - slip, LEAST_TRAVEL_RATIO, 1.0)


@compiled
def slip_of_radius(slip, scale):
    """Slip in [-1, 1] of the same motion by another wheel radius r', where `scale` is r/r' > 0.

    It multiplies V/(r w). A driving wheel may become a braked one. A locked wheel (-1) stays
    locked.
    """
    if slip <= -1.0 or scale == 1.0:
        return slip
    ratio = scale * motion_from_slip(slip)[1]
    return 1.0 - ratio if ratio <= 1.0 else 1.0 / ratio - 1.0


def slips_of_radius(slip: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """`slip_of_radius` for arrays: slips [N] by the radius r', from `slip` [N] by the radius r and
    `scale` [N], which is r/r'.
    """
    ratio = scale * travel_speeds(1.0, slip)
    with np.errstate(divide="ignore"):  # 1/0 of the other branch
        scaled = np.where(ratio <= 1.0, 1.0 - ratio, 1.0 / ratio - 1.0)
    return np.where((slip <= -1.0) | (scale == 1.0), slip, scaled)
