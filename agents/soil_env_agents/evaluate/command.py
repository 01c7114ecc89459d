"""`soil-env evaluate`: controllers and agents on the same courses, with confidence intervals."""

import dataclasses
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
from click.core import ParameterSource

from soil_env._io.files import alone, check_outputs, is_unused
from soil_env._io.loading import ParameterError, to_dict
from soil_env.cli.running import PATH, WholeNumber
from soil_env.parameters import load_scenario
from soil_env.terramechanics.model import WheelSoilModel

from .. import cells
from ..cli import (
    WITH_KEYS,
    again,
    allow_code_option,
    as_options,
    begun_in,
    continued_by,
    controllers_as,
    engine_options,
    keys_argument,
    overrides,
    scenario_option,
    unknown_option,
)
from ..progress import show
from . import contestants, evaluation, report
from .driving import HELD_OUT_SET, TUNING_SET
from .evaluation import Evaluation
from .own import bounds_of_settings, code_digest
from .tuning import shipped_settings, tuned_settings

_TUNING_COURSES = 200  # as train.py
_TUNING = "tuning.log"  # trials of a tuning that is not finished


@click.command("evaluate", context_settings=WITH_KEYS)
@click.option("--controllers", metavar="LIST", help="Names with commas, see above.")
@click.option("--out", type=PATH, metavar="OUT", help="Folder of the results, made if missing.")
@click.option(
    "--resume", type=PATH, metavar="OUT", help="Continue; only the engine may be given beside it."
)
@scenario_option
@click.option("--model", metavar="YAML", help="model.yaml with the effects of this world.")
@click.option(
    "--courses",
    type=WholeNumber(),
    default=1000,
    metavar="N",
    help="Courses of each (default 1000).",
)
@click.option(
    "--seed",
    type=WholeNumber(),
    default=HELD_OUT_SET,
    metavar="N",
    help="Courses (default: held out).",
)
@click.option(
    "--tuning-courses",
    type=WholeNumber(),
    metavar="N",
    help="For untuned controllers; 0: do not tune.",
)
@click.option(
    "--oracle-courses",
    type=WholeNumber(),
    default=0,
    metavar="N",
    help="Courses of the oracle (default 0).",
)
@click.option(
    "--block",
    type=WholeNumber(),
    default=100,
    metavar="N",
    help="Courses side by side (default 100).",
)
@click.option(
    "--resamples",
    type=WholeNumber(),
    default=2000,
    metavar="N",
    help="Bootstrap redraws (default 2000).",
)
@allow_code_option
@engine_options
@keys_argument
@controllers_as("--controllers")
def command(
    resume: Path | None,
    engine: str,
    workers: int | None,
    address: str | None,
    allow_code: bool,
    keys: tuple,
    **given: Any,
) -> None:
    """Compare controllers and agents on the same courses.

    An entry of the list is a classical controller (full_throttle, fixed_slip, ...), default_policy
    (comes with the package), a run folder or model.zip, a policy.onnx, or my.module:Thing with
    predict(obs, state, episode_start, deterministic). NAME=ENTRY names it; a glob makes one
    algorithm of several seeds. Models of others are unpickled and modules imported: name what you
    trust.

    \b
    soil-env evaluate --controllers full_throttle,best_slip_identified --out evaluation
    soil-env evaluate --controllers 'soft_start,ppo=runs/seed_*' --workers 2 --out evaluation
    soil-env evaluate --controllers mine=mine:Ramp --changes.course.length 20 --out e2
    soil-env evaluate --resume evaluation

    --changes.KEY VALUE sets a key of the scenario, --settings.NAME.KEY VALUE one of a controller. A
    class with `bounds` is tuned, as the classical ones. Values of a NAME.yaml that soil-env tune
    wrote are given with --settings; that in configs/tuned is found.
    """
    selected = cells.choose(engine, workers, address)
    if resume is None:
        asked = _asked(SimpleNamespace(**given), keys)
        folder = given["out"]
        check_outputs(folder)
    else:
        source = click.get_current_context().get_parameter_source
        if keys or any(source(name) is not ParameterSource.DEFAULT for name in given):
            raise ParameterError(f"--resume takes only the engine; {resume} has the rest")
        folder = resume
        check = None if allow_code else contestants.refuse_code  # modules that would be imported
        asked = cells.load_study(Evaluation, resume, check)
        if not allow_code:
            _refuse_foreign(asked, resume / cells.STUDY)  # models that would be unpickled
    evaluation.check_controllers(asked)
    code = ["--allow-code"] if contestants.code_in(to_dict(asked)) else []
    unused = is_unused(folder)
    with begun_in(folder, new=unused, made=not folder.exists()), alone(folder):
        if resume is None:
            asked = evaluation.as_begun(asked, folder)
        with continued_by(again("evaluate", "--resume", folder, *code), folder):
            carry_out(asked, folder, selected, ship=engine == "ray")


