"""State of a driven wheel and its laws of motion (docs/physics/wheel.md), which `dynamics` steps.

    m dV/dt = DP - m g sin(grade)            travel, m = wheel with its share of the body, and payload
    J dw/dt = T_motor - T                    rotation
    dz/dt   = B z_w - A z                    sinkage on fresh ground, `effects.excavation_rate`
    W       = m g cos(grade)                 Eq. (1), met at every instant

z_w is the depth at which undisturbed soil carries the same pressure as the wheel now has under it (`bearing_sinkage`).
On ground that the wheel has touched before, travel takes the sinkage to the depth of the rut instead (`relax_sinkage`).
"""

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_inline, compiled_part
from soil_env._numba.elementary import exp, larger, power, smaller, where_less
from soil_env._numba.lanes import COUNT
from soil_env._numba.random_streams import between
from soil_env._numba.rows import Rows, rows, zero_column
from soil_env.parameters import Scenario
from soil_env.simulation.world.terrain import cell_at, ground_at
from soil_env.slip import slip_ratio
from soil_env.terramechanics.effects import NO_EFFECTS, acting, excavation_rate
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.reaction import REST_SPEED, Interaction, interaction
from soil_env.terramechanics.residual import residual_law
from soil_env.terramechanics.steady import Conditions, Rim, steady_with

SHALLOWEST = 1e-4  # [radii] least sinkage of a wheel
REVERSE = (
    0.1  # [of the top rim speed] that rim acceleration can command backwards, to back out of a hole
)
SETTLING_TIME = 0.1  # [s] in which soil yields under a wheel that stands on less than it needs

#: Wheels. Numbers that follow from the others in the same step are kept for sensors and info.
WheelState: type[Rows] = rows(
    "WheelState",
    "x",  # [m] distance along the course
    "best_x",  # [m] furthest x so far: ground beyond it is fresh
    "lowest_x",  # [m] least x so far: ground before it is fresh
    "speed",  # V [m/s]
    "wheel_speed",  # w [rad/s]
    "sinkage",  # z [m] below the undisturbed surface
    "sinking",  # dz/dt [m/s] in the last stage
    "rut_depth",  # [m] of the ground under the wheel where it has been before
    "cell_x",  # [m] where the wheel came into the present cell
    "slid",  # [m] that the rim has slid over the ground in the present cell
    "mass",  # [kg]
    "motor_torque",  # [N m]
    "available_torque",  # [N m] of the motor at this wheel speed, in the direction of the torque asked for
    "load",  # W [N]
    "drawbar_pull",  # DP [N]
    "torque",  # T [N m], soil on wheel
    "slip",  # [-]
    "pull_by_speed",  # dDP/dV [N s/m] at the end of the last substep
    "pull_by_rim",  # dDP/d(r w)
    "torque_by_speed",  # dT/dV [N s]
    "torque_by_rim",  # dT/d(r w)
    "bearing_sinkage",  # z_w [m]
    "grade",  # [rad] at the wheel
    "motor_work",  # [J] in the last control period
    "soil_work",  # [J] that soil and drivetrain took from it, T w - DP V, in the last control period
    "numerical_work",  # [J] that the integrator took from it, in the last control period
    "travel",  # [m] in the last control period
    "last_action",  # [-1, 1]
    "rim_command",  # [of the top rim speed] that the drive follows; 0 if the action is a torque
    "mark_x",  # [m] `best_x` when it last was a further `no_progress_distance` on
    "idle_time",  # [s] since `mark_x` was set, halts left out
    "stalled_time",  # [s] of `idle_time` in which the wheel did not turn
    "odometer",  # [m] distance by odometry
    "odometer_scale",  # [-] its scale on this course
    "next_halt",  # [m] place of the next commanded halt
    "halt_left",  # [s] left of the present halt, 0 while driving
)

#: What is counted of wheels.
WheelCounts: type[Rows] = rows(
    "WheelCounts",
    "converged",  # 1 unless a Newton iteration of the last control period failed at the finest substep
    "patch",  # of the course, under the wheel
    "cell",  # of the rut, under the wheel
    "steps",  # control periods since reset
    kind=np.int64,
)


class WorldNumbers(NamedTuple):
    """Numbers of the dynamics from a `Scenario`."""

    wheel: Interaction  # with the effects that act on the wheel, not on its sensors
    inertia: float
    stall_torque: float
    no_load_speed: float
    relaxation: float  # [m]
    border: float  # [m]
    halt_low: float  # [m]
    halt_high: float  # [m]
    halt_time: float  # [s]
    period: float  # [s]
    substeps: int
    speed_command: bool  # the drive follows a commanded rim speed
    rim_step: float  # [of top rim speed] by which an action of 1 changes it in a control period; 0: it is the action
    lines: int  # between which the wheel may choose
    sight: float  # [m] before a patch from which its lines are seen
    axles: int  # of the rover; 1: a wheel by itself


def interaction_of(scenario: Scenario, model: WheelSoilModel | None = None) -> Interaction:
    """The wheel of a scenario and the effects of `model` that act on it, not on its sensors."""
    w = scenario.wheel
    grousers, density = (0.0, 0.0) if model is None else (model.wheel.grouser_height, model.density)
    effects = NO_EFFECTS if model is None else acting(model.numbers)
    law = residual_law(() if model is None else model.residual)
    rim = Rim(w.radius, w.width, grousers)
    return interaction(rim, effects, law, scenario.gravity, density * scenario.gravity)


