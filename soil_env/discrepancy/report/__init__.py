"""Result of the workflow as files (report.json, report.html, model.yaml) and on the terminal."""

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
from soil_env.discrepancy.report import equations, sentences, tables
from soil_env.discrepancy.report.content import content
from soil_env.discrepancy.report.pictures import CAPTIONS, pictures
from soil_env.discrepancy.result import Report

__all__ = ["FILES", "check_folder", "content", "page", "show", "text", "write"]

FILES = ("report.json", "report.html", "model.yaml")
COLOURS = {"named": "green", "none": "green"}
_SHOWN = 8  # candidates of the ranking on the terminal


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
    """Return report.html, which needs no other file; `values` is `content(report)`."""
    images = {name: Markup(html_image(svg, CAPTIONS[name], "svg+xml")) for name, svg in pictures(report).items()}
    names = ", ".join(sentences.title(e.name) for e in report.effects)
    mathematics = {
        "equation": lambda text: Markup(equations.mathematics(text)),
        "meaning": lambda text: Markup(equations.leading_mathematics(text)),
    }
    body = render(f"{__name__}:report.html", images=images, values=values, **mathematics, **_common(report))
    style = render(f"{__name__}:report.css")
    return html_page(f"{report.verdict}: {names}" if names else report.verdict, body, style)


def text(report: Report) -> str:
    """Return the report for the terminal, below its summary."""
    return render(f"{__name__}:report.txt", shown=_SHOWN, **_common(report))


def _common(report: Report) -> dict[str, Any]:
    """Values of both templates."""
    return {
        "report": report,
        "sentences": sentences,
        "tables": tables,
        "blocks": equations.blocks(report),
        "cautions": sentences.cautions(report),
        "where": [
            (sentences.disagreement(report, d), "< 1e-6" if d.p_value < 1e-6 else f"{d.p_value:.2g}")
            for d in report.where
        ],
        "next_tests": [sentences.next_test(report, t) for t in report.next_tests],
    }


def show(report: Report, console: Console) -> None:
    """Print the conclusion with its tables."""
    colour = COLOURS.get(report.verdict, "yellow")
    if report.doubts:
        doubts = Text(" ".join(report.doubts))
        console.print(Panel(doubts, title="[bold]check first[/]", title_align="left", style="red"))
    title = f"[bold]{report.verdict}[/]"
    console.print(Panel(Text(sentences.summary(report)), title=title, title_align="left", style=colour))
    console.print(Text(text(report)))
