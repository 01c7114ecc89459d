"""Printed numbers of the source paper, its equations, and its Newton-Raphson method.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251; method: its Section 4. The stresses,
their integrals and the forces are the compiled functions of `soil_env.terramechanics`.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soil_env._io.loading import read_yaml
from soil_env._numba.compiling import compiled_part, compiled_root
from soil_env.slip import motion_from_slip
from soil_env.terramechanics.arc_integrals import arc_integrals, shear_modulus_rates, simpson_integrals
from soil_env.terramechanics.contact import compaction_resistance, entry_angle, forces as contact_forces, shear_forces

#: Wheel of Wong & Reece (1967), J. Terramechanics 4(1):81-98, from which the paper takes its wheel, sand and points:
#: radius 24.7 in [m], which the paper prints as 0.6274.
WONG_REECE_RADIUS = 24.7 * 0.0254
#: Angle of maximum stress on the compact sand of Wong & Reece (1967): theta_m = (c1 + c2 i) theta1; (c1, c2), as
#: transcribed with the other constants of that sand in J. Madsen's pyTerramechanics.
WONG_REECE_PEAK = (0.43, 0.32)


@dataclass(frozen=True)
class Sand:
    """Compact sand (Table 2), SI units."""

    friction_angle_deg: float
    cohesion: float
    shear_modulus: float
    k_c: float
    k_phi: float
    sinkage_exponent: float


def _printed() -> SimpleNamespace:
    """Numbers of printed.yaml by its keys; tables by the name of the parameter."""
    content = read_yaml(Path(__file__).with_name("printed.yaml"))
    for table in ("table1", "table3"):
        content[table] = {name: SimpleNamespace(**line) for name, line in content[table].items()}
    for group in ("wheel", "working_point"):
        content[group] = SimpleNamespace(**content[group])
    points = tuple(SimpleNamespace(**point) for point in content["measured"])
    return SimpleNamespace(**content | {"measured": points, "table2": Sand(**content["table2"])})


P = _printed()


class Equations(NamedTuple):
    """Equations and constants; the stress has its peak at (peak + peak_by_slip i) theta1."""

    radius: float  # [m]
    width: float  # [m]
    cohesion: float  # [Pa]
    exponent: float  # n [-]
    peak: float = 0.5  # Eq. (9) with theta2 = 0
    peak_by_slip: float = 0.0
    simpson: int = 2  # m of Eqs. (14)-(15); 0: Gauss-Legendre
    compaction: bool = True  # resistance by Eq. (12), else by Eq. (11)


AS_PRINTED = Equations(P.wheel.radius, P.wheel.width, P.table2.cohesion, P.table2.sinkage_exponent)
WONG_REECE = AS_PRINTED._replace(radius=WONG_REECE_RADIUS, peak=WONG_REECE_PEAK[0], peak_by_slip=WONG_REECE_PEAK[1])

_ITERATIONS = 100  # of Newton-Raphson at most
_TOLERANCE = 1e-8  # step at convergence: [rad] of phi, relative of K and S


class Linear(NamedTuple):
    """(pull, load, torque) and drawbar pull by phi, K and S."""

    pull: float
    load: float
    torque: float
    by_phi: float
    by_K: float
    by_S: float


@compiled_part
def at_point(x, slip, sinkage, e):
    """`Linear` at x = (phi [rad], K [m], S) for any phi, K > 0 and any S."""
    K, tan_phi, r = x[1], math.tan(x[0]), e.radius
    theta1 = entry_angle(sinkage, r)
    thetam = (e.peak + e.peak_by_slip * slip) * theta1
    rim, travel = motion_from_slip(slip)
    if e.simpson > 0:
        q, by_rim, by_travel = simpson_integrals(theta1, 0.0, thetam, rim, travel, K, e.exponent, r, e.simpson)
    else:
        q, by_rim, by_travel = arc_integrals(theta1, 0.0, thetam, rim, travel, K, e.exponent, r)
    k = shear_modulus_rates(by_rim, by_travel, rim, travel, K)
    f = contact_forces(q, x[2], tan_phi, e.cohesion, r, e.width, 1.0)
    by_phi = shear_forces(q, x[2] * (1.0 + tan_phi * tan_phi), 0.0, r, e.width, 1.0)
    by_K = shear_forces(k, x[2] * tan_phi, e.cohesion, r, e.width, 1.0)
    by_S = contact_forces(q, 1.0, tan_phi, 0.0, r, e.width, 1.0)
    more = 0.0  # resistance of Eq. (11) less that of Eq. (12), for S = 1
    if e.compaction:
        more = r * e.width * q.p_sin - compaction_resistance(sinkage, 1.0, e.exponent, e.width)
    return Linear(
        f.drawbar_pull + x[2] * more, f.load, f.torque, by_phi.drawbar_pull, by_K.drawbar_pull, by_S.drawbar_pull + more
    )


@compiled_root
def _forces(x, slip, sinkage, e, out):
    for p in range(x.shape[0]):
        y = at_point(x[p], slip[p], sinkage[p], e)
        out[p, 0], out[p, 1], out[p, 2] = y.pull, y.load, y.torque
        out[p, 3], out[p, 4], out[p, 5] = y.by_phi, y.by_K, y.by_S


def forces(soil: ArrayLike, slip: ArrayLike, sinkage: ArrayLike, e: Equations) -> np.ndarray:
    """DP [N], W [N], T [N m] and d(DP) by phi [rad], K and S, [M, 6], of soils (phi [deg], K [m], S), [3] or [M, 3]."""
    x = np.atleast_2d(np.asarray(soil, dtype=float)) * (math.pi / 180.0, 1.0, 1.0)
    count = max(np.size(slip), np.size(sinkage), len(x))
    out = np.empty((count, 6))
    columns = [np.array(np.broadcast_to(v, count), dtype=float) for v in (slip, sinkage)]
    _forces(np.array(np.broadcast_to(x, (count, 3))), *columns, e, out)
    return out


class Points(NamedTuple):
    """Slip, sinkage [m] and drawbar pull [N], [3] each."""

    slip: np.ndarray
    sinkage: np.ndarray
    pull: np.ndarray


#: The three measured points of Table 3.
MEASURED = Points(*np.array([(p.slip, p.sinkage, p.drawbar_pull) for p in P.measured]).T.copy())


@compiled_root(allocates=True)
def _newton_raphson(path, slip, sinkage, pull, e, tolerance):
    """Iterates from path[0] = (phi [rad], K, S) into `path`; their number, negative where it did not converge.

    It ends without convergence at a singular Jacobian, at K <= 0, where Eq. (10) means nothing, or with `path` full.
    """
    residual, jacobian = np.empty(3), np.empty((3, 3))
    for k in range(path.shape[0] - 1):
        for p in range(3):
            y = at_point(path[k], slip[p], sinkage[p], e)
            residual[p] = pull[p] - y.pull
            jacobian[p, 0], jacobian[p, 1], jacobian[p, 2] = y.by_phi, y.by_K, y.by_S
        determinant = np.linalg.det(jacobian)
        if not (np.isfinite(determinant) and determinant != 0.0):
            return -k - 1
        step = np.linalg.solve(jacobian, residual)
        path[k + 1] = path[k] + step
        if not np.all(np.isfinite(path[k + 1])) or path[k + 1, 1] <= 0.0:
            return -k - 1
        small = abs(step[0]) < tolerance and abs(step[1]) < tolerance * path[k + 1, 1]
        if small and abs(step[2]) < tolerance * abs(path[k + 1, 2]):
            return k + 1
    return -path.shape[0]


def newton_raphson(points: Points, guess: ArrayLike, e: Equations) -> np.ndarray:
    """Root (phi [deg], K [m], S) by plain Newton-Raphson from `guess`, the paper's Section 4; NaN if it is lost."""
    path = np.empty((_ITERATIONS + 1, 3))
    path[0] = math.radians(guess[0]), guess[1], guess[2]
    count = _newton_raphson(path, *points, e, _TOLERANCE)
    return path[count] * (180.0 / math.pi, 1.0, 1.0) if count > 0 else np.full(3, np.nan)
