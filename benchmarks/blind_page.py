"""docs/discrepancy.md from the result of benchmarks/blind.py.

What stands between the markers `<!-- remarks -->` or `<!-- cmu -->` and the next `<!-- end -->` comes from elsewhere
and stays when the page is renewed.
"""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

from benchmarks import blind_plots
from benchmarks.blind_judge import LARGEST_GAP, LEAST_CASES, OPTIONS, TARGETS
from benchmarks.blind_study import GROUPS
from soil_env._io.files import replace_file

KEPT = ("remarks", "cmu")
LEAST_TOLD = 1.0
#: Seeds of the cases that were looked at while the model and the search were made.
DEVELOPMENT = (0, 1, 2, 7, 8, 11, 21, 31, 41, *range(50, 60))


def _wrap(text: str) -> list[str]:
    return textwrap.wrap(" ".join(text.split()), 118, break_long_words=False, break_on_hyphens=False)


def _row(*cells) -> str:
    return "| " + " | ".join(str(c) for c in cells) + " |"


def _head(*cells) -> list[str]:
    return [_row(*cells), "|" + "---|" * len(cells)]


def _words(name: str) -> str:
    return name.replace("_", " ")


def percent(share: dict | None) -> str:
    """Share with its interval [%]."""
    if share is None:
        return "-"
    return f"{100 * share['value']:.1f} [{100 * share['low']:.1f}, {100 * share['high']:.1f}]"


def _short(share: dict | None) -> str:
    return "-" if share is None else f"{100 * share['value']:.0f}"


# --- targets ----------------------------------------------------------------------------------------------------------


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


def targets(f: dict) -> list[list[str]]:
    """Rows of the table of targets: what, asked, measured, cases, met."""
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
    return rows


def _targets(f: dict) -> list[str]:
    lines = [
        "## What was asked, and what came out",
        "",
        *_wrap(
            """Shares with Wilson 95 % intervals. A name counts as first only if nothing else is claimed beside it: one
            hidden effect and two names is a failure. Two names are right in either order. A wrong name without doubt
            is the verdict `named` with a name that is not hidden."""
        ),
        "",
        *_head("what", "asked", "measured", "cases", "target"),
        *(_row(*r) for r in targets(f)),
    ]
    if f["errors"]:
        lines += ["", f"In {f['errors']} cases the workflow broke off with an error; they count as failures."]
    return lines


# --- the groups -------------------------------------------------------------------------------------------------------


def _groups(f: dict) -> list[str]:
    lines = [
        "## All groups",
        "",
        *_wrap("""Rich designs where nothing else is said, 2 to 8 times the detection limit. The target figures of the
               first table are those of the groups without options; the options are told here."""),
        "",
        *_head("cases", "number", "right [%]", "right or among alternatives [%]", "a wrong name without doubt [%]"),
    ]
    for name, g in f["groups"].items():
        row = (percent(g[key]) for key in ("right", "included", "wrong"))
        lines.append(_row(GROUPS[name].words, g["right"]["of"], *row))
    lines += ["", "How they end:", "", *_head("cases", "outcomes")]
    for name, g in f["groups"].items():
        lines.append(_row(GROUPS[name].words, ", ".join(f"{k} {n}" for k, n in g["outcomes"].items())))
    return lines


def _curve(f: dict) -> list[str]:
    lines = [
        "## Success against effect size",
        "",
        *_wrap(
            """Size: root of the noise-weighted sum of squares that the best refit of the base model, soil and all,
            leaves of the noise-free table, over that at the detection limit. The limit is where a chi-square test
            at the 1 % level finds the effect in 95 % of the tables; the test is told which effect to look for, the
            workflow is not. Groups of one effect in rich designs, forms and strengths mixed."""
        ),
        "",
        *_head("size", "cases", "right [%]", "right or among alternatives [%]", "says `none` [%]", "wrong name [%]"),
    ]
    for b in f["size"]:
        shares = (percent(b[key]) for key in ("right", "included", "none", "wrong"))
        lines.append(_row(_range(b), b["right"]["of"], *shares))
    return [*lines, "", "![Success against effect size](discrepancy_curve.png)"]


def _range(b: dict) -> str:
    return f"{b['from']:g} and more" if b["to"] is None else f"{b['from']:g} to {b['to']:g}"


