"""Wrappers of the single environment."""

import gymnasium
import numpy as np
import pytest

from soil_env import ParameterError
from soil_env.wrappers import LineOnWay


def test_the_line_that_was_chosen_is_ahead_until_the_wheel_is_on_it():
    """The line beside is chosen at every fork; the plain observation goes on as before."""
    plain = gymnasium.make("soil_env:SoilWheel-v0", info="none")
    env, names = LineOnWay(plain), list(plain.unwrapped.observation_names)
    choice, border = names.index("choice"), names.index("border_distance")
    ahead, beside = ([k for k, n in enumerate(names) if n.startswith(line)] for line in ("ahead_", "beside_"))
    exchanged, forks = 0, 0
    for seed in range(8):
        seen, _ = env.reset(seed=seed)
        over, chosen = False, False
        while not over:
            before, choosing = seen, seen[choice] > 0.5
            seen, _, over, _, _ = env.step([-0.5 if choosing else 0.3])
            raw = plain.unwrapped.scaling(plain.unwrapped.simulation.worlds.observation[0])
            chosen = choosing or (chosen and seen[border] < before[border] + 1.0)  # else a next patch is in sight
            forks += choosing and not raw[choice] > 0.5
            if chosen and not raw[choice] > 0.5 and raw[beside].any():
                np.testing.assert_array_equal(seen[ahead], raw[beside])
                np.testing.assert_array_equal(seen[beside], raw[ahead])
                exchanged += 1
            elif not chosen:
                np.testing.assert_array_equal(seen, raw)
    assert forks >= 5 and exchanged > 2 * forks


def test_an_environment_without_two_lines_is_refused():
    with pytest.raises(ParameterError, match="expected SoilWheel-v0 with two lines"):
        LineOnWay(gymnasium.make("soil_env:SoilWheel-v0", scenario="mixed"))
