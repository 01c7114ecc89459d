"""Borders: where a camera or the forces show one, none where the pitch changes; the blend of two
soils.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from soil_env.identification import Status
from soil_env.identification.online import borders
from soil_env.identification.online.identifier import MOVED
from soil_env.identification.online.memory import HERE, OLD, PLACE, QUANTITIES, SOIL
from soil_env.parameters.readings import Image
from tests.identification.observing import PLAIN, SAND, Identified, driven

LENGTH = PLAIN.belief.border
(STEADY,) = driven(SAND, [0.2], PLAIN, speed=0.3)
SLIPS = 0.3 + 0.2 * np.sin(0.12 * np.arange(200))
STEP = STEADY.speed * PLAIN.control.period


share_at = np.vectorize(borders.share_at)  # (shares, slopes) at many distances


@given(st.floats(-3.0, 3.0), st.floats(0.01, 10.0))
@settings(deadline=None)
def test_the_share_of_the_new_soil_is_a_smooth_step(behind, length):
    """From 0 to 1 over a length, the same from both sides; its slope by finite differences."""
    h = 1e-6
    at = np.array([behind, -behind, behind + h, behind - h])
    (share, other, ahead, back), slopes = share_at(at * length, length)
    assert share + other == pytest.approx(1.0)
    assert slopes[0] * length == pytest.approx((ahead - back) / (2.0 * h), abs=1e-5)
    assert share == np.clip(share, 0.0, 1.0)
    if abs(behind) >= 0.5:
        assert (share, slopes[0]) == (float(behind > 0.0), 0.0)


@pytest.mark.parametrize("rise_deg", [-12.0, 4.0])
def test_another_grade_is_no_border(rise_deg):
    """Forces at the load of another slope are those of the same soil."""
    wheel = Identified(PLAIN)
    wheel.observe(driven(SAND, SLIPS, PLAIN))
    pitch = math.radians(rise_deg)
    load = PLAIN.weight * math.cos(pitch)
    rows = driven(SAND, SLIPS, PLAIN, load=load)
    wheel.observe([r._replace(pitch=pitch) for r in rows])
    assert wheel.now.borders == 0 and wheel.now.points > 30


def seen(left, label, here=0.0, taken=0.0):
    """An `Image` in which the ground of the line taken changes in `left` metres to `label`."""
    beside = 2.0 if taken == 0.0 else label
    straight = label if taken == 0.0 else 2.0
    return Image(1, 1.0, left, here, 1.0, 1.0, 2, taken, straight, beside, 0.0, 0.0)


def test_a_camera_sees_where_another_class_begins():
    """Once the wheel comes to the passage, on either line, and not where the class goes on."""
    for taken in (0.0, 1.0):
        wheel = Identified(PLAIN)
        wheel.observe([STEADY] * 30)
        for left, label in ((0.6 * LENGTH, 1.0), (0.4 * LENGTH, 0.0)):
            assert not wheel.see_border(seen(left, label, taken=taken), 0.04)
        assert wheel.see_border(seen(0.4 * LENGTH, 1.0, taken=taken), 0.04)
        assert wheel.now.border == pytest.approx(wheel.now.place + 0.4 * LENGTH)
        assert wheel.now.border_variance == pytest.approx(0.04**2)
        assert not wheel.see_border(seen(0.3 * LENGTH, 1.0, taken=taken), 0.04)
        assert wheel.now.borders == 1


def test_another_soil_begins_at_its_prior_and_the_old_one_is_kept():
    """What was known, doubted a little, is the prior of the old soil; its instruments are not."""
    wheel = Identified(PLAIN)
    wheel.observe(driven(SAND, np.linspace(0.1, 0.5, 60), PLAIN))
    before = wheel.memory.copy()[0]
    assert before.cells_kept > 1
    wheel.begin_border(7.0, 0.2**2)
    now = wheel.now
    doubted = np.linalg.inv(borders.OLD_DOUBT * before.covariance)
    sd = np.sqrt(np.diag(before.covariance))
    unit = np.outer(sd, sd)
    np.testing.assert_allclose(now.old_precision * unit, doubted * unit, rtol=1e-6, atol=1e-6)
    for found, expected in (
        (now.old_mean, before.u[:SOIL]),
        (now.u[OLD:], before.u[:SOIL]),
        (now.u[:SOIL], wheel.set.soil_mean),
        (now.covariance, wheel.set.soil_covariance),
        (now.u[SOIL:HERE], 0.0),
        (now.old, before.estimate),
        (now.fresh, wheel.set.prior),
    ):
        np.testing.assert_array_equal(found, expected)
    assert (now.u[PLACE], now.border, now.border_variance) == (7.0, 7.0, 0.2**2)
    assert (now.behind, now.crossing, now.borders, now.cells_kept) == (1, 1.0, 1, 0)


@pytest.mark.parametrize("behind", [-0.5, -0.3, 0.0, 0.2, 0.5])
def test_on_a_border_it_is_a_blend_that_is_as_sure_as_its_place(behind):
    """Against draws of both soils and of the place."""
    wheel = Identified(PLAIN)
    now = wheel.now
    now.border = 1.0
    now.border_variance = 0.01**2
    now.place = 1.0 + behind * LENGTH
    now.old[:] = np.arange(QUANTITIES)
    now.old_sd[:] = 0.2
    now.fresh[:] = np.arange(QUANTITIES) + 1.0
    now.fresh_sd[:] = 0.3
    borders.blend_estimates(now, now, wheel.set)
    rng = np.random.default_rng(3)
    draws = 50_000
    old = now.old[1] + 0.2 * rng.normal(size=draws)
    fresh = now.fresh[1] + 0.3 * rng.normal(size=draws)
    share = share_at(behind * LENGTH - 0.01 * rng.normal(size=draws), LENGTH)[0]
    ground = old + share * (fresh - old)
    assert now.estimate[1] == pytest.approx(ground.mean(), abs=0.01)
    assert now.sd[1] == pytest.approx(ground.std(), rel=0.03)


def test_behind_a_border_the_ground_is_of_the_new_soil():
    """Every reading on it moves the estimate; at its end the fresh one is published."""
    wheel = Identified(PLAIN)
    wheel.observe([STEADY] * 20)
    wheel.begin_border(wheel.now.place + 0.3 * LENGTH, (0.1 * LENGTH) ** 2)
    # the middle lies 0.3 of the length ahead, and the end half of the length behind it
    readings = math.ceil(0.8 * LENGTH / STEP) - 1
    outcomes = wheel.observe([STEADY] * readings)
    assert min(outcomes) >= MOVED and wheel.now.crossing > 0.0
    wheel.observe([STEADY] * 3)
    assert wheel.now.crossing == 0.0
    np.testing.assert_array_equal(wheel.now.estimate, wheel.now.fresh)
    np.testing.assert_array_equal(wheel.now.sd, wheel.now.fresh_sd)


def test_behind_a_border_a_soil_without_points_is_not_known():
    """The status is of what is published, though no point has renewed it since."""
    wheel = Identified(PLAIN)
    wheel.observe(driven(SAND, SLIPS, PLAIN))
    assert Status(wheel.now.status) == Status.CONVERGED
    assert wheel.see_border(seen(0.4 * LENGTH, 1.0), 0.04)
    wheel.observe([STEADY._replace(rim_speed=2.0 * STEADY.rim_speed), STEADY] * 12)
    assert wheel.now.crossing == 0.0 and wheel.now.points == 0
    assert Status(wheel.now.status) == Status.NOT_EXCITED
    told = Identified(PLAIN)  # of a border before its first point
    told.begin_border(told.now.place, (0.1 * LENGTH) ** 2)
    told.observe([STEADY._replace(rim_speed=2.0 * STEADY.rim_speed), STEADY] * 12)
    assert Status(told.now.status) == Status.NO_DATA


def test_cells_on_a_border_have_an_error_of_their_place():
    """Those before and behind have none."""
    wheel = Identified(PLAIN)
    wheel.observe([STEADY] * 19)  # a point begins with the last
    assert np.all(wheel.cells["place_error"] == 0.0)
    middle = wheel.now.place + 0.5 * LENGTH
    wheel.begin_border(middle, (0.1 * LENGTH) ** 2)
    wheel.observe([STEADY] * 40)
    on = np.abs(wheel.cells["place"] - middle) < 0.5 * LENGTH
    assert np.any(on) and np.any(~on)
    np.testing.assert_array_equal(wheel.cells["place_error"] > 0.0, on)
