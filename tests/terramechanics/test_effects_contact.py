"""Contact arc and shear law of the named effects: golden values, limits, and slopes against differences."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from soil_env.terramechanics import arc_integrals as quadrature, contact, effects
from soil_env.terramechanics.effects import NO_EFFECTS, grousers, pack_effects, shear_softening


def on(name, **parameters):
    """`Effects` with one effect on."""
    return pack_effects({name: parameters})


# --- contact arc ------------------------------------------------------------------------------------------------------


def test_ends_of_the_arc():
    """theta1 = 0.8: exit at -l theta1, peak midway or at theta1/2, moved by (a + c |i|) theta1."""
    assert effects.arc_ends(0.8, 0.3, NO_EFFECTS) == pytest.approx((0.0, 0.4))
    assert effects.arc_ends(0.8, 0.3, on("rear_contact", ratio=0.5)) == pytest.approx((-0.4, 0.2))
    assert effects.arc_ends(0.8, 0.3, on("rear_contact", ratio=0.5, peak_follows=0.0)) == pytest.approx((-0.4, 0.4))
    for slip in (0.3, -0.3):
        assert effects.arc_ends(0.8, slip, on("stress_peak_shift", offset=0.05, slope=0.5))[1] == pytest.approx(0.56)


@settings(deadline=None)
@given(
    theta1=st.floats(1e-3, 3.0),
    slip=st.floats(-1.0, 1.0),
    ratio=st.floats(0.0, 0.95),
    follows=st.floats(0.0, 1.0),
    offset=st.floats(-0.4, 0.4),
    slope=st.floats(-0.6, 0.9),
)
def test_the_peak_lies_inside_the_arc(theta1, slip, ratio, follows, offset, slope):
    fx = pack_effects({
        "rear_contact": {"ratio": ratio, "peak_follows": follows},
        "stress_peak_shift": {"offset": offset, "slope": slope},
    })  # fmt: skip
    theta2, thetam = effects.arc_ends(theta1, slip, fx)
    assert -theta1 < theta2 <= 0.0
    assert theta2 + 0.049 * (theta1 - theta2) < thetam < theta1 - 0.049 * (theta1 - theta2)


def test_shear_radius_of_ding():
    """r + l h over r: 0.15 + 0.5 x 0.03 over 0.15."""
    assert grousers.shear_radius_ratio(0.15, 0.03, on("grousers", shear_share=0.5)) == pytest.approx(1.1)
    assert grousers.shear_radius_ratio(0.15, 0.03, NO_EFFECTS) == 1.0


# --- shear law --------------------------------------------------------------------------------------------------------

J = np.linspace(0.0, 1.0, 20001)  # [m], to 50 K


def share(law, K=0.02):
    """Mobilised share of the strength at each displacement `J`."""
    return np.array([contact.mobilised(j, K, law)[0] for j in J])


def test_neutral_shear_law_is_that_of_janosi():
    for off in (NO_EFFECTS, on("shear_softening", sharpness=0.9, slope_kept=1.0)):
        np.testing.assert_array_equal(share(shear_softening.shear_law(off)), share(contact.JANOSI))
        assert shear_softening.shear_length_ratio(off) == 1.0
    np.testing.assert_allclose(share(contact.JANOSI), 1.0 - np.exp(-J / 0.02), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("sharpness", [1.5, 3.0, 8.0, 30.0])
def test_sharp_law_has_the_peak_1_and_its_residual(sharpness):
    """(1 - x)(1 + s x) is largest at x = (s - 1)/(2 s), where it is (1 + s)^2/(4 s)."""
    e = share(shear_softening.shear_law(on("shear_softening", sharpness=sharpness)))
    assert e.max() == pytest.approx(1.0, abs=1e-5)
    assert J[e.argmax()] == pytest.approx(-0.02 * math.log((sharpness - 1.0) / (2.0 * sharpness)), abs=1e-3)
    assert e[-1] == pytest.approx(4.0 * sharpness / (1.0 + sharpness) ** 2, rel=1e-6)


def test_a_law_that_is_not_sharp_has_no_peak():
    e = share(shear_softening.shear_law(on("shear_softening", sharpness=1.0)))
    assert np.all(np.diff(e) >= -1e-12)
    assert e[-1] == pytest.approx(1.0)


@pytest.mark.parametrize("sharpness", [1.0, 2.0, 8.0])
def test_the_first_slope_can_be_kept(sharpness):
    """K is then that of Janosi & Hanamoto, de/dj = 1/K at rest, and at s = 1 the whole law is theirs."""
    fx = on("shear_softening", sharpness=sharpness, slope_kept=1.0)
    law, K = shear_softening.shear_law(fx), 0.02 * shear_softening.shear_length_ratio(fx)
    assert contact.mobilised(0.0, K, law)[1] == pytest.approx(1.0 / 0.02)
    assert shear_softening.shear_length_ratio(on("shear_softening", sharpness=sharpness)) == 1.0
    if sharpness == 1.0:
        np.testing.assert_allclose(share(law, K), share(contact.JANOSI), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("residual", [0.4, 0.65, 0.9])
def test_wongs_law_is_of_the_family(residual):
    """Wong & Preston-Thomas (1983): Kr {1 + [1/(Kr (1 - 1/e)) - 1] e^(1 - j/K)} (1 - e^(-j/K)), over its maximum."""
    x = np.exp(-J / 0.02)
    wong = residual * (1.0 + (1.0 / (residual * (1.0 - math.exp(-1.0))) - 1.0) * math.e * x) * (1.0 - x)
    sharpness = math.e * (1.0 / (residual * (1.0 - math.exp(-1.0))) - 1.0)
    found = share(shear_softening.shear_law(on("shear_softening", sharpness=sharpness)))
    np.testing.assert_allclose(found, wong / wong.max(), rtol=1e-4, atol=1e-7)


def test_decaying_law_of_oida():
    """(1 - e^(-j/K))(1 - d + d e^(-j/L)) with K = 0.02, d = 0.4, L = 0.1 at j = 0.04 and far on."""
    law = shear_softening.shear_law(on("shear_softening", drop=0.4, length=0.1))
    expected = (1.0 - math.exp(-2.0)) * (0.6 + 0.4 * math.exp(-0.4))
    assert contact.mobilised(0.04, 0.02, law)[0] == pytest.approx(expected, rel=1e-6)
    assert contact.mobilised(5.0, 0.02, law)[0] == pytest.approx(0.6, rel=1e-6)


def test_decay_from_an_onset():
    """Nothing is lost up to j0 = 0.03, and beyond it the decay counts from there."""
    law = shear_softening.shear_law(on("shear_softening", drop=0.4, length=0.1, onset=0.03))
    for j in (0.01, 0.03):
        assert contact.mobilised(j, 0.02, law)[0] == pytest.approx(1.0 - math.exp(-j / 0.02), rel=1e-6)
    expected = (1.0 - math.exp(-3.5)) * (0.6 + 0.4 * math.exp(-0.4))
    assert contact.mobilised(0.07, 0.02, law)[0] == pytest.approx(expected, rel=1e-6)


softening = st.fixed_dictionaries(
    {
        "sharpness": st.floats(1.0, 30.0),
        "drop": st.floats(0.0, 0.9),
        "length": st.floats(2e-3, 1.0),
        "onset": st.floats(0.0, 0.5),
    }
)


@settings(max_examples=200, deadline=None)
@given(parameters=softening, relative=st.floats(0.01, 8.0), k=st.floats(1e-3, 0.3), sign=st.sampled_from([-1.0, 1.0]))
def test_slope_of_the_shear_law(parameters, relative, k, sign):
    """de/dj against central differences; e is odd in j, its slope even."""
    law, j = shear_softening.shear_law(on("shear_softening", **parameters)), sign * relative * k
    h = 1e-4 * min(k, abs(j), parameters["length"])
    assume(abs(abs(j) - parameters["onset"]) > h)  # a kink
    e, slope = contact.mobilised(j, k, law)
    difference = (contact.mobilised(j + h, k, law)[0] - contact.mobilised(j - h, k, law)[0]) / (2.0 * h)
    scale = 1.0 / k + 1.0 / parameters["length"]
    assert slope == pytest.approx(difference, rel=1e-4, abs=1e-5 * scale)
    assert contact.mobilised(-j, k, law) == (-e, slope)


@pytest.mark.parametrize(
    "law", [contact.ShearLaw(0.4, 2.0, 0.3, 0.01, 0.02), contact.ShearLaw(1.0, -0.5, -0.2, 0.5, 0.0)]
)
def test_slope_of_a_general_shear_law_in_lanes(law):
    """The rates of the arc integrals, which take de/dj in lanes, against differences of the integrals."""
    motion, step = np.array([1.0, 0.6]), 1e-6

    def shear(motion):
        return np.array(quadrature.arc_integrals(0.8, -0.2, 0.35, *motion, 0.03, 0.9, 0.2, law)[0])[2:]

    _, by_rim, by_travel = quadrature.arc_integrals(0.8, -0.2, 0.35, *motion, 0.03, 0.9, 0.2, law)
    for rates, d in ((by_rim, np.array([step, 0.0])), (by_travel, np.array([0.0, step]))):
        np.testing.assert_allclose(rates, (shear(motion + d) - shear(motion - d)) / (2.0 * step), rtol=1e-6, atol=1e-9)
