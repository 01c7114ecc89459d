"""Tune the classical controllers on a scenario, as the settings that come with the package were found.

Every controller has the same number of trials (configs/tuning.yaml) on the first N courses of the tuning set, for each
action that the drive may take. OUT then holds NAME.yaml, to be laid into configs/tuned: where it lies there, train.py
and agents.evaluate take the settings from it instead of tuning. Interrupted or killed, the same command goes on.

Example:
  python -m agents.tune --scenario mixed --out tuned
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import get_args, get_type_hints

import yaml

from soil_env._io.commands import command, command_line, folder, leave, whole_number
from soil_env._io.document import Table
from soil_env._io.files import replace_file
from soil_env._io.loading import Checked, ParameterError, quantity, unknown_value
from soil_env.parameters import DEFAULT_SCENARIO, Control, load_scenario

from . import cells
from .cells import code_version
from .cli import as_options, manual_parser
from .evaluate.driving import TUNING_SET
from .evaluate.tuning import load_spaces, tuned_settings
from .progress import show

_NAME = f"{__package__}.tune"
ACTIONS = get_args(get_type_hints(Control)["action"])


@dataclass(frozen=True)
class Tuning(Checked):
    """What is tuned."""

    scenario: str
    actions: tuple[str, ...]
    courses: int = quantity("", 1, 10**6)
    version: str = ""

    def __post_init__(self):
        super().__post_init__()
        for action in self.actions:
            if action not in ACTIONS:
                raise unknown_value(action, ACTIONS, "actions")


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    p = manual_parser(command(_NAME), __doc__)
    p.add_argument("--out", metavar="OUT", type=folder, required=True, help="folder, made where it does not exist")
    p.add_argument(
        "--scenario",
        metavar="NAME",
        default=DEFAULT_SCENARIO,
        help="of configs/scenarios (default: %(default)s)",
    )
    p.add_argument("--actions", metavar="A,B", default=",".join(ACTIONS), help="of the drive (default: all)")
    p.add_argument("--courses", metavar="N", type=whole_number(), default=300, help="tuning courses (default: 300)")
    return p


@command_line(_NAME)
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 2 bad input, 130 interrupted."""
    options = parser().parse_args(arguments)
    name = load_scenario(options.scenario).name
    if name != options.scenario:
        raise ParameterError(f"--scenario {options.scenario}: expected the name of a scenario in configs/scenarios")
    with as_options():
        asked = Tuning(name, tuple(options.actions.split(",")), options.courses, code_version())
    if not cells.is_begun(asked, options.out):
        cells.save_study(asked, options.out)
    settings, rows = {}, []
    for action in asked.actions:
        scenario = load_scenario(name, {"control": {"action": action}})
        log = options.out / f"trials-{action}.jsonl"
        chosen, tried = tuned_settings(scenario, asked.courses, log=log, anew=True)
        settings[action] = {n: {key: float(f"{v:.4g}") for key, v in values.items()} for n, values in chosen.items()}
        for n, values in settings[action].items():
            best = max(tried[n], key=lambda trial: (trial["finished"], trial["return"]))
            said = ", ".join(f"{key} {value:g}" for key, value in values.items())
            rows.append([action, n, f"{100 * best['finished']:.1f}", said])
    content = {"courses": asked.courses, "seed": TUNING_SET, "trials": load_spaces().trials_of(asked.courses),
               "version": asked.version, "settings": settings}  # fmt: skip
    file = options.out / f"{name}.yaml"
    typed = f"--scenario {name} --courses {asked.courses} --actions {','.join(asked.actions)}"
    made = f"# Settings of the classical controllers, found by python -m agents.tune {typed}\n"
    replace_file(file, made + yaml.safe_dump(content, sort_keys=False))
    show(Table(["action", "controller", "finished [% of tuning courses]", "settings"], rows), f"Written: {file}")
    return 0


if __name__ == "__main__":
    leave(main())
