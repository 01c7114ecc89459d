"""Newton's method for the speeds of a stage of a step: travel and rotation of one wheel.

    V = V* + h/m (DP - m g sin(grade)),   u = u* + h r/J (T_motor - T),   u = r w

with the analytic derivatives of the reaction; V* and u* of the two stages: docs/physics/wheel.md
(Alexander 1977). `drive` is a `wheel.Drive`, `rig` a `wheel.RIG`, `world` a `wheel.World`.
"""

from typing import Any, NamedTuple

from soil_env._compiled.flags import HUGE, compiled_finite, inlined
from soil_env.terramechanics.motor import motor_torque
from soil_env.terramechanics.reaction import NO_REACTION, REST_SPEED, Reaction, moved, reaction

TOLERANCE = 1e-5  # [m/s] residual of Newton's method, which converges quadratically
PREDICTED = 0.3  # [of TOLERANCE] predicted residual up to which the last evaluation is skipped
FIRST_ORDER = 0.1  # [of TOLERANCE] residual of the reaction to first order that is good enough then
PASSES = 60  # evaluations of the reaction in a stage, at most
TRIES = 8  # evaluations along one step of Newton's method, at most
LEAST_GAIN = 0.1  # [of the share of a step] by which the residual has to fall
SHORTER = 0.4  # [-] factor on a step that is not better
# A residual is let pass where no shorter step makes it smaller: at most `NEARLY`, and `OF_CHANGE`
# of the change of speed that was found. Without the second, a step that is short enough would leave
# the speeds as they are.
NEARLY = 1e-4  # [m/s]
OF_CHANGE = 0.1  # [-]
# [of the first residual] taken for the residual before it, so that its fall predicts nothing
BEFORE_FIRST = 0.1
SHORT = 0.1  # [of the rim speed] foreseen change up to which the first try is the foreseen speed
LEAST_PIVOT = 1e-12  # [-] size of a number that a step is divided by, at least
#: Fields of a `Reaction` that the record of a wheel has too, from its last stage: all but S and its
#: derivatives, which a foreseen change of speed does not need.
LASTING = tuple(name for name in Reaction._fields if not name.startswith("sinkage"))


class Stage(NamedTuple):
    """A stage of a step: duration, weights of its first and last speeds, where it begins."""

    duration: float  # [s]
    first: float  # [s] weight of the speed at its beginning in the way, and in the work
    last: float  # [s] weight of the speed at its end
    implicit: float  # [s] duration of implicit Euler that ends it
    speed: float  # V* [m/s], from which the implicit Euler starts
    rim: float  # u* [m/s]


class Motion(NamedTuple):
    """Speeds at the end of a stage and the reaction there."""

    speed: float  # [m/s]
    rim: float  # [m/s]
    force: Any  # `Reaction`, or of a rover a `TURNING`, which has its fields
    converged: bool


@compiled_finite
def divisor(x):
    """`x`, or `LEAST_PIVOT` where its size is not more: a number to divide by. The sign of so small
    a number is lost.
    """
    return x if abs(x) > LEAST_PIVOT else LEAST_PIVOT


@compiled_finite
def newton_step(f1, f2, cv, cu, force, net_u):
    """(dV, du) [m/s] of Newton's method for the residuals f1 of travel and f2 of rotation [m/s].

    `cv` = h/m, `cu` = h r/J; `force`: `Reaction` with its derivatives, or a wheel, which has those
    of its last stage (`LASTING`); `net_u` = d(T - T_motor)/du. It solves the two equations on top
    of this module, linearised, by Cramer's rule, with `divisor` of their determinant.
    """
    a11 = 1.0 - cv * force.pull_v
    a12 = -cv * force.pull_u
    a21 = cu * force.torque_v
    a22 = 1.0 + cu * net_u
    determinant = divisor(a11 * a22 - a12 * a21)
    return -(a22 * f1 - a12 * f2) / determinant, -(a11 * f2 - a21 * f1) / determinant


@compiled_finite
def foreseen(wheel, drive, back_v, back_u, h, along, rig):
    """(dV, du) [m/s] of a wheel in h seconds, by the reaction of the last stage to first order.

    The stage begins at speeds V*, u* that lie `back_v`, `back_u` [m/s] behind the present ones,
    from which dV and du count; `along` [N] is the weight along the grade.
    """
    cv = h / wheel.mass
    cu = h * rig.radius / rig.inertia
    torque, slope = motor_torque(drive.command, drive.by_speed, wheel.wheel_speed, rig)
    f1 = back_v - cv * (wheel.drawbar_pull - along)
    f2 = back_u - cu * (torque - wheel.torque)
    return newton_step(f1, f2, cv, cu, wheel, wheel.torque_u - slope / rig.radius)


