"""The online identifier by itself: that of the environment, and what it makes of channels that are missing."""

import math
import pickle

import gymnasium
import numpy as np
import pytest

import soil_env  # noqa: F401  (registers SoilWheel-v0)
from soil_env.online import OnlineIdentifier, Readings, Status, slips
from soil_env.parameters import Belief, Noise, wheels

WHEEL = wheels()["planetary_rover"]


@pytest.fixture(scope="module")
def drive():
    """(scenario, readings, infos) of 520 periods, the readings out of the observation (float32)."""
    env = gymnasium.make("SoilWheel-v0").unwrapped
    env.reset(seed=3)
    scenario, readings, infos = env.scenario, [], []
    weight, r = scenario.weight, scenario.wheel.radius
    for step in range(1, 521):
        observation, _, over, _, info = env.step([0.35 + 0.2 * math.sin((step - 1) / 7)])
        o = dict(zip(env.observation_names, observation.tolist(), strict=True))
        top = scenario.wheel.no_load_speed
        readings.append(
            Readings(
                o["rim_speed"] * top, o["speed"] * top * r, o["sinkage"] * r, o["drawbar_pull"] * weight,
                o["load"] * weight, o["torque"] * weight * r, o["slip"], o["pitch"], time=0.1 * step,
            )
        )  # fmt: skip
        infos.append(info)
        assert not over
    return scenario, readings, infos


def least(scenario, readings, **missing):
    """Least standard deviations (phi [deg], K, S) over the drive with fields replaced, and the last estimate."""
    identifier = OnlineIdentifier.of_scenario(scenario)
    estimates = [identifier.update(r._replace(**missing)) for r in readings]
    names = ("friction_angle_sd_deg", "shear_modulus_relative_sd", "sinkage_coefficient_relative_sd")
    return *(min(getattr(e, name) for e in estimates) for name in names), estimates[-1]


def test_it_is_the_identifier_of_the_environment(drive):
    scenario, readings, infos = drive
    identifier, renewals, seen = OnlineIdentifier.of_scenario(scenario), 0, set()
    for r, info in zip(readings, infos, strict=True):
        e, expected = identifier.update(r), dict(info["estimate"])
        renewals += e.renewed
        seen.add(e.status)
        assert e.status.name == expected.pop("status")
        for name, value in expected.items():
            assert getattr(e, name) == pytest.approx(value, rel=1e-4), name
        if e.renewed:
            way, told = identifier.traversability(r.load, r.pitch), info["traversability"]
            assert way.best_slip == told["best_slip"] and way.passable == told["passable"]
            assert way.drawbar_margin == pytest.approx(told["drawbar_margin"], abs=1e-4)
    assert 50 < renewals < 300 and seen >= {Status.CONVERGED, Status.NOT_EXCITED}


def test_without_a_channel_less_is_known(drive):
    """The order of the uncertainties; that nothing measures shear where neither pull nor torque is there."""
    scenario, readings, _ = drive
    nan = math.nan
    belief = scenario.belief
    _, whole, _, _ = least(scenario, readings)
    for names in ({"torque": nan}, {"drawbar_pull": nan}, {"load": nan}):
        part = least(scenario, readings, **names)[1]  # of another estimate, and so not less to the last digit
        assert 0.9 * whole < part < 0.5 * belief.shear_modulus_sd
    phi, _, s, _ = least(scenario, readings, torque=nan, drawbar_pull=nan)
    assert phi > 0.95 * belief.friction_sd_deg and s < 0.7 * belief.sinkage_coefficient_sd
    blind = least(scenario, readings, sinkage=nan)[-1]
    assert blind.status == Status.NO_DATA and blind.friction_angle_deg == pytest.approx(belief.friction_angle_deg)
    _, _, s, unweighed = least(scenario, readings, load=nan, torque=nan, drawbar_pull=nan)
    assert s == pytest.approx(belief.sinkage_coefficient_sd)
    assert unweighed.sinkage_coefficient == pytest.approx(belief.sinkage_coefficient)


STEADY = Readings(2.5, 0.28, 0.022, 14.0, 147.0, 5.5, 0.25)


def five(third, first=0.0):
    """Estimate of S after five readings, which make a point: `third` the torque of the third, `first` added to that
    of the first."""
    identifier = OnlineIdentifier(WHEEL)
    torques = [5.5 + first, 5.5, third, 5.5, 5.5]
    slow = STEADY._replace(wheel_speed=0.75, speed=0.75 * 0.15 * 0.75)
    last = [identifier.update(slow._replace(torque=t)) for t in torques][-1]
    assert last.renewed
    return last.sinkage_coefficient, last.friction_angle_deg


def test_an_average_with_a_gap_in_it_goes_without_the_channel():
    assert five(5.5) != five(5.5, first=1.0)
    assert five(math.nan) == five(math.nan, first=1.0) != five(5.5)


