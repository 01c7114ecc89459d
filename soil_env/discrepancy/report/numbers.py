"""Numbers as a report prints them."""

from __future__ import annotations

import math


def figure(x: float) -> str:
    """Two digits, without an exponent where the number is large."""
    return f"{x:.2g}" if abs(x) < 99.5 else f"{x:.0f}"


def figures(value: float, digits: int = 4) -> str:
    """A number for a table; empty where there is none."""
    return "" if value is None or not math.isfinite(value) else f"{value + 0.0:.{digits}g}"


def fixed(value: float, decimals: int) -> str:
    """A number with a fixed number of decimals, never -0."""
    return f"{round(value, decimals) + 0.0:.{decimals}f}"


def times(log: float) -> str:
    """A factor of which the natural logarithm is given."""
    decades = log / math.log(10.0)
    return f"{figure(10.0**decades)} times" if -2.0 <= decades < 3.0 else f"10^{decades:.0f} times"


def p_value(p: float) -> str:
    """A p value in a table."""
    return "< 1e-6" if p < 1e-6 else f"{p:.2g}"
