"""Inputs of the networks: a history of readings, and the two routes that are compared; worlds of a
training.
"""

import math

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box

from soil_env.parameters import load_scenario
from soil_env.simulation.task import layout
from soil_env_agents import inputs, ppo
from soil_env_agents.controllers import make_controller
from soil_env_agents.environment import HIDDEN, HistoryVecEnv, SeveralWorlds, hidden_worlds
from soil_env_agents.evaluate.driving import run_courses
from soil_env_agents.evaluate.models import load_model
from soil_env_agents.history import READINGS, SHARE, History
from soil_env_agents.sb3 import SoilWheelVecEnv
from tests.agents.drivers import Half
from tests.agents.learnt import learnt
from tests.refusals import refused

SHORT = {"course": {"length": 2.0}, "control": {"time_limit": 4.0}}
NAMES = [e.name for e in layout("blind")]
BLIND = len(NAMES)


@pytest.fixture(scope="module")
def scenario():
    """`mixed` with courses of 2 m and at most 4 s."""
    return load_scenario("mixed", SHORT)


def driven(env, steps, seed=5):
    """First observations, and a list of step results under random actions."""
    env.seed(seed)
    rng = np.random.default_rng(seed)
    first = env.reset()
    return first, [
        env.step(rng.uniform(0.0, 1.0, (env.num_envs, 1)).astype(np.float32)) for _ in range(steps)
    ]


def test_the_history_holds_the_readings_of_the_last_steps(scenario):
    """Against a list of all past observations of each course; the last one of a course is of that
    course still.
    """
    steps = 3
    env = HistoryVecEnv(SoilWheelVecEnv(4, scenario, "blind"), History(NAMES, steps))
    plain = SoilWheelVecEnv(4, scenario, "blind")
    columns = [NAMES.index(name) for name in READINGS]
    first, results = driven(env, 60)
    plain_first, plain_results = driven(plain, 60)
    assert first.shape == (4, BLIND + steps * len(READINGS)) == (4, *env.observation_space.shape)

    def check(found, now, past):
        """Compare an observation with history to the plain one `now` and the `past` ones, oldest
        first; before the course began the first stands for all.
        """
        padded = [*past[::-1], *[past[0] if past else now] * steps][:steps]
        expected = np.concatenate([now, *[one[columns] for one in padded]])
        np.testing.assert_array_equal(found, expected)

    for k in range(4):
        past = []
        before = plain_first[k]
        check(first[k], before, past)
        both = zip(results, plain_results, strict=True)
        for (seen, _, done, infos), (own, _, _, own_infos) in both:
            past.append(before)
            if done[k]:
                found, last = (i[k]["terminal_observation"] for i in (infos, own_infos))
                check(found, last, past)
                past = []
            before = own[k]
            check(seen[k], before, past)
    assert sum(done.sum() for _, _, done, _ in results) >= 4


@pytest.mark.parametrize(
    "name, variant, steps",
    [
        ("mixed", "identified", 0),
        ("mixed", "true_soil", 0),
        ("mixed", "blind", 3),
        ("two_lines", "identified", 3),
    ],
)
def test_a_loaded_agent_drives_as_it_was_trained(tmp_path, name, variant, steps):
    """On raw observations, with the history of its own calls."""
    scenario = load_scenario(name, SHORT)
    model = learnt(scenario, variant, history=steps)
    ppo.save(model, tmp_path / "model.zip")
    agent = load_model(tmp_path / "model.zip", scenario)
    assert (agent.variant, agent.timesteps) == (variant, model.num_timesteps)
    env = model.get_vec_normalize_env()
    plain = SoilWheelVecEnv(8, scenario, variant, scaled=False)
    env.training = False  # the normalisation stays as it was saved
    env.seed(7)
    plain.seed(7)
    seen = env.reset()
    raw = plain.reset()
    memory = None
    fresh = np.ones(8, dtype=bool)
    for _ in range(50):
        action, _ = model.predict(seen, deterministic=True)
        own, memory = agent.predict(raw, memory, fresh)
        np.testing.assert_allclose(own, action, atol=1e-5)
        seen = env.step(action)[0]
        raw, _, fresh, _ = plain.step(action)
    assert raw.shape[1] + steps * len(READINGS) <= len(agent.mean)
    assert agent.predict(raw[0])[0].shape == (1,)


def test_what_are_no_numbers_is_refused(scenario):
    agent = make_controller("soft_start", scenario)
    huge = [10**400] * len(agent.layout.entries)
    refused(lambda: agent.predict(huge), "expected numbers")
    refused(lambda: inputs.memory(huge, (1,)), "expected what the last predict")
    refused(lambda: inputs.starts([[True], [True, False]], 2, False), "expected True or False")


