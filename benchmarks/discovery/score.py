"""Scores: every answer against its truth, shares with Wilson intervals, calibration of the stated probabilities.

A case *counts* for the targets where the hidden effect is at or above twice its detection limit; an unlisted mechanism,
where what the best listed form would leave of it is. Only the calibration has the other cases too.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.common import page, percent, share
from benchmarks.discovery.cases import SETS
from benchmarks.discovery.entrants import Answer
from benchmarks.discovery.forms import MECHANISMS
from soil_env._io.document import Table
from soil_env._io.loading import ParameterError

ASSERTED = ("named", "partly")  # verdicts that assert a name
MORE_LIKELY = 0.5
BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
LEAST_IN_BIN = 20  # a bin with fewer answers has no deviation
RICH = ("rich", "wheels")
MAIN = 0.1  # size of the law errors at which the targets are set
CALIBRATED = 0.05  # largest deviation of stated probabilities that is asked for


class Judged(NamedTuple):
    """Judgement of an answer; fields that do not apply are None."""

    first: bool | None  # kind one: the right mechanism is named first
    included: bool | None  # or is among the names and alternatives
    both: bool | None  # kind two: exactly the hidden ones are named
    silent: bool | None  # kinds none and unlisted: no name
    wrong: bool  # a name that is not there, with more than 50 % or asserted without a probability


def judged(truth: Mapping[str, Any], answer: Answer) -> Judged:
    """Judge an answer; names that the base law is a form of (`also`) are not wrong."""
    listed = [e["name"] for e in truth["effects"] if e["name"] in MECHANISMS]
    kind, named = truth["kind"], list(answer.named)
    there = {*listed, *truth["also"]}
    wrong = any(p > MORE_LIKELY and name not in there for name, p in stated(answer).items())
    if kind == "one":
        own = [name for name in named if name == listed[0] or name not in truth["also"]]
        first = bool(own) and own[0] == listed[0]
        return Judged(first, first or listed[0] in (*named, *answer.alternatives), None, None, wrong)
    if kind == "two":
        return Judged(None, None, set(listed) <= set(named) <= there, None, wrong)
    return Judged(None, None, None, not (set(named) - set(truth["also"])) and not wrong, wrong)


def stated(answer: Answer) -> dict[str, float]:
    """Probability of each mechanism that an answer states; an asserted name without one counts as sure."""
    asserted = answer.named if answer.verdict in ASSERTED else ()
    return {name: 1.0 for name in asserted} | dict(answer.probabilities)


def contradicted(answer: Answer) -> bool:
    """True if the verdict asserts a name that is stated at less than 50 %, or no name where one has more."""
    p = stated(answer)
    if answer.verdict in ASSERTED:
        return any(p[name] < MORE_LIKELY for name in answer.named)
    return answer.verdict in ("none", "unlisted", "undetermined") and max(p.values(), default=0.0) > MORE_LIKELY


class Record(NamedTuple):
    """Case with its answer."""

    truth: dict
    answer: Answer
    judged: Judged
    seconds: float


class Target(NamedTuple):
    """Share that is asked of an entrant."""

    key: str
    words: str
    kind: str
    value: Callable[[Record], bool]
    bound: float
    least: bool  # at least the bound, else at most


TARGETS = (
    Target("first", "one effect: its mechanism named first", "one", lambda r: r.judged.first, 0.85, True),
    Target("included", "the same: first or among the alternatives", "one", lambda r: r.judged.included, 0.95, True),
    Target("wrong", "one effect: a wrong name with more than 50 %", "one", lambda r: r.judged.wrong, 0.05, False),
    Target("both", "two effects: both named", "two", lambda r: r.judged.both, 0.70, True),
    Target("none", "no effect: no name", "none", lambda r: r.judged.silent, 0.95, True),
    Target("unlisted", "unlisted: no name with more than 50 %", "unlisted", lambda r: not r.judged.wrong, 0.90, True),
)


def targets(records: Iterable[Record]) -> dict[str, dict | None]:
    """Share of each target among cases that count."""
    counting = [r for r in records if r.truth["counts"]]
    return {t.key: share(t.value(r) for r in counting if r.truth["kind"] == t.kind) for t in TARGETS}


def figures(records: list[Record]) -> dict:
    """All figures of one entrant as plain values."""
    rich = [r for r in records if r.truth["design"] in RICH and r.truth["sort"] != "weak"]
    plain = [r for r in rich if r.truth["design"] == "rich" and not r.truth["sort"]]
    main = [r for r in rich if r.truth["law_error"] == MAIN]
    sizes, designs = sorted({r.truth["law_error"] for r in plain}), sorted({r.truth["design"] for r in records})
    named = [r for r in records if r.truth["kind"] == "one" and r.truth["counts"]]
    seconds = [r.seconds for r in records]
    return {
        "cases": len(records),
        "counting": sum(r.truth["counts"] for r in records),
        "errors": sum(r.answer.verdict == "error" for r in records),
        "contradicted": sum(contradicted(r.answer) for r in records),
        "targets": targets(main),
        "by_law": {f"{size:g}": targets(r for r in plain if r.truth["law_error"] == size) for size in sizes},
        "by_design": {d: targets(r for r in records if r.truth["design"] == d) for d in designs},
        "mechanisms": {m: {"first": share(r.judged.first for r in named if r.truth["effects"][0]["name"] == m)}
                       for m in MECHANISMS},
        "calibration": {"first": reliability(_firsts(records)), "all": reliability(_all(records))},
        "seconds": {"median": float(np.median(seconds)), "most": max(seconds)} if seconds else None,
    }  # fmt: skip


# --- calibration ------------------------------------------------------------------------------------------------------


def _there(r: Record) -> set[str]:
    return {e["name"] for e in r.truth["effects"]} | set(r.truth["also"])


def _firsts(records: list[Record]) -> list[tuple[float, bool]]:
    """(Probability of the first name, true if it is there) of the answers that have one."""
    pairs = [(r, r.answer.named[0]) for r in records if r.answer.named]
    return [(stated(r.answer)[name], name in _there(r)) for r, name in pairs if name in stated(r.answer)]


def _all(records: list[Record]) -> list[tuple[float, bool]]:
    """(Probability, true if it is there) of every mechanism in every answer; those left out count as 0."""
    return [
        (stated(r.answer).get(m, 0.0), m in _there(r))
        for r in records if r.answer.verdict != "error" for m in MECHANISMS if m not in r.truth["also"]
    ]  # fmt: skip


def reliability(pairs: list[tuple[float, bool]]) -> dict:
    """Stated against observed: bins, the largest deviation of a well-filled bin, the mean one, the Brier score."""
    bins = []
    for low, high in zip(BINS[:-1], BINS[1:], strict=True):
        inside = [(p, x) for p, x in pairs if low <= p < high or (high == 1.0 and p >= 1.0)]
        if inside:
            mean, seen = float(np.mean([p for p, _ in inside])), share(x for _, x in inside)
            bins.append({"from": low, "to": high, "stated": mean, "seen": seen, "deviation": abs(mean - seen["value"])})
    total = sum(b["seen"]["of"] for b in bins)
    return {
        "of": total, "bins": bins,
        "largest": max((b["deviation"] for b in bins if b["seen"]["of"] >= LEAST_IN_BIN), default=None),
        "mean": sum(b["deviation"] * b["seen"]["of"] for b in bins) / total if total else None,
        "brier": float(np.mean([(p - x) ** 2 for p, x in pairs])) if pairs else None,
    }  # fmt: skip


# --- files ------------------------------------------------------------------------------------------------------------


def read_records(folder: Path, label: str, names: Iterable[str]) -> list[Record]:
    """Return the answered cases among the names. Raises `ParameterError` for a damaged file."""
    out = []
    for name in names:
        file = folder / "answers" / label / f"{name}.json"
        if not file.exists():
            continue
        try:
            answer = json.loads(file.read_text(encoding="utf-8"))
            truth = json.loads((folder / "truth" / f"{name}.json").read_text(encoding="utf-8"))
            seconds = answer.pop("seconds")
            answer = Answer.of(answer)
        except (ValueError, KeyError, TypeError) as error:
            raise ParameterError(f"{file}: {error}; delete the file to have the case asked again") from None
        out.append(Record(truth, answer, judged(truth, answer), seconds))
    return out


def tables(results: Mapping[str, dict]) -> dict[str, Table]:
    """Tables of the page: the targets of each set, then law errors and calibration of the workflow by set."""
    found = {}
    for name, result in results.items():
        entrants = result["entrants"]
        rows = [
            (t.words, f"{'>=' if t.least else '<='} {100 * t.bound:g}",
             *(percent(f["targets"][t.key]) for f in entrants.values())) for t in TARGETS
        ]  # fmt: skip
        for key, words in (("first", "first name"), ("all", "every mechanism")):
            off = [f["calibration"][key]["largest"] for f in entrants.values()]
            rows.append((f"largest deviation of stated probabilities, {words}", f"<= {100 * CALIBRATED:g}",
                         *("-" if x is None else f"{100 * x:.1f}" for x in off)))  # fmt: skip
        found[f"Set {name}, seed {result['seed']}: asked and seen [%]"] = Table(("share", "asked", *entrants), rows)
    laws = results.get("laws", {"entrants": {}})["entrants"]
    if f := laws.get("workflow"):
        shares = f["by_law"].items()
        rows = [(f"{100 * float(size):g} %", *(percent(of[t.key]) for t in TARGETS)) for size, of in shares]
        found["Workflow by law error [%]"] = Table(("law error", *(t.key for t in TARGETS)), rows)
        bins = [(f"{b['from']:g} to {b['to']:g}", f"{100 * b['stated']:.1f}", percent(b["seen"]))
                for b in f["calibration"]["first"]["bins"]]  # fmt: skip
        found["Workflow: stated probability of the first name [%]"] = Table(("bin", "mean stated", "seen"), bins)
    return found


def page_of(folder: Path) -> str:
    """Page of all sets whose scores are in a folder."""
    files = {name: folder / f"discovery_{name}.json" for name in SETS}
    results = {name: json.loads(f.read_text(encoding="utf-8")) for name, f in files.items() if f.is_file()}
    text = (
        "Naming of hidden mechanisms, by `python -m benchmarks.discovery`: shares with 95 % intervals (Wilson) at law "
        f"errors of {100 * MAIN:g} %, in rich tables, of the cases at or above twice the detection limit."
    )
    return page("The blind benchmark of discovery", text, tables(results))
