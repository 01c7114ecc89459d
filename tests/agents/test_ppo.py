"""PPO agents: what is saved is what is loaded, training goes on where it stopped, bad files are refused in one line."""

import os
import struct
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from agents import ppo
from agents.evaluate.models import load_model
from agents.ppo import NAMES, PPOConfig, build, load_agent, load_config, resume, save
from agents.sb3 import SoilWheelVecEnv
from soil_env._io.loading import ParameterError
from soil_env.parameters import load_scenario
from soil_env.simulation.task import VARIANTS, layout
from tests.agents.saved import META, edit, rewrite

TINY = PPOConfig(num_envs=8, n_steps=16, batch_size=32, n_epochs=2, layer=8, learning_rate=1e-3, history=0)
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
    save(model, tmp_path / "model.zip")
    return tmp_path / "model.zip"


def raw_observations(scenario, variant, n=20, scaled=False):
    env = SoilWheelVecEnv(n, scenario, variant, scaled=scaled)
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


# --- building ---------------------------------------------------------------------------------------------------------


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
    save(model, tmp_path / "model.zip")
    agent = load_agent(tmp_path / "model.zip")
    raw = raw_observations(scenario, variant)
    env = model.get_vec_normalize_env()
    expected, _ = model.predict(env.normalize_obs(agent.scaling(raw)), deterministic=True)
    actions, _ = agent.predict(raw, deterministic=True)
    np.testing.assert_allclose(actions, expected, atol=1e-6)
    assert (actions != model.predict(raw, deterministic=True)[0]).any()  # the normalisation matters
    np.testing.assert_allclose(agent.predict(raw[3])[0], expected[3], atol=1e-6)
    assert agent.variant == variant and agent.name == NAMES[variant]
    assert agent.timesteps == model.num_timesteps == 3 * ROLLOUT


def test_the_zip_is_still_one_of_sb3(saved, model, scenario):
    raw = raw_observations(scenario, "identified").astype(np.float32)
    plain = PPO.load(saved, device="cpu")
    assert plain.num_timesteps == model.num_timesteps
    np.testing.assert_array_equal(plain.predict(raw, deterministic=True)[0], model.predict(raw, deterministic=True)[0])
    with zipfile.ZipFile(saved) as archive:
        assert archive.testzip() is None
        assert sorted(archive.namelist()).count(META) == 1


