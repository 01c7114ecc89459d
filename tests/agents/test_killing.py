"""Work killed with SIGKILL over and over gives what it gives undisturbed, to the byte."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not hasattr(os, "fork"), reason="fork and SIGKILL")]
ROOT = Path(__file__).resolve().parents[2]
WORK = {  # name: (least number of kills, some of its files)
    "study": (8, {"study.json", "study.md", "study.png", "cells/mixed-true_soil-0.json"}),
    "discovery": (3, {"study.json", "discovery.md", "truth/none-few-10-000.json"}),
}


@pytest.mark.parametrize("name", WORK)
def test_killed_work_gives_what_calm_work_gives(name, tmp_path):
    command = [sys.executable, "-m", "tests.agents.killing", name, str(tmp_path)]
    env = {**os.environ, "MPLBACKEND": "Agg"}
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr[-2000:]
    kills, some = WORK[name]
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
