"""Validity of a fitted model: the conditions that it has seen, {condition: (lowest, highest)} in
the units of a measurement table.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from soil_env._io.loading import ParameterError, unknown_key

#: Conditions and their units, as the columns of a measurement table.
CONDITIONS = {"slip": "", "load": "N", "speed": "m/s", "pass": "", "grade_deg": "deg"}


# [of the range; in `envs.worlds` of a load] by which conditions may lie outside; own choice
NEAR = 0.01
ROUNDING = 1e-6  # [of a bound] that is let pass at least, as the error of a written number


class OutsideValidity(UserWarning):
    """A model predicts conditions beyond those that it was fitted to."""


def check(validity: Mapping[str, tuple[float, float]]) -> None:
    """Raise `ParameterError` for unknown conditions and for a pair that is no range."""
    for name, pair in validity.items():
        if name not in CONDITIONS:
            raise unknown_key(name, CONDITIONS, "validity")
        if not -math.inf < pair[0] <= pair[1] < math.inf:
            raise ParameterError(f"validity.{name} = {pair}: expected [lowest, highest]")


def columns_of(rows: Any) -> dict[str, np.ndarray]:
    """{condition: values [N]} of `steady.Rows`, in the units of a measurement table.

    Grades are to six decimals, without what sine and arcsine lose of the table's own.
    """
    speed, passes, sine = rows.conditions.T
    grade = np.round(np.degrees(np.arcsin(sine)), 6)
    return dict(zip(CONDITIONS, (rows.slip, rows.load, speed, passes, grade), strict=True))


def ranges_of(rows: Any) -> dict[str, tuple[float, float]]:
    """{condition: (lowest, highest)} of `steady.Rows`.

    A speed of 0 stands for one not known, and is left out; so is a condition without any row.
    """
    columns = columns_of(rows)
    columns["speed"] = columns["speed"][columns["speed"] > 0.0]
    return {name: (float(x.min()), float(x.max())) for name, x in columns.items() if x.size}


def outside(validity: Mapping[str, tuple[float, float]], rows: Any) -> str:
    """In words, each condition whose range over all rows leaves that of `validity`, with both
    ranges; "" if none.

    `NEAR` of the range, and at least `ROUNDING` of a bound, is tolerated.
    """
    asked = ranges_of(rows)
    out = []
    for name, (low, high) in validity.items():
        if name not in asked:
            continue
        lowest, highest = asked[name]
        near = max(NEAR * (high - low), ROUNDING * max(abs(low), abs(high)))
        if lowest < low - near or highest > high + near:
            fitted = _span(low, high, CONDITIONS[name])
            out.append(f"{name} {_span(lowest, highest, '')} (fitted to {fitted})")
    return ", ".join(out)


def in_words(validity: Mapping[str, tuple[float, float]]) -> str:
    """The ranges as text: "slip 0.04 to 0.55, load 63.1 to 149 N, ..."; `grade_deg` is "grade"."""
    return ", ".join(
        f"{k.removesuffix('_deg')} {_span(low, high, CONDITIONS[k])}"
        for k, (low, high) in validity.items()
    )


def _span(low: float, high: float, unit: str) -> str:
    """One range as text, "0.04 to 0.55 N", or one number where both ends are equal."""
    span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
    return f"{span} {unit}".rstrip()
