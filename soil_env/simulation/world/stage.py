"""Stage of a step of eight wheels in lanes: the ground under them, the equations of motion, the soil's reaction.

The equations are those of `newton`, which solves them; the `Footing` is the ground in the middle of the stage, first
undisturbed and then as the wheel meets it.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from soil_env._numba.compiling import compiled_inline
from soil_env._numba.elementary import (
    below,
    chosen,
    half_sin_cos,
    larger,
    sine_of,
    smaller,
    where_less,
)
from soil_env._numba.lanes import COUNT, fill, from_array, to_array
from soil_env._numba.records import lane_record
from soil_env._numba.rows import Rows, rows, scratch_rows
from soil_env.parameters import SoilState
from soil_env.simulation.world.terrain import between_cells, ground_at
from soil_env.simulation.world.wheel import axle_of, course_of
from soil_env.terramechanics.arc_integrals import (
    NODE_COLUMNS,
    ArcFrame,
    Nodes,
    shear_integrals,
    store_nodes,
)
from soil_env.terramechanics.contact import motion_from_speeds
from soil_env.terramechanics.motor import motor
from soil_env.terramechanics.reaction import (
    REST_SPEED,
    Reaction,
    at_the_axle,
    ground_under,
    reaction_from,
)

MANY = 16 * COUNT  # wheels that `advance` takes at most
GAMMA = 1.0 - math.sqrt(0.5)  # duration of a stage over that of the step
LEAD = math.sqrt(
    2.0
)  # (1 - GAMMA) / GAMMA - 1: how far the second stage begins beyond the end of the first
SHORT = 0.1  # share of the rim speed up to which the first try is the foreseen speed


#: A control period.
Period: type[Rows] = rows(
    "Period",
    "start",
    "command",
    "by_speed",
    "left",
    "alive",
    "clean",
    "steps",
    "speed_before",
    "rim_before",
)
#: The ground in a substep: a `SoilState`, first undisturbed and then as the wheel meets it.
Footing: type[Rows] = rows("Footing", *SoilState._fields, "grade", "passes", "lift", "sinkage")
#: The equations of a substep; the last two are the speeds to try next.
_Equations: type[Rows] = rows(
    "_Equations",
    "speed0",
    "rim0",
    "gain_v",
    "weight_along",
    "load",
    "tan_phi",
    "cohesion",
    "shear_modulus",
    "command",
    "by_speed",
    *ArcFrame._fields,
    "bulldozing",
    "blades",
    "pull",
    "twist",
    "try_v",
    "try_u",
)
#: Newton's method on them: the best so far with its `Reaction`, then the state of the iteration.
_Newton: type[Rows] = rows(
    "_Newton",
    "v",
    "u",
    *Reaction._fields,
    "converged",
    "f1",
    "f2",
    "motor_slope",
    "norm",
    "before",
    "share",
    "tries",
    "passes",
)
# Scratch of a substep, for `Substep`. The last block is that of the wheels that take longer.
new_footing: Callable[[], Rows] = scratch_rows(Footing, MANY)
new_equations: Callable[[], Rows] = scratch_rows(_Equations, MANY + COUNT)
new_newton: Callable[[], Rows] = scratch_rows(_Newton, MANY + COUNT)
new_nodes: Callable[[], Rows] = scratch_rows(Nodes, (MANY // COUNT + 1) * NODE_COLUMNS)


class Substep(NamedTuple):
    """Scratch of a substep, made by the function that drives it: it is gone with that function's frame."""

    footing: object
    equations: object
    nodes: object
    newton: object


load_reaction, store_reaction, choose_reaction, same_reaction = lane_record(Reaction)
load_soil = lane_record(SoilState).load
_load_frame, _store_frame, _, _ = lane_record(ArcFrame)


@compiled_inline
def newton_step(f1, f2, cv, cu, dp_v, dp_u, torque_v, net_u):
    """(dV, du) of Newton's method for the residuals of implicit Euler; `net_u` = d(T - T_motor)/du."""
    a11 = 1.0 - cv * dp_v
    a12 = -cv * dp_u
    a21 = cu * torque_v
    a22 = 1.0 + cu * net_u
    det = a11 * a22 - a12 * a21
    det = chosen(below(1e-12, abs(det)), det, 1e-12)
    return -(a22 * f1 - a12 * f2) / det, -(a11 * f2 - a21 * f1) / det


