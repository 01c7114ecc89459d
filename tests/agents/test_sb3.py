"""`agents.sb3`: the `VecEnv`s of Stable-Baselines3 against the vector environments that reset
within a step.
"""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from agents.sb3 import SoilRoverVecEnv, SoilWheelVecEnv
from soil_env.envs.rover_env import SoilRoverVectorEnv
from soil_env.envs.wheel_env import SoilWheelVectorEnv
from soil_env.simulation.task import Cause

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
