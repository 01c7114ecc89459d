"""What the soil and all else do to a wheel at one motion, with the derivatives that the implicit step needs."""

from __future__ import annotations

import math
from typing import NamedTuple

from soil_env._numba.compiling import inlined, inner, kernel
from soil_env._numba.elementary import larger, root, where_less
from soil_env.parameters import SoilState
from soil_env.terramechanics.contact import (
    JANOSI,
    ShearLaw,
    arc_nodes,
    entry_angle,
    forces,
    mobilised_modulus,
    motion_from_speeds,
    shear_integrals,
    slip_ratio,
)
from soil_env.terramechanics.effects import (
    arc_ends,
    blade_force,
    blade_share,
    bulldozing_resistance,
    drive_torque,
    excavated_depth,
    shear_law,
    shear_length_ratio,
    slip_sinkage_ratio,
    soil_in_contact,
)
from soil_env.terramechanics.model import Rim, contact_arc, sheared_from
from soil_env.terramechanics.residual import dimensionless_groups, residual_at

REST_SPEED = 0.001  # [m/s] below this speed slip and resistance fade out, so that a wheel can stand still


class Reaction(NamedTuple):
    """Soil reaction at one motion, with its derivatives by V and by rim speed u = r w."""

    load: float
    drawbar_pull: float
    torque: float
    modulus: float  # s, mobilised sinkage coefficient
    dp_v: float
    dp_u: float
    torque_v: float
    torque_u: float
    modulus_v: float
    modulus_u: float


@kernel
def reaction(speed, rim_speed, sinkage, load, soil, r, b):
    """`Reaction` of the soil to a wheel at a given sinkage that carries `load`: Eqs. (1)-(3) with (1) solved for S."""
    theta1 = entry_angle(sinkage, r)
    nodes = arc_nodes(theta1, 0.0, 0.5 * theta1, soil.sinkage_exponent, r, theta1)
    return reaction_of(nodes, speed, rim_speed, load, soil, r, b, JANOSI)


@inlined
def reaction_of(nodes, speed, rim_speed, load, soil, r, b, law):
    """`reaction` on given nodes of the contact arc (`contact.arc_nodes`), which depend on sinkage and soil only."""
    motion = motion_from_speeds(rim_speed, speed, REST_SPEED)
    integrals = shear_integrals(nodes, motion[0], motion[1], soil.shear_modulus, law)
    return reaction_from(integrals, motion, speed, rim_speed, load, soil.tan_phi, soil.cohesion, r, b)


@inlined
def reaction_from(integrals, motion, speed, rim_speed, load, tan_phi, c, r, b):
    """`reaction` from the arc's integrals with their rates, of floats or in lanes."""
    q, by_rim, by_travel = integrals
    _, travel, direction = motion
    s = mobilised_modulus(q, load, tan_phi, c, r, b, direction)
    f = forces(q, s, tan_phi, c, r, b, direction)

    rest2 = REST_SPEED * REST_SPEED
    u2, v2 = rim_speed * rim_speed + rest2, speed * speed + rest2
    travel_v = 1.0 / root(u2)
    rim_u, travel_u = rest2 * travel_v / u2, -travel * rim_speed / u2
    turn = rest2 / (v2 * root(v2))  # d direction/dV
    share = where_less(0.0, s, 1.0 / (q.p_cos + direction * tan_phi * q.pe_sin), 0.0)
    st = s * tan_phi

    # d/dV and d/du of the soil's reaction: first at the present s, then by s
    a, z = by_rim, by_travel
    dp_s, torque_s = tan_phi * q.pe_cos - direction * q.p_sin, r * tan_phi * q.pe
    lift = direction * (st * z.pe_sin + c * z.e_sin)
    lift_u = direction * (st * a.pe_sin + c * a.e_sin) * rim_u + lift * travel_u
    s_v = -share * (lift * travel_v + turn * (st * q.pe_sin + c * q.e_sin))
    s_u = -share * lift_u
    pull, twist = st * z.pe_cos + c * z.e_cos, r * (st * z.pe + c * z.e)
    pull_u = (st * a.pe_cos + c * a.e_cos) * rim_u + pull * travel_u
    twist_u = r * (st * a.pe + c * a.e) * rim_u + twist * travel_u
    rb = r * b
    return Reaction(
        f.load,
        f.drawbar_pull,
        f.torque,
        s,
        rb * (s_v * dp_s + pull * travel_v - turn * s * q.p_sin),
        rb * (s_u * dp_s + pull_u),
        rb * (s_v * torque_s + twist * travel_v),
        rb * (s_u * torque_s + twist_u),
        s_v,
        s_u,
    )


class Ground(NamedTuple):
    """What a wheel stands on during a substep, and the effects that act there."""

    soil: SoilState
    radius: float  # [m] that carries the normal stress
    shear_ratio: float  # radius at which soil is sheared, over `radius`
    rim_ratio: float  # that radius over the wheel's
    law: ShearLaw
    theta1: float
    theta2: float
    thetam: float
    sheared_from: float
    lift: float  # [m] sinkage beyond that which carries, as digging has it
    bulldozing: float  # [N] resistance of the soil ahead
    blades: float  # [N] thrust of the lugs of a slipping wheel
    pull: float  # [N] of the residual law
    torque: float  # [N m] of the residual law


