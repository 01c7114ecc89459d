"""Environments of a wheel and of a rover: checkers, determinism, copies, actions, arguments, ends,
info.
"""

import copy
import json
import math
import pickle
import warnings
from functools import partial

import gymnasium
import numpy as np
import pytest
import yaml
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

from soil_env._io.loading import config_dir
from soil_env.envs.rover_env import SoilRoverEnv, SoilRoverVectorEnv
from soil_env.envs.wheel_env import SoilWheelEnv, SoilWheelVectorEnv
from soil_env.parameters import (
    CourseSpec,
    ParameterError,
    Soil,
    load_rover,
    load_scenario,
    rover_names,
    scenario_names,
)
from soil_env.simulation.task import VARIANTS, Cause
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env.terramechanics.traversability import best_working_point
from tests.refusals import refused

MODES = ("torque", "wheel_speed", "rim_acceleration")
BOTH = pytest.mark.parametrize("make", [SoilWheelEnv, SoilRoverEnv], ids=["wheel", "rover"])
ALL = pytest.mark.parametrize(
    "make",
    [SoilWheelEnv, SoilRoverEnv, partial(SoilWheelVectorEnv, 2), partial(SoilRoverVectorEnv, 2)],
    ids=["wheel", "rover", "wheels", "rovers"],
)


def run(env, seed, steps, command=None):
    """(observations, rewards, infos) of at most `steps` steps, up to the end of the episode.

    Actions are `command`, or, without one, random and held over five steps. Observations and infos
    begin with those of the reset.
    """
    rng = np.random.default_rng(0)
    motors = env.action_space.shape
    observation, info = env.reset(seed=seed)
    rows = [observation]
    rewards = []
    infos = [info]
    for k in range(steps):
        if k % 5 == 0:
            action = (
                rng.uniform(0.1, 0.6, motors)
                if command is None
                else np.broadcast_to(command, motors)
            )
        observation, reward, over, truncated, info = env.step(action)
        assert not truncated
        rows.append(observation)
        rewards.append(reward)
        infos.append(info)
        if over:
            break
    return np.array(rows), np.array(rewards), infos


