"""State of a driven wheel and one step of it.

    m dV/dt = DP - m g sin(grade)            travel, m = wheel with its share of the body, and payload
    J dw/dt = T_motor - T                    rotation
    dz/dt   = B z_w - A z                    sinkage, `effects.excavation_rate`
    W       = m g cos(grade)                 Eq. (1), met at every instant

z_w is the depth at which undisturbed soil carries the same peak pressure as the wheel now has under it. At a sinkage
z the load mobilises a sinkage coefficient s, in closed form since Eq. (1) is linear in it
(`contact.mobilised_modulus`); equal pressure s z^n = S z_w^n then gives z_w = z (s/S)^(1/n). So the balance (1) holds
throughout and no root is sought; the steady state at any slip is that of `model.steady_state`. (Where cohesion alone
carries more than the load, s is 0 and the reported load exceeds the weight: a deeply dug wheel in strongly cohesive
soil.)

Sliding speed and travel speed answer to force within milliseconds for a slow rover, so (V, r w) are stepped by implicit
Euler with a safeguarded Newton iteration on analytic derivatives, and z, which is slow, by the exact solution of its
law with A, B and z_w held over the step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, kernel
from soil_env._numba.elementary import exp, larger, power, smaller, where_less
from soil_env._numba.random_streams import between
from soil_env.parameters import Scenario
from soil_env.simulation.terrain import cell_at, ground_at, leave_rut, stiffened
from soil_env.terramechanics.contact import (
    arc_nodes,
    slip_ratio,
)
from soil_env.terramechanics.effects import (
    NO_EFFECTS,
    Effects,
    acting,
    excavation_rate,
)
from soil_env.terramechanics.model import DEEPEST, Conditions, Rim, WheelSoilModel, steady_with
from soil_env.terramechanics.reaction import REST_SPEED, ground_with_effects, moved, plain_ground, react
from soil_env.terramechanics.residual import ResidualLaw, residual_law

SHALLOWEST = 1e-4  # [radii] least sinkage of a wheel
SETTLING_TIME = 0.1  # [s] in which soil yields under a wheel that stands on less than it needs
TOLERANCE = 1e-5  # [m/s] of the Newton iteration, which converges quadratically
SHORT = 0.1  # share of the rim speed up to which the first step goes by the last reaction
FORETOLD = 0.3  # share of the tolerance that the foretold residual of an unseen last iteration may reach
_MAX_ITERATIONS = 30
FINEST = 1024  # a substep that fails is halved down to this fraction; softening soil breaks away within 1 ms

#: One wheel. Numbers that follow from the others in the same step are kept for sensors and info.
WHEEL_STATE = np.dtype(
    [
        ("x", np.float64),  # [m] distance along the course
        ("best_x", np.float64),  # [m] furthest x so far
        ("speed", np.float64),  # V [m/s]
        ("wheel_speed", np.float64),  # w [rad/s]
        ("sinkage", np.float64),  # z [m] below the undisturbed surface
        ("mass", np.float64),  # [kg]
        ("motor_torque", np.float64),  # [N m]
        ("available_torque", np.float64),  # [N m] of the motor at this wheel speed, in the direction of the command
        ("load", np.float64),  # W [N]
        ("drawbar_pull", np.float64),  # DP [N]
        ("torque", np.float64),  # T [N m], soil on wheel
        ("slip", np.float64),  # [-]
        ("pull_by_speed", np.float64),  # dDP/dV [N s/m] at the end of the last substep
        ("pull_by_rim", np.float64),  # dDP/d(r w)
        ("torque_by_speed", np.float64),  # dT/dV [N s]
        ("torque_by_rim", np.float64),  # dT/d(r w)
        ("bearing_sinkage", np.float64),  # z_w [m]
        ("grade", np.float64),  # [rad] at the wheel
        ("motor_work", np.float64),  # [J] in the last control period
        ("soil_work", np.float64),  # [J] that soil and drivetrain took from it, T w - DP V, in the last control period
        ("travel", np.float64),  # [m] in the last control period
        ("last_action", np.float64),  # [-1, 1]
        ("entrapped_time", np.float64),  # [s] the conditions of entrapment have held
        ("stalled_time", np.float64),  # [s] the conditions of stalling have held
        ("next_halt", np.float64),  # [m] place of the next commanded halt
        ("halt_left", np.float64),  # [s] left of the present halt, 0 while driving
        ("converged", np.int64),  # 1 unless a Newton iteration of the last control period failed at the finest substep
        ("patch", np.int64),
        ("cell", np.int64),
        ("steps", np.int64),  # control periods since reset
    ],
    align=True,
)


class WorldNumbers(NamedTuple):
    """What the dynamics take from a `Scenario`."""

    radius: float
    width: float
    inertia: float
    stall_torque: float
    no_load_speed: float
    gravity: float
    relaxation: float  # [m]
    border: float  # [m]
    halt_low: float  # [m]
    halt_high: float  # [m]
    halt_time: float  # [s]
    period: float  # [s]
    substeps: int
    speed_command: bool
    with_effects: bool  # whether any effect below is on
    grouser_height: float  # [m]
    unit_weight: float  # of the soil [N/m3]
    effects: Effects  # those that act on the wheel, not on its sensors
    residual: ResidualLaw


def world_numbers(scenario: Scenario, model: WheelSoilModel | None = None) -> WorldNumbers:
    """Pack what `advance` needs; `model` brings the effects that are on in this world."""
    w, c = scenario.wheel, scenario.control
    effects = NO_EFFECTS if model is None else acting(model.numbers)
    terms = () if model is None else model.residual
    return WorldNumbers(
        w.radius,
        w.width,
        w.inertia,
        w.stall_torque,
        w.no_load_speed,
        scenario.gravity,
        scenario.relaxation * w.radius,
        scenario.course.border,
        *scenario.course.halt_interval,
        scenario.course.halt_time,
        c.period,
        math.ceil(c.period / c.substep - 1e-9),
        c.action == "wheel_speed",
        effects != NO_EFFECTS or len(terms) > 0,
        0.0 if model is None else model.wheel.grouser_height,
        0.0 if model is None else model.density * scenario.gravity,
        effects,
        residual_law(terms),
    )


@inlined
def motor(command, by_speed, wheel_speed, world):
    """(torque, d torque/dw, available): motor torque [N m] for a command in [-1, 1].

    The command is a share of the stall torque or, with `by_speed`, of the no-load speed, which a stiff speed loop then
    follows. Either way the torque stays between the torque-speed lines of full voltage forward and backward,
    T_stall (+-1 - w/w_0), and within +-T_stall: faster than the no-load speed the motor brakes. `available` is the line
    on the side of the command. Of floats or in lanes; `by_speed` is 1 or 0.
    """
    stall, line = world.stall_torque, world.stall_torque / world.no_load_speed
    high = smaller(larger(stall - line * wheel_speed, -stall), stall)
    low = smaller(larger(-stall - line * wheel_speed, -stall), stall)
    gain = 10.0 * line
    follow = gain * (command * world.no_load_speed - wheel_speed)
    torque = where_less(0.5, by_speed, follow, command * stall)
    slope = where_less(0.5, by_speed, -gain, 0.0)
    available = where_less(torque, 0.0, -low, high)
    on_high = where_less(-stall, high, where_less(high, stall, -line, 0.0), 0.0)
    on_low = where_less(-stall, low, where_less(low, stall, -line, 0.0), 0.0)
    slope = where_less(high, torque, on_high, where_less(torque, low, on_low, slope))
    return where_less(high, torque, high, where_less(torque, low, low, torque)), slope, available


@inlined
def newton_step(f1, f2, cv, cu, dp_v, dp_u, torque_v, net_u):
    """(dV, du) of Newton's method for the residuals of implicit Euler; `net_u` = d(T - T_motor)/du."""
    a11, a12 = 1.0 - cv * dp_v, -cv * dp_u
    a21, a22 = cu * torque_v, 1.0 + cu * net_u
    det = a11 * a22 - a12 * a21
    det = where_less(1e-12, abs(det), det, 1e-12)
    return -(a22 * f1 - a12 * f2) / det, -(a11 * f2 - a21 * f1) / det


