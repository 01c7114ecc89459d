"""Reaction of the soil and of effects to a driven wheel, with the derivatives that an implicit step needs.

All functions take floats (one wheel) or lanes (eight wheels).
"""

from typing import NamedTuple

import soil_env.terramechanics.effects.grousers as grousers
from soil_env._numba.compiling import compiled_inline, compiled_part, uncompiled
from soil_env._numba.elementary import larger, sqrt, where_less
from soil_env._numba.lanes import alike
from soil_env.parameters import SoilState
from soil_env.slip import signed_slip, slip_ratio
from soil_env.terramechanics import contact
from soil_env.terramechanics.arc_integrals import integrals_of
from soil_env.terramechanics.contact import (
    JANOSI,
    Arc,
    ShearLaw,
    forces,
    shear_forces,
    smooth_arc,
    smoothed_sign,
)
from soil_env.terramechanics.effects import (
    NO_EFFECTS,
    Effects,
    drive_friction,
    soil_in_contact,
    soil_resistance,
)
from soil_env.terramechanics.effects.shear_softening import shear_law, shear_length_ratio
from soil_env.terramechanics.effects.slip_sinkage import excavated_depth, slip_sinkage_ratio
from soil_env.terramechanics.residual import ResidualLaw, dimensionless_groups, residual_at
from soil_env.terramechanics.steady import Rim, arc_of

REST_SPEED = (
    0.001  # [m/s] below this speed slip and resistance fade out, so that a wheel can stand still
)


class Reaction(NamedTuple):
    """Soil reaction at one motion, with its derivatives by travel speed V and by rim speed u = r w."""

    load: float
    drawbar_pull: float
    torque: float
    sinkage_coefficient: float  # s, mobilised sinkage coefficient
    dp_v: float
    dp_u: float
    torque_v: float
    torque_u: float
    sinkage_coefficient_v: float
    sinkage_coefficient_u: float


@compiled_inline
def reaction_from(integrals, motion, speed, rim_speed, load, tan_phi, c, r, b):
    """`Reaction` to a wheel that carries `load`: Eqs. (1)-(3) with (1) solved for S, from its arc's integrals."""
    q, by_rim, by_travel = integrals
    _, travel, direction = motion
    s = contact.mobilised_sinkage_coefficient(q, load, tan_phi, c, r, b, direction)
    f = forces(q, s, tan_phi, c, r, b, direction)
    st = s * tan_phi
    rest2 = REST_SPEED * REST_SPEED
    u2 = rim_speed * rim_speed + rest2
    travel_v = 1.0 / sqrt(u2)
    rim_u = rest2 * travel_v / u2
    travel_u = -travel * rim_speed / u2
    turn = smoothed_sign(speed, REST_SPEED)[1]

    # at the present s: through rim, travel and the direction
    by_rim = shear_forces(by_rim, st, c, r, b, direction)
    by_travel = shear_forces(by_travel, st, c, r, b, direction)
    load_v = by_travel.load * travel_v + turn * (shear_forces(q, st, c, r, b, 1.0).load)
    load_u = by_rim.load * rim_u + by_travel.load * travel_u
    # through s, which keeps the load what it is
    of_s = forces(q, 1.0, tan_phi, 0.0, r, b, direction)
    s_by_load = where_less(
        0.0, s, -1.0 / (r * b * contact.bearing_share(q, tan_phi, direction)), 0.0
    )
    s_v = s_by_load * load_v
    s_u = s_by_load * load_u
    return Reaction(
        f.load,
        f.drawbar_pull,
        f.torque,
        s,
        s_v * of_s.drawbar_pull + by_travel.drawbar_pull * travel_v - turn * (r * b * s * q.p_sin),
        s_u * of_s.drawbar_pull + by_rim.drawbar_pull * rim_u + by_travel.drawbar_pull * travel_u,
        s_v * of_s.torque + by_travel.torque * travel_v,
        s_u * of_s.torque + by_rim.torque * rim_u + by_travel.torque * travel_u,
        s_v,
        s_u,
    )


@compiled_part
def reaction(speed, rim_speed, sinkage, load, soil, r, b):
    """`Reaction` of the base model to one wheel at a given sinkage [m] that carries `load` [N]."""
    motion = contact.motion_from_speeds(rim_speed, speed, REST_SPEED)
    arc = smooth_arc(sinkage, r)
    integrals = integrals_of(
        arc, motion[0], motion[1], soil.shear_modulus, soil.sinkage_exponent, JANOSI
    )
    return reaction_from(
        integrals, motion, speed, rim_speed, load, soil.tan_phi, soil.cohesion, r, b
    )


class Interaction(NamedTuple):
    """A wheel and what acts between it and any soil: its size and the effects that are on, as the kernels take them."""

    radius: float  # [m] of the rim
    width: float  # [m]
    grouser_height: float  # [m]
    contact_radius: float  # [m] that carries the normal stress
    shear_ratio: float  # radius at which soil is sheared, over `contact_radius`
    rim_ratio: float  # that radius over the rim's
    law: ShearLaw
    gravity: float
    unit_weight: float  # of the soil [N/m3]
    on: bool  # whether any effect or a residual law is on
    effects: Effects
    residual: ResidualLaw


