"""Sensors: reading = (1 + gain) truth + zero + white noise, with zeros and gains of a course; slip
of the two speeds that were read.
"""

import math
import re
from dataclasses import fields

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from soil_env.parameters import Noise, load_rover, load_scenario, rover_names
from soil_env.parameters.readings import IDLE, RESTART, STEP
from soil_env.parameters.sensors import SENSORS, Readings, SensorReading, calibrated
from soil_env.simulation.rover.task import rover_layout
from soil_env.simulation.task import layout
from tests.simulation.wheels import started

COURSES = 2000
#: Sensors with zeros and gains; a slip sensor has none.
NAMES = SensorReading._fields[1:]
OF_BODY = ("speed", "pitch", "acceleration")  # of a rover: one sensor each, that of the front wheel
RARE = 1e-4  # probability of any of the numbers of a check beyond its limits
ZEROS = {
    f.name: 0.003 + 0.001 * k
    for k, f in enumerate(fields(Noise))
    if f.name.endswith(("_zero", "_gain"))
}
WHITE = {name: 0.0 for name in ("slip", "wheel_speed", *NAMES) if name != "rim_speed"}
BOTH = pytest.mark.parametrize("load", [load_scenario, load_rover], ids=["wheel", "rover"])


def named(name):
    """Name in `Noise` of a reading."""
    return "wheel_speed" if name == "rim_speed" else name


def test_what_is_declared_of_a_sensor_has_its_fields():
    """The names of sensors stand in four places of soil_env/parameters/sensors.py: one row, field
    and white noise for each, in one order.
    """
    names = [sensor.name for sensor in SENSORS]
    assert [named(name) for name in SensorReading._fields] == names
    assert {*names, "time"} == set(Readings._fields)
    of_noise = {f.name for f in fields(Noise)}
    assert {name for name in of_noise if not name.endswith(("_zero", "_gain"))} == set(names)
    assert {name.removesuffix("_zero").removesuffix("_gain") for name in of_noise} == set(names)


def scenario_of(load, noise):
    """The default wheel or a rover on three axles, with every action of one control period."""
    which = "mixed" if load is load_scenario else "mars_rover"
    return load(which, {"noise": noise, "control": {"action": "torque", "repeat": 1}})


def units(scenario):
    """{reading: size of 1 of its `Noise`, in the unit of the reading}."""
    weight = scenario.weight
    r = scenario.wheel.radius
    of = dict.fromkeys(NAMES, 1.0) | dict.fromkeys(("drawbar_pull", "load"), weight)
    return of | dict.fromkeys(("torque", "motor_torque"), weight * r) | {"rim_speed": r}


def wheels_of(sim):
    """Records of all wheels [vehicles, axles]."""
    state = sim.worlds.state
    return (
        state["wheels"][:, : sim.scenario.axles]
        if "wheels" in state.dtype.names
        else state[:, None]
    )


def mounted(sim, kind):
    """`zero` or `gain` {reading: [vehicles, axles]} of all sensors."""
    of = wheels_of(sim)[kind][..., 0]
    return {name: np.array(of[name]) for name in NAMES}


def drawn(sim):
    """Zeros and gains [vehicles, axles x numbers] of the sensors, over their sd; those without a
    deviation are 0, and left out.
    """
    noise = vars(sim.scenario.noise)
    rows = []
    for kind, unit in (("zero", units(sim.scenario)), ("gain", dict.fromkeys(NAMES, 1.0))):
        for name, values in mounted(sim, kind).items():
            sd = noise[f"{named(name)}_{kind}"] * unit[name]
            assert sd > 0.0 or not values.any(), (kind, name)
            rows += [values / sd] if sd > 0.0 else []
    return np.concatenate(rows, axis=1)


