"""The node of docs/guide/online.md against a stand-in for rclpy; the example behind stdin."""

import io
import json
import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import gymnasium
import pytest

import soil_env  # noqa: F401  (registers SoilWheel-v0)
from soil_env.online import OnlineIdentifier, Readings
from soil_env.parameters import wheels

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


class Rclpy(ModuleType):
    """As much of rclpy as the node uses: `spin` delivers the messages of `rows` and calls the timer after each."""

    def __init__(self, rows):
        super().__init__("rclpy")
        self.rows, self.topics, self.said, self.timer = rows, {}, [], None

    def init(self):
        pass

    def create_node(self, name):
        return SimpleNamespace(
            create_subscription=lambda kind, topic, call, depth: self.topics.__setitem__(topic, (kind, call)),
            create_timer=lambda period, call: setattr(self, "timer", (period, call)),
            get_logger=lambda: SimpleNamespace(info=self.said.append),
        )

    def spin(self, node):
        for wheel_speed, torque, speed, distance in self.rows:
            twist = SimpleNamespace(twist=SimpleNamespace(linear=SimpleNamespace(x=speed)))
            for topic, message in {
                "/joint_states": SimpleNamespace(velocity=[wheel_speed], effort=[torque]),
                "/odom": SimpleNamespace(twist=twist),
                "/range": SimpleNamespace(range=distance),
            }.items():
                self.topics[topic][1](message)
            assert self.timer[0] == 0.1
            self.timer[1]()


def test_the_node_of_the_page(monkeypatch):
    page = (ROOT / "docs" / "guide" / "online.md").read_text(encoding="utf-8")
    code = next(c for c in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "rclpy" in c)
    rows = drive(120)
    rclpy = Rclpy(rows)
    monkeypatch.setitem(sys.modules, "rclpy", rclpy)
    for package in ("nav_msgs", "sensor_msgs"):
        messages = ModuleType(f"{package}.msg")
        messages.Odometry = messages.JointState = messages.Range = object
        monkeypatch.setitem(sys.modules, package, ModuleType(package))
        monkeypatch.setitem(sys.modules, f"{package}.msg", messages)
    exec(compile(code, "docs/guide/online.md", "exec"), {})
    identifier = OnlineIdentifier(wheels()["planetary_rover"])
    for wheel_speed, torque, speed, distance in rows:
        e = identifier.update(Readings(wheel_speed, speed, 0.15 - distance, torque=torque))
    assert len(rclpy.said) == 120 and rclpy.said[-1].startswith(f"phi {e.friction_angle_deg:.1f} ")
    assert len(set(rclpy.said)) > 10


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
