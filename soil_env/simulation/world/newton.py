"""Newton's method for the speeds of a stage of a step: travel and rotation, eight wheels at a time in lanes.

    V = V* + h/m (DP - m g sin(grade)),   u = u* + h r/J (T_motor - T),   u = r w

with the analytic derivatives of the reaction; V* and u* of the two stages: docs/physics/wheel.md (Alexander 1977).
Newton's method takes one wheel longer than another: a lane whose wheel has converged goes on with the next of up to
`MANY`.
"""

from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_inline
from soil_env._numba.elementary import below, chosen, larger, smaller
from soil_env._numba.lanes import COUNT, bits, fill, from_array, to_array
from soil_env._numba.records import keep_where
from soil_env._numba.rows import Rows, copy_column, rows, scratch_rows
from soil_env.simulation.world.stage import (
    MANY,
    choose_reaction,
    load_reaction,
    newton_step,
    reaction_at,
    same_reaction,
    store_reaction,
)
from soil_env.terramechanics.arc_integrals import NODE_COLUMNS
from soil_env.terramechanics.motor import motor
from soil_env.terramechanics.reaction import REST_SPEED, moved

TOLERANCE = 1e-5  # [m/s] of the Newton iteration, which converges quadratically
_PREDICTED = 0.3  # predicted residual, as a share of the tolerance, up to which the last evaluation is skipped
PASSES = 60  # evaluations of the reaction in a substep, at most
TRIES = 8  # of them at most along one step of Newton's method
# Residual that is let pass where no shorter step makes it smaller: at most this [m/s], and this share of the change of
# speed that was found. Without the second a step that is short enough would leave the speeds as they are.
NEARLY = 1e-4
OF_CHANGE = 0.1
HUGE = 1e300
_Queue: type[Rows] = rows("_Queue", "wheel", kind=np.int64)
_queue = scratch_rows(_Queue, MANY)
_occupants = scratch_rows(_Queue, COUNT)


@compiled_inline
def _residual(v, u, f, e, i, cu, world):
    """(f1, f2, d motor torque/dw): the residuals of implicit Euler [m/s] at speeds v, u with the `Reaction` f."""
    torque, slope, _ = motor(
        from_array(e.command, i), from_array(e.by_speed, i), u / world.wheel.radius, world
    )
    along = f.drawbar_pull - from_array(e.weight_along, i)
    f1 = v - from_array(e.speed0, i) - from_array(e.gain_v, i) * along
    return f1, u - from_array(e.rim0, i) - cu * (torque - f.torque), slope


@compiled_inline
def _begin(e, n, i):
    """Newton's state of the eight wheels from column i on, at the start of a substep."""
    zero = fill(0.0)
    huge = fill(HUGE)
    to_array(from_array(e.speed0, i), n.v, i)
    to_array(from_array(e.rim0, i), n.u, i)
    store_reaction(same_reaction(zero), n, i)
    to_array(zero, n.converged, i)
    to_array(zero, n.f1, i)
    to_array(zero, n.f2, i)
    to_array(zero, n.motor_slope, i)
    to_array(huge, n.norm, i)
    to_array(huge, n.before, i)
    to_array(fill(1.0), n.share, i)
    to_array(zero, n.tries, i)
    to_array(zero, n.passes, i)


class Comparison(NamedTuple):
    """Outcome of a trial against the best so far, in lanes."""

    better: float  # 1 where the trial is the best so far
    failed: float  # 1 where no further try is left
    share: float  # of Newton's step to take next
    tries: float  # made along that step


@compiled_inline
def compare(reached, norm, share, tries):
    """`Comparison` of a residual `reached` [m/s] with the least so far, `norm`, after a `share` of Newton's step.

    It is better if it is smaller by a tenth of that share, on the last try by anything. A step that is not better is
    shortened.
    """
    last = below(TRIES - 1.5, tries)
    better = below(reached, norm * chosen(last, fill(1.0), 1.0 - 0.1 * share))
    return Comparison(
        better,
        last * (1.0 - better),
        chosen(better, fill(1.0), 0.4 * share),
        chosen(better, fill(0.0), tries + 1.0),
    )


@compiled_inline
def near_enough(norm, change):
    """1 where a residual that no shorter step reduces is small enough; `change` of speed in the stage [m/s]."""
    return below(norm, NEARLY) * below(norm, TOLERANCE + OF_CHANGE * change)


@compiled_inline
def _accept(sub, i, cu, world):
    """Evaluate the trial speeds and keep them where they are better; (better, failed), 1 or 0 in each lane."""
    e = sub.equations
    n = sub.newton
    v = from_array(e.try_v, i)
    u = from_array(e.try_u, i)
    trial = reaction_at(v, u, sub, i, world.wheel)
    f1, f2, slope = _residual(v, u, trial, e, i, cu, world)
    reached = larger(abs(f1), abs(f2))
    norm = from_array(n.norm, i)
    found = compare(reached, norm, from_array(n.share, i), from_array(n.tries, i))
    better = found.better
    first_before = chosen(
        below(norm, 0.5 * HUGE), norm, 0.1 * reached
    )  # the first residual predicts nothing
    keep_where(better, first_before, n.before, i)
    keep_where(better, reached, n.norm, i)
    keep_where(better, v, n.v, i)
    keep_where(better, u, n.u, i)
    keep_where(better, f1, n.f1, i)
    keep_where(better, f2, n.f2, i)
    keep_where(better, slope, n.motor_slope, i)
    store_reaction(choose_reaction(better, trial, load_reaction(n, i)), n, i)
    to_array(found.share, n.share, i)
    to_array(found.tries, n.tries, i)
    return better, found.failed


