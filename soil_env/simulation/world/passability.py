"""Soils that a course is drawn from, and the best drawbar pull of this wheel on them."""

import math
from typing import Any, NamedTuple

import numpy as np

from soil_env._compiled.flags import HUGE, compiled, record
from soil_env._compiled.random_streams import between, normal_pair, uniform
from soil_env.parameters import SoilState
from soil_env.terramechanics.effects import depends_on_speed
from soil_env.terramechanics.ground import soil_of
from soil_env.terramechanics.reaction import Acting
from soil_env.terramechanics.residual import WorkingPoint, residual_under
from soil_env.terramechanics.steady import LEVEL, Conditions, Point, rim_of, steady_at
from soil_env.terramechanics.traversability import best_point_at

REDRAWS = 200  # attempts at a soil
CUT = 2.5  # [sigma] beyond which no property of a soil is drawn
# [rad] largest friction angle that is drawn about a mean below it
STEEPEST_FRICTION = math.radians(60.0)
SAFE_SINKAGE = 0.9  # [of the sinkage that ends an episode] most that a soil may ask for
IMPASSABLE = -HUGE  # [of weight] pull of a wheel that cannot pass, for whatever reason

_PAIR = ("f8", 2)  # (low, high) of a uniform distribution
#: Distribution of courses, as compiled code takes `CourseSpec`, `Camera` and `SoilSpread`.
DISTRIBUTION = record(
    "length",  # [m] of a course
    "border",  # [m] over which one patch passes into the next
    "class_scatter",  # [of `variation`] of the patches of a class about its soil
    "least_pull",  # [of weight] best drawbar pull below which a soil is drawn again
    "label_error",  # [-] share of the labels that a camera has wrong
    "grade_noise",  # [rad] 1-sigma, of a camera
    "border_noise",  # [m] 1-sigma, of a camera
    "ahead",  # [m] of final ground ahead of a wheel: more than it travels in an action
    "body_mass",  # [kg]
    "stall_torque",  # [N m]
    "bogged_sinkage",  # [m] at which an episode ends
    "reference_sinkage",  # [m] at which stiffness scatters
    "speed",  # [m/s] travel at which passability is judged, half the top rim speed
    patch_length=_PAIR,  # [m]
    slope_length=_PAIR,  # [m]
    grade=_PAIR,  # [rad]
    first_grade=_PAIR,  # [rad] of the first slope, and of those on the first patch of a class
    payload=_PAIR,  # [kg]
    halt_before=_PAIR,  # [m] a patch with two routes
    variation=("f8", 6),  # [-] of friction angle, cohesion, K, stiffness, dig gain, exponent
    factor=("f8", (5, 5)),  # Cholesky factor of the correlations of the first five
    classes=("i8",),
    lines=("i8",),
)
#: A soil of the mixture.
PRESET = record(
    "cumulative",  # [-] share of the mixture up to and with this soil
    *SoilState._fields,
)


class CourseDistribution(NamedTuple):
    """What courses are drawn from."""

    spec: Any  # `DISTRIBUTION`
    presets: np.ndarray  # [soils] `PRESET`


class CourseNumbers(NamedTuple):
    """Distribution of the courses, and the wheel that has to pass them."""

    drawn: CourseDistribution
    rig: Any  # `RIG`
    acting: Acting


@compiled
def within(owner, bounds):
    """Next number of the stream of `owner`, uniform in [low, high), the two `bounds`."""
    return between(owner, bounds[0], bounds[1])


@compiled
def draw_soil(owner, drawn):
    """Random soil from the stream of `owner`: a preset by its share of the mixture, scattered by
    the whole `SoilSpread`. `drawn`: `CourseDistribution`.
    """
    pick = uniform(owner)
    i = 0
    while i < drawn.presets.size - 1 and pick > drawn.presets[i].cumulative:
        i += 1
    return scattered(soil_of(drawn.presets[i]), 1.0, owner, drawn.spec)


