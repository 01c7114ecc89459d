"""Terrain classes, and the routes between which a wheel may choose (docs/physics/wheel.md).

Two routes over a patch have soils of different classes and the same slopes, which are drawn without
looking at the soils: both routes may be passable, or one, or none.
"""

from soil_env._compiled.flags import compiled, inlined
from soil_env._compiled.random_streams import normal_pair, uniform
from soil_env.terramechanics.ground import put_soil, soil_of

from .passability import capacity, draw_ground, scattered, within


@inlined
def draw_classes(course, load, numbers, nodes):
    """Draw the soils of the classes of a course; False if one was not found."""
    for c in range(numbers.drawn.spec.classes):
        if not draw_ground(course.library[c], course, load, numbers, nodes):
            return False
    return True


@compiled
def _another(owner, classes, one):
    """A class other than `one`."""
    other = int(uniform(owner) * (classes - 1))
    return other + 1 if other >= one else other


@inlined
def _introduced(course, p, classes):
    """Class of a patch p < classes: one that no patch before it is of, by chance."""
    left = classes - p
    pick = int(uniform(course) * left)
    for c in range(classes):
        new = True
        for q in range(p):
            new = new and course.routes[q, 0].terrain != c
        if new:
            if pick == 0:
                return c
            pick -= 1
    return 0


@compiled
def _draw_route(course, route, load, numbers, nodes):
    """Draw the soil of a `ROUTE` of a known class."""
    spec = numbers.drawn.spec
    mean = soil_of(course.library[route.terrain])
    soil = scattered(mean, spec.class_scatter, course, spec)
    put_soil(route, soil)
    route.capacity = capacity(load, soil, numbers, nodes)


@inlined
def draw_routes(course, load, numbers, nodes):
    """Draw the routes of the next patch of a course with terrain classes."""
    p = course.drawn
    spec = numbers.drawn.spec
    two = spec.lines > 1 and p >= spec.classes
    course.forks[p].routes = 2 if two else 1
    straight = course.routes[p, 0]
    beside = course.routes[p, 1]
    if p < spec.classes:
        straight.terrain = _introduced(course, p, spec.classes)
    else:
        straight.terrain = int(uniform(course) * spec.classes)
    _draw_route(course, straight, load, numbers, nodes)
    if two:
        beside.terrain = _another(course, spec.classes, straight.terrain)
        _draw_route(course, beside, load, numbers, nodes)
    _draw_camera_errors(course, p, spec)
    if not two:
        course.routes[p, 1] = straight
    set_route(course, p, 0)


@inlined
def _draw_camera_errors(course, p, spec):
    """Draw the errors of the camera in patch p, and how far before it the wheel is halted."""
    fork = course.forks[p]
    for i in range(2):
        route = course.routes[p, i]
        route.label = route.terrain
        if uniform(course) < spec.label_error and spec.classes > 1:
            route.label = _another(course, spec.classes, route.terrain)
    a, b = normal_pair(course)
    course.routes[p, 0].grade_error = spec.grade_noise * a
    course.routes[p, 1].grade_error = spec.grade_noise * b
    a, b = normal_pair(course)
    fork.border_error = spec.border_noise * a
    fork.halt = -within(course, spec.halt_before)


@compiled
def set_route(course, p, route):
    """Let the course lead along a route of patch p."""
    taken = course.routes[p, route]
    course.forks[p].taken = route
    put_soil(course.patches[p], taken)


@compiled
def next_fork(wheel, course, border):
    """The patch with two routes that a wheel comes to next and has not touched yet, or -1."""
    ahead = wheel.patch + 1
    if ahead >= course.drawn or course.forks[ahead].routes < 2:
        return -1
    return ahead if wheel.best_x < course.patches[ahead].start - 0.5 * border else -1


@compiled
def plan_halt(wheel, course, rig):
    """Let a wheel halt before the next fork; a halt shortly before that one waits for it."""
    fork = next_fork(wheel, course, rig.border)
    if fork >= 0:
        place = course.patches[fork].start + course.forks[fork].halt
        if wheel.best_x < place and wheel.next_halt > place - rig.halt_low:
            wheel.next_halt = place


@compiled
def choosing(wheel, course, view):
    """The patch whose route the action chooses now, or -1: at a halt with a fork in sight.

    `view`: a record with `sight` and `border` [m], as those of a wheel's rig and of a camera.
    """
    if wheel.halt_left <= 0.0:
        return -1
    fork = next_fork(wheel, course, view.border)
    if fork < 0 or course.patches[fork].start - wheel.x > view.sight:
        return -1
    return fork


@compiled
def settled(wheel, course, p):
    """True if a wheel has no choice over patch p: one route, or it has come to the halt."""
    fork = course.forks[p]
    return fork.routes < 2 or wheel.best_x >= course.patches[p].start + fork.halt
