"""A study killed with SIGKILL over and over, and begun again, gives what it gives undisturbed, to the byte.

`python -m tests.agents.test_killing FOLDER` does the work. Each of its processes is a fork of that one, which has
imported all that the work imports and started no thread: a fork of a process with threads may crash. It is killed where
it puts a file in its place (`os.replace`), before or after that.
"""

import importlib
import os
import signal
import subprocess
import sys
import traceback
import zipfile
from pathlib import Path

import pytest

from soil_env.cli import main as soil_env

ROOT = Path(__file__).resolve().parents[2]
MOST = 60  # processes
MOMENTS = ((1, "after"), (2, "before"), (2, "after"), (6, "before"), (5, "after"))  # of a process, in files; in turn
IMPORTED = ("optuna", "torch", "torch._dynamo", "soil_env_agents.study.command", "soil_env_agents.training")
SOME = {"study.json", "study.md", "study.png", "cells/mixed-identified-0.json", "cells/mixed-soft_start-0.json"}


def study(folder):
    """A study whose training begins anew after a kill."""
    from tests.agents.test_study import PPO, config

    (folder.parent / "config").mkdir(exist_ok=True)
    own = {"train": {"timesteps": 192, "student": 0, "ppo": PPO}, "arms": {"identified": {}, "blind": {}}}
    path = config(folder.parent / "config", controllers=["soft_start"], courses=3, seeds=1, **own)
    assert soil_env(["study", "--config", str(path), "--out", str(folder)]) == 0


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="fork and SIGKILL")
def test_a_killed_study_gives_what_a_calm_one_gives(tmp_path):
    command = [sys.executable, "-m", "tests.agents.test_killing", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout.split()[-1]) >= 5  # kills
    calm, killed = tmp_path / "calm", tmp_path / "killed"
    assert files(calm) == files(killed) >= SOME
    for file in files(calm):
        assert content(calm / file) == content(killed / file), file


def files(folder):
    """Names of the files, the logs of TensorBoard and Optuna apart."""
    found = (f.relative_to(folder) for f in folder.rglob("*") if f.is_file())
    return {f.as_posix() for f in found if not {"tensorboard", "tuned"} & set(f.parts)}


def content(file):
    """Content that has to be the same: of a model the weights."""
    return zipfile.ZipFile(file).read("policy.pth") if file.name == "model.zip" else file.read_bytes()


def status_of(folder, moment=None):
    """Status, as of `os.waitpid`, of a forked process that does the study, killed at a moment of `MOMENTS`."""
    child = os.fork()
    if child == 0:
        try:
            if moment:
                kill_at_a_file(*moment)
            study(folder)
        except BaseException:
            traceback.print_exc()
            sys.stderr.flush()
            os._exit(1)
        os._exit(0)
    return os.waitpid(child, 0)[1]


def kill_at_a_file(number, when):
    """Let this process be killed before or after it puts its file of that number (from 1) in its place."""
    replace, seen = os.replace, []

    def replaced(source, target):
        seen.append(target)
        if len(seen) < number or when == "after":
            replace(source, target)
        if len(seen) == number:
            os.kill(os.getpid(), signal.SIGKILL)

    os.replace = replaced


def work_and_kill(folder):
    """Do the study in folder/calm and, killed and begun again, in folder/killed; print the number of kills.

    Both are done in folder/work, whose name some results have in them.
    """
    for module in IMPORTED:
        importlib.import_module(module)
    sys.modules["torch"].set_num_threads(1)
    here = folder / "work"
    assert status_of(here) == 0
    here.rename(folder / "calm")
    for count in range(MOST):
        status = status_of(here, MOMENTS[count % len(MOMENTS)])
        if status == 0:
            here.rename(folder / "killed")
            print(count)
            return
        assert os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL, f"process {count}: status {status}"
    raise AssertionError(f"{MOST} processes, and no end")


if __name__ == "__main__":
    work_and_kill(Path(sys.argv[1]))
