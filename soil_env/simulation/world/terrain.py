"""The ground of a course: patches of soil, a profile of grades, smooth passages, the rut."""

import math
from typing import Any

import numpy as np

from soil_env._compiled.cache import kept
from soil_env._compiled.elementary import smooth_step
from soil_env._compiled.flags import HUGE, compiled, record
from soil_env.parameters import MOST_CLASSES, Scenario, SoilState
from soil_env.terramechanics.ground import SOIL, blend, put_soil, soil_of

CELL = 0.05  # [m] length of one cell of the rut
CELLS_BEHIND = 10  # cells behind the start of a course
BEHIND = CELLS_BEHIND * CELL  # [m] ground behind the start that has cells of its own

#: A patch of a course, with the soil of the route that is taken over it.
PATCH = record(
    "start",  # [m] along the course; `HUGE` of patches that are not drawn yet
    "end",  # [m]
    *SoilState._fields,
)
#: A slope of the profile, whose ends have nothing to do with those of patches.
SLOPE = record(
    "start",  # [m] along the course; `HUGE` of slopes that are not drawn yet
    "end",  # [m]
    "grade",  # [rad] uphill positive
)
#: A cell of the rut as one wheel meets it; how passes change its soil: `effects.multipass`.
RUT = record(
    passes=("f4",),  # made over it, by this wheel and those ahead
    floor=("f4",),  # [m] depth of the rut of the wheels ahead, below the undisturbed surface
    depth=("f4",),  # [m] of the wheel's own rut below the floor, 0 before its first pass
)
#: One of two routes over a patch of a course with terrain classes. Route 0 leads straight ahead,
#: route 1 beside it on the same slopes.
ROUTE = record(
    # [rad] of the grade that a camera sees; before the soil: numba takes a record that begins like
    # a `SOIL` for one, and warns
    "grade_error",
    *SoilState._fields,
    "capacity",  # [of weight] best steady drawbar pull
    terrain=("i8",),  # number of its class
    label=("i8",),  # number of the class that a camera sees
)
#: What the routes over a patch share. A patch with one route has it twice.
FORK = record(
    "halt",  # [m] place of the halt from the beginning of a patch with two routes, so below 0
    "border_error",  # [m] of where a camera sees the beginning of the patch
    "grade",  # [rad] steepest slope on the patch
    routes=("i8",),
    taken=("i8",),  # route whose soil the `PATCH` has
)


LEAST_PATCHES = 64  # [-] patches, and as many slopes, that any course has room for
LEAST_CELLS = 2048  # [-] that any course has room for: 100 m, enough for each shipped scenario


def course_dtype(patches: int, slopes: int, cells: int) -> np.dtype[Any]:
    """Dtype of a course with room for at least these numbers of patches, slopes and cells.

    Of a course only the first `drawn` patches and the slopes over them are drawn, and only the
    cells below them are cleared. Room is a power of two, so that there are few dtypes: functions
    are compiled anew for each.
    """
    patches = _room(patches, LEAST_PATCHES)
    slopes = _room(slopes, LEAST_PATCHES)
    cells = _room(cells, LEAST_CELLS)
    return record(
        "ready",  # [m] place up to which the ground is final; `HUGE` once the whole course is drawn
        forks=(FORK, patches),
        routes=(ROUTE, (patches, 2)),  # only drawn with terrain classes
        library=(SOIL, MOST_CLASSES),  # soils of the classes
        drawn=("i8",),
        sloped=("i8",),  # slopes drawn
        stream=("u8",),  # from which the patches and slopes to come are drawn
        patches=(PATCH, patches),
        slopes=(SLOPE, slopes),
        cells=(RUT, cells),
    )


def _room(count: int, least: int) -> int:
    """Return the least power of two that is at least `count` and `least`."""
    return 1 << (max(count, least) - 1).bit_length()