# --- whole files or none ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("moment", ["model", "meta", "replace"])
def test_a_save_that_fails_half_way_leaves_the_old_agent(saved, scenario, monkeypatch, moment):
    """As a full disk or a kill would: the agent that was there is untouched, and the next save goes through."""
    raw = raw_observations(scenario, "identified")
    newer = trained(scenario, rollouts=1, seed=9)
    old, content = load_agent(saved).predict(raw)[0], saved.read_bytes()
    seen = load_agent(saved).scaling(raw)
    new = newer.predict(newer.get_vec_normalize_env().normalize_obs(seen), deterministic=True)[0]
    assert np.abs(new - old).max() > 1e-3

    class Killed(BaseException):
        pass

    def killed(*args, **kwargs):
        raise Killed

    if moment == "model":

        def half(stream, *args, **kwargs):
            stream.write(b"PK half")
            raise Killed

        monkeypatch.setattr(newer, "save", half)
    elif moment == "meta":
        write = zipfile.ZipFile.writestr

        def no_meta(self, name, data, *args, **kwargs):
            if name == META:
                write(self, name, data[: len(data) // 2], *args, **kwargs)
                raise Killed
            return write(self, name, data, *args, **kwargs)

        monkeypatch.setattr(zipfile.ZipFile, "writestr", no_meta)
    else:
        monkeypatch.setattr(os, "replace", killed)
    with pytest.raises(Killed):
        save(newer, saved)
    monkeypatch.undo()
    assert saved.read_bytes() == content
    np.testing.assert_array_equal(load_agent(saved).predict(raw)[0], old)
    resume(saved, scenario, "identified", TINY, 0, None)  # and a checkpoint can still be resumed
    save(newer, saved)
    np.testing.assert_allclose(load_agent(saved).predict(raw)[0], new, atol=1e-6)
    assert [p.name for p in saved.parent.iterdir()] == ["model.zip"]


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
    rates = []
    update = again.train

    def train():
        update()
        rates.append(again.policy.optimizer.param_groups[0]["lr"])

    again.train = train
    again.learn(3 * ROLLOUT, reset_num_timesteps=False)
    assert rates == pytest.approx([TINY.learning_rate * share for share in (2 / 6, 1 / 6, 0.05)])


def first_observations(model):
    """What the wheels see at their start, not normalised."""
    model.learn(0, reset_num_timesteps=False)
    return model.get_vec_normalize_env().get_original_obs()


def apart(a, b):
    """Smallest difference between any observation of `a` and any of `b`."""
    return np.abs(a[:, None, :] - b[None, :, :]).max(axis=2).min()


def test_resume_starts_new_courses_not_those_of_the_beginning(saved, scenario):
    start = first_observations(build(scenario, "identified", TINY, 0))
    again = first_observations(resume(saved, scenario, "identified", TINY, 0, None))
    repeat = first_observations(resume(saved, scenario, "identified", TINY, 0, None))
    np.testing.assert_array_equal(again, repeat)  # still reproducible
    assert np.abs(start).max(axis=1).min() > 0.1  # these are observations
    assert apart(start, again) > 1e-3
    edit(saved, timesteps=5_000_000_000)  # other courses at each checkpoint, and the seeds do not run out
    assert apart(again, first_observations(resume(saved, scenario, "identified", TINY, 0, None))) > 1e-3


def test_resume_draws_other_actions_than_at_the_beginning(saved, scenario):
    """The noise of exploration is seeded anew too; loading alone would repeat that of the first rollout."""

    def noise(model):
        """Actions relative to the policy's own, for the same observations."""
        raw = raw_observations(scenario, "identified", 8).astype(np.float32)
        return model.predict(raw, deterministic=False)[0] - model.predict(raw, deterministic=True)[0]

    again = noise(resume(saved, scenario, "identified", TINY, 0, None))
    repeat = noise(resume(saved, scenario, "identified", TINY, 0, None))
    np.testing.assert_array_equal(again, repeat)
    loaded = PPO.load(saved, env=ppo.normalised(scenario, "identified", TINY, 0), device="cpu")
    assert np.abs(again - noise(loaded)).max() > 1e-3


def test_resume_refuses_another_observation(saved, scenario):
    refused(lambda: resume(saved, scenario, "blind", TINY, 0, None), "identified", "blind")


# --- files that cannot be used ----------------------------------------------------------------------------------------


def test_another_layout_is_refused_and_the_difference_named(saved):
    names = [e.name for e in layout("identified")]
    edit(saved, observation_names=[*names[:4], "wheel_torque", *names[5:]])
    refused(lambda: load_agent(saved), "wheel_torque", "torque", "layout")
    edit(saved, observation_names=names[:-1], mean=[0.0] * (len(names) - 1), var=[1.0] * (len(names) - 1))
    refused(lambda: load_agent(saved), names[-1], len(names) - 1, len(names))
    swapped = [names[1], names[0], *names[2:]]
    edit(saved, observation_names=swapped, mean=[0.0] * len(names), var=[1.0] * len(names))
    refused(lambda: load_agent(saved), "order")


def test_missing_zip(saved, scenario):
    saved.unlink()
    refused(lambda: load_agent(saved), "model.zip")
    refused(lambda: load_agent(saved.parent), "model.zip")
    refused(lambda: resume(saved, scenario, "identified", TINY, 0, None), "model.zip")


def test_a_model_without_its_normalisation(saved, model, scenario):
    """A zip as SB3's own save leaves it."""
    model.save(saved)
    refused(lambda: load_agent(saved), "model.zip", "soil_env.json")
    refused(lambda: resume(saved, scenario, "identified", TINY, 0, None), "model.zip", "soil_env.json")


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.999])
def test_a_zip_that_is_cut_off(saved, share):
    saved.write_bytes(saved.read_bytes()[: int(share * saved.stat().st_size)])
    refused(lambda: load_agent(saved), "model.zip")


@pytest.mark.parametrize("member", [META, "data", "policy.pth"])
@pytest.mark.parametrize("where", [0.0, 0.9])
def test_a_zip_with_damaged_bytes(saved, member, where):
    """A disk error within one member; its place in the file is still listed."""
    with zipfile.ZipFile(saved) as archive:
        info = archive.getinfo(member)
    content = bytearray(saved.read_bytes())
    lengths = struct.unpack_from("<HH", content, info.header_offset + 26)  # of the member's name and its extra field
    begin = info.header_offset + 30 + sum(lengths)
    at = begin + int(where * info.compress_size)
    for k in range(at, min(at + 12, begin + info.compress_size)):
        content[k] ^= 0xFF
    saved.write_bytes(content)
    refused(lambda: load_agent(saved), "model.zip")


@pytest.mark.parametrize("content", [b"{", b"[]", b"\xff\xfe\x00binary"])
def test_a_json_that_is_none(saved, content):
    rewrite(saved, content)
    refused(lambda: load_agent(saved), "model.zip")


@pytest.mark.parametrize(
    "key, value",
    [("mean", [0.0] * 5), ("var", [[1.0]] * 22), ("clip", "ten"), ("observation", "identifed"), ("timesteps", 1.5)],
)  # fmt: skip
def test_a_json_with_a_value_of_the_wrong_kind(saved, scenario, key, value):
    edit(saved, **{key: value})
    refused(lambda: load_agent(saved), "model.zip", "soil_env.json", key)
    refused(lambda: resume(saved, scenario, "identified", TINY, 0, None), "model.zip", "soil_env.json", key)


