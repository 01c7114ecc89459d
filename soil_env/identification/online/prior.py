"""Prior of the soil: a Gaussian, that of the belief itself or the moments of its library of soils;
and the constants of the identifier.

Soils are compared by the pressure S d^n at a depth d, since the unit of S depends on n.
"""

import math

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from soil_env._io.loading import ParameterError
from soil_env.parameters import FLOW_LAW, RoverScenario, Scenario, Wheel
from soil_env.parameters.readings import largest_sensed, reading_errors, reading_units

from .identifier import start
from .memory import (
    COHESION,
    EXPONENT,
    GAIN,
    LEAST_SD,
    LN_K,
    MOST_SOILS,
    PRESSURE,
    PUBLISHED,
    PUBLISHED_LN_S,
    PUBLISHED_PHI,
    READING,
    SETTING,
    SOIL as SIZE,
    TANGENT,
    WORK,
)

# Standard deviation of an unknown that the belief holds for known, own choice: of cohesion [of the
# mean pressure weight/(r b)], of the others in their units.
KNOWN = 1e-4
# [of the standard deviation of `plain`] least scatter of a soil of the library, own choice
LEAST_SCATTER = 1e-2
LEAST_GAIN = 1e-3  # [-] least gain of slip-sinkage, whose logarithm is taken, own choice
# [of the weight of the library] weight of a soil that is like none of the library, own choice
STRANGE = 0.2
#: White noise, in the units of `Noise`, so large that a reading has no weight; own choice.
NO_WEIGHT = 1e6
_LEAST_WIDTH = 0.95  # [of the standard deviation] least of `widths`, own choice
_WIDEST = 4.0  # [of the standard deviation] half width up to which `widths` are sought, own choice
_DEPTH = 0.2  # [wheel radii] depth at which pressures are compared, own choice
_ONE_SIGMA = math.erf(math.sqrt(0.5))  # [-] probability within one standard deviation
_PUBLISHED = [TANGENT, LN_K, PRESSURE, COHESION, GAIN]  # behind each published quantity, in order
_OF_SPREAD = np.array([TANGENT, COHESION, LN_K, PRESSURE, GAIN])  # as in `SoilSpread.factor`

Gaussian = tuple[float, np.ndarray, np.ndarray]  # weight, mean [SIZE], covariance [SIZE, SIZE]


def depth_of(wheel: Wheel) -> float:
    """Sinkage [m] at which the pressures of soils are compared."""
    return _DEPTH * wheel.radius


def plain(scenario: Scenario) -> Gaussian:
    """The prior of the belief without its library: weight 1, mean and covariance of the unknowns
    `TANGENT` to `GAIN` of `memory`. Each standard deviation is at least `KNOWN`.
    """
    b = scenario.belief
    w = scenario.wheel
    tangent = math.tan(math.radians(b.friction_angle_deg))
    n = b.sinkage_exponent
    ln_pressure = math.log(b.sinkage_coefficient) + n * math.log(depth_of(scenario.wheel))
    mean = np.array([tangent, b.cohesion, n, math.log(b.shear_modulus), ln_pressure, 0.0])
    sd = np.array(
        [
            (1.0 + tangent**2) * math.radians(b.friction_sd_deg),
            b.cohesion_sd,
            b.sinkage_exponent_sd,
            b.shear_modulus_sd,
            b.sinkage_coefficient_sd,
            b.dig_gain_sd,
        ]
    )
    least = np.full(SIZE, KNOWN)
    least[COHESION] *= scenario.weight / (w.radius * w.width)
    sd = np.maximum(sd, least)
    correlations = np.eye(SIZE)
    for i, j, correlation in (
        (TANGENT, COHESION, b.friction_cohesion),
        (TANGENT, PRESSURE, b.friction_stiffness),
        (LN_K, PRESSURE, b.stiffness_shear_modulus),
    ):
        correlations[[i, j], [j, i]] = correlation
    return 1.0, mean, correlations * np.outer(sd, sd)


