"""Body of a rover: its state, and its suspension in equilibrium (docs/physics/rover.md).

A rover is seen from the side, its two sides alike, so all masses and forces are those of one side. Loads follow from
the DP and T of the same stage, which in turn follow from the loads: each stage is solved with the loads of the forces
that the last reaction foresees, and again with those of the forces found, where that changes a load by more than
`LOAD_TOLERANCE`.
"""

from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_inline
from soil_env._numba.elementary import asin_root, larger, smaller, sqrt, where_less
from soil_env._numba.lanes import COUNT, fill, from_array, to_array
from soil_env._numba.rows import Rows, rows
from soil_env.parameters import RoverScenario

LOAD_TOLERANCE = 0.02  # of the mean load of an axle
LEAST_LOAD = 0.02  # of the mean load of an axle: none is taken to lift off

#: Rovers as wholes. The names that `WheelState` has too mean the same, so that its laws of halts, of progress, of
#: odometry and of the reward hold for rovers.
BodyState: type[Rows] = rows(
    "BodyState",
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
    "mark_x",  # as in `WheelState`, as all that follow
    "idle_time",
    "stalled_time",
    "odometer",
    "odometer_scale",
    "next_halt",
    "halt_left",
)
#: What is counted of rovers.
BodyCounts: type[Rows] = rows("BodyCounts", "converged", "steps", kind=np.int64)
#: What an axle has beside its wheel.
AxleState: type[Rows] = rows(
    "AxleState",
    "height",  # [m] of the undisturbed ground under the wheel
    "floor",  # [m] depth below it of the rut that the wheels ahead have left there
)


class Suspension(NamedTuple):
    """A `Vehicle` as the compiled code takes it."""

    axles: int
    base: float  # [m] from the front axle to the rear one
    places: np.ndarray  # [axles] behind the front axle [m]
    shares: np.ndarray  # [axles] of the weight at rest on level ground
    arms: np.ndarray  # [axles] how far ahead of the centre of mass [m]
    height: float  # [m] of the centre of mass above the axles
    bogie: int  # first axle on it; -1: none
    pivot_arm: float  # [m] of the bogie's pivot, ahead of the centre of mass
    pivot_height: float  # [m] above the axles


def suspension_of(scenario: RoverScenario) -> Suspension:
    """Pack the vehicle of a scenario."""
    v = scenario.vehicle
    places = np.array(v.axles)
    return Suspension(
        len(places),
        v.base,
        places,
        np.array(v.shares),
        v.centre - places,
        v.centre_height,
        v.first_on_bogie,
        v.centre - v.pivot,
        v.pivot_height,
    )


@compiled_inline
def _between(together, moment, arm, other_arm, least):
    """Loads at two arms [m] that bear `together` [N] and balance a moment [N m], each at least `least`."""
    one = (-1.0 * moment - other_arm * together) * (1.0 / (arm - other_arm))
    one = smaller(larger(one, least), together - least)
    return one, together - one


@compiled_inline
def _moment(forces, k, height):
    """Moment [N m], front up, of pull and torque of the wheels in columns k on about a point so high above the axle."""
    return from_array(forces.torque, k) + height * from_array(forces.drawbar_pull, k)


@compiled_inline
def bear(forces, weight, s, loads):
    """Loads [N] of the axles of eight rovers into `loads`, eight a axle, in equilibrium with the torques and drawbar
    pulls of `forces`; `weight` [N] is normal to the body."""
    least = (LEAST_LOAD / s.axles) * weight
    moment = fill(0.0)
    for a in range(s.axles):
        moment = moment + _moment(forces, a * COUNT, s.height)
    if s.bogie < 0:
        front, rear = _between(weight, moment, s.arms[0], s.arms[1], least)
        to_array(front, loads, 0)
        to_array(rear, loads, COUNT)
        return
    b = s.bogie
    k = b * COUNT
    about = _moment(forces, k, s.pivot_height) + _moment(forces, k + COUNT, s.pivot_height)
    single = 2 if b == 0 else 0
    alone, pair = _between(weight, moment - about, s.arms[single], s.pivot_arm, least)
    pair = larger(pair, 2.0 * least)
    alone = weight - pair
    front, rear = _between(pair, about, s.arms[b] - s.pivot_arm, s.arms[b + 1] - s.pivot_arm, least)
    to_array(alone, loads, single * COUNT)
    to_array(front, loads, b * COUNT)
    to_array(rear, loads, (b + 1) * COUNT)


@compiled_inline
def _axle_height(wheels, axles, k):
    return from_array(axles.height, k) - from_array(axles.floor, k) - from_array(wheels.sinkage, k)


@compiled_inline
def rise_of_body(wheels, axles, first, s):
    """Sine of the pitch of eight rovers' bodies, from where their wheels stand."""
    front = _axle_height(wheels, axles, first)
    rear = _axle_height(wheels, axles, first + (s.axles - 1) * COUNT)
    length = s.base
    if s.bogie >= 0:
        b = s.bogie
        share = (s.arms[b] - s.pivot_arm) / (
            s.arms[b] - s.arms[b + 1]
        )  # of the rear one of its axles
        k = first + b * COUNT
        pivot = (1.0 - share) * _axle_height(wheels, axles, k) + share * _axle_height(
            wheels, axles, k + COUNT
        )
        if b == 0:
            front = pivot
            length = s.pivot_arm - s.arms[2]
        else:
            rear = pivot
            length = s.arms[0] - s.pivot_arm
    return smaller(larger((front - rear) * (1.0 / length), -0.9), 0.9)


@compiled_inline
def angle_of(sine):
    """Angle [rad] of a sine, in lanes."""
    half = asin_root(0.5 - 0.5 * sqrt(1.0 - sine * sine))
    return where_less(sine, 0.0, -2.0 * half, 2.0 * half)
