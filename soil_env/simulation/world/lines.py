"""Terrain classes, and the lines between which a wheel may choose (docs/physics/wheel.md).

One of two lines over a patch is passable by construction, as every patch of a course without
classes is, and so is every border between passable lines; the other may be steeper than any slip
can climb.
"""

import math

from numba import njit

from soil_env._compiled.flags import EXACT, HUGE, INLINE
from soil_env._compiled.random_streams import normal_pair, uniform
from soil_env.simulation.world.passability import (
    IMPASSABLE,
    LOWERING,
    TOLERANCE,
    draw_soil,
    margin_between,
    scattered,
    slopes_weaken,
    steepest,
    within,
)
from soil_env.terramechanics.ground import put_soil, soil_of

CLASS_REDRAWS = 30  # attempts at the soil of a class


@njit(**EXACT)
def draw_classes(course, lines, load, numbers, nodes):
    """Draw the soils of the classes of a course; False if none leaves the highest margin.

    `lines`: None without classes, here and below.
    """
    if lines is None:
        return True
    else:
        spec = numbers.drawn.spec
        for c in range(spec.classes):
            tries = 0
            while tries < CLASS_REDRAWS:
                soil = draw_soil(course, numbers.drawn)
                _, pull = steepest(load, soil, spec.margin[1], numbers, nodes)
                if pull > IMPASSABLE:
                    put_soil(course.library[c], soil)
                    break
                tries += 1
            if tries == CLASS_REDRAWS:
                return False
        return True


@njit(**EXACT)
def _another(owner, classes, one):
    """A class other than `one`."""
    other = int(uniform(owner) * (classes - 1))
    return other + 1 if other >= one else other


@njit(**INLINE)
def _introduced(course, p, classes):
    """Class of a patch p < classes: one that no patch before it is of, by chance."""
    left = classes - p
    pick = int(uniform(course) * left)
    for c in range(classes):
        new = True
        for q in range(p):
            new = new and course.lines[q, 0].terrain != c
        if new:
            if pick == 0:
                return c
            pick -= 1
    return 0


@njit(**EXACT)
def _draw_line(course, line, margin, load, numbers, nodes):
    """Draw soil and grade of a `LINE` of a known class; False if its grade would be out of bounds.

    A negative margin is a deficit: the line is steeper by it than the steepest that it could be.
    """
    spec = numbers.drawn.spec
    mean = soil_of(course.library[line.terrain])
    soil = scattered(mean, spec.class_scatter, course, spec)
    tangent, pull = steepest(load, soil, max(margin, 0.0), numbers, nodes)
    if pull <= IMPASSABLE:
        return False
    if margin < 0.0:
        tangent = pull - margin
        if tangent > spec.grade[1] or tangent < spec.grade[0]:
            return False
    put_soil(line, soil)
    line.grade = math.atan(tangent)
    line.capacity = pull
    return True


@njit(**EXACT)
def draw_lines(course, lines, load, numbers, nodes):
    """Draw the lines of the next patch; False if it is not passable, and without classes.

    Where the border between a passable line of this patch and one of the patch before falls short
    of the least margin, the grades of both are lowered. So the grades of a patch are final when the
    next one is drawn.
    """
    if lines is None:
        return False
    else:
        p = course.drawn
        spec = numbers.drawn.spec
        two = spec.lines > 1 and p >= spec.classes
        margin = within(course, spec.margin)
        other = within(course, spec.margin)
        if p == 0:
            margin = max(margin, 0.5 * (spec.margin[0] + spec.margin[1]))  # somewhere to get going
        course.forks[p].lines = 2 if two else 1
        straight = course.lines[p, 0]
        beside = course.lines[p, 1]
        if p < spec.classes:
            straight.terrain = _introduced(course, p, spec.classes)
        else:
            straight.terrain = int(uniform(course) * spec.classes)
        if two:
            beside.terrain = _another(course, spec.classes, straight.terrain)
            if uniform(course) < spec.dead_ends:
                deficit = -within(course, spec.deficit)
                if uniform(course) < 0.5:
                    margin = deficit
                else:
                    other = deficit
        if not _draw_line(course, straight, margin, load, numbers, nodes):
            return False
        if not two:
            course.lines[p, 1] = straight
        elif not _draw_line(course, beside, other, load, numbers, nodes):
            return False
        if p > 0 and not _joined(course, p, load, numbers, nodes):
            return False
        _draw_looks(course, p, spec)
        take_line(course, p, 0)
        return True


