"""docs/discrepancy.md from the result of benchmarks/blind.py, by templates/discrepancy.md.

What stands between the markers `<!-- remarks -->` or `<!-- cmu -->` and the next `<!-- end -->` comes from elsewhere
and stays when the page is renewed.
"""

from __future__ import annotations

import re
from pathlib import Path

from benchmarks.blind.easy import plots
from benchmarks.blind.easy.judge import LARGEST_GAP, LEAST_CASES, OPTIONS, TARGETS
from benchmarks.blind.easy.study import GROUPS
from soil_env._io.document import Table, render
from soil_env._io.files import replace_file

KEPT = ("remarks", "cmu")
LEAST_TOLD = 1.0
#: Seeds of the cases that were looked at while the model and the search were made.
DEVELOPMENT = (0, 1, 2, 7, 8, 11, 21, 31, 41, *range(50, 60))


def percent(share: dict | None) -> str:
    """Share with its interval [%]."""
    if share is None:
        return "-"
    return f"{100 * share['value']:.1f} [{100 * share['low']:.1f}, {100 * share['high']:.1f}]"


def _spread(s: dict | None) -> str:
    """Median with quartiles."""
    return "-" if s is None else f"{s['median']:.2f} ({s['low']:.2f}, {s['high']:.2f})"


def _range(b: dict) -> str:
    return f"{b['from']:g} and more" if b["to"] is None else f"{b['from']:g} to {b['to']:g}"


def _words(name: str) -> str:
    return name.replace("_", " ")


def verdict(share: dict | None, bound: float, least: bool) -> str:
    """Whether a target is met, in words."""
    if share is None:
        return "not measured"
    met = share["value"] >= bound if least else share["value"] < bound
    beyond = share["low"] if least else share["high"]
    other = share["high"] if least else share["low"]
    if met:
        sure = beyond >= bound if least else beyond < bound
        return "met" if sure else "met; the interval reaches past the target"
    near = other >= bound if least else other < bound
    return "**not met**" + ("; the interval reaches the target" if near else "")


def targets(f: dict) -> Table:
    """What was asked, and what came out."""
    rows = []
    for t in TARGETS:
        share = f["targets"][t.key]
        asked = f"{'at least' if t.least else 'below'} {100 * t.bound:.0f} %"
        count = "0" if share is None else str(share["of"])
        rows.append([t.words, asked, f"{percent(share)} %", count, verdict(share, t.bound, t.least)])
    gap = f["gap"].get("all")
    if gap:
        after = gap["after"]
        value = f"median {after['median']:.2f} (quartiles {after['low']:.2f}, {after['high']:.2f})"
        met = "met" if after["median"] <= LARGEST_GAP else "**not met**"
        rows.append(["held-out RMSE after / noise, named", f"median at most {LARGEST_GAP}", value, after["of"], met])
    met = "met" if f["cases"] >= LEAST_CASES else "**not met**"
    rows.append(["cases", f"at least {LEAST_CASES}", f["cases"], f["cases"], met])
    return Table(("what", "asked", "measured", "cases", "target"), rows)


def tables(f: dict) -> dict[str, Table]:
    """The tables of the page by name, from the figures."""
    groups = [(GROUPS[name].words, g) for name, g in f["groups"].items()]
    shares = ("right [%]", "right or among alternatives [%]", "wrong name [%]")
    return {
        "targets": targets(f),
        "groups": Table(
            ("cases", "number", *shares[:2], "a wrong name without doubt [%]"),
            [(w, g["right"]["of"], *(percent(g[key]) for key in ("right", "included", "wrong"))) for w, g in groups],
        ),
        "outcomes": Table(
            ("cases", "outcomes"), [(w, ", ".join(f"{k} {n}" for k, n in g["outcomes"].items())) for w, g in groups]
        ),
        "size": Table(
            ("size", "cases", *shares[:2], "says `none` [%]", shares[2]),
            [(_range(b), b["right"]["of"], *(percent(b[key]) for key in ("right", "included", "none", "wrong")))
             for b in f["size"]],
        ),
        "told": Table(
            ("distance from the best rival", "cases", *shares, "best possible, two rivals [%]"),
            [(_range(b), b["right"]["of"], *(percent(b[key]) for key in ("right", "included", "wrong")),
              f"{100 * b['ideal']:.1f}") for b in f["told"]],
        ),
        "stated": Table(
            ("stated probability", "mean", "right [%]", "cases"),
            [(f"{b['from']:g} to {b['to']:g}", f"{b['stated']:.3f}", percent(b["right"]), b["right"]["of"])
             for b in f["stated"]],
        ),
        "gap": _gap(f),
        "time": _time(f),
        **_by_effect(f),
    }  # fmt: skip


