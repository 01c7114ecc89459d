"""Steady state of a wheel on level, fresh soil by the base model, and the slip of its best drawbar
pull.
"""

import math
from typing import NamedTuple

import numpy as np

from soil_env.identification.online.lanes.compiling import (
    compiled_inline,
    compiled_part,
    compiled_root,
)
from soil_env.identification.online.lanes.contact import (
    Forces,
    bearing_share,
    digging_ratio,
    forces,
    integrals_alone,
    mobilised_sinkage_coefficient,
    motion_from_slip,
    smooth_arc,
)
from soil_env.identification.online.lanes.elementary import where_less
from soil_env.parameters import SoilState

# [ln m]^2 product of the last two steps at which the secant ends: the size of its error
_SECANT = 1e-7
DEEPEST = 1.5  # [radii] sinkage beyond which a wheel counts as buried
#: Slips at which the drawbar pull is compared.
SLIPS = np.array([0.05, 0.1, 0.15, 0.2, 0.26, 0.33, 0.41, 0.5, 0.6, 0.72, 0.85, 0.97])
_MIDDLE = 4


class Steady(NamedTuple):
    """Steady state of a wheel at one slip and load."""

    sinkage: float  # [m]
    drawbar_pull: float  # [N]
    torque: float  # [N m]
    # False when the soil cannot carry the load before the wheel is buried; `sinkage` is then the
    # bound
    supported: bool


class _Balance(NamedTuple):
    """Constants of Eq. (1) at one point."""

    rim: float
    travel: float
    load: float  # [N]
    soil: SoilState
    strength: float  # ln of S over the pressure ratio of the digging
    r: float  # [m] radius of the wheel
    b: float  # [m] its width


@compiled_part
def slip_sinkage_ratio(slip, gain, recovery):
    """Steady sinkage over the sinkage of the same load on undisturbed soil: 1 + gain |i| / (1 - |i|
    + recovery |i|).

    For a braked wheel the digging is driven by the share |i| of its travel that it slides.
    """
    return digging_ratio(abs(slip), where_less(slip, 0.0, 1.0, 1.0 - slip), gain, recovery)


@compiled_inline
def _balance(slip, load, soil, r, b):
    rim, travel = motion_from_slip(slip)
    ratio = max(slip_sinkage_ratio(slip, soil.dig_gain, soil.dig_recovery), 1e-3)
    strength = math.log(soil.sinkage_coefficient) - soil.sinkage_exponent * math.log(ratio)
    return _Balance(rim, travel, load, soil, strength, r, b)


@compiled_inline
def _misfit(x, p):
    """(ln of the mobilised over the available sinkage coefficient at the sinkage e^x [m], `Forces`
    there).
    """
    soil = p.soil
    c = soil.cohesion
    arc = smooth_arc(math.exp(x), p.r)
    q = integrals_alone(arc, p.rim, p.travel, soil.shear_modulus, soil.sinkage_exponent)
    s = mobilised_sinkage_coefficient(q, p.load, soil.tan_phi, c, p.r, p.b)
    f = min(max(math.log(max(s, 1e-300)) - p.strength, -2.0), 50.0)
    if bearing_share(q, soil.tan_phi) <= 1e-12 * q.p_cos and p.load / (p.r * p.b) > c * q.e_sin:
        f = 2.0  # friction takes more than the normal stress gives: no S carries the load here
    return f, forces(q, math.exp(p.strength), soil.tan_phi, c, p.r, p.b)


@compiled_inline
def _first_guess(p, guess):
    """ln of the sinkage [m] to start from: of `guess` where there is one, else of a flat plate,
    sqrt(2 r z) long.
    """
    if guess > 0.0:
        return math.log(guess)
    pressure = math.log(p.load / (p.b * math.sqrt(2.0 * p.r))) - p.strength
    x = pressure / (p.soil.sinkage_exponent + 0.5)
    return math.log(math.exp(min(x, math.log(DEEPEST * p.r))))


