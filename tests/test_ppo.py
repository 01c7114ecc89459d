"""PPO agents: what is saved is what is loaded, training goes on where it stopped, bad files are refused in one line."""

import json
import shutil

import numpy as np
import pytest
from stable_baselines3.common.vec_env import VecNormalize

from agents import ppo
from agents.ppo import NAMES, PPOConfig, TrainConfig, build, load_agent, load_config, resume, save
from agents.sb3 import SoilWheelVecEnv
from soil_env.loading import ParameterError
from soil_env.parameters import load_scenario
from soil_env.task import VARIANTS, layout

TINY = PPOConfig(num_envs=8, n_steps=16, batch_size=32, n_epochs=2, layer=8, learning_rate=1e-3)
ROLLOUT = TINY.num_envs * TINY.n_steps


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("mixed", {"control": {"time_limit": 3.0}})


def trained(scenario, variant="identified", rollouts=3, seed=0):
    model = build(scenario, variant, TINY, seed)
    model.learn(rollouts * ROLLOUT)
    return model


@pytest.fixture(scope="module")
def model(scenario):
    return trained(scenario)


@pytest.fixture()
def saved(model, tmp_path):
    save(model, tmp_path / "model")
    return tmp_path / "model"


def raw_observations(scenario, variant, n=20):
    env = SoilWheelVecEnv(n, scenario, variant)
    env.seed(77)
    env.reset()
    for _ in range(8):
        out = env.step(np.full((n, 1), 0.4, dtype=np.float32))[0]
    return out


def refused(action, *parts):
    """The message of the ParameterError that `action` raises: one line that holds all `parts`."""
    with pytest.raises(ParameterError) as error:
        action()
    message = str(error.value)
    assert "\n" not in message, message
    assert len(message) < 600, message
    for part in parts:
        assert str(part) in message, f"{part!r} not in {message!r}"
    return message


def edit(stem, **changes):
    path = stem.with_name(stem.name + ".json")
    meta = json.loads(path.read_text())
    for key, value in changes.items():
        if value is None:
            del meta[key]
        else:
            meta[key] = value
    path.write_text(json.dumps(meta))


# --- building ---------------------------------------------------------------------------------------------------------


def test_names_of_the_variants():
    assert NAMES == {"blind": "ppo_blind", "identified": "ppo_identified", "true_soil": "ppo_true"}
    assert tuple(NAMES) == VARIANTS


def test_build_takes_the_config(scenario):
    config = PPOConfig(num_envs=4, n_steps=24, batch_size=12, n_epochs=3, learning_rate=2e-3, gamma=0.9, gae_lambda=0.8,
                       clip_range=0.13, ent_coef=0.01, layer=5, log_std_init=-1.1)  # fmt: skip
    model = build(scenario, "blind", config, seed=5)
    assert (model.n_envs, model.n_steps, model.batch_size, model.n_epochs) == (4, 24, 12, 3)
    assert (model.gamma, model.gae_lambda, model.ent_coef, model.seed) == (0.9, 0.8, 0.01, 5)
    assert model.clip_range(0.5) == 0.13
    assert model.policy.log_std.detach().numpy() == pytest.approx(-1.1)
    widths = {p.shape[0] for name, p in model.policy.named_parameters() if "mlp_extractor" in name}
    assert widths == {5}
    assert isinstance(model.get_env(), VecNormalize) and model.get_env().gamma == 0.9


def test_learning_rate_falls_linearly_to_five_percent(scenario):
    model = build(scenario, "blind", TINY, seed=0)
    for left, share in ((1.0, 1.0), (0.5, 0.5), (0.2, 0.2), (0.05, 0.05), (0.01, 0.05), (0.0, 0.05)):
        assert model.lr_schedule(left) == pytest.approx(share * TINY.learning_rate)


