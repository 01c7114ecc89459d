"""One control period of a wheel: two implicit stages a step, short steps where needed.

The method: `newton` and docs/physics/wheel.md. A wheel whose speeds are about to change takes 2, 4
or 8 steps where others take one. Where its iteration fails, the step is halved, down to the
`FINEST` part.

`drive` is a `Drive`, `stage` a `Stage`, `rig` a `RIG` and `world` a `World` throughout.
"""

import math
from typing import NamedTuple

from soil_env._compiled.elementary import sin_cos, smoothed_sign
from soil_env._compiled.flags import compiled_finite, inlined, put_fields
from soil_env.slip import braked_share
from soil_env.terramechanics.effects.multipass import in_rut
from soil_env.terramechanics.ground import below_rut
from soil_env.terramechanics.motor import motor_torque
from soil_env.terramechanics.reaction import (
    REST_SPEED,
    ExtraForces,
    Footing,
    Standing,
    ground_under,
    lay_footing,
)

from .newton import LASTING, Stage, foreseen, solve_speeds
from .routes import choosing, plan_halt, set_route
from .terrain import find_ground, in_cell, pass_at, rut_at
from .wheel import (
    Ahead,
    Ground,
    Path,
    at_time,
    begin_period,
    commanded,
    end_period,
    leave_ruts,
    pile_up,
    set_slip,
    sink,
)

GAMMA = 1.0 - math.sqrt(0.5)  # [-] duration of the implicit Euler in a stage over that of the step
# [-] (1 - GAMMA)/GAMMA - 1: how far the second stage begins beyond the end of the first
LEAD = math.sqrt(2.0)
# [-] a step that fails is halved until it has at most 1/FINEST of its length, where it is taken
# all the same; softening soil breaks away within 1 ms
FINEST = 1024
# Foreseen changes of speed [of the top rim speed] beyond which a wheel takes 2, 4 and 8 steps where
# others take one; own choice.
REFINED_TWICE = 0.3
REFINED_FOUR_TIMES = 0.6
REFINED_EIGHT_TIMES = 1.2
OVER = 1e-9  # [of a step] time left that counts as none
# [of the sinkage] below the rut of earlier passes that a wheel has at least; own choice: it falls
# to the floor of the rut within some milliseconds
LEAST_BELOW = 1e-2
LARGEST_CHANGE = 0.1  # [of the sinkage] that is foreseen in a stage, up or down; own choice


class Stand(NamedTuple):
    """A wheel on the ground in a stage of a step."""

    ground: Ground
    footing: Footing
    extra: ExtraForces
    along: float  # [N] weight along the grade


@inlined
def steps_for(change):
    """Number of steps that replace one of the usual length: 1, 2, 4 or 8, more for a larger
    foreseen `change` of a speed [of the top rim speed].
    """
    if change <= REFINED_TWICE:
        return 1
    if change <= REFINED_FOUR_TIMES:
        return 2
    return 4 if change <= REFINED_EIGHT_TIMES else 8


@inlined
def loop_change(du, wheel, drive, rig):
    """Size [m/s], >= 0, of a foreseen change `du` [m/s] of the rim speed; with a speed loop at most
    the difference to its command, where the change stops.

    `drive`: a `Drive`, or the `FOOT` of an axle, which has its fields.
    """
    if not drive.by_speed:
        return abs(du)
    command = drive.command * (rig.radius * rig.no_load_speed)
    return min(abs(du), abs(command - rig.radius * wheel.wheel_speed))


@compiled_finite
def change_ahead(wheel, drive, rig):
    """Foreseen change of V or of r w, the larger one [of the top rim speed], in a step of the usual
    length. It is foreseen by the reaction of the last stage; that of r w goes through
    `loop_change`.
    """
    along = rig.gravity * wheel.mass * sin_cos(wheel.grade)[0]
    dv, du = foreseen(wheel, drive, 0.0, 0.0, rig.period / rig.substeps, along, rig)
    return max(abs(dv), loop_change(du, wheel, drive, rig)) / (rig.radius * rig.no_load_speed)


@inlined
def stage_of(number, h, wheel, speed_before, rim_before, rig):
    """`Stage` of this `number`, 0 or 1, of a step of h seconds, at whose beginning the `wheel` is.

    `speed_before`, `rim_before` [m/s]: V and u = r w at the beginning of the step. V* and u* of
    stage 1 lie `LEAD` times the change in stage 0 beyond its end (docs/physics/wheel.md). Stage 0
    lasts `GAMMA` h, stage 1 the rest; either ends in an implicit Euler of `GAMMA` h.
    """
    g = GAMMA * h
    speed = wheel.speed
    rim = rig.radius * wheel.wheel_speed
    if number == 0:
        return Stage(g, 0.0, g, g, speed, rim)  # all of its way at its last speed
    ahead_v = speed + LEAD * (speed - speed_before)
    ahead_u = rim + LEAD * (rim - rim_before)
    return Stage(h - g, h - 2.0 * g, g, g, ahead_v, ahead_u)


