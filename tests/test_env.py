"""Single environments of a wheel and of a rover: checkers, determinism, actions, arguments, info."""

import copy
import math
import pickle
from functools import partial

import gymnasium
import numpy as np
import pytest
import yaml

import soil_env
from soil_env.env import SoilWheelEnv
from soil_env.parameters import ParameterError
from soil_env.rover_env import SoilRoverEnv
from soil_env.rover_vector_env import SoilRoverVectorEnv
from soil_env.simulation.task import Cause
from soil_env.terramechanics.traversability import best_working_point
from soil_env.vector_env import SoilWheelVectorEnv

MODES = ("torque", "wheel_speed", "rim_acceleration")
BOTH = pytest.mark.parametrize("make", [SoilWheelEnv, SoilRoverEnv], ids=["wheel", "rover"])
ALL = pytest.mark.parametrize("make", [
    SoilWheelEnv, SoilRoverEnv, partial(SoilWheelVectorEnv, 2), partial(SoilRoverVectorEnv, 2)
], ids=["wheel", "rover", "wheels", "rovers"])  # fmt: skip


def act(value):
    return np.array([value], dtype=np.float32)


def run(env, seed, steps, actions=None):
    """(observations, rewards, infos, ended) of one episode under random, held actions."""
    rng, motors = np.random.default_rng(0), env.action_space.shape[0]
    observation, info = env.reset(seed=seed)
    rows, rewards, infos = [observation], [], [info]
    for k in range(steps):
        if k % 5 == 0:
            action = rng.uniform(0.1, 0.6, motors)
        given = action if actions is None else np.broadcast_to(actions[k], motors)
        observation, reward, terminated, truncated, info = env.step(given.astype(np.float32))
        rows.append(observation)
        rewards.append(reward)
        infos.append(info)
        if terminated or truncated:
            return np.array(rows), np.array(rewards), infos, True
    return np.array(rows), np.array(rewards), infos, False


@pytest.mark.parametrize("mode", MODES)
@BOTH
def test_a_seed_is_a_course_and_its_noise(make, mode):
    """In a new environment and in a used one; resets without a seed go on from the last one."""
    used = make(action=mode)
    first, again = run(used, 7, 150), run(make(action=mode), 7, 150)
    run(used, 4, 70)
    for other in (again, run(used, 7, 150)):
        np.testing.assert_array_equal(first[0], other[0])
        np.testing.assert_array_equal(first[1], other[1])
        assert first[2] == other[2]
    other = run(make(action=mode), 8, 150)[0]
    assert not np.array_equal(first[0][:10], other[:10])
    runs = []
    for _ in range(2):
        env = make(action=mode)
        runs.append([env.reset(seed=5)[0], env.reset()[0], env.reset()[0]])
    np.testing.assert_array_equal(runs[0], runs[1])
    assert len({tuple(row) for row in runs[0]}) == 3
    assert not np.array_equal(make().reset()[0], make().reset()[0])


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))], ids=["copy", "pickle"])
@pytest.mark.parametrize("make", [SoilWheelVectorEnv, SoilRoverVectorEnv], ids=["wheel", "rover"])
def test_a_copy_of_a_vector_env_goes_on_as_the_original(make, copied):
    env = make(40, threads=2, info="none", course={"length": 2.0})
    env.reset(seed=3)
    other = copied(env)
    for _ in range(40):
        x, y = (e.step(np.full(e.action_space.shape, 0.45))[0] for e in (env, other))
        np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))], ids=["copy", "pickle"])
@pytest.mark.parametrize("render_mode", [None, "rgb_array"])
@BOTH
def test_a_copy_goes_on_as_the_original(make, render_mode, copied):
    env = make(render_mode=render_mode, course={"length": 2.0})
    run(env, 3, 5)
    if render_mode is not None:
        env.render()
    other, untouched = copied(env), copied(env)
    for _ in range(30):
        a, b = (e.step(np.full(e.action_space.shape, 0.45)) for e in (env, other))
        np.testing.assert_array_equal(a[0], b[0])
        assert a[4] == b[4]
        if a[2]:
            break
    np.testing.assert_array_equal(env.reset()[0], other.reset()[0])
    if render_mode is not None:
        assert untouched.render().dtype == np.uint8  # before it was stepped
    for e in (env, other, untouched):
        e.close()