def new_courses(wheels: int, scenario: Scenario) -> np.ndarray:
    """Courses without drawn ground, `course_dtype` [wheels], with room for the most patches and
    slopes that the scenario can draw.

    The last patch may begin just before the end, and slopes are drawn to the end of that patch.
    """
    spec = scenario.course
    # the shortest pieces, and two to spare, since their ends are sums that may be rounded down
    patches = math.ceil(spec.length / spec.patch_length[0]) + 2
    longest = spec.length + spec.patch_length[1]
    slopes = math.ceil(longest / spec.slope_length[0]) + 2
    # two more: the one at the end itself, and one beyond, since `pass_at` reads it
    cells = CELLS_BEHIND + math.ceil(spec.length / CELL) + 2
    courses = np.zeros(wheels, course_dtype(patches, slopes, cells))
    courses["ready"] = HUGE  # so that no ground is asked for before the first restart
    for pieces in ("patches", "slopes"):
        courses[pieces]["start"] = HUGE
        courses[pieces]["end"] = HUGE
    courses["forks"]["routes"] = 1
    return courses


@compiled
def piece_at(pieces, x, piece):
    """Index of the patch or slope at x [m], sought from the index `piece`; those not drawn begin at
    `HUGE`. Before the first one it is 0, beyond the last drawn one that one.
    """
    # by its own end first: the next one, which begins there, is seldom in the processor's cache
    while x >= pieces[piece].end and piece + 1 < pieces.size and pieces[piece + 1].start < HUGE:
        piece += 1
    while piece > 0 and x < pieces[piece].start:
        piece -= 1
    return piece


@compiled
def border_near(pieces, x, piece, border):
    """(index of a patch or slope, share of the one after it) at x [m], which is on `piece`.

    Within half of `border` [m] on either side of the end of a piece the index is that of this
    piece, and the share rises smoothly from 0 to 1. Elsewhere, and at both ends of the drawn
    ground, the index is `piece` and the share 0.
    """
    here = pieces[piece]
    at_end = x - here.start > here.end - x
    first = piece if at_end else piece - 1
    place = here.end if at_end else here.start
    t = (x - place) / border + 0.5
    if t <= 0.0 or t >= 1.0 or first < 0 or first + 1 >= pieces.size:
        return piece, 0.0
    if pieces[first + 1].start == HUGE:
        return piece, 0.0
    return first, smooth_step(t)[0]


@compiled
def soil_on(patches, x, patch, border):
    """`SoilState` of undisturbed ground at x [m], which is on `patch` (`piece_at`).

    Over a length of `border` [m], half of it on each side of the end of a patch, its soil passes
    smoothly into that of the next.
    """
    first, share = border_near(patches, x, patch, border)
    if share == 0.0:
        return soil_of(patches[first])
    return blend(patches[first], patches[first + 1], share)


@compiled
def grade_on(slopes, x, slope, border):
    """Grade [rad] of undisturbed ground at x [m], which is on `slope`.

    Over a length of `border` [m], half of it on each side of the end of a slope, it passes smoothly
    into the next grade.
    """
    first, share = border_near(slopes, x, slope, border)
    grade = slopes[first].grade
    if share == 0.0:
        return grade
    return (1.0 - share) * grade + share * slopes[first + 1].grade


@compiled
def find_ground(wheel, course, x, border):
    """(`SoilState`, grade [rad]) of the undisturbed ground at x [m] of a course; `border` [m] as in
    `soil_on`. `wheel.patch` and `wheel.slope`, near which it is sought, become the indices there.
    """
    wheel.patch = piece_at(course.patches, x, wheel.patch)
    wheel.slope = piece_at(course.slopes, x, wheel.slope)
    soil = soil_on(course.patches, x, wheel.patch, border)
    return soil, grade_on(course.slopes, x, wheel.slope, border)


@compiled
def cell_at(cells, x):
    """Index of the rut cell at x [m]; the first begins `BEHIND` metres before the start.

    Places before it belong to it, places beyond the last cell to the last.
    """
    return min(max(math.floor(x / CELL) + CELLS_BEHIND, 0), cells.size - 1)


