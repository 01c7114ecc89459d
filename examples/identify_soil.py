"""Identify a soil from a measurement table, and draw measured and fitted points.

\b
    python examples/identify_soil.py                                  examples/data/single_wheel.csv
    python examples/identify_soil.py my.csv --setup my.yaml --out soil.png

Prints every soil parameter with its 95 % interval; the picture shows measured points and the fit over slip.
"""

from pathlib import Path

import click
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from soil_env.cli.running import leave, run
from soil_env.identification.table import identify_table
from soil_env.measurement.setup import read_setup
from soil_env.measurement.table import read_table

DATA = Path(__file__).parent / "data"


@click.command(help=__doc__)
@click.argument("table", type=Path, default=DATA / "single_wheel.csv")
@click.option("--setup", type=Path, default=DATA / "setup.yaml", help="wheel, noise, prior knowledge of the soil")
@click.option("--out", default="identified.png", help="the picture")
def main(table: Path, setup: Path, out: str) -> None:
    """Identify, print, draw."""
    known = read_setup(setup)
    estimate = identify_table(read_table(table, known.wheel, known.ignore_columns), known)
    for name, found in estimate.parameters.items():
        given = "  (given)" if found.known else ""
        print(f"{name:20s} {found.value:10.4g}  [{found.low:.4g}, {found.high:.4g}] {found.unit}{given}")

    figure, axes = plt.subplots(1, len(estimate.fits), figsize=(4.5 * len(estimate.fits), 3.6), layout="constrained")
    for axis, (name, fit) in zip(axes, estimate.fits.items(), strict=True):
        axis.errorbar(estimate.slip, fit.measured, 1.96 * fit.noise, fmt="o", ms=3, capsize=2, label="measured, 95 %")
        axis.plot(estimate.slip, fit.fitted, "x", label="fitted")
        axis.set(title=name.replace("_", " "), xlabel="slip [-]", ylabel=f"[{fit.unit}]")
    axes[0].legend()
    figure.savefig(out, dpi=130)
    print(f"written: {out}")


if __name__ == "__main__":
    leave(run(main, None, "identify_soil.py"))
