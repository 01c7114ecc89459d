"""Rows: arrays with names, one contiguous row of numbers for each quantity, for the state and the
scratch of wheels.

    State = rows("State", "x", "speed")          # a class state = State(10)
    # quantities of ten wheels, zero state.x[3], state["x"], state[3]             # a number; a row;
    all quantities of wheel 3 as a dict

In compiled code `state.x` is the same row, so that `from_array(state.x, k)` loads eight neighbours
at once, and `state` itself is one pointer; `state.data` is all rows [names, columns]. A row is as
long as the next multiple of eight there, so that the last eight can be loaded like any other.
`scratch_rows(State, n)` are rows on the stack.
"""

import sys
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    intrinsic,
    lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)
from numba.np.arrayobj import make_array, populate_array
from numba.np.numpy_support import from_dtype

from soil_env.identification.online.lanes import interpreted
from soil_env.identification.online.lanes.compiling import COMPILED, compiled_inline
from soil_env.identification.online.lanes.lanes import COUNT, on_stack


class Rows:
    """Named rows of `count` numbers each; made by a class that `rows` returns."""

    __slots__ = ("_memory", "count", "data")
    NAMES: tuple[str, ...] = ()
    KIND: type = np.float64

    def __init__(self, count: int, data: np.ndarray | None = None) -> None:
        columns = -(-count // COUNT) * COUNT
        self.count: int = count
        self.data: np.ndarray = (
            np.zeros((len(self.NAMES), columns), self.KIND) if data is None else data
        )
        self._memory = self.data.ctypes.data, self.data.shape[1]  # address, columns

    def __getattr__(self, name: str) -> np.ndarray:
        if name.startswith("__") or name not in self.NAMES:
            raise AttributeError(
                f"{type(self).__name__} has no row {name!r}: "
                f"expected one of {', '.join(self.NAMES)}"
            )
        return self.data[self.NAMES.index(name), : self.count if COMPILED else None]

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self.NAMES:
            self.data[self.NAMES.index(name), : self.count] = value
        else:
            super().__setattr__(name, value)

    def __getitem__(self, which: Any) -> Any:
        """The row of a name, or all quantities at one index as a dict."""
        if isinstance(which, str):
            return self.data[self.NAMES.index(which), : self.count]
        return dict(zip(self.NAMES, self.data[:, : self.count][:, which].tolist(), strict=True))

    def __setitem__(self, name: str, value: Any) -> None:
        self.data[self.NAMES.index(name), : self.count] = value

    def __len__(self) -> int:
        return self.count

    def copy(self) -> "Rows":
        """Rows of their own with the same numbers."""
        return type(self)(self.count, self.data.copy())

    def __deepcopy__(self, memo: Any) -> "Rows":
        return self.copy()

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.count, self.data)


def rows(name: str, *names: str, kind: type = np.float64) -> type[Rows]:
    """A class of `Rows` with these names; `kind`: float64 or int64."""
    module = sys._getframe(1).f_globals["__name__"]
    return type(
        name, (Rows,), {"__slots__": (), "NAMES": names, "KIND": kind, "__module__": module}
    )


class _RowsType(types.Type):
    def __init__(self, cls) -> None:
        self.cls = cls
        super().__init__(name=f"{cls.__module__}.{cls.__qualname__}{cls.NAMES}")

    def array(self, name):
        """Type of a row, or of `data`, all rows."""
        return types.Array(from_dtype(np.dtype(self.cls.KIND)), 2 if name == "data" else 1, "C")


@register_model(_RowsType)
class _RowsModel(models.StructModel):
    def __init__(self, manager, fe_type) -> None:
        super().__init__(manager, fe_type, [("pointer", types.voidptr), ("columns", types.intp)])


@typeof_impl.register(Rows)
def _typeof_rows(value, context):
    return _RowsType(type(value))


@unbox(_RowsType)
def _unbox_rows(typ, obj, c):
    value = cgutils.create_struct_proxy(typ)(c.context, c.builder)
    memory = c.pyapi.object_getattr_string(obj, "_memory")
    address, columns = (
        c.pyapi.long_as_longlong(c.pyapi.tuple_getitem(memory, i)) for i in range(2)
    )
    value.pointer = c.builder.inttoptr(address, cgutils.voidptr_t)
    value.columns = columns
    c.pyapi.decref(memory)
    return NativeValue(value._getvalue())


@infer_getattr
class _RowsAttributes(AttributeTemplate):
    key = _RowsType

    def generic_resolve(self, typ, name):
        return typ.array(name) if name == "data" or name in typ.cls.NAMES else None


@lower_getattr_generic(_RowsType)
def _row(context, builder, typ, value, name):
    rows = cgutils.create_struct_proxy(typ)(context, builder, value=value)
    item = ir.Constant(ir.IntType(64), 8)
    kind = typ.array(name)
    names = typ.cls.NAMES
    row = builder.mul(rows.columns, item)
    whole = name == "data"
    offset = builder.mul(row, ir.Constant(ir.IntType(64), 0 if whole else names.index(name)))
    shape = [ir.Constant(ir.IntType(64), len(names)), rows.columns] if whole else [rows.columns]
    array = make_array(kind)(context, builder)
    pointer = builder.bitcast(
        builder.gep(rows.pointer, [offset]), context.get_data_type(kind.dtype).as_pointer()
    )
    strides = [row, item] if whole else [item]
    populate_array(array, data=pointer, shape=shape, strides=strides, itemsize=item, meminfo=None)
    return array._getvalue()


def scratch_rows(cls: type[Rows], columns: int):
    """A compiled function without arguments that returns rows on the stack of its caller, not set
    to anything.

    The caller must not return them: they are gone with its frame, also where it is put into its own
    caller.
    """
    if not COMPILED:
        return lambda: cls(
            columns, np.full((len(cls.NAMES), columns), interpreted.UNSET).astype(cls.KIND)
        )
    if columns % COUNT:
        raise ValueError(f"scratch_rows: {columns} columns: expected a multiple of {COUNT}")

    @intrinsic
    def get(typingctx):
        typ = _RowsType(cls)

        def emit(context, builder, sig, args):
            data = on_stack(builder, ir.IntType(64), len(cls.NAMES) * columns)
            rows = cgutils.create_struct_proxy(typ)(context, builder)
            rows.pointer = builder.bitcast(data, cgutils.voidptr_t)
            rows.columns = ir.Constant(ir.IntType(64), columns)
            return rows._getvalue()

        return typ(), emit

    return get


@compiled_inline
def zero_column(target, i):
    """Set all quantities at index i to zero."""
    for row in range(target.data.shape[0]):
        target.data[row, i] = 0
