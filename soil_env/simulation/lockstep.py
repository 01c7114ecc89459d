"""Wheels in lockstep, eight at a time in the lanes of vectors: `dynamics.advance` of the base model without waiting.

Within one wheel nearly everything depends on what came before, and a processor that steps one wheel after the other
mostly waits. Here each operation acts on eight wheels. They share no number: a wheel goes through the same operations
on the same bits whoever its neighbours are, so that a lone wheel, repeated in all lanes, gives what it gives among
others. Newton's method takes one wheel longer than another: a lane whose wheel has converged goes on with the next of
up to `MANY`. A wheel whose iteration fails goes on alone by shorter substeps, as in `dynamics.drive`. Worlds with
effects are stepped by `dynamics.advance`.
"""

from __future__ import annotations

from soil_env._numba.compiling import inlined, inner, kernel, pasted
from soil_env._numba.elementary import half_sin_cos, larger, smaller, where_less
from soil_env._numba.lanes import COUNT, bits, fill, from_array, scratch, to_array
from soil_env.parameters import SoilState
from soil_env.simulation.dynamics import (
    FINEST,
    FORETOLD,
    SHALLOWEST,
    SHORT,
    TOLERANCE,
    bearing_sinkage,
    finish,
    motor,
    newton_step,
    relax_sinkage,
)
from soil_env.simulation.terrain import cell_at, ground_at, leave_rut
from soil_env.terramechanics.arcs import ARCS, Arcs, arcs_integrals, entry_angle_of_many, store_arcs
from soil_env.terramechanics.contact import motion_from_speeds
from soil_env.terramechanics.model import DEEPEST
from soil_env.terramechanics.reaction import REST_SPEED, Reaction, moved, reaction_from

MANY = 16 * COUNT  # wheels that `advance_many` takes at most
_PASSES = 60  # evaluations of the reaction in a substep, at most
_TRIES = 8  # of them at most along one step of Newton's method
_HUGE = 1e300