def step(sim, rng):
    """Step vehicles with random actions; those whose episode has ended begin a new course."""
    vehicles = len(sim.worlds.cause)
    actions = rng.uniform(0.1, 0.6, (vehicles, sim._actions.size // vehicles))
    sim.step_all(actions, np.where(sim.worlds.cause == 0, STEP, RESTART))


def read(sim):
    """Last readings {reading: [vehicles, axles]}, in double precision."""
    world = sim._world
    samples = world.readings[:, :, 0] if hasattr(world, "readings") else world.samples[:, :1]
    return {name: np.array(samples[name]) for name in SensorReading._fields}


def truth(sim):
    """What the sensors measure {reading: [vehicles, axles]}."""
    state = sim.worlds.state
    wheels = wheels_of(sim)
    names = ("slip", "sinkage", "drawbar_pull", "load", "torque", "motor_torque")
    of = {name: np.array(wheels[name]) for name in names}
    of["rim_speed"] = wheels["wheel_speed"] * sim.scenario.wheel.radius
    body = state if "wheels" in state.dtype.names else wheels[:, 0]
    of["speed"] = body["speed"][:, None] + 0.0 * of["slip"]
    pitch = body["pitch"] if "wheels" in state.dtype.names else body["grade"]
    of["pitch"] = pitch[:, None] + 0.0 * of["slip"]
    of["acceleration"] = (body["drawbar_pull"] / body["mass"])[:, None] + 0.0 * of["slip"]
    return of


def errors(sim):
    """Readings less what zeros and gains make of the truth {reading: [vehicles, axles]}."""
    zeros = mounted(sim, "zero")
    gains = mounted(sim, "gain")
    readings = read(sim)
    true = truth(sim)
    out = {}
    for name in NAMES:
        zero = zeros[name]
        gain = gains[name]
        if name in OF_BODY:
            zero = zero[:, :1]
            gain = gain[:, :1]
        out[name] = readings[name] - ((1.0 + gain) * true[name] + zero)
    return out


def slip_of(rim, speed, noise, radius):
    """Slip of two speeds, relative to three standard deviations of their difference at least."""
    least = max(3.0 * math.hypot(noise.speed, noise.wheel_speed * radius), 1e-3)
    slip = (rim - speed) / np.maximum(np.maximum(np.abs(rim), np.abs(speed)), least)
    return np.clip(np.where(rim + speed < -least, -slip, slip), -1.0, 1.0)


def fits(squares, count):
    """True if sums of squares of so many normal numbers each are all within their limits."""
    low, high = chi2.ppf(
        [0.5 * RARE / np.size(squares), 1.0 - 0.5 * RARE / np.size(squares)], count
    )
    return bool(np.all((low < squares) & (squares < high)))


def centred(x):
    """True if means of the columns of normal numbers `x` [N, n] are all within their limits."""
    return bool(np.max(len(x) * x.mean(axis=0) ** 2) < chi2.isf(RARE / x[0].size, 1))


def independent(x, others):
    """True if the columns of `x` [N, n] are correlated neither with each other nor with those of
    `others` [N, m].
    """
    r = np.corrcoef(np.hstack([x, others]), rowvar=False)[: x.shape[1]]
    r = r[~np.eye(*r.shape, dtype=bool)]
    return bool(np.abs(r).max() < math.sqrt(chi2.isf(RARE / r.size, 1) / len(x)))


@BOTH
@pytest.mark.parametrize(
    ("noise", "count"), [(ZEROS, 2 * len(NAMES)), ({}, 12)], ids=["all", "default"]
)
def test_zeros_and_gains_have_the_stated_deviations(load, noise, count):
    """Of each sensor, all or those of the scenario, over 2000 courses: normal, of mean 0,
    independent of each other, of those of other wheels, and of those of the course before.
    """
    sim = started(scenario_of(load, noise), "blind", range(COURSES))
    x = drawn(sim)
    assert x.shape[1] == count * wheels_of(sim).shape[1]
    assert not wheels_of(sim)["zero"]["slip"].any() and not wheels_of(sim)["gain"]["slip"].any()
    assert fits((x**2).sum(axis=0), COURSES)
    assert centred(x)
    assert min(kstest(column, "norm").pvalue for column in x.T) > RARE / x.shape[1]
    sim.restart_where(np.ones(COURSES, dtype=bool))
    again = drawn(sim)
    assert np.all(x != again)
    assert fits((again**2).sum(axis=0), COURSES)
    assert independent(x, np.hstack([np.roll(x, 1, axis=0), again]))


@BOTH
def test_zeros_and_gains_stay_on_a_course_and_change_with_it(load):
    """Of those that are reset alone, the others keep theirs."""
    sim = started(scenario_of(load, ZEROS), "blind", range(6))
    rng = np.random.default_rng(0)
    first = drawn(sim)
    for _ in range(60):
        sim.step_all(rng.uniform(-0.2, 0.6, sim._actions.shape), np.full(6, STEP))
        np.testing.assert_array_equal(drawn(sim), first)
    sim.step_all(np.full(sim._actions.shape, 0.3), np.array([STEP, RESTART, IDLE] * 2))
    changed = drawn(sim) != first
    assert changed[[1, 4]].all() and not changed[[0, 2, 3, 5]].any()


@BOTH
def test_calibrated_sensors_have_neither_zero_nor_gain(load):
    own = scenario_of(load, {}).noise
    noise = calibrated(own)
    white = {name: vars(own)[name] for name in map(named, SensorReading._fields)}
    assert vars(noise) == dict.fromkeys(vars(noise), 0.0) | white


@BOTH
@pytest.mark.parametrize(
    ("noise", "wrong"),
    [
        (ZEROS, {*NAMES}),
        ({}, {*NAMES} - {"rim_speed"}),  # which has neither zero nor gain by default
        (vars(calibrated(Noise())), set()),
    ],
    ids=["all", "default", "none"],
)
def test_without_white_noise_a_reading_is_one_plus_gain_times_truth_plus_zero(load, noise, wrong):
    """To rounding, of every wheel over a drive with halts, ends and new courses; `wrong`: the
    readings that differ from the truth.
    """
    sim = started(scenario_of(load, noise | WHITE), "identified", range(16))
    rng = np.random.default_rng(1)
    changed = set()
    for _ in range(120):
        true = truth(sim)
        for name, off in errors(sim).items():
            assert np.abs(off).max() < 1e-10 * units(sim.scenario)[name], name
            if np.any(read(sim)[name] != true[name]):
                changed.add(name)
        step(sim, rng)
    assert changed == wrong


@BOTH
def test_white_noise_about_zeros_and_gains_has_the_stated_deviation(load):
    """Independent between readings, wheels and periods; of a rover's body one reading for all
    wheels.
    """
    sim = started(scenario_of(load, ZEROS), "identified", range(50))
    noise = vars(sim.scenario.noise)
    unit = units(sim.scenario)
    rng = np.random.default_rng(1)
    rows = []
    for _ in range(400):
        step(sim, rng)
        off = errors(sim)
        for name in OF_BODY:
            assert not np.ptp(read(sim)[name], axis=1).any()
            off[name] = off[name][:, :1]
        columns = [off[name] / (noise[named(name)] * unit[name]) for name in NAMES]
        rows.append(np.concatenate(columns, axis=1))
    x = np.array(rows)  # [periods, vehicles, sensors]
    flat = x.reshape(-1, x.shape[-1])
    assert fits((flat**2).sum(axis=0), len(flat))
    assert centred(flat)
    assert independent(*(part.reshape(-1, x.shape[-1]) for part in (x[1:], x[:-1])))


@BOTH
def test_a_slip_sensor_reads_the_slip_with_its_noise(load):
    """Where slips are far from 1, at which readings are cut."""
    sim = started(scenario_of(load, {"slip": 0.02}), "identified", range(50))
    rng = np.random.default_rng(2)
    off = []
    for _ in range(60):
        step(sim, rng)
        slip = truth(sim)["slip"]
        reading = read(sim)["slip"]
        assert np.abs(reading).max() <= 1.0
        off.append((reading - slip)[np.abs(slip) < 0.85] / 0.02)
    off = np.concatenate(off)
    assert off.size > 1000
    assert fits((off**2).sum(), off.size) and centred(off[:, None])


@BOTH
@pytest.mark.parametrize(
    "noise",
    [{}, ZEROS, ZEROS | WHITE, vars(calibrated(Noise())) | WHITE],
    ids=["default", "zeros", "no white noise", "exact"],
)
def test_slip_is_that_of_the_two_speeds_that_were_read(load, noise):
    """Driving, braking, backwards and at rest; of exact sensors it is that of the wheel."""
    scenario = scenario_of(load, noise)
    sim = started(scenario, "identified", range(16))
    rng = np.random.default_rng(3)
    radius = scenario.wheel.radius
    signs = set()
    for _ in range(150):
        readings = read(sim)
        stated = slip_of(readings["rim_speed"], readings["speed"], scenario.noise, radius)
        np.testing.assert_allclose(readings["slip"], stated, rtol=0.0, atol=1e-14)
        signs |= set(np.sign(stated).ravel().tolist())
        if "drawbar_pull_zero" in noise and not any(noise.values()):
            rim, speed = readings["rim_speed"], readings["speed"]
            # turning backwards as fast as it goes forward: neither has a sign
            moving = (np.abs(rim) > 0.02) & (np.abs(rim + speed) > 1e-3)
            off = np.abs(readings["slip"] - truth(sim)["slip"])[moving]
            assert off.size == 0 or off.max() < 1e-9
        actions = rng.uniform(-0.6, 0.8, sim._actions.shape)
        sim.step_all(actions, np.where(sim.worlds.cause == 0, STEP, RESTART))
    assert {-1.0, 1.0} <= signs


@BOTH
def test_a_wheel_at_rest_has_little_slip(load):
    """It is relative to three standard deviations of the difference of the speeds at least."""
    sim = started(scenario_of(load, {}), "identified", range(400))
    for of_axle in read(sim)["slip"].T:
        assert fits(9.0 * (of_axle**2).sum(), of_axle.size)


@pytest.mark.parametrize("name", ["mixed", *rover_names()])
def test_the_observation_has_the_readings_in_its_units(name):
    """Relative to weight, wheel radius, top rim speed and gravity, those of a rover's body once;
    the odometry sums up the readings of the speed.
    """
    own = {"control": {"action": "torque", "repeat": 1}}
    scenario = load_scenario(name, own) if name == "mixed" else load_rover(name, own)
    variant = "identified"
    entries = layout(variant) if name == "mixed" else rover_layout(variant, scenario.axles)
    names = np.array([re.sub("^(front|middle|rear)_", "", entry.name) for entry in entries])
    wheel = scenario.wheel
    top = wheel.radius * wheel.no_load_speed
    of = {"slip": 1.0, "sinkage": wheel.radius, "speed": top, "rim_speed": top}
    of |= {"acceleration": scenario.gravity}
    sim = started(scenario, variant, range(16))
    rng = np.random.default_rng(4)
    metres = scenario.course.length / scenario.control.period
    for _ in range(30):
        before = sim.worlds.observation[:, names == "odometry"]
        going = sim.worlds.cause == 0
        step(sim, rng)
        readings = read(sim)
        for reading, unit in (units(scenario) | of).items():
            columns = np.flatnonzero(names == reading)
            assert columns.size == (1 if reading in OF_BODY else wheels_of(sim).shape[1])
            stated = readings[reading][:, : columns.size] / unit
            stated = np.clip(stated, *sim.numbers.bounds[:, columns])
            seen = sim.worlds.observation[:, columns]
            np.testing.assert_allclose(seen, stated, rtol=1e-6, atol=1e-7, err_msg=reading)
        moved = (sim.worlds.observation[:, names == "odometry"] - before)[going] * metres
        np.testing.assert_allclose(moved, readings["speed"][going, :1], atol=1e-4)
