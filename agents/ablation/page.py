"""The result of an ablation for people: tables, figures, comparison.md."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.figure import Figure
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from soil_env._io.loading import ParameterError

from ..evaluate import report
from ..evaluate.results import save_json
from ..evaluate.study import replace_file
from . import results
from . import study as studies
from .study import Ablation

BEGIN, END = "<!-- ablation -->", "<!-- end -->"
#: Column of a table -> (metric, heading, factor, digits)
_COLUMNS = (
    ("immobilised", "immobilised [%]", 100.0, 1),
    ("time_limit", "out of time [%]", 100.0, 1),
    ("finished", "finished [%]", 100.0, 1),
    ("time", "time [s]", 1.0, 0),
    ("energy_per_metre", "energy [J/m]", 1.0, 0),
    ("slip", "slip [-]", 1.0, 2),
    ("return", "return [-]", 1.0, 2),
)
_COLOURS = {"true_soil": "#777777", "identified": "#d55e00", "blind": "#0072b2"}
_LINES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999999", "#7b3f00")


def write(asked: Ablation, folder: Path, result: dict, page: Path | None) -> list[Path]:
    """Evaluations of all scenarios, comparison.json, figures and comparison.md into `folder`; with `page`, the marked
    part of that page, and json and figures into a folder of its name beside it. Returns what was written."""
    folder = Path(folder)
    for name in result["scenarios"]:
        study, records = studies.evaluation(asked, folder, name)
        own = folder / name / "evaluation"
        own.mkdir(parents=True, exist_ok=True)
        report.write(study, records, results.evaluation_results.result(study, records), own)
    written = _files(asked, result, folder, "")
    path = folder / "comparison.md"
    replace_file(path, f"# Does the identifier help?\n\n{block(asked, result, '')}\n".encode())
    written.append(path)
    if page is not None:
        page = Path(page)
        text = page.read_text(encoding="utf-8") if page.exists() else f"# Does the identifier help?\n\n{BEGIN}\n{END}\n"
        if text.count(BEGIN) != 1 or END not in text.split(BEGIN)[1]:
            raise ParameterError(f"{page}: expected one part between {BEGIN} and {END}")
        before, rest = text.split(BEGIN)
        beside = page.with_suffix("")
        beside.mkdir(parents=True, exist_ok=True)
        written += _files(asked, result, beside, "")
        new = f"{before}{BEGIN}\n{block(asked, result, beside.name + '/')}\n{END}{rest.split(END, 1)[1]}"
        replace_file(page, new.encode())
        written.append(page)
    return written


def _files(asked: Ablation, result: dict, folder: Path, prefix: str) -> list[Path]:
    save_json(result, folder / "comparison.json")
    pictures = {"overview.png": overview(asked, result), "profiles.png": profiles(result)}
    for name, figure in pictures.items():
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=110, metadata={"Software": None})
        replace_file(folder / name, out.getvalue())
    return [folder / "comparison.json", *(folder / name for name in pictures)]


# --- figures ----------------------------------------------------------------------------------------------------------


def _colour(asked: Ablation, name: str) -> str:
    if results.knows_truth(asked, name):
        return _COLOURS["true_soil"]
    variant = asked.agents[name].observation if name in asked.agents else results.CONTROLLERS[name].variant
    return _COLOURS[variant]


def overview(asked: Ablation, result: dict) -> Figure:
    """Immobilised and finished courses of every controller on every scenario, with intervals and single seeds."""
    scenarios = result["scenarios"]
    rows = max((len(s["controllers"]) for s in scenarios.values()), default=1)
    figure = Figure(figsize=(3.2 * max(len(scenarios), 1) + 1.5, 2 * (0.28 * rows + 0.7)), layout="constrained")
    for line, metric in enumerate(("immobilised", "finished")):
        for column, (scenario, entry) in enumerate(scenarios.items()):
            axis = figure.add_subplot(2, len(scenarios), line * len(scenarios) + column + 1)
            names = list(entry["controllers"])[::-1]
            for y, name in enumerate(names):
                c, colour = entry["controllers"][name], _colour(asked, name)
                value, low, high = (100.0 * c["metrics"][metric][key] for key in ("value", "low", "high"))
                axis.errorbar(value, y, xerr=[[value - low], [high - value]], fmt="o", ms=4, color=colour, capsize=2)
                if c["members"] > 1:
                    seeds = [100.0 * v for v in c["by_seed"][metric]]
                    axis.plot(seeds, [y - 0.3] * len(seeds), "|", ms=4, color=colour, alpha=0.6)
            axis.set_yticks(range(len(names)), names if column == 0 else [""] * len(names), fontsize=7)
            axis.tick_params(axis="x", labelsize=7)
            axis.set_xlabel(f"{metric} [%]", fontsize=8)
            axis.set_title(scenario, fontsize=9)
            axis.grid(alpha=0.3)
    return figure


def profiles(result: dict) -> Figure:
    """Performance profiles of the return, one panel a scenario."""
    scenarios = result["scenarios"]
    figure = Figure(figsize=(3.6 * max(len(scenarios), 1), 3.6), layout="constrained")
    axis = None
    for column, (scenario, entry) in enumerate(scenarios.items()):
        axis = figure.add_subplot(1, len(scenarios), column + 1)
        for i, (name, p) in enumerate(entry["profile"].items()):
            colour = _LINES[i % len(_LINES)]
            axis.plot(p["threshold"], p["share"], lw=1.2, color=colour, label=name)
            axis.fill_between(p["threshold"], p["low"], p["high"], color=colour, alpha=0.12, lw=0)
        axis.set_title(scenario, fontsize=9)
        axis.set_xlabel("return [-]", fontsize=8)
        axis.set_ylabel("share of runs above" if column == 0 else "", fontsize=8)
        axis.tick_params(labelsize=7)
        axis.set_ylim(0, 1)
        axis.grid(alpha=0.3)
    if axis is not None:
        axis.legend(fontsize=6)
    return figure


# --- text -------------------------------------------------------------------------------------------------------------


def block(asked: Ablation, result: dict, where: str) -> str:
    """The marked part of the page, as Markdown; figures are looked for in the folder `where` ('' or 'name/')."""
    agents = "; ".join(
        f"`{n}`: {a['algorithm']}, observation {a['observation']}, {_guided(a)}{a['timesteps']:,} steps"
        for n, a in result["agents"].items()
    )
    parts = [
        f"{result['courses']} held-out courses of each scenario, the same for all; classical controllers tuned on "
        f"{result['tuning_courses']} other courses. Agents: {agents}. soil_env {result['version']}.",
        "## Verdicts",
        "\n".join(verdicts(result)),
        f"![Immobilised and finished courses on every scenario]({where}overview.png)",
        "Dots: means with 95 % intervals over training seeds and courses; ticks below: single training seeds. Orange "
        "reads the identified soil, blue does not, grey knows the true soil.",
    ]
    for name, entry in result["scenarios"].items():
        parts += _scenario(asked, result, name, entry)
    for name, losses in result["loss"].items():
        parts += _losses(result, name, losses)
    parts += ["## Distribution of the return", f"![Performance profiles of the return]({where}profiles.png)"]
    return "\n\n".join(parts)


def _guided(agent: dict) -> str:
    if not agent["guide"]:
        return "sets the torque, "
    others = "".join(f" (on `{source}`: `{guide}`)" for source, guide in agent["guides"].items())
    return f"trims the rim speed of `{agent['guide']}`{others}, "


def _scenario(asked, result, name, entry) -> list[str]:
    rows = [["controller", "seeds", *(heading for _, heading, _, _ in _COLUMNS)]]
    for key, c in entry["controllers"].items():
        cells = [report.cell(c["metrics"][m], factor, digits) for m, _, factor, digits in _COLUMNS]
        rows.append([f"`{key}`", str(c["members"]) if key in asked.agents else "", *cells])
    out = [f"## {name}", _markdown(rows)]
    agent = results.identified(asked)
    if agent in entry["paired"]:
        rows = [[f"`{agent}` minus", "immobilised [points]", "finished [points]", "return", "P(higher return)"]]
        for other, d in entry["paired"][agent].items():
            rows.append([
                f"`{other}`", _points(d["immobilised"]), _points(d["finished"]), _signed(d["return"], 1.0, 2),
                report.cell(entry["improvement"][agent][other], 1.0, 2),
            ])  # fmt: skip
        out += ["On the same courses:", _markdown(rows)]
    return out


def _losses(result, name, losses) -> list[str]:
    source = result["scenarios"][name]["trained_on"]
    rows = [["controller", f"more immobilised than on {source} [points]", "fewer finished [points]"]]
    rows += [[f"`{n}`", _points(losses["immobilised"][n]), _points(losses["finished"][n])] for n in losses["finished"]]
    return [f"## What is lost on {name}", _markdown(rows)]


def verdicts(result: dict) -> list[str]:
    """The goals and whether they are reached, as a list."""
    lines = []
    for g in result["goals"]:
        word, d = {"yes": "Yes", "no": "No", "open": "Not shown"}[g["answer"]], g["details"]
        if g["goal"] == "beats":
            text = "less often immobilised than every controller that does not know the true soil, intervals apart? "
            groups = {"apart": "apart from", "lower": "lower, intervals overlap:", "not lower": "not lower than",
                      "higher": "higher than"}  # fmt: skip
            said = [f"{t} {_names(d, kind)}" for kind, t in groups.items() if kind in d.values()]
            lines.append(f"- `{g['scenario']}`: {text}**{word}**: {'; '.join(said)}.")
        elif g["goal"] == "within":
            ((true, m),) = d.items()
            text = f"at most 5 points more often immobilised than `{true}`? "
            lines.append(f"- `{g['scenario']}`: {text}**{word}**: {_points(m)} points.")
        else:
            least = ", ".join(f"{_points(m)} against `{n}`" for n, m in d.items())
            text = "loses less than every controller that does not know the true soil? "
            lines.append(f"- `{g['scenario']}`: {text}**{word}**: its loss minus theirs, in points: {least}.")
    return lines


def _names(details: dict, kind: str) -> str:
    return ", ".join(f"`{n}`" for n, k in details.items() if k == kind)


def _points(m: dict) -> str:
    return _signed(m, 100.0, 1)


def _signed(m: dict, factor: float, digits: int) -> str:
    value, low, high = (factor * m[key] for key in ("value", "low", "high"))
    return f"{value:+.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]"


def _markdown(rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def print_tables(result: dict, console: Console) -> None:
    """The main metrics on the terminal."""
    for name, entry in result["scenarios"].items():
        table = Table(title=f"{name}: {result['courses']} held-out courses", title_justify="left")
        table.add_column("controller", no_wrap=True)
        for _, heading, _, _ in _COLUMNS:
            table.add_column(escape(heading), justify="right", no_wrap=True)
        for key, c in entry["controllers"].items():
            seeds = f" ({c['members']} seeds)" if c["members"] > 1 else ""
            cells = [report.cell(c["metrics"][m], f, d, m in ("immobilised", "finished")) for m, _, f, d in _COLUMNS]
            table.add_row(escape(key + seeds), *cells)
        wide = Console(file=console.file, width=1000)
        wide.width = max(console.width, wide.measure(table).maximum)
        wide.print(table)
    for line in verdicts(result):
        console.print(line.replace("`", "").replace("**", ""), soft_wrap=True, highlight=False)
