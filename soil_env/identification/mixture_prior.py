"""Prior of the filter as a mixture of as many Gaussians as a bank has filters, but one.

Where the belief names a library of soils, each of them is one Gaussian (or several, split along ln K, where there are
filters enough), with the scatter of `Belief.spread`. Else the plain prior of the belief is split along ln K, its widest
and most curved direction. The last filter is that of a soil that stays the same on a border (`border`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.lanes import COUNT
from soil_env.parameters import Scenario

SIZE = 6  # (phi, ln K, q, c, n, ln g), as in `linearised`, but for the friction angle
PARTS = COUNT - 1
_REACH = {2: 0.555, 3: 1.05, 4: 1.4, 5: 1.65, 6: 1.8, 7: 1.9}  # [sd] of the outermost of so many parts
_NEVER = -700.0  # ln weight of a filter that is not used


class MixturePrior(NamedTuple):
    """Means, covariances and weights; eight numbers, one a filter, lie side by side."""

    mean: np.ndarray  # [SIZE x 8]
    covariance: np.ndarray  # [SIZE (SIZE + 1)/2 x 8], the lower triangle row by row
    tangent: np.ndarray  # [8] of the friction angle
    log_weight: np.ndarray  # [8]


Gaussian = tuple[float, np.ndarray, np.ndarray]  # weight, mean [SIZE], covariance [SIZE, SIZE]


def split(gaussian: Gaussian, parts: int) -> list[Gaussian]:
    """A Gaussian as a mixture of narrower ones along ln K, with means evenly within `_REACH`; its standard deviation is
    kept to 3 %."""
    weight, mean, covariance = gaussian
    if parts == 1:
        return [gaussian]
    at = np.linspace(-_REACH[parts], _REACH[parts], parts)
    share = 0.75 * (at[1] - at[0])
    weights = np.exp(-0.5 * at**2 / (1.0 - share**2))
    along = covariance[:, 1] / math.sqrt(covariance[1, 1])
    narrower = covariance - (1.0 - share**2) * np.outer(along, along)
    return [(weight * w, mean + x * along, narrower) for x, w in zip(at, weights / weights.sum(), strict=True)]


def plain(scenario: Scenario) -> Gaussian:
    """The prior of the belief without its library."""
    b, w = scenario.belief, scenario.wheel
    mean = [math.radians(b.friction_angle_deg), math.log(b.shear_modulus), math.log(b.sinkage_coefficient), b.cohesion,
            b.sinkage_exponent, 0.0]  # fmt: skip
    sd = [math.radians(b.friction_sd_deg), b.shear_modulus_sd, b.sinkage_coefficient_sd, b.cohesion_sd,
          b.sinkage_exponent_sd, b.dig_gain_sd]  # fmt: skip
    least = [1e-4, 1e-4, 1e-4, 1e-4 * scenario.weight / (w.radius * w.width), 1e-4, 1e-4]
    r = np.eye(SIZE)
    r[0, 3] = r[3, 0] = b.friction_cohesion
    r[0, 2] = r[2, 0] = b.friction_stiffness
    r[1, 2] = r[2, 1] = b.stiffness_shear_modulus
    return 1.0, np.array(mean), r * np.outer(np.maximum(sd, least), np.maximum(sd, least))


def of_library(scenario: Scenario, depth: float) -> list[Gaussian]:
    """A Gaussian for each soil of the belief's library; the sinkage coefficients are compared at `depth` [m]."""
    b, spread, found = scenario.belief, scenario.belief.spread or scenario.spread, []
    relative = np.array([spread.friction, spread.cohesion, spread.shear_modulus, spread.stiffness, spread.dig_gain])
    logs = np.sqrt(np.log1p(relative**2))
    correlation = spread.factor() @ spread.factor().T
    least = np.sqrt(np.diag(plain(scenario)[2])) * 1e-2
    for name, weight in b.soils.items():
        soil = scenario.library[name].state(scenario.wheel.width)
        phi = math.atan(soil.tan_phi)
        n = soil.sinkage_exponent
        stiffness = soil.sinkage_coefficient * spread.reference_sinkage**n
        mean = np.array([
            phi, math.log(soil.shear_modulus) - 0.5 * logs[2] ** 2,
            math.log(stiffness) - 0.5 * logs[3] ** 2 + n * math.log(depth / spread.reference_sinkage)
            - b.sinkage_exponent * math.log(depth),
            soil.cohesion, n, math.log(max(soil.dig_gain, 1e-3) / max(b.dig_gain, 1e-3)) - 0.5 * logs[4] ** 2,
        ])  # fmt: skip
        # (friction, cohesion, K, stiffness, gain) to (phi, ln K, q, c, n, ln g)
        sd = np.array([phi * relative[0], logs[2], logs[3], soil.cohesion * relative[1], n * spread.exponent, logs[4]])
        order = [0, 2, 3, 1, 4]
        r = np.eye(SIZE)
        used = [0, 1, 2, 3, 5]
        r[np.ix_(used, used)] = correlation[np.ix_(order, order)]
        sd = np.maximum(sd, least)
        found.append((weight, mean, r * np.outer(sd, sd)))
    return found


def moments(gaussians: list[Gaussian]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of a mixture."""
    weights = np.array([g[0] for g in gaussians]) / sum(g[0] for g in gaussians)
    means = np.array([g[1] for g in gaussians])
    mean = weights @ means
    away = means - mean
    return mean, np.einsum("k,kij->ij", weights, np.array([g[2] for g in gaussians])) + (away.T * weights) @ away


def prior_of_belief(scenario: Scenario) -> list[Gaussian]:
    """The prior of a scenario's belief, as at most `PARTS` Gaussians."""
    if not scenario.belief.soils:
        return split(plain(scenario), PARTS)
    gaussians = sorted(of_library(scenario, 0.03), key=lambda g: -g[0])
    if len(gaussians) > PARTS:
        rest = gaussians[PARTS - 1 :]
        gaussians = [*gaussians[: PARTS - 1], (sum(g[0] for g in rest), *moments(rest))]
    parts = [PARTS // len(gaussians) + (k < PARTS % len(gaussians)) for k in range(len(gaussians))]
    return [narrow for g, p in zip(gaussians, parts, strict=True) for narrow in split(g, p)]


def mixture_prior(scenario: Scenario) -> MixturePrior:
    """The prior of a scenario's belief as the compiled filter takes it."""
    gaussians = prior_of_belief(scenario)
    gaussians = gaussians + [(0.0, *gaussians[0][1:])] * (COUNT - len(gaussians))
    weights = np.array([g[0] for g in gaussians])
    means, covariances = np.array([g[1] for g in gaussians]), np.array([g[2] for g in gaussians])
    with np.errstate(divide="ignore"):
        log_weight = np.maximum(np.log(weights / weights.sum()), _NEVER)
    rows, columns = np.tril_indices(SIZE)
    return MixturePrior(
        np.ascontiguousarray(means.T).ravel(), np.ascontiguousarray(covariances[:, rows, columns].T).ravel(),
        np.tan(means[:, 0]), log_weight,
    )  # fmt: skip
