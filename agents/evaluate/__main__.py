"""Compare controllers on the same courses, with confidence intervals.

CONTROLLERS is a list with commas. An entry is
  full_throttle, fixed_slip, ...   a classical controller (agents/controllers)
  path/to/model.zip, runs/NAME     a model of train.py, or any model of Stable-Baselines3 or sb3-contrib
  path/to/policy.onnx              an agent as agents.export has written it; its folder will do
  my.module:Thing                  a class (made with the scenario if it takes an argument), a function that makes one,
                                   or an object; with predict(obs, state, episode_start, deterministic) and, if it
                                   does not read the observation "identified", an attribute `variant`
  NAME=...                         any of these under another name; a glob of models, 'ppo=runs/ppo_*', or the same
                                   NAME again makes one algorithm of several training seeds
Models that train.py did not write are unpickled in part, and modules are imported: both run code.
Name only what you trust.

Examples:
  soil-env evaluate --controllers full_throttle,soft_start,best_slip_identified --out evaluation
  soil-env evaluate --controllers 'soft_start,ppo=runs/seed_*' --workers 8 --out evaluation
  soil-env evaluate --controllers my.module:Controller --scenario my.yaml --changes.course.length 20 --out e2
  soil-env evaluate --controllers fixed_slip --settings.fixed_slip.slip 0.2 --out e3
  soil-env evaluate --resume evaluation

Interrupted or killed, it goes on where it was with --resume OUT or with the same command again. OUT then holds
evaluation.md (tables), evaluation.json, evaluation.csv (a row for each controller), courses.csv (a row for each
course), metrics.png, study.yaml (the task) and cells/ (the courses driven).
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from soil_env._io.commands import command, command_line, folder, leave, whole_number
from soil_env._io.loading import ParameterError, unknown_key
from soil_env.parameters import DEFAULT_SCENARIO, load_scenario
from soil_env.terramechanics.model import WheelSoilModel

from .. import cells
from ..cli import as_options, go_on_with, manual_parser, overrides
from ..progress import Bar, show
from . import contestants, evaluation, report
from .driving import HELD_OUT_SET, TUNING_SET
from .evaluation import Evaluation
from .tuning import trials_in_all, tuned_settings

_EPILOG = """further options:
  --changes.KEY VALUE        any key of the scenario, in SI units, as --changes.course.length 20 [m]
  --settings.NAME.KEY VALUE  a setting of a classical controller (docs/controllers.md), as --settings.soft_start.speed
                             0.4 [m/s]"""

_NAME = __package__
_TUNING_COURSES = 200  # as train.py
_TUNING = "tuning.log"  # trials of a tuning that is not finished


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    p = manual_parser(command(_NAME), __doc__, _EPILOG)
    p.add_argument("--controllers", metavar="CONTROLLERS", help="what is compared, with commas (see above)")
    p.add_argument("--out", metavar="OUT", type=folder, help="folder of the results, made where it does not exist")
    p.add_argument(
        "--resume", metavar="OUT", type=folder, help="go on with an evaluation; only the engine may be given"
    )
    p.add_argument("--scenario", metavar="NAME", default=DEFAULT_SCENARIO, help="or YAML file (default: %(default)s)")
    p.add_argument("--model", metavar="YAML", default="", help="model.yaml with the effects that are on in this world")
    p.add_argument(
        "--courses", metavar="N", type=whole_number(), default=1000, help="courses that each drives (default: 1000)"
    )
    p.add_argument(
        "--seed", metavar="N", type=whole_number(), default=HELD_OUT_SET,
        help=f"names the set of courses (default: {HELD_OUT_SET}, the held-out set of train.py)",
    )  # fmt: skip
    p.add_argument(
        "--tuning-courses", metavar="N", type=whole_number(),
        help="tune the classical controllers on N other courses first, those with --settings excepted, unless settings "
        f"come with the package; 0: not at all (default: as many as --courses, at most {_TUNING_COURSES})",
    )  # fmt: skip
    p.add_argument(
        "--oracle-courses", metavar="N", type=whole_number(), default=0,
        help="the oracle, a planner that knows the ground, drives the first N courses: the limit of the task, and "
        "which failures were avoidable (default: 0; about a second of a processor each)",
    )  # fmt: skip
    p.add_argument(
        "--block", metavar="N", type=whole_number(), default=100, help="courses driven side by side (default: 100)"
    )
    p.add_argument(
        "--resamples", metavar="N", type=whole_number(), default=2000, help="redraws of the bootstrap (default: 2000)"
    )
    cells.add_options(p)
    return p


@command_line(_NAME, memory="fewer --courses or a smaller --block")
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 2 bad input, 130 interrupted."""
    options, rest = parser().parse_known_args(arguments)
    folder = options.resume or options.out
    with go_on_with(_NAME, folder):
        engine = cells.choose(options.engine, options.workers, options.address)
        asked = _evaluation(options, rest, folder)
        threads = None if engine is cells.in_process else 1
        job = evaluation.Job(asked, threads, ship=options.engine == "ray")
        with Bar("Driving", asked.courses * len(asked.controllers) + asked.oracle_courses, "courses") as bar:
            runs = evaluation.run(asked, folder, engine, job, lambda count: bar.update(advance=count))
        result = evaluation.result(asked, runs)
        written = report.write(result, runs, folder)
        report.print_table(result)
        show(f"Written to {folder}: {', '.join(written)}")
    return 0


