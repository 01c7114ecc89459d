"""The `VecEnv`s of Stable-Baselines3 against the vector environments that reset
within a step.
"""

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorWrapper

from soil_env._io.loading import ParameterError
from soil_env.envs.rover_env import SoilRoverVectorEnv
from soil_env.envs.wheel_env import SoilWheelVectorEnv
from soil_env.simulation.task import Cause
from soil_env_agents.sb3 import SoilRoverVecEnv, SoilWheelVecEnv

KINDS = [(SoilWheelVecEnv, SoilWheelVectorEnv), (SoilRoverVecEnv, SoilRoverVectorEnv)]


@pytest.mark.parametrize("own, native", KINDS, ids=["wheel", "rover"])
def test_every_number_is_that_of_the_vector_environment(own, native):
    changes = {"control": {"time_limit": 6.0}, "limits": {"no_progress_time": 0.5}}
    env = own(4, **changes)
    other = native(4, autoreset_mode=AutoresetMode.SAME_STEP, **changes)
    env.seed(11)
    np.testing.assert_array_equal(env.reset(), other.reset(seed=11)[0])
    rng = np.random.default_rng(3)
    ends = 0
    returns = np.zeros(4)
    lengths = np.zeros(4)
    for _ in range(100):
        actions = rng.uniform(-0.2, 1.0, other.action_space.shape).astype(np.float32)
        seen, rewards, done, infos = env.step(actions)
        observation, reward, terminated, truncated, info = other.step(actions)
        np.testing.assert_array_equal(seen, observation)
        np.testing.assert_array_equal(rewards, reward.astype(np.float32))
        np.testing.assert_array_equal(done, terminated | truncated)
        returns = returns + reward
        lengths = lengths + 1
        for k in np.flatnonzero(done):
            np.testing.assert_array_equal(infos[k]["terminal_observation"], info["final_obs"][k])
            assert infos[k]["cause"] == Cause(info["final_info"]["cause"][k]).name
            assert infos[k]["TimeLimit.truncated"] is False
            assert infos[k]["episode"]["r"] == pytest.approx(returns[k], rel=1e-9)
            assert infos[k]["episode"]["l"] == lengths[k]
            returns[k] = 0.0
            lengths[k] = 0
            ends = ends + 1
    assert ends >= 4


@pytest.mark.parametrize("own", [SoilWheelVecEnv, SoilRoverVecEnv])
def test_a_truncated_course_is_told_from_one_that_ended(own):
    """By the keyword of the vector environment and by a wrapper of it."""
    env = own(3, observation="blind", max_episode_steps=4)
    env.seed(1)
    env.reset()
    actions = np.full((3, *env.action_space.shape), 0.3, np.float32)
    for _ in range(2):
        for step in range(4):
            seen, _, done, infos = env.step(actions)
            assert done.tolist() == [step == 3] * 3
        assert all(info["TimeLimit.truncated"] for info in infos)
        assert {info["episode"]["l"] for info in infos} == {4}
        assert not np.array_equal(infos[0]["terminal_observation"], seen[0])
    env = own(2, observation="blind")
    env.env = Impatient(env.env)
    env.reset()
    _, _, done, infos = env.step(actions[:2])
    assert done.all() and all(info["TimeLimit.truncated"] for info in infos)


class Impatient(VectorWrapper):
    """Truncates every course in its first step."""

    def step(self, actions):
        seen, reward, terminated, truncated, info = super().step(actions)
        self.unwrapped._done[:] = True
        return seen, reward, terminated, ~terminated, info


@pytest.mark.parametrize("own", [SoilWheelVecEnv, SoilRoverVecEnv])
def test_what_it_cannot_take_is_one_line(own):
    for options, said in (
        ({"autoreset_mode": "NextStep"}, "autoreset_mode = 'NextStep': expected none"),
        ({"info": "full"}, "info = 'full': expected none"),
        ({"num_envs": "two"}, "num_envs = 'two'"),
        ({"corse": {}}, "did you mean 'course'"),
    ):
        with pytest.raises(ParameterError, match=said):
            own(**{"num_envs": 1, "observation": "blind", **options})
    env = own(1, observation="blind")
    for call in (env.step_wait, env.true_soil):
        with pytest.raises(ResetNeeded):
            call()
    env.reset()
    env.step(np.zeros((1, *env.action_space.shape)))
    with pytest.raises(ResetNeeded):  # an action is taken once
        env.step_wait()
    env.step_async(np.zeros((1, *env.action_space.shape)))
    env.reset()
    with pytest.raises(ResetNeeded):  # and not on the course after it
        env.step_wait()
    env.set_options({})
    with pytest.raises(ParameterError, match="reset options = .*'x'.*: expected none"):
        env.set_options({"x": 1})
    with pytest.raises(IndexError):
        env.get_attr("scenario", 1)
