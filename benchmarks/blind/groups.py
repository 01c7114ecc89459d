"""Which cases there are: groups by what is hidden, design, base law and size of the law errors."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

from benchmarks.blind.forms import MECHANISMS, VARIES, forms_of
from benchmarks.blind.laws import BASE_LAWS
from benchmarks.blind.unlisted import UNLISTED

KINDS = ("one", "two", "unlisted", "none")
SIZES = (0.0, 0.05, 0.1, 0.2)  # of the law errors
LEAST = 2.0  # detection limits from which a case counts for the targets
SEEN = (LEAST, 8.0)
WEAK = (0.5, LEAST)
PAIRS = tuple(combinations(MECHANISMS, 2))
STEADY = tuple(m for m in MECHANISMS if m not in VARIES)
LAWS = tuple(law for law in BASE_LAWS if law != "reece")  # that differ for one wheel, too


@dataclass(frozen=True)
class Group:
    """Cases of one sort."""

    kind: str
    design: str
    error: float  # size of the law errors
    count: int
    sort: str = ""  # laws, outliers, weak: what else is special

    @property
    def name(self) -> str:
        """kind-design-sort-error, as in the names of the cases."""
        return "-".join(filter(None, (self.kind, self.design, self.sort, f"{100 * self.error:.0f}")))

    @property
    def multiple(self) -> tuple[float, float]:
        """Range of the sizes that are sought, in detection limits."""
        return WEAK if self.sort == "weak" else SEEN

    @property
    def start(self) -> int:
        """Where the turns of mechanisms and forms begin, so that groups do not all begin with the same ones."""
        return zlib.crc32(self.name.encode()) % 1009

    def law(self, index: int) -> str | None:
        """Base law of a case; None is the paper's."""
        if self.sort == "laws":
            return LAWS[index % len(LAWS)]
        return "reece" if self.design == "wheels" and index % 2 else None

    def hidden(self, index: int) -> list:
        """Forms that are hidden in a case: mechanisms and forms take turns."""
        index += self.start
        if self.kind == "none":
            return []
        if self.kind == "unlisted":
            return [UNLISTED[index % len(UNLISTED)]]
        if self.kind == "two":
            names = PAIRS[31 * index % len(PAIRS)]  # all pairs before any comes again
        else:
            known = STEADY if self.design in ("poor", "few") else MECHANISMS
            names = (known[index % len(known)],)
        turn = index // len(MECHANISMS) if self.kind == "one" else index
        return [forms_of(n)[(turn + k) % len(forms_of(n))] for k, n in enumerate(names)]


_LIST = (
    *(Group("one", "rich", error, count) for error, count in zip(SIZES, (78, 39, 156, 39), strict=True)),
    *(Group("two", "rich", error, count) for error, count in zip(SIZES, (39, 0, 78, 0), strict=True)),
    *(Group("none", "rich", error, count) for error, count in zip(SIZES, (40, 20, 60, 20), strict=True)),
    *(Group("unlisted", "rich", error, count) for error, count in zip(SIZES, (36, 0, 63, 18), strict=True)),
    Group("one", "rich", 0.1, 39, "weak"),
    *(Group("one", "rich", error, 28, "laws") for error in (0.0, 0.1)),
    *(Group("none", "rich", error, 14, "laws") for error in (0.0, 0.1)),
    Group("one", "rich", 0.1, 26, "outliers"),
    Group("none", "rich", 0.1, 10, "outliers"),
    *(Group("one", "wheels", error, count) for error, count in ((0.0, 13), (0.1, 39))),
    Group("none", "wheels", 0.1, 20),
    *(Group("one", design, error, count) for design in ("poor", "few") for error, count in ((0.0, 18), (0.1, 36))),
    *(Group("none", design, 0.1, count) for design, count in (("poor", 30), ("few", 20))),
)
GROUPS = {group.name: group for group in _LIST if group.count}


class Task(NamedTuple):
    """One case."""

    group: str
    index: int

    @property
    def name(self) -> str:
        """Of its folder and its files."""
        return f"{self.group}-{self.index:03d}"
