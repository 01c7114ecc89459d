"""Without the extra `train`: one line that says what to install, and whatever does not need it works."""

import os
import subprocess
import sys

import pytest

BARE = """
import sys
sys.modules.update(dict.fromkeys(("torch", "stable_baselines3", "sb3_contrib", "tensorboard", "tqdm")))  # not there
sys.argv[0] = {name!r}
from {module} import main
sys.exit(main({arguments!r}))
"""


def run(code):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=300)


@pytest.mark.parametrize(
    ("module", "name", "arguments"),
    [
        ("agents.train", "soil-env-train", ["--timesteps", "64"]),
        ("agents.ablation.__main__", "soil-env-ablation", []),
        ("agents.sim2real.__main__", "soil-env-sim2real", ["--world", "w.yaml", "--out", "o"]),
        ("agents.seeds", "agents.seeds", ["--out", "o"]),
    ],
)
def test_command_says_what_to_install(module, name, arguments):
    ended = run(BARE.format(module=module, name=name, arguments=arguments))
    assert ended.returncode == 2
    assert ended.stderr == f"{name}: needs Stable-Baselines3: pip install 'soil_env[train]'\n"


def test_help_of_training_needs_no_torch():
    ended = run(BARE.format(module="agents.train", name="soil-env-train", arguments=["--help"]))
    assert ended.returncode == 0 and "--ppo.gamma" in ended.stdout
    assert ended.stdout.startswith("usage: soil-env-train [--config")


def test_adapter_of_sb3_says_what_to_install():
    ended = run("import sys; sys.modules['stable_baselines3'] = None; from agents.sb3 import SoilWheelVecEnv")
    message = "ModuleNotFoundError: agents.sb3 needs Stable-Baselines3: pip install 'soil_env[train]'"
    assert ended.stderr.splitlines()[-1] == message
