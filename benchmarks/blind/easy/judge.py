"""How the workflow did: every case judged against its truth, shares with intervals, targets.

A case of one or two effects is *right* if exactly the hidden ones are named, each before its alternatives; *included*
if each is named or among the alternatives of a name of its own; *wrong* if the verdict is `named` and a name is not
hidden. With no effect `none` is right, with one that is in no catalogue `unlisted`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from agents.evaluate import wilson
from benchmarks.blind.easy.forms import EFFECTS
from benchmarks.blind.easy.study import GROUPS

SHOWN = (0.0, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, math.inf)  # bins of the effect size
TOLD = (0.0, 0.25, 0.5, 1.0, 2.0, math.inf)  # bins of how well an effect can be told from its best rival
STATED = (0.0, 0.5, 0.8, 0.95, 0.99, 1.0)  # bins of the probability that the workflow states
OPTIONS = ("repeats", "absent", "outliers", "priors")


class Target(NamedTuple):
    """What is asked."""

    key: str
    words: str
    groups: tuple[str, ...]
    what: str  # a field of `judged`
    bound: float
    least: bool  # at least the bound, else below it


TARGETS = (
    Target("one", "one effect, rich design: the right name first", ("one",), "right", 0.95, True),
    Target("one_included", "the same: right or among the alternatives", ("one",), "included", 0.99, True),
    Target("none", "no effect: `none`", ("none", "none_poor"), "right", 0.98, True),
    Target("two", "two effects: both named", ("two",), "right", 0.85, True),
    Target("unlisted", "unlisted: `unlisted`, and no name", ("unlisted",), "right", 0.90, True),
    Target("poor", "poor design: a wrong name without doubt", ("poor", "none_poor"), "wrong", 0.03, False),
)
LEAST_CASES = 400
LARGEST_GAP = 1.1


class Judged(NamedTuple):
    """What a record is worth."""

    right: bool
    included: bool
    wrong: bool
    outcome: str


def judged(record: dict) -> Judged:
    """`Judged` of a record of `study.solve`."""
    verdict, kind = record["verdict"], record["kind"]
    truth, names = _names(record), [e["name"] for e in record["named"]]
    wrong = verdict == "named" and (kind == "unlisted" or any(n not in truth for n in names))
    if verdict == "error":
        return Judged(False, False, False, "error")
    if kind in ("none", "unlisted"):
        right = verdict == kind
        return Judged(right, right, wrong, "right" if right else _otherwise(verdict))
    right = len(names) == len(truth) and set(names) == set(truth)
    included = right or _included(truth, [{e["name"], *e["alternatives"]} for e in record["named"]])
    if right:
        outcome = "right" if verdict == "named" else "right, with alternatives"
    elif included:
        outcome = "among the alternatives"
    elif verdict == "named" and not wrong:
        outcome = "one of two"
    else:
        outcome = _otherwise(verdict)
    return Judged(right, included, wrong, outcome)


def _included(truth: list[str], sets: list[set[str]]) -> bool:
    if len(truth) != len(sets):
        return False
    return any(all(t in s for t, s in zip(truth, order, strict=True)) for order in (sets, sets[::-1]))


def _otherwise(verdict: str) -> str:
    return {"named": "a wrong name", "ambiguous": "undecided, without it"}.get(verdict, verdict)


OUTCOMES = (
    "right", "right, with alternatives", "among the alternatives", "one of two", "undecided, without it", "none",
    "unlisted", "a wrong name", "error",
)  # fmt: skip


# --- figures ----------------------------------------------------------------------------------------------------------


def share(values: Iterable[bool]) -> dict | None:
    """{count, of, value, low, high} with the Wilson 95 % interval; None of nothing."""
    values = list(values)
    if not values:
        return None
    count = sum(map(bool, values))
    low, high = wilson(count, len(values))
    return {"count": count, "of": len(values), "value": count / len(values), "low": low, "high": high}


def figures(records: list[dict]) -> dict:
    """All figures of the page, as plain values; None or left out where there are no cases."""
    by = {name: [r for r in records if r["group"] == name] for name in GROUPS}
    single = [r for r in records if r["kind"] == "one" and not r["group"].startswith(OPTIONS)]
    rich = [r for r in single if r["group"] in ("one", "weak")]
    return {
        "cases": len(records),
        "rich_cases": sum(GROUPS[r["group"]].design == "rich" for r in records),
        "errors": sum(r["verdict"] == "error" for r in records),
        "drawn": sum(r["drawn"] for r in records),
        "targets": {t.key: share(getattr(judged(r), t.what) for g in t.groups for r in by[g]) for t in TARGETS},
        "groups": {name: _group(chosen) for name, chosen in by.items() if chosen},
        "size": _bins(rich, SHOWN, lambda r: r["truth"][0]["shown"]),
        "told": _bins(by["one"], TOLD, lambda r: r["truth"][0]["named"]),
        "ideal": _ideal(by["one"]),
        "effects": {name: _effect([r for r in by["one"] if r["truth"][0]["name"] == name]) for name in EFFECTS},
        "pairs": {name: share(judged(r).right for r in by["two"] if name in _names(r)) for name in EFFECTS},
        "hidden_unlisted": _by(by["unlisted"], lambda r: r["truth"][0]["name"]),
        "forms": _by(by["one"], lambda r: f"{r['truth'][0]['name']}: {r['truth'][0]['form']}"),
        "stated": _stated(records),
        "gap": _gaps(records),
        "time": {name: _time(chosen) for name, chosen in by.items() if chosen},
    }


def _names(record: dict) -> list[str]:
    return [e["name"] for e in record["truth"]]


def _group(records: list[dict]) -> dict:
    verdicts = [judged(r) for r in records]
    return {
        **{key: share(getattr(v, key) for v in verdicts) for key in ("right", "included", "wrong")},
        "outcomes": {k: n for k in OUTCOMES if (n := sum(v.outcome == k for v in verdicts))},
    }


def _effect(records: list[dict]) -> dict | None:
    if not records:
        return None
    instead = Counter()
    for r in records:
        if not judged(r).right:
            instead[" + ".join(e["name"] for e in r["named"]) or r["verdict"]] += 1
    more = [len(e["alternatives"]) for r in records for e in r["named"]]
    return _group(records) | {
        "instead": dict(instead.most_common()),
        "alternatives": float(np.mean(more)) if more else 0.0,
        "told": float(np.median([r["truth"][0]["named"] for r in records])),
    }


def _by(records: list[dict], key: Callable[[dict], str]) -> dict:
    return {k: share(judged(r).right for r in records if key(r) == k) for k in sorted({key(r) for r in records})}


def _bins(records: list[dict], edges: tuple[float, ...], size: Callable[[dict], float]) -> list[dict]:
    """Shares by bins of a size, empty ones left out."""
    out = []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        inside = [r for r in records if low <= size(r) < high]
        if inside:
            middle = float(np.exp(np.mean([np.log(max(size(r), 1e-3)) for r in inside])))
            none = share(r["verdict"] == "none" for r in inside)
            shown = {"from": low, "to": None if math.isinf(high) else high, "middle": middle, "none": none}
            out.append(shown | {"ideal": _ideal(inside)} | _group(inside))
    return out


def _ideal(records: list[dict]) -> float | None:
    """Mean chance to choose right between the hidden effect and its best rival, by likelihood, both forms known.

    Two Gaussian hypotheses a distance d apart are told apart with the chance Phi(d/2); d^2 is what the rival leaves.
    """
    if not records:
        return None
    return float(np.mean([ndtr(0.5 * math.sqrt(r["truth"][0]["rival_leaves"])) for r in records]))


def _stated(records: list[dict]) -> list[dict]:
    """Where one effect is named: its stated probability against how often it is right."""
    told = []
    for r in records:
        if len(r["named"]) == 1 and r["named"][0]["name"] in r["probability"]:
            told.append((r["probability"][r["named"][0]["name"]], judged(r).right))
    out = []
    for low, high in zip(STATED[:-1], STATED[1:], strict=True):
        inside = [(p, right) for p, right in told if low <= p < high or (high == 1.0 and p == 1.0)]
        if inside:
            mean = float(np.mean([p for p, _ in inside]))
            out.append({"from": low, "to": high, "stated": mean, "right": share(right for _, right in inside)})
    return out


# --- the gap and the time ---------------------------------------------------------------------------------------------


def gap_of(record: dict, which: str, true_noise: bool = False) -> float | None:
    """Held-out RMSE `before` or `after` over the noise, as root mean square over the channels."""
    ratios = []
    for name, gap in record["gap"].items():
        floor = record["noise"][name] if true_noise else gap["noise_floor"]
        if gap[which] is None:
            return None
        ratios.append(gap[which] / floor)
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else None


def _spread(values: list[float]) -> dict | None:
    """Median and quartiles."""
    if not values:
        return None
    low, middle, high = np.percentile(values, [25, 50, 75])
    return {"median": float(middle), "low": float(low), "high": float(high), "of": len(values)}


def _gaps(records: list[dict]) -> dict:
    """Of the cases with a named effect, by group and all together; of the unlisted by themselves."""
    named = [r for r in records if r["verdict"] == "named"]
    chosen = {"all": named, "right": [r for r in named if judged(r).right]}
    chosen |= {name: [r for r in named if r["group"] == name] for name in GROUPS}
    chosen["law"] = [r for r in records if r["verdict"] == "unlisted"]
    out = {}
    for name, group in chosen.items():
        both = [r for r in group if gap_of(r, "before") is not None and gap_of(r, "after") is not None]
        if both:
            out[name] = {
                "before": _spread([gap_of(r, "before") for r in both]),
                "after": _spread([gap_of(r, "after") for r in both]),
                "after_true_noise": _spread([gap_of(r, "after", true_noise=True) for r in both]),
                "closed": _spread([r["closed"] for r in both if r["closed"] is not None]),
            }
    return out


def _time(records: list[dict]) -> dict:
    out = {"of": len(records)}
    for key in ("seconds", "cpu", "drawing"):
        values = [r[key] for r in records]
        out[key] = {
            "median": float(np.median(values)), "p95": float(np.percentile(values, 95)), "most": float(np.max(values)),
        }  # fmt: skip
    return out
