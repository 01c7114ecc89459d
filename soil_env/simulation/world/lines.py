"""Courses of terrain classes, and the lines between which a wheel may choose (docs/physics/wheel.md).

One of two lines over a patch is passable by construction, as every patch of a course without classes is, and so is
every border between passable lines; the other may be steeper than any slip can climb.
"""

import math

import numpy as np

from soil_env._numba.compiling import compiled_inline, compiled_part
from soil_env._numba.random_streams import normal_pair, uniform, within
from soil_env.simulation.world.passability import draw_soil, margin_between, scattered, steepest
from soil_env.terramechanics.ground import row_soil

_REDRAWS = 30


@compiled_part
def draw_classes(k, courses, load, numbers):
    """Draw the soils of the classes of course k; False if none was found that leaves the highest margin."""
    drawn = numbers.drawn
    streams = courses.streams
    library = courses.lines.library
    for c in range(drawn.course.classes):
        tries = 0
        while tries < _REDRAWS:
            soil = draw_soil(streams, k, numbers)
            _, pull = steepest(load, soil, drawn.course.margin[1], numbers)
            if pull > -np.inf:
                for j in range(7):
                    library[k, c, j] = soil[j]
                break
            tries += 1
        if tries == _REDRAWS:
            return False
    return True


@compiled_inline
def _another(streams, k, count, one):
    """A class other than `one`, of `count`."""
    other = int(uniform(streams, k) * (count - 1))
    return other + 1 if other >= one else other


@compiled_inline
def _introduced(k, courses, p, count):
    """Class of patch p < count of course k: one that no patch before it is of, by chance."""
    left = count - p
    pick = int(uniform(courses.streams, k) * left)
    for c in range(count):
        new = True
        for q in range(p):
            new = new and courses.lines.classes[k, q, 0] != c
        if new:
            if pick == 0:
                return c
            pick -= 1
    return 0


@compiled_part
def _draw_line(k, courses, p, line, margin, load, numbers):
    """Draw soil and grade of a line of patch p whose class is known; False if its grade would be out of bounds.

    A negative margin is a deficit: the line is steeper by it than the steepest that it could be.
    """
    lines = courses.lines
    drawn = numbers.drawn
    mean = row_soil(lines.library[k, lines.classes[k, p, line]])
    soil = scattered(mean, drawn.course.class_scatter, courses.streams, k, numbers)
    tangent, pull = steepest(load, soil, max(margin, 0.0), numbers)
    if pull == -np.inf:
        return False
    if margin < 0.0:
        tangent = pull - margin
        if tangent > drawn.grade_high or tangent < drawn.grade_low:
            return False
    for j in range(7):
        lines.soils[k, p, line, j] = soil[j]
    lines.grades[k, p, line] = math.atan(tangent)
    lines.capacities[k, p, line] = pull
    return True


@compiled_inline
def _copy_line(k, courses, p):
    """Line 1 of a patch with one line is line 0."""
    lines = courses.lines
    lines.classes[k, p, 1] = lines.classes[k, p, 0]
    lines.grades[k, p, 1] = lines.grades[k, p, 0]
    lines.capacities[k, p, 1] = lines.capacities[k, p, 0]
    for j in range(7):
        lines.soils[k, p, 1, j] = lines.soils[k, p, 0, j]


@compiled_part
def draw_patch(k, courses, load, numbers):
    """Draw the next patch of course k into the row after its last one; False if it is not passable.

    Where the border between a passable line of this patch and one of the patch before falls short of the least margin,
    the grades of both are lowered, so that the grades of a patch are final when the next one is drawn.
    """
    p = courses.patches[k]
    streams = courses.streams
    lines = courses.lines
    drawn = numbers.drawn
    spec = drawn.course
    two = spec.lines > 1 and p >= spec.classes
    margin = within(streams, k, spec.margin)
    other = within(streams, k, spec.margin)
    if p == 0:
        margin = max(margin, 0.5 * (spec.margin[0] + spec.margin[1]))  # somewhere to get going
    lines.count[k, p] = 2 if two else 1
    if p < spec.classes:
        lines.classes[k, p, 0] = _introduced(k, courses, p, spec.classes)
    else:
        lines.classes[k, p, 0] = int(uniform(streams, k) * spec.classes)
    if two:
        lines.classes[k, p, 1] = _another(streams, k, spec.classes, lines.classes[k, p, 0])
        if uniform(streams, k) < spec.dead_ends:
            deficit = -within(streams, k, spec.deficit)
            if uniform(streams, k) < 0.5:
                margin = deficit
            else:
                other = deficit
    if not _draw_line(k, courses, p, 0, margin, load, numbers):
        return False
    if not two:
        _copy_line(k, courses, p)
    elif not _draw_line(k, courses, p, 1, other, load, numbers):
        return False
    if p > 0 and not _joined(k, courses, p, load, numbers):
        return False
    _draw_looks(k, courses, p, drawn)
    take_line(k, courses, p, 0)
    return True


@compiled_part
def repeat_patch(k, courses, p):
    """Patch p as the passable line of the patch before it: for want of another."""
    lines = courses.lines
    line = 0 if passable(k, courses, p - 1, 0) else 1
    lines.count[k, p] = 1
    for i in range(2):
        lines.classes[k, p, i] = lines.classes[k, p - 1, line]
        lines.labels[k, p, i] = lines.labels[k, p - 1, line]
        lines.grades[k, p, i] = lines.grades[k, p - 1, line]
        lines.capacities[k, p, i] = lines.capacities[k, p - 1, line]
        lines.grade_errors[k, p, i] = lines.grade_errors[k, p - 1, line]
        for j in range(7):
            lines.soils[k, p, i, j] = lines.soils[k, p - 1, line, j]
    take_line(k, courses, p, 0)


