"""Camera: terrain class under the wheel, and class, grade and distance of the routes ahead.

Label and grade of a route are wrong in the same way in every image (`routes._draw_camera_errors`),
so that they do not average out. The distance of a border has an error of that kind and one that is
new in every image.
"""

from typing import NamedTuple

import numpy as np

from soil_env._compiled.flags import compiled, record
from soil_env._compiled.random_streams import normal_pair
from soil_env.parameters import Scenario
from soil_env.parameters.readings import Image

from .routes import route_chosen

#: The camera of a `Scenario`.
CAMERA = record(
    "sight",  # [m] before a patch from which its routes are seen
    "border",  # [m] over which one patch passes into the next
    "border_noise",  # [m] 1-sigma of the place of a border, new in every image
    classes=("i8",),
    lines=("i8",),  # over a patch, at most; 0 without terrain classes: there is no image
)
#: An `Image`.
IMAGE = record(*Image._fields)


class Sight(NamedTuple):
    """Place of the wheel between two borders, as an image shows it."""

    patch: int  # that the wheel seems to be on
    since: float  # [m] from the beginning of it
    left: float  # [m] to its end


def camera_of(scenario: Scenario) -> np.ndarray:
    """Pack the camera of a scenario, `CAMERA` [1]; its `lines` are 0 where there are no terrain
    classes, and so no images.
    """
    course = scenario.course
    packed = np.zeros(1, CAMERA)
    camera = packed[0]
    camera.sight = scenario.camera.range
    camera.border = course.border
    camera.border_noise = scenario.camera.border_noise
    camera.classes = course.classes
    camera.lines = course.lines if course.classes else 0
    return packed


@compiled
def sight_of(wheel, course, camera):
    """Draw the `Sight` of a new image: on which patch the wheel seems to be, and how far from its
    ends.

    The place of the wheel has an error that is new in every image, from the wheel's random stream.
    Each border has an error that stays (`border_error`).
    """
    patches = course.patches
    forks = course.forks
    last = course.drawn - 1
    x = wheel.x + camera.border_noise * normal_pair(wheel)[0]
    p = wheel.patch
    while p < last and x >= patches[p + 1].start + forks[p + 1].border_error:
        p += 1
    while p > 0 and x < patches[p].start + forks[p].border_error:
        p -= 1
    end = patches[p].end
    if p < last:
        end += forks[p + 1].border_error
    return Sight(p, x - patches[p].start - forks[p].border_error, end - x)


@compiled
def patch_ahead(course, sight, camera):
    """Index of the patch after that of a `Sight`, if it is drawn and seems to begin within
    `camera.sight` of the wheel, else -1.
    """
    ahead = sight.patch + 1
    return ahead if ahead < course.drawn and sight.left <= camera.sight else -1


@compiled
def seen_grade(course, p, route):
    """Steepest grade [rad] of patch p as the camera sees it along a `route`, 0 or 1: the true one
    and the error of that route, which stays.
    """
    return course.forks[p].grade + course.routes[p, route].grade_error


@compiled
def take_image(image, wheel, course, sight, camera):
    """Fill the `IMAGE` of a wheel, which identifier and observation read.

    Without a patch ahead in sight, `seen` is 0 and what follows it is of patch 0 and means nothing.
    """
    ahead = patch_ahead(course, sight, camera)
    p = max(ahead, 0)
    image.patch = sight.patch
    image.since = sight.since
    image.left = sight.left
    image.here = course.routes[sight.patch, course.forks[sight.patch].taken].label
    image.seen = 1.0 if ahead >= 0 else 0.0
    image.chosen = 1.0 if route_chosen(wheel, course, p) else 0.0
    image.lines = course.forks[p].routes
    image.taken = course.forks[p].taken
    image.label_0 = course.routes[p, 0].label
    image.label_1 = course.routes[p, 1].label
    image.grade_0 = seen_grade(course, p, 0)
    image.grade_1 = seen_grade(course, p, 1)


@compiled
def write_view(out, image, chooses, camera):
    """Fill `out` with an `IMAGE`: distance of the border, class here, grade and class of each route
    ahead, and with two routes whether the action `chooses` one now. Return the number of entries.

    While no patch ahead is in sight, the distance is the range of the camera. Entries of routes
    that are out of sight or not there are 0. A class is a flag for each, 1 at the label that is
    seen.
    """
    classes = camera.classes
    seen = image.seen > 0.0
    out[0] = max(image.left, 0.0) if seen else camera.sight
    for c in range(classes):
        out[1 + c] = 1.0 if image.here == c else 0.0
    i = 1 + classes
    for k in range(camera.lines):
        there = seen and k < image.lines
        label = image.label_0 if k == 0 else image.label_1
        grade = image.grade_0 if k == 0 else image.grade_1
        out[i] = grade if there else 0.0
        for c in range(classes):
            out[i + 1 + c] = 1.0 if there and label == c else 0.0
        i += 1 + classes
    if camera.lines > 1:
        out[i] = 1.0 if chooses else 0.0
        i += 1
    return i