@compiled_inline
def gather_ground(state, counts, first, block, period, g, courses, ruts, world, h):
    """The ground under eight wheels in the middle of a stage of h seconds, with what has been left in `ruts`."""
    for i in range(block, block + COUNT):
        k = first + i
        if period.alive[i] == 0.0:  # nobody there
            g.tan_phi[i] = g.cohesion[i] = g.shear_modulus[i] = g.sinkage_coefficient[
                i
            ] = g.sinkage_exponent[i] = 1.0
            g.dig_gain[i] = g.dig_recovery[i] = g.grade[i] = g.passes[i] = 0.0
            continue
        x = state.x[k] + 0.5 * h * state.speed[k]
        cell = counts.cell[k]
        course = course_of(k, world.axles)
        soil, grade, patch = ground_at(courses, course, x, counts.patch[k], world.border)
        counts.patch[k] = patch
        g.tan_phi[i] = soil.tan_phi
        g.cohesion[i] = soil.cohesion
        g.shear_modulus[i] = soil.shear_modulus
        g.sinkage_coefficient[i] = soil.sinkage_coefficient * between_cells(ruts.rut_factors, k, x)
        g.sinkage_exponent[i] = soil.sinkage_exponent
        g.dig_gain[i] = soil.dig_gain
        g.dig_recovery[i] = soil.dig_recovery
        g.grade[i] = grade
        again = 1.0 if ruts.rut[k, cell] > 0.0 else 0.0
        g.passes[i] = 1.0 + axle_of(k, world.axles) + again


@compiled_inline
def foreseen_rim(state, k, i, period, back_u, cu, world):
    """(residual [m/s], d(T - T_motor)/du) of the rotation of eight wheels, by the reaction of the last stage."""
    command = from_array(period.command, i)
    by_speed = from_array(period.by_speed, i)
    torque, slope, _ = motor(command, by_speed, from_array(state.wheel_speed, k), world)
    net = from_array(state.torque_by_rim, k) - slope / world.wheel.radius
    return back_u - cu * (torque - from_array(state.torque, k)), net


@compiled_inline
def _foreseen(state, k, i, period, back_v, back_u, cv, cu, weight_along, world):
    """Change of the speeds [m/s] of eight wheels in a stage, by the reaction of the last one to first order.

    The stage begins at speeds that lie `back_v`, `back_u` behind those that the wheels have.
    """
    f2, net = foreseen_rim(state, k, i, period, back_u, cu, world)
    return newton_step(
        back_v - cv * (from_array(state.drawbar_pull, k) - weight_along),
        f2,
        cv,
        cu,
        from_array(state.pull_by_speed, k),
        from_array(state.pull_by_rim, k),
        from_array(state.torque_by_speed, k),
        net,
    )


@compiled_inline
def held_change(du, state, k, i, period, world):
    """Size of a foreseen change `du` [m/s] of the rim speeds of eight wheels: a speed loop stops at its command."""
    r = world.wheel.radius
    follow = abs(
        from_array(period.command, i) * (r * world.no_load_speed)
        - r * from_array(state.wheel_speed, k)
    )
    return where_less(0.5, from_array(period.by_speed, i), smaller(abs(du), follow), abs(du))


@compiled_inline
def change_ahead(state, k, i, period, world, h):
    """Foreseen change of the speeds [of the top rim speed] of eight wheels in h seconds under their commands."""
    r = world.wheel.radius
    mass = from_array(state.mass, k)
    along = world.wheel.gravity * mass * sine_of(from_array(state.grade, k))
    still = fill(0.0)
    dv, du = _foreseen(
        state, k, i, period, still, still, h / mass, h * r / world.inertia, along, world
    )
    return larger(abs(dv), held_change(du, state, k, i, period, world)) / (r * world.no_load_speed)


