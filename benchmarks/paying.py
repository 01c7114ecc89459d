"""Knowledge of the identifier along a drive, and the return of a plain bonus for every gain of it.

Knowledge is that of the reward term `information` (`task.knowledge`, nat). A bonus for every gain of it could be earned
again and again where an identifier can be made to start anew: `Rocking` hardly leaves its place and tries.

    python -m benchmarks.paying --controllers 'soft_start,rocking=benchmarks.paying:Rocking,ppo=runs/paid_1/seed_*'

CONTROLLERS as of `python -m agents.evaluate`; several models of one name are averaged.
"""

from __future__ import annotations

import numpy as np

from agents.evaluate.contestants import parse
from agents.evaluate.driving import HELD_OUT_SET, drive
from agents.evaluate.loading import load
from benchmarks.common import TORQUE
from soil_env._io.commands import command_line, command_parser, leave, whole_number
from soil_env._io.document import Table
from soil_env.identification.online.identifier import identifier_numbers
from soil_env.parameters import Scenario, load_scenario
from soil_env.simulation.task import knowledge


class Rocking:
    """Torque forwards and backwards in turn, a second each."""

    variant = "blind"
    share, periods = 0.5, 10  # of the stall torque; control periods one way

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        """Actions [n, 1]; `state` counts the control periods."""
        step = 0 if state is None else state
        sign = 1.0 if (step // self.periods) % 2 == 0 else -1.0
        return np.full((len(observation), 1), sign * self.share, dtype=np.float32), step + 1


def along(controller, scenario: Scenario, courses: int) -> dict[str, float]:
    """{"mean", "highest", "gained" [nat], "distance" [m]}, means over held-out courses.

    "mean" is over the time of a course, "gained" the sum of all rises.
    """
    precision = identifier_numbers(scenario).precision
    last, highest, gained, total, steps = np.zeros((5, courses))
    for w, alive in drive(controller, scenario, HELD_OUT_SET, 0, courses, threads=1):
        known = np.array([knowledge(w.ids, k, precision) for k in range(courses)])
        gained += np.where(alive, np.maximum(known - last, 0.0), 0.0)
        highest = np.where(alive, np.maximum(highest, known), highest)
        total += np.where(alive, known, 0.0)
        steps += alive
        last = known
    found = {"mean": total / steps, "highest": highest, "gained": gained, "distance": w.state["best_x"]}
    return {name: float(values.mean()) for name, values in found.items()}


@command_line("benchmarks.paying")
def main(arguments: list[str] | None = None) -> int:
    """Print the table; returns the exit status."""
    p = command_parser("python -m benchmarks.paying", __doc__)
    p.add_argument("--controllers", required=True)
    p.add_argument("--scenario", default="mixed")
    p.add_argument("--courses", type=whole_number(1), default=200)
    options = p.parse_args(arguments)
    scenario, found = load_scenario(options.scenario, TORQUE), {}
    for one in parse(options.controllers).values():
        found.setdefault(one.name, []).append(along(load(one, scenario), scenario, options.courses))
    keys = ("mean", "highest", "gained", "distance")
    rows = [(name, *(f"{np.mean([run[key] for run in runs]):.2f}" for key in keys)) for name, runs in found.items()]
    header = ("controller", "knowledge [nat]", "at its highest", "gained in all", "distance [m]")
    print(Table(header, rows).markdown())
    return 0


if __name__ == "__main__":
    leave(main())
