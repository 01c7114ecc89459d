"""The online identifier by itself: that of the environment, and what it makes of channels that are
missing.
"""

import copy
import dataclasses
import itertools
import math
import pickle
import warnings

import gymnasium
import numpy as np
import pytest

import soil_env  # noqa: F401  (registers SoilWheel-v0)
from soil_env.envs.rover_env import SoilRoverEnv
from soil_env.identification.online.memory import EXPONENT, GAIN, LN_K, PRESSURE, TANGENT
from soil_env.identification.online.prior import prior_of_belief
from soil_env.identification.online.residuals import PAYLOAD
from soil_env.online import OnlineIdentifier, Readings, Status, largest_readings, slips
from soil_env.parameters import Belief, Noise, SoilState, load_rover, wheels
from soil_env.parameters.sensors import calibrated
from soil_env.terramechanics.steady import steady_state
from tests.refusals import refused

WHEEL = wheels()["planetary_rover"]
BELIEF = Belief()


def driven(seed, periods):
    """(scenario, readings, infos) of so many periods, the readings out of the observation
    (float32); None if the first 100 are not in one soil.
    """
    env = gymnasium.make(
        "SoilWheel-v0",
        scenario="mixed",
        action="torque",
        scaled=False,
        course={"patch_length": [4.0, 5.0]},
    ).unwrapped
    env.reset(seed=seed)
    scenario = env.scenario
    readings = []
    infos = []
    weight = scenario.weight
    r = scenario.wheel.radius
    for step in range(1, periods + 1):
        observation, _, over, late, info = env.step([0.35 + 0.2 * math.sin((step - 1) / 7)])
        o = dict(zip(env.observation_names, observation.tolist(), strict=True))
        top = scenario.wheel.no_load_speed
        readings.append(
            Readings(
                o["rim_speed"] * top,
                o["speed"] * top * r,
                o["sinkage"] * r,
                o["drawbar_pull"] * weight,
                o["load"] * weight,
                o["torque"] * weight * r,
                o["slip"],
                o["pitch"],
                o["motor_torque"] * weight * r,
                o["acceleration"] * scenario.gravity,
                0.1 * step,
            )
        )
        infos.append(info)
        if step == 100:
            end = env.simulation.worlds.courses["patches"]["end"][0, 0]
            if info["state"]["x"] >= end - 0.5 * scenario.course.border:
                return None
        if over or late:
            break
    return scenario, readings, infos


@pytest.fixture(scope="module")
def drive():
    """`driven` for 520 periods."""
    return driven(0, 520)


@pytest.fixture(scope="module")
def short_drives():
    """Eight that are `driven` in one soil each."""
    every = (driven(seed, 100) for seed in itertools.count())
    return list(itertools.islice(filter(None, every), 8))


def left_by_sinkage(scenario):
    """Standard deviations of the unknowns over those of the prior [SOIL], if exponent, pressure and
    digging gain were known exactly: the others follow by their correlations in the prior alone.
    """
    covariance = prior_of_belief(scenario)[1]
    known = [EXPONENT, PRESSURE, GAIN]
    gain = np.linalg.solve(covariance[np.ix_(known, known)], covariance[known])
    return np.sqrt(np.maximum(1.0 - np.sum(gain * covariance[known], 0) / np.diag(covariance), 0.0))


NO_FORCE = dict.fromkeys(("torque", "drawbar_pull", "motor_torque", "acceleration"), math.nan)


def sd_over_prior(drive, **missing):
    """(least standard deviations of phi, ln K, ln S and the digging gain over those of the prior,
    identifier).

    Over 100 periods in one soil, with the fields `missing` replaced in every reading.
    """
    scenario, readings, _ = drive
    identifier = OnlineIdentifier.of_scenario(scenario)
    estimates = [
        identifier.estimate,
        *(identifier.update(r._replace(**missing)) for r in readings[:100]),
    ]
    names = (
        "friction_angle_sd_deg",
        "shear_modulus_relative_sd",
        "sinkage_coefficient_relative_sd",
        "dig_gain_relative_sd",
    )
    sd = np.array([[getattr(e, name) for name in names] for e in estimates])
    return sd.min(axis=0) / sd[0], identifier


