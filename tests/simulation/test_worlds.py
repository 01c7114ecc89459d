"""Worlds with effects: `model=` of the environments, judged by `steady.steady_with`, differences and random driving."""

import math

import numpy as np
import pytest

from soil_env._numba.random_streams import seed_stream
from soil_env.driving.wheels import Simulation
from soil_env.env import SoilWheelEnv
from soil_env.parameters import Soil, SoilState, load_scenario, soils
from soil_env.simulation.task.rules import task_numbers
from soil_env.simulation.world import courses as drawing, terrain
from soil_env.simulation.world.sensors import sense
from soil_env.terramechanics.effects import CATALOGUE, acting, pack_effects
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.reaction import ground_under
from soil_env.terramechanics.residual import ResidualTerm
from soil_env.terramechanics.steady import Conditions, Rim, steady_with
from soil_env.terramechanics.traversability import best_working_point_with
from soil_env.vector_env import SoilWheelVectorEnv
from tests.simulation import wheels as bench
from tests.terramechanics.cases import ACTING, CASES, LUG, RESIDUAL, TOGETHER, WHEEL

SOFT = SoilState(math.tan(math.radians(34.0)), 1500.0, 0.012, 4e5, 0.8, 1.0, 0.5)


def model_of(effects, residual=(), soil=None):
    return WheelSoilModel(WHEEL, soil, effects, residual)


#: No sensor noise, no commanded halts, and a course that is long enough.
STILL = {
    "course": {"length": 40.0},
    "noise": dict.fromkeys(
        ("slip", "sinkage", "drawbar_pull", "load", "torque", "speed", "wheel_speed", "pitch", "motor_torque",
         "acceleration"), 0.0
    ),
}  # fmt: skip


def on_uniform_ground(effects, soil, grade, mode="wheel_speed", residual=()):
    """One wheel at rest on one soil and grade, in a world with `effects`."""
    model = None if effects is None else model_of(effects, residual)
    return bench.on_uniform_ground(soil, grade, mode, model, **STILL)


def readings(wheels, effects):
    """Readings of the sensors of the wheel."""
    model = None if effects is None else model_of(effects)
    task = task_numbers(load_scenario("mixed", STILL), "blind", model)
    return sense(wheels.state, 0, np.ones(1, dtype=np.uint64), task.sensors)


def ground_of(w, soil, grade, passes, world):
    """`Ground` under a wheel as it is now."""
    weight = w.mass * world.wheel.gravity
    u = w.wheel_speed * world.wheel.radius
    return ground_under(w.sinkage, w.speed, u, weight, soil, math.sin(grade), passes, world.wheel)


def settled(case, grade_deg):
    """(what instruments read, what `steady_with` says, the same without the effect, weight) of a wheel driven far."""
    effects = {name: dict(values) for name, values in CASES[case].items()}
    soil = SOFT._replace(dig_gain=0.0) if "apparent" in case else SOFT  # the form takes the place of the soil's digging
    wheels = on_uniform_ground(effects, soil, math.radians(grade_deg))
    passes = 1.0
    if "multipass" in effects:
        wheels.courses.rut[0, :], passes = 1e-3, 2.0
    wheels.drive([0.35] * 250)
    before = wheels.now().sinkage
    wheels.drive([0.35] * 5)
    w, read, gravity = wheels.now(), readings(wheels, effects), wheels.world.wheel.gravity
    assert w.x > 2.0 and w.speed > 0.05
    assert w.sinkage == pytest.approx(before, rel=1e-6)
    weight = w.mass * gravity
    if "grousers" in effects:
        effects["grousers"]["slip_at_rim"] = 1.0  # the slip of the world is that of the rim
    at = Conditions(w.speed, passes, math.sin(w.grade))
    rim, pulled = Rim(WHEEL.radius, WHEEL.width, LUG), {"grade": {"share": 1.0}}
    stated = [
        steady_with(read.slip, weight, soil, rim, at, 1500.0 * gravity, pack_effects(fx), 0.0)
        for fx in ({**effects, "grade": {**pulled["grade"], **effects.get("grade", {})}}, pulled)
    ]
    # gravity along the slope pulls at the drawbar in the table, at the wheel in the world
    found = np.array([read.sinkage / 0.15, read.drawbar_pull / weight - at.sin_grade, read.torque / weight / 0.15])
    with_effect, without = (np.array([s.sinkage / 0.15, s.drawbar_pull / weight, s.torque / weight / 0.15])
                            for s in stated)  # fmt: skip
    return found, with_effect, without


