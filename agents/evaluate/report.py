"""Report of an evaluation: a table on the terminal, figures, and report.html."""

from __future__ import annotations

from pathlib import Path

from soil_env._io.document import Table, html_image, html_page, render
from soil_env._io.files import replace_file, write_json

from ..progress import show
from . import figures, limit, results
from .records import METRICS, RATES, Records
from .tables import Column, cell, labels, legend, metric_table

#: Columns of the printed table
_COLUMNS = (
    Column("immobilised", "immobilised [%]", 100.0, 1),
    Column("time_limit", "out of time [%]", 100.0, 1, bounds=False),
    Column("finished", "finished [%]", 100.0, 1, bounds=False),
    Column("warned", "warned [%]", 100.0, 0, bounds=False),
    Column("warning_distance", "ahead [m]", bounds=False),
    Column("warning_time", "ahead [s]", digits=1, bounds=False),
    Column("foreseen", "foreseen [%]", 100.0, 0, bounds=False),
    Column("foreseen_time", "by [s]", digits=1, bounds=False),
    Column("time", "time [s]", digits=0, bounds=False),
    Column("energy_per_metre", "energy [J/m]", digits=0, bounds=False),
    Column("tractive_efficiency", "tractive eff.", bounds=False),
    Column("slip_p50", "slip", bounds=False),
    Column("sinkage_p95", "sinkage p95 [mm]", digits=0, bounds=False),
    Column("return", "return"),
)
REFERENCE = (
    "Published: warnings 1.8 m and 2.9 s before complete immobilisation on average, on field data of a four-wheeled "
    "rover in snow (ASME J. Autonomous Vehicles and Systems 2(3), 031001). Other conditions: another machine, ground, "
    "method and course."
)
_CHOSEN = {
    "untuned": "untuned",
    "tuned": "tuned on at least {courses} other courses",
    "given": "as given with --settings",
}
_STYLE = ".wide { overflow-x: auto; }"


def print_table(result: dict) -> None:
    """The main metrics of all controllers."""
    names = labels(result["controllers"])
    entries = {names[n]: e["metrics"] for n, e in result["controllers"].items()} | limit.rows(result)
    table = metric_table(entries, _COLUMNS, _title(result))
    show(table, legend(_COLUMNS, METRICS), *settings(result), *limit.lines(result), REFERENCE)


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


def _values(entry: dict) -> str:
    return ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in entry["settings"].items())


def _title(result: dict) -> str:
    return (
        f"{result['courses']} courses of scenario {result['scenario']!r}, set {result['seed']}, the same for all "
        "controllers; 95 % intervals"
    )


def write(records: dict[str, list[Records]], result: dict, folder: Path) -> list[str]:
    """Write evaluation.json, evaluation.csv, courses.csv, the figures and report.html; returns their names."""
    folder = Path(folder)
    write_json(folder / "evaluation.json", result)
    results.save_table(result, folder / "evaluation.csv")
    results.save_courses(records, folder / "courses.csv")
    pictures = {name: figures.png(draw(result)) for name, (_, draw) in figures.FIGURES.items()}
    for name, content in pictures.items():
        replace_file(folder / name, content)
    replace_file(folder / "report.html", page(result, pictures))
    return ["report.html", "evaluation.json", "evaluation.csv", "courses.csv", *pictures]


def page(result: dict, pictures: dict[str, bytes]) -> str:
    """report.html: everything in one file, nothing is loaded from elsewhere."""
    controllers = result["controllers"]
    body = render(
        f"{__package__}:report.html",
        result=result,
        title=_title(result),
        settings=[*settings(result), *limit.lines(result)],
        reference=REFERENCE,
        controllers=Table(
            ["controller", "training seeds", "what"], [[n, e["members"], _what(e)] for n, e in controllers.items()]
        ),
        metrics=Table(["metric", *controllers, *limit.rows(result)], _metric_rows(result)),
        figures=[html_image(pictures[name], caption) for name, (caption, _) in figures.FIGURES.items()],
        paired=Table(["a - b", *(f"{m} [points]" if m in RATES else m for m in results.PAIRED)], _paired_rows(result)),
        meanings=Table(["metric", "unit", "meaning"], [[n, *m.values()] for n, m in result["metrics"].items()]),
    )
    return html_page(f"Evaluation, {result['scenario']}", body, _STYLE)


def _what(entry: dict) -> str:
    values, chosen = _values(entry), entry.get("chosen")
    return ", ".join(entry["sources"]) + (f" ({chosen}: {values})" if values else "")


def _metric_rows(result: dict) -> list[list[str]]:
    rows, controllers = [], result["controllers"].values()
    for name, (unit, _) in METRICS.items():
        factor, digits, shown = (100.0, 1, "%") if name in RATES else (1.0, 2, unit)
        columns = [*(e["metrics"] for e in controllers), *limit.rows(result).values()]
        rows.append([f"{name.replace('_', ' ')} [{shown}]", *(cell(c[name], factor, digits) for c in columns)])
    none = ["" for _ in limit.rows(result)]
    return rows + [[f"IQM of {s}", *(cell(e["iqm"][s]) for e in controllers), *none] for s in results.SCORES]


def _paired_rows(result: dict) -> list[list[str]]:
    rows, names = [], list(result["controllers"])
    for i, a in enumerate(names):
        for b in names[:i]:
            m = result["paired"][a][b]
            cells = [cell(m[k], 100.0, 1) if k in RATES else cell(m[k]) for k in results.PAIRED]
            rows.append([f"{a} - {b}", *cells])
    return rows
