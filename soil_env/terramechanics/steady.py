"""Steady state of a wheel on uniform soil: sinkage, drawbar pull and torque at a given slip and load, with effects."""

from __future__ import annotations

import math
from typing import NamedTuple

from soil_env._numba.compiling import kernel
from soil_env.parameters import SoilState
from soil_env.terramechanics.contact import (
    JANOSI,
    Forces,
    arc_integrals,
    arc_nodes,
    entry_angle,
    forces,
    mobilised_modulus,
    motion_from_slip,
    shear_integrals,
)
from soil_env.terramechanics.effects import (
    NO_EFFECTS,
    arc_ends,
    blade_force,
    bulldozing_resistance,
    drive_torque,
    excavated_depth,
    shear_law,
    shear_length_ratio,
    shear_radius_ratio,
    sliding_speed,
    slip_sinkage_ratio,
    soil_in_contact,
    true_slip,
)

_SECANT = 1e-7  # step times last step [ln m]^2, the size of the error that the last step of the secant leaves
DEEPEST = 1.5  # [radii] sinkage beyond which a wheel counts as buried


class Steady(NamedTuple):
    """Steady state of a wheel at one slip and load."""

    sinkage: float  # [m]
    drawbar_pull: float  # [N]
    torque: float  # [N m]
    floating: bool  # False when the soil cannot carry the load before the wheel is buried; `sinkage` is then the bound


class Rim(NamedTuple):
    """The wheel as it meets the soil."""

    radius: float  # [m]
    width: float  # [m]
    grouser_height: float  # [m]


class Conditions(NamedTuple):
    """What a steady point was driven at, besides slip and load."""

    speed: float  # [m/s] travel
    passes: float  # 1 = fresh soil
    sin_grade: float  # uphill positive


class Contact(NamedTuple):
    """Contact arc of a wheel at one sinkage, with the effects that shape it."""

    theta1: float  # [rad] entry angle
    radius: float  # [m] that carries the normal stress
    shear_ratio: float  # radius at which soil is sheared, over `radius`


LEVEL = Conditions(0.0, 1.0, 0.0)


@kernel
def contact_arc(sinkage, fx, wheel):
    """`Contact` of a wheel at a given sinkage [m]."""
    r = wheel.radius + fx.grousers_radius_share * wheel.grouser_height
    return Contact(entry_angle(sinkage, r), r, shear_radius_ratio(r, wheel.grouser_height, fx))


@kernel
def sheared_from(arc):
    """Angle [rad] at which the lug tips enter the soil: cos = cos(theta1)/q; theta1 without lugs (Ding et al. 2011)."""
    if arc.shear_ratio == 1.0:
        return arc.theta1
    return math.acos(max(-1.0, min(1.0, math.cos(arc.theta1) / arc.shear_ratio)))


@kernel
def sheared(rim, soil, arc, fx, wheel):
    """(rim, K) as the soil between the lug tips sees them: `rim` of motion and shear modulus [m].

    Shear at the radius q R stretches j, thrust and torque: K/q here, q tan(phi) and q c where forces are summed. Where
    slip was taken at the rim of radius r, the tips move faster: rim q R/r instead.
    """
    K = soil.shear_modulus * shear_length_ratio(fx)
    if fx.grousers_slip_at_rim > 0.0:
        larger = arc.radius / wheel.radius
        return rim * larger * arc.shear_ratio, K * larger
    return rim, K / arc.shear_ratio


@kernel
def contact_at(sinkage, rim, travel, slip, soil, fx, wheel):
    """(Contact, ArcIntegrals, ArcRates by rim, ArcRates by travel) of a wheel at a given sinkage [m]."""
    arc = contact_arc(sinkage, fx, wheel)
    theta2, thetam = arc_ends(arc.theta1, slip, fx)
    rim, K = sheared(rim, soil, arc, fx, wheel)
    nodes = arc_nodes(arc.theta1, theta2, thetam, soil.sinkage_exponent, arc.radius, sheared_from(arc))
    q, by_rim, by_travel = shear_integrals(nodes, rim, travel, K, shear_law(fx))
    return arc, q, by_rim, by_travel


@kernel
def forces_at(sinkage, S, soil, rim, travel, direction, r, b):
    """`Forces` of a smooth wheel at a given sinkage [m] with sinkage coefficient S, contact up to the lowest point."""
    theta1 = entry_angle(sinkage, r)
    q, _, _ = arc_integrals(
        theta1, 0.0, 0.5 * theta1, rim, travel, soil.shear_modulus, soil.sinkage_exponent, r, JANOSI
    )
    return forces(q, S, soil.tan_phi, soil.cohesion, r, b, direction)


@kernel
def steady_state(slip, load, soil, r, b, guess=0.0):
    """`steady_with` of the base model on level, fresh soil, with the digging of `soil`."""
    return steady_with(slip, load, soil, Rim(r, b, 0.0), LEVEL, 0.0, NO_EFFECTS, guess)