def test_learning_rate_is_used_by_the_optimizer(scenario):
    """Four rollouts: the last update starts with nothing left to learn from, at 5 %."""
    rates = []
    model = build(scenario, "blind", TINY, seed=0)
    update = model.train

    def train():
        update()
        rates.append(model.policy.optimizer.param_groups[0]["lr"])

    model.train = train
    model.learn(4 * ROLLOUT)
    assert rates == pytest.approx([TINY.learning_rate * share for share in (0.75, 0.5, 0.25, 0.05)])


def test_training_is_reproducible(scenario):
    a, b, other = (trained(scenario, "blind", rollouts=2, seed=s) for s in (3, 3, 4))
    x = raw_observations(scenario, "blind")
    np.testing.assert_array_equal(a.predict(x, deterministic=True)[0], b.predict(x, deterministic=True)[0])
    assert (a.predict(x, deterministic=True)[0] != other.predict(x, deterministic=True)[0]).any()


# --- save and load ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("variant", VARIANTS)
def test_loaded_agent_acts_on_raw_observations_as_the_trained_model(scenario, variant, tmp_path):
    model = trained(scenario, variant)
    save(model, tmp_path / "model")
    agent = load_agent(tmp_path / "model")
    raw = raw_observations(scenario, variant)
    env = model.get_vec_normalize_env()
    expected, _ = model.predict(env.normalize_obs(raw), deterministic=True)
    actions, _ = agent.predict(raw, deterministic=True)
    np.testing.assert_allclose(actions, expected, atol=1e-6)
    assert (actions != model.predict(raw, deterministic=True)[0]).any()  # the normalisation matters
    np.testing.assert_allclose(agent.predict(raw[3])[0], expected[3], atol=1e-6)
    assert agent.variant == variant and agent.name == NAMES[variant]
    assert agent.timesteps == model.num_timesteps == 3 * ROLLOUT


def test_predict_has_the_interface_of_a_controller(saved, scenario):
    agent = load_agent(saved)
    raw = raw_observations(scenario, "identified", 5)
    actions, state = agent.predict(raw, state=None, episode_start=np.ones(5, dtype=bool), deterministic=True)
    assert actions.shape == (5, 1) and actions.dtype == np.float32 and np.abs(actions).max() <= 1.0
    assert state is None
    assert agent.predict(raw[0])[0].shape == (1,)


def test_stem_zip_and_folder_name_the_same_agent(saved, scenario):
    raw = raw_observations(scenario, "identified")
    expected = load_agent(saved).predict(raw)[0]
    for where in (str(saved), saved.with_name("model.zip"), saved.parent, str(saved.parent)):
        np.testing.assert_array_equal(load_agent(where).predict(raw)[0], expected)


def test_json_describes_the_agent(saved, model, scenario):
    meta = json.loads(saved.with_name("model.json").read_text())
    assert meta["observation"] == "identified" and meta["timesteps"] == 3 * ROLLOUT
    assert meta["observation_names"] == [e.name for e in layout("identified")]
    assert len(meta["mean"]) == len(meta["var"]) == len(meta["observation_names"])
    assert meta["scenario"]["control"]["time_limit"] == 3.0
    assert load_scenario(scenario).name == meta["scenario"]["name"]


def test_loading_does_not_need_the_training_environment(saved, scenario, monkeypatch):
    """The agent is judged on other scenarios: loading builds no environment."""

    def no_env(*args, **kwargs):
        raise AssertionError("an environment was built")

    monkeypatch.setattr(ppo, "SoilWheelVecEnv", no_env)
    assert load_agent(saved).timesteps == 3 * ROLLOUT


# --- whole files or none ----------------------------------------------------------------------------------------------


def test_saving_leaves_just_the_two_files(saved):
    assert sorted(p.name for p in saved.parent.iterdir()) == ["model.json", "model.zip"]


