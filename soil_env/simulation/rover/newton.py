"""Newton's method for the speeds of a stage of a step of a rover: one of travel, one of rotation an
axle.

The equation of each axle has its own rim speed and V only. A step of Newton's method is
therefore the elimination of all rim speeds, at a cost that is linear in the axles. Stages and
reaction are those of `simulation.world`.

`world` is a `RoverWorld`, `equation` the `Equation` of the stage, `weight` [N] that of one side,
normal to the body. Masses and forces are those of one side, with one wheel an axle. What a function
leaves in `feet`, `found` and `trial` it leaves in `world.stage` (`STAGE`).
"""

from typing import Any, NamedTuple

from soil_env._compiled.elementary import sin_cos
from soil_env._compiled.flags import HUGE, compiled_finite, inlined, put_fields, record
from soil_env.parameters import MOST_AXLES, SoilState
from soil_env.simulation.world.newton import (
    LASTING,
    LEAST_GAIN,
    PASSES,
    SHORT,
    SHORTER,
    TOLERANCE,
    TRIES,
    divisor,
    near_enough,
)
from soil_env.terramechanics.contact import ARC_NODES
from soil_env.terramechanics.motor import motor_torque
from soil_env.terramechanics.reaction import (
    REST_SPEED,
    Acting,
    ExtraForces,
    Footing,
    Reaction,
    reaction,
)

from .body import LOAD_TOLERANCE, axle_loads, weight_of

# [-] solutions of a stage at most, each with the axle loads that follow from the forces of the one
# before; the last is kept
TURNS = 4

# fields of a soil that a footing does not have too: `FOOT` has each name once
_NOT_SHEARED = [name for name in SoilState._fields if name not in Footing._fields]
#: What the wheel of an axle is to do in a control period and what it stands on in a stage. It has
#: the fields of a `Drive`, a `Footing`, an `ExtraForces` and the `SoilState` of a `Ground`, whose
#: strength and K are those of the footing.
FOOT = record(
    "start",  # [m] where the control period began
    "speed_before",  # [m/s] V at the beginning of the step
    "rim_before",  # [m/s] r w there
    "rim_start",  # u* [m/s] of the stage
    "command",  # at the end of the stage
    "asked",  # at the end of the control period
    "before",  # at its beginning
    "sinkage",  # [m] that the arc is laid at
    "rolled",  # [m] depth of the rut of earlier passes, where the contact begins
    "grade",  # [rad]
    "along",  # [N] weight along the grade
    *Footing._fields,
    *_NOT_SHEARED,
    *ExtraForces._fields,
    by_speed=("i8",),
)
_OF_REACTION = Reaction._fields
#: Rotation of an axle at some speeds, with the `Reaction` there.
TURNING = record(
    "rim",  # u [m/s]
    "residual",  # [m/s] of its equation
    "motor_slope",  # d T_motor/dw [N m s]
    "change",  # [m/s] of u in a step of Newton's method
    "change_v",  # [-] of u with V in such a step
    *_OF_REACTION,
)


#: Scratch of a thread for a stage of a rover, one row an axle.
STAGE = record(
    nodes=(ARC_NODES, MOST_AXLES),
    feet=(FOOT, MOST_AXLES),
    found=(TURNING, MOST_AXLES),  # the best so far
    trial=(TURNING, MOST_AXLES),
)


class RoverWorld(NamedTuple):
    """What a rover is simulated with."""

    rig: Any  # `RIG` of each wheel
    acting: Acting
    suspension: Any  # `SUSPENSION`
    stage: Any  # `STAGE`


class Equation(NamedTuple):
    """Implicit Euler at the end of a stage: where V begins, and changes of speed by forces."""

    speed: float  # V* [m/s]
    by_pull: float  # h/M [s/kg], change of V by a pull on the rover
    by_torque: float  # h r/J [1/(N s)], change of u = r w by a torque on an axle


@compiled_finite
def equation_of(speed, duration, mass, rig):
    """`Equation` of a rover of this `mass` [kg], for implicit Euler over `duration` [s] from
    V* = `speed` [m/s].
    """
    return Equation(speed, duration / mass, duration * rig.radius / rig.inertia)


@compiled_finite
def newton_step(residual, equation, world):
    """dV [m/s] of a step of Newton's method from the speeds in `found`; each axle of `found` gets
    the `change` of its rim speed.

    `residual` [m/s] is that of the equation of travel. The changes of the rim speeds are
    eliminated, which leaves one equation in dV.
    """
    found = world.stage.found
    r = world.rig.radius
    slope = 1.0
    for a in range(world.suspension.axles):
        f = found[a]
        per_pivot = 1.0 / divisor(1.0 + equation.by_torque * (f.torque_u - f.motor_slope / r))
        f.change = -f.residual * per_pivot
        f.change_v = -equation.by_torque * f.torque_v * per_pivot
        slope -= equation.by_pull * (f.pull_v + f.pull_u * f.change_v)
        residual -= equation.by_pull * f.pull_u * f.change
    dv = -residual / divisor(slope)
    for a in range(world.suspension.axles):
        found[a].change += found[a].change_v * dv
    return dv


