"""Inputs of the networks: a history of readings for both, the true soil for the value network alone."""

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box

from agents import ppo
from agents.config import PPOConfig
from agents.environment import HIDDEN, SeveralWorlds, hidden_worlds
from agents.evaluate import run_courses
from agents.evaluate.models import load_model
from agents.history import READINGS, SHARE, History, HistoryVecEnv
from agents.sb3 import SoilWheelVecEnv, privileged
from soil_env.parameters import CourseSpec, load_scenario
from soil_env.simulation.task import layout, truth

TINY = {"num_envs": 8, "n_steps": 16, "batch_size": 64, "n_epochs": 2, "layer": 8}
NAMES = [e.name for e in layout("blind")]
BLIND, TRUE = len(NAMES), len(truth(CourseSpec()))


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("mixed", {"course": {"length": 2.0}, "control": {"time_limit": 4.0}})


def driven(env, steps, seed=5):
    """First observations, and a list of step results under random actions."""
    env.seed(seed)
    rng = np.random.default_rng(seed)
    first = env.reset()
    return first, [env.step(rng.uniform(0.0, 1.0, (env.num_envs, 1)).astype(np.float32)) for _ in range(steps)]


# --- history ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("critic", ["", "true_soil"])
def test_the_history_holds_the_readings_of_the_last_steps(scenario, critic):
    """Against a list of all past observations of each course; the last one of a course is of that course still."""
    steps, more = 3, len(privileged(critic, scenario.course))
    env = HistoryVecEnv(SoilWheelVecEnv(4, scenario, "blind", critic=critic), History(NAMES, steps))
    plain = SoilWheelVecEnv(4, scenario, "blind", critic=critic)
    columns = [NAMES.index(name) for name in READINGS]
    first, results = driven(env, 60)
    plain_first, plain_results = driven(plain, 60)
    assert first.shape == (4, BLIND + steps * len(READINGS) + more) == (4, *env.observation_space.shape)

    def expected(now, past):
        padded = [*past[::-1], *[past[0] if past else now] * steps][:steps]
        return np.concatenate([now[:BLIND], *[one[columns] for one in padded], now[BLIND:]])

    past, ends = [[] for _ in range(4)], 0
    for k in range(4):
        np.testing.assert_array_equal(first[k], expected(plain_first[k], []))
        past[k].append(plain_first[k])
    for (seen, _, done, infos), (own, _, own_done, own_infos) in zip(results, plain_results, strict=True):
        np.testing.assert_array_equal(done, own_done)
        for k in range(4):
            if done[k]:
                ends += 1
                last = own_infos[k]["terminal_observation"]
                np.testing.assert_array_equal(infos[k]["terminal_observation"], expected(last, past[k]))
                past[k] = []
            np.testing.assert_array_equal(seen[k], expected(own[k], past[k]))
            past[k].append(own[k])
    assert ends >= 4


@pytest.mark.parametrize("critic", ["", "true_soil"])
def test_a_loaded_agent_drives_as_it_was_trained(scenario, tmp_path, critic):
    """With the history of its own calls, and without the true soil that its value network had."""
    model = ppo.build(scenario, "blind", PPOConfig(**TINY, history=3, critic=critic), 0)
    model.learn(256)
    ppo.save(model, tmp_path / "model.zip")
    agent = load_model(tmp_path / "model.zip", scenario)
    env, plain = model.get_vec_normalize_env(), SoilWheelVecEnv(8, scenario, "blind", scaled=False)
    env.training = False  # the normalisation stays as it was saved
    env.seed(7)
    plain.seed(7)
    seen, raw = env.reset(), plain.reset()
    memory, fresh = None, np.ones(8, dtype=bool)
    for _ in range(50):
        action, _ = model.predict(env.normalize_obs(env.get_original_obs()), deterministic=True)
        own, memory = agent.predict(raw, memory, fresh)
        np.testing.assert_allclose(own, action, atol=1e-5)
        seen = env.step(action)[0]
        raw, _, fresh, _ = plain.step(action)
    assert seen.shape == (8, BLIND + 3 * len(READINGS) + len(privileged(critic, scenario.course)))
    alone, state = agent.predict(raw[0])
    assert alone.shape == (1,) and state[0].shape == (1, 4 * len(READINGS))


def test_a_class_is_remembered_by_what_it_felt_like_while_driving():
    """Against sums over all past steps on a class, weighted by (1 - SHARE)^k; nothing of a course before."""
    names = [*NAMES, *(f"{place}_class_{c}" for place in ("here", "ahead", "beside") for c in (1, 2))]
    history, rng, n, m = History(names, 2), np.random.default_rng(0), 3, len(READINGS)
    seen = rng.normal(size=(40, n, len(names))).astype(np.float32)
    first_class = rng.random((40, n)) < 0.5
    seen[:, :, -6], seen[:, :, -5] = first_class, ~first_class
    seen[:, :, -4:] = 0.0
    seen[-1, :, -3] = seen[-1, :, -2] = 1.0  # ahead the second class, beside the first
    halted = rng.random((40, n)) < 0.2
    seen[:, :, history.halted] = halted
    kept = rng.normal(size=(n, history.kept)).astype(np.float32)  # of courses that have ended
    for step in range(40):
        out, kept = history.observe(seen[step], kept, np.full(n, step == 0))
    assert out.shape == (n, len(names) + history.size) == (n, len(names) + 2 * m + 2 * (m + 1))
    columns = [names.index(name) for name in READINGS]
    for k in range(n):
        for c, there in enumerate((~first_class[:, k], first_class[:, k])):
            rows = np.flatnonzero(there & ~halted[:, k])
            weights = SHARE * (1.0 - SHARE) ** np.arange(len(rows))[::-1]
            found = out[k, len(names) + 2 * m + c * (m + 1) :][: m + 1]
            assert found[m] == pytest.approx(weights.sum(), rel=1e-5)
            expected = (weights[:, None] * seen[rows, k][:, columns]).sum(axis=0) / weights.sum()
            np.testing.assert_allclose(found[:m], expected, rtol=1e-4, atol=1e-5)
    low, high = history.space(Box(-1.0, 1.0, (len(names),))).low, history.space(Box(-1.0, 1.0, (len(names),))).high
    assert low.shape == high.shape == (len(names) + history.size,)


