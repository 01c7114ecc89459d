"""Body of a rover: its state, and its suspension in equilibrium (docs/physics/rover.md).

A rover is seen from the side, its two sides alike, so all masses and forces are those of one side.
Loads follow from the DP and T of the same stage, which in turn follow from the loads. Each stage is
solved with the loads of the forces that the last reaction foresees. Where the forces found change a
load by more than `LOAD_TOLERANCE`, it is solved again with theirs.
"""

import math

import numpy as np

from soil_env._compiled.elementary import asin_root, sin_cos
from soil_env._compiled.flags import compiled_finite, record
from soil_env.parameters import MOST_AXLES, RoverScenario
from soil_env.simulation.world.wheel import WHEEL

LOAD_TOLERANCE = 0.02  # [of the mean load of an axle] change of a load that asks for a new solution
# [of the mean load of an axle] that an axle carries at least: none is taken to lift off
LEAST_LOAD = 0.02
STEEPEST = 0.9  # [-] largest sine of the pitch; own choice

#: What an axle has beside its wheel.
AXLE = record(
    "height",  # [m] of the undisturbed ground under the wheel, over the start of the course
    "floor",  # [m] depth below it of the rut that the wheels ahead have left there
)
#: A rover: its body, then its wheels and axles from the front on. The names that `WHEEL` has too
#: mean the same, so that its laws of halts, of progress, of odometry and of the reward hold for
#: rovers.
ROVER = record(
    "x",  # [m] distance along the course of the rear axle: how far the whole rover has come
    "best_x",  # [m] furthest x so far
    "speed",  # V [m/s]
    "wheel_speed",  # [rad/s] of the wheel that turns fastest
    "sinkage",  # [m] of the deepest wheel, with the rut that it runs in
    "slip",  # [-] mean of the wheels
    "pitch",  # [rad] of the body, front up positive
    "mass",  # [kg] of one side with payload
    "drawbar_pull",  # [N] of all wheels of one side
    "motor_work",  # [J] of one side in the last control period, without recuperation
    "travel",  # [m] in the last control period
    "mark_x",  # as in `WHEEL`, as all that follow
    "idle_time",
    "stalled_time",
    "odometer",
    "next_halt",
    "halt_left",
    "reward",
    terms=("f8", 4),
    stream=("u8",),
    cause=("i8",),
    periods=("i8",),
    converged=("i8",),
    steps=("i8",),
    wheels=(WHEEL, MOST_AXLES),
    axles=(AXLE, MOST_AXLES),
)
#: A `Vehicle` as compiled code takes it. Arms count from the centre of mass forward.
SUSPENSION = record(
    "wheelbase",  # [m] from the front axle to the rear one
    "height",  # [m] of the centre of mass above the axles
    "pivot_arm",  # [m] of the bogie's pivot
    "pivot_height",  # [m] above the axles
    places=("f8", MOST_AXLES),  # [m] behind the front axle
    arms=("f8", MOST_AXLES),  # [m]
    shares=("f8", MOST_AXLES),  # [-] of the weight at rest on level ground
    axles=("i8",),
    bogie=("i8",),  # first axle on it; -1: none
)


def suspension_of(scenario: RoverScenario) -> np.ndarray:
    """Pack the vehicle of a scenario, `SUSPENSION` [1]; numbers of axles it does not have are 0."""
    v = scenario.vehicle
    axles = scenario.axles
    places = np.array(v.axles)
    s = np.zeros(1, SUSPENSION)
    s["wheelbase"] = v.base
    s["height"] = v.centre_height
    s["pivot_arm"] = v.centre - v.pivot
    s["pivot_height"] = v.pivot_height
    s["places"][0, :axles] = places
    s["arms"][0, :axles] = v.centre - places
    s["shares"][0, :axles] = v.shares
    s["axles"] = axles
    s["bogie"] = v.first_on_bogie
    return s


