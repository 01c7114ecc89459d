"""The examples run and print their result; those whose library is missing are left out."""

import re
import runpy
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "examples"
#: Script -> (arguments, pattern of the output, module it needs).
RUNS = {
    "own_controller": ("", r"^(FINISHED|ENTRAPPED|STALLED|BOGGED) at \d+\.\d m$", "numpy"),
    "cleanrl_ppo": ("600 8", r"^8192 steps: return -?\d+\.\d\d, \d+ % of 8 finished$", "torch"),
    "sb3_ppo": ("600 8", r"^600 steps: return -?\d+\.\d\d, \d+ % of 8", "stable_baselines3"),
    "sb3_sac": ("600 8", r"^600 steps: return -?\d+\.\d\d, \d+ % of 8", "stable_baselines3"),
    "sb3_td3": ("600 8", r"^600 steps: return -?\d+\.\d\d, \d+ % of 8", "stable_baselines3"),
    "record_bag": ("--steps 200", r"200 sets of readings.*\n.*drive: \d\.\de-0[5-9]", "rosbags"),
}


@pytest.mark.documents
@pytest.mark.parametrize("name", RUNS)
def test_an_example_runs(name, tmp_path, monkeypatch, capsys):
    arguments, said, needs = RUNS[name]
    pytest.importorskip(needs)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *arguments.split()])
    runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
    assert re.search(said, capsys.readouterr().out)
