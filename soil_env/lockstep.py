"""Eight wheels in lockstep, one a lane: `dynamics.advance` of the base model without waiting.

Within one wheel nearly everything depends on what came before, and a processor that steps one wheel after the other
mostly waits. Here each operation acts on eight wheels. They share no number: a wheel goes through the same operations
on the same bits whoever its neighbours are, so that a lone wheel, repeated in all lanes, gives what it gives among
others. Newton's method goes on until the last wheel has converged; those that have are left as they are. A wheel whose
iteration fails goes on alone, by `dynamics.drive`, from the substep that failed.
"""

from __future__ import annotations

from soil_env.arcs import ARCS, arcs_integrals, store_arcs
from soil_env.compiled import inlined, kernel
from soil_env.contact import entry_angle_of_many, motion_from_speeds
from soil_env.dynamics import (
    FORETOLD,
    REST_SPEED,
    SHALLOWEST,
    SHORT,
    TOLERANCE,
    Reaction,
    advance,
    bearing_sinkage,
    drive,
    finish,
    motor,
    moved,
    newton_step,
    reaction_from,
    relax_sinkage,
)
from soil_env.lanes import COUNT, fill, from_array, half_sin_cos, larger, scratch, smaller, to_array, total, where_less
from soil_env.model import DEEPEST
from soil_env.parameters import SoilState
from soil_env.terrain import cell_at, ground_at, leave_rut

_PASSES = 60  # evaluations of the reaction in a substep, at most
_TRIES = 8  # of them at most along one step of Newton's method
_HUGE = 1e300

# Rows of eight in the scratch of `advance_eight`
_X, _SPEED, _WHEEL_SPEED, _SINKAGE, _MASS, _PULL, _TORQUE = 0, 8, 16, 24, 32, 40, 48
_PULL_V, _PULL_U, _TORQUE_V, _TORQUE_U, _COMMAND, _BY_SPEED, _WORK = 56, 64, 72, 80, 88, 96, 104
_MOTOR, _AVAILABLE, _LOAD, _BEARING, _START, _LEFT, _SOIL = 112, 120, 128, 136, 144, 152, 160
_wheels = scratch(21 * COUNT)
# Rows of the scratch for the ground
_TAN_PHI, _COHESION, _K, _S, _N, _GAIN, _RECOVERY, _GRADE = 0, 8, 16, 24, 32, 40, 48, 56
_ground = scratch(8 * COUNT)
_nodes = scratch(ARCS)


@inlined
def _chosen(mask, x, y):
    """x where `mask` is 1, y where it is 0."""
    return where_less(0.5, mask, x, y)


@inlined
def _pick(mask, f, g):
    """`Reaction` f where `mask` is 1, g where it is 0."""
    return Reaction(
        _chosen(mask, f.load, g.load),
        _chosen(mask, f.drawbar_pull, g.drawbar_pull),
        _chosen(mask, f.torque, g.torque),
        _chosen(mask, f.modulus, g.modulus),
        _chosen(mask, f.dp_v, g.dp_v),
        _chosen(mask, f.dp_u, g.dp_u),
        _chosen(mask, f.torque_v, g.torque_v),
        _chosen(mask, f.torque_u, g.torque_u),
        _chosen(mask, f.modulus_v, g.modulus_v),
        _chosen(mask, f.modulus_u, g.modulus_u),
    )


@inlined
def _below(a, b):
    """1 where a < b, else 0."""
    return where_less(a, b, fill(1.0), fill(0.0))


