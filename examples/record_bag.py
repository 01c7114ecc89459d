"""Record a drive of SoilWheel-v0 into a ROS 2 bag (MCAP) with standard messages, read it back, and
identify the soil.

The bag has the messages of a rover: JointState (wheel speed, torque), Odometry (travel speed),
WrenchStamped (drawbar pull, load), Imu (orientation, acceleration), Range (hub to ground) and
Float64 (slip, motor torque). The estimates from the bag agree with those of the drive to three
digits. `soil-env logs BAG --map MAP --out DIR` reads it too and writes a report. Needs
`pip install "soil_env[logs]"`, no ROS.

    python examples/record_bag.py    writes drive/ (the bag) and drive.map.yaml
    soil-env logs drive --map drive.map.yaml --out drive.report
"""

import argparse
import contextlib
import math
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import yaml

from soil_env.logs import read_map, read_recording, replay
from soil_env.parameters import to_dict

try:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    raise SystemExit("record_bag.py needs the extra logs: pip install 'soil_env[logs]'") from None

STORE = get_typestore(Stores.ROS2_JAZZY)
T = STORE.types
CHANNELS = {
    "wheel_speed": {"topic": "/joint_states", "field": "velocity[wheel]", "unit": "rad/s"},
    "torque": {"topic": "/joint_states", "field": "effort[wheel]", "unit": "N m"},
    "speed": {"topic": "/odom", "field": "twist.twist.linear.x", "unit": "m/s"},
    "drawbar_pull": {"topic": "/wheel/wrench", "field": "wrench.force.x", "unit": "N"},
    "load": {"topic": "/wheel/wrench", "field": "wrench.force.z", "unit": "N"},
    "pitch": {"topic": "/imu", "field": "orientation", "unit": "quaternion"},
    "slip": {"topic": "/wheel/slip", "field": "data"},
    "motor_torque": {"topic": "/motor/torque", "field": "data", "unit": "N m"},
    "acceleration": {"topic": "/imu", "field": "linear_acceleration.x", "unit": "m/s2"},
}


