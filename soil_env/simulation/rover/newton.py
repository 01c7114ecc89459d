"""Newton's method for the speeds of a stage of a step of eight rovers in lanes: one of travel, one of rotation an axle.

The equation of each axle has its own rim speed and V only, so a step of Newton's method is the elimination of all rim
speeds, at a cost that is linear in the axles. Stages and reaction are those of `simulation.stage`.
"""

from soil_env._numba.compiling import compiled_inline, compiled_part
from soil_env._numba.elementary import below, chosen, larger, sine_of, sqrt
from soil_env._numba.lanes import COUNT, bits, fill, from_array, to_array
from soil_env._numba.records import keep_where
from soil_env.simulation.rover.body import LOAD_TOLERANCE, bear
from soil_env.simulation.world.newton import HUGE, PASSES, TOLERANCE, compare, near_enough
from soil_env.simulation.world.stage import (
    SHORT,
    behind,
    choose_reaction,
    foreseen_rim,
    load_reaction,
    reaction_at,
    same_reaction,
    stand,
    store_reaction,
)
from soil_env.terramechanics.motor import motor
from soil_env.terramechanics.reaction import REST_SPEED

_LEAST_PIVOT = 1e-12
_TURNS = 4  # solutions of a stage at most, each with the loads of the one before; the last is kept


@compiled_inline
def _apart(x):
    """`x` away from 0, where it is divided by."""
    return chosen(below(_LEAST_PIVOT, abs(x)), x, _LEAST_PIVOT)


@compiled_inline
def _eliminate(pull_by_u, torque_by_v, net_by_u, f2, cu):
    """Terms of an axle's rotation in the equation of travel: (slope by V, residual), both times h/M."""
    pivot = _apart(1.0 + cu * net_by_u)
    return pull_by_u * cu * torque_by_v / pivot, pull_by_u * f2 / pivot


@compiled_inline
def _turned(dv, torque_by_v, net_by_u, f2, cu):
    """Change of the rim speed of an axle with a change `dv` of travel."""
    return -(f2 + cu * torque_by_v * dv) / _apart(1.0 + cu * net_by_u)


@compiled_inline
def foresee(wheels, first, period, world, s, h, mass, lead, changes):
    """Change of V [m/s] of eight rovers in h seconds by the reaction of the last stage to first order, and those of the
    rim speeds into `changes`, eight an axle; the stage begins at speeds as `newton.behind` says."""
    cv = h / mass
    cu = h * world.wheel.radius / world.inertia
    back_v, _ = behind(wheels, first, 0, period, world, lead)
    f1 = back_v
    slope = fill(1.0)
    for a in range(s.axles):
        i = a * COUNT
        k = first + a * COUNT
        _, back_u = behind(wheels, k, i, period, world, lead)
        f2, net = foreseen_rim(wheels, k, i, period, back_u, cu, world)
        along = (
            world.wheel.gravity * from_array(wheels.mass, k) * sine_of(from_array(wheels.grade, k))
        )
        by_slope, by_residual = _eliminate(
            from_array(wheels.pull_by_rim, k), from_array(wheels.torque_by_speed, k), net, f2, cu
        )
        slope = slope - cv * (from_array(wheels.pull_by_speed, k) - by_slope)
        f1 = f1 - cv * (from_array(wheels.drawbar_pull, k) - along - by_residual)
    dv = -1.0 * f1 / _apart(slope)
    for a in range(s.axles):
        i = a * COUNT
        k = first + a * COUNT
        _, back_u = behind(wheels, k, i, period, world, lead)
        f2, net = foreseen_rim(wheels, k, i, period, back_u, cu, world)
        to_array(_turned(dv, from_array(wheels.torque_by_speed, k), net, f2, cu), changes, i)
    return dv


@compiled_inline
def weight_of(body, block, world):
    """Weight [N] of one side of eight rovers, normal to their bodies."""
    sine = sine_of(from_array(body.pitch, block))
    return world.wheel.gravity * from_array(body.mass, block) * sqrt(1.0 - sine * sine)


