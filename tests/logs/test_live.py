"""The example of a live identifier behind stdin."""

import io
import json
import re
import runpy
import sys
from pathlib import Path

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "live_identifier.py"


def test_the_example_takes_lines_from_stdin_and_leaves_out_bad_ones(monkeypatch, capsys):
    lines = []
    for k in range(60):
        speed, slip = 2.0 + 0.5 * (k // 20), 0.15 + 0.1 * (k // 20)
        reading = {"wheel_speed": speed, "speed": 0.15 * speed * (1.0 - slip), "torque": 5.0 + k // 20, "sinkage": 0.02}
        lines.append(json.dumps(reading | {"time": 0.1 * k}))
    bad = ["no JSON", '{"wheelspeed": 2}', lines[9], "7", "[1, 2]", '{"speed": "fast"}', '{"sinkage": 30}']
    lines[10:10] = bad
    monkeypatch.setattr(sys, "argv", ["live_identifier.py", "--stdin"])
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n".join(lines) + "\n"))
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    said = capsys.readouterr()
    assert "60 sets of readings" in said.out and said.err.count("left out") == len(bad)
    assert len(re.findall(r"^phi [\d.]+ \+- ", said.out, re.MULTILINE)) > 5