@BOTH
def test_returned_arrays_are_not_overwritten(make):
    env = make()
    first, info = env.reset(seed=0)
    kept, kept_info = first.copy(), repr(info)
    second = env.step(np.full(env.action_space.shape, 0.5))[0]
    kept_second = second.copy()
    env.step(np.full(env.action_space.shape, 0.9))
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(second, kept_second)
    assert repr(info) == kept_info


@pytest.mark.parametrize("bad", [
    lambda shape: 0.5, lambda shape: [], lambda shape: "x", lambda shape: np.zeros((4, 4, *shape)),
    lambda shape: np.full(shape, math.nan), lambda shape: np.full(shape, math.inf), lambda shape: np.zeros((1, *shape)),
])  # fmt: skip
@ALL
def test_bad_actions_are_named_and_change_nothing(make, bad):
    env, untouched = make(), make()
    for e in (env, untouched):
        e.reset(seed=0)
    shape = env.action_space.shape
    with pytest.raises(ValueError, match="action.*expected") as raised:
        env.step(bad(shape))
    assert "\n" not in str(raised.value)
    np.testing.assert_array_equal(env.step(np.full(shape, 0.4))[0], untouched.step(np.full(shape, 0.4))[0])


@pytest.mark.parametrize("mode", MODES)
def test_actions_matter_and_mean_what_they_say(mode):
    env = SoilWheelEnv(action=mode, course={"halt_interval": [1e5, 1e5], "grade_deg": [-1, 0]})
    env.reset(seed=0)
    for _ in range(5 if mode == "rim_acceleration" else 20):  # half of 0.3 m/s2 over 2.5 s is 0.375 m/s
        info = env.step(act(0.5))[4]
    wheel = env.scenario.wheel
    if mode == "torque":
        assert info["state"]["motor_torque"] == pytest.approx(
            min(0.5, 1.0 - info["state"]["wheel_speed"] / wheel.no_load_speed) * wheel.stall_torque
        )
    else:
        assert info["state"]["wheel_speed"] == pytest.approx(0.5 * wheel.no_load_speed, rel=0.1)


@BOTH
def test_order_is_enforced(make):
    env = make(control={"time_limit": 1.0})
    action = np.full(env.action_space.shape, 0.1)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(action)
    assert run(env, 0, 10)[2][-1]["cause"] == "TIME_LIMIT"
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(action)
    with pytest.raises(ValueError, match="options.*'x'"):
        env.reset(options={"x": 1})
    env.reset(options={})
    env.step(action)


def test_halts_happen_and_ignore_the_action():
    halts = []
    for action_in_halt in (0.5, -1.0):
        env = SoilWheelEnv(action="torque", scaled=False, course={"grade_deg": [-1.0, 0.0]})
        observation, _ = env.reset(seed=1)
        rows = [observation]
        for _ in range(80):
            rows.append(env.step(act(action_in_halt if rows[-1][10] else 0.5))[0])
        halts.append(np.array(rows))
    np.testing.assert_array_equal(halts[0], halts[1])
    halted = halts[0][:, 10] == 1.0
    starts = np.flatnonzero(np.diff(halted.astype(int)) == 1)
    assert len(starts) >= 2
    first = np.flatnonzero(halted)[: round(env.scenario.course.halt_time / env.scenario.control.period)]
    assert np.all(np.diff(first) == 1)
    assert np.all(halts[0][first[1:], 8] == 0.0)  # the command that was in force
    assert abs(halts[0][first[-1], 5]) < 0.02  # it stands
    assert halts[0][first[0] - 1, 5] > 0.1  # it did not before
    with_no_halts = run(
        SoilWheelEnv(action="torque", course={"grade_deg": [-1.0, 0.0], "halt_interval": [1e5, 1e5]}), 1, 80
    )[0]
    assert not with_no_halts[:, 10].any()


@pytest.mark.parametrize(("arguments", "message"), [
    ({"cours": {}}, "unexpected keyword argument 'cours'; did you mean 'course'?"),
    ({"observation": "identifed"}, "observation: unknown value 'identifed'; did you mean 'identified'?"),
    ({"render_mode": "x"}, "render_mode = 'x': expected one of ['rgb_array', 'human']"),
    ({"action": "torqe"}, "'torqe'"),
    ({"repeat": "3"}, "repeat = '3': expected a whole number >= 1"),
    ({"scenario": ""}, "scenario = '': expected a name or the path of a YAML file"),
    ({"scenario": "nowhere.yaml"}, "nowhere.yaml: cannot be read"),
])  # fmt: skip
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(soil_env.ParameterError) as raised:
        SoilWheelEnv(**arguments)
    assert message in str(raised.value) and "\n" not in str(raised.value)