@compiled_part
def _solve_balance(p, guess):
    """(ln of the sinkage, `Forces` there, whether the soil carries the load): bracketed secant on
    `_misfit`.
    """
    deepest = math.log(DEEPEST * p.r)
    low = math.log(1e-6 * p.r)
    high = deepest
    x = min(max(_first_guess(p, guess), low), high)
    slope = -(p.soil.sinkage_exponent + 0.5)
    x_old = 0.0
    f_old = 0.0
    w_old = Forces(0.0, 0.0, 0.0)
    supported = False
    for k in range(60):
        f, w = _misfit(x, p)
        if f > 0.0:
            low = max(low, x)
        else:
            high = min(high, x)
        moved = x - x_old
        if k > 0 and moved != 0.0:
            slope = min((f - f_old) / moved, -0.05)
        step = -f / slope
        if k > 0 and abs(step * moved) < _SECANT and low < x + step < high:
            share = step / moved  # along the secant that gave the step
            return x + step, _along(w_old, w, share), True
        x_old = x
        f_old = f
        w_old = w
        supported = x < deepest
        if abs(step) < 1e-6 or low >= high:
            break
        x = x + step
        if x >= deepest and high == deepest:
            x = deepest
        elif not low < x < high:
            x = 0.5 * (low + high)
    return x_old, w_old, supported


@compiled_inline
def _along(before, now, share):
    """`Forces` extrapolated beyond `now` by a share of the last change; the load stays."""
    pull = now.drawbar_pull + share * (now.drawbar_pull - before.drawbar_pull)
    return Forces(now.load, pull, now.torque + share * (now.torque - before.torque))


@compiled_part
def steady_state(slip, load, soil, r, b, guess):
    """`Steady` sinkage, drawbar pull and torque at a slip and a load [N], with the digging of
    `soil`.

    Eq. (1) is solved for the sinkage, then Eqs. (2) and (3) follow. Digging deepens the hole at the
    same bearing pressure: s z^n = S z_w^n with z = k(i) z_w. The root of the difference of the
    logarithms is found by a bracketed secant in ln z, in which it is nearly straight, from `guess`
    [m] where one is given.
    """
    x, w, supported = _solve_balance(_balance(slip, load, soil, r, b), guess)
    return Steady(min(math.exp(x), DEEPEST * r), w.drawbar_pull, w.torque, supported)


class Best(NamedTuple):
    """The working point of the highest steady drawbar pull within the motor's torque."""

    slip: float  # [-]
    drawbar_pull: float  # [N]; -inf if the motor can turn the wheel at no slip
    torque: float  # [N m]
    sinkage: float  # [m]


@compiled_part
def best_working_point(load, soil, r, b, torque_available):
    """`Best` of `steady_state` over the slips of `SLIPS`: up from the middle of them, then down
    from there.

    The curve has one maximum, so each scan stops once it has clearly passed it, or where more slip
    takes more torque than there is.
    """
    best = Best(SLIPS[0], -np.inf, 0.0, 0.0)
    n = soil.sinkage_exponent
    gain = soil.dig_gain
    recovery = soil.dig_recovery
    power = n / (n + 0.5)
    middle = 0.0
    for direction in (1, -1):
        i = _MIDDLE if direction > 0 else _MIDDLE - 1
        guess = middle
        last = SLIPS[_MIDDLE]
        while 0 <= i < SLIPS.size:
            slip = SLIPS[i]
            if guess > 0.0:
                # at the same load the ratio of sinkages is the ratio of slip-sinkage, to a power
                deeper = slip_sinkage_ratio(slip, gain, recovery)
                deeper /= slip_sinkage_ratio(last, gain, recovery)
                guess *= deeper**power
            s = steady_state(slip, load, soil, r, b, min(guess, DEEPEST * r))
            guess = s.sinkage if s.supported else 0.0
            last = slip
            if i == _MIDDLE:
                middle = guess
            if s.torque <= torque_available and s.supported:
                if s.drawbar_pull > best.drawbar_pull:
                    best = Best(slip, s.drawbar_pull, s.torque, s.sinkage)
                elif s.drawbar_pull < best.drawbar_pull - 0.03 * load:
                    break
            elif direction > 0:
                break
            i += direction
    return best


@compiled_root(nogil=True)
def best_points(rows, soils, load, r, b, torque, slip, pull):
    """Write slip [-] and drawbar pull [N] of the best working point of the wheels `rows` into
    `slip` and `pull` [n].

    `soils` [n, 7] are rows of `SoilState`, `load` [n] in N; r, b [m] and the motor's torque [N m]
    are of all wheels.
    """
    for k in rows:
        s = soils[k]
        best = best_working_point(
            load[k], SoilState(s[0], s[1], s[2], s[3], s[4], s[5], s[6]), r, b, torque
        )
        slip[k] = best.slip
        pull[k] = best.drawbar_pull
