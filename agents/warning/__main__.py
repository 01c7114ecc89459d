"""Train the warning of immobilisation, judge it on other courses, and write weights, figures and page.

Drives of several families of controllers over the scenarios are recorded, the network is fitted (PyTorch), the
threshold of the alarm is set on other courses, and all is judged on others again. Written are the weights with
their card (immobilisation.json), what was found (warning.json), and docs/warning.md with its figure.

Examples:
  python -m agents.warning --smoke --out /tmp/w                    every part in a minute, numbers without meaning
  python -m agents.warning --out docs --weights soil_env/identification/online/immobilisation.json
  python -m agents.warning --out docs --models two_lines=runs/NAME mixed=runs/OTHER
  python -m agents.warning --out docs --others                     only what it is compared with again, and the page
  python -m agents.warning --out docs --draw                       page and figure again, from warning.json
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

import numpy as np

import soil_env
from soil_env._io.commands import command, command_line, folder, leave
from soil_env._io.files import make_folder, plain, write_json
from soil_env._io.loading import ParameterError
from soil_env.identification.online.immobilisation import HORIZONS, INPUTS, SCALES, Network

from ..cli import manual_parser
from ..evaluate.contestants import parse
from ..extras import needing
from ..progress import show
from . import page, study
from .drivers import DRIVERS, FAMILIES

_NAME = __package__
RESULT, WEIGHTS = "warning.json", "immobilisation.json"


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    p = manual_parser(command(_NAME), __doc__)
    p.add_argument("--out", metavar="DIR", type=folder, required=True, help="folder of warning.json and the figure")
    p.add_argument("--weights", metavar="FILE", type=Path, help=f"where the weights go (default: DIR/{WEIGHTS})")
    p.add_argument("--page", metavar="MD", type=Path, help="put the tables between the markers of this page")
    p.add_argument(
        "--models", metavar="SCENARIO=MODEL", type=trained, nargs="+", default=[],
        help="agents to judge it on too: run folders or zips of train.py, each with the scenario it was trained on",
    )  # fmt: skip
    p.add_argument("--draw", action="store_true", help="only page and figure, from the warning.json of DIR")
    p.add_argument("--others", action="store_true", help="only what it is compared with, into the warning.json of DIR")
    p.add_argument("--smoke", action="store_true", help="every part in a minute, numbers without meaning")
    return p


def trained(text: str) -> tuple[str, Path]:
    """(scenario, model) of SCENARIO=MODEL."""
    scenario, equals, path = text.partition("=")
    if not equals or scenario not in study.SCENARIOS:
        raise argparse.ArgumentTypeError(f"{text!r}: expected SCENARIO=MODEL with one of {', '.join(study.SCENARIOS)}")
    try:
        (found,) = parse(f"{study.MODEL}={path}").values()
    except ParameterError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return scenario, Path(found.source)


def content(net: Network, alarm: float, card: dict) -> dict:
    """What immobilisation.json holds."""
    arrays = {name: np.vectorize(lambda x: float(f"{x:.7g}"))(array) for name, array in net._asdict().items()}
    return {"card": card, "alarm": alarm, "inputs": list(INPUTS), **arrays}


def train_and_judge(out: Path, weights: Path, sizes: study.Sizes, smoke: bool, models: dict[str, Path]) -> dict:
    """Do all of it; writes the weights and warning.json, whose content is returned."""
    learnt = study.learn(sizes, show)
    tuning = study.all_scored(study.SCENARIOS, DRIVERS, study.TUNING_SET, sizes.tuning, learnt, show)
    alarm = round(study.threshold(study.NETWORK, tuning), 4)
    settings = {
        "version": soil_env.__version__,
        "smoke": smoke,
        "scenarios": list(study.SCENARIOS),
        "families": list(FAMILIES),
        "models": list(models),
        "sets": {"training": study.TRAINING_SET, "tuning": study.TUNING_SET, "test": study.TEST_SET},
        "sizes": dataclasses.asdict(sizes),
        "courses_of_training": learnt.courses,
        "rows_of_training": learnt.rows,
    }
    test = study.all_scored(study.SCENARIOS, tuple(FAMILIES), study.TEST_SET, sizes.test, learnt, show)
    test += study.all_scored(study.FOREIGN, DRIVERS, study.TEST_SET, sizes.test, learnt, show)
    tuning += study.of_models(models, study.TUNING_SET, sizes.tuning, learnt, show)
    test += study.of_models(models, study.TEST_SET, sizes.models, learnt, show)
    found = settings | study.judged(tuning, test)
    ours = found["rivals"][study.NETWORK]
    card = {
        "what": f"Probability that the wheel stops for good within {HORIZONS[0]:g} and {HORIZONS[1]:g} s of driving",
        "command": "python -m agents.warning --out docs --weights soil_env/identification/online/immobilisation.json",
        "scales": list(SCALES),
        **settings,
        "alarm": "probability within 5 s at which the alarm is false for 5 % of the driving time on finished courses",
        "on_test_courses": {name: ours[name] for name in ("auc", "warned", "time", "mean_time", "false")},
        "sample": study.sample(learnt.network, sizes),
    }
    write_json(weights, content(learnt.network, alarm, card), indent=None)
    show(f"Written: {weights}")
    found["others"] = study.others(sizes, show)
    found["leakage"] = study.leakage(learnt, test, sizes, show)
    del tuning, test
    found["limits"] = study.limits(sizes, show)
    write_json(out / RESULT, found)
    return found


@command_line(_NAME)
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 2 bad input, 130 interrupted."""
    options = parser().parse_args(arguments)
    if options.page is not None:
        page.check(options.page)
    models = dict(options.models)
    if len(models) < len(options.models):
        raise ParameterError("--models: expected one agent for each scenario")
    make_folder(options.out)
    sizes = study.SMOKE if options.smoke else study.Sizes()
    if options.draw or options.others:
        try:
            found = json.loads((options.out / RESULT).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ParameterError(f"{options.out / RESULT}: {error}: expected what this command has written") from None
        if options.others:
            found["others"] = study.others(sizes, show)
            write_json(options.out / RESULT, found)
    else:
        with needing("train", _NAME):
            import torch
        torch.set_num_threads(1)
        found = train_and_judge(
            options.out, options.weights or options.out / WEIGHTS, sizes, options.smoke, dict(options.models)
        )
    page.write(plain(found), options.out, options.page)
    return 0


if __name__ == "__main__":
    leave(main())
