"""Reaction of the soil and of effects to a driven wheel, with the derivatives that an implicit step
needs.

`ground_under` says what a wheel stands on during a step: its soil, its arc and the forces beside
the contact. `lay_footing` puts the arc's nodes into a scratch; `reaction` then gives the forces at
any two speeds.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from soil_env._compiled.elementary import smoothed_sign
from soil_env._compiled.flags import compiled, inlined, record
from soil_env.slip import signed_slip, slip_ratio

from .contact import (
    ShearLaw,
    bounded_bearing,
    braked_shift,
    carried_share,
    forces,
    gripping_share,
    grown_modulus,
    held_below,
    lay_nodes,
    mobilised_sinkage_coefficient,
    most_carried,
    on_tyre,
    shear_integrals,
    shear_rates,
    stretched,
)
from .effects import (
    NO_EFFECTS,
    Effects,
    drive_friction,
    grousers,
    soil_at_rim,
    soil_in_contact,
    soil_resistance,
)
from .effects.entry import Passage
from .effects.shear_softening import mobilisation
from .effects.slip_sinkage import excavated_depth
from .ground import strengthened
from .residual import WorkingPoint, residual_law, residual_under
from .steady import arc_of, dug_ratio

# [m/s] below this speed slip and resistance fade out, so that a wheel can stand still
REST_SPEED = 0.001


#: `Effects` of a world: compiled functions hand on the address of a record, and copy a tuple.
EFFECTS = record(*NO_EFFECTS._fields)


class Acting(NamedTuple):
    """What acts between wheel and soil beside the base model.

    All three are None where nothing acts, which compiles to no code. Where anything acts all three
    are there, neutral if need be (`acting_on`).
    """

    effects: Any  # `EFFECTS` or None
    law: ShearLaw | None  # None: Janosi & Hanamoto, Eq. (10)
    residual: Any  # `RESIDUAL` or None


#: The base model of Eqs. (1)-(10).
BASE = Acting(None, None, None)


class Standing(NamedTuple):
    """How a wheel stands on the ground at the beginning of a step."""

    sinkage: float  # [m]
    speed: float  # V [m/s]
    rim_speed: float  # r w [m/s]
    weight: float  # [N] of the wheel with its share of the body, along the vertical
    sin_grade: float  # uphill positive
    passes: float  # 1 = fresh soil
    # [of its travel] sliding, >= 0, at which a steady pile of soil ahead of a braked wheel would be
    # as large as the present one
    braked: float
    load: float  # [N] normal to the ground, for tyre, grip and the pressure of `Passage`


class ExtraForces(NamedTuple):
    """Forces and depths beside the contact, at the slip and the speeds that a step begins with."""

    lift: float  # [m] depth excavated whatever the load, over the slip-sinkage ratio
    bulldozing: float  # [N] resistance of the soil ahead
    blades: float  # [N] thrust of the lugs of a wheel that slips, in full
    pull: float  # [N] of the residual law
    torque: float  # [N m] of the residual law
    unfelt: float  # [m] sinkage of the residual law, which is read and not felt


class Footing(NamedTuple):
    """What a wheel stands on during a step: integrals of the normal stress over its arc, the
    strength of the soil that it shears, the load.
    """

    theta1: float  # [rad] entry angle
    p_cos: float  # as in `ArcIntegrals`
    p_sin: float
    tan_phi: float
    cohesion: float  # [Pa]
    shear_modulus: float  # [m] at this length of contact
    carry: float  # `rim_flow` tan(phi), the factor on `carried_share`
    most_carried: float  # bound on the share of the travel speed at which soil is carried
    load: float  # [N] normal to the ground


class Reaction(NamedTuple):
    """Soil reaction at one motion, with its derivatives by travel speed V and rim speed u = r w.

    Suffixes _v and _u stand for these derivatives, here and below.
    """

    load: float  # [N], as in `Forces`
    drawbar_pull: float  # [N]
    torque: float  # [N m]
    sinkage_coefficient: float  # mobilised sinkage coefficient S [N/m^(n+2)]
    pull_v: float  # [N s/m]
    pull_u: float
    torque_v: float  # [N s]
    torque_u: float
    sinkage_coefficient_v: float
    sinkage_coefficient_u: float


NO_REACTION = Reaction(*[0.0] * len(Reaction._fields))


def acting_on(
    effects: Effects | None, residual: np.record | None = None, shear_ratio: float = 1.0
) -> Acting:
    """Pack effects and a residual law (a record `RESIDUAL`): `BASE` where both are None.

    Where one of them is None, the other comes with neutral effects or a law without terms.
    `shear_ratio`: radius at which soil is sheared over that of the contact. Lengths of the shear
    law are divided by it, as K is in `_soil_and_arc`.
    """
    if effects is None and residual is None:
        return BASE
    effects = NO_EFFECTS if effects is None else effects
    packed = np.array(effects, EFFECTS)[()]
    law = stretched(mobilisation(effects), 1.0 / shear_ratio)
    return Acting(packed, law, residual_law() if residual is None else residual)


@inlined
def lay_footing(nodes, arc, soil, load):
    """Lay the nodes of an `Arc` into the scratch `nodes`. Return its `Footing` on `soil`, as it is
    sheared, under a `load` [N].
    """
    p_cos, p_sin = lay_nodes(nodes, arc, soil.sinkage_exponent)
    most = most_carried(arc) if soil.rim_flow > 0.0 else 1.0  # 1: not read, no soil is carried
    return Footing(
        arc.theta1,
        p_cos,
        p_sin,
        soil.tan_phi,
        soil.cohesion,
        grown_modulus(soil.shear_modulus, soil, arc),
        soil.rim_flow * soil.tan_phi,
        most,
        load,
    )


@compiled
def carried_along(footing, speed, rim_speed):
    """(share of the travel speed at which soil is carried along the rim, its derivative by the
    travel speed V, that by the rim speed u [s/m]).

    Three zeros on soil that does not flow. The share is `carry` of the `Footing` times
    `carried_share`, held below `most_carried` of the `Footing`. `speed` is V and `rim_speed` u,
    in m/s.
    """
    if footing.carry == 0.0:
        return 0.0, 0.0, 0.0
    free, free_u, free_v = carried_share(rim_speed, speed, REST_SPEED)
    share, by_share, _ = held_below(footing.carry * free, footing.most_carried)
    by_free = footing.carry * by_share
    return share, by_free * free_v, by_free * free_u


@inlined
def soil_reaction(nodes, footing, speed, rim_speed, wheel, law):
    """`Reaction` of the contact alone at travel speed V and rim speed u [m/s]: Eqs. (1)-(3).

    Eq. (1) is solved for S at the present sinkage, so that the load stays what it is. `nodes` and
    `footing` are of `lay_footing`; `law` is a `ShearLaw`, or None for Eq. (10). rim, travel and
    direction are those of `motion_from_speeds`, with soil that is carried along the rim. u is the
    speed of the radius at which soil is sheared. Of `wheel`, a `RIG` of `simulation.world.wheel`,
    radius, width and tyre are read.
    """
    r = nodes.radius
    lever = wheel.radius if on_tyre(wheel) else r  # the tread of a tyre moves at its own r w
    b = wheel.width
    rb = r * b
    c = footing.cohesion
    tan_phi = footing.tan_phi
    # as `motion_from_speeds`, with derivatives
    square = rim_speed * rim_speed + REST_SPEED * REST_SPEED
    travel_v = 1.0 / math.sqrt(square)
    rim = rim_speed * travel_v
    travel = speed * travel_v
    rim_u = REST_SPEED * REST_SPEED * travel_v / square
    travel_u = -travel * rim_speed / square
    share, share_v, share_u = carried_along(footing, speed, rim_speed)
    rim += share * travel
    rim_v = share_v * travel + share * travel_v
    rim_u += share_u * travel + share * travel_u
    direction, direction_v = smoothed_sign(speed, REST_SPEED)
    p = footing.p_cos, footing.p_sin
    flows = footing.carry > 0.0
    q = shear_integrals(nodes, p, (rim, travel), footing.shear_modulus, law, flows)
    S = mobilised_sinkage_coefficient(q, footing.load, tan_phi, c, r, b, direction)
    f = forces(q, S, tan_phi, c, r, b, direction)

    # at the present S: through rim, travel and the direction
    rates = shear_rates(nodes, S * tan_phi, c)
    cos_v = rates.cos_rim * rim_v + rates.cos_travel * travel_v
    sin_v = rates.sin_rim * rim_v + rates.sin_travel * travel_v
    one_v = rates.one_rim * rim_v + rates.one_travel * travel_v
    cos_u = rates.cos_rim * rim_u + rates.cos_travel * travel_u
    sin_u = rates.sin_rim * rim_u + rates.sin_travel * travel_u
    one_u = rates.one_rim * rim_u + rates.one_travel * travel_u
    # through S, which keeps the load what it is
    shear_sin = S * tan_phi * q.pe_sin + c * q.e_sin
    bearing, bounded = bounded_bearing(q, tan_phi, direction)
    # where S is bounded it hardly changes
    by_load = 0.0 if bounded or S <= 0.0 else -1.0 / bearing
    S_v = by_load * (direction * sin_v + direction_v * shear_sin)
    S_u = by_load * (direction * sin_u)
    pull_by_S = rb * (tan_phi * q.pe_cos - direction * q.p_sin)
    torque_by_S = lever * rb * (tan_phi * q.pe)
    return Reaction(
        f.load,
        f.drawbar_pull,
        f.torque if r == lever else lever / r * f.torque,
        S,
        S_v * pull_by_S + rb * (cos_v - direction_v * S * q.p_sin),  # pull_v
        S_u * pull_by_S + rb * cos_u,  # pull_u
        S_v * torque_by_S + lever * rb * one_v,  # torque_v
        S_u * torque_by_S + lever * rb * one_u,  # torque_u
        S_v,
        S_u,
    )


@compiled
def ground_under(at, soil, wheel, acting):
    """(`SoilState` as it is sheared, `Arc`, `ExtraForces`) of a wheel whose state `at` is a
    `Standing`.

    `soil` is as a rut leaves it; the effects of `acting` are applied here. The forces of a residual
    law fade out towards rest and change sign in reverse.
    """
    slip = slip_ratio(at.rim_speed, at.speed, REST_SPEED)
    point = WorkingPoint(slip, at.sinkage, at.weight, abs(at.speed), at.passes, at.sin_grade)
    unfelt, pull, torque = residual_under(acting.residual, point, soil, wheel)
    moving = smoothed_sign(at.speed, REST_SPEED)[0] * at.weight
    pull *= moving
    torque *= moving * wheel.radius
    soil, arc, lift, bulldozing, blades = _soil_and_arc(at, slip, soil, wheel, acting.effects)
    return soil, arc, ExtraForces(lift, bulldozing, blades, pull, torque, unfelt * wheel.radius)


@compiled
def _gripped(soil, arc, load, wheel):
    """Soil as the tread of a wheel shears it: tan(phi) and cohesion times `gripping_share`; as it
    is for a wheel without a limit of grip (`wheel.grip` 0).

    The share of soil carried along the rim stays.
    """
    share = 1.0 if wheel.grip == 0.0 else gripping_share(soil, arc, load, wheel)
    return strengthened(soil, share, soil.shear_modulus)


@compiled
def _soil_and_arc(at, slip, soil, wheel, fx):
    """(`SoilState` as it is sheared, `Arc`, lift, bulldozing, blades), the last three as in
    `ExtraForces`, 0 without effects. `at` is a `Standing`, `wheel` a `RIG` (as in `soil_reaction`).

    Effects change the soil; the stress peak of a braked wheel is shifted (`braked_shift`). Lugs
    shear the soil at a larger radius: its strength is multiplied by `shear_ratio`, K divided by it.
    Last, the grip of the tread bounds the strength (`_gripped`).
    """
    if fx is None:
        shift = braked_shift(at.braked, soil)
        arc = arc_of(at.sinkage, slip, shift, at.load, None, wheel)
        return _gripped(soil, arc, at.load, wheel), arc, 0.0, 0.0, 0.0
    else:
        slide = abs(at.rim_speed - at.speed)
        pressure = at.load / (wheel.width * wheel.radius)
        passage = Passage(soil, slip, abs(at.speed), slide, at.passes, at.sin_grade, pressure)
        ground = soil_in_contact(soil, passage, fx)
        shift = braked_shift(at.braked, ground)
        arc = arc_of(at.sinkage, slip, shift, at.load, fx, wheel)
        sheared = soil_at_rim(ground, passage, fx)
        # stronger by the larger radius at which it is sheared; `_at_the_axle` has the longer lever
        ratio = wheel.shear_ratio
        sheared = strengthened(sheared, ratio, sheared.shear_modulus / ratio)
        return (
            _gripped(sheared, arc, at.load, wheel),
            arc,
            excavated_depth(slip, fx) / dug_ratio(slip, ground),  # z = ratio (z_w + lift)
            soil_resistance(at.sinkage, ground, wheel, fx),
            grousers.blade_thrust(arc.theta1, at.sinkage, ground, wheel, fx),
        )


@compiled
def reaction(nodes, footing, speed, rim_speed, wheel, extra, acting):
    """`Reaction` at the axle at travel speed V and rim speed u [m/s], with `ExtraForces` and the
    friction of the drivetrain.

    `nodes` and `footing` are of `lay_footing`, `acting` is an `Acting`. `wheel.rim_ratio` is the
    radius at which soil is sheared over that of the rim.
    """
    f = soil_reaction(nodes, footing, speed, wheel.rim_ratio * rim_speed, wheel, acting.law)
    return _at_the_axle(f, extra, speed, rim_speed, wheel, acting.effects)


@compiled
def _at_the_axle(f, extra, speed, rim_speed, wheel, fx):
    """`Reaction` at the axle, from the reaction `f` of the contact by `soil_reaction`.

    Without effects it is `f`. With them blades, bulldozing, residual forces and friction are added:
    `ExtraForces`, and `drive_friction`. Blades push at half the height of the lugs.

    The derivatives of `f` by u are by the speed of the radius where lugs shear the soil, which is
    `wheel.rim_ratio` times the rim speed. The torque of `f` has the radius of the contact as its
    lever, and `wheel.shear_ratio` times that is the lever of the shear.
    """
    if fx is None:
        return f
    else:
        rim_ratio = wheel.rim_ratio
        shear_ratio = wheel.shear_ratio
        lever = wheel.radius + 0.5 * wheel.grouser_height
        direction, direction_v = smoothed_sign(speed, REST_SPEED)
        slip, slip_u, slip_v = signed_slip(rim_speed, speed, REST_SPEED)
        thrust, slope = grousers.blades_at(extra.blades, slip)
        thrust_v = slope * slip_v
        thrust_u = slope * slip_u
        torque = shear_ratio * f.torque + lever * thrust + extra.torque
        torque_v = shear_ratio * f.torque_v + lever * thrust_v
        torque_u = shear_ratio * rim_ratio * f.torque_u + lever * thrust_u
        friction = drive_friction(torque, rim_speed / wheel.radius, REST_SPEED / wheel.radius, fx)
        by_torque = 1.0 + friction.by_torque
        return Reaction(
            f.load,
            f.drawbar_pull + thrust - direction * extra.bulldozing + extra.pull,
            torque + friction.torque,
            f.sinkage_coefficient,
            f.pull_v + thrust_v - direction_v * extra.bulldozing,  # pull_v
            rim_ratio * f.pull_u + thrust_u,  # pull_u
            by_torque * torque_v,  # torque_v
            by_torque * torque_u + friction.by_wheel_speed / wheel.radius,  # torque_u
            f.sinkage_coefficient_v,
            rim_ratio * f.sinkage_coefficient_u,
        )


@compiled
def moved(f, dv, du):
    """`Reaction` f to first order after changes `dv` of V and `du` of u [m/s]: pull, torque and S,
    which is at least 0; load and derivatives stay.
    """
    coefficient = (
        f.sinkage_coefficient + f.sinkage_coefficient_v * dv + f.sinkage_coefficient_u * du
    )
    return Reaction(
        f.load,
        f.drawbar_pull + f.pull_v * dv + f.pull_u * du,
        f.torque + f.torque_v * dv + f.torque_u * du,
        max(coefficient, 0.0),
        *f[4:],
    )
