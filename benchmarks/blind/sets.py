"""The sets of cases of the benchmark.

`laws`: forms that no fit has on laws with errors; `log_slip` and `regimes`: the same with errors that change otherwise
with slip; `easy`: listed forms on exact laws.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.blind import cases as laws_cases, groups as laws_groups, slip_errors
from benchmarks.blind.easy import groups as easy_groups
from benchmarks.blind.groups import Task

HERE = Path(__file__).parent
_SHARED = ("effect", "world")
_LAWS = ("cases", "forms", "forms_contact", "forms_run", "groups", "laws", "limits", "plan", "unlisted")
_ASKED = {"first": 0.85, "included": 0.95, "wrong": 0.05, "both": 0.70, "none": 0.95, "unlisted": 0.90}
_EASY = ("forms", "forms_contact", "forms_run", "limits", "plan", "unlisted")


@dataclass(frozen=True)
class CaseSet:
    """Cases that are drawn and scored together."""

    name: str
    groups: dict
    draw: Callable[[int, Task], laws_cases.Case]
    sources: tuple[Path, ...]  # the code that the cases follow from
    main: float  # size of the law errors at which the targets are set
    bounds: dict[str, float]  # what is asked, by the key of `score.TARGETS`

    @property
    def in_all(self) -> int:
        """Number of cases."""
        return sum(group.count for group in self.groups.values())

    def tasks(self, limit: int | None = None) -> list[Task]:
        """The first `limit` cases of all; every group is in any beginning of the list in proportion to its size."""
        out = [((i + 0.5) / g.count, Task(name, i)) for name, g in self.groups.items() for i in range(g.count)]
        return [task for _, task in sorted(out, key=lambda pair: pair[0])][:limit]


def _files(folder: Path, names: tuple[str, ...]) -> tuple[Path, ...]:
    return tuple(folder / f"{name}.py" for name in names)


SETS = {
    s.name: s
    for s in (
        CaseSet(
            "laws", laws_groups.GROUPS, laws_cases.draw_case,
            (*sorted(_files(HERE, _LAWS + _SHARED)), *_files(HERE / "easy", _EASY)), 0.1, _ASKED,
        ),
        *(
            CaseSet(
                name, errors.groups, slip_errors.draw_of(name),
                (*sorted(_files(HERE, (*_LAWS, *_SHARED, "slip_errors"))), *_files(HERE / "easy", _EASY)), 0.1, _ASKED,
            )
            for name, errors in slip_errors.KINDS.items()
        ),
        CaseSet(
            "easy", easy_groups.GROUPS, easy_groups.draw,
            (*_files(HERE, _SHARED), *_files(HERE / "easy", (*_EASY, "cases", "groups"))), 0.0,
            {"first": 0.985, "included": 0.99, "wrong": 0.03, "both": 0.92, "none": 0.98, "unlisted": 0.96},
        ),
    )
}  # fmt: skip


def set_of(name: str) -> CaseSet:
    """The set of a case."""
    other = {"easy-": "easy"} | {errors.prefix: name for name, errors in slip_errors.KINDS.items()}
    return SETS[next((of for prefix, of in other.items() if name.startswith(prefix)), "laws")]


def task_of(name: str) -> Task:
    """The case of a name. Raises `ValueError` where there is none."""
    group, _, index = name.rpartition("-")
    groups = set_of(name).groups
    if group not in groups or not index.isdigit():
        raise ValueError(f"case {name!r}: expected GROUP-NUMBER, GROUP one of {', '.join(groups)}")
    return Task(group, int(index))
