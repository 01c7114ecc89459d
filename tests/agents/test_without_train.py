"""Without torch and SB3: soil_env and the controllers work, help is shown, commands say what to install."""

import json
import os
import subprocess
import sys

import pytest

MODULES = {
    "train": "agents.train", "evaluate": "agents.evaluate.command", "export": "agents.export.command",
    "study": "agents.study.command", "tune": "agents.tune",
}  # fmt: skip
COMMANDS = {"train": ["--timesteps", "64"], "export": ["runs/x", "--out", "o"]}
BARE = """
import contextlib, importlib, io, json, sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "stable_baselines3", "sb3_contrib", "tensorboard", "tqdm", "onnx"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent())
from soil_env.cli.running import run
said = {}
for name, module, *arguments in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = run(importlib.import_module(module).command, arguments, f"soil-env {name}")
    said[f"{name} {arguments[0]}"] = (status, out.getvalue(), err.getvalue())
try:
    import agents.sb3
except ModuleNotFoundError as error:
    said["agents.sb3"] = str(error)
import gymnasium, soil_env, agents.controllers.oracle, agents.exported
from agents.controllers import make_controller
env = gymnasium.make("SoilWheel-v0", observation="blind", scaled=False)
observation, _ = env.reset(seed=0)
action, _ = make_controller("soft_start", env.unwrapped.scenario).predict(observation)
said["driven"] = bool(env.step(action)[1] < 1e9)
print(json.dumps(said))
"""


@pytest.fixture(scope="module")
def said():
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    asked = [[name, MODULES[name], *more] for name, more in COMMANDS.items()]
    asked = json.dumps(asked + [[name, module, "--help"] for name, module in MODULES.items()])
    ended = subprocess.run(
        [sys.executable, "-c", BARE, asked], capture_output=True, text=True, env=environment, timeout=300
    )
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_says_what_to_install(said, name):
    line = f"soil-env {name}: error: needs Stable-Baselines3: pip install 'soil_env[train]'\n"
    assert said[f"{name} {COMMANDS[name][0]}"] == [2, "", line]


@pytest.mark.parametrize("name", MODULES)
def test_help_is_shown(said, name):
    status, out, err = said[f"{name} --help"]
    assert status == 0 and out.startswith("Usage: ") and not err


def test_the_environment_and_the_controllers_work_and_the_adapter_says_what_to_install(said):
    assert said["driven"]
    assert said["agents.sb3"] == "agents.sb3 needs Stable-Baselines3: pip install 'soil_env[train]'"
