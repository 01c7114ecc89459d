"""Forces of the ground and their slopes: against adaptive quadrature and differences."""

import math

import numpy as np
import pytest

from soil_env.identification.online.contact_slopes import GroundSoil, Slopes, reaction
from soil_env.identification.online.lanes.compiling import compiled_inline, compiled_root
from soil_env.identification.online.lanes.lanes import COUNT, from_array, to_array
from tests.terramechanics import reference

R = 0.15
B = 0.12
TANGENT, COHESION, EXPONENT, LN_K, SINKAGE, SLIP = range(6)
VALUE = Slopes._fields.index("value")


@compiled_inline
def _store(slopes, out, row):
    to_array(slopes.value, out, row * COUNT)
    by_soil = slopes.by_tangent, slopes.by_cohesion, slopes.by_exponent, slopes.by_ln_K
    for i, slope in enumerate((*by_soil, slopes.by_sinkage, slopes.by_slip)):
        to_array(slope, out, (row + 1 + i) * COUNT)


@compiled_root
def _reaction(x, load, r, b, out):
    soil = GroundSoil(
        from_array(x, 0), from_array(x, COUNT), from_array(x, 2 * COUNT), from_array(x, 3 * COUNT)
    )
    found = reaction(soil, from_array(x, 4 * COUNT), from_array(x, 5 * COUNT), load, r, b)
    _store(found.pull, out, 0)
    _store(found.torque, out, 7)
    _store(found.ln_s, out, 14)


def reactions(x, load, r=R, b=B):
    """(pull, torque, ln s) by value and slopes [3, 7, COUNT] at rows x [6, COUNT]: soil, sinkage
    and slip.
    """
    out = np.zeros(21 * COUNT)
    _reaction(np.ascontiguousarray(x, float).ravel(), load, r, b, out)
    return out.reshape(3, 7, COUNT)


def cases(seed, braking=False):
    """Eight random soils, sinkages and slips [6, COUNT] that carry loads of the order of 100 N."""
    rng = np.random.default_rng(seed)
    slip = rng.uniform(-0.4, -0.02, COUNT) if braking else rng.uniform(0.01, 0.8, COUNT)
    return np.array(
        [
            np.tan(np.radians(rng.uniform(15.0, 42.0, COUNT))),
            rng.uniform(0.0, 2000.0, COUNT),
            rng.uniform(0.6, 1.3, COUNT),
            np.log(rng.uniform(0.006, 0.04, COUNT)),
            rng.uniform(0.008, 0.05, COUNT),
            slip,
        ]
    )


@pytest.mark.parametrize("braking", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_slopes_are_those_of_central_differences(seed, braking):
    x = cases(seed, braking)
    load = 130.0
    found = reactions(x, load)
    for i, h in enumerate((1e-5, 1e-2, 1e-5, 1e-5, 1e-7, 1e-6)):
        away = np.zeros_like(x)
        away[i] = h
        expected = (reactions(x + away, load)[:, VALUE] - reactions(x - away, load)[:, VALUE]) / (
            2.0 * h
        )
        size = np.abs(expected).max(axis=1, keepdims=True)
        assert np.all(np.abs(found[:, 1 + i] - expected) <= 2e-5 * size + 1e-9), (
            i,
            found[:, 1 + i],
            expected,
        )


@pytest.mark.parametrize(
    ("seed", "braking", "tolerance"), [(0, False, 1e-4), (1, False, 1e-4), (2, True, 1e-3)]
)
def test_forces_are_those_of_quadrature(seed, braking, tolerance):
    """At the mobilised sinkage coefficient that is stated, the equations give the load, the pull
    and the torque.
    """
    x = cases(seed, braking)
    load = 130.0
    pull, torque, ln_s = reactions(x, load)[:, VALUE]
    for k in range(COUNT):
        tangent, cohesion, exponent, ln_K, sinkage, slip = x[:, k]
        soil = reference.Ground(
            math.degrees(math.atan(tangent)), cohesion, math.exp(ln_K), math.exp(ln_s[k]), exponent
        )
        judge = reference.forces(soil, slip, math.acos(1.0 - sinkage / R), R, B)
        for found, expected in (
            (load, judge.load),
            (pull[k], judge.drawbar_pull),
            (torque[k] / R, judge.torque / R),
        ):
            assert abs(found - expected) < tolerance * judge.scale


@pytest.mark.parametrize("depth", [1e-3, 0.01, 1.0, 1.9])
def test_all_is_finite_from_the_surface_to_the_top_of_the_wheel(depth):
    """Also under no load, at the wildest soils that nodes may be at; the filter keeps sinkages
    within these.
    """
    for load in (0.0, 1e-3, 1e4):
        x = cases(5)
        x[SINKAGE] = depth * R
        x[TANGENT, :4] = 0.005
        x[COHESION, 2:6] = -500.0
        x[EXPONENT, 4:] = 0.2
        x[LN_K, :2] = -12.0
        x[LN_K, 2:4] = 3.0
        assert np.all(np.isfinite(reactions(x, load)))