@kernel
def steady_with(slip, load, soil, wheel, conditions, unit_weight, fx, guess):
    """`Steady` sinkage, drawbar pull and torque as they are measured at a measured slip and weight `load` [N].

    Eq. (1) is solved for the sinkage, then Eqs. (2) and (3) follow. Digging deepens the hole at the same bearing
    pressure: s z^n = S z_w^n with z = k(i) z_w + l(i), so z carries the load when the coefficient s(z) that the load
    mobilises (closed form, since (1) is linear in it) is S ((z - l)/(k z))^n. The root of the difference of their
    logarithms is found by a bracketed secant in ln z, in which it is nearly straight, from `guess` [m] where one is
    given. `unit_weight` [N/m3] of the soil is needed by bulldozing and blades only.
    """
    i = true_slip(slip, fx)
    rim, travel = motion_from_slip(i)
    sine = conditions.sin_grade
    ground = soil_in_contact(soil, fx, i, conditions.speed, sliding_speed(i, conditions.speed), conditions.passes, sine)
    normal = load * (1.0 - fx.grade_share * (1.0 - math.sqrt(1.0 - sine * sine)))
    r, b, n = wheel.radius, wheel.width, ground.sinkage_exponent
    ratio = slip_sinkage_ratio(i, ground.dig_gain, ground.dig_recovery)
    apparent = max(ratio, 1e-3) if fx.slip_sinkage_apparent > 0.0 else 1.0
    ratio = 1.0 if fx.slip_sinkage_apparent > 0.0 else ratio
    lift = min(excavated_depth(i, fx), 0.9 * DEEPEST * r)
    available = math.log(ground.sinkage_coefficient) - n * math.log(max(ratio, 1e-3))
    low, high = math.log(max(1e-6 * r, 1.0001 * lift)), math.log(DEEPEST * r)
    deepest = high
    # start from the guess, or from the depth of a flat plate, sqrt(2 r z) long
    if guess > 0.0:
        x = math.log(guess)
    else:
        x = (math.log(normal / (b * math.sqrt(2.0 * r))) - available) / (n + 0.5)
        x = math.log(math.exp(min(x, high)) + max(lift, 0.0))
    x = min(max(x, low), high)
    slope = -(n + 0.5)
    x_old = f_old = 0.0
    w_old = Forces(0.0, 0.0, 0.0)
    floating = False
    for k in range(60):
        z = math.exp(x)
        arc, q, _, _ = contact_at(z, rim, travel, i, ground, fx, wheel)
        tan_phi, c = arc.shear_ratio * ground.tan_phi, arc.shear_ratio * ground.cohesion
        s = mobilised_modulus(q, normal, tan_phi, c, arc.radius, b, 1.0)
        lifted = n * math.log(1.0 - lift / z) if lift != 0.0 else 0.0
        f = min(max(math.log(max(s, 1e-300)) - available - lifted, -2.0), 50.0)
        if q.p_cos + tan_phi * q.pe_sin <= 1e-12 * q.p_cos and normal / (arc.radius * b) > c * q.e_sin:
            f = 2.0  # friction takes more than the normal stress gives: no S carries the load here
        if f > 0.0:
            low = max(low, x)
        else:
            high = min(high, x)
        w = forces(q, math.exp(available + lifted), tan_phi, c, arc.radius, b, 1.0)
        moved = x - x_old
        if k > 0 and moved != 0.0:
            slope = min((f - f_old) / moved, -0.05)
        step = -f / slope
        if k > 0 and abs(step * moved) < _SECANT and low < x + step < high:
            share = step / moved  # along the secant that gave the step
            w_old = Forces(
                w.load,
                w.drawbar_pull + share * (w.drawbar_pull - w_old.drawbar_pull),
                w.torque + share * (w.torque - w_old.torque),
            )
            x_old, floating = x + step, True
            break
        x_old, f_old, w_old = x, f, w
        floating = x < deepest
        if abs(step) < 1e-6 or low >= high:
            break
        x = x + step
        if x >= deepest and high == deepest:
            x = deepest
        elif not low < x < high:
            x = 0.5 * (low + high)
    z = math.exp(x_old)
    arc = contact_arc(z, fx, wheel)
    blade = blade_force(arc.theta1, z, i, ground, unit_weight, b, wheel.grouser_height, fx)
    pull = w_old.drawbar_pull + blade - bulldozing_resistance(z, ground, unit_weight, b, fx)
    pull -= fx.grade_share * load * sine
    torque = arc.shear_ratio * w_old.torque + blade * (r + 0.5 * wheel.grouser_height)
    speed = max(conditions.speed, 1e-9)  # a wheel whose speed is not known turns all the same
    wheel_speed = (speed + sliding_speed(i, speed) * (1.0 if i > 0.0 else -1.0)) / r
    torque = drive_torque(torque, wheel_speed, 1e-15, fx)
    return Steady(min(apparent * z, DEEPEST * r) + fx.sinkage_offset_offset, pull, torque, floating)


@kernel
def predict_rows(slip, load, wheels, conditions, soil, unit_weight, fx, guess, out):
    """`steady_with` of every row into `out` [N, 3] (sinkage, drawbar pull, torque), from `guess` [N], which it renews.

    `wheels` [N, 3] as `Rim`, `conditions` [N, 3] as `Conditions`. Returns the number of rows that the soil carries.
    """
    carried = 0
    for k in range(slip.size):
        w, c = wheels[k], conditions[k]
        s = steady_with(
            slip[k], load[k], soil, Rim(w[0], w[1], w[2]), Conditions(c[0], c[1], c[2]), unit_weight, fx, guess[k]
        )
        out[k, 0], out[k, 1], out[k, 2] = s.sinkage, s.drawbar_pull, s.torque
        carried += s.floating
        guess[k] = s.sinkage - fx.sinkage_offset_offset if s.floating else 0.0
    return carried


def sinkage_coefficient_at(soil: SoilState, exponent: float, depth: float) -> float:
    """S' [N/m^(n'+2)] that bears the same pressure S' z^n' = S z^n as `soil` at `depth` z [m] with another exponent n'.

    S has a unit that depends on n, so two values compare only at the same exponent.
    """
    return soil.sinkage_coefficient * max(depth, 1e-4) ** (soil.sinkage_exponent - exponent)