def test_it_is_the_identifier_of_the_environment(drive):
    scenario, readings, infos = drive
    identifier = OnlineIdentifier.of_scenario(scenario)
    renewals = 0
    seen = set()
    for r, info in zip(readings, infos, strict=True):
        e = identifier.update(r)
        expected = dict(info["estimate"])
        renewals += e.renewed
        seen.add(e.status)
        assert e.status.name == expected.pop("status")
        for name, value in expected.items():
            near_zero = 1e-7 if name == "best_pull" else None  # readings are of single precision
            assert getattr(e, name) == pytest.approx(value, rel=1e-4, abs=near_zero), name
        if e.renewed:
            way = identifier.traversability(r.load, r.pitch)
            expected = info["traversability"]
            assert way.best_slip == expected["best_slip"] and way.passable == expected["passable"]
            assert way.drawbar_margin == pytest.approx(expected["drawbar_margin"], abs=1e-4)
    assert 40 < renewals < 300 and seen >= {Status.CONVERGED, Status.NOT_EXCITED}


@pytest.mark.parametrize("name", ["torque", "drawbar_pull", "load"])
def test_without_one_channel_it_is_no_surer(short_drives, name):
    """In the mean of courses; of another estimate, and so not less to the last digit."""
    whole = np.mean([sd_over_prior(drive)[0] for drive in short_drives], axis=0)
    part = np.mean([sd_over_prior(drive, **{name: math.nan})[0] for drive in short_drives], axis=0)
    assert 0.9 * whole[1] < part[1] < 0.6


def test_without_a_channel_less_is_known(drive):
    """Order of the uncertainties: little is known of shear where neither pull nor torque is
    read.
    """
    whole = sd_over_prior(drive)[0]
    none = sd_over_prior(drive, **NO_FORCE)[0]
    assert none[1] > 0.65 and none[2] < 0.7
    for name in ("motor_torque", "acceleration"):
        others = {n: v for n, v in NO_FORCE.items() if n != name}
        assert sd_over_prior(drive, **others)[0][1] < 0.7 * none[1]
    no_sinkage = sd_over_prior(drive, sinkage=math.nan)[0]
    assert whole[0] < no_sinkage[0] < 0.9 and 0.9 * whole[1] < no_sinkage[1] < 0.6
    assert no_sinkage[2] > 1.5 * whole[2]


def test_without_any_force_nothing_is_known_but_the_stiffness(drive):
    """Load known by the mass of the wheel alone, which is doubted by 5 %; the mass stays as it
    is.
    """
    sd, identifier = sd_over_prior(drive, load=math.nan, **NO_FORCE)
    assert sd[2] < 0.8
    assert np.all(sd[:2] > 0.9 * left_by_sinkage(drive[0])[[TANGENT, LN_K]])
    mass = drive[0].wheel.body_mass
    assert identifier._memory["mass"][0] == pytest.approx(mass, rel=0.01)
    mean, doubt = identifier.estimate.instruments.load_gain
    assert abs(mean) < 0.05 and 0.03 < doubt <= math.hypot(PAYLOAD, drive[0].noise.load_gain)


@pytest.mark.parametrize("every", [2, 10])
def test_a_sinkage_that_is_missing_now_and_then_makes_no_stiffness_surer(short_drives, every):
    """What stands in its place does not count as measured; in the mean of courses, since the form
    error is another in each.
    """
    sds = np.zeros((len(short_drives), 3))
    for row, (scenario, readings, _) in zip(sds, short_drives, strict=True):
        for i, measured in enumerate((1, every, len(readings))):
            identifier = OnlineIdentifier.of_scenario(scenario)
            for k, r in enumerate(readings):
                identifier.update(r if k % measured == 0 else r._replace(sinkage=math.nan))
            row[i] = identifier.estimate.sinkage_coefficient_relative_sd
    all_of_them, some, first_alone = sds.mean(axis=0)
    assert all_of_them < some < 0.9 * first_alone


def test_one_missing_sinkage_is_one_reading_less(short_drives):
    """Whichever reading of the last points it is: what the others measured stays known."""
    scenario, readings, _ = short_drives[0]
    known = []
    for gone in (None, *range(len(readings) - 10, len(readings))):
        identifier = OnlineIdentifier.of_scenario(scenario)
        for k, r in enumerate(readings):
            identifier.update(r._replace(sinkage=math.nan) if k == gone else r)
        known.append(identifier.estimate.sinkage_coefficient_relative_sd)
    assert max(known) < 1.1 * known[0]


def test_a_gap_in_the_sinkage_takes_nothing_from_what_was_measured(short_drives):
    """Points without a sinkage are averaged with no others; these keep what they know."""
    sds = []
    for scenario, readings, _ in short_drives:
        whole, some = (OnlineIdentifier.of_scenario(scenario) for _ in range(2))
        middle = len(readings) // 2
        for k, r in enumerate(readings):
            whole.update(r)
            some.update(r._replace(sinkage=math.nan) if middle <= k < middle + 25 else r)
        memory = some._memory[0]
        cells = memory["cells"][: memory["cells_kept"]]
        unknown = cells["sinkage_variance"] > scenario.wheel.radius**2
        assert cells["readings"][unknown].sum() <= 33  # those without, and up to the end of a point
        sds.append([i.estimate.sinkage_coefficient_relative_sd for i in (whole, some)])
    all_of_them, without = np.mean(sds, axis=0)
    assert all_of_them < without < 1.3 * all_of_them


