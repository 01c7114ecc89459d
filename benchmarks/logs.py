"""Logs: what the online identifier says of them is judged by the truth; reading of a large bag; one update.

    python -m benchmarks.logs                 60 courses, a bag of 1 GB; renews the tables of docs/logs.md; two minutes
    python -m benchmarks.logs --courses 2 --gigabytes 0.05 --page page.md

Courses of scenario "mixed" with its default action are driven at a constant rim speed, and at one that steps, and are
replayed as logs of the sensors. Judged are the steps whose estimate is current and where the wheel is not halted, by
the ground under it. The table has a log of all readings, and others with one change each.

The bag is an MCAP file as a rover writes it: joint states at 100 Hz, odometry at 50 Hz, a force at 100 Hz, and images
of 1 MB in between (random bytes, chunks of 4 MB without compression). Memory is the largest resident size of a process
of its own, less what it had before it opened the bag.
"""

from __future__ import annotations

import math
import multiprocessing
import tempfile
import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import psutil
import yaml

from agents.controllers import ConstantSpeed
from agents.evaluate import HELD_OUT_SET
from benchmarks.common import ROOT, TORQUE, check_page, machine, machine_text, range_text, renew_page, spread
from benchmarks.drives import QUANTITIES, UNITS, record
from soil_env._io.commands import command_line, command_parser, file_path, leave, whole_number
from soil_env._io.document import Table
from soil_env._io.loading import ParameterError
from soil_env.logs import LogMap, Source, Windows, read_map, read_recording, replay
from soil_env.logs.align import Aligned
from soil_env.logs.mapping import Channels, RoverWheel
from soil_env.online import OnlineIdentifier, Readings, Status
from soil_env.parameters import Scenario, load_scenario

NAME = "benchmarks.logs"
PAGE = ROOT / "docs" / "logs.md"
IMAGE, HERTZ = 1_000_000, 10  # bytes, images a second
ROUNDS, STEPS = 7, 2000  # of the updates that are timed
#: Logs: (whether the rim speed steps, readings that are left out, control periods from one reading to the next).
LOGS = {
    "all readings, 10 Hz, stepped speed": (True, (), 1),
    "no slip": (True, ("slip",), 1),
    "no motor torque": (True, ("motor_torque",), 1),
    "2 Hz": (True, (), 5),
    "constant speed": (False, (), 1),
    "all four": (False, ("slip", "motor_torque"), 5),
}
_READ = ("slip", "sinkage", "drawbar_pull", "load", "torque", "speed", "wheel_speed", "pitch", "motor_torque",
         "acceleration")  # in the order of `SensorReading`  # fmt: skip
_CHANNELS = {
    "wheel_speed": {"topic": "/joint_states", "field": "velocity[wheel]"},
    "torque": {"topic": "/joint_states", "field": "effort[wheel]"},
    "speed": {"topic": "/odom", "field": "twist.twist.linear.x"},
    "sinkage": {"constant": 0.02},
    "drawbar_pull": {"topic": "/wrench", "field": "wrench.force.x"},
}


# --- drives as logs ---------------------------------------------------------------------------------------------------


class SteppedSpeed(ConstantSpeed):
    """A rim speed that is held for 2.5 s, and then another."""

    name = "stepped_speed"
    shares, hold = np.array([0.33, 0.6, 0.47, 0.8]), 2.5  # of the top rim speed; [s]

    def rim_speed(self, observation, state):
        """The speed of this period [m/s], [n]."""
        t = state["time"] = np.where(state["fresh"], 0.0, state.get("time", 0.0) + self.period)
        return self.top_speed * self.shares[(t / self.hold).astype(int) % self.shares.size]


def log_of(
    driven: dict[str, np.ndarray], scenario: Scenario, without: tuple[str, ...] = (), every: int = 1
) -> tuple[Aligned, LogMap]:
    """A drive of `record` as a log, with its map: one reading in `every` control periods, some readings left out."""
    rows, wheel, noise = driven["readings"][every - 1 :: every], scenario.wheel, scenario.noise
    period, twist = every * scenario.control.period, scenario.weight * wheel.radius
    unit = {"drawbar_pull": scenario.weight, "load": scenario.weight, "torque": twist, "motor_torque": twist}
    readings = {name: rows[:, k].copy() for k, name in enumerate(_READ) if name not in without}
    readings["wheel_speed"] /= wheel.radius
    readings["sinkage"][np.abs(readings["sinkage"]) > wheel.radius] = math.nan  # as of a recording
    rover = RoverWheel(**{f.name: getattr(wheel, f.name) for f in fields(RoverWheel)})
    sources = {name: Source(column=name, sd=getattr(noise, name) * unit.get(name, 1.0)) for name in readings}
    log_map = LogMap(
        rover, Channels(**sources), period=period, gravity=scenario.gravity, relaxation=scenario.relaxation,
        belief=replace(scenario.belief, spread=scenario.belief.spread or scenario.spread),
        windows=Windows(duration=max(1.0, 4.0 * period)),
    )  # fmt: skip
    return Aligned(0, period * np.arange(len(rows)), readings, {}, period), log_map