@compiled_inline
def _predicted_residual(norm, before, dv, du, u, theta1, shear_modulus, r):
    """Residual [m/s] after Newton's step (dv, du), from its quadratic convergence.

    The ratio to the present one is at most that of the last two, or the change of shear that the step makes.
    """
    curvature = 1.0 + r * theta1 / shear_modulus  # change of shear over that of speed
    by_shear = larger(abs(dv), abs(du)) * curvature / (abs(u) + REST_SPEED)
    return norm * smaller(norm / before, by_shear)


@compiled_inline
def _iterate(sub, i, world, h):
    """One pass of Newton's method on the eight wheels from column i on; 1 where it has ended.

    Once the residual is predicted to fall far below the tolerance, the step is taken with the reaction to first order
    instead of being computed once more.
    """
    e = sub.equations
    n = sub.newton
    r = world.wheel.radius
    cu = h * r / world.inertia
    better, failed = _accept(sub, i, cu, world)
    v = from_array(n.v, i)
    u = from_array(n.u, i)
    norm = from_array(n.norm, i)
    f = load_reaction(n, i)
    dv, du = newton_step(
        from_array(n.f1, i),
        from_array(n.f2, i),
        from_array(e.gain_v, i),
        cu,
        f.dp_v,
        f.dp_u,
        f.torque_v,
        f.torque_u - from_array(n.motor_slope, i) / r,
    )
    predicted = _predicted_residual(
        norm,
        from_array(n.before, i),
        dv,
        du,
        u,
        from_array(e.theta1, i),
        from_array(e.shear_modulus, i),
        r,
    )
    ahead = moved(f, dv, du)
    f1, f2, _ = _residual(v + dv, u + du, ahead, e, i, cu, world)
    skip = below(predicted, _PREDICTED * TOLERANCE) * below(
        larger(abs(f1), abs(f2)), 0.1 * TOLERANCE
    )
    skip = skip * below(0.0, ahead.sinkage_coefficient) * better
    converged = larger(skip, better * below(norm, TOLERANCE))
    passes = from_array(n.passes, i) + 1.0
    share = from_array(n.share, i)
    to_array(passes, n.passes, i)
    to_array(v + share * dv, e.try_v, i)
    to_array(u + share * du, e.try_u, i)
    to_array(chosen(skip, v + dv, v), n.v, i)
    to_array(chosen(skip, u + du, u), n.u, i)
    store_reaction(choose_reaction(skip, ahead, f), n, i)
    change = larger(abs(v - from_array(e.speed0, i)), abs(u - from_array(e.rim0, i)))
    settled = failed * near_enough(norm, change)
    to_array(larger(settled, converged), n.converged, i)
    return larger(larger(failed, converged), below(PASSES - 0.5, passes))


@compiled_inline
def _copy_wheel(sub, source, target):
    """A wheel with its state of Newton's method from one column to another."""
    copy_column(sub.equations, source, sub.equations, target)
    copy_column(sub.newton, source, sub.newton, target)
    a = (source // COUNT) * NODE_COLUMNS + source % COUNT
    b = (target // COUNT) * NODE_COLUMNS + target % COUNT
    for node in range(0, NODE_COLUMNS, COUNT):
        copy_column(sub.nodes, a + node, sub.nodes, b + node)


@compiled_inline
def solve_speeds(sub, period, begin, end, world, h):
    """The speeds and reactions at the end of a substep of the wheels in columns begin .. end - 1, into `sub.newton`.

    One pass for all, on the spot; those that have not ended go on in the last block, where a lane takes the next as
    soon as its wheel has ended.
    """
    queue = _queue()
    occupants = _occupants()
    block = begin
    queued = 0
    following = 0
    working = 0
    while True:
        filling = block < end
        if filling:
            _begin(sub.equations, sub.newton, block)
        ended = bits(_iterate(sub, block, world, h))
        if filling:
            for i in range(COUNT):
                if ended >> i & 1 == 0 and period.alive[block + i] > 0.0:
                    queue.wheel[queued] = block + i
                    queued += 1
            block += COUNT
            if block < end:
                continue
            block = MANY
            ended = (1 << COUNT) - 1
            for i in range(COUNT):
                occupants.wheel[i] = -1
        for i in range(COUNT):
            if ended >> i & 1 == 0:
                continue
            k = occupants.wheel[i]
            if k >= 0:
                copy_column(sub.newton, block + i, sub.newton, k)
                occupants.wheel[i] = -1
                working -= 1
            if following < queued or (
                filling and queued > 0
            ):  # a lane without a wheel of its own repeats another's
                k = queue.wheel[min(following, queued - 1)]
                _copy_wheel(sub, k, block + i)
                if following < queued:
                    occupants.wheel[i] = k
                    working += 1
                following += 1
        if working == 0:
            return
