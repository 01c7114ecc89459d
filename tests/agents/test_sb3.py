"""`agents.sb3.SoilWheelVecEnv` against what Stable-Baselines3 expects of a `VecEnv`; the scalar env is the judge."""

import numpy as np
import pytest

from agents.sb3 import SoilWheelVecEnv
from soil_env.env import SoilWheelEnv
from soil_env.simulation.task import VARIANTS

SHORT = {"control": {"time_limit": 3.0}}  # 6 steps of 0.5 s
QUICK_END = {"limits": {"no_progress_time": 0.5}}
FINISH = {"scenario": "mixed", "course": {"length": 1.0, "patch_length": [0.5, 0.9], "grade_deg": [-5.0, 0.0]}}


def drive(env, steps, actions):
    """Reset, then `steps` steps with `actions` [steps, wheels, 1]: first observations and a list of step results."""
    first = env.reset()
    return first, [env.step(actions[t]) for t in range(steps)]


def random_actions(steps, wheels, low=-0.2, high=1.0, seed=3):
    return np.random.default_rng(seed).uniform(low, high, (steps, wheels, 1)).astype(np.float32)


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_number_equals_the_scalar_env(variant):
    """Observation, reward, end and terminal observation of wheel k are those of SoilWheelEnv with seed + k."""
    steps, wheels, seed = 80, 3, 11
    changes = {**QUICK_END, "control": {"time_limit": 6.0}}
    actions = random_actions(steps, wheels)
    vec = SoilWheelVecEnv(wheels, observation=variant, **changes)
    vec.seed(seed)
    first, results = drive(vec, steps, actions)
    ends = 0
    for k in range(wheels):
        one = SoilWheelEnv(observation=variant, **changes)
        observation, _ = one.reset(seed=seed + k)
        np.testing.assert_array_equal(first[k], observation)
        for t in range(steps):
            observation, reward, terminated, truncated, info = one.step(actions[t, k])
            observations, rewards, dones, infos = results[t]
            assert rewards[k] == pytest.approx(reward, rel=1e-6, abs=1e-7)
            assert dones[k] == (terminated or truncated)
            if dones[k]:
                ends += 1
                np.testing.assert_array_equal(infos[k]["terminal_observation"], observation)
                assert infos[k]["TimeLimit.truncated"] is (truncated and not terminated)
                assert infos[k]["cause"] == info["cause"]
                observation, _ = one.reset()  # goes on with the stream, as the vector env does
            np.testing.assert_array_equal(observations[k], observation)
    assert ends >= wheels


def test_episode_info_equals_the_sums_of_rewards_and_steps():
    wheels, steps = 6, 150
    env = SoilWheelVecEnv(wheels, **QUICK_END, **SHORT)
    env.seed(2)
    _, results = drive(env, steps, random_actions(steps, wheels, seed=8))
    returns, lengths, ends = np.zeros(wheels), np.zeros(wheels, dtype=int), 0
    for _, rewards, dones, infos in results:
        returns += rewards
        lengths += 1
        for k in np.flatnonzero(dones):
            episode = infos[k]["episode"]
            assert episode["r"] == pytest.approx(returns[k], rel=1e-5, abs=1e-5)
            assert episode["l"] == lengths[k]
            assert episode["t"] >= 0.0
            returns[k], lengths[k] = 0.0, 0
            ends += 1
    assert ends >= wheels * (steps // 30)


@pytest.mark.parametrize("bad, match", [
    ([[0.0], [np.nan], [0.0]], "finite"), ([[0.0], [np.inf], [0.0]], "finite"), (np.zeros(3), "shape"),
    (np.zeros((3, 2)), "shape"), (np.zeros((2, 1)), "shape"), ("x", "actions = 'x': expected numbers"),
])  # fmt: skip
def test_an_action_that_cannot_be_is_refused(bad, match):
    env = SoilWheelVecEnv(3)
    env.reset()
    with pytest.raises(ValueError, match=match):
        env.step_async(bad)


def test_actions_are_cut_to_the_bounds():
    results = []
    for value in (1.0, 50.0):
        env = SoilWheelVecEnv(2)
        env.seed(0)
        env.reset()
        results.append(env.step(np.full((2, 1), value, dtype=np.float32))[0])
    np.testing.assert_array_equal(*results)
