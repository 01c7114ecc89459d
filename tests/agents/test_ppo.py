"""PPO agents: a loaded agent acts as the saved one, training goes on after a stop, bad files are
refused.
"""

import json
import tempfile
import zipfile
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3
from stable_baselines3.common.callbacks import ConvertCallback

from soil_env.parameters import load_rover, load_scenario
from soil_env.simulation.task import layout
from soil_env_agents.agent import INFO, load_agent, read_info
from soil_env_agents.evaluate.models import load_model
from soil_env_agents.ppo import Schedules, build, resume, save
from soil_env_agents.sb3 import SoilWheelVecEnv
from tests.agents.drivers import observations
from tests.agents.learnt import ROLLOUT, TINY, learnt
from tests.refusals import refused


@pytest.fixture(scope="module")
def scenario():
    """`mixed` with courses of at most 3 s."""
    return load_scenario("mixed", {"control": {"time_limit": 3.0}})


@pytest.fixture(scope="module")
def model(scenario):
    """An agent after three rollouts of training."""
    return learnt(scenario, steps=3 * ROLLOUT)


@pytest.fixture()
def saved(model, tmp_path):
    """Path of the zip of this agent."""
    save(model, tmp_path / "model.zip")
    return tmp_path / "model.zip"


def test_the_zip_is_one_of_sb3_too(saved, model, scenario):
    raw = observations(scenario, "identified").astype(np.float32)
    plain = PPO.load(saved, device="cpu")
    np.testing.assert_array_equal(
        plain.predict(raw, deterministic=True)[0], model.predict(raw, deterministic=True)[0]
    )


def test_resume_goes_on_with_weights_optimizer_normalisation_and_learning_rate(
    saved, model, scenario
):
    again = resume(saved, scenario, "identified", TINY, 0, None)
    assert again.num_timesteps == 3 * ROLLOUT
    for moments in ("obs_rms", "ret_rms"):
        mine, theirs = (getattr(m.get_vec_normalize_env(), moments) for m in (again, model))
        for name in ("mean", "var", "count"):
            np.testing.assert_allclose(getattr(mine, name), getattr(theirs, name))
    mine, theirs = (
        (m.policy.state_dict(), m.policy.optimizer.state_dict()["state"]) for m in (again, model)
    )
    assert mine[1]
    torch.testing.assert_close(mine, theirs, rtol=0.0, atol=0.0)
    rates = []
    update = again.train

    def train():
        """Update as before, and note the learning rate of it."""
        update()
        rates.append(again.policy.optimizer.param_groups[0]["lr"])

    again.train = train
    again.learn(3 * ROLLOUT, reset_num_timesteps=False)
    assert again.num_timesteps == 6 * ROLLOUT
    assert rates == pytest.approx([TINY.learning_rate * share for share in (2 / 6, 1 / 6, 0.05)])


@pytest.mark.parametrize("final, falls", [(-3.0, 2.0), (None, 0.0)])
def test_the_exploration_narrows_over_a_training_or_is_learned(scenario, final, falls):
    """`final`: logarithm of its standard deviation at the end, None where it is learned; `falls`:
    by how much it falls over the training.
    """
    config = replace(TINY, log_std_init=-1.0, log_std_final=final)
    seen = []
    model = build(scenario, "identified", config, 0)
    model.num_timesteps = ROLLOUT  # as after a student
    watch = ConvertCallback(lambda *_: seen.append(model.policy.log_std.item()) or True)
    model.learn(3 * ROLLOUT, callback=[Schedules(config), watch], reset_num_timesteps=False)
    expected = [-1.0 - falls * k / 4 for k in (1, 2, 3)]
    assert seen[:: TINY.n_steps] == pytest.approx(expected, abs=0.0 if falls else 0.1)
    assert len(set(seen)) == 3 and model.policy.log_std.requires_grad == (final is None)