@compiled_finite
def ground_ahead(wheel, stage, course, cells, border, effects):
    """Ground `Ahead` at the middle of the way of a wheel in a stage, foreseen by its present speed.

    The soil there is that of the course, between two patches blended within `border` [m]. In a rut
    its firm ground is nearer by the depth of all ruts, those of wheels ahead and its own
    (`rolled`), and the passes stiffen it. `cells`: `RUT` of the wheel; `effects`: `Effects` that
    act in the world, or None. `wheel.patch` and `wheel.slope` are set to the indices there.
    """
    x = wheel.x + 0.5 * stage.duration * wheel.speed
    soil, grade = find_ground(wheel, course, x, border)
    passes = pass_at(cells, x)
    floor, rolled = rut_at(cells, x)
    if floor + rolled > 0.0:
        soil = below_rut(soil, floor + rolled)
    return Ahead(in_rut(soil, passes, effects), grade, passes, rolled)


@inlined
def foreseen_sinkage(wheel, duration, rolled):
    """Sinkage [m] below the rut of earlier passes, `rolled` [m] deep, at the end of a stage, if it
    goes on at the rate of the stage before.

    The change is at most `LARGEST_CHANGE` of the sinkage. At least `LEAST_BELOW` of the sinkage is
    below the rut. `duration` in s.
    """
    most = LARGEST_CHANGE * wheel.sinkage
    ahead = wheel.sinkage + min(max(duration * wheel.sinking, -most), most)
    return max(ahead - rolled, LEAST_BELOW * wheel.sinkage)


@inlined
def account(wheel, end, stage, drive, rig):
    """Add the work [J] of motor, soil and integrator in a stage to the sums of the period, and set
    the torque of the motor at its end.

    The work is that from the present speeds to the `Motion` `end`. The stage begins at V* and ends
    at V'; d = V' - V*, and e = V* - V is the lead over the present speed. The integrator takes
    m (d^2 - e^2)/2, and for the rotation J/r^2 (d^2 - e^2)/2 with d and e of the rim speed. By this
    the work of the forces exceeds the gain of kinetic energy.
    """
    r = rig.radius
    turning = wheel.wheel_speed
    turning_after = end.rim / r
    torque, _ = motor_torque(drive.command, drive.by_speed, turning_after, rig)
    force = end.force
    wheel.motor_work += stage.first * wheel.motor_torque * turning
    wheel.motor_work += stage.last * torque * turning_after
    wheel.soil_work += stage.first * (wheel.torque * turning - wheel.drawbar_pull * wheel.speed)
    wheel.soil_work += stage.last * (force.torque * turning_after - force.drawbar_pull * end.speed)
    lead_v = stage.speed - wheel.speed
    lead_u = stage.rim - r * turning
    change_v = end.speed - stage.speed
    change_u = end.rim - stage.rim
    travelling = wheel.mass * (change_v * change_v - lead_v * lead_v)
    rotating = rig.inertia / (r * r) * (change_u * change_u - lead_u * lead_u)
    wheel.numerical_work += 0.5 * (travelling + rotating)
    wheel.motor_torque = torque


@inlined
def move(wheel, end, stage, ground, drive, rig):
    """Take a wheel to the `end` of a stage, a `Motion`: sinkage and place (`sink`), pile, work
    (`account`), then grade, speeds, forces and their derivatives.

    The way [m] is the present speed times `stage.first` plus that at the end times `stage.last`;
    the sliding |r w - V| is summed in the same way. `converged` becomes 0 where Newton's method has
    failed. `drive`: the command to the motor, a `Drive` or a `FOOT`.
    """
    rim = rig.radius * wheel.wheel_speed
    moved = stage.first * wheel.speed + stage.last * end.speed
    slid = stage.first * abs(rim - wheel.speed) + stage.last * abs(end.rim - end.speed)
    force = end.force
    sink(wheel, ground, force.sinkage_coefficient, Path(moved, slid, stage.duration), rig)
    pile_up(wheel, braked_share(end.rim, end.speed, REST_SPEED), moved, rig)
    account(wheel, end, stage, drive, rig)
    wheel.speed = end.speed
    wheel.wheel_speed = end.rim / rig.radius
    wheel.grade = ground.grade
    wheel.unfelt = ground.unfelt
    put_fields(wheel, force, LASTING)
    if not end.converged:
        wheel.converged = 0


