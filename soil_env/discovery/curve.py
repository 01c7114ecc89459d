"""Generic curve of a channel y over slip i and load W: what anybody would draw through a table
without a law of soils.

    y = (W/W0)^p a + (W/W0)^q b [1 - exp(-|i| / (k (W/W0)^m))]        i >= 0

For i < 0 the second term has the opposite sign, and a b of its own if enough rows are braked. The
form is that of the shear curve of Janosi & Hanamoto (1961). W0 is the geometric mean of the loads.
The amplitudes a and b are linear, k is sought on a grid; where the loads differ, k, p, q and m are
fitted.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import gmean

from soil_env.terramechanics.steady import Rows

SLIP_SCALES = np.geomspace(0.03, 3.0, 25)  # [-] k that are tried
POWERS = np.array([1.0, 1.0, 0.0])  # p, q, m where the loads do not show them, and prior means
POWER_SD = 0.5  # prior sd of p, q and m
LEAST_SPAN = 0.25  # of ln W, from which the loads show the powers
BRAKED = -0.02  # [-] slip below which a row counts for `FEWEST_BRAKED`
FEWEST_BRAKED = 2  # braked rows, from which they have an amplitude of their own
BEYOND_SCALES = 2.0  # factor by which a fitted k may go beyond `SLIP_SCALES`; own choice
MOST_CALLS = 40  # of the curve in a fit; own choice


class Curve(NamedTuple):
    """Fitted curve of one channel."""

    load: float  # [N] W0
    scale: float  # [-] k
    powers: np.ndarray  # [3] p, q, m
    amplitudes: np.ndarray  # [2 or 3] a, b and, if `braked`, b of braked rows
    braked: bool  # braked rows have a b of their own

    def at(self, slip: np.ndarray, load: np.ndarray) -> np.ndarray:
        """[N] values of the channel, in its unit, at slips [N] and loads [N] in newtons."""
        x = np.log(load / self.load)
        return _basis(slip, x, self.scale, self.powers, self.braked) @ self.amplitudes


def _basis(
    slip: np.ndarray, x: np.ndarray, scale: float, powers: np.ndarray, braked: bool
) -> np.ndarray:
    """[N, 2 or 3] functions of slip and load that the `Curve.amplitudes` a and b multiply.

    `x` [N]: ln(W/W0); `scale`: k; `powers`: p, q, m. The function of b is odd in the slip, so
    negative on braked rows. If `braked`, these rows have a b of their own, in a third column.
    """
    grown = -np.expm1(-np.abs(slip) / (scale * np.exp(powers[2] * x)))
    side = np.exp(powers[1] * x) * grown
    level = np.exp(powers[0] * x)
    driven = side * (slip >= 0.0)
    dragged = -side * (slip < 0.0)
    return np.stack([level, driven, dragged] if braked else [level, driven + dragged], axis=1)


def fit_curve(slip: np.ndarray, load: np.ndarray, y: np.ndarray, sd: float) -> Curve:
    """The curve through values y [N] of a channel, each with the standard deviation `sd`, at slips
    [N] and loads [N] in newtons.

    k is the best of `SLIP_SCALES`, with the powers `POWERS`. Where ln W spans more than
    `LEAST_SPAN`, these are only the start: k and the powers are fitted, the powers with their
    priors. Braked rows have an amplitude of their own if there are `FEWEST_BRAKED`.
    """
    middle = gmean(load)
    x = np.log(load / middle)
    braked = int(np.sum(slip < BRAKED)) >= FEWEST_BRAKED

    def fitted(scale: float, powers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(least-squares amplitudes, (curve - y)/sd of each row) at a scale of the slip and these
        powers.
        """
        basis = _basis(slip, x, scale, powers, braked) / sd
        found = np.linalg.lstsq(basis, y / sd, rcond=1e-8)[0]
        return found, basis @ found - y / sd

    scale = min(SLIP_SCALES, key=lambda k: np.sum(fitted(k, POWERS)[1] ** 2))
    powers = POWERS
    if np.ptp(x) > LEAST_SPAN:
        # Unknowns: p, q, m, ln k.
        found = least_squares(
            lambda p: np.append(fitted(math.exp(p[3]), p[:3])[1], (p[:3] - POWERS) / POWER_SD),
            [*POWERS, math.log(scale)],
            bounds=(
                [-np.inf] * 3 + [math.log(SLIP_SCALES[0] / BEYOND_SCALES)],
                [np.inf] * 3 + [math.log(BEYOND_SCALES * SLIP_SCALES[-1])],
            ),
            max_nfev=MOST_CALLS,
        ).x
        powers = found[:3]
        scale = math.exp(found[3])
    return Curve(middle, float(scale), powers, fitted(scale, powers)[0], braked)


def at_curves(curves: list[Curve | None], rows: Rows) -> np.ndarray:
    """[N, 3] values [m, N, N m] of the curves, one for each channel, at rows; NaN for a channel
    without one.
    """
    nothing = np.full(rows.slip.size, np.nan)
    return np.stack(
        [nothing if curve is None else curve.at(rows.slip, rows.load) for curve in curves], axis=1
    )
