"""The filter as a whole: points, consistency on courses, what enters it, wild readings."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, example, given, settings, strategies as st

from soil_env.identification import Status
from soil_env.identification.online import curve, identifier
from soil_env.identification.online.identifier import HELD, RENEWED, SensorReading
from soil_env.parameters import Belief, load_scenario
from tests.identification.observing import numbers_of, observe, started
from tests.simulation.courses import EVEN

SCENARIO = load_scenario("mixed")
PLAIN = replace(SCENARIO, belief=Belief())
STEADY = SensorReading(0.25, 0.022, 14.0, 147.0, 5.5, 0.28, 0.28 / 0.75, 0.0, 5.5, 0.93)


class Fed:
    """One identifier fed with readings."""

    def __init__(self, scenario=SCENARIO):
        self.numbers = identifier.identifier_numbers(scenario)
        self.ids = identifier.new_identifiers(1)
        identifier.forget(self.ids, 0, self.numbers)
        self.p = self.ids.banks.point

    def feed(self, reading, times=1):
        """Outcome of each reading."""
        return [observe(self.ids, 0, reading, self.numbers) for _ in range(times)]

    @property
    def bins(self):
        """Bins of the curve [n, FIELDS]."""
        return self.ids.banks.bins[0].reshape(curve.BINS + 1, curve.FIELDS)[: int(self.p.bins[0])]


def test_a_point_is_a_few_readings():
    """Eight of them, or two thirds of a radius of way: completed by the reading after."""
    slow = Fed()
    fast = Fed()
    outcomes = slow.feed(STEADY._replace(rim_speed=0.1, speed=0.075), 33)
    assert [n for n, outcome in enumerate(outcomes) if outcome == RENEWED] == [8, 16, 24, 32]
    outcomes = fast.feed(STEADY._replace(rim_speed=0.8, speed=0.6), 11)
    assert [n for n, outcome in enumerate(outcomes) if outcome == RENEWED] == [3, 5, 7, 9]


def test_two_sensors_of_a_quantity_are_averaged_by_their_precision():
    """Slip by its sensor and by two speeds, pull by acceleration and mass, torque by that of the
    motor; by numpy.
    """
    fed = Fed()
    sd = fed.numbers.filter.noise
    r = STEADY._replace(rim_speed=0.1, speed=0.074, acceleration=1.1, motor_torque=5.9)
    fed.feed(r, 17)  # the wheel turns steadily from the second point on
    bin_ = fed.bins[0]
    mass = r.load / fed.numbers.filter.gravity
    by_speeds = math.hypot(sd[5], 0.74 * sd[6]) / 0.1
    for value, weight, readings, sds in (
        (curve.SLIP, curve.SLIP_WEIGHT, (0.25, 0.26), (sd[0], by_speeds)),
        (curve.PULL, curve.PULL_WEIGHT, (14.0, mass * 1.1), (sd[2], mass * sd[9])),
        (curve.TORQUE, curve.TORQUE_WEIGHT, (5.5, 5.9), (sd[4], sd[8])),
    ):
        w = np.power(sds, -2.0)  # the rim speed has jumped at first
        first = 0.07 if value == curve.TORQUE else 1e-6
        assert bin_[value] == pytest.approx(w @ readings / w.sum(), rel=0.1 * first)
        assert bin_[weight] == pytest.approx(16.0 * w.sum(), rel=first)


@pytest.mark.parametrize(
    "changes",
    [
        {"rim_speed": 0.0, "speed": 0.0},
        {"slip": 0.95},
        {"slip": -0.6},
        {"sinkage": 0.0},
        {"rim_speed": -0.2},
    ],
)
def test_wheels_that_do_not_drive_tell_nothing(changes):
    """At rest, spinning, locked, above the ground, backward."""
    fed = Fed()
    assert fed.feed(STEADY._replace(**changes), 30) == [HELD] * 30
    assert fed.p.points[0] == 0.0 and fed.ids.status[0] == Status.NO_DATA


wild = st.floats(-1e6, 1e6)
speed = st.floats(-3.0, 3.0)
wild_reading = st.builds(
    SensorReading,
    st.floats(-1.0, 1.0),
    st.floats(-0.2, 0.4),
    wild,
    wild,
    wild,
    speed,
    speed,
    st.floats(-1.6, 1.6),
    wild,
    wild,
)


NO_SOIL = [
    SensorReading(0.0, 0.293, 725e3, 807e3, 539e3, 2.48, -2.81, 0.364, -524e3, 0.0),
    SensorReading(0.0, 0.233, -826e3, 261e3, 735e3, 1.94, 1.85, 1.3, 976e3, -723e3),
]


@settings(max_examples=25, deadline=None, phases=[Phase.explicit, Phase.generate])
@example(SCENARIO, NO_SOIL)
@given(st.sampled_from([SCENARIO, PLAIN]), st.lists(wild_reading, min_size=5, max_size=25))
def test_wild_readings_never_give_nan(scenario, readings):
    """Nor more bins than there is memory for, nor a covariance that is none."""
    fed = Fed(scenario)
    ids = fed.ids
    scale = np.sqrt(1.0 / fed.numbers.precision)
    for reading in readings:
        for _ in range(5):
            fed.feed(reading)
            assert 0.0 <= fed.p.bins[0] <= curve.BINS
        assert np.all(np.isfinite(numbers_of(ids))) and np.all(ids.sd > 0.0)
        if np.all(ids.sd < 1e3 * scale):
            assert (
                np.linalg.eigvalsh(ids.covariance[0] / np.outer(ids.sd[0], ids.sd[0])).min() > -1e-5
            )
        assert isinstance(Status(ids.status[0]), Status)


@pytest.mark.parametrize("name", SensorReading._fields)
def test_a_reading_that_is_not_a_number_is_passed_over(name):
    for wrong in (math.nan, math.inf, -math.inf):
        fed = Fed()
        before = numbers_of(fed.ids)
        assert fed.feed(STEADY._replace(**{name: wrong}), 20) == [HELD] * 20
        np.testing.assert_array_equal(numbers_of(fed.ids), before)
        fed.feed(STEADY._replace(rim_speed=0.1, speed=0.075), 5)
        fed.feed(STEADY._replace(**{name: wrong}), 3)
        assert fed.feed(STEADY._replace(rim_speed=0.1, speed=0.075), 4)[-1] == RENEWED


CONTRARY = STEADY._replace(rim_speed=0.375, motor_torque=12.0, acceleration=-3.0)


def test_readings_that_contradict_each_other_give_no_current_estimate():
    """Motor torque twice the torque, acceleration against the pull, at slips that vary, by sensors
    next to exact.
    """
    exact = dict.fromkeys(
        ("slip", "sinkage", "drawbar_pull", "torque", "load", "speed", "motor_torque"), 1e-6
    )
    fed = Fed(load_scenario("mixed", {"noise": exact, "belief": {"grade_change_deg": 0.0}}))
    seen = []
    for k in range(400):
        slip = 0.3 + 0.25 * math.sin(0.05 * k)
        pull = 14.0 - 40.0 * slip
        torque = 3.0 + 25.0 * slip * (-1.0) ** (k // 30)
        fed.feed(
            CONTRARY._replace(
                slip=slip, speed=0.375 * (1.0 - slip), drawbar_pull=pull, torque=torque
            )
        )
        seen.append(Status(fed.ids.status[0]))
    assert seen.count(Status.MISFIT) > 150


def test_steady_readings_of_one_soil_contradict_nothing():
    """100 s at slips that vary on ground of one soil: neither a misfit nor a border."""
    course = {
        "length": 60.0,
        "patch_length": [60.0, 60.0],
        "halt_interval": [1e5, 1e6],
        "margin": [0.1, 0.1],
    }
    changes = {
        "course": course,
        "soils": {"dry_sand": 1},
        "spread": EVEN,
        "control": {"action": "wheel_speed"},
    }
    sim = started(load_scenario("mixed", changes), *([9, k] for k in range(8)))
    misfits = []
    for step in range(300):
        sim.step_all(np.full(8, 0.4 + 0.2 * math.sin(0.07 * step)), np.zeros(8, np.int8))
        misfits.append(sim.worlds.ids.status == Status.MISFIT)
    assert np.mean(misfits) < 0.1 and sim.worlds.ids.borders.sum() <= 2


def test_forget_leaves_nothing_of_the_course_before():
    sim = started(SCENARIO, 1)
    used = Fed()
    fresh = Fed()
    for k in range(160):
        sim.step(0, 0.35 + 0.15 * math.sin(0.1 * k))
    used.ids = sim.worlds.ids
    identifier.forget(used.ids, 0, used.numbers)
    for fed in (used, fresh):
        fed.feed(CONTRARY._replace(load=14.7), 60)
    np.testing.assert_array_equal(numbers_of(used.ids), numbers_of(fresh.ids))