@ALL
def test_an_unknown_keyword_is_the_error_of_python_too(make):
    """TorchRL's GymEnv tries `frameskip=...` and goes on without where such a TypeError comes back."""
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'") as raised:
        make(frameskip=1)
    assert isinstance(raised.value, soil_env.ParameterError)
    again = pickle.loads(pickle.dumps(raised.value))
    assert type(again) is type(raised.value) and str(again) == str(raised.value)


def test_the_length_of_an_episode_is_that_of_the_scenario():
    """Wrappers ask `spec.max_episode_steps` for it; registered, it would cut every scenario at the same step."""
    env = gymnasium.wrappers.TimeAwareObservation(
        gymnasium.make("SoilWheel-v0", course={"length": 50.0}, control={"time_limit": 100.0}), normalize_time=True
    )
    observation, _ = env.reset(seed=0)
    assert env.spec.max_episode_steps == 200 and observation[-1] == 0.0
    steps, over = 0, False
    while not over:
        observation, _, terminated, truncated, info = env.step(act(0.35))
        steps, over = steps + 1, terminated or truncated
        assert observation[-1] == pytest.approx(steps / 200)
    again = gymnasium.make(env.unwrapped.spec)
    assert again.unwrapped.scenario == env.unwrapped.scenario and again.spec.max_episode_steps == 200
    assert gymnasium.spec("SoilWheel-v0").max_episode_steps is None


def test_yaml_file_as_scenario(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump({
        "wheel": {"preset": "planetary_rover", "body_mass": 20.0}, "soils": {"lete_sand": 1}, "course": {"length": 5.0},
    }))  # fmt: skip
    for which in (path, str(path)):
        env = gymnasium.make("SoilWheel-v0", scenario=which, gravity=1.6).unwrapped
        assert (env.scenario.name, env.scenario.wheel.body_mass, env.scenario.gravity) == ("mine", 20.0, 1.6)
        assert env.scenario.course.length == 5.0 and env.scenario.wheel.radius == 0.15
        assert env.observation_space.contains(env.reset(seed=0)[0])
    path.write_text("wheel: planetary_rover\nsoils: {lete_sand: 1}\ncours: {}\n")
    with pytest.raises(ParameterError, match="mine.yaml.*'cours'.*'course'"):
        SoilWheelEnv(path)


def check_info(info, observation, env):
    assert set(info) == {"cause", "immobilised", "reward_terms", "estimate", "traversability", "state"}
    assert info["cause"] in Cause.__members__
    assert info["immobilised"] is (info["cause"] in ("ENTRAPPED", "STALLED", "BOGGED"))
    assert set(info["reward_terms"]) == {"progress", "energy", "immobilisation", "information"}
    assert set(info["traversability"]) == {
        "best_slip", "drawbar_margin", "drawbar_margin_sd", "torque_required", "torque_available", "passable",
        "immobilised_within_3_s", "immobilised_within_5_s"}  # fmt: skip
    soon, later = (info["traversability"][f"immobilised_within_{s}_s"] for s in (3, 5))
    assert 0.0 <= soon <= later <= 1.0
    assert info["traversability"]["passable"] == (info["traversability"]["drawbar_margin"] > 0.0)
    values = env.physical(observation)
    e, names = info["estimate"], dict(zip(env.observation_names, values, strict=True))
    assert math.radians(e["friction_angle_deg"]) == pytest.approx(names["friction_angle"], rel=1e-5)
    assert math.log10(e["shear_modulus"]) == pytest.approx(names["log10_shear_modulus"], rel=1e-5)
    assert math.log10(e["sinkage_coefficient"]) == pytest.approx(names["log10_sinkage_coefficient"], rel=1e-5)
    assert math.radians(e["friction_angle_sd_deg"]) == pytest.approx(names["friction_angle_sd"], rel=1e-5)
    assert e["shear_modulus_relative_sd"] == pytest.approx(names["shear_modulus_sd"], rel=1e-5)
    assert e["sinkage_coefficient_relative_sd"] == pytest.approx(names["sinkage_coefficient_sd"], rel=1e-5)
    for name in ("best_pull", "best_pull_sd"):
        assert e[name] == pytest.approx(names[name], rel=1e-5)
    assert (e["status"] == "CONVERGED") == (names["estimate_valid"] == 1.0)
    s, noise = info["state"], env.scenario.noise
    assert abs(s["sinkage"] / env.scenario.wheel.radius - names["sinkage"]) < 6.0 * noise.sinkage / 0.15 + 1e-6
    assert abs(s["grade"] - names["pitch"]) < 6.0 * noise.pitch
    assert abs(s["x"] / env.scenario.course.length - names["odometry"]) < 0.1 * abs(names["odometry"]) + 0.05


