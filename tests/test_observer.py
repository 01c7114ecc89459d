"""Observations from readings: those of the environment along a drive, in every number."""

import copy
import math
import pickle
from functools import partial

import numpy as np
import pytest

from soil_env.envs.wheel_env import SoilWheelEnv
from soil_env.online import Observer, OnlineIdentifier, Readings
from soil_env.parameters import ParameterError, load_rover, load_scenario
from soil_env.readings import Image
from tests.refusals import refused

#: All readings but those of slip, which follows from the two speeds, of the wheel speed and time.
MEASURED = Readings._fields[1:6] + ("pitch", "motor_torque", "acceleration")


class Rig:
    """A simulated wheel whose sensors are read as those of a real one."""

    def __init__(self, scenario, variant, **options):
        self.env = SoilWheelEnv(scenario, observation=variant, scaled=False, repeat=1, **options)
        self.names = self.env.observation_names

    def reset(self, seed):
        self.seen, self.info = self.env.reset(seed=seed)

    def step(self, action):
        self.seen, _, self.over, _, self.info = self.env.step([action])

    @property
    def readings(self):
        """Readings of this control period."""
        sample = self.env.simulation._world.samples[0, 0]
        own = {name: float(sample[name]) for name in MEASURED}
        return Readings(wheel_speed=sample.rim_speed / self.env.scenario.wheel.radius, **own)

    @property
    def now(self):
        """Further arguments of `Observer.observe`: if the wheel is in a halt, and on courses with a
        camera its image and if a route is chosen now.
        """
        sample = self.env.simulation._world.samples[0, 0]
        known = {"halted": bool(sample.halted)}
        if self.env.scenario.course.classes:
            known["image"] = Image(*(float(sample[name]) for name in Image._fields))
            known["chooses"] = bool(self.seen[self.names.index("choice")])
        return known


@pytest.mark.parametrize(
    ("name", "variant", "action", "length"),
    [
        ("mixed", "identified", "torque", 150),
        ("two_lines", "identified", "rim_acceleration", 400),
        ("two_lines", "blind", "wheel_speed", 150),
    ],
)
def test_readings_give_the_observation_of_the_environment(name, variant, action, length):
    """And the probabilities of immobilisation; a reset begins another drive."""
    rig = Rig(name, variant, action=action, info="full")
    observer = Observer(rig.env.scenario, variant)
    rng = np.random.default_rng(1)
    for seed in (3, 5):
        rig.reset(seed)
        observer.reset()
        given = 0.0
        for _ in range(length):
            seen = observer.observe(rig.readings, given, **rig.now)
            np.testing.assert_array_equal(seen, rig.seen)
            for key, value in observer.probabilities().items():
                assert rig.info["traversability"][key] == pytest.approx(value, abs=1e-12)
            given = float(np.float32(rng.uniform(0.0, 0.6)))
            rig.step(given)
            if rig.over:
                break
    assert observer.held == {}


def test_a_copy_and_a_pickle_go_on_as_the_observer():
    observer = Observer(load_scenario("mixed"))
    reading = Readings(wheel_speed=2.0, speed=0.2, sinkage=0.02, torque=6.0, load=150.0)

    def later(one):
        """Observation and probabilities after two seconds of a wheel that gets stuck."""
        for k in range(20):
            seen = one.observe(reading._replace(speed=0.2 - 0.01 * k, sinkage=0.02 + 0.003 * k))
        return seen.tolist(), one.probabilities()

    for _ in range(5):
        observer.observe(reading)
    before = observer.probabilities()
    copies = copy.deepcopy(observer), pickle.loads(pickle.dumps(observer))
    after = later(observer)
    assert all(later(other) == after for other in copies) and after[1] != before
    observer.reset()  # nothing is left of the drive before
    assert np.isnan([*observer.probabilities().values()]).all()