def of_library(scenario: Scenario) -> list[Gaussian]:
    """A Gaussian for each soil of the belief's library, with the scatter of `Belief.spread`, or of
    the courses where that is None.

    The soils are those of the scenario's gravity. K, S and gain scatter as log-normals whose means
    are the numbers of the soil. The pressure is that of `depth_of`, so it scatters with the
    exponent too.
    """
    b = scenario.belief
    spread = b.spread or scenario.spread
    found = []
    # standard deviations of ln K, ln of the pressure and ln of the gain
    logs = np.sqrt(np.log1p(np.square([spread.shear_modulus, spread.stiffness, spread.dig_gain])))
    correlations = np.eye(SIZE)
    correlations[np.ix_(_OF_SPREAD, _OF_SPREAD)] = spread.factor() @ spread.factor().T
    least = LEAST_SCATTER * np.sqrt(np.diag(plain(scenario)[2]))
    deeper = np.eye(SIZE)  # from the pressure at the reference of the scatter to that at `depth_of`
    deeper[PRESSURE, EXPONENT] = math.log(depth_of(scenario.wheel) / spread.reference_sinkage)
    for name, weight in b.soils.items():
        soil = scenario.beneath(scenario.library[name])
        tangent = soil.tan_phi
        n = soil.sinkage_exponent
        ln_pressure = math.log(soil.sinkage_coefficient) + n * math.log(spread.reference_sinkage)
        gain = math.log(max(soil.dig_gain, LEAST_GAIN) / max(b.dig_gain, LEAST_GAIN))
        ln_K = math.log(soil.shear_modulus)
        mean = np.array([tangent, soil.cohesion, n, ln_K, ln_pressure, gain])
        mean[LN_K:] -= 0.5 * logs**2  # the scatter keeps the mean, not the median
        # sd of tan phi, by that of phi, which is a share of phi
        friction = (1.0 + tangent**2) * math.atan(tangent) * spread.friction
        sd = np.maximum(
            [friction, soil.cohesion * spread.cohesion, n * spread.exponent, *logs], least
        )
        found.append((weight, deeper @ mean, deeper @ (correlations * np.outer(sd, sd)) @ deeper.T))
    return found


def moments(gaussians: list[Gaussian]) -> tuple[np.ndarray, np.ndarray]:
    """Mean [SIZE] and covariance [SIZE, SIZE] of a mixture."""
    weights, means, covariances = (np.array(part) for part in zip(*gaussians, strict=True))
    apart = np.cov(means.T, aweights=weights, ddof=0)
    mean = np.average(means, axis=0, weights=weights)
    return mean, np.average(covariances, axis=0, weights=weights) + apart


def widths(gaussians: list[Gaussian]) -> np.ndarray:
    """Half widths [SIZE] of the intervals about its mean that hold 68 % of a mixture, in its
    standard deviations; 1 for a Gaussian.
    """
    weights, means, covariances = (np.array(part) for part in zip(*gaussians, strict=True))
    mean, covariance = moments(gaussians)
    sd = np.sqrt(np.diag(covariance))
    # [Gaussians, SIZE] means and standard deviations of the Gaussians in the unit of a width
    off = (means - mean) / sd
    own = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)) / sd

    def excess(width: float, i: int) -> float:
        """Probability of unknown i within `width` of the mean, less that of one sigma."""
        held = ndtr((width - off[:, i]) / own[:, i]) - ndtr((-width - off[:, i]) / own[:, i])
        return float(np.average(held, weights=weights)) - _ONE_SIGMA

    return np.array([brentq(excess, 0.0, _WIDEST, args=(i,)) for i in range(SIZE)])


def _gaussians(scenario: Scenario) -> list[Gaussian]:
    """The Gaussians of the prior: of the library, or one where the belief has none."""
    return of_library(scenario) if scenario.belief.soils else [plain(scenario)]


