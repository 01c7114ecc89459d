"""`soil-env identify`."""

import json
import sys
from pathlib import Path

import click
from rich.console import Console
from rich.text import Text

from soil_env._io.files import check_own, write_own
from soil_env.cli.running import out_option
from soil_env.cli.table_files import table_arguments
from soil_env.discovery.instrument import exact
from soil_env.identification.table.fit import identify_table
from soil_env.identification.table.report import picture, report_of, text_of
from soil_env.measurement.setup import read_setup
from soil_env.measurement.table import read_table

FILES = ("identification.json", "identification.png")


@click.command("identify")
@out_option("identification.json and identification.png")
@table_arguments
def command(data: Path, setup: Path, out: Path | None) -> None:
    """Identify a soil from a table of steady points.

    Fits friction angle, shear deformation modulus K, sinkage coefficient S, sinkage exponent n and
    cohesion, as far as they are not known. Prints estimates with 95 % intervals, correlations, and
    what the data cannot determine.
    """
    known = read_setup(setup)
    exact(known)  # refuses what `discover` would
    table = read_table(data, known.wheel, known.ignore_columns)
    if out is not None:
        check_own(out, FILES, (data, setup))
    estimate = identify_table(table, known)
    if out is not None:
        contents = (
            json.dumps(report_of(estimate), indent=2, allow_nan=False) + "\n",
            picture(estimate),
        )
        write_own(out, dict(zip(FILES, contents, strict=True)))
    Console(width=None if sys.stdout.isatty() else 110).print(Text(text_of(estimate)))
    if out is not None:
        for name in FILES:
            print(f"written: {out / name}")