@inlined
def near_enough(residual, change):
    """True if a residual [m/s] that no shorter step reduces is let pass: below `NEARLY`, and small
    against the `change` [m/s] of the speeds since the beginning of the stage.
    """
    return residual < NEARLY and residual < TOLERANCE + OF_CHANGE * change


@inlined
def solve_speeds(wheel, stage, footing, along, drive, world, extra):
    """`Motion` at the end of a stage, by Newton's method; a step that does not reduce the residual
    is shortened.

    The first try is the foreseen speeds where no foreseen change is more than `SHORT` of the rim
    speed, else the present ones. Once the residual is predicted to fall far below the tolerance,
    the last step is taken with the reaction to first order, without another evaluation.

    Not converged: `PASSES` evaluations were not enough, or no shorter step reduces a residual that
    is not `near_enough`. The motion is then the best one found. `along` [N]: the weight along the
    grade; `footing`, `extra`: `Footing` and `ExtraForces` of the wheel in this stage.

    In the loop v, u are the best speeds so far and `norm` their residual [m/s]; `before` is the
    residual of those before. `share` is how much of a step is tried. A step counts as better if it
    lowers the residual by `LEAST_GAIN` times that share, the last of `TRIES` if it lowers it at
    all.
    """
    rig = world.rig
    r = rig.radius
    cv = stage.implicit / wheel.mass
    cu = stage.implicit * r / rig.inertia
    try_v = wheel.speed
    try_u = r * wheel.wheel_speed
    back_v = try_v - stage.speed
    back_u = try_u - stage.rim
    dv, du = foreseen(wheel, drive, back_v, back_u, stage.implicit, along, rig)
    if max(abs(dv), abs(du)) < SHORT * (abs(try_u) + REST_SPEED):
        try_v += dv
        try_u += du
    # change of shear over the relative change of a speed: the shear displacement is about r theta1
    # at most, and counts in K
    curvature = 1.0 + r * footing.theta1 / footing.shear_modulus

    v = stage.speed
    u = stage.rim
    force = NO_REACTION
    norm = HUGE
    share = 1.0
    tries = 0
    for _ in range(PASSES):
        trial = reaction(world.nodes, footing, try_v, try_u, rig, extra, world.acting)
        torque, slope = motor_torque(drive.command, drive.by_speed, try_u / r, rig)
        f1 = try_v - stage.speed - cv * (trial.drawbar_pull - along)
        f2 = try_u - stage.rim - cu * (torque - trial.torque)
        reached = max(abs(f1), abs(f2))
        last = tries == TRIES - 1
        if reached < norm * (1.0 if last else 1.0 - LEAST_GAIN * share):
            before = norm if norm < HUGE else BEFORE_FIRST * reached
            v = try_v
            u = try_u
            norm = reached
            force = trial
            share = 1.0
            tries = 0
            dv, du = newton_step(f1, f2, cv, cu, force, force.torque_u - slope / r)
            # the residual after this step, predicted: it falls as it did before (quadratic
            # convergence: at least so), or in proportion to the change of shear that is made
            by_shear = max(abs(dv), abs(du)) * curvature / (abs(u) + REST_SPEED)
            if norm * min(norm / before, by_shear) < PREDICTED * TOLERANCE:
                ahead = moved(force, dv, du)
                torque, _ = motor_torque(drive.command, drive.by_speed, (u + du) / r, rig)
                f1 = v + dv - stage.speed - cv * (ahead.drawbar_pull - along)
                f2 = u + du - stage.rim - cu * (torque - ahead.torque)
                small = max(abs(f1), abs(f2)) < FIRST_ORDER * TOLERANCE
                if small and ahead.sinkage_coefficient > 0.0:
                    return Motion(v + dv, u + du, ahead, True)
            if norm < TOLERANCE:
                return Motion(v, u, force, True)
        elif last:
            change = max(abs(v - stage.speed), abs(u - stage.rim))
            return Motion(v, u, force, near_enough(norm, change))
        else:
            share *= SHORTER
            tries += 1
        try_v = v + share * dv
        try_u = u + share * du
    return Motion(v, u, force, False)