def _told(f: dict) -> list[str]:
    lines = [
        "## Where nobody could tell",
        "",
        *_wrap(
            """An effect can be seen clearly and still not be told from another one: the best other listed effect,
            its strength and the soil refitted, may leave next to nothing. The truth of each case says how much is
            left, in the same units (below 1: the difference could not be detected even by one who looks for it). The
            last column is what could be reached at best between the hidden effect and its best rival alone: the mean
            chance that the more likely of the two is the hidden one, both forms known. Forms that are not known and
            further rivals make it less, plausible strengths may make it more. One effect, rich designs, 2 to 8 times
            the detection limit."""
        ),
        "",
        *_head("distance from the best rival", "cases", "right [%]", "right or among alternatives [%]",
               "wrong name [%]", "best possible, two rivals [%]"),
    ]  # fmt: skip
    for b in f["told"]:
        shares = (percent(b[key]) for key in ("right", "included", "wrong"))
        lines.append(_row(_range(b), b["right"]["of"], *shares, f"{100 * b['ideal']:.1f}"))
    if f["ideal"] is not None:
        right = f["groups"]["one"]["right"]
        hard = sum(b["right"]["of"] for b in f["told"] if b["to"] is not None and b["to"] <= LEAST_TOLD)
        text = f"Over all {right['of']} cases the best possible is {100 * f['ideal']:.1f} %, the workflow has "
        text += f"{100 * right['value']:.1f} %. In {hard} of them the distance is below {LEAST_TOLD:g}."
        lines += ["", *_wrap(text)]
    return lines


def _effects(f: dict) -> list[str]:
    lines = [
        "## By effect",
        "",
        *_wrap("""One effect, rich designs, 2 to 8 times the detection limit. `distance`: median of the distance from
               the best rival. `alternatives`: mean number returned with the name. The last column is what was said
               instead, with its count: names, or the verdict where nothing is named."""),
        "",
        *_head("hidden", "cases", "right", "right or among alternatives", "alternatives", "distance", "said instead"),
    ]
    for name, e in f["effects"].items():
        if e:
            instead = ", ".join(f"{_words(k)} {n}" for k, n in e["instead"].items())
            lines.append(
                _row(f"`{name}`", e["right"]["of"], e["right"]["count"], e["included"]["count"],
                     f"{e['alternatives']:.1f}", f"{e['told']:.2f}", instead)
            )  # fmt: skip
    lines += ["", "![Hidden effect against the name](discrepancy_confusion.png)", "",
              *_head("two effects, one of them", "both named"),
              *(_row(f"`{k}`", f"{s['count']} of {s['of']}") for k, s in f["pairs"].items() if s)]  # fmt: skip
    lines += ["", *_head("effect that is in no catalogue", "`unlisted`"),
              *(_row(_words(k), f"{s['count']} of {s['of']}") for k, s in f["hidden_unlisted"].items())]  # fmt: skip
    return lines


# --- the gap, the probabilities, the time -----------------------------------------------------------------------------


def _gap(f: dict) -> list[str]:
    lines = [
        "## The gap",
        "",
        *_wrap(
            """Held-out RMSE over the noise, the root mean square of the channels; whole groups of conditions are held
            out, as the workflow reports it. Median, with quartiles. Over the true noise: over that of the generator,
            not that which the workflow was given or has found. Verdict `named`; in the last row `unlisted`, where a
            law for the residual is added without a name."""
        ),
        "",
        *_head("cases", "number", "before", "after", "after, over the true noise", "share closed"),
    ]
    words = {"all": "**all named**", "right": "all named rightly", "law": "verdict `unlisted`"}
    for name, g in f["gap"].items():
        spreads = [_spread(g[key]) for key in ("before", "after", "after_true_noise", "closed")]
        lines.append(_row(words.get(name) or GROUPS[name].words, g["after"]["of"], *spreads))
    return [*lines, "", "![Held-out error before and after](discrepancy_gap.png)"]


def _spread(s: dict | None) -> str:
    return "-" if s is None else f"{s['median']:.2f} ({s['low']:.2f}, {s['high']:.2f})"


def _stated(f: dict) -> list[str]:
    return [
        "## How sure it says it is",
        "",
        *_wrap("All cases in which one effect is named, first or alone: the probability in the report against how "
               "often the name was right."),
        "",
        *_head("stated probability", "mean", "right [%]", "cases"),
        *(_row(f"{b['from']:g} to {b['to']:g}", f"{b['stated']:.3f}", percent(b["right"]), b["right"]["of"])
          for b in f["stated"]),
    ]  # fmt: skip


def _time(f: dict, machine: str) -> list[str]:
    lines = [
        "## Time",
        "",
        *_wrap(f"""{machine}, one thread each. Everything from the two files to the report in memory, without the
               bootstrap of the name and without writing files. CPU time first: the wall clock depends on what else
               the machine does."""),
        "",
        *_head("cases", "CPU s, median", "95 %", "most", "wall s, median", "most"),
    ]
    for name, t in f["time"].items():
        cpu, wall = t["cpu"], t["seconds"]
        cells = (f"{x:.1f}" for x in (cpu["median"], cpu["p95"], cpu["most"], wall["median"], wall["most"]))
        lines.append(_row(GROUPS[name].words, *cells))
    return lines


# --- the page ---------------------------------------------------------------------------------------------------------

