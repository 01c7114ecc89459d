"""Identify a soil from a measurement table, and draw measured and fitted points.

    python examples/identify_soil.py                                  examples/data/single_wheel.csv
    python examples/identify_soil.py my.csv --setup my.yaml --out soil.png

Prints every soil parameter with its 95 % interval; the picture shows measured points and the fit over slip.
"""

import argparse
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from soil_env import ParameterError
from soil_env.identification.table import identify_table
from soil_env.measurement.setup import read_setup
from soil_env.measurement.table import read_table

DATA = Path(__file__).parent / "data"


def main() -> None:
    """Identify, print, draw."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("table", nargs="?", default=DATA / "single_wheel.csv", help="CSV file")
    p.add_argument("--setup", default=DATA / "setup.yaml", help="wheel, noise, and what is known of the soil")
    p.add_argument("--out", default="identified.png", help="the picture")
    options = p.parse_args()

    setup = read_setup(options.setup)
    estimate = identify_table(read_table(options.table, setup.wheel, setup.ignore_columns), setup)
    for name, found in estimate.parameters.items():
        known = "  (given)" if found.known else ""
        print(f"{name:20s} {found.value:10.4g}  [{found.low:.4g}, {found.high:.4g}] {found.unit}{known}")

    figure, axes = plt.subplots(1, len(estimate.fits), figsize=(4.5 * len(estimate.fits), 3.6), layout="constrained")
    for axis, (name, fit) in zip(axes, estimate.fits.items(), strict=True):
        axis.errorbar(estimate.slip, fit.measured, 1.96 * fit.noise, fmt="o", ms=3, capsize=2, label="measured, 95 %")
        axis.plot(estimate.slip, fit.fitted, "x", label="fitted")
        axis.set(title=name.replace("_", " "), xlabel="slip [-]", ylabel=f"[{fit.unit}]")
    axes[0].legend()
    figure.savefig(options.out, dpi=130)
    print(f"written: {options.out}")


if __name__ == "__main__":
    try:
        main()
    except (ParameterError, OSError) as error:
        print(f"identify_soil.py: error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
