"""Worlds with effects: `model=` of the environments, judged by `steady.steady_with`, differences
and random driving.
"""

import dataclasses
import math
import warnings

import numpy as np
import pytest

from soil_env._io.loading import ParameterError
from soil_env.envs.wheel_env import SoilWheelEnv, SoilWheelVectorEnv
from soil_env.parameters import Noise, Soil, SoilState, load_scenario, soils
from soil_env.terramechanics.effects import acting_effects, pack_effects
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.residual import ResidualTable, ResidualTerm
from soil_env.terramechanics.steady import Conditions, Rim, steady_with
from soil_env.terramechanics.traversability import best_working_point_with
from soil_env.terramechanics.validity import OutsideValidity
from tests.simulation import wheels as bench
from tests.simulation.courses import course, margin
from tests.terramechanics.cases import ACTING, CASES, EQUATION_10, LUG, RESIDUAL, TOGETHER, WHEEL

SOFT = SoilState(math.tan(math.radians(34.0)), 1500.0, 0.012, 4e5, 0.8, 1.0, 0.5)


def model_of(effects, residual=(), soil=None, remainder=None):
    return WheelSoilModel(WHEEL, soil, effects, residual, remainder=remainder)


#: No sensor noise, and a course that is long enough.
STILL = {"course": {"length": 40.0}, "noise": {f.name: 0.0 for f in dataclasses.fields(Noise)}}


def on_uniform_ground(effects, soil, grade, residual=(), remainder=None):
    """One wheel at rest on one soil and grade, in a world with `effects`, without halts."""
    model = None if effects is None else model_of(effects, residual, remainder=remainder)
    return bench.on_uniform_ground(soil, grade, "wheel_speed", model, **STILL)


#: Lugs shear at a larger radius, at which the lengths of a softening law count, too.
SETTLING = CASES | {
    "grousers-softening": CASES["grousers-shear_radius"] | CASES["shear_softening-decaying"]
}


def settled(case, grade_deg, ground=SOFT):
    """[3, 3] of a wheel driven far: rows as read, by `steady_with`, and by it without the effect.

    Columns are sinkage, drawbar pull and torque over radius, weight and weight times radius.
    """
    effects = {name: dict(values) for name, values in SETTLING[case].items()}
    wheels = on_uniform_ground(effects, ground, math.radians(grade_deg))
    passes = 1.0
    if "multipass" in effects:
        wheels.courses["cells"]["passes"] = 1.0
        passes = 2.0
    wheels.drive([0.35] * 250)
    before = wheels.now().sinkage
    wheels.drive([0.35] * 5)
    w = wheels.now()
    scenario = wheels.simulation.scenario
    gravity = scenario.gravity
    unit_weight = 1500.0 * gravity
    slip, sunk, pull, _, torque = (float(x) for x in wheels.simulation.worlds.observation[0, :5])
    assert w.x > 2.0 and w.speed > 0.05
    assert w.sinkage == pytest.approx(before, rel=1e-6)
    weight = w.mass * gravity
    if "grousers" in effects:
        effects["grousers"]["slip_at_rim"] = 1.0  # the slip of the world is that of the rim
    at = Conditions(w.speed, passes, math.sin(w.grade))
    rim = Rim(WHEEL.radius, WHEEL.width, LUG, unit_weight)
    pulled = {"grade": {"share": 1.0}}
    stated = [
        steady_with(slip, weight, ground, rim, at, pack_effects(fx))
        for fx in ({**effects, "grade": {**pulled["grade"], **effects.get("grade", {})}}, pulled)
    ]
    shown = scenario.weight / weight  # the observation counts in weights without payload
    # gravity along the slope pulls at the drawbar in the table, at the wheel in the world
    read = [sunk, pull * shown - at.sin_grade, torque * shown]
    scale = [0.15, weight, weight * 0.15]
    return np.array(
        [read, *(np.array([x.sinkage, x.drawbar_pull, x.torque]) / scale for x in stated)]
    )


