"""Wrappers of other libraries on the native vector environment."""

import gymnasium
import pytest

from soil_env.simulation.task import REWARD_TERMS


def test_wrappers_for_vector_environments_take_the_native_one():
    """RLlib wraps it in DictInfoToList; CleanRL's scripts record statistics."""
    env = gymnasium.make_vec("soil_env:SoilWheel-v0", num_envs=2, vectorization_mode="vector_entry_point")
    env = gymnasium.wrappers.vector.DictInfoToList(gymnasium.wrappers.vector.RecordEpisodeStatistics(env))
    _, infos = env.reset(seed=1)
    assert [set(i) for i in infos] == [{"cause", "immobilised", "x", *(f"reward_{name}" for name in REWARD_TERMS)}] * 2
    for _ in range(160):  # full throttle digs in, or makes no progress for 10 s
        _, reward, terminated, _, infos = env.step([[1.0], [0.0]])
        for k in range(2):
            assert sum(infos[k][f"reward_{name}"] for name in REWARD_TERMS) == pytest.approx(reward[k])
            assert ("episode" in infos[k]) == bool(terminated[k])
    assert len(env.env.return_queue) >= 1
