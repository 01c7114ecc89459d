"""Reaction to one wheel, or to eight in lanes, put together for tests as a substep of the simulation does it."""

from soil_env._numba.compiling import root
from soil_env._numba.lanes import from_array, to_array
from soil_env._numba.rows import scratch_rows
from soil_env.parameters import SoilState
from soil_env.terramechanics.arc_integrals import (
    NODE_COLUMNS,
    Nodes,
    integrals_of,
    shear_integrals,
    store_nodes,
)
from soil_env.terramechanics.contact import (
    motion_from_speeds,
)
from soil_env.terramechanics.reaction import REST_SPEED, at_the_axle, ground_under, reaction_from

_nodes = scratch_rows(Nodes, NODE_COLUMNS)


@root
def react(ground, v, u, load, wheel):
    """`Reaction` at the axle of a wheel on its `Ground`, at travel speed v and rim speed u [m/s], carrying `load`."""
    rim, soil = wheel.rim_ratio * u, ground.soil
    motion = motion_from_speeds(rim, v, REST_SPEED)
    integrals = integrals_of(ground.arc, motion[0], motion[1], soil.shear_modulus, soil.sinkage_exponent, wheel.law)
    f = reaction_from(
        integrals, motion, v, rim, load, soil.tan_phi, soil.cohesion, wheel.contact_radius, wheel.width
    )  # fmt: skip
    return at_the_axle(f, ground.bulldozing, ground.blades, ground.pull, ground.torque, v, u, wheel)


@root
def ground_in_lanes(x, wheel, out):
    """`Ground` under eight wheels; rows of x [13, 8]: as the arguments of `ground_under`, those of `SoilState` last."""
    soil = SoilState(
        from_array(x, 48), from_array(x, 56), from_array(x, 64), from_array(x, 72), from_array(x, 80),
        from_array(x, 88), from_array(x, 96),
    )  # fmt: skip
    ground = ground_under(
        from_array(x, 0), from_array(x, 8), from_array(x, 16), from_array(x, 24), soil, from_array(x, 32),
        from_array(x, 40), wheel,
    )  # fmt: skip
    to_array(ground.soil.tan_phi, out, 0)
    to_array(ground.soil.cohesion, out, 8)
    to_array(ground.soil.shear_modulus, out, 16)
    to_array(ground.soil.sinkage_coefficient, out, 24)
    to_array(ground.soil.sinkage_exponent, out, 32)
    to_array(ground.soil.dig_gain, out, 40)
    to_array(ground.soil.dig_recovery, out, 48)
    to_array(ground.arc.theta1, out, 56)
    to_array(ground.arc.theta2, out, 64)
    to_array(ground.arc.thetam, out, 72)
    to_array(ground.arc.sheared_from, out, 80)
    to_array(ground.lift, out, 88)
    to_array(ground.bulldozing, out, 96)
    to_array(ground.blades, out, 104)
    to_array(ground.pull, out, 112)
    to_array(ground.torque, out, 120)


@root
def react_in_lanes(x, speeds, wheel, out):
    """`Reaction` at the axle of eight wheels on the ground of `ground_in_lanes`; rows of `speeds`: v, u, load."""
    soil = SoilState(
        from_array(x, 48), from_array(x, 56), from_array(x, 64), from_array(x, 72), from_array(x, 80),
        from_array(x, 88), from_array(x, 96),
    )  # fmt: skip
    ground = ground_under(
        from_array(x, 0), from_array(x, 8), from_array(x, 16), from_array(x, 24), soil, from_array(x, 32),
        from_array(x, 40), wheel,
    )  # fmt: skip
    v, u, load, nodes, soil = (
        from_array(speeds, 0),
        from_array(speeds, 8),
        from_array(speeds, 16),
        _nodes(),
        ground.soil,
    )
    rim = wheel.rim_ratio * u
    motion = motion_from_speeds(rim, v, REST_SPEED)
    frame = store_nodes(ground.arc, soil.sinkage_exponent, nodes, 0)
    integrals = shear_integrals(
        frame, nodes, 0, motion[0], motion[1], soil.shear_modulus, wheel.contact_radius, wheel.law
    )  # fmt: skip
    f = reaction_from(
        integrals, motion, v, rim, load, soil.tan_phi, soil.cohesion, wheel.contact_radius, wheel.width
    )  # fmt: skip
    f = at_the_axle(f, ground.bulldozing, ground.blades, ground.pull, ground.torque, v, u, wheel)
    to_array(f.load, out, 0)
    to_array(f.drawbar_pull, out, 8)
    to_array(f.torque, out, 16)
    to_array(f.modulus, out, 24)
    to_array(f.dp_v, out, 32)
    to_array(f.dp_u, out, 40)
    to_array(f.torque_v, out, 48)
    to_array(f.torque_u, out, 56)
    to_array(f.modulus_v, out, 64)
    to_array(f.modulus_u, out, 72)