def _evaluation(options, rest: list[str], folder: Path | None) -> Evaluation:
    """The evaluation of the command line or of a folder, its controllers checked."""
    if options.resume is None:
        asked = _asked(options, rest)
        evaluation.check_controllers(asked)
        return _begin(asked, folder)
    given = [k for k in _OPTIONS if getattr(options, k) != parser().get_default(k)]
    if given or rest:
        raise ParameterError(f"--resume takes only the engine; {options.resume} has the rest")
    asked = cells.load_study(Evaluation, folder)
    evaluation.check_controllers(asked)
    return _tuned(asked, folder)


_OPTIONS = (
    "controllers",
    "out",
    "scenario",
    "model",
    "courses",
    "seed",
    "tuning_courses",
    "oracle_courses",
    "block",
    "resamples",
)


def _asked(options, rest: list[str]) -> Evaluation:
    """The evaluation of the command line."""
    extra = overrides(rest)
    for key in extra:
        if key not in ("changes", "settings"):
            raise unknown_key(key, [*_OPTIONS, "resume", "engine", "workers", "address", "changes", "settings"],
                              "command line")  # fmt: skip
    if options.controllers is None or options.out is None:
        raise ParameterError("expected --controllers and --out, or --resume (see --help)")
    for key in ("changes", "settings"):
        if not isinstance(extra.get(key, {}), dict):
            raise ParameterError(f"--{key}: expected --{key}.KEY VALUE")
    settings = extra.get("settings", {})
    for name, values in settings.items():
        if not isinstance(values, dict):
            raise ParameterError(f"--settings.{name}: expected --settings.{name}.KEY VALUE")
    if options.tuning_courses and options.seed == TUNING_SET:
        raise ParameterError(f"--seed {TUNING_SET}: these courses are those that controllers are tuned on")
    scenario = load_scenario(options.scenario, extra.get("changes"), "--changes")
    controllers = contestants.parse(options.controllers, settings)
    with as_options():
        return Evaluation(
            scenario=scenario,
            controllers=controllers,
            courses=options.courses,
            seed=options.seed,
            block=options.block,
            resamples=options.resamples,
            tuning_courses=_tuning_courses(options),
            oracle_courses=options.oracle_courses,
            model=WheelSoilModel.load(options.model).content() if options.model else {},
        )


def _tuning_courses(options) -> int:
    """The option, else its default."""
    if options.tuning_courses is not None:
        return options.tuning_courses
    return min(_TUNING_COURSES, options.courses) if options.seed != TUNING_SET else 0


def _untuned(controllers: dict[str, contestants.Contestant]) -> list[str]:
    """Names of the classical controllers that tuning is for: those without --settings and under their own name."""
    return [c.name for c in controllers.values() if c.kind == "classical" and c.source == c.name and not c.settings]


def _begin(asked: Evaluation, folder: Path) -> Evaluation:
    """The evaluation of `folder` if it is the same one, else `asked`, written there; tuned."""
    if cells.is_begun(asked, folder, ignored=("tuned",)):
        asked = cells.load_study(Evaluation, folder)
    else:
        cells.save_study(asked, folder)
    return _tuned(asked, folder)


def _tuned(asked: Evaluation, folder: Path) -> Evaluation:
    """`asked` with the settings of its classical controllers, found before the first course of the comparison."""
    untuned = _untuned(asked.controllers)
    if asked.tuned or not (asked.tuning_courses and trials_in_all(untuned, 1)):
        return asked
    log = folder / _TUNING
    tuned, _ = tuned_settings(asked.scenario, asked.tuning_courses, untuned, None, asked.world, log)
    asked = dataclasses.replace(asked, tuned=tuned)
    cells.save_study(asked, folder)
    log.unlink(missing_ok=True)
    return asked


if __name__ == "__main__":
    leave(main())
