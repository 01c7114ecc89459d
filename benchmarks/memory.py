"""Memory over many steps: the resident size of the process, sampled while environments are stepped.

    python -m benchmarks.memory                                       prints the table, a minute or so
    python -m benchmarks.memory --page docs/reliability.md            and puts it into the page

The vector environment drives 1024 wheels for ten million steps in all, with resets; the single one, with effects on
and a picture now and then, for two hundred thousand. After a tenth of the steps, in which caches fill, memory may not
grow by more than 2 MB.
"""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.common import check_page, renew_page
from soil_env._io.commands import command_line, command_parser, leave
from soil_env._io.document import Table
from soil_env._io.loading import ParameterError, config_dir
from soil_env.env import SoilWheelEnv
from soil_env.vector_env import SoilWheelVectorEnv

SAMPLES = 10
MOST_GROWTH = 2.0  # MB


def resident() -> float:
    """Resident size of this process [MB]."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def sizes(step: Callable[[int], None], steps: int) -> list[float]:
    """Sizes [MB] after each tenth of `steps` calls of `step`, which is told the number of the call in its tenth."""
    out = []
    for _ in range(SAMPLES):
        for number in range(max(1, steps // SAMPLES)):
            step(number)
        out.append(resident())
    return out


def vector(steps: int, wheels: int) -> list[float]:
    """`sizes` over `steps` steps of the wheels of one vector environment."""
    env, rng = SoilWheelVectorEnv(wheels, course={"length": 4.0}), np.random.default_rng(0)
    env.reset(seed=0)
    return sizes(lambda number: env.step(rng.uniform(-0.1, 0.9, (wheels, 1))), steps // wheels)


def single(steps: int) -> list[float]:
    """`sizes` over `steps` steps of one single environment."""
    world, rng = config_dir() / "worlds" / "two_effects.yaml", np.random.default_rng(0)
    env = SoilWheelEnv(model=world, render_mode="rgb_array", course={"length": 4.0})
    env.reset(seed=0)

    def step(number: int) -> None:
        _, _, terminated, truncated, _ = env.step(rng.uniform(-0.1, 0.9, 1))
        if number % 1000 == 0:
            env.render()
        if terminated or truncated:
            env.reset()

    return sizes(step, steps)


def growth(sizes: list[float]) -> float:
    """MB from the first sample to the largest after it."""
    return max(sizes) - sizes[0]


@command_line("benchmarks.memory")
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    p = command_parser(
        "python -m benchmarks.memory", __doc__, status="exit status: 0 flat, 1 not, 2 bad input, 130 interrupted"
    )
    p.add_argument("--share", type=float, default=1.0, help="of the steps, to see that it works (default 1)")
    p.add_argument("--page", type=Path, metavar="MD", help="put the result between the markers of this page")
    options = p.parse_args(arguments)
    if not 0.0 < options.share <= 100.0:
        raise ParameterError(f"--share {options.share}: expected a number in (0, 100]")
    if options.page is not None:
        check_page(options.page, "memory")  # before the work
    counts = round(1e7 * options.share), round(2e5 * options.share)
    samples = {
        f"vector, 1024 wheels, {counts[0]:,} steps": vector(counts[0], 1024),
        f"single, effects and pictures, {counts[1]:,} steps": single(counts[1]),
    }
    header = ("resident size [MB] after each tenth of the steps", "", "growth after the first")
    rows = [(name, ", ".join(f"{s:.1f}" for s in v), f"{growth(v):.1f}") for name, v in samples.items()]
    text = Table(header, rows).markdown()
    if options.page is not None:
        renew_page(options.page, {"memory": text})
    print(text)
    return 0 if all(growth(sizes) <= MOST_GROWTH for sizes in samples.values()) else 1


if __name__ == "__main__":
    leave(main())
