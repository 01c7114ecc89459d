"""A study killed with SIGKILL over and over gives what it gives undisturbed, to the byte."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not hasattr(os, "fork"), reason="fork and SIGKILL")]
ROOT = Path(__file__).resolve().parents[2]


def test_study(tmp_path):
    """TensorBoard's logs and Optuna's journals apart; of a model the weights."""
    command = [sys.executable, "-m", "tests.agents.killing", str(tmp_path)]
    env = {**os.environ, "MPLBACKEND": "Agg"}
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout.split()[-1]) >= 8  # kills
    calm, again = ({f.relative_to(tmp_path / part).as_posix(): f.read_bytes() for f in (tmp_path / part).rglob("*")
                    if f.is_file() and not {"tensorboard", "tuned"} & set(f.parts)}
                   for part in ("calm", "killed"))  # fmt: skip
    assert sorted(calm) == sorted(again)
    assert {"study.json", "study.md", "study.png", "cells/mixed-true_soil-0.json"} <= set(calm)
    for file in calm:
        if file.endswith("model.zip"):
            first, second = (zipfile.ZipFile(tmp_path / part / file) for part in ("calm", "killed"))
            assert first.read("policy.pth") == second.read("policy.pth"), file
        else:
            assert calm[file] == again[file], file