@pytest.mark.parametrize("case", CASES)
def test_a_driven_wheel_settles_at_the_steady_state(case):
    """Downhill and uphill at a constant wheel speed: sinkage, drawbar pull and torque as instruments read them."""
    change = 0.0
    for grade_deg in (-4.0, -1.0, 2.0):
        found, stated, without = settled(case, grade_deg)
        np.testing.assert_allclose(found, stated, rtol=0.0, atol=1e-5)
        change = max(change, np.abs(stated - without).max())
    assert change > 1e-3 or case == "grade-weight"  # there was something to settle at


def test_a_residual_law_acts_as_it_predicts():
    """Its groups are those of the undisturbed soil and of the weight, whatever effects are on beside it."""
    soil = Soil(friction_angle_deg=34.0, cohesion=1500.0, shear_modulus=0.012, sinkage_coefficient=4e5,
                sinkage_exponent=0.8, dig_gain=1.0, dig_recovery=0.5)  # fmt: skip
    residual = (ResidualTerm("drawbar_pull", -0.05, {"load": 1}), ResidualTerm("torque", 0.2, {"load": 1, "speed": 1}))
    effects = {"penetration_rate": {"exponent": 0.4}, "grade": {"share": 1.0}}
    wheels = on_uniform_ground(effects, soil.state(0.15), math.radians(-3.0), residual=residual)
    wheels.drive([0.35] * 250)
    w = wheels.now()
    weight = w.mass * wheels.world.wheel.gravity
    conditions = {"slip": w.slip, "load": weight, "speed": w.speed, "grade_deg": -3.0}
    stated, without = (model_of(effects, law, soil).predict(conditions) for law in (residual, ()))
    assert w.drawbar_pull + weight * math.sin(math.radians(3.0)) == pytest.approx(
        stated.drawbar_pull[0], abs=1e-5 * weight
    )
    assert w.torque == pytest.approx(stated.torque[0], abs=1e-5 * weight * 0.15)
    assert abs(stated.drawbar_pull[0] - without.drawbar_pull[0]) > 1e-3 * weight
    assert abs(stated.torque[0] - without.torque[0]) > 1e-3 * weight * 0.15


def test_a_wheel_at_rest_has_settled():
    """On ground that slopes weaken it starts as deep as it stays: 40 % deeper than on the level."""
    soil, starts = soils()["lete_sand"].state(0.15), []
    for grade_deg in (0.0, 6.0):
        wheels = on_uniform_ground({"grade": {"weakening": 1.0}}, soil, math.radians(grade_deg))
        starts.append(wheels.now().sinkage)
        wheels.drive([0.0] * 3)
        assert wheels.now().sinkage == pytest.approx(starts[-1], rel=0.01)
    assert starts[1] > 1.3 * starts[0]


def test_blades_push_the_soil_between_them_whatever_the_shear_radius():
    """Thrust of the lugs is that of the soil, not of the soil as sheared at the larger radius."""
    soil = soils()["lete_sand"].state(0.15)
    thrust = []
    for share in (0.0, 0.8):
        wheels = on_uniform_ground({"grousers": {"blades": 3.0, "shear_share": share}}, soil, 0.0)
        wheels.state.sinkage[0] = 0.02
        thrust.append(ground_of(wheels.now(), soil, 0.0, 1.0, wheels.world).blades)
    assert thrust[0] > 1.0 and thrust[1] == thrust[0]


#: Parameters that do nothing while the one that switches their law on is neutral.
IDLE = {
    "slip_sinkage": {"recovery": 0.9}, "rear_contact": {"peak_follows": 0.0}, "multipass": {"passes": 3.0},
    "grousers": {"slip_at_rim": 1.0}, "penetration_rate": {"reference_speed": 0.5},
    "shear_rate": {"reference_speed": 0.5, "onset_speed": 0.1},
    "shear_softening": {"length": 0.2, "onset": 0.1, "slope_kept": 1.0},
}  # fmt: skip
NEUTRAL = {name: {p.name: p.neutral for p in effect.parameters} for name, effect in CATALOGUE.items()}