def test_what_stands_for_pull_and_torque():
    """Pull = m a; T = T_motor - J dw/dt, the law of the wheel's rotation. Noise of the wheel speed left out."""
    noise = Noise(wheel_speed=0.0)
    one, other = OnlineIdentifier(WHEEL, noise=noise), OnlineIdentifier(WHEEL, noise=noise)
    w = 2.0
    one.update(STEADY._replace(wheel_speed=w)), other.update(STEADY._replace(wheel_speed=w))
    for k in range(1, 21):
        rate = 0.3 * math.cos(0.2 * k)
        w += 0.1 * rate
        a = one.update(STEADY._replace(wheel_speed=w))
        b = other.update(
            STEADY._replace(
                wheel_speed=w, drawbar_pull=math.nan, acceleration=14.0 / WHEEL.body_mass,
                torque=math.nan, motor_torque=5.5 + WHEEL.inertia * rate,
            )
        )  # fmt: skip
        assert b.friction_angle_deg == pytest.approx(a.friction_angle_deg, rel=1e-9)
        assert b.sinkage_coefficient == pytest.approx(a.sinkage_coefficient, rel=1e-9)
    assert a.friction_angle_deg != pytest.approx(30.0, abs=0.01)


def test_slip_from_the_speeds_and_a_speed_from_the_slip():
    assert slips(np.array([0.4, 0.3, -0.4, 0.0, math.nan]), np.array([0.3, 0.4, -0.3, 0.0, 0.1])) == pytest.approx(
        [0.25, -0.25, 0.25, 0.0, math.nan], nan_ok=True
    )
    exact = Noise(slip=0.0, speed=0.0, wheel_speed=0.0)
    given, derived, no_speed = (OnlineIdentifier(WHEEL, noise=exact) for _ in range(3))
    for _ in range(10):
        r = STEADY._replace(speed=2.5 * WHEEL.radius * 0.75)
        a, b = given.update(r), derived.update(r._replace(slip=math.nan))
        c = no_speed.update(r._replace(speed=math.nan))
        assert b.friction_angle_deg == pytest.approx(a.friction_angle_deg, rel=1e-9)
        assert c.friction_angle_deg == pytest.approx(a.friction_angle_deg, rel=1e-9)
    noisy = OnlineIdentifier(WHEEL, noise=Noise(slip=0.0, speed=0.03))
    assert [noisy.update(r._replace(slip=math.nan)) for _ in range(10)][
        -1
    ].friction_angle_sd_deg > a.friction_angle_sd_deg


def test_motion_that_is_not_known_is_passed_over():
    identifier = OnlineIdentifier(WHEEL)
    before = identifier.estimate
    for _ in range(20):
        assert identifier.update(STEADY._replace(wheel_speed=math.nan, slip=math.nan)) == before


@pytest.mark.parametrize(
    "wrong",
    [{"sinkage": 22.0}, {"slip": 25.0}, {"torque": math.inf}, {"speed": -math.inf}, {"time": 0.5}, {"time": 0.4}],
)
def test_bad_readings_are_refused_and_leave_no_trace(wrong):
    one, other = OnlineIdentifier(WHEEL), OnlineIdentifier(WHEEL)
    for k in range(1, 6):
        one.update(STEADY._replace(time=0.1 * k))
        other.update(STEADY._replace(time=0.1 * k))
    with pytest.raises(ValueError):
        one.update(STEADY._replace(**({"time": 0.6} | wrong)))
    for k in range(6, 16):
        a, b = one.update(STEADY._replace(time=0.1 * k)), other.update(STEADY._replace(time=0.1 * k))
        assert a == b


def test_time_stamps_count_as_time():
    """Five readings a quarter of a second apart go 5 times as far as at 0.05 s: the open point is closed before."""
    slow, fast = OnlineIdentifier(WHEEL), OnlineIdentifier(WHEEL)
    renewed = [
        sum(i.update(STEADY._replace(time=dt * k)).renewed for k in range(1, 11))
        for i, dt in ((slow, 0.25), (fast, 0.05))
    ]
    assert renewed[0] > renewed[1]


def test_reset_and_copy():
    identifier = OnlineIdentifier(WHEEL, Belief(friction_angle_deg=35.0), period=0.05, gravity=1.62)
    fresh = identifier.estimate
    for _ in range(7):
        identifier.update(STEADY)
    copy = pickle.loads(pickle.dumps(identifier))
    assert [copy.update(STEADY) for _ in range(5)] == [identifier.update(STEADY) for _ in range(5)]
    identifier.reset()
    assert identifier.estimate == fresh and fresh.friction_angle_deg == pytest.approx(35.0)
    assert identifier.soil().dig_recovery == identifier.scenario.belief.dig_recovery
