"""Steady state of a wheel on uniform soil: sinkage, drawbar pull and torque at a given slip and load, with effects."""

import math
from typing import NamedTuple

from soil_env._numba.compiling import compiled_inline, compiled_part
from soil_env._numba.elementary import asin_root
from soil_env.parameters import SoilState
from soil_env.slip import motion_from_slip
from soil_env.terramechanics import contact
from soil_env.terramechanics.arc_integrals import integrals_alone
from soil_env.terramechanics.contact import (
    Arc,
    Forces,
    ShearLaw,
    bearing_share,
    entry_angle,
    forces,
)
from soil_env.terramechanics.effects import (
    NO_EFFECTS,
    arc_ends,
    drive_torque,
    soil_in_contact,
    soil_resistance,
)
from soil_env.terramechanics.effects.grade import weight_on_slope
from soil_env.terramechanics.effects.grousers import (
    at_shear_radius,
    blade_force,
    contact_radius,
    shear_radius_ratio,
)
from soil_env.terramechanics.effects.shear_rate import sliding_speed
from soil_env.terramechanics.effects.shear_softening import shear_law, shear_length_ratio
from soil_env.terramechanics.effects.slip_bias import true_slip
from soil_env.terramechanics.effects.slip_sinkage import excavated_depth, slip_sinkage_ratio

_SECANT = (
    1e-7  # [ln m]^2 product of the last two steps at which the secant ends: the size of its error
)
DEEPEST = 1.5  # [radii] sinkage beyond which a wheel counts as buried


class Steady(NamedTuple):
    """Steady state of a wheel at one slip and load."""

    sinkage: float  # [m]
    drawbar_pull: float  # [N]
    torque: float  # [N m]
    supported: bool  # False when the soil cannot carry the load before the wheel is buried; `sinkage` is then the bound


class Rim(NamedTuple):
    """The wheel as it meets the soil."""

    radius: float  # [m]
    width: float  # [m]
    grouser_height: float  # [m]


class Conditions(NamedTuple):
    """Conditions of a steady point besides slip and load."""

    speed: float  # [m/s] travel
    passes: float  # 1 = fresh soil
    sin_grade: float  # uphill positive


LEVEL = Conditions(0.0, 1.0, 0.0)


@compiled_inline
def arc_of(sinkage, slip, fx, wheel):
    """`Arc` of a wheel at a given sinkage [m] and slip, with the effects that shape it.

    The tips of the lugs enter the soil, and begin to shear it, at cos = cos(theta1)/q (Ding et al. 2011).
    """
    r = contact_radius(fx, wheel)
    theta1 = entry_angle(sinkage, r)
    theta2, thetam = arc_ends(theta1, slip, fx)
    q = shear_radius_ratio(r, wheel.grouser_height, fx)
    if q == 1.0:
        return Arc(theta1, theta2, thetam, theta1, r)
    rise = 0.5 * (1.0 - 1.0 / q) + (0.5 / (r * q)) * sinkage  # (1 - cos)/2 of the tips' entry
    return Arc(theta1, theta2, thetam, 2.0 * asin_root(rise), r)


@compiled_inline
def sheared(rim, soil, fx, wheel):
    """(rim, K) as the soil between the lug tips sees them: `rim` of motion and shear deformation modulus [m].

    Shear at the radius q R stretches j, thrust and torque: K/q here, q tan(phi) and q c where forces are summed. Where
    slip was taken at the rim of radius r, the tips move faster: rim q R/r instead.
    """
    r = contact_radius(fx, wheel)
    q = shear_radius_ratio(r, wheel.grouser_height, fx)
    K = soil.shear_modulus * shear_length_ratio(fx)
    if fx.grousers_slip_at_rim > 0.0:
        wider = r / wheel.radius
        return rim * wider * q, K * wider
    return rim, K / q