def interaction(
    wheel: Rim, effects: Effects, residual: ResidualLaw, gravity: float, unit_weight: float
) -> Interaction:
    """`Interaction` of a wheel with the effects that act on it."""
    r = uncompiled(grousers.contact_radius)(effects, wheel)
    ratio = uncompiled(grousers.shear_radius_ratio)(r, wheel.grouser_height, effects)
    on = effects != NO_EFFECTS or residual.coefficient.size > 0
    law = uncompiled(shear_law)(effects)
    return Interaction(
        wheel.radius,
        wheel.width,
        wheel.grouser_height,
        r,
        ratio,
        ratio * r / wheel.radius,
        law,
        gravity,
        unit_weight,
        on,
        effects,
        residual,
    )


class Ground(NamedTuple):
    """Ground under a wheel during a substep, at the slip and the speeds that it begins with."""

    soil: SoilState  # as it is sheared
    arc: Arc
    lift: float  # [m] sinkage beyond that which carries, as digging has it
    bulldozing: float  # [N] resistance of the soil ahead
    blades: float  # [N] thrust of the lugs of a slipping wheel
    pull: float  # [N] of the residual law
    torque: float  # [N m] of the residual law


@compiled_inline
def ground_under(sinkage, speed, rim_speed, weight, soil, sin_grade, passes, wheel):
    """`Ground` under a wheel (`Interaction`) of this weight [N] on undisturbed `soil`."""
    none = alike(0.0, sinkage)
    if not wheel.on:
        return Ground(soil, smooth_arc(sinkage, wheel.radius), none, none, none, none, none)
    fx = wheel.effects
    r = wheel.radius
    b = wheel.width
    h = wheel.grouser_height
    slip = slip_ratio(rim_speed, speed, REST_SPEED)
    pull = none
    torque = none
    if wheel.residual.coefficient.size > 0:
        groups = dimensionless_groups(
            slip, sinkage, weight, abs(speed), passes, sin_grade, soil, r, b, wheel.gravity
        )
        moving = smoothed_sign(speed, REST_SPEED)[0] * weight
        _, pull, torque = residual_at(wheel.residual, groups)
        pull = moving * pull
        torque = moving * torque * r
    soil = soil_in_contact(soil, fx, slip, abs(speed), abs(rim_speed - speed), passes, sin_grade)
    arc = arc_of(sinkage, slip, fx, Rim(r, b, h))
    dug = larger(slip_sinkage_ratio(slip, soil.dig_gain, soil.dig_recovery), 1e-3)
    q = wheel.shear_ratio
    return Ground(
        grousers.at_shear_radius(soil, q, soil.shear_modulus * shear_length_ratio(fx) / q),
        arc,
        excavated_depth(slip, fx) / dug,
        soil_resistance(sinkage, soil, wheel.unit_weight, b, fx),
        grousers.blade_thrust(arc.theta1, sinkage, soil, wheel.unit_weight, b, h, fx),
        pull,
        torque,
    )


class Added(NamedTuple):
    """A force or a torque that is added to the soil's, with its derivatives."""

    value: float
    by_v: float
    by_u: float


@compiled_inline
def _blades(thrust, speed, rim_speed):
    """`Added` thrust [N] of the lugs along the rim."""
    slip, by_u, by_v = signed_slip(rim_speed, speed, REST_SPEED)
    force, slope = grousers.blades_at(thrust, slip)
    return Added(force, slope * by_v, slope * by_u)


@compiled_inline
def _drive_friction(torque, rim_speed, r, fx):
    """`Added` torque [N m] of `drive_friction` for an `Added` torque at the axle."""
    friction, by_torque, by_wheel_speed = drive_friction(
        torque.value, rim_speed / r, REST_SPEED / r, fx
    )
    return Added(friction, by_torque * torque.by_v, by_torque * torque.by_u + by_wheel_speed / r)


@compiled_inline
def at_the_axle(f, bulldozing, blades, pull, torque, speed, rim_speed, wheel):
    """`Reaction` `f` at the shear radius as one at the axle, with what `Ground` and the drivetrain add."""
    q = wheel.shear_ratio
    p = wheel.rim_ratio
    lever = wheel.radius + 0.5 * wheel.grouser_height
    direction, turn = smoothed_sign(speed, REST_SPEED)
    blade = _blades(blades, speed, rim_speed)
    at_axle = q * f.torque + lever * blade.value + torque
    axle = Added(
        at_axle, q * f.torque_v + lever * blade.by_v, q * p * f.torque_u + lever * blade.by_u
    )
    friction = _drive_friction(axle, rim_speed, wheel.radius, wheel.effects)
    return Reaction(
        f.load,
        f.drawbar_pull + blade.value - direction * bulldozing + pull,
        axle.value + friction.value,
        f.sinkage_coefficient,
        f.dp_v + blade.by_v - turn * bulldozing,
        p * f.dp_u + blade.by_u,
        axle.by_v + friction.by_v,
        axle.by_u + friction.by_u,
        f.sinkage_coefficient_v,
        p * f.sinkage_coefficient_u,
    )


@compiled_inline
def moved(f, dv, du):
    """`Reaction` `f` to first order after a change of V and of u; its derivatives stay."""
    return Reaction(
        f.load,
        f.drawbar_pull + f.dp_v * dv + f.dp_u * du,
        f.torque + f.torque_v * dv + f.torque_u * du,
        larger(
            f.sinkage_coefficient + f.sinkage_coefficient_v * dv + f.sinkage_coefficient_u * du, 0.0
        ),
        f.dp_v,
        f.dp_u,
        f.torque_v,
        f.torque_u,
        f.sinkage_coefficient_v,
        f.sinkage_coefficient_u,
    )
