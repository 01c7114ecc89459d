"""Find the effect that the base model lacks in a measurement table, and draw the gap before and after.

    python examples/find_missing_effect.py                            examples/data/rig.csv
    python examples/find_missing_effect.py my.csv --setup my.yaml --out gap.png

Prints the named effect, the probabilities of it and its rivals, and the gap before and after. Writes the corrected
model, model.yaml, beside the picture. `soil-env discover` does the same with a whole report.
"""

import argparse
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from soil_env import ParameterError
from soil_env.discrepancy import run

DATA = Path(__file__).parent / "data"


def main() -> None:
    """Run the workflow, print its verdict, draw the gap."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("table", nargs="?", default=DATA / "rig.csv", help="CSV file")
    p.add_argument("--setup", default=DATA / "rig.setup.yaml", help="wheel, noise, and what is known of the soil")
    p.add_argument("--out", type=Path, default=Path("gap.png"), help="the picture")
    options = p.parse_args()

    report = run(options.table, options.setup)
    print(f"verdict: {report.verdict}")
    for effect in report.effects:
        print(f"  {effect.name}: " + ", ".join(f"{k} = {v.value:.3g}" for k, v in effect.parameters.items()))
    for rank in report.finding.ranking[:3]:
        print(f"  {rank.probability:6.1%}  {rank.name}")
    for channel, gap in report.gap.items():
        print(f"  {channel}: held-out gap {gap.before:.3g} -> {gap.after:.3g}, noise {gap.noise_floor:.3g}")

    table, names = report.problem.data.table, ("sinkage", "drawbar_pull", "torque")
    figure, axes = plt.subplots(1, 3, figsize=(13.5, 3.6), layout="constrained")
    for j, (axis, name) in enumerate(zip(axes, names, strict=True)):
        for held, words in ((report.held_before, "base model"), (report.held_after, "corrected")):
            axis.plot(table.slip, getattr(table, name) - held[:, j], "o", ms=3, label=words)
        axis.axhline(0.0, color="0.5", lw=0.8)
        axis.set(title=name.replace("_", " "), xlabel="slip [-]", ylabel="measured - predicted")
    axes[0].legend()
    figure.savefig(options.out, dpi=130)
    report.model.save(options.out.with_name("model.yaml"))
    print(f"written: {options.out}, {options.out.with_name('model.yaml')}")


if __name__ == "__main__":
    try:
        main()
    except (ParameterError, OSError) as error:
        print(f"find_missing_effect.py: error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
