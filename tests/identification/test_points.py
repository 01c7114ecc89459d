"""Points: means of two sensors, which readings belong to none, clocks of the law of sinkage, and
the zero of the pull.
"""

import math

import numpy as np
import pytest

from soil_env.identification import Status
from soil_env.identification.online.identifier import HELD, RENEWED
from soil_env.identification.online.memory import PULL_ZERO
from soil_env.identification.online.points import (
    BLUNTEST,
    FEW_READINGS,
    FIRST_POINTS,
    LAG,
    LIFTED,
    LOCKED,
    LONGEST,
    READINGS,
    SHARPEST_SLIP,
    SLIP_RANGE,
    SLOWEST,
    SPIN_ERROR,
    SPINNING,
    STANDSTILL,
    THROWN,
    TYPICAL_PULL,
    TYPICAL_TORQUE,
)
from soil_env.online import slips
from soil_env.parameters import load_scenario
from soil_env.parameters.readings import largest_sensed
from tests.identification.observing import SAND, SCENARIO, Identified, R, W, driven

PERIOD = SCENARIO.control.period
(STEADY,) = driven(SAND, [0.25], SCENARIO, speed=0.4)
HALT = STEADY._replace(slip=0.0, speed=0.0, rim_speed=0.0, drawbar_pull=0.0, acceleration=0.0)
# two sensors of pull and of torque that are about as good
NOISE = {
    "speed": 0.002,
    "drawbar_pull": 0.01,
    "drawbar_pull_zero": 0.004,
    "drawbar_pull_gain": 0.01,
    "acceleration": 0.1,
    "acceleration_zero": 0.05,
    "load": 1e-6,
    "load_gain": 0.02,
    "torque": 0.01,
    "torque_zero": 0.004,
    "torque_gain": 0.01,
    "motor_torque": 0.012,
    "motor_torque_zero": 0.003,
    "motor_torque_gain": 0.02,
}


@pytest.fixture
def wheel():
    return Identified(SCENARIO)


def first_point(wheel, readings):
    """The first cell, after these readings and a reading that ends their point."""
    wheel.start()
    wheel.observe([readings[0]])  # the wheel begins to turn
    wheel.observe([*readings, HALT])
    assert len(wheel.cells) == 1
    return wheel.cells[0]


def combined(white, zero, gain, values):
    """(share of the second of two sensors, mean, its white variance) by their precisions; all [2]
    in one unit.
    """
    precision = 1.0 / (np.square(white) + np.square(zero) + np.square(gain))
    shares = precision / precision.sum()
    return shares[1], shares @ values, shares**2 @ np.square(white)


def test_two_sensors_of_a_quantity_are_averaged_by_their_precision():
    """Pull by its sensor and by acceleration and mass, torque by its sensor and the motor's."""
    wheel = Identified(load_scenario("mixed", {"noise": NOISE}))
    r = STEADY._replace(acceleration=1.1, motor_torque=5.9)
    cell = first_point(wheel, [r] * 3)
    of = wheel.scenario.noise
    mass = r.load / SCENARIO.gravity
    pull = combined(
        (of.drawbar_pull, mass / W * of.acceleration),
        (of.drawbar_pull_zero, mass / W * of.acceleration_zero),
        TYPICAL_PULL * np.hypot((of.drawbar_pull_gain, of.acceleration_gain), (0.0, of.load_gain)),
        np.array([r.drawbar_pull, mass * r.acceleration]) / W,
    )
    torque = combined(
        (of.torque, of.motor_torque),
        (of.torque_zero, of.motor_torque_zero),
        np.multiply(TYPICAL_TORQUE, (of.torque_gain, of.motor_torque_gain)),
        np.array([r.torque, r.motor_torque]) / (W * R),
    )
    for share, name, expected in (("inertial", "pull", pull), ("motor", "torque", torque)):
        found = [cell[share], cell[name], 3.0 * cell[f"{name}_variance"]]
        assert found == pytest.approx(expected, rel=1e-6) and 0.2 < cell[share] < 0.8


