"""Borders: the blend of two soils, the place of a change of the grade against dense Gaussians,
where one is found, and none where there is none.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.special import softmax
from scipy.stats import multivariate_normal

from soil_env.identification.online import borders
from soil_env.identification.online.identifier import MOVED
from soil_env.identification.online.memory import HERE, OLD, PLACE, PUBLISHED, SOIL
from soil_env.parameters import Belief, load_scenario, soils
from tests.identification.observing import Identified, driven, shares_at

SCENARIO = replace(load_scenario("mixed"), belief=Belief())
LENGTH = SCENARIO.belief.border
NOISE = SCENARIO.noise.pitch
SAND = soils()["dry_sand"].state(SCENARIO.wheel.width)
(STEADY,) = driven(SAND, [0.2], SCENARIO, speed=0.3)
STEP = STEADY.speed * SCENARIO.control.period


def share_at(behind, length=LENGTH):
    """(shares, slopes) at distances [n]."""
    behind = np.atleast_1d(np.asarray(behind, dtype=float))
    out = np.empty((len(behind), 2))
    shares_at(behind, length, out)
    return out.T


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


def on_border(places, pitches, grade, first):
    """A wheel that has noticed a border at `first` and read `pitches` at these places."""
    wheel = Identified(SCENARIO)
    wheel.observe([STEADY] * 8)
    now = wheel.now
    now.grade = grade
    now.grades = 30.0
    now.place = first
    wheel.begin_border(first, 0.1**2)
    now.border_places[: len(places)] = places
    now.border_pitches[: len(places)] = pitches
    now.pitches_kept = len(places)
    return wheel


@pytest.mark.parametrize("seed", range(6))
def test_the_place_of_a_border_is_that_of_bayesian_regression(seed):
    """Mean and variance over places, each with the evidence of its rise, by dense Gaussians."""
    rng = np.random.default_rng(seed)
    first = 2.0
    grade = 0.05
    x = first + np.cumsum(rng.uniform(0.01, 0.04, rng.integers(3, 12)))
    middle = first + rng.uniform(0.0, 0.1)
    pitches = grade + 0.1 * share_at(x - middle)[0] + NOISE * rng.normal(size=len(x))
    wheel = on_border(x, pitches, grade, first)
    wheel.put_on_border(0)
    n = len(x)
    places = LENGTH * (np.arange(borders.TRIED) / (borders.TRIED - 1.0) + borders.TRIED_FROM)
    variance = NOISE**2 * (1.0 + 1.0 / 30.0)
    evidence = []
    for place in places:
        w = share_at(x - first - place)[0]
        covariance = variance * np.eye(n) + borders.RISE_VARIANCE * np.outer(w, w)
        evidence.append(multivariate_normal(np.zeros(n), covariance).logpdf(pitches - grade))
    weight = softmax(evidence)
    mean = weight @ places
    assert wheel.now.border == pytest.approx(first + mean, abs=1e-9)
    spread = weight @ (places - mean) ** 2
    stated = spread + (borders.LEAST_PLACE_SD * LENGTH) ** 2
    assert wheel.now.border_variance == pytest.approx(stated, rel=1e-6)


def drive(rise, rng, end=3.0, middle=1.5, slower=1.0):
    """(places of borders that were noticed, place and sd of the last as known on its end or None)
    of a drive over a change of the grade by `rise` [rad], so many times `slower`.
    """
    wheel = Identified(SCENARIO)
    reading = STEADY._replace(speed=STEADY.speed / slower, rim_speed=STEADY.rim_speed / slower)
    places = []
    known = None
    x = 0.0
    while x < end:
        x += STEP / slower
        pitch = 0.05 + rise * share_at(x - middle)[0][0] + NOISE * rng.standard_normal()
        crossed = wheel.now.borders
        wheel.observe([reading._replace(pitch=pitch)])
        if wheel.now.borders > crossed:
            places.append(x)
        if wheel.now.crossing > 0.0:
            known = wheel.now.border, math.sqrt(wheel.now.border_variance)
    return places, known


@pytest.mark.parametrize(
    ("rise_deg", "slower"), [(-12.0, 1.0), (-4.0, 1.0), (4.0, 1.0), (12.0, 1.0), (4.0, 5.0)]
)
def test_a_change_of_the_grade_is_found_where_it_is(rise_deg, slower):
    """Once, on the border, and located to a tenth of its length, about as well as stated."""
    rng = np.random.default_rng(1)
    found = [drive(math.radians(rise_deg), rng, slower=slower) for _ in range(30)]
    once = [places[0] for places, _ in found if len(places) == 1]
    assert len(once) >= 27
    assert np.all(np.abs(np.array(once) - 1.5) < 0.5 * LENGTH + 2.0 * STEP)
    place, sd = np.array([known for places, known in found if len(places) == 1]).T
    assert np.median(np.abs(place - 1.5)) < 0.1 * LENGTH and np.median(sd) < 0.15 * LENGTH
    assert np.mean(((place - 1.5) / sd) ** 2) < 2.0


def test_a_grade_that_stays_is_no_border():
    """Courses of six metres of one grade: nine of ten at least have none."""
    rng = np.random.default_rng(2)
    false = sum(bool(drive(0.0, rng, end=6.0)[0]) for _ in range(60))
    assert false <= 6


def test_a_grade_that_changes_before_the_first_point_is_no_border():
    """While a wheel spins on the spot, say: the first soil that it learns of has the new grade."""
    wheel = Identified(SCENARIO)
    spinning = STEADY._replace(slip=0.97, speed=0.03 * STEADY.rim_speed)
    wheel.observe([spinning] * 20 + [spinning._replace(pitch=0.1)] * 20)
    assert wheel.now.points == 0
    wheel.observe([STEADY._replace(pitch=0.1)] * 30)
    assert wheel.now.borders == 0


def test_where_the_pitch_says_nothing_none_is_looked_for_by_it():
    belief = replace(SCENARIO.belief, grade_change_deg=0.0)
    wheel = Identified(replace(SCENARIO, belief=belief))
    wheel.observe([STEADY] * 40 + [STEADY._replace(pitch=0.08)] * 40)
    assert wheel.now.borders == 0


def test_another_soil_begins_at_its_prior_and_the_old_one_is_kept():
    """What was known, doubted a little, is the prior of the old soil; its instruments are not."""
    wheel = Identified(SCENARIO)
    wheel.observe(driven(SAND, np.linspace(0.1, 0.5, 60), SCENARIO))
    before = wheel.memory.copy()[0]
    assert before.cells_kept > 1
    wheel.begin_border(7.0, 0.2**2)
    now = wheel.now
    np.testing.assert_array_equal(now.old_mean, before.u[:SOIL])
    np.testing.assert_array_equal(now.u[OLD:], before.u[:SOIL])
    doubted = np.linalg.inv(borders.OLD_DOUBT * before.covariance)
    sd = np.sqrt(np.diag(before.covariance))
    unit = np.outer(sd, sd)
    np.testing.assert_allclose(now.old_precision * unit, doubted * unit, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(now.u[:SOIL], wheel.set.soil_mean)
    np.testing.assert_array_equal(now.covariance, wheel.set.soil_covariance)
    np.testing.assert_array_equal(now.u[SOIL:HERE], 0.0)
    assert (now.u[PLACE], now.border, now.border_variance) == (7.0, 7.0, 0.2**2)
    assert (now.behind, now.crossing, now.borders, now.cells_kept) == (1, 1.0, 1, 0)
    np.testing.assert_array_equal(now.old, before.estimate)
    np.testing.assert_array_equal(now.fresh, wheel.set.prior)


def blended(behind, sd=0.02):
    """A wheel at a distance behind the middle of a border, whose place has an `sd`, with what is
    published.
    """
    wheel = Identified(SCENARIO)
    now = wheel.now
    now.border = 1.0
    now.border_variance = sd**2
    now.place = 1.0 + behind
    now.old[:] = np.arange(PUBLISHED)
    now.old_sd[:] = 0.2
    now.fresh[:] = np.arange(PUBLISHED) + 1.0
    now.fresh_sd[:] = 0.3
    wheel.blend()
    return wheel


@pytest.mark.parametrize(("behind", "name"), [(-0.5, "old"), (0.5, "fresh")])
def test_at_the_ends_of_a_border_it_is_one_soil(behind, name):
    wheel = blended(behind * LENGTH)
    np.testing.assert_allclose(wheel.now.estimate, getattr(wheel.now, name), rtol=1e-12)
    np.testing.assert_allclose(wheel.now.sd, getattr(wheel.now, f"{name}_sd"), rtol=1e-12)


@pytest.mark.parametrize("behind", [-0.3, 0.0, 0.2])
def test_on_a_border_it_is_a_blend_that_is_as_sure_as_its_place(behind):
    """Against draws of both soils and of the place."""
    wheel = blended(behind * LENGTH, sd=0.01)
    rng = np.random.default_rng(3)
    draws = 200_000
    old = wheel.now.old[1] + 0.2 * rng.normal(size=draws)
    fresh = wheel.now.fresh[1] + 0.3 * rng.normal(size=draws)
    share = share_at(behind * LENGTH - 0.01 * rng.normal(size=draws))[0]
    ground = old + share * (fresh - old)
    assert wheel.now.estimate[1] == pytest.approx(ground.mean(), abs=0.01)
    assert wheel.now.sd[1] == pytest.approx(ground.std(), rel=0.03)


def test_behind_a_border_the_ground_is_of_the_new_soil():
    """Every reading on it moves the estimate; at its end the fresh one is published and the grade
    begins anew.
    """
    wheel = Identified(SCENARIO)
    wheel.observe([STEADY] * 20)
    wheel.begin_border(wheel.now.place + 0.3 * LENGTH, (0.1 * LENGTH) ** 2)
    readings = math.ceil(0.8 * LENGTH / STEP) - 1
    outcomes = wheel.observe([STEADY] * readings)
    assert min(outcomes) >= MOVED and wheel.now.crossing > 0.0
    wheel.observe([STEADY] * 3)
    assert wheel.now.crossing == 0.0
    np.testing.assert_array_equal(wheel.now.estimate, wheel.now.fresh)
    np.testing.assert_array_equal(wheel.now.sd, wheel.now.fresh_sd)


def test_cells_on_a_border_have_an_error_of_their_place():
    """Those before and behind have none."""
    wheel = Identified(SCENARIO)
    wheel.observe([STEADY] * 20)
    assert np.all(wheel.cells["place_error"] == 0.0)
    middle = wheel.now.place + 0.5 * LENGTH
    wheel.begin_border(middle, (0.1 * LENGTH) ** 2)
    wheel.observe([STEADY] * 40)
    on = np.abs(wheel.cells["place"] - middle) < 0.5 * LENGTH
    assert np.any(on) and np.any(~on)
    np.testing.assert_array_equal(wheel.cells["place_error"] > 0.0, on)
