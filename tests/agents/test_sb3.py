"""The `VecEnv`s of Stable-Baselines3 against the vector environments that reset
within a step.
"""

from functools import partial

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorWrapper

from soil_env.envs.rover_env import SoilRoverVectorEnv
from soil_env.envs.wheel_env import SoilWheelVectorEnv
from soil_env.simulation.task import Cause
from soil_env_agents.sb3 import SoilRoverVecEnv, SoilWheelVecEnv
from tests.refusals import refused

OWN = pytest.mark.parametrize("own", [SoilWheelVecEnv, SoilRoverVecEnv])
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
    paid = [[] for _ in range(4)]
    for _ in range(100):
        actions = rng.uniform(-0.2, 1.0, other.action_space.shape).astype(np.float32)
        seen, rewards, done, infos = env.step(actions)
        observation, reward, terminated, truncated, info = other.step(actions)
        np.testing.assert_array_equal(seen, observation)
        np.testing.assert_array_equal(rewards, reward.astype(np.float32))
        np.testing.assert_array_equal(done, terminated | truncated)
        for k, told in enumerate(infos):
            paid[k].append(reward[k])
            if done[k]:
                np.testing.assert_array_equal(told["terminal_observation"], info["final_obs"][k])
                assert told["cause"] == Cause(info["final_info"]["cause"][k]).name
                assert told["TimeLimit.truncated"] is False
                assert told["episode"]["r"] == pytest.approx(sum(paid[k]), rel=1e-9)
                assert told["episode"]["l"] == len(paid[k])
                paid[k] = []
                ends += 1
    assert ends >= 4


@OWN
def test_a_truncated_course_is_told_from_one_that_ended(own):
    """Truncated by `max_episode_steps`, and by a wrapper of the vector environment."""
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


@OWN
def test_what_it_cannot_take_is_one_line(own):
    for options, said in (
        ({"autoreset_mode": "NextStep"}, "autoreset_mode = 'NextStep': expected none"),
        ({"info": "full"}, "info = 'full': expected none"),
        ({"num_envs": "two"}, "num_envs = 'two'"),
        ({"corse": {}}, "did you mean 'course'"),
    ):
        refused(partial(own, **{"num_envs": 1} | options), said)
    env = own(1, observation="blind")
    for call in (env.step_wait, env.true_soil):
        with pytest.raises(ResetNeeded):
            call()
    env.reset()
    still = np.zeros((1, *env.action_space.shape))
    env.step(still)
    with pytest.raises(ResetNeeded):  # an action is taken once
        env.step_wait()
    env.step_async(still)
    env.reset()
    with pytest.raises(ResetNeeded):  # and not on the course after it
        env.step_wait()
    env.set_options({})
    refused(lambda: env.set_options({"x": 1}), "reset options = ", "'x'", ": expected none")
    with pytest.raises(IndexError):
        env.get_attr("scenario", 1)
