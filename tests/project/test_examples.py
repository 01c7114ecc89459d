"""The examples run, print their result and draw their picture; those whose library is missing are left out."""

import re
import runpy
import sys
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[2] / "examples"
pytestmark = pytest.mark.documents
RUNS = {  # script -> (arguments, picture, pattern of the output, module it needs)
    "drive_rover": (
        "--rover mars_rover --frame 30 --out rover.png",
        "rover.png",
        r"mars_rover: RUNNING at 0\.\d+ m.*\n  front: slip .*\n  middle: .*\n  rear: .* friction angle \d",
        "pygame",
    ),
    "record_bag": ("--steps 200", "", r"200 sets of readings.*\n.*drive: \d\.\de-0[5-9]", "rosbags"),
    "cleanrl_ppo": ("--steps 4096 --length 16 --courses 4", "", r"same 4 courses: ppo -?\d", "torch"),
}


def run(name, arguments, folder, monkeypatch):
    """Run a script as the command line does, in an empty folder; its exit status."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *arguments.split()])
    try:
        runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
    except SystemExit as end:
        return end.code
    return 0


@pytest.mark.parametrize("name", RUNS)
def test_an_example_runs(name, tmp_path, monkeypatch, capsys):
    arguments, picture, said, needs = RUNS[name]
    pytest.importorskip(needs)
    status = run(name, arguments, tmp_path, monkeypatch)
    out, err = capsys.readouterr()
    assert not status, err
    assert re.search(said, out)
    if picture:
        pixels = matplotlib.image.imread(tmp_path / picture)
        assert min(pixels.shape[:2]) > 200 and np.std(pixels[..., :3]) > 0.02  # something is drawn


def test_a_rover_that_identifies_nothing_is_driven(tmp_path, monkeypatch, capsys):
    (tmp_path / "mine.yaml").write_text((FOLDER.parent / "configs/rovers/field_rover.yaml").read_text().replace(
        "\nbelief: {", "\nbelief: {method: none, "))  # fmt: skip
    assert run("drive_rover", "--rover mine.yaml --frame 3 --out rover.png", tmp_path, monkeypatch) == 0
    assert re.search(r"RUNNING.*\n  front: .*; friction angle not identified\n  rear:", capsys.readouterr().out)