@inlined
def implicit_speeds(w, load, ground, command, by_speed, grade, world, h):
    """Implicit Euler for (V, u = r w) of wheel `w` (a WHEEL_STATE) over h seconds: (V, u, Reaction, converged).

    The first step goes by the reaction of the last substep to first order, where it is short. Newton's residual
    falls quadratically: once it is foretold to fall far below the tolerance, by the last two residuals or by
    the change of shear that the step makes, the step is taken with the reaction to first order instead of being
    computed once more.
    """
    r = world.radius
    weight_along = w.mass * world.gravity * math.sin(grade)
    cv, cu = h / w.mass, h * r / world.inertia
    speed0, u0 = w.speed, w.wheel_speed * r
    v, u = speed0, u0
    torque, torque_w, _ = motor(command, by_speed, u / r, world)
    dv, du = newton_step(
        -cv * (w.drawbar_pull - weight_along), -cu * (torque - w.torque), cv, cu,
        w.pull_by_speed, w.pull_by_rim, w.torque_by_speed, w.torque_by_rim - torque_w / r,
    )  # fmt: skip
    if max(abs(dv), abs(du)) < SHORT * (abs(u) + REST_SPEED):
        v, u = v + dv, u + du
        torque, torque_w, _ = motor(command, by_speed, u / r, world)
    soil = ground.soil
    nodes = arc_nodes(
        ground.theta1, ground.theta2, ground.thetam, soil.sinkage_exponent, ground.radius, ground.sheared_from
    )
    curvature = 1.0 + r * ground.theta1 / soil.shear_modulus  # relative change of the shear over that of the speeds
    soil_force = react(nodes, ground, v, u, load, world)
    f1 = v - speed0 - cv * (soil_force.drawbar_pull - weight_along)
    f2 = u - u0 - cu * (torque - soil_force.torque)
    norm = max(abs(f1), abs(f2))
    before = 0.1 * norm  # nothing is foretold by the first residual alone
    for _ in range(_MAX_ITERATIONS):
        dv, du = newton_step(
            f1, f2, cv, cu, soil_force.dp_v, soil_force.dp_u, soil_force.torque_v, soil_force.torque_u - torque_w / r
        )
        foretold = min(norm / before, max(abs(dv), abs(du)) * curvature / (abs(u) + REST_SPEED)) * norm
        if foretold < FORETOLD * TOLERANCE:
            trial = moved(soil_force, dv, du)
            torque, _, _ = motor(command, by_speed, (u + du) / r, world)
            g1 = v + dv - speed0 - cv * (trial.drawbar_pull - weight_along)
            g2 = u + du - u0 - cu * (torque - trial.torque)
            if max(abs(g1), abs(g2)) < 0.1 * TOLERANCE and trial.modulus > 0.0:
                return v + dv, u + du, trial, True
        if norm < TOLERANCE:
            return v, u, soil_force, True
        share = 1.0
        v1, u1, g1, g2, trial = v, u, f1, f2, soil_force
        reached = norm
        for _ in range(8):
            v1, u1 = v + share * dv, u + share * du
            trial = react(nodes, ground, v1, u1, load, world)
            torque, torque_w, _ = motor(command, by_speed, u1 / r, world)
            g1 = v1 - speed0 - cv * (trial.drawbar_pull - weight_along)
            g2 = u1 - u0 - cu * (torque - trial.torque)
            reached = max(abs(g1), abs(g2))
            if reached < norm * (1.0 - 0.1 * share):
                break
            share *= 0.4
        if not reached < norm:
            break
        before, norm = norm, reached
        v, u, f1, f2, soil_force = v1, u1, g1, g2, trial
    return v, u, soil_force, norm < 1e-4


