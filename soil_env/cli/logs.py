"""`soil-env logs`."""

import sys
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn

from soil_env._io.files import check_own, drop_own, write_own
from soil_env.logs.mapping import read_map
from soil_env.logs.recordings import read_recording
from soil_env.logs.replay import replay
from soil_env.logs.report import ALWAYS, report_of
from soil_env.logs.steady import FILES, steady_windows

from .running import PATH, out_option


@click.command("logs")
@click.argument("recording", type=PATH, metavar="RECORDING")
@click.option(
    "--map", "map_file", type=PATH, metavar="YAML", required=True, help="Channel of each reading."
)
@out_option(
    "report.html, log.json, estimates.csv, figures and tables of steady points", required=True
)
def command(recording: Path, map_file: Path, out: Path) -> None:
    """Identify the soil along the log of a rover.

    RECORDING is a ROS 2 bag (folder, .mcap or .db3), an MCAP file with JSON messages, or a CSV or
    Parquet file with a column of time stamps.

    \b
    MAP.yaml:
        wheel: {radius: 0.15, width: 0.15, body_mass: 15, inertia: 0.5}
        channels:
          wheel_speed:  {topic: /joint_states, field: "velocity[front_left]", unit: rad/s}
          speed:        {topic: /odom, field: twist.twist.linear.x}
          drawbar_pull: {topic: /wheel/wrench, field: wrench.force.x, unit: N}
          motor_torque: {topic: /motor, field: "effort[0]", unit: A,
                         motor_constant: 0.05, gear: 246}

    wheel_speed, and speed or slip, are required. A table takes `column: NAME` in place of topic and
    field, and `time: {column: t, unit: s}` at the top. All keys: docs/guide/logs.md.
    """
    log_map = read_map(map_file)
    check_own(out, (*ALWAYS, "steady.csv", "setup.yaml"), (recording, map_file))
    with Progress(
        TextColumn("reading"),
        BarColumn(),
        DownloadColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    ) as progress:
        task = progress.add_task("reading", total=None)
        log = read_recording(
            recording,
            log_map,
            lambda done, size: progress.update(task, completed=done, total=size),
        )
    found = replay(log, log_map)
    steady = steady_windows(log, log_map, found.ground)
    files, text = report_of(recording.name, log, log_map, found, steady, out)
    check_own(out, files, (recording, map_file))  # now with the tables of the grounds found
    write_own(out, files)
    # Tables that an earlier run wrote and this one did not.
    drop_own(out, {p.name for p in out.iterdir() if FILES.fullmatch(p.name)} - set(files))
    print(text, end="")
