"""One control period of a rover: stages, soil and ruts of `simulation.world`, axle by axle.

All wheels of a rover run over the same course, each leaving its rut to those behind it: `ruts`
[axles, cells] are the `RUT`s as each wheel meets them. `world` is a `RoverWorld`, `foot` the `FOOT`
of an axle.
"""

from soil_env._compiled.elementary import sin_cos
from soil_env._compiled.flags import compiled_finite, inlined, put_fields
from soil_env.simulation.world.dynamics import (
    FINEST,
    GAMMA,
    OVER,
    ground_ahead,
    loop_change,
    move,
    stage_of,
    stand,
    steps_for,
)
from soil_env.simulation.world.newton import Motion
from soil_env.simulation.world.terrain import rut_at
from soil_env.simulation.world.wheel import (
    Drive,
    Ground,
    World,
    at_time,
    begin_period,
    commanded,
    end_period,
    leave_ruts,
    set_slip,
)
from soil_env.terramechanics.ground import put_soil, soil_of
from soil_env.terramechanics.reaction import ExtraForces, Footing

from .body import set_pitch
from .newton import equation_of, foresee, solve_speeds
from .ruts import copy_rut_behind

# fields of a `FOOT` by the part of a `Stand` that has them
_OF_GROUND = ("sinkage", "rolled", "grade")
_OF_FOOTING = Footing._fields
_OF_EXTRA = ExtraForces._fields


@compiled_finite
def _stage_of(number, h, wheel, foot, rig):
    """`Stage` of this `number` (0 or 1) of a step of h seconds, of the wheel of an axle; its `FOOT`
    has the speeds at the beginning of the step.
    """
    return stage_of(number, h, wheel, foot.speed_before, foot.rim_before, rig)


@inlined
def _keep_stand(foot, stand):
    """Write a `Stand` into a `FOOT`. The load of its footing is that of a wheel by itself:
    `solve_speeds` begins with the loads that follow from the suspension.
    """
    put_soil(foot, stand.ground.soil)
    put_fields(foot, stand.ground, _OF_GROUND)
    foot.along = stand.along
    # After the soil, three of whose values it replaces: strength and K are those of this contact.
    put_fields(foot, stand.footing, _OF_FOOTING)
    put_fields(foot, stand.extra, _OF_EXTRA)


@inlined
def _solve_stage(rover, course, ruts, number, h, forced, world):
    """Take a rover through a stage of a step of h seconds, and return True; `ruts` [axles, cells].

    Each wheel stands on its own ground; all speeds are solved together. Then wheels move, and axle
    heights, floors, pitch and ruts follow. Where Newton's method fails, return False and leave the
    rover where it was, or, if `forced`, go on with the best speeds found.
    """
    rig = world.rig
    scratch = world.stage
    axles = world.suspension.axles
    for a in range(axles):
        wheel = rover.wheels[a]
        foot = scratch.feet[a]
        stage = _stage_of(number, h, wheel, foot, rig)
        foot.rim_start = stage.rim
        own = World(rig, world.acting, scratch.nodes[a])
        ahead = ground_ahead(wheel, stage, course, ruts[a], rig.border, world.acting.effects)
        # tyre and grip by the last stage's load
        _keep_stand(foot, stand(wheel, stage, ahead, wheel.load, own))
    # any wheel gives V* and the duration, since all travel at the speed of the rover
    stage = _stage_of(number, h, rover.wheels[0], scratch.feet[0], rig)
    equation = equation_of(stage.speed, stage.implicit, rover.mass, rig)
    speed, converged = solve_speeds(rover, equation, world)
    if not (converged or forced):
        return False
    for a in range(axles):
        wheel = rover.wheels[a]
        foot = scratch.feet[a]
        axle = rover.axles[a]
        stage = _stage_of(number, h, wheel, foot, rig)
        found = scratch.found[a]
        end = Motion(speed, found.rim, found, converged)
        soil = soil_of(foot)
        under = Ground(soil, foot.sinkage, foot.rolled, foot.lift, foot.unfelt, foot.grade)
        # each part of the way climbs the grade that its speed was solved on, for the energy balance
        rise = stage.first * wheel.speed * sin_cos(wheel.grade)[0]
        move(wheel, end, stage, under, foot, rig)
        axle.height += rise + stage.last * speed * sin_cos(foot.grade)[0]
        axle.floor = rut_at(ruts[a], wheel.x)[0]
    set_pitch(rover, world.suspension)
    for a in range(axles):
        wheel = rover.wheels[a]
        cell = wheel.cell
        leave_ruts(wheel, ruts[a])
        copy_rut_behind(ruts, a, cell, wheel.cell)
    return True


@inlined
def _command_at(left, world):
    """Set the commands of all axles, shares of the stall torque or of the top rim speed, to those
    at the time when `left` seconds of the control period remain.

    A speed goes evenly from `before` to `asked` within the period; a torque is constant.
    """
    share = 1.0 - left / world.rig.period
    for a in range(world.suspension.axles):
        foot = world.stage.feet[a]
        asked = Drive(foot.asked, foot.by_speed > 0, foot.before)
        foot.command = at_time(asked, share).command


