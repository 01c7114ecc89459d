"""Which cases the easy set has, and how one is drawn from (seed, group, number) alone."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from benchmarks.blind.easy.cases import Case, draw_case
from benchmarks.blind.easy.forms import EFFECTS, forms_of
from benchmarks.blind.easy.plan import MULTIPLES
from benchmarks.blind.easy.unlisted import UNLISTED
from benchmarks.blind.groups import LEAST, Task

PAIRS = tuple(combinations(EFFECTS, 2))
HIDDEN_UNLISTED = tuple(dict.fromkeys(form.effect for form in UNLISTED))
_SORTS: dict[str, dict] = {  # keywords of `draw_case` by what is special
    "weak": {"multiple": (0.25, LEAST)},
    "repeats": {"noise": "repeats"},  # no noise in the setup, every condition three times
    "absent": {"noise": "absent"},  # no noise in the setup, and no repeats
    "outliers": {"outliers": True},
    "priors": {"prior_error": "2sd"},
}


@dataclass(frozen=True)
class EasyGroup:
    """Cases of one sort."""

    kind: str
    design: str
    count: int
    sort: str = ""  # a key of `_SORTS`
    error: float = 0.0  # size of the law errors: there are none

    @property
    def name(self) -> str:
        """easy-kind-design-sort, as in the names of the cases."""
        return "-".join(filter(None, ("easy", self.kind, self.design, self.sort)))

    def effects(self, index: int) -> dict:
        """Effects and forms of a case: all in turn, or left to be drawn (a poor design cannot show every one)."""
        if self.design == "poor" or self.kind == "none":
            return {}
        if self.kind == "two":
            return {"names": PAIRS[31 * index % len(PAIRS)]}  # all pairs before any comes again
        if self.kind == "unlisted":
            return {"names": (HIDDEN_UNLISTED[index % len(HIDDEN_UNLISTED)],)}
        name = EFFECTS[index % len(EFFECTS)]
        known = forms_of(name)
        return {"names": (name,), "forms": (known[index // len(EFFECTS) % len(known)].name,)}


_LIST = (
    EasyGroup("one", "rich", 260),
    EasyGroup("one", "rich", 130, "weak"),
    EasyGroup("none", "rich", 150),
    EasyGroup("two", "rich", 156),
    EasyGroup("unlisted", "rich", 90),
    EasyGroup("one", "poor", 200),
    EasyGroup("none", "poor", 150),
    *(EasyGroup(kind, "rich", count, sort) for sort in ("repeats", "absent", "outliers", "priors")
      for kind, count in (("one", 39), ("none", 20))),
)  # fmt: skip
GROUPS = {group.name: group for group in _LIST}


def draw(seed: int, task: Task) -> Case:
    """The case of a seed, group and number."""
    group = GROUPS[task.group]
    rng = np.random.default_rng([seed, zlib.crc32(group.name.encode()), task.index])
    options = {"kind": group.kind, "design": group.design, "multiple": MULTIPLES} | _SORTS.get(group.sort, {})
    try:
        case = draw_case(rng, **options, **group.effects(task.index))
    except RuntimeError:  # the effects whose turn it is cannot be seen in any design: others are drawn
        case = draw_case(rng, **options)
    truth = case.truth
    effects = [_effect(e, group.kind) for e in truth["effects"]]
    about = {
        "case": task.name, "seed": seed, "kind": group.kind, "design": group.design, "sort": group.sort,
        "law_error": 0.0, "base_law": None, "also": [], "rows": case.clean.shape[1],
        "noise_stated": "noise" in case.setup, "wrong_cells": truth["wrong_cells"], "soil_type": truth["soil_type"],
        "soil": truth["soil"], "noise": truth["noise_levels"], "effects": effects,
        "counts": all((e["rival_left"] if group.kind == "unlisted" else e["size"]) >= 0.97 * LEAST for e in effects),
    }  # fmt: skip
    return Case(case.columns, case.setup, about, case.clean, case.bench, case.effects)


def _effect(e: dict, kind: str) -> dict:
    """An effect as the truths of the benchmark have it; its own form is listed and leaves nothing of it."""
    pair = e["rival_pair"] if kind == "unlisted" else {"names": e["rival"], "named": e["named"]}
    same = ("name", "form", "source", "strength", "unit", "side")
    return {key: e[key] for key in same} | {
        "size": e["shown"], "own_left": None if kind == "unlisted" else 0.0, "rival": pair["names"],
        "rival_left": pair["named"], "left": e["rivals"],
    }  # fmt: skip
