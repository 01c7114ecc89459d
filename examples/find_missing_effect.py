"""Find the effect that the base model lacks in a measurement table, and draw the gap before and after.

\b
    python examples/find_missing_effect.py                            examples/data/rig.csv
    python examples/find_missing_effect.py my.csv --setup my.yaml --out gap.png

Prints the named effect, the probabilities of it and its rivals, and the gap before and after. Writes the corrected
model, model.yaml, beside the picture. `soil-env discover` does the same with a whole report.
"""

from pathlib import Path

import click
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from soil_env import discrepancy
from soil_env.cli.running import leave, run

DATA = Path(__file__).parent / "data"


@click.command(help=__doc__)
@click.argument("table", type=Path, default=DATA / "rig.csv")
@click.option("--setup", type=Path, default=DATA / "rig.setup.yaml", help="wheel, noise, prior knowledge of the soil")
@click.option("--out", type=Path, default=Path("gap.png"), help="the picture")
def main(table: Path, setup: Path, out: Path) -> None:
    """Run the workflow, print its verdict, draw the gap."""
    report = discrepancy.run(table, setup)
    print(f"verdict: {report.verdict}")
    for effect in report.effects:
        print(f"  {effect.name}: " + ", ".join(f"{k} = {v.value:.3g}" for k, v in effect.parameters.items()))
    for rank in report.finding.ranking[:3]:
        print(f"  {rank.probability:6.1%}  {rank.name}")
    for channel, gap in report.gap.items():
        print(f"  {channel}: held-out gap {gap.before:.3g} -> {gap.after:.3g}, noise {gap.noise_floor:.3g}")

    rows, names = report.problem.data.table, ("sinkage", "drawbar_pull", "torque")
    figure, axes = plt.subplots(1, 3, figsize=(13.5, 3.6), layout="constrained")
    for j, (axis, name) in enumerate(zip(axes, names, strict=True)):
        for held, words in ((report.held_before, "base model"), (report.held_after, "corrected")):
            axis.plot(rows.slip, getattr(rows, name) - held[:, j], "o", ms=3, label=words)
        axis.axhline(0.0, color="0.5", lw=0.8)
        axis.set(title=name.replace("_", " "), xlabel="slip [-]", ylabel="measured - predicted")
    axes[0].legend()
    figure.savefig(out, dpi=130)
    report.model.save(out.with_name("model.yaml"))
    print(f"written: {out}, {out.with_name('model.yaml')}")


if __name__ == "__main__":
    leave(run(main, None, "find_missing_effect.py"))
