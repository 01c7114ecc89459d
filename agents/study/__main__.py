"""Compare arms (agents that are trained, classical controllers, classes) over training seeds and scenarios.

Examples:
  soil-env study --config configs/study_smoke.yaml --out runs/smoke      a minute, numbers without meaning
  soil-env study --config configs/study.yaml --out runs/study --workers 2
  soil-env study --config configs/study.yaml --out runs/short --seeds 2 --train.timesteps 1e6
  soil-env study --out runs/study                                        go on
  soil-env study --out runs/study --report                               only the results of the cells that are done

Interrupted or killed, the same command goes on: trainings from their last checkpoint, tunings from their last trial. A
larger --seeds adds to what is there. OUT then holds study.json, study.md and study.png.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib

from soil_env._io.commands import command, command_line, file_path, folder, label, leave, whole_number
from soil_env._io.loading import ParameterError

from .. import cells
from ..cli import as_options, config_file, manual_parser, overrides
from ..extras import needing
from ..progress import show
from . import config, results, work

_NAME = __package__
_EPILOG = f"""further options:
  --KEY VALUE    any key of the YAML file, nested ones as --train.timesteps 1e6

the YAML file:
{(config.__doc__ or "").partition(chr(10))[2].strip(chr(10))}"""


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    p = manual_parser(command(_NAME), __doc__, _EPILOG)
    p.add_argument("--out", metavar="OUT", type=folder, required=True, help="folder of the study, made if need be")
    p.add_argument("--config", metavar="YAML", type=file_path, help="the study; left out: that of OUT")
    p.add_argument("--seeds", metavar="N", type=whole_number(), help="trainings of each agent on each scenario")
    p.add_argument("--report", action="store_true", help="only write the results of the cells that are done")
    cells.add_options(p)
    return p


@command_line(_NAME, interrupted="go on with the same command", memory="a smaller ppo.num_envs")
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 2 bad input, 130 interrupted."""
    options, rest = parser().parse_known_args(arguments)
    engine = cells.choose(options.engine, options.workers, options.address)
    if options.config is None:
        if rest:
            raise ParameterError(f"{rest[0]}: only with --config")
        asked = cells.load_study(config.Study, options.out)
    else:
        asked = config.read_config(config_file(options.config), overrides(rest, "--config"))
    if options.seeds is not None:
        with as_options():
            asked = dataclasses.replace(asked, seeds=options.seeds)
    if any(not arm.controller for arm in asked.arms.values()):
        with needing("train", label(_NAME)):
            importlib.import_module("..training", __package__)  # takes seconds, which --help need not
    if not options.report:
        work.begin(asked, options.out)
        work.fill(asked, options.out, engine, elsewhere=options.engine == "ray")
    content = results.result(asked, options.out)
    if not content["scenarios"]:
        raise ParameterError(f"{options.out}: no cell is done; expected a study that has run")
    written = results.write(content, options.out)
    show(results.table(content, bounds=False), f"Written to {options.out}: {', '.join(written)}")
    return 0


if __name__ == "__main__":
    leave(main())