# --- config -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("num_envs, n_steps, batch_size", [(4, 10, 39), (4, 10, 80)])
def test_a_batch_that_does_not_divide_the_rollout_is_refused(num_envs, n_steps, batch_size):
    ppo_keys = {"num_envs": num_envs, "n_steps": n_steps, "batch_size": batch_size}
    refused(lambda: PPOConfig(**ppo_keys), "batch_size", batch_size, num_envs * n_steps)
    refused(lambda: load_config({"ppo": ppo_keys}, "x.yaml"), "x.yaml", "batch_size", batch_size, num_envs * n_steps)


def test_an_observation_of_another_layout_is_refused(tmp_path):
    save(build(load_scenario("mixed"), "blind", TINY, 0), tmp_path / "model.zip")
    agent = load_agent(tmp_path / "model.zip")
    for shape in ((24,), (3, 24), ()):
        with pytest.raises(ParameterError, match=r"expected 14 numbers, those of observation 'blind'"):
            agent.predict(np.zeros(shape))
    assert agent.predict(np.zeros((3, 14)))[0].shape == (3, 1)


# --- what predict is given --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def agents(scenario, tmp_path_factory):
    """{name: agent} that read "blind": without a memory, with a history, with an LSTM and a history."""
    folder, made = tmp_path_factory.mktemp("agents"), {}
    for name, steps, algorithm in (("none", 0, "ppo"), ("history", 3, "ppo"), ("lstm", 2, "recurrent_ppo")):
        if algorithm == "recurrent_ppo":
            pytest.importorskip("sb3_contrib")
        config = replace(TINY, history=steps)
        save(build(scenario, "blind", config, 0, algorithm=algorithm), folder / "model.zip")
        made[name] = load_model(folder / "model.zip", scenario)
    return made


@pytest.mark.parametrize("variant", VARIANTS)
def test_values_in_their_units_and_given_back_are_taken(scenario, variant, tmp_path):
    """Over whole courses, those that end badly among them; of scaled ones of the same courses most are refused."""
    save(build(scenario, variant, TINY, 0), tmp_path / "model.zip")
    agent = load_agent(tmp_path / "model.zip")
    plain, scaled = (SoilWheelVecEnv(20, scenario, variant, scaled=s) for s in (False, True))
    for env in (plain, scaled):
        env.seed(5)
    seen, other = plain.reset(), scaled.reset()
    told = 0
    for k in range(60):
        np.testing.assert_allclose(agent.predict(scaled.scaling.physical(other))[0], agent.predict(seen)[0], atol=1e-4)
        try:
            agent.predict(other)
        except ParameterError as error:
            assert "values in their units, as scaled=False observes them" in str(error) and "\n" not in str(error)
            told += 1
        action = np.full((20, 1), (1.0, -1.0, 0.3)[k % 3], np.float32)
        seen, other = (env.step(action)[0] for env in (plain, scaled))
    assert told > 40  # of 20 observations at least one is out of the bounds, not always one


@pytest.mark.parametrize("which", ["none", "history", "lstm"])
def test_what_predict_cannot_take_is_named(agents, which):
    agent = agents[which]
    rows = np.zeros((3, 14))
    rows[:, 3] = 1.0
    rows[1, 3] = np.nan
    refused(lambda: agent.predict(rows), "observation[1]: load = nan: expected -10 to 10 (of weight)")
    refused(lambda: agent.predict(rows[1]), "observation: load = nan")
    rows[1, 3], rows[2, 10] = 1.0, 1.5
    refused(lambda: agent.predict(rows), "observation[2]: halted = 1.5: expected 0 to 1")
    refused(lambda: agent.predict("xyz"), "observation = 'xyz': expected numbers")
    refused(lambda: agent.predict(np.zeros((2, 3, 14))), "shape (2, 3, 14): expected 14 numbers")
    rows[2, 10] = 0.0
    refused(lambda: agent.predict(rows, None, [True]), "episode_start: 1 values: expected 3")
    refused(lambda: agent.predict(rows, None, "yes"), "episode_start = 'yes': expected True or False")
    refused(lambda: agent.predict(rows, deterministic="no"), "deterministic = 'no': expected True or False")
    _, state = agent.predict(rows, None, np.ones(3, dtype=bool))
    assert agent.predict(rows, state, [False] * 3)[0].shape == (3, 1)
    if which != "none":
        refused(lambda: agent.predict(rows[:2], state), "state: arrays of shape", "expected what the last predict")
        refused(lambda: agent.predict(rows, 3.0), "state = 3.0: expected")
        kept, memory = state
        refused(lambda: agent.predict(rows, (np.full_like(kept, np.nan), memory)), "state: a number that is not finite")
    if which == "lstm":
        refused(lambda: agent.predict(rows, (kept, (memory[0],))), "arrays of shape [(1, 3, 8)]: expected")


@pytest.mark.parametrize("path", [None, 3, b"runs/x"])
def test_a_path_that_is_none_is_named(path):
    refused(lambda: load_agent(path), f"path = {path!r}: expected that of a run folder or of its model.zip")
