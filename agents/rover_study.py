"""Compare the controllers of a rover with PPO agents that know nothing of the soil, identify it, or are told it.

Trains each agent with several seeds, tunes the controllers on courses of their own, and drives all of them over the
same held-out courses. Trainings that are done, and trials of the tuning, are kept in OUT: the same command goes on.

Examples:
    python -m agents.rover_study --rover mars_rover --out runs/mars
    python -m agents.rover_study --rover lunar_micro_rover --out runs/lunar --seeds 3 --timesteps 1e6
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Mapping
from pathlib import Path

from soil_env._io.commands import command_line, folder, leave, whole_number
from soil_env._io.document import renewed
from soil_env._io.files import make_folder, replace_file, write_json
from soil_env._io.loading import config_dir, read_yaml
from soil_env.vehicle import DEFAULT_ROVER, RoverScenario, load_rover

from .cli import manual_parser
from .config import NAMES, TrainConfig, load_config
from .evaluate import HELD_OUT_SET
from .evaluate.models import load_model
from .evaluate.tables import cell
from .evaluate.tuning import shown_on
from .extras import needing
from .progress import Bar, show
from .rover import comparing

NAME = f"{__package__}.rover_study"

_FILES = """
OUT holds a run folder for each agent, settings.jsonl (trials of the tuning, until it is done), and
  comparison.json, .csv   every controller, all metrics with 95 % intervals, all paired differences
  comparison.md           the table, and what is told by the differences on the same courses
"""


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    p = manual_parser(f"python -m {NAME}", __doc__, _FILES, usage=f"python -m {NAME} --out OUT [options]")
    p.add_argument("--rover", default=DEFAULT_ROVER, help=f"name of a rover, or a YAML file; {DEFAULT_ROVER}")
    p.add_argument("--out", required=True, type=folder, help="folder of the study")
    p.add_argument("--seeds", type=whole_number(1), default=3, help="training seeds of each agent; 3")
    p.add_argument("--timesteps", type=whole_number(1), default=1_000_000, help="of each training; 1e6")
    p.add_argument("--courses", type=whole_number(1), default=1000, help="held-out courses; 1000")
    p.add_argument("--page", metavar="MD", help="page whose part `comparison` is renewed; JSON beside it")
    p.add_argument("--tuning_courses", type=whole_number(1), default=200, help="of each trial; 200")
    return p


def configs(rover: str, out: Path, seeds: int, timesteps: int) -> dict[str, list[TrainConfig]]:
    """{agent: the training of each seed}, with the hyperparameters of configs/rover.yaml."""
    path = config_dir() / "rover.yaml"
    ppo = load_config(read_yaml(path), str(path)).ppo
    return {
        name: [
            TrainConfig(
                rover=rover, observation=variant, seed=seed, timesteps=timesteps, runs=str(out), name=f"{name}_{seed}",
                ppo=ppo,
            )
            for seed in range(seeds)
        ]
        for variant, name in NAMES.items()
    }  # fmt: skip


def run(rover: str, out: Path, seeds: int, timesteps: int, courses: int, tuning_courses: int) -> dict:
    """The study; its result, which is written to `out` too."""
    from . import training  # needs the extra `train`, which --help does not

    trainings = configs(rover, out, seeds, timesteps)
    scenario = training.scenario_of(trainings[NAMES["blind"]][0])
    assert isinstance(scenario, RoverScenario)
    agents = {
        name: [load_model(training.trained(config, scenario), scenario) for config in own]
        for name, own in trainings.items()
    }
    settings = comparing.tuned_settings(scenario, tuning_courses, log=out / "settings.jsonl")
    drivers = {name: [one] for name, one in comparing.controllers(scenario, settings).items()} | agents
    with Bar("Comparing", courses * sum(map(len, drivers.values())), "courses") as bar:
        runs = comparing.driven(drivers, scenario, HELD_OUT_SET, courses, shown_on(bar))
    result = comparing.comparison(scenario, HELD_OUT_SET, runs, tuning_courses, settings)
    comparing.save(result, out)
    replace_file(out / "comparison.md", page(result) + "\n")
    return result


def page(result: Mapping) -> str:
    """The table in Markdown, and the differences that a reader asks for first."""
    rows, paired = result["controllers"], result["paired"]
    head = ["controller", *(c.heading for c in comparing.COLUMNS)]
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for name, metrics in rows.items():
        seeds = result["members"][name]
        label = f"{name} ({seeds} seeds)" if seeds > 1 else name
        cells = [cell(metrics[c.metric], c.factor, c.digits, bounds=c.bounds) for c in comparing.COLUMNS]
        lines.append("| " + " | ".join([label, *cells]) + " |")
    lines.append("")
    for a, b in _ASKED:
        if a in paired and b in paired:
            d = paired[a][b]
            finished = cell(d["finished"], 100.0, 1, sign=True)
            energy, force = (
                cell(d["energy_per_metre"], digits=1, sign=True),
                cell(d["wheel_force"], digits=1, sign=True),
            )
            lines.append(
                f"- {a} less {b}, on the same courses: finished {finished} points, energy {energy} J/m, wheel force "
                f"{force} points, fighting {cell(d['fighting'], digits=3, sign=True)} points"
            )
    return "\n".join(lines)


_ASKED = (
    ("soft_start", "equal_speed"),
    ("velocity_sync", "soft_start"),
    ("slip_limiter", "soft_start"),
    ("torque_by_load", "soft_start"),
    ("best_slip_identified", "soft_start"),
    ("best_slip_identified", "equal_speed"),
    ("best_slip_true", "best_slip_identified"),
    ("ppo_identified", "best_slip_identified"),
    ("ppo_identified", "ppo_blind"),
    ("ppo_true", "ppo_identified"),
)


@command_line(NAME)
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    options = parser().parse_args(arguments)
    with needing("train", NAME):
        importlib.import_module(".training", __package__)
    out = options.out
    load_rover(options.rover)  # refuses what is none
    make_folder(out)
    if options.page:
        renewed(Path(options.page).read_text(encoding="utf-8"), {"comparison": ""}, options.page)
    result = run(
        options.rover, out, options.seeds, options.timesteps, options.courses, options.tuning_courses
    )  # fmt: skip
    if options.page:
        part = {"comparison": page(result)}
        replace_file(Path(options.page), renewed(Path(options.page).read_text(encoding="utf-8"), part, options.page))
        write_json(Path(options.page).with_suffix(".json"), result)
    show(*comparing.table(result), f"Written to {out}: comparison.json, comparison.csv, comparison.md")
    return 0


if __name__ == "__main__":
    leave(main())
