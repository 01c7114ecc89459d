"""Models of other origin: algorithms of Stable-Baselines3 with a continuous action, recognised by their zip."""

import pickle

import numpy as np
import pytest
from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3
from stable_baselines3.common.vec_env import VecNormalize

from agents.evaluate.contestants import digest
from agents.evaluate.models import load_model
from agents.sb3 import SoilWheelVecEnv
from soil_env._io.loading import ParameterError
from soil_env.cli import main
from soil_env.parameters import load_scenario
from tests.agents.drivers import observations

SMALL = {"net_arch": [4]}


@pytest.fixture(scope="module")
def scenario():
    return load_scenario()


def scaled(variant, raw):
    """Observations as an environment gives them."""
    return SoilWheelVecEnv(1, observation=variant).scaling(raw)


@pytest.mark.parametrize("to_order_one", [True, False])
@pytest.mark.parametrize(
    "algorithm, variant",
    [(PPO, "blind"), (PPO, "true_soil"), (A2C, "blind"), (SAC, "blind"), (TD3, "blind"), (DDPG, "blind")],
)
def test_a_plain_model_acts_as_before(tmp_path, scenario, algorithm, variant, to_order_one):
    env = SoilWheelVecEnv(2, observation=variant, scaled=to_order_one)
    model = algorithm("MlpPolicy", env, policy_kwargs=dict(SMALL), seed=1, device="cpu")
    model.save(tmp_path / "any.zip")
    loaded = load_model(tmp_path / "any.zip", scenario)
    assert loaded.variant == variant
    x = observations(scenario, variant)
    seen = scaled(variant, x) if to_order_one else x
    np.testing.assert_array_equal(loaded.predict(x)[0], model.predict(seen, deterministic=True)[0])


def test_normalisation_that_lies_beside_is_used(tmp_path, scenario):
    env = VecNormalize(SoilWheelVecEnv(4, observation="blind"))
    model = A2C("MlpPolicy", env, policy_kwargs=dict(SMALL), seed=1, device="cpu")
    model.learn(128)
    model.save(tmp_path / "any.zip")
    bare = digest(str(tmp_path / "any.zip"))
    x = observations(scenario, "blind")
    raw = load_model(tmp_path / "any.zip", scenario).predict(x)[0]
    env.save(tmp_path / "vecnormalize.pkl")
    assert digest(str(tmp_path / "any.zip")) != bare  # another agent
    got = load_model(tmp_path / "any.zip", scenario).predict(x)[0]
    seen = env.normalize_obs(scaled("blind", x))
    np.testing.assert_array_equal(got, model.predict(seen, deterministic=True)[0])
    assert (got != raw).any()
    (tmp_path / "vecnormalize.pkl").write_bytes(pickle.dumps([1]))
    with pytest.raises(ParameterError, match="vecnormalize.pkl: cannot be loaded"):
        load_model(tmp_path / "any.zip", scenario)


def test_a_model_of_another_task_is_refused(capsys, tmp_path):
    A2C("MlpPolicy", "Pendulum-v1", policy_kwargs=dict(SMALL), device="cpu").save(tmp_path / "p.zip")
    assert main(["evaluate", f"--controllers={tmp_path}/p.zip", f"--out={tmp_path}/out"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 2 and "another observation layout: shape (3,)" in error
    assert "p.zip: not written by train.py, so parts of it are unpickled" in error.splitlines()[0]
    assert not (tmp_path / "out").exists()
