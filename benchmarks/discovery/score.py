"""The scorer: every answer against its truth, shares with Wilson intervals, calibration of the stated probabilities.

A case *counts* for the targets where what is hidden is at or above twice its detection limit; an unlisted mechanism,
where what the best listed one would leave of it is. The rest is reported apart.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr
from scipy.stats import binomtest

from benchmarks.blind.easy.limits import noncentrality
from benchmarks.blind.entrants import Answer
from benchmarks.blind.forms import MECHANISMS
from benchmarks.blind.groups import SIZES
from benchmarks.blind.sets import CaseSet

ASSERTED = ("named", "partly")  # verdicts that say a name without doubt
MORE_LIKELY = 0.5
BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
LEAST_IN_BIN = 20  # below it the deviation of a bin says little
RICH = ("rich", "wheels")


class Judged(NamedTuple):
    """What an answer is worth; fields that do not apply are None."""

    first: bool | None  # kind one: the right mechanism is named first
    included: bool | None  # or is among the names and alternatives
    both: bool | None  # kind two: exactly the hidden ones are named
    silent: bool | None  # no name: kinds none and unlisted
    fitting: bool | None  # the verdict: none or undetermined, unlisted
    wrong: bool  # a name that is not there, with more than 50 % or without a probability and without doubt


def judged(truth: dict, answer: Answer) -> Judged:
    """`Judged` of an answer; names that the base law is a form of (`also`) are not wrong."""
    hidden = [e["name"] for e in truth["effects"]]
    listed = [name for name in hidden if name in MECHANISMS]
    kind, named = truth["kind"], list(answer.named)
    there = {*listed, *truth["also"]}
    wrong = any(p > MORE_LIKELY and name not in there for name, p in stated(answer).items())
    if kind == "one":
        own = [name for name in named if name == listed[0] or name not in truth["also"]]
        first = bool(own) and own[0] == listed[0]
        return Judged(first, first or listed[0] in (*named, *answer.alternatives), None, None, None, wrong)
    if kind == "two":
        return Judged(None, None, set(listed) <= set(named) <= there, None, None, wrong)
    strangers = [name for name in named if name not in truth["also"]]
    fitting = answer.verdict in (("unlisted",) if kind == "unlisted" else ("none", "undetermined"))
    return Judged(None, None, None, not strangers and not wrong, fitting, wrong)


def stated(answer: Answer) -> dict[str, float]:
    """Probability of each mechanism that an answer states; a name said without doubt and without one counts as sure."""
    out = dict(answer.probabilities)
    if answer.verdict in ASSERTED:
        out |= {name: 1.0 for name in answer.named if name not in out}
    return out


def contradicted(answer: Answer) -> bool:
    """Whether the verdict says a name that is stated at less than 50 %, or none where one is stated at more."""
    p = stated(answer)
    if answer.verdict in ASSERTED:
        return any(p[name] < MORE_LIKELY for name in answer.named)
    return answer.verdict in ("none", "unlisted", "undetermined") and max(p.values(), default=0.0) > MORE_LIKELY


# --- shares -----------------------------------------------------------------------------------------------------------


def share(values: Iterable[bool]) -> dict | None:
    """{count, of, value, low, high} with the 95 % interval (Wilson 1927); None of nothing."""
    values = [bool(v) for v in values]
    if not values:
        return None
    interval = binomtest(sum(values), len(values)).proportion_ci(method="wilson")
    value = sum(values) / len(values)
    return {"count": sum(values), "of": len(values), "value": value, "low": interval.low, "high": interval.high}


class Record(NamedTuple):
    """A case with its answer."""

    truth: dict
    answer: Answer
    judged: Judged
    seconds: float


class Target(NamedTuple):
    """What is asked of an entrant."""

    key: str
    words: str
    kind: str
    value: Callable[[Record], bool]
    least: bool  # at least the bound of the set, else at most


TARGETS = (
    Target("first", "one effect: its mechanism named first", "one", lambda r: r.judged.first, True),
    Target("included", "the same: first or among the alternatives", "one", lambda r: r.judged.included, True),
    Target("wrong", "one effect: a wrong name with more than 50 %", "one", lambda r: r.judged.wrong, False),
    Target("both", "two effects: both named", "two", lambda r: r.judged.both, True),
    Target("none", "no effect: no name", "none", lambda r: r.judged.silent, True),
    Target("unlisted", "unlisted: no name with more than 50 %", "unlisted", lambda r: not r.judged.wrong, True),
)


def targets(records: list[Record]) -> dict[str, dict | None]:
    """Share of each target among cases that count."""
    counting = [r for r in records if r.truth["counts"]]
    return {t.key: share(t.value(r) for r in counting if r.truth["kind"] == t.kind) for t in TARGETS}


def figures(records: list[Record], of: CaseSet) -> dict:
    """All figures of one entrant on the cases of a set, as plain values."""
    sizes = [size for size in SIZES if any(g.error == size for g in of.groups.values())]
    rich = [r for r in records if r.truth["design"] in RICH and r.truth["sort"] != "weak"]
    plain = [r for r in rich if r.truth["design"] == "rich" and not r.truth["sort"]]
    named = [r for r in records if r.truth["kind"] == "one" and r.truth["counts"]]
    at_main = [r for r in records if r.truth["law_error"] == of.main]
    main = [r for r in rich if r.truth["law_error"] == of.main]
    return {
        "cases": len(records),
        "counting": sum(r.truth["counts"] for r in records),
        "errors": sum(r.answer.verdict == "error" for r in records),
        "contradicted": sum(contradicted(r.answer) for r in records),
        "targets": targets(main),
        "by_law": {f"{size:g}": targets([r for r in plain if r.truth["law_error"] == size]) for size in sizes},
        "by_design": {d: targets([r for r in at_main if _design(r) == d]) for d in sorted(set(map(_design, at_main)))},
        "below": {f"{size:g}": _below([r for r in records if r.truth["law_error"] == size]) for size in sizes},
        "mechanisms": {m: _mechanism([r for r in named if r.truth["effects"][0]["name"] == m]) for m in MECHANISMS},
        "closest": share(_nearest(r) for r in named),
        "ideal": _ideal([r for r in main if r.truth["kind"] == "one" and r.truth["counts"]]),
        "nearest": targets([r for r in main if _nearest(r)]),
        "verdicts": _verdicts(records),
        "calibration": {"first": reliability(_firsts(records)), "all": reliability(_all(records)),
                        "first_at_main": reliability(_firsts(at_main)), "all_at_main": reliability(_all(at_main))},
        "seconds": _quantiles([r.seconds for r in records]),
    }  # fmt: skip


def _nearest(r: Record) -> bool:
    """Whether the best listed form of every hidden mechanism leaves less than that of any other."""
    return bool(r.truth["effects"]) and all(
        e["own_left"] is not None and (e["rival_left"] is None or e["own_left"] < e["rival_left"])
        for e in r.truth["effects"]
    )


def _ideal(records: list[Record]) -> float | None:
    """Mean chance that the own listed form beats its best rival by distance, the covariance of all errors known.

    For whitened truth d and forms a, b the chance is Phi[(|d - b|^2 - |d - a|^2)/(2 |a - b|)], and |a - b| is at most
    the sum of both distances: a lower bound where a is nearer, an upper one where b is; one rival only.
    """
    effects = [
        e for r in records for e in r.truth["effects"] if e["own_left"] is not None and e["rival_left"] is not None
    ]
    if not effects:
        return None
    return float(
        np.mean([ndtr(0.5 * math.sqrt(noncentrality(1)) * (e["rival_left"] - e["own_left"])) for e in effects])
    )


def _design(r: Record) -> str:
    return " ".join(filter(None, (r.truth["design"], r.truth["sort"])))


def _below(records: list[Record]) -> dict:
    """Of the cases that do not count: how many, right first, wrong with more than 50 %."""
    records = [r for r in records if not r.truth["counts"]]
    ones = [r for r in records if r.truth["kind"] == "one"]
    return {
        "cases": len(records),
        "first": share(r.judged.first for r in ones),
        "wrong": share(r.judged.wrong for r in records),
    }


def _mechanism(records: list[Record]) -> dict:
    """Shares of one mechanism, over all designs and law errors, and what was said instead."""
    instead: dict[str, int] = {}
    for r in records:
        if not r.judged.first:
            said = r.answer.named[0] if r.answer.named else r.answer.verdict
            instead[said] = instead.get(said, 0) + 1
    return {
        "first": share(r.judged.first for r in records), "included": share(r.judged.included for r in records),
        "instead": dict(sorted(instead.items(), key=lambda item: -item[1])),
    }  # fmt: skip


def _verdicts(records: list[Record]) -> dict:
    out: dict[str, dict[str, int]] = {}
    for r in records:
        told = out.setdefault(r.truth["kind"], {})
        told[r.answer.verdict] = told.get(r.answer.verdict, 0) + 1
    return out


def _quantiles(values: list[float]) -> dict | None:
    if not values:
        return None
    return {"median": float(np.median(values)), "p95": float(np.percentile(values, 95)), "most": float(np.max(values))}


# --- calibration ------------------------------------------------------------------------------------------------------


def _firsts(records: list[Record]) -> list[tuple[float, bool]]:
    """(probability of the first name, whether it is there) of the answers that have one."""
    return [
        (stated(r.answer)[r.answer.named[0]], r.answer.named[0] in _there(r))
        for r in records if r.answer.named and r.answer.named[0] in stated(r.answer)
    ]  # fmt: skip


def _all(records: list[Record]) -> list[tuple[float, bool]]:
    """(probability, whether it is there) of every mechanism in every answer; those left out count as 0."""
    return [
        (stated(r.answer).get(m, 0.0), m in _there(r))
        for r in records if r.answer.verdict != "error" for m in MECHANISMS if m not in r.truth["also"]
    ]  # fmt: skip


def _there(r: Record) -> set[str]:
    return {e["name"] for e in r.truth["effects"]} | set(r.truth["also"])


def reliability(pairs: list[tuple[float, bool]]) -> dict:
    """Stated against observed: bins, the largest deviation of a well-filled bin, the mean one, the Brier score."""
    bins = []
    for low, high in zip(BINS[:-1], BINS[1:], strict=True):
        inside = [(p, x) for p, x in pairs if low <= p < high or (high == 1.0 and p >= 1.0)]
        if inside:
            mean, seen = float(np.mean([p for p, _ in inside])), share(x for _, x in inside)
            bins.append({"from": low, "to": high, "stated": mean, "seen": seen, "deviation": abs(mean - seen["value"])})
    filled = [b for b in bins if b["seen"]["of"] >= LEAST_IN_BIN]
    total = sum(b["seen"]["of"] for b in bins)
    return {
        "of": total, "bins": bins,
        "largest": max((b["deviation"] for b in filled), default=None),
        "mean": sum(b["deviation"] * b["seen"]["of"] for b in bins) / total if total else None,
        "brier": float(np.mean([(p - x) ** 2 for p, x in pairs])) if pairs else None,
    }  # fmt: skip


# --- files ------------------------------------------------------------------------------------------------------------


def read_records(folder: Path, label: str, names: Iterable[str]) -> list[Record]:
    """Those cases of the names that an entrant has answered. Raises `ValueError` for a damaged file."""
    out = []
    for name in names:
        said = folder / "answers" / label / f"{name}.json"
        if not said.exists():
            continue
        try:
            content = json.loads(said.read_text(encoding="utf-8"))
            truth = json.loads((folder / "truth" / f"{name}.json").read_text(encoding="utf-8"))
            seconds = content.pop("seconds", math.nan)
            content.pop("cpu", None)
            answer = Answer.of(content)
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{said}: {error}; delete the file to have the case asked again") from None
        out.append(Record(truth, answer, judged(truth, answer), seconds))
    return out


def group_counts(records: list[Record], of: CaseSet) -> dict[str, dict[str, int]]:
    """Cases of each group, and how many of them count."""
    out = {}
    for name in of.groups:
        inside = [r for r in records if r.truth["case"].rpartition("-")[0] == name]
        if inside:
            out[name] = {"cases": len(inside), "count": sum(r.truth["counts"] for r in inside)}
    return out
