"""Wheel dynamics: step size, derivatives, motor, energy, rest, reverse, extremes and the rut."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from soil_env.parameters import load_scenario, soils
from soil_env.simulation.world import terrain
from soil_env.simulation.world.wheel import PILING, rig_of
from soil_env.terramechanics.effects.multipass import COMPACTION
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.motor import motor_torque
from soil_env.terramechanics.reaction import REST_SPEED
from soil_env.terramechanics.steady import DEEPEST, SHALLOWEST
from tests.simulation.wheels import lay_patches, on_random_courses, on_uniform_ground
from tests.terramechanics.cases import EQUATION_10, FLOW, PLAIN_SOILS, TOGETHER, WHEEL, any_soil

# a course on which half the torque gets through
EASY = {
    "least_pull": 0.2,
    "grade_deg": [-5.0, 2.0],
}

MOTOR = rig_of(load_scenario("mixed"))[0]


def start(mode="torque", soil="dry_sand", grade_deg=0.0):
    """One wheel at rest on uniform ground, without commanded halts."""
    return on_uniform_ground(soils()[soil].state(0.15), math.radians(grade_deg), mode)


FIRST_HALVING = "0.85 of the sinkage's change at the first halving, then 0.47 and 0.50"


#: (model, mean torque command, `own_soils`) of each world.
WORLDS = {
    "flow": (None, 0.22, {}),
    "equation 10": (None, 0.22, PLAIN_SOILS),
    "effects": (WheelSoilModel(WHEEL, None, TOGETHER), 0.5, {}),
}


@cache
def swinging(world, times):
    """x, sinkage and speed [300, 3, 8] of eight wheels on courses of their own, whose torque
    swings, with steps so many times as short.
    """
    model, level, own_soils = WORLDS[world]
    wheels = on_random_courses(range(8), course=EASY, model=model, own_soils=own_soils)
    wheels = wheels.refined(times)
    rows = []
    wheels.state["next_halt"] = 1e9
    for k in range(300):
        wheels.step(level + 0.06 * math.sin(0.1 * k))
        rows.append([wheels.state[name].copy() for name in ("x", "sinkage", "speed")])
    return np.array(rows)


@pytest.mark.parametrize(
    "world",
    [
        pytest.param("flow", marks=pytest.mark.xfail(strict=True, reason=FIRST_HALVING)),
        "equation 10",
        "effects",
    ],
)
def test_the_steps_converge(world):
    """Each halving must shrink the change of (x, sinkage, speed), averaged over eight courses."""
    runs = np.array([swinging(world, times) for times in (1, 2, 4, 8)])
    assert runs[-1, -1, 0].min() > 1.0  # [m]
    change = np.sqrt(np.mean((runs[:-1] - runs[1:]) ** 2, axis=1)) / np.abs(runs[1:]).max(axis=1)
    first, second, third = change.mean(axis=-1)
    assert np.all(second < 0.7 * first) and np.all(third < 0.7 * second)


def test_half_the_step_changes_a_drive_of_30_s_by_less_than_a_percent():
    """Distance, sinkage and speed at its end."""
    usual, half = (swinging("flow", times)[-1] for times in (1, 2))
    assert np.all(np.abs(usual - half).mean(axis=1) < 0.01 * np.abs(half).mean(axis=1))


@pytest.mark.parametrize(
    ("mode", "every", "error"),
    [("torque", 1, 0.06), ("torque", 2, 0.04), ("torque", 5, 0.03), ("wheel_speed", 5, 0.03)],
)
def test_reversals_are_followed(mode, every, error):
    """Full reversals every 0.1 to 0.5 s: distance and work against steps 32 times as short, median
    of 96 courses.
    """
    rng = np.random.default_rng(1)
    runs = []
    size = rng.uniform(0.2, 1.0, (60, 96))
    for refine in (1, 32):
        wheels = on_random_courses(range(96), mode).refined(refine)
        wheels.state["next_halt"] = 1e9
        x = []
        motor_work = np.zeros(96)
        lost = np.zeros(96)
        for k in range(60):
            wheels.step((-1.0 if k // every % 2 else 1.0) * size[k // every * every])
            x.append(wheels.state["x"].copy())
            motor_work += wheels.state["motor_work"]
            lost += wheels.state["numerical_work"]
        runs.append((np.array(x), motor_work, lost))
    (x, work, lost), (exact, exact_work, _) = runs
    off = np.sqrt(np.mean((x - exact) ** 2, axis=0)) / np.abs(exact).max(axis=0)
    assert np.median(off) < error
    assert np.median(work / exact_work) == pytest.approx(1.0, abs=0.06)
    assert np.median(np.abs(lost / work)) < 0.08


@settings(max_examples=300, deadline=None)
@given(command=st.floats(-1.0, 1.0), share=st.floats(-3.0, 3.0), speed_command=st.booleans())
def test_motor_stays_within_its_lines(command, share, speed_command):
    speed = share * MOTOR.no_load_speed
    torque, _ = motor_torque(command, speed_command, speed, MOTOR)
    stall = MOTOR.stall_torque
    high = stall * min(max(1.0 - share, -1.0), 1.0)
    low = stall * min(max(-1.0 - share, -1.0), 1.0)
    assert low - 1e-9 <= torque <= high + 1e-9
    if not speed_command:
        assert torque == pytest.approx(min(max(command * stall, low), high), abs=1e-9)


@pytest.mark.parametrize("speed_command", [False, True])
def test_motor_slope(speed_command):
    """The second result of `motor_torque`, d(torque)/d(w) [N m s], against central differences."""
    rng = np.random.default_rng(0)
    for command, w in zip(rng.uniform(-1, 1, 200), rng.uniform(-5, 5, 200), strict=True):
        up, here, down = (
            motor_torque(command, speed_command, w + d, MOTOR) for d in (1e-6, 0.0, -1e-6)
        )
        assert here[1] == pytest.approx((up[0] - down[0]) / 2e-6, abs=1e-4)


@pytest.mark.parametrize(
    ("mode", "grades", "fastest", "furthest"),
    [
        ("wheel_speed", (-10.0, -5.0, 0.0, 5.0, 10.0), 0.01, 0.1),
        ("torque", (-2.0, 0.0, 2.0), REST_SPEED, 0.03),
    ],
    ids=["held", "idle"],
)
@pytest.mark.parametrize("soil", ["dry_sand", "lete_sand", "grenville_loam", "lunar_nominal"])
def test_a_wheel_without_a_command_stays_nearly_at_rest(soil, mode, grades, fastest, furthest):
    """Held by its speed loop on a grade the wheel creeps, downhill if anywhere; idle it stays on
    gentle ground.
    """
    for grade_deg in grades:
        wheels = start(mode, soil, grade_deg)
        wheels.drive([0.0] * 100)
        assert abs(wheels.now().speed) < fastest and abs(wheels.now().x) < furthest
        assert mode == "torque" or wheels.now().x * grade_deg <= 0.0


TYRE = {"wheel": {"tyre": {"stiffness": 8000.0}, "grip": 0.6}}
FIRM_BELOW = {"layer_gain": 1e4, "layer_depth": 0.03}


@pytest.mark.parametrize(
    ("law", "changes"),
    [(EQUATION_10, {}), (FLOW, {}), (EQUATION_10 | FIRM_BELOW, TYRE)],
    ids=["equation 10", "flow", "tyre on a cover"],
)
def test_energy_of_a_driven_and_braked_wheel_is_accounted_for(law, changes):
    """Downhill with changing commands: work of the motor less that on soil, of height, of speed and
    of the integrator in every period; the soil takes work over each, and the wheel is braked.
    """
    wheels = on_uniform_ground(
        soils()["dry_sand"].state(0.15)._replace(**law),
        math.radians(-12.0),
        "wheel_speed",
        **changes,
    )
    rng = np.random.default_rng(0)
    before = wheels.now()
    slips = []
    for t in range(80):
        if t % 8 == 0:
            command = rng.choice([0.05, 0.2, 0.5, 0.8])
        wheels.step(command)
        now = wheels.now()
        kinetic = 0.5 * now.mass * (now.speed**2 - before.speed**2)
        inertia = wheels.rig.inertia
        kinetic += 0.5 * inertia * (now.wheel_speed**2 - before.wheel_speed**2)
        rise = now.mass * wheels.rig.gravity * math.sin(now.grade) * (now.x - before.x)
        missing = now.motor_work - now.soil_work - now.numerical_work - kinetic - rise
        assert abs(missing) < 1e-3 * max(abs(now.motor_work), 0.1)
        assert now.soil_work > -1e-3 and now.converged == 1
        slips.append(now.slip)
        before = now
    low, high = (-0.04, 0.04) if changes else (-0.05, 0.1)  # a tyre holds on to rock
    assert min(slips) < low and max(slips) > high


def test_soil_piles_up_ahead_of_a_braked_wheel_as_it_travels():
    """On the way down, braked suddenly: as the solution of the law in time, by the speeds of 1 ms;
    a wheel that drives on the level again leaves the pile behind.
    """
    soil = soils()["dry_sand"].state(0.15)._replace(**FLOW)
    wheels = on_uniform_ground(soil, -0.3, "wheel_speed")
    wheels.rig.period = 1e-3
    wheels.rig.substeps = 1
    wheels.drive([0.6] * 1000)
    pile = wheels.now().braked
    piles = []
    for command, grade in ((0.1, -0.3), (0.5, 0.0)):
        wheels.courses["slopes"]["grade"][0] = grade
        for _ in range(1500):
            before = wheels.now()
            wheels.step(command)
            now = wheels.now()
            braked = max(1.0 - now.wheel_speed * wheels.rig.radius / now.speed, 0.0)
            rate = abs(now.x - before.x) / (PILING * wheels.rig.radius)
            pile += (braked - pile) * (1.0 - math.exp(-rate))
            assert now.braked == pytest.approx(pile, abs=1e-3)
        piles.append(now.braked)
    assert piles[0] > 0.2 and piles[1] < 0.3 * piles[0]


@pytest.mark.parametrize("mode", ["torque", "wheel_speed"])
def test_reverse_mirrors_forward_on_level_ground(mode):
    """On level fresh ground, long before any rut, backward is forward mirrored."""
    runs = []
    for sign in (1.0, -1.0):
        wheels = start(soil="lete_sand", mode=mode)
        wheels.drive([sign * 0.25] * 3)
        names = ("x", "speed", "wheel_speed", "drawbar_pull", "torque", "sinkage")
        runs.append([wheels.state[name][0] for name in names])
    forward, backward = np.array(runs)
    assert forward[0] > 0.0 and abs(forward[0]) < terrain.CELL
    np.testing.assert_allclose(backward, forward * [-1, -1, -1, -1, -1, 1], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("dig", "low", "high"),
    [({"dig_gain": 0.0}, 0.998, 1.002), ({}, 1.0, 1.05)],
    ids=["rolling", "digging"],
)
@pytest.mark.parametrize("law", [EQUATION_10, {}], ids=["equation 10", "flow"])
def test_rolling_out_and_back_keeps_the_rut(law, dig, low, high):
    """A rut does not heal: the second pass deepens it by 2^(1 - q). Slip digs by less than a
    twentieth more, at that of a level drive.
    """
    soil = soils()["grenville_loam"].state(0.15)._replace(**dig, **law)
    assert dig or soil.dig_gain > 0.0
    wheels = on_uniform_ground(soil, 0.0, "wheel_speed")
    out = wheels.drive([0.4] * 60)
    assert out[-1, 0] > 0.5
    cell = wheels.now().cell
    cells = wheels.courses["cells"][0]
    passed = cells[terrain.CELLS_BEHIND + 2 : cell - 2]
    assert passed.size > 5 and np.all(passed["passes"] == 1.0) and np.all(passed["depth"] > 0.0)
    assert not np.any(cells["passes"][cell + 1 :])  # not yet driven over
    back = wheels.drive([-0.4] * 50)
    assert back[-1, 0] < out[-1, 0] - 0.3
    there = np.interp(0.4, out[:, 0], out[:, 1])
    again = np.interp(0.4, back[::-1, 0], back[::-1, 1])
    assert low < again / there / 2.0 ** (1.0 - COMPACTION) < high


@pytest.mark.parametrize("amplitude", [0.003, 0.02])
def test_rocking_on_the_spot_heals_nothing(amplitude):
    """A wheel in a hole of 10 cm that rocks by some mm stays in it: what moves under it is the
    ground it has dug up.
    """
    soil = soils()["dry_sand"].state(0.15)._replace(**EQUATION_10)
    wheels = on_uniform_ground(soil, 0.0, "wheel_speed")
    wheels.drive([0.3] * 30 + [0.0] * 10)
    wheels.state["sinkage"] = 0.1
    wheels.state["rut_depth"] = 0.1
    here = wheels.now().x
    way = 0.0
    forward = True
    for _ in range(600):
        if abs(wheels.now().x - here) > amplitude:
            forward = wheels.now().x < here
        before = wheels.now().x
        wheels.step(0.05 if forward else -0.05)
        way += abs(wheels.now().x - before)
    assert way > 0.3 and abs(wheels.now().x - here) < 0.1
    assert wheels.now().sinkage > 0.097


@pytest.mark.parametrize(
    ("grade_deg", "law", "error"),
    [(0.0, EQUATION_10, 0.01), (6.0, EQUATION_10, 0.05), (0.0, {}, 0.01), (6.0, {}, 0.05)],
)
def test_passes_leave_the_rut_of_the_law_and_loosen_nothing(grade_deg, law, error):
    """There and back over fresh soil, four passes: z_N = z_1 N^(1 - q), less what flows back. Up
    the slope the wheel slips by more than 14 %.
    """
    soil = soils()["dry_sand"].state(0.15)._replace(dig_gain=1.0 if grade_deg else 0.0, **law)
    wheels = on_uniform_ground(soil, math.radians(grade_deg), "wheel_speed")
    cells = wheels.courses["cells"][0]
    middle = terrain.cell_at(cells, 1.2)
    depths = []
    for n in range(4):
        commands = 0.5 if n % 2 == 0 else -0.5
        slips = []
        for _ in range(120):
            wheels.step(commands)
            slips.append(wheels.now().slip)
            if not 0.1 < wheels.now().x < 2.4 and len(slips) > 30:
                break
        assert grade_deg == 0.0 or n % 2 == 1 or np.median(slips) > 0.14
        assert cells[middle].passes == n + 1.0
        depths.append(float(cells[middle].depth))
    ruts = np.arange(1, 5) ** (1.0 - COMPACTION)
    np.testing.assert_allclose(np.array(depths) / depths[0], ruts, rtol=error)
    assert np.all(np.diff(depths) >= 0.0)


def test_passes_do_not_roll_a_rut_into_rock():
    """Rock below 2 cm of sand: four passes end on it."""
    cover = 0.02
    soil = soils()["dry_sand"].state(0.15)._replace(layer_gain=1e5, layer_depth=cover)
    wheels = on_uniform_ground(soil, mode="wheel_speed", payload=0.0)
    # the sinkage [m] in each pass after 81 of its 110 periods
    depths = [wheels.drive([command] * 110)[80, 1] for command in (0.3, -0.3, 0.3, -0.3)]
    assert depths[0] < depths[1] < 1.1 * cover and depths[-1] < 1.1 * cover


def test_spinning_digs_a_wheel_in_for_good():
    """Full torque on a slope of loose sand: slip near 1, three times the sinkage, and no way on."""
    wheels = start(soil="dry_sand", grade_deg=14.0)
    rest = wheels.now().sinkage
    rows = wheels.drive([0.8] * 200)
    assert rows[-1, 1] > 3.0 * rest
    assert np.all(rows[20:, 3] > 0.9) and rows[-1, 0] < 0.2


@pytest.fixture(scope="module")
def bare():
    """(wheels driven by torque, what they and their course began with)."""
    wheels = start()
    return wheels, wheels.state.copy(), wheels.courses.copy()


@settings(deadline=None, max_examples=60)
@given(
    soil=any_soil,
    grade_deg=st.floats(-30.0, 30.0),
    depth=st.none() | st.sampled_from([1e-9, 1.0, 1.4]) | st.floats(0.0, 1.4),
    speeds=st.tuples(*2 * [st.just(0.0) | st.floats(-1.0, 1.0)]),
    commands=st.lists(st.sampled_from([-1.0, 0.0, 0.3, 1.0]), min_size=4, max_size=4),
)
def test_edges_of_the_world(bare, soil, grade_deg, depth, speeds, commands):
    """Any depth, from the air to beyond the radius and out of it again, any speeds and commands on
    any soil: every period converges, and depth, speeds and forces are finite and bounded.
    """
    wheels, state, courses = bare
    wheels.state[:] = state
    wheels.courses[:] = courses
    lay_patches(wheels.courses, (0.0, 1e3), [soil], [math.radians(grade_deg)])
    radius = MOTOR.radius
    if depth is not None:
        wheels.state["sinkage"] = wheels.state["rut_depth"] = depth * radius
    wheels.state["speed"] = speeds[0]
    wheels.state["wheel_speed"] = speeds[1] / radius
    fastest = max(map(abs, speeds)) + radius * MOTOR.no_load_speed
    for period, command in enumerate(commands, 1):
        wheels.step(command)
        now = wheels.now()
        weight = now.mass * MOTOR.gravity
        assert now.converged and SHALLOWEST * radius <= now.sinkage <= DEEPEST * radius
        numbers = (now.x, now.load, now.drawbar_pull, now.torque, now.soil_work, now.motor_work)
        assert np.isfinite(numbers).all()
        assert abs(now.speed) < fastest + MOTOR.gravity * MOTOR.period * period
        assert abs(now.drawbar_pull) < 100.0 * weight + 100.0 * soil.cohesion * radius**2
        assert now.soil_work > -1e-3 * weight * radius


@pytest.mark.parametrize("action", ["rim_acceleration", "wheel_speed"])
def test_forces_at_the_end_of_a_period_are_those_of_its_motion(action):
    """A commanded speed is reached evenly within it, as the drive of a rover does."""
    soil = soils()["dry_sand"].state(0.15)
    wheels = on_uniform_ground(soil, 0.0, action)
    scenario = wheels.simulation.scenario
    per_period = 1.0 / scenario.control.period
    off = []
    size = []
    for k in range(24):
        before = wheels.now()
        wheels.step(0.3 if action == "rim_acceleration" else 0.01 * (k + 1))
        now = wheels.now()
        faster = now.wheel_speed - before.wheel_speed
        turning = scenario.wheel.inertia * faster * per_period
        travelling = now.mass * (now.speed - before.speed) * per_period
        off.append((now.motor_torque - now.torque - turning, now.drawbar_pull - travelling))
        size.append((turning, travelling))
    off, size = (np.abs(values[8:]).mean(0) for values in (np.array(off), np.array(size)))
    assert np.all(off < 0.1 * size)