@compiled_finite
def foresee(rover, equation, world):
    """dV [m/s] of a rover from its present speed to the end of a stage, by the reactions of the
    last stage to first order.

    `found` gets those reactions (`LASTING`) and the `change` of u of each axle, likewise from the
    present rim speed. The stage begins at V* of `equation` and at `rim_start` of each axle.
    """
    rig = world.rig
    residual = rover.wheels[0].speed - equation.speed
    for a in range(world.suspension.axles):
        wheel = rover.wheels[a]
        foot = world.stage.feet[a]
        found = world.stage.found[a]
        put_fields(found, wheel, LASTING)
        torque, slope = motor_torque(foot.command, foot.by_speed > 0, wheel.wheel_speed, rig)
        found.rim = rig.radius * wheel.wheel_speed
        found.residual = found.rim - foot.rim_start - equation.by_torque * (torque - wheel.torque)
        found.motor_slope = slope
        # by the grade of the last stage, since `foot.along` of this one may not be known yet
        along = rig.gravity * wheel.mass * sin_cos(wheel.grade)[0]
        residual -= equation.by_pull * (wheel.drawbar_pull - along)
    return newton_step(residual, equation, world)


@inlined
def _begin(rover, equation, weight, world):
    """First V to try in a stage [m/s]; `trial` gets the rim speeds to try, `feet` the axle loads.

    The speeds are the foreseen ones where no foreseen change is more than `SHORT` of the rim speed,
    else the present ones. The loads balance the forces foreseen there, or those of the last stage.
    """
    s = world.suspension
    found = world.stage.found
    trial = world.stage.trial
    dv = foresee(rover, equation, world)
    short = True
    for a in range(s.axles):
        change = max(abs(dv), abs(found[a].change))
        short = short and change < SHORT * (abs(found[a].rim) + REST_SPEED)
    for a in range(s.axles):
        f = found[a]
        trial[a].rim = f.rim
        if short:
            f.drawbar_pull += f.pull_v * dv + f.pull_u * f.change
            f.torque += f.torque_v * dv + f.torque_u * f.change
            trial[a].rim += f.change
    loads = axle_loads(found, weight, s)
    for a in range(s.axles):
        world.stage.feet[a].load = loads[a]
    speed = rover.wheels[0].speed
    return speed + dv if short else speed


@inlined
def _evaluate(v, equation, world):
    """(residual of travel, largest residual) [m/s] at V = `v` and the rim speeds in `trial`.

    `trial` gets the reaction and the residual of each axle there.
    """
    rig = world.rig
    pull = 0.0
    largest = 0.0
    for a in range(world.suspension.axles):
        foot = world.stage.feet[a]
        trial = world.stage.trial[a]
        u = trial.rim
        force = reaction(world.stage.nodes[a], foot, v, u, rig, foot, world.acting)
        torque, slope = motor_torque(foot.command, foot.by_speed > 0, u / rig.radius, rig)
        put_fields(trial, force, _OF_REACTION)
        trial.residual = u - foot.rim_start - equation.by_torque * (torque - force.torque)
        trial.motor_slope = slope
        pull += force.drawbar_pull - foot.along
        largest = max(largest, abs(trial.residual))
    residual = v - equation.speed - equation.by_pull * pull
    return residual, max(largest, abs(residual))


@inlined
def _largest_change(v, equation, world):
    """Largest change [m/s] of a speed since the beginning of the stage, at V = `v` [m/s] and the
    rim speeds in `found`.
    """
    change = abs(v - equation.speed)
    for a in range(world.suspension.axles):
        change = max(change, abs(world.stage.found[a].rim - world.stage.feet[a].rim_start))
    return change


@inlined
def _iterate(v, equation, world):
    """(V, True if converged) by Newton's method at the present loads, from `v` and the rim speeds
    in `trial`.

    As in `world.newton`, a step that does not reduce the largest residual is shortened. `found`
    gets the rim speeds and reactions at the V returned, the best one found. Not converged: `PASSES`
    evaluations were not enough, or no shorter step helps and the residual is not `near_enough`.
    """
    axles = world.suspension.axles
    found = world.stage.found
    trial = world.stage.trial
    try_v = v
    dv = 0.0
    norm = HUGE
    share = 1.0
    tries = 0
    for _ in range(PASSES):
        residual, reached = _evaluate(try_v, equation, world)
        last = tries == TRIES - 1
        if reached < norm * (1.0 if last else 1.0 - LEAST_GAIN * share):
            v = try_v
            norm = reached
            share = 1.0
            tries = 0
            for a in range(axles):
                found[a] = trial[a]
            if norm < TOLERANCE:
                return v, True
            dv = newton_step(residual, equation, world)
        elif last:
            return v, near_enough(norm, _largest_change(v, equation, world))
        else:
            share *= SHORTER
            tries += 1
        try_v = v + share * dv
        for a in range(axles):
            trial[a].rim = found[a].rim + share * found[a].change
    return v, False


@inlined
def _renew_changed_loads(weight, world):
    """Set all loads to those that balance the forces found, if one of them changes by more than
    `LOAD_TOLERANCE` of the mean load; True if so.

    `trial` is then set to the rim speeds found, which are tried next.
    """
    s = world.suspension
    feet = world.stage.feet
    found = world.stage.found
    trial = world.stage.trial
    loads = axle_loads(found, weight, s)
    changed = False
    for a in range(s.axles):
        change = abs(loads[a] - feet[a].load)
        changed = changed or change > LOAD_TOLERANCE / s.axles * weight
    if changed:
        for a in range(s.axles):
            feet[a].load = loads[a]
            trial[a].rim = found[a].rim
    return changed


@compiled_finite
def solve_speeds(rover, equation, world):
    """(V [m/s], True if the speeds converged) at the end of a stage; `found` gets the rim speeds
    and the reactions.

    Speeds are solved at fixed axle loads, at most `TURNS` times, with the loads renewed from the
    forces in between, but not after the last time: True says nothing of whether they settled.
    """
    weight = weight_of(rover, world.rig.gravity)
    v = _begin(rover, equation, weight, world)
    for turn in range(TURNS):
        v, converged = _iterate(v, equation, world)
        if turn == TURNS - 1 or not converged or not _renew_changed_loads(weight, world):
            break
    return v, converged
