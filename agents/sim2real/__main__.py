"""Does a model corrected from the rover's own log make better controllers?

An environment whose world has an effect that nobody was told of plays the rover. It is driven over a commissioning
course, its log becomes a measurement table, `soil_env.discrepancy` says what the simulation lacks, and what it named is
added to the simulation. Controllers tuned and PPO trained on the uncorrected and on the corrected simulation are then
compared in the hidden world, on the same held-out courses.

Example:
  python -m agents.sim2real --world configs/worlds/bulldozing.yaml configs/worlds/grousers.yaml --out runs/sim2real

Interrupted or killed, it goes on where it was with the same command. OUT then holds sim2real.json, sim2real.md and
sim2real.png, and for each world its table, the report of the workflow and the corrected model.
"""

from __future__ import annotations

import argparse
import importlib

from soil_env._io.commands import command, command_line, folder, label, leave, whole_number
from soil_env.parameters import DEFAULT_SCENARIO, load_scenario

from ..cli import as_options, manual_parser
from ..extras import needing
from ..progress import show
from . import report, study

_NAME = __package__

_EPILOG = """files:
  YAML               model.yaml of a hidden world: `effects:` of the catalogue, `residual:`; see configs/worlds
  OUT/sim2real.*     .json, .md and .png: the comparison over all worlds
  OUT/worlds/WORLD/  table, report of the workflow, corrected model, what was tuned and trained on it

With its defaults it trains for hours: begin with --timesteps 100000 --courses 100 --tuning-courses 20."""


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    default = {f: study.Study.__dataclass_fields__[f].default for f in _NUMBERS}
    p = manual_parser(command(_NAME), __doc__, _EPILOG)
    p.add_argument("--world", metavar="YAML", nargs="+", required=True, help="model.yaml of each hidden world")
    p.add_argument("--out", metavar="OUT", type=folder, required=True, help="folder of the results")
    p.add_argument("--scenario", metavar="NAME", default=DEFAULT_SCENARIO,
                   help=f"name or YAML file (default: {DEFAULT_SCENARIO})")  # fmt: skip
    for name, text in _NUMBERS.items():
        p.add_argument(f"--{name.replace('_', '-')}", metavar="N", type=whole_number(), default=default[name],
                       help=f"{text} (default: {default[name]})")  # fmt: skip
    return p


_NUMBERS = {
    "seed": "of drives, training and bootstraps",
    "timesteps": "environment steps of each PPO training",
    "training_seeds": "PPO trainings of each arm",
    "logs": "logs of drives in each world; controllers are made from the first",
    "courses": "held-out courses",
    "tuning_courses": "courses that the classical controllers are tuned on",
}


@command_line(_NAME, interrupted="go on with the same command", memory="fewer --courses")
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 2 bad input, 130 interrupted."""
    options = parser().parse_args(arguments)
    with needing("train", label(_NAME)):
        importlib.import_module("..training", __package__)  # takes seconds, which --help need not
    scenario = load_scenario(options.scenario)
    worlds = study.read_worlds(options.world, scenario)
    with as_options():
        asked = study.Study(scenario=scenario, worlds=worlds, **{name: getattr(options, name) for name in _NUMBERS})
    study.begin(asked, options.out)
    study.run(asked, options.out, show)
    result = report.result(asked, options.out)
    written = report.write(asked, result, options.out)
    report.print_table(result)
    show(f"Written to {options.out}: {', '.join(written)}")
    return 0


if __name__ == "__main__":
    leave(main())