@compiled
def scattered(mean, share, owner, spec):
    """Random soil about `mean` from the stream of `owner`, with a `share` of the variations of
    `SoilSpread` and deviations cut at `CUT`. Friction angle and exponent scatter normally, the
    others log-normally; the angle is at most `STEEPEST_FRICTION`.

    Stiffness is the pressure at `reference_sinkage`, so a change of the exponent turns the curve
    about that point. Recovery and the fields after it stay. Rows of `factor` and entries of
    `variation` are in the order of `DISTRIBUTION`, which `spec` is.
    """
    z = normal_pair(owner) + normal_pair(owner) + normal_pair(owner)
    friction = share * spec.variation[0] * _deviation(spec.factor[0], z)
    mean_phi = math.atan(mean.tan_phi)
    phi = min(mean_phi * (1.0 + friction), max(mean_phi, STEEPEST_FRICTION))
    cohesion = mean.cohesion * _log_normal(1, share, spec, z)
    modulus = mean.shear_modulus * _log_normal(2, share, spec, z)
    stiffer = _log_normal(3, share, spec, z)
    gain = mean.dig_gain * _log_normal(4, share, spec, z)
    n = mean.sinkage_exponent * (1.0 + share * spec.variation[5] * _cut(z[5]))
    depth = spec.reference_sinkage
    pressure = mean.sinkage_coefficient * depth**mean.sinkage_exponent * stiffer  # [Pa] at `depth`
    coefficient = pressure / depth**n
    return SoilState(math.tan(phi), cohesion, modulus, coefficient, n, gain, *mean[6:])


@compiled
def _cut(deviation):
    """Deviation [sigma] within -`CUT` and `CUT`."""
    return min(max(deviation, -CUT), CUT)


@compiled
def _deviation(row, z):
    """Deviation [sigma], cut, of the property that has this row of `factor` (`DISTRIBUTION`),
    correlated with those before it; z are independent standard normal numbers. The row has five
    entries, so a sixth number of z is left to a property without correlations.
    """
    total = 0.0
    for k in range(row.size):
        total += row[k] * z[k]
    return _cut(total)


@compiled
def _log_normal(k, share, spec, z):
    """Log-normal factor, of mean 1 but for the cut, on the property with the number k in
    `variation`, of which a `share` is taken; its deviation is that of `_deviation`.
    """
    variation = share * spec.variation[k]
    s = math.sqrt(math.log(1.0 + variation * variation))
    return math.exp(s * _deviation(spec.factor[k], z) - 0.5 * s * s)


@compiled
def capacity(load, soil, numbers, nodes):
    """Best steady drawbar pull [of `load`] of this wheel on level, fresh ground within the stall
    torque; `load` in N. `soil`: `SoilState`; `numbers`: `CourseNumbers`; `nodes`: scratch.

    The point of best pull is found without the residual law; the pull of that law at the point is
    added. Where strength or bearing depends on speed, the result is the lesser of the pulls when
    starting (speed 0) and when driving (`spec.speed`). `IMPASSABLE`:

    - where the soil does not carry the wheel at rest;
    - where it sinks deeper than `SAFE_SINKAGE` allows, at rest or at that point;
    - where no slip is possible within the stall torque;
    - where the residual law takes more torque than is left.
    """
    spec = numbers.drawn.spec
    rig = numbers.rig
    rim = rim_of(rig)
    effects = numbers.acting.effects
    deepest = SAFE_SINKAGE * spec.bogged_sinkage
    rest = steady_at(nodes, Point(0.0, load, 0.0), soil, rim, LEVEL, effects)
    if rest.sinkage > deepest or not rest.supported:
        return IMPASSABLE
    least = HUGE
    for speed in (spec.speed, 0.0):
        at = Conditions(speed, 1.0, 0.0)
        best = best_point_at(nodes, load, soil, rim, at, effects, spec.stall_torque)
        point = WorkingPoint(best.slip, best.sinkage, load, at.speed, at.passes, at.sin_grade)
        # the sinkage of a residual law is read by sensors only
        _, pull, torque = residual_under(numbers.acting.residual, point, soil, rig)
        if best.sinkage > deepest or best.torque + torque * load * rig.radius > spec.stall_torque:
            return IMPASSABLE
        least = min(least, best.drawbar_pull / load + pull)
        if not depends_on_speed(effects):
            break
    return max(least, IMPASSABLE)  # -inf where no slip is possible within the torque


@compiled
def draw_ground(owner, load, numbers, nodes):
    """Draw soils until one leaves this wheel `least_pull` [of load] on level ground under a `load`
    [N]: (True if found, the last `SoilState`).

    `owner`: the record whose random stream draws; `numbers`: `CourseNumbers`; `nodes`: scratch.

    Not found: none of `REDRAWS` soils does. With a least pull of -1 the last soil then counts as
    found, even if the wheel would be bogged at its best pull. Slopes do not count, since they are
    drawn without looking at soils.
    """
    least = numbers.drawn.spec.least_pull
    for _ in range(REDRAWS):
        soil = draw_soil(owner, numbers.drawn)
        if capacity(load, soil, numbers, nodes) >= least:
            return True, soil
    return least <= -1.0, soil