def test_leftovers_of_a_killed_save_are_ignored_and_replaced(saved, scenario, model):
    raw = raw_observations(scenario, "identified")
    expected = load_agent(saved).predict(raw)[0]
    for name in (".model.partial.zip", ".model.json.partial", "model.zip.partial"):
        saved.with_name(name).write_bytes(b"half a fil")
    np.testing.assert_array_equal(load_agent(saved).predict(raw)[0], expected)
    save(model, saved)
    np.testing.assert_array_equal(load_agent(saved).predict(raw)[0], expected)


@pytest.mark.parametrize("what", ["zip", "json"])
def test_a_save_that_fails_half_way_leaves_the_old_agent(saved, scenario, monkeypatch, what):
    """As a full disk or a kill would: the agent that was there must still load (whichever of the two it is)."""
    raw = raw_observations(scenario, "identified")
    newer = trained(scenario, rollouts=1, seed=9)
    old, new = load_agent(saved).predict(raw)[0], newer.predict(newer.get_vec_normalize_env().normalize_obs(raw))[0]

    class Killed(BaseException):
        pass

    if what == "zip":

        def half(path, *args, **kwargs):
            with open(path, "wb") as file:
                file.write(b"PK half")
            raise Killed

        monkeypatch.setattr(newer, "save", half)
    else:

        def killed(*args, **kwargs):
            raise Killed

        monkeypatch.setattr(ppo, "_write", killed)
    with pytest.raises(Killed):
        save(newer, saved)
    monkeypatch.undo()
    got = load_agent(saved).predict(raw)[0]
    assert np.allclose(got, old, atol=1e-6) or np.allclose(got, new, atol=1e-6), "neither the old agent nor the new one"
    resume(saved, scenario, "identified", TINY, 0, None)  # and a checkpoint can still be resumed


# --- resume -----------------------------------------------------------------------------------------------------------


def test_resume_goes_on_with_everything(saved, model, scenario):
    again = resume(saved, scenario, "identified", TINY, 0, None)
    env, old = again.get_vec_normalize_env(), model.get_vec_normalize_env()
    assert again.num_timesteps == 3 * ROLLOUT
    np.testing.assert_allclose(env.obs_rms.mean, old.obs_rms.mean)
    np.testing.assert_allclose(env.obs_rms.var, old.obs_rms.var)
    assert env.obs_rms.count == old.obs_rms.count
    for name in ("mean", "var", "count"):
        assert getattr(env.ret_rms, name) == getattr(old.ret_rms, name), name
    for (name, p), (_, q) in zip(again.policy.named_parameters(), model.policy.named_parameters(), strict=True):
        np.testing.assert_array_equal(p.detach().numpy(), q.detach().numpy(), err_msg=name)
    mine, theirs = (m.policy.optimizer.state_dict()["state"] for m in (again, model))
    assert mine.keys() == theirs.keys() and len(mine) > 0
    for key in mine:
        np.testing.assert_array_equal(mine[key]["exp_avg_sq"].numpy(), theirs[key]["exp_avg_sq"].numpy())
    count = env.obs_rms.count
    again.learn(2 * ROLLOUT, reset_num_timesteps=False)
    assert again.num_timesteps == 5 * ROLLOUT
    assert env.obs_rms.count == pytest.approx(count + 2 * ROLLOUT + TINY.num_envs, abs=TINY.num_envs + 1e-3)


def test_resume_goes_on_with_the_learning_rate(saved, scenario):
    """After 3 of 6 rollouts the rate is halved already; the schedule does not start over."""
    again = resume(saved, scenario, "identified", TINY, 0, None)
    again.learn(3 * ROLLOUT, reset_num_timesteps=False)
    rate = again.policy.optimizer.param_groups[0]["lr"]
    assert rate == pytest.approx(0.05 * TINY.learning_rate)
    again = resume(saved, scenario, "identified", TINY, 0, None)
    rates = []
    update = again.train

    def train():
        update()
        rates.append(again.policy.optimizer.param_groups[0]["lr"])

    again.train = train
    again.learn(3 * ROLLOUT, reset_num_timesteps=False)
    assert rates == pytest.approx([TINY.learning_rate * share for share in (2 / 6, 1 / 6, 0.05)])