_MADE = """
Each case is drawn by `benchmarks/blind_cases.py` from the seed, its group and its number alone. The generator is
written apart from the model, with its own quadrature, root search and refits in numpy and scipy. It hides an effect in
one of several published forms, which are mostly not those that the model fits: Lyasko, Ding or Reece for slip-sinkage,
a blade force or an enlarged radius for grousers, Rankine, Hegedus or Bekker for bulldozing, logarithmic or power laws
of rate. Soil (dry sand to clayey loam), wheel (radius 0.08 to 0.35 m), loads, speeds, grades, slips, noise (about 1 %
of the load, 0.4 to 1.2 % of the radius), side parameters of the form and the error of the priors are random.

- Rich design: 3 loads, 3 speeds, 3 passes, 6 slips, three grades in a Latin square: 162 rows of 3 channels.
- Poor design: one load, one speed, one pass, no grade, 6 to 9 slips, three times.
- Strength: log-uniform between multiples of the detection limit, never beyond what is physically sensible.
- Two effects: neither alone, nor any third one, explains what both do; each is at 2 to 8 times its limit beside the
  other.
- Unlisted: no listed effect, and no two, imitate it to below twice the limit.
- Noise from repeats: 9 combinations, each three times, no noise in the setup. No repeats: none in the setup either.
- Outliers: 2 % of the cells off by 5 to 15 standard deviations.
- Priors off: every prior by two of its standard deviations, up or down.

The workflow is given a folder with `data.csv` and `setup.yaml`; the truth is in another one. Effects, forms and pairs
are taken in turn, so that each effect has as many cases as any other; in the poor design effects are drawn among those
that can be seen at all.
"""

_OTHER_SEED = "The figures above are of a seed that was not used for that; but they are of the same generator."
_SAME_SEED = "**The figures above are of one of these seeds**: they say how well the development cases are fitted."
_LIMITS = """
- The forms of the model were extended, and the thresholds of the search set, after looking at cases of this very
  generator, drawn with the seeds 0, 1, 2, 7, 8, 11, 21, 31, 41 and 50 to 59.
  {seed}
  Real soil follows neither the generator nor the model: see the measured data.
- The generator and the model share the physics that both take from the literature (rigid wheel, Wong and Reece, Janosi
  and Hanamoto), the meaning of the columns, and Gaussian noise. A rig has errors that are none of these.
- Priors are honest except in the last option: the true soil lies about one standard deviation off.
- Distances from rivals are linearised, with the forms of the generator.
- How often each effect is missing in the real world is unknown; here all are equally frequent.
"""


def page(result: dict, kept: dict[str, str]) -> str:
    """The page as Markdown, with the parts that are kept."""
    f = result["figures"]
    lines = [
        "# The discrepancy workflow, tested blind",
        "",
        *_wrap(f"""Tables in which an effect is hidden, or none, or two, or one that no catalogue has; the workflow sees
               the table and the setup and has to say what is missing. Made by `{result["command"]}`, code
               {result["code"]}. `discrepancy.json` beside this page has every case."""),
        "",
        *(["A smoke run: numbers without meaning.", ""] if result["smoke"] else []),
        *_targets(f),
        "",
        *_kept("remarks", kept),
        *_groups(f),
        "",
        *_curve(f),
        "",
        *_told(f),
        "",
        *_effects(f),
        "",
        *_gap(f),
        "",
        *_stated(f),
        "",
        *_time(f, result["machine"]),
        "",
        "## How the cases are made",
        *_MADE.splitlines(),
        "",
        "## What this does not show",
        *_LIMITS.format(seed=_SAME_SEED if result["seed"] in DEVELOPMENT else _OTHER_SEED).splitlines(),
    ]
    if f["drawn"]:
        lines += [f"- In {f['drawn']} cases the effect in turn could not be seen in any table, and another was drawn."]
    return "\n".join([*lines, "", *_kept("cmu", kept)])


def _kept(name: str, kept: dict[str, str]) -> list[str]:
    return [f"<!-- {name} -->{kept.get(name, chr(10))}<!-- end -->", ""]


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
    blind_plots.curve(f, folder / "discrepancy_curve.png")
    blind_plots.confusion([r for r in cases if r["group"] == "one"], folder / "discrepancy_confusion.png")
    blind_plots.gap(cases, folder / "discrepancy_gap.png")
    replace_file(path, text)


def summary(result: dict) -> str:
    """The targets for the terminal, one line each."""
    f = result["figures"]
    lines = [f"{what}: {measured} ({cases} cases), asked {asked}: {met}".replace("**", "")
             for what, asked, measured, cases, met in targets(f)]  # fmt: skip
    wrong = [name for name in f["groups"] if name.startswith(OPTIONS)]
    lines += [f"{GROUPS[name].words}: right {percent(f['groups'][name]['right'])} %" for name in wrong]
    return "\n".join(lines)