def test_a_load_that_is_missing_now_and_then_is_that_of_the_others():
    """The load of a cell is that of the readings that had one."""
    scenario = load_rover("mars_rover")
    identifier = OnlineIdentifier.of_scenario(scenario)
    load = 1.25 * scenario.weight
    for k in range(60):
        measured = math.nan if k % 2 else load
        identifier.update(STEADY._replace(load=measured, time=0.1 * (k + 1)))
    assert identifier._memory["cells"][0, 0]["load"] == pytest.approx(load)


@pytest.mark.parametrize("missing", [("drawbar_pull", "acceleration"), ("pitch",)])
def test_a_wheel_at_rest_shows_no_zero_of_a_pull_that_is_not_measured(missing):
    """Neither without pull and acceleration, nor without the pitch, which gives the weight along
    the slope.
    """
    pitch = math.radians(10.0)
    load = WHEEL.body_mass * 9.81
    gone = dict.fromkeys(missing, math.nan)
    rest = Readings(0.0, 0.0, 0.03, load * math.sin(pitch), load * math.cos(pitch), 0.0, 0.0, pitch)
    identifier = OnlineIdentifier(WHEEL)
    prior = identifier.estimate.instruments.pull_zero
    for k in range(1, 61):
        identifier.update(rest._replace(time=0.1 * k, **gone))
    drive = STEADY._replace(pitch=pitch)
    for k in range(61, 90):
        identifier.update(drive._replace(time=0.1 * k))
    assert identifier._memory["rests"][0] == 0.0
    assert identifier.estimate.instruments.pull_zero[1] > 0.8 * prior[1]


def test_without_a_sinkage_sensor_on_soil_that_hardly_bears():
    """What stands for the sinkage is one that a wheel can have."""
    identifier = OnlineIdentifier(WHEEL, dataclasses.replace(BELIEF, sinkage_coefficient=3e4))
    for k in range(1, 31):
        identifier.update(STEADY._replace(sinkage=math.nan, time=0.1 * k))
    assert identifier.estimate.refused == 0 and identifier.estimate.status != Status.NO_DATA


#: A reading of `WHEEL` as it drives steadily at slip 0.25; a pull, a torque and a sinkage by hand.
STEADY = Readings(2.5, 0.28, 0.022, 14.0, 147.0, 5.5, 0.25)
SOIL = SoilState(
    math.tan(math.radians(35.0)),
    900.0,
    0.018,
    8e5,
    BELIEF.sinkage_exponent,
    BELIEF.dig_gain,
    BELIEF.dig_recovery,
    BELIEF.rim_flow,
    BELIEF.braked_peak,
)


def of_soil(slip):
    """`Readings` of `WHEEL` in the steady state at a slip in `SOIL`, its rim at 2 rad/s, without a
    slip sensor.
    """
    load = WHEEL.body_mass * 9.81
    s = steady_state(slip, load, SOIL, WHEEL.radius, WHEEL.width)
    speed = 2.0 * WHEEL.radius * (1.0 - slip)
    return Readings(2.0, speed, s.sinkage, s.drawbar_pull, load, s.torque)


def test_what_stands_for_pull_and_torque():
    """Pull = m a; the motor torque turns the wheel, whose inertia costs none at a constant
    speed.
    """
    exact = calibrated(Noise(acceleration=0.01 * 9.81))
    one = OnlineIdentifier(WHEEL, BELIEF, exact)
    other = OnlineIdentifier(WHEEL, BELIEF, exact)
    for k in range(60):
        r = of_soil(0.25 - 0.15 * math.sin(0.2 * k))
        a = one.update(r)
        b = other.update(
            r._replace(
                drawbar_pull=math.nan,
                acceleration=r.drawbar_pull / WHEEL.body_mass,
                torque=math.nan,
                motor_torque=r.torque,
            )
        )
    assert b.friction_angle_deg == pytest.approx(a.friction_angle_deg, rel=1e-3)
    assert b.shear_modulus == pytest.approx(a.shear_modulus, rel=1e-3)
    assert a.friction_angle_deg == pytest.approx(35.0, abs=2.0)  # not the prior's 30
    assert a.shear_modulus == pytest.approx(0.018, rel=0.1)  # not 0.012


