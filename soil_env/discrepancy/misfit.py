"""Tests for lack of fit: residuals along smooth and along physical directions.

What the fit's own unknowns explain is taken out of both:

- *smooth*: polynomials of the conditions, in each channel on its own;
- *physical*: an input of the model (a soil parameter, the load on the wheel, its radius, its slip) that is not the
  constant it is taken for, but changes with a condition. That moves all channels together, as the model has it. It is
  the score test of the constancy of a parameter (Rao 1948, Proc. Cambridge Phil. Soc. 44:50-57): a name under which
  the soil would have to be another one at another load, slip or speed is not the right name, however well each channel
  may be described by itself.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from soil_env.discrepancy.calibrate import Fit, Problem
from soil_env.discrepancy.noise import smooth_basis

LEAST_LEFT = 0.05  # of the length of a direction, below which the unknowns explain it anyway
_STEP = 1e-3  # relative change of an input, for differences
_LEAST_COHESION = 100.0  # [Pa] whose change is taken where the cohesion is less


def probability(gain: float, count: int, freedom: float) -> float:
    """Chance of a fall of the objective by `gain` from `count` further unknowns, the noise known to `freedom`."""
    if gain <= 0.0:
        return 1.0
    if math.isinf(freedom):
        return float(chi2.sf(gain, count))
    return float(f_distribution.sf(gain / count, count, freedom))


def log_bound(p: float) -> float:
    """Logarithm of the largest odds against a hypothesis that a p value speaks for, B(p) = 1/(-e p ln p).

    Sellke, Bayarri & Berger (2001), Am. Stat. 55:62-71; 0 from p = 1/e on.
    """
    p = max(p, 1e-300)
    return -1.0 - math.log(-p * math.log(p)) if p < 1.0 / math.e else 0.0


def lack_of_fit(problem: Problem, fit: Fit) -> float:
    """p value of what a fit leaves: the smaller of two, doubled.

    The first is that of all smooth directions together, the second that of the one direction, smooth or physical, that
    explains most, for as many independent looks as the directions amount to.
    """
    a, e = fit.linearised()
    q, _ = np.linalg.qr(a)
    smooth, seen = _apart(q, smooth_directions(problem))
    left, s, _ = np.linalg.svd(smooth, full_matrices=False)
    rank = int(np.sum(s > 1e-6 * max(s[0], 1e-300)))
    together = probability(float(np.sum((left[:, :rank].T @ e) ** 2)), rank, problem.freedom)
    physical, also = _apart(q, physical_directions(problem, fit))
    families = [c / np.linalg.norm(c, axis=0) for c in (smooth[:, seen], physical[:, also]) if c.shape[1]]
    if not families:
        return together
    most = probability(max(float(np.max((c.T @ e) ** 2)) for c in families), 1, problem.freedom)
    alone = -math.expm1(sum(looks(c) for c in families) * math.log1p(-min(most, 1.0 - 1e-12)))
    return min(1.0, 2.0 * min(together, alone))


def looks(single: np.ndarray) -> float:
    """Independent tests that correlated directions [M, C] of length one amount to: sum of [l >= 1] + l - floor(l).

    l: eigenvalues of their correlations (Li & Ji 2005, Heredity 95:221-227).
    """
    values = np.maximum(np.linalg.eigvalsh(single.T @ single), 0.0)
    values = np.where(np.abs(values - np.round(values)) < 1e-9, np.round(values), values)
    return float(np.sum((values >= 1.0) + values - np.floor(values)))


def _apart(q: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(directions [M + p, C] without what the unknowns explain, [C] whether enough is left to be seen)."""
    c = np.concatenate([directions, np.zeros((q.shape[0] - directions.shape[0], directions.shape[1]))])
    size = np.linalg.norm(c, axis=0)
    c = c - q @ (q.T @ c)
    return c, np.linalg.norm(c, axis=0) > np.maximum(LEAST_LEFT * size, 1e-9)


def smooth_directions(problem: Problem) -> np.ndarray:
    """[M, C] whitened polynomials of the conditions, each in one channel."""
    row, channel = np.nonzero(problem.used)
    basis = smooth_basis(problem.data)[row]
    measured = [j for j in range(3) if problem.used[:, j].any()]
    return np.concatenate([np.where((channel == j)[:, None], basis, 0.0) for j in measured], axis=1)


def physical_directions(problem: Problem, fit: Fit) -> np.ndarray:
    """[M, C] whitened response to each input of the model that changes with a condition or a product of two."""
    conditions = list(problem.data.varied.values())
    pattern = [c.scaled for c in conditions]
    pattern += [c.scaled**2 for c in conditions if c.levels > 2]
    pattern += [a.scaled * b.scaled for k, a in enumerate(conditions) for b in conditions[k + 1 :]]
    row = np.nonzero(problem.used)[0]
    pattern = np.stack(pattern, axis=1)[row]
    return np.concatenate([r[:, None] * pattern for r in responses(problem, fit).values()], axis=1)


def responses(problem: Problem, fit: Fit) -> dict[str, np.ndarray]:
    """Whitened change [M] of the model's values with each of its inputs, for a relative change of one."""
    rows, values, guess = problem.data.rows, fit.parameters(), problem.sinkage_guess(fit)
    base = problem.predict(values, fit.choices, guess.copy())
    moved = {}
    known = {**problem.known, **values}
    for name in ("friction_angle_deg", "cohesion", "shear_modulus", "sinkage_coefficient", "sinkage_exponent"):
        by = _STEP * max(known[name], _LEAST_COHESION if name == "cohesion" else 0.0)
        moved[name] = values | {name: known[name] + by}, rows
    radius = np.array([1.0 + _STEP, 1.0, 1.0])
    moved["load"] = values, rows._replace(load=rows.load * (1.0 + _STEP))
    moved["radius"] = values, rows._replace(wheels=rows.wheels * radius)
    moved["slip"] = values, rows._replace(slip=rows.slip + _STEP)
    out = {}
    for name, (changed, there) in moved.items():
        change = problem.predict(changed, fit.choices, guess.copy(), there) - base
        change = problem.whiten(change) / _STEP
        out[name] = np.where(np.isfinite(change), change, 0.0)
    return out
