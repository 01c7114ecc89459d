"""Three-point identification kept within bounds, beside the paper's plain Newton-Raphson."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from soil_env.paper.model import Equations, Points, forces

#: Bounds of (phi [rad], ln K, ln S): the box of the paper's Table 4, widened.
LOWER = np.array([math.radians(1.0), math.log(2e-4), math.log(1e3)])
UPPER = np.array([math.radians(89.5), math.log(0.3), math.log(1e13)])
_TOLERANCE = 1e-12


def safeguarded(points: Points, guess: ArrayLike, e: Equations) -> np.ndarray:
    """(phi [deg], K [m], S) of the three points by a trust-region method in (phi, ln K, ln S), within the bounds."""
    size = float(np.max(np.abs(points.pull)))

    def soil(x: np.ndarray) -> tuple[float, float, float]:
        return math.degrees(x[0]), math.exp(x[1]), math.exp(x[2])

    def residual(x: np.ndarray) -> np.ndarray:
        return (forces(soil(x), points.slip, points.sinkage, e)[:, 0] - points.pull) / size

    def jacobian(x: np.ndarray) -> np.ndarray:
        _, K, S = soil(x)
        return forces(soil(x), points.slip, points.sinkage, e)[:, 3:] * (1.0, K, S) / size

    start = np.clip([math.radians(guess[0]), math.log(guess[1]), math.log(guess[2])], LOWER + 1e-9, UPPER - 1e-9)
    found = least_squares(
        residual, start, jacobian, bounds=(LOWER, UPPER), xtol=_TOLERANCE, ftol=_TOLERANCE, gtol=_TOLERANCE,
        max_nfev=500,
    )  # fmt: skip
    return np.array(soil(found.x))
