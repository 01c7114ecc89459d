"""The ground of a course: patches of soil with a grade each, smooth borders between them, and the rut of the wheel."""

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_inline
from soil_env.parameters import Scenario
from soil_env.terramechanics.ground import blend, row_soil, share_of_next

CELL = 0.05  # [m] length of one cell of the rut
CELLS_BEHIND = 10
BEHIND = CELLS_BEHIND * CELL  # [m] ground behind the start of a course that has cells of its own

# How a pass changes the ground, as a factor on the sinkage coefficient S of the cell. A rolling wheel compacts, a
# digging one loosens. The direction is that of multi-pass tests (Holm 1969, Proc. 3rd ISTVS Conf. II:1-12); the law
# is ours: factor = COMPACTION * (digging ratio)^-LOOSENING, bounded.
COMPACTION = 1.6
LOOSENING = 1.5
RUT_FACTOR_BOUNDS = (0.3, 3.0)


class Lines(NamedTuple):
    """The lines over the patches of courses with terrain classes, and what a camera sees of them; empty without.

    Line 0 leads straight ahead, line 1 beside it. Patches with one line have it twice.
    """

    count: np.ndarray  # [wheels, patches] lines over each patch
    classes: np.ndarray  # [wheels, patches, 2] number of the class of each line
    soils: np.ndarray  # [wheels, patches, 2, 7] `SoilState`
    grades: np.ndarray  # [wheels, patches, 2] [rad]
    capacities: np.ndarray  # [wheels, patches, 2] best steady drawbar pull [of weight]
    taken: np.ndarray  # [wheels, patches] the line whose soil and grade `Courses` has
    halts: (
        np.ndarray
    )  # [wheels, patches] place of the halt before a patch with two lines, from its beginning [m]
    labels: np.ndarray  # [wheels, patches, 2] the class that the camera sees
    grade_errors: np.ndarray  # [wheels, patches, 2] of the grade that it sees [rad]
    border_errors: np.ndarray  # [wheels, patches] of where it sees the beginning of a patch [m]
    library: np.ndarray  # [wheels, classes, 7] `SoilState` of the classes


def _new_lines(wheels: int, patches: int, classes: int) -> Lines:
    n = patches if classes else 0
    return Lines(
        np.ones((wheels, n), dtype=np.int64),
        np.zeros((wheels, n, 2), dtype=np.int64),
        np.zeros((wheels, n, 2, 7)),
        np.zeros((wheels, n, 2)),
        np.zeros((wheels, n, 2)),
        np.zeros((wheels, n), dtype=np.int64),
        np.zeros((wheels, n)),
        np.zeros((wheels, n, 2), dtype=np.int64),
        np.zeros((wheels, n, 2)),
        np.zeros((wheels, n)),
        np.zeros((wheels, classes, 7)),
    )


class Courses(NamedTuple):
    """The ground of many wheels: arrays with one row a wheel. x [m] is the distance along the course.

    Only the first `patches` patches of a course are drawn, and the cells below them cleared.
    """

    edges: np.ndarray  # [wheels, patches + 1] patch borders [m]; those not drawn are +inf
    soils: np.ndarray  # [wheels, patches, 7] `SoilState` of each patch
    grades: np.ndarray  # [wheels, patches] grade angle [rad], uphill positive
    margins: np.ndarray  # [wheels, patches] drawbar pull in reserve at best slip [of weight]
    patches: np.ndarray  # [wheels] patches drawn
    ready: (
        np.ndarray
    )  # [wheels] x [m] up to which the ground is final; +inf once the whole course is drawn
    streams: np.ndarray  # [wheels] uint64, from which the patches to come are drawn
    rut_factors: np.ndarray  # [wheels, cells] factor on S left by earlier passes [-]
    rut: (
        np.ndarray
    )  # [wheels, cells] depth of the rut below the undisturbed surface [m]; 0 before the first pass
    lines: Lines


def new_courses(wheels: int, scenario: Scenario) -> Courses:
    """Empty courses for `wheels` wheels."""
    spec = scenario.course
    patches = math.ceil(spec.length / spec.patch_length[0]) + 2
    cells = CELLS_BEHIND + math.ceil(spec.length / CELL) + 2
    return Courses(
        np.full((wheels, patches + 1), np.inf),
        np.zeros((wheels, patches, 7)),
        np.zeros((wheels, patches)),
        np.zeros((wheels, patches)),
        np.zeros(wheels, dtype=np.int64),
        np.full(wheels, np.inf),
        np.zeros(wheels, dtype=np.uint64),
        np.ones((wheels, cells), dtype=np.float32),
        np.zeros((wheels, cells), dtype=np.float32),
        _new_lines(wheels, patches, spec.classes),
    )


@compiled_inline
def ground_at(courses, k, x, patch, border):
    """(soil, grade [rad], patch) of course k at x [m], undisturbed; `patch` is a first guess of the patch index.

    Within `border` [m] around a patch border soil and grade pass smoothly from one patch to the next (`share_of_next`).
    """
    edges = courses.edges[k]
    last = courses.patches[k] - 1
    while patch < last and x >= edges[patch + 1]:
        patch += 1
    while patch > 0 and x < edges[patch]:
        patch -= 1
    near = (
        patch + 1 if x - edges[patch] > edges[patch + 1] - x else patch
    )  # index of the nearer border
    w, _ = share_of_next((x - edges[near]) / border)
    if near < 1 or near > last or w <= 0.0 or w >= 1.0:
        return row_soil(courses.soils[k, patch]), courses.grades[k, patch], patch
    soil = blend(row_soil(courses.soils[k, near - 1]), row_soil(courses.soils[k, near]), w)
    return soil, (1.0 - w) * courses.grades[k, near - 1] + w * courses.grades[k, near], patch


@compiled_inline
def cell_at(courses, x):
    """Index of the rut cell at x [m]; the first begins `BEHIND` metres before the start."""
    return min(max(int(math.floor(x / CELL)) + CELLS_BEHIND, 0), courses.rut_factors.shape[1] - 1)


@compiled_inline
def between_cells(values, k, x):
    """Value of the rut cells [wheels, cells] of wheel k at x [m], linear between the middles of the cells."""
    place = min(max(x / CELL + (CELLS_BEHIND - 0.5), 0.0), values.shape[1] - 1.0)
    cell = min(int(place), values.shape[1] - 2)
    here = values[k, cell]
    return here + (place - cell) * (values[k, cell + 1] - here)


@compiled_inline
def cell_after(courses, cell, x):
    """The cell of a wheel that comes from `cell` and is at x [m]: the next one begins for it in its middle.

    So a cell is passed once the wheel no longer stands on any of it (`between_cells`), and rocking over a border passes
    none.
    """
    place = x / CELL + (CELLS_BEHIND - 0.5)
    after = (
        math.floor(place)
        if place >= cell + 1.0
        else (math.ceil(place) if place <= cell - 1.0 else float(cell))
    )
    return int(min(max(after, 0.0), courses.rut_factors.shape[1] - 1.0))


@compiled_inline
def leave_rut(courses, k, cell, depth, dug, compaction):
    """Mark a cell as driven over: its rut, `depth` [m], and soil compacted by rolling or loosened by digging.

    `compaction`: the factor on S of a wheel that rolls without digging.
    """
    factor = courses.rut_factors[k, cell] * compaction * dug**-LOOSENING
    highest = max(RUT_FACTOR_BOUNDS[1], compaction)
    courses.rut_factors[k, cell] = min(max(factor, RUT_FACTOR_BOUNDS[0]), highest)
    courses.rut[k, cell] = max(courses.rut[k, cell], depth)
