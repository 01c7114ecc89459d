"""`soil-env identify`; the code of docs/identify.md."""

import json
import subprocess
import sys
from pathlib import Path

from soil_env.cli import main
from tests.identification.test_table import EXAMPLE, NAMES

ROOT = Path(__file__).resolve().parents[2]


def test_command_line(tmp_path):
    command = [sys.executable, "-m", "soil_env.cli", "identify", str(EXAMPLE / "single_wheel.csv")]
    command += ["--setup", str(EXAMPLE / "setup.yaml"), "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=EXAMPLE.parent.parent)
    assert done.returncode == 0, done.stderr
    for word in ("friction angle", "95 % interval", "Correlation", "drawbar pull", "identification.png"):
        assert word in done.stdout
    assert "\x1b" not in done.stdout and done.stderr == ""
    report = json.loads((tmp_path / "out" / "identification.json").read_text())
    assert set(report["parameters"]) == {*NAMES, "reference_pressure"} and len(report["slip"]) == 18
    assert 0.0 < report["parameters"]["friction_angle_deg"]["sd_over_prior"] < 1.0
    assert (tmp_path / "out" / "identification.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert len(list((tmp_path / "out").iterdir())) == 2


def test_command_line_refuses_in_one_line(tmp_path, capsys):
    data, out = tmp_path / "data.csv", tmp_path / "out"
    data.write_text("slip,load,sinkage\n0.1,100,30\n")
    assert main(["identify", str(data), "--setup", str(EXAMPLE / "setup.yaml"), "--out", str(out)]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and "row 2, sinkage = 30" in said.err and not out.exists()
