"""Residual law: what the laws of a model miss in each channel, as a sum of products of powers of
dimensionless groups and as a table over them.

    sinkage / r, drawbar pull / W, torque / (W r)   +=   sum of  a  prod_g  group_g ^ p_g  +  table

`discovery.prediction` makes tables, with standard deviations. Neither terms nor a table have a
claim to hold outside the conditions they were found in. So a table is constant beyond its nodes,
and a term holds the groups that have a range.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from soil_env._compiled.elementary import power
from soil_env._compiled.flags import compiled, record
from soil_env._io.loading import Checked, ParameterError, quantity, unknown_key

from .effects.entry import CHANNELS, Channel

#: Dimensionless groups: |i| (i in tables), 1 - |i|, z/r, W/(S b r^(n+1)) load over bearing
#: strength, V/sqrt(g r) Froude number, pass number, sine of the grade. "grip" is 1 - |i|, not the
#: `grip` of a wheel.
GROUPS = ("slip", "grip", "sinkage", "load", "speed", "pass", "grade")
COLUMNS = (*CHANNELS, *(f"{name}_sd" for name in CHANNELS))  # of a table
AXES = ("slip", "load", "speed", "pass", "grade")  # groups that a table may go over
#: Coefficient and value in a table, at most: ten times radius, load, or load times radius. Own
#: choice, far beyond any wheel.
LARGEST = 10.0
MOST_SD = 1e6  # [-] standard deviation of such a value, at most; own choice
MOST_POWER = 6.0  # [-] size of the power of a group; own choice
MOST_TERMS = 32  # of a residual law
MOST_NODES = 4096  # of a table, of all axes together and of all their combinations


@dataclass(frozen=True)
class ResidualTerm(Checked):
    """One term of a channel: coefficient [-] and the power of each group in it."""

    channel: Channel
    coefficient: float = quantity("", -LARGEST, LARGEST)
    powers: dict[str, float] = field(default_factory=dict)
    #: Group -> (low, high) of the data; outside, the group keeps the value of the nearer end.
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)

    def _check_together(self) -> None:
        """Raise `ParameterError` for unknown groups, powers beyond `MOST_POWER` and ranges that are
        not (low, high).
        """
        for name in ("powers", "ranges"):
            for group in getattr(self, name):
                if group not in GROUPS:
                    raise unknown_key(group, GROUPS, name)
        for group, p in self.powers.items():
            if not abs(p) <= MOST_POWER:
                raise ParameterError(
                    f"powers: {group} = {p!r}: expected a number of size {MOST_POWER:g} at most"
                )
        for group, (low, high) in self.ranges.items():
            if not low <= high:
                raise ParameterError(f"ranges: {group} = {[low, high]}: expected [low, high]")

    def __str__(self) -> str:
        """The coefficient in three digits and the powers, as "+0.03 slip load^-0.5"."""
        product = "".join(f" {g}" if p == 1 else f" {g}^{p:g}" for g, p in self.powers.items())
        return f"{self.coefficient:+.3g}{product}"


@dataclass(frozen=True)
class ResidualTable(Checked):
    """A residual at nodes of dimensionless groups, linear between them, with standard deviations.

    `axes`: at least two ascending nodes of each group of `AXES` that it goes over; of the slip with
    its sign, braked below 0. `values`: of each channel and NAME_sd of it, the numbers of all
    combinations of nodes, the last axis fastest, with spaces between them.
    """

    axes: dict[str, tuple[float, ...]]
    values: dict[str, str]

    def _check_together(self) -> None:
        """Raise `ParameterError` for unknown groups or columns, nodes that do not ascend, too many
        combinations of nodes (`MOST_NODES`) and values that `columns` refuses.
        """
        for group, nodes in self.axes.items():
            if group not in AXES:
                raise unknown_key(group, AXES, "axes")
            steps = np.diff(nodes)
            if len(nodes) < 2 or not np.all((steps > 0.0) & (steps < math.inf)):
                raise ParameterError(
                    f"axes: {group} = {list(nodes)[:4]}: expected at least two numbers, ascending"
                )
        count = math.prod(map(len, self.axes.values()))
        if not 2 <= count <= MOST_NODES:
            raise ParameterError(f"axes: {count} combinations of nodes: expected 2 to {MOST_NODES}")
        for name in self.values:
            if name not in COLUMNS:
                raise unknown_key(name, COLUMNS, "values")
        self.columns()  # raises for values that are wrong

    def columns(self) -> np.ndarray:
        """Values by `COLUMNS`, [combinations of nodes, 6], 0 in a column that is not given.

        Raises `ParameterError` for a column of another length or with text that is no number, for a
        value beyond `LARGEST`, and for a standard deviation below 0 or beyond `MOST_SD`.
        """
        count = math.prod(map(len, self.axes.values()))
        out = np.zeros((count, len(COLUMNS)))
        for name, text in self.values.items():
            try:
                column = np.array(text.split(), dtype=float)
            except ValueError:
                column = np.empty(0)
            low, high = (-LARGEST, LARGEST) if name in CHANNELS else (0.0, MOST_SD)
            if column.size != count or not np.all((column >= low) & (column <= high)):
                raise ParameterError(
                    f"values: {name} = {text[:20]!r}...: expected {count} numbers in "
                    f"[{low:g}, {high:g}], one for each combination of nodes"
                )
            out[:, COLUMNS.index(name)] = column
        return out


#: Terms and a table as compiled code takes them, one record. Of the arrays of terms the first
#: `terms` rows are in use, of `axis` and `count` the first `axes` entries.
RESIDUAL = record(
    terms=("i8",),
    axes=("i8",),  # of the table; 0 without one
    channel=("i8", MOST_TERMS),  # index into CHANNELS
    coefficient=("f8", MOST_TERMS),
    powers=("f8", (MOST_TERMS, len(GROUPS))),
    low=("f8", (MOST_TERMS, len(GROUPS))),  # range of the groups
    high=("f8", (MOST_TERMS, len(GROUPS))),
    axis=("i8", len(AXES)),  # index into GROUPS of each axis
    count=("i8", len(AXES)),  # its nodes
    nodes=("f8", MOST_NODES),  # of all axes, one after the other
    table=("f8", (MOST_NODES, len(COLUMNS))),
)


def residual_law(
    terms: Sequence[ResidualTerm] = (), table: ResidualTable | None = None
) -> np.record:
    """Pack terms and a table as a record `RESIDUAL`; `ParameterError` for more than `MOST_TERMS`.

    A group of a term without a range keeps its value, whatever it is.
    """
    if len(terms) > MOST_TERMS:
        raise ParameterError(f"residual: {len(terms)} terms: expected at most {MOST_TERMS}")
    packed = np.zeros(1, RESIDUAL)[0]
    packed.terms = len(terms)
    packed.high[:] = np.inf
    packed.low[:] = -np.inf
    for k, term in enumerate(terms):
        packed.channel[k] = CHANNELS.index(term.channel)
        packed.coefficient[k] = term.coefficient
        for group, p in term.powers.items():
            packed.powers[k, GROUPS.index(group)] = p
        for group, (low, high) in term.ranges.items():
            packed.low[k, GROUPS.index(group)] = low
            packed.high[k, GROUPS.index(group)] = high
    if table is not None:
        packed.axes = len(table.axes)
        packed.axis[: packed.axes] = [GROUPS.index(name) for name in table.axes]
        packed.count[: packed.axes] = [len(nodes) for nodes in table.axes.values()]
        nodes = np.concatenate(list(table.axes.values()))
        packed.nodes[: nodes.size] = nodes
        columns = table.columns()
        packed.table[: len(columns)] = columns
    return packed


class WorkingPoint(NamedTuple):
    """What a residual law depends on, beside soil and wheel."""

    slip: float
    sinkage: float  # [m]
    load: float  # [N]
    speed: float  # [m/s] travel
    passes: float  # 1 = fresh soil
    sin_grade: float  # uphill positive


@compiled
def dimensionless_groups(at, soil, wheel, gravity):
    """The seven `GROUPS` at one `WorkingPoint`, a tuple in their order, gravity in m/s2; the slip
    with its sign, cut to [-1, 1].

    `soil`: `SoilState`; of `wheel` radius and width are read.
    """
    slip = min(max(at.slip, -1.0), 1.0)
    r = wheel.radius
    bearing = soil.sinkage_coefficient * wheel.width * power(r, soil.sinkage_exponent + 1.0)
    return (
        slip,
        1.0 - abs(slip),
        at.sinkage / r,
        at.load / bearing,
        abs(at.speed) / math.sqrt(gravity * r),
        at.passes,
        at.sin_grade,
    )


@compiled
def residual_at(law, groups):
    """What terms and table of a `RESIDUAL` add to (sinkage / r, drawbar pull / W, torque / (W r))
    at `groups`, those of `dimensionless_groups`.

    In a term each group is cut to its range, and slip counts as |i|; the table takes it with its
    sign.
    """
    sinkage, pull, torque = interpolated(law, groups, 0)
    for k in range(law.terms):
        value = law.coefficient[k]
        for g in range(len(groups)):
            p = law.powers[k, g]
            if p != 0.0:
                x = abs(groups[g]) if g == 0 else groups[g]  # 0: slip
                value *= _raised(min(max(x, law.low[k, g]), law.high[k, g]), p)
        if law.channel[k] == 0:  # as in `CHANNELS`
            sinkage += value
        elif law.channel[k] == 1:
            pull += value
        else:
            torque += value
    return sinkage, pull, torque


@compiled
def residual_under(law, at, soil, wheel):
    """`residual_at` of a `WorkingPoint` of a simulated wheel; three zeros where `law` is None."""
    if law is None:
        return 0.0, 0.0, 0.0
    else:
        return residual_at(law, dimensionless_groups(at, soil, wheel, wheel.gravity))


@compiled
def interpolated(law, groups, first):
    """Three columns of the table of a `RESIDUAL` at `groups`, for sinkage, pull and torque.

    They begin with the column `first`: 0 for values, 3 for standard deviations. Each is linear in
    every group between the nodes about `groups`, and constant beyond the first and the last node.
    Three zeros without a table.

    The nodes about `groups` are the corners of a cell of the table. Bit a of the number of a corner
    is 1 if it has the upper node of axis a.
    """
    sinkage = 0.0
    pull = 0.0
    torque = 0.0
    axes = law.axes
    corners = 1 << axes if axes > 0 else 0
    for corner in range(corners):
        weight = 1.0
        row = 0
        start = 0
        for a in range(axes):
            count = law.count[a]
            x = groups[law.axis[a]]
            low = start
            while low < start + count - 2 and law.nodes[low + 1] <= x:
                low += 1
            share = (x - law.nodes[low]) / (law.nodes[low + 1] - law.nodes[low])
            share = min(max(share, 0.0), 1.0)
            upper = (corner >> a) & 1
            weight *= share if upper == 1 else 1.0 - share
            row = row * count + low - start + upper
            start += count
        if weight > 0.0:
            sinkage += weight * law.table[row, first]
            pull += weight * law.table[row, first + 1]
            torque += weight * law.table[row, first + 2]
    return sinkage, pull, torque


@compiled
def _raised(x, p):
    """x^p; 0 for x = 0 at any p, and where x^p is not a real number."""
    if x == 0.0 or (x < 0.0 and p != math.floor(p)):
        return 0.0
    size = power(abs(x), p)
    odd = 0.5 * p != math.floor(0.5 * p)
    return -size if x < 0.0 and odd else size