@pytest.mark.parametrize("mode", MODES)
@BOTH
def test_a_seed_is_a_course_and_its_noise(make, mode):
    """In a new environment and in a used one; resets without a seed go on from the last one."""
    used = make(action=mode)
    first = run(used, 7, 150)
    again = run(make(action=mode), 7, 150)
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


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", [*scenario_names(), *rover_names()])
def test_checkers(name, variant):
    """Checkers of gymnasium and SB3, for a wheel with and without the effects of a shipped hidden
    world.
    """
    sb3 = pytest.importorskip("stable_baselines3.common.env_checker")
    number = len(VARIANTS) * [*scenario_names(), *rover_names()].index(name) + VARIANTS.index(
        variant
    )
    mode = MODES[(number + number // len(VARIANTS)) % len(MODES)]  # each action with each variant
    if name in rover_names():
        make = SoilRoverEnv
        models = (None,)
    else:
        make = SoilWheelEnv
        wheel = load_scenario(name).wheel
        worlds = sorted((config_dir() / "worlds").glob("*.yaml"))
        effects = WheelSoilModel.load(worlds[number % len(worlds)]).effects
        models = (
            None,
            WheelSoilModel(
                ModelWheel(wheel.radius, wheel.width, 0.05 * wheel.radius), None, effects
            ),
        )
    for model in models:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", message=".*(not have a spec|render|spec).*")
            drawn = variant == "identified"
            env = make(name, variant, mode, model=model, render_mode="rgb_array" if drawn else None)
            check_env(env, skip_render_check=not drawn)
        sb3.check_env(make(name, variant, mode, model=model), warn=True)


def test_registration_of_the_rover():
    env = gymnasium.make(
        "soil_env:SoilRover-v0",
        rover="mars_rover",
        course={"length": 30.0},
        vehicle={"mass": 600.0},
    )
    assert type(env.unwrapped) is SoilRoverEnv and env.action_space.shape == (3,)
    assert (
        env.unwrapped.scenario.course.length == 30.0
        and env.unwrapped.scenario.wheel.body_mass == 100.0
    )
    assert load_rover("mars_rover").course.length == 25.0  # a changed env does not change the next
    many = gymnasium.make_vec("SoilRover-v0", num_envs=3, vectorization_mode="vector_entry_point")
    assert isinstance(many.unwrapped, SoilRoverVectorEnv) and many.action_space.shape == (3, 2)


def test_an_environment_ends_by_itself_and_a_spec_adds_no_limit():
    env = gymnasium.make("SoilWheel-v0", course={"length": 50.0}, control={"time_limit": 20.0})
    again = gymnasium.make(env.spec)
    assert str(again) == str(env) and again.spec.max_episode_steps is None
    for one in (env, again):
        one.reset(seed=0)
        over = False
        while not over:
            *_, over, truncated, info = one.step(np.float32([0.35]))
            assert not truncated
        assert info["cause"] == "TIME_LIMIT"


_SOIL = Soil(31.0, 800.0, 0.02, 1.0, sinkage_coefficient=9e5)
SPECS = [
    ("SoilWheel-v0", {"scenario": load_scenario("mixed", {"course": {"length": 4.0}})}),
    ("SoilWheel-v0", {"scenario": "mixed", "own_soils": {"own": _SOIL}, "soils": {"own": 1}}),
    ("SoilWheel-v0", {"course": CourseSpec(length=np.float32(4.0), classes=3, lines=2)}),
    ("SoilWheel-v0", {"scenario": "mixed", "model": WheelSoilModel(ModelWheel(0.2, 0.1), _SOIL)}),
    ("SoilWheel-v0", {"scenario": config_dir() / "scenarios" / "sticky.yaml", "info": "state"}),
    ("SoilRover-v0", {"rover": load_rover("mars_rover"), "observation": "blind"}),
]


@pytest.mark.parametrize(("name", "options"), SPECS)
def test_the_json_of_a_spec_makes_the_environment_again(name, options):
    """The checkers of gymnasium and SB3 run on what the spec gives."""
    env = gymnasium.make(name, **options)
    spec = EnvSpec.from_json(env.spec.to_json())
    again = gymnasium.make(spec)
    assert again.unwrapped.scenario == env.unwrapped.scenario
    assert again.unwrapped.model == env.unwrapped.model
    np.testing.assert_array_equal(again.reset(seed=4)[0], env.reset(seed=4)[0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*(render|different from the unwrapped).*")
        check_env(gymnasium.make(spec), skip_render_check=True)
    sb3 = pytest.importorskip("stable_baselines3.common.env_checker")
    sb3.check_env(gymnasium.make(spec), warn=True)
    many = gymnasium.make_vec(name, 2, "vector_entry_point", **options)
    plain = json.loads(many.spec.to_json())["kwargs"]
    plain.pop("vectorization_mode")
    assert type(many.unwrapped)(**plain).scenario == many.unwrapped.scenario


@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))], ids=["copy", "pickle"]
)
@pytest.mark.parametrize("drawn", [False, True])
@ALL
def test_a_copy_goes_on_as_the_original(make, drawn, copied):
    if drawn and make not in (SoilWheelEnv, SoilRoverEnv):
        pytest.skip("a vector of environments draws nothing")
    env = make(course={"length": 2.0}, **({"render_mode": "rgb_array"} if drawn else {}))
    env.reset(seed=3)
    env.step(np.full(env.action_space.shape, 0.3))
    if drawn:
        env.render()
    other = copied(env)
    untouched = copied(env)
    for _ in range(30):
        a, b = (e.step(np.full(e.action_space.shape, 0.45)) for e in (env, other))
        np.testing.assert_equal(a, b)
        if np.any(a[2]):
            break
    np.testing.assert_array_equal(env.reset()[0], other.reset()[0])
    if drawn:
        assert untouched.render().dtype == np.uint8  # before it was stepped
    for e in (env, other, untouched):
        e.close()


@ALL
def test_returned_data_have_their_types_and_are_not_overwritten(make):
    env = make()
    returned = [env.reset(seed=0)]
    kept = copy.deepcopy(returned)
    for level in (0.5, 0.9, 0.1):
        returned.append(env.step(np.full(env.action_space.shape, level)))
        kept.append(copy.deepcopy(returned[-1]))
        observation, reward, terminated, truncated, _ = returned[-1]
        assert env.observation_space.contains(observation)
        if make not in (SoilWheelEnv, SoilRoverEnv):
            assert reward.dtype == np.float64 and terminated.dtype == truncated.dtype == np.bool_
            assert reward.shape == terminated.shape == truncated.shape == (2,)
    for a, b in zip(returned, kept, strict=True):
        np.testing.assert_equal(a, b)


