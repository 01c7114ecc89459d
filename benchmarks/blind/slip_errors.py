"""The same cases with law errors that change otherwise with slip: a workflow must not live on how the errors are drawn.

Law errors of `laws` are smooth in slip. Those of `log_slip` are smooth in ln(1 + slip/0.05), fast at small slip and
slow at large; those of `regimes` are smooth in the slip on either side of a border, one for each case, and across it as
good as independent, as where soil begins to fail in another way. Conditions, soils and effects are those of the cases
of `laws`, errors and noise are drawn anew. Which cases count is as it is there, with the covariance of the errors of
`laws`.
"""

from __future__ import annotations

import copy
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from benchmarks.blind import cases
from benchmarks.blind.groups import Group, Task
from benchmarks.blind.laws import LENGTHS, StressError
from benchmarks.blind.plan import CHANNELS
from benchmarks.blind.world import Contact

LITTLE_SLIP = 0.05
LENGTH = 0.8  # of ln(1 + slip/0.05), nominal
BORDERS = (0.1, 0.5)  # slips between which the border of two regimes is drawn
BORDER_WIDTH = 0.03
APART = 2.0  # correlation lengths between both sides: their errors correlate by exp(-2)

Coordinate = Callable[[np.ndarray], np.ndarray]  # slip -> what takes its place in `StressError`


def log_slip(rng: np.random.Generator) -> Coordinate:
    """Of errors that are smooth in the logarithm of slip."""
    return lambda slip: LENGTHS[2] / LENGTH * np.log1p(np.maximum(slip, 0.0) / LITTLE_SLIP)


def regimes(rng: np.random.Generator) -> Coordinate:
    """Of errors that are others beyond a slip, which is drawn."""
    border = rng.uniform(*BORDERS)
    return lambda slip: slip + 0.5 * APART * LENGTHS[2] * np.tanh((slip - border) / BORDER_WIDTH)


@dataclass(frozen=True, eq=False)
class SlipError:
    """A `StressError` that changes with slip over another coordinate."""

    error: StressError
    coordinate: Coordinate

    def __call__(self, contact: Contact) -> None:
        seen = copy.copy(contact)  # it has the same lists of what alters the stresses
        seen.rows = replace(contact.rows, slip=self.coordinate(contact.rows.slip))
        self.error(seen)


@dataclass(frozen=True)
class SlipGroup(Group):
    """Cases of a group of `laws`, with other errors."""

    prefix: str = ""

    @property
    def name(self) -> str:
        """That of the group of `laws` behind a prefix."""
        return self.prefix + super().name


@dataclass(frozen=True)
class Errors:
    """Law errors of one kind, and the cases that have them."""

    prefix: str  # of the names of the groups
    draw: Callable[[np.random.Generator], Coordinate]
    _COUNTS: ClassVar = (("one", 156), ("two", 78), ("none", 60), ("unlisted", 63))

    @property
    def groups(self) -> dict[str, Group]:
        """By name."""
        all_of = [SlipGroup(kind, "rich", 0.1, count, prefix=self.prefix) for kind, count in self._COUNTS]
        return {group.name: group for group in all_of}


KINDS = {"log_slip": Errors("log-slip-", log_slip), "regimes": Errors("regimes-", regimes)}


def draw_case(errors: Errors, seed: int, task: Task) -> cases.Case:
    """The case of a seed, group and number."""
    known = cases.draw_case(seed, Task(task.group.removeprefix(errors.prefix), task.index))
    rng = np.random.default_rng([seed, zlib.crc32(task.group.encode()), task.index])
    bench = known.bench
    for _ in range(cases.ATTEMPTS):
        coordinate = errors.draw(rng)
        error = SlipError(StressError.draw(rng, bench.error.size, bench.pressure, bench.load), coordinate)
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


def draw_of(name: str) -> Callable[[int, Task], cases.Case]:
    """`draw_case` of one of `KINDS`."""
    return partial(draw_case, KINDS[name])