# --- asymmetric critic ------------------------------------------------------------------------------------------------


def test_the_critic_sees_the_lines_ahead_too():
    """Entries as `true_soil` observes them, but for the error of the camera in where the patch begins."""
    scenario = load_scenario("two_lines", {"camera": {"border_noise": 0.0}})
    seeing, plain = SoilWheelVecEnv(8, scenario, "blind", critic="true_soil"), SoilWheelVecEnv(8, scenario, "true_soil")
    names, blind = plain.observation_names, {e.name for e in layout("blind", scenario.course)}
    columns = [k for k, name in enumerate(names) if name not in blind]
    assert seeing.privileged == len(columns) > TRUE
    first, results = driven(seeing, 150)
    expected, others = driven(plain, 150)
    rows = np.concatenate([first, *(result[0] for result in results)])[:, -seeing.privileged :]
    np.testing.assert_array_equal(rows, np.concatenate([expected, *(result[0] for result in others)])[:, columns])
    assert (rows[:, -1] != 0.0).any()  # a second line has been in sight
    ends = [(mine[k], theirs[k]) for (_, _, done, mine), (*_, theirs) in zip(results, others, strict=True)
            for k in np.flatnonzero(done)]  # fmt: skip
    assert len(ends) >= 4
    for mine, theirs in ends:
        last = mine["terminal_observation"][-seeing.privileged :]
        np.testing.assert_array_equal(last, theirs["terminal_observation"][columns])


def test_the_action_does_not_depend_on_what_the_value_network_sees(scenario):
    model = ppo.build(scenario, "blind", PPOConfig(**TINY, history=0, critic="true_soil"), 0)
    model.learn(256)
    rng = np.random.default_rng(0)
    x = rng.normal(size=(20, BLIND + TRUE)).astype(np.float32)
    y = x.copy()
    y[:, BLIND:] = rng.normal(size=(20, TRUE))
    mean, value, log_prob = (t.detach().numpy() for t in model.policy(torch.from_numpy(x), deterministic=True))
    other, other_value, other_prob = (t.detach().numpy() for t in model.policy(torch.from_numpy(y), deterministic=True))
    np.testing.assert_array_equal(mean, other)
    np.testing.assert_array_equal(log_prob, other_prob)
    assert np.abs(value - other_value).min() > 1e-6
    z = x.copy()
    z[:, 0] += 1.0
    assert np.abs(model.policy(torch.from_numpy(z), deterministic=True)[0].detach().numpy() - mean).max() > 1e-6


# --- worlds with hidden effects ---------------------------------------------------------------------------------------


def test_several_worlds_are_the_single_ones_side_by_side(scenario):
    models = [None, *hidden_worlds(scenario, 2, seed=1)]
    both = SeveralWorlds([SoilWheelVecEnv(2, scenario, "blind", model=m) for m in models])
    singles = [SoilWheelVecEnv(2, scenario, "blind", model=m) for m in models]
    both.seed(40)
    for k, env in enumerate(singles):
        env.seed(40 + 2 * k)
    np.testing.assert_array_equal(both.reset(), np.concatenate([env.reset() for env in singles]))
    actions = np.random.default_rng(0).uniform(0.0, 1.0, (50, 6, 1)).astype(np.float32)
    for a in actions:
        seen, rewards, done, infos = both.step(a)
        parts = [env.step(a[2 * k : 2 * k + 2]) for k, env in enumerate(singles)]
        for found, column in ((seen, 0), (rewards, 1), (done, 2)):
            np.testing.assert_array_equal(found, np.concatenate([part[column] for part in parts]))
        assert [info.get("cause") for info in infos] == [info.get("cause") for part in parts for info in part[3]]
    assert both.get_attr("model") == [m for m in models for _ in range(2)]


def test_hidden_worlds_have_one_effect_each_and_follow_from_the_seed(scenario):
    worlds = hidden_worlds(scenario, 2 * len(HIDDEN), seed=3)
    assert [next(iter(w.effects)) for w in worlds] == [*HIDDEN, *HIDDEN]
    assert [w.content() for w in worlds] == [w.content() for w in hidden_worlds(scenario, 2 * len(HIDDEN), seed=3)]
    assert [w.content() for w in worlds] != [w.content() for w in hidden_worlds(scenario, 2 * len(HIDDEN), seed=4)]
    half = run_courses(_Half(), scenario, 3, 6)
    changed = [name for name, world in zip(HIDDEN, worlds, strict=False)
               if (run_courses(_Half(), scenario, 3, 6, model=world).returns != half.returns).any()]  # fmt: skip
    assert changed == list(HIDDEN)  # each acts on a course driven once


class _Half:
    variant = "blind"

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((len(observation), 1), 0.5), None