@pytest.mark.parametrize("make", [SoilWheelVectorEnv, SoilRoverVectorEnv], ids=["wheel", "rover"])
def test_the_info_of_an_end_is_not_overwritten_by_the_next_step(make):
    env = make(2, info="full", autoreset_mode="SameStep", max_episode_steps=2)
    env.reset(seed=0)
    actions = np.full(env.action_space.shape, 0.5)
    env.step(actions)
    info = env.step(actions)[4]
    kept = pickle.dumps(info)
    for _ in range(3):  # through the next end
        env.step(0.5 * actions)
    assert pickle.dumps(info) == kept
    assert np.all(info["final_info"]["state"]["x"] > 0.0)


@pytest.mark.parametrize(
    "bad",
    [
        lambda shape: 0.5,
        lambda shape: [],
        lambda shape: "x",
        lambda shape: np.full(shape, "0.4"),
        lambda shape: np.full(shape, 0.4 + 0.1j),
        lambda shape: np.zeros((4, 4, *shape)),
        lambda shape: np.full(shape, math.nan),
        lambda shape: np.full(shape, math.inf),
        lambda shape: np.full(shape, 10**400),
        lambda shape: np.zeros((1, *shape)),
    ],
)
@ALL
def test_bad_actions_are_named_and_change_nothing(make, bad):
    env = make()
    untouched = make()
    for e in (env, untouched):
        e.reset(seed=0)
    shape = env.action_space.shape
    with pytest.raises(ValueError, match="action.*expected") as raised:
        env.step(bad(shape))
    assert "\n" not in str(raised.value)
    np.testing.assert_array_equal(
        env.step(np.full(shape, 0.4))[0], untouched.step(np.full(shape, 0.4))[0]
    )


@BOTH
def test_order_is_enforced(make):
    """`step` raises before a reset and after an end; a reset refuses options that are unknown."""
    env = make(control={"time_limit": 1.0})
    action = np.full(env.action_space.shape, 0.1)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(action)
    assert run(env, 0, 10)[2][-1]["cause"] == "TIME_LIMIT"
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(action)
    known = env.np_random_seed
    with pytest.raises(ValueError, match="options.*'x'"):
        env.reset(seed=99, options={"x": 1})
    assert env.np_random_seed == known  # a refused reset leaves no seed behind
    env.reset(options={})
    env.step(action)


@pytest.mark.parametrize(
    ("make", "ask"),
    [
        (SoilWheelEnv, "estimate"),
        (SoilWheelEnv, "true_soil"),
        (SoilRoverEnv, "true_soils"),
        (SoilWheelEnv, "render"),
        (SoilRoverEnv, "render"),
    ],
)
def test_nothing_is_told_of_a_course_before_the_first_reset(make, ask):
    """Neither soils nor an estimate nor a picture; drawing a wheel without a course never ended."""
    with pytest.raises(gymnasium.error.ResetNeeded, match="before reset"):
        getattr(make(render_mode="rgb_array"), ask)()


@BOTH
def test_halts_happen_and_ignore_the_action(make):
    """In a halt the vehicle comes to a stand for the stated time, whatever the action is then."""
    changes = {"observation": "blind", "action": "torque", "scaled": False, "repeat": 1}
    env = make(**changes, course={"grade_deg": [-1.0, 0.0]})
    halts = []
    halted, speed, *actions = (
        [
            k
            for k, name in enumerate(env.observation_names)
            if name == end or name.endswith(f"_{end}")
        ]
        for end in ("halted", "speed", "last_action")
    )
    for in_halt in (0.5, -1.0):
        rows = [env.reset(seed=1)[0]]
        for _ in range(80):
            action = in_halt if rows[-1][halted[0]] else 0.5
            rows.append(env.step(np.full(env.action_space.shape, action))[0])
        halts.append(np.array(rows))
    np.testing.assert_array_equal(*halts)
    rows = halts[0]
    here = halts[0][:, halted[0]] == 1.0
    last = np.flatnonzero(here[:-1] & ~here[1:])
    starts = np.flatnonzero(~here[:-1] & here[1:])[: len(last)]
    assert len(last) >= 1 and np.all(rows[starts, speed[0]] > 0.1)
    assert np.all(np.abs(rows[last, speed[0]]) < 0.05)  # it stands
    lasted = env.scenario.course.halt_time / env.scenario.control.period
    assert np.all(last - starts == round(lasted))
    assert np.all(rows[1:, actions[0]][here[:-1]] == 0.0) and np.all(
        rows[1:, actions[0]][~here[:-1]] == 0.5
    )


