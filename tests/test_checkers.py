"""The checkers of gymnasium and SB3 for every shipped scenario, with and without effects, single and vector."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from soil_env._io.loading import config_dir
from soil_env.env import SoilWheelEnv
from soil_env.parameters import load_scenario, scenario_names
from soil_env.simulation.task import VARIANTS
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env.vector_env import SoilWheelVectorEnv

MODES = ("torque", "wheel_speed")
WORLDS = sorted((config_dir() / "worlds").glob("*.yaml"))


def world(scenario: str, number: int = 0) -> WheelSoilModel:
    """The effects of a shipped hidden world on the wheel of a scenario."""
    wheel = load_scenario(scenario).wheel
    effects = WheelSoilModel.load(WORLDS[number % len(WORLDS)]).effects
    return WheelSoilModel(ModelWheel(wheel.radius, wheel.width, 0.05 * wheel.radius), None, effects)


@pytest.mark.parametrize("scenario", scenario_names())
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("variant", VARIANTS)
def test_checkers(scenario, mode, variant):
    sb3 = pytest.importorskip("stable_baselines3.common.env_checker")
    for model in (None, world(scenario, VARIANTS.index(variant) + 3 * MODES.index(mode))):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", message=".*(not have a spec|render|spec).*")
            check_env(SoilWheelEnv(scenario, variant, mode, model=model), skip_render_check=True)
        sb3.check_env(SoilWheelEnv(scenario, variant, mode, model=model), warn=True)


def test_checker_with_rendering():
    check_env(gymnasium.make("SoilWheel-v0", render_mode="rgb_array").unwrapped)


def check_vector(env, steps=30):
    """Demands of gymnasium on a vector environment: spaces, dtypes, shapes, seeds, and data of its own."""
    n, single = env.num_envs, env.single_observation_space
    first, info = env.reset(seed=5)
    assert env.observation_space.contains(first) and isinstance(info, dict)
    np.testing.assert_array_equal(first, env.reset(seed=5)[0])
    rng = np.random.default_rng(0)
    kept = first.copy()
    for _ in range(steps):
        actions = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(actions)
        assert env.observation_space.contains(observation) and observation.dtype == single.dtype
        assert reward.shape == terminated.shape == truncated.shape == (n,)
        assert reward.dtype == np.float64 and terminated.dtype == truncated.dtype == np.bool_
        assert not np.shares_memory(observation, first)
    np.testing.assert_array_equal(first, kept)
    env.close()


@pytest.mark.parametrize("scenario", scenario_names())
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("variant", VARIANTS)
def test_vector_env(scenario, mode, variant):
    for model in (None, world(scenario)):
        check_vector(SoilWheelVectorEnv(3, scenario, variant, mode, model=model, course={"length": 2.0}))


def test_single_environments_in_a_vector_of_gymnasium():
    check_vector(gymnasium.make_vec("soil_env:SoilWheel-v0", num_envs=3, vectorization_mode="sync"))