@inlined
def stand(wheel, stage, ahead, load, world):
    """Stand a wheel on the ground `Ahead` for a stage: return its `Stand`, and lay the nodes of its
    arc into `world.nodes`.

    The contact bears the weight normal to the grade. `load` [N] deflects the tyre, bounds the grip
    and sets the pressure that effects know; a rover passes that of its last stage. The sinkage is
    that foreseen for the end of the stage, slip and extra forces are those at its beginning.
    """
    rig = world.rig
    sine, cosine = sin_cos(ahead.grade)
    weight = rig.gravity * wheel.mass
    sinkage = foreseen_sinkage(wheel, stage.duration, ahead.rolled)
    rim = rig.radius * wheel.wheel_speed
    # braking that the piled soil answers to; 0 where the pile lies behind
    piled = max(wheel.braked * smoothed_sign(wheel.speed, REST_SPEED)[0], 0.0)
    standing = Standing(sinkage, wheel.speed, rim, weight, sine, ahead.passes, piled, load)
    soil, arc, extra = ground_under(standing, ahead.soil, rig, world.acting)
    footing = lay_footing(world.nodes, arc, soil, weight * cosine)
    ground = Ground(soil, sinkage, ahead.rolled, extra.lift, extra.unfelt, ahead.grade)
    return Stand(ground, footing, extra, weight * sine)


@inlined
def solve_stage(wheel, stage, ahead, drive, forced, world):
    """Take a wheel through a `Stage` on the ground `Ahead` under a `Drive`, the command to its
    motor; return True.

    `move` changes place, sinkage, speeds and forces of the wheel. Where Newton's method fails,
    return False and leave the wheel where it was, or, if `forced`, go on with the best speeds
    found. The load that tyre and grip feel is the weight normal to the grade.
    """
    load = world.rig.gravity * wheel.mass * sin_cos(ahead.grade)[1]
    at = stand(wheel, stage, ahead, load, world)
    end = solve_speeds(wheel, stage, at.footing, at.along, drive, world, at.extra)
    if not (end.converged or forced):
        return False
    move(wheel, end, stage, at.ground, drive, world.rig)
    return True


@compiled_finite
def drive_period(wheel, drive, course, world):
    """Drive a wheel for a control period, in one or more steps as its speeds change (`steps_for`).

    A step whose Newton iteration fails is halved, down to 1/`FINEST` of its length, where the best
    speeds found are taken. Only the first failure of a period repeats the step at full length,
    since one of its two stages may have been driven. After a success the full length is back.
    """
    rig = world.rig
    begin_period(wheel)
    longest = rig.period / (rig.substeps * steps_for(change_ahead(wheel, drive, rig)))
    left = rig.period
    h = longest
    failed = False
    while left > OVER * longest:
        h = min(h, left)
        forced = h <= longest / FINEST
        speed_before = wheel.speed
        rim_before = rig.radius * wheel.wheel_speed
        for number in range(2):
            stage = stage_of(number, h, wheel, speed_before, rim_before, rig)
            effects = world.acting.effects
            ahead = ground_ahead(wheel, stage, course, course.cells, rig.border, effects)
            # the command at the end of the stage, where implicit Euler takes the forces
            now = at_time(drive, 1.0 - (left - stage.duration) / rig.period)
            done = solve_stage(wheel, stage, ahead, now, forced, world)
            if not done:
                break
            left -= stage.duration
            if not in_cell(wheel.cell, wheel.x):
                leave_ruts(wheel, course.cells)
        if done:
            h = longest
        else:
            # a first failure may have driven a stage: what is left is tried as one step again
            h = 0.5 * h if failed else longest
            failed = True


@compiled_finite
def _at_fork(wheel, course, action, rig):
    """Take the route that the action chooses, if it chooses one now (`choosing`), and plan the halt
    before the next fork (`plan_halt`). An action below 0 takes route 1 (beside), any other route 0.
    """
    fork = choosing(wheel, course, rig)
    if fork >= 0:
        set_route(course, fork, 1 if action < 0.0 else 0)
    plan_halt(wheel, course, rig)


@inlined
def control_period(wheel, action, course, world):
    """One control period of a wheel under an action in [-1, 1] (`commanded`).

    Drive, choose a route where there is one to choose, set the slip, count the period, let a halt
    pass or begin.

    In a halt the drive ignores the action; its speed loop brakes the wheel and holds it.
    """
    x_start = wheel.x
    rig = world.rig
    drive_period(wheel, commanded(wheel, action, wheel.halt_left > 0.0, rig), course, world)
    if rig.sight > 0.0:
        _at_fork(wheel, course, action, rig)
    set_slip(wheel, rig)
    end_period(wheel, x_start, wheel, rig)
