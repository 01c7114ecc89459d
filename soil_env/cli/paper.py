"""`soil-env paper`."""

import shlex
from pathlib import Path

import click
from rich.markdown import Markdown

from soil_env._io.files import check_own
from soil_env.paper import page
from soil_env.paper.compare import compute

from .running import WholeNumber, console, out_option, seed_option


@click.command("paper")
@out_option("paper.md and its figures")
@click.option(
    "--draws",
    type=WholeNumber(1, 10**6),
    default=1000,
    metavar="N",
    help="Draws of the noise in Table 5 (default 1000).",
)
@seed_option("the noise in Table 5")
def command(out: Path | None, draws: int, seed: int) -> None:
    """Recompute the numbers that the source paper prints.

    Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251: Tables 1 to 5, Figs. 2 to
    4 and 6 to 8, by the equations as printed and with the angle of maximum stress of Wong & Reece
    (1967).
    """
    if out is not None:
        check_own(out, ["paper.md", *(f"paper/{name}.png" for name in page.FIGURES)])
    results = compute(seed, draws)
    asked = f"soil-env paper --draws {draws} --seed {seed}"
    if out is not None:
        page.write(results, out, f"{asked} --out {shlex.quote(str(out))}")
        print(f"written: {out / 'paper.md'}, figures in {out / 'paper'}")
    else:
        console().print(Markdown(page.markdown(results, asked), hyperlinks=False))