@compiled
def place_in_cells(x):
    """Place x [m] counted in cells, a number with fractions, 0 in the middle of the first one."""
    return x / CELL + (CELLS_BEHIND - 0.5)


@compiled
def between_cells(count, x):
    """(index of a cell, share of the way from its middle to the middle of the next) at x [m].

    x is cut to the middles of the first and the last of `count` cells; the index is that of the
    last but one at most.
    """
    place = min(max(place_in_cells(x), 0.0), count - 1.0)
    i = min(int(place), count - 2)
    return i, place - i


@compiled
def pass_at(cells, x):
    """Number of the pass over x [m], 1 on fresh soil; linear between the middles of the cells."""
    i, way = between_cells(cells.size, x)
    here = cells[i].passes
    return 1.0 + here + way * (cells[i + 1].passes - here)


@compiled
def rut_at(cells, x):
    """(depth of the ruts of the wheels ahead, depth of the own rut below that) [m] at x [m].

    Both are linear between the middles of the cells, and 0 a cell or more from the middle of any
    cell with a rut.
    """
    i, way = between_cells(cells.size, x)
    here = cells[i]
    after = cells[i + 1]
    floor = here.floor + way * (after.floor - here.floor)
    return floor, here.depth + way * (after.depth - here.depth)


@compiled
def clear(cell):
    """Make a cell of the rut (`RUT`) undisturbed ground: no passes, no floor, no depth."""
    cell.passes = 0.0
    cell.floor = 0.0
    cell.depth = 0.0


@compiled
def in_cell(cell, x):
    """True if a wheel that comes from `cell` counts as still in it at x [m]: until it reaches the
    middle of a neighbour. So rocking over the border of two cells passes neither.
    """
    return cell - 1.0 < place_in_cells(x) < cell + 1.0


@compiled
def cell_after(count, cell, x):
    """Index of the last cell whose middle a wheel has reached on its way from `cell` to x [m];
    `cell` if it has reached none. There are `count` cells.
    """
    if in_cell(cell, x):
        return cell
    place = place_in_cells(x)
    after = math.floor(place) if place >= cell + 1.0 else math.ceil(place)
    return int(min(max(after, 0.0), count - 1.0))


@compiled
def leave_rut(cell, depth):
    """Mark a cell as driven over once more, with a rut at least `depth` [m] below its floor."""
    cell.passes += 1.0
    cell.depth = max(cell.depth, depth)


#: Undisturbed ground at one place; its grade [rad] first, as in a `ROUTE`.
PLACE = record("grade", *SoilState._fields, patch=("i8",))


@kept
def _sample(courses, k, x, border, places):
    """Fill `places` (`PLACE` [n]) with patch, soil and grade of the undisturbed ground of course k
    at x [n], in m; `border` [m] as in `soil_on`.
    """
    course = courses[k]
    for i in range(x.size):
        place = places[i]
        place.patch = piece_at(course.patches, x[i], 0)
        put_soil(place, soil_on(course.patches, x[i], place.patch, border))
        place.grade = grade_on(course.slopes, x[i], piece_at(course.slopes, x[i], 0), border)


def places_on(courses: np.ndarray, k: int, x: np.ndarray, border: float) -> np.ndarray:
    """Undisturbed ground, `PLACE` [n], of course k at x [n]; `border` [m] as in `soil_on`."""
    places = np.zeros(len(x), PLACE)
    _sample(courses, k, np.ascontiguousarray(x, dtype=float), float(border), places)
    return places


def soil_at(courses: np.ndarray, k: int, x: float, border: float) -> SoilState:
    """Undisturbed soil of course k at x [m]; `border` [m] as in `soil_on`."""
    place = places_on(courses, k, np.array([x]), border)[0]
    return SoilState(*(float(place[name]) for name in SoilState._fields))
