"""Traversability of the ground as identified, against terramechanics."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from soil_env.identification.online.ground import (
    MOST_DIGGING,
    STIFFEST,
    assess_ground,
)
from soil_env.identification.online.points import LIFTED
from soil_env.identification.online.prior import setting_of
from soil_env.identification.published import Traversability
from soil_env.parameters import SoilState
from soil_env.terramechanics.traversability import best_working_point
from tests.identification.observing import SCENARIO, flow_of

WHEEL = SCENARIO.wheel
SETTING = setting_of(SCENARIO)
PRIOR = SETTING["prior"][0, :5]


def assessed(estimate, pull, seen, rows=(0,)):
    """Rows of `assess_ground` of wheels with these estimates [5], best pulls (value, sd) and what
    is `seen` (load [of weight], pitch [rad]); those not among `rows` are NaN.
    """
    estimate, pull, seen = (np.atleast_2d(x).astype(float) for x in (estimate, pull, seen))
    out = np.full((len(estimate), len(Traversability._fields)), np.nan)
    known = np.column_stack([estimate, pull[:, 0]]), np.column_stack([0.0 * estimate, pull[:, 1]])
    assess_ground(np.array(rows), *known, seen, SETTING, out)
    return out


def soil_of(estimate):
    """`SoilState` of (phi, ln K, ln S, c, l)."""
    phi, ln_K, ln_S, c, gain = estimate
    s = SETTING[0]
    stress = math.tan(phi), c, math.exp(ln_K), math.exp(ln_S)
    return SoilState(*stress, s.exponent, s.dig_gain * math.exp(gain), s.dig_recovery, *flow_of(s))


@settings(max_examples=40, deadline=None)
@given(*[st.floats(-1.0, 1.0)] * 3, st.floats(0.0, 1.3), st.floats(-0.4, 0.4))
def test_slip_and_torque_are_those_of_the_best_working_point(strength, K, S, load, pitch):
    """The margin is the best pull that is published, over the grade."""
    estimate = PRIOR + np.array([0.15 * strength, K, S, 300.0 * strength, 0.3 * K])
    best = best_working_point(
        max(load, LIFTED) * SCENARIO.weight,
        soil_of(estimate),
        WHEEL.radius,
        WHEEL.width,
        WHEEL.stall_torque,
    )
    slip, margin, sd, required, available, passable = assessed(
        estimate, (0.21, 0.03), (load, pitch)
    )[0]
    assert slip == best.slip
    assert required == pytest.approx(best.torque, rel=1e-9)
    assert (sd, available) == (0.03, WHEEL.stall_torque)
    expected = 0.21 - math.tan(pitch) if math.isfinite(best.drawbar_pull) else -1.0
    assert margin == pytest.approx(max(expected, -1.0), rel=1e-12)
    assert passable == float(margin > 0.0)


def test_ground_on_which_the_motor_does_not_turn_the_wheel_is_impassable():
    """Whatever pull is published of it (source paper, Section 6)."""
    found = assessed(PRIOR, (0.3, 0.01), (200.0, 0.0))[0]
    assert (found[1], found[5]) == (-1.0, 0.0)


def test_estimates_beyond_all_soils_count_as_the_last_soils():
    """A coefficient, a digging and a cohesion that no soil has."""
    beyond = PRIOR + np.array([0.0, 0.0, 60.0, -5000.0, 9.0])
    found = assessed(beyond, (0.2, 0.01), (1.0, 0.0))[0]
    limits = PRIOR.copy()
    limits[2] = math.log(STIFFEST)
    limits[3] = 0.0
    limits[4] = math.log(MOST_DIGGING / SETTING[0].dig_gain)
    np.testing.assert_allclose(found, assessed(limits, (0.2, 0.01), (1.0, 0.0))[0], rtol=1e-6)
    assert np.all(np.isfinite(found))


def test_the_wheels_that_are_asked_for_are_assessed():
    estimates = PRIOR + np.outer([0.0, 0.1, -0.1], [1.0, 1.0, 1.0, 100.0, 1.0])
    pulls = np.array([[0.1, 0.01], [0.2, 0.02], [0.3, 0.03]])
    seen = np.array([[1.0, 0.0], [0.9, 0.1], [1.1, -0.1]])
    out = assessed(estimates, pulls, seen, rows=(2, 0))
    assert np.all(np.isnan(out[1]))
    for k in (0, 2):
        np.testing.assert_array_equal(out[k], assessed(estimates[k], pulls[k], seen[k])[0])
