"""`soil-env study`: arms compared over training seeds and scenarios."""

import dataclasses
from pathlib import Path

import click

from soil_env._io.files import alone, is_unused
from soil_env._io.loading import ParameterError, read_yaml, to_dict
from soil_env.cli.running import PATH, WholeNumber

from .. import cells
from ..cli import (
    WITH_KEYS,
    again,
    allow_code_option,
    as_options,
    begun_in,
    config_file,
    continued_by,
    engine_options,
    keys_argument,
    needing_training,
    overrides,
    unknown_option,
)
from ..evaluate.contestants import code_in, refuse_code
from ..progress import show
from . import config, results, work


@click.command("study", context_settings=WITH_KEYS)
@click.option(
    "--out", type=PATH, metavar="OUT", required=True, help="Folder of the study, made if missing."
)
@click.option(
    "--config", "file", type=PATH, metavar="YAML", help="The study (default: that of OUT)."
)
@click.option(
    "--seeds", type=WholeNumber(1), metavar="N", help="Trainings of each agent on each scenario."
)
@click.option("--report", is_flag=True, help="Write only the results of the finished cells.")
@allow_code_option
@engine_options
@keys_argument
def command(
    out: Path,
    file: Path | None,
    seeds: int | None,
    report: bool,
    allow_code: bool,
    engine: str,
    workers: int | None,
    address: str | None,
    keys: tuple[str, ...],
) -> None:
    """Compare agents and controllers (arms) over training seeds and scenarios.

    \b
    soil-env study --config study_smoke.yaml --out runs/smoke   # a minute, numbers without meaning
    soil-env study --config study.yaml --out runs/study --workers 2
    soil-env study --config study.yaml --out runs/short --seeds 2 --train.timesteps 1e6
    soil-env study --out runs/study                               # continue

    Any key of the YAML file is an option, too. Trainings continue from their last checkpoint,
    tunings from their last trial; a larger --seeds adds to the finished cells. OUT gets study.json,
    study.md and study.png. Keys of the file: docs/guide/study.md.
    """
    selected = cells.choose(engine, workers, address)
    changes = overrides(keys, "--config")
    known = [str(p.name) for p in command.params if p.name not in ("file", "keys")]
    for key in changes:
        if key not in config.KEYS:
            raise unknown_option(key, ["config", *known, *config.KEYS])
    if file is None:
        if keys:
            raise ParameterError(f"{keys[0]}: only with --config")
        asked = cells.load_study(config.Study, out, None if allow_code else refuse_code)
    else:
        path = config_file(file)
        if not allow_code:
            refuse_code(read_yaml(path), str(path), code_in(changes))
        asked = config.read_config(path, changes)
    if seeds is not None:
        with as_options():
            asked = dataclasses.replace(asked, seeds=seeds)
    if any(not arm.controller for arm in asked.arms.values()):
        with needing_training():
            from .. import training  # noqa: F401
    if not report:
        code = ["--allow-code"] if code_in(to_dict(asked)) else []
        with begun_in(out, new=is_unused(out), made=not out.exists()), alone(out):
            work.begin(asked, out)
            with continued_by(again("study", "--out", out, *code), out):
                work.fill(asked, out, selected, elsewhere=engine == "ray")
    content = results.result(asked, out)
    if not content["scenarios"]:
        raise ParameterError(f"{out}: no cell is done; expected a study that has run")
    results.write(content, out)
    show(results.table(content, bounds=False), f"Written to {out}: {', '.join(results.FILES)}")