@inlined
def bearing_sinkage(sinkage, modulus, soil):
    """z_w [m]: depth at which undisturbed soil bears the pressure `modulus` z^n, at most 10 z."""
    n = larger(soil.sinkage_exponent, 0.05)
    return sinkage * smaller(power(modulus / soil.sinkage_coefficient, 1.0 / n), 10.0)


@inlined
def relax_sinkage(sinkage, bearing, speed, slip_speed, soil, length, h):
    """Sinkage [m] after h seconds of dz/dt = B z_w - A z (`effects.excavation_rate`)."""
    a, b = excavation_rate(abs(speed), abs(slip_speed), soil.dig_gain, soil.dig_recovery, length)
    yielding = where_less(sinkage, bearing, 1.0 / SETTLING_TIME, 0.0)  # under the load at once, travelling or not
    a, b = a + yielding, b + yielding
    goal = b * bearing / a
    return where_less(a * h, 1e-12, sinkage, goal + (sinkage - goal) * exp(-a * h))


@kernel
def advance(state, k, command, courses, streams, world):
    """Drive wheel k for one control period with a command in [-1, 1]; updates state[k] and its rut.

    During a commanded halt the drive ignores the command and holds the wheel with its speed loop.
    """
    w = state[k]
    by_speed = world.speed_command
    if w.halt_left > 0.0:
        command, by_speed = 0.0, True
    x_start = w.x
    w.motor_work = w.soil_work = 0.0
    w.converged = 1
    drive(state, k, command, by_speed, courses, world, world.period)
    finish(state, k, command, x_start, streams, world)


