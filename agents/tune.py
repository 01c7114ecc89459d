"""Tune the classical controllers on a scenario, as the settings that come with the package were found.

Every controller has the same number of trials (configs/tuning.yaml) on the first N courses of the tuning set, for each
action of the drive. OUT then holds NAME.yaml for configs/tuned: train.py and soil-env evaluate take the settings from
there instead of tuning. Interrupted or killed, the same command goes on from Optuna's journal in OUT.

Example:
  soil-env tune --scenario mixed --out tuned
"""

from __future__ import annotations

import argparse
from typing import get_args, get_type_hints

import yaml

from soil_env._io.commands import command, command_line, command_parser, folder, leave, whole_number
from soil_env._io.document import Table
from soil_env._io.files import make_folder, replace_file
from soil_env._io.loading import ParameterError, unknown_value
from soil_env.parameters import DEFAULT_SCENARIO, Control, load_scenario, scenario_names

from .cells import code_version
from .evaluate.driving import TUNING_SET
from .evaluate.tuning import load_spaces, tuned_settings
from .progress import show

_NAME = f"{__package__}.tune"
ACTIONS = get_args(get_type_hints(Control)["action"])


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    p = command_parser(command(_NAME), __doc__, allow_abbrev=False)
    p.add_argument("--out", metavar="OUT", type=folder, required=True, help="folder, made where it does not exist")
    p.add_argument("--scenario", metavar="NAME", default=DEFAULT_SCENARIO, help="shipped one (default: %(default)s)")
    p.add_argument("--actions", metavar="A,B", default=",".join(ACTIONS), help="of the drive (default: all)")
    p.add_argument("--courses", metavar="N", type=whole_number(1), default=300, help="tuning courses (default: 300)")
    return p


@command_line(_NAME)
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 2 bad input, 130 interrupted."""
    options = parser().parse_args(arguments)
    name, courses, actions = options.scenario, options.courses, options.actions.split(",")
    if name not in scenario_names():
        raise unknown_value(name, scenario_names(), "--scenario")
    for action in actions:
        if action not in ACTIONS:
            raise unknown_value(action, ACTIONS, "--actions")
    if courses > 10**6:
        raise ParameterError(f"--courses {courses}: expected at most {10**6}")
    make_folder(options.out)
    settings, rows = {}, []
    for action in actions:
        scenario = load_scenario(name, {"control": {"action": action}})
        chosen, tried = tuned_settings(scenario, courses, log=options.out / f"trials-{action}.log", anew=True)
        settings[action] = {n: {key: float(f"{v:.4g}") for key, v in values.items()} for n, values in chosen.items()}
        for n, values in settings[action].items():
            best = max(tried[n], key=lambda trial: (trial["finished"], trial["return"]))
            said = ", ".join(f"{key} {value:g}" for key, value in values.items())
            rows.append([action, n, f"{100 * best['finished']:.1f}", said])
    content = {"courses": courses, "seed": TUNING_SET, "trials": load_spaces().trials_of(courses),
               "version": code_version(), "settings": settings}  # fmt: skip
    file = options.out / f"{name}.yaml"
    typed = f"soil-env tune --scenario {name} --courses {courses} --actions {','.join(actions)}"
    made = f"# Settings of the classical controllers, found by {typed}\n"
    replace_file(file, made + yaml.safe_dump(content, sort_keys=False))
    show(Table(["action", "controller", "finished [% of tuning courses]", "settings"], rows), f"Written: {file}")
    return 0


if __name__ == "__main__":
    leave(main())
