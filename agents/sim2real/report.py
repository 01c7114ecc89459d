"""Results and report of a study: sim2real.json, .md and .png.

Scores are [members, courses]; course k has the same random numbers in every world, so whole courses are drawn together
in all of them, and whole training seeds (`agents.evaluate.statistics`). Rates of one member have Wilson intervals.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from soil_env._io.document import Table, render
from soil_env._io.files import replace_file, write_json
from soil_env._io.loading import config_dir
from soil_env.parameters import DEFAULT_SCENARIO
from soil_env.terramechanics.model import WheelSoilModel

from ..evaluate import statistics as st
from ..evaluate.figures import png
from ..evaluate.tables import cell, draw_intervals
from ..progress import show
from . import carried
from .drives import bed_soil
from .study import ARMS, CONTROLLERS, CORRECTED, PPO, UNCORRECTED, Study, another_log, scores

FILES = ("sim2real.json", "sim2real.md", "sim2real.png")


def result(study: Study, folder: Path) -> dict:
    """The content of sim2real.json.

    {"scenario", "seed", ..., "worlds": {name: {"planted", "planted_law", "found", "law", "verdict", "probabilities",
    "alternatives", "closed", "rows", "bed" (friction angle, true and calibrated), "forces" (`carried.left`), "logs"
    (the same of further logs), "corrected" (whether anything was found), "controllers": {controller: {metric:
    {"uncorrected", "corrected", "difference"}, "gap": {"before", "after", "change"}, "gap_same": {"before",
    "after"}}}}}}; scores are {"value", "low", "high"}, 95 %. difference = corrected - uncorrected on the same hidden
    courses. gap = return on the simulation that the controller was made on - return in the hidden world; gap_same = the
    same of the uncorrected controller on both simulations.
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
        "logs": study.logs,
        "commissioning": study.commissioning.soil,
        "version": study.version,
        "worlds": {name: _world(study, folder, name, draws) for name in study.worlds},
    }


def _found(study: Study, name: str, here: Path, seed: int) -> dict:
    """What the workflow made of one log."""
    report = json.loads((here / "discrepancy" / "report.json").read_text(encoding="utf-8"))
    found, world = WheelSoilModel.load(here / "corrected.yaml"), study.world(name)
    bed = bed_soil(study.scenario, study.commissioning, np.random.default_rng([seed, 7]))
    law = WheelSoilModel.load(here / "discrepancy" / "model.yaml").residual
    models = {UNCORRECTED: None, CORRECTED: found, "with_law": replace(found, residual=law)}
    return {
        "verdict": report["verdict"],
        "found": {k: dict(v) for k, v in found.effects.items()},
        "law": [f"{t.channel} {t}" for t in law],
        "probabilities": {e["name"]: e["probability"] for e in report["effects"]},
        "alternatives": {e["name"]: e["alternatives"] for e in report["effects"]},
        "closed": report["closed"],
        "rows": report["rows"],
        "bed": {"true": float(bed.friction_angle_deg), "calibrated": report["soil"]["friction_angle_deg"]["value"]},
        "forces": carried.left(study.scenario, world, models),
    }