def test_a_class_is_remembered_by_what_it_felt_like_while_driving():
    """Against sums over all past steps on a class, weighted by (1 - SHARE)^k; nothing of a course
    before.
    """
    places = ("here", "ahead", "beside")
    names = NAMES + [f"{place}_class_{c}" for place in places for c in (1, 2)]
    history = History(names, 2)
    rng = np.random.default_rng(0)
    n = 3
    m = len(READINGS)
    seen = rng.normal(size=(40, n, len(names))).astype(np.float32)
    first_class, halted = rng.random((2, 40, n)) < [[[0.5]], [[0.2]]]
    # By route: where the wheel is on the class that is seen ahead at the end, and beside.
    here = [~first_class, first_class]
    seen[..., -6] = first_class
    seen[..., -5] = ~first_class
    seen[..., -4:] = 0.0
    seen[-1, :, -4:] = [0.0, 1.0, 1.0, 0.0]  # ahead the second class, beside the first
    seen[..., history.halted] = halted
    kept = rng.normal(size=(n, history.kept)).astype(np.float32)  # of courses that have ended
    for step in range(40):
        out, kept = history.observe(seen[step], kept, np.full(n, step == 0))
    assert out.shape == (n, len(names) + history.size)
    columns = [names.index(name) for name in READINGS]
    for k in range(n):
        felt = out[k, len(names) + 2 * m :].reshape(2, m + 1)
        for found, there in zip(felt, here, strict=True):
            rows = np.flatnonzero((there & ~halted)[:, k])
            weights = SHARE * (1.0 - SHARE) ** np.arange(len(rows))[::-1]
            expected = np.average(seen[rows, k][:, columns], axis=0, weights=weights)
            assert found[m] == pytest.approx(weights.sum(), rel=1e-5)
            np.testing.assert_allclose(found[:m], expected, rtol=1e-4, atol=1e-5)
    space = history.space(Box(-1.0, 1.0, (len(names),)))
    assert space.low.shape == space.high.shape == (len(names) + history.size,)


def test_exchanged_lines_give_the_opposite_choice():
    """Where a route is chosen, entries of no route do not count; elsewhere they do."""
    model = learnt(load_scenario("two_lines"), history=2)
    env = model.get_vec_normalize_env()
    names = env.get_attr("observation_names")[0]
    extractor = model.policy.mlp_extractor
    choice = names.index("choice")
    ahead, beside = extractor.routes
    assert [names[k].partition("_")[2] for k in ahead[:14]] == [
        names[k].partition("_")[2] for k in beside[:14]
    ]
    x = torch.randn((20, *env.observation_space.shape), generator=torch.Generator().manual_seed(0))
    x[:, choice] = 1.0
    other = x.clone()
    exchanged = x.clone()
    other[:, [k for k in range(x.shape[1]) if k not in (*ahead, *beside, choice)]] += 1.0
    exchanged[:, ahead] = x[:, beside]
    exchanged[:, beside] = x[:, ahead]
    action = lambda seen: model.policy.get_distribution(seen).distribution.mean  # noqa: E731
    found = action(x)
    assert torch.equal(action(other), found) and found.abs().max() > 0.0
    assert torch.equal(action(exchanged), -found)
    for one in (x, other):
        one[:, choice] = -1.0
    assert (action(other) != action(x)).any()
    for values in (env.obs_rms.mean, env.obs_rms.var):
        np.testing.assert_array_equal(values[ahead], values[beside])
        assert len(np.unique(values)) > 5


def test_several_worlds_are_the_single_ones_side_by_side(scenario):
    models = [None, *hidden_worlds(scenario, 2, seed=1)]
    both = SeveralWorlds([SoilWheelVecEnv(2, scenario, "blind", model=m) for m in models])
    singles = [SoilWheelVecEnv(2, scenario, "blind", model=m) for m in models]
    both.seed(40)
    for k, env in enumerate(singles):
        env.seed(40 + 2 * k)
    np.testing.assert_array_equal(both.reset(), np.concatenate([env.reset() for env in singles]))
    actions = np.random.default_rng(0).uniform(0.0, 1.0, (50, 3, 2, 1)).astype(np.float32)
    for a in actions:
        *found, infos = both.step(a.reshape(6, 1))
        *expected, of_parts = zip(*map(SoilWheelVecEnv.step, singles, a), strict=True)
        for all_wheels, parts in zip(found, expected, strict=True):
            np.testing.assert_array_equal(all_wheels, np.concatenate(parts))
        causes = [info.get("cause") for infos in of_parts for info in infos]
        assert [info.get("cause") for info in infos] == causes
    assert both.get_attr("model") == [m for m in models for _ in range(2)]


def test_hidden_sizes_are_within_the_priors_of_the_wheel(scenario):
    worlds = hidden_worlds(scenario, 60, seed=3, names=["shear_softening"])
    radius = scenario.wheel.radius
    forms = set()
    for world in worlds:
        (values,) = world.effects.values()
        forms.add(tuple(values))
        assert values.get("sharpness", 1.0) >= 1.0  # below 1 the law is off
    assert len(forms) == 3
    onsets = [v["onset"] for w in worlds for v in w.effects.values() if "onset" in v]
    lengths = [v["length"] for w in worlds for v in w.effects.values() if "length" in v]
    assert max(lengths) <= 0.3 * radius * math.exp(0.7)  # about a centre that goes with the radius
    assert 0.0 < min(onsets) and 0.1 * radius < max(onsets) <= 0.15 * radius


def test_hidden_worlds_have_one_effect_each_and_follow_from_the_seed(scenario):
    worlds = hidden_worlds(scenario, 2 * len(HIDDEN), seed=3)
    assert [next(iter(w.effects)) for w in worlds] == [*HIDDEN, *HIDDEN]
    again, other = (hidden_worlds(scenario, 2 * len(HIDDEN), seed=seed) for seed in (3, 4))
    assert worlds == again and worlds != other
    half = run_courses(Half(), scenario, 3, 6)
    for name, world in zip(HIDDEN, worlds, strict=False):  # each acts on a course driven once
        there = run_courses(Half(), scenario, 3, 6, model=world)
        assert (there.returns != half.returns).any(), name
