"""How hard the scenarios are: three controllers that know nothing of the soil, on held-out courses of each scenario.

    python -m benchmarks.difficulty --courses 200

prints a Markdown table, with 95 % intervals (Wilson 1927): the share of courses finished, immobilised and out of time,
mean distance [m] and time [s]. The controllers have their default settings: what is measured is the task, not their
merit.
"""

from __future__ import annotations

import argparse

import numpy as np

from agents.controllers import make_controller
from agents.evaluate.driving import HELD_OUT_SET, run_courses
from agents.evaluate.statistics import wilson
from soil_env.parameters import load_scenario, scenario_names

CONTROLLERS = ("constant_speed", "fixed_slip", "full_throttle")
RATES = ("finished", "immobilised", "time_limit")


def row(scenario: str, controller: str, courses: int) -> str:
    """One row of the table."""
    task = load_scenario(scenario)
    runs = run_courses(make_controller(controller, task), task, HELD_OUT_SET, courses)
    cells = [scenario, controller]
    for name in RATES:
        share = runs.metric(name)
        low, high = wilson(int(share.sum()), courses)
        cells.append(f"{100 * share.mean():.1f} [{100 * low:.1f}, {100 * high:.1f}]")
    cells += [f"{np.mean(runs.distance):.2f}", f"{np.mean(runs.time):.1f}"]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Print the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--courses", type=int, default=200, help="of each scenario (default 200)")
    options = p.parse_args()
    print("| scenario | controller | finished [%] | immobilised [%] | out of time [%] | distance [m] | time [s] |")
    print("|---|---|---|---|---|---|---|")
    for scenario in scenario_names():
        for controller in CONTROLLERS:
            print(row(scenario, controller, options.courses), flush=True)


if __name__ == "__main__":
    main()
