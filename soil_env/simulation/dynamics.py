"""One control period of many wheels: implicit Euler for the speeds, eight wheels at a time in lanes.

Sliding speed and travel speed answer to force within milliseconds for a slow rover, so (V, u = r w) are stepped by
implicit Euler with a safeguarded Newton iteration on analytic derivatives, and the sinkage z, which is slow, by the
exact solution of its law with A, B and z_w held over the substep (`wheel`).

Within one wheel nearly everything depends on what came before, and a processor that steps one wheel after the other
mostly waits. Here each operation acts on eight wheels. They share no number: a wheel goes through the same operations
on the same bits whoever its neighbours are, so that a wheel alone gives what it gives among others. Newton's method
takes one wheel longer than another: a lane whose wheel has converged goes on with the next of up to `MANY`. A wheel
whose iteration fails goes on by shorter substeps, its neighbours waiting.
"""

from __future__ import annotations

from soil_env._numba.compiling import inlined, part
from soil_env._numba.elementary import chosen, larger, smaller
from soil_env._numba.lanes import COUNT, from_array, to_array
from soil_env._numba.rows import scratch_rows
from soil_env.simulation.newton import (
    MANY,
    TOLERANCE,
    Period,
    gather_ground,
    load_reaction,
    scratch_of_substep,
    set_up,
    soil_in_lanes,
    solve_speeds,
)
from soil_env.simulation.terrain import cell_at, leave_rut
from soil_env.simulation.wheel import (
    SHALLOWEST,
    bearing_sinkage,
    finish,
    motor,
    relax_sinkage,
)
from soil_env.terramechanics.steady import DEEPEST

__all__ = ["MANY", "STEP", "TOLERANCE", "advance"]

STEP = 0  # what is to be done with a wheel: a control period
_FINEST = 1024  # a substep that fails is halved down to this fraction; softening soil breaks away within 1 ms
_period = scratch_rows(Period, MANY)


@inlined
def _keep(alive, row, k, value):
    """Store `value` in lanes where `alive` is 1."""
    to_array(chosen(alive, value, from_array(row, k)), row, k)


@inlined
def _move(state, first, i, period, sub, world, h, anyhow):
    """Eight wheels to the end of a substep, but those not alive; who did not converge dies, unless `anyhow` is 1."""
    n, g, k, r = sub.newton, sub.footing, first + i, world.wheel.radius
    v, u, f = from_array(n.v, i), from_array(n.u, i), load_reaction(n, i)
    converged = from_array(n.converged, i)
    alive = from_array(period.alive, i) * larger(converged, anyhow)
    to_array(alive, period.alive, i)
    _keep(alive, period.clean, i, from_array(period.clean, i) * converged)
    soil, sinkage, speed = soil_in_lanes(g, i), from_array(state.sinkage, k), from_array(state.speed, k)
    bearing = bearing_sinkage(sinkage, f.modulus, soil)
    if world.wheel.on:
        bearing = bearing + from_array(g.lift, i)
    relaxed = relax_sinkage(sinkage, bearing, v, u - v, soil, world.relaxation, h)
    torque, _, available = motor(from_array(period.command, i), from_array(period.by_speed, i), u / r, world)
    _keep(alive, state.x, k, from_array(state.x, k) + 0.5 * h * (speed + v))
    _keep(alive, state.motor_work, k, from_array(state.motor_work, k) + h * torque * u / r)
    work = h * (f.torque * u / r - f.drawbar_pull * v)
    _keep(alive, state.soil_work, k, from_array(state.soil_work, k) + work)
    _keep(alive, state.speed, k, v)
    _keep(alive, state.wheel_speed, k, u / r)
    _keep(alive, state.sinkage, k, smaller(larger(relaxed, SHALLOWEST * r), DEEPEST * r))
    _keep(alive, state.bearing_sinkage, k, bearing)
    _keep(alive, state.motor_torque, k, torque)
    _keep(alive, state.available_torque, k, available)
    _keep(alive, state.load, k, f.load)
    _keep(alive, state.drawbar_pull, k, f.drawbar_pull)
    _keep(alive, state.torque, k, f.torque)
    _keep(alive, state.pull_by_speed, k, f.dp_v)
    _keep(alive, state.pull_by_rim, k, f.dp_u)
    _keep(alive, state.torque_by_speed, k, f.torque_v)
    _keep(alive, state.torque_by_rim, k, f.torque_u)
    _keep(alive, state.grade, k, from_array(g.grade, i))
    _keep(alive, period.left, i, from_array(period.left, i) - h)


