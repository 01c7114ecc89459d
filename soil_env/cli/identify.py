"""`soil-env identify`."""

from pathlib import Path

import click
from rich.text import Text

from soil_env._io.files import check_own, json_text, write_own
from soil_env.discovery.instrument import ruled_out
from soil_env.identification.table.fit import identify_table
from soil_env.identification.table.report import picture, report_of, text_of
from soil_env.measurement.setup import read_setup
from soil_env.measurement.table import read_table

from .running import console, out_option
from .table_files import table_arguments

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
    ruled_out(known)  # for its errors: `discover` reads the same setup and refuses it
    table = read_table(data, known.wheel, known.ignore_columns)
    if out is not None:
        check_own(out, FILES, (data, setup))
    estimate = identify_table(table, known)
    if out is not None:
        report = json_text(report_of(estimate), indent=2)
        write_own(out, dict(zip(FILES, (report, picture(estimate)), strict=True)))
    console(110).print(Text(text_of(estimate)))
    if out is not None:
        for name in FILES:
            print(f"written: {out / name}")