# Scratch is in blocks of eight wheels, a row of eight floats for each quantity. Rows of the wheels over a period:
_X, _SPEED, _WHEEL_SPEED, _SINKAGE, _MASS, _PULL, _TORQUE = 0, 8, 16, 24, 32, 40, 48
_PULL_V, _PULL_U, _TORQUE_V, _TORQUE_U, _COMMAND, _BY_SPEED, _WORK = 56, 64, 72, 80, 88, 96, 104
_MOTOR, _AVAILABLE, _LOAD, _BEARING, _CLEAN, _LEFT, _ALIVE, _SOIL = 112, 120, 128, 136, 144, 152, 160, 168
_WHEELS = 22 * COUNT
_wheels = scratch(_WHEELS * MANY // COUNT)
# of the ground under them in a substep:
_TAN_PHI, _COHESION, _K, _S, _N, _GAIN, _RECOVERY, _GRADE = 0, 8, 16, 24, 32, 40, 48, 56
_GROUND = 8 * COUNT
_ground = scratch(_GROUND * MANY // COUNT)
# of the equations of a substep, which Newton's method solves, and behind them the nodes of the arcs:
_V0, _U0, _CV, _ALONG, _CARRIED, _TAN, _C, _SHEAR, _GIVEN, _FOLLOW, _THETA1, _SIN1, _P_COS, _P_SIN, _V1, _U1, _NODES = (
    range(0, 17 * COUNT, COUNT)
)
_EQUATIONS = _NODES + ARCS
# of its state and, in the end, its result:
_V, _U, _FORCE, _CONVERGED, _F1, _F2, _SLOPE, _NORM, _BEFORE, _SHARE, _DONE_TRIES, _DONE_PASSES = (
    0, 8, 16, 96, 104, 112, 120, 128, 136, 144, 152, 160
)  # fmt: skip
_RESULT = 13 * COUNT
_STATE = 21 * COUNT
# In both the last block is that of the wheels that take longer.
_equations, _states = scratch(_EQUATIONS * (MANY // COUNT + 1)), scratch(_STATE * (MANY // COUNT + 1))
_waiting, _starts, _lefts = scratch(MANY), scratch(MANY), scratch(MANY)
_occupants, _alone, _left_alone = scratch(COUNT), scratch(COUNT), scratch(COUNT)


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
def _load_force(a, at):
    """`Reaction` from its ten rows at a[at]; the load is not kept."""
    return Reaction(
        from_array(a, at), from_array(a, at + 8), from_array(a, at + 16), from_array(a, at + 24),
        from_array(a, at + 32), from_array(a, at + 40), from_array(a, at + 48), from_array(a, at + 56),
        from_array(a, at + 64), from_array(a, at + 72),
    )  # fmt: skip


@inlined
def _store_force(f, a, at):
    to_array(f.load, a, at)
    to_array(f.drawbar_pull, a, at + 8)
    to_array(f.torque, a, at + 16)
    to_array(f.modulus, a, at + 24)
    to_array(f.dp_v, a, at + 32)
    to_array(f.dp_u, a, at + 40)
    to_array(f.torque_v, a, at + 48)
    to_array(f.torque_u, a, at + 56)
    to_array(f.modulus_v, a, at + 64)
    to_array(f.modulus_u, a, at + 72)


@pasted
def _set_up(s, at, g, ground, e, to, world, h):
    """The equations of one substep of eight wheels, into e[to], and where Newton's method starts."""
    r = world.radius
    mass, speed0, u0 = from_array(s, at + _MASS), from_array(s, at + _SPEED), r * from_array(s, at + _WHEEL_SPEED)
    command, by_speed = from_array(s, at + _COMMAND), from_array(s, at + _BY_SPEED)
    sin_half, cos_half = half_sin_cos(from_array(g, ground + _GRADE))
    load = (world.gravity * mass) * (1.0 - 2.0 * sin_half * sin_half)
    weight_along = (world.gravity * mass) * (2.0 * sin_half * cos_half)
    cv, cu = h / mass, h * r / world.inertia
    torque, torque_w, _ = motor(command, by_speed, u0 / r, world)
    pull, twist = from_array(s, at + _PULL), from_array(s, at + _TORQUE)
    dv, du = newton_step(
        -cv * (pull - weight_along), -cu * (torque - twist), cv, cu,
        from_array(s, at + _PULL_V), from_array(s, at + _PULL_U),
        from_array(s, at + _TORQUE_V), from_array(s, at + _TORQUE_U) - torque_w / r,
    )  # fmt: skip
    share = _below(larger(abs(dv), abs(du)), SHORT * (abs(u0) + REST_SPEED))  # 1 where the step is short, else 0
    theta1 = entry_angle_of_many(from_array(s, at + _SINKAGE), r)
    arcs = store_arcs(theta1, from_array(g, ground + _N), r, e, to + _NODES)
    to_array(speed0, e, to + _V0)
    to_array(u0, e, to + _U0)
    to_array(cv, e, to + _CV)
    to_array(weight_along, e, to + _ALONG)
    to_array(load, e, to + _CARRIED)
    to_array(from_array(g, ground + _TAN_PHI), e, to + _TAN)
    to_array(from_array(g, ground + _COHESION), e, to + _C)
    to_array(from_array(g, ground + _K), e, to + _SHEAR)
    to_array(command, e, to + _GIVEN)
    to_array(by_speed, e, to + _FOLLOW)
    to_array(theta1, e, to + _THETA1)
    to_array(arcs.sin1, e, to + _SIN1)
    to_array(arcs.p_cos, e, to + _P_COS)
    to_array(arcs.p_sin, e, to + _P_SIN)
    to_array(speed0 + share * dv, e, to + _V1)
    to_array(u0 + share * du, e, to + _U1)


@pasted
def _iterate(e, at, n, to, world, h):
    """One pass of `dynamics.implicit_speeds` on the equations e[at] with Newton's state n[to]; 1 where it ended."""
    r, b, cu = world.radius, world.width, h * world.radius / world.inertia
    zero, one = fill(0.0), fill(1.0)
    speed0, u0 = from_array(e, at + _V0), from_array(e, at + _U0)
    cv, weight_along = from_array(e, at + _CV), from_array(e, at + _ALONG)
    load, K = from_array(e, at + _CARRIED), from_array(e, at + _SHEAR)
    command, by_speed = from_array(e, at + _GIVEN), from_array(e, at + _FOLLOW)
    theta1, sin1 = from_array(e, at + _THETA1), from_array(e, at + _SIN1)
    arcs = Arcs(theta1, sin1, from_array(e, at + _P_COS), from_array(e, at + _P_SIN))
    v1, u1 = from_array(e, at + _V1), from_array(e, at + _U1)
    motion = motion_from_speeds(u1, v1, REST_SPEED)
    integrals = arcs_integrals(e, at + _NODES, arcs, motion[0], motion[1], K, r)
    trial = reaction_from(integrals, motion, v1, u1, load, from_array(e, at + _TAN), from_array(e, at + _C), r, b)
    torque, slope, _ = motor(command, by_speed, u1 / r, world)
    g1 = v1 - speed0 - cv * (trial.drawbar_pull - weight_along)
    g2 = u1 - u0 - cu * (torque - trial.torque)
    reached = larger(abs(g1), abs(g2))
    share, tries, norm = from_array(n, to + _SHARE), from_array(n, to + _DONE_TRIES), from_array(n, to + _NORM)
    last = _below(_TRIES - 1.5, tries)
    better = _below(reached, norm * _chosen(last, one, 1.0 - 0.1 * share))
    failed = last * (1.0 - better)
    before = _chosen(better, where_less(norm, 0.5 * _HUGE, norm, 0.1 * reached), from_array(n, to + _BEFORE))
    norm = _chosen(better, reached, norm)
    v, u = _chosen(better, v1, from_array(n, to + _V)), _chosen(better, u1, from_array(n, to + _U))
    f1, f2 = _chosen(better, g1, from_array(n, to + _F1)), _chosen(better, g2, from_array(n, to + _F2))
    torque_w = _chosen(better, slope, from_array(n, to + _SLOPE))
    f = _pick(better, trial, _load_force(n, to + _FORCE))
    share, tries = _chosen(better, one, 0.4 * share), _chosen(better, zero, tries + 1.0)
    converged = failed * _below(norm, fill(1e-4))

    dv, du = newton_step(f1, f2, cv, cu, f.dp_v, f.dp_u, f.torque_v, f.torque_u - torque_w / r)
    curvature = 1.0 + r * arcs.theta1 / K
    foretold = norm * smaller(norm / before, larger(abs(dv), abs(du)) * curvature / (abs(u) + REST_SPEED))
    ahead = moved(f, dv, du)
    torque, _, _ = motor(command, by_speed, (u + du) / r, world)
    g1 = v + dv - speed0 - cv * (ahead.drawbar_pull - weight_along)
    g2 = u + du - u0 - cu * (torque - ahead.torque)
    seen = _below(foretold, fill(FORETOLD * TOLERANCE)) * _below(larger(abs(g1), abs(g2)), fill(0.1 * TOLERANCE))
    seen = seen * _below(zero, ahead.modulus) * better
    there = larger(seen, better * _below(norm, fill(TOLERANCE)))
    passes = from_array(n, to + _DONE_PASSES) + 1.0
    to_array(f1, n, to + _F1)
    to_array(f2, n, to + _F2)
    to_array(torque_w, n, to + _SLOPE)
    to_array(norm, n, to + _NORM)
    to_array(before, n, to + _BEFORE)
    to_array(share, n, to + _SHARE)
    to_array(tries, n, to + _DONE_TRIES)
    to_array(passes, n, to + _DONE_PASSES)
    to_array(v + share * dv, e, at + _V1)
    to_array(u + share * du, e, at + _U1)
    to_array(_chosen(seen, v + dv, v), n, to + _V)
    to_array(_chosen(seen, u + du, u), n, to + _U)
    _store_force(_pick(seen, ahead, f), n, to + _FORCE)
    to_array(larger(converged, there), n, to + _CONVERGED)
    return larger(larger(failed, there), _below(_PASSES - 0.5, passes))


@inlined
def _begin(e, at, n, to):
    """Newton's state of eight wheels at the start of a substep."""
    zero, one, huge = fill(0.0), fill(1.0), fill(_HUGE)
    for row in range(0, _STATE, COUNT):
        to_array(zero, n, to + row)
    to_array(from_array(e, at + _V0), n, to + _V)
    to_array(from_array(e, at + _U0), n, to + _U)
    to_array(huge, n, to + _NORM)
    to_array(huge, n, to + _BEFORE)
    to_array(one, n, to + _SHARE)


@inlined
def _enter(e, n, k, block, i):
    """Wheel k with its state into lane i of a block."""
    start, to = (k // COUNT) * _EQUATIONS + k % COUNT, block * _EQUATIONS + i
    for row in range(0, _EQUATIONS, COUNT):
        e[to + row] = e[start + row]
    start, to = (k // COUNT) * _STATE + k % COUNT, block * _STATE + i
    for row in range(0, _STATE, COUNT):
        n[to + row] = n[start + row]


@pasted
def _solve(e, n, count, world, h):
    """The speeds and reactions of `count` wheels at the end of a substep, into their states `n`.

    One pass for all, on the spot; those that have not ended go on in the last block, where a lane takes the next as
    soon as its wheel has ended.
    """
    blocks = (count + COUNT - 1) // COUNT
    waiting, which = _waiting(), _occupants()
    block = following = queue = working = 0
    while True:
        filling = block < blocks
        if filling:
            _begin(e, block * _EQUATIONS, n, block * _STATE)
        ended = bits(_iterate(e, block * _EQUATIONS, n, block * _STATE, world, h))
        if filling:
            for i in range(min(count - block * COUNT, COUNT)):
                if ended >> i & 1 == 0:
                    waiting[queue] = float(block * COUNT + i)
                    queue += 1
            block += 1
            if block < blocks:
                continue
            block, ended = MANY // COUNT, (1 << COUNT) - 1
            for i in range(COUNT):
                which[i] = -1.0
        for i in range(COUNT):
            if ended >> i & 1 == 0:
                continue
            k = int(which[i])
            if k >= 0:
                start, to = block * _STATE + i, (k // COUNT) * _STATE + k % COUNT
                for row in range(0, _RESULT, COUNT):
                    n[to + row] = n[start + row]
                which[i] = -1.0
                working -= 1
            if following < queue or (filling and queue > 0):  # no lane without a wheel, if only another's
                k = int(waiting[min(following, queue - 1)])
                _enter(e, n, k, block, i)
                if following < queue:
                    which[i] = float(k)
                    working += 1
                following += 1
        if working == 0:
            return


@pasted
def _gather_ground(s, at, g, ground, which, first, state, courses, world, h):
    """The ground under eight wheels in the middle of the substep."""
    for i in range(COUNT):
        k = int(which[first + i])
        w = state[k]
        x = s[at + _X + i] + 0.5 * h * s[at + _SPEED + i]
        soil, grade, patch = ground_at(courses, k, x, w.patch, world.border)
        w.patch = patch
        j = ground + i
        g[j + _TAN_PHI], g[j + _COHESION], g[j + _K] = soil.tan_phi, soil.cohesion, soil.shear_modulus
        g[j + _S] = soil.sinkage_coefficient * courses.modulus[k, w.cell]
        g[j + _N], g[j + _GAIN], g[j + _RECOVERY] = soil.sinkage_exponent, soil.dig_gain, soil.dig_recovery
        g[j + _GRADE] = grade


@pasted
def _move(s, at, g, ground, results, found, world, h, anyhow):
    """Eight wheels to the end of a substep, but those not alive; who did not converge dies, unless `anyhow` is 1."""
    r = world.radius
    soil = SoilState(
        from_array(g, ground + _TAN_PHI), from_array(g, ground + _COHESION), from_array(g, ground + _K),
        from_array(g, ground + _S), from_array(g, ground + _N), from_array(g, ground + _GAIN),
        from_array(g, ground + _RECOVERY),
    )  # fmt: skip
    v, u, f = from_array(results, found + _V), from_array(results, found + _U), _load_force(results, found + _FORCE)
    converged = from_array(results, found + _CONVERGED)
    alive = from_array(s, at + _ALIVE) * larger(converged, anyhow)
    speed, sinkage = from_array(s, at + _SPEED), from_array(s, at + _SINKAGE)
    bearing = bearing_sinkage(sinkage, f.modulus, soil)
    relaxed = relax_sinkage(sinkage, bearing, v, u - v, soil, world.relaxation, h)
    torque, _, available = motor(from_array(s, at + _COMMAND), from_array(s, at + _BY_SPEED), u / r, world)
    x, work = from_array(s, at + _X), from_array(s, at + _WORK)
    to_array(alive, s, at + _ALIVE)
    to_array(_chosen(alive, from_array(s, at + _CLEAN) * converged, fill(1.0)), s, at + _CLEAN)
    to_array(_chosen(alive, x + 0.5 * h * (speed + v), x), s, at + _X)
    to_array(_chosen(alive, work + h * torque * u / r, work), s, at + _WORK)
    taken = from_array(s, at + _SOIL)
    to_array(_chosen(alive, taken + h * (f.torque * u / r - f.drawbar_pull * v), taken), s, at + _SOIL)
    to_array(_chosen(alive, v, speed), s, at + _SPEED)
    to_array(_chosen(alive, u / r, from_array(s, at + _WHEEL_SPEED)), s, at + _WHEEL_SPEED)
    sunk = smaller(larger(relaxed, fill(SHALLOWEST * r)), fill(DEEPEST * r))
    to_array(_chosen(alive, sunk, sinkage), s, at + _SINKAGE)
    to_array(_chosen(alive, bearing, from_array(s, at + _BEARING)), s, at + _BEARING)
    to_array(_chosen(alive, torque, from_array(s, at + _MOTOR)), s, at + _MOTOR)
    to_array(_chosen(alive, available, from_array(s, at + _AVAILABLE)), s, at + _AVAILABLE)
    to_array(_chosen(alive, f.load, from_array(s, at + _LOAD)), s, at + _LOAD)
    to_array(_chosen(alive, f.drawbar_pull, from_array(s, at + _PULL)), s, at + _PULL)
    to_array(_chosen(alive, f.torque, from_array(s, at + _TORQUE)), s, at + _TORQUE)
    to_array(_chosen(alive, f.dp_v, from_array(s, at + _PULL_V)), s, at + _PULL_V)
    to_array(_chosen(alive, f.dp_u, from_array(s, at + _PULL_U)), s, at + _PULL_U)
    to_array(_chosen(alive, f.torque_v, from_array(s, at + _TORQUE_V)), s, at + _TORQUE_V)
    to_array(_chosen(alive, f.torque_u, from_array(s, at + _TORQUE_U)), s, at + _TORQUE_U)
    left = from_array(s, at + _LEFT)
    to_array(_chosen(alive, left - h, left), s, at + _LEFT)


@pasted
def _load_wheels(s, at, which, first, state, commands, world, left):
    """Eight wheels into the scratch."""
    for i in range(COUNT):
        w, j = state[int(which[first + i])], at + i
        halted = w.halt_left > 0.0
        s[j + _X] = w.x
        s[j + _SPEED], s[j + _WHEEL_SPEED], s[j + _SINKAGE] = w.speed, w.wheel_speed, w.sinkage
        s[j + _MASS], s[j + _PULL], s[j + _TORQUE] = w.mass, w.drawbar_pull, w.torque
        s[j + _PULL_V], s[j + _PULL_U] = w.pull_by_speed, w.pull_by_rim
        s[j + _TORQUE_V], s[j + _TORQUE_U] = w.torque_by_speed, w.torque_by_rim
        s[j + _COMMAND] = 0.0 if halted else commands[first + i]
        s[j + _BY_SPEED] = 1.0 if halted or world.speed_command else 0.0
        s[j + _WORK], s[j + _SOIL], s[j + _LEFT], s[j + _ALIVE] = w.motor_work, w.soil_work, left, 1.0
        s[j + _CLEAN] = 1.0
        s[j + _MOTOR], s[j + _AVAILABLE], s[j + _LOAD] = w.motor_torque, w.available_torque, w.load
        s[j + _BEARING] = w.bearing_sinkage


@pasted
def _store_wheel(s, j, grade, w):
    """A wheel from its place j in the scratch."""
    w.x, w.speed, w.wheel_speed, w.sinkage = s[j + _X], s[j + _SPEED], s[j + _WHEEL_SPEED], s[j + _SINKAGE]
    w.drawbar_pull, w.torque, w.load = s[j + _PULL], s[j + _TORQUE], s[j + _LOAD]
    w.pull_by_speed, w.pull_by_rim = s[j + _PULL_V], s[j + _PULL_U]
    w.torque_by_speed, w.torque_by_rim = s[j + _TORQUE_V], s[j + _TORQUE_U]
    w.motor_torque, w.available_torque, w.motor_work = s[j + _MOTOR], s[j + _AVAILABLE], s[j + _WORK]
    w.soil_work, w.bearing_sinkage, w.grade = s[j + _SOIL], s[j + _BEARING], grade
    if s[j + _CLEAN] == 0.0:
        w.converged = 0


@inner
def _drive_many(state, which, count, commands, courses, world, left, longest, anyhow, lefts):
    """Substeps of at most `longest` seconds for `left` seconds; lefts[i] is what then is left of them to wheel i.

    That is where Newton's method fails, and the wheel stays as it was before; with `anyhow` = 1 it goes on.
    """
    blocks = (count + COUNT - 1) // COUNT
    s, g, equations, states = _wheels(), _ground(), _equations(), _states()
    for b in range(blocks):
        _load_wheels(s, b * _WHEELS, which, b * COUNT, state, commands, world, left)
    while left > 1e-9 * longest:
        h = min(longest, left)
        for b in range(blocks):
            _gather_ground(s, b * _WHEELS, g, b * _GROUND, which, b * COUNT, state, courses, world, h)
            _set_up(s, b * _WHEELS, g, b * _GROUND, equations, b * _EQUATIONS, world, h)
        _solve(equations, states, count, world, h)
        for b in range(blocks):
            for i in range(count - b * COUNT, COUNT):  # the repeated
                for row in range(0, _RESULT, COUNT):
                    states[b * _STATE + row + i] = states[b * _STATE + row + (count - 1) % COUNT]
            _move(s, b * _WHEELS, g, b * _GROUND, states, b * _STATE, world, h, anyhow)
        left -= h
        for i in range(count):
            k, j = int(which[i]), (i // COUNT) * _WHEELS + i % COUNT
            w = state[k]
            if s[j + _LEFT] > left + 1e-9 * longest:
                continue
            cell = cell_at(courses, s[j + _X])
            while w.cell != cell:
                leave_rut(courses, k, w.cell, s[j + _SINKAGE], s[j + _BEARING])
                w.cell += 1 if cell > w.cell else -1
    for i in range(count):
        j = (i // COUNT) * _WHEELS + i % COUNT
        _store_wheel(s, j, g[(i // COUNT) * _GROUND + _GRADE + i % COUNT], state[int(which[i])])
        lefts[i] = s[j + _LEFT] if s[j + _LEFT] > 1e-9 * longest else 0.0


@kernel
def advance_many(state, which, count, commands, courses, streams, world):
    """`dynamics.advance` of `count` <= MANY wheels, which[i] with commands[i]; both [MANY] float64.

    The rest of their last block of eight is overwritten. For worlds without effects.
    """
    starts, lefts, alone, given, rest = _starts(), _lefts(), _occupants(), _alone(), _left_alone()
    for i in range(count, (count + COUNT - 1) // COUNT * COUNT):
        which[i], commands[i] = which[count - 1], commands[count - 1]
    for i in range(count):
        w = state[int(which[i])]
        starts[i] = w.x
        w.motor_work = w.soil_work = 0.0
        w.converged = 1
    longest = world.period / world.substeps
    _drive_many(state, which, count, commands, courses, world, world.period, longest, 0.0, lefts)
    one = min(count, 1)  # not a literal, for which numba would compile the whole once more
    for i in range(count):
        k, left, h = int(which[i]), lefts[i], longest
        while left > 1e-9 * longest:  # Newton's method failed: halve the substep until it does not
            alone[0], given[0], h = which[i], commands[i], min(h, left)
            finest = h <= longest / FINEST
            _drive_many(state, alone, one, given, courses, world, h, h, 1.0 if finest else 0.0, rest)
            if rest[0] > 0.0 and not finest:
                h *= 0.5
            else:
                left -= h
                h = longest
        finish(state, k, 0.0 if state[k].halt_left > 0.0 else commands[i], starts[i], streams, world)