@njit(**EXACT)
def repeat_patch(course, lines):
    """Patch after the last one as that one, or as its passable line: for want of another."""
    p = course.drawn
    if lines is None:
        course.patches[p] = course.patches[p - 1]
    else:
        line = 0 if passable(course.lines[p - 1, 0]) else 1
        for i in range(2):
            course.lines[p, i] = course.lines[p - 1, line]
        fork = course.forks[p]
        fork.lines = 1
        fork.halt = 0.0
        fork.border_error = 0.0
        take_line(course, p, 0)


@njit(**INLINE)
def _draw_looks(course, p, spec):
    """Draw the errors of the camera in patch p, and how far before it the wheel is halted."""
    fork = course.forks[p]
    straight = course.lines[p, 0]
    beside = course.lines[p, 1]
    for i in range(2):
        line = course.lines[p, i]
        line.label = line.terrain
        if uniform(course) < spec.label_error and spec.classes > 1:
            line.label = _another(course, spec.classes, line.terrain)
    a, b = normal_pair(course)
    straight.grade_error = spec.grade_noise * a
    beside.grade_error = spec.grade_noise * b
    a, b = normal_pair(course)
    fork.border_error = spec.border_noise * a
    if fork.lines == 1:
        beside.label = straight.label
        beside.grade_error = straight.grade_error
    fork.halt = -within(course, spec.halt_before)


@njit(**EXACT)
def passable(line):
    """True if the grade of a line is less than its capacity."""
    return line.capacity > math.tan(line.grade)


@njit(**EXACT)
def _joined(course, p, load, numbers, nodes):
    """Lower grades until each border between passable lines of patches p - 1 and p is passable.

    Ground that slopes weaken may not have its grades changed afterwards: there a short border is a
    failure.
    """
    spec = numbers.drawn.spec
    lines = course.lines
    kept_straight = lines[p - 1, 0].grade
    kept_beside = lines[p - 1, 1].grade
    may_lower = not slopes_weaken(numbers.acting.effects)
    least = HUGE
    for attempt in range(2):
        least = HUGE
        for i in range(course.forks[p - 1].lines):
            for j in range(course.forks[p].lines):
                before = lines[p - 1, i]
                line = lines[p, j]
                if not (passable(before) and passable(line)):
                    continue
                short = spec.margin[0] - margin_between(before, line, load, numbers, nodes)
                least = min(least, -short)
                if short > 0.0 and attempt == 0 and may_lower:
                    _lower(before, short, spec.grade[0])
                    _lower(line, short, spec.grade[0])
    if course.forks[p - 1].lines == 1:
        lines[p - 1, 1].grade = lines[p - 1, 0].grade
    if course.forks[p].lines == 1:
        lines[p, 1].grade = lines[p, 0].grade
    if least < -TOLERANCE:
        lines[p - 1, 0].grade = kept_straight
        lines[p - 1, 1].grade = kept_beside
        return False
    take_line(course, p - 1, 0)
    return True


@njit(**EXACT)
def _lower(line, short, lowest):
    """Lower the grade of a line by what a border falls `short` of, down to the tangent `lowest`."""
    line.grade = math.atan(max(math.tan(line.grade) - LOWERING * short, lowest))


@njit(**EXACT)
def take_line(course, p, line):
    """Let the course lead along a line of patch p."""
    taken = course.lines[p, line]
    patch = course.patches[p]
    course.forks[p].taken = line
    put_soil(patch, taken)
    patch.grade = taken.grade
    patch.margin = taken.capacity - math.tan(taken.grade)


@njit(**EXACT)
def next_fork(wheel, course, border):
    """The patch with two lines that a wheel comes to next and has not touched yet, or -1."""
    ahead = wheel.patch + 1
    if ahead >= course.drawn or course.forks[ahead].lines < 2:
        return -1
    return ahead if wheel.best_x < course.patches[ahead].start - 0.5 * border else -1


@njit(**EXACT)
def plan_halt(wheel, course, rig):
    """Let a wheel halt before the next fork; a halt shortly before that one waits for it."""
    fork = next_fork(wheel, course, rig.border)
    if fork >= 0:
        place = course.patches[fork].start + course.forks[fork].halt
        if wheel.best_x < place and wheel.next_halt > place - rig.halt_low:
            wheel.next_halt = place


@njit(**EXACT)
def choosing(wheel, course, view):
    """The patch whose line the action chooses now, or -1: at a halt with a fork in sight.

    `view`: a record with `sight` and `border` [m], as those of a wheel's rig and of a camera.
    """
    if wheel.halt_left <= 0.0:
        return -1
    fork = next_fork(wheel, course, view.border)
    if fork < 0 or course.patches[fork].start - wheel.x > view.sight:
        return -1
    return fork


@njit(**EXACT)
def settled(wheel, course, p):
    """True if a wheel has no choice over patch p: one line, or it has come to the halt."""
    fork = course.forks[p]
    return fork.lines < 2 or wheel.best_x >= course.patches[p].start + fork.halt