def test_resume_starts_new_courses_not_those_of_the_beginning(saved, scenario):
    def first(model):
        model.learn(0, reset_num_timesteps=False)
        return model.get_vec_normalize_env().get_original_obs()

    start = first(build(scenario, "identified", TINY, 0))
    again = first(resume(saved, scenario, "identified", TINY, 0, None))
    repeat = first(resume(saved, scenario, "identified", TINY, 0, None))
    np.testing.assert_array_equal(again, repeat)  # still reproducible
    assert np.abs(start).max(axis=1).min() > 0.1  # these are observations
    assert (np.abs(again - start).max(axis=1) > 1e-3).all()


def test_resume_writes_its_curve_into_the_same_log(scenario, tmp_path):
    model = build(scenario, "blind", TINY, 0, tmp_path / "log")
    model.learn(ROLLOUT, reset_num_timesteps=False, tb_log_name="PPO")
    save(model, tmp_path / "checkpoint")
    again = resume(tmp_path / "checkpoint", scenario, "blind", TINY, 0, tmp_path / "log")
    again.learn(ROLLOUT, reset_num_timesteps=False, tb_log_name="PPO")
    assert [p.name for p in (tmp_path / "log").iterdir()] == ["PPO_0"]
    assert len(list((tmp_path / "log" / "PPO_0").iterdir())) == 2


def test_resume_refuses_another_observation(saved, scenario):
    refused(lambda: resume(saved, scenario, "blind", TINY, 0, None), "identified", "blind")


def test_resume_refuses_a_zip_and_json_of_different_ages(saved, scenario):
    edit(saved, timesteps=3 * ROLLOUT + 1)
    refused(lambda: resume(saved, scenario, "identified", TINY, 0, None), 3 * ROLLOUT, 3 * ROLLOUT + 1)


@pytest.mark.parametrize("key", ["timesteps", "count", "return_mean", "return_var", "return_count"])
def test_resume_names_a_missing_key(saved, scenario, key):
    edit(saved, **{key: None})
    refused(lambda: resume(saved, scenario, "identified", TINY, 0, None), key)


# --- files that cannot be used ----------------------------------------------------------------------------------------


def test_another_layout_is_refused_and_the_difference_named(saved):
    names = [e.name for e in layout("identified")]
    edit(saved, observation_names=[*names[:4], "wheel_torque", *names[5:]])
    refused(lambda: load_agent(saved), "wheel_torque", "torque", "layout")
    edit(saved, observation_names=names[:-1])
    refused(lambda: load_agent(saved), "estimate_valid", len(names) - 1, len(names))
    edit(saved, observation_names=[names[1], names[0], *names[2:]])
    refused(lambda: load_agent(saved), "order")


def test_resume_refuses_another_layout_too(saved, scenario):
    edit(saved, observation_names=["slip"])
    refused(lambda: resume(saved, scenario, "identified", TINY, 0, None), "layout", "sinkage")


def test_an_unknown_variant_is_refused(saved):
    edit(saved, observation="identifed")
    refused(lambda: load_agent(saved), "identifed", "identified")


def test_missing_zip(saved):
    saved.with_name("model.zip").unlink()
    refused(lambda: load_agent(saved), "model.zip")


def test_missing_json(saved):
    saved.with_name("model.json").unlink()
    refused(lambda: load_agent(saved), "model.json")


def test_missing_folder(tmp_path):
    refused(lambda: load_agent(tmp_path / "nowhere" / "model"), "nowhere")


@pytest.mark.parametrize("content", [b"", b"no zip at all", b"PK\x03\x04 cut off"])
def test_a_zip_that_is_none(saved, content):
    saved.with_name("model.zip").write_bytes(content)
    refused(lambda: load_agent(saved), "model.zip")


