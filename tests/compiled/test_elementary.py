"""Elementary functions against Python's `math`, with the errors that their module states."""

import math

import pytest
from hypothesis import example, given, settings, strategies as st

from soil_env._compiled import elementary

MANY = settings(max_examples=500, deadline=None)
HALF_TURN = st.floats(-math.pi, math.pi)


@MANY
@given(st.floats(-700.0, 700.0))
@example(0.0)
def test_exp(x):
    assert elementary.exp(x) == pytest.approx(math.exp(x), rel=3e-15)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_exp_is_cut(sign):
    assert elementary.exp(sign * 1e4) == elementary.exp(sign * 700.0)


@MANY
@given(st.floats(2.3e-308, 1e308))
@example(1.0)
@example(math.sqrt(0.5))
def test_log(x):
    assert elementary.log(x) == pytest.approx(math.log(x), rel=1e-15, abs=1e-15)


@MANY
@given(st.floats(1e-12, 1e12), st.floats(-3.0, 3.0))
def test_power(x, y):
    rounding = 2.3e-16 * abs(y * math.log(x))  # that of the exponent
    assert elementary.power(x, y) == pytest.approx(x**y, rel=4e-15 + 2.0 * rounding)


def test_power_of_zero():
    assert elementary.power(0.0, 0.7) < 1e-200


@MANY
@given(HALF_TURN)
@example(0.0)
@example(math.pi)
def test_sin_cos(x):
    assert elementary.half_sin(x) == pytest.approx(math.sin(0.5 * x), rel=0.0, abs=2e-15)
    assert elementary.half_cos(x) == pytest.approx(math.cos(0.5 * x), rel=0.0, abs=2e-15)
    sine, cosine = elementary.sin_cos(x)
    assert sine == pytest.approx(math.sin(x), rel=0.0, abs=4e-15)
    assert cosine == pytest.approx(math.cos(x), rel=0.0, abs=4e-15)


@MANY
@given(st.floats(0.0, 1.0))
@example(0.25)
@example(1.0)
def test_asin_root(t):
    assert elementary.asin_root(t) == pytest.approx(math.asin(math.sqrt(t)), rel=1e-14)


@MANY
@given(st.floats(-3.0, 3.0), st.floats(1e-3, 1.0))
def test_smoothed_sign(speed, floor):
    """The derivative is that of the value; the value is odd and reaches one."""
    value, slope = elementary.smoothed_sign(speed, floor)
    step = 1e-6 * floor
    ahead = elementary.smoothed_sign(speed + step, floor)[0]
    behind = elementary.smoothed_sign(speed - step, floor)[0]
    assert slope == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-5, abs=1e-8 / floor)
    assert value == -elementary.smoothed_sign(-speed, floor)[0] and abs(value) <= 1.0


@MANY
@given(st.floats(-0.5, 1.5))
def test_smooth_step(t):
    value, slope = elementary.smooth_step(t)
    inside = min(max(t, 0.0), 1.0)
    assert value == pytest.approx(3.0 * inside**2 - 2.0 * inside**3, abs=1e-15)
    assert slope == pytest.approx(6.0 * inside * (1.0 - inside), abs=1e-15)
