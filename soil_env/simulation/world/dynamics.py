"""One control period of many wheels, eight at a time in lanes: two implicit stages a step, short steps where needed.

The method: `newton` and docs/physics/wheel.md. A wheel whose speeds are about to change (`change_ahead`) takes 2, 4 or
8 steps where others take one; one whose iteration fails goes on by shorter steps, its neighbours waiting.

Within one wheel nearly everything depends on what came before, and a processor that steps one wheel after the other
mostly waits. Here each operation acts on eight wheels. They share no number: a wheel goes through the same operations
on the same bits whoever its neighbours are, so that a wheel alone gives what it gives among others.
"""

from typing import NamedTuple

from soil_env._numba.compiling import compiled_inline, compiled_part
from soil_env._numba.elementary import below, larger, smaller, where_less
from soil_env._numba.lanes import COUNT, fill, from_array, to_array
from soil_env._numba.records import keep_where
from soil_env._numba.rows import scratch_rows
from soil_env.simulation.world.lines import choosing, plan_halt, take_line
from soil_env.simulation.world.newton import TOLERANCE, solve_speeds
from soil_env.simulation.world.stage import (
    GAMMA,
    LEAD,
    MANY,
    Period,
    Substep,
    change_ahead,
    gather_ground,
    load_reaction,
    load_soil,
    new_equations,
    new_footing,
    new_newton,
    new_nodes,
    set_up,
)
from soil_env.simulation.world.terrain import COMPACTION, cell_after, leave_rut
from soil_env.simulation.world.wheel import (
    SHALLOWEST,
    bearing_sinkage,
    commanded,
    finish,
    relax_sinkage,
)
from soil_env.terramechanics.effects import digging_ratio, onto_fresh
from soil_env.terramechanics.motor import motor
from soil_env.terramechanics.steady import DEEPEST

__all__ = ["MANY", "STEP", "TOLERANCE", "advance"]

STEP = 0  # what is to be done with a wheel: a control period
MOST_STEPS = 8  # where others take one
# Foreseen changes of speed [of the top rim speed] beyond which a wheel takes 2, 4 and 8 steps where others take one.
REFINED_BEYOND = (0.3, 0.6, 1.2)
FINEST = 1024  # a step that fails is halved down to this fraction; softening soil breaks away within 1 ms
_period = scratch_rows(Period, MANY)


class Stage(NamedTuple):
    """A stage of a step of h seconds: its own duration, and the weights [s] of its first and last speeds over it."""

    duration: float
    first: float
    last: float
    lead: float  # as `stage.set_up` takes it


@compiled_inline
def stage_of(number, h):
    """`Stage` 0 or 1 of a step of h seconds."""
    g = GAMMA * h
    return Stage(g, 0.0, g, 0.0) if number == 0 else Stage(h - g, h - 2.0 * g, g, LEAD)


@compiled_inline
def move(state, first, i, period, sub, world, stage, force):
    """Move eight wheels to the end of a stage.

    Lanes that are not alive stay as they are. Lanes that did not converge are masked out, unless `force` is 1.
    """
    n = sub.newton
    k = first + i
    r = world.wheel.radius
    v = from_array(n.v, i)
    u = from_array(n.u, i)
    f = load_reaction(n, i)
    converged = from_array(n.converged, i)
    alive = from_array(period.alive, i) * larger(converged, force)
    to_array(alive, period.alive, i)
    keep_where(alive, from_array(period.clean, i) * converged, period.clean, i)
    torque, _, available = motor(
        from_array(period.command, i), from_array(period.by_speed, i), u / r, world
    )
    speed = from_array(state.speed, k)
    rim = r * from_array(state.wheel_speed, k)
    turned = from_array(state.torque, k)
    pulled = from_array(state.drawbar_pull, k)
    drove = from_array(state.motor_torque, k)
    moved = stage.first * speed + stage.last * v
    slid = stage.first * abs(rim - speed) + stage.last * abs(u - v)
    _sink(state, k, i, alive, sub, world, f.sinkage_coefficient, moved, slid, stage.duration)
    work = (stage.first * (drove * rim) + stage.last * (torque * u)) / r
    keep_where(alive, from_array(state.motor_work, k) + work, state.motor_work, k)
    work = stage.first * (turned * rim / r - pulled * speed) + stage.last * (
        f.torque * u / r - f.drawbar_pull * v
    )
    keep_where(alive, from_array(state.soil_work, k) + work, state.soil_work, k)
    work = _taken(state, period, k, i, v, u, stage, world)
    keep_where(alive, from_array(state.numerical_work, k) + work, state.numerical_work, k)
    keep_where(alive, speed, period.speed_before, i)
    keep_where(alive, rim, period.rim_before, i)
    keep_where(alive, v, state.speed, k)
    keep_where(alive, u / r, state.wheel_speed, k)
    keep_where(alive, torque, state.motor_torque, k)
    keep_where(alive, available, state.available_torque, k)
    keep_where(alive, f.load, state.load, k)
    keep_where(alive, f.drawbar_pull, state.drawbar_pull, k)
    keep_where(alive, f.torque, state.torque, k)
    keep_where(alive, f.dp_v, state.pull_by_speed, k)
    keep_where(alive, f.dp_u, state.pull_by_rim, k)
    keep_where(alive, f.torque_v, state.torque_by_speed, k)
    keep_where(alive, f.torque_u, state.torque_by_rim, k)
    keep_where(alive, from_array(sub.footing.grade, i), state.grade, k)
    keep_where(alive, from_array(period.left, i) - stage.duration, period.left, i)


