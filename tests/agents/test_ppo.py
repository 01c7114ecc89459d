"""PPO agents: a loaded agent acts as the saved one, training goes on after a stop, bad files are refused."""

import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from stable_baselines3 import PPO

from agents.agent import INFO, load_agent, read_info
from agents.config import NAMES, PPOConfig
from agents.evaluate import run_courses
from agents.evaluate.models import load_model
from agents.ppo import build, resume, save
from soil_env._io.loading import ParameterError
from soil_env.parameters import load_scenario
from soil_env.simulation.task import VARIANTS, layout
from soil_env.vehicle import load_rover
from tests.agents.drivers import observations

TINY = PPOConfig(num_envs=8, n_steps=16, batch_size=32, n_epochs=2, layer=8, learning_rate=1e-3, history=0)
ROLLOUT = TINY.num_envs * TINY.n_steps


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("mixed", {"control": {"time_limit": 3.0}})


def trained(scenario, variant="identified", rollouts=3, seed=0, **more):
    model = build(scenario, variant, TINY, seed, **more)
    model.learn(rollouts * ROLLOUT)
    return model


@pytest.fixture(scope="module")
def model(scenario):
    return trained(scenario)


@pytest.fixture()
def saved(model, tmp_path):
    save(model, tmp_path / "model.zip")
    return tmp_path / "model.zip"


def refused(action, *parts):
    """Check that `action` raises a ParameterError of one line that holds all `parts`."""
    with pytest.raises(ParameterError) as error:
        action()
    message = str(error.value)
    assert "\n" not in message and len(message) < 600, message
    for part in parts:
        assert str(part) in message, f"{part!r} not in {message!r}"


# --- building ---------------------------------------------------------------------------------------------------------


def test_build_takes_the_config(scenario):
    own = {"n_steps": 24, "batch_size": 12, "n_epochs": 3, "gamma": 0.9, "gae_lambda": 0.8, "ent_coef": 0.01}
    config = PPOConfig(num_envs=4, learning_rate=2e-3, clip_range=0.13, layer=5, log_std_init=-1.1, **own)
    model = build(scenario, "blind", config, seed=5)
    assert {name: getattr(model, name) for name in own} == own
    assert (model.n_envs, model.seed, model.clip_range(0.5), model.get_env().gamma) == (4, 5, 0.13, 0.9)
    assert model.policy.log_std.detach().numpy() == pytest.approx(-1.1)
    assert {p.shape[0] for name, p in model.policy.named_parameters() if "mlp_extractor" in name} == {5}


def test_training_is_reproducible(scenario):
    a, b, other = (trained(scenario, "blind", rollouts=2, seed=s) for s in (3, 3, 4))
    x = observations(scenario, "blind")
    np.testing.assert_array_equal(a.predict(x, deterministic=True)[0], b.predict(x, deterministic=True)[0])
    assert (a.predict(x, deterministic=True)[0] != other.predict(x, deterministic=True)[0]).any()


# --- save and load ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_loaded_agent_acts_on_raw_observations_as_the_trained_model(scenario, variant, tmp_path):
    model = trained(scenario, variant)
    save(model, tmp_path / "model.zip")
    agent = load_agent(tmp_path)
    raw = observations(scenario, variant)
    env = model.get_vec_normalize_env()
    expected, _ = model.predict(env.normalize_obs(agent.scaling(raw)), deterministic=True)
    actions, _ = agent.predict(raw, deterministic=True)
    np.testing.assert_allclose(actions, expected, atol=1e-6)
    assert (actions != model.predict(raw, deterministic=True)[0]).any()  # the normalisation matters
    np.testing.assert_allclose(agent.predict(raw[3])[0], expected[3], atol=1e-6)
    assert agent.variant == variant and agent.name == NAMES[variant]
    assert agent.timesteps == model.num_timesteps == 3 * ROLLOUT


