"""Reaction to one wheel, or to eight in lanes, put together for tests as a substep of the simulation does it."""

from soil_env._numba.compiling import compiled_inline, compiled_root
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


@compiled_root
def react(ground, v, u, load, wheel):
    """`Reaction` at the axle of a wheel on its `Ground`, at travel speed v and rim speed u [m/s], carrying `load`."""
    rim, soil = wheel.rim_ratio * u, ground.soil
    motion = motion_from_speeds(rim, v, REST_SPEED)
    integrals = integrals_of(ground.arc, motion[0], motion[1], soil.shear_modulus, soil.sinkage_exponent, wheel.law)
    f = reaction_from(
        integrals, motion, v, rim, load, soil.tan_phi, soil.cohesion, wheel.contact_radius, wheel.width
    )  # fmt: skip
    return at_the_axle(f, ground.bulldozing, ground.blades, ground.pull, ground.torque, v, u, wheel)


@compiled_inline
def grounds(x, wheel):
    """`Ground` under eight wheels; rows of x [13, 8]: as the arguments of `ground_under`, those of `SoilState` last."""
    soil = SoilState(
        from_array(x, 48), from_array(x, 56), from_array(x, 64), from_array(x, 72), from_array(x, 80),
        from_array(x, 88), from_array(x, 96),
    )  # fmt: skip
    return ground_under(
        from_array(x, 0), from_array(x, 8), from_array(x, 16), from_array(x, 24), soil, from_array(x, 32),
        from_array(x, 40), wheel,
    )  # fmt: skip


@compiled_root
def react_in_lanes(x, speeds, wheel, out):
    """`Reaction` at the axle of eight wheels on `grounds` as the rows of out [10, 8]; of `speeds`: v, u, load."""
    ground, nodes = grounds(x, wheel), _nodes()
    v, u, load = from_array(speeds, 0), from_array(speeds, 8), from_array(speeds, 16)
    rim, soil = wheel.rim_ratio * u, ground.soil
    motion = motion_from_speeds(rim, v, REST_SPEED)
    frame = store_nodes(ground.arc, soil.sinkage_exponent, nodes, 0)
    integrals = shear_integrals(
        frame, nodes, 0, motion[0], motion[1], soil.shear_modulus, wheel.contact_radius, wheel.law
    )  # fmt: skip
    f = reaction_from(
        integrals, motion, v, rim, load, soil.tan_phi, soil.cohesion, wheel.contact_radius, wheel.width
    )  # fmt: skip
    f = at_the_axle(f, ground.bulldozing, ground.blades, ground.pull, ground.torque, v, u, wheel)
    for i in range(10):
        to_array(f[i], out, 8 * i)
