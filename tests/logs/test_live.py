"""The node of docs/guide/online.md against a stand-in for rclpy; the example behind stdin."""

import io
import json
import re
import sys
from pathlib import Path

import gymnasium
import pytest

import soil_env  # noqa: F401  (registers SoilWheel-v0)

ROOT = Path(__file__).resolve().parents[2]


def drive(steps):
    """Wheel speed, torque, speed and range of a drive."""
    env = gymnasium.make("SoilWheel-v0", scenario="mixed", action="torque", scaled=False).unwrapped
    env.reset(seed=2)
    weight, radius, rows = env.scenario.weight, env.scenario.wheel.radius, []
    top = env.scenario.wheel.no_load_speed
    for step in range(steps):
        o = dict(zip(env.observation_names, env.step([0.3 + 0.2 * (step % 30 < 15)])[0].tolist(), strict=True))
        rows.append((o["rim_speed"] * top, o["torque"] * weight * radius, o["speed"] * top * radius,
                     radius - o["sinkage"] * radius))  # fmt: skip
    return rows


def test_the_example_takes_lines_from_stdin_and_leaves_out_bad_ones(monkeypatch, capsys):
    import runpy

    rows = [dict(zip(("wheel_speed", "torque", "speed", "sinkage"), r, strict=True)) for r in drive(60)]
    lines = [json.dumps(r | {"sinkage": 0.15 - r["sinkage"], "time": 0.1 * k}) for k, r in enumerate(rows)]
    lines[10:10] = ["no JSON", '{"wheelspeed": 2}', lines[9]]
    monkeypatch.setattr(sys, "argv", ["live_identifier.py", "--stdin"])
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n".join(lines) + "\n"))
    runpy.run_path(str(ROOT / "examples" / "live_identifier.py"), run_name="__main__")
    said = capsys.readouterr()
    assert "60 sets of readings" in said.out and said.err.count("left out") == 3
    assert len(re.findall(r"^phi [\d.]+ \+- ", said.out, re.MULTILINE)) > 5


@pytest.mark.parametrize("bad", ["7", "[1, 2]", '{"speed": "fast"}', '{"sinkage": 30}'])
def test_no_line_ends_the_example(bad):
    import runpy

    code = runpy.run_path(str(ROOT / "examples" / "live_identifier.py"))
    good = json.dumps({"wheel_speed": 2.0, "speed": 0.2, "sinkage": 0.02, "torque": 5.0})
    assert code["identify"]([good, bad, good])[0] == 2
