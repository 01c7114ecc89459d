"""Report of an ablation: tables, figures and comparison.md."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from soil_env._io.document import Table, render, renewed
from soil_env._io.files import check_outputs, replace_file, write_json
from soil_env._io.loading import ParameterError

from ..evaluate import report
from ..evaluate.figures import draw_profiles, png
from ..evaluate.tables import Column, cell, draw_intervals, labels, metric_table, points
from ..progress import show
from . import results, study as studies
from .study import Ablation

EMPTY_PAGE = "# Does the identifier help?\n\n<!-- ablation -->\n<!-- end -->\n"
_COLUMNS = (
    Column("immobilised", "immobilised [%]", 100.0, 1),
    Column("time_limit", "out of time [%]", 100.0, 1),
    Column("finished", "finished [%]", 100.0, 1),
    Column("time", "time [s]", digits=0),
    Column("energy_per_metre", "energy [J/m]", digits=0),
    Column("slip", "slip [-]"),
    Column("return", "return [-]"),
)
_COLOURS = {"true_soil": "#777777", "identified": "#d55e00", "blind": "#0072b2"}


def check(page: Path) -> None:
    """Before the work: ParameterError or OSError if the page, or the folder beside it, could not be written."""
    if not page.suffix:  # the folder beside it would have its name
        raise ParameterError(f"--page {page}: expected a file NAME.md")
    if not page.parent.is_dir():
        raise ParameterError(f"{page.parent}: no such folder: expected one for the page {page.name}")
    _renewed(page, "")
    check_outputs(page.parent, (page.name,))
    check_outputs(page.with_suffix(""))


def _renewed(page: Path, part: str) -> str:
    """The text of the page, an empty one where there is none, with `part` between its markers."""
    text = page.read_text(encoding="utf-8") if page.exists() else EMPTY_PAGE
    return renewed(text, {"ablation": part}, page)


def write(asked: Ablation, folder: Path, result: dict, page: Path | None) -> list[Path]:
    """Evaluations of all scenarios, comparison.json, figures and comparison.md into `folder`; with `page`, the marked
    part of that page, and json and figures into a folder of its name beside it. Returns what was written."""
    folder = Path(folder)
    for name in result["scenarios"]:
        study, records = studies.evaluation(asked, folder, name)
        own = folder / name / "evaluation"
        own.mkdir(parents=True, exist_ok=True)
        report.write(records, results.evaluation_results.result(study, records), own)
    path = folder / "comparison.md"
    written = [*_files(asked, result, folder), path]
    replace_file(path, f"# Does the identifier help?\n\n{block(asked, result, '')}\n")
    if page is not None:
        page = Path(page)
        check(page)  # before anything is written beside it
        beside = page.with_suffix("")
        beside.mkdir(exist_ok=True)
        written += [*_files(asked, result, beside), page]
        replace_file(page, _renewed(page, block(asked, result, beside.name + "/")))
    return written


def _files(asked: Ablation, result: dict, folder: Path) -> list[Path]:
    write_json(folder / "comparison.json", result)
    replace_file(folder / "overview.png", png(overview(asked, result)))
    replace_file(folder / "profiles.png", png(profiles(result)))
    return [folder / name for name in ("comparison.json", "overview.png", "profiles.png")]


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
            names, controllers = list(entry["controllers"])[::-1], list(entry["controllers"].values())[::-1]
            values = [c["metrics"][metric] for c in controllers]
            draw_intervals(axis, values, 100.0, [_colour(asked, name) for name in names])
            for y, (name, c) in enumerate(zip(names, controllers, strict=True)):
                if c["members"] > 1:
                    seeds = [100.0 * v for v in c["by_seed"][metric]]
                    axis.plot(seeds, [y - 0.3] * len(seeds), "|", ms=4, color=_colour(asked, name), alpha=0.6)
            axis.set_yticks(range(len(names)), names if column == 0 else [""] * len(names), fontsize=7)
            axis.tick_params(axis="x", labelsize=7)
            axis.set_xlabel(f"{metric} [%]", fontsize=8)
            axis.set_title(scenario, fontsize=9)
    return figure


def profiles(result: dict) -> Figure:
    """Performance profiles of the return, one panel a scenario."""
    scenarios = result["scenarios"]
    figure = Figure(figsize=(3.6 * max(len(scenarios), 1), 3.6), layout="constrained")
    for column, (scenario, entry) in enumerate(scenarios.items()):
        axis = figure.add_subplot(1, len(scenarios), column + 1)
        draw_profiles(axis, entry["profile"])
        axis.set_title(scenario, fontsize=9)
        axis.set_xlabel("return [-]", fontsize=8)
        axis.set_ylabel("share of runs above" if column == 0 else "", fontsize=8)
        axis.tick_params(labelsize=7)
    for axis in figure.axes[-1:]:
        axis.legend(fontsize=6)
    return figure


# --- text -------------------------------------------------------------------------------------------------------------


def block(asked: Ablation, result: dict, where: str) -> str:
    """The marked part of the page, as Markdown; figures are looked for in the folder `where` ('' or 'name/')."""
    sections = [{"title": n, "parts": _scenario(asked, entry)} for n, entry in result["scenarios"].items()]
    sections += [{"title": f"What is lost on {n}", "parts": [_losses(result, n, e)]} for n, e in result["loss"].items()]
    agents = "; ".join(
        f"`{n}`: {a['algorithm']}, observation {a['observation']}, {_more(a)}{a['timesteps']:,} steps"
        for n, a in result["agents"].items()
    )
    return render(
        f"{__package__}:comparison.md",
        result=result,
        agents=agents,
        verdicts="\n".join(verdicts(result)),
        sections=sections,
        where=where,
    ).strip()


def _more(agent: dict) -> str:
    """What sets an agent apart beside its algorithm and its observation."""
    parts = (
        (agent["history"], f"readings of {agent['history']} past steps, "),
        (agent["critic"], f"critic that sees {agent['critic']}, "),
        (agent["hidden_worlds"], f"{agent['hidden_worlds']} worlds with hidden effects in the training, "),
    )
    return "".join(text for there, text in parts if there)


def _scenario(asked: Ablation, entry: dict) -> list[str]:
    table = metric_table({f"`{n}`": c["metrics"] for n, c in entry["controllers"].items()}, _COLUMNS)
    seeds = [c["members"] if n in asked.agents else "" for n, c in entry["controllers"].items()]
    rows = [[row[0], count, *row[1:]] for row, count in zip(table.rows, seeds, strict=True)]
    out = [Table([table.header[0], "seeds", *table.header[1:]], rows).markdown()]
    agent = asked.asked_about("identified")
    if agent in entry["paired"]:
        improvement = entry["improvement"][agent]
        rows = [
            [
                f"`{n}`",
                points(d["immobilised"]),
                points(d["finished"]),
                cell(d["return"], sign=True),
                cell(improvement[n]),
            ]
            for n, d in entry["paired"][agent].items()
        ]
        header = [f"`{agent}` minus", "immobilised [points]", "finished [points]", "return", "P(higher return)"]
        out += ["On the same courses:", Table(header, rows).markdown()]
    return out


def _losses(result: dict, name: str, losses: dict) -> str:
    source = result["scenarios"][name]["trained_on"]
    rows = [[f"`{n}`", points(losses["immobilised"][n]), points(losses["finished"][n])] for n in losses["finished"]]
    return Table(
        ["controller", f"more immobilised than on {source} [points]", "fewer finished [points]"], rows
    ).markdown()


def verdicts(result: dict) -> list[str]:
    """The goals and whether they are reached, as a list."""
    lines = []
    for g in result["goals"]:
        word, d = {"yes": "Yes", "no": "No", "open": "Not shown"}[g["answer"]], g["details"]
        if g["goal"] == "beats":
            text = "finishes more than every controller that does not know the true soil, intervals apart? "
            groups = {"apart": "apart from", "more": "more, intervals overlap:", "not more": "not more than",
                      "fewer": "fewer than"}  # fmt: skip
            said = [f"{t} {_names(d, kind)}" for kind, t in groups.items() if kind in d.values()]
            lines.append(f"- `{g['scenario']}`: {text}**{word}**: {'; '.join(said)}.")
        elif g["goal"] == "covers":
            text = f"the identified soil gives at least {results.ENOUGH:.0%} of what the true soil is worth? "
            worth = f"{points(d['identifier'])} of {points(d['soil'])} points finished, a share of {cell(d['share'])}"
            lines.append(f"- `{g['scenario']}`: {text}**{word}**: {worth}.")
        else:
            least = ", ".join(f"{points(m)} against `{n}`" for n, m in d.items())
            text = "loses fewer finished courses than every controller that does not know the true soil? "
            lines.append(f"- `{g['scenario']}`: {text}**{word}**: its loss minus theirs, in points: {least}.")
    return lines


def _names(details: dict, kind: str) -> str:
    return ", ".join(f"`{n}`" for n, k in details.items() if k == kind)


def print_tables(result: dict) -> None:
    """The main metrics on the terminal."""
    for scenario, entry in result["scenarios"].items():
        names = labels(entry["controllers"])
        entries = {names[n]: c["metrics"] for n, c in entry["controllers"].items()}
        shown = [c._replace(bounds=c.metric in ("immobilised", "finished")) for c in _COLUMNS]
        show(metric_table(entries, shown, f"{scenario}: {result['courses']} held-out courses"))
    show(*(line.replace("`", "").replace("**", "") for line in verdicts(result)))
