"""Drawing courses: every patch passable by construction (docs/physics/wheel.md).

A course has a random stream of its own, and its patches are drawn from it in order, each as the
wheel comes near it: what they are like does not depend on how far or in how many pieces the course
is drawn. Ground of terrain classes and with two lines is drawn by `lines`.

Functions take a `Course`, `CourseNumbers` and the scratch `nodes` of an arc (`contact.ARC_NODES`).
"""

import math

import numpy as np
from numba import njit

from soil_env._compiled.flags import EXACT, HUGE, INLINE
from soil_env._compiled.random_streams import word
from soil_env.parameters import Scenario
from soil_env.simulation.world.lines import draw_classes, draw_lines, repeat_patch
from soil_env.simulation.world.passability import (
    DISTRIBUTION,
    IMPASSABLE,
    LOWERING,
    PRESET,
    TOLERANCE,
    CourseDistribution,
    CourseNumbers,
    capacity,
    draw_soil,
    margin_between,
    slopes_weaken,
    steepest,
    within,
)
from soil_env.simulation.world.terrain import cell_at
from soil_env.simulation.world.wheel import acting_in, rig_of
from soil_env.terramechanics.ground import put_soil, soil_of
from soil_env.terramechanics.model import WheelSoilModel

REDRAWS = 30  # attempts at a soil or a patch
# actions of travel at top rim speed before a wheel within which ground is drawn
ACTIONS_AHEAD = 3.0


def course_numbers(scenario: Scenario, model: WheelSoilModel | None = None) -> CourseNumbers:
    """Pack the numbers of `draw_course`; `model` gives the effects that are on in this world."""
    return CourseNumbers(
        course_distribution(scenario, model),
        rig_of(scenario, model)[0],
        acting_in(model),
    )


def course_distribution(
    scenario: Scenario, model: WheelSoilModel | None = None
) -> CourseDistribution:
    """Pack what courses are drawn from; the soil of a `model` replaces those of the scenario."""
    course = scenario.course
    camera = scenario.camera
    wheel = scenario.wheel
    spread = scenario.spread
    ahead = ACTIONS_AHEAD * wheel.radius * wheel.no_load_speed * scenario.control.duration
    if course.classes:  # the patch after one in sight is drawn, so that what is seen is final
        ahead += camera.range + course.patch_length[1] + course.border
    spec = np.zeros(1, DISTRIBUTION)[0]
    for name in ("length", "border", "class_scatter", "dead_ends", "classes", "lines"):
        spec[name] = getattr(course, name)
    for name in ("patch_length", "margin", "payload", "deficit", "halt_before"):
        spec[name] = getattr(course, name)
    for name in ("label_error", "grade_noise", "border_noise"):
        spec[name] = getattr(camera, name)
    spec.ahead = ahead
    spec.grade = np.tan(np.radians(course.grade_deg))
    spec.body_mass = wheel.body_mass
    spec.stall_torque = wheel.stall_torque
    spec.bogged_sinkage = scenario.limits.bogged_sinkage * wheel.radius
    spec.reference_sinkage = spread.reference_sinkage
    spec.speed = 0.5 * wheel.no_load_speed * wheel.radius
    spec.variation = (
        spread.friction,
        spread.cohesion,
        spread.shear_modulus,
        spread.stiffness,
        spread.dig_gain,
        spread.exponent,
    )
    spec.factor = spread.factor()
    presets = _presets(scenario, model)
    return CourseDistribution(
        spec, presets, None if course.classes else True, True if course.classes else None
    )


def _presets(scenario: Scenario, model: WheelSoilModel | None) -> np.ndarray:
    """The mixture of soils, `PRESET` [soils]."""
    width = scenario.wheel.width
    if model is not None and model.soil is not None:
        soils = [model.soil.state(width)]
        weights = np.ones(1)
    else:
        soils = [scenario.library[name].state(width) for name in scenario.soils]
        weights = np.array(list(scenario.soils.values()), dtype=float)
    shares = np.cumsum(weights) / weights.sum()
    return np.array([(share, *soil) for soil, share in zip(soils, shares, strict=True)], PRESET)


@njit(**INLINE)
def draw_course(course, owner, numbers, nodes):
    """`start_course` and all of its patches; the mass [kg] on the wheel with payload, or -1.

    -1: no passable course was found, as the soils are too weak for this wheel within the bounds of
    grade and margin.
    """
    mass = start_course(course, owner, numbers, nodes)
    if mass > 0.0 and not extend_course(course, mass, HUGE, numbers, nodes):
        mass = -1.0
    return mass


