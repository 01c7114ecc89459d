"""Read the log of a rover: wheel readings on one time axis, steady points, and the soil over time.

RECORDING is a ROS 2 bag (its folder, or one .mcap or .db3 file; no ROS is needed), any MCAP file with ROS 2 or JSON
messages, or a CSV or Parquet file with a column of time stamps. A recording that was cut off gives what is whole.

map.yaml says which reading is where:

    wheel: {radius: 0.15, width: 0.15, body_mass: 15, inertia: 0.5}  # m, m, kg on it, kg m2; or a preset's name
    channels:
      wheel_speed:  {topic: /joint_states, field: "velocity[front_left]", unit: rad/s}
      speed:        {topic: /odom, field: twist.twist.linear.x}          # m/s, of travel: visual odometry, not wheels
      sinkage:      {topic: /sinkage, field: range, sign: -1, offset: 0.15, sd: 0.002}  # hub to ground: radius - range
      drawbar_pull: {topic: /wheel/wrench, field: wrench.force.x, unit: N}
      load:         {topic: /wheel/wrench, field: wrench.force.z}
      motor_torque: {topic: /motor, field: "effort[0]", unit: A, motor_constant: 0.05, gear: 246, efficiency: 0.8}
      pitch:        {topic: /imu, field: orientation, unit: quaternion}  # uphill positive

  wheel_speed, and speed or slip, are required; sinkage, drawbar_pull or acceleration, torque or motor_torque, load and
  pitch as far as they are measured: the report says what is missing. A table has column: NAME in place of
  topic and field, and at the top time: {column: t, unit: s} (or ms, us, ns, iso). constant: 147 is a reading that
  never changes. unit, sign (1 or -1), offset (SI, added last), gear (turns of the motor to one of the wheel) and sd
  (1-sigma, in unit) may be left out. A motor_torque counts only where inertia (rotor and gear included) is known.
  clock: header (default; time stamps in the messages) or log; period: 0.1 (s, of the time axis and the identifier);
  max_gap: 0.5 (s, over which readings are interpolated); gravity, relaxation, belief: {...} (the prior of the
  identifier), windows: {...} (what is steady), soil: {...} (copied to setup.yaml): see docs/logs.md
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn

from soil_env._io.commands import command_line, command_parser, file_path, folder, leave
from soil_env._io.files import check_outputs, replace_files
from soil_env.logs.grounds import FILES, advice, commands, grounds
from soil_env.logs.mapping import read_map
from soil_env.logs.recordings import read_recording
from soil_env.logs.replay import findings, replay
from soil_env.logs.report import ALWAYS, channel_table, contents, ground_table, soil_table, summary
from soil_env.logs.steady import steady_windows

NAME = "soil_env.logs"
_WRITTEN = """\
files written into DIR: report.html (self-contained, with plots), log.json (the same as data), estimates.csv (the
soil, its standard deviations, drawbar margin and status at each step), estimates.png, readings.png, and, where
there are steady stretches, steady.csv and setup.yaml for soil-env identify and discover; where the soil
changes on the way, ground1.csv, ground1.yaml and so on, one pair for each ground that has points of two slips

examples:

    soil-env logs drive.mcap --map map.yaml --out runs/drive
    soil-env identify runs/drive/steady.csv --setup runs/drive/setup.yaml"""


@command_line(NAME)
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = _parser().parse_args(arguments)
    log_map = read_map(options.map)
    check_outputs(options.out, (*ALWAYS, "steady.csv", "setup.yaml"))
    with _progress() as progress:
        log = read_recording(options.recording, log_map, progress)
    found = replay(log, log_map)
    steady = steady_windows(log, log_map, found.ground)
    files = contents(options.recording.name, log, log_map, found, steady)
    replace_files(options.out, files)
    for place in options.out.iterdir():
        if FILES.fullmatch(place.name) and place.name not in files and place.is_file():  # of an earlier run
            place.unlink()
    parts = grounds(found, steady)
    print(summary(log))
    for line in log.doubts:
        print(f"check first: {line}")
    print(channel_table(log).text(2))
    print(soil_table(found).text(2))
    if len(parts) > 1:
        print(ground_table(parts).text(2))
    for line in (*findings(found, log), *advice(found, parts, steady)):
        print(f"- {line}")
    for line in (*log.notes, *found.warnings):
        print(f"! {line}")
    for name in files:
        print(f"written: {options.out / name}")
    for line in commands(parts, steady, options.out):
        print(f"next: {line}")
    sys.stdout.flush()
    return 0


def _parser():
    p = command_parser(f"python -m {NAME}", __doc__, _WRITTEN)
    p.add_argument("recording", metavar="RECORDING", type=file_path, help="bag (folder, .mcap, .db3), .csv or .parquet")
    p.add_argument("--map", metavar="YAML", type=file_path, required=True, help="which reading is where; required")
    p.add_argument("--out", metavar="DIR", type=folder, required=True, help="folder, made if need be; required")
    return p


@contextmanager
def _progress() -> Iterator[Callable[[int, int], None]]:
    """Shows how much is read, on a terminal (stderr)."""
    columns = (TextColumn("reading"), BarColumn(), DownloadColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as shown:
        task = shown.add_task("reading", total=None)
        yield lambda done, size: shown.update(task, completed=done, total=size)


if __name__ == "__main__":
    leave(main())
