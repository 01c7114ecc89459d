"""Without torch and SB3: drives of controllers and the default policy, help, and commands that name
what to install.
"""

import json
import os
import sys
from importlib.util import find_spec

from soil_env.cli import _COMMANDS
from tests.programs import python

REFUSED = [["train", "--timesteps", "64"], ["export", ".", "--out", "o"]]
HELPS = [[name, "--help"] for name in ("train", "evaluate", "export", "study", "tune")]
BARE = """
import contextlib, io, json, sys
TRAIN = ("torch", "stable_baselines3", "sb3_contrib", "tensorboard", "tqdm")
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in TRAIN:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent())
from soil_env.cli import main
said = []
for arguments in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(arguments)
    said.append((status, out.getvalue(), err.getvalue()))
import gymnasium, soil_env, soil_env_agents.controllers.oracle, soil_env_agents.exported
from soil_env_agents.controllers import make_controller
env = gymnasium.make("SoilWheel-v0", observation="blind", scaled=False)
observation, _ = env.reset(seed=0)
action, _ = make_controller("soft_start", env.unwrapped.scenario).predict(observation)
env.step(action)
from soil_env_agents.default_policy import DefaultPolicy
env = gymnasium.make("SoilWheel-v0", scaled=False)
action, _ = DefaultPolicy(env.unwrapped.scenario).predict(env.reset(seed=0)[0])
env.step(action)
print(json.dumps(said))
"""


HELP = """
import contextlib, io, json, sys
import train
from soil_env.cli import main
with contextlib.redirect_stdout(io.StringIO()):
    assert not train.main(["--help"])
    for name in json.loads(sys.argv[1]):
        assert not main([name, "--help"]), name
print([name for name in sys.modules if name in ("torch", "stable_baselines3")])
"""


def test_help_loads_neither_torch_nor_sb3():
    assert python("-c", HELP, json.dumps(list(_COMMANDS))).stdout == "[]\n"


def test_without_the_extra_train(tmp_path):
    exported = [["export", "default", f"--out={tmp_path}", "--steps=3"]] * bool(find_spec("onnx"))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    commands = json.dumps(REFUSED + exported + HELPS)
    said = json.loads(python("-c", BARE, commands, env=environment).stdout)
    needs = "error: needs Stable-Baselines3: pip install 'soil_env[train]'\n"
    for (name, *_), found in zip(REFUSED, said, strict=False):
        assert found == [2, "", f"soil-env {name}: {needs}"]
    for status, _, err in said[len(REFUSED) : -len(HELPS)]:
        assert status == 0, err
        assert (tmp_path / "policy.onnx").is_file()
    for status, out, err in said[-len(HELPS) :]:
        assert status == 0 and out.startswith("Usage: ") and not err