@pytest.mark.parametrize("case", SETTLING)
def test_a_driven_wheel_settles_at_the_steady_state(case):
    """Downhill and uphill at a constant wheel speed: sinkage, drawbar pull and torque as
    instruments read them.
    """
    change = 0.0
    for grade_deg in (-4.0, -1.0, 2.0):
        found, stated, without = settled(case, grade_deg)
        np.testing.assert_allclose(found, stated, rtol=0.0, atol=1e-5)
        change = max(change, np.abs(stated - without).max())
    assert change > 1e-3 or case == "grade-weight"  # there was something to settle at


@pytest.mark.parametrize("case", ["slip_sinkage-ratio", "slip_sinkage-excavation"])
def test_a_wheel_that_digs_settles_on_the_rock_below_its_cover(case):
    depth = 0.03
    covered = SOFT._replace(layer_gain=1e4, layer_depth=depth)
    for grade_deg in (2.0, 12.0):
        found, stated, _ = settled(case, grade_deg, covered)
        np.testing.assert_allclose(found, stated, rtol=0.0, atol=1e-5)
        _, deep, _ = settled(case, grade_deg)
        assert found[0] < depth / WHEEL.radius < deep[0]


TERMS = (
    ResidualTerm("drawbar_pull", -0.05, {"load": 1}),
    ResidualTerm("torque", 0.2, {"load": 1, "speed": 1}),
    ResidualTerm("sinkage", 0.3, {"sinkage": 1, "slip": 0.5}),
)
REMAINDER = ResidualTable(
    {"slip": (-0.1, 0.05, 0.6), "load": (0.001, 1.0), "speed": (0.0, 0.5)},
    {
        "sinkage": "0.01 0.02 0.03 0.04 -0.05 -0.06 -0.07 -0.08 0.03 0.02 0.01 0",
        "drawbar_pull": "0.1 0.05 0.1 0.05 0.02 0.03 0.04 0.05 -0.1 -0.1 -0.2 -0.2",
        "torque": "0 0.02 0.05 0.05 0.02 0.03 0.04 0.05 0.1 0.1 0.2 0.2",
    },
)


@pytest.mark.parametrize("residual, remainder", [(TERMS, None), ((), REMAINDER)])
def test_a_residual_law_acts_as_it_predicts(residual, remainder):
    """Its groups are those of the undisturbed soil and of the weight, whatever effects are on
    beside it.
    """
    soil = Soil.of_state(SOFT)
    effects = {"penetration_rate": {"exponent": 0.4}, "grade": {"share": 1.0}}
    grade = math.radians(-3.0)
    wheels = on_uniform_ground(effects, SOFT, grade, residual=residual, remainder=remainder)
    wheels.drive([0.35] * 250)
    w = wheels.now()
    weight = w.mass * wheels.rig.gravity
    conditions = {"slip": w.slip, "load": weight, "speed": w.speed, "grade_deg": -3.0}
    scale = [0.15, weight, weight * 0.15]
    stated, without = (
        np.concatenate(model_of(effects, *law, remainder=table).predict(conditions)[:3]) / scale
        for law, table in (((residual, soil), remainder), (((), soil), None))
    )
    sunk = wheels.simulation.worlds.observation[0, 1]
    found = sunk, w.drawbar_pull / weight + math.sin(-grade), w.torque / weight / 0.15
    assert found == pytest.approx(stated, abs=1e-5) and np.all(np.abs(stated - without) > 1e-3)


def test_a_wheel_at_rest_has_settled():
    """On ground that slopes weaken it starts as deep as it stays: 40 % deeper than on the level."""
    soil = soils()["lete_sand"].state(0.15)._replace(**EQUATION_10)
    starts = []
    for grade_deg in (0.0, 6.0):
        wheels = on_uniform_ground({"grade": {"weakening": 1.0}}, soil, math.radians(grade_deg))
        starts.append(wheels.now().sinkage)
        wheels.drive([0.0] * 3)
        assert wheels.now().sinkage == pytest.approx(starts[-1], rel=0.01)
    assert starts[1] > 1.3 * starts[0]


