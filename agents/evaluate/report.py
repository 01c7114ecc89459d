"""The result of an evaluation for people: a table on the terminal, figures, and report.html."""

from __future__ import annotations

import base64
import html
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from soil_env._io.files import replace_file

from . import figures, results
from .records import METRICS, RATES, Records
from .study import Study

#: Column of the printed table -> (metric, heading, factor, digits, with its interval)
_COLUMNS = (
    ("immobilised", "immobilised\n[%], 95 %", 100.0, 1, True),
    ("time_limit", "out of\ntime [%]", 100.0, 1, False),
    ("finished", "finished\n[%]", 100.0, 1, False),
    ("warned", "warned of\n[%]", 100.0, 0, False),
    ("warning_distance", "warning\n[m]", 1.0, 2, False),
    ("warning_time", "warning\n[s]", 1.0, 1, False),
    ("time", "time\n[s]", 1.0, 0, False),
    ("energy_per_metre", "energy\n[J/m]", 1.0, 0, False),
    ("tractive_efficiency", "tractive\neff. [-]", 1.0, 2, False),
    ("slip_p50", "slip\nmedian", 1.0, 2, False),
    ("sinkage_p95", "sinkage\np95 [mm]", 1.0, 0, False),
    ("return", "return\n[-], 95 %", 1.0, 2, True),
)
REFERENCE = (
    "Published: warnings 1.8 m and 2.9 s before complete immobilisation on average, on field data of a four-wheeled "
    "rover in snow (ASME J. Autonomous Vehicles and Systems 2(3), 031001). Other conditions: another machine, ground, "
    "method and course."
)


def cell(m: dict, factor: float, digits: int, bounds: bool = True) -> str:
    """'12.3 [10.0, 14.1]', or a dash where the metric is not defined."""
    if m["value"] is None:
        return "-"
    text = f"{factor * m['value']:.{digits}f}"
    return text + f" [{factor * m['low']:.{digits}f}, {factor * m['high']:.{digits}f}]" if bounds else text


def print_table(result: dict, console: Console) -> None:
    """The main metrics of all controllers."""
    table = Table(title=_title(result), title_justify="left")
    table.add_column("controller", no_wrap=True)
    for _, heading, *_ in _COLUMNS:
        table.add_column(escape(heading), justify="right", no_wrap=True)
    for name, entry in result["controllers"].items():
        cells = [cell(entry["metrics"][m], factor, digits, bounds) for m, _, factor, digits, bounds in _COLUMNS]
        seeds = f" ({entry['members']} seeds)" if entry["members"] > 1 else ""
        table.add_row(escape(name + seeds), *cells)
    wide = Console(file=console.file, width=1000)
    wide.width = max(console.width, wide.measure(table).maximum)  # rather a wrapped terminal than cut numbers
    wide.print(table)
    for line in settings(result):
        console.print(line, soft_wrap=True, highlight=False, markup=False)


def settings(result: dict) -> list[str]:
    """Lines that say what the classical controllers are set to, and whether that was tuned."""
    lines = []
    for chosen, title in _CHOSEN.items():
        of = {n: _values(e) for n, e in result["controllers"].items() if e.get("chosen") == chosen and e["settings"]}
        if of:
            title = title.format(courses=result["tuning_courses"])
            lines.append(f"{title}: " + "; ".join(f"{name} {values}" for name, values in of.items()))
            if chosen == "untuned":
                lines[-1] += ". Tuned they do better: --tuning-courses 200"
    return lines


_CHOSEN = {"untuned": "untuned", "tuned": "tuned on {courses} other courses", "given": "as given with --settings"}


def _values(entry: dict) -> str:
    return ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in entry["settings"].items())


def _title(result: dict) -> str:
    return (
        f"{result['courses']} courses of scenario {result['scenario']!r}, set {result['seed']}, the same for all "
        "controllers; 95 % intervals"
    )


def write(study: Study, records: dict[str, list[Records]], result: dict, folder: Path) -> list[str]:
    """Write evaluation.json, evaluation.csv, courses.csv, the figures and report.html; returns their names."""
    folder = Path(folder)
    results.save_json(result, folder / "evaluation.json")
    results.save_table(result, folder / "evaluation.csv")
    results.save_courses(records, folder / "courses.csv")
    pictures = {name: figures.png(draw(result)) for name, (_, draw) in figures.FIGURES.items()}
    for name, content in pictures.items():
        replace_file(folder / name, content)
    replace_file(folder / "report.html", page(study, result, pictures).encode())
    return ["report.html", "evaluation.json", "evaluation.csv", "courses.csv", *pictures]