def test_a_zip_that_is_cut_off(saved):
    path = saved.with_name("model.zip")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    refused(lambda: load_agent(saved), "model.zip")


def test_a_zip_of_something_else(saved, tmp_path):
    (tmp_path / "stuff").mkdir()
    (tmp_path / "stuff" / "a.txt").write_text("hello")
    shutil.make_archive(str(saved), "zip", tmp_path / "stuff")
    refused(lambda: load_agent(saved), "model.zip")


@pytest.mark.parametrize("content", [b"", b"{", b"not json", b"[]", b"3", b"null", b'"text"', b"\xff\xfe\x00binary"])
def test_a_json_that_is_none(saved, content):
    saved.with_name("model.json").write_bytes(content)
    refused(lambda: load_agent(saved), "model.json")


@pytest.mark.parametrize("key", ["observation", "observation_names", "mean", "var", "clip"])
def test_a_json_with_a_missing_key(saved, key):
    edit(saved, **{key: None})
    refused(lambda: load_agent(saved), "model.json", key)


@pytest.mark.parametrize(
    "key, value",
    [("mean", 3.0), ("mean", "abc"), ("mean", [0.0] * 5), ("var", [1.0] * 5), ("var", "abc"), ("clip", "ten"),
     ("observation_names", 5)],
)  # fmt: skip
def test_a_json_with_a_value_of_the_wrong_kind(saved, key, value):
    edit(saved, **{key: value})
    refused(lambda: load_agent(saved), "model")


def test_zip_and_json_of_different_agents(saved, scenario, tmp_path):
    """The zip of a blind agent beside the json of an identified one."""
    other = tmp_path / "other"
    save(trained(scenario, "blind", rollouts=1), other)
    shutil.copy(other.with_name("other.zip"), saved.with_name("model.zip"))
    refused(lambda: load_agent(saved), "11", "18")


def test_zip_and_json_of_different_ages(saved, scenario, tmp_path):
    """Same layout, another training: its normalisation belongs to other weights."""
    other = tmp_path / "other"
    save(trained(scenario, rollouts=1), other)
    shutil.copy(other.with_name("other.zip"), saved.with_name("model.zip"))
    refused(lambda: load_agent(saved), ROLLOUT, 3 * ROLLOUT)


# --- config -----------------------------------------------------------------------------------------------------------


def test_config_is_strict():
    refused(lambda: load_config({"timestep": 5}, "x.yaml"), "x.yaml", "timestep", "did you mean 'timesteps'")
    refused(lambda: load_config({"ppo": {"gama": 0.9}}, "x.yaml"), "gama", "did you mean 'gamma'")
    refused(lambda: load_config({"ppo": {"gamma": 1.5}}, "x.yaml"), "gamma", "1.5", "[0.5, 1]")
    refused(lambda: load_config({"ppo": {"gamma": "high"}}, "x.yaml"), "gamma", "high", "number")
    refused(lambda: load_config({"seed": 1.5}, "x.yaml"), "seed", "1.5", "whole number")
    refused(lambda: load_config({"seed": True}, "x.yaml"), "seed", "True", "number")
    refused(lambda: load_config({"observation": "seen"}, "x.yaml"), "observation", "seen", "true_soil")
    refused(lambda: load_config({"ppo": 5}, "x.yaml"), "ppo", "5")
    refused(lambda: load_config({"courses": 0}, "x.yaml"), "courses", "0")
    refused(lambda: load_config({"scenario": 5}, "x.yaml"), "scenario", "5", "text")


def test_config_defaults_and_conversions():
    assert load_config({}, "x") == TrainConfig()
    config = load_config({"timesteps": "5e6", "ppo": {"num_envs": 3.0}}, "x")
    assert config.timesteps == 5_000_000 and isinstance(config.timesteps, int)
    assert config.ppo.num_envs == 3 and config.ppo.gamma == PPOConfig().gamma