@pytest.mark.parametrize(
    ("make", "arguments", "message"),
    [
        (
            SoilWheelEnv,
            {"cours": {}},
            "unexpected keyword argument 'cours'; did you mean 'course'?",
        ),
        (SoilWheelEnv, {"observation": "x"}, "observation: unknown value 'x'"),
        (
            SoilWheelEnv,
            {"render_mode": "x"},
            "render_mode = 'x': expected one of ['rgb_array', 'human']",
        ),
        (SoilWheelEnv, {"repeat": "3"}, "repeat = '3': expected a whole number >= 1"),
        (
            SoilWheelEnv,
            {"repeat": 4, "control": {"repeat": 3}},
            "repeat = 4: control has repeat = 3: expected one of them",
        ),
        (
            SoilWheelEnv,
            {"scenario": ""},
            "scenario = '': expected a name or the path of a YAML file",
        ),
        (SoilWheelEnv, {"scenario": "nowhere.yaml"}, "nowhere.yaml: cannot be read"),
        (SoilWheelVectorEnv, {"num_envs": 0}, "num_envs = 0: expected a whole number >= 1"),
        (
            SoilWheelVectorEnv,
            {"autoreset_mode": "x"},
            "autoreset_mode = 'x': expected one of 'NextStep'",
        ),
        (
            SoilWheelVectorEnv,
            {"render_mode": "rgb_array"},
            "render_mode: the vector env does not render",
        ),
        (SoilRoverVectorEnv, {"threads": -1}, "threads"),
        (
            SoilRoverVectorEnv,
            {"info": "x"},
            "info = 'x': expected one of 'full', 'state', 'numeric', 'short', 'none'",
        ),
    ],
)
def test_bad_arguments_are_named(make, arguments, message):
    refused(lambda: make(**arguments), message)


@ALL
def test_an_unknown_keyword_is_the_error_of_python_too(make):
    """TorchRL's GymEnv tries `frameskip=...` and goes on without where such a TypeError comes
    back.
    """
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'") as raised:
        make(frameskip=1)
    assert isinstance(raised.value, ParameterError)
    again = pickle.loads(pickle.dumps(raised.value))
    assert type(again) is type(raised.value) and str(again) == str(raised.value)


