"""Does the identifier help? PPO agents that are blind or read the identified soil, without and with a memory, and one
that knows the true soil, against the classical controllers, on several scenarios and with several training seeds.

Examples:
  python -m agents.ablation --out runs/ablation --workers 2
  python -m agents.ablation --config configs/ablation_smoke.yaml --out runs/smoke    numbers without meaning
  python -m agents.ablation --out runs/sticky --scenarios sticky --seeds 2 --steps 1e6
  python -m agents.ablation --report runs/ablation --page docs/comparison.md         write the results again

Interrupted or killed, it goes on where it was with the same command (or --resume OUT): trainings from their last
checkpoint. With a larger --seeds it adds to what is there. OUT then holds comparison.json, comparison.md, figures, and
for each scenario an evaluation as of `python -m agents.evaluate`, with its report.html.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
from contextlib import closing
from functools import partial
from pathlib import Path

from soil_env._io.commands import command, command_line, file_path, folder, label, leave, whole_number
from soil_env._io.loading import ParameterError, config_dir

from .. import studies
from ..cli import as_options, config_file, go_on_with, manual_parser
from ..extras import needing
from ..progress import Bar, console, show
from . import page, results, study

_NAME = __package__


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    p = manual_parser(command(_NAME), __doc__)
    p.add_argument("--out", metavar="OUT", type=folder, help="folder of the study, made where it does not exist")
    p.add_argument("--resume", metavar="OUT", type=folder, help="go on with a study; only --workers may be given")
    p.add_argument("--report", metavar="OUT", type=folder, help="only write the results of what a study has so far")
    p.add_argument("--config", metavar="YAML", type=file_path, help="what is asked (default: configs/ablation.yaml)")
    p.add_argument("--scenarios", metavar="A,B", help="only these of the config")
    p.add_argument("--seeds", metavar="N", type=whole_number(), help="trainings of each agent on each scenario")
    p.add_argument("--steps", metavar="N", type=whole_number(1), help="environment steps of each training")
    p.add_argument("--courses", metavar="N", type=whole_number(), help="held-out courses of each scenario")
    p.add_argument(
        "--workers", metavar="N", type=whole_number(), help="processes side by side (default: none but this one)"
    )
    p.add_argument(
        "--page", metavar="MD", type=file_path,
        help="write the results into the marked part of this page, with comparison/*.json and *.png beside it",
    )  # fmt: skip
    return p


_ASKING = ("config", "scenarios", "seeds", "steps", "courses")


@command_line(_NAME, memory="a smaller ppo.num_envs or --courses")
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 2 bad input, 130 interrupted."""
    options = parser().parse_args(arguments)
    with needing("train", label(_NAME)):
        importlib.import_module("..training", __package__)  # takes seconds, which --help need not
    if [options.out, options.resume, options.report].count(None) != 2:
        raise ParameterError("expected one of --out, --resume and --report (see --help)")
    engine = studies.choose("local", options.workers)
    place = options.report or options.resume or options.out
    if options.page is not None:
        page.check(options.page)
    with go_on_with(_NAME, place):
        if options.out is not None:
            asked = _asked(options)
            study.begin(asked, place)
        else:
            given = [name for name in _ASKING if getattr(options, name) is not None]
            if given:
                raise ParameterError(f"--{given[0]}: only with --out; {place} has what is asked")
            asked = study.open_study(place)
        if options.report is None:
            fill(asked, place, engine)
        result = results.result(asked, place)
        written = page.write(asked, place, result, options.page)
        page.print_tables(result)
        show(f"Written: {', '.join(map(str, written))}")
    return 0


def _asked(options) -> study.Ablation:
    path = config_file(options.config) if options.config else config_dir() / "ablation.yaml"
    only = options.scenarios.split(",") if options.scenarios else None
    asked = study.read_config(path, only)
    given = {name: getattr(options, name) for name in ("seeds", "courses") if getattr(options, name) is not None}
    with as_options(timesteps="steps"):
        asked = dataclasses.replace(asked, **given)
        return asked if options.steps is None else study.with_steps(asked, options.steps)


def fill(asked: study.Ablation, folder: Path, engine: studies.Engine) -> None:
    """Do all work that is not done yet."""
    todo = [step for step in study.steps(asked) if not study.done(asked, folder, step)]
    total, left = sum(study.cost(asked, step) for step in todo), len(todo)
    with Bar("Training", max(total, 1), "steps") as bar:

        def progress(count: int) -> None:
            bar.update(advance=count, note=f"{left} of {len(todo)} pieces of work left")

        with closing(engine(partial(study.perform, asked, folder), todo, progress)) as done:
            for step, _ in done:
                left -= 1
                progress(0)
                if not console.is_terminal:
                    show(f"{step}: done, {left} left")


if __name__ == "__main__":
    leave(main())
