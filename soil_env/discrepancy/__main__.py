"""Find where simulation and measurement disagree, name the missing effect, add it, and show the gap shrink.

Reads a table of steady points of a wheel and what is known beforehand of wheel, soil and sensors. The base model is
calibrated to the table; where it disagrees is said; every effect of the catalogue is refitted together with the soil
and judged on held-out conditions; what is missing is named, or said to be undecided, unlisted, or nothing. The
conclusion is printed, and written into DIR: report.html to read and to mail, report.json, and model.yaml, the
corrected model, which gymnasium.make("SoilWheel-v0", model=...) simulates. A table whose signs or units cannot be
right is refused; what looks wrong there is said before everything else.

DATA.csv (SI units; a cell is left empty where nothing was measured):

    slip,load,speed,pass,sinkage,drawbar_pull,torque
    0.10,120,0.05,1,0.0211,2.35,4.02
    0.25,120,0.05,1,0.0224,11.9,5.86
    0.45,120,0.05,1,0.0263,21.4,7.41

  slip          (r w - V)/(r w) when driving, (r w - V)/V when braking, in [-1, 1]; required
  load          [N] normal to the ground, or vertical where the setup says so; required
  sinkage [m], drawbar_pull [N], torque [N m]: measured, at least one of them
  speed         [m/s] of travel
  pass          1 = fresh soil
  grade_deg     [deg] uphill positive
  run, time [s]: what tells repeats apart

An effect shows only where its condition varies: rates need several speeds, multipass several passes.

setup.yaml:

    wheel: {radius: 0.15, width: 0.12}             # m; grouser_height: optional, 0 = smooth
    soil:
      density: 1600                                # kg/m3; a number is known and not fitted
      friction_angle_deg: {value: 30, sd: 1.5}     # a prior: fitted, and held to this as far as the data allow
      cohesion: {value: 3700, sd: 700}             # Pa
      # left out: shear_modulus [m], sinkage_exponent, sinkage_coefficient [N/m^(n+2)] (or k_c and k_phi): fitted
    noise: {sinkage: 0.0009, drawbar_pull: 0.7, torque: 0.1}   # 1-sigma; left out = from repeats, else fitted
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from soil_env._io.commands import command_line, folder, label, leave, table_parser, whole_number
from soil_env.discrepancy.report import FILES, show
from soil_env.discrepancy.report.sentences import summary
from soil_env.discrepancy.workflow import run

NAME = "soil_env.discrepancy"


@command_line(NAME, interrupted="nothing written")
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = _parser().parse_args(arguments)
    with _progress(options.quiet) as say:
        report = run(options.data, options.setup, options.out, seed=options.seed, progress=say)
    if options.quiet:
        first = f"CHECK FIRST: {' '.join(report.doubts)} " if report.doubts else ""
        print(f"{report.verdict}: {first}{summary(report)}")
    else:
        show(report, Console(width=None if sys.stdout.isatty() else 100))
        for name in FILES:
            print(f"written: {Path(options.out) / name}")
    sys.stdout.flush()
    return 0


@contextmanager
def _progress(quiet: bool):
    """Shows the progress of `run`: a spinner on a terminal, a line for each stage elsewhere (stderr)."""
    if quiet:
        yield lambda text: None
    elif sys.stderr.isatty():
        with Progress(
            SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), console=Console(stderr=True),
            transient=True,
        ) as shown:  # fmt: skip
            task = shown.add_task("reading", total=None)
            yield lambda text: shown.update(task, description=text)
    else:
        yield _stages()


def _stages() -> Callable[[str], None]:
    said = [""]

    def say(text: str) -> None:
        stage = text.partition(":")[0]
        if stage != said[0]:
            said[0] = stage
            print(f"{label(NAME)}: {stage}", file=sys.stderr)

    return say


_WRITTEN = """DIR/report.html (self-contained, with plots), DIR/report.json (the same as data), DIR/model.yaml (the
corrected model)"""
_EXAMPLES = """\
    python -m soil_env.discrepancy examples/data/rig.csv --setup examples/data/rig.setup.yaml --out runs/rig
    python -m soil_env.discrepancy rig.csv --setup rig.setup.yaml --out rig --quiet"""


def _parser() -> argparse.ArgumentParser:
    p = table_parser(NAME, __doc__, _WRITTEN, _EXAMPLES)
    p.add_argument(
        "--out", type=folder, required=True, metavar="DIR", help="folder for the report, made if need be; required"
    )
    p.add_argument(
        "--seed", type=whole_number(), default=0, metavar="N",
        help="of everything random (default 0); same seed, same report",
    )  # fmt: skip
    p.add_argument("--quiet", action="store_true", help="print only the conclusion, in one line")
    return p


if __name__ == "__main__":
    leave(main())
