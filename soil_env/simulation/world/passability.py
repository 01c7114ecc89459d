"""Soils that a course is drawn from, and the steepest slope of them that this wheel can climb."""

import math
from collections import namedtuple
from dataclasses import fields
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_part
from soil_env._numba.lanes import scratch
from soil_env._numba.random_streams import normal_pair, uniform
from soil_env.parameters import Camera, CourseSpec, SoilState
from soil_env.terramechanics.effects import depends_on_speed
from soil_env.terramechanics.ground import blend, row_soil
from soil_env.terramechanics.reaction import Interaction
from soil_env.terramechanics.residual import dimensionless_groups, residual_at
from soil_env.terramechanics.steady import Conditions, Rim, steady_with
from soil_env.terramechanics.traversability import best_working_point_with

_BISECTIONS = 8  # of the steepest grade on ground that slopes weaken
_six = scratch(6)


#: `CourseSpec` and `Camera` as the kernels take them.
CourseValues = namedtuple("CourseValues", [f.name for f in fields(CourseSpec)])
CameraValues = namedtuple("CameraValues", [f.name for f in fields(Camera)])


class CourseDistribution(NamedTuple):
    """Course, camera, `SoilSpread` and the soil mixture as the kernels take them."""

    course: CourseValues
    camera: CameraValues
    ahead: float  # [m] final ground before a wheel: more than it travels in an action
    grade_low: float  # tangent
    grade_high: float  # tangent
    body_mass: float
    stall_torque: float
    bogged_sinkage: float  # [m]
    reference_sinkage: float
    spread: (
        np.ndarray
    )  # [6] coefficients of variation: friction, cohesion, K, stiffness, dig gain, exponent
    factor: np.ndarray  # [5, 5] Cholesky factor of the correlations of the first five
    library: np.ndarray  # [soils, 7] `SoilState` of the presets
    cumulative: np.ndarray  # [soils] cumulative share of the presets
    speed: float  # [m/s] travel at which passability is judged, half the top rim speed


class CourseNumbers(NamedTuple):
    """Distribution of the courses, and the wheel that has to pass them."""

    drawn: CourseDistribution
    wheel: Interaction


@compiled_part
def draw_soil(streams, k, numbers):
    """One soil: a preset by weight, scattered by `SoilSpread` (deviations cut at 2.5 sigma)."""
    pick = uniform(streams, k)
    i = 0
    while i < numbers.drawn.cumulative.size - 1 and pick > numbers.drawn.cumulative[i]:
        i += 1
    return scattered(row_soil(numbers.drawn.library[i]), 1.0, streams, k, numbers)


@compiled_part
def scattered(mean, share, streams, k, numbers):
    """A soil that scatters about `mean` by a share of `SoilSpread` (deviations cut at 2.5 sigma)."""
    spread = numbers.drawn.spread
    factor = numbers.drawn.factor
    z = _six()
    d = _six()
    scale = _six()
    for j in range(3):
        z[2 * j], z[2 * j + 1] = normal_pair(streams, k)
    for row in range(5):
        d[row] = 0.0
        for column in range(row + 1):
            d[row] += factor[row, column] * z[column]
        d[row] = min(max(d[row], -2.5), 2.5)
    phi = min(math.atan(mean[0]) * (1.0 + share * spread[0] * d[0]), math.radians(60.0))
    for j in range(1, 5):
        s = math.sqrt(math.log(1.0 + share * spread[j] * share * spread[j]))
        scale[j] = math.exp(s * d[j] - 0.5 * s * s)
    n = mean[4] * (1.0 + share * spread[5] * min(max(z[5], -2.5), 2.5))
    depth = numbers.drawn.reference_sinkage
    stiffness = mean[3] * depth ** mean[4] * scale[3]  # pressure at that depth [Pa]
    return SoilState(
        math.tan(phi),
        mean[1] * scale[1],
        mean[2] * scale[2],
        stiffness / depth**n,
        n,
        mean[5] * scale[4],
        mean[6],
    )


@compiled_part
def _best_pull(load, soil, speed, sin_grade, numbers):
    """Best steady drawbar pull over load at this travel speed [m/s], -inf where the wheel would be bogged at it."""
    wheel = numbers.wheel
    drawn = numbers.drawn
    at = Conditions(speed, 1.0, sin_grade)
    r = wheel.radius
    b = wheel.width
    best = best_working_point_with(
        load,
        soil,
        Rim(r, b, wheel.grouser_height),
        at,
        wheel.unit_weight,
        wheel.effects,
        drawn.stall_torque,
    )
    groups = dimensionless_groups(
        best.slip, best.sinkage, load, speed, 1.0, sin_grade, soil, r, b, wheel.gravity
    )
    _, pull, torque = residual_at(wheel.residual, groups)
    if (
        best.sinkage > 0.9 * drawn.bogged_sinkage
        or best.torque + torque * load * r > drawn.stall_torque
    ):
        return -np.inf
    return best.drawbar_pull / load + pull


@compiled_part
def capacity(load, soil, tangent, numbers):
    """Best steady drawbar pull over load on a slope, -inf where the wheel would be bogged at rest or at its best.

    Where strength depends on speed, the lesser one of starting and of driving. Of the slope only the loss of bearing
    counts: W cos(grade) sinks less than W, so W is on the safe side.
    """
    wheel = numbers.wheel
    sin_grade = tangent / math.sqrt(1.0 + tangent * tangent)
    rim = Rim(wheel.radius, wheel.width, wheel.grouser_height)
    at_rest = Conditions(0.0, 1.0, sin_grade)
    rest = steady_with(0.0, load, soil, rim, at_rest, wheel.unit_weight, wheel.effects, 0.0)
    if rest.sinkage > 0.9 * numbers.drawn.bogged_sinkage or not rest.supported:
        return -np.inf
    pull = _best_pull(load, soil, numbers.drawn.speed, sin_grade, numbers)
    if depends_on_speed(wheel.effects):
        pull = min(pull, _best_pull(load, soil, 0.0, sin_grade, numbers))
    return pull


@compiled_part
def margin_between(a, b, grade_a, grade_b, load, numbers):
    """Margin in the middle of the passage from soil a to soil b, with their grades [rad]."""
    tangent = math.tan(0.5 * (grade_a + grade_b))
    return capacity(load, blend(a, b, 0.5), tangent, numbers) - tangent


@compiled_part
def steepest(load, soil, margin, numbers):
    """(tangent of the steepest grade of the course that leaves `margin`, `capacity` there); -inf twice if none does.

    On the level and on a slope the capacity is the same, unless slopes weaken the ground: then it is sought for.
    """
    low = numbers.drawn.grade_low
    high = numbers.drawn.grade_high
    flat = min(max(0.0, low), high)
    pull = capacity(load, soil, flat, numbers)
    if numbers.wheel.effects.grade_weakening == 0.0:
        return (min(pull - margin, high), pull) if pull - margin >= low else (-np.inf, -np.inf)
    if pull - margin < flat:
        flat, high = low, flat
        pull = capacity(load, soil, flat, numbers)
        if pull - margin < flat:
            return -np.inf, -np.inf
    for _ in range(_BISECTIONS):
        middle = 0.5 * (flat + high)
        there = capacity(load, soil, middle, numbers)
        if there - margin >= middle:
            flat = middle
            pull = there
        else:
            high = middle
    return flat, pull