def test_yaml_file_as_scenario(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(
        yaml.safe_dump(
            {
                "wheel": {"preset": "planetary_rover", "body_mass": 20.0},
                "soils": {"lete_sand": 1},
                "course": {"length": 5.0},
            }
        )
    )
    for which in (path, str(path)):
        env = gymnasium.make("SoilWheel-v0", scenario=which, gravity=1.6).unwrapped
        assert (env.scenario.name, env.scenario.wheel.body_mass, env.scenario.gravity) == (
            "mine",
            20.0,
            1.6,
        )
        assert env.scenario.course.length == 5.0 and env.scenario.wheel.radius == 0.15
    path.write_text("wheel: planetary_rover\nsoils: {lete_sand: 1}\ncours: {}\n")
    with pytest.raises(ParameterError, match="mine.yaml.*'cours'.*'course'"):
        SoilWheelEnv(path)


def downhill(degrees):
    """Changes of a course: all slopes of one grade [deg], uphill positive, on any soil."""
    return {"grade_deg": [degrees] * 2, "first_grade_deg": [degrees] * 2, "least_pull": -1.0}


def test_a_stuck_wheel_is_no_end_and_a_stuck_rover_is():
    """One axle locked is dragged downhill by the others; all of them locked are stalled."""
    course = dict(downhill(-16.0), halt_time=0.0)
    env = SoilRoverEnv("mars_rover", action="wheel_speed", soils={"dry_sand": 1}, course=course)
    infos = run(env, 0, 160, (0.5, 0.5, 0.0))[2]
    assert (
        infos[-1]["cause"] == "RUNNING"
        and infos[-1]["state"]["x"] == infos[-1]["rear"]["state"]["x"] > 2.0
    )
    assert infos[-1]["rear"]["state"]["slip"] < -0.9 < infos[-1]["front"]["state"]["slip"]
    _, rewards, infos = run(env, 0, 160, 0.0)
    assert infos[-1]["cause"] == "STALLED" and infos[-1]["immobilised"] is True
    assert infos[-1]["reward_terms"]["immobilisation"] == -10.0 and len(rewards) == 100


def test_the_deepest_wheel_is_bogged():
    """Its depth is that below the undisturbed ground, in a rut or not, whatever the others do."""
    course = dict(downhill(-12.0), halt_time=0.0)
    env = SoilRoverEnv("field_rover", action="wheel_speed", soils={"quartz_sand": 1}, course=course)
    infos = run(env, 5, 160, (0.0, 0.5))[2]  # the rear wheels spin behind locked ones
    depth = [i["state"]["sinkage"] for i in infos]
    limit = 0.8 * env.scenario.wheel.radius
    assert infos[-1]["cause"] == "BOGGED" and max(depth[:-1]) <= limit < depth[-1]
    assert infos[-1]["front"]["state"]["sinkage"] < 0.5 * limit
    rover = env.simulation.worlds.state[0]
    assert depth[-1] == max(
        wheel.sinkage + axle.floor for wheel, axle in zip(rover.wheels, rover.axles, strict=True)
    )


def test_info_is_as_documented():
    """Estimates as in the observation, the state as the sensors read it, and rewards the sum of
    their terms.
    """
    env = SoilWheelEnv(course={"length": 3.0, "first_grade_deg": [0.0, 6.0]}, action="torque")
    causes = set()
    noise = env.scenario.noise
    radius = env.scenario.wheel.radius
    length = env.scenario.course.length
    for seed in range(6):
        rows, rewards, infos = run(env, seed, 900, 0.3 if seed % 2 else 1.0)
        zero = env.simulation.worlds.state[0].zero  # of these sensors no gain differs from 1
        for observation, reward, info in zip(rows, [0.0, *rewards], infos, strict=True):
            assert set(info) == {
                "cause",
                "immobilised",
                "reward_terms",
                "estimate",
                "traversability",
                "state",
            }
            assert info["immobilised"] is (info["cause"] in ("ENTRAPPED", "STALLED", "BOGGED"))
            assert sum(info["reward_terms"].values()) == pytest.approx(reward, abs=1e-12)
            way = info["traversability"]
            e = info["estimate"]
            s = info["state"]
            assert 0.0 <= way["immobilised_within_3_s"] <= way["immobilised_within_5_s"] <= 1.0
            assert way["passable"] == (way["drawbar_margin"] > 0.0)
            seen = dict(zip(env.observation_names, env.physical(observation), strict=True))
            assert math.degrees(seen["friction_angle"]) == pytest.approx(
                e["friction_angle_deg"], rel=1e-5
            )
            assert 10.0 ** seen["log10_shear_modulus"] == pytest.approx(
                e["shear_modulus"], rel=1e-5
            )
            assert 10.0 ** seen["log10_sinkage_coefficient"] == pytest.approx(
                e["sinkage_coefficient"], rel=1e-4
            )
            assert math.degrees(seen["friction_angle_sd"]) == pytest.approx(
                e["friction_angle_sd_deg"], rel=1e-5
            )
            assert (e["status"] == "CONVERGED") == (seen["estimate_valid"] == 1.0)
            off = seen["sinkage"] - (s["sinkage"] + zero[0].sinkage) / radius
            assert abs(off) < 6.0 * noise.sinkage / radius + 1e-6
            assert abs(s["grade"] + zero[0].pitch - seen["pitch"]) < 6.0 * noise.pitch
            assert abs(s["x"] / length - seen["odometry"]) < 0.1 * abs(seen["odometry"]) + 0.05
        assert [i["cause"] == "RUNNING" for i in infos] == [True] * (len(infos) - 1) + [False]
        causes.add(infos[-1]["cause"])
    assert (
        "FINISHED" in causes
        and causes & {"ENTRAPPED", "STALLED", "BOGGED"}
        and causes <= set(Cause.__members__)
    )


def test_traversability_is_that_of_the_estimate():
    """Recomputed from observation and estimate alone at every renewal."""
    env = SoilWheelEnv(scaled=False)
    info = env.reset(seed=2)[1]
    wheel = env.scenario.wheel
    renewed = 0
    for k in range(120):
        before = info["traversability"]
        observation, _, ended, _, info = env.step(np.float32([0.3 + 0.2 * math.sin(0.5 * k)]))
        found = info["traversability"]
        if (
            found["best_slip"] != before["best_slip"]
            or found["drawbar_margin"] != before["drawbar_margin"]
        ):
            renewed += 1
            # entry 3 is the load [of weight], entry 7 below the pitch [rad]
            load = max(float(observation[3]), 0.05) * env.scenario.weight
            soil = env.estimate().state(wheel.width)
            best = best_working_point(load, soil, wheel.radius, wheel.width, wheel.stall_torque)
            assert found["best_slip"] == best.slip
            # by the identifier's own code, rounded in another order
            assert found["torque_required"] == pytest.approx(best.torque, rel=1e-13)
            estimate = info["estimate"]
            assert found["drawbar_margin"] == pytest.approx(
                estimate["best_pull"] - math.tan(observation[7])
            )
            assert found["drawbar_margin_sd"] == estimate["best_pull_sd"]
            assert found["torque_available"] == wheel.stall_torque
        if ended:
            break
    assert renewed > 5
