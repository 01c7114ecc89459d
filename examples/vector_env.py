"""Many wheels in one call: the end of each course under a constant torque.

\b
    python examples/vector_env.py
    python examples/vector_env.py --wheels 4096 --steps 2000

Prints the steps a second and the causes of the ends, and draws the places of the ends. Under a constant torque hardly
any wheel finishes.
"""

import time
from collections import Counter

import click
import gymnasium
import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from soil_env.cli.running import leave, run
from soil_env.simulation.task import Cause


@click.command(help=__doc__)
@click.option("--wheels", default=512)
@click.option("--steps", default=1000, help="of every wheel")
@click.option("--out", default="vector_env.png", help="the picture")
def main(wheels: int, steps: int, out: str) -> None:
    """Step, count, draw."""
    envs = gymnasium.make_vec(
        "soil_env:SoilWheel-v0", wheels, "vector_entry_point", observation="blind", action="torque"
    )
    envs.reset(seed=0)
    actions = np.linspace(0.2, 0.8, wheels, dtype=np.float32)[:, None]  # share of the stall torque
    ends, start = [], time.perf_counter()
    for _ in range(steps):
        _, _, terminated, truncated, info = envs.step(actions)
        for k in np.flatnonzero(terminated | truncated):
            ends.append((actions[k, 0], info["x"][k], Cause(info["cause"][k]).name))
    rate = wheels * steps / (time.perf_counter() - start)
    print(f"{rate:,.0f} steps a second; courses that ended: {dict(Counter(cause for _, _, cause in ends))}")

    figure, axis = plt.subplots(figsize=(6, 3.5), layout="constrained")
    for cause in sorted({cause for _, _, cause in ends}):
        at = np.array([(torque, x) for torque, x, c in ends if c == cause])
        axis.plot(at[:, 0], at[:, 1], ".", ms=3, label=cause.lower().replace("_", " "))
    axis.set(xlabel="motor torque [of stall torque]", ylabel="end of the course [m]")
    figure.legend(loc="outside right upper")
    figure.savefig(out, dpi=130)
    print(f"written: {out}")


if __name__ == "__main__":
    leave(run(main, None, "vector_env.py"))