@compiled_finite
def _two_loads(together, moment, arm, other_arm, least):
    """Loads [N] at the arms `arm` and `other_arm` [m], forward positive, that add up to `together`
    [N] and balance a `moment` [N m], which counts front up.

    The sum of load times arm is -moment. Each load is cut to at least `least` [N] and their sum
    kept; the moment is then not balanced.
    """
    one = (-moment - other_arm * together) / (arm - other_arm)
    one = min(max(one, least), together - least)
    return one, together - one


@compiled_finite
def _moment(force, height):
    """Moment [N m], front up, of the pull and the torque of a wheel about a point that is `height`
    [m] above its axle. `force` has `torque` [N m] and `drawbar_pull` [N].
    """
    return force.torque + height * force.drawbar_pull


@compiled_finite
def axle_loads(forces, weight, suspension):
    """Loads [N] of the axles, front to rear, in equilibrium with the torques and drawbar pulls of
    `forces` [axles]: three numbers, the last 0 with two axles.

    `weight` [N] is normal to the body. None is less than `LEAST_LOAD` of the mean, and they add up
    to the weight all the same. `suspension`: `SUSPENSION`.
    """
    least = LEAST_LOAD / suspension.axles * weight
    moment = 0.0
    for a in range(suspension.axles):
        moment += _moment(forces[a], suspension.height)
    b = suspension.bogie
    if b < 0:
        front, rear = _two_loads(weight, moment, suspension.arms[0], suspension.arms[1], least)
        return front, rear, 0.0
    height = suspension.pivot_height
    # [N m] of both wheels of the bogie about its pivot, which passes no moment on to the body
    about = _moment(forces[b], height) + _moment(forces[b + 1], height)
    single = 2 if b == 0 else 0
    arm = suspension.pivot_arm
    _, pair = _two_loads(weight, moment - about, suspension.arms[single], arm, least)
    pair = max(pair, 2.0 * least)  # the bogie has two wheels, each of which carries `least`
    alone = weight - pair
    front_arm = suspension.arms[b] - arm
    front, rear = _two_loads(pair, about, front_arm, suspension.arms[b + 1] - arm, least)
    if b == 0:
        return front, rear, alone
    return alone, front, rear


@compiled_finite
def _height_of(rover, a):
    """Height [m], over the start of the course, of the lowest point of the wheel of axle a; its
    sinkage counts from the floor of the rut of the wheels ahead.
    """
    axle = rover.axles[a]
    return axle.height - axle.floor - rover.wheels[a].sinkage


@compiled_finite
def set_pitch(rover, suspension):
    """Set the pitch of a rover's body from the heights of its wheels.

    It is the slope of the line through both axles, or through the bogie's pivot and the other
    axle; its sine is cut to `STEEPEST`. `suspension`: `SUSPENSION`.
    """
    front = _height_of(rover, 0)
    rear = _height_of(rover, suspension.axles - 1)
    length = suspension.wheelbase
    b = suspension.bogie
    if b >= 0:
        # weight of the bogie's rear wheel in the height of the pivot
        front_arm = suspension.arms[b]
        on_rear = (front_arm - suspension.pivot_arm) / (front_arm - suspension.arms[b + 1])
        pivot = (1.0 - on_rear) * _height_of(rover, b) + on_rear * _height_of(rover, b + 1)
        if b == 0:
            front = pivot
            length = suspension.pivot_arm - suspension.arms[2]
        else:
            rear = pivot
            length = suspension.arms[0] - suspension.pivot_arm
    sine = min(max((front - rear) / length, -STEEPEST), STEEPEST)
    angle = asin_root(sine * sine)
    rover.pitch = -angle if sine < 0.0 else angle


@compiled_finite
def weight_of(rover, gravity):
    """Weight [N] of one side of a rover, normal to its body."""
    sine = sin_cos(rover.pitch)[0]
    return gravity * rover.mass * math.sqrt(1.0 - sine * sine)
