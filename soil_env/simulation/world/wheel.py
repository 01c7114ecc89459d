"""State of a driven wheel and its laws of motion (docs/physics/wheel.md), which `dynamics` steps.

    m dV/dt = DP - m g sin(grade)    travel; m = wheel with its share of the body, and payload
    J dw/dt = T_motor - T            rotation
    dz/dt   = B z_w - A z            sinkage on fresh ground, `slip_sinkage.excavation_rate`
    ds/dt   = |V| (s_i - s)/L_s      soil piled ahead of a braked wheel, `pile_up`;
                                     s_i = sign(V) max(-slip, 0)
    W       = m g cos(grade)         Eq. (1), met at every instant

z_w is the depth at which undisturbed soil carries the same pressure as the wheel now has under it
(`sink`). Where the wheel has been before, its contact begins at the floor of the rut that it
rolled, and z_w is reached from there.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from soil_env._compiled.elementary import exp, power
from soil_env._compiled.flags import compiled, compiled_finite, inlined, record
from soil_env._compiled.random_streams import between
from soil_env.parameters import Scenario, SoilState
from soil_env.parameters.wheel import refuse_lugs_on_tyre
from soil_env.slip import slip_ratio
from soil_env.terramechanics.contact import layered_depth
from soil_env.terramechanics.effects import acting_effects
from soil_env.terramechanics.effects.grousers import contact_radius, shear_radius_ratio
from soil_env.terramechanics.effects.slip_sinkage import digging_ratio, excavation_rate, onto_fresh
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.reaction import BASE, REST_SPEED, Acting, acting_on
from soil_env.terramechanics.steady import DEEPEST, Conditions, Point, rim_of, steady_at

from .sensors import READING
from .terrain import cell_after, cell_at, find_ground, leave_rut

SHALLOWEST = 1e-4  # [radii] least sinkage of a wheel
# [of the top rim speed] that rim acceleration can command backwards, to back out of a hole
REVERSE = 0.1
ROUNDING = 1e-9  # [-] by which a ratio may exceed a whole number and still counts as it
SETTLING_TIME = 0.1  # [s] in which soil yields under a wheel that stands on less than it needs
MOST_BEARING = 10.0  # [-] z_w over the present sinkage, at most; own choice
LEAST_EXPONENT = 0.05  # [-] least sinkage exponent by which z_w is computed; own choice
# [radii] of travel in which soil piles up ahead of a braked wheel: 0.4 to 0.8 on a continuum
# (`python -m benchmarks.continuum pile`)
PILING = 0.7
STANDING = 1e-12  # [-] relaxation in a stage, or [m] of travel, below which nothing changes

#: A wheel; all fields have eight bytes. Numbers that follow from others in the same step are kept
#: for sensors and info.
WHEEL = record(
    # motion and forces, up to the grade: `info["state"]`
    "x",  # [m] distance along the course
    "speed",  # V [m/s]
    "wheel_speed",  # w [rad/s]
    "slip",  # [-]
    "sinkage",  # z [m] below the undisturbed surface; of a rover below the rut of the wheels ahead
    "load",  # W [N]
    "drawbar_pull",  # DP [N]
    "torque",  # T [N m], soil on wheel
    "motor_torque",  # [N m]
    "grade",  # [rad] at the wheel
    # sinkage, rut and pile
    "best_x",  # [m] furthest x so far: ground beyond it is fresh
    "lowest_x",  # [m] least x so far: ground behind it is fresh
    "sinking",  # dz/dt [m/s] in the last stage
    # [of the travel] sliding at which a steady pile would be as large as the present one; > 0: the
    # pile is on the side of larger x
    "braked",
    "rut_depth",  # [m] of the ground under the wheel where it has been before
    # of the last stage
    "mass",  # [kg]
    "pull_v",  # dDP/dV [N s/m] at the end of the last stage, with the names of a `Reaction`
    "pull_u",  # dDP/d(r w)
    "torque_v",  # dT/dV [N s]
    "torque_u",  # dT/d(r w)
    "bearing_sinkage",  # z_w [m] from where `sinkage` is measured
    "unfelt",  # [m] sinkage of a residual law, which is read beyond z
    # of the last control period
    "motor_work",  # [J] in the last control period
    "soil_work",  # [J] that soil and drivetrain took, T w - DP V, in the last control period
    "numerical_work",  # [J] that the integrator took, in the last control period
    "travel",  # [m] in the last control period
    "last_action",  # [-1, 1]
    "rim_command",  # [of the top rim speed] that the drive follows; 0 if the action is a torque
    "halt_command",  # [of the top rim speed] that a halt brakes from, and then follows
    # of the task
    "mark_x",  # [m] `best_x` when it last was a further `no_progress_distance` on
    "idle_time",  # [s] since `mark_x` was set, halts left out
    "stalled_time",  # [s] of `idle_time` in which the wheel did not turn
    "odometer",  # [m] distance by odometry
    "next_halt",  # [m] place of the next commanded halt
    "halt_left",  # [s] left of the present halt, 0 while driving
    "action",  # [-1, 1] of the next step
    "reward",  # of the last step
    terms=("f8", 4),  # of the reward, `REWARD_TERMS`
    zero=(READING, 1),  # of its sensors on this course
    gain=(READING, 1),  # of them
    stream=("u8",),  # random numbers of the wheel (`random_streams`)
    order=("i8",),  # what is to be done with it: STEP, RESTART or IDLE
    cause=("i8",),  # `Cause` of the end of its episode, or that it runs
    periods=("i8",),  # control periods of the last step
    # 1 unless Newton's method failed at the finest step of the last control period
    converged=("i8",),
    patch=("i8",),  # of the course, under the wheel
    slope=("i8",),  # of its profile, under the wheel
    cell=("i8",),  # of the rut, under the wheel
    steps=("i8",),  # control periods since reset
)

#: Constants of a wheel with its motor, of the commands that it takes and of the halts of its
#: courses.
RIG = record(
    "radius",  # [m] of the rim
    "width",  # [m]
    "grouser_height",  # [m]
    "shear_ratio",  # [-] radius at which soil is sheared, over that of the contact
    "rim_ratio",  # [-] radius at which soil is sheared, over that of the rim
    "tyre_deflection",  # [m] at any load
    "tyre_compliance",  # [m/N]
    "grip",  # [-] friction between tread and ground, 0: no such limit
    "gravity",  # [m/s2]
    "unit_weight",  # [N/m3] of the soil
    "inertia",  # [kg m2]
    "stall_torque",  # [N m]
    "no_load_speed",  # [rad/s]
    "relaxation",  # [m] of the sinkage
    "border",  # [m] over which one patch passes into the next
    "halt_low",  # [m] least distance between halts
    "halt_high",  # [m] largest distance between halts
    "halt_time",  # [s]
    "period",  # [s] of the control
    # [of top rim speed] change of the command by an action of 1 in a period; 0: the action is the
    # command
    "rim_step",
    "halt_step",  # [of top rim speed] that a halt lowers the command by in a period
    "sight",  # [m] before a patch from which its routes are seen; 0: there is one route
    substeps=("i8",),  # of a control period
    speed_command=("i8",),  # 1 if the drive follows a commanded rim speed
)


class World(NamedTuple):
    """What a wheel is simulated with: constants, what acts beside the base model, scratch."""

    rig: Any  # `RIG`
    acting: Acting
    nodes: Any  # `ARC_NODES`


class Drive(NamedTuple):
    """What the motor is to do in a control period, or at a time in it."""

    command: float  # [-1, 1] of the stall torque, or of the top rim speed
    by_speed: bool
    before: float  # command of a speed at the beginning of the period; of a torque, `command`


class Ground(NamedTuple):
    """The ground under a wheel in a stage of a step."""

    soil: SoilState  # as the wheel meets it
    sinkage: float  # [m] that the arc is laid at, below the rut of earlier passes
    rolled: float  # [m] depth of that rut, where the contact begins
    lift: float  # [m] of z_w beyond the depth that carries
    unfelt: float  # [m] as in `WHEEL`
    grade: float  # [rad]


class Ahead(NamedTuple):
    """Ground under the middle of the way of a wheel in a stage, before the wheel passes it."""

    soil: SoilState  # stiffened by earlier passes, unless the effect multipass does that (`in_rut`)
    grade: float  # [rad]
    passes: float  # 1 = fresh soil
    rolled: float  # [m] depth of the wheel's own rut (`rut_at`)


class Path(NamedTuple):
    """Way of a wheel in a stage."""

    moved: float  # [m]
    slid: float  # [m] of the rim over the ground
    duration: float  # [s]


def rig_of(scenario: Scenario, model: WheelSoilModel | None = None) -> np.ndarray:
    """Pack the constants of wheel, drive and halts of a scenario, `RIG` [1].

    A `model` gives lugs, unit weight of the soil and effects on the radii; without one there are
    none. Raises ParameterError for lugs on a tyre. A period has as many substeps as make none
    longer than `Control.substep`. `rim_step` stays 0 unless the action is a rim acceleration.
    """
    w = scenario.wheel
    c = scenario.control
    packed = np.zeros(1, RIG)
    rig = packed[0]
    for name in (
        "radius",
        "width",
        "tyre_deflection",
        "tyre_compliance",
        "grip",
        "inertia",
        "stall_torque",
        "no_load_speed",
    ):
        rig[name] = getattr(w, name)
    rig.gravity = scenario.gravity
    if model is not None:
        refuse_lugs_on_tyre(model.wheel.grouser_height, w.tyre)
        rig.grouser_height = model.wheel.grouser_height
        rig.unit_weight = model.density * scenario.gravity
    effects = acting_in(model, 1.0).effects
    rig.shear_ratio = shear_radius_ratio(rig, effects)
    rig.rim_ratio = rig.shear_ratio * contact_radius(rig, effects) / w.radius
    rig.relaxation = scenario.relaxation * w.radius
    rig.border = scenario.course.border
    rig.halt_low, rig.halt_high = scenario.course.halt_interval
    rig.halt_time = scenario.course.halt_time
    rig.period = c.period
    rig.substeps = math.ceil(c.period / c.substep - ROUNDING)
    rig.speed_command = c.action != "torque"
    top = w.radius * w.no_load_speed  # [m/s] rim speed
    if c.action == "rim_acceleration":
        rig.rim_step = c.rim_acceleration * c.period / top
    rig.halt_step = c.halt_deceleration * c.period / top
    rig.sight = scenario.camera.range if scenario.course.lines > 1 else 0.0
    return packed


def acting_in(model: WheelSoilModel | None, shear_ratio: float) -> Acting:
    """Effects and residual law of a `model` that act on its wheels, not on its sensors; `BASE`
    where nothing does. `shear_ratio` as in `RIG`.
    """
    if model is None:
        return BASE
    law = model.law if model.residual or model.remainder else None
    return acting_on(acting_effects(model.numbers), law, shear_ratio)


@inlined
def commanded(wheel, action, halted, rig):
    """`Drive` of a control period under an action in [-1, 1]; store the commands in the wheel.

    The action is a share of the stall torque, a share of the top rim speed, or a change of the
    commanded share (`rig.rim_step`), which stays within -`REVERSE` and 1. A commanded speed is
    reached evenly, at the end of the period (`at_time`).

    In a halt the action is ignored, so `last_action` and `rim_command` are 0. The commanded speed
    falls to 0 by `rig.halt_step` a period. It starts at the last command, or with torque at the
    wheel's speed when the last period began.
    """
    before = wheel.halt_command
    if halted:
        slower = max(abs(wheel.halt_command) - rig.halt_step, 0.0)
        wheel.halt_command = math.copysign(slower, wheel.halt_command)
        wheel.last_action = 0.0
        wheel.rim_command = 0.0
        return Drive(wheel.halt_command, True, before)
    by_speed = rig.speed_command > 0
    command = action
    if rig.rim_step > 0.0:
        command = min(max(wheel.rim_command + rig.rim_step * action, -REVERSE), 1.0)
    wheel.last_action = action
    wheel.rim_command = command if by_speed else 0.0
    wheel.halt_command = command if by_speed else wheel.wheel_speed / rig.no_load_speed
    return Drive(command, by_speed, before if by_speed else command)


@inlined
def at_time(drive, share):
    """`Drive` with its command at a time in the control period, given as a `share` of it: linear
    from `before` at 0 to `command` at 1.
    """
    return Drive(
        drive.before + share * (drive.command - drive.before), drive.by_speed, drive.before
    )


@inlined
def begin_period(wheel):
    """Set the sums of a control period to 0, and `converged` to 1."""
    wheel.motor_work = 0.0
    wheel.soil_work = 0.0
    wheel.numerical_work = 0.0
    wheel.converged = 1


@inlined
def sink(wheel, ground, mobilised, path, rig):
    """Move a wheel along its `Path` in a stage on `Ground`: set its place, sinkage and rut.

    z_w [m] (`bearing`) is the depth at which undisturbed soil carries the pressure under the wheel,
    `mobilised` z^n at z = `ground.sinkage`, and `ground.lift` more where effects dig. Both begin at
    the floor of the wheel's own rut, `ground.rolled`. The coefficient `mobilised` [N/m^(n+2)] is
    what the load took in the stage.

    z_w counts as at most `MOST_BEARING` z, n as at least `LEAST_EXPONENT`. On firm ground below a
    cover it is that of `layered_depth`.

    Travel leads the sinkage `onto` a depth [m]. On fresh ground, beyond the furthest places of the
    wheel, that is z_w. In the hole where the wheel stands it is the depth of that hole, and where
    an earlier pass has left a rut, z_w if that is deeper. On a way over both it is the mean by
    length. The sinkage stays between `SHALLOWEST` and `DEEPEST` radii. `rut_depth` grows where the
    wheel sinks and not where it climbs out of its hole. `sinking`, `best_x`, `lowest_x` and
    `bearing_sinkage` are set, too.
    """
    soil = ground.soil
    exponent = max(soil.sinkage_exponent, LEAST_EXPONENT)
    ratio = power(mobilised / soil.sinkage_coefficient, 1.0 / exponent)
    bearing = ground.sinkage * min(ratio, MOST_BEARING)
    if soil.layer_gain > 0.0 and bearing > 0.0:
        bearing = layered_depth(bearing, ground.lift, _dug(path, soil), soil)
    bearing += ground.lift
    x = wheel.x + path.moved
    beyond = onto_fresh(x, wheel.lowest_x, wheel.best_x)
    fresh = min(beyond / max(abs(path.moved), STANDING), 1.0)
    rut = max(wheel.rut_depth - ground.rolled, bearing if ground.rolled > 0.0 else 0.0)
    onto = fresh * bearing + (1.0 - fresh) * rut
    below = wheel.sinkage - ground.rolled
    relaxed = relax_sinkage(below, bearing, onto, path, soil, rig.relaxation) + ground.rolled
    depth = min(max(relaxed, SHALLOWEST * rig.radius), DEEPEST * rig.radius)
    wheel.sinking = (depth - wheel.sinkage) / path.duration
    if wheel.sinkage < depth:
        wheel.rut_depth = max(wheel.rut_depth, depth)
    wheel.x = x
    wheel.best_x = max(x, wheel.best_x)
    wheel.lowest_x = min(x, wheel.lowest_x)
    wheel.sinkage = depth
    wheel.bearing_sinkage = bearing + ground.rolled


@inlined
def pile_up(wheel, braked, moved, rig):
    """Let `wheel.braked` relax to `braked` >= 0, the present sliding over the travel, in a stage in
    which the wheel `moved` [m].

    `wheel.braked` is the sliding whose steady pile is as large as the present one. It relaxes over
    `PILING` radii of travel, to `braked` with the sign of the travel. A wheel that turns back has
    the pile behind it, where nothing is pushed (`dynamics.stand`).
    """
    if moved < 0.0:
        braked = -braked
    if wheel.braked != 0.0 or braked != 0.0:  # saves the `exp` of most wheels
        left = exp(-abs(moved) / (PILING * rig.radius))
        wheel.braked = braked + (wheel.braked - braked) * left


@inlined
def _dug(path, soil):
    """`digging_ratio` along a `Path` [-], by the digging of a `SoilState`; 1 where the wheel moves
    and slides less than `STANDING`.
    """
    moved = abs(path.moved)
    slid = abs(path.slid)
    if moved + slid < STANDING:
        return 1.0
    return digging_ratio(slid, moved, soil.dig_gain, soil.dig_recovery)


@inlined
def relax_sinkage(sinkage, bearing, onto, path, soil, length):
    """Sinkage [m] after dz/dt = B z_w - A z + |V| (onto - z_w)/length along a `Path`
    (`effects.excavation_rate`), with z_w = `bearing` [m]: the exact solution at constant rates.

    Where z < z_w, 1/`SETTLING_TIME` is added to A and B: the wheel sinks under its load at once,
    travelling or not. `onto` [m] is the depth that travel leads to, z_w on fresh ground and the
    rut where the wheel has been. A wheel that neither moves, slides nor sinks keeps its sinkage.
    """
    speed = abs(path.moved) / path.duration
    sliding = abs(path.slid) / path.duration
    a, b = excavation_rate(speed, sliding, soil.dig_gain, soil.dig_recovery, length)
    to_rut = speed * (onto - bearing) / length  # [m/s]
    if sinkage < bearing:
        a += 1.0 / SETTLING_TIME
        b += 1.0 / SETTLING_TIME
    if a * path.duration < STANDING:
        return sinkage
    goal = (b * bearing + to_rut) / a
    return goal + (sinkage - goal) * exp(-a * path.duration)


@compiled_finite
def leave_ruts(wheel, cells):
    """Mark the cells that a wheel has left in a stage as passed, and enter the next ones.

    A cell is left once the wheel reaches the middle of the next (`cell_after`). It keeps
    `rut_depth`, to which the wheel sank in it. A wheel that rises into an older, shallower rut
    presses it at least to the depth that carries it: z_w, or the present sinkage if that is less.
    In a cell that is entered for the first time `rut_depth` begins at the present sinkage, else at
    the depth of the cell. `cells`: `RUT` of the wheel.
    """
    after = cell_after(cells.size, wheel.cell, wheel.x)
    while wheel.cell != after:
        pressed = min(wheel.bearing_sinkage, wheel.sinkage)
        leave_rut(cells[wheel.cell], max(wheel.rut_depth, pressed))
        wheel.cell += 1 if after > wheel.cell else -1
        depth = cells[wheel.cell].depth
        wheel.rut_depth = depth if depth > 0.0 else wheel.sinkage


@inlined
def end_period(wheel, x_start, owner, rig):
    """End a control period of a wheel or a whole rover that began at `x_start` [m]: set its travel,
    count the period, and let a halt pass or begin.

    A halt begins where x reaches `next_halt`. The place of the halt after it is then drawn from the
    random stream of `owner`, `rig.halt_low` to `rig.halt_high` [m] further. In a halt its time left
    falls by a period; what is left then counts as 0 if it is at most `ROUNDING` periods.
    """
    wheel.travel = wheel.x - x_start
    wheel.steps += 1
    if wheel.halt_left > 0.0:
        left = wheel.halt_left - rig.period
        wheel.halt_left = left if left > ROUNDING * rig.period else 0.0
    elif wheel.x >= wheel.next_halt:
        wheel.halt_left = rig.halt_time
        wheel.next_halt = wheel.x + between(owner, rig.halt_low, rig.halt_high)


@inlined
def set_slip(wheel, rig):
    """Set the true slip of a wheel from its speeds: `slip_ratio` with the floor `REST_SPEED`."""
    wheel.slip = slip_ratio(wheel.wheel_speed * rig.radius, wheel.speed, REST_SPEED)


@compiled
def settle_at(wheel, x, mass, course, world):
    """Put a wheel, its record blank but for its stream, at rest at x [m] of a drawn course.

    It has the steady sinkage of slip 0 on fresh soil, under the weight of its `mass` [kg] normal to
    the grade, at least `SHALLOWEST` radii. Its own rut is as deep. `world`: a `World`, whose nodes
    are scratch.
    """
    rig = world.rig
    soil, grade = find_ground(wheel, course, x, rig.border)
    load = mass * rig.gravity * math.cos(grade)
    at_rest = Conditions(0.0, 1.0, math.sin(grade))
    effects = world.acting.effects
    rest = steady_at(world.nodes, Point(0.0, load, 0.0), soil, rim_of(rig), at_rest, effects)
    wheel.x = x
    wheel.best_x = x
    wheel.lowest_x = x
    wheel.mark_x = x
    wheel.sinkage = max(rest.sinkage, SHALLOWEST * rig.radius)
    wheel.bearing_sinkage = wheel.sinkage
    wheel.rut_depth = wheel.sinkage
    wheel.mass = mass
    wheel.load = load
    wheel.grade = grade
    wheel.converged = 1
    wheel.cell = cell_at(course.cells, x)
