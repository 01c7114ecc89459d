"""What an info costs: steps a second with each value of the keyword `info`, over those with the full one.

    python -m benchmarks.infos                       prints the table, half a minute
    python -m benchmarks.infos --page docs/env.md    and puts it into the page

Every round drives all of them in turn, under a constant torque from the same seeds; a ratio is that of one round, of
the processor time.
"""

from __future__ import annotations

import time
from pathlib import Path

import gymnasium
import numpy as np

from benchmarks.common import check_page, range_text, renew_page, spread
from soil_env._io.commands import command_line, command_parser, leave, whole_number
from soil_env._io.document import Table
from soil_env.driving.infos import INFOS

KINDS = (("8 single wheels in gymnasium's SyncVectorEnv", "sync", 8), ("64 wheels in the native vector environment",
         "vector_entry_point", 64))  # fmt: skip


def seconds(kind: str, mode: str, wheels: int, steps: int) -> float:
    """Processor time of `steps` steps."""
    env = gymnasium.make_vec("soil_env:SoilWheel-v0", wheels, mode, info=kind, action="torque")
    env.reset(seed=0)
    action = np.full((wheels, 1), 0.35, dtype=np.float32)
    env.step(action)
    start = time.process_time()
    for _ in range(steps):
        env.step(action)
    return time.process_time() - start


def ratios(mode: str, wheels: int, steps: int, rounds: int) -> dict[str, dict[str, float]]:
    """{value of info: spread over the rounds of the rate over that of "full"}."""
    times = [{kind: seconds(kind, mode, wheels, steps) for kind in INFOS} for _ in range(rounds)]
    return {kind: spread([t["full"] / t[kind] for t in times]) for kind in INFOS}


@command_line("benchmarks.infos")
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    p = command_parser("python -m benchmarks.infos", __doc__)
    p.add_argument("--steps", type=whole_number(1), default=300, help="a round (default: 300)")
    p.add_argument("--rounds", type=whole_number(1), default=9, help="default: 9")
    p.add_argument("--page", type=Path, metavar="MD", help="put the result between the markers of this page")
    options = p.parse_args(arguments)
    if options.page is not None:
        check_page(options.page, "infos")
    rows = []
    for name, mode, wheels in KINDS:
        found = ratios(mode, wheels, options.steps, options.rounds)
        rows.append((name, *(range_text(found[kind]) for kind in INFOS)))
    caption = f"Steps a second over those with the full info (lowest and highest of {options.rounds} rounds)"
    text = Table(("", *(f'`info="{kind}"`' for kind in INFOS)), rows, caption).markdown()
    if options.page is not None:
        renew_page(options.page, {"infos": text})
    print(text)
    return 0


if __name__ == "__main__":
    leave(main())