@njit(**EXACT)
def start_course(course, owner, numbers, nodes):
    """Start a course with a seed from the stream of `owner`; the mass [kg] on the wheel, or -1.

    Only as much is drawn as a wheel at its start needs; `extend_course` draws the rest.
    """
    for p in range(course.drawn):
        course.patches[p].start = HUGE
        course.patches[p].end = HUGE
    course.drawn = 0
    course.stream = word(owner)
    spec = numbers.drawn.spec
    for _ in range(REDRAWS):
        mass = spec.body_mass + within(course, spec.payload)
        load = mass * numbers.rig.gravity
        if not draw_classes(course, numbers.drawn.lines, load, numbers, nodes):
            continue
        if _try_patch(course, load, numbers, nodes):
            extend_course(course, mass, spec.ahead, numbers, nodes)
            return mass
    return -1.0


@njit(**EXACT)
def extend_course(course, mass, x, numbers, nodes):
    """Draw patches until the ground is final up to x [m] or the course ends; `mass` in kg.

    False if no passable patch was found for some place, and the patch before it was repeated there.
    """
    load = mass * numbers.rig.gravity
    found = True
    while course.ready < x:
        tries = 0
        while tries < REDRAWS and not _try_patch(course, load, numbers, nodes):
            tries += 1
        if tries == REDRAWS:
            found = False
            repeat_patch(course, numbers.drawn.lines)
            length = within(course, numbers.drawn.spec.patch_length)
            _add_patch(course, length, numbers.drawn.spec)
    return found


@njit(**EXACT)
def _try_patch(course, load, numbers, nodes):
    """Draw the next patch and add it; False, with the course as before, if it is not passable.

    The blend at the border to the patch before is checked too, and the grades on both sides lowered
    if it falls short. So the grade of a patch is final when the next one is drawn.
    """
    drawn = numbers.drawn
    length = within(course, drawn.spec.patch_length)
    found = draw_lines(course, drawn.lines, load, numbers, nodes)
    if not found:
        found = _draw_ground(course, drawn.plain, load, numbers, nodes)
    if found:
        _add_patch(course, length, drawn.spec)
    return found


@njit(**EXACT)
def _draw_ground(course, plain, load, numbers, nodes):
    """Draw soil and grade of the next patch without classes; False if it is not passable."""
    if plain is None:
        return False
    else:
        p = course.drawn
        spec = numbers.drawn.spec
        margin = within(course, spec.margin)
        if p == 0:
            margin = max(margin, 0.5 * (spec.margin[0] + spec.margin[1]))  # somewhere to get going
        patch = course.patches[p]
        for _ in range(REDRAWS):
            soil = draw_soil(course, numbers.drawn)
            tangent, pull = steepest(load, soil, margin, numbers, nodes)
            if pull > IMPASSABLE:
                put_soil(patch, soil)
                patch.grade = math.atan(tangent)
                patch.margin = pull - tangent
                return p == 0 or _joined(course, p, load, numbers, nodes)
        return False


@njit(**EXACT)
def _joined(course, p, load, numbers, nodes):
    """Lower the grades of patches p - 1 and p until their border is passable.

    False, with the patch before as it was, if that cannot be.
    """
    spec = numbers.drawn.spec
    patches = course.patches
    kept_grade = patches[p - 1].grade
    kept_margin = patches[p - 1].margin
    short = spec.margin[0] - margin_between(patches[p - 1], patches[p], load, numbers, nodes)
    if short <= 0.0:
        return True
    for i in (p - 1, p):
        tangent = math.tan(patches[i].grade)
        lowered = max(tangent - LOWERING * short, spec.grade[0])
        patches[i].grade = math.atan(lowered)
        patches[i].margin += tangent - lowered
    least = margin_between(patches[p - 1], patches[p], load, numbers, nodes)
    if slopes_weaken(numbers.acting.effects):
        # a lowered grade may be a steep descent on weaker ground
        for i in (p - 1, p):
            tangent = math.tan(patches[i].grade)
            pull = capacity(load, soil_of(patches[i]), tangent, numbers, nodes)
            patches[i].margin = pull - tangent
            least = min(least, patches[i].margin)
        if p > 1:
            before = margin_between(patches[p - 2], patches[p - 1], load, numbers, nodes)
            least = min(least, before)
    if spec.margin[0] - least <= TOLERANCE:
        return True
    patches[p - 1].grade = kept_grade
    patches[p - 1].margin = kept_margin
    return False


@njit(**EXACT)
def _add_patch(course, length, spec):
    """Count the patch just written: its place, its cells, and how far the ground is final now."""
    p = course.drawn
    start = 0.0 if p == 0 else course.patches[p - 1].end
    end = start + length
    whole = end >= spec.length or p + 1 == course.patches.size
    course.patches[p].start = start
    course.patches[p].end = end
    course.drawn = p + 1
    course.ready = HUGE if whole else start - 0.5 * spec.border
    cells = course.cells
    first = 0 if p == 0 else cell_at(cells, start) + 1
    # `rut_factor_at` reads one cell further
    last = cells.size - 1 if whole else min(cell_at(cells, end) + 1, cells.size - 1)
    for i in range(first, last + 1):
        cells[i].factor = 1.0
        cells[i].depth = 0.0
