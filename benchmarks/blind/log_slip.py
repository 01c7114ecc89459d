"""The same cases with law errors that change otherwise with slip: a workflow must not live on how the errors are drawn.

Law errors of `laws` are smooth in slip, as those of the workflow are. Here they are smooth in ln(1 + slip/0.05), fast
at small slip and slow at large. Conditions, soils and effects are those of the cases of `laws`, errors and noise are
drawn anew. Which cases count is as it is there, with the covariance of the errors of `laws`.
"""

from __future__ import annotations

import copy
import zlib
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.blind import cases
from benchmarks.blind.groups import Group, Task
from benchmarks.blind.laws import LENGTHS, StressError
from benchmarks.blind.plan import CHANNELS
from benchmarks.blind.world import Contact

PREFIX = "log-slip-"
LITTLE_SLIP = 0.05
LENGTH = 0.8  # of ln(1 + slip/0.05), nominal


class LogSlipError(StressError):
    """`StressError` that changes with the logarithm of slip."""

    def __call__(self, contact: Contact) -> None:
        seen = copy.copy(contact)  # it has the same lists of what alters the stresses
        slip = LENGTHS[2] / LENGTH * np.log1p(np.maximum(contact.rows.slip, 0.0) / LITTLE_SLIP)
        seen.rows = replace(contact.rows, slip=slip)
        super().__call__(seen)


@dataclass(frozen=True)
class LogSlipGroup(Group):
    """Cases of a group of `laws`, with other errors."""

    @property
    def name(self) -> str:
        """That of the group of `laws` behind a prefix."""
        return PREFIX + super().name


_LIST = (("one", 156), ("two", 78), ("none", 60), ("unlisted", 63))
GROUPS = {g.name: g for g in (LogSlipGroup(kind, "rich", 0.1, count) for kind, count in _LIST)}


def draw_case(seed: int, task: Task) -> cases.Case:
    """The case of a seed, group and number."""
    known = cases.draw_case(seed, Task(task.group.removeprefix(PREFIX), task.index))
    rng = np.random.default_rng([seed, zlib.crc32(task.group.encode()), task.index])
    bench = known.bench
    for _ in range(cases.ATTEMPTS):
        error = LogSlipError.draw(rng, bench.error.size, bench.pressure, bench.load)
        drawn = replace(bench, error=error)
        clean = drawn.truth(known.effects)
        if np.all(np.isfinite(clean)) and np.max(clean[0] / bench.wheel.radius) <= cases.DEEPEST:
            break
    else:
        raise RuntimeError(f"{task.name}: no table with a balance in {cases.ATTEMPTS} attempts")
    values = clean + np.array(bench.noise)[:, None] * rng.standard_normal(clean.shape)
    measured = {name: [float(f"{v:.6g}") for v in row] for name, row in zip(CHANNELS, values, strict=True)}
    truth = known.truth | {"case": task.name}
    return replace(known, columns=known.columns | measured, truth=truth, clean=clean, bench=drawn)
