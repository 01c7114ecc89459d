"""Reaction to one wheel, put together for tests as a substep of the simulation does it."""

from soil_env._numba.compiling import compiled_root
from soil_env.terramechanics.arc_integrals import integrals_of
from soil_env.terramechanics.contact import motion_from_speeds
from soil_env.terramechanics.reaction import REST_SPEED, at_the_axle, reaction_from


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