@compiled_inline
def _taken(state, period, k, i, v, u, stage, world):
    """Energy [J] that a stage to speeds v, u takes from eight wheels beside the work of the forces on them.

    With d the change of speed from where the stage begins and e = `lead` times that in the stage before,
    m (d^2 - e^2)/2, and the same of the rotation: what the products of the stages with their speeds leave.
    """
    r = world.wheel.radius
    speed = from_array(state.speed, k)
    rim = r * from_array(state.wheel_speed, k)
    e = stage.lead * (speed - from_array(period.speed_before, i))
    e2 = stage.lead * (rim - from_array(period.rim_before, i))
    d = v - speed - e
    d2 = u - rim - e2
    return 0.5 * (
        from_array(state.mass, k) * (d * d - e * e) + world.inertia / (r * r) * (d2 * d2 - e2 * e2)
    )


@compiled_inline
def _sink(state, k, i, alive, sub, world, mobilised, moved, slid, duration):
    """Place and sinkage of eight wheels that move by `moved` [m] while the rim slides by `slid` [m] over the ground.

    Ground beyond the furthest places of a wheel is fresh. Where it has been the ground has the depth of the rut, which
    grows where the wheel digs and not where it climbs out of its hole.
    """
    g = sub.footing
    soil = load_soil(sub.footing, i)
    sinkage = from_array(state.sinkage, k)
    rut = state.rut_depth
    bearing = bearing_sinkage(from_array(g.sinkage, i), mobilised, soil)
    if world.wheel.on:
        bearing = bearing + from_array(g.lift, i)
    x = from_array(state.x, k) + moved
    low = from_array(state.lowest_x, k)
    high = from_array(state.best_x, k)
    fresh = smaller(onto_fresh(x, low, high) / larger(abs(moved), 1e-12), 1.0)
    onto = fresh * bearing + (1.0 - fresh) * from_array(rut, k)
    over = 1.0 / duration
    relaxed = relax_sinkage(
        sinkage, bearing, onto, over * moved, over * slid, soil, world.relaxation, duration
    )
    depth = smaller(larger(relaxed, SHALLOWEST * world.wheel.radius), DEEPEST * world.wheel.radius)
    keep_where(alive, over * (depth - sinkage), state.sinking, k)
    keep_where(
        alive,
        where_less(sinkage, depth, larger(from_array(rut, k), depth), from_array(rut, k)),
        rut,
        k,
    )
    keep_where(alive, x, state.x, k)
    keep_where(alive, larger(x, high), state.best_x, k)
    keep_where(alive, smaller(x, low), state.lowest_x, k)
    keep_where(alive, from_array(state.slid, k) + slid, state.slid, k)
    keep_where(alive, depth, state.sinkage, k)
    keep_where(alive, bearing, state.bearing_sinkage, k)


@compiled_part
def _drive(state, counts, first, begin, end, period, courses, world, left, longest, force):
    """Steps of at most `longest` seconds for `left` seconds, of the wheels in columns begin .. end - 1 of `period`.

    A wheel for which Newton's method fails stays as it was before that stage, with the rest of its time in
    `period.left`; with `force` = 1 it goes on.
    """
    sub = Substep(new_footing(), new_equations(), new_nodes(), new_newton())
    while left > 1e-9 * longest:
        h = min(longest, left)
        for number in range(2):
            stage = stage_of(number, h)
            for i in range(begin, end, COUNT):
                gather_ground(
                    state,
                    counts,
                    first,
                    i,
                    period,
                    sub.footing,
                    courses,
                    courses,
                    world,
                    stage.duration,
                )
                set_up(state, first, i, period, sub, world, GAMMA * h, stage.lead, stage.duration)
            solve_speeds(sub, period, begin, end, world, GAMMA * h)
            for i in range(begin, end, COUNT):
                move(state, first, i, period, sub, world, stage, force)
            for i in range(begin, end):
                if period.alive[i] > 0.0:
                    dug = sub.footing.dig_gain[i], sub.footing.dig_recovery[i]
                    leave_ruts(state, counts, first + i, courses, dug[0], dug[1], COMPACTION)
        left -= h


@compiled_inline
def leave_ruts(state, counts, k, ruts, gain, recovery, compaction):
    """Mark the cells that wheel k has passed in this stage."""
    cell = counts.cell[k]
    after = cell_after(ruts, counts.cell[k], state.x[k])
    if after == cell:
        return
    # how much the wheel dug here; its sinkage over z_w does not say, since it lags behind a change of the ground
    dug = digging_ratio(state.slid[k], max(abs(state.x[k] - state.cell_x[k]), 1e-6), gain, recovery)
    while cell != after:
        leave_rut(ruts, k, cell, state.rut_depth[k], dug, compaction)
        cell += 1 if after > cell else -1
        rut = ruts.rut[k, cell]
        state.rut_depth[k] = rut if rut > 0.0 else state.sinkage[k]
    counts.cell[k] = cell
    state.slid[k] = 0.0
    state.cell_x[k] = state.x[k]


