"""The page of `paper`, for the terminal and as Markdown with its figures; its sections are in `paper_sections`.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251.
"""

from __future__ import annotations

import sys
import tempfile
import textwrap
from pathlib import Path

from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table as RichTable

from soil_env._io.files import replace_file, save_figure
from soil_env.paper.sections import UNKNOWN, Table, sections

COMMAND = "python -m soil_env.paper --out docs"
INTRO = (
    "Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), Soil parameter identification for wheel-terrain "
    "interaction dynamics and traversability prediction, IJAC 3:244-251. Equations carry its numbers. Units are SI, "
    "angles in degrees. "
    "The text of the paper is not available to us; what is known of it comes from the project's design notes. Four "
    "printed results are compared below: the drawbar pull of 1047.22 N, and phi, K and S of Table 3, these with points "
    "of our own since the paper's are not known. Its working point (22.11 %, 37 deg), the box of Table 4, the 5 % of "
    f"noise and the 3 kN m are taken over. All other printed digits are {UNKNOWN}: what stands beside such an entry "
    "is our result alone."
)


def prepare(folder: Path) -> None:
    """Make `folder` and its folder of figures, and see that they can be written to; OSError if not."""
    (folder / "paper").mkdir(parents=True, exist_ok=True)
    for place in (folder, folder / "paper"):
        with tempfile.TemporaryFile(dir=place):
            pass
    if (folder / "paper.md").is_dir():
        raise IsADirectoryError(0, "paper.md is a folder")


def show(results) -> None:
    """Print the page; at 140 columns where the output is no terminal."""
    console = Console(width=None if sys.stdout.isatty() else 140, highlight=False, markup=False)
    console.print(INTRO)
    for section in sections(results):
        console.rule(section.title, align="left")
        for text in section.text:
            console.print(text)
        for table in section.tables:
            rich = RichTable(*table.columns)
            for row in table.rows:
                rich.add_row(*row)
            console.print(rich)
        for text in section.notes:
            console.print(text)


def _markdown_table(table: Table) -> list[str]:
    lines = [table.columns, ("---",) * len(table.columns), *table.rows]
    return ["| " + " | ".join(cell or " " for cell in line) + " |" for line in lines]


def markdown(results) -> str:
    """The page as Markdown."""
    command = COMMAND + (f" --seed {results.seed}" if results.seed else "")
    blocks = ["# The source paper, recomputed", f"Written by `{command}`; do not edit.", INTRO]
    for section in sections(results):
        blocks += [f"## {section.title}", *section.text]
        blocks += ["\n".join(_markdown_table(t)) for t in section.tables]
        blocks += [f"![{p.caption}](paper/{p.name}.png)\n\n*{p.caption}*" for p in section.pictures]
        blocks += section.notes
    wrapped = [b if b.startswith(("|", "!", "#")) else textwrap.fill(b, 120, break_on_hyphens=False) for b in blocks]
    return "\n\n".join(wrapped) + "\n"


def write(results, folder: Path) -> None:
    """Write `folder`/paper.md and the figures in `folder`/paper."""
    for section in sections(results):
        for picture in section.pictures:
            figure = Figure(figsize=(6.4, 4.2), layout="constrained")
            picture.draw(figure)
            save_figure(figure, folder / "paper" / f"{picture.name}.png", dpi=110, metadata={"Software": None})
    replace_file(folder / "paper.md", markdown(results))