def test_the_zip_is_one_of_sb3_too(saved, model, scenario):
    raw = observations(scenario, "identified").astype(np.float32)
    plain = PPO.load(saved, device="cpu")
    np.testing.assert_array_equal(plain.predict(raw, deterministic=True)[0], model.predict(raw, deterministic=True)[0])


def test_an_agent_with_a_memory_is_saved_loaded_driven_and_resumed(tmp_path, scenario):
    pytest.importorskip("sb3_contrib")
    config, path = replace(TINY, history=2), tmp_path / "model.zip"
    model = build(scenario, "blind", config, 0, algorithm="recurrent_ppo")
    model.learn(ROLLOUT)
    save(model, path)
    agent = load_model(path, scenario)
    x = np.linspace(0.0, 0.2, 3 * len(layout("blind"))).reshape(3, -1)
    first, state = agent.predict(x, episode_start=np.ones(3, dtype=bool))
    second, _ = agent.predict(x, state, np.zeros(3, dtype=bool))
    afresh, _ = agent.predict(x, state, np.ones(3, dtype=bool))
    assert not np.array_equal(first, second)  # the same readings, with another memory
    np.testing.assert_allclose(afresh, first, atol=1e-6)  # a new course: nothing is remembered
    assert np.isfinite(run_courses(agent, scenario, 3, 4).returns).all()
    again = resume(path, scenario, "blind", config, 0, None, algorithm="recurrent_ppo")
    again.learn(ROLLOUT, reset_num_timesteps=False)
    assert again.num_timesteps == 2 * ROLLOUT


# --- resume -----------------------------------------------------------------------------------------------------------


def test_resume_goes_on_with_weights_optimizer_normalisation_and_learning_rate(saved, model, scenario):
    again = resume(saved, scenario, "identified", TINY, 0, None)
    env, old = again.get_vec_normalize_env(), model.get_vec_normalize_env()
    assert again.num_timesteps == 3 * ROLLOUT
    for mine, theirs in ((env.obs_rms, old.obs_rms), (env.ret_rms, old.ret_rms)):
        for name in ("mean", "var", "count"):
            np.testing.assert_allclose(getattr(mine, name), getattr(theirs, name))
    for (name, p), (_, q) in zip(again.policy.named_parameters(), model.policy.named_parameters(), strict=True):
        np.testing.assert_array_equal(p.detach().numpy(), q.detach().numpy(), err_msg=name)
    mine, theirs = (m.policy.optimizer.state_dict()["state"] for m in (again, model))
    assert mine.keys() == theirs.keys() and len(mine) > 0
    for key in mine:
        np.testing.assert_array_equal(mine[key]["exp_avg_sq"].numpy(), theirs[key]["exp_avg_sq"].numpy())
    rates, update = [], again.train

    def train():
        update()
        rates.append(again.policy.optimizer.param_groups[0]["lr"])

    again.train = train
    again.learn(3 * ROLLOUT, reset_num_timesteps=False)
    assert again.num_timesteps == 6 * ROLLOUT
    assert rates == pytest.approx([TINY.learning_rate * share for share in (2 / 6, 1 / 6, 0.05)])


def test_resume_starts_new_courses_with_new_noise(saved, scenario):
    """Repeating the start of the run would be learnt by heart; the same checkpoint still gives the same courses."""

    def first(model):
        model.learn(0, reset_num_timesteps=False)
        seen = model.get_vec_normalize_env().get_original_obs()
        x = np.zeros_like(seen)
        noise = model.predict(x, deterministic=False)[0] - model.predict(x, deterministic=True)[0]
        return seen, noise

    start = first(build(scenario, "identified", TINY, 0))
    again, repeat = (first(resume(saved, scenario, "identified", TINY, 0, None)) for _ in range(2))
    np.testing.assert_array_equal(again[0], repeat[0])
    np.testing.assert_array_equal(again[1], repeat[1])
    assert np.abs(start[0][:, None] - again[0][None]).max(axis=2).min() > 1e-3
    assert np.abs(start[1] - again[1]).max() > 1e-3