def actions(wheels, steps, seed=0):
    """Held random actions [steps, wheels, 1], full throttle and reverse among them."""
    held = np.random.default_rng(seed).uniform(-0.2, 1.2, (steps // 8 + 1, wheels, 1))
    held[np.random.default_rng(seed + 1).random(held.shape) < 0.1] = -1.0
    return np.repeat(held, 8, axis=0)[:steps].astype(np.float32)


def trajectories(model, variant="identified", wheels=8, steps=250):
    """(observations, rewards, x and sinkage) of some wheels."""
    env = SoilWheelVectorEnv(wheels, observation=variant, action="torque", model=model, threads=1)
    observation, _ = env.reset(seed=5)
    rows, rewards, states = [observation], [], []
    for a in actions(wheels, steps):
        observation, reward, *_ = env.step(a)
        rows.append(observation)
        rewards.append(reward)
        states.append([env.simulation.worlds.state[name].copy() for name in ("x", "sinkage", "slip", "torque")])
    return np.array(rows), np.array(rewards), np.array(states)


def test_neutral_models_change_nothing():
    """Bit for bit where no effect is on; else but for rounding, as laws that do nothing are then computed."""

    def same(a, b):
        tolerance = {"rtol": 3e-7, "atol": 1e-7} if a.dtype == np.float32 else {"rtol": 1e-9, "atol": 1e-12}
        return np.allclose(a, b, **tolerance)

    base = trajectories(None)
    for effects in ({}, NEUTRAL):
        for a, b in zip(base, trajectories(model_of(effects)), strict=True):
            np.testing.assert_array_equal(a, b)
    for a, b in zip(base, trajectories(model_of(IDLE)), strict=True):
        assert same(a, b)
    zero = model_of({}, (ResidualTerm("drawbar_pull", 0.0, {"slip": 1}),))
    assert same(base[2], trajectories(zero)[2])
    assert not same(base[2], trajectories(model_of({"rear_contact": {"ratio": 0.001}}))[2])


@pytest.mark.parametrize("case", [case for case in CASES if case not in ACTING])
def test_sensor_effects_change_readings_only(case):
    base, found = trajectories(None, "blind"), trajectories(model_of(CASES[case]), "blind")
    np.testing.assert_array_equal(base[1], found[1])
    np.testing.assert_array_equal(base[2], found[2])
    changed = np.flatnonzero((base[0] != found[0]).any(axis=(0, 1)))
    assert changed.tolist() == {"slip_bias": [0], "grade": []}.get(case.split("-")[0], [1])


def test_multipass_acts_in_the_track_only():
    """Forward over fresh ground there is no track; on the way back there is."""
    soil, runs = soils()["lete_sand"].state(0.15), []
    for effects in (None, {"multipass": {"hardening": 1.0}}):
        runs.append(on_uniform_ground(effects, soil, 0.0).drive([0.4] * 60 + [-0.4] * 50)[:, :3])
    base, found = runs
    assert base[59, 0] > 0.5
    turned = int(np.argmax(base[:, 0]))
    np.testing.assert_array_equal(base[:turned], found[:turned])
    assert np.all(found[90:, 1] < 0.95 * base[90:, 1])


@pytest.mark.parametrize("case", [*CASES, "together", "residual"])
def test_random_driving_converges(case):
    """32 wheels under bang-bang commands in each mode of action; soil that softens breaks away under a dug wheel."""
    wheels, periods, failures = 32, 200 if "softening" in case else 60, 0
    effects = {"together": TOGETHER, "residual": {}}.get(case) or CASES.get(case, {})
    for seed, mode in enumerate(("torque", "wheel_speed")):
        scenario = load_scenario("mixed", {"control": {"action": mode}})
        model = model_of(effects, RESIDUAL if case == "residual" else ())
        simulation = Simulation(wheels, scenario, "identified", threads=1, model=model)
        for k in range(wheels):
            simulation.seed(k, np.random.default_rng([seed, k]))
        simulation.restart_where(np.ones(wheels, dtype=np.bool_))
        rng = np.random.default_rng(seed)
        command = np.zeros(wheels)
        for _ in range(periods):
            new = rng.random(wheels) < 0.1
            command[new] = rng.choice([-1.0, -0.3, 0.0, 0.3, 1.0, rng.uniform(-1.0, 1.0)], new.sum())
            simulation.step_all(command, np.zeros(wheels, dtype=np.int8))
            failures += np.sum(simulation.worlds.counts.converged == 0)
        assert np.ptp(simulation.worlds.state["x"]) > 0.1
    assert failures <= 0.001 * 2 * wheels * periods


def smooth_drive(effects, refine):
    """(x, sinkage, speed) [300, 3] over 30 s of a smooth torque, with the substep divided by `refine`."""
    wheels = on_uniform_ground(effects, soils()["lete_sand"].state(0.15), 0.0, "torque")
    wheels = wheels._replace(world=wheels.world._replace(substeps=wheels.world.substeps * refine))
    return wheels.drive([0.3 + 0.06 * math.sin(0.1 * k) for k in range(300)])[:, :3]


@pytest.mark.parametrize("case", [*ACTING, "together"])
def test_halving_the_substep_changes_little(case):
    effects = TOGETHER if case == "together" else CASES[case]
    coarse, fine = smooth_drive(effects, 1), smooth_drive(effects, 2)
    assert fine[-1, 0] > 1.0
    assert np.all(np.sqrt(np.mean((coarse - fine) ** 2, axis=0)) < 0.01 * np.abs(fine).max(axis=0))


def margins(model, speeds, seeds=range(25)):
    """Drawbar pull in reserve of W at each patch and speed, with all that the world has there; also the grades."""
    scenario = load_scenario("mixed")
    numbers, wheel = drawing.course_numbers(scenario, model), scenario.wheel
    rows, grades = [], []
    for seed in seeds:
        courses = terrain.new_courses(1, scenario)
        mass = drawing.draw_course(0, courses, np.array([seed_stream(np.random.default_rng(seed))]), numbers)
        assert mass > 0.0
        load = mass * scenario.gravity
        for soil, grade in zip(courses.soils[0, : courses.patches[0]], courses.grades[0], strict=False):
            soil = SoilState(*soil)
            grades.append(grade)
            for speed in speeds:
                best = best_working_point_with(
                    load * math.cos(grade), soil, Rim(wheel.radius, wheel.width, LUG),
                    Conditions(speed, 1.0, math.sin(grade)), 1500.0 * scenario.gravity, acting(model.numbers),
                    wheel.stall_torque,
                )  # fmt: skip
                rows.append(best.drawbar_pull / load - math.sin(grade))
    return np.array(rows), np.degrees(grades)


@pytest.mark.parametrize("case", ACTING)
def test_courses_are_passable_in_the_world_they_are_drawn_for(case):
    """Starting and at half speed; steepness is used up, so that the effect is seen in the grades and not as slack."""
    low, high = load_scenario("mixed").course.margin
    speed = 0.5 * load_scenario("mixed").wheel.no_load_speed * 0.15
    rate = CATALOGUE[case.split("-")[0]].speed_dependent is not None
    found, grades = margins(model_of(CASES[case]), (0.0, speed) if rate else (speed,))
    assert found.min() > 0.5 * low  # judged by W and tan(grade), here by W cos(grade) and sin(grade)
    assert rate or np.quantile(found, 0.2) < high
    assert np.ptp(grades) > 5.0


def test_a_residual_law_counts_on_the_grades():
    """A pull that lacks everywhere lowers every grade by as much."""
    scenario, tangents = load_scenario("mixed"), []
    for residual in ((), (ResidualTerm("drawbar_pull", -0.05, {}),)):
        courses, numbers = terrain.new_courses(1, scenario), drawing.course_numbers(scenario, model_of({}, residual))
        for seed in range(20):
            drawing.draw_course(0, courses, np.array([seed_stream(np.random.default_rng(seed))]), numbers)
            tangents.append(np.tan(courses.grades[0, 0]))
    before, after = np.array(tangents).reshape(2, 20)
    lower = (before < math.tan(math.radians(scenario.course.grade_deg[1])) - 1e-9) & (
        after > math.tan(math.radians(scenario.course.grade_deg[0])) + 1e-9
    )
    shift = (before - after)[lower]
    assert shift.size > 5 and np.median(shift) == pytest.approx(0.05, abs=1e-6)


def test_a_model_is_a_path_or_an_object(tmp_path):
    path = tmp_path / "model.yaml"
    model_of(CASES["rear_contact-midway"]).save(path)
    runs = [SoilWheelEnv(model=model) for model in (path, str(path), WheelSoilModel.load(path))]
    firsts = [env.reset(seed=0)[0] for env in runs]
    np.testing.assert_array_equal(firsts[0], firsts[1])
    np.testing.assert_array_equal(firsts[0], firsts[2])
    assert not np.array_equal(firsts[0], SoilWheelEnv().reset(seed=0)[0])


def test_patches_are_drawn_from_the_soil_of_the_model():
    soil = Soil(friction_angle_deg=31.0, cohesion=900.0, shear_modulus=0.02, sinkage_coefficient=8e5,
                sinkage_exponent=0.9, dig_gain=1.5, dig_recovery=0.5)  # fmt: skip
    exact = dict.fromkeys(("friction", "cohesion", "shear_modulus", "stiffness", "dig_gain", "exponent"), 0.0)
    env = SoilWheelEnv(model=model_of({}, soil=soil), spread=exact)
    env.reset(seed=0)
    env.simulation.complete(0)
    courses = env.simulation.worlds.courses
    patches = courses.soils[0, : courses.patches[0]]
    np.testing.assert_allclose(patches, np.broadcast_to(soil.state(0.15), patches.shape), rtol=1e-9)
    scattered = SoilWheelEnv(model=model_of({}, soil=soil))
    scattered.reset(seed=0)
    scattered.simulation.complete(0)
    friction = scattered.simulation.worlds.courses.soils[0, :3, 0]
    assert np.ptp(friction) > 0.0 and np.all(np.abs(np.degrees(np.arctan(friction)) - 31.0) < 10.0)
