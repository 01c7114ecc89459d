"""Residual law: what an unlisted effect adds to a channel, as a sum of products of powers of
dimensionless groups.

    sinkage / r,  drawbar pull / W,  torque / (W r)   +=   sum of  a  prod_g  group_g ^ p_g

`discrepancy.symbolic` finds such laws. They have no claim to hold outside the conditions they were
found in, so every group is held inside the range it had there.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numba import njit

from soil_env._compiled.elementary import power
from soil_env._compiled.flags import EXACT
from soil_env._io.loading import Checked, ParameterError, quantity, unknown_key
from soil_env.terramechanics.effects.entry import CHANNELS, Channel
from soil_env.terramechanics.effects.text import plain

#: Dimensionless groups by name: (symbol in an equation, symbol in its legend, meaning).
LEGEND = {
    "slip": ("i", "i", "slip"),
    "grip": ("(1 - i)", "1 - i", "travel over rim speed"),
    "sinkage": ("Z", "Z", "z_0/r, sinkage over radius"),
    "load": ("L", "L", "W/(S b r^(n+1)), load over bearing strength"),
    "speed": ("Fr", "Fr", "V/sqrt(g r), Froude number"),
    "pass": ("N", "N", "pass number"),
    "grade": ("sin(b)", "sin(b)", "sine of the grade"),
}
GROUPS = tuple(LEGEND)
_LEFT = {"sinkage": "(z - z_0)/r", "drawbar_pull": "(DP - DP_0)/W", "torque": "(T - T_0)/(W r)"}


@dataclass(frozen=True)
class ResidualTerm(Checked):
    """One term: coefficient [-] and the power of each group in it."""

    channel: Channel
    coefficient: float = quantity("")
    powers: dict[str, float] = field(default_factory=dict)
    #: Group -> (low, high) of the data; outside, the group keeps the value of the nearer end.
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(
            self, "ranges", {group: tuple(pair) for group, pair in self.ranges.items()}
        )
        for name in ("powers", "ranges"):
            for group in getattr(self, name):
                if group not in GROUPS:
                    raise unknown_key(group, GROUPS, f"residual: {name}")
        for group, p in self.powers.items():
            if not abs(p) <= 6.0:
                raise ParameterError(
                    f"residual: powers: {group} = {p!r}: expected a number in [-6, 6]"
                )
        for group, (low, high) in self.ranges.items():
            if not low <= high:
                raise ParameterError(
                    f"residual: ranges: {group} = {[low, high]}: expected [low, high]"
                )

    def __str__(self) -> str:
        product = "".join(f" {g}" if p == 1 else f" {g}^{p:g}" for g, p in self.powers.items())
        return f"{self.coefficient:+.3g}{product}"


class ResidualLaw(NamedTuple):
    """Terms as compiled code takes them."""

    channel: np.ndarray  # [T] index into CHANNELS
    coefficient: np.ndarray  # [T]
    powers: np.ndarray  # [T, 7]
    low: np.ndarray  # [T, 7] range of the groups
    high: np.ndarray  # [T, 7]


def residual_law(terms: Sequence[ResidualTerm]) -> ResidualLaw:
    """Pack terms for compiled code."""
    count = len(terms)
    law = ResidualLaw(
        np.array([CHANNELS.index(t.channel) for t in terms], dtype=np.int64),
        np.array([t.coefficient for t in terms], dtype=float),
        np.zeros((count, len(GROUPS))),
        np.full((count, len(GROUPS)), -np.inf),
        np.full((count, len(GROUPS)), np.inf),
    )
    for k, term in enumerate(terms):
        for group, p in term.powers.items():
            law.powers[k, GROUPS.index(group)] = p
        for group, (low, high) in term.ranges.items():
            law.low[k, GROUPS.index(group)] = low
            law.high[k, GROUPS.index(group)] = high
    return law


def product(powers: Mapping[str, float]) -> str:
    """Groups of a term with their powers, each behind a space."""
    parts = ""
    for group, p in powers.items():
        parts += f" {LEGEND[group][0]}" + (
            "" if p == 1.0 else f"^{p:g}" if p > 0.0 else f"^({p:g})"
        )
    return parts


def formulas(terms: Sequence[ResidualTerm], digits: int = 3) -> dict[str, str]:
    """{channel: equation} of a law."""
    out: dict[str, str] = {}
    for term in terms:
        size = f"{plain(abs(term.coefficient), digits)}{product(term.powers)}"
        minus = term.coefficient < 0.0
        if term.channel in out:
            out[term.channel] += f" {'-' if minus else '+'} {size}"
        else:
            out[term.channel] = f"{_LEFT[term.channel]} = {'-' if minus else ''}{size}"
    return out


class WorkingPoint(NamedTuple):
    """What a residual law depends on, beside soil and wheel."""

    slip: float
    sinkage: float  # [m]
    load: float  # [N]
    speed: float  # [m/s] travel
    passes: float  # 1 = fresh soil
    sin_grade: float  # uphill positive


@njit(**EXACT)
def dimensionless_groups(at, soil, wheel, gravity):
    """The seven `GROUPS` at one `WorkingPoint`."""
    slip = min(abs(at.slip), 1.0)
    r = wheel.radius
    bearing = soil.sinkage_coefficient * wheel.width * power(r, soil.sinkage_exponent + 1.0)
    return (
        slip,
        1.0 - slip,
        at.sinkage / r,
        at.load / bearing,
        abs(at.speed) / math.sqrt(gravity * r),
        at.passes,
        at.sin_grade,
    )


@njit(**EXACT)
def residual_at(law, groups):
    """Sum of the terms for (sinkage / r, drawbar pull / W, torque / (W r)) at `groups`."""
    sinkage = 0.0
    pull = 0.0
    torque = 0.0
    for k in range(law.coefficient.size):
        value = law.coefficient[k]
        for g in range(len(groups)):
            p = law.powers[k, g]
            if p != 0.0:
                value *= _raised(min(max(groups[g], law.low[k, g]), law.high[k, g]), p)
        if law.channel[k] == 0:
            sinkage += value
        elif law.channel[k] == 1:
            pull += value
        else:
            torque += value
    return sinkage, pull, torque


@njit(**EXACT)
def _raised(x, p):
    """x^p; 0 where it is not a real number."""
    if x == 0.0 or (x < 0.0 and p != math.floor(p)):
        return 0.0
    size = power(abs(x), p)
    odd = 0.5 * p != math.floor(0.5 * p)
    return -size if x < 0.0 and odd else size