@inlined
def _solve_step(rover, course, ruts, h, left, forced, world):
    """Drive a step of h seconds in two stages, with `left` seconds of the period to go; return the
    time [s] that was driven.

    That is h, or where Newton's method fails the duration of the stages before, 0 or one stage;
    `forced` as in `_solve_stage`.
    """
    for a in range(world.suspension.axles):
        foot = world.stage.feet[a]
        foot.speed_before = rover.wheels[a].speed
        foot.rim_before = world.rig.radius * rover.wheels[a].wheel_speed
    for number in range(2):
        # at the end of the stage, where implicit Euler takes the forces
        _command_at(left - (GAMMA * h if number == 0 else h), world)
        if not _solve_stage(rover, course, ruts, number, h, forced, world):
            return number * (GAMMA * h)
    return h


@inlined
def _change_ahead(rover, world):
    """Largest foreseen change of V or of a rim speed in a step of the usual length [of the top rim
    speed]; that of a rim under a speed loop ends at its command (`loop_change`).
    """
    rig = world.rig
    for a in range(world.suspension.axles):
        world.stage.feet[a].rim_start = rig.radius * rover.wheels[a].wheel_speed
    usual = rig.period / rig.substeps
    dv = foresee(rover, equation_of(rover.wheels[0].speed, usual, rover.mass, rig), world)
    change = abs(dv)
    for a in range(world.suspension.axles):
        du = world.stage.found[a].change
        change = max(change, loop_change(du, rover.wheels[a], world.stage.feet[a], rig))
    return change / (rig.radius * rig.no_load_speed)


@inlined
def _drive_period(rover, course, ruts, world):
    """Drive a rover for a control period, in steps as those of `world.dynamics.drive_period`.

    A step whose Newton iteration fails is halved, down to 1/`FINEST` of its length, where the best
    speeds found are taken. Only the first failure of a period repeats the step at full length.
    """
    rig = world.rig
    longest = rig.period / (rig.substeps * steps_for(_change_ahead(rover, world)))
    left = rig.period
    h = longest
    failed = False
    while left > OVER * longest:
        h = min(h, left)
        driven = _solve_step(rover, course, ruts, h, left, h <= longest / FINEST, world)
        left -= driven
        if driven == h:
            h = longest
        else:
            # a first failure may have driven a stage: what is left is tried as one step again
            h = 0.5 * h if failed else longest
            failed = True


@compiled_finite
def control_period(rover, actions, course, ruts, world):
    """One control period of a rover under `actions` [axles] in [-1, 1] (`wheel.commanded`): drive,
    then set the state of the rover as a whole (`_sum_up`).

    `course`: that of the rover; `ruts` [axles, cells]: `RUT`. In a halt the drives ignore the
    actions; their speed loops brake the wheels and hold them.
    """
    halted = rover.halt_left > 0.0
    for a in range(world.suspension.axles):
        wheel = rover.wheels[a]
        foot = world.stage.feet[a]
        drive = commanded(wheel, actions[a], halted, world.rig)
        foot.command = drive.command
        foot.asked = drive.command
        foot.before = drive.before
        foot.by_speed = drive.by_speed
        foot.start = wheel.x
        begin_period(wheel)
    _drive_period(rover, course, ruts, world)
    _sum_up(rover, world)


@inlined
def _sum_up(rover, world):
    """Set the state of a rover as a whole (`ROVER`) from its wheels, and end the control period.

    Place and speed are those of the rear wheel: the rover has come as far as its last axle. The
    wheel speed is that of the fastest wheel, so a rover stalls only if no wheel turns. The sinkage
    is that of the deepest wheel, its rut included. Slip is the mean. Pull and motor work are sums;
    a motor whose work is negative counts as 0, since it recovers nothing for the others.
    `converged` is 0 if any wheel's is. Slip and travel of each wheel are set, too.
    """
    axles = world.suspension.axles
    fastest = 0.0
    slip = 0.0
    deepest = 0.0
    pull = 0.0
    work = 0.0
    rover.converged = 1
    for a in range(axles):
        wheel = rover.wheels[a]
        set_slip(wheel, world.rig)
        wheel.travel = wheel.x - world.stage.feet[a].start
        if abs(wheel.wheel_speed) > abs(fastest):
            fastest = wheel.wheel_speed
        slip += wheel.slip
        deepest = max(deepest, wheel.sinkage + rover.axles[a].floor)
        pull += wheel.drawbar_pull
        work += max(wheel.motor_work, 0.0)
        rover.converged = min(rover.converged, wheel.converged)
    rear = rover.wheels[axles - 1]
    start = rover.x
    rover.x = rear.x
    rover.best_x = max(rover.best_x, rear.x)
    rover.speed = rear.speed
    rover.wheel_speed = fastest
    rover.slip = slip / axles
    rover.sinkage = deepest
    rover.drawbar_pull = pull
    rover.motor_work = work
    end_period(rover, start, rover, world.rig)
