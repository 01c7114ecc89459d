"""Exported agents: one file that acts as the agent does, run without torch, Stable-Baselines3 and
soil_env.
"""

import json
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import yaml
from stable_baselines3 import A2C, SAC

from soil_env._io import files
from soil_env._io.loading import ParameterError
from soil_env.cli import main as soil_env
from soil_env.envs.wheel_env import SoilWheelEnv, observation_space
from soil_env.parameters import load_scenario
from soil_env.wrappers import LineAction
from soil_env_agents import ppo
from soil_env_agents.agent import Agent
from soil_env_agents.config import PPOConfig
from soil_env_agents.evaluate.contestants import parse
from soil_env_agents.evaluate.driving import run_courses
from soil_env_agents.evaluate.models import load_model
from soil_env_agents.exported import ExportedAgent
from soil_env_agents.sb3 import SoilWheelVecEnv

onnx = pytest.importorskip("onnx", reason="onnx and onnxruntime are in the extra export")
pytest.importorskip("onnxruntime", reason="onnx and onnxruntime are in the extra export")

TINY = PPOConfig(num_envs=4, n_steps=16, batch_size=32, n_epochs=1, layer=8, history=0)
COURSE = {"course": {"length": 3.0}, "control": {"action": "torque", "time_limit": 20.0}}


def export(run, out, steps=20):
    """Exit status of the command."""
    return soil_env(["export", str(run), f"--out={out}", f"--steps={steps}"])


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("mixed", COURSE)


def saved(folder, scenario, observation="identified", steps=256, **inputs):
    """A run folder with an agent that has learnt a little, so that its normalisation is not the
    identity.
    """
    model = ppo.build(scenario, observation, replace(TINY, **inputs), 0)
    model.learn(steps)
    folder.mkdir(exist_ok=True)
    ppo.save(model, folder / "model.zip")
    return folder


ALONE = textwrap.dedent("""
    import runpy, sys
    ours = ("soil_env", "soil_env_agents")
    for name in ("torch", "stable_baselines3", "gymnasium", "yaml", *ours):
        sys.modules[name] = None  # cannot be imported
    script, *sys.argv[1:] = sys.argv[1:]
    runpy.run_path(script, run_name="__main__")
""")


