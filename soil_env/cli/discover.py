"""`soil-env discover`."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import click

from soil_env.discovery.next_tests import MOST
from soil_env.discovery.report import FILES, show
from soil_env.discovery.report.sentences import summary
from soil_env.discovery.workflow import run

from .running import WholeNumber, console, out_option, seed_option
from .table_files import table_arguments


@click.command("discover")
@out_option("report.html, report.json and model.yaml (the corrected model)", required=True)
@seed_option("everything random; same seed, same report")
@click.option(
    "--next",
    "runs",
    type=WholeNumber(0),
    default=MOST,
    metavar="N",
    show_default=True,
    help="Runs to propose: conditions, predictions of each candidate, and how sure one will be.",
)
@click.option(
    "--goal",
    type=click.Choice(["name", "predict"]),
    default="name",
    show_default=True,
    help="What these runs are to tell best: what is missing, or what other runs would give.",
)
@click.option("--quiet", is_flag=True, help="Print only verdict and summary, in one line.")
@table_arguments
def command(
    data: Path,
    setup: Path,
    out: Path,
    seed: int,
    runs: int,
    goal: Literal["name", "predict"],
    quiet: bool,
) -> None:
    """Locate where model and measurement disagree, name the missing effect, show the gap shrink.

    Calibrates the base model to the table, refits every effect of the catalogue with the soil, and
    judges it on held-out conditions. The verdict is named, partly, ambiguous, unlisted,
    none or undetermined.
    """
    report = run(data, setup, out, seed=seed, next_runs=runs, goal=goal, progress=_stages(quiet))
    if quiet:
        first = f"CHECK FIRST: {' '.join(report.doubts)} " if report.doubts else ""
        print(f"{report.verdict}: {first}{summary(report)}")
        return
    show(report, console())
    for name in FILES:
        print(f"written: {out / name}")


def _stages(quiet: bool) -> Callable[[str], None]:
    """Return the function that prints a stage of the work on stderr when it begins.

    The stage is the text before a colon, and printed once. That of reading the files is not
    printed, since bad input prints one line only. If `quiet`, none is.
    """
    said = {"reading"}

    def say(text: str) -> None:
        """Print the stage of this text if it has not been said."""
        stage = text.partition(":")[0]
        if stage not in said and not quiet:
            said.add(stage)
            print(f"soil-env discover: {stage}", file=sys.stderr)

    return say
