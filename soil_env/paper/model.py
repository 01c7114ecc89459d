"""Printed numbers of the source paper, its equations, and its Newton-Raphson method.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251; method: its
Section 4.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soil_env._io.loading import read_yaml
from soil_env.slip import travel_speeds
from soil_env.terramechanics.contact import NODE_DEPTHS, NODE_WEIGHTS

#: Wheel of Wong & Reece (1967), J. Terramechanics 4(1):81-98, from which the paper takes its wheel,
#: sand and points: radius 24.7 in [m], which the paper prints as 0.6274.
WONG_REECE_RADIUS = 24.7 * 0.0254
#: Angle of maximum stress on the compact sand of Wong & Reece (1967): theta_m = (c1 + c2 i) theta1;
#: (c1, c2), as transcribed with the other constants of that sand in J. Madsen's pyTerramechanics.
WONG_REECE_PEAK = (0.43, 0.32)


@dataclass(frozen=True)
class Sand:
    """Compact sand (Table 2)."""

    friction_angle_deg: float  # phi
    cohesion: float  # c [Pa]
    shear_modulus: float  # K [m]
    k_c: float  # [N/m^(n+1)]
    k_phi: float  # [N/m^(n+2)]
    sinkage_exponent: float  # n [-]


def _printed() -> SimpleNamespace:
    """Numbers of printed.yaml as attributes by its keys; tables 1 and 3 are {parameter: line}."""
    content = read_yaml(Path(__file__).with_name("printed.yaml"))
    for table in ("table1", "table3"):
        content[table] = {name: SimpleNamespace(**line) for name, line in content[table].items()}
    for group in ("wheel", "working_point"):
        content[group] = SimpleNamespace(**content[group])
    return SimpleNamespace(**content | {"table2": Sand(**content["table2"])})


P = _printed()


class Equations(NamedTuple):
    """A reading of the paper's equations: wheel, c and n that are known, stress peak, integration.

    The stress has its peak at the angle (peak + peak_by_slip i) theta1.
    """

    radius: float  # [m]
    width: float  # [m]
    cohesion: float  # [Pa]
    exponent: float  # n [-]
    peak: float = 0.5  # Eq. (9) with theta2 = 0
    peak_by_slip: float = 0.0
    simpson: int = 2  # m of Eqs. (14)-(15); 0: Gauss-Legendre
    compaction: bool = True  # resistance by Eq. (12), else by Eq. (11)


AS_PRINTED = Equations(P.wheel.radius, P.wheel.width, P.table2.cohesion, P.table2.sinkage_exponent)
WONG_REECE = AS_PRINTED._replace(
    radius=WONG_REECE_RADIUS, peak=WONG_REECE_PEAK[0], peak_by_slip=WONG_REECE_PEAK[1]
)

_ITERATIONS = 100  # of Newton-Raphson at most
_TOLERANCE = 1e-8  # step at convergence: [rad] of phi, relative of K and S
_HALVINGS = 30  # of a step at most, with backtracking
_DEGREES = np.array([math.degrees(1.0), 1.0, 1.0])  # of the radians in a step of (phi, K, S)


def _nodes(m: int) -> tuple[np.ndarray, np.ndarray]:
    """(places in [0, 1], weights) of the nodes of a zone of the arc; a place is 0 at the entry or
    exit and 1 at the stress peak.

    By Simpson's rule with 2m subintervals, Eqs. (14)-(15); with m = 0 by Gauss-Legendre nodes, as
    in `contact`.
    """
    if m == 0:
        return NODE_DEPTHS, NODE_WEIGHTS
    weights = np.full(2 * m + 1, 2.0)
    weights[1::2] = 4.0
    weights[[0, -1]] = 1.0
    return np.linspace(0.0, 1.0, 2 * m + 1), weights / (6.0 * m)


def forces(soil: ArrayLike, slip: ArrayLike, sinkage: ArrayLike, e: Equations) -> np.ndarray:
    """DP [N], W [N], T [N m] and the derivatives of DP by phi [rad], K and S, [M, 6], by the
    equations `e`.

    `soil` is (phi [deg], K [m], S), [3] or [M, 3]; slip and sinkage [m] are numbers or [M]. Any phi
    and S, and K > 0, are admitted, as a search passes through them. Nodes at the same place of the
    front and the rear zone have one stress, Eq. (8).
    """
    phi, K, S = (np.atleast_2d(np.asarray(soil, float)) * (math.pi / 180.0, 1.0, 1.0)).T[:, :, None]
    slip, z = (np.atleast_1d(np.asarray(v, float))[:, None] for v in (slip, sinkage))
    r = e.radius
    b = e.width
    c = e.cohesion
    n = e.exponent
    tan_phi = np.tan(phi)
    place, weight = _nodes(e.simpson)
    theta1 = 2.0 * np.arcsin(np.sqrt(z / (2.0 * r)))
    rear = (e.peak + e.peak_by_slip * slip) * theta1  # length of the zone, theta2 = 0
    ahead = theta1 - (theta1 - rear) * place
    theta = np.concatenate([ahead, rear * place], axis=1)
    cos = np.cos(theta)
    sin = np.sin(theta)
    # Area of the rim that each node stands for [m2].
    w = r * b * np.concatenate([(theta1 - rear) * weight, rear * weight], axis=1)
    # Normal stress over S, Eqs. (7) and (8), and shear displacement [m].
    p = np.tile(np.maximum(r * (np.cos(ahead) - np.cos(theta1)), 0.0) ** n, (1, 2))
    j = r * (theta1 - theta - travel_speeds(1.0, slip) * (np.sin(theta1) - sin))
    # Shares of the shear strength that are not mobilised and mobilised, Eq. (10).
    left = np.exp(-np.abs(j) / K)
    share = np.copysign(1.0 - left, j)
    strength = c + S * p * tan_phi
    resistance = (w * p * sin).sum(axis=1)  # Eq. (11), for S = 1
    if e.compaction:
        resistance = b * z[:, 0] ** (n + 1.0) / (n + 1.0)  # Eq. (12)
    shear = strength * share
    # Of the shear stress by phi.
    by_phi = S * p * (1.0 + tan_phi * tan_phi) * share
    columns = (  # what is integrated, in the order of the result
        shear * cos,
        S * p * cos + shear * sin,
        r * shear,
        by_phi * cos,
        -strength * j * left / (K * K) * cos,
        p * tan_phi * share * cos,
    )
    out = np.stack([(w * f).sum(axis=1) for f in columns], axis=1)
    out[:, 0] -= S[:, 0] * resistance
    out[:, 5] -= resistance
    return out


class Points(NamedTuple):
    """Slip, sinkage [m] and drawbar pull [N], [3] each."""

    slip: np.ndarray
    sinkage: np.ndarray
    pull: np.ndarray


#: The three measured points of Table 3.
MEASURED = Points(
    *(np.array([p[name] for p in P.measured]) for name in ("slip", "sinkage", "drawbar_pull"))
)


def newton_raphson(
    points: Points, guess: ArrayLike, e: Equations, backtracking: bool = False
) -> np.ndarray:
    """Soils (phi [deg], K [m], S) whose pulls by `e` are the three of `points`, by Newton-Raphson,
    the paper's Section 4; NaN where a search is lost.

    `guess` is [3], or [G, 3] for G searches; the fields of `points` are [3], the same for all
    searches, or [G, 3]. A search is lost at a singular Jacobian, at K <= 0, where Eq. (10) means
    nothing, and after `_ITERATIONS`. With `backtracking` a step beyond `_TOLERANCE` is halved until
    it leads to positive parameters, phi < 90 deg, that fit better; a search that finds none is
    lost.
    """
    x = np.array(np.atleast_2d(guess), float)
    slip, sinkage, pull = (np.broadcast_to(v, x.shape) for v in points)
    out = np.full(x.shape, np.nan)
    going = np.arange(len(x))  # searches under way

    def misfit(who: np.ndarray, soil: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(Measured less predicted pulls [g, 3] in N, Jacobian [g, 3, 3] of the predicted pulls by
        (phi [rad], K, S)).

        `who` [g]: indices of the searches; `soil` [g, 3]: where they are, in the units of `guess`.
        """
        y = forces(np.repeat(soil, 3, axis=0), slip[who].ravel(), sinkage[who].ravel(), e)
        return pull[who] - y[:, 0].reshape(-1, 3), y[:, 3:].reshape(-1, 3, 3)

    with np.errstate(all="ignore"):
        for _ in range(_ITERATIONS):
            residual, jacobian = misfit(going, x[going])
            determinant = np.linalg.det(jacobian)
            solvable = np.isfinite(determinant) & (determinant != 0.0)
            going = going[solvable]
            residual = residual[solvable]
            step = np.linalg.solve(jacobian[solvable], residual[:, :, None])[:, :, 0]
            step *= _DEGREES  # phi was solved in radians
            # Of the searches under way, those whose step has not been accepted.
            worse = np.flatnonzero(~_small(step, x[going]) & backtracking)
            for _ in range(_HALVINGS):
                if not worse.size:
                    break
                soil = x[going[worse]] + step[worse]
                ahead = (misfit(going[worse], soil)[0] ** 2).sum(axis=1)
                better = ahead < (residual[worse] ** 2).sum(axis=1)
                better &= np.all(soil > 0.0, axis=1) & (soil[:, 0] < 90.0)
                worse = worse[~better]
                step[worse] *= 0.5
            step[worse] = np.nan
            x[going] += step
            valid = np.all(np.isfinite(x[going]), axis=1) & (x[going, 1] > 0.0)
            there = valid & _small(step, x[going])
            out[going[there]] = x[going[there]]
            going = going[valid & ~there]
    return out.reshape(np.shape(guess))


def _small(step: np.ndarray, x: np.ndarray) -> np.ndarray:
    """[G] True where a step of (phi [deg], K [m], S) [G, 3] from `x` [G, 3] is within `_TOLERANCE`.

    It is absolute, in radians, for phi, and relative for K and S.
    """
    size = np.abs(x)
    size[:, 0] = _DEGREES[0]
    return np.all(np.abs(step) < _TOLERANCE * size, axis=1)