@pytest.mark.parametrize("key, asked", [("layer", 16), ("history", 2), ("critic", "true_soil"), ("activation", "tanh")])
def test_resume_refuses_another_network_or_observation(saved, scenario, key, asked):
    refused(lambda: resume(saved, scenario, "blind", TINY, 0, None), "observation 'identified', not 'blind'")
    config = replace(TINY, **{key: asked})
    refused(lambda: resume(saved, scenario, "identified", config, 0, None), f"{key} {getattr(TINY, key)!r}, not")


# --- files that cannot be used ----------------------------------------------------------------------------------------


def edit(path, **changes):
    """Change keys of the description in the zip of an agent."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members[INFO] = json.dumps(json.loads(members[INFO]) | changes)
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)


def test_another_layout_is_refused_and_the_difference_named(saved):
    names = [e.name for e in layout("identified")]
    edit(saved, observation_names=[*names[:4], "wheel_torque", *names[5:]])
    refused(lambda: load_agent(saved), "wheel_torque", "torque", "layout")
    edit(saved, observation_names=[names[1], names[0], *names[2:]])
    refused(lambda: load_agent(saved), "order")


@pytest.mark.parametrize(
    "key, value",
    [("mean", [0.0] * 5), ("var", [-1.0] * 22), ("clip", "ten"), ("observation", "identifed"), ("timesteps", 1.5),
     ("scenario", {"course": {"lenght": 3}}), ("ppo", {"layers": 3}), ("new", 3)],
)  # fmt: skip
def test_a_description_with_a_wrong_entry(saved, key, value):
    edit(saved, **{key: value})
    refused(lambda: read_info(saved), "model.zip", INFO, "lenght" if key == "scenario" else key)


def test_an_agent_of_a_rover_does_not_drive_a_wheel(tmp_path, scenario):
    model = build(load_rover("mars_rover"), "blind", TINY, 0)
    save(model, tmp_path / "model.zip")
    refused(
        lambda: load_model(tmp_path / "model.zip", scenario), "an agent of a rover, for scenario 'mixed' of a wheel"
    )


# --- arguments of predict ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("steps, algorithm", [(0, "ppo"), (3, "ppo"), (2, "recurrent_ppo")])
def test_an_argument_that_predict_cannot_take_is_named(tmp_path, scenario, steps, algorithm):
    """Without a memory, with a history, with an LSTM and a history."""
    if algorithm == "recurrent_ppo":
        pytest.importorskip("sb3_contrib")
    save(build(scenario, "blind", replace(TINY, history=steps), 0, algorithm=algorithm), tmp_path / "model.zip")
    agent = load_model(tmp_path / "model.zip", scenario)
    rows = np.zeros((3, 14))
    rows[:, 3] = 1.0
    for row, column, value, said in (
        (1, 3, np.nan, "load = nan: expected -10 to 10 (of weight)"),
        (2, 10, 1.5, "halted = 1.5: expected 0 to 1"),
    ):
        wrong = rows.copy()
        wrong[row, column] = value
        refused(lambda wrong=wrong: agent.predict(wrong), f"observation[{row}]: {said}")
    refused(lambda: agent.predict("xyz"), "observation = 'xyz': expected numbers")
    refused(lambda: agent.predict(np.zeros((3, 24))), "expected 14 numbers, those of observation 'blind'")
    refused(lambda: agent.predict(rows, None, [True]), "episode_start: 1 values: expected 3")
    _, state = agent.predict(rows, None, np.ones(3, dtype=bool))
    assert agent.predict(rows, state, [False] * 3)[0].shape == (3, 1)
    if steps:
        kept, memory = state
        refused(lambda: agent.predict(rows[:2], state), "state: arrays of shape", "expected what the last predict")
        refused(lambda: agent.predict(rows, 3.0), "state = 3.0: expected")
        refused(lambda: agent.predict(rows, (np.full_like(kept, np.nan), memory)), "state: a number that is not finite")
    if algorithm == "recurrent_ppo":
        refused(lambda: agent.predict(rows, (kept, (memory[0],))), "arrays of shape [(1, 3, 8)]: expected")