@part
def _drive(state, counts, first, begin, end, period, courses, world, left, longest, anyhow):
    """Substeps of at most `longest` seconds for `left` seconds, of the wheels in columns begin .. end - 1 of `period`.

    A wheel for which Newton's method fails stays as it was before that substep, with the rest of its time in
    `period.left`; with `anyhow` = 1 it goes on.
    """
    sub = scratch_of_substep()
    while left > 1e-9 * longest:
        h = min(longest, left)
        for i in range(begin, end, COUNT):
            gather_ground(state, counts, first, i, period, sub.footing, courses, world, h)
            set_up(state, first, i, period, sub, world, h)
        solve_speeds(sub, period, begin, end, world, h)
        for i in range(begin, end, COUNT):
            _move(state, first, i, period, sub, world, h, anyhow)
        left -= h
        for i in range(begin, end):
            if period.alive[i] > 0.0:
                _leave_ruts(state, counts, first + i, courses)


@inlined
def _leave_ruts(state, counts, k, courses):
    """Mark the cells that wheel k has left in this substep."""
    cell = cell_at(courses, state.x[k])
    while counts.cell[k] != cell:
        leave_rut(courses, k, counts.cell[k], state.sinkage[k], state.bearing_sinkage[k])
        counts.cell[k] += 1 if cell > counts.cell[k] else -1


@part
def _drive_alone(state, counts, first, i, period, courses, world, longest):
    """The rest of the control period of the wheel in column i, by substeps halved while Newton's method fails."""
    block = i // COUNT * COUNT
    for j in range(block, block + COUNT):
        period.alive[j] = 0.0
    left, h = period.left[i], longest
    while left > 1e-9 * longest:
        h = min(h, left)
        finest = h <= longest / _FINEST
        period.alive[i], period.left[i] = 1.0, h
        _drive(state, counts, first, block, block + COUNT, period, courses, world, h, h, 1.0 if finest else 0.0)
        if period.left[i] > 0.0:
            h *= 0.5
        else:
            left -= h
            h = longest
    period.left[i] = 0.0


@part
def advance(state, counts, first, count, what, commands, courses, streams, world):
    """One control period of those of the wheels first .. first + count - 1 with what[k] = STEP.

    `commands` [wheels] in [-1, 1]. During a commanded halt the drive ignores the command and holds the wheel with its
    speed loop. `count` <= MANY; `first` a multiple of eight. `state` (`WheelState`), `counts` (`WheelCounts`),
    `courses` and `streams` are renewed in place.
    """
    period, longest = _period(), world.period / world.substeps
    end = (count + COUNT - 1) // COUNT * COUNT
    for i in range(end):
        k = first + i
        going = i < count and what[k] == STEP
        period.alive[i], period.left[i], period.clean[i] = (1.0, world.period, 1.0) if going else (0.0, 0.0, 1.0)
        period.start[i] = period.command[i] = period.by_speed[i] = 0.0
        if going:
            halted = state.halt_left[k] > 0.0
            period.start[i] = state.x[k]
            period.command[i] = 0.0 if halted else commands[k]
            period.by_speed[i] = 1.0 if halted or world.speed_command else 0.0
            state.motor_work[k] = state.soil_work[k] = 0.0
    _drive(state, counts, first, 0, end, period, courses, world, world.period, longest, 0.0)
    for i in range(count):
        if what[first + i] != STEP:
            continue
        if period.left[i] > 1e-9 * longest:
            _drive_alone(state, counts, first, i, period, courses, world, longest)
        counts.converged[first + i] = 1 if period.clean[i] > 0.0 else 0
        finish(state, counts, first + i, period.command[i], period.start[i], streams, world)