def _world(study: Study, folder: Path, name: str, draws: st.Draws) -> dict:
    here = folder / "worlds" / name
    first = _found(study, name, here, study.seed)
    corrected = bool(first["found"])
    own = {UNCORRECTED: folder / UNCORRECTED / "runs", CORRECTED: here / CORRECTED / "runs"}
    hidden = {arm: here / "runs" / arm for arm in ARMS}
    foretold = here / "runs" / "foretold"
    if not corrected:
        own[CORRECTED], hidden[CORRECTED], foretold = own[UNCORRECTED], hidden[UNCORRECTED], own[UNCORRECTED]
    settings = {arm: json.loads((own[arm].parent / "tuned.json").read_text(encoding="utf-8")) for arm in ARMS}
    return {
        "planted": study.worlds[name]["effects"],
        "planted_law": [f"{t.channel} {t}" for t in study.world(name).residual],
        **first,
        "logs": [_found(study, name, another_log(here, k), study.seed + k) for k in range(1, study.logs)],
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

    def estimate(terms: list[tuple[float, np.ndarray, str]], rate: bool = False) -> dict:
        """Weighted sum of mean scores with its interval; `rate`: of a single rate."""
        value = sum(w * st.mean(x) for w, x, _ in terms)
        samples = sum(w * st.mean_samples(x, members[a], draws.courses) for w, x, a in terms)
        if rate:
            ((_, x, _),) = terms
            return st.rate_bounds(value, samples, x.shape[1], len(x))
        return st.bounds(value, samples)

    out: dict = {}
    for metric in ("immobilised", "finished", "return"):
        x = {a: hidden[a][metric] for a in ARMS}
        out[metric] = {a: estimate([(1.0, x[a], a)], rate=metric != "return") for a in ARMS}
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
    write_json(folder / FILES[0], result)
    replace_file(folder / FILES[1], page(result))
    replace_file(folder / FILES[2], png(figure(result)))
    return list(FILES)


def effects_text(effects: dict) -> str:
    """'bulldozing (hegedus 1)'."""
    one = (f"{name} ({', '.join(f'{k} {v:.3g}' for k, v in p.items())})" for name, p in effects.items())
    return ", ".join(one)


def planted_text(world: dict) -> str:
    """What acts in the hidden world."""
    law = f"law errors ({len(world['planted_law'])} terms of pull and torque)" if world["planted_law"] else ""
    return ", ".join(filter(None, (effects_text(world["planted"]), law)))


def found_text(world: dict) -> str:
    """What the workflow found, in one line."""
    law = "a law without a name, which is not carried over: " + "; ".join(world["law"]) if world["law"] else ""
    text = ", ".join(filter(None, (effects_text(world["found"]), law)))
    others = [f"{k}: or {', '.join(v)}" for k, v in world["alternatives"].items() if v]
    closed = "" if world["closed"] is None else f"; gap of the table closed by {world['closed']:.1%}"
    return f"{world['verdict']}: {text or 'nothing'}" + (f" ({'; '.join(others)})" if others else "") + closed


def summary(name: str, world: dict) -> str:
    """A world in one sentence, by what the intervals allow."""
    m = world["controllers"][PPO]
    gap = f"gap in return of {PPO} {cell(m['gap']['before'], sign=True)}"
    if not world["corrected"]:
        return f"{name}: nothing is found, so nothing is corrected and both arms are the same; {gap}."
    stuck = _changes(world, "immobilised", "less often", "more often")
    worth = _changes(world, "return", "lower", "higher")
    after = cell(m["gap"]["after"], sign=True)
    return f"{name}: immobilised after the correction: {stuck}. Return: {worth}. The {gap} before, {after} after."


def _changes(world: dict, metric: str, falls: str, rises: str) -> str:
    """'less often A; no difference told apart B': controllers by what the interval of the difference says."""
    kinds: dict[str, list[str]] = {}
    for c, row in world["controllers"].items():
        d = row[metric]["difference"]
        kind = falls if d["high"] < 0.0 else rises if d["low"] > 0.0 else "no difference told apart"
        kinds.setdefault(kind, []).append(c)
    return "; ".join(f"{kind} {', '.join(kinds[kind])}" for kind in sorted(kinds))


def command(result: dict) -> str:
    """The command that made a result; what is default is left out."""
    words = ["python -m agents.sim2real --world", *map(_path, result["worlds"])]
    if result["scenario"] != DEFAULT_SCENARIO:
        words.append(f"--scenario {result['scenario']}")
    default = Study.__dataclass_fields__
    for name in ("timesteps", "training_seeds", "courses", "tuning_courses", "logs"):
        if result[name] != default[name].default:
            words.append(f"--{name.replace('_', '-')} {result[name]}")
    return " ".join([*words, f"--seed {result['seed']}", "--out OUT"])


def _path(world: str) -> str:
    shipped = config_dir() / "worlds" / f"{world}.yaml"
    return f"configs/worlds/{world}.yaml" if shipped.is_file() else f"{world}.yaml"


def page(result: dict) -> str:
    """sim2real.md."""
    worlds = [(n, planted_text(w), found_text(w)) for n, w in result["worlds"].items()]
    arms = "uncorrected", "corrected", "corrected - uncorrected, same courses"
    changes = "before", "after", "change of the gap", "same controller"
    return render(
        f"{__package__}:sim2real.md",
        r=result,
        command=command(result),
        worlds=_markdown(("world", "planted", "found"), worlds),
        forces=_markdown(("world", "found", *_FORCES), [
            (f"{n}, log {k}", *_forces(found))
            for n, w in result["worlds"].items() for k, found in enumerate((w, *w["logs"]), 1)
        ]),
        summaries=[summary(n, w) for n, w in result["worlds"].items()],
        immobilised=_by_controller(result, arms, lambda m: _arms(m["immobilised"], 100.0, 1)),
        finished=_by_controller(result, arms, lambda m: _arms(m["finished"], 100.0, 1)),
        returns=_by_controller(result, arms, lambda m: _arms(m["return"])),
        gap=_by_controller(result, changes, lambda m: [
            cell(x, sign=True) for x in (*m["gap"].values(), m["gap_same"]["after"])
        ]),
    ) + "\n"  # fmt: skip


def _markdown(header, rows) -> str:
    return Table(header, rows).markdown()


_FORCES = ("bed, true friction angle [deg]", "calibrated [deg]", "pull off by [N], uncorrected", "corrected",
           "with the law", "torque off by [N m], uncorrected", "corrected", "with the law")  # fmt: skip


def _forces(found: dict) -> list[str]:
    """Cells of a log: what was found, the bed's friction, and what is left of the forces."""
    names = [f"{k} {found['probabilities'][k]:.2f}" for k in found["found"] if k in found["probabilities"]]
    words = f"{found['verdict']}: " + (", ".join([*names, *["a law"][: len(found["law"])]]) or "nothing")
    left = [f"{found['forces'][m][c]:.2f}" for c in carried.CHANNELS for m in (*ARMS, "with_law")]
    return [words, *(f"{found['bed'][k]:.1f}" for k in ("true", "calibrated")), *left]


def _by_controller(result: dict, header: tuple[str, ...], cells) -> str:
    """A table with a row a world and controller."""
    rows = [[n, c, *cells(m)] for n, world in result["worlds"].items() for c, m in world["controllers"].items()]
    return _markdown(("world", "controller", *header), rows)


def _arms(m: dict, factor: float = 1.0, digits: int = 2) -> list[str]:
    """Both arms and their difference."""
    return [*(cell(m[arm], factor, digits) for arm in ARMS), cell(m["difference"], factor, digits, sign=True)]


_COLOURS = {UNCORRECTED: "#d55e00", CORRECTED: "#0072b2"}


def figure(result: dict) -> Figure:
    """A row a world: immobilisation and return in the hidden world of both arms, and the gap in return."""
    worlds = result["worlds"]
    out = Figure(figsize=(13, 1.0 + 2.2 * len(worlds)), layout="constrained")
    axes = out.subplots(len(worlds), 3, squeeze=False)
    panels = (  # label, factor, metric, its keys of both arms
        ("immobilised in the hidden world [%]", 100.0, "immobilised", (UNCORRECTED, CORRECTED)),
        ("return in the hidden world", 1.0, "return", (UNCORRECTED, CORRECTED)),
        ("gap in return, simulation - hidden world", 1.0, "gap", ("before", "after")),
    )
    for number, (row, (name, world)) in enumerate(zip(axes, worlds.items(), strict=True), 1):
        for axis, (label, factor, metric, keys) in zip(row, panels, strict=True):
            for arm, key, shift in zip(ARMS, keys, (0.12, -0.12), strict=True):
                values = [world["controllers"][c][metric][key] for c in CONTROLLERS[::-1]]
                draw_intervals(axis, values, factor, _COLOURS[arm], shift)
            axis.set_yticks(range(len(CONTROLLERS)), CONTROLLERS[::-1] if axis is row[0] else [""] * len(CONTROLLERS))
            if number == len(worlds):
                axis.set_xlabel(label)
        row[0].set_title(f"{name}: planted {planted_text(world)}", loc="left", fontsize=9)
        row[2].axvline(0.0, color="#888888", lw=1)
    axes[0, 2].legend([Line2D([], [], marker="o", color=_COLOURS[arm]) for arm in ARMS], ARMS, fontsize=8)
    return out


def print_table(result: dict) -> None:
    """The main numbers."""
    rows = []
    for name, world in result["worlds"].items():
        for controller, m in world["controllers"].items():
            gap = (cell(m["gap"][when], sign=True) for when in ("before", "after"))
            rows.append([name, controller, *_arms(m["immobilised"], 100.0, 1), *gap])
    header = (
        "world",
        "controller",
        "immobilised [%], uncorrected",
        "corrected",
        "difference",
        "gap in return, before",
        "after",
    )
    title = f"In the hidden world, {result['courses']} held-out courses; 95 % intervals"
    show(Table(header, rows, title), *(f"{name}: {found_text(world)}" for name, world in result["worlds"].items()))
