"""Arguments of commands that read a measurement table, and the description of its files."""

import inspect
from collections.abc import Callable

import click

from .running import PATH

#: Text of --help; `\\b` keeps the lines of a paragraph as they are.
FILES = """
\b
DATA.csv, SI units, an empty cell was not measured:
    slip,load,sinkage,drawbar_pull,torque
    0.10,120,0.0211,2.35,4.02
    0.25,120,0.0204,11.9,5.86

\b
SETUP.yaml:
    wheel: {radius: 0.15, width: 0.12}
    soil:
      cohesion: 1500                           # Pa: known
      friction_angle_deg: {value: 30, sd: 3}   # a prior; a missing key is fitted
    noise: {sinkage: 0.0003, drawbar_pull: 0.7, torque: 0.1}   # missing: estimated

All columns and keys: docs/guide/tables.md.
"""


def table_arguments(command: Callable) -> Callable:
    """Decorator: add the argument DATA.csv and the option --setup; append `FILES` to the help."""
    command.__doc__ = f"{inspect.cleandoc(command.__doc__ or '')}\n{FILES}"
    command = click.option(
        "--setup", type=PATH, metavar="YAML", required=True, help="Wheel, soil, noise."
    )(command)
    return click.argument("data", type=PATH, metavar="DATA.csv")(command)
