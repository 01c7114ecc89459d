"""Ruts of a rover, left by the wheels ahead to those behind them (docs/physics/rover.md).

A wheel behind another runs on the floor of its rut: its sinkage is that below the floor, and its
contact begins there. Each wheel keeps its own rut, as a single wheel does, and meets it again
where the rover reverses. It does not meet the ruts of the wheels behind it.
"""

from soil_env._compiled.flags import compiled_finite
from soil_env.simulation.world.terrain import clear


@compiled_finite
def clear_ruts(cells):
    """Make all rut `cells` of a wheel undisturbed ground."""
    for i in range(cells.size):
        clear(cells[i])


@compiled_finite
def copy_rut_behind(ruts, a, cell, after):
    """Copy the rut of axle a to the axles behind it, in the cells from `cell` to before `after`, in
    either direction; `ruts` [axles, cells].

    Its bottom, `floor` + `depth` below the undisturbed surface, becomes the floor on which those
    wheels run. Its passes count for them, unless they have made more themselves.
    """
    while cell != after:
        left = ruts[a, cell]
        for behind in range(a + 1, len(ruts)):
            ruts[behind, cell].passes = max(ruts[behind, cell].passes, left.passes)
            ruts[behind, cell].floor = left.floor + left.depth
        cell += 1 if after > cell else -1