def test_info_is_as_documented():
    env = SoilWheelEnv(course={"length": 3.0}, action="torque")
    causes = set()
    for seed in range(6):
        rows, rewards, infos, ended = run(env, seed, 900, [0.3 if seed % 2 else 1.0] * 900)
        assert ended
        for observation, reward, info in zip(rows, [0.0, *rewards], infos, strict=True):
            check_info(info, observation, env)
            assert sum(info["reward_terms"].values()) == pytest.approx(reward, abs=1e-12)
        assert [i["cause"] == "RUNNING" for i in infos] == [True] * (len(infos) - 1) + [False]
        causes.add(infos[-1]["cause"])
    assert "FINISHED" in causes and causes & {"ENTRAPPED", "STALLED", "BOGGED"}


@pytest.mark.parametrize(("changes", "expected"), [
    ({}, (True, False, "FINISHED", 0.0)),
    ({"control": {"time_limit": 1.0}}, (True, False, "TIME_LIMIT", -10.0)),
    ({"max_episode_steps": 10}, (False, True, "RUNNING", 0.0)),
])  # fmt: skip
def test_only_a_wrapper_truncates(changes, expected):
    """To be late is to have lost, and costs; to be cut off by the user's own wrapper is neither."""
    env = gymnasium.make("SoilWheel-v0", course={"length": 2.0, "grade_deg": [-2, 0]}, repeat=1, **changes)
    env.reset(seed=0)
    terminated = truncated = False
    steps = 0
    while not (terminated or truncated):
        _, _, terminated, truncated, info = env.step(act(0.4))
        steps += 1
    assert (terminated, truncated, info["cause"], info["reward_terms"]["immobilisation"]) == expected
    assert not info["immobilised"] and (info["cause"] == "FINISHED" or steps == 10)


def test_traversability_is_that_of_the_estimate():
    """Recomputed from observation and estimate alone at every renewal."""
    env = SoilWheelEnv(scaled=False)
    observation, info = env.reset(seed=2)
    wheel, renewed = env.scenario.wheel, 0
    for k in range(120):
        before = info["traversability"]
        observation, _, ended, _, info = env.step(act(0.3 + 0.2 * math.sin(0.5 * k)))
        found = info["traversability"]
        if found["best_slip"] != before["best_slip"] or found["drawbar_margin"] != before["drawbar_margin"]:
            renewed += 1
            load = max(float(observation[3]), 0.05) * env.scenario.weight
            soil = env.estimate().state(wheel.width)
            best = best_working_point(load, soil, wheel.radius, wheel.width, wheel.stall_torque)
            assert found["best_slip"] == best.slip and found["torque_required"] == best.torque
            estimate = info["estimate"]
            assert found["drawbar_margin"] == pytest.approx(estimate["best_pull"] - math.tan(observation[7]))
            assert found["drawbar_margin_sd"] == estimate["best_pull_sd"]
            assert found["torque_available"] == wheel.stall_torque
        if ended:
            break
    assert renewed > 5


def test_traversability_never_uses_the_true_soil(monkeypatch):
    """With the readings held, other ground, state or truth changes nothing of it; a worse estimate does."""
    env = SoilWheelEnv()
    run(env, 2, 40)

    def warning():
        env.infos.renew(np.ones(1, dtype=bool))
        return env.infos.one(0)["traversability"]

    before = warning()
    env.simulation.worlds.courses.soils[:] *= 0.5
    env.simulation.worlds.courses.grades[:] += 0.1
    for name in ("sinkage", "load", "mass", "grade", "x", "slip"):
        env.simulation.worlds.state[name] *= 1.5
    assert warning() == before
    env.simulation.worlds.ids.best_pull[0] += [-0.1, 0.02]
    worse = warning()
    assert worse["drawbar_margin"] == pytest.approx(before["drawbar_margin"] - 0.1)
    assert worse["drawbar_margin_sd"] == pytest.approx(before["drawbar_margin_sd"] + 0.02)
    env.simulation.worlds.ids.estimate[0, 0] -= 0.2
    assert warning()["torque_required"] < worse["torque_required"]
