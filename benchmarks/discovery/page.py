"""Scores of a set as JSON, and as a page with the pictures of the reliability."""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.blind.score import LEAST_IN_BIN, TARGETS
from benchmarks.blind.sets import SETS, CaseSet
from soil_env._io.files import replace_file

REPORTED = 2027  # the seed that is reported
CALIBRATED = 0.05  # largest deviation of stated probabilities that is asked for


def stem(name: str) -> str:
    """Name, without suffix, of the files of a set."""
    return "blind_scores" if name == "laws" else f"blind_scores_{name}"


def percent(value: dict | None) -> str:
    """Share with its interval [%] and the number of cases."""
    if value is None:
        return "-"
    return f"{100 * value['value']:.1f} [{100 * value['low']:.1f}, {100 * value['high']:.1f}] of {value['of']}"


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines) + "\n"


def _asked(target, of: CaseSet) -> str:
    return f"{'>=' if target.least else '<='} {100 * of.bounds[target.key]:.3g}"


def _deviation(calibration: dict, key: str) -> str:
    return "-" if calibration[key] is None else f"{100 * calibration[key]:.1f}"


def _before(result: dict) -> str:
    """That the reported cases are not new to the workflow."""
    if (result["set"], result["seed"]) != ("laws", REPORTED):
        return ""
    return f"""

Seed {REPORTED} is not fresh: earlier versions of the workflow have answered cases of it, and their scores were read.
Nothing was set on it; what was, on seeds from 100000 on. The version that answered now is the one named above. A
verdict is against the stated probabilities where it says a name of less than 50 %, or none where one has more."""


def _missed(entrants: dict, of: CaseSet) -> str:
    """What each entrant misses of what is asked."""
    lines = []
    for label, f in entrants.items():
        missed = []
        for t in TARGETS:
            v, bound = f["targets"][t.key], of.bounds[t.key]
            if v is not None and (v["value"] < bound if t.least else v["value"] > bound):
                missed.append(f"{t.words} ({100 * v['value']:.1f}, asked {100 * bound:g})")
        for key, words in (("first", "first name"), ("all", "every mechanism")):
            largest = f["calibration"][key]["largest"]
            if largest is not None and largest > CALIBRATED:
                missed.append(f"stated probabilities, {words} ({100 * largest:.1f} points, asked {100 * CALIBRATED:g})")
        lines.append(f"- Missed by {label}: {'; '.join(missed) or 'nothing'}.\n")
    return "".join(lines)


def _by(entrants: dict, key: str, values, words: str) -> str:
    """One table an entrant: targets against the values of a key of its figures."""
    parts = []
    for label, f in entrants.items():
        rows = [[v, *(percent(f[key][v][t.key]) if v in f[key] else "-" for t in TARGETS)] for v in values(f)]
        parts.append(f"\n**{label}**\n\n" + _table([words, *(t.words for t in TARGETS)], rows))
    return "".join(parts)


def _ideal(entrants: dict) -> str:
    known = [100 * f["ideal"] for f in entrants.values() if f["ideal"] is not None]
    return f"{known[0]:.0f}" if known else "-"


def _cases(entrants: dict) -> str:
    return ", ".join(f"{k} {f['cases']} (soil_env {f.get('soil_env', '-')})" for k, f in entrants.items())


def markdown(result: dict) -> str:
    """The page of the scores."""
    entrants, of = result["entrants"], SETS[result["set"]]
    pictures = "".join(f"![{label}]({stem(of.name)}_{label}.svg)\n" for label in entrants)
    head = ["what", "asked [%]", *entrants]
    rows = [[t.words, _asked(t, of), *(percent(f["targets"][t.key]) for f in entrants.values())] for t in TARGETS]
    for t in TARGETS[:2]:
        nearest = [percent(f["nearest"][t.key]) for f in entrants.values()]
        rows.append([f"{t.words}; where its own listed form is nearest", "", *nearest])
    for key, words in (("first", "first name"), ("all", "every mechanism")):
        for size, asked in (("largest", f"<= {100 * CALIBRATED:.0f}"), ("mean", "")):
            deviations = [_deviation(f["calibration"][key], size) for f in entrants.values()]
            rows.append([f"{size} deviation of stated probabilities, {words}", asked, *deviations])
    rows.append(["answers that failed", "0", *(f["errors"] for f in entrants.values())])
    rows.append(["verdicts against the stated probabilities", "0", *(f["contradicted"] for f in entrants.values())])
    rows.append(["seconds a case, median (most)", "", *(f"{f['seconds']['median']:.1f} ({f['seconds']['most']:.1f})"
                                                        for f in entrants.values())])  # fmt: skip
    closest = [f"{label} {percent(f['closest'])}" for label, f in entrants.items()]
    sizes = list(dict.fromkeys(size for f in entrants.values() for size in f["by_law"]))
    return f"""# Scores of the blind benchmark{"" if of.name == "laws" else f", {of.name} set"}

Set `{of.name}`, seed {result["seed"]}, generator {result.get("generator", "-")}; [how](blind_benchmark.md).
Cases: {_cases(entrants)}.
Shares in % with 95 % intervals (Wilson) of the cases at or above twice the detection limit; deviations in points: the
largest of a bin of {LEAST_IN_BIN} and more, and the mean over all answers, the expected calibration
error.{_before(result)}

## At {100 * of.main:.0f} % law error, rich tables of one and two wheels

{_table(head, rows)}
{_missed(entrants, of)}
Its own listed form is nearest: the best one of the hidden mechanism leaves less of the truth than that of any other
mechanism (noise-free, law errors in the covariance). Share of all cases of one effect: {"; ".join(closest)} %.
A method that knows the covariance of all errors and chooses between it and its best rival by distance is right in about
{_ideal(entrants)} % of the cases of the first row.

## By law error, rich tables of one wheel on the paper's base law
{_by(entrants, "by_law", lambda f: sizes, "law error")}
## By design, at {100 * of.main:.0f} % law error
{_by(entrants, "by_design", lambda f: list(f["by_design"]), "design")}
## By mechanism, all designs and law errors
{_mechanisms(entrants)}
## Stated probabilities

{pictures}
{_reliability(entrants)}
## Cases below twice the detection limit

{_below(entrants)}
## Verdicts

{_verdicts(entrants)}
## Groups

{_table(["group", "cases", "count"], [[g, n["cases"], n["count"]] for g, n in result.get("groups", {}).items()])}"""


