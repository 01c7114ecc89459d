"""Exported agents: one file that acts as the agent does, run without torch, Stable-Baselines3 and
soil_env.
"""

import json
import subprocess
import sys
import textwrap
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import gymnasium
import numpy as np
import pytest
import yaml
from stable_baselines3 import A2C, SAC

from soil_env._io import files
from soil_env.cli import main as soil_env
from soil_env.envs.wheel_env import SoilWheelEnv, observation_space
from soil_env.parameters import load_scenario
from soil_env.wrappers import LineAction
from soil_env_agents.agent import Agent
from soil_env_agents.evaluate.contestants import parse
from soil_env_agents.evaluate.driving import run_courses
from soil_env_agents.evaluate.models import load_model
from soil_env_agents.exported import ExportedAgent
from soil_env_agents.sb3 import SoilWheelVecEnv
from tests.agents.learnt import saved
from tests.refusals import refused, refused_command

onnx = pytest.importorskip("onnx", reason="onnx and onnxruntime are in the extra export")
pytest.importorskip("onnxruntime", reason="onnx and onnxruntime are in the extra export")

COURSE = {"course": {"length": 3.0}, "control": {"action": "torque", "time_limit": 20.0}}


def export(run, out):
    """Exit status of `soil-env export` of the agent `run` to a folder, proved over 20 steps."""
    return soil_env(["export", str(run), f"--out={out}", "--steps=20"])


@pytest.fixture(scope="module")
def scenario():
    """`mixed` with short courses, driven by torque."""
    return load_scenario("mixed", COURSE)


@pytest.fixture(scope="module")
def run(scenario, tmp_path_factory):
    """Run folder of an agent."""
    return saved(tmp_path_factory.mktemp("run"), scenario)


@pytest.fixture(scope="module")
def exported(run):
    """Folder of its export."""
    assert export(run, run / "out") == 0
    return run / "out"


#: Runs a script with its arguments where these packages cannot be imported.
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
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    command = [sys.executable, "-c", ALONE, str(tmp_path / "out" / "run_policy.py"), "--serve"]
    runner = subprocess.Popen(command, cwd=tmp_path, text=True, **pipes)
    over = True
    worst = 0.0
    courses = 0
    for step in range(1000):
        if over:
            observation, _ = env.reset(seed=step)
            memory = None
            courses += 1
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


def test_actions_of_another_strength_are_refused(tmp_path):
    """What an agent reads does not tell it how strong its actions are."""
    own, stronger = (
        load_scenario("two_lines", COURSE | {"control": {"rim_acceleration": a}})
        for a in (0.3, 0.6)
    )
    model = saved(tmp_path / "run", own, "blind") / "model.zip"
    said = "trained with actions of at most 0.3 m/s2, those of scenario 'two_lines' are of at most"
    refused(partial(load_model, model, stronger), said)
    assert load_model(model, own).variant == "blind"


