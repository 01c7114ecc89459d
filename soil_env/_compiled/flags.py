"""Options of `numba.njit` and of numpy records that all compiled functions share.

Compiled functions are plain Python on numbers, named tuples and numpy records; with
NUMBA_DISABLE_JIT=1 the same code runs without a compiler. A function that Python calls is decorated
by `cache.kept`, all others by `njit(**EXACT)` and the like. Small functions, and those that are
called in one place, are put into their callers (`inline="always"`): numba takes about a quarter of
a second for each function that it compiles by itself.
"""

from typing import Any

import numpy as np

#: Sums keep their order; a product and a sum may be fused, so that results differ between machines
#: by rounding only.
EXACT: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}}
#: As `EXACT`, of functions that never meet NaN or infinity: a minimum is then one instruction and
#: not a branch.
FINITE: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz", "nnan", "ninf"}}
#: Loops that sum: LLVM may change the order of a sum, without which it vectorises none. They are
#: put into their callers.
SUMS: dict[str, Any] = {
    "error_model": "numpy",
    "fastmath": {"contract", "nsz", "reassoc"},
    "forceinline": True,
}
#: Put into the caller, whose other options then hold.
INLINE: dict[str, Any] = EXACT | {"inline": "always"}


def uncompiled(function: Any) -> Any:
    """Return the uncompiled function, for a single call from Python."""
    return getattr(function, "py_func", function)


#: Stands for infinity in `FINITE` functions: more than any number there.
HUGE = 1e300


def record(*numbers: str, **others: tuple[Any, ...]) -> np.dtype[Any]:
    """Dtype of a record: float64 fields by name, then others by name with their types and shapes.

    `array[k].name` reads a field in Python as in compiled code, `array["name"]` the field of all
    records.
    """
    fields = [(name, "f8") for name in numbers] + [(name, *kind) for name, kind in others.items()]
    return np.dtype((np.record, fields))