def test_a_missing_reading_is_held_and_counted():
    """It poisons nothing: the last value is observed, and a reset forgets the count."""
    rig = Rig("mixed", "identified")
    observer = Observer(rig.env.scenario)
    whole = Observer(rig.env.scenario)
    rig.reset(0)
    last = rig.seen
    for k in range(60):
        readings = rig.readings
        gaps = {}
        if k == 20:
            gaps = {"torque": math.nan}
        elif k == 30:
            gaps = {"speed": math.nan, "wheel_speed": math.nan}
        seen = observer.observe(readings._replace(**gaps), 0.3, **rig.now)
        expected = whole.observe(readings, 0.3, **rig.now)
        assert np.isfinite(seen).all()
        if k < 20:
            np.testing.assert_array_equal(seen, expected)
        for name in gaps:
            column = rig.names.index({"wheel_speed": "rim_speed"}.get(name, name))
            assert seen[column] == last[column]
        last = seen
        rig.step(0.3)
    np.testing.assert_array_equal(seen[:8], expected[:8])  # sensors, of now
    # phi, log10 K and log10 S of the estimate, and their standard deviations
    np.testing.assert_allclose(seen[14:20], expected[14:20], atol=0.3)
    assert observer.held == {"torque": 1, "speed": 1, "rim_speed": 1}
    observer.reset()
    assert observer.held == {}


def test_what_is_never_measured_stands_as_in_the_identifier():
    """The estimate that is observed (entry 14 is phi) is that of an `OnlineIdentifier` with the
    same readings, and no missing reading is counted.
    """
    scenario = load_scenario("mixed")
    observer = Observer(scenario)
    identifier = OnlineIdentifier.of_scenario(scenario)
    first = observer.observe(Readings())
    assert np.isfinite(first).all() and first[14] == pytest.approx(
        math.radians(identifier.estimate.friction_angle_deg)
    )
    for k in range(30):
        readings = Readings(wheel_speed=2.0, speed=0.27 - 0.004 * k, torque=5.0)
        seen = observer.observe(readings)
        estimate = identifier.update(readings)
    assert seen[14] == pytest.approx(math.radians(estimate.friction_angle_deg), rel=1e-6)
    assert observer.held == {}


def test_what_cannot_be_is_refused_in_one_line():
    observer = Observer(load_scenario("two_lines"))
    with pytest.raises(ParameterError, match="expected the Image of a camera"):
        observer.observe(Readings(2.0, 0.27))
    with pytest.raises(ParameterError, match="expected none"):
        Observer(load_scenario("mixed")).observe(
            Readings(2.0, 0.27), image=Image(*(0.0,) * len(Image._fields))
        )
    image = Image(0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 2.0, 0.0, 1.0, 2.0, 0.0, 0.0)
    observer.observe(Readings(2.0, 0.27), image=image)
    for name, value in (("here", 50.0), ("label_0", 3.0), ("label_1", 0.5), ("lines", 3.0)):
        wrong = partial(observer.observe, image=image._replace(**{name: value}))
        refused(
            partial(wrong, Readings(2.0, 0.27)),
            f"image.{name} = {value:g}: expected a whole number",
        )
    mixed = Observer(load_scenario("mixed"))
    for readings, error, said in (
        (Readings(math.inf, 0.2), ValueError, "wheel_speed"),
        ((2.0, 0.2), TypeError, "Readings"),
    ):
        with pytest.raises(error, match=said):
            mixed.observe(readings)
    with pytest.raises(ValueError, match="action"):
        mixed.observe(Readings(2.0, 0.27), math.nan)
    for wrong in ({"halted": "no"}, {"chooses": 1.0}):
        with pytest.raises(ParameterError, match="expected True or False"):
            mixed.observe(Readings(2.0, 0.27), **wrong)
    for scenario, variant in ((load_rover(), "blind"), (load_scenario("mixed"), "true_soil")):
        with pytest.raises(ParameterError, match="expected"):
            Observer(scenario, variant)
