"""rl-baselines3-zoo on the native vector environment; what needs rl_zoo3 itself is left out where it is missing."""

import pydoc
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import yaml

pytest.importorskip("stable_baselines3")
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from agents import zoo
from agents.sb3 import SoilWheelVecEnv

ROOT = Path(__file__).resolve().parents[2]
SHORT = {"control": {"time_limit": 3.0}, "course": {"length": 2.0}}


def wheels(count, **options):
    """Single environments as rl_zoo3 makes them: by a function, which leaves rendering off."""
    return make_vec_env(partial(gymnasium.make, "soil_env:SoilWheel-v0"), count, **options)


@pytest.fixture()
def given():
    """What configs/rl_zoo3/ppo.yml says, quoted text evaluated as rl_zoo3 does."""
    content = yaml.safe_load((ROOT / "configs" / "rl_zoo3" / "ppo.yml").read_text())
    assert list(content) == ["SoilWheel-v0"]
    found = content["SoilWheel-v0"]
    return found | {key: eval(found[key], {"nn": nn}) for key in ("normalize", "policy_kwargs")}


def test_the_hyperparameters_build_an_agent(given, tmp_path):
    """As rl_zoo3 does it: its own keys taken out, the rest arguments of SB3's PPO."""
    ((wrapper, options),) = given.pop("vec_env_wrapper")[0].items()
    made = pydoc.locate(wrapper.replace("soil_env_agents", "agents"))(
        wheels(4, seed=1, monitor_dir=str(tmp_path)), **options
    )
    env = VecNormalize(made, gamma=given["gamma"], **given.pop("normalize"))
    assert given.pop("n_timesteps") >= 1e6 and given.pop("n_envs") * given["n_steps"] % given["batch_size"] == 0
    model = PPO(given.pop("policy"), env, seed=0, **given | {"learning_rate": 1e-3, "n_steps": 8, "batch_size": 32})
    model.learn(32)
    action, _ = model.predict(env.reset(), deterministic=True)
    assert action.shape == (4, 1)
    assert torch.allclose(model.policy.log_std, torch.tensor(-1.0), atol=0.05)


def test_the_native_wheels_are_those_of_sb3(tmp_path):
    """Same courses, rewards and ends as the single environments with the same seed; monitored in one file."""
    singles = wheels(3, seed=5, env_kwargs={"observation": "blind", **SHORT})
    folder = tmp_path / "logs"
    made = wheels(3, seed=5, monitor_dir=str(folder), env_kwargs={"observation": "blind", **SHORT})
    native = zoo.native(made, initial_action=0.25)
    assert native.action_space.low == pytest.approx(-1.25) and native.action_space.high == pytest.approx(0.75)
    np.testing.assert_allclose(native.reset(), singles.reset(), rtol=1e-6)
    ended = 0
    for _ in range(80):
        expected, found = singles.step(np.full((3, 1), 0.35)), native.step(np.full((3, 1), 0.1))
        for one, other in zip(found[:3], expected[:3], strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-6)
        for k in np.flatnonzero(expected[2]):
            ended += 1
            assert found[3][k]["episode"]["r"] == pytest.approx(expected[3][k]["episode"]["r"], abs=1e-4)
    native.close()
    assert ended >= 3
    assert [file.name for file in folder.iterdir()] == ["wheels.monitor.csv"]
    assert len((folder / "wheels.monitor.csv").read_text().splitlines()) == 2 + ended  # two lines say what follows


def test_the_search_draws_what_trains_here():
    """Every draw divides the rollouts of the wheels of ppo.yml, and a trial's parameters give the arguments it had."""
    pytest.importorskip("rl_zoo3")
    import optuna
    from rl_zoo3 import exp_manager

    from agents import zoo_space

    assert exp_manager.HYPERPARAMS_SAMPLER["ppo"] is zoo_space.sample
    assert exp_manager.HYPERPARAMS_CONVERTER["ppo"] is zoo_space.hyperparameters
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=1))
    seen = set()
    for _ in range(100):
        trial = study.ask()
        drawn = zoo_space.sample(trial, 1, 512, {})
        assert 512 * drawn["n_steps"] % drawn["batch_size"] == 0
        assert 0.98 < drawn["gamma"] < 1.0 and 0.75 < drawn["gae_lambda"] < 1.0
        again = zoo_space.hyperparameters(trial.params)
        rate = again.pop("learning_rate")
        schedule = drawn.pop("learning_rate")
        assert again == drawn and rate == f"lin_{schedule(1.0)}" and schedule(0.5) == pytest.approx(schedule(1.0) / 2)
        seen.add((drawn["n_steps"], drawn["batch_size"]))
    assert len(seen) > 10
    env = SoilWheelVecEnv(512, **SHORT)
    PPO("MlpPolicy", env, **drawn | {"learning_rate": schedule, "n_steps": 8, "batch_size": 4096})