@pytest.mark.parametrize("slip", [0.3, -0.2])
def test_the_variances_of_a_point_are_those_of_its_noise(slip):
    """Over 400 points with white noise of all sensors, driving and braking."""
    wheel = Identified(load_scenario("mixed", {"noise": NOISE}))
    rng = np.random.default_rng(0)
    of = wheel.set.white[0]
    rim = 0.4
    travel = rim * (1.0 - slip) if slip > 0.0 else rim / (1.0 + slip)
    mean = STEADY._replace(rim_speed=rim, speed=travel)
    cells = []
    for _ in range(400):
        readings = []
        for _ in range(3):
            noise = {
                name: getattr(mean, name) + of[name] * rng.standard_normal()
                for name in ("sinkage", "drawbar_pull", "torque", "motor_torque", "acceleration")
            }
            speed = travel + of.speed * rng.standard_normal()
            (read,) = slips(np.array([rim]), np.array([speed]))
            readings.append(mean._replace(slip=float(read), speed=speed, **noise))
        cells.append(first_point(wheel, readings).copy())
    # the rim speed has no noise here; its share of the noise of slip is left out of the account
    both = np.hypot(of.speed, travel / rim * of.rim_speed) / of.speed
    for name, scale in (("slip", both), ("sinkage", 1.0), ("pull", 1.0), ("torque", 1.0)):
        found = np.std([cell[name] for cell in cells]) * scale
        stated = math.sqrt(np.mean([cell[f"{name}_variance"] for cell in cells]))
        assert found == pytest.approx(stated, rel=0.1), name


def test_the_forces_of_a_point_are_those_at_its_slip():
    """A wheel that is braked: a slow wheel's slip is less well known, so the means of slip and of
    forces that follow it in proportion need the same weights.
    """
    noise = NOISE | {"motor_torque": 1.0}  # a torque that turns the wheel faster is its noise too
    wheel = Identified(load_scenario("mixed", {"noise": noise}))
    mass = STEADY.load / SCENARIO.gravity
    readings = []
    for k, slip in enumerate((0.04, 0.01, -0.02)):
        rim = 0.3 - 0.09 * k
        pull = W * (0.1 + 2.0 * slip)
        torque = W * R * (0.2 + 2.0 * slip)
        r = STEADY._replace(slip=slip, rim_speed=rim, speed=rim * (1.0 - slip))
        forces = {"drawbar_pull": pull, "acceleration": pull / mass}
        readings.append(r._replace(torque=torque, motor_torque=torque, **forces))
    cell = first_point(wheel, readings)
    assert cell["readings"] == 3 and cell["slip"] > 0.02
    assert cell["pull"] == pytest.approx(0.1 + 2.0 * cell["slip"], abs=1e-9)
    assert cell["torque"] == pytest.approx(0.2 + 2.0 * cell["slip"], abs=1e-6)


def test_the_variance_of_a_torque_is_that_of_unlike_readings():
    """Where the wheel turns faster from one reading to the next the motor tells less of the torque,
    and a faster wheel is surer of its slip.
    """
    wheel = Identified(load_scenario("mixed", {"noise": NOISE}))
    readings = [
        STEADY._replace(rim_speed=rim, speed=0.75 * rim, motor_torque=STEADY.torque)
        for rim in (0.4, 0.4, 0.415)
    ]
    stated = first_point(wheel, readings)["torque_variance"]
    white = wheel.set.white[0]
    spin = SPIN_ERROR * SCENARIO.wheel.inertia / (R * PERIOD)
    expected = 0.0
    before = readings[0].rim_speed
    for k, r in enumerate(readings):
        turned = max((r.rim_speed - before) ** 2 - 2.0 * white.rim_speed**2, 0.0)
        before = r.rim_speed
        for name, more in (("torque", 0.0), ("motor_torque", spin**2 * turned)):
            ends = []
            for change in (-0.1, 0.1):
                off = [*readings]
                off[k] = r._replace(**{name: getattr(r, name) + change})
                ends.append(first_point(wheel, off)["torque"])
            expected += ((ends[1] - ends[0]) / 0.2) ** 2 * (white[name] ** 2 + more)
    assert stated == pytest.approx(expected, rel=1e-6)


def test_a_slip_sensor_counts_in_place_of_the_speeds():
    wheel = Identified(load_scenario("mixed", {"noise": {"slip": 0.02}}))
    cell = first_point(wheel, [STEADY._replace(slip=0.27)] * 3)
    assert cell["slip"] == pytest.approx(0.27)
    assert cell["slip_variance"] == pytest.approx(0.02**2 / 3.0)


