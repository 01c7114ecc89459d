"""Ruts of a rover, left by the wheels ahead to those behind them (docs/physics/rover.md).

A wheel behind another runs on the floor of its rut: its sinkage is that below the floor, and its contact begins there.
Each wheel keeps its own rut, as a wheel by itself does, and meets it again where the rover reverses; what wheels behind
it have left it does not meet.
"""

from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_inline
from soil_env._numba.lanes import COUNT

COMPACTION_OF_RUT = 5.0  # factor on S behind a wheel that rolls


class Ruts(NamedTuple):
    """Cells of a course as each wheel meets them: as `Courses.rut_factors` and `Courses.rut`."""

    rut_factors: np.ndarray  # [wheels, cells] factor on S [-]
    rut: (
        np.ndarray
    )  # [wheels, cells] depth of the wheel's own rut below the floor [m]; 0 before its first pass
    floor: (
        np.ndarray
    )  # [wheels, cells] depth of the rut of the wheels ahead, below the undisturbed surface [m]


def new_ruts(wheels: int, cells: int) -> Ruts:
    """Undisturbed ground."""
    return Ruts(*(np.full((wheels, cells), value, dtype=np.float32) for value in (1.0, 0.0, 0.0)))


@compiled_inline
def clear_ruts(ruts, k):
    """Undisturbed ground for wheel k."""
    for cell in range(ruts.rut.shape[1]):
        ruts.rut_factors[k, cell] = 1.0
        ruts.rut[k, cell] = ruts.floor[k, cell] = 0.0


@compiled_inline
def pass_on(ruts, k, behind, cell, after):
    """Copy the rut of wheel k to the `behind` wheels that follow it, in the cells from `cell` to before `after`."""
    while cell != after:
        depth = ruts.floor[k, cell] + ruts.rut[k, cell]
        for n in range(1, behind + 1):
            ruts.rut_factors[k + n * COUNT, cell] = ruts.rut_factors[k, cell]
            ruts.floor[k + n * COUNT, cell] = depth
        cell += 1 if after > cell else -1