class Recorder:
    """Writer of a bag into the new folder `path`; the caller closes `writer` at the end."""

    def __init__(self, path: Path, storage: StoragePlugin = StoragePlugin.MCAP) -> None:
        self.writer = Writer(path, version=9, storage_plugin=storage)
        self.writer.open()
        self.connections = {}

    def write(self, topic: str, seconds: float, kind: str, *values) -> None:
        """Write one message of the type `kind` to a topic, recorded at the time `seconds`.

        `values`: fields of the type in their order, without the header. Of the types that are used
        here all but Float64 have one, which is stamped with the same time.
        """
        nanoseconds = round(seconds * 1e9)
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=STORE)
        if kind != "std_msgs/msg/Float64":
            stamp = T["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9)
            values = (T["std_msgs/msg/Header"](stamp, "wheel"), *values)
        data = STORE.serialize_cdr(T[kind](*values), kind)
        self.writer.write(self.connections[topic], nanoseconds, data)

    def readings(self, seconds: float, reading: dict[str, float], radius: float) -> None:
        """Write one set of readings in SI units as messages, the sinkage as the height of a hub
        above the ground for a wheel of this radius [m].
        """
        vector = T["geometry_msgs/msg/Vector3"]
        quaternion = T["geometry_msgs/msg/Quaternion"]
        none = np.zeros(0)
        zero = vector(0.0, 0.0, 0.0)
        speed = np.array([reading["wheel_speed"]])
        torque = np.array([reading["torque"]])
        self.write(
            "/joint_states", seconds, "sensor_msgs/msg/JointState", ["wheel"], none, speed, torque
        )
        pose = T["geometry_msgs/msg/Pose"](
            T["geometry_msgs/msg/Point"](0.0, 0.0, 0.0), quaternion(0.0, 0.0, 0.0, 1.0)
        )
        twist = T["geometry_msgs/msg/Twist"](vector(reading["speed"], 0.0, 0.0), zero)
        self.write(
            "/odom",
            seconds,
            "nav_msgs/msg/Odometry",
            "wheel",
            T["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
            T["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
        )
        force = T["geometry_msgs/msg/Wrench"](
            vector(reading["drawbar_pull"], 0.0, reading["load"]), zero
        )
        self.write("/wheel/wrench", seconds, "geometry_msgs/msg/WrenchStamped", force)
        # REP 103: a positive rotation about y, to the left, is nose down.
        half = -0.5 * reading["pitch"]
        up = quaternion(0.0, math.sin(half), 0.0, math.cos(half))
        unknown = np.array([-1.0, *[0.0] * 8])  # "not measured" of sensor_msgs/Imu
        felt = vector(reading["acceleration"], 0.0, 0.0)
        self.write(
            "/imu",
            seconds,
            "sensor_msgs/msg/Imu",
            up,
            np.zeros(9),
            zero,
            unknown,
            felt,
            np.zeros(9),
        )
        height = radius - reading["sinkage"]
        # Older releases of the message have no variance.
        older = "variance" not in T["sensor_msgs/msg/Range"].__dataclass_fields__
        self.write(
            "/range",
            seconds,
            "sensor_msgs/msg/Range",
            0,
            0.1,
            0.0,
            2.0,
            height,
            *(() if older else (0.0,)),
        )
        self.write("/wheel/slip", seconds, "std_msgs/msg/Float64", reading["slip"])
        self.write("/motor/torque", seconds, "std_msgs/msg/Float64", reading["motor_torque"])


def drive(recorder: Recorder, seed: int, steps: int):
    """Drive the course of a seed for at most `steps` control periods and record the readings.

    Return (the scenario, the estimate of the environment after each step, as `info["estimate"]`).
    """
    env = gymnasium.make(
        "soil_env:SoilWheel-v0", scenario="mixed", action="torque", scaled=False
    ).unwrapped
    names = env.observation_names
    scenario = env.scenario
    weight = scenario.weight
    radius = scenario.wheel.radius
    top = radius * scenario.wheel.no_load_speed
    unit = {  # SI units of 1 in the entry of the observation
        "slip": 1.0,
        "sinkage": radius,
        "drawbar_pull": weight,
        "load": weight,
        "torque": weight * radius,
        "speed": top,
        "rim_speed": top,
        "pitch": 1.0,
        "motor_torque": weight * radius,
        "acceleration": scenario.gravity,
    }
    env.reset(seed=seed)
    online = []
    for step in range(1, steps + 1):
        # The command swings, so that the slip does: one slip alone identifies little.
        observation, _, terminated, truncated, info = env.step([0.35 + 0.2 * math.sin(0.15 * step)])
        reading = {
            name: scale * float(observation[names.index(name)]) for name, scale in unit.items()
        }
        reading["wheel_speed"] = reading.pop("rim_speed") / radius
        recorder.readings(step * scenario.control.period, reading, radius)
        online.append(info["estimate"])
        if terminated or truncated:
            break
    return scenario, online


def map_of(scenario) -> str:
    """Text of the map (YAML) of a bag that was recorded in a scenario.

    It has the wheel, the sensors and the belief of the scenario. Each channel has the standard
    deviation of its white noise in SI units.
    """
    wheel = scenario.wheel
    noise = scenario.noise
    weight = scenario.weight
    # A belief without a spread of its own has that of the scenario.
    belief = replace(scenario.belief, spread=scenario.belief.spread or scenario.spread)
    sd = {
        "wheel_speed": noise.wheel_speed,
        "speed": noise.speed,
        "slip": noise.slip,
        "pitch": noise.pitch,
        "drawbar_pull": noise.drawbar_pull * weight,
        "load": noise.load * weight,
        "torque": noise.torque * weight * wheel.radius,
        "sinkage": noise.sinkage,
        "motor_torque": noise.motor_torque * weight * wheel.radius,
        "acceleration": noise.acceleration,
    }
    depth = {"topic": "/range", "field": "range", "unit": "m", "sign": -1, "offset": wheel.radius}
    channels = {
        name: {**source, "sd": sd[name]} for name, source in {**CHANNELS, "sinkage": depth}.items()
    }
    rover = {
        n: getattr(wheel, n)
        for n in ("radius", "width", "body_mass", "inertia", "stall_torque", "no_load_speed")
    }
    same = {
        "period": scenario.control.period,
        "gravity": scenario.gravity,
        "relaxation": scenario.relaxation,
    }
    return yaml.safe_dump(
        {"wheel": rover, "channels": channels, **same, "belief": to_dict(belief)}, sort_keys=False
    )


def main() -> None:
    """Record a drive and write its map beside the bag; read it back, identify the soil from it, and
    print how far the estimates are from those of the drive.
    """
    p = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("--seed", type=int, default=0, help="seed of the course")
    p.add_argument("--steps", type=int, default=600, help="control periods at most")
    p.add_argument(
        "--out", type=Path, default=Path("drive"), help="folder of the bag, which must not exist"
    )
    options = p.parse_args()
    if options.out.exists():
        p.error(f"--out {options.out}: exists: expected the folder of a new bag")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    recorder = Recorder(options.out)
    with contextlib.closing(recorder.writer):
        scenario, online = drive(recorder, options.seed, options.steps)
    place = options.out.with_name(options.out.name + ".map.yaml")
    place.write_text(map_of(scenario), encoding="utf-8")
    log_map = read_map(place)
    found = replay(read_recording(options.out, log_map), log_map)
    worst = 0.0
    for name, values in found.values.items():
        if name in online[0]:
            given = np.array([e[name] for e in online])
            worst = max(
                worst, float(np.max(np.abs(values - given) / np.maximum(np.abs(given), 1e-9)))
            )
    print(
        f"{len(online)} sets of readings; phi {found.values['friction_angle_deg'][-1]:.2f} deg at "
        "the end"
    )
    print(
        f"largest relative difference of an estimate from the bag to that of the drive: {worst:.1e}"
    )


if __name__ == "__main__":
    main()