def test_the_runner_refuses_what_is_no_observation(exported, scenario):
    """No action may follow from it: one line on stderr, status 2."""
    size = len(SoilWheelEnv(scenario).observation_names)
    good = "0 " * size
    for bad, said in (("a b", "'a'"), ("0 0", f"{size} finite"), ("nan " * size, f"{size} finite")):
        command = [sys.executable, str(exported / "run_policy.py"), "--serve"]
        lines = f"{good}\n{bad}\n{good}\n"
        done = subprocess.run(command, input=lines, text=True, capture_output=True)
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
        limits = [e[side] for e in content["inputs"]]
        assert limits == pytest.approx(getattr(env.observation_space, side), rel=1e-6)
    assert all(e["unit"] for e in content["inputs"])
    assert content["rate"] == {"period": 0.1, "unit": "s"}
    assert content["output"]["scale"] == {"value": scenario.wheel.stall_torque, "unit": "N m"}
    assert content["scenario"]["course"]["length"] == 3.0
    assert content["proof"]["largest_difference"] <= 1e-5

    (contestant,) = parse(f"mine={out}").values()
    assert contestant.kind == "model" and contestant.source.endswith("policy.onnx")
    agent = load_model(folder / "model.zip", scenario)
    other = load_model(contestant.source, scenario)
    assert all(other.content[key] == content[key] for key in ("inputs", "output"))
    expected, found = (run_courses(a, scenario, 3, 12) for a in (agent, other))
    np.testing.assert_array_equal(found.cause, expected.cause)
    np.testing.assert_allclose(found.returns, expected.returns, atol=1e-4)
    by_speed = load_scenario(scenario, {"control": {"action": "wheel_speed"}})
    refused(lambda: load_model(contestant.source, by_speed), "trained with action 'torque'")

    rows = np.zeros((2, len(env.observation_names)))
    _, state = other.predict(rows)
    refused(lambda: other.predict(rows[:1], state), "what the last predict")


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
    space.seed(0)
    x = np.array([space.sample() for _ in range(40)])
    x[:, k] = np.arange(40) % 2
    both, _ = model.predict(agent.scaling(x), deterministic=True)
    expected = np.where(x[:, [k]] > 0.5, both[:, 1:], both[:, :1])
    np.testing.assert_array_equal(agent.predict(x)[0], expected)
    assert export(path, tmp_path / "out") == 0
    found, _ = ExportedAgent(tmp_path / "out" / "policy.onnx").predict(x)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    asked = ["--frame=3", f"--controller={path}", f"--out={tmp_path / 'a.png'}"]
    assert soil_env(["drive", *asked]) == 0
    refused(lambda: load_model(path, load_scenario("mixed")), ": trained ")


@pytest.mark.parametrize("algorithm", [A2C, SAC])
def test_models_of_plain_sb3(tmp_path, algorithm):
    env = SoilWheelVecEnv(2, **COURSE)
    model = algorithm("MlpPolicy", env, policy_kwargs={"net_arch": [8]}, device="cpu", seed=0)
    model.save(tmp_path / "model.zip")
    assert export(tmp_path / "model.zip", tmp_path / "out") == 0
    scaling = env.scaling
    space = env.observation_space
    x = np.random.default_rng(0).normal(size=(40, *space.shape)).clip(space.low, space.high)
    x = scaling.physical(x).astype(np.float32)
    x[::3, env.observation_names.index("ahead_log10_sinkage_coefficient")] = 0.0  # out of sight
    expected, _ = model.predict(scaling(x), deterministic=True)
    found, memory = ExportedAgent(tmp_path / "out" / "policy.onnx").predict(x)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert memory is None and len(np.unique(found)) > 5


def test_an_export_and_a_model_of_plain_sb3_are_refused_on_a_rover(
    tmp_path, exported, scenario, capsys
):
    plain = tmp_path / "plain.zip"
    A2C("MlpPolicy", SoilWheelVecEnv(1, scenario), policy_kwargs={"net_arch": [4]}).save(plain)
    for path in (exported, plain):
        asked = ["drive", f"--policy={path}", "--rover=lunar_micro_rover"]
        error = refused_command(capsys, "soil-env", soil_env, *asked).err
        assert "of a rover: expected an agent of train.py, or module:Class" in error


def test_an_action_that_differs_is_not_exported(tmp_path, run, capsys, monkeypatch):
    plain = Agent.act
    monkeypatch.setattr(Agent, "act", lambda self, x, *rest: plain(self, 1.5 * x, *rest))
    assert export(run, tmp_path / "out") == 2
    assert "differs by" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_a_full_temporary_folder_is_named(tmp_path, capsys, monkeypatch):
    """The export is tried there first; it may be full where --out is not."""
    full = Mock(side_effect=OSError(28, "full"))
    monkeypatch.setattr(files, "_bytes", full)
    monkeypatch.setattr(Path, "write_bytes", full)
    assert export("default", tmp_path / "out") == 2
    assert "policy.onnx: full" in capsys.readouterr().err


def test_files_that_are_not_known_are_named(tmp_path, exported):
    model = onnx.load(exported / "policy.onnx")
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
        refused(partial(ExportedAgent, file), said)
    file.write_bytes(b"no")
    refused(partial(ExportedAgent, file), "cannot be loaded as an ONNX policy")
