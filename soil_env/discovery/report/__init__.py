"""Result of the workflow as files (report.json, report.html, model.yaml) and on the terminal."""

import json
import platform
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import scipy
import yaml
from markupsafe import Markup
from rich.console import Console
from rich.panel import Panel
from rich.text import Text

from soil_env import __version__
from soil_env._io.document import html_image, html_page, render
from soil_env._io.files import check_own, plain, write_own
from soil_env._io.loading import ParameterError
from soil_env.discovery.instrument import LISTED
from soil_env.discovery.result import Report
from soil_env.identification.table.data import CHANNELS

from . import equations, sentences, tables, words

FILES = ("report.json", "report.html", "model.yaml")
COLOURS = {"named": "green", "none": "green"}  # of the terminal by verdict; others are yellow
_SHOWN = 8  # candidates of the ranking on the terminal
LEAST = 1e-3  # probability below which a hypothesis is not listed


def check_folder(folder: Path, inputs: Iterable[Path]) -> None:
    """Raise `ParameterError` where report files could not be written into `folder`, or would
    replace a file of the user, such as one of the `inputs`; create nothing.
    """
    try:
        check_own(folder, FILES, inputs)
    except OSError as error:
        raise ParameterError(f"{error.filename}: {error.strerror}") from None


def write(report: Report, folder: Path) -> None:
    """Write report.json, report.html and model.yaml into `folder`, all of them composed before the
    first is written.

    `ParameterError` where a file cannot be written, or would replace one that soil-env did not
    write or that was changed since.
    """
    values = content(report)
    files = {
        "report.json": json.dumps(values, indent=2, allow_nan=False, ensure_ascii=False) + "\n",
        "report.html": page(report, values),
        "model.yaml": yaml.safe_dump(report.model.content(), sort_keys=False),
    }
    try:
        write_own(folder, files)
    except OSError as error:
        raise ParameterError(f"{error.filename}: {error.strerror}") from None


def page(report: Report, values: dict[str, Any]) -> str:
    """HTML text of report.html, which needs no other file; `values` is `content(report)`."""
    # Imported here, since matplotlib takes a second to load.
    from .pictures import CAPTIONS, pictures

    images = {
        name: Markup(html_image(svg, CAPTIONS[name], "svg+xml"))
        for name, svg in pictures(report).items()
    }
    names = ", ".join(sentences.title(e.name) for e in report.effects)
    body = render(f"{__name__}:report.html", images=images, values=values, **_common(report))
    style = render(f"{__name__}:report.css")
    return html_page(f"{report.verdict}: {names}" if names else report.verdict, body, style)


def text(report: Report) -> str:
    """Return the report for the terminal, below its summary."""
    return render(f"{__name__}:report.txt", shown=_SHOWN, **_common(report))


def _common(report: Report) -> dict[str, Any]:
    """Values that the templates of report.html and of the terminal share, by their names there:
    the report, modules with functions of it, equations and cautions.
    """
    return {
        "report": report,
        "sentences": sentences,
        "words": words,
        "listed": LISTED,
        "tables": tables,
        "blocks": equations.blocks(report),
        "cautions": sentences.cautions(report),
    }


def show(report: Report, console: Console) -> None:
    """Print a panel of doubts, if there are any, and one with conclusion, summary, predictions and
    next step; then the report's `text` with equations and tables.
    """
    if report.doubts:
        doubts = Text(" ".join(report.doubts))
        console.print(Panel(doubts, title="[bold]check first[/]", title_align="left", style="red"))
    said = "\n\n".join(
        (
            words.conclusion(report),
            sentences.summary(report),
            " ".join((sentences.foreseen(report), sentences.if_laws_err(report))).strip(),
            words.next_step(report),
        )
    )
    console.print(
        Panel(
            Text(said),
            title=f"[bold]{report.verdict}[/]",
            title_align="left",
            style=COLOURS.get(report.verdict, "yellow"),
        )
    )
    console.print(Text(text(report)))


def content(report: Report) -> dict[str, Any]:
    """Content of report.json: plain values, in the units that they have in the `Report`, None where
    there is no number.

    Each key of the top level is always present. Entries by channel are of the channels in use;
    hypotheses below `LEAST` are left out.
    """
    noise = report.noise
    finding = report.finding
    return plain(
        {
            "verdict": report.verdict,
            "conclusion": words.conclusion(report),
            "summary": sentences.summary(report),
            "next_step": words.next_step(report),
            "candidates": finding.candidates,
            "effects": [
                vars(e)
                | {
                    "probability_if_laws_err": finding.if_laws_err(e.name),
                    "sure": finding.is_sure(e.name),
                    "explained": LISTED[e.name].explained,
                    "symbols": {p.name: p.symbol for p in LISTED[e.name].parameters if p.symbol},
                    **block.content(),
                }
                for e, block in zip(report.effects, equations.blocks(report), strict=True)
            ],
            "where": [vars(d) | {"words": sentences.disagreement(report, d)} for d in report.where],
            "ranking": finding.ranking,
            "gap": report.gap,
            "remainder": {n: g.remainder for n, g in report.gap.items()},
            "closed": report.closed,
            "prediction": {way.split: way.errors for way in report.outlook.left_out},
            "foreseen": sentences.foreseen(report),
            "if_laws_err": sentences.if_laws_err(report),
            "guess": report.guess,
            "closed_interval": report.closed_interval,
            "untestable": [{"name": k, "reason": v} for k, v in finding.untestable.items()],
            "detectable": {name: d.size for name, d in finding.detectable.items()},
            "detectable_as": {
                name: d._asdict() | {"unit": LISTED[name].parameter(d.parameter).unit}
                for name, d in finding.detectable.items()
            },
            "next_checks": report.next_checks,
            "next_tests": [vars(t) | {"words": sentences.next_test(t)} for t in report.next_tests],
            "surer_runs": report.surer_runs,
            "probability": {
                "none": finding.none,
                "unlisted": finding.unlisted,
                "remainder": finding.remainder,
            },
            "hypotheses": [
                {
                    "effects": h.names,
                    "like": h.like,
                    "law": h.law,
                    "unlisted": h.free,
                    "probability": h.probability,
                    "score": h.score,
                }
                for h in finding.hypotheses
                if h.probability >= LEAST
            ],
            "refuted": finding.refuted,
            "law_error": report.law_error,
            "soil": {
                name: v._asdict() | {"known": report.known(name)} for name, v in report.soil.items()
            },
            "scatter": finding.scatter,
            "noise": {
                name: {"sd": noise.sd[j], "origin": noise.origin[j]}
                for j, name in enumerate(CHANNELS)
                if name in report.channels
            },
            "left_out": [{"row": row, "channel": name} for row, name in report.left_out],
            "check_first": report.doubts,
            "cautions": [*report.doubts, *sentences.cautions(report)],
            "trust": report.model.validity,
            "rows": len(report.problem.data.table),
            "settings": vars(report.settings),
            "versions": {
                "soil_env": __version__,
                "python": platform.python_version(),
                "numpy": np.__version__,
                "scipy": scipy.__version__,
            },
        }
    )
