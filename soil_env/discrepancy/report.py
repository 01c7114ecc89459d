"""A report as files (report.json, report.html, model.yaml) and on the terminal."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.padding import Padding
from rich.panel import Panel
from rich.table import Table as Grid
from rich.text import Text

from soil_env._io.loading import ParameterError
from soil_env.discrepancy.formulas import as_lines, blocks, validity_line
from soil_env.discrepancy.page import page
from soil_env.discrepancy.words import (
    EFFECT_COLUMNS,
    SOIL_COLUMNS,
    check_first,
    effect_rows,
    fixed,
    gap_columns,
    gap_rows,
    lesser,
    p_value,
    rule,
    soil_rows,
    summary,
    title,
)

if TYPE_CHECKING:
    from soil_env.discrepancy.workflow import Report

FILES = ("report.json", "report.html", "model.yaml")
COLOURS = {"named": "green", "none": "green", "ambiguous": "yellow", "unlisted": "yellow"}
_SHOWN = 8  # candidates of the ranking on the terminal


# --- files ------------------------------------------------------------------------------------------------------------


def check_folder(folder: Path) -> None:
    """Raise `ParameterError` where report files could not be written into `folder`; creates nothing."""
    if folder.exists() and not folder.is_dir():
        raise ParameterError(f"{folder}: is a file: expected a folder")
    for name in FILES:
        if (folder / name).is_dir():
            raise ParameterError(f"{folder / name}: is a folder: expected a file that can be replaced, or nothing")
    there = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        raise ParameterError(f"{folder}: cannot be written (no permission in {there})")


def write(report: Report, folder: Path) -> list[Path]:
    """Write report.json, report.html and model.yaml into `folder`; each is whole, and all are made before the first.

    They are written into a hidden folder first, which is removed if anything goes wrong.
    """
    folder = Path(folder)
    check_folder(folder)
    try:
        beside = folder if folder.exists() else folder.absolute().parent
        beside.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=".report-", dir=beside))
        try:
            content = report.as_dict()
            text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
            (part / "report.json").write_text(text, encoding="utf-8")
            (part / "report.html").write_text(page(report, content), encoding="utf-8")
            report.model.save(part / "model.yaml")
            if not folder.exists():
                part.chmod(0o755)
                os.replace(part, folder)
            else:
                for name in FILES:
                    os.replace(part / name, folder / name)
        finally:
            shutil.rmtree(part, ignore_errors=True)
    except OSError as error:
        raise ParameterError(f"{folder}: cannot be written ({error.strerror})") from None
    return [folder / name for name in FILES]


# --- on the terminal --------------------------------------------------------------------------------------------------


def show(report: Report, console: Console) -> None:
    """Print the conclusion with its tables."""
    colour, first = COLOURS[report.verdict], check_first(report)
    if first:
        console.print(Panel(Text(" ".join(first)), title="[bold]check first[/]", title_align="left", style="red"))
    console.print(Panel(Text(summary(report)), title=f"[bold]{report.verdict}[/]", title_align="left", style=colour))
    for grid in (_effects(report), *_equations(report), _where(report), _gap(report), _ranking(report), _soil(report)):
        if grid is not None:
            console.print(grid)
    console.print(Text(validity_line(report)))
    if report.next_tests:
        console.print(_tests(report))
    if report.finding.untestable:
        console.print(_grid("Not testable with this table", ("effect", "reason"),
                            [(title(k), v) for k, v in report.finding.untestable.items()]))  # fmt: skip
    console.print(Text(rule(report)))
    for text in lesser(report):
        console.print(Text(f"! {text}", style="yellow"))


def _grid(name: str, columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> Grid:
    """A table; columns whose title starts with ">" are aligned right."""
    grid = Grid(title=name, title_justify="left", title_style="bold")
    for column in columns:
        grid.add_column(
            Text(column.lstrip(">")), justify="right" if column.startswith(">") else "left", overflow="fold"
        )
    for row in rows:
        grid.add_row(*(Text(cell) for cell in row))
    return grid


def _effects(report: Report) -> Grid | None:
    rows = effect_rows(report)
    return _grid("Missing effect", EFFECT_COLUMNS, rows) if rows else None


def _equations(report: Report) -> list[Text | Padding]:
    """The equations of what was added, with the fitted numbers."""
    out = []
    for block in blocks(report):
        out.append(Text(block.heading[:1].upper() + block.heading[1:], style="bold italic"))
        out += [Padding(Text(line.strip()), (0, 0, 0, len(line) - len(line.lstrip()))) for line in as_lines(block)]
    return out


def _where(report: Report) -> Grid | None:
    if not report.where:
        return None
    rows = [(d.words, p_value(d.p_value)) for d in report.where]
    return _grid("Where the base model disagrees", ("what", ">p"), rows)


def _gap(report: Report) -> Grid:
    return _grid("Held-out error (rms)", gap_columns(report), gap_rows(report))


_OTHER = (("unlisted", "something that no catalogue lists"), ("none", "nothing is missing"))


def _ranking(report: Report) -> Grid:
    rows = [(title(r.name), fixed(r.score, 1), fixed(r.probability, 3)) for r in report.ranking[:_SHOWN]]
    left = len(report.ranking) - _SHOWN
    name = "Candidates" + (f" (first {_SHOWN}, {left} more in the report)" if left > 0 else "")
    rows += [(words, "", fixed(report.other[key], 3)) for key, words in _OTHER if report.other.get(key)]
    return _grid(name, ("effect", ">held-out gain [nats]", ">probability"), rows)


def _soil(report: Report) -> Grid:
    return _grid("Soil", SOIL_COLUMNS, soil_rows(report))


def _tests(report: Report) -> Grid:
    rows = [(t.words, fixed(t.expected_sigma, 1)) for t in report.next_tests]
    return _grid("Next tests", ("test", ">expected [sd]"), rows)
