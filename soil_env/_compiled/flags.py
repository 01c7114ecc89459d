"""Decorators of compiled functions, and the numpy records that they share.

Compiled functions are plain Python on numbers, named tuples and numpy records; with
NUMBA_DISABLE_JIT=1 the same code runs without a compiler. A function that Python calls compiled is
decorated by `cache.kept`, all others by `compiled` and the like. Numba compiles those where a
compiled function calls them. To Python they stay plain functions, but for those that are `inlined`:
they are numba's own objects, with the plain function as `py_func`. What to know of numba here:

- A function costs about a tenth of a second of compilation. Those that are called in one place are
  put into their callers (`inlined`).
- `if x is None: ... else: ...` compiles to one branch where `x` is an argument and None. With a
  value both branches are compiled, so their results need one type.
- An array that is sliced or handed on has its references counted, at some 10 ns each; a record, or
  an array within one, has not. So arrays stay in the function that Python calls.
- A record is told from another by its fields in order: none may begin with all fields of another
  (`tests/compiled/test_records.py`). No field may be called like an attribute of numpy's records.
- A function is compiled once for each decorator of its callers, whose flags may differ.
- A slice that is set to an array (`a[:] = b`) compiles the text of its error, for a second. Fields
  of records that are arrays are set whole (`one.a = other.b`), all others number by number.
- A function that is compiled by itself cannot return a tuple that holds a record.
"""

from typing import Any

import numpy as np
from numba import literal_unroll, njit
from numba.extending import register_jitable

# No function is handed on as a value, so none needs the wrapper that numba makes for that.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
_EXACT: dict[str, Any] = {"fastmath": {"contract", "nsz"}, **_OPTIONS}
#: Sums keep their order; a product and a sum may be fused, so that results differ between machines
#: by rounding only.
compiled: Any = register_jitable(**_EXACT)
#: As `compiled`, for functions that never meet NaN or infinity: a minimum is then one instruction
#: and not a branch.
compiled_finite: Any = register_jitable(fastmath={"contract", "nsz", "nnan", "ninf"}, **_OPTIONS)
#: Loops that sum: LLVM may change the order of a sum, without which it vectorises none. They are
#: put into their callers.
compiled_sums: Any = register_jitable(
    fastmath={"contract", "nsz", "reassoc"}, forceinline=True, **_OPTIONS
)
#: Put into the caller, whose other options then hold.
inlined: Any = njit(**_EXACT, inline="always")


#: Stands for infinity in `compiled_finite` functions: more than any number there.
HUGE = 1e300


def record(*numbers: str, **others: tuple[Any, ...]) -> np.dtype[Any]:
    """Dtype of a record: float64 fields by name, then others by name, each as (type,) or (type,
    shape). A type is a dtype or its text, a shape a number or a tuple.

    `array[k].name` reads a field in Python as in compiled code, `array["name"]` the field of all
    records. Fields are not padded, so a caller should choose types of eight bytes. Types of four
    bytes are for places where every field is aligned nevertheless.
    """
    fields: list[tuple[Any, ...]] = [(name, "f8") for name in numbers]
    # A shape 1 becomes (1,), since NumPy before 2.0 takes (type, 1) for the type alone.
    fields += [(n, kind, np.broadcast_shapes(*shape)) for n, (kind, *shape) in others.items()]
    return np.dtype((np.record, fields))


@compiled
def put_fields(into, values, names):
    """Write the fields `names` of `values`, a record or a named tuple, into the record `into`.

    `names` is a constant of a module, for numba to know.
    """
    for name in literal_unroll(names):
        into[name] = getattr(values, name)


def by_name(one: np.record) -> dict[str, Any]:
    """{name: value} of the fields of one record, in their order; numbers as those of Python."""
    return dict(zip(names_of(one.dtype), one.item(), strict=True))


def names_of(dtype: np.dtype[Any]) -> tuple[str, ...]:
    """Names of the fields of a record."""
    assert dtype.names is not None
    return dtype.names