@compiled_inline
def _bear_ahead(wheels, first, sub, short, dv, weight, s):
    """Loads by the forces of the last stage and, where that is a `short` way, how they change to first order with `dv`
    and the changes of the rim speeds that are in `try_u`."""
    e = sub.equations
    n = sub.newton
    for a in range(s.axles):
        i = a * COUNT
        k = first + a * COUNT
        du = from_array(e.try_u, i)
        pull = from_array(wheels.pull_by_speed, k) * dv + from_array(wheels.pull_by_rim, k) * du
        torque = (
            from_array(wheels.torque_by_speed, k) * dv + from_array(wheels.torque_by_rim, k) * du
        )
        to_array(from_array(wheels.drawbar_pull, k) + short * pull, n.drawbar_pull, i)
        to_array(from_array(wheels.torque, k) + short * torque, n.torque, i)
    bear(n, weight, s, e.load)


@compiled_inline
def set_up(wheels, body, block, first, period, sub, world, s, h, lead, duration):
    """The equations of a stage of eight rovers, and where Newton's method starts."""
    e = sub.equations
    mass = from_array(body.mass, block)
    for a in range(s.axles):
        stand(wheels, first, a * COUNT, sub, world, duration)
    dv = foresee(wheels, first, period, world, s, h, mass, lead, e.try_u)
    short = fill(1.0)
    for a in range(s.axles):
        i = a * COUNT
        k = first + a * COUNT
        rim = world.wheel.radius * from_array(wheels.wheel_speed, k)
        change = larger(abs(dv), abs(from_array(e.try_u, i)))
        short = short * below(change, SHORT * (abs(rim) + REST_SPEED))
    _bear_ahead(wheels, first, sub, short, dv, weight_of(body, block, world), s)
    for a in range(s.axles):
        i = a * COUNT
        k = first + a * COUNT
        speed = from_array(wheels.speed, k)
        rim = world.wheel.radius * from_array(wheels.wheel_speed, k)
        back_v, back_u = behind(wheels, k, i, period, world, lead)
        to_array(speed - back_v, e.speed0, i)
        to_array(rim - back_u, e.rim0, i)
        to_array(h / mass, e.gain_v, i)
        to_array(from_array(period.command, i), e.command, i)
        to_array(from_array(period.by_speed, i), e.by_speed, i)
        to_array(speed + short * dv, e.try_v, i)
        to_array(rim + short * from_array(e.try_u, i), e.try_u, i)


@compiled_inline
def _evaluate(sub, trial, cu, world, s):
    """The reaction to the speeds to try, into `trial`; the largest residual [m/s]."""
    e = sub.equations
    along = fill(0.0)
    largest = fill(0.0)
    v = from_array(e.try_v, 0)
    for a in range(s.axles):
        i = a * COUNT
        u = from_array(e.try_u, i)
        f = reaction_at(v, u, sub, i, world.wheel)
        torque, slope, _ = motor(
            from_array(e.command, i), from_array(e.by_speed, i), u / world.wheel.radius, world
        )
        residual = u - from_array(e.rim0, i) - cu * (torque - f.torque)
        along = along + (f.drawbar_pull - from_array(e.weight_along, i))
        largest = larger(largest, abs(residual))
        store_reaction(f, trial, i)
        to_array(u, trial.u, i)
        to_array(residual, trial.f2, i)
        to_array(slope, trial.motor_slope, i)
    residual = v - from_array(e.speed0, 0) - from_array(e.gain_v, 0) * along
    to_array(residual, trial.f1, 0)
    return larger(largest, abs(residual))


@compiled_inline
def _keep_better(sub, trial, better, s):
    """Take over speeds, residuals and reaction of the trial in lanes where it is better."""
    n = sub.newton
    keep_where(better, from_array(sub.equations.try_v, 0), n.v, 0)
    keep_where(better, from_array(trial.f1, 0), n.f1, 0)
    for a in range(s.axles):
        i = a * COUNT
        keep_where(better, from_array(trial.u, i), n.u, i)
        keep_where(better, from_array(trial.f2, i), n.f2, i)
        keep_where(better, from_array(trial.motor_slope, i), n.motor_slope, i)
        store_reaction(choose_reaction(better, load_reaction(trial, i), load_reaction(n, i)), n, i)