def test_a_motor_that_accelerates_the_wheel_tells_little_of_the_torque(wheel):
    """Where the rim speed changes from reading to reading the soil's share is the sensor's."""
    steady = first_point(wheel, [STEADY] * 3)["motor"]
    faster = [STEADY._replace(rim_speed=0.4 + 0.03 * k) for k in range(3)]
    assert first_point(wheel, faster)["motor"] < 0.5 * steady


def points_of(wheel, reading, count):
    """Readings of each point that so many like this, after one that turns the wheel, complete."""
    wheel.start()
    wheel.observe([reading])
    sizes = []
    for _ in range(count):
        collected = wheel.now.open[0].readings
        if wheel.observe([reading]) == [RENEWED]:
            sizes.append(collected)
    return sizes


def test_points_are_a_few_readings_and_the_first_fewer(wheel):
    """Where the slip is sharp enough by then."""
    cell = first_point(wheel, [STEADY] * 3)
    assert cell["slip_variance"] * 3.0 / FEW_READINGS < SHARPEST_SLIP**2
    sizes = points_of(wheel, STEADY, 60)
    assert sizes[:FIRST_POINTS] == [FEW_READINGS] * FIRST_POINTS
    assert sizes[-1] == READINGS


def test_a_slow_wheel_needs_more_readings_for_as_sharp_a_slip(wheel):
    sizes = points_of(wheel, STEADY._replace(speed=0.075, rim_speed=0.1), 80)
    (cell,) = wheel.cells
    by_one = cell["slip_variance"] * cell["readings"]
    needed = by_one / SHARPEST_SLIP**2
    assert needed > FEW_READINGS + 1.0 and set(sizes) == {math.ceil(needed)}


def test_a_fast_wheel_has_points_of_so_much_way(wheel):
    """The ground is not the same any more further on."""
    fast = STEADY._replace(speed=2.4, rim_speed=3.2)
    sizes = points_of(wheel, fast, 20)
    most = math.floor(LONGEST * R / (fast.speed * PERIOD)) + 1
    assert most < FEW_READINGS and set(sizes) == {most}


def test_an_unlike_slip_begins_another_point(wheel):
    """A slip that is further off than noise and the range of a point."""
    error = math.sqrt(first_point(wheel, [STEADY] * 3)["slip_variance"] * 3.0)
    wheel.start()
    off = SLIP_RANGE + 3.2 * error
    near = STEADY.slip + 0.5 * SLIP_RANGE
    readings = [STEADY, STEADY, STEADY._replace(slip=near), STEADY._replace(slip=near + off)]
    assert wheel.observe(readings) == [HELD, HELD, HELD, RENEWED]
    assert wheel.cells[0]["slip"] == pytest.approx(0.5 * (STEADY.slip + near))


IN_NO_POINT = {
    "at rest": {"rim_speed": 0.0, "speed": 0.0},
    "nearly at rest": {"rim_speed": 0.9 * SLOWEST, "speed": 0.9 * SLOWEST},
    "backward": {"rim_speed": -0.4, "speed": -0.3},
    "spinning": {"slip": SPINNING + 0.01},
    "locked": {"slip": LOCKED - 0.01},
    "above the ground": {"sinkage": -1e-4},
    "in the air": {"load": 0.9 * LIFTED * W},
}
NO_WHEEL = {
    f"{name} {wrong}": {name: wrong}
    for name, limit in largest_sensed(SCENARIO.wheel, SCENARIO.gravity)._asdict().items()
    for wrong in (math.nan, math.inf, -math.inf, 1.01 * limit, -1.01 * limit)
}


def learnt(wheel):
    """All that a fit leaves."""
    now = wheel.now
    arrays = (now.estimate, now.sd, now.u, now.covariance, [now.status, now.points])
    return np.concatenate([np.ravel(array) for array in arrays])