def test_a_training_leaves_nothing_in_the_folder_of_temporary_files(
    scenario, tmp_path, monkeypatch
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    build(scenario, "identified", TINY, 0).learn(ROLLOUT)
    assert not list(tmp_path.iterdir())


def test_resume_starts_new_courses_with_new_noise(saved, scenario):
    """Repeating the start of the run would be learnt by heart; the same checkpoint still gives the
    same courses.
    """

    def first(model):
        """(first observations [wheels, D] in units, exploration noise of an action for zeros) of a
        model: a training of 0 steps resets its environment.
        """
        model.learn(0, reset_num_timesteps=False)
        seen = model.get_vec_normalize_env().get_original_obs()
        x = np.zeros_like(seen)
        return seen, model.predict(x)[0] - model.predict(x, deterministic=True)[0]

    of = (scenario, "identified", TINY, 0)
    seen, noise = first(build(*of))
    (later, other), repeat = (first(resume(saved, *of, None)) for _ in range(2))
    np.testing.assert_array_equal(later, repeat[0])
    np.testing.assert_array_equal(other, repeat[1])
    assert np.abs(seen[:, None] - later).max(axis=2).min() > 1e-3
    assert np.abs(noise - other).max() > 1e-3


def test_resume_refuses_another_network_or_observation(saved, scenario):
    other = load_scenario("two_lines")
    for task, variant, changes, said in (
        (scenario, "blind", {}, "observation 'identified', not 'blind'"),
        (scenario, "identified", {"layer": 16}, "layer 8, not"),
        (scenario, "identified", {"history": 2}, "history 0, not"),
        (scenario, "identified", {"activation": "tanh"}, "activation 'relu', not"),
        (other, "identified", {}, "another observation layout"),
    ):
        config = replace(TINY, **changes)
        refused(partial(resume, saved, task, variant, config, 0, None), said)


def edit(path, **changes):
    """Change keys of the description (`INFO`) in the zip of an agent at `path`."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members[INFO] = json.dumps(json.loads(members[INFO]) | changes)
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)


def test_another_layout_is_refused_and_the_difference_named(saved):
    names = [e.name for e in layout("identified")]
    for found, said in ((names[:-1] + ["wheel_torque"], "wheel_torque"), (names[::-1], "order")):
        edit(saved, observation_names=found)
        refused(lambda: load_agent(saved), "another observation layout", said)
    # before anything else of it is read, as keys of its scenario may be gone
    edit(saved, observation_version=1, scenario={"course": {"margin": [0.0, 0.1]}})
    refused(lambda: load_agent(saved), "observations of version 1", "expected version 2")


@pytest.mark.parametrize(
    "key, value, said",
    [
        ("mean", [0.0] * 5, "mean"),
        ("var", [-1.0] * 22, "var"),
        ("clip", "ten", "clip"),
        ("observation", "identifed", "observation"),
        ("timesteps", 1.5, "timesteps"),
        ("scenario", {"course": {"lenght": 3}}, "lenght"),
        ("ppo", {"layers": 3}, "layers"),
        ("new", 3, "new"),
    ],
)
def test_a_description_with_a_wrong_entry(saved, key, value, said):
    edit(saved, **{key: value})
    refused(lambda: read_info(saved), "model.zip", INFO, said)


def test_an_agent_of_a_rover_does_not_drive_a_wheel(tmp_path, scenario):
    path = tmp_path / "model.zip"
    save(build(load_rover("mars_rover"), "blind", TINY, 0), path)
    refused(
        lambda: load_model(path, scenario), "an agent of a rover, for scenario 'mixed' of a wheel"
    )


@pytest.mark.parametrize("steps", [0, 3])
def test_an_argument_that_predict_cannot_take_is_named(tmp_path, scenario, steps):
    """Without a history and with one."""
    save(build(scenario, "blind", replace(TINY, history=steps), 0), tmp_path / "model.zip")
    agent = load_model(tmp_path / "model.zip", scenario)
    rows = np.tile(observations(scenario, "blind", 1), (3, 1))
    _, state = agent.predict(rows, None, np.ones(3, dtype=bool))
    assert agent.predict(rows, state, [False] * 3)[0].shape == (3, 1)
    nan = rows.copy()
    beyond = rows.copy()
    nan[1, 3] = np.nan
    beyond[2, 10] = 1.5
    wrong = [
        (nan, None, None, "observation[1]: load = nan: expected -10 to 10 (of weight)"),
        (beyond, None, None, "observation[2]: halted = 1.5: expected 0 to 1"),
        ("xyz", None, None, "observation = 'xyz': expected numbers"),
        (np.zeros((3, 24)), None, None, "expected 14 numbers, those of observation 'blind'"),
        (rows, None, [True], "episode_start: 1 values: expected 3"),
    ]
    if steps:
        wrong += [
            (rows[:2], state, None, "state: an array of shape"),
            (rows, "x", None, "state = 'x': expected"),
            (rows, np.full_like(state, np.nan), None, "state: a number that is not finite"),
        ]
    for *given, said in wrong:
        refused(partial(agent.predict, *given), said)


def small(algorithm, env):
    """An untrained model."""
    return algorithm("MlpPolicy", env, policy_kwargs={"net_arch": [4]}, seed=1, device="cpu")


@pytest.mark.parametrize("scaled", [True, False])
@pytest.mark.parametrize("variant", ["blind", "true_soil"])
@pytest.mark.parametrize("algorithm", [PPO, A2C, SAC, TD3, DDPG])
def test_a_plain_model_acts_as_before(tmp_path, scenario, algorithm, variant, scaled):
    env = SoilWheelVecEnv(2, scenario, variant, scaled=scaled)
    model = small(algorithm, env)
    model.save(tmp_path / "any.zip")
    loaded = load_model(tmp_path / "any.zip", scenario)
    x = observations(scenario, variant)
    assert loaded.variant == variant
    np.testing.assert_array_equal(
        loaded.predict(x)[0], model.predict(env.scaling(x), deterministic=True)[0]
    )


def test_a_model_of_another_task_is_refused(tmp_path, scenario):
    small(A2C, "Pendulum-v1").save(tmp_path / "p.zip")
    refused(
        lambda: load_model(tmp_path / "p.zip", scenario), "another observation layout: shape (3,)"
    )


@pytest.mark.parametrize("place", ["vecnormalize.pkl", "p/vecnormalize.pkl"])
def test_a_model_of_normalised_observations_is_refused(tmp_path, scenario, place):
    """It is known by the file of their moments, which lies beside it or where rl-baselines3-zoo
    writes it.
    """
    small(A2C, SoilWheelVecEnv(2, scenario, "blind")).learn(100).save(tmp_path / "p.zip")
    (tmp_path / place).parent.mkdir(exist_ok=True)
    (tmp_path / place).touch()
    refused(
        lambda: load_model(tmp_path / "p.zip", scenario),
        "trained with VecNormalize: evaluate a module:Class",
    )
