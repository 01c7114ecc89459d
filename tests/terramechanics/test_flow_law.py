"""Soil that flows along the rim: closed form against quadrature, limits, and one law in the world
and in steady state.
"""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings, strategies as st
from scipy.optimize import brentq

from soil_env.parameters import SoilState, soils
from soil_env.slip import motion_from_slip
from soil_env.terramechanics import contact
from soil_env.terramechanics.effects.slip_sinkage import slip_sinkage_ratio
from soil_env.terramechanics.steady import steady_state
from tests.terramechanics import reference
from tests.terramechanics.arcs import arc_integrals
from tests.terramechanics.cases import EQUATION_10, FLOW
from tests.terramechanics.test_reaction import R, ground_under, react, wheel_with

LOAD = 150.0  # [N]
SLIPS = (-1.0, -0.9, -0.6, -0.3, -0.1, -0.02, 0.0, 0.05, 0.3, 0.7, 0.95)

#: `SoilState` with flow: K of 0.01 to 0.5 radii, a pressure of 4 to 316 kPa at 1 cm.
soil_with_flow = st.builds(
    lambda phi, c, k, pressure, n, gain, a, peak, growth: SoilState(
        math.tan(math.radians(phi)),
        c,
        10.0**k * R,
        10.0**pressure / 0.01**n,
        n,
        gain,
        0.5,
        a,
        peak,
        growth,
        0.5 * R,
    ),
    st.floats(5.0, 45.0),
    st.floats(0.0, 1500.0),
    st.floats(-2.0, -0.3),
    st.floats(3.6, 5.5),
    st.floats(0.3, 1.5),
    st.floats(0.0, 2.0),
    st.floats(0.01, 0.12),
    st.floats(0.0, 0.9),
    st.floats(0.0, 1.5),
)


@pytest.mark.parametrize(
    ("depth", "flow", "plain"),
    [(0.003, -0.005, -0.002), (0.01, -0.043, -0.005), (0.03, -0.084, -0.016)],
)
def test_the_slip_of_free_rolling_grows_with_the_sinkage(depth, flow, plain):
    """Slip without torque at a sinkage of `depth` radii, as docs/physics/contact.md has it."""
    soil = soils()["dry_sand"].state(R)._replace(cohesion=0.0, dig_gain=0.0)

    def at(slip, exponent, law):
        firm = soil._replace(sinkage_coefficient=10.0**exponent, **law)
        return steady_state(slip, LOAD, firm, R, R)

    exponent = brentq(lambda e: at(-0.01, e, {}).sinkage / R - depth, 5.0, 12.0)
    with_flow = brentq(lambda i: at(i, exponent, {}).torque, -0.3, 0.1)
    without = brentq(lambda i: at(i, exponent, EQUATION_10).torque, -0.3, 0.1)
    assert (with_flow, without) == pytest.approx((flow, plain), abs=6e-4)


def nearly_locked(phi, S, n, gain, flow, peak):
    """`SoilState` with K = 0.01 radii and no cohesion; `phi` in degrees."""
    state = (math.tan(math.radians(phi)), 0.0, 0.01 * R, S, n, gain, 0.5, flow, peak, 0.0, 0.5 * R)
    return SoilState(*state)


@settings(max_examples=60, deadline=None)
@example(soil=soils()["dry_sand"].state(R)._replace(**FLOW), slip=-1.0)
# shear builds up within a thousandth of the arc, on both sides of its turn
@example(soil=nearly_locked(45.0, 6.95e6, 1.48, 1.66, 0.05, 0.63), slip=-0.972)
@example(soil=nearly_locked(32.2, 7.52e6, 1.33, 0.81, 0.026, 0.83), slip=-0.989)
# no turn, and a stress peak far ahead
@example(soil=nearly_locked(45.0, 1.84e8, 1.44, 1.68, 0.088, 0.87), slip=-0.887)
@given(soil=soil_with_flow, slip=st.one_of(st.floats(-1.0, 1.0), st.floats(-1.0, 0.0)))
def test_steady_forces_are_those_of_quadrature(soil, slip):
    """The balance of Eq. (1) and both forces, to 1e-4 of the load, or of 0.3 of the sum of all
    stresses.

    With slip-sinkage the pressure is that of the depth without it.
    """
    assume(slip == -1.0 or slip > -0.9999)  # next to a locked wheel quadrature is hard
    at = steady_state(slip, LOAD, soil, R, R)
    assume(at.supported)
    theta1 = math.acos(1.0 - at.sinkage / R)
    ratio = slip_sinkage_ratio(slip, soil.dig_gain, soil.dig_recovery)
    braked = max(-slip, 0.0)
    judged = reference.Ground(
        math.degrees(math.atan(soil.tan_phi)),
        soil.cohesion,
        soil.shear_modulus * (R * theta1 / soil.shear_length) ** soil.shear_growth,
        soil.sinkage_coefficient / ratio**soil.sinkage_exponent,
        soil.sinkage_exponent,
    )
    peak = (0.5 + soil.braked_peak * braked / (1.0 + braked)) * theta1
    judge = reference.forces(judged, slip, theta1, R, R, 0.0, peak, soil.rim_flow)
    off = (
        judge.load - LOAD,
        judge.drawbar_pull - at.drawbar_pull,
        (judge.torque - at.torque) / R,
    )
    assert max(map(abs, off)) < 1e-4 * max(LOAD, 0.3 * judge.scale)


