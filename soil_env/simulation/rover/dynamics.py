"""One control period of eight rovers in lanes: stages, soil and ruts of `simulation.dynamics`, axle by axle.

A block of eight rovers has its wheels side by side, eight a axle from the front on (`wheel.wheel_of`), so that each
operation acts on the same axle of eight rovers. They share no number: a rover alone gives what it gives among others.
All wheels of a rover run over the same course, each leaving its rut to those behind it.
"""

from typing import NamedTuple

from soil_env._numba.compiling import compiled_inline, compiled_part
from soil_env._numba.elementary import larger, sine_of
from soil_env._numba.lanes import COUNT, from_array, scratch, to_array
from soil_env._numba.rows import Rows, scratch_rows
from soil_env.parameters import MOST_AXLES
from soil_env.simulation.rover.body import angle_of, rise_of_body
from soil_env.simulation.rover.newton import foresee, set_up, solve_speeds, weight_of
from soil_env.simulation.rover.ruts import COMPACTION_OF_RUT, pass_on
from soil_env.simulation.world.dynamics import (
    FINEST,
    MOST_STEPS,
    STEP,
    arrive,
    begin_period,
    leave_ruts,
    move,
    stage_of,
    steps_for,
)
from soil_env.simulation.world.stage import (
    GAMMA,
    Period,
    Substep,
    gather_ground,
    held_change,
    new_equations,
    new_footing,
    new_newton,
    new_nodes,
)
from soil_env.simulation.world.terrain import between_cells
from soil_env.simulation.world.wheel import finish, wheel_of
from soil_env.slip import slip_ratio
from soil_env.terramechanics.reaction import REST_SPEED

_period = scratch_rows(Period, MOST_AXLES * COUNT)
_changes = scratch(MOST_AXLES * COUNT)


class Rovers(NamedTuple):
    """State of many rovers, of their wheels (`wheel.wheel_of`) and of what axles have beside."""

    body: Rows  # BodyState
    body_counts: Rows  # BodyCounts
    wheels: Rows  # WheelState
    counts: Rows  # WheelCounts
    axles: Rows  # AxleState


@compiled_inline
def _climb(wheels, axles, ruts, k, before, grade):
    """Height of the ground and depth of the rut under eight wheels that have moved from `before` [m] on."""
    rise = (from_array(wheels.x, k) - before) * sine_of(grade)
    to_array(from_array(axles.height, k) + rise, axles.height, k)
    for i in range(k, k + COUNT):
        axles.floor[i] = between_cells(ruts.floor, i, wheels.x[i])


@compiled_inline
def take_pitch(rovers, j, s):
    """Pitch of the bodies of the eight rovers of which j is one, from where their wheels stand."""
    block = j // COUNT * COUNT
    to_array(
        angle_of(rise_of_body(rovers.wheels, rovers.axles, block * s.axles, s)),
        rovers.body.pitch,
        block,
    )