def _by_effect(f: dict) -> dict[str, Table]:
    rows = []
    for name, e in f["effects"].items():
        if e:
            instead = ", ".join(f"{_words(k)} {n}" for k, n in e["instead"].items())
            rows.append((f"`{name}`", e["right"]["of"], e["right"]["count"], e["included"]["count"],
                         f"{e['alternatives']:.1f}", f"{e['told']:.2f}", instead))  # fmt: skip
    head = ("hidden", "cases", "right", "right or among alternatives", "alternatives", "distance", "said instead")
    pairs = [(f"`{k}`", f"{s['count']} of {s['of']}") for k, s in f["pairs"].items() if s]
    unlisted = [(_words(k), f"{s['count']} of {s['of']}") for k, s in f["hidden_unlisted"].items()]
    return {
        "effects": Table(head, rows),
        "pairs": Table(("two effects, one of them", "both named"), pairs),
        "unlisted": Table(("effect that is in no catalogue", "`unlisted`"), unlisted),
    }


def _gap(f: dict) -> Table:
    words = {"all": "**all named**", "right": "all named rightly", "law": "verdict `unlisted`"}
    keys = ("before", "after", "after_true_noise", "closed")
    rows = [
        (words.get(name) or GROUPS[name].words, g["after"]["of"], *(_spread(g[key]) for key in keys))
        for name, g in f["gap"].items()
    ]
    return Table(("cases", "number", "before", "after", "after, over the true noise", "share closed"), rows)


def _time(f: dict) -> Table:
    rows = []
    for name, t in f["time"].items():
        cpu, wall = t["cpu"], t["seconds"]
        cells = (cpu["median"], cpu["p95"], cpu["most"], wall["median"], wall["most"])
        rows.append((GROUPS[name].words, *(f"{x:.1f}" for x in cells)))
    return Table(("cases", "CPU s, median", "95 %", "most", "wall s, median", "most"), rows)


def page(result: dict, kept: dict[str, str]) -> str:
    """The page as Markdown, with the parts that are kept."""
    f = result["figures"]
    hard = sum(b["right"]["of"] for b in f["told"] if b["to"] is not None and b["to"] <= LEAST_TOLD)
    return render(
        "benchmarks:discrepancy.md", result=result, f=f, tables=tables(f), kept=kept, hard=hard,
        least_told=f"{LEAST_TOLD:g}", development=DEVELOPMENT,
    ) + "\n"  # fmt: skip


def read_kept(path: Path) -> dict[str, str]:
    """What stands between the markers of a page; nothing where there is none."""
    if not path.exists():
        return {}
    text = path.read_text(encoding="utf-8")
    found = {name: re.search(rf"<!-- {name} -->(.*?)<!-- end -->", text, re.DOTALL) for name in KEPT}
    return {name: match[1] for name, match in found.items() if match}


def write(result: dict, folder: Path) -> None:
    """discrepancy.md and its plots into `folder`; the kept parts of the page there stay."""
    path = folder / "discrepancy.md"
    text = page(result, read_kept(path))
    f, cases = result["figures"], result["cases"]
    plots.curve(f, folder / "discrepancy_curve.png")
    plots.confusion([r for r in cases if r["group"] == "one"], folder / "discrepancy_confusion.png")
    plots.gap(cases, folder / "discrepancy_gap.png")
    replace_file(path, text)


def summary(result: dict) -> str:
    """The targets for the terminal, one line each."""
    f = result["figures"]
    lines = [f"{what}: {measured} ({cases} cases), asked {asked}: {met}".replace("**", "")
             for what, asked, measured, cases, met in targets(f).rows]  # fmt: skip
    wrong = [name for name in f["groups"] if name.startswith(OPTIONS)]
    lines += [f"{GROUPS[name].words}: right {percent(f['groups'][name]['right'])} %" for name in wrong]
    return "\n".join(lines)