def test_an_arc_in_which_the_shear_turns_needs_the_split():
    """Change of the shear forces by `split`, over the load of the normal stress alone: 400 braked
    arcs with K/r of 0.002 to 0.01, without cohesion.
    """
    rng = np.random.default_rng(0)
    off = []
    for _ in range(400):
        theta1 = rng.uniform(0.2, 1.2)
        slip = rng.uniform(-0.98, -0.02)
        K = R * math.exp(rng.uniform(math.log(0.002), math.log(0.01)))
        n = rng.uniform(0.3, 1.5)
        tan_phi = math.tan(rng.uniform(0.1, 0.8))
        arc = (theta1, 0.0, 0.5 * theta1, *motion_from_slip(slip), K, n, R)
        plain, split = (arc_integrals(*arc, split=of) for of in (False, True))
        change = max(abs(plain.pe_cos - split.pe_cos), abs(plain.pe - split.pe))
        off.append(tan_phi * change / plain.p_cos)
    assert np.quantile(off, 0.9) == pytest.approx(1.2e-3, rel=0.1)
    assert np.max(off) == pytest.approx(0.063, rel=0.05)


@pytest.mark.parametrize("name", sorted(soils()))
def test_without_flow_it_is_equation_10(name):
    """The length that K belongs to does not matter then; a little flow changes little."""
    soil = soils()[name].state(R)._replace(**EQUATION_10)
    for slip in SLIPS:
        plain = steady_state(slip, LOAD, soil, R, R)
        assert steady_state(slip, LOAD, soil._replace(shear_length=1.7), R, R) == plain
        if slip >= 0.0:  # a braked arc is integrated better with flow
            little = steady_state(slip, LOAD, soil._replace(rim_flow=1e-9), R, R)
            np.testing.assert_allclose(little, plain, rtol=1e-6, atol=1e-6)


@settings(max_examples=100, deadline=None)
@given(soil=soil_with_flow, slip=st.just(-1.0) | st.floats(-1.0, 1.0))
def test_power_is_lost(soil, slip):
    """Also by a locked wheel, which is therefore not pushed forward."""
    at = steady_state(slip, LOAD, soil, R, R)
    assume(at.supported)
    rim, travel = motion_from_slip(slip)
    fastest = max(rim, travel)
    lost = (at.torque / R * rim - at.drawbar_pull * travel) / fastest
    assert lost > 0.0


@pytest.mark.parametrize("name", sorted(soils()))
def test_a_locked_wheel_is_dragged_and_held_by_its_brake(name):
    """Pull backward, and a torque that would turn the wheel forward while its axle is above the
    ground.
    """
    locked = steady_state(-1.0, LOAD, soils()[name].state(R), R, R)
    assert locked.drawbar_pull < 0.0
    assert locked.torque < 0.0 or locked.sinkage > R


@settings(max_examples=200, deadline=None)
@given(
    rim=st.floats(-1.0, 1.0),
    travel=st.floats(-1.0, 1.0),
    carry=st.floats(0.0, 0.6),
    most=st.floats(0.3, 1.0),
)
def test_the_carried_share_is_bounded_smooth_and_mirrored(rim, travel, carry, most):
    """Derivatives by central differences; with both speeds reversed it is the same."""
    assume(math.hypot(rim, travel) > 1e-2)  # else it varies within a step of the differences
    floor = 1e-2

    def share(rim, travel):
        free, by_rim, by_travel = contact.carried_share(rim, travel, floor)
        found, by_share, _ = contact.held_below(carry * free, most)
        return found, carry * by_share * by_rim, carry * by_share * by_travel

    found, by_rim, by_travel = share(rim, travel)
    assert 0.0 <= found <= min(most, 9.1 * carry)
    assert share(-rim, -travel)[0] == found
    h = 1e-7
    size = 1e-3 * (abs(by_rim) + abs(by_travel)) + 1e-3  # curvature has jumps
    ahead, behind = share(rim + h, travel)[0], share(rim - h, travel)[0]
    assert by_rim == pytest.approx((ahead - behind) / (2.0 * h), abs=size)
    ahead, behind = share(rim, travel + h)[0], share(rim, travel - h)[0]
    assert by_travel == pytest.approx((ahead - behind) / (2.0 * h), abs=size)


@pytest.mark.parametrize("slip", [s for s in SLIPS if s < 0.95])
@pytest.mark.parametrize("name", ["dry_sand", "lete_sand", "grenville_loam"])
def test_the_world_has_the_law_of_the_steady_state(name, slip):
    """The reaction at the steady sinkage, with V = 3 m/s far above the speed of rest."""
    soil = soils()[name].state(R)._replace(**FLOW, dig_gain=0.0)
    at = steady_state(slip, LOAD, soil, R, R)
    rim, travel = motion_from_slip(slip)
    v, u = 3.0, 3.0 * rim / travel
    wheel = wheel_with("none")
    f = react(ground_under(at.sinkage, v, u, soil, wheel), v, u, LOAD, wheel)
    assert f.drawbar_pull == pytest.approx(at.drawbar_pull, abs=2e-4 * LOAD)
    assert f.torque == pytest.approx(at.torque, abs=2e-4 * LOAD * R)
    assert f.sinkage_coefficient == pytest.approx(soil.sinkage_coefficient, rel=1e-3)