def test_slip_from_the_speeds_and_a_speed_from_the_slip():
    rim = np.array([0.4, 0.3, -0.4, 0.0, math.nan])
    speed = np.array([0.3, 0.4, -0.3, 0.0, 0.1])
    assert slips(rim, speed) == pytest.approx([0.25, -0.25, 0.25, 0.0, math.nan], nan_ok=True)
    exact = Noise(slip=0.0, speed=0.0, wheel_speed=0.0)
    given, derived, no_speed = (OnlineIdentifier(WHEEL, BELIEF, exact) for _ in range(3))
    for _ in range(20):
        r = STEADY._replace(speed=2.5 * WHEEL.radius * 0.75)
        a = given.update(r)
        b = derived.update(r._replace(slip=math.nan))
        c = no_speed.update(r._replace(speed=math.nan))
        assert b.friction_angle_deg == pytest.approx(a.friction_angle_deg, rel=1e-3)
        assert c.friction_angle_deg == pytest.approx(a.friction_angle_deg, rel=1e-3)
    assert a.friction_angle_deg != given.scenario.belief.friction_angle_deg


@pytest.mark.parametrize("slip", [-1.2, -1.0, -0.99, 0.99, 1.2])
def test_a_locked_or_spinning_wheel_tells_one_speed_only(slip):
    """Of a locked wheel the travel speed does not follow, of a spinning one that of the rim."""
    identifier = OnlineIdentifier(WHEEL)
    r = STEADY._replace(slip=slip)
    for lacking in (r._replace(speed=math.nan), r._replace(wheel_speed=math.nan, speed=0.2)):
        identifier.update(lacking._replace(time=math.nan))
    rim, speed = identifier._speeds(r._replace(speed=math.nan))
    assert math.isnan(speed) == (slip < 0.0) and not speed < 0.0
    rim, _ = identifier._speeds(r._replace(wheel_speed=math.nan, speed=0.2))
    assert math.isnan(rim) == (slip > 0.0)


def test_a_slip_sensor_that_is_silent_makes_no_slip_sharper():
    """A slip that follows from the speeds has their noise, also where a sensor is stated."""
    silent, without = (OnlineIdentifier(WHEEL, noise=Noise(slip=x)) for x in (1e-3, 0.0))
    for k in range(60):
        r = of_soil(0.25 - 0.15 * math.sin(0.2 * k))
        a, b = silent.update(r), without.update(r)
    assert a == b and a.friction_angle_sd_deg < 0.9 * Belief().friction_sd_deg


def test_of_a_rover_it_is_the_identifier_of_the_front_wheel():
    env = SoilRoverEnv(action="torque", scaled=False)
    env.reset(seed=1)
    worlds = env.simulation.worlds
    radius = env.scenario.wheel.radius
    identifier = OnlineIdentifier.of_scenario(env.scenario)
    for k in range(160):
        env.step([0.3 + 0.2 * math.sin(k / 7.0)] * 2)
        read = worlds.readings[0, 0, 0]
        given = {name: float(read[name]) for name in Readings._fields if name in read.dtype.names}
        e = identifier.update(Readings(wheel_speed=read["rim_speed"] / radius, **given))
    front = worlds.ids.estimate[0, 0], worlds.ids.sd[0, 0]
    expected = math.degrees(front[0][0]), math.degrees(front[1][0]), math.exp(front[0][1])
    found = e.friction_angle_deg, e.friction_angle_sd_deg, e.shear_modulus
    assert found == pytest.approx(expected, rel=1e-6)


ABSURD = [
    {"sinkage": 22.0},
    {"torque": math.inf},
    {"time": 0.4},
    {"load": -1e9},
    {"wheel_speed": 10**400},
    {"time": 10**400},
    {"load": "147"},
    {"wheel_speed": None},
    {"speed": np.array([0.28, 0.28])},
    {"wheel_speed": math.nan, "slip": math.nan, "load": "147"},
]


@pytest.mark.parametrize("wrong", ABSURD, ids=str)
def test_bad_readings_are_refused_and_leave_no_trace(wrong):
    one = OnlineIdentifier(WHEEL)
    other = OnlineIdentifier(WHEEL)
    numbers = all(isinstance(value, (int, float)) for value in wrong.values())
    for k in range(1, 16):
        assert one.update(STEADY._replace(time=0.1 * k)) == other.update(
            STEADY._replace(time=0.1 * k)
        )
        if k == 5:
            with pytest.raises(ValueError if numbers else TypeError) as refusal:
                one.update(STEADY._replace(**({"time": 0.6} | wrong)))
            assert f"{list(wrong)[-1]} = " in str(refusal.value) and "expected" in str(
                refusal.value
            )


