"""What the blind benchmark asks: groups of cases, how one is drawn, and what the workflow makes of it.

A case follows from (seed, group, index) alone, so neither the order, nor the number of workers, nor that of the cases
makes a difference. The workflow is given a folder with data.csv and setup.yaml and nothing else.
"""

from __future__ import annotations

import functools
import tempfile
import time
import zlib
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.blind.easy.cases import Case, draw_case, write_case
from benchmarks.blind.easy.forms import EFFECTS, forms_of
from benchmarks.blind.easy.limits import noncentrality
from benchmarks.blind.easy.plan import MULTIPLES
from benchmarks.blind.easy.unlisted import UNLISTED
from soil_env._io.loading import ParameterError
from soil_env.discrepancy import Report, run

PAIRS = tuple(combinations(EFFECTS, 2))
HIDDEN_UNLISTED = tuple(dict.fromkeys(form.effect for form in UNLISTED))


@dataclass(frozen=True)
class Group:
    """Cases of one sort."""

    name: str
    count: int
    words: str
    kind: str = "one"
    design: str = "rich"
    multiple: tuple[float, float] = MULTIPLES  # of the detection limit
    noise: str = "given"
    outliers: bool = False
    prior_error: str = "normal"

    def options(self) -> dict:
        """Keywords of `draw_case` but for the effects."""
        return {key: value for key, value in vars(self).items() if key not in ("name", "count", "words")}

    def effects(self, index: int) -> dict:
        """Effects and forms of case `index`: all in turn, or left to be drawn (a poor design cannot show every one)."""
        if self.design == "poor" or self.kind == "none":
            return {}
        if self.kind == "two":
            return {"names": PAIRS[31 * index % len(PAIRS)]}  # all pairs before any comes again
        if self.kind == "unlisted":
            return {"names": (HIDDEN_UNLISTED[index % len(HIDDEN_UNLISTED)],)}
        name = EFFECTS[index % len(EFFECTS)]
        known = forms_of(name)
        return {"names": (name,), "forms": (known[index // len(EFFECTS) % len(known)].name,)}


def _with(option: str, words: str, **options) -> tuple[Group, Group]:
    return (
        Group(f"{option}_one", 39, f"{words}; one effect", **options),
        Group(f"{option}_none", 20, f"{words}; no effect", kind="none", **options),
    )


GROUPS = {
    group.name: group
    for group in (
        Group("one", 260, "one effect, 2 to 8 times its detection limit"),
        Group("weak", 130, "one effect, 0.25 to 2 times its detection limit", multiple=(0.25, 2.0)),
        Group("none", 150, "no effect", kind="none"),
        Group("two", 156, "two effects, every pair of the catalogue", kind="two"),
        Group("unlisted", 90, "one effect that is in no catalogue", kind="unlisted"),
        Group("poor", 200, "one effect, poor design", design="poor"),
        Group("none_poor", 150, "no effect, poor design", kind="none", design="poor"),
        *_with("repeats", "noise not given, from repeats", noise="repeats"),
        *_with("absent", "noise not given, no repeats", noise="absent"),
        *_with("outliers", "2 % gross outliers", outliers=True),
        *_with("priors", "priors off by two standard deviations", prior_error="2sd"),
    )
}
IN_ALL = sum(group.count for group in GROUPS.values())
SMOKE = ("one", "weak", "none", "two", "unlisted", "none_poor", "outliers_none")


class Task(NamedTuple):
    """One case to do."""

    group: str
    index: int
    small: bool = False  # as a poor design, which takes a tenth of the time


def tasks(cases: int, smoke: bool = False) -> list[Task]:
    """About `cases` cases, shared among the groups as `GROUPS` has them, all groups progressing at the same pace."""
    if smoke:
        return [Task(name, 0, True) for name in SMOKE]
    counts = {g.name: max(1, round(g.count * cases / IN_ALL)) for g in GROUPS.values()}
    out = [((i + 0.5) / n, Task(name, i)) for name, n in counts.items() for i in range(n)]
    return [task for _, task in sorted(out, key=lambda pair: pair[0])]


def draw(seed: int, task: Task) -> tuple[Case, bool]:
    """(the case, whether its effects had to be drawn since those in turn cannot be seen in any design)."""
    group = GROUPS[task.group]
    options = group.options() | ({"design": "poor"} if task.small else {})
    rng = np.random.default_rng([seed, zlib.crc32(group.name.encode()), task.index])
    wanted = {} if task.small else group.effects(task.index)
    if wanted:
        try:
            return draw_case(rng, **options, **wanted), False
        except RuntimeError:
            pass
    return draw_case(rng, **options), bool(wanted)


def solve(seed: int, task: Task) -> dict:
    """Draw a case, let the workflow see its table and setup, and put what it says beside the truth; plain values."""
    _warm()
    start = time.perf_counter()
    case, drawn = draw(seed, task)
    record = {"group": task.group, "index": task.index, "drawn": drawn, "drawing": time.perf_counter() - start}
    record |= _truth(case)
    with tempfile.TemporaryDirectory() as seen, tempfile.TemporaryDirectory() as unseen:
        write_case(case, Path(seen), Path(unseen) / "truth.json")
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            said = _said(run(Path(seen) / "data.csv", Path(seen) / "setup.yaml"))
        except (ParameterError, ArithmeticError, ValueError, RuntimeError, LookupError) as error:
            said = {"verdict": "error", "named": [], "gap": {}, "error": f"{type(error).__name__}: {error}"}
        record |= said | {"seconds": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
    return _short(record)


@functools.cache
def _warm() -> None:
    """Have the compiled code loaded before anything is timed."""
    case = draw_case(np.random.default_rng(0), "none", "poor")
    with tempfile.TemporaryDirectory() as folder:
        write_case(case, Path(folder), Path(folder) / "truth.json")
        run(Path(folder) / "data.csv", Path(folder) / "setup.yaml")


def _truth(case: Case) -> dict:
    truth = case.truth
    effects = []
    for told, hidden in zip(truth["effects"], case.effects, strict=True):
        kept = ("name", "form", "strength", "limit", "multiple", "shown", "named", "rival")
        # what its best rival leaves, in units of the noise: the square of the distance between the two
        left = told["named"] ** 2 * noncentrality(hidden.form.freedom)
        effects.append({key: told[key] for key in kept} | {"rival_leaves": left})
    return {
        "kind": truth["kind"],
        "rows": len(case.columns["slip"]),
        "soil": truth["soil_type"],
        "wrong_cells": truth["wrong_cells"],
        "noise": truth["noise_levels"],
        "truth": effects,
    }


def _said(report: Report) -> dict:
    return {
        "verdict": report.verdict,
        "named": [{"name": e.name, "alternatives": list(e.alternatives)} for e in report.effects],
        "probability": {r.name: r.probability for r in report.ranking[:3]},
        "gap": {name: g._asdict() for name, g in report.gap.items()},
        "closed": report.closed,
    }


def _short(x):
    """The same with five significant digits."""
    if isinstance(x, dict):
        return {k: _short(v) for k, v in x.items()}
    if isinstance(x, (list, tuple)):
        return [_short(v) for v in x]
    if isinstance(x, (float, np.floating)):
        return float(f"{x:.5g}") if np.isfinite(x) else None
    return x
