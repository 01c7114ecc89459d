"""The result of the workflow as files (report.json, report.html, model.yaml) and on the terminal."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import yaml
from markupsafe import Markup
from rich.console import Console
from rich.panel import Panel
from rich.text import Text

from soil_env._io.document import html_image, html_page, render
from soil_env._io.files import check_outputs, replace_files
from soil_env._io.loading import ParameterError
from soil_env.discrepancy.report import blocks, cautions, tables, words
from soil_env.discrepancy.report.content import content
from soil_env.discrepancy.report.numbers import p_value
from soil_env.discrepancy.report.pictures import CAPTIONS, pictures
from soil_env.discrepancy.result import Report

__all__ = ["FILES", "check_folder", "content", "page", "show", "text", "write"]

FILES = ("report.json", "report.html", "model.yaml")
COLOURS = {"named": "green", "none": "green"}
_SHOWN = 8  # candidates of the ranking on the terminal
_STYLE = """
body { max-width: 66rem; } p, ul { max-width: 50rem; }
.summary { border-left: 6px solid #1f6f8b; background: #eef5f7; padding: .8rem 1.1rem; font-size: 1.08rem;
           max-width: none; }
.ambiguous, .unlisted, .partly, .undetermined { border-color: #c2871a; background: #fbf5e6; }
.check { border-color: #b3261e; background: #fbeceb; margin-bottom: .8rem; }
.verdict { font-size: .78rem; font-weight: 600; letter-spacing: .06em; text-transform: uppercase; color: #555;
           display: block; }
.eq { font: 1.12rem/1.5 Cambria, "STIX Two Text", "Times New Roman", serif; margin: .2rem 0 .2rem 1.2rem;
      max-width: none; }
.eq sub, .eq sup { font-size: .72em; line-height: 0; }
"""


def check_folder(folder: Path) -> None:
    """Raise `ParameterError` where report files could not be written into `folder`; creates nothing."""
    try:
        check_outputs(folder, FILES)
    except OSError as error:
        raise ParameterError(f"{error.filename}: {error.strerror}") from None


def write(report: Report, folder: Path) -> None:
    """Write report.json, report.html and model.yaml into `folder`: all are made before the first is written."""
    values = content(report)
    files = {
        "report.json": json.dumps(values, indent=2, allow_nan=False, ensure_ascii=False) + "\n",
        "report.html": page(report, values),
        "model.yaml": yaml.safe_dump(report.model.content(), sort_keys=False),
    }
    try:
        replace_files(folder, {name: text.encode() for name, text in files.items()})
    except OSError as error:
        raise ParameterError(f"{folder}: {error.strerror}") from None


def page(report: Report, values: dict[str, Any]) -> str:
    """report.html, which needs no other file; `values` is `content(report)`."""
    images = {name: Markup(html_image(svg, CAPTIONS[name], "svg+xml")) for name, svg in pictures(report).items()}
    names = ", ".join(words.title(e.name) for e in report.effects)
    mathematics = {
        "equation": lambda text: Markup(blocks.mathematics(text)),
        "meaning": lambda text: Markup(blocks.leading_mathematics(text)),
    }
    body = render(f"{__name__}:report.html", images=images, values=values, **mathematics, **_common(report))
    return html_page(f"{report.verdict}: {names}" if names else report.verdict, body, _STYLE)


def text(report: Report) -> str:
    """The report for the terminal, below its summary."""
    return render(f"{__name__}:report.txt", shown=_SHOWN, **_common(report))


def _common(report: Report) -> dict[str, Any]:
    """What both templates take."""
    return {
        "report": report,
        "words": words,
        "tables": tables,
        "blocks": blocks.blocks(report),
        "check_first": cautions.check_first(report),
        "cautions": cautions.cautions(report),
        "where": [(words.disagreement(report, d), p_value(d.p_value)) for d in report.where],
        "next_tests": [words.next_test(report, t) for t in report.next_tests],
    }


def show(report: Report, console: Console) -> None:
    """Print the conclusion with its tables."""
    first, colour = cautions.check_first(report), COLOURS.get(report.verdict, "yellow")
    if first:
        console.print(Panel(Text(" ".join(first)), title="[bold]check first[/]", title_align="left", style="red"))
    title = f"[bold]{report.verdict}[/]"
    console.print(Panel(Text(words.summary(report)), title=title, title_align="left", style=colour))
    console.print(Text(text(report)))