def test_a_number_beyond_all_floats_is_refused():
    identifier = OnlineIdentifier(WHEEL)
    refused(lambda: identifier.traversability(load=10**400), "load = 1e+400: expected")
    refused(lambda: identifier.traversability(pitch=-(10**400)), "pitch = -1e+400: expected")


def test_whatever_is_admitted_gives_a_soil():
    """Readings up to their limits, of any sign, some missing: finite numbers, a valid `Soil`, no
    warning.
    """
    rng = np.random.default_rng(3)
    limits = largest_readings(WHEEL)[:-1]
    n = len(limits)
    typical = STEADY._replace(pitch=0.0, motor_torque=5.5, acceleration=0.3)[:-1]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(40):
            identifier = OnlineIdentifier(WHEEL)
            size = np.where(rng.random(n) < 0.4, 10.0 ** rng.uniform(-4, 4, n), 1.0)
            size *= np.where(rng.random(n) < 0.2, -1.0, 1.0)
            missing = (rng.random(n) < 0.2) & (np.arange(n) > 0)
            for _ in range(40):
                values = np.array(typical) * size * (1.0 + 0.3 * rng.normal(size=n))
                values = np.where(missing, math.nan, np.clip(values, np.negative(limits), limits))
                try:
                    e = identifier.update(Readings(*values.tolist()))
                except ValueError:  # a speed from the slip, beyond its own limit
                    continue
                assert all(math.isfinite(x) for x in dataclasses.astuple(e)[:10])
                identifier.soil()
                assert math.isfinite(identifier.traversability().drawbar_margin)


def test_time_stamps_count_as_time():
    """Readings half a second apart lie 10 times as far apart as at 0.05 s. A point then reaches its
    longest travel before its number of readings, so that there are more points.
    """
    renewed = []
    for dt in (0.5, 0.05):
        identifier = OnlineIdentifier(WHEEL)
        time = 0.0
        for _ in range(40):  # until points are of the full length
            time = time + dt
            identifier.update(of_soil(0.25)._replace(time=time))
        count = 0
        for _ in range(80):
            time = time + dt
            count += identifier.update(of_soil(0.25)._replace(time=time)).renewed
        renewed.append(count)
    assert renewed[0] > 1.3 * renewed[1] and identifier.estimate.borders == 0
    for dt in (1e-6, 100.0):
        with pytest.warns(
            UserWarning, match=f"time = .* {dt:g} s after .*: expected 0.001 to 10 s"
        ):
            identifier.update(STEADY._replace(time=identifier._time + dt))
    with warnings.catch_warnings():  # times of the shortest step, rounded as those since 1970 are
        warnings.simplefilter("error")
        identifier.reset()
        for k in range(50):
            identifier.update(STEADY._replace(time=1.77e9 + 1e-3 * k))


def test_reset_and_copy():
    identifier = OnlineIdentifier(WHEEL, Belief(friction_angle_deg=35.0), period=0.05, gravity=1.62)
    fresh = identifier.estimate
    for _ in range(7):
        identifier.update(STEADY)
    copies = [
        pickle.loads(pickle.dumps(identifier)),
        copy.copy(identifier),
        copy.deepcopy(identifier),
    ]
    after = [identifier.update(STEADY) for _ in range(5)]
    for other in copies:
        assert [other.update(STEADY) for _ in range(5)] == after
    identifier.reset()
    assert identifier.estimate == fresh and fresh.friction_angle_deg == pytest.approx(35.0)
    assert identifier.soil().dig_recovery == identifier.scenario.belief.dig_recovery


def test_a_wheel_that_is_lifted_at_first_does_not_begin_its_mass(drive):
    """Loads of 0 in the first periods do not count: the mass comes from the loads after them."""
    scenario, readings, _ = drive
    own = OnlineIdentifier.of_scenario(scenario)
    for k, reading in enumerate(readings):
        own.update(reading._replace(load=0.0) if k < 8 else reading)
    assert 0.9 < own._memory["mass"][0] * scenario.gravity / scenario.weight < 1.2
    assert own.estimate.best_pull < 1.0


def test_ground_on_which_the_motor_stalls_is_not_passable():
    """Under a load under which it can turn the wheel at no slip."""
    own = OnlineIdentifier(wheels()["planetary_rover"])
    way = own.traversability(load=600.0)
    assert own.traversability().passable and not way.passable and way.drawbar_margin == -1.0
