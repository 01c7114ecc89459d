"""Without torch and SB3: soil_env and the controllers work, help is shown, commands say what to install."""

import json
import os
import subprocess
import sys

import pytest

COMMANDS = {"soil-env-train": ("agents.train", ["--timesteps", "64"])}
HELP = ("agents.train", "agents.evaluate.__main__", "agents.export.__main__", "agents.study.__main__", "agents.tune")
BARE = """
import contextlib, importlib, io, json, sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "stable_baselines3", "sb3_contrib", "tensorboard", "tqdm", "onnx"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent())
said = {}
for name, (module, arguments) in json.loads(sys.argv[1]).items():
    sys.argv[0] = name
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = importlib.import_module(module).main(arguments)
        except SystemExit as end:
            status = end.code
    said[name] = (status, out.getvalue(), err.getvalue())
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
    asked = json.dumps(COMMANDS | {f"{module} --help": (module, ["--help"]) for module in HELP})
    ended = subprocess.run(
        [sys.executable, "-c", BARE, asked], capture_output=True, text=True, env=environment, timeout=300
    )
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_says_what_to_install(said, name):
    assert said[name] == [2, "", f"{name}: needs Stable-Baselines3: pip install 'soil_env[train]'\n"]


@pytest.mark.parametrize("module", HELP)
def test_help_is_shown(said, module):
    status, out, err = said[f"{module} --help"]
    assert status == 0 and out.startswith("usage: ") and not err


def test_the_environment_and_the_controllers_work_and_the_adapter_says_what_to_install(said):
    assert said["driven"]
    assert said["agents.sb3"] == "agents.sb3 needs Stable-Baselines3: pip install 'soil_env[train]'"
