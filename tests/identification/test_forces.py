"""Forces at a measured slip and sinkage: against quadrature, the steady state of terramechanics,
and finite differences.
"""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from soil_env.parameters import soils
from soil_env.terramechanics.contact import layer_firmness
from soil_env.terramechanics.effects.slip_sinkage import slip_sinkage_ratio
from soil_env.terramechanics.steady import steady_state
from tests.identification.observing import react, reactions
from tests.terramechanics import reference
from tests.terramechanics.cases import FLOW

PULL, TORQUE, LN_S = range(3)
R = 0.15  # [m]
B = 0.12
LOAD = 150.0  # [N]
UNIT = np.array([LOAD, LOAD * R, 1.0])  # of what `react` gives

ground = st.tuples(
    st.floats(10.0, 42.0),  # [deg]
    st.floats(0.0, 2500.0),  # [Pa]
    st.floats(0.3, 1.4),
    st.floats(math.log(0.003), math.log(0.08)),
)
driving = st.floats(0.0, 0.95)
braking = st.floats(-0.5, -0.01)
depth = st.floats(0.005, 0.6).map(lambda share: share * R)


def row_of(ground, sinkage, slip, load=LOAD):
    """Row of `react` on a soil (friction angle [deg], c [Pa], n, ln of K [m])."""
    return [math.tan(math.radians(ground[0])), *ground[1:], sinkage, slip, load, R, B]


@settings(max_examples=40, deadline=None)
@given(ground, depth, st.one_of(driving, braking))
def test_forces_are_those_of_the_equations(soil, sinkage, slip):
    """By adaptive quadrature of Eqs. (1)-(3): the load of a soil gives back its S, with the pull
    and the torque.

    Where the shear reverses within the arc the nodes see no kink, as in test_contact.
    """
    angle, cohesion, n, ln_K = soil
    S = 3e5
    bound = 1e-4 if slip >= 0.0 else 4e-3
    judged = reference.Ground(angle, cohesion, math.exp(ln_K), S, n)
    judge = reference.forces(judged, slip, math.acos(1.0 - sinkage / R), R, B)
    assume(judge.load > 0.1 * judge.scale)
    found = react(row_of(soil, sinkage, slip, judge.load))[0, :, 0]
    normal = judge.scale * bound
    assert found[PULL] == pytest.approx(judge.drawbar_pull, abs=2.0 * normal)
    assert found[TORQUE] == pytest.approx(judge.torque, abs=2.0 * normal * R)
    assert found[LN_S] == pytest.approx(math.log(S), abs=10.0 * bound)


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(soils())), st.floats(-0.4, 0.9), st.sampled_from([{}, FLOW]))
def test_at_the_steady_sinkage_the_forces_are_those_of_the_steady_state(name, slip, law):
    """The mobilised S is that of the soil over the ratio of slip-sinkage, to the n; firmer ground
    below a cover adds its own.
    """
    soil = soils()[name].state(B)._replace(**law)
    at = steady_state(slip, LOAD, soil, R, B)
    assume(at.supported)
    found = reactions(soil, at.sinkage, slip, LOAD, R, B)
    ratio = slip_sinkage_ratio(slip, soil.dig_gain, soil.dig_recovery)
    available = math.log(soil.sinkage_coefficient) - soil.sinkage_exponent * math.log(ratio)
    available += math.log(layer_firmness(at.sinkage, soil))
    assert found[PULL] == pytest.approx(at.drawbar_pull, abs=1e-3 * LOAD)
    assert found[TORQUE] == pytest.approx(at.torque, abs=1e-3 * LOAD * R)
    assert found[LN_S] == pytest.approx(available, abs=1e-3)


@settings(max_examples=80, deadline=None)
@given(ground, depth, st.one_of(driving, braking), st.sampled_from([(), (tuple(FLOW.values()),)]))
def test_derivatives_are_those_of_finite_differences(soil, sinkage, slip, law):
    """Central ones, to a millionth of the scale on which a quantity varies."""
    assume(not law or abs(slip) > 1e-3)  # the stress peak begins to move at slip 0
    row = row_of(soil, sinkage, slip)
    found = react(row, *law)[0]
    twice = react([*row[:6], 2.0 * row[6], *row[7:]], *law)[0]
    # The normal stress bears a tenth of the load, which S is in proportion to: cohesion the rest.
    assume(twice[LN_S, 0] - found[LN_S, 0] < math.log(11.0))
    scales = np.array([0.3, 500.0, 0.3, 0.3, sinkage, 0.3])
    h = 1e-5
    ahead = np.tile(row, (6, 1))
    behind = ahead.copy()
    ahead[np.arange(6), np.arange(6)] += h * scales
    behind[np.arange(6), np.arange(6)] -= h * scales
    slopes = (react(ahead, *law)[:, :, 0] - react(behind, *law)[:, :, 0]).T / (2.0 * h)
    np.testing.assert_allclose(
        found[:, 1:] * scales / UNIT[:, None], slopes / UNIT[:, None], rtol=2e-6, atol=2e-6
    )
