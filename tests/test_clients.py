"""What is shipped for other people's code, as far as that can be tested without it; `benchmarks.clients` runs it."""

import json
import pydoc
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import yaml

from benchmarks import clients

ROOT = Path(__file__).resolve().parent.parent


def test_the_page_is_that_of_the_committed_runs(tmp_path):
    result = json.loads((ROOT / "docs" / "clients.json").read_text())
    assert result and set(result) <= set(clients.CLIENTS)
    assert all(run["ok"] for found in result.values() for run in found["runs"])
    assert (ROOT / "docs" / "clients.md").read_text() == clients.page(result)


def test_a_failing_command_is_told_and_ends_the_client(capsys):
    client = clients.Client("", "", (), ("python -c 'print(1)'", "python -c 'print(2/0)'", "python -c 'print(3)'"))
    runs = clients.smoke("mine", client, Path(sys.executable))
    assert [(r["ok"], r["seen"]) for r in runs] == [(True, "1"), (False, "ZeroDivisionError: division by zero")]
    assert "Traceback" in capsys.readouterr().err
    text = clients.page({"zoo": {"versions": {"zoo": "1"}, "runs": runs}})
    assert "| `python -c 'print(2/0)'` | **failed**: ZeroDivisionError" in text and text.count("Not run yet") == 3


def test_an_unknown_client_is_refused_in_one_line(capsys, tmp_path):
    assert clients.main(["zo", f"--out={tmp_path}"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "did you mean 'zoo'" in error and not list(tmp_path.iterdir())


def test_the_hyperparameters_of_rl_zoo3_build_an_agent():
    """As rl_zoo3 reads them: its own keys taken out, text in quotes evaluated, the rest arguments of SB3's PPO."""
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecNormalize

    content = yaml.safe_load((ROOT / "configs" / "rl_zoo3" / "ppo.yml").read_text())
    given = content.pop("SoilWheel-v0")
    assert not content and given.pop("n_timesteps") >= 1e6 and given.pop("learning_rate") == "lin_1e-3"
    normalise = eval(given.pop("normalize"))
    ((wrapper, options),) = given.pop("env_wrapper")[0].items()
    made = make_vec_env(
        "SoilWheel-v0", given.pop("n_envs"), wrapper_class=pydoc.locate(wrapper), wrapper_kwargs=options
    )
    assert made.envs[0].action(np.zeros(1, np.float32)) == pytest.approx(0.3, abs=1e-3)
    env = VecNormalize(made, gamma=given["gamma"], **normalise)
    assert env.num_envs * given["n_steps"] % given["batch_size"] == 0
    model = PPO(given.pop("policy"), env, policy_kwargs=eval(given.pop("policy_kwargs")), seed=0, **given)
    actions, _ = model.predict(env.reset())
    assert actions.shape == (env.num_envs, 1)


def test_wrappers_for_vector_environments_take_the_native_one():
    """RLlib wraps it in DictInfoToList; CleanRL's scripts record statistics."""
    env = gymnasium.make_vec("soil_env:SoilWheel-v0", num_envs=2, vectorization_mode="vector_entry_point")
    env = gymnasium.wrappers.vector.DictInfoToList(gymnasium.wrappers.vector.RecordEpisodeStatistics(env))
    _, infos = env.reset(seed=1)
    assert [set(i) for i in infos] == [{"cause", "reward_terms", "x"}] * 2
    for _ in range(80):  # full throttle digs in, or stands at the first halt
        _, reward, terminated, _, infos = env.step([[1.0], [0.0]])
        for k in range(2):
            assert sum(infos[k]["reward_terms"].values()) == pytest.approx(reward[k])
            assert ("episode" in infos[k]) == bool(terminated[k])
    assert len(env.env.return_queue) >= 1
