"""Soils that a course is drawn from, and the best drawbar pull of this wheel on them."""

import math
from typing import Any, NamedTuple

import numpy as np

from soil_env._compiled.flags import HUGE, compiled, record
from soil_env._compiled.random_streams import between, normal_pair, uniform
from soil_env.parameters import SoilState
from soil_env.terramechanics.effects import depends_on_speed
from soil_env.terramechanics.ground import put_soil, soil_of
from soil_env.terramechanics.reaction import Acting
from soil_env.terramechanics.residual import WorkingPoint, residual_under
from soil_env.terramechanics.steady import Conditions, Point, steady_at
from soil_env.terramechanics.traversability import best_point_at

REDRAWS = 200  # attempts at a soil
CUT = 2.5  # [sigma] beyond which no property of a soil is drawn
STEEPEST_FRICTION = math.radians(60.0)  # [rad] largest friction angle that is drawn
SAFE_SINKAGE = 0.9  # [of the sinkage that ends an episode] most that a soil may ask for
IMPASSABLE = -HUGE  # [of weight] pull of a wheel that would be bogged

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
    "ahead",  # [m] final ground before a wheel: more than it travels in an action
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
    """Next number of a stream, uniform in `bounds` [low, high)."""
    return between(owner, bounds[0], bounds[1])


@compiled
def draw_soil(owner, drawn):
    """One soil: a preset by weight, scattered by `SoilSpread`; from the stream of `owner`."""
    pick = uniform(owner)
    i = 0
    while i < drawn.presets.size - 1 and pick > drawn.presets[i].cumulative:
        i += 1
    return scattered(soil_of(drawn.presets[i]), 1.0, owner, drawn.spec)


@compiled
def scattered(mean, share, owner, spec):
    """A soil that scatters about `mean` by a share of `SoilSpread`; deviations are cut."""
    z = normal_pair(owner) + normal_pair(owner) + normal_pair(owner)
    friction = share * spec.variation[0] * _deviation(0, z, spec)
    phi = min(math.atan(mean.tan_phi) * (1.0 + friction), STEEPEST_FRICTION)
    cohesion = mean.cohesion * _factor(1, z, share, spec)
    modulus = mean.shear_modulus * _factor(2, z, share, spec)
    stiffer = _factor(3, z, share, spec)
    gain = mean.dig_gain * _factor(4, z, share, spec)
    n = mean.sinkage_exponent * (1.0 + share * spec.variation[5] * _cut(z[5]))
    depth = spec.reference_sinkage
    pressure = mean.sinkage_coefficient * depth**mean.sinkage_exponent * stiffer  # [Pa] at `depth`
    coefficient = pressure / depth**n
    return SoilState(math.tan(phi), cohesion, modulus, coefficient, n, gain, *mean[6:])


@compiled
def _cut(deviation):
    return min(max(deviation, -CUT), CUT)


@compiled
def _deviation(i, z, spec):
    """Deviation [sigma] of the property i of `variation`, correlated, from independent ones z."""
    total = 0.0
    for k in range(i + 1):
        total += spec.factor[i, k] * z[k]
    return _cut(total)


@compiled
def _factor(i, z, share, spec):
    """Log-normal factor of mean 1 of the property i, with a share of its `variation`."""
    variation = share * spec.variation[i]
    s = math.sqrt(math.log(1.0 + variation * variation))
    return math.exp(s * _deviation(i, z, spec) - 0.5 * s * s)


@compiled
def capacity(load, soil, numbers, nodes):
    """Best steady drawbar pull over load [N] on level ground, `IMPASSABLE` for a bogged wheel.

    Where strength depends on speed, the lesser one of starting and of driving.
    """
    spec = numbers.drawn.spec
    rig = numbers.rig
    effects = numbers.acting.effects
    deepest = SAFE_SINKAGE * spec.bogged_sinkage
    at_rest = Conditions(0.0, 1.0, 0.0)
    rest = steady_at(nodes, Point(0.0, load, 0.0), soil, rig, at_rest, effects)
    if rest.sinkage > deepest or not rest.supported:
        return IMPASSABLE
    least = HUGE
    for speed in (spec.speed, 0.0):
        at = Conditions(speed, 1.0, 0.0)
        best = best_point_at(nodes, load, soil, rig, at, effects, spec.stall_torque)
        point = WorkingPoint(best.slip, best.sinkage, load, at.speed, at.passes, at.sin_grade)
        _, pull, torque = residual_under(numbers.acting.residual, point, soil, rig)
        if best.sinkage > deepest or best.torque + torque * load * rig.radius > spec.stall_torque:
            return IMPASSABLE
        least = min(least, best.drawbar_pull / load + pull)
        if not depends_on_speed(effects):
            break
    return max(least, IMPASSABLE)


@compiled
def draw_ground(ground, owner, load, numbers, nodes):
    """Draw the soil of `ground`, which leaves this wheel the least pull; False if none was found.

    Of slopes nothing is asked: they are drawn without looking at soils. With a least pull of minus
    the weight the last soil stays, even if a wheel would be bogged at its best pull.
    """
    least = numbers.drawn.spec.least_pull
    for k in range(REDRAWS):
        soil = draw_soil(owner, numbers.drawn)
        last = k == REDRAWS - 1 and least <= -1.0
        if last or capacity(load, soil, numbers, nodes) >= least:
            put_soil(ground, soil)
            return True
    return False
