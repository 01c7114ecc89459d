"""Drawing courses: patches of soil, and a profile of slopes that says nothing about them
(docs/physics/wheel.md).

A course has a random stream of its own, and its patches are drawn from it in order, each with the
slopes over it as the wheel comes near. What they are like does not depend on how far or in how many
pieces the course is drawn. Ground of terrain classes and with two routes is drawn by `routes`.

Slopes have lengths and grades of their own. So a grade changes inside a soil, a soil on a slope,
and some slopes are too steep for their soil: those courses are kept.

Functions take a course (`terrain.course_dtype`), `CourseNumbers` and the scratch `nodes` of an arc
(`contact.ARC_NODES`). `spec` is the `DISTRIBUTION` of the numbers, `load` [N] the weight of the
wheel on level ground.
"""

import numpy as np

from soil_env._compiled.flags import HUGE, compiled, inlined
from soil_env._compiled.random_streams import word
from soil_env.parameters import Scenario
from soil_env.terramechanics.ground import put_soil, soil_of
from soil_env.terramechanics.model import WheelSoilModel

from .passability import (
    DISTRIBUTION,
    PRESET,
    CourseDistribution,
    CourseNumbers,
    draw_ground,
    within,
)
from .routes import draw_classes, draw_routes
from .terrain import cell_at, clear
from .wheel import acting_in, rig_of

# ground is drawn as far ahead of a wheel as it travels in so many actions at top rim speed; one is
# what it needs, the rest is an own choice
ACTIONS_AHEAD = 3.0
DRIVING = 0.5  # [of the top rim speed] travel at which a soil is judged; own choice


def course_numbers(scenario: Scenario, model: WheelSoilModel | None) -> CourseNumbers:
    """Pack what `start_course` and `extend_course` draw from; a `model` gives effects, lugs and,
    where it has one, the soil.
    """
    rig = rig_of(scenario, model)[0]
    return CourseNumbers(
        course_distribution(scenario, model),
        rig,
        acting_in(model, rig.shear_ratio),
    )


def course_distribution(
    scenario: Scenario, model: WheelSoilModel | None = None
) -> CourseDistribution:
    """Pack what courses are drawn from; the soil of a `model` replaces those of the scenario.

    Angles become radians, the bogged sinkage metres. Final ground is asked for `ACTIONS_AHEAD`
    actions at top rim speed ahead, with terrain classes also beyond what a camera sees.
    """
    course = scenario.course
    camera = scenario.camera
    wheel = scenario.wheel
    spread = scenario.spread
    ahead = ACTIONS_AHEAD * wheel.radius * wheel.no_load_speed * scenario.control.duration
    if course.classes:  # the patch after one in sight is drawn, so that what is seen is final
        ahead += camera.range + course.patch_length[1] + course.border
    spec = np.zeros(1, DISTRIBUTION)[0]
    of_course = ("length", "border", "class_scatter", "least_pull", "classes", "lines")
    ranges = ("patch_length", "slope_length", "payload", "halt_before")
    for part, names in (
        (course, of_course + ranges),
        (camera, ("label_error", "grade_noise", "border_noise")),
        (wheel, ("body_mass", "stall_torque")),
    ):
        for name in names:
            spec[name] = getattr(part, name)
    spec.ahead = ahead
    spec.grade = np.radians(course.grade_deg)
    spec.first_grade = np.radians(course.first_grade_deg)
    spec.bogged_sinkage = scenario.limits.bogged_sinkage * wheel.radius
    spec.reference_sinkage = spread.reference_sinkage
    spec.speed = DRIVING * wheel.no_load_speed * wheel.radius
    spec.variation = (
        spread.friction,
        spread.cohesion,
        spread.shear_modulus,
        spread.stiffness,
        spread.dig_gain,
        spread.exponent,
    )
    spec.factor = spread.factor()
    return CourseDistribution(spec, _presets(scenario, model))


def _presets(scenario: Scenario, model: WheelSoilModel | None) -> np.ndarray:
    """Mixture of soils, `PRESET` [soils]: that of the scenario, or the soil of a `model` alone
    where it has one.
    """
    if model is not None and model.soil is not None:
        soils = [scenario.beneath(model.soil)]
        weights = np.ones(1)
    else:
        soils = [scenario.beneath(scenario.library[name]) for name in scenario.soils]
        weights = np.array(list(scenario.soils.values()), dtype=float)
    shares = np.cumsum(weights) / weights.sum()
    return np.array([(share, *soil) for soil, share in zip(soils, shares, strict=True)], PRESET)