def _published(values: dict[str, np.ndarray], gain: float) -> np.ndarray:
    """(Estimate, its sd) [2, T, 5] in the units of `QUANTITIES`; `gain` is that of the belief."""
    v = values
    estimate = [v["friction_angle_deg"], np.log(v["shear_modulus"]), np.log(v["sinkage_coefficient"]),
                1e-3 * v["cohesion"], np.log(v["dig_gain"] / gain)]  # fmt: skip
    sd = [v["friction_angle_sd_deg"], v["shear_modulus_relative_sd"], v["sinkage_coefficient_relative_sd"],
          1e-3 * v["cohesion_sd"], v["dig_gain_relative_sd"]]  # fmt: skip
    return np.stack([np.column_stack(estimate), np.column_stack(sd)])


def judged(scenario: Scenario, drives: list[dict], without: tuple[str, ...], every: int) -> tuple[list[tuple], float]:
    """Cells of the table for each of `QUANTITIES` but the pull, and the share of the steps with a current estimate."""
    errors, sds, priors, steps = [], [], [], 0
    for driven in drives:
        log, log_map = log_of(driven, scenario, without, every)
        found = replay(log, log_map)
        moving = driven["halt_left"][every - 1 :: every] == 0.0
        kept = moving & (found.status == Status.CONVERGED)
        truth = (driven["truth"] * UNITS)[every - 1 :: every, :5]
        prior = {n: np.array([getattr(found.prior, n)]) for n in found.values if hasattr(found.prior, n)}
        estimate, sd = _published(found.values, log_map.belief.dig_gain)
        errors.append((estimate - truth)[kept])
        sds.append(sd[kept])
        priors.append((_published(prior, log_map.belief.dig_gain)[0] - truth)[kept])
        steps += int(moving.sum())
    error, sd, prior = np.concatenate(errors), np.concatenate(sds), np.concatenate(priors)
    away, rows = np.abs(error) / sd, []
    for i, name in enumerate(QUANTITIES[:5]):
        sizes = (error[:, i].mean(), math.sqrt(np.mean(error[:, i] ** 2)), math.sqrt(np.mean(prior[:, i] ** 2)))
        held = (np.mean(away[:, i] <= 0.994), np.mean(away[:, i] <= 1.96), np.mean(away[:, i] > 3.0))
        rows.append((name, *(f"{x:.2f}" for x in sizes), *(f"{100.0 * x:.0f} %" for x in held)))
    return rows, len(error) / steps


def calibration(courses: int) -> Table:
    """How well the intervals of the identifier hold the truth on the drives of `LOGS`."""
    scenario, rows = load_scenario("mixed"), []
    drives = {c: record(c(scenario), scenario, courses, HELD_OUT_SET) for c in (SteppedSpeed, ConstantSpeed)}
    for name, (stepped, without, every) in LOGS.items():
        cells, share = judged(scenario, drives[SteppedSpeed if stepped else ConstantSpeed], without, every)
        current = f"{100.0 * share:.0f} %"
        rows += [(name if k == 0 else "", current if k == 0 else "", *row) for k, row in enumerate(cells)]
    header = ("log", "current", "quantity", "bias", "RMS", "RMS of the prior", "in 68 %", "in 95 %", "beyond 3 sd")
    return Table(header, rows)


# --- a large bag, an update -------------------------------------------------------------------------------------------


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


def updates() -> np.ndarray:
    """Seconds [ROUNDS, STEPS] of single updates, compiled before; the slips vary so that most points are new."""
    scenario = load_scenario("mixed", TORQUE)
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
    p.add_argument("--courses", type=whole_number(1), default=60, help="that are driven and replayed (default 60)")
    p.add_argument("--page", type=file_path, default=PAGE, help="whose tables are renewed (default docs/logs.md)")
    options = p.parse_args(arguments)
    if not 0.001 <= options.gigabytes <= 100.0:
        raise ParameterError(f"--gigabytes {options.gigabytes:g}: expected a size from 0.001 to 100")
    check_page(options.page, "calibration", "bag")
    table = calibration(options.courses).markdown()
    print(table)
    each = 1e6 * updates()
    median, high = np.median(each, axis=1), np.percentile(each, 99, axis=1)
    lines = [
        f"{machine_text(machine(), 'numpy', 'numba')}.",
        f"One update takes {range_text(spread(median), 1)} us (median of {each.shape[1]} calls, and lowest and highest "
        f"of {len(each)} rounds; compiled before); 99 % take less than {range_text(spread(high), 1)} us.",
    ]
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
    lines.append(
        f"A bag of {size / 1e9:.2f} GB with {messages:,} messages ({steps:,} steps) was read in {seconds:.1f} s. It "
        f"took at most {grown:.0f} MB more memory than the {before:.0f} MB from before it was opened."
    )
    print("\n".join(lines))
    renew_page(options.page, {"calibration": table, "bag": "\n".join(lines)})
    return 0


if __name__ == "__main__":
    leave(main())
