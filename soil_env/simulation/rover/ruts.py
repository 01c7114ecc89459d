"""Ruts of a rover, left by the wheels ahead to those behind them (docs/physics/rover.md).

A wheel behind another runs on the floor of its rut: its sinkage is that below the floor, and its
contact begins there. Each wheel keeps its own rut, as a wheel by itself does, and meets it again
where the rover reverses; what wheels behind it have left it does not meet.
"""

import numpy as np

from soil_env._compiled.flags import compiled_finite
from soil_env.simulation.world.terrain import RUT, between_cells, clear


def new_ruts(rovers: int, axles: int, cells: int) -> np.ndarray:
    """Undisturbed ground, `RUT` [rovers, axles, cells]."""
    return np.zeros((rovers, axles, cells), RUT)


@compiled_finite
def clear_ruts(cells):
    """Undisturbed ground for a wheel."""
    for i in range(cells.size):
        clear(cells[i])


@compiled_finite
def floor_at(ruts, a, x):
    """Depth [m] at x [m] of the rut of the wheels ahead of axle a, linear between the middles of
    the cells.
    """
    i, way = between_cells(ruts.shape[1], x)
    here = ruts[a, i].floor
    return here + way * (ruts[a, i + 1].floor - here)


@compiled_finite
def copy_rut_behind(ruts, a, cell, after):
    """Copy the rut of axle a to the axles behind it, in the cells from `cell` to before `after`;
    `ruts` [axles, cells].
    """
    while cell != after:
        left = ruts[a, cell]
        for behind in range(a + 1, len(ruts)):
            ruts[behind, cell].passes = max(ruts[behind, cell].passes, left.passes)
            ruts[behind, cell].floor = left.floor + left.depth
        cell += 1 if after > cell else -1
