"""Wrappers of the single environment."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from soil_env import ParameterError
from soil_env.wrappers import LineAction


def plain(**options):
    """A wheel without `LineAction` around it, by default with two routes."""
    return gymnasium.make("soil_env:SoilWheel-v0", info="none", **options)


@pytest.fixture()
def env():
    return LineAction(plain())


@pytest.mark.parametrize("line", [-0.4, 0.4])
def test_the_second_number_counts_where_a_line_is_chosen_and_nowhere_else(env, line):
    reference = plain().unwrapped
    assert env.action_space.shape == (2,)
    choice = reference.observation_names.index("choice")
    forks = 0
    for seed in range(3):
        seen = env.reset(seed=seed)[0]
        expected = reference.reset(seed=seed)[0]
        over = False
        while not over:
            np.testing.assert_array_equal(seen, expected)
            choosing = expected[choice] > 0.5
            forks += choosing
            seen, _, over, _, _ = env.step([0.3, line])
            expected = reference.step([line if choosing else 0.3])[0]
    assert forks >= 5


@pytest.mark.parametrize("action", [[0.3], [0.3, np.nan], "left"])
def test_other_actions_are_refused(env, action):
    env.reset(seed=1)
    with pytest.raises(ValueError, match="action"):
        env.step(action)


def test_environments_without_two_lines_or_with_another_action_are_refused(env):
    for other, said in (
        (plain(scenario="mixed"), "SoilWheel-v0 with two routes"),
        (env, "an action of one number"),
    ):
        with pytest.raises(ParameterError, match=f"expected {said}"):
            LineAction(other)


@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version")
def test_it_is_made_again_from_its_spec(env):
    again = gymnasium.make(env.spec)
    assert isinstance(again, LineAction) and again.action_space == env.action_space
    np.testing.assert_array_equal(again.reset(seed=4)[0], env.reset(seed=4)[0])
    check_env(env, skip_render_check=True)