@compiled
def start_course(course, owner, numbers, nodes):
    """Start a new course with a seed from the stream of `owner`; return the mass [kg] on the wheel
    with payload, or -1.

    -1 means that no soil was found on which this wheel can pull as much as the course requires
    (`least_pull`). Only as much is drawn as a wheel at the start needs; `extend_course` draws the
    rest. `owner`: a record with a random stream; `numbers`: `CourseNumbers`; `nodes`: scratch.
    """
    _clear(course.patches, course.drawn)
    _clear(course.slopes, course.sloped)
    course.drawn = 0
    course.sloped = 0
    course.stream = word(owner)
    spec = numbers.drawn.spec
    mass = spec.body_mass + within(course, spec.payload)
    load = mass * numbers.rig.gravity
    found = draw_classes(course, load, numbers, nodes)
    if not (found and _draw_patch(course, load, numbers, nodes)):
        return -1.0
    extend_course(course, mass, spec.ahead, numbers, nodes)
    return mass


@compiled
def _clear(pieces, drawn):
    """Mark the first `drawn` patches or slopes as not drawn: both ends at `HUGE`."""
    for p in range(drawn):
        pieces[p].start = HUGE
        pieces[p].end = HUGE


@compiled
def extend_course(course, mass, x, numbers, nodes):
    """Draw patches until the ground is final up to x [m] or the course ends; `mass` in kg on the
    wheel, with payload.

    Where no soil is found, that of the patch before goes on. At the end of the course `ready` is
    `HUGE`, so an x of `HUGE` draws all of it.
    """
    load = mass * numbers.rig.gravity
    while course.ready < x:
        _draw_patch(course, load, numbers, nodes)


@compiled
def _draw_patch(course, load, numbers, nodes):
    """Draw the next patch and the slopes over it; False if no soil was found.

    The patch then has the soil of the patch before; without one before, nothing is added. With
    terrain classes a soil is always found: that of a class is scattered. `load` [N] is the weight
    of the wheel on level ground, `numbers` the `CourseNumbers`, `nodes` scratch.
    """
    spec = numbers.drawn.spec
    length = within(course, spec.patch_length)
    found = True
    if spec.classes > 0:
        draw_routes(course, load, numbers, nodes)
    else:
        found = _draw_soil(course, load, numbers, nodes)
    if found or course.drawn > 0:
        _add_patch(course, length, spec)
        _draw_slopes(course, spec)
        _note_steepest(course)
    return found


@inlined
def _draw_soil(course, load, numbers, nodes):
    """Draw the soil of the next patch, on a course without terrain classes.

    Where none is found (`draw_ground`), return False and repeat the soil of the patch before. The
    first patch then gets the last soil that was drawn, and is not added. Arguments as in
    `_draw_patch`.
    """
    p = course.drawn
    found, soil = draw_ground(course, load, numbers, nodes)
    if not found and p > 0:
        soil = soil_of(course.patches[p - 1])
    put_soil(course.patches[p], soil)
    return found


@inlined
def _add_patch(course, length, spec):
    """Add the next patch, `length` [m] long, whose soil is written already: set its ends, clear its
    rut cells, set `ready`. `spec`: `DISTRIBUTION`.

    Until the wheel comes to the border before the new patch, a choice of route may still replace
    the soil of the patch. So the ground is final up to that border, or all of it with the last
    patch.
    """
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
    # one cell beyond the end, since `pass_at` reads it
    last = cells.size - 1 if whole else min(cell_at(cells, end) + 1, cells.size - 1)
    for i in range(first, last + 1):
        clear(cells[i])


@inlined
def _draw_slopes(course, spec):
    """Draw slopes up to the end of the last patch, without looking at its soil.

    The first slope, and those drawn with the first patch of each class, have grades within
    `first_grade`, all others within `grade`.
    """
    last = course.drawn - 1
    end = course.patches[last].end
    s = course.sloped
    reached = course.slopes[s - 1].end if s > 0 else 0.0
    while reached < end and s < course.slopes.size:
        slope = course.slopes[s]
        slope.start = reached
        reached += within(course, spec.slope_length)
        slope.end = reached
        first = s == 0 or last < spec.classes
        slope.grade = within(course, spec.first_grade if first else spec.grade)
        s += 1
    course.sloped = s


@inlined
def _note_steepest(course):
    """Note the grade [rad] of the steepest slope uphill on the last patch, for the camera, in its
    `FORK`. It is below 0 where all slopes on the patch lead downhill.
    """
    p = course.drawn - 1
    start = course.patches[p].start
    end = course.patches[p].end
    steepest = -HUGE
    for s in range(course.sloped):
        slope = course.slopes[s]
        if slope.end > start and slope.start < end:
            steepest = max(steepest, slope.grade)
    course.forks[p].grade = steepest