@kernel
def plain_ground(w, soil, world):
    """`Ground` of the base model."""
    theta1 = entry_angle(w.sinkage, world.radius)
    return Ground(soil, world.radius, 1.0, 1.0, JANOSI, theta1, 0.0, 0.5 * theta1, theta1, 0.0, 0.0, 0.0, 0.0, 0.0)


@kernel
def ground_with_effects(w, soil, grade, passes, world):
    """`Ground` with the effects of this world, at the slip and the speeds that the substep starts with."""
    fx, r, b, h = world.effects, world.radius, world.width, world.grouser_height
    u = w.wheel_speed * r
    slip = slip_ratio(u, w.speed, REST_SPEED)
    weight = w.mass * world.gravity
    groups = dimensionless_groups(
        slip, w.sinkage, weight, abs(w.speed), passes, math.sin(grade), soil, r, b, world.gravity
    )
    _, pull, torque = residual_at(world.residual, groups)
    soil = soil_in_contact(soil, fx, slip, abs(w.speed), abs(u - w.speed), passes, math.sin(grade))
    arc = contact_arc(w.sinkage, fx, Rim(r, b, h))
    theta2, thetam = arc_ends(arc.theta1, slip, fx)
    ahead = bulldozing_resistance(w.sinkage, soil, world.unit_weight, b, fx)
    blades = blade_force(arc.theta1, w.sinkage, 1.0, soil, world.unit_weight, b, h, fx)
    dug = max(slip_sinkage_ratio(slip, soil.dig_gain, soil.dig_recovery), 1e-3)
    moving = w.speed / math.sqrt(w.speed * w.speed + REST_SPEED * REST_SPEED)
    q = arc.shear_ratio
    sheared_soil = SoilState(
        q * soil.tan_phi, q * soil.cohesion, soil.shear_modulus * shear_length_ratio(fx) / q,
        soil.sinkage_coefficient, soil.sinkage_exponent, soil.dig_gain, soil.dig_recovery,
    )  # fmt: skip
    return Ground(
        sheared_soil, arc.radius, q, q * arc.radius / r, shear_law(fx), arc.theta1, theta2, thetam, sheared_from(arc),
        excavated_depth(slip, fx) / dug, ahead, blades, moving * pull * weight, moving * torque * weight * r,
    )  # fmt: skip


@inlined
def react(nodes, ground, speed, rim_speed, load, world):
    """`Reaction` of the ground, with all that acts on the wheel at its axle."""
    f = reaction_of(
        nodes, speed, ground.rim_ratio * rim_speed, load, ground.soil, ground.radius, world.width, ground.law
    )
    return with_added_forces(f, ground, speed, rim_speed, world) if world.with_effects else f


@kernel
def with_added_forces(f, ground, speed, rim_speed, world):
    """`Reaction` `f` at the shear radius as one at the axle, with lugs, bulldozing, drivetrain and residual law."""
    q, p = ground.shear_ratio, ground.rim_ratio
    torque, torque_v, torque_u = q * f.torque, q * f.torque_v, q * p * f.torque_u
    d = 1e-8  # [m/s], small beside the speeds within which Coulomb friction and the thrust of lugs turn round
    pull, more = _added_forces(ground, speed, rim_speed, torque, world)
    pull_v, more_v = _added_forces(ground, speed + d, rim_speed, torque + d * torque_v, world)
    pull_u, more_u = _added_forces(ground, speed, rim_speed + d, torque + d * torque_u, world)
    return Reaction(
        f.load,
        f.drawbar_pull + pull,
        torque + more,
        f.modulus,
        f.dp_v + (pull_v - pull) / d,
        p * f.dp_u + (pull_u - pull) / d,
        torque_v + (more_v - more) / d,
        torque_u + (more_u - more) / d,
        f.modulus_v,
        p * f.modulus_u,
    )


@inner
def _added_forces(ground, speed, rim_speed, soil_torque, world):
    """(pull [N], torque [N m]) that lugs, bulldozing, drivetrain friction and the residual law add."""
    fx, r = world.effects, world.radius
    direction = speed / math.sqrt(speed * speed + REST_SPEED * REST_SPEED)
    slip = slip_ratio(rim_speed, speed, REST_SPEED) * (1.0 if rim_speed + speed >= 0.0 else -1.0)
    blade = ground.blades * blade_share(slip)
    lever = r + 0.5 * world.grouser_height
    torque = blade * lever + ground.torque
    friction = drive_torque(soil_torque + torque, rim_speed / r, REST_SPEED / r, fx) - soil_torque - torque
    return blade - direction * ground.bulldozing + ground.pull, torque + friction


@inlined
def moved(f, dv, du):
    """`Reaction` `f` to first order after a change of V and of u; its derivatives stay."""
    return Reaction(
        f.load,
        f.drawbar_pull + f.dp_v * dv + f.dp_u * du,
        f.torque + f.torque_v * dv + f.torque_u * du,
        larger(f.modulus + f.modulus_v * dv + f.modulus_u * du, 0.0),
        f.dp_v,
        f.dp_u,
        f.torque_v,
        f.torque_u,
        f.modulus_v,
        f.modulus_u,
    )
