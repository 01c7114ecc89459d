"""Drawing courses: every patch passable by construction, as the wheel comes near it (docs/physics/wheel.md).

A course has a random stream of its own, and its patches are drawn from it in order, each as the wheel comes near it:
what they are like does not depend on how far or in how many pieces the course is drawn. Ground of terrain classes and
with two lines is drawn by `lines`.
"""

import math
from dataclasses import astuple

import numpy as np

from soil_env._numba.compiling import compiled_part
from soil_env._numba.random_streams import within, word
from soil_env.parameters import Scenario
from soil_env.simulation.world.lines import draw_classes, draw_patch, repeat_patch
from soil_env.simulation.world.passability import (
    CameraValues,
    CourseDistribution,
    CourseNumbers,
    CourseValues,
    capacity,
    draw_soil,
    margin_between,
    steepest,
)
from soil_env.simulation.world.terrain import cell_at
from soil_env.simulation.world.wheel import interaction_of
from soil_env.terramechanics.ground import row_soil
from soil_env.terramechanics.model import WheelSoilModel

_MAX_REDRAWS = 30
_ACTIONS_AHEAD = (
    3.0  # actions of travel at top rim speed before a wheel within which ground is drawn
)


def course_numbers(scenario: Scenario, model: WheelSoilModel | None = None) -> CourseNumbers:
    """Pack the numbers of `draw_course`; `model` gives the effects that are on in this world."""
    c = scenario.course
    s = scenario.spread
    w = scenario.wheel
    camera = scenario.camera
    ahead = _ACTIONS_AHEAD * w.radius * w.no_load_speed * scenario.control.duration
    if c.classes:  # the patch after one in sight is drawn, so that what is seen is final
        ahead += camera.range + c.patch_length[1] + c.border
    if model is not None and model.soil is not None:
        library = [model.soil.state(w.width)]
        weights = np.ones(1)
    else:
        presets = scenario.library
        library = [presets[name].state(w.width) for name in scenario.soils]
        weights = np.array(list(scenario.soils.values()), dtype=float)
    drawn = CourseDistribution(
        CourseValues(*astuple(c)),
        CameraValues(*astuple(camera)),
        ahead,
        *(math.tan(math.radians(g)) for g in c.grade_deg),
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


@compiled_part
def _margin_at_border(k, courses, i, load, numbers):
    """Margin in the middle of the passage from patch i - 1 to patch i."""
    soils = courses.soils[k]
    grades = courses.grades[k]
    return margin_between(
        row_soil(soils[i - 1]), row_soil(soils[i]), grades[i - 1], grades[i], load, numbers
    )


@compiled_part
def draw_course(k, courses, streams, numbers):
    """`start_course` and all of its patches; the mass [kg] on the wheel with payload, or -1.

    -1: no passable course was found, as the soils are too weak for this wheel within the bounds of grade and margin.
    """
    mass = start_course(k, courses, streams, numbers)
    if mass > 0.0 and not extend_course(k, courses, mass, np.inf, numbers):
        return -1.0
    return mass


@compiled_part
def start_course(k, courses, streams, numbers):
    """Start course k afresh, with a seed from stream k; the mass [kg] on the wheel with payload, or -1 (`draw_course`).

    Only as much is drawn as a wheel at its start needs; `extend_course` draws the rest.
    """
    for i in range(courses.patches[k] + 1):
        courses.edges[k, i] = np.inf
    courses.patches[k] = 0
    courses.streams[k] = word(streams, k)
    for _ in range(_MAX_REDRAWS):
        mass = numbers.drawn.body_mass + within(courses.streams, k, numbers.drawn.course.payload)
        load = mass * numbers.wheel.gravity
        if numbers.drawn.course.classes > 0 and not draw_classes(k, courses, load, numbers):
            continue
        if _try_patch(k, courses, load, numbers):
            extend_course(k, courses, mass, numbers.drawn.ahead, numbers)
            return mass
    return -1.0


@compiled_part
def extend_course(k, courses, mass, x, numbers):
    """Draw patches of course k until the ground is final up to x [m] or the course ends.

    False if no passable patch was found for some place, and the patch before it was repeated there.
    """
    found = True
    while courses.ready[k] < x:
        tries = 0
        while tries < _MAX_REDRAWS and not _try_patch(
            k, courses, mass * numbers.wheel.gravity, numbers
        ):
            tries += 1
        if tries == _MAX_REDRAWS:
            found = False
            p = courses.patches[k]
            if numbers.drawn.course.classes > 0:
                repeat_patch(k, courses, p)
            else:
                for j in range(7):
                    courses.soils[k, p, j] = courses.soils[k, p - 1, j]
                courses.grades[k, p] = courses.grades[k, p - 1]
                courses.margins[k, p] = courses.margins[k, p - 1]
            _add_patch(
                k, courses, within(courses.streams, k, numbers.drawn.course.patch_length), numbers
            )
    return found


@compiled_part
def _try_patch(k, courses, load, numbers):
    """Draw the next patch of course k and add it; False, with the course as before, if it is not passable.

    The blend at the border to the patch before is checked too, and the grades on both sides lowered if it falls short.
    So the grade of a patch is final when the next one is drawn.
    """
    p = courses.patches[k]
    streams = courses.streams
    spec = numbers.drawn.course
    length = within(streams, k, spec.patch_length)
    if spec.classes > 0:
        found = draw_patch(k, courses, load, numbers)
        if found:
            _add_patch(k, courses, length, numbers)
        return found
    margin = within(streams, k, spec.margin)
    if p == 0:
        margin = max(margin, 0.5 * (spec.margin[0] + spec.margin[1]))  # somewhere to get going
    tangent = capacity = -np.inf
    for _ in range(_MAX_REDRAWS):
        soil = draw_soil(streams, k, numbers)
        tangent, capacity = steepest(load, soil, margin, numbers)
        if capacity > -np.inf:
            for j in range(7):
                courses.soils[k, p, j] = soil[j]
            break
    if capacity == -np.inf:
        return False
    courses.margins[k, p] = capacity - tangent
    courses.grades[k, p] = math.atan(tangent)
    if p > 0:
        grade = courses.grades[k, p - 1]
        margin = courses.margins[k, p - 1]
        if not _joined(k, courses, p, load, numbers):
            courses.grades[k, p - 1] = grade
            courses.margins[k, p - 1] = margin
            return False
    _add_patch(k, courses, length, numbers)
    return True


@compiled_part
def _joined(k, courses, i, load, numbers):
    """Lower the grades of patches i - 1 and i until their border is passable; False if that cannot be."""
    short = numbers.drawn.course.margin[0] - _margin_at_border(k, courses, i, load, numbers)
    if short <= 0.0:
        return True
    for j in (i - 1, i):
        tangent = math.tan(courses.grades[k, j])
        lowered = max(tangent - 1.02 * short, numbers.drawn.grade_low)
        courses.grades[k, j] = math.atan(lowered)
        courses.margins[k, j] += tangent - lowered
    least = _margin_at_border(k, courses, i, load, numbers)
    if (
        numbers.wheel.effects.grade_weakening != 0.0
    ):  # a lowered grade may be a steep descent on weaker ground
        for j in (i - 1, i):
            tangent = math.tan(courses.grades[k, j])
            courses.margins[k, j] = (
                capacity(load, row_soil(courses.soils[k, j]), tangent, numbers) - tangent
            )
            least = min(least, courses.margins[k, j])
        if i > 1:
            least = min(least, _margin_at_border(k, courses, i - 1, load, numbers))
    return numbers.drawn.course.margin[0] - least <= 1e-6


@compiled_part
def _add_patch(k, courses, length, numbers):
    """Count the patch just written: its edges, the cells below it, and how far the ground is final now."""
    p = courses.patches[k]
    start = 0.0 if p == 0 else courses.edges[k, p]
    end = start + length
    whole = end >= numbers.drawn.course.length or p + 1 == courses.soils.shape[1]
    courses.edges[k, p] = start
    courses.edges[k, p + 1] = end
    courses.patches[k] = p + 1
    courses.ready[k] = np.inf if whole else start - 0.5 * numbers.drawn.course.border
    first = 0 if p == 0 else cell_at(courses, start) + 1
    cells = courses.rut_factors.shape[1]
    last = (
        cells - 1 if whole else min(cell_at(courses, end) + 1, cells - 1)
    )  # `between_cells` reads one further
    for i in range(first, last + 1):
        courses.rut_factors[k, i] = 1.0
        courses.rut[k, i] = 0.0
