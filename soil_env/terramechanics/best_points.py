"""Best working points of many wheels, for controllers and warnings."""

from __future__ import annotations

from numba import njit

from soil_env._numba.compiling import CACHE
from soil_env.parameters import SoilState
from soil_env.terramechanics.traversability import best_working_point


@njit(cache=CACHE, nogil=True)
def best_points(rows, soils, load, r, b, torque, slip, pull):
    """Write slip [-] and drawbar pull [N] of the best working point of the wheels `rows` into `slip` and `pull` [n].

    `soils` [n, 7] are rows of `SoilState`, `load` [n] in N; r, b [m] and the motor's torque [N m] are of all wheels.
    """
    for k in rows:
        s = soils[k]
        best = best_working_point(load[k], SoilState(s[0], s[1], s[2], s[3], s[4], s[5], s[6]), r, b, torque)
        slip[k], pull[k] = best.slip, best.drawbar_pull