@compiled_part
def _drive_together(state, counts, first, end, period, courses, world, steps):
    """The control period of the wheels that take `steps` steps where others take one."""
    longest = world.period / (world.substeps * steps)
    begin = 0
    for block in range(0, end + COUNT, COUNT):
        going = 0.0
        if block < end:
            for i in range(block, block + COUNT):
                period.alive[i] = 1.0 if period.left[i] > 0.0 and period.steps[i] == steps else 0.0
                going += period.alive[i]
        if going == 0.0:
            if begin < block:
                _drive(
                    state,
                    counts,
                    first,
                    begin,
                    block,
                    period,
                    courses,
                    world,
                    world.period,
                    longest,
                    0.0,
                )
            begin = block + COUNT


@compiled_part
def _drive_alone(state, counts, first, i, period, courses, world):
    """The rest of the control period of the wheel in column i, by steps halved while Newton's method fails."""
    block = i // COUNT * COUNT
    longest = world.period / (world.substeps * period.steps[i])
    for j in range(block, block + COUNT):
        period.alive[j] = 0.0
    left = period.left[i]
    h = longest
    while left > 1e-9 * longest:
        h = min(h, left)
        finest = h <= longest / FINEST
        period.alive[i] = 1.0
        period.left[i] = h
        _drive(
            state,
            counts,
            first,
            block,
            block + COUNT,
            period,
            courses,
            world,
            h,
            h,
            1.0 if finest else 0.0,
        )
        failed = period.alive[i] == 0.0
        left -= h - (period.left[i] if failed else 0.0)
        h = 0.5 * h if failed else longest
    period.left[i] = 0.0


@compiled_inline
def begin_period(state, k, i, period, commands, going, halted, world):
    """Column i of `period` for wheel k, which is `going` or of no concern, at the beginning of a control period."""
    period.left[i], period.clean[i] = (world.period, 1.0) if going else (0.0, 1.0)
    period.start[i] = period.command[i] = period.by_speed[i] = 0.0
    period.speed_before[i] = period.rim_before[i] = 0.0
    if going:
        period.start[i] = state.x[k]
        period.command[i] = commanded(state, k, commands[k], halted, world)
        period.by_speed[i] = 1.0 if halted or world.speed_command else 0.0
        state.motor_work[k] = state.soil_work[k] = state.numerical_work[k] = 0.0


@compiled_inline
def steps_for(change, halt_left):
    """Steps that eight wheels take where others take one, for a change of speeds ahead [of the top rim speed]."""
    steps = fill(1.0)  # a halt has its speed loop
    driven = below(halt_left, 1e-9)
    for limit in REFINED_BEYOND:
        steps = steps * (1.0 + driven * below(limit, change))
    return steps


@compiled_inline
def arrive(period, end):
    """Set the time left to zero for the columns up to `end` that are alive; others have failed a step."""
    for i in range(end):
        if period.alive[i] > 0.0:
            period.left[i] = 0.0


@compiled_inline
def _at_fork(state, counts, k, command, courses, world):
    """Before the halts of a control period are reckoned: what its action chooses, and the halt to come."""
    fork = choosing(state, counts, k, courses, world)
    if fork >= 0:
        take_line(k, courses, fork, 1 if command < 0.0 else 0)
    plan_halt(state, counts, k, courses, world)


@compiled_part
def advance(state, counts, first, count, what, commands, courses, streams, world):
    """One control period of those of the wheels first .. first + count - 1 with what[k] = STEP.

    `commands` [wheels] in [-1, 1]: actions, see `commanded`. During a halt the drive ignores them and holds the wheel
    with its speed loop. `count` <= MANY; `first` a multiple of eight. `state` (`WheelState`), `counts` (`WheelCounts`),
    `courses` and `streams` are renewed in place.
    """
    period = _period()
    end = (count + COUNT - 1) // COUNT * COUNT
    for i in range(end):
        k = first + i
        going = i < count and what[k] == STEP
        begin_period(state, k, i, period, commands, going, state.halt_left[k] > 0.0, world)
    for i in range(0, end, COUNT):
        change = change_ahead(state, first + i, i, period, world, world.period / world.substeps)
        to_array(steps_for(change, from_array(state.halt_left, first + i)), period.steps, i)
    steps = 1
    while steps <= MOST_STEPS:
        _drive_together(state, counts, first, end, period, courses, world, steps)
        arrive(period, end)
        steps *= 2
    for i in range(count):
        if what[first + i] != STEP:
            continue
        if period.left[i] > 0.0:
            _drive_alone(state, counts, first, i, period, courses, world)
        counts.converged[first + i] = 1 if period.clean[i] > 0.0 else 0
        if world.lines > 1:
            _at_fork(state, counts, first + i, commands[first + i], courses, world)
        finish(state, counts, first + i, period.start[i], streams, world)