@inlined
def _speeds(s, soil, grade_sin, load, theta1, sin1, nodes, world, h):
    """`dynamics.implicit_speeds` of eight wheels: (V, u, Reaction, converged)."""
    r, b = world.radius, world.width
    mass, speed0, u0 = from_array(s, _MASS), from_array(s, _SPEED), r * from_array(s, _WHEEL_SPEED)
    command, by_speed = from_array(s, _COMMAND), from_array(s, _BY_SPEED)
    weight_along = (world.gravity * mass) * grade_sin
    cv, cu = h / mass, h * r / world.inertia
    torque, torque_w, _ = motor(command, by_speed, u0 / r, world)
    zero = fill(0.0)
    f = Reaction(
        load, from_array(s, _PULL), from_array(s, _TORQUE), zero, from_array(s, _PULL_V), from_array(s, _PULL_U),
        from_array(s, _TORQUE_V), from_array(s, _TORQUE_U), zero, zero,
    )  # fmt: skip
    f1, f2 = -cv * (f.drawbar_pull - weight_along), -cu * (torque - f.torque)
    dv, du = newton_step(f1, f2, cv, cu, f.dp_v, f.dp_u, f.torque_v, f.torque_u - torque_w / r)
    short = _below(larger(abs(dv), abs(du)), SHORT * (abs(u0) + REST_SPEED))
    v, u = speed0, u0
    v1, u1 = v + _chosen(short, dv, zero), u + _chosen(short, du, zero)
    curvature = 1.0 + r * theta1 / soil.shear_modulus
    norm, before = fill(_HUGE), fill(_HUGE)
    share, tries, done, converged = fill(1.0), zero, zero, zero
    for _ in range(_PASSES):
        motion = motion_from_speeds(u1, v1, REST_SPEED)
        integrals = arcs_integrals(nodes, theta1, sin1, motion[0], motion[1], soil.shear_modulus, r)
        trial = reaction_from(integrals, motion, v1, u1, load, soil.tan_phi, soil.cohesion, r, b)
        torque, slope, _ = motor(command, by_speed, u1 / r, world)
        g1 = v1 - speed0 - cv * (trial.drawbar_pull - weight_along)
        g2 = u1 - u0 - cu * (torque - trial.torque)
        reached = larger(abs(g1), abs(g2))
        last = _below(_TRIES - 1.5, tries)
        better = _below(reached, norm * _chosen(last, fill(1.0), 1.0 - 0.1 * share)) * (1.0 - done)
        failed = last * (1.0 - better) * (1.0 - done)
        before = _chosen(better, where_less(norm, 0.5 * _HUGE, norm, 0.1 * reached), before)
        norm = _chosen(better, reached, norm)
        v, u = _chosen(better, v1, v), _chosen(better, u1, u)
        f1, f2, torque_w = _chosen(better, g1, f1), _chosen(better, g2, f2), _chosen(better, slope, torque_w)
        f = _pick(better, trial, f)
        share, tries = _chosen(better, fill(1.0), 0.4 * share), _chosen(better, zero, tries + 1.0)
        converged = _chosen(failed, _below(norm, fill(1e-4)), converged)
        done = larger(done, failed)

        dv, du = newton_step(f1, f2, cv, cu, f.dp_v, f.dp_u, f.torque_v, f.torque_u - torque_w / r)
        foretold = norm * smaller(norm / before, larger(abs(dv), abs(du)) * curvature / (abs(u) + REST_SPEED))
        ahead = moved(f, dv, du)
        torque, _, _ = motor(command, by_speed, (u + du) / r, world)
        g1 = v + dv - speed0 - cv * (ahead.drawbar_pull - weight_along)
        g2 = u + du - u0 - cu * (torque - ahead.torque)
        seen = _below(foretold, fill(FORETOLD * TOLERANCE)) * _below(larger(abs(g1), abs(g2)), fill(0.1 * TOLERANCE))
        seen = seen * _below(zero, ahead.modulus) * better
        v, u, f = _chosen(seen, v + dv, v), _chosen(seen, u + du, u), _pick(seen, ahead, f)
        there = larger(seen, better * _below(norm, fill(TOLERANCE)))
        converged, done = larger(converged, there), larger(done, there)
        if total(done) == COUNT:
            break
        v1, u1 = v + share * dv, u + share * du
    return v, u, f, converged