@pytest.mark.parametrize(
    ("name", "observation", "action", "history"),
    [
        ("mixed", "identified", "torque", 0),
        ("mixed", "blind", "rim_acceleration", 4),
        ("two_lines", "identified", "rim_acceleration", 2),
    ],
)
def test_the_runner_alone_drives_courses_as_the_agent_would(
    tmp_path, name, observation, action, history
):
    """1000 steps in closed loop: what the wheel does follows from the runner's actions."""
    scenario = load_scenario(name, COURSE | {"control": {"action": action, "time_limit": 20.0}})
    folder = saved(tmp_path / "run", scenario, observation, history=history)
    assert export(folder, tmp_path / "out") == 0
    agent = load_model(folder / "model.zip", scenario)
    env = SoilWheelEnv(scenario, observation=observation, scaled=False)
    runner = subprocess.Popen(
        [sys.executable, "-c", ALONE, str(tmp_path / "out" / "run_policy.py"), "--serve"],
        cwd=tmp_path,
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    memory = None
    over = True
    worst = 0.0
    courses = 0
    for step in range(1000):
        if over:
            observation, _ = env.reset(seed=step)
            memory = None
            courses = courses + 1
            runner.stdin.write("\n")
        expected, memory = agent.predict(observation[None], memory, np.array([over]))
        runner.stdin.write(" ".join(map(repr, observation.tolist())) + "\n")
        runner.stdin.flush()
        action = np.array([float(runner.stdout.readline())], dtype=np.float32)
        worst = max(worst, abs(float(action[0] - expected[0, 0])))
        observation, _, terminated, truncated, _ = env.step(action)
        over = terminated or truncated
    _, errors = runner.communicate()
    assert (runner.returncode, errors) == (0, "") and courses >= 3 and worst <= 1e-5


def test_the_runner_refuses_what_is_no_observation(tmp_path, scenario):
    """No action may follow from it: one line on stderr, status 2."""
    assert export(saved(tmp_path / "run", scenario), tmp_path / "out") == 0
    size = len(SoilWheelEnv(scenario).observation_names)
    good = "0 " * size
    for bad, said in (("a b", "'a'"), ("0 0", f"{size} finite"), ("nan " * size, f"{size} finite")):
        done = subprocess.run(
            [sys.executable, str(tmp_path / "out" / "run_policy.py"), "--serve"],
            input=f"{good}\n{bad}\n{good}\n",
            text=True,
            capture_output=True,
        )
        assert done.returncode == 2 and done.stdout.count("\n") == 1
        assert done.stderr.count("\n") == 1 and "line 2: " in done.stderr and said in done.stderr


def test_an_export_describes_itself_and_is_a_contestant_by_its_path(tmp_path, scenario):
    folder = saved(tmp_path / "run", scenario, history=3)
    out = tmp_path / "out"
    env = SoilWheelEnv(scenario, scaled=False)
    assert export(folder, out) == 0
    content = yaml.safe_load((out / "policy.yaml").read_text(encoding="utf-8"))
    assert [e["name"] for e in content["inputs"]] == list(env.observation_names)
    for side in ("low", "high"):
        np.testing.assert_allclose(
            [e[side] for e in content["inputs"]], getattr(env.observation_space, side), rtol=1e-6
        )
    assert all(e["unit"] for e in content["inputs"]) and content["rate"] == {
        "period": 0.1,
        "unit": "s",
    }
    assert content["output"]["scale"] == {"value": scenario.wheel.stall_torque, "unit": "N m"}
    assert (
        content["scenario"]["course"]["length"] == 3.0
        and content["proof"]["largest_difference"] <= 1e-5
    )

    (contestant,) = parse(f"mine={out}").values()
    assert contestant.kind == "model" and contestant.source.endswith("policy.onnx")
    agent = load_model(folder / "model.zip", scenario)
    other = load_model(contestant.source, scenario)
    assert all(other.content[key] == content[key] for key in ("inputs", "output"))
    expected, found = (run_courses(a, scenario, 3, 12) for a in (agent, other))
    np.testing.assert_array_equal(found.cause, expected.cause)
    np.testing.assert_allclose(found.returns, expected.returns, atol=1e-4)
    with pytest.raises(ParameterError, match="trained with action 'torque'"):
        load_model(
            contestant.source, load_scenario(scenario, {"control": {"action": "wheel_speed"}})
        )

    rows = np.zeros((2, len(env.observation_names)))
    _, state = other.predict(rows)
    for given, said in (
        ((rows + np.nan,), r"observation\[0\]: slip = nan"),
        ((rows[:1], state), "what the last predict"),
    ):
        with pytest.raises(ParameterError, match=said):
            other.predict(*given)


def test_a_model_trained_with_line_action_drives_and_is_exported(tmp_path, capsys):
    path = tmp_path / "lines.zip"
    env = LineAction(gymnasium.make("soil_env:SoilWheel-v0", info="none"))
    model = SAC(
        "MlpPolicy", env, policy_kwargs={"net_arch": [8]}, device="cpu", seed=0, buffer_size=200
    )
    model.save(path)
    agent = load_model(path, load_scenario())
    k = env.unwrapped.observation_names.index("choice")
    space = observation_space("identified", load_scenario().course, scaled=False)
    x = (
        np.random.default_rng(0)
        .uniform(space.low, space.high, (40, *space.shape))
        .astype(np.float32)
    )
    x[:, k] = np.arange(40) % 2
    both = model.predict(agent.scaling(x), deterministic=True)[0]
    expected = np.where(x[:, [k]] > 0.5, both[:, 1:], both[:, :1])
    np.testing.assert_array_equal(agent.predict(x)[0], expected)
    assert export(path, tmp_path / "out") == 0
    found, _ = ExportedAgent(tmp_path / "out" / "policy.onnx").predict(x)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert (
        soil_env(
            ["drive", "--controller", str(path), "--frame", "3", "--out", str(tmp_path / "a.png")]
        )
        == 0
    )
    with pytest.raises(ParameterError, match=r"another observation layout|actions of shape \(2,\)"):
        load_model(path, load_scenario("mixed"))


@pytest.mark.parametrize("algorithm", [A2C, SAC])
def test_models_of_plain_sb3(tmp_path, algorithm):
    env = SoilWheelVecEnv(2, **COURSE)
    model = algorithm("MlpPolicy", env, policy_kwargs={"net_arch": [8]}, device="cpu", seed=0)
    model.save(tmp_path / "model.zip")
    assert export(tmp_path / "model.zip", tmp_path / "out") == 0
    count = len(env.observation_names)
    scaling = env.scaling
    x = (scaling.centre + scaling.scale * np.random.default_rng(0).normal(size=(40, count))).astype(
        np.float32
    )
    x = np.clip(
        x, scaling.physical(env.observation_space.low), scaling.physical(env.observation_space.high)
    )
    x[::3, env.observation_names.index("ahead_log10_sinkage_coefficient")] = 0.0  # out of sight
    expected, _ = model.predict(scaling(x), deterministic=True)
    exported = ExportedAgent(tmp_path / "out" / "policy.onnx")
    found, memory = exported.predict(x)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert memory is None and len(np.unique(found)) > 5
    with pytest.raises(ParameterError, match="episode_start: 2 values: expected 40"):
        exported.predict(x, None, [True, False])


def test_an_export_and_a_model_of_plain_sb3_are_refused_on_a_rover(tmp_path, scenario, capsys):
    assert export(saved(tmp_path / "run", scenario, "blind"), tmp_path / "out") == 0
    plain = tmp_path / "plain.zip"
    A2C("MlpPolicy", SoilWheelVecEnv(1, scenario), policy_kwargs={"net_arch": [4]}).save(plain)
    for path in (tmp_path / "out", plain):
        capsys.readouterr()
        assert soil_env(["drive", f"--policy={path}", "--rover=lunar_micro_rover"]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert "of a rover: expected an agent of train.py, or module:Class" in error


def test_an_action_that_differs_is_not_exported(tmp_path, scenario, capsys, monkeypatch):
    folder = saved(tmp_path / "run", scenario)
    plain = Agent.act
    monkeypatch.setattr(
        "soil_env_agents.agent.Agent.act", lambda self, x, *rest: plain(self, 1.5 * x, *rest)
    )
    assert export(folder, tmp_path / "out") == 2
    assert "differs by" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_a_full_temporary_folder_is_named(tmp_path, scenario, capsys, monkeypatch):
    """It may be full where --out is not."""

    def full(content):
        raise OSError(28, "full")

    monkeypatch.setattr(files, "_bytes", full)
    monkeypatch.setattr(Path, "write_bytes", lambda path, content: full(content))
    assert export("default", tmp_path / "out") == 2
    assert "policy.onnx: full" in capsys.readouterr().err


def test_files_that_are_not_known_are_named(tmp_path, scenario):
    assert export(saved(tmp_path / "run", scenario), tmp_path) == 0
    model = onnx.load(tmp_path / "policy.onnx")
    file = tmp_path / "other.onnx"
    content = json.loads(model.metadata_props[0].value)
    older = {k: v for k, v in content.items() if k != "observation_version"}
    content["inputs"][0]["high"] = 2.0
    for description, said in (
        (older, "observations of version 1: expected version 2"),
        (content, "another observation layout"),
        ({}, "not written by `soil-env export`"),
    ):
        model.metadata_props[0].value = json.dumps(description)
        onnx.save(model, file)
        with pytest.raises(ParameterError, match=said):
            ExportedAgent(file)
    file.write_bytes(b"no")
    with pytest.raises(ParameterError, match="cannot be loaded as an ONNX policy"):
        ExportedAgent(file)
