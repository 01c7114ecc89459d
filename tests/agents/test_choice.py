"""Choice of a route: what is kept of the routes taken, and that the better route is learned."""

import copy

import numpy as np
import pytest
import torch
from gymnasium import spaces

from soil_env.parameters import load_scenario
from soil_env_agents import choice, ppo
from soil_env_agents.sb3 import NativeVecEnv
from tests.agents.learnt import WITH_ROUTES


class _Forks(NativeVecEnv):
    """Two wheels that choose in every third step: entry 0 is `choice`, 1 and 2 are of the routes
    ahead and beside.
    """

    def __init__(self):
        box = spaces.Box(-10.0, 10.0, (3,), np.float32)
        super().__init__(2, box, spaces.Box(-1.0, 1.0, (1,), np.float32))
        self.step_count = 0

    def reset(self):
        """Observations [2, 3] of this step: step + 0.1 and + 0.2 are the routes of wheel 0, step
        + 0.3 and + 0.4 those of wheel 1.
        """
        k = self.step_count
        choosing = float(k % 3 == 0)
        rows = [[choosing, k + 0.1, k + 0.2], [choosing, k + 0.3, k + 0.4]]
        return np.array(rows, dtype=np.float32)

    def step_async(self, actions):
        self.step_count += 1

    def step_wait(self):
        """Wheel 0 finishes its course with step 4, wheel 1 is bogged with step 8."""
        finished = self.step_count == 4
        bogged = self.step_count == 8
        infos = [{"cause": "FINISHED"}, {"cause": "BOGGED"}]
        return self.reset(), np.zeros(2), np.array([finished, bogged]), infos


def test_lines_taken_are_kept_with_what_became_of_them():
    """A route is passed at the next choice or the end of the course, and not where the wheel is
    immobilised before.
    """
    env = choice.ChoiceVecEnv(_Forks(), 0, [[1], [2]])
    env.reset()
    first = [0.5, 0.3, -0.3, -0.1, 0.0, 0.0, 0.2, 0.0]
    second = [-0.5, 0.3, 0.3, 0.1, 0.0, 0.0, -0.2, 0.0]
    for action in np.array([first, second], dtype=np.float32).T:
        env.step(action[:, None])
    # Steps 0, 3 and 6 choose; wheel 0 finishes in step 4, wheel 1 is bogged in step 8; the last of
    # wheel 0 is open.
    kept = [(0.1, 1.0), (0.4, 1.0), (3.2, 1.0), (3.3, 1.0), (6.4, 0.0)]
    found = np.stack([env.taken[: env.count, 0], env.passed[: env.count]], axis=1)
    assert found == pytest.approx(np.array(kept))


def test_the_line_that_is_passed_more_often_gets_the_higher_score(monkeypatch):
    """The odds that a route is passed rise with its third entry alone: the model comes to choose by
    it. Only the network of the choice is changed.
    """
    monkeypatch.setattr(choice, "PASSES", 60)
    model = ppo.build(load_scenario("two_lines"), "identified", WITH_ROUTES, 0)
    chooser = choice.Chooser(model, np.random.default_rng(0))
    rng = np.random.default_rng(1)
    env = chooser.env
    env.reset()
    rows = rng.normal(size=(4000, len(env.routes[0]))).astype(np.float32)
    env.taken[:4000] = rows
    env.count = 4000
    env.passed[:4000] = rng.random(4000) < 1.0 / (1.0 + np.exp(-3.0 * rows[:, 2]))
    before = copy.deepcopy(model.policy.state_dict())
    chooser.learned = env.count - 20
    chooser.learn(1.0)  # too few that are new: they wait for the next call
    assert chooser.learned == env.count - 20
    chooser.learned = 0
    chooser.learn(1.0)
    moved = {name for name, x in model.policy.state_dict().items() if not x.equal(before[name])}
    assert moved and all("line_net" in name for name in moved)
    seen = rng.normal(size=(500, *env.observation_space.shape)).astype(np.float32)
    seen[:, env.choice] = 1.0
    action = model.predict(seen)[0][:, 0]
    better = np.subtract(*(seen[:, columns[2]] for columns in env.routes))  # ahead over beside
    apart = np.abs(better) > 0.5
    assert np.mean((action * better > 0.0)[apart]) > 0.9
    policy = model.policy
    policy.zero_grad()
    policy.evaluate_actions(torch.from_numpy(seen), torch.zeros(500, 1))[1].sum().backward()
    # PPO leaves the choice.
    assert policy.log_std.grad is not None
    assert all(x.grad is None for x in policy.mlp_extractor.line_net.parameters())


def test_where_nothing_is_chosen_nothing_is_learned():
    model = ppo.build(load_scenario("mixed"), "identified", WITH_ROUTES, 0)
    chooser = choice.Chooser(model, np.random.default_rng(0))
    chooser.learn(1.0)
    assert chooser.env is None and chooser.choosing.shape == (16, 1) and not chooser.choosing.any()
