"""`soil-env tune`: settings of the classical controllers for a scenario."""

import shlex
from pathlib import Path
from typing import get_args, get_type_hints

import click
import yaml

from soil_env._io.files import alone, check_own, is_unused, write_own
from soil_env._io.loading import ParameterError, unknown_value
from soil_env.cli.running import PATH, WholeNumber
from soil_env.parameters import Control, load_scenario
from soil_env.terramechanics.model import WheelSoilModel

from .cells import code_version
from .cli import begun_in, continued_by, controllers_as, scenario_option
from .evaluate.contestants import parse
from .evaluate.driving import TUNING_SET
from .evaluate.own import bounds_of_settings
from .evaluate.tuning import trials_of, tuned_settings
from .progress import show

ACTIONS = get_args(get_type_hints(Control)["action"])


@click.command("tune")
@click.option("--out", type=PATH, metavar="OUT", required=True, help="Folder, made if missing.")
@scenario_option
@click.option(
    "--controllers", metavar="LIST", help="Names, my.module:Class (default: the shipped ones)."
)
@click.option("--model", metavar="YAML", help="model.yaml with the effects of this world.")
@click.option(
    "--actions",
    metavar="A,B",
    default=",".join(ACTIONS),
    help="Actions of the drive (default: all).",
)
@click.option(
    "--courses",
    metavar="N",
    type=WholeNumber(1, 10**6),
    default=300,
    help="Tuning courses (default 300).",
)
def command(
    out: Path,
    scenario: str,
    controllers: str | None,
    model: str | None,
    actions: str,
    courses: int,
) -> None:
    """Tune controllers on a scenario.

    Every controller gets the same number of trials on the first N courses of the tuning set, for
    each action of the drive. OUT then holds NAME.yaml with the settings. A class of your own has
    `bounds`, as those of soil_env_agents.controllers. The same command continues an interrupted
    tuning.

    To use a value of NAME.yaml, give it to soil-env evaluate as --settings.CONTROLLER.KEY VALUE. A
    NAME.yaml of a shipped scenario in configs/tuned is found by train.py and soil-env evaluate,
    where N is at least their --tuning-courses.

    \b
    soil-env tune --scenario mixed --out tuned
    soil-env tune --controllers soft_start,mine:Ramp --actions torque --out tuned
    """
    asked = load_scenario(scenario, place="--scenario")
    name = asked.name
    world = None if model is None else WheelSoilModel.load(model)
    names = None
    if controllers is not None:
        with controllers_as("--controllers"):
            parsed = parse(controllers).values()
            names = [c.source for c in parsed]
            for c in parsed:
                if c.kind == "model" or not bounds_of_settings(c.source, asked):
                    raise ParameterError(
                        f"controllers: {c.source}: nothing to tune: expected a controller with "
                        "settings, or a class with `bounds`"
                    )
    chosen_actions = actions.split(",")
    for action in chosen_actions:
        if action not in ACTIONS:
            raise unknown_value(action, ACTIONS, "--actions")
    settings = {}
    check_own(out, (f"{name}.yaml",))
    begun = begun_in(out, new=is_unused(out), made=not out.exists())
    with begun, alone(out), continued_by("the same command", out):
        for action in chosen_actions:
            task = load_scenario(scenario, {"control": {"action": action}})
            log = out / f"trials-{action}.log"
            # `anew`: else the settings that come with the package would be taken for its scenarios.
            chosen = tuned_settings(task, courses, names, world, log, anew=True)
            settings[action] = {
                n: {key: float(f"{v:.4g}") for key, v in own.items()} for n, own in chosen.items()
            }
    content = {
        "courses": courses,
        "seed": TUNING_SET,
        "trials": trials_of(courses),
        "version": code_version(),
        "settings": settings,
    }
    typed = ["--scenario", scenario, "--courses", courses, "--actions", actions]
    typed += ["--controllers", controllers] if controllers else []
    typed += ["--model", model] if model else []
    command = shlex.join(["soil-env", "tune", *map(str, typed)])
    made = f"# Settings of controllers, found by {command}\n"
    write_own(out, {f"{name}.yaml": made + yaml.safe_dump(content, sort_keys=False)})
    show(f"Written: {out / name}.yaml")
