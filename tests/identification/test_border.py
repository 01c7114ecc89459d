"""Borders: the odds of a change of the grade against scipy, where one is found, and none where
there is none.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import softmax
from scipy.stats import multivariate_normal

from soil_env.identification.online import soil_nodes as nodes_of
from soil_env.identification.online.border import (
    cross_where_the_grade_changes,
    follow_border,
    note_grade,
)
from soil_env.identification.online.filter_bank import filter_numbers, new_banks, restart
from soil_env.identification.online.lanes.compiling import compiled_root
from soil_env.identification.online.lanes.contact import share_of_next
from soil_env.identification.online.lanes.lanes import COUNT
from soil_env.parameters import Belief, load_scenario
from tests.identification.observing import started
from tests.simulation.courses import EVEN

SCENARIO = replace(load_scenario("mixed"), belief=Belief())
NUMBERS = filter_numbers(SCENARIO)
LENGTH = NUMBERS.border
NOISE = NUMBERS.noise[7]
STEP = 0.02  # m from reading to reading


@compiled_root
def _note(banks, x, pitch, numbers):
    banks.point.place[0] = x
    note_grade(banks, 0, pitch, numbers)
    if banks.point.crossing[0] > 0.0:
        follow_border(banks, 0, numbers)


@compiled_root
def _look(banks, numbers):
    cross_where_the_grade_changes(banks, 0, numbers)


def new_bank():
    banks = new_banks(1)
    restart(banks, 0, NUMBERS)
    return banks, banks.point


def pitches(x, middle, rise, rng):
    """Readings [n] at places x [n] of a course whose grade rises by `rise` [rad] over a border."""
    share = np.array([share_of_next((at - middle) / LENGTH)[0] for at in x])
    return 0.05 + rise * share + NOISE * rng.standard_normal(len(x))


def driven(seed, rise, middle=1.5, end_at=3.0):
    """(place where a border was found, its middle and sd as known at last) or None, of one drive
    over a border.
    """
    (banks, p), found, x = new_bank(), None, np.arange(0.0, end_at, STEP)
    for at, pitch in zip(x, pitches(x, middle, rise, np.random.default_rng(seed)), strict=True):
        _note(banks, at, pitch, NUMBERS)
        if p.crossing[0] == 0.0:
            _look(banks, NUMBERS)
        if p.crossing[0] > 0.0:
            found = at if found is None else found
            if at > p.border[0] + 0.5 * LENGTH:
                break
    return None if found is None else (found, p.border[0], math.sqrt(p.border_variance[0]))


@pytest.mark.parametrize("rise_deg", [-12.0, -4.0, 4.0, 12.0])
def test_a_clean_step_is_found_near_its_place(rise_deg):
    """Before its middle, and behind it to two centimetres of a length of 30 cm, about as well as
    stated.

    One course of the twenty has a false border before it.
    """
    rows = np.array([driven(seed, math.radians(rise_deg)) for seed in range(20)])
    assert np.median(rows[:, 0]) < 1.5
    assert np.median(np.abs(rows[:, 1] - 1.5)) < 0.02
    scaled = np.abs(rows[:, 1] - 1.5) / rows[:, 2]
    assert np.mean(scaled < 3.0) >= 0.75 and np.median(rows[:, 2]) < 0.1 * LENGTH


def test_without_a_step_none_is_found():
    """Courses of six metres of one grade: nineteen of twenty have none."""
    false = sum(driven(seed, 0.0, end_at=6.0) is not None for seed in range(60))
    assert false <= 3, false


class Judge:
    """Bayesian regression of the readings on each place, by dense Gaussians of scipy, from the
    grade of 60 readings.
    """

    def __init__(self):
        self.x = []
        self.y = []
        self.variance = NOISE**2 * (1.0 + 1.0 / 60.0)
        self.t2 = NUMBERS.grade_change**2

    def located(self, places):
        """(ln odds of a border in these places, mean and sd of its place, mean rise)."""
        n = len(self.x)
        evidence = []
        rises = []
        none = multivariate_normal(np.zeros(n), self.variance * np.eye(n)).logpdf(self.y)
        for place in places:
            w = np.array([share_of_next((a - place) / LENGTH)[0] for a in self.x])
            cov = self.variance * np.eye(n) + self.t2 * np.outer(w, w)
            evidence.append(multivariate_normal(np.zeros(n), cov).logpdf(self.y) - none)
            rises.append(self.t2 * w @ np.linalg.solve(cov, self.y))
        odds = np.logaddexp.reduce(evidence) + math.log(0.5 * NUMBERS.offsets[1])
        weight = softmax(evidence)
        mean = weight @ places
        return odds, mean, math.sqrt(weight @ (places - mean) ** 2), weight @ rises


@pytest.mark.parametrize("seed", range(4))
def test_the_odds_and_the_place_are_those_of_bayesian_regression(seed):
    """A border is begun when the evidence exceeds the odds, and is where and as steep as it says,
    also afterwards.
    """
    rng, (banks, p), judge, crossed = np.random.default_rng(seed), new_bank(), Judge(), 0
    p.grades[0] = 1e6
    p.grade[0] = 0.05
    x = np.arange(-0.5 * LENGTH, 0.5, STEP)
    for at, pitch in zip(x, pitches(x, 0.25, math.radians(6.0), rng), strict=True):
        judge.x.append(at), judge.y.append(pitch - p.grade[0])
        before = p.crossing[0] > 0.0
        _note(banks, at, pitch, NUMBERS)
        odds, mean, sd, rise = judge.located(p.nearest[0] + NUMBERS.offsets)
        if not before:
            _look(banks, NUMBERS)
            assert (p.crossing[0] > 0.0) == (odds >= 3.0)
        if p.crossing[0] > 0.0:
            crossed += 1
            assert (p.border[0], p.rise[0]) == pytest.approx((mean, rise), abs=1e-6)
            between = 2.0 * NUMBERS.offsets[1]  # at most, of places that are tested at intervals
            assert sd < math.sqrt(p.border_variance[0]) < math.hypot(sd, between)
    assert crossed > 10 and abs(p.border[0] - 0.25) < 0.02


WHEEL_SPEED = {"control": {"action": "wheel_speed"}}
ONE_SOIL = {
    "soils": {"dry_sand": 1},
    "spread": EVEN,
    "course": {"margin": [0.0, 0.15]},
    "belief": {"soils": load_scenario("mixed").belief.soils, "spread": {}},
}


def weights_of_the_same_soil(changes):
    """Probabilities [n] that the soil stayed the same, at the end of each border of six courses."""
    sim = started(load_scenario("mixed", WHEEL_SPEED | changes), 0)
    weights = []
    w = sim.worlds
    p = sim.worlds.ids.banks.point
    for seed in range(6):
        sim.seed(0, np.random.default_rng(seed))
        sim.restart(0)
        for step in range(420):
            was = p.crossing[0]
            nodes = w.ids.banks.nodes[0].reshape(nodes_of.NODE_ROWS, COUNT)[:, nodes_of.STAYS]
            weight = (
                math.exp(nodes[nodes_of.LOG_WEIGHT]) if nodes[nodes_of.SAME_SOIL] > 0.0 else 0.0
            )
            sim.step(0, 0.42 + 0.1 * math.sin(0.1 * step))
            if w.cause[0] != 0:
                break
            if was > p.crossing[0]:
                weights.append(weight)
    assert len(weights) >= 8
    return np.array(weights)


def test_the_forces_separate_a_slope_on_the_same_soil_from_a_new_soil():
    """The odds of patches of one soil, whose grades differ, rise, and those of other soils fall."""
    before = 0.05  # what is believed before the forces are known
    assert np.median(weights_of_the_same_soil(ONE_SOIL)) > 5.0 * before
    assert np.median(weights_of_the_same_soil({})) < 0.2 * before
