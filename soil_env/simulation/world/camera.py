"""Camera: terrain class under the wheel, and class, grade and distance of the lines of the patch ahead.

Label and grade of a line are wrong in the same way in every image (`lines._draw_looks`), so that they do not average
out. The distance of a border has an error of that kind and one that is new in every image.
"""

from typing import NamedTuple

from soil_env._numba.compiling import compiled_inline
from soil_env._numba.random_streams import normal_pair
from soil_env.parameters import Scenario
from soil_env.readings import Image
from soil_env.simulation.world.lines import choosing, settled


class CameraNumbers(NamedTuple):
    """Numbers of the camera from a `Scenario`."""

    classes: int  # 0: no camera
    lines: int
    sight: float  # [m]
    border: float  # [m] over which one patch passes into the next
    border_noise: float  # [m]


class Sight(NamedTuple):
    """Place of the wheel by an image."""

    patch: int  # that the wheel seems to be on
    since: float  # [m] from the beginning of it
    left: float  # [m] to its end


def camera_numbers(scenario: Scenario) -> CameraNumbers:
    """Pack what the functions below need."""
    c = scenario.course
    return CameraNumbers(
        c.classes, c.lines, scenario.camera.range, c.border, scenario.camera.border_noise
    )


@compiled_inline
def look(state, counts, k, courses, streams, camera):
    """`Sight` of a new image of wheel k."""
    errors = courses.lines.border_errors
    edges = courses.edges
    last = courses.patches[k] - 1
    x = state.x[k] + camera.border_noise * normal_pair(streams, k)[0]
    patch = counts.patch[k]
    while patch < last and x >= edges[k, patch + 1] + errors[k, patch + 1]:
        patch += 1
    while patch > 0 and x < edges[k, patch] + errors[k, patch]:
        patch -= 1
    end = edges[k, patch + 1] + (errors[k, patch + 1] if patch < last else 0.0)
    return Sight(patch, x - edges[k, patch] - errors[k, patch], end - x)


@compiled_inline
def label_here(courses, k, sight):
    """The class of the ground under wheel k as the camera sees it."""
    return courses.lines.labels[k, sight.patch, courses.lines.taken[k, sight.patch]]


@compiled_inline
def patch_ahead(courses, k, sight, camera):
    """The patch whose lines are in sight, or -1."""
    ahead = sight.patch + 1
    return ahead if ahead < courses.patches[k] and sight.left <= camera.sight else -1


@compiled_inline
def seen_grade(courses, k, patch, line):
    """Grade [rad] of a line as the camera sees it."""
    return courses.lines.grades[k, patch, line] + courses.lines.grade_errors[k, patch, line]


@compiled_inline
def image_of(state, k, courses, sight, camera):
    """`Image` of wheel k, for what identifies the ground on board."""
    lines = courses.lines
    ahead = patch_ahead(courses, k, sight, camera)
    patch = max(ahead, 0)
    return Image(
        sight.patch,
        sight.since,
        sight.left,
        label_here(courses, k, sight),
        1.0 if ahead >= 0 else 0.0,
        1.0 if settled(state, k, courses, patch) else 0.0,
        lines.count[k, patch],
        lines.taken[k, patch],
        lines.labels[k, patch, 0],
        lines.labels[k, patch, 1],
        seen_grade(courses, k, patch, 0),
        seen_grade(courses, k, patch, 1),
    )


@compiled_inline
def write_view(out, state, counts, k, courses, sight, camera):
    """Fill `out` with distance, class here, and grade and class of each line ahead; return the count of numbers."""
    n = camera.classes
    ahead = patch_ahead(courses, k, sight, camera)
    out[0] = max(sight.left, 0.0) if ahead >= 0 else camera.sight
    for c in range(n):
        out[1 + c] = 1.0 if label_here(courses, k, sight) == c else 0.0
    i = 1 + n
    for line in range(camera.lines):
        there = ahead >= 0 and line < courses.lines.count[k, ahead]
        out[i] = seen_grade(courses, k, ahead, line) if there else 0.0
        for c in range(n):
            out[i + 1 + c] = 1.0 if there and courses.lines.labels[k, ahead, line] == c else 0.0
        i += 1 + n
    if camera.lines > 1:
        out[i] = 1.0 if choosing(state, counts, k, courses, camera) >= 0 else 0.0
        i += 1
    return i
