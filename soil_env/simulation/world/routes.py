"""Terrain classes, and the routes between which a wheel may choose (docs/physics/wheel.md).

Two routes over a patch have soils of different classes and the same slopes, which are drawn without
looking at the soils: both routes may be passable, or one, or none. Arguments are named as in
`courses`; p is the index of a patch.
"""

from soil_env._compiled.flags import compiled, inlined
from soil_env._compiled.random_streams import normal_pair, uniform
from soil_env.terramechanics.ground import put_soil, soil_of

from .passability import capacity, draw_ground, scattered, within


@inlined
def draw_classes(course, load, numbers, nodes):
    """Draw the soils of all terrain classes of a course (`draw_ground`) into its `library`; False
    if one was not found. Without classes there is nothing to draw, and it is True. `load` [N] is
    the weight of the wheel on level ground, `numbers` the `CourseNumbers`, `nodes` scratch.
    """
    for c in range(numbers.drawn.spec.classes):
        found, soil = draw_ground(course, load, numbers, nodes)
        if not found:
            return False
        put_soil(course.library[c], soil)
    return True


@compiled
def _other_class(owner, classes, one):
    """Random class from 0 to `classes` - 1 but not `one`, all others equally likely, from the
    stream of `owner`. There are at least two classes.
    """
    other = int(uniform(owner) * (classes - 1))
    return other + 1 if other >= one else other


@inlined
def _unused_class(course, p, classes):
    """Random class, 0 to `classes` - 1, for a patch p < `classes`, from the stream of the course,
    among those that no earlier patch has (these have one route, route 0). Each of them is equally
    likely.
    """
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
    return 0  # not reached: a class is left


@compiled
def _draw_route(course, route, load, numbers, nodes):
    """Draw the soil of a `ROUTE`, about the soil of its class `terrain`, and compute its best pull
    `capacity` [of load] under a `load` [N]. The pull may be too little: no soil is drawn again.
    """
    spec = numbers.drawn.spec
    soil = scattered(soil_of(course.library[route.terrain]), spec.class_scatter, course, spec)
    put_soil(route, soil)
    route.capacity = capacity(load, soil, numbers, nodes)


@inlined
def draw_routes(course, load, numbers, nodes):
    """Draw the routes of the next patch of a course with terrain classes; the wheel heads for the
    first.

    The first patches have one route and show each class once. On later patches the class is random.
    With `lines` = 2 they have a second route, of another class. A patch with one route has it
    twice. The errors of the camera are drawn, too. Arguments as in `draw_classes`.
    """
    p = course.drawn
    spec = numbers.drawn.spec
    two = spec.lines > 1 and p >= spec.classes
    course.forks[p].routes = 2 if two else 1
    straight = course.routes[p, 0]
    beside = course.routes[p, 1]
    if p < spec.classes:
        straight.terrain = _unused_class(course, p, spec.classes)
    else:
        straight.terrain = int(uniform(course) * spec.classes)
    _draw_route(course, straight, load, numbers, nodes)
    if two:
        beside.terrain = _other_class(course, spec.classes, straight.terrain)
        _draw_route(course, beside, load, numbers, nodes)
    _draw_camera_errors(course, p, spec)
    if not two:
        course.routes[p, 1] = straight
    set_route(course, p, 0)


@inlined
def _draw_camera_errors(course, p, spec):
    """Draw the errors of the camera in patch p, and where the wheel is halted before it.

    Each route gets a `label`, that of another class with probability `label_error` if there are
    several classes, and a `grade_error` [rad]. The `FORK` gets a `border_error` [m] and `halt` [m],
    from the beginning of the patch and so below 0. A patch with one route draws for its second one
    too, which is overwritten later.
    """
    fork = course.forks[p]
    for i in range(2):
        route = course.routes[p, i]
        route.label = route.terrain
        if uniform(course) < spec.label_error and spec.classes > 1:
            route.label = _other_class(course, spec.classes, route.terrain)
    a, b = normal_pair(course)
    course.routes[p, 0].grade_error = spec.grade_noise * a
    course.routes[p, 1].grade_error = spec.grade_noise * b
    fork.border_error = spec.border_noise * normal_pair(course)[0]
    fork.halt = -within(course, spec.halt_before)


@compiled
def set_route(course, p, route):
    """Let the course lead along a `route` of patch p, 0 or 1: the patch gets its soil, the `FORK`
    notes it as `taken`.
    """
    course.forks[p].taken = route
    put_soil(course.patches[p], soil_of(course.routes[p, route]))


@compiled
def next_fork(wheel, course, border):
    """Index of the patch after the wheel's if it is drawn, has two routes, and the furthest point
    of the wheel is not yet on the border before it, else -1. That border is `border` [m] long, with
    its middle where the patch begins.
    """
    ahead = wheel.patch + 1
    if ahead >= course.drawn or course.forks[ahead].routes < 2:
        return -1
    return ahead if wheel.best_x < course.patches[ahead].start - 0.5 * border else -1


@compiled
def plan_halt(wheel, course, rig):
    """Move the next halt to the place of the halt before the next fork, if it would be later than
    that or less than `rig.halt_low` [m] before. Nothing happens where there is no next fork
    (`next_fork`), or where the wheel has been at that place.
    """
    fork = next_fork(wheel, course, rig.border)
    if fork >= 0:
        place = course.patches[fork].start + course.forks[fork].halt
        if wheel.best_x < place and wheel.next_halt > place - rig.halt_low:
            wheel.next_halt = place


@compiled
def choosing(wheel, course, view):
    """Index of the patch whose route the action chooses now: at a halt, the next fork if it is in
    sight. -1 if there is none.

    `view`: a record with `sight` and `border` [m], as a wheel's rig and a camera have.
    """
    if wheel.halt_left <= 0.0:
        return -1
    fork = next_fork(wheel, course, view.border)
    if fork < 0 or course.patches[fork].start - wheel.x > view.sight:
        return -1
    return fork


@compiled
def route_chosen(wheel, course, p):
    """True if the route over patch p counts as chosen: there is only one, or the wheel has reached
    the halt before the patch, at which the action chooses (`choosing`).
    """
    fork = course.forks[p]
    return fork.routes < 2 or wheel.best_x >= course.patches[p].start + fork.halt
