"""Commands that are killed with SIGKILL and begun again, many times, give what they give undisturbed, to the byte."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not hasattr(os, "fork"), reason="fork and SIGKILL")]
ROOT = Path(__file__).resolve().parents[2]


def killed(name, folder, least):
    """{file: content} of the undisturbed work and of the one that was killed, at least `least` times."""
    command = [sys.executable, "-m", "tests.agents.killing", name, str(folder)]
    env = {**os.environ, "MPLBACKEND": "Agg"}
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout.split()[-1]) >= least
    return [
        {f.relative_to(part).as_posix(): f.read_bytes() for f in sorted(part.rglob("*")) if f.is_file()}
        for part in (folder / "calm", folder / "killed")
    ]


def test_study(tmp_path):
    """TensorBoard's logs and Optuna's journals apart; of a model the weights."""
    calm, again = killed("study", tmp_path, 8)
    calm, again = (
        {f: c for f, c in files.items() if "/tensorboard/" not in f and not f.startswith("tuned/")}
        for files in (calm, again)
    )
    assert sorted(calm) == sorted(again)
    assert {"study.json", "study.md", "study.png", "cells/mixed-true_soil-0.json"} <= set(calm)
    for file in calm:
        if file.endswith("model.zip"):
            first, second = (zipfile.ZipFile(tmp_path / part / file) for part in ("calm", "killed"))
            assert first.read("policy.pth") == second.read("policy.pth"), file
        else:
            assert calm[file] == again[file], file


def test_blind(tmp_path):
    """Times apart."""
    calm, again = killed("blind", tmp_path, 3)
    assert {"study.json", "discovery.md", "truth/none-few-10-000.json"} <= set(calm)
    assert sorted(calm) == sorted(again)
    for file in calm:
        if file.startswith(("cases/", "truth/")):
            assert calm[file] == again[file], file
        elif file.startswith("answers/bic/"):
            assert timeless(calm[file]) == timeless(again[file]), file


def timeless(content):
    """Answer without the time that it took."""
    return {key: value for key, value in json.loads(content).items() if key != "seconds"}