def world_numbers(
    scenario: Scenario, model: WheelSoilModel | None = None, axles: int = 1
) -> WorldNumbers:
    """Pack the numbers of `dynamics.advance`; `model` gives the effects that are on in this world."""
    w = scenario.wheel
    c = scenario.control
    return WorldNumbers(
        interaction_of(scenario, model),
        w.inertia,
        w.stall_torque,
        w.no_load_speed,
        scenario.relaxation * w.radius,
        scenario.course.border,
        *scenario.course.halt_interval,
        scenario.course.halt_time,
        c.period,
        math.ceil(c.period / c.substep - 1e-9),
        c.action != "torque",
        c.rim_acceleration * c.period / (w.radius * w.no_load_speed)
        if c.action == "rim_acceleration"
        else 0.0,
        scenario.course.lines,
        scenario.camera.range,
        axles,
    )


@compiled_inline
def course_of(k, axles):
    """Row of the course that wheel k is on. Each block of eight wheels is of eight rovers, axle by axle."""
    return k if axles == 1 else k // (COUNT * axles) * COUNT + k % COUNT


@compiled_inline
def axle_of(k, axles):
    """Axle of wheel k, from the front on."""
    return 0 if axles == 1 else k // COUNT % axles


@compiled_inline
def wheel_of(j, axle, axles):
    """The wheel of rover j on an axle: the reverse of `course_of` and `axle_of`."""
    return (j // COUNT * axles + axle) * COUNT + j % COUNT


@compiled_inline
def bearing_sinkage(sinkage, mobilised, soil):
    """z_w [m]: depth at which undisturbed soil bears the pressure `mobilised` z^n, at most 10 z."""
    n = larger(soil.sinkage_exponent, 0.05)
    return sinkage * smaller(power(mobilised / soil.sinkage_coefficient, 1.0 / n), 10.0)


@compiled_inline
def relax_sinkage(sinkage, bearing, onto, speed, slip_speed, soil, length, h):
    """Sinkage [m] after h seconds of dz/dt = B z_w - A z + |V| (onto - z_w) / length (`effects.excavation_rate`).

    Where z < z_w, 1/SETTLING_TIME is added to A and B: the wheel sinks under its load at once.

    `onto` [m] is the depth that travel leads to: z_w on fresh ground, that of the rut where the wheel has been.
    """
    a, b = excavation_rate(abs(speed), abs(slip_speed), soil.dig_gain, soil.dig_recovery, length)
    rut = abs(speed) * (onto - bearing) / length
    yielding = where_less(
        sinkage, bearing, 1.0 / SETTLING_TIME, 0.0
    )  # under the load at once, travelling or not
    a = a + yielding
    b = b + yielding
    goal = (b * bearing + rut) / a
    return where_less(a * h, 1e-12, sinkage, goal + (sinkage - goal) * exp(-a * h))


@compiled_inline
def commanded(state, k, action, halted, world):
    """Command of wheel k for a control period, as `motor` takes it: the action itself, or the rim speed that it leads
    to where it is a rim acceleration. In a halt it is 0, and so is the action that counts as the last one."""
    action = 0.0 if halted else action
    command = action
    state.last_action[k] = action
    if world.rim_step > 0.0 and not halted:
        command = min(max(state.rim_command[k] + world.rim_step * action, -REVERSE), 1.0)
    state.rim_command[k] = command if world.speed_command else 0.0
    return command


@compiled_inline
def finish(state, counts, k, x_start, streams, world):
    """The end of a control period of wheel k, which began at `x_start` [m]: slip, travel and halts."""
    x = state.x[k]
    state.slip[k] = slip_ratio(
        state.wheel_speed[k] * world.wheel.radius, state.speed[k], REST_SPEED
    )
    state.travel[k] = x - x_start
    counts.steps[k] += 1
    if state.halt_left[k] > 0.0:
        state.halt_left[k] = max(0.0, state.halt_left[k] - world.period)
    elif x >= state.next_halt[k]:
        state.halt_left[k] = world.halt_time
        state.next_halt[k] = x + between(streams, k, world.halt_low, world.halt_high)


@compiled_part
def settle(state, counts, k, mass, courses, streams, world):
    """Put wheel k at rest at the start of its course, sunk in under its own load."""
    settle_at(state, counts, k, 0.0, mass, courses, world)
    state.next_halt[k] = between(streams, k, world.halt_low, world.halt_high)


@compiled_part
def settle_at(state, counts, k, x, mass, courses, world):
    """Put wheel k at rest at x [m] of its course, sunk in under its own load."""
    wheel = world.wheel
    soil, grade, patch = ground_at(courses, course_of(k, world.axles), x, 0, world.border)
    load = mass * wheel.gravity * math.cos(grade)
    rim = Rim(wheel.radius, wheel.width, wheel.grouser_height)
    here = Conditions(0.0, 1.0, math.sin(grade))
    rest = steady_with(0.0, load, soil, rim, here, wheel.unit_weight, wheel.effects, 0.0)
    zero_column(state, k)
    zero_column(counts, k)
    state.x[k] = state.best_x[k] = state.lowest_x[k] = state.mark_x[k] = state.cell_x[k] = x
    state.sinkage[k] = state.bearing_sinkage[k] = max(rest.sinkage, SHALLOWEST * wheel.radius)
    state.rut_depth[k] = state.sinkage[k]
    state.mass[k] = mass
    state.load[k] = load
    state.grade[k] = grade
    state.available_torque[k] = world.stall_torque
    counts.converged[k] = 1
    counts.patch[k] = patch
    counts.cell[k] = cell_at(courses, x)