@compiled_part
def steady_state(slip, load, soil, r, b):
    """`steady_with` of the base model on level, fresh soil, with the digging of `soil`."""
    return steady_with(slip, load, soil, Rim(r, b, 0.0), LEVEL, 0.0, NO_EFFECTS, 0.0)


class _Balance(NamedTuple):
    """Constants of Eq. (1) at one point."""

    slip: float
    rim: float  # of motion, as the sheared soil sees it
    travel: float
    load: float  # [N] normal to the ground
    soil: SoilState  # as it is sheared
    strength: float  # ln of S over the pressure ratio of the digging
    lift: float  # [m] depth excavated whatever the load
    law: ShearLaw


@compiled_inline
def _balance(slip, load, soil, wheel, conditions, fx):
    """(`_Balance`, soil in contact, sinkage that is seen over that which is felt)."""
    sine = conditions.sin_grade
    ground = soil_in_contact(
        soil,
        fx,
        slip,
        conditions.speed,
        sliding_speed(slip, conditions.speed),
        conditions.passes,
        sine,
    )
    normal, _ = weight_on_slope(load, sine, fx)
    rim, travel = motion_from_slip(slip)
    rim, K = sheared(rim, ground, fx, wheel)
    q = shear_radius_ratio(contact_radius(fx, wheel), wheel.grouser_height, fx)
    under = at_shear_radius(ground, q, K)
    ratio = max(slip_sinkage_ratio(slip, ground.dig_gain, ground.dig_recovery), 1e-3)
    apparent = ratio if fx.slip_sinkage_apparent > 0.0 else 1.0
    lift = min(excavated_depth(slip, fx), 0.9 * DEEPEST * wheel.radius)
    strength = math.log(ground.sinkage_coefficient) - ground.sinkage_exponent * math.log(
        ratio / apparent
    )
    return (
        _Balance(slip, rim, travel, normal, under, strength, lift, shear_law(fx)),
        ground,
        apparent,
    )


@compiled_inline
def _misfit(x, p, wheel, fx):
    """(ln of the mobilised over the available sinkage coefficient at the sinkage e^x [m], `Forces` there)."""
    z = math.exp(x)
    soil = p.soil
    b = wheel.width
    n = soil.sinkage_exponent
    arc = arc_of(z, p.slip, fx, wheel)
    q = integrals_alone(arc, p.rim, p.travel, soil.shear_modulus, n, p.law)
    s = contact.mobilised_sinkage_coefficient(
        q, p.load, soil.tan_phi, soil.cohesion, arc.radius, b, 1.0
    )
    available = p.strength + (n * math.log(1.0 - p.lift / z) if p.lift != 0.0 else 0.0)
    f = min(max(math.log(max(s, 1e-300)) - available, -2.0), 50.0)
    if (
        bearing_share(q, soil.tan_phi, 1.0) <= 1e-12 * q.p_cos
        and p.load / (arc.radius * b) > soil.cohesion * q.e_sin
    ):
        f = 2.0  # friction takes more than the normal stress gives: no S carries the load here
    return f, forces(q, math.exp(available), soil.tan_phi, soil.cohesion, arc.radius, b, 1.0)


@compiled_inline
def _first_guess(p, wheel, guess):
    """ln of the sinkage [m] to start from: of `guess` where there is one, else of a flat plate, sqrt(2 r z) long."""
    if guess > 0.0:
        return math.log(guess)
    pressure = math.log(p.load / (wheel.width * math.sqrt(2.0 * wheel.radius))) - p.strength
    x = pressure / (p.soil.sinkage_exponent + 0.5)
    return math.log(math.exp(min(x, math.log(DEEPEST * wheel.radius))) + max(p.lift, 0.0))