@compiled_part
def _drive(rovers, block, period, courses, ruts, world, s, left, longest, force):
    """Steps of at most `longest` seconds for `left` seconds, of those of eight rovers that are alive in `period`.

    A rover for which Newton's method fails stays as it was before that stage, with the rest of its time in
    `period.left`; with `force` = 1 it goes on.
    """
    body = rovers.body
    wheels = rovers.wheels
    axles = rovers.axles
    counts = rovers.counts
    sub = Substep(new_footing(), new_equations(), new_nodes(), new_newton())
    trial = new_newton()
    first = block * s.axles
    while left > 1e-9 * longest:
        h = min(longest, left)
        for number in range(2):
            stage = stage_of(number, h)
            for a in range(s.axles):
                gather_ground(
                    wheels,
                    counts,
                    first,
                    a * COUNT,
                    period,
                    sub.footing,
                    courses,
                    ruts,
                    world,
                    stage.duration,
                )
            set_up(
                wheels,
                body,
                block,
                first,
                period,
                sub,
                world,
                s,
                GAMMA * h,
                stage.lead,
                stage.duration,
            )
            solve_speeds(sub, trial, period, weight_of(body, block, world), world, s, GAMMA * h)
            for a in range(s.axles):
                i = a * COUNT
                before = from_array(wheels.x, first + i)
                move(wheels, first, i, period, sub, world, stage, force)
                _climb(wheels, axles, ruts, first + i, before, from_array(sub.footing.grade, i))
            take_pitch(rovers, block, s)
            for i in range(s.axles * COUNT):
                if period.alive[i] > 0.0:
                    gain = sub.footing.dig_gain[i]
                    recovery = sub.footing.dig_recovery[i]
                    cell = counts.cell[first + i]
                    leave_ruts(wheels, counts, first + i, ruts, gain, recovery, COMPACTION_OF_RUT)
                    pass_on(ruts, first + i, s.axles - 1 - i // COUNT, cell, counts.cell[first + i])
        left -= h


@compiled_part
def _drive_alone(rovers, block, lane, period, courses, ruts, world, s):
    """The rest of the control period of one rover of a block, by steps halved while Newton's method fails."""
    longest = world.period / (world.substeps * period.steps[lane])
    end = s.axles * COUNT
    for i in range(end):
        period.alive[i] = 0.0
    left = period.left[lane]
    h = longest
    while left > 1e-9 * longest:
        h = min(h, left)
        finest = h <= longest / FINEST
        for i in range(lane, end, COUNT):
            period.alive[i] = 1.0
            period.left[i] = h
        _drive(rovers, block, period, courses, ruts, world, s, h, h, 1.0 if finest else 0.0)
        failed = period.alive[lane] == 0.0
        left -= h - (period.left[lane] if failed else 0.0)
        h = 0.5 * h if failed else longest
    for i in range(lane, end, COUNT):
        period.left[i] = 0.0


@compiled_inline
def _choose_steps(rovers, block, period, world, s):
    """Steps that eight rovers take in this control period where others take one (`newton.change_ahead`)."""
    wheels = rovers.wheels
    body = rovers.body
    first = block * s.axles
    changes = _changes()
    dv = foresee(
        wheels,
        first,
        period,
        world,
        s,
        world.period / world.substeps,
        from_array(body.mass, block),
        0.0,
        changes,
    )
    change = abs(dv)
    for a in range(s.axles):
        i = a * COUNT
        change = larger(
            change, held_change(from_array(changes, i), wheels, first + i, i, period, world)
        )
    steps = steps_for(
        change / (world.wheel.radius * world.no_load_speed), from_array(body.halt_left, block)
    )
    for a in range(s.axles):
        to_array(steps, period.steps, a * COUNT)


@compiled_part
def advance(rovers, block, what, commands, courses, ruts, streams, world, s):
    """One control period of those of the rovers `block` ... `block` + 7 with what[j] = STEP.

    `commands` [wheels] in [-1, 1]: actions, see `wheel.commanded`. During a halt the drive ignores them and holds the
    wheels. `rovers`, `courses`, `ruts` and `streams` are renewed in place.
    """
    body = rovers.body
    wheels = rovers.wheels
    period = _period()
    first = block * s.axles
    end = s.axles * COUNT
    for i in range(end):
        k = first + i
        j = block + i % COUNT
        going = j < what.size and what[j] == STEP
        begin_period(wheels, k, i, period, commands, going, body.halt_left[j] > 0.0, world)
    _choose_steps(rovers, block, period, world, s)
    steps = 1
    while steps <= MOST_STEPS:
        going = 0.0
        for i in range(end):
            period.alive[i] = 1.0 if period.left[i] > 0.0 and period.steps[i] == steps else 0.0
            going += period.alive[i]
        if going > 0.0:
            longest = world.period / (world.substeps * steps)
            _drive(rovers, block, period, courses, ruts, world, s, world.period, longest, 0.0)
            arrive(period, end)
        steps *= 2
    for lane in range(min(COUNT, what.size - block)):
        if what[block + lane] == STEP:
            if period.left[lane] > 0.0:
                _drive_alone(rovers, block, lane, period, courses, ruts, world, s)
            rovers.body_counts.converged[block + lane] = 1 if period.clean[lane] > 0.0 else 0
            _as_a_whole(rovers, block + lane, period, lane, streams, world, s)


@compiled_inline
def _as_a_whole(rovers, j, period, lane, streams, world, s):
    """The end of a control period of rover j, in a lane of its block."""
    body = rovers.body
    wheels = rovers.wheels
    fastest = slip = deepest = pull = work = 0.0
    for a in range(s.axles):
        k = wheel_of(j, a, s.axles)
        rim = wheels.wheel_speed[k]
        wheels.slip[k] = slip_ratio(rim * world.wheel.radius, wheels.speed[k], REST_SPEED)
        wheels.travel[k] = wheels.x[k] - period.start[a * COUNT + lane]
        fastest = rim if abs(rim) > abs(fastest) else fastest
        slip += wheels.slip[k]
        deepest = max(deepest, wheels.sinkage[k] + rovers.axles.floor[k])
        pull += wheels.drawbar_pull[k]
        work += max(wheels.motor_work[k], 0.0)
    rear = wheel_of(j, s.axles - 1, s.axles)
    start = body.x[j]
    body.x[j] = wheels.x[rear]
    body.speed[j] = wheels.speed[rear]
    body.wheel_speed[j] = fastest
    body.best_x[j] = max(body.best_x[j], body.x[j])
    body.sinkage[j] = deepest
    body.drawbar_pull[j] = pull
    body.motor_work[j] = work
    finish(body, rovers.body_counts, j, start, streams, world)
    body.slip[j] = slip / s.axles
