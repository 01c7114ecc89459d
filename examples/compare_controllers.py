"""Compare controllers on the same held-out courses, and draw their rates with 95 % intervals.

    python examples/compare_controllers.py
    python examples/compare_controllers.py --scenario field_vehicle --courses 1000 --out compared.png

The slip and speed controllers are tuned first, on courses of their own. The picture shows how often each controller
gets stuck and how often it finishes. `soil-env evaluate` does the same for trained agents and for classes of
your own, with resume, many processes and a report.
"""

import argparse
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from soil_env import ParameterError
from soil_env.parameters import DEFAULT_SCENARIO, load_scenario
from soil_env_agents.controllers import CONTROLLERS, make_controller
from soil_env_agents.evaluate import HELD_OUT_SET, run_courses, wilson
from soil_env_agents.evaluate.tuning import tuned_settings


def main() -> None:
    """Drive, print, draw."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scenario", default=DEFAULT_SCENARIO, help="name or YAML file")
    p.add_argument("--courses", type=int, default=200)
    p.add_argument("--out", default="compared.png", help="the picture")
    p.add_argument("--tuning-courses", type=int, default=30, help="to tune each controller on (default: 30)")
    options = p.parse_args()
    for name in ("courses", "tuning_courses"):
        if getattr(options, name) < 1:
            p.error(f"--{name.replace('_', '-')} {getattr(options, name)}: expected at least 1")

    scenario = load_scenario(options.scenario)
    settings, _ = tuned_settings(scenario, options.tuning_courses)
    figure, axes = plt.subplots(1, 2, figsize=(9, 3), sharey=True, layout="constrained")
    for y, name in enumerate(CONTROLLERS):
        controller = make_controller(name, scenario, **settings.get(name, {}))
        runs = run_courses(controller, scenario, HELD_OUT_SET, options.courses)
        for axis, metric in zip(axes, ("immobilised", "finished"), strict=True):
            share = runs.metric(metric).mean()
            low, high = wilson(runs.metric(metric).sum(), options.courses)
            axis.errorbar(100 * share, y, xerr=[[100 * (share - low)], [100 * (high - share)]], fmt="o", capsize=3)
            axis.set(xlabel=f"{metric} [% of courses]", xlim=(0, 100))
        stuck, done = (runs.metric(m).mean() for m in ("immobilised", "finished"))
        print(f"{name:22s} immobilised {stuck:6.1%}   finished {done:6.1%}   return {runs.returns.mean():6.2f}")
    axes[0].set_yticks(range(len(CONTROLLERS)), CONTROLLERS)
    figure.savefig(options.out, dpi=130)
    print(f"written: {options.out}")


if __name__ == "__main__":
    try:
        main()
    except (ParameterError, OSError) as error:
        print(f"compare_controllers.py: error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