def prior_of_belief(scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """Mean [SIZE] and covariance [SIZE, SIZE] of the soil before any reading."""
    return moments(_gaussians(scenario))


def published_prior(scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """Mean [5] and standard deviations [5] of (phi, ln K, ln S, c, ln gain) before any reading.

    S is that at the exponent of the belief, the gain is over its nominal one. Standard deviations
    are half widths of the 68 % intervals of the belief's library, but at least `_LEAST_WIDTH` of
    its standard deviations.
    """
    u, covariance = prior_of_belief(scenario)
    scale = np.maximum(widths(_gaussians(scenario)), _LEAST_WIDTH)
    sd = (scale * np.sqrt(np.diag(covariance)))[_PUBLISHED]
    sd[PUBLISHED_PHI] /= 1.0 + u[TANGENT] ** 2
    mean = u[_PUBLISHED]
    mean[PUBLISHED_PHI] = math.atan(u[TANGENT])
    mean[PUBLISHED_LN_S] -= scenario.belief.sinkage_exponent * math.log(depth_of(scenario.wheel))
    return mean, sd


def setting_of(scenario: Scenario) -> np.ndarray:
    """Pack the constants of the identifier of a scenario, `SETTING` [1], and its blank memory.

    A library of several soils gets one more Gaussian, with the moments of the library and `STRANGE`
    times its weight. Raises `ParameterError` for more soils than `MOST_SOILS` leaves room for.
    """
    setting = np.zeros(1, SETTING)
    s = setting[0]
    wheel = scenario.wheel
    belief = scenario.belief
    for name in ("radius", "width", "inertia", "stall_torque"):
        s[name] = getattr(wheel, name)
    for name in ("dig_gain", "dig_recovery", "border", "model_error", *FLOW_LAW):
        s[name] = getattr(belief, name)
    s.gravity = scenario.gravity
    s.weight = scenario.weight
    s.period = scenario.control.period
    s.length = scenario.relaxation * wheel.radius
    s.depth = depth_of(scenario.wheel)
    s.exponent = belief.sinkage_exponent
    s.off = belief.method == "none"
    white, zero, gain = reading_errors(scenario)
    least = LEAST_SD * np.array(reading_units(scenario))
    least[0] = 0.0  # of the slip, the first: white noise of 0 tells that there is no slip sensor
    s.white = np.maximum(white, least).view(READING)
    s.zero = zero.view(READING)
    s.gain = gain.view(READING)
    s.largest = largest_sensed(wheel, scenario.gravity)
    mean, covariance = prior_of_belief(scenario)
    s.soil_mean = mean
    s.soil_sd = np.sqrt(np.diag(covariance))
    s.soil_covariance = covariance
    s.soil_precision = np.linalg.inv(covariance)
    soils = _gaussians(scenario)
    if len(soils) > 1:  # against soils that are like none of the library
        soils.append((STRANGE * sum(weight for weight, _, _ in soils), mean, covariance))
    if len(soils) > MOST_SOILS:
        raise ParameterError(f"belief.soils: expected at most {MOST_SOILS - 1} soils")
    s.library = len(soils)
    for k, (weight, center, spread) in enumerate(soils):
        s.library_mean[k] = center
        s.library_covariance[k] = spread
        s.library_precision[k] = np.linalg.inv(spread)
        s.library_log[k] = math.log(weight) - 0.5 * np.linalg.slogdet(spread)[1]
    # `start` takes the published prior from the setting and adds the best pull of the prior
    s.prior[:PUBLISHED], s.prior_sd[:PUBLISHED] = published_prior(scenario)
    start(s.blank, setting, np.zeros(1, WORK))
    s.prior = s.blank[0].estimate
    s.prior_sd = s.blank[0].sd
    return setting


def limit_to_wheel(setting: np.ndarray, scenario: RoverScenario) -> None:
    """Give no weight, in the `SETTING` of one wheel of a rover, to two readings (`NO_WEIGHT`).

    The accelerometer measures the body, not the pull of this wheel. The torque of a motor with a
    speed loop is read at the end of a period, in which the other wheels change the motion, too:
    `points.SPIN_ERROR` allows for what the wheel itself takes. The load on one wheel changes with
    the pull, so `load_varies` becomes 1.
    """
    white = setting["white"]
    white["acceleration"] = NO_WEIGHT * scenario.gravity
    if scenario.control.action != "torque":
        white["motor_torque"] = NO_WEIGHT * scenario.weight * scenario.wheel.radius
    setting["load_varies"] = 1