@inlined
def _gather_ground(s, g, which, state, courses, world, h):
    """The ground under each wheel in the middle of the substep, into `g`."""
    for i in range(COUNT):
        k = int(which[i])
        w = state[k]
        soil, grade, patch = ground_at(courses, k, s[_X + i] + 0.5 * h * s[_SPEED + i], w.patch, world.border)
        w.patch = patch
        g[_TAN_PHI + i], g[_COHESION + i], g[_K + i] = soil.tan_phi, soil.cohesion, soil.shear_modulus
        g[_S + i] = soil.sinkage_coefficient * courses.modulus[k, w.cell]
        g[_N + i], g[_GAIN + i], g[_RECOVERY + i] = soil.sinkage_exponent, soil.dig_gain, soil.dig_recovery
        g[_GRADE + i] = grade


@inlined
def _substep(s, g, nodes, alive, world, h):
    """One substep of the wheels in `s` on the ground in `g`, but for those with `alive` 0; which of them converged."""
    r = world.radius
    soil = SoilState(
        from_array(g, _TAN_PHI), from_array(g, _COHESION), from_array(g, _K), from_array(g, _S), from_array(g, _N),
        from_array(g, _GAIN), from_array(g, _RECOVERY),
    )  # fmt: skip
    sin_half, cos_half = half_sin_cos(from_array(g, _GRADE))
    load = (world.gravity * from_array(s, _MASS)) * (1.0 - 2.0 * sin_half * sin_half)
    speed, sinkage = from_array(s, _SPEED), from_array(s, _SINKAGE)
    theta1 = entry_angle_of_many(sinkage, r)
    sin1 = store_arcs(theta1, soil.sinkage_exponent, r, nodes)
    v, u, f, converged = _speeds(s, soil, 2.0 * sin_half * cos_half, load, theta1, sin1, nodes, world, h)
    alive = alive * converged
    bearing = bearing_sinkage(sinkage, f.modulus, soil)
    relaxed = relax_sinkage(sinkage, bearing, v, u - v, soil, world.relaxation, h)
    torque, _, available = motor(from_array(s, _COMMAND), from_array(s, _BY_SPEED), u / r, world)
    x, work = from_array(s, _X), from_array(s, _WORK)
    to_array(_chosen(alive, x + 0.5 * h * (speed + v), x), s, _X)
    to_array(_chosen(alive, work + h * torque * u / r, work), s, _WORK)
    taken = from_array(s, _SOIL)
    to_array(_chosen(alive, taken + h * (f.torque * u / r - f.drawbar_pull * v), taken), s, _SOIL)
    to_array(_chosen(alive, v, speed), s, _SPEED)
    to_array(_chosen(alive, u / r, from_array(s, _WHEEL_SPEED)), s, _WHEEL_SPEED)
    to_array(_chosen(alive, smaller(larger(relaxed, fill(SHALLOWEST * r)), fill(DEEPEST * r)), sinkage), s, _SINKAGE)
    to_array(_chosen(alive, bearing, from_array(s, _BEARING)), s, _BEARING)
    to_array(_chosen(alive, torque, from_array(s, _MOTOR)), s, _MOTOR)
    to_array(_chosen(alive, available, from_array(s, _AVAILABLE)), s, _AVAILABLE)
    to_array(_chosen(alive, f.load, from_array(s, _LOAD)), s, _LOAD)
    to_array(_chosen(alive, f.drawbar_pull, from_array(s, _PULL)), s, _PULL)
    to_array(_chosen(alive, f.torque, from_array(s, _TORQUE)), s, _TORQUE)
    to_array(_chosen(alive, f.dp_v, from_array(s, _PULL_V)), s, _PULL_V)
    to_array(_chosen(alive, f.dp_u, from_array(s, _PULL_U)), s, _PULL_U)
    to_array(_chosen(alive, f.torque_v, from_array(s, _TORQUE_V)), s, _TORQUE_V)
    to_array(_chosen(alive, f.torque_u, from_array(s, _TORQUE_U)), s, _TORQUE_U)
    left = from_array(s, _LEFT)
    to_array(_chosen(alive, left - h, left), s, _LEFT)
    return alive