@compiled_inline
def _draw_looks(k, courses, p, drawn):
    """Draw the errors of the camera in patch p, and how far before it the wheel is halted."""
    lines = courses.lines
    streams = courses.streams
    spec = drawn.course
    camera = drawn.camera
    for line in range(2):
        label = lines.classes[k, p, line]
        if uniform(streams, k) < camera.label_error and spec.classes > 1:
            label = _another(streams, k, spec.classes, label)
        lines.labels[k, p, line] = label
    a, b = normal_pair(streams, k)
    lines.grade_errors[k, p, 0] = camera.grade_noise * a
    lines.grade_errors[k, p, 1] = camera.grade_noise * b
    a, b = normal_pair(streams, k)
    lines.border_errors[k, p] = camera.border_noise * a
    if lines.count[k, p] == 1:
        lines.labels[k, p, 1] = lines.labels[k, p, 0]
        lines.grade_errors[k, p, 1] = lines.grade_errors[k, p, 0]
    lines.halts[k, p] = -within(streams, k, spec.halt_before)


@compiled_inline
def passable(k, courses, p, line):
    """True if a line of patch p is passable: if its grade is less than its capacity."""
    return courses.lines.capacities[k, p, line] > math.tan(courses.lines.grades[k, p, line])


@compiled_part
def _border_margin(k, courses, p, before, line, load, numbers):
    """Margin in the middle of the passage from line `before` of patch p - 1 to `line` of patch p."""
    soils = courses.lines.soils[k]
    grades = courses.lines.grades[k]
    return margin_between(
        row_soil(soils[p - 1, before]),
        row_soil(soils[p, line]),
        grades[p - 1, before],
        grades[p, line],
        load,
        numbers,
    )


@compiled_part
def _joined(k, courses, p, load, numbers):
    """Lower grades until each border between passable lines of patches p - 1 and p is passable; False if that fails.

    Ground that slopes weaken may not have its grades changed afterwards: there a short border is a failure.
    """
    lines = courses.lines
    drawn = numbers.drawn
    kept0 = lines.grades[k, p - 1, 0]
    kept1 = lines.grades[k, p - 1, 1]
    least = np.inf
    for attempt in range(2):
        least = np.inf
        for before in range(lines.count[k, p - 1]):
            for line in range(lines.count[k, p]):
                if not (passable(k, courses, p - 1, before) and passable(k, courses, p, line)):
                    continue
                short = drawn.course.margin[0] - _border_margin(
                    k, courses, p, before, line, load, numbers
                )
                least = min(least, -short)
                if short > 0.0 and attempt == 0 and numbers.wheel.effects.grade_weakening == 0.0:
                    _lower(k, courses, p - 1, before, short, drawn.grade_low)
                    _lower(k, courses, p, line, short, drawn.grade_low)
    if lines.count[k, p - 1] == 1:
        lines.grades[k, p - 1, 1] = lines.grades[k, p - 1, 0]
    if lines.count[k, p] == 1:
        lines.grades[k, p, 1] = lines.grades[k, p, 0]
    if least < -1e-6:
        lines.grades[k, p - 1, 0] = kept0
        lines.grades[k, p - 1, 1] = kept1
        return False
    take_line(k, courses, p - 1, 0)
    return True


@compiled_inline
def _lower(k, courses, p, line, short, lowest):
    """Lower the grade of a line by what a border falls `short` of, as far as the tangent `lowest`."""
    tangent = math.tan(courses.lines.grades[k, p, line])
    courses.lines.grades[k, p, line] = math.atan(max(tangent - 1.02 * short, lowest))


@compiled_inline
def take_line(k, courses, p, line):
    """Let course k lead along a line of patch p."""
    lines = courses.lines
    lines.taken[k, p] = line
    for j in range(7):
        courses.soils[k, p, j] = lines.soils[k, p, line, j]
    courses.grades[k, p] = lines.grades[k, p, line]
    courses.margins[k, p] = lines.capacities[k, p, line] - math.tan(lines.grades[k, p, line])


@compiled_inline
def next_fork(state, counts, k, courses, border):
    """The patch with two lines that wheel k comes to next and has not touched yet, or -1."""
    ahead = counts.patch[k] + 1
    if ahead >= courses.patches[k] or courses.lines.count[k, ahead] < 2:
        return -1
    return ahead if state.best_x[k] < courses.edges[k, ahead] - 0.5 * border else -1


@compiled_inline
def plan_halt(state, counts, k, courses, world):
    """Let wheel k halt before the next fork; a halt that would be shortly before that one waits for it."""
    fork = next_fork(state, counts, k, courses, world.border)
    if fork >= 0:
        place = courses.edges[k, fork] + courses.lines.halts[k, fork]
        if state.best_x[k] < place and state.next_halt[k] > place - world.halt_low:
            state.next_halt[k] = place


@compiled_inline
def choosing(state, counts, k, courses, numbers):
    """The patch whose line the action of wheel k chooses now, or -1: at a halt within `sight` of a fork."""
    fork = next_fork(state, counts, k, courses, numbers.border) if state.halt_left[k] > 0.0 else -1
    return fork if fork >= 0 and courses.edges[k, fork] - state.x[k] <= numbers.sight else -1


@compiled_inline
def settled(state, k, courses, patch):
    """True if wheel k has no choice of a line over a patch: it had none, or has come to the halt before it."""
    return (
        courses.lines.count[k, patch] < 2
        or state.best_x[k] >= courses.edges[k, patch] + courses.lines.halts[k, patch]
    )
