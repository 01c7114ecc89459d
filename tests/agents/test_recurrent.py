"""Agents with a memory: made as the others are, loaded by the same hands, refused in one line without sb3-contrib."""

import numpy as np
import pytest

from agents import ppo
from agents.evaluate import run_courses
from agents.evaluate.models import load_model
from agents.ppo import PPOConfig, TrainConfig
from agents.training import make_run_folder, open_run, train
from soil_env.parameters import load_scenario
from soil_env.simulation.task import layout

TINY = PPOConfig(num_envs=4, n_steps=16, batch_size=32, n_epochs=1, layer=4, history=2)


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("mixed", {"course": {"length": 2.0}, "control": {"time_limit": 5.0}})


def test_a_saved_agent_drives_with_its_memory_and_goes_on(tmp_path, scenario):
    pytest.importorskip("sb3_contrib")
    model = ppo.build(scenario, "blind", TINY, 0, algorithm="recurrent_ppo")
    model.learn(64)
    path = tmp_path / "model.zip"
    ppo.save(model, path)
    agent = load_model(path, scenario)
    x = np.linspace(0.0, 0.2, 3 * len(layout("blind"))).reshape(3, -1)
    first, state = agent.predict(x, episode_start=np.ones(3, dtype=bool))
    second, _ = agent.predict(x, state, np.zeros(3, dtype=bool))
    afresh, _ = agent.predict(x, state, np.ones(3, dtype=bool))
    assert not np.array_equal(first, second)  # the same readings, but not the first
    np.testing.assert_allclose(afresh, first, atol=1e-6)  # a new course: nothing is remembered
    runs = run_courses(agent, scenario, 3, 4)
    assert np.isfinite(runs.returns).all()
    again = ppo.resume(path, scenario, "blind", TINY, 0, None, algorithm="recurrent_ppo")
    again.learn(64, reset_num_timesteps=False)
    assert again.num_timesteps == 128


def test_a_training_run_ends_and_is_not_repeated(tmp_path, scenario):
    pytest.importorskip("sb3_contrib")
    config = TrainConfig(
        observation="blind", algorithm="recurrent_ppo", name="r", runs=str(tmp_path), timesteps=128, ppo=TINY
    )
    folder = make_run_folder(config, scenario)
    assert open_run(folder)[0] == config
    assert train(folder, config, scenario).timesteps == 128
    assert train(folder, config, scenario).timesteps == 128
