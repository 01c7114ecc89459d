"""Ruts of a rover, left by the wheels ahead to those behind them (docs/physics/rover.md).

A wheel behind another runs on the floor of its rut: its sinkage is that below the floor, and its
contact begins there. Each wheel keeps its own rut, as a wheel by itself does, and meets it again
where the rover reverses; what wheels behind it have left it does not meet.
"""

import numpy as np
from numba import njit

from soil_env._compiled.flags import FINITE, record
from soil_env.simulation.world.terrain import between_cells

COMPACTION_OF_RUT = 5.0  # [-] factor on S behind a wheel that rolls

#: A cell of a course as one wheel of a rover meets it: a `terrain.RUT` with what the wheels ahead
#: have left.
ROVER_RUT = record(
    floor=("f4",),  # [m] depth of the rut of the wheels ahead, below the undisturbed surface
    factor=("f4",),  # [-] on the sinkage coefficient
    depth=("f4",),  # [m] of the wheel's own rut below the floor, 0 before its first pass
)


def new_ruts(rovers: int, axles: int, cells: int) -> np.ndarray:
    """Undisturbed ground, `ROVER_RUT` [rovers, axles, cells]."""
    ruts = np.zeros((rovers, axles, cells), ROVER_RUT)
    ruts["factor"] = 1.0
    return ruts


@njit(**FINITE)
def clear_ruts(cells):
    """Undisturbed ground for a wheel."""
    for i in range(cells.size):
        cells[i].factor = 1.0
        cells[i].depth = 0.0
        cells[i].floor = 0.0


@njit(**FINITE)
def floor_at(ruts, a, x):
    """Depth [m] at x [m] of the rut of the wheels ahead of axle a, linear between the middles of
    the cells.
    """
    i, way = between_cells(ruts.shape[1], x)
    here = ruts[a, i].floor
    return here + way * (ruts[a, i + 1].floor - here)


@njit(**FINITE)
def pass_on(ruts, a, cell, after):
    """Copy the rut of axle a to the axles behind it, in the cells from `cell` to before `after`;
    `ruts` [axles, cells].
    """
    while cell != after:
        left = ruts[a, cell]
        for behind in range(a + 1, len(ruts)):
            ruts[behind, cell].factor = left.factor
            ruts[behind, cell].floor = left.floor + left.depth
        cell += 1 if after > cell else -1
