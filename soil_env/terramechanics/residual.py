"""Residual law: what an unlisted effect adds to a channel, as a sum of products of powers of dimensionless groups.

    sinkage / r,  drawbar pull / W,  torque / (W r)   +=   sum over terms of  a  prod_g  group_g ^ p_g

`discrepancy.symbolic` finds such laws. They have no claim to hold outside the conditions they were found in, so every
group is held inside the range it had there.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from soil_env._io.loading import Checked, ParameterError, quantity, unknown_key
from soil_env._numba.compiling import compiled_inline, compiled_part
from soil_env._numba.elementary import larger, power, smaller, where_less
from soil_env._numba.lanes import alike
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
    """Terms as the kernels take them."""

    channel: np.ndarray  # [T] index into CHANNELS
    coefficient: np.ndarray  # [T]
    powers: np.ndarray  # [T, 7]
    low: np.ndarray  # [T, 7] range of the groups
    high: np.ndarray  # [T, 7]


def residual_law(terms: Sequence[ResidualTerm]) -> ResidualLaw:
    """Pack terms for the kernels."""
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


@compiled_part
def dimensionless_groups(slip, sinkage, load, speed, passes, sin_grade, soil, r, b, gravity):
    """The seven `GROUPS` at one working point."""
    i = smaller(abs(slip), 1.0)
    bearing = (
        soil.sinkage_coefficient
        * b
        * power(alike(r, soil.sinkage_exponent), soil.sinkage_exponent + 1.0)
    )
    pattern = 0.0 * i  # floats or lanes alike
    return (
        i,
        1.0 - i,
        sinkage / r + pattern,
        load / bearing + pattern,
        abs(speed) / math.sqrt(gravity * r) + pattern,
        passes + pattern,
        sin_grade + pattern,
    )


@compiled_part
def residual_at(law, groups):
    """Sum of the terms for (sinkage / r, drawbar pull / W, torque / (W r)) at `groups`."""
    z = pull = torque = 0.0 * groups[0]
    for k in range(law.coefficient.size):
        value = alike(law.coefficient[k], groups[0])
        for g in range(len(groups)):
            p = law.powers[k, g]
            if p != 0.0:
                x = smaller(larger(groups[g], law.low[k, g]), law.high[k, g])
                value = value * _raised(x, p)
        if law.channel[k] == 0:
            z = z + value
        elif law.channel[k] == 1:
            pull = pull + value
        else:
            torque = torque + value
    return z, pull, torque


@compiled_inline
def _raised(x, p):
    """x^p; 0 where it is not a real number."""
    size = power(larger(abs(x), 1e-300), p)
    odd = p == math.floor(p) and 0.5 * p != math.floor(0.5 * p)
    below = (-size if odd else size) if p == math.floor(p) else 0.0 * size
    return where_less(0.0, x, size, where_less(x, 0.0, below, 0.0))
