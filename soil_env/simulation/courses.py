"""Drawing courses: every patch passable by construction, as the wheel comes near it.

A course has a random stream of its own, and its patches are drawn from it in order, each as the wheel comes near it:
what they are like does not depend on how far or in how many pieces the course is drawn. Each patch draws a preset by
weight and scatters it (`SoilSpread`); its grade follows from what the wheel can do there at its best slip less the
margin of the scenario (`CourseSpec`), so that every course is passable by construction. Soils on which even the mildest
grade leaves less than the margin, or in which the wheel would be bogged, are drawn again.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, part
from soil_env._numba.lanes import scratch
from soil_env._numba.random_streams import between, normal_pair, uniform, word
from soil_env.parameters import Scenario, SoilState
from soil_env.simulation.terrain import blend, cell_at, row_soil
from soil_env.simulation.wheel import interaction_of
from soil_env.terramechanics.effects import depends_on_speed
from soil_env.terramechanics.model import Conditions, Rim, WheelSoilModel, steady_with
from soil_env.terramechanics.reaction import Interaction
from soil_env.terramechanics.residual import dimensionless_groups, residual_at
from soil_env.terramechanics.traversability import best_working_point_with

_MAX_REDRAWS = 30
_PERIODS_AHEAD = 3.0  # control periods of travel at top rim speed before a wheel within which ground is drawn
_BISECTIONS = 8  # of the steepest grade on ground that slopes weaken
_six = scratch(6)


class CourseDistribution(NamedTuple):
    """`CourseSpec`, `SoilSpread` and the soil mixture as the kernels take them."""

    length: float
    patch_low: float
    patch_high: float
    border: float
    ahead: float  # [m] final ground before a wheel: more than it travels in a control period
    grade_low: float  # tangent
    grade_high: float  # tangent
    margin_low: float
    margin_high: float
    payload_low: float
    payload_high: float
    body_mass: float
    stall_torque: float
    bogged_sinkage: float  # [m]
    reference_sinkage: float
    spread: np.ndarray  # [6] coefficients of variation: friction, cohesion, K, stiffness, dig gain, exponent
    factor: np.ndarray  # [5, 5] Cholesky factor of the correlations of the first five
    library: np.ndarray  # [soils, 7] `SoilState` of the presets
    cumulative: np.ndarray  # [soils] cumulative share of the presets
    speed: float  # [m/s] travel at which passability is judged, half the top rim speed


class CourseNumbers(NamedTuple):
    """What courses are drawn from, and the wheel that has to pass them."""

    drawn: CourseDistribution
    wheel: Interaction


def course_numbers(scenario: Scenario, model: WheelSoilModel | None = None) -> CourseNumbers:
    """Pack what `draw_course` needs; `model` brings the effects that are on in this world."""
    c, s, w = scenario.course, scenario.spread, scenario.wheel
    if model is not None and model.soil is not None:
        library, weights = [model.soil.state(w.width)], np.ones(1)
    else:
        presets = scenario.library
        library = [presets[name].state(w.width) for name in scenario.soils]
        weights = np.array(list(scenario.soils.values()), dtype=float)
    drawn = CourseDistribution(
        c.length,
        *c.patch_length,
        c.border,
        _PERIODS_AHEAD * w.radius * w.no_load_speed * scenario.control.period,
        *(math.tan(math.radians(g)) for g in c.grade_deg),
        *c.margin,
        *c.payload,
        w.body_mass,
        w.stall_torque,
        scenario.limits.bogged_sinkage * w.radius,
        s.reference_sinkage,
        np.array([s.friction, s.cohesion, s.shear_modulus, s.stiffness, s.dig_gain, s.exponent]),
        s.factor(),
        np.array(library),
        np.cumsum(weights) / weights.sum(),
        0.5 * w.no_load_speed * w.radius,
    )
    return CourseNumbers(drawn, interaction_of(scenario, model))


@part
def draw_soil(streams, k, numbers):
    """One soil: a preset by weight, scattered by `SoilSpread` (deviations cut at 2.5 sigma)."""
    pick = uniform(streams, k)
    i = 0
    while i < numbers.drawn.cumulative.size - 1 and pick > numbers.drawn.cumulative[i]:
        i += 1
    mean, spread, factor = numbers.drawn.library[i], numbers.drawn.spread, numbers.drawn.factor
    z, d, scale = _six(), _six(), _six()
    for j in range(3):
        z[2 * j], z[2 * j + 1] = normal_pair(streams, k)
    for row in range(5):
        d[row] = 0.0
        for column in range(row + 1):
            d[row] += factor[row, column] * z[column]
        d[row] = min(max(d[row], -2.5), 2.5)
    phi = min(math.atan(mean[0]) * (1.0 + spread[0] * d[0]), math.radians(60.0))
    for j in range(1, 5):
        s = math.sqrt(math.log(1.0 + spread[j] * spread[j]))
        scale[j] = math.exp(s * d[j] - 0.5 * s * s)
    n = mean[4] * (1.0 + spread[5] * min(max(z[5], -2.5), 2.5))
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


@part
def _best_pull(load, soil, speed, sin_grade, numbers):
    """Best steady drawbar pull over load at this travel speed [m/s], -inf where the wheel would be bogged at it."""
    wheel, drawn, at = numbers.wheel, numbers.drawn, Conditions(speed, 1.0, sin_grade)
    r, b = wheel.radius, wheel.width
    best = best_working_point_with(
        load, soil, Rim(r, b, wheel.grouser_height), at, wheel.unit_weight, wheel.effects, drawn.stall_torque
    )
    groups = dimensionless_groups(best.slip, best.sinkage, load, speed, 1.0, sin_grade, soil, r, b, wheel.gravity)
    _, pull, torque = residual_at(wheel.residual, groups)
    if best.sinkage > 0.9 * drawn.bogged_sinkage or best.torque + torque * load * r > drawn.stall_torque:
        return -np.inf
    return best.drawbar_pull / load + pull


@part
def _capacity(load, soil, tangent, numbers):
    """Best steady drawbar pull over load on a slope, -inf where the wheel would be bogged at rest or at its best.

    Where strength depends on speed, the lesser one of starting and of driving. Of the slope only the loss of bearing
    counts: W cos(grade) sinks less than W, so W is on the safe side.
    """
    wheel = numbers.wheel
    sin_grade = tangent / math.sqrt(1.0 + tangent * tangent)
    rim, at_rest = Rim(wheel.radius, wheel.width, wheel.grouser_height), Conditions(0.0, 1.0, sin_grade)
    rest = steady_with(0.0, load, soil, rim, at_rest, wheel.unit_weight, wheel.effects, 0.0)
    if rest.sinkage > 0.9 * numbers.drawn.bogged_sinkage or not rest.supported:
        return -np.inf
    pull = _best_pull(load, soil, numbers.drawn.speed, sin_grade, numbers)
    if depends_on_speed(wheel.effects):
        pull = min(pull, _best_pull(load, soil, 0.0, sin_grade, numbers))
    return pull


@part
def _steepest(load, soil, margin, numbers):
    """(tangent of the steepest grade of the course that leaves `margin`, `_capacity` there); -inf twice if none does.

    On the level and on a slope the capacity is the same, unless slopes weaken the ground: then it is sought for.
    """
    low, high = numbers.drawn.grade_low, numbers.drawn.grade_high
    flat = min(max(0.0, low), high)
    capacity = _capacity(load, soil, flat, numbers)
    if numbers.wheel.effects.grade_weakening == 0.0:
        return (min(capacity - margin, high), capacity) if capacity - margin >= low else (-np.inf, -np.inf)
    if capacity - margin < flat:
        flat, high = low, flat
        capacity = _capacity(load, soil, flat, numbers)
        if capacity - margin < flat:
            return -np.inf, -np.inf
    for _ in range(_BISECTIONS):
        middle = 0.5 * (flat + high)
        there = _capacity(load, soil, middle, numbers)
        if there - margin >= middle:
            flat, capacity = middle, there
        else:
            high = middle
    return flat, capacity


@part
def _margin_at_border(k, courses, i, load, numbers):
    """Margin in the middle of the passage from patch i - 1 to patch i."""
    mid = blend(row_soil(courses.soils[k, i - 1]), row_soil(courses.soils[k, i]), 0.5)
    tangent = math.tan(0.5 * (courses.grades[k, i - 1] + courses.grades[k, i]))
    return _capacity(load, mid, tangent, numbers) - tangent


@part
def draw_course(k, courses, streams, numbers):
    """`start_course` and all of its patches; the mass [kg] on the wheel with payload, or -1.

    -1: no passable course was found, as the soils are too weak for this wheel within the bounds of grade and margin.
    """
    mass = start_course(k, courses, streams, numbers)
    if mass > 0.0 and not extend_course(k, courses, mass, np.inf, numbers):
        return -1.0
    return mass


@part
def start_course(k, courses, streams, numbers):
    """Start course k afresh, with a seed from stream k; the mass [kg] on the wheel with payload, or -1 (`draw_course`).

    Only as much is drawn as a wheel at its start needs; `extend_course` draws the rest.
    """
    for i in range(courses.patches[k] + 1):
        courses.edges[k, i] = np.inf
    courses.patches[k] = 0
    courses.streams[k] = word(streams, k)
    for _ in range(_MAX_REDRAWS):
        mass = numbers.drawn.body_mass + between(
            courses.streams, k, numbers.drawn.payload_low, numbers.drawn.payload_high
        )
        if _try_patch(k, courses, mass * numbers.wheel.gravity, numbers):
            extend_course(k, courses, mass, numbers.drawn.ahead, numbers)
            return mass
    return -1.0


@inlined
def draw_ahead(k, courses, x, mass, numbers):
    """Draw what a wheel of `mass` [kg] at x [m] may reach in the next control period, unless it is there already."""
    if courses.ready[k] < x + numbers.drawn.ahead:
        extend_course(k, courses, mass, x + numbers.drawn.ahead, numbers)


@part
def extend_course(k, courses, mass, x, numbers):
    """Draw patches of course k until the ground is final up to x [m] or the course ends.

    False if no passable patch was found for some place, and the patch before it was repeated there.
    """
    found = True
    while courses.ready[k] < x:
        tries = 0
        while tries < _MAX_REDRAWS and not _try_patch(k, courses, mass * numbers.wheel.gravity, numbers):
            tries += 1
        if tries == _MAX_REDRAWS:
            found = False
            p = courses.patches[k]
            for j in range(7):
                courses.soils[k, p, j] = courses.soils[k, p - 1, j]
            courses.grades[k, p], courses.margins[k, p] = courses.grades[k, p - 1], courses.margins[k, p - 1]
            _add_patch(
                k, courses, between(courses.streams, k, numbers.drawn.patch_low, numbers.drawn.patch_high), numbers
            )
    return found


@part
def _try_patch(k, courses, load, numbers):
    """Draw the next patch of course k and add it; False, with the course as before, if it is not passable.

    The blend at the border to the patch before is checked too, and the grades on both sides lowered if it falls short.
    So the grade of a patch is final when the next one is drawn.
    """
    p, streams = courses.patches[k], courses.streams
    length = between(streams, k, numbers.drawn.patch_low, numbers.drawn.patch_high)
    margin = between(streams, k, numbers.drawn.margin_low, numbers.drawn.margin_high)
    if p == 0:
        margin = max(margin, 0.5 * (numbers.drawn.margin_low + numbers.drawn.margin_high))  # somewhere to get going
    tangent = capacity = -np.inf
    for _ in range(_MAX_REDRAWS):
        soil = draw_soil(streams, k, numbers)
        tangent, capacity = _steepest(load, soil, margin, numbers)
        if capacity > -np.inf:
            for j in range(7):
                courses.soils[k, p, j] = soil[j]
            break
    if capacity == -np.inf:
        return False
    courses.margins[k, p] = capacity - tangent
    courses.grades[k, p] = math.atan(tangent)
    if p > 0:
        grade, margin = courses.grades[k, p - 1], courses.margins[k, p - 1]
        if not _joined(k, courses, p, load, numbers):
            courses.grades[k, p - 1], courses.margins[k, p - 1] = grade, margin
            return False
    _add_patch(k, courses, length, numbers)
    return True


@part
def _joined(k, courses, i, load, numbers):
    """Lower the grades of patches i - 1 and i until their border is passable; False if that cannot be."""
    short = numbers.drawn.margin_low - _margin_at_border(k, courses, i, load, numbers)
    if short <= 0.0:
        return True
    for j in (i - 1, i):
        tangent = math.tan(courses.grades[k, j])
        lowered = max(tangent - 1.02 * short, numbers.drawn.grade_low)
        courses.grades[k, j] = math.atan(lowered)
        courses.margins[k, j] += tangent - lowered
    least = _margin_at_border(k, courses, i, load, numbers)
    if numbers.wheel.effects.grade_weakening != 0.0:  # a lowered grade may be a steep descent on weaker ground
        for j in (i - 1, i):
            tangent = math.tan(courses.grades[k, j])
            courses.margins[k, j] = _capacity(load, row_soil(courses.soils[k, j]), tangent, numbers) - tangent
            least = min(least, courses.margins[k, j])
        if i > 1:
            least = min(least, _margin_at_border(k, courses, i - 1, load, numbers))
    return numbers.drawn.margin_low - least <= 1e-6


@part
def _add_patch(k, courses, length, numbers):
    """Count the patch just written: its edges, the cells below it, and how far the ground is final now."""
    p = courses.patches[k]
    start = 0.0 if p == 0 else courses.edges[k, p]
    end = start + length
    whole = end >= numbers.drawn.length or p + 1 == courses.soils.shape[1]
    courses.edges[k, p], courses.edges[k, p + 1] = start, end
    courses.patches[k] = p + 1
    courses.ready[k] = np.inf if whole else start - 0.5 * numbers.drawn.border
    first = 0 if p == 0 else cell_at(courses, start) + 1
    cells = courses.modulus.shape[1]
    last = cells - 1 if whole else min(cell_at(courses, end) + 1, cells - 1)  # `rut_factor` reads one further
    for i in range(first, last + 1):
        courses.modulus[k, i] = 1.0
        courses.rut[k, i] = 0.0