@compiled_inline
def set_up(state, first, i, period, sub, world, h, lead, duration):
    """The equations of a stage of the eight wheels from column i on, and where Newton's method starts.

    The stage begins at speeds that lie beyond the present ones by `lead` times the change in the stage before.
    """
    e = sub.equations
    k = first + i
    stand(state, first, i, sub, world, duration)
    cv = h / from_array(state.mass, k)
    cu = h * world.wheel.radius / world.inertia
    speed0 = from_array(state.speed, k)
    u0 = world.wheel.radius * from_array(state.wheel_speed, k)
    back_v, back_u = behind(state, k, i, period, world, lead)
    dv, du = _foreseen(
        state, k, i, period, back_v, back_u, cv, cu, from_array(e.weight_along, i), world
    )
    short = below(larger(abs(dv), abs(du)), SHORT * (abs(u0) + REST_SPEED))
    to_array(cv, e.gain_v, i)
    to_array(speed0 - back_v, e.speed0, i)
    to_array(u0 - back_u, e.rim0, i)
    to_array(from_array(period.command, i), e.command, i)
    to_array(from_array(period.by_speed, i), e.by_speed, i)
    to_array(speed0 + short * dv, e.try_v, i)
    to_array(u0 + short * du, e.try_u, i)


@compiled_inline
def behind(state, k, i, period, world, lead):
    """Differences [m/s] from the speeds that a stage begins with to the present ones, of eight wheels."""
    if lead == 0.0:
        return fill(0.0), fill(0.0)
    rim = world.wheel.radius * from_array(state.wheel_speed, k)
    return (
        lead * (from_array(period.speed_before, i) - from_array(state.speed, k)),
        lead * (from_array(period.rim_before, i) - rim),
    )


@compiled_inline
def stand(state, first, i, sub, world, duration):
    """Set arc, soil and load under eight wheels in a stage, with the weight that pulls along the grade.

    Sinkage is that at the end of the stage if it goes on as in the stage before, over the `duration` [s] of this one.
    """
    wheel = world.wheel
    e = sub.equations
    g = sub.footing
    k = first + i
    speed0 = from_array(state.speed, k)
    u0 = wheel.radius * from_array(state.wheel_speed, k)
    sinkage = from_array(state.sinkage, k)
    weight = wheel.gravity * from_array(state.mass, k)
    sin_half, cos_half = half_sin_cos(from_array(g.grade, i))
    sine = 2.0 * sin_half * cos_half
    ahead = duration * from_array(state.sinking, k)
    sinkage = sinkage + smaller(larger(ahead, -0.1 * sinkage), 0.1 * sinkage)
    to_array(sinkage, g.sinkage, i)
    ground = ground_under(
        sinkage, speed0, u0, weight, load_soil(g, i), sine, from_array(g.passes, i), wheel
    )
    soil = ground.soil
    frame = store_nodes(ground.arc, soil.sinkage_exponent, sub.nodes, (i // COUNT) * NODE_COLUMNS)
    _store_frame(frame, e, i)
    to_array(weight * sine, e.weight_along, i)
    to_array(weight * (1.0 - 2.0 * sin_half * sin_half), e.load, i)
    to_array(soil.tan_phi, e.tan_phi, i)
    to_array(soil.cohesion, e.cohesion, i)
    to_array(soil.shear_modulus, e.shear_modulus, i)
    if wheel.on:
        to_array(ground.bulldozing, e.bulldozing, i)
        to_array(ground.blades, e.blades, i)
        to_array(ground.pull, e.pull, i)
        to_array(ground.torque, e.twist, i)
        to_array(ground.lift, g.lift, i)
        to_array(soil.sinkage_coefficient, g.sinkage_coefficient, i)
        to_array(soil.sinkage_exponent, g.sinkage_exponent, i)
        to_array(soil.dig_gain, g.dig_gain, i)
        to_array(soil.dig_recovery, g.dig_recovery, i)


@compiled_inline
def reaction_at(v, u, sub, i, wheel):
    """`Reaction` at the axle of eight wheels at travel speeds v and rim speeds u [m/s]."""
    e = sub.equations
    rim = wheel.rim_ratio * u
    motion = motion_from_speeds(rim, v, REST_SPEED)
    integrals = shear_integrals(
        _load_frame(e, i),
        sub.nodes,
        (i // COUNT) * NODE_COLUMNS,
        motion[0],
        motion[1],
        from_array(e.shear_modulus, i),
        wheel.contact_radius,
        wheel.law,
    )
    f = reaction_from(
        integrals,
        motion,
        v,
        rim,
        from_array(e.load, i),
        from_array(e.tan_phi, i),
        from_array(e.cohesion, i),
        wheel.contact_radius,
        wheel.width,
    )
    if wheel.on:
        f = at_the_axle(
            f,
            from_array(e.bulldozing, i),
            from_array(e.blades, i),
            from_array(e.pull, i),
            from_array(e.twist, i),
            v,
            u,
            wheel,
        )
    return f