def _refuse_foreign(asked: Evaluation, where: Path) -> None:
    """ParameterError where the study of the file `where` has a model of another program, whose code
    would be run.
    """
    for contestant in asked.controllers.values():
        if contestant.kind == "model" and contestant.source.endswith(".zip"):
            from ..agent import INFO, read_member  # with torch

            if read_member(Path(contestant.source), INFO) is None:
                raise ParameterError(
                    f"{where}: {contestant.source}: a model of another program, which is "
                    "unpickled: expected --allow-code too, if you trust it"
                )


def carry_out(
    asked: Evaluation, folder: Path, engine: cells.Engine = cells.in_process, ship: bool = False
) -> dict:
    """Tune, drive what is missing in `folder`, write and print the results; returns the content of
    evaluation.json.

    `ship`: the engine's machines do not have the files of the models.
    """
    asked = _tuned(asked, folder)
    cells.save_study(asked, folder)
    (folder / _TUNING).unlink(missing_ok=True)
    job = evaluation.Job(asked, None if engine is cells.in_process else 1, ship)
    runs = evaluation.run(asked, folder, engine, job)
    result = evaluation.result(asked, runs)
    report.write(result, runs, folder)
    report.print_table(result)
    show(f"Written to {folder}: {', '.join(report.FILES)}")
    return result


def _asked(options: SimpleNamespace, keys: tuple[str, ...]) -> Evaluation:
    """The evaluation of the command line: `options` by name, and the other arguments `keys`.

    Without --tuning-courses it tunes on `_TUNING_COURSES`, at most as many as are compared, but not
    where the courses compared are the tuning set. ParameterError for anything that does not fit.
    """
    extra = overrides(keys)
    for key, value in extra.items():
        if key not in ("changes", "settings"):
            known = [str(p.name) for p in command.params if p.name != "keys"]
            raise unknown_option(key, [*known, "changes", "settings"])
        entries = {key: value}
        if key == "settings" and isinstance(value, dict):
            entries = {f"settings.{name}": v for name, v in value.items()}
        for name, entry in entries.items():
            if not isinstance(entry, dict):
                raise ParameterError(f"--{name}: expected --{name}.KEY VALUE")
    if options.controllers is None or options.out is None:
        raise ParameterError("expected --controllers and --out, or --resume (see --help)")
    tuning = options.tuning_courses
    if tuning and options.seed == TUNING_SET:
        raise ParameterError(
            f"--seed {TUNING_SET}: these courses are those that controllers are tuned on"
        )
    if tuning is None:
        tuning = min(_TUNING_COURSES, options.courses) if options.seed != TUNING_SET else 0
    same = {
        name: getattr(options, name)
        for name in ("courses", "seed", "block", "resamples", "oracle_courses")
    }
    scenario = load_scenario(options.scenario, extra.get("changes"), "--changes")
    controllers = contestants.parse(options.controllers, extra.get("settings", {}))
    model = {} if options.model is None else WheelSoilModel.load(options.model).content()
    with as_options():
        return Evaluation(
            to_dict(scenario), controllers, tuning_courses=tuning, model=model, **same
        )


def _tuned(asked: Evaluation, folder: Path) -> Evaluation:
    """`asked` with tuned settings of the controllers that have none by --settings.

    Tuned are classical ones under their own name, and classes with `bounds`. What `asked` has in
    `tuned` stays, but is tuned again where task, world, courses or the code of a class are others.

    ParameterError for several classes to tune under one name.
    """
    if not asked.tuning_courses:
        return asked
    own = [
        c
        for c in asked.controllers.values()
        if not c.settings
        and (c.kind == "class" or (c.kind == "classical" and c.source == c.name))
        and bounds_of_settings(c.source, asked.scenario)
    ]
    for name, count in Counter(c.name for c in own).items():
        if count > 1:
            raise ParameterError(
                f"controllers: {name!r}: {count} classes to tune: expected a name for each"
            )
    shipped = shipped_settings(asked.scenario, asked.tuning_courses, asked.world)
    task = [asked.task, asked.model, asked.tuning_courses, shipped]
    codes = {
        c.name: cells.digest_of([*task, code_digest(c.source) if c.kind == "class" else ""])
        for c in own
    }
    done = {name for name in asked.tuned if asked.codes.get(name) == codes.get(name)}
    own = [c for c in own if c.name not in done]
    cells.save_study(asked, folder)  # before the work, so that it can be resumed
    sources = {c.name: c.source for c in own}
    log = folder / _TUNING
    names = list(dict.fromkeys(sources.values()))
    found = tuned_settings(asked.scenario, asked.tuning_courses, names, asked.world, log)
    tuned = {name: found[source] for name, source in sources.items() if source in found}
    return dataclasses.replace(asked, tuned={**asked.tuned, **tuned}, codes=codes)
