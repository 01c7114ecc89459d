"""The steady wheel on uniform soil: sinkage, drawbar pull and torque at a given slip and load."""

from __future__ import annotations

import math
from typing import NamedTuple

from soil_env.compiled import kernel
from soil_env.contact import Forces, arc_integrals, entry_angle, forces, mobilised_modulus, motion_from_slip
from soil_env.effects import slip_sinkage_ratio
from soil_env.parameters import SoilState

_SECANT = 1e-7  # step times last step [ln m]^2, the size of the error that the last step of the secant leaves
DEEPEST = 1.5  # [radii] sinkage beyond which a wheel counts as buried


class Steady(NamedTuple):
    """Steady state of a wheel at one slip and load."""

    sinkage: float  # [m]
    drawbar_pull: float  # [N]
    torque: float  # [N m]
    floating: bool  # False when the soil cannot carry the load before the wheel is buried; `sinkage` is then the bound


@kernel
def forces_at(sinkage, S, soil, rim, travel, direction, r, b):
    """`Forces` of a wheel at a given sinkage [m] with sinkage coefficient S, contact from entry to the lowest point."""
    theta1 = entry_angle(sinkage, r)
    q, _, _ = arc_integrals(theta1, 0.0, 0.5 * theta1, rim, travel, soil.shear_modulus, soil.sinkage_exponent, r)
    return forces(q, S, soil.tan_phi, soil.cohesion, r, b, direction)


@kernel
def steady_state(slip, load, soil, r, b, guess=0.0):
    """`Steady` sinkage, drawbar pull and torque: Eq. (1) solved for the sinkage, then Eqs. (2) and (3).

    Slip-sinkage deepens the hole by the ratio k(i) at the same bearing pressure S z_w^n = S (z/k)^n, that is, it acts
    as a sinkage coefficient S k^-n. With s(z) the coefficient that `load` mobilises at sinkage z (closed form, since
    (1) is linear in it), the root of ln s(z) - ln(S k^-n) is found by a bracketed secant in ln z, in which it is
    nearly straight, from `guess` [m] where one is given.
    """
    rim, travel = motion_from_slip(slip)
    n = soil.sinkage_exponent
    available = soil.sinkage_coefficient * slip_sinkage_ratio(slip, soil.dig_gain, soil.dig_recovery) ** -n
    low, high = math.log(1e-6 * r), math.log(DEEPEST * r)
    deepest = high
    # start from the guess, or from the depth of a flat plate, sqrt(2 r z) long
    x = (
        math.log(guess)
        if guess > 0.0
        else min(max(math.log(load / (b * math.sqrt(2.0 * r) * available)) / (n + 0.5), low), high)
    )
    slope = -(n + 0.5)
    x_old = f_old = 0.0
    w_old = Forces(0.0, 0.0, 0.0)
    for k in range(60):
        theta1 = entry_angle(math.exp(x), r)
        q, _, _ = arc_integrals(theta1, 0.0, 0.5 * theta1, rim, travel, soil.shear_modulus, n, r)
        s = mobilised_modulus(q, load, soil.tan_phi, soil.cohesion, r, b, 1.0)
        f = max(math.log(max(s, 1e-300) / available), -2.0)
        if q.p_cos + soil.tan_phi * q.pe_sin <= 1e-12 * q.p_cos and load / (r * b) > soil.cohesion * q.e_sin:
            f = 2.0  # friction takes more than the normal stress gives: no S carries the load here
        if f > 0.0:
            low = max(low, x)
        else:
            high = min(high, x)
        w = forces(q, available, soil.tan_phi, soil.cohesion, r, b, 1.0)
        moved = x - x_old
        if k > 0 and moved != 0.0:
            slope = min((f - f_old) / moved, -0.05)
        step = -f / slope
        if k > 0 and abs(step * moved) < _SECANT and low < x + step < high:
            share = step / moved  # along the secant that gave the step
            return Steady(
                math.exp(x + step),
                w.drawbar_pull + share * (w.drawbar_pull - w_old.drawbar_pull),
                w.torque + share * (w.torque - w_old.torque),
                True,
            )
        x_old, f_old, w_old = x, f, w
        if abs(step) < 1e-6 or low >= high:
            break
        x = x + step
        if x >= deepest and high == deepest:
            x = deepest
        elif not low < x < high:
            x = 0.5 * (low + high)
    return Steady(math.exp(x_old), w_old.drawbar_pull, w_old.torque, x_old < deepest)


def sinkage_coefficient_at(soil: SoilState, exponent: float, depth: float) -> float:
    """S' [N/m^(n'+2)] that bears the same pressure S' z^n' = S z^n as `soil` at `depth` z [m] with another exponent n'.

    S has a unit that depends on n, so two values compare only at the same exponent.
    """
    return soil.sinkage_coefficient * max(depth, 1e-4) ** (soil.sinkage_exponent - exponent)