def _mechanisms(entrants: dict) -> str:
    parts = []
    for label, f in entrants.items():
        rows = []
        for m, v in f["mechanisms"].items():
            instead = ", ".join(f"{k} {n}" for k, n in v["instead"].items())
            rows.append([f"`{m}`", percent(v["first"]), percent(v["included"]), instead])
        parts.append(
            f"\n**{label}**\n\n" + _table(["hidden", "first", "first or among alternatives", "said instead"], rows)
        )
    return "".join(parts)


def _reliability(entrants: dict) -> str:
    rows = [
        [label, words, f"{b['from']:g} to {b['to']:g}", f"{100 * b['stated']:.1f}", percent(b["seen"])]
        for label, f in entrants.items()
        for key, words in (("first", "first name"), ("all", "every mechanism"))
        for b in f["calibration"][key]["bins"]
    ]
    return _table(["entrant", "of", "stated between", "mean stated [%]", "seen [%]"], rows)


def _below(entrants: dict) -> str:
    rows = [[label, size, v["cases"], percent(v["first"]), percent(v["wrong"])]
            for label, f in entrants.items() for size, v in f["below"].items()]  # fmt: skip
    return _table(["entrant", "law error", "cases", "mechanism first", "wrong with more than 50 %"], rows)


def _verdicts(entrants: dict) -> str:
    rows = [[label, kind, ", ".join(f"{k} {n}" for k, n in told.items())]
            for label, f in entrants.items() for kind, told in f["verdicts"].items()]  # fmt: skip
    return _table(["entrant", "hidden", "verdicts"], rows)


SIDE, EDGE = 255, 45  # of a diagram and left of it [px]


def picture(f: dict, label: str) -> str:
    """Reliability of an entrant as SVG: seen against stated, with intervals; area of a dot as the number of cases."""
    width = 2 * (SIDE + 2 * EDGE)
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{SIDE + 90}" '
        'font-family="sans-serif" font-size="12" text-anchor="middle">',
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    for k, (key, words) in enumerate((("first", "first name"), ("all", "every mechanism"))):
        out += _diagram(f["calibration"][key]["bins"], EDGE + k * (SIDE + 2 * EDGE), f"stated, {words}")
    out.append(f'<text x="{width / 2}" y="{SIDE + 75}">{label}: share of cases in which the mechanism is there</text>')
    return "\n".join([*out, "</svg>"]) + "\n"


def _diagram(bins: list[dict], left: int, words: str) -> list[str]:
    """Elements of one reliability diagram whose left edge is at `left` [px]."""
    top, low = 20, 20 + SIDE

    def x(value):
        return f"{left + value * SIDE:.1f}"

    def y(value):
        return f"{low - value * SIDE:.1f}"

    out = [
        f'<rect x="{left}" y="{top}" width="{SIDE}" height="{SIDE}" fill="none" stroke="#888"/>',
        f'<line x1="{x(0)}" y1="{y(0)}" x2="{x(1)}" y2="{y(1)}" stroke="#888" stroke-dasharray="4 3"/>',
        f'<text x="{x(0.5)}" y="{low + 34}">{words}</text>',
    ]
    for tick in (0, 0.5, 1):
        out.append(f'<text x="{x(tick)}" y="{low + 16}">{tick:g}</text>')
        out.append(f'<text x="{left - 16}" y="{float(y(tick)) + 4:.1f}">{tick:g}</text>')
    for b in bins:
        seen, at = b["seen"], x(b["stated"])
        size = 2.0 + min(seen["of"], 400) ** 0.5 / 3.0
        out.append(f'<line x1="{at}" y1="{y(seen["low"])}" x2="{at}" y2="{y(seen["high"])}" stroke="#1b7837"/>')
        out.append(f'<circle cx="{at}" cy="{y(seen["value"])}" r="{size:.1f}" fill="#1b7837" fill-opacity="0.7"/>')
    return out


def write(result: dict, folder: Path) -> None:
    """JSON, page and a picture for each entrant, named by `stem`."""
    name = stem(result["set"])
    folder.mkdir(parents=True, exist_ok=True)
    for label, f in result["entrants"].items():
        replace_file(folder / f"{name}_{label}.svg", picture(f, label))
    replace_file(folder / f"{name}.json", json.dumps(result, indent=1) + "\n")
    replace_file(folder / f"{name}.md", markdown(result))


def summary(result: dict) -> str:
    """The targets for the terminal."""
    lines, of = [], SETS[result["set"]]
    for label, f in result["entrants"].items():
        lines.append(f"{label}: {f['cases']} cases, {f['counting']} count, {f['errors']} errors")
        lines += [f"  {t.words}: {percent(f['targets'][t.key])} (asked {_asked(t, of)})" for t in TARGETS]
        first, every = (_deviation(f["calibration"][of_what], "largest") for of_what in ("first", "all"))
        lines.append(f"  largest deviation of stated probabilities: first {first}, all {every} points")
    return "\n".join(lines)
