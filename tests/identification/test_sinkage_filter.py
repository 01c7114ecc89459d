"""The filter of the sinkage: its law against scipy, its moments against draws, what it learns of
pressure and gain.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp

from soil_env.identification.online import sinkage_filter as sf
from soil_env.identification.online.filter_bank import filter_numbers, new_banks, restart
from soil_env.identification.online.lanes.lanes import COUNT
from soil_env.parameters import Belief, load_scenario
from soil_env.terramechanics.effects import excavation_rate

SCENARIO = replace(load_scenario("mixed"), belief=Belief())
NUMBERS = filter_numbers(SCENARIO)
R = NUMBERS.radius
LENGTH = NUMBERS.relaxation
RECOVERY = NUMBERS.dig_recovery
DT = 0.4  # s; exponent; m2, of a sinkage that is not measured
N = 1.07
LOST = 1e6


class Wheel:
    """The sinkage filter of one wheel, on one soil or on a border."""

    def __init__(self, numbers=NUMBERS):
        self.banks = new_banks(1)
        self.numbers = numbers
        restart(self.banks, 0, numbers)
        self.s = self.banks.sinkage[0]

    def start(self, sinkage, variance=1e-12):
        sf.start(self.banks, 0, sinkage, variance)

    def set(self, i, value):
        self.s[i * COUNT : (i + 1) * COUNT] = value

    def know(self, y, ln_gain, sd=1e-9):
        """Pressure and gain next to exactly."""
        for i, value in ((sf.PRESSURE, y), (sf.GAIN, ln_gain)):
            self.set(i, value)
            for j in range(sf.STATES):
                self.s[sf.cell(i, j) : sf.cell(i, j) + COUNT] = sd * sd if i == j else 0.0
        self.s[sf.LOG_WEIGHT * COUNT :] = -math.log(COUNT)

    def follow(self, motion, bearing, by_depth=-N, share=1.0, by_place=0.0, place_variance=0.0):
        """Follow a motion in which the pressure mobilised is that of a bearing sinkage of `bearing`
        [m].

        That is on the soil whose y is the one of the prior.
        """
        depth = sf.mean(self.s, sf.DEPTH)
        ln_s = (
            self.numbers.prior.sinkage[0]
            + N * math.log(bearing / self.numbers.depth)
            - N * math.log(depth)
        )
        ground = sf.Ground(ln_s, depth, by_depth, N, share, by_place, place_variance)
        sf.follow(self.banks, 0, ground, motion, self.numbers)

    @property
    def sinkage(self):
        return sf.mean(self.s, sf.DEPTH)

    def moments(self, i):
        """(mean, standard deviation) of a state over all filters."""
        return sf.mean(self.s, i), math.sqrt(sf.spread(self.s, i, i))

    def check(self, size=sf.STATES):
        """The covariance of each filter and of all is positive semidefinite; weights sum to one."""
        w = np.exp(self.s[sf.LOG_WEIGHT * COUNT :][:COUNT])
        assert w.sum() == pytest.approx(1.0, abs=1e-9) and np.all(np.isfinite(self.s))
        P = np.array(
            [
                [self.s[sf.cell(i, j) : sf.cell(i, j) + COUNT] for j in range(size)]
                for i in range(size)
            ]
        )
        whole = np.array([[sf.spread(self.s, i, j) for j in range(size)] for i in range(size)])
        for p in (*np.moveaxis(P, 2, 0), whole):
            sd = np.sqrt(np.maximum(np.diag(p), 1e-18))
            assert (
                np.all(np.diag(p) >= 0.0) and np.linalg.eigvalsh(p / np.outer(sd, sd)).min() > -1e-7
            )


def moved(speed, sliding, seconds=DT, sinkage=0.02, variance=LOST, time=None):
    """Motion at a travel and a sliding speed [m/s]; at `time` 0 a lack of depth does not come by
    itself.
    """
    a, _ = excavation_rate(speed, sliding, 1.0, RECOVERY, LENGTH)
    time = seconds if time is None else time
    return sf.Motion(a * seconds, sliding * seconds / LENGTH, 0.0, time, sinkage, variance)


def law(z, bearing, gain, motions):
    """Sinkage [m] after each time by the law of excavation, integrated by scipy."""
    out = []
    for speed, sliding in motions:
        a, b = excavation_rate(speed, sliding, gain, RECOVERY, LENGTH)
        z = solve_ivp(
            lambda _, y, a=a, b=b: b * bearing - a * y, (0.0, DT), [z], rtol=1e-10, atol=1e-13
        ).y[0, -1]
        out.append(z)
    return np.array(out)


@settings(max_examples=30, deadline=None)
@given(
    ln_gain=st.floats(-1.5, 1.0),
    bearing=st.floats(0.008, 0.03),
    ratio=st.floats(0.5, 2.0),
    motions=st.lists(st.tuples(st.floats(0.0, 0.5), st.floats(0.0, 0.4)), min_size=1, max_size=12),
)
def test_with_exact_parameters_the_sinkage_follows_its_law(ln_gain, bearing, ratio, motions):
    wheel = Wheel()
    wheel.know(NUMBERS.prior.sinkage[0], ln_gain)
    wheel.start(ratio * bearing)
    expected = law(ratio * bearing, bearing, NUMBERS.dig_gain * math.exp(ln_gain), motions)
    for (speed, sliding), z in zip(motions, expected, strict=True):
        wheel.follow(moved(speed, sliding, time=0.0), bearing)
        assert wheel.sinkage == pytest.approx(min(z, 1.9 * R), rel=1e-6)


@pytest.mark.parametrize("offset", [-2.0, -0.5, 0.0, 0.7, 2.0])
def test_what_lacks_in_depth_comes_in_the_mean(offset):
    """At rest for long: the moments are those of the larger of the sinkage and its bearing depth,
    by draws.
    """
    wheel = Wheel()
    sd = 0.004
    bearing = 0.03
    wheel.know(NUMBERS.prior.sinkage[0], 0.0)
    wheel.start(bearing + offset * sd, sd * sd)
    wheel.follow(moved(0.0, 0.0, 100.0), bearing)
    z = np.maximum(
        bearing + sd * (offset + np.random.default_rng(0).standard_normal(400_000)), bearing
    )
    found, of_all = wheel.moments(sf.DEPTH)
    assert found == pytest.approx(z.mean(), abs=0.02 * sd)
    least = (0.02 * R) ** 2 + (0.1 * (found - bearing - offset * sd)) ** 2  # of the law itself
    assert of_all**2 - least == pytest.approx(z.var(), rel=0.05, abs=2e-3 * sd * sd)


def test_the_bank_of_a_new_soil_has_the_moments_of_the_prior():
    states = (sf.PRESSURE, sf.GAIN)
    for numbers in (NUMBERS, filter_numbers(load_scenario("two_lines"))):
        wheel = Wheel(numbers)
        P = numbers.prior.sinkage_covariance.reshape(2, 2)
        sf.new_soil(wheel.banks, 0, numbers)
        np.testing.assert_allclose(
            [sf.mean(wheel.s, i) for i in states], numbers.prior.sinkage, atol=1e-9
        )
        found = np.array([[sf.spread(wheel.s, i, j) for j in states] for i in states])
        scale = np.sqrt(np.diag(P))
        np.testing.assert_allclose(
            found / np.outer(scale, scale), P / np.outer(scale, scale), atol=0.15
        )


@pytest.mark.parametrize("seed", range(4))
def test_pressure_and_gain_are_learnt_from_the_sinkage(seed):
    """A wheel at varied slip that obeys the law, with noise of 1 mm: both come within three
    standard deviations.
    """
    rng = np.random.default_rng(seed)
    wheel = Wheel()
    prior = NUMBERS.prior
    off = 0.4 * rng.standard_normal()
    ln_gain = 0.5 * rng.standard_normal()
    bearing = 0.02 * math.exp(-off / N)
    wheel.start(0.02, 1e-4)
    z = bearing
    for k in range(60):
        speed = 0.25
        sliding = 0.12 * (1.0 + math.sin(0.5 * k))
        z = law(z, bearing, NUMBERS.dig_gain * math.exp(ln_gain), [(speed, sliding)])[0]
        # the pressure mobilised is that of a bearing sinkage of 0.02 m on the soil of the prior,
        # whatever the depth
        wheel.follow(
            moved(speed, sliding, sinkage=z + 1e-3 * rng.standard_normal(), variance=1e-6), 0.02
        )
        wheel.check(sf.HERE)
    for state, truth, before in (
        (sf.PRESSURE, prior.sinkage[0] + off, prior.sinkage_covariance[0]),
        (sf.GAIN, ln_gain, prior.sinkage_covariance[3]),
    ):
        found, sd = wheel.moments(state)
        assert abs(found - truth) < 3.0 * sd < 3.0 * 0.6 * math.sqrt(before), state


floats = st.floats
step = st.tuples(
    st.integers(0, 9),
    st.booleans(),
    floats(1e-3, 0.5),
    floats(-2.0, 0.0),
    floats(0.0, 0.999),
    floats(0.0, 0.01),
    st.tuples(
        floats(0.0, 5.0),
        floats(0.0, 5.0),
        floats(0.0, 1.0),
        floats(0.0, 2.0),
        floats(0.0, 1.5),
        floats(1e-8, 1e2),
    ),
)


@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from(["mixed", "field_vehicle"]),
    floats(1e-3, 1.0),
    floats(1e-10, 1e-2),
    st.lists(step, min_size=1),
)
def test_covariances_stay_positive_and_weights_sum_to_one(scenario, sinkage, variance, steps):
    """On one soil and on a border, at any motion; steps begin a border, or end it with the old or
    the new soil.
    """
    wheel = Wheel(filter_numbers(load_scenario(scenario)))
    on_border = False
    r = wheel.numbers.radius
    wheel.start(sinkage * r, variance)
    for turn, old, bearing, by_depth, share, place_variance, motion in steps:
        if turn == 0 and not on_border:
            sf.begin_next_sinkage(wheel.banks, 0, wheel.numbers)
            on_border = True
        elif turn == 1 and on_border:
            if old:
                sf.keep_old_sinkage(wheel.banks, 0)
            on_border = False
        motion = sf.Motion(*motion[:4], motion[4] * r, motion[5])
        wheel.follow(
            motion,
            bearing * r,
            by_depth,
            share if on_border else 1.0,
            -5.0 * on_border,
            place_variance,
        )
        wheel.check(sf.STATES if on_border else sf.HERE)
        assert (1.0 - 1e-9) * 1e-3 * r <= wheel.sinkage <= 1.9 * r * (
            1.0 + 1e-9
        ) and wheel.banks.point.bearing[0] > 0.0


def test_on_a_border_the_ground_is_of_both_soils():
    """By the share of the new one: y is averaged, so that the bearing sinkage is their geometric
    mean; gains add.
    """
    wheel = Wheel()
    y = NUMBERS.prior.sinkage[0]
    wheel.know(y - 0.4, math.log(0.5))
    wheel.start(0.03)
    sf.begin_next_sinkage(wheel.banks, 0, NUMBERS)
    wheel.set(sf.PRESSURE, y + 0.2)
    wheel.set(sf.GAIN, math.log(2.0))
    share = 0.3
    speed = 0.2
    sliding = 0.1
    bearing = 0.02 * math.exp(-(share * 0.2 - (1.0 - share) * 0.4) / N)
    gain = NUMBERS.dig_gain * (share * 2.0 + (1.0 - share) * 0.5)
    wheel.follow(moved(speed, sliding, time=0.0), 0.02, share=share)
    assert wheel.sinkage == pytest.approx(law(0.03, bearing, gain, [(speed, sliding)])[0], rel=1e-6)
