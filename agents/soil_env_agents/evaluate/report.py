"""Files of an evaluation, and its table on the terminal."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from soil_env._io.document import Table
from soil_env._io.files import json_text, replace_files
from soil_env.simulation.task import Cause

from ..progress import show
from . import comparing
from .comparing import ORACLE
from .driving import RATES, Runs
from .tables import cell, csv_text, difference, draw_metrics, heading

FILES = ("evaluation.md", "courses.csv", "metrics.png", "evaluation.json")
_PANELS = (
    "immobilised",
    "finished",
    "speed",
    "energy_per_metre",
    "tractive_efficiency",
    "fighting",
    "return",
)
_CHOSEN = {
    "untuned": "untuned",
    "tuned": "tuned on at least {courses} other courses",
    "given": "as given with --settings",
}


def print_table(result: Mapping) -> None:
    """Print the main metrics of all controllers, the courses that nobody finished, and settings.

    Of detailed drives also print the share of immobilisations that were foreseen, and how far and
    how long ahead.
    """
    show(*comparing.table(result), *comparing.nobody(result), *settings(result))
    if "foreseen" not in result["metrics"]:
        return
    foreseen = (
        f"{name} {cell(row['foreseen'], 100.0, 0, bounds=False)} % "
        f"{cell(row['foreseen_distance'], bounds=False)} m "
        f"{cell(row['foreseen_time'], digits=1, bounds=False)} s"
        for name, row in result["controllers"].items()
    )
    show(f"Immobilisations foreseen, distance and time ahead: {'; '.join(foreseen)}")


def settings(result: Mapping) -> list[str]:
    """Lines with the settings of controllers, one for each origin of `_CHOSEN` that some have."""
    lines = []
    for chosen, title in _CHOSEN.items():
        own = [
            f"{name} {_values(result['settings'][name])}"
            for name, how in result["chosen"].items()
            if how == chosen
        ]
        if own:
            lines.append(f"{title.format(courses=result['tuning_courses'])}: {'; '.join(own)}")
    return lines


def _values(values: Mapping[str, float]) -> str:
    """Settings as text, "key value, key value", four digits each."""
    return ", ".join(f"{key} {value:.4g}" for key, value in values.items())


def write(result: Mapping, runs: Mapping[str, list[Runs]], folder: Path) -> None:
    """Write the `FILES`, all or none. evaluation.json comes last: where it is, the others are."""
    panels = [m for m in _PANELS if m in result["metrics"]]
    contents = (
        page(result),
        csv_text(_courses(runs, list(result["metrics"]))),
        draw_metrics({"": result["controllers"]}, panels),
        json_text(result),
    )
    replace_files(folder, dict(zip(FILES, contents, strict=True)))


def _courses(runs: Mapping[str, list[Runs]], metrics: list[str]) -> list[list]:
    """A heading, then a row for each course of each controller but the oracle: how it ended, and
    the `metrics` that are no rates. A metric that is not defined is empty.
    """
    names = [m for m in metrics if m not in RATES]
    rows: list[list] = [["controller", "member", "course", "cause", *names]]
    for name, members in runs.items():
        for member, own in enumerate(members if name != ORACLE else ()):
            values = np.array([own.metric(m) for m in names]).T
            for course, (cause, row) in enumerate(zip(own.cause, values, strict=True)):
                cells = ("" if math.isnan(v) else f"{v:.6g}" for v in row)
                rows.append([name, member, course, Cause(cause).name, *cells])
    return rows


def page(result: Mapping) -> str:
    """evaluation.md: controllers, all metrics, differences on the same courses."""
    names = list(result["controllers"])
    limits = comparing.limit_rows(result)
    made = [
        [
            f"`{n}`",
            result["members"][n],
            ", ".join(result["sources"][n]),
            _values(result["settings"].get(n, {})),
        ]
        for n in names
    ]
    metrics = []
    for m, about in result["metrics"].items():
        rate = m in RATES
        columns = [*result["controllers"].values(), *limits.values()]
        cells = (cell(c[m], 100.0 if rate else 1.0, 1 if rate else 2) for c in columns)
        metrics.append([heading(m), about["meaning"], *cells])
    iqm = [*(cell(result["iqm"][n]) for n in names), *("" for _ in limits)]
    metrics.append(["interquartile mean of return", "", *iqm])
    paired = []
    for i, a in enumerate(names):
        for b in names[:i]:
            cells = (difference(m, result["paired"][a][b][m]) for m in comparing.MAIN)
            paired.append([f"`{a}` - `{b}`", *cells, cell(result["improvement"][a][b])])
    parts = [
        f"# Controllers on scenario {result['scenario']}{comparing.other_world(result)}",
        (
            f"{result['courses']} courses of set {result['seed']}, the same for all controllers; "
            "95 % intervals."
        ),
        Table(["controller", "training seeds", "from", "settings"], made).markdown(),
        *settings(result),
        "![Metrics](metrics.png)",
        Table(["metric", "meaning", *names, *limits], metrics).markdown(),
        *comparing.nobody(result),
        (
            "Differences on the same courses, of rates in percentage points, and the probability "
            "of the higher return:"
        ),
        Table(["controllers", *comparing.MAIN, "P(higher return)"], paired).markdown(),
    ]
    return "\n\n".join(parts) + "\n"