@compiled_part
def _solve_balance(p, wheel, fx, guess):
    """(ln of the sinkage, `Forces` there, whether the soil carries the load): bracketed secant on `_misfit`."""
    deepest = math.log(DEEPEST * wheel.radius)
    low = math.log(max(1e-6 * wheel.radius, 1.0001 * p.lift))
    high = deepest
    x = min(max(_first_guess(p, wheel, guess), low), high)
    slope = -(p.soil.sinkage_exponent + 0.5)
    x_old = 0.0
    f_old = 0.0
    w_old = Forces(0.0, 0.0, 0.0)
    supported = False
    for k in range(60):
        f, w = _misfit(x, p, wheel, fx)
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
def steady_with(slip, load, soil, wheel, conditions, unit_weight, fx, guess):
    """`Steady` sinkage, drawbar pull and torque as they are measured at a measured slip and weight `load` [N].

    Eq. (1) is solved for the sinkage, then Eqs. (2) and (3) follow. Digging deepens the hole at the same bearing
    pressure: s z^n = S z_w^n with z = k(i) z_w + l(i). So z carries the load when the coefficient s(z) that the load
    mobilises is S ((z - l)/(k z))^n. The root of the difference of their logarithms is found by a bracketed secant in
    ln z, in which it is nearly straight, from `guess` [m] where one is given. `unit_weight` [N/m3] of the soil is
    needed by bulldozing and blades only.
    """
    i = true_slip(slip, fx)
    r = wheel.radius
    b = wheel.width
    p, ground, apparent = _balance(i, load, soil, wheel, conditions, fx)
    x, w, supported = _solve_balance(p, wheel, fx, guess)
    z = math.exp(x)
    outer = contact_radius(fx, wheel)
    blade = 0.0
    if fx.grousers_blades != 0.0:
        theta1 = entry_angle(z, outer)
        blade = blade_force(theta1, z, i, ground, unit_weight, b, wheel.grouser_height, fx)
    pull = w.drawbar_pull + blade - soil_resistance(z, ground, unit_weight, b, fx)
    pull -= weight_on_slope(load, conditions.sin_grade, fx)[1]
    q = shear_radius_ratio(outer, wheel.grouser_height, fx)
    torque = q * w.torque + blade * (r + 0.5 * wheel.grouser_height)
    speed = max(conditions.speed, 1e-9)  # a wheel whose speed is not known turns all the same
    wheel_speed = (speed + sliding_speed(i, speed) * (1.0 if i > 0.0 else -1.0)) / r
    torque = drive_torque(torque, wheel_speed, 1e-15, fx)
    return Steady(
        min(apparent * z, DEEPEST * r) + fx.sinkage_offset_offset, pull, torque, supported
    )


@compiled_part
def predict_rows(slip, load, wheels, conditions, soil, unit_weight, fx, guess, out):
    """`steady_with` of every row into `out` [N, 3] (sinkage, drawbar pull, torque), from `guess` [N], which it renews.

    `wheels` [N, 3] as `Rim`, `conditions` [N, 3] as `Conditions`. Returns the number of rows that the soil carries.
    """
    carried = 0
    for k in range(slip.size):
        w = wheels[k]
        c = conditions[k]
        s = steady_with(
            slip[k],
            load[k],
            soil,
            Rim(w[0], w[1], w[2]),
            Conditions(c[0], c[1], c[2]),
            unit_weight,
            fx,
            guess[k],
        )
        out[k, 0] = s.sinkage
        out[k, 1] = s.drawbar_pull
        out[k, 2] = s.torque
        carried += s.supported
        guess[k] = s.sinkage - fx.sinkage_offset_offset if s.supported else 0.0
    return carried


def sinkage_coefficient_at(soil: SoilState, exponent: float, depth: float) -> float:
    """S' [N/m^(n'+2)] that bears the same pressure S' z^n' = S z^n as `soil` at `depth` z [m] with another exponent n'.

    S has a unit that depends on n, so two values compare only at the same exponent.
    """
    return soil.sinkage_coefficient * max(depth, 1e-4) ** (soil.sinkage_exponent - exponent)
