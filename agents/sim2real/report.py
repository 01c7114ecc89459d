"""What came out: sim2real.json, .md and .png, from the files of a study alone.

Scores are [members, courses]; course k has the same random numbers in every world, so whole courses are drawn together
in all of them, and whole training seeds (`agents.evaluate.statistics`). Rates of one member have Wilson intervals.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from soil_env._io.files import replace_file
from soil_env._io.loading import config_dir
from soil_env.terramechanics.model import WheelSoilModel

from ..evaluate import statistics as st
from ..evaluate.comparing import wilson
from ..evaluate.figures import png
from .study import ARMS, CONTROLLERS, CORRECTED, PPO, UNCORRECTED, Study, scores

FILES = ("sim2real.json", "sim2real.md", "sim2real.png")


def result(study: Study, folder: Path) -> dict:
    """The content of sim2real.json.

    {"scenario", "seed", ..., "worlds": {name: {"planted", "found", "verdict", "alternatives", "closed", "rows",
    "corrected" (whether anything was found), "controllers": {controller: {metric: {"uncorrected", "corrected",
    "difference"}, "gap": {"before", "after", "change"}, "gap_same": {"before", "after"}}}}}}; all numbers are {"value",
    "low", "high"}, 95 %. difference = corrected - uncorrected on the same hidden courses. gap = return on the
    simulation that the controller was made on - return in the hidden world; gap_same = the same of the uncorrected
    controller on both simulations.
    """
    folder = Path(folder)
    draws = st.draws(study.seed, study.courses, study.bootstrap)
    return {
        "scenario": study.scenario.name,
        "seed": study.seed,
        "timesteps": study.timesteps,
        "training_seeds": study.training_seeds,
        "courses": study.courses,
        "tuning_courses": study.tuning_courses,
        "commissioning": study.commissioning.soil,
        "version": study.version,
        "worlds": {name: _world(study, folder, name, draws) for name in study.worlds},
    }


def _world(study: Study, folder: Path, name: str, draws: st.Draws) -> dict:
    here = folder / "worlds" / name
    report = json.loads((here / "discrepancy" / "report.json").read_text(encoding="utf-8"))
    found = WheelSoilModel.load(here / "corrected.yaml")
    corrected = bool(found.effects)
    own = {UNCORRECTED: folder / UNCORRECTED / "runs", CORRECTED: here / CORRECTED / "runs"}
    hidden = {arm: here / "runs" / arm for arm in ARMS}
    foretold = here / "runs" / "foretold"
    if not corrected:
        own[CORRECTED], hidden[CORRECTED], foretold = own[UNCORRECTED], hidden[UNCORRECTED], own[UNCORRECTED]
    settings = {arm: json.loads((own[arm].parent / "tuned.json").read_text(encoding="utf-8")) for arm in ARMS}
    return {
        "planted": study.worlds[name]["effects"],
        "verdict": report["verdict"],
        "found": {k: dict(v) for k, v in found.effects.items()},
        "law": [] if report["residual"] is None else report["residual"]["terms"],
        "alternatives": {e["name"]: e["alternatives"] for e in report["effects"]},
        "closed": report["closed"],
        "rows": report["rows"],
        "corrected": corrected,
        "settings": settings,
        "controllers": {
            c: _controller(
                c,
                {a: scores(own[a], c) for a in ARMS},
                {a: scores(hidden[a], c) for a in ARMS},
                scores(foretold, c),
                draws,
                corrected,
            )
            for c in CONTROLLERS
        },
    }


def _controller(name: str, own: dict, hidden: dict, foretold: dict, draws: st.Draws, corrected: bool) -> dict:
    arms = {UNCORRECTED: UNCORRECTED, CORRECTED: CORRECTED if corrected else UNCORRECTED}
    members = {a: draws.members(f"{name} {arm}", len(own[a]["return"])) for a, arm in arms.items()}

    def estimate(terms: list[tuple[float, np.ndarray, str]]) -> dict:
        """Weighted sum of mean scores with its interval."""
        value = sum(w * st.mean(x) for w, x, _ in terms)
        samples = sum(w * st.mean_samples(x, members[a], draws.courses) for w, x, a in terms)
        low, high = st.interval(value, samples)
        return {"value": value, "low": low, "high": high}

    out: dict = {}
    for metric in ("immobilised", "finished", "return"):
        x = {a: hidden[a][metric] for a in ARMS}
        out[metric] = {a: estimate([(1.0, x[a], a)]) for a in ARMS}
        if metric != "return":
            for a in ARMS:  # several training seeds on one course are not independent trials: courses are counted
                low, high = wilson(st.mean(x[a]) * x[a].shape[1], x[a].shape[1])
                m = out[metric][a]
                alone = len(x[a]) == 1
                m["low"], m["high"] = (low, high) if alone else (min(low, m["low"]), max(high, m["high"]))
        out[metric]["difference"] = estimate([(1.0, x[CORRECTED], CORRECTED), (-1.0, x[UNCORRECTED], UNCORRECTED)])
    before = [(1.0, own[UNCORRECTED]["return"], UNCORRECTED), (-1.0, hidden[UNCORRECTED]["return"], UNCORRECTED)]
    after = [(1.0, own[CORRECTED]["return"], CORRECTED), (-1.0, hidden[CORRECTED]["return"], CORRECTED)]
    same = [(1.0, foretold["return"], UNCORRECTED), (-1.0, hidden[UNCORRECTED]["return"], UNCORRECTED)]
    change = after + [(-w, x, a) for w, x, a in before]
    out["gap"] = {"before": estimate(before), "after": estimate(after), "change": estimate(change)}
    out["gap_same"] = {"before": estimate(before), "after": estimate(same)}
    return out


# --- the files --------------------------------------------------------------------------------------------------------


def write(study: Study, result: dict, folder: Path) -> list[str]:
    """Write sim2real.json, .md and .png; returns their names."""
    folder = Path(folder)
    replace_file(folder / FILES[0], (json.dumps(result, indent=1) + "\n").encode())
    replace_file(folder / FILES[1], page(result).encode())
    replace_file(folder / FILES[2], png(figure(result)))
    return list(FILES)


def cell(m: dict, factor: float = 1.0, digits: int = 2, sign: bool = False) -> str:
    """'1.23 [1.00, 1.40]'."""
    s = "+" if sign else ""
    value, low, high = (f"{factor * m[key]:{s}.{digits}f}" for key in ("value", "low", "high"))
    return f"{value} [{low}, {high}]"


def effects_text(effects: dict) -> str:
    """'bulldozing (hegedus 1)'."""
    one = (f"{name} ({', '.join(f'{k} {v:.3g}' for k, v in p.items())})" for name, p in effects.items())
    return ", ".join(one)


def found_text(world: dict) -> str:
    """What the workflow found, in one line."""
    text = effects_text(world["found"])
    if world["law"]:
        text = "a law without a name, which is not carried over: " + "; ".join(world["law"])
    others = [f"{k}: or {', '.join(v)}" for k, v in world["alternatives"].items() if v]
    closed = "" if world["closed"] is None else f"; gap of the table closed by {world['closed']:.1%}"
    return f"{world['verdict']}: {text or 'nothing'}" + (f" ({'; '.join(others)})" if others else "") + closed


def summary(name: str, world: dict) -> str:
    """A world in one sentence, by what the intervals allow."""
    m = world["controllers"][PPO]
    verdicts = {}
    for c, row in world["controllers"].items():
        d = row["immobilised"]["difference"]
        kind = "less often" if d["high"] < 0.0 else "more often" if d["low"] > 0.0 else "no difference told apart"
        verdicts.setdefault(kind, []).append(c)
    gap = f"gap in return of {PPO} {cell(m['gap']['before'], sign=True)}"
    if not world["corrected"]:
        return f"{name}: nothing is named, so nothing is corrected and both arms are the same; {gap}."
    text = "; ".join(f"{kind} {', '.join(verdicts[kind])}" for kind in sorted(verdicts))
    return (
        f"{name}: immobilised after the correction: {text}. The {gap} before, "
        f"{cell(m['gap']['after'], sign=True)} after."
    )


def command(result: dict) -> str:
    """The command that made a result; what is default is left out."""
    words = ["python -m agents.sim2real --world", *map(_path, result["worlds"])]
    default = Study.__dataclass_fields__
    for name in ("timesteps", "training_seeds", "courses", "tuning_courses"):
        if result[name] != default[name].default:
            words.append(f"--{name.replace('_', '-')} {result[name]}")
    return " ".join([*words, f"--seed {result['seed']}", "--out OUT"])


def _path(world: str) -> str:
    shipped = config_dir() / "worlds" / f"{world}.yaml"
    return f"configs/worlds/{world}.yaml" if shipped.is_file() else f"{world}.yaml"


def page(result: dict) -> str:
    """sim2real.md."""
    r = result
    lines = [
        "# From the rover's log to a corrected simulation",
        "",
        f"Made by `{command(r)}` on scenario `{r['scenario']}`: "
        f"{r['courses']} held-out courses, the same for all in one world; PPO with {r['timesteps']:,} steps and "
        f"{r['training_seeds']} training seed{'s' if r['training_seeds'] > 1 else ''} an arm, classical controllers "
        f"tuned on {r['tuning_courses']} other courses. Intervals: 95 %, over courses and training seeds; of few "
        "seeds they say little about another training.",
        "",
        "A hidden effect acts in the world that plays the rover. Its log of commissioning drives over a bed of "
        f"`{r['commissioning']}` becomes a table of steady points, `soil_env.discrepancy` names what the simulation "
        "lacks, and the effect found is put on the soils of the scenario (corrected). Uncorrected: the scenario as it "
        "is.",
        "",
        "The bed is that preset, scattered once; its priors are the preset with the standard deviations of the belief. "
        "Its digging counts as known, as the uncorrected simulation digs too: the workflow must not discover it. "
        "Drawbar pull and load are what the soil gives at the wheel, so the weight along a slope is not in them; grade "
        "sets the slip of a steady drive and is no column of the table.",
        "",
        "What limits this: the hidden world is simulated by the same compiled model that the correction is chosen "
        "from, with parameters (and in some worlds a form) that the workflow does not know. Real soil keeps to no such "
        "law, so these gaps after correction are lower bounds. Held-out courses are drawn so that the wheel can pass "
        "them in the world at hand, so returns of different worlds are returns on different courses. The identifier "
        "and `best_slip_identified` keep the base model inside in both arms; only what they are tuned on changes. Only "
        "named effects are carried over to the scenario's soils: a law without a name holds on the bed it was fitted "
        "to.",
        "",
        "## Worlds",
        "",
        "| world | planted | found |",
        "|---|---|---|",
        *(f"| {n} | {effects_text(w['planted'])} | {found_text(w)} |" for n, w in r["worlds"].items()),
        "",
        *(f"- {summary(n, w)}" for n, w in r["worlds"].items()),
        "",
        "## Immobilised in the hidden world [% of courses]",
        "",
        "| world | controller | uncorrected | corrected | corrected - uncorrected, same courses |",
        "|---|---|---|---|---|",
        *_rows(r, lambda m: (cell(m["immobilised"][UNCORRECTED], 100.0, 1), cell(m["immobilised"][CORRECTED], 100.0, 1),
                             cell(m["immobilised"]["difference"], 100.0, 1, True))),
        "",
        "## Return in the hidden world",
        "",
        "| world | controller | uncorrected | corrected | corrected - uncorrected, same courses |",
        "|---|---|---|---|---|",
        *_rows(r, lambda m: (cell(m["return"][UNCORRECTED]), cell(m["return"][CORRECTED]),
                             cell(m["return"]["difference"], sign=True))),
        "",
        "## Gap in return: simulation minus hidden world",
        "",
        "Before: an uncorrected controller on the uncorrected simulation, minus the hidden world. After: a corrected "
        "controller on the corrected simulation, minus the hidden world. Same controller: the uncorrected one, as the "
        "corrected simulation foretells it, minus the hidden world.",
        "",
        "| world | controller | before | after | change of the gap | same controller |",
        "|---|---|---|---|---|---|",
        *_rows(r, lambda m: (cell(m["gap"]["before"], sign=True), cell(m["gap"]["after"], sign=True),
                             cell(m["gap"]["change"], sign=True), cell(m["gap_same"]["after"], sign=True))),
        "",
        "![Immobilisation, return and gap](sim2real.png)",
        "",
        f"soil_env {r['version']}.",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _rows(result: dict, cells) -> list[str]:
    return [
        f"| {name} | {controller} | {' | '.join(cells(m))} |"
        for name, world in result["worlds"].items()
        for controller, m in world["controllers"].items()
    ]


_COLOURS = {UNCORRECTED: "#d55e00", CORRECTED: "#0072b2"}


def figure(result: dict) -> Figure:
    """A row a world: immobilisation and return in the hidden world of both arms, and the gap in return."""
    worlds = result["worlds"]
    out = Figure(figsize=(13, 1.0 + 2.2 * len(worlds)), layout="constrained")
    axes = out.subplots(len(worlds), 3, squeeze=False)
    for number, (row, (name, world)) in enumerate(zip(axes, worlds.items(), strict=True), 1):
        panels = (
            ("immobilised in the hidden world [%]", 100.0, lambda m: {a: m["immobilised"][a] for a in ARMS}),
            ("return in the hidden world", 1.0, lambda m: {a: m["return"][a] for a in ARMS}),
            ("gap in return, simulation - hidden world", 1.0,
             lambda m: {UNCORRECTED: m["gap"]["before"], CORRECTED: m["gap"]["after"]}),
        )  # fmt: skip
        for axis, (label, factor, values) in zip(row, panels, strict=True):
            for y, c in enumerate(CONTROLLERS[::-1]):
                for shift, (arm, m) in zip((0.12, -0.12), values(world["controllers"][c]).items(), strict=True):
                    v, low, high = (factor * m[k] for k in ("value", "low", "high"))
                    axis.errorbar(v, y + shift, xerr=[[v - low], [high - v]], fmt="o", ms=4, capsize=2,
                                  color=_COLOURS[arm], label=arm if y == 0 else None)  # fmt: skip
            axis.set_yticks(range(len(CONTROLLERS)), CONTROLLERS[::-1] if axis is row[0] else [""] * len(CONTROLLERS))
            axis.grid(alpha=0.3)
            if number == len(worlds):
                axis.set_xlabel(label)
        row[0].set_title(f"{name}: planted {effects_text(world['planted'])}", loc="left", fontsize=9)
        row[2].axvline(0.0, color="#888888", lw=1)
    axes[0, 2].legend(fontsize=8)
    return out


def print_table(result: dict, console: Console) -> None:
    """The main numbers."""
    table = Table(title=f"In the hidden world, {result['courses']} held-out courses; 95 % intervals")
    for name in ("world", "controller", "immobilised [%]\nuncorrected", "immobilised [%]\ncorrected",
                 "difference\n[points]", "gap in return\nbefore", "gap in return\nafter"):  # fmt: skip
        table.add_column(name, justify="left" if name in ("world", "controller") else "right", no_wrap=True)
    for name, world in result["worlds"].items():
        for controller, m in world["controllers"].items():
            i, g = m["immobilised"], m["gap"]
            table.add_row(name, controller, cell(i[UNCORRECTED], 100.0, 1), cell(i[CORRECTED], 100.0, 1),
                          cell(i["difference"], 100.0, 1, True), cell(g["before"], sign=True),
                          cell(g["after"], sign=True))  # fmt: skip
    wide = Console(file=console.file, width=1000)
    wide.width = max(console.width, wide.measure(table).maximum)
    wide.print(table)
    for name, world in result["worlds"].items():
        console.print(f"{name}: {found_text(world)}", soft_wrap=True, highlight=False, markup=False)