@inlined
def _load_wheels(s, which, state, commands, world):
    """The wheels into `s`."""
    for i in range(COUNT):
        w = state[int(which[i])]
        halted = w.halt_left > 0.0
        s[_X + i] = s[_START + i] = w.x
        s[_SPEED + i], s[_WHEEL_SPEED + i], s[_SINKAGE + i] = w.speed, w.wheel_speed, w.sinkage
        s[_MASS + i], s[_PULL + i], s[_TORQUE + i] = w.mass, w.drawbar_pull, w.torque
        s[_PULL_V + i], s[_PULL_U + i] = w.pull_by_speed, w.pull_by_rim
        s[_TORQUE_V + i], s[_TORQUE_U + i] = w.torque_by_speed, w.torque_by_rim
        s[_COMMAND + i] = 0.0 if halted else commands[i]
        s[_BY_SPEED + i] = 1.0 if halted or world.speed_command else 0.0
        s[_WORK + i], s[_SOIL + i], s[_LEFT + i] = 0.0, 0.0, world.period
        s[_MOTOR + i], s[_AVAILABLE + i], s[_LOAD + i] = w.motor_torque, w.available_torque, w.load
        s[_BEARING + i] = w.bearing_sinkage


@inlined
def _store_wheel(s, g, i, w):
    """Wheel i of `s` into its state."""
    w.x, w.speed, w.wheel_speed, w.sinkage = s[_X + i], s[_SPEED + i], s[_WHEEL_SPEED + i], s[_SINKAGE + i]
    w.drawbar_pull, w.torque, w.load = s[_PULL + i], s[_TORQUE + i], s[_LOAD + i]
    w.pull_by_speed, w.pull_by_rim = s[_PULL_V + i], s[_PULL_U + i]
    w.torque_by_speed, w.torque_by_rim = s[_TORQUE_V + i], s[_TORQUE_U + i]
    w.motor_torque, w.available_torque, w.motor_work = s[_MOTOR + i], s[_AVAILABLE + i], s[_WORK + i]
    w.soil_work, w.bearing_sinkage, w.grade = s[_SOIL + i], s[_BEARING + i], g[_GRADE + i]
    w.converged = 1


@kernel
def advance_eight(state, which, count, commands, courses, streams, world):
    """`dynamics.advance` of `count` <= 8 wheels, of which[i] with commands[i]; both [8] float64, the rest repeated."""
    for i in range(count, COUNT):
        which[i], commands[i] = which[count - 1], commands[count - 1]
    if world.with_effects:
        for i in range(count):
            advance(state, int(which[i]), commands[i], courses, streams, world)
        return
    s, g, nodes = _wheels(), _ground(), _nodes()
    _load_wheels(s, which, state, commands, world)
    longest = world.period / world.substeps
    alive, left = fill(1.0), world.period
    while left > 1e-9 * longest:
        h = min(longest, left)
        _gather_ground(s, g, which, state, courses, world, h)
        alive = _substep(s, g, nodes, alive, world, h)
        left -= h
        for i in range(count):
            k = int(which[i])
            w = state[k]
            if s[_LEFT + i] > left + 1e-9 * longest:
                continue
            cell = cell_at(courses, s[_X + i])
            while w.cell != cell:
                leave_rut(courses, k, w.cell, s[_SINKAGE + i], s[_BEARING + i])
                w.cell += 1 if cell > w.cell else -1
    for i in range(count):
        k = int(which[i])
        _store_wheel(s, g, i, state[k])
        if s[_LEFT + i] > 1e-9 * longest:
            drive(state, k, s[_COMMAND + i], s[_BY_SPEED + i] > 0.0, courses, world, s[_LEFT + i])
        finish(state, k, s[_COMMAND + i], s[_START + i], streams, world)
