"""Environment of a rover: checkers, registration, actions, ends, effects, bad input; the rest is in test_env.py."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from soil_env.rover_env import SoilRoverEnv
from soil_env.rover_vector_env import SoilRoverVectorEnv
from soil_env.simulation.task import VARIANTS
from soil_env.vehicle import load_rover, rover_names

ACTIONS = ("torque", "wheel_speed", "rim_acceleration")


def held(env, seed, steps, command=None):
    """(observations, rewards, infos) of steps under random, held actions, or always the same one; until the end."""
    rng, axles = np.random.default_rng(0), env.action_space.shape[0]
    observation, info = env.reset(seed=seed)
    rows, rewards, infos = [observation], [], [info]
    for k in range(steps):
        if k % 5 == 0:
            action = rng.uniform(0.1, 0.7, axles) if command is None else np.broadcast_to(command, axles)
        observation, reward, over, truncated, info = env.step(action)
        assert not truncated
        rows.append(observation)
        rewards.append(reward)
        infos.append(info)
        if over:
            break
    return np.array(rows), np.array(rewards), infos


@pytest.mark.parametrize(("rover", "variant"), list(zip(rover_names(), VARIANTS, strict=True)))
def test_checkers(rover, variant):
    sb3 = pytest.importorskip("stable_baselines3.common.env_checker")
    env = gymnasium.make("SoilRover-v0", rover=rover, observation=variant, render_mode="rgb_array").unwrapped
    check_env(env, skip_render_check=variant != "identified")
    sb3.check_env(SoilRoverEnv(rover, variant), warn=True)


def test_registration():
    env = gymnasium.make("soil_env:SoilRover-v0", rover="mars_rover", course={"length": 30.0}, vehicle={"mass": 600.0})
    assert type(env.unwrapped) is SoilRoverEnv and env.action_space.shape == (3,)
    assert env.unwrapped.scenario.course.length == 30.0 and env.unwrapped.scenario.wheel.body_mass == 100.0
    assert env.spec.max_episode_steps == 480  # 240 s in steps of 0.5 s
    assert load_rover("mars_rover").course.length == 25.0  # a changed env does not change the next
    many = gymnasium.make_vec("SoilRover-v0", num_envs=3, vectorization_mode="vector_entry_point")
    assert isinstance(many.unwrapped, SoilRoverVectorEnv) and many.action_space.shape == (3, 2)


@pytest.mark.parametrize("action", ACTIONS)
def test_each_axle_has_its_own_action(action):
    """The command of an axle turns its wheels, and values outside are cut."""
    env = SoilRoverEnv("mars_rover", action=action, scaled=False, course={"halt_interval": [1e5, 1e5]})
    env.reset(seed=0)
    for _ in range(12):
        observation, _, _, _, info = env.step([0.1, 7.0, 0.4])
    seen = dict(zip(env.observation_names, observation, strict=True))
    assert [seen[f"{a}_last_action"] for a in ("front", "middle", "rear")] == pytest.approx([0.1, 1.0, 0.4])
    of = [info[a]["state"] for a in ("front", "middle", "rear")]
    wheel = env.scenario.wheel
    if action == "torque":
        line = wheel.stall_torque * np.array([1.0 - s["wheel_speed"] / wheel.no_load_speed for s in of])
        expected = np.minimum(wheel.stall_torque * np.array([0.1, 1.0, 0.4]), line)
        assert [s["motor_torque"] for s in of] == pytest.approx(expected)
    else:
        commanded = [seen[f"{a}_rim_command"] for a in ("front", "middle", "rear")]
        if action == "rim_acceleration":  # 12 steps of 0.5 s at 0.1 m/s2, of 0.425 m/s
            assert commanded == pytest.approx([0.6 * 0.1 / 0.425, 1.0, 0.6 * 0.4 / 0.425], rel=1e-5)
        else:
            assert commanded == pytest.approx([0.1, 1.0, 0.4])
        assert of[0]["wheel_speed"] < of[2]["wheel_speed"] < of[1]["wheel_speed"]


def test_the_rear_axle_starts_at_0_and_ends_the_course():
    env = SoilRoverEnv("mars_rover", action="wheel_speed", course={"length": 2.0, "grade_deg": [-4.0, 0.0]})
    _, _, infos = held(env, 1, 300, 0.5)
    assert infos[0]["state"]["x"] == 0.0 and infos[-1]["cause"] == "FINISHED"
    assert infos[-2]["state"]["x"] < 2.0 <= infos[-1]["state"]["x"] == infos[-1]["rear"]["state"]["x"]
    for info in (infos[0], infos[-1]):
        ahead = [info[a]["state"]["x"] - info["rear"]["state"]["x"] for a in ("front", "middle")]
        assert ahead == pytest.approx([2.258, 2.258 - 1.184], abs=1e-9)


def test_a_stuck_wheel_is_no_end_and_a_stuck_rover_is():
    """One axle locked is dragged downhill by the others; all of them locked are stalled."""
    downhill = {"grade_deg": [-16.0, -15.0], "halt_time": 0.0}
    env = SoilRoverEnv("mars_rover", action="wheel_speed", soils={"quartz_sand": 1}, course=downhill)
    _, _, infos = held(env, 0, 160, (0.5, 0.5, 0.0))
    assert infos[-1]["cause"] == "RUNNING" and infos[-1]["state"]["x"] > 2.0
    assert infos[-1]["rear"]["state"]["slip"] < -0.9 < infos[-1]["front"]["state"]["slip"]
    _, rewards, infos = held(env, 0, 160, 0.0)
    assert infos[-1]["cause"] == "STALLED" and infos[-1]["immobilised"] is True
    assert infos[-1]["reward_terms"]["immobilisation"] == -10.0 and len(rewards) == 100


def test_the_deepest_wheel_is_bogged():
    """Its depth is that below the undisturbed ground, in a rut or not, whatever the others do."""
    downhill = {"grade_deg": [-12.0, -11.0], "halt_time": 0.0}
    env = SoilRoverEnv("field_rover", action="wheel_speed", soils={"quartz_sand": 1}, course=downhill)
    _, _, infos = held(env, 0, 160, (0.0, 0.5))  # the rear wheels spin behind locked ones
    depth, limit = [i["state"]["sinkage"] for i in infos], 0.8 * env.scenario.wheel.radius
    assert infos[-1]["cause"] == "BOGGED" and max(depth[:-1]) <= limit < depth[-1]
    assert infos[-1]["front"]["state"]["sinkage"] < 0.5 * limit
    rovers, rows = env.simulation.worlds.rovers, env.simulation.wheels[0]
    assert depth[-1] == max(rovers.wheels.sinkage[rows] + rovers.axles.floor[rows])