@compiled_inline
def _try_next(sub, share, cu, world, s):
    """The speeds to try next: a share of the step of Newton's method from the best so far."""
    e = sub.equations
    n = sub.newton
    r = world.wheel.radius
    cv = from_array(e.gain_v, 0)
    f1 = from_array(n.f1, 0)
    slope = fill(1.0)
    for a in range(s.axles):
        i = a * COUNT
        f = load_reaction(n, i)
        net = f.torque_u - from_array(n.motor_slope, i) / r
        by_slope, by_residual = _eliminate(f.dp_u, f.torque_v, net, from_array(n.f2, i), cu)
        slope = slope - cv * (f.dp_v - by_slope)
        f1 = f1 + cv * by_residual
    dv = -1.0 * f1 / _apart(slope)
    to_array(from_array(n.v, 0) + share * dv, e.try_v, 0)
    for a in range(s.axles):
        i = a * COUNT
        f = load_reaction(n, i)
        net = f.torque_u - from_array(n.motor_slope, i) / r
        du = _turned(dv, f.torque_v, net, from_array(n.f2, i), cu)
        to_array(from_array(n.u, i) + share * du, e.try_u, i)


@compiled_inline
def _begin(sub, s):
    """State of the iteration at its start."""
    n = sub.newton
    zero = fill(0.0)
    for a in range(s.axles):
        i = a * COUNT
        to_array(from_array(sub.equations.speed0, i), n.v, i)
        to_array(from_array(sub.equations.rim0, i), n.u, i)
        store_reaction(same_reaction(zero), n, i)
        to_array(zero, n.f2, i)
        to_array(zero, n.motor_slope, i)
    to_array(zero, n.f1, 0)


@compiled_inline
def _largest_change(sub, s):
    """Largest change of a speed of eight rovers since the start of the stage [m/s]."""
    e = sub.equations
    n = sub.newton
    change = abs(from_array(n.v, 0) - from_array(e.speed0, 0))
    for a in range(s.axles):
        change = larger(change, abs(from_array(n.u, a * COUNT) - from_array(e.rim0, a * COUNT)))
    return change


@compiled_part
def _iterate(sub, trial, alive, world, s, h):
    """Newton's method for those of eight rovers that are `alive`, at the present loads; 1 where it has converged.

    As in `world.newton`, a step that does not reduce the largest residual is shortened. Rovers that have ended stay as
    they are while others go on.
    """
    cu = h * world.wheel.radius / world.inertia
    going = alive
    converged = fill(0.0)
    norm = fill(HUGE)
    share = fill(1.0)
    tries = fill(0.0)
    for _ in range(PASSES):
        reached = _evaluate(sub, trial, cu, world, s)
        found = compare(reached, norm, share, tries)
        better = going * found.better
        failed = going * found.failed
        share = found.share
        tries = found.tries
        _keep_better(sub, trial, better, s)
        norm = chosen(better, reached, norm)
        there = going * better * below(norm, TOLERANCE)
        settled = failed * near_enough(norm, _largest_change(sub, s))
        converged = larger(converged, larger(there, settled))
        going = going * (1.0 - larger(there, failed))
        if bits(going) == 0:
            break
        _try_next(sub, share, cu, world, s)
    return converged


@compiled_inline
def _bear_anew(sub, trial, weight, alive, s):
    """Loads by the forces that were found, and the speeds to begin with again, where a load has changed: 1 there."""
    e = sub.equations
    n = sub.newton
    bear(n, weight, s, trial.load)
    changed = fill(0.0)
    for a in range(s.axles):
        change = abs(from_array(trial.load, a * COUNT) - from_array(e.load, a * COUNT))
        changed = larger(changed, below((LOAD_TOLERANCE / s.axles) * weight, change))
    changed = changed * alive
    for a in range(s.axles):
        i = a * COUNT
        to_array(chosen(changed, from_array(trial.load, i), from_array(e.load, i)), e.load, i)
        to_array(from_array(n.u, i), e.try_u, i)
    to_array(from_array(n.v, 0), e.try_v, 0)
    return changed


@compiled_part
def solve_speeds(sub, trial, period, weight, world, s, h):
    """The speeds and reactions at the end of a stage of eight rovers, into `sub.newton`, with `converged` for each.

    `weight` [N] is that normal to the body, of one side.
    """
    n = sub.newton
    going = from_array(period.alive, 0)
    _begin(sub, s)
    converged = fill(0.0)
    for turn in range(_TURNS):
        found = _iterate(sub, trial, going, world, s, h)
        converged = chosen(going, found, converged)
        if turn < _TURNS - 1:
            going = _bear_anew(sub, trial, weight, found, s)
            if bits(going) == 0:
                break
    for a in range(s.axles):
        to_array(from_array(n.v, 0), n.v, a * COUNT)
        to_array(converged, n.converged, a * COUNT)