_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
table { border-collapse: collapse; font-size: 13px; } .wide { overflow-x: auto; }
th, td { padding: .25rem .6rem; border-bottom: 1px solid #ddd; text-align: right; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; } th.text, td.text { text-align: left; white-space: normal; }
img { max-width: 100%; } figure { margin: 1rem 0; } figcaption { color: #555; font-size: 13px; }
"""


def page(study: Study, result: dict, pictures: dict[str, bytes]) -> str:
    """report.html: everything in one file, nothing is loaded from elsewhere."""
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        f"<title>Evaluation, {html.escape(result['scenario'])}</title><style>{_STYLE}</style></head><body>",
        f"<h1>Controllers on scenario {html.escape(result['scenario'])}</h1><p>{html.escape(_title(result))}.</p>",
        "<h2>Controllers</h2>",
        _table(
            ["controller", "training seeds", "what"],
            [[n, str(e["members"]), _what(e)] for n, e in result["controllers"].items()],
        ),
        *(f"<p>{html.escape(line)}.</p>" for line in settings(result)),
        "<h2>Results</h2>",
        _table(["metric", *result["controllers"]], _metric_rows(result)),
        "<p>Rates of one training seed: Wilson intervals. All others: bootstrap over training seeds and courses, both "
        f"drawn whole ({result['resamples']} draws). IQM: mean without the lowest and the highest quarter.</p>",
    ]
    for name, (caption, _) in figures.FIGURES.items():
        data = base64.b64encode(pictures[name]).decode()
        parts.append(
            f"<figure><img alt='{html.escape(caption, quote=True)}' src='data:image/png;base64,{data}'>"
            f"<figcaption>{html.escape(caption)}</figcaption></figure>"
        )
    parts += [
        "<h2>Differences on the same courses</h2>",
        _table(["a - b", *(f"{m} [points]" if m in RATES else m for m in results.PAIRED)], _paired_rows(result)),
        f"<h2>Warnings</h2><p>{html.escape(REFERENCE)} How a warning is defined here: agents/evaluate/warning.py.</p>",
        "<h2>Metrics</h2>",
        _table(["metric", "unit", "meaning"], [[n, m["unit"], m["meaning"]] for n, m in result["metrics"].items()]),
        f"<p>soil_env {html.escape(result['version'])}, courses driven {result['block']} side by side.</p>",
        "</body></html>",
    ]
    return "\n".join(parts) + "\n"


def _what(entry: dict) -> str:
    values, chosen = _values(entry), entry.get("chosen")
    return ", ".join(entry["sources"]) + (f" ({chosen}: {values})" if values else "")


def _metric_rows(result: dict) -> list[list[str]]:
    rows = []
    for name, (unit, _) in METRICS.items():
        factor, digits, shown = (100.0, 1, "%") if name in RATES else (1.0, 2, unit)
        cells = [cell(e["metrics"][name], factor, digits) for e in result["controllers"].values()]
        rows.append([f"{name.replace('_', ' ')} [{shown}]", *cells])
    for score in results.SCORES:
        rows.append([f"IQM of {score}", *(cell(e["iqm"][score], 1.0, 2) for e in result["controllers"].values())])
    return rows


def _paired_rows(result: dict) -> list[list[str]]:
    rows, names = [], list(result["controllers"])
    for i, a in enumerate(names):
        for b in names[:i]:
            m = result["paired"][a][b]
            cells = [cell(m[k], 100.0 if k in RATES else 1.0, 1 if k in RATES else 2) for k in results.PAIRED]
            rows.append([f"{a} - {b}", *cells])
    return rows


_TEXT = ("what", "meaning")  # columns of text


def _table(heading: list[str], rows: list[list[str]]) -> str:
    head = "".join(f"<th{' class=text' if h in _TEXT else ''}>{html.escape(h)}</th>" for h in heading)
    wide = heading[-1] in _TEXT
    body = "".join(
        "<tr>"
        + "".join(
            f"<td{' class=text' if wide and k == len(row) - 1 else ''}>{html.escape(c)}</td>" for k, c in enumerate(row)
        )
        + "</tr>"
        for row in rows
    )
    return f"<div class='wide'><table><tr>{head}</tr>{body}</table></div>"
