"""The conditions that a fitted model has seen: {condition: (lowest, highest)} in the units of a
measurement table.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from soil_env._io.loading import ParameterError, number, unknown_key

#: Conditions and their units, as the columns of a measurement table.
CONDITIONS = MappingProxyType(
    {"slip": "", "load": "N", "speed": "m/s", "pass": "", "grade_deg": "deg"}
)


class OutsideValidity(UserWarning):
    """A model predicts conditions beyond those that it was fitted to."""


def checked(validity: Mapping[str, Any], where: str = "validity") -> dict[str, tuple[float, float]]:
    """A range for each condition that has one; `ParameterError` for unknown names and for what is
    no range.
    """
    if not isinstance(validity, Mapping):
        raise ParameterError(
            f"{where}: expected a mapping of conditions to [lowest, highest], got {validity!r}"
        )
    out = {}
    for name, pair in validity.items():
        if name not in CONDITIONS:
            raise unknown_key(name, CONDITIONS, where)
        try:
            low, high = (number(float, x, where) for x in pair)
        except (TypeError, ValueError):
            low = math.nan
            high = math.nan
        if not -math.inf < low <= high < math.inf:
            raise ParameterError(f"{where}.{name} = {pair!r}: expected [lowest, highest]")
        out[name] = (low, high)
    return out


def seen(
    slip: ArrayLike, load: ArrayLike, conditions: np.ndarray
) -> dict[str, tuple[float, float]]:
    """The ranges of slips [N], loads [N] and conditions [N, 3] (speed, 0 = not known; pass; sine of
    the grade).
    """
    speed = conditions[:, 0]
    columns = {
        "slip": slip,
        "load": load,
        "speed": speed[speed > 0.0],
        "pass": conditions[:, 1],
        "grade_deg": np.round(np.degrees(np.arcsin(conditions[:, 2])), 6),
    }
    return {name: (float(x.min()), float(x.max())) for name, x in columns.items() if x.size}


def outside(
    validity: Mapping[str, tuple[float, float]],
    slip: ArrayLike,
    load: ArrayLike,
    conditions: np.ndarray,
) -> str:
    """Conditions of rows that lie outside by more than 1 % of the range, in words; "" if none."""
    asked = seen(slip, load, conditions)
    out = []
    for name, (low, high) in validity.items():
        if name not in asked:
            continue
        a, b = asked[name]
        near = max(0.01 * (high - low), 1e-6 * max(abs(low), abs(high)))
        if a < low - near or b > high + near:
            out.append(f"{name} {_span(a, b, '')} (fitted to {_span(low, high, CONDITIONS[name])})")
    return ", ".join(out)


def in_words(validity: Mapping[str, tuple[float, float]]) -> str:
    """ "slip 0.04 to 0.55, load 63.1 to 149 N, ..."."""
    titles = {"grade_deg": "grade"}
    return ", ".join(
        f"{titles.get(k, k)} {_span(low, high, CONDITIONS[k])}"
        for k, (low, high) in validity.items()
    )


def _span(low: float, high: float, unit: str) -> str:
    span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
    return f"{span} {unit}".rstrip()