@kernel
def drive(state, k, command, by_speed, courses, world, left):
    """Substeps of wheel k for the `left` seconds that remain of a control period."""
    w = state[k]
    r = world.radius
    longest = world.period / world.substeps
    h = longest
    while left > 1e-9 * longest:
        h = min(h, left)
        soil, grade, patch = ground_at(courses, k, w.x + 0.5 * h * w.speed, w.patch, world.border)
        soil = stiffened(soil, courses.modulus[k, w.cell])
        load = w.mass * world.gravity * math.cos(grade)
        if world.with_effects:
            passes = 2.0 if courses.rut[k, w.cell] > 0.0 else 1.0
            ground = ground_with_effects(w, soil, grade, passes, world)
        else:
            ground = plain_ground(w, soil, world)
        v, u, soil_force, converged = implicit_speeds(w, load, ground, command, by_speed, grade, world, h)
        if not converged:
            if h > longest / FINEST:
                h *= 0.5
                continue
            w.converged = 0
        bearing = bearing_sinkage(w.sinkage, soil_force.modulus, ground.soil) + ground.lift
        sinkage = relax_sinkage(w.sinkage, bearing, v, u - v, ground.soil, world.relaxation, h)
        torque, _, available = motor(command, by_speed, u / r, world)

        w.x += 0.5 * h * (w.speed + v)
        w.motor_work += h * torque * u / r
        w.soil_work += h * (soil_force.torque * u / r - soil_force.drawbar_pull * v)
        w.speed, w.wheel_speed = v, u / r
        w.sinkage = min(max(sinkage, SHALLOWEST * r), DEEPEST * r)
        w.bearing_sinkage = bearing
        w.motor_torque, w.available_torque = torque, available
        w.load, w.drawbar_pull, w.torque = soil_force.load, soil_force.drawbar_pull, soil_force.torque
        w.pull_by_speed, w.pull_by_rim = soil_force.dp_v, soil_force.dp_u
        w.torque_by_speed, w.torque_by_rim = soil_force.torque_v, soil_force.torque_u
        w.grade, w.patch = grade, patch
        left -= h
        h = longest
        cell = cell_at(courses, w.x)
        while w.cell != cell:
            leave_rut(courses, k, w.cell, w.sinkage, bearing)
            w.cell += 1 if cell > w.cell else -1


@inlined
def finish(state, k, command, x_start, streams, world):
    """The end of a control period of wheel k, which began at `x_start` [m]: slip, travel and halts."""
    w = state[k]
    w.slip = slip_ratio(w.wheel_speed * world.radius, w.speed, REST_SPEED)
    w.travel = w.x - x_start
    w.best_x = max(w.best_x, w.x)
    w.last_action = command
    w.steps += 1
    if w.halt_left > 0.0:
        w.halt_left = max(0.0, w.halt_left - world.period)
    elif w.x >= w.next_halt:
        w.halt_left = world.halt_time
        w.next_halt = w.x + between(streams, k, world.halt_low, world.halt_high)


@kernel
def settle(state, k, mass, courses, streams, world):
    """Put wheel k at rest at the start of its course, sunk in under its own load."""
    w = state[k]
    w.x, w.patch = 0.0, 0
    soil, grade, patch = ground_at(courses, k, w.x, w.patch, world.border)
    load = mass * world.gravity * math.cos(grade)
    wheel, here = Rim(world.radius, world.width, world.grouser_height), Conditions(0.0, 1.0, math.sin(grade))
    rest = steady_with(0.0, load, soil, wheel, here, world.unit_weight, world.effects, 0.0)
    w.best_x = w.speed = w.wheel_speed = 0.0
    w.sinkage = w.bearing_sinkage = max(rest.sinkage, SHALLOWEST * world.radius)
    w.mass, w.load, w.grade, w.patch = mass, load, grade, patch
    w.motor_torque = w.drawbar_pull = w.torque = w.slip = 0.0
    w.pull_by_speed = w.pull_by_rim = w.torque_by_speed = w.torque_by_rim = 0.0
    w.available_torque = world.stall_torque
    w.motor_work = w.soil_work = w.travel = w.last_action = w.entrapped_time = w.stalled_time = 0.0
    w.converged, w.cell, w.steps = 1, 0, 0
    w.next_halt, w.halt_left = between(streams, k, world.halt_low, world.halt_high), 0.0