@pytest.mark.parametrize("changes", IN_NO_POINT.values(), ids=IN_NO_POINT)
def test_a_wheel_that_does_not_drive_on_the_ground_tells_nothing(wheel, changes):
    """At the start, and, but for the end of the open point, after a drive."""
    other = STEADY._replace(**changes)
    for drive in ([], [STEADY] * 20 + [other]):
        wheel.start()
        wheel.observe(drive)
        before = learnt(wheel)
        assert set(wheel.observe([other] * 30)) == {HELD}
        np.testing.assert_array_equal(learnt(wheel), before)
        assert (wheel.now.status == Status.NO_DATA.value) != bool(drive)
        assert wheel.now.refused == 0.0


def test_a_wheel_in_the_air_has_the_mass_that_it_had_on_the_ground(wheel):
    wheel.observe([STEADY] * 20)
    mass = wheel.now.mass
    wheel.observe([STEADY._replace(load=0.0)] * 20)
    assert wheel.now.mass == mass == pytest.approx(STEADY.load / SCENARIO.gravity)


@pytest.mark.parametrize("changes", NO_WHEEL.values(), ids=NO_WHEEL)
def test_readings_that_no_wheel_gives_are_refused(wheel, changes):
    """Nothing changes but their number, in the middle of a point."""
    other = STEADY._replace(**changes)
    wheel.observe([STEADY] * 6)
    before = wheel.memory.copy()
    assert wheel.observe([other] * 5) == [HELD] * 5
    assert wheel.now.refused == 5.0
    before["refused"] = 5.0
    assert wheel.memory.tobytes() == before.tobytes()


def test_a_rim_that_changes_its_speed_at_once_is_in_no_point(wheel):
    """Laws are those of steady motion; a little slower it is in one."""
    jump = THROWN * SCENARIO.gravity * PERIOD
    for factor, readings in ((1.01, 0.0), (0.99, 1.0)):
        wheel.start()
        wheel.observe([STEADY, STEADY._replace(rim_speed=STEADY.rim_speed + factor * jump)])
        assert wheel.now.open[0].readings == readings


def test_a_slip_that_says_nothing_is_in_no_point():
    noise = {"speed": 1.5 * BLUNTEST * STEADY.rim_speed}
    wheel = Identified(load_scenario("mixed", {"noise": noise}))
    assert set(wheel.observe([STEADY] * 30)) == {HELD}


@pytest.mark.parametrize("known", [False, True])
def test_a_braked_wheel_counts_whatever_its_travel_speed(wheel, known):
    """Chosen by the noise of the travel speed, slips would have another mean than all have."""
    white = wheel.set.white[0]
    rim = math.hypot(white.speed, white.rim_speed) / BLUNTEST * (1.01 if known else 0.99)
    for travel in (0.8, 1.0, 1.2, 1.5):
        (slip,) = slips(np.array([rim]), np.array([travel * rim]))
        r = STEADY._replace(rim_speed=rim, speed=travel * rim, slip=float(slip))
        wheel.start()
        wheel.observe([r] * 3)
        assert (wheel.now.open[0].readings > 0.0) == known, travel


def test_the_load_of_a_point_is_that_of_the_mass_on_its_slope(wheel):
    """Each reading of the load weighs the mass, whose part into the ground it is."""
    pitch = 0.2
    loads = [140.0, 150.0, 148.0]
    readings = [STEADY._replace(load=load, pitch=pitch) for load in loads]
    wheel.observe([readings[0], *readings])
    mass = np.mean([loads[0], *loads]) / (SCENARIO.gravity * math.cos(pitch))
    assert wheel.now.mass == pytest.approx(mass)
    wheel.observe([HALT._replace(load=mass * SCENARIO.gravity)])
    load = mass * SCENARIO.gravity * math.cos(pitch)
    assert wheel.cells[0]["load"] == pytest.approx(load)


def test_place_and_spread_of_a_point_are_those_of_its_readings(wheel):
    """A reading is of the ground in the middle of its period; odometry is at its end."""
    speeds = [0.28, 0.31, 0.33]
    readings = [STEADY._replace(speed=v) for v in speeds]
    cell = first_point(wheel, readings)
    before = [speeds[0], *speeds[:-1]]  # a first reading turns the wheel, from rest
    means = 0.5 * (np.array(before) + speeds)
    ends = 0.5 * speeds[0] * PERIOD + np.cumsum(means) * PERIOD
    places = ends - LAG * np.array(speeds) * PERIOD
    assert cell["place"] == pytest.approx(places.mean())
    assert cell["spread"] == pytest.approx(places.std())


