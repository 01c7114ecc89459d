"""Reading of a large bag, and one update of the online identifier: time and memory.

    python -m benchmarks.logs                 writes a bag of 1 GB, reads it, times the identifier; a minute or two
    python -m benchmarks.logs --gigabytes 0.05

The bag is an MCAP file as a rover writes it: joint states at 100 Hz, odometry at 50 Hz, a force at 100 Hz, and images
of 1 MB in between (random bytes, chunks of 4 MB without compression). Memory is the largest resident size of a process
of its own, less what it had before it opened the bag.
"""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
import yaml

from benchmarks.common import TORQUE, machine, machine_text, range_text, spread
from soil_env._io.commands import command_line, command_parser, leave
from soil_env._io.document import Table
from soil_env._io.loading import ParameterError
from soil_env.logs import read_map, read_recording
from soil_env.online import OnlineIdentifier, Readings
from soil_env.parameters import load_scenario

NAME = "benchmarks.logs"
IMAGE, HERTZ = 1_000_000, 10  # bytes, images a second
ROUNDS, STEPS = 7, 2000  # of the updates that are timed
_CHANNELS = {
    "wheel_speed": {"topic": "/joint_states", "field": "velocity[wheel]"},
    "torque": {"topic": "/joint_states", "field": "effort[wheel]"},
    "speed": {"topic": "/odom", "field": "twist.twist.linear.x"},
    "sinkage": {"constant": 0.02},
    "drawbar_pull": {"topic": "/wrench", "field": "wrench.force.x"},
}


def write_bag(path: Path, gigabytes: float) -> int:
    """Write the bag; the number of its messages."""
    from mcap.writer import CompressionType, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    T, rng, messages = store.types, np.random.default_rng(0), 0
    vector = T["geometry_msgs/msg/Vector3"]
    zero, none = vector(0.0, 0.0, 0.0), np.zeros(0)
    still = T["geometry_msgs/msg/Pose"](
        T["geometry_msgs/msg/Point"](0.0, 0.0, 0.0), T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    )
    kinds = {
        "/joint_states": "sensor_msgs/msg/JointState",
        "/odom": "nav_msgs/msg/Odometry",
        "/wrench": "geometry_msgs/msg/WrenchStamped",
        "/camera": "sensor_msgs/msg/CompressedImage",
    }
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=4_000_000, compression=CompressionType.NONE)
        writer.start("ros2", "benchmarks.logs")
        channels = {}
        for topic, kind in kinds.items():
            text, _ = store.generate_msgdef(kind, ros_version=2)
            schema = writer.register_schema(kind, "ros2msg", text.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)

        def put(topic: str, at: int, *values) -> None:
            nonlocal messages
            stamp = T["builtin_interfaces/msg/Time"](at // 10**9, at % 10**9)
            message = T[kinds[topic]](T["std_msgs/msg/Header"](stamp, ""), *values)
            writer.add_message(channels[topic], at, bytes(store.serialize_cdr(message, kinds[topic])), at)
            messages += 1

        for k in range(round(gigabytes * 1e9 / IMAGE * 100 / HERTZ)):
            at = 10**9 + k * 10**7
            put("/joint_states", at, ["wheel"], none, np.array([2.0]), np.array([5.0 + rng.normal()]))
            put("/wrench", at, T["geometry_msgs/msg/Wrench"](vector(14.0 + rng.normal(), 0.0, 147.0), zero))
            if k % 2 == 0:
                twist = T["geometry_msgs/msg/Twist"](vector(0.25, 0.0, 0.0), zero)
                put(
                    "/odom", at, "wheel", T["geometry_msgs/msg/PoseWithCovariance"](still, np.zeros(36)),
                    T["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
                )  # fmt: skip
            if k % (100 // HERTZ) == 0:
                put("/camera", at, "jpeg", np.frombuffer(rng.bytes(IMAGE), np.uint8))
        writer.finish()
    return messages


def read(bag: Path, map_file: Path, out) -> None:
    """In a process of its own: read, and tell steps, seconds and MB."""
    log_map, process = read_map(map_file), psutil.Process()
    read_recording(bag.parent / "small.mcap", log_map)  # imports and all that is made once
    before = peak = process.memory_info().rss

    def look(done: int, size: int) -> None:
        nonlocal peak
        peak = max(peak, process.memory_info().rss)

    start = time.perf_counter()
    log = read_recording(bag, log_map, look)
    out.put((len(log), time.perf_counter() - start, (peak - before) / 1e6, before / 1e6))


def updates(method: str) -> np.ndarray:
    """Seconds [ROUNDS, STEPS] of single updates, compiled before; the slips vary so that most points are new."""
    scenario = load_scenario("mixed", {**TORQUE, "belief": {"method": method}})
    identifier, rng = OnlineIdentifier.of_scenario(scenario), np.random.default_rng(0)
    slip = 0.35 + 0.3 * np.sin(0.1 * np.arange(STEPS)) + 0.01 * rng.normal(size=STEPS)
    readings = [
        Readings(
            2.0, 0.3 * (1.0 - i), 0.02 + 0.02 * i + 1e-3 * e, 40.0 * i, 147.0, 3.0 + 8.0 * i, i, 0.0, 3.0 + 8.0 * i,
            40.0 * i / 15.0, 0.1 * k,
        )
        for k, (i, e) in enumerate(zip(slip.tolist(), rng.normal(size=STEPS).tolist(), strict=True))
    ]  # fmt: skip
    out = np.empty((ROUNDS, STEPS))
    for r in range(-1, ROUNDS):
        identifier.reset()
        for k, reading in enumerate(readings):
            start = time.perf_counter()
            identifier.update(reading)
            out[r, k] = time.perf_counter() - start
    return out


@command_line(NAME)
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    p = command_parser(f"python -m {NAME}", __doc__)
    p.add_argument("--gigabytes", type=float, default=1.0, help="size of the bag (default 1)")
    options = p.parse_args(arguments)
    if not 0.001 <= options.gigabytes <= 100.0:
        raise ParameterError(f"--gigabytes {options.gigabytes:g}: expected a size from 0.001 to 100")
    print(machine_text(machine(), "numpy", "numba"))
    for method in ("filter", "window"):
        each = 1e6 * updates(method)
        median, mean, high = np.median(each, axis=1), np.mean(each, axis=1), np.percentile(each, 99, axis=1)
        print(f"update, {method}, {len(each)} rounds of {each.shape[1]}: median {range_text(spread(median), 1)} us, "
              f"mean {range_text(spread(mean), 1)} us, 99 % below {range_text(spread(high), 1)} us")  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        bag, map_file = Path(folder) / "large.mcap", Path(folder) / "map.yaml"
        map_file.write_text(yaml.safe_dump({"wheel": "planetary_rover", "channels": _CHANNELS}), encoding="utf-8")
        write_bag(bag.with_name("small.mcap"), 0.01)
        messages = write_bag(bag, options.gigabytes)
        size = bag.stat().st_size
        context = multiprocessing.get_context("spawn")
        out = context.Queue()
        child = context.Process(target=read, args=(bag, map_file, out))
        child.start()
        steps, seconds, grown, before = out.get()
        child.join()
    row = (f"{size / 1e9:.2f} GB", messages, steps, f"{seconds:.1f}", f"{size / 1e6 / seconds:.0f}", f"{grown:.0f}")
    header = ("bag", "messages", "steps", "seconds", "MB a second", "MB above the start")
    print(Table(header, [row], f"resident before: {before:.0f} MB").text())
    return 0


if __name__ == "__main__":
    leave(main())
