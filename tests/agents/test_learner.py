"""The shorter update learns what SB3's own learns; wall times are kept."""

import copy

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

from agents.learner import Learner, Tanh
from agents.ppo import PPOConfig, build
from agents.timing import PARTS, Times
from soil_env.parameters import load_scenario

CONFIG = {"num_envs": 16, "n_steps": 16, "layer": 8, "learning_rate": 1e-2, "clip_range": 0.02}


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("mixed", {"control": {"time_limit": 3.0}})


class Logged:
    """Keeps what an update records."""

    def __init__(self):
        self.values = {}

    def record(self, key, value, exclude=None):
        self.values[key] = value


def parameters(model):
    return torch.cat([p.detach().flatten() for p in model.policy.parameters()]).numpy()


def updated(model, update):
    """(parameters before and after, what was logged) of one update of a copy of `model` by `update`."""
    buffer, policy = copy.deepcopy(model.rollout_buffer), copy.deepcopy(model.policy)
    policy.optimizer = type(model.policy.optimizer)(policy.parameters(), lr=1e-2, eps=1e-5)
    kept = model.rollout_buffer, model.policy, model._logger
    model.rollout_buffer, model.policy, model._logger = buffer, policy, Logged()
    model._current_progress_remaining = 1.0  # the full learning rate
    try:
        before = parameters(model)
        update(model)
        return before, parameters(model), model.logger.values
    finally:
        model.rollout_buffer, model.policy, model._logger = kept


@pytest.mark.parametrize("activation", ["relu", "tanh"])
def test_the_update_is_that_of_sb3(scenario, activation):
    """Three passes over whole rollouts, where the order of the rows does not matter; SB3's PPO is the judge."""
    config = PPOConfig(**CONFIG, batch_size=256, n_epochs=3, ent_coef=0.01, activation=activation)
    model = build(scenario, "identified", config, seed=3)
    model.learn(512)
    before, ours, log = updated(model, Learner.train)
    _, theirs, expected = updated(model, PPO.train)
    assert np.abs(ours - before).max() > 0.01
    np.testing.assert_allclose(ours, theirs, atol=2e-5)
    assert 0.02 < expected["train/clip_fraction"] < 0.98  # so the clipping has been tried
    for name in ("value_loss", "policy_gradient_loss", "entropy_loss", "clip_fraction", "std", "explained_variance"):
        assert log[f"train/{name}"] == pytest.approx(expected[f"train/{name}"], abs=1e-4), name
    assert log["train/n_updates"] + 3 == expected["train/n_updates"]


def test_every_row_is_used_once_a_pass(scenario, monkeypatch):
    config = PPOConfig(**CONFIG, batch_size=32, n_epochs=2, threads=1)
    model = build(scenario, "identified", config, seed=0)
    model.learn(256)
    model.rollout_buffer.log_probs[:] = np.arange(256).reshape(16, 16)  # a number for every row
    seen = []
    gradients = Learner._gradients

    def watched(self, parameters, share, rows, clip):
        seen.append(share[2].numpy())
        return gradients(self, parameters, (*share[:2], torch.zeros(len(share[2])), *share[3:]), rows, clip)

    monkeypatch.setattr(Learner, "_gradients", watched)
    model.train()
    passes = np.concatenate(seen).reshape(2, 256)
    np.testing.assert_array_equal(np.sort(passes), np.tile(np.arange(256.0), (2, 1)))
    assert (passes[0] != passes[1]).any() and (passes[0] != np.arange(256.0)).any()


def test_threads_do_not_change_the_result(scenario):
    found = []
    for threads in (1, 2):
        config = PPOConfig(**CONFIG, batch_size=64, n_epochs=2, threads=threads)
        model = build(scenario, "identified", config, seed=1)
        model.learn(3 * 256)
        assert model.update_threads == threads
        found.append(parameters(model))
    np.testing.assert_array_equal(*found)


def test_an_odd_rollout_and_a_batch_of_its_size(scenario):
    """Halves of 14 and 13 rows."""
    config = PPOConfig(num_envs=3, n_steps=9, batch_size=27, n_epochs=2, layer=8)
    model = build(scenario, "blind", config, seed=0)
    model.learn(27)
    _, ours, _ = updated(model, Learner.train)
    _, theirs, _ = updated(model, PPO.train)
    np.testing.assert_allclose(ours, theirs, atol=2e-5)


def test_tanh_is_tanh():
    x = torch.cat([torch.linspace(-12.0, 12.0, 4001), torch.tensor([-1e3, -1e-6, 0.0, 1e-6, 1e3])]).requires_grad_()
    y = Tanh()(x)
    y.sum().backward()
    exact = np.tanh(x.detach().numpy().astype(np.float64))
    np.testing.assert_allclose(y.detach().numpy(), exact, atol=2e-7)
    np.testing.assert_allclose(x.grad.numpy(), 1.0 - exact**2, atol=5e-7)


# --- wall time --------------------------------------------------------------------------------------------------------


def test_times_are_kept_and_gone_on_with(tmp_path):
    times = Times(tmp_path)
    assert times.seconds == dict.fromkeys(PARTS, 0.0)
    times.seconds["env"] = 1.5
    with times.part("tuning"):
        pass
    times.save()
    again = Times(tmp_path)
    assert again.seconds["env"] == 1.5 and again.seconds["update"] == 0.0
    again.seconds["tuning"] = 9.0
    with again.part("tuning"):
        pass
    assert again.seconds["tuning"] < 9.0  # measured anew, not added