def test_the_way_between_points_is_what_travelled_and_slid(wheel):
    """In lengths in which sinkage adapts, from the middle of one point to that of the next."""
    deeper = STEADY._replace(sinkage=STEADY.sinkage + 0.004, slip=0.5, speed=0.2)
    wheel.observe([STEADY] * 4)  # the first only turns the wheel
    wheel.observe([deeper] * 2 + [HALT])
    first, second = wheel.cells
    length = SCENARIO.relaxation * R
    assert first["changes"] == 0.0 and second["changes"] == 1.0
    # from the middle of three readings to the end of the last, and on to the middle of two
    travel = (1.5 * STEADY.speed + deeper.speed) * PERIOD / length
    slide = (1.5 * 0.1 + 0.2) * PERIOD / length
    assert second["travel"] == pytest.approx(travel)
    assert second["slide"] == pytest.approx(slide)
    assert second["rise"] == pytest.approx(0.004)
    one = wheel.set.white[0].sinkage ** 2  # of a reading
    assert second["rise_variance"] == pytest.approx(one * (1.0 / 3.0 + 1.0 / 2.0))
    assert second["middle"] == pytest.approx(STEADY.sinkage + 0.002)


def test_the_bearing_sinkage_is_that_of_the_point_not_of_the_reading_that_ends_it():
    found = []
    for slip in (0.3, 0.6):
        one = Identified(SCENARIO)
        one.observe([STEADY] * 4)
        one.observe([STEADY._replace(slip=slip, speed=(1.0 - slip) * STEADY.rim_speed)])
        assert one.now.points == 1.0
        found.append(float(one.now.ln_bearing))
    assert found[0] == found[1]


def test_a_change_of_sinkage_over_a_stop_is_not_that_of_the_law(wheel):
    """Soil yields under a wheel that stands."""
    drive = [STEADY] * 4  # the first turns the wheel, the others are a point
    wheel.observe([*drive, *drive[1:], HALT])
    assert (wheel.cells["readings"].sum(), wheel.cells["changes"].sum()) == (6.0, 1.0)
    wheel.observe([HALT, *drive, HALT])
    assert (wheel.cells["readings"].sum(), wheel.cells["changes"].sum()) == (9.0, 1.0)


@pytest.mark.parametrize("pitch", [0.0, 0.15])
def test_the_zero_of_the_pull_is_taken_while_the_wheel_stands(pitch):
    """Beyond the weight on the slope, after it has settled; it is an unknown that is then known."""
    wheel = Identified(load_scenario("mixed", {"noise": {"acceleration": 5.0}}))
    weight = HALT.load / math.cos(pitch)
    zero = 0.013
    along = weight * math.sin(pitch)
    rest = HALT._replace(
        pitch=pitch,
        drawbar_pull=along + zero * W,
        acceleration=SCENARIO.gravity * math.sin(pitch),
    )
    wheel.observe([STEADY._replace(pitch=pitch)])
    wheel.observe([rest] * int(STANDSTILL))
    assert wheel.now.rests == 0.0
    wheel.observe([rest] * 40)
    assert wheel.now.rests == 40.0
    assert wheel.now.rest_pull == pytest.approx(zero, abs=2e-4)
    drive = STEADY._replace(pitch=pitch, drawbar_pull=STEADY.drawbar_pull + zero * W)
    wheel.observe([drive] * 12)
    sd = math.sqrt(wheel.covariance[PULL_ZERO, PULL_ZERO])
    assert wheel.now.u[PULL_ZERO] == pytest.approx(zero, abs=2.0 * sd)
    unrested = Identified(wheel.scenario)
    unrested.observe([drive] * 12)
    assert sd < 0.7 * math.sqrt(unrested.covariance[PULL_ZERO, PULL_ZERO])


def test_a_moving_wheel_shows_no_zero(wheel):
    wheel.observe([STEADY] * 30)
    wheel.observe([HALT, HALT, STEADY] * 10)
    assert wheel.now.rests == 0.0


def test_a_standing_wheel_of_a_rover_shows_no_zero(wheel):
    """Its axles brace against each other: only their sum is the weight on the slope."""
    wheel.set.load_varies = 1
    wheel.observe([STEADY, *[HALT] * 40])
    assert wheel.now.rests == 0.0
