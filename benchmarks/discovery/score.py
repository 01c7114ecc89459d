"""Scores: every answer against its truth, shares with Wilson intervals, calibration of the stated
probabilities.

A case *counts* for the targets if the hidden effect is at or above twice its detection limit. Of an
unlisted mechanism, what the best listed form would leave has to be. The calibration and the shares
under `all` have every case.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.common import share, spread
from benchmarks.discovery.entrants import NAMES, Answer
from benchmarks.discovery.forms import MECHANISMS
from soil_env._io.document import Table
from soil_env._io.loading import ParameterError

ASSERTED = ("named", "partly")  # verdicts that assert a name
MORE_LIKELY = 0.5  # probability above which an answer states a name
BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)  # edges of the probabilities that are judged together
LEAST_IN_BIN = 20  # a bin with fewer answers has no deviation
SENSORS = ("slip_bias", "sinkage_offset")  # of the catalogue, but not of the soil
CALIBRATED = {"largest": 0.10, "mean": 0.03}  # deviation of stated probabilities that is asked for


class Record(NamedTuple):
    """A case with the answer of an entrant to it."""

    truth: dict  # content of its truth.json
    answer: Answer
    seconds: float  # that the answer took

    @property
    def there(self) -> list[str]:
        """Names of the hidden effects."""
        return [e["name"] for e in self.truth["effects"]]

    @property
    def sure(self) -> set[str]:
        """Names stated at more than `MORE_LIKELY`, or asserted without a probability."""
        return {name for name, p in stated(self.answer).items() if p > MORE_LIKELY}


def stated(answer: Answer) -> dict[str, float]:
    """Probability of each mechanism that an answer states; an asserted name without one counts as
    sure.
    """
    asserted = answer.named if answer.verdict in ASSERTED else ()
    return {name: 1.0 for name in asserted} | dict(answer.probabilities)


def contradicted(answer: Answer) -> bool:
    """True if the verdict asserts a name that is stated at less than 50 %, or no name where one has
    more.
    """
    p = stated(answer)
    if answer.verdict in ASSERTED:
        return any(p[name] < MORE_LIKELY for name in answer.named)
    return (
        answer.verdict in ("none", "unlisted", "undetermined")
        and max(p.values(), default=0.0) > MORE_LIKELY
    )


def first(r: Record) -> bool:
    """True if the hidden mechanism is named first."""
    return r.answer.named[:1] == (r.there[0],)


def included(r: Record) -> bool:
    """True if the hidden mechanism is among the names and alternatives."""
    return r.there[0] in (*r.answer.named, *r.answer.alternatives)


def covered(r: Record) -> bool:
    """True if every hidden mechanism is among what may be missing: the names, their alternatives
    and what may be there beside them.
    """
    return {*r.there} <= {*r.answer.named, *r.answer.alternatives, *r.answer.beside}


def wrong(r: Record) -> bool:
    """True if the answer is sure of a name that is not there."""
    return bool(r.sure - set(r.there))


class Target(NamedTuple):
    """Share of the cases of a kind that is asked of an entrant, or that it must not exceed."""

    key: str  # in discovery.json
    words: str  # in the table
    kind: str  # of the cases that it is about (`cases.Group.kind`)
    value: Callable[[Record], bool]  # True for an answer that counts in the share
    bound: float  # of the share
    least: bool  # at least the bound, else at most


TARGETS = (
    Target("first", "one effect: its mechanism named first", "one", first, 0.85, True),
    Target("included", "one effect: first or among the alternatives", "one", included, 0.92, True),
    Target("wrong", "one effect: more than half sure of a wrong one", "one", wrong, 0.05, False),
    Target(
        "second",
        "one effect: a wrong second name",
        "one",
        lambda r: bool(set(r.answer.named[1:]) - set(r.there)),
        0.05,
        False,
    ),
    Target(
        "both",
        "two effects: both named and no other",
        "two",
        lambda r: set(r.answer.named) == set(r.there),
        0.65,
        True,
    ),
    Target(
        "covered",
        "two effects: both among the names and alternatives",
        "two",
        covered,
        0.92,
        True,
    ),
    Target(
        "none",
        "no effect: no name",
        "none",
        lambda r: not r.answer.named and not wrong(r),
        0.95,
        True,
    ),
    Target(
        "unlisted",
        "effect in no catalogue: verdict unlisted",
        "unlisted",
        lambda r: r.answer.verdict == "unlisted",
        0.90,
        True,
    ),
    Target(
        "misled",
        "effect in no catalogue: more than half sure of a listed one",
        "unlisted",
        wrong,
        0.05,
        False,
    ),
    Target(
        "instrument",
        "error of the instrument: named or an alternative",
        "instrument",
        included,
        0.90,
        True,
    ),
    Target(
        "soil",
        "error of the instrument: more than half sure of an effect of soil or drive",
        "instrument",
        lambda r: bool(r.sure & set(MECHANISMS) - set(SENSORS)),
        0.10,
        False,
    ),
)


def targets(records: Iterable[Record]) -> dict[str, dict]:
    """{key of a target: `share` of its cases in which `Target.value` is true}, if it has cases."""
    records = list(records)
    found = {
        t.key: share(t.value(r) for r in records if r.truth["kind"] == t.kind) for t in TARGETS
    }
    return {key: value for key, value in found.items() if value is not None}


def figures(records: list[Record]) -> dict:
    """All figures of one entrant as plain values: shares of `TARGETS` over the cases that count, by
    group, by hidden effect and over all cases, calibration, and times [s].
    """
    counting = [r for r in records if r.truth["counts"]]
    groups = sorted({r.truth["case"].rpartition("-")[0] for r in records})
    hidden = {"-".join(r.there) for r in records if len(r.there) == 1}
    return {
        "cases": len(records),
        "counting": len(counting),
        "errors": sum(r.answer.verdict == "error" for r in records),
        "contradicted": sum(contradicted(r.answer) for r in records),
        "targets": targets(counting),
        "all": targets(records),
        "groups": {
            g: targets(r for r in counting if r.truth["case"].rpartition("-")[0] == g)
            for g in groups
        },
        "hidden": {
            name: targets(r for r in counting if r.there == [name]) for name in sorted(hidden)
        },
        "calibration": {"first": reliability(_firsts(records)), "all": reliability(_all(records))},
        "seconds": spread([r.seconds for r in records]),
    }


def _firsts(records: list[Record]) -> list[tuple[float, bool]]:
    """(Probability of the first name, true if it is there) of the answers that have one."""
    pairs = [(r, r.answer.named[0]) for r in records if r.answer.named]
    return [
        (stated(r.answer)[name], name in r.there) for r, name in pairs if name in stated(r.answer)
    ]


def _all(records: list[Record]) -> list[tuple[float, bool]]:
    """(Probability, true if it is there) of every name in every answer; those left out count
    as 0.
    """
    answered = [r for r in records if r.answer.verdict != "error"]
    return [(stated(r.answer).get(name, 0.0), name in r.there) for r in answered for name in NAMES]


def reliability(pairs: list[tuple[float, bool]]) -> dict:
    """Stated probabilities against observed shares: {"of", "bins", "largest", "mean"}.

    `pairs`: (stated probability, true if it came true). "of" is their number, "bins" one entry for
    each of `BINS` with pairs. "largest" deviation is of bins with `LEAST_IN_BIN` pairs, None
    without one; "mean" is over all pairs, None without any.
    """
    bins = []
    for low, high in zip(BINS[:-1], BINS[1:], strict=True):
        inside = [(p, x) for p, x in pairs if low <= p < high or (high == 1.0 and p >= 1.0)]
        if inside:
            mean = float(np.mean([p for p, _ in inside]))
            seen = share(x for _, x in inside)
            bins.append(
                {
                    "from": low,
                    "to": high,
                    "stated": mean,
                    "seen": seen,
                    "deviation": abs(mean - seen["value"]),
                }
            )
    total = sum(b["seen"]["of"] for b in bins)
    return {
        "of": total,
        "bins": bins,
        "largest": max(
            (b["deviation"] for b in bins if b["seen"]["of"] >= LEAST_IN_BIN), default=None
        ),
        "mean": sum(b["deviation"] * b["seen"]["of"] for b in bins) / total if total else None,
    }


def read_records(folder: Path, label: str, names: Iterable[str]) -> list[Record]:
    """Read the cases among `names` that have an answer of the entrant `label` in a study's folder.

    Raises `ParameterError` for a damaged file.
    """
    out = []
    for name in names:
        file = folder / "answers" / label / f"{name}.json"
        if not file.exists():
            continue
        try:
            answer = json.loads(file.read_text(encoding="utf-8"))
            truth = json.loads((folder / "truth" / f"{name}.json").read_text(encoding="utf-8"))
            seconds = answer.pop("seconds")
            out.append(Record(truth, Answer.of(answer), seconds))
        except (ValueError, KeyError, TypeError) as error:
            raise ParameterError(
                f"{file}: {error}; delete the file to have the case asked again"
            ) from None
    return out


def table(entrants: Mapping[str, dict]) -> Table:
    """Table of the targets and the calibration of each entrant [%]."""
    shares = [f["targets"] for f in entrants.values()]
    rows = [
        (
            t.words,
            f"{'>=' if t.least else '<='} {100 * t.bound:g}",
            *(f"{100 * of[t.key]['value']:.0f}" if t.key in of else "-" for of in shares),
        )
        for t in TARGETS
    ]
    for of, words in (("first", "first name"), ("all", "every name")):
        for key, bound in CALIBRATED.items():
            off = [f["calibration"][of][key] for f in entrants.values()]
            rows.append(
                (
                    f"stated probability of the {words}: {key} deviation",
                    f"<= {100 * bound:g}",
                    *("-" if x is None else f"{100 * x:.0f}" for x in off),
                )
            )
    return Table(("share [%]", "asked", *entrants), rows)
