"""Without the extra `train`: one line that says what to install, and help, which needs none of it."""

import json
import os
import subprocess
import sys

import pytest

COMMANDS = {
    "soil-env-train": ("agents.train", ["--timesteps", "64"]),
    "soil-env-ablation": ("agents.ablation.__main__", []),
    "soil-env-sim2real": ("agents.sim2real.__main__", ["--world", "w.yaml", "--out", "o"]),
    "agents.seeds": ("agents.seeds", ["--out", "o"]),
    "agents.rover_study": ("agents.rover_study", ["--out", "o"]),
}
HELP = (
    "agents.train", "agents.ablation.__main__", "agents.sim2real.__main__", "agents.seeds", "agents.rover_study",
    "agents.evaluate.__main__", "agents.export.__main__", "agents.warning.__main__", "agents.tune",
)  # fmt: skip
BARE = """
import contextlib, importlib, io, json, sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "stable_baselines3", "sb3_contrib", "tensorboard", "tqdm"):
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
def test_command_says_what_to_install(said, name):
    assert said[name] == [2, "", f"{name}: needs Stable-Baselines3: pip install 'soil_env[train]'\n"]


@pytest.mark.parametrize("module", HELP)
def test_help_needs_nothing_of_it(said, module):
    status, out, err = said[f"{module} --help"]
    assert status == 0 and out.startswith("usage: ") and not err


def test_adapter_of_sb3_says_what_to_install(said):
    assert said["agents.sb3"] == "agents.sb3 needs Stable-Baselines3: pip install 'soil_env[train]'"
