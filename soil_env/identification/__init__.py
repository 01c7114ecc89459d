"""Identification of friction angle phi, shear deformation modulus K and sinkage coefficient S from wheel measurements.

The unknowns are x = (phi, ln K, ln S); cohesion, sinkage exponent and the law of slip-sinkage are held at the values
of a belief. A measured point is (slip, sinkage) with drawbar pull, load and torque; what was not measured has no
weight.

* `newton_raphson`: three points, drawbar pull alone, the method of the source paper (its Section 4).
* `generalized_newton_raphson`: any number of points and channels, weighted: Gauss-Newton.

Both are one safeguarded iteration on analytic derivatives (`solve`): a step that would leave the bounds or that does
not reduce the weighted residual is shortened, and damped after Levenberg & Marquardt. The outcome is data,
`Estimate`. The online identifier (`online.py`) calls the same compiled `solve`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soil_env._numba.rows import Rows
from soil_env.identification.point import Points, Reading, predict, weigh_all
from soil_env.identification.solver import (
    LOWER,
    UPPER,
    Status,
    normal_equations,
    solve,
)
from soil_env.identification.uniqueness import other_soil
from soil_env.parameters import Soil

__all__ = [
    "LOWER",
    "UPPER",
    "Estimate",
    "Points",
    "Reading",
    "Status",
    "generalized_newton_raphson",
    "newton_raphson",
    "predict",
    "solve",
]

CHANNELS = ("drawbar_pull", "load", "torque")
_REWEIGHTINGS = 5
_NO_PRIOR = np.zeros(3)


@dataclass(frozen=True)
class Estimate:
    """An identified soil, or why there is none."""

    soil: Soil | None  # None only for NO_DATA
    covariance: np.ndarray  # [3, 3] of (phi [rad], ln K, ln S); zeros if the points do not determine them
    status: Status
    iterations: int
    residual: float  # root of the mean squared whitened residual [-]
    condition: float  # condition number of the whitened Jacobian by (phi, ln K, ln S)
    other: Soil | None = None  # with AMBIGUOUS: another soil that explains the points exactly

    @property
    def converged(self) -> bool:
        """Whether `soil` explains the points best, be it alone (CONVERGED) or not (AMBIGUOUS)."""
        return self.status in (Status.CONVERGED, Status.AMBIGUOUS)


def _check_reading(reading: Reading) -> None:
    for name, least in (("cohesion", 0.0), ("exponent", 0.0), ("simpson", 0)):
        if not least <= getattr(reading, name) < math.inf:
            raise ValueError(f"reading.{name} = {getattr(reading, name)}: expected a number >= 0")
    for name in ("radius", "width"):
        if not 0.0 < getattr(reading, name) < math.inf:
            raise ValueError(f"reading.{name} = {getattr(reading, name)}: expected metres > 0")


def _points(
    slip: ArrayLike,
    sinkage: ArrayLike,
    channels: tuple[ArrayLike | None, ...],
    dig_ratio: ArrayLike | None,
    reading: Reading,
) -> Rows:
    """Checked `Points` without weights; ValueError for a reading or arrays that make no sense."""
    _check_reading(reading)
    slip = np.asarray(slip, dtype=float)
    ones = np.ones_like(slip)
    columns = {
        "slip": slip,
        "sinkage": np.asarray(sinkage, dtype=float),
        "dig_ratio": ones if dig_ratio is None else np.asarray(dig_ratio, dtype=float),
    }
    for name, channel in zip(CHANNELS, channels, strict=True):
        columns[name] = 0.0 * ones if channel is None else np.asarray(channel, dtype=float)
    for name, column in columns.items():
        if column.shape != slip.shape or column.ndim != 1:
            raise ValueError(f"{name}: expected {slip.shape[0] if slip.ndim else 1} values, got shape {column.shape}")
        if not np.all(np.isfinite(column)):
            row = int(np.flatnonzero(~np.isfinite(column))[0])
            raise ValueError(f"{name}: expected finite values, got {column[row]} in row {row}")
    if np.any(np.abs(slip) > 1.0):
        raise ValueError(f"slip = {slip[np.abs(slip) > 1.0][0]:g}: expected values in [-1, 1]")
    if np.any(columns["dig_ratio"] <= 0.0):
        bad = columns["dig_ratio"][columns["dig_ratio"] <= 0.0][0]
        raise ValueError(f"dig_ratio = {bad:g}: expected values > 0")
    if np.any(columns["sinkage"] <= 0.0) or np.any(columns["sinkage"] > reading.radius):
        raise ValueError(f"sinkage: expected values in (0, {reading.radius:g}] m, the radius of the wheel")
    if all(c is None for c in channels):
        raise ValueError(f"expected at least one of {', '.join(CHANNELS)}")
    points = Points(slip.size)
    for name, column in columns.items():
        points[name] = column
    return points


def generalized_newton_raphson(
    slip: ArrayLike,
    sinkage: ArrayLike,
    drawbar_pull: ArrayLike | None = None,
    load: ArrayLike | None = None,
    torque: ArrayLike | None = None,
    *,
    reading: Reading,
    guess: Soil,
    sd: tuple[float, float, float] = (1.0, 1.0, 1.0),
    slip_sd: float = 0.0,
    sinkage_sd: float = 0.0,
    dig_ratio: ArrayLike | None = None,
    max_iterations: int = 100,
    tolerance: float = 1e-8,
    restarts: bool = True,
) -> Estimate:
    """Identify (phi, K, S) from M points by weighted least squares; no prior.

    Parameters: `slip` [M] in [-1, 1]; `sinkage` [M] m; at least one of `drawbar_pull` [M] N, `load` [M] N and `torque`
    [M] N m, with their standard deviations in `sd`; `guess`, a soil to start from (its S must be lumped);
    `dig_ratio` [M], see `predict`, 1 if left out.

    With `slip_sd` [-] and `sinkage_sd` [m], the noise of slip and sinkage enters the weights by its first-order
    effect on the channels (`point.weigh`), renewed at the solution until it no longer changes. With `restarts`, a
    solve that ends with a misfit beyond the noise starts again from soils spread over the bounds, and the best end is
    taken. Three measured values can have several exact solutions within the bounds; the status is then AMBIGUOUS, and
    a second one is in `other`.

    Raises ValueError for arrays that do not match or are not finite. Source: Hutangkabodee et al. (2006), Section 4.
    """
    channels = (drawbar_pull, load, torque)
    points = _points(slip, sinkage, channels, dig_ratio, reading)
    if not all(s > 0.0 for s in sd):
        raise ValueError(f"sd = {sd}: expected positive standard deviations")
    if not (slip_sd >= 0.0 and sinkage_sd >= 0.0):
        raise ValueError(f"slip_sd = {slip_sd}, sinkage_sd = {sinkage_sd}: expected standard deviations >= 0")
    measured = len(points) * sum(c is not None for c in channels)
    if measured < 3:
        return Estimate(None, np.zeros((3, 3)), Status.NO_DATA, 0, math.nan, math.inf)
    variances = np.array([math.inf if c is None else s * s for c, s in zip(channels, sd, strict=True)])
    start = [
        math.radians(guess.friction_angle_deg),
        math.log(guess.shear_modulus),
        math.log(guess.lumped(reading.width)),
    ]
    run = partial(_run, points=points, variances=variances, reading=reading, tolerance=tolerance)
    found = run(np.clip(start, LOWER, UPPER), limit=max_iterations)
    if slip_sd > 0.0 or sinkage_sd > 0.0:
        for _ in range(_REWEIGHTINGS):
            before, found = found, run(found.x, slip_sd, sinkage_sd, limit=max_iterations, spent=found.iterations)
            if np.max(np.abs(found.x - before.x)) < 1e-4:
                break
    elif restarts:
        found = _restarted(found, _misfit_allowed(measured), partial(run, limit=min(max_iterations, 40)))
    return _estimate(found, points, measured, reading)


def _estimate(found: _Found, points: Rows, measured: int, reading: Reading) -> Estimate:
    """`Estimate` at the end of an iteration."""
    cost, matrix, _ = normal_equations(found.x, points, _NO_PRIOR, _NO_PRIOR, reading)
    eigenvalues = np.linalg.eigvalsh(matrix)
    singular = not np.linalg.det(matrix) > 1e-14 * np.prod(np.diagonal(matrix))
    covariance = np.zeros((3, 3)) if singular else np.linalg.inv(matrix)
    condition = math.sqrt(eigenvalues[-1] / eigenvalues[0]) if eigenvalues[0] > 0.0 else math.inf
    status, second, other = found.status, np.empty(3), None
    if measured == 3 and status == Status.CONVERGED and other_soil(found.x, points, reading, second):
        status, other = Status.AMBIGUOUS, _soil(second, reading)
    residual = math.sqrt(cost / measured)
    soil = _soil(found.x, reading)
    return Estimate(soil, covariance, Status(status), found.iterations, residual, condition, other)


class _Found(NamedTuple):
    """The end of an iteration."""

    x: np.ndarray  # [3] phi [rad], ln K, ln S
    status: int
    iterations: int
    cost: float


def _run(
    x: np.ndarray,
    slip_sd: float = 0.0,
    sinkage_sd: float = 0.0,
    *,
    points: Rows,
    variances: np.ndarray,
    reading: Reading,
    tolerance: float,
    limit: int,
    spent: int = 0,
) -> _Found:
    """Least squares from x, with the weights that the noise of slip and sinkage gives the points there."""
    x = x.copy()
    weigh_all(points, len(points), x, variances, slip_sd, sinkage_sd, reading)
    covariance = np.empty((3, 3))
    status, iterations, cost = solve(x, points, _NO_PRIOR, _NO_PRIOR, reading, limit, tolerance, covariance)
    return _Found(x, status, spent + iterations, cost)


def _restarted(found: _Found, allowed: float, run: Callable[..., _Found]) -> _Found:
    """`found`, or the best end of further starts until one has a misfit that noise allows."""
    iterations = found.iterations
    for start in _spread_starts():
        if found.status == Status.CONVERGED and found.cost <= allowed:
            break
        other = run(start)
        iterations += other.iterations
        better = other.cost < found.cost or found.status != Status.CONVERGED
        if other.status == Status.CONVERGED and better:
            found = other
    return found._replace(iterations=iterations)


def _soil(x: np.ndarray, reading: Reading) -> Soil:
    return Soil(
        friction_angle_deg=math.degrees(x[0]),
        cohesion=reading.cohesion,
        shear_modulus=math.exp(x[1]),
        sinkage_exponent=reading.exponent,
        sinkage_coefficient=math.exp(x[2]),
    )


def _misfit_allowed(measured: int) -> float:
    """Chi-squared that noise alone hardly ever exceeds with `measured` values and three unknowns (Wilson &
    Hilferty)."""
    freedom = max(measured - 3, 1)
    return freedom * (1.0 - 2.0 / (9.0 * freedom) + 4.0 * math.sqrt(2.0 / (9.0 * freedom))) ** 3


def _spread_starts() -> Iterator[np.ndarray]:
    """Unknowns to start again from: common soils, soft to stiff."""
    for phi in (0.3, 0.6, 0.9):
        for K in (0.005, 0.03):
            for S in (1e5, 1e6, 1e7):
                yield np.array([phi, math.log(K), math.log(S)])


def newton_raphson(
    slip: ArrayLike, sinkage: ArrayLike, drawbar_pull: ArrayLike, *, reading: Reading, guess: Soil, **options: Any
) -> Estimate:
    """Identify (phi, K, S) from exactly three points of slip, sinkage [m] and drawbar pull [N], as the paper does.

    With as many equations as unknowns the Gauss-Newton step is Newton's, so this is `generalized_newton_raphson` for a
    square system. Raises ValueError if there are not three points.
    """
    if np.size(slip) != 3:
        raise ValueError(f"expected three points, got {np.size(slip)}; for more use generalized_newton_raphson")
    return generalized_newton_raphson(slip, sinkage, drawbar_pull, reading=reading, guess=guess, **options)
