"""Work killed with SIGKILL over and over, and begun again, gives what it gives undisturbed, to the byte.

`python -m tests.agents.test_killing NAME FOLDER` does the work. Each of its processes is a fork of that one, which has
imported all that the work imports and started no thread: a fork of a process with threads may crash. It is killed where
it puts a file in its place (`os.replace`), before or after that.
"""

import importlib
import json
import os
import signal
import subprocess
import sys
import traceback
import zipfile
from pathlib import Path

import pytest

from soil_env.cli import main as soil_env

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not hasattr(os, "fork"), reason="fork and SIGKILL")]
ROOT = Path(__file__).resolve().parents[2]
MOST = 120  # processes
MOMENTS = ((1, "after"), (2, "before"), (2, "after"), (6, "before"), (5, "after"))  # of a process, in files; in turn


def small_study(folder):
    """A study whose trainings begin anew after a kill."""
    from tests.agents.test_study import config

    own = {"num_envs": 4, "n_steps": 16, "batch_size": 32, "n_epochs": 1, "layer": 4}
    train = {"timesteps": 192, "student": 0, "ppo": own}
    (folder.parent / "config").mkdir(exist_ok=True)
    path = config(folder.parent / "config", train=train, courses=3, seeds=1)
    assert soil_env(["study", "--config", str(path), "--out", str(folder)]) == 0


def discovery(folder):
    """Three small cases of `benchmarks.discovery`, drawn, answered and scored."""
    main = importlib.import_module("benchmarks.discovery.__main__").main
    groups = [f"--group={name}" for name in ("none-few-10", "one-few-10", "one-poor-10")]
    assert main(["run", "--entrant", "bic", "--seed", "100007", "--limit", "30", *groups, "--out", str(folder)]) == 0


WORK = {  # name: (work, what it imports, least number of kills, some of its files)
    "study": (small_study, ("optuna", "torch", "soil_env_agents.study.command", "soil_env_agents.training"), 8,
              {"study.json", "study.md", "study.png", "cells/mixed-true_soil-0.json"}),
    "discovery": (discovery, ("benchmarks.discovery.__main__",), 3,
                  {"study.json", "discovery_laws.json", "truth/none-few-10-000.json"}),
}  # fmt: skip


@pytest.mark.parametrize("name", WORK)
def test_killed_work_gives_what_calm_work_gives(name, tmp_path):
    command = [sys.executable, "-m", "tests.agents.test_killing", name, str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr[-2000:]
    *_, kills, some = WORK[name]
    assert int(done.stdout.split()[-1]) >= kills
    calm, killed = tmp_path / "calm", tmp_path / "killed"
    assert files(calm) == files(killed) >= some
    for file in files(calm):
        if name == "study" or file.startswith(("cases/", "truth/", "answers/bic/")):  # the others hold times
            assert content(calm / file) == content(killed / file), file


def files(folder):
    """Names of the files, the logs of TensorBoard and Optuna apart."""
    found = (f.relative_to(folder) for f in folder.rglob("*") if f.is_file())
    return {f.as_posix() for f in found if not {"tensorboard", "tuned"} & set(f.parts)}


def content(file):
    """Content that has to be the same: of a model the weights, of an answer all but the time that it took."""
    if file.name == "model.zip":
        return zipfile.ZipFile(file).read("policy.pth")
    if file.parent.name == "bic":
        return {key: value for key, value in json.loads(file.read_text()).items() if key != "seconds"}
    return file.read_bytes()


def status_of(work, folder, moment=None):
    """Status, as of `os.waitpid`, of a forked process that does `work`, killed at a moment of `MOMENTS`."""
    child = os.fork()
    if child == 0:
        try:
            if moment:
                kill_at_a_file(*moment)
            work(folder)
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


def work_and_kill(name, folder):
    """Do the work in folder/calm and, killed and begun again, in folder/killed; print the number of kills.

    Both are done in folder/work, whose name some results have in them.
    """
    work, imports, *_ = WORK[name]
    for module in imports:
        importlib.import_module(module)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
    here = folder / "work"
    assert status_of(work, here) == 0
    here.rename(folder / "calm")
    for count in range(MOST):
        status = status_of(work, here, MOMENTS[count % len(MOMENTS)])
        if status == 0:
            here.rename(folder / "killed")
            print(count)
            return
        assert os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL, f"process {count}: status {status}"
    raise AssertionError(f"{MOST} processes, and no end")


if __name__ == "__main__":
    work_and_kill(sys.argv[1], Path(sys.argv[2]))