def trajectories(model, wheels=8, steps=250):
    """(observations, rewards, states) under held random actions, full throttle and reverse among
    them.
    """
    rng = np.random.default_rng(0)
    held = rng.uniform(-0.2, 1.2, (steps // 8 + 1, wheels, 1))
    held[rng.random(held.shape) < 0.1] = -1.0
    env = SoilWheelVectorEnv(wheels, observation="blind", action="torque", model=model, threads=1)
    rows = [env.reset(seed=5)[0]]
    rewards = []
    states = []
    for a in np.repeat(held, 8, axis=0)[:steps]:
        observation, reward, *_ = env.step(a)
        rows.append(observation)
        rewards.append(reward)
        states.append(
            [
                env.simulation.worlds.state[name].copy()
                for name in ("x", "sinkage", "slip", "torque")
            ]
        )
    return np.array(rows), np.array(rewards), np.array(states)


@pytest.mark.parametrize("case", [case for case in CASES if case not in ACTING])
def test_sensor_effects_change_readings_only(case):
    base = trajectories(None)
    found = trajectories(model_of(CASES[case]))
    np.testing.assert_array_equal(base[1], found[1])
    np.testing.assert_array_equal(base[2], found[2])
    # entry 0 is the slip, entry 1 the sinkage
    changed = np.flatnonzero((base[0] != found[0]).any(axis=(0, 1)))
    assert changed.tolist() == {"slip_bias": [0], "grade": []}.get(case.split("-")[0], [1])


def test_multipass_acts_in_the_track_only():
    """Forward over fresh ground there is no track. On the way back the effect takes the place of
    the world's law, by which the track is 4.4 times as stiff as fresh soil: of 2 times, then 8.
    """
    soil = soils()["lete_sand"].state(0.15)._replace(**EQUATION_10)
    effects = (None, {"multipass": {"hardening": 1.0}}, {"multipass": {"hardening": 3.0}})
    runs = [on_uniform_ground(e, soil, 0.0).drive([0.4] * 60 + [-0.4] * 50)[:, :3] for e in effects]
    base, softer, stiffer = runs
    assert base[59, 0] > 0.5
    turned = int(np.argmax(base[:, 0]))
    for found in (softer, stiffer):
        # Code with effects is compiled anew, and may round its sums in another order.
        np.testing.assert_allclose(base[:turned], found[:turned], rtol=1e-12)
    assert np.all(softer[90:, 1] > 1.03 * base[90:, 1])
    assert np.all(stiffer[90:, 1] < 0.99 * base[90:, 1])


@pytest.mark.parametrize("case", [*CASES, "together", "residual"])
def test_random_driving_converges(case):
    """32 wheels under bang-bang commands in each mode of action; soil that softens breaks away
    under a dug wheel.
    """
    wheels = 32
    periods = 200 if "softening" in case else 60
    failures = 0
    effects = {"together": TOGETHER, "residual": {}}.get(case) or CASES.get(case, {})
    model = model_of(effects, RESIDUAL if case == "residual" else ())
    for seed, mode in enumerate(("torque", "wheel_speed")):
        scenario = load_scenario("mixed", {"control": {"action": mode}})
        simulation = bench.started(
            scenario, "identified", [[seed, k] for k in range(wheels)], model=model
        )
        rng = np.random.default_rng(seed)
        command = np.zeros(wheels)
        for _ in range(periods):
            new = rng.random(wheels) < 0.1
            command[new] = rng.choice(
                [-1.0, -0.3, 0.0, 0.3, 1.0, rng.uniform(-1.0, 1.0)], new.sum()
            )
            simulation.step_all(command, np.zeros(wheels, dtype=np.int8))
            failures += np.sum(simulation.worlds.state["converged"] == 0)
        assert np.ptp(simulation.worlds.state["x"]) > 0.1
    assert failures <= 0.001 * 2 * wheels * periods


@pytest.mark.parametrize("case", ACTING)
def test_soils_leave_the_least_pull_in_the_world_they_are_drawn_for(case):
    """On level ground, starting and at half speed; some leave little more."""
    scenario = load_scenario("mixed")
    model = model_of(CASES[case])
    wheel = scenario.wheel
    least = scenario.course.least_pull
    found = []
    rate = case.startswith(("penetration_rate", "shear_rate"))
    speed = 0.5 * wheel.no_load_speed * wheel.radius
    rim = Rim(wheel.radius, wheel.width, LUG, 1500.0 * scenario.gravity)
    for seed in range(25):
        drawn = course(seed, scenario, model)
        load = drawn.mass * scenario.gravity
        for patch in drawn.patches:
            for v in (0.0, speed) if rate else (speed,):
                best = best_working_point_with(
                    load,
                    SoilState(*(patch[name] for name in SoilState._fields)),
                    rim,
                    Conditions(v, 1.0, 0.0),
                    acting_effects(model.numbers),
                    wheel.stall_torque,
                )
                found.append(best.drawbar_pull / load)
    assert min(found) > least - 1e-6
    assert min(found) < 0.5 * np.median(found)
    assert case.startswith("rear_contact") or min(found) < least + 0.02


def test_a_residual_law_counts_on_the_soils():
    """Where a pull lacks everywhere, soils have as much more without it."""
    scenario = load_scenario("mixed")
    lacking = (ResidualTerm("drawbar_pull", -0.05, {}),)
    pulls = []
    for seed in range(20):
        drawn = course(seed, scenario, model_of({}, lacking))
        pulls += [margin(patch, 0.0, drawn.mass, scenario) for patch in drawn.patches]
    assert min(pulls) == pytest.approx(scenario.course.least_pull + 0.05, abs=0.02)
    assert min(pulls) >= scenario.course.least_pull + 0.05 - 1e-6


@pytest.mark.parametrize("scatter", [False, True])
def test_a_weight_beyond_the_loads_of_a_model_is_warned_of(scatter):
    model = dataclasses.replace(model_of({}), validity={"load": (60.0, 140.0)})
    with pytest.warns(OutsideValidity, match=r"carries 147.2 N, .*body_mass = 9.34"):
        SoilWheelEnv("mixed", model=model, scatter=scatter)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wheel = {"body_mass": 9.34}
        SoilWheelEnv("mixed", model=model, scatter=scatter, wheel=wheel)
    for load, mass in (((104.0, 104.0), "10.6"), ((0.0, 100.0), "10.2")):
        narrow = dataclasses.replace(model, validity={"load": load})
        with pytest.warns(OutsideValidity, match=f"body_mass = {mass} or so"):
            SoilWheelEnv("mixed", model=narrow, scatter=scatter)


def test_a_mixture_beside_the_soil_of_a_model_is_refused():
    """It would be without effect; with `scatter` a spread counts, without a soil both do."""
    model = model_of({}, soil=soils()["dry_sand"])
    spread = {"friction": 0.1}
    mixture = {"dry_sand": 1.0}
    for keywords in ({"soils": mixture}, {"soils": mixture, "scatter": True}, {"spread": spread}):
        with pytest.raises(ParameterError, match="without effect"):
            SoilWheelEnv("mixed", model=model, **keywords)
    SoilWheelEnv("mixed", model=model, spread=spread, scatter=True)
    SoilWheelEnv("mixed", model=model_of({}), soils=mixture, spread=spread)


def test_a_least_pull_of_minus_the_weight_takes_soil_that_bogs_the_wheel():
    """With -1 the last soil that was drawn is taken although none passes; with -0.99 there is no
    course.
    """
    changes = {"soils": {"dry_sand": 1}, "limits": {"bogged_sinkage": 0.06}}
    with pytest.raises(ParameterError, match="no soil leaves this wheel"):
        SoilWheelEnv(load_scenario("mixed", changes | {"course": {"least_pull": -0.99}}))
    env = SoilWheelEnv(load_scenario("mixed", changes | {"course": {"least_pull": -1.0}}))
    assert np.all(np.isfinite(env.reset(seed=0)[0]))
