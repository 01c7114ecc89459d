"""Threads that share the work of compiled functions which hold no lock.

Each thread runs the same functions one after the other. A function takes its next rows from a counter (`take`), marks
the rows that it has done, and waits for the rows that the function before it has not done yet. So no thread waits for
the end of a function. `concurrent.futures` would make an object with its own lock for every block; here a helper waits
on one queue and answers through another, which takes a third of the time.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from functools import cache
from queue import SimpleQueue

from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from soil_env._numba.compiling import COMPILED, compiled_inline


def _item(context, builder, kind, array, index):
    """Pointer to an item of an array of int64."""
    return builder.gep(make_array(kind)(context, builder, array).data, [index])


@intrinsic
def _take(typingctx, counter, count):
    def emit(context, builder, sig, args):
        first = _item(context, builder, sig.args[0], args[0], ir.Constant(ir.IntType(64), 0))
        return builder.atomic_rmw("add", first, args[1], "monotonic")

    return types.int64(counter, types.int64), emit


@intrinsic
def _mark(typingctx, progress, k, stage):
    def emit(context, builder, sig, args):
        builder.store_atomic(args[2], _item(context, builder, sig.args[0], args[0], args[1]), "release", 8)
        return context.get_dummy_value()

    return types.none(progress, types.int64, types.int64), emit


@intrinsic
def _stage_of(typingctx, progress, k):
    def emit(context, builder, sig, args):
        return builder.load_atomic(_item(context, builder, sig.args[0], args[0], args[1]), "acquire", 8)

    return types.int64(progress, types.int64), emit


_TAKING = threading.Lock()


def _take_in_python(counter, count):
    with _TAKING:
        taken = int(counter[0])
        counter[0] += count
    return taken


def _mark_in_python(progress, k, stage):
    progress[k] = stage


def _stage_in_python(progress, k):
    return progress[k]


#: take(counter, count): present value of counter[0] (int64), which grows by `count` at once, whatever other threads do.
take = _take if COMPILED else _take_in_python
#: mark(progress, k, stage): set progress[k] (int64) after all that this thread has written.
mark = _mark if COMPILED else _mark_in_python
_stage = _stage_of if COMPILED else _stage_in_python


@compiled_inline
def wait_for(progress, first, end, stage):
    """Wait until rows `first` ... `end` - 1 have been marked with `stage`, and see what was written before."""
    for k in range(first, end):
        while _stage(progress, k) < stage:
            pass


class Threads:
    """`size` threads in all: the caller and size - 1 helpers."""

    def __init__(self, size: int) -> None:
        self._orders = [SimpleQueue() for _ in range(size - 1)]
        for orders in self._orders:
            threading.Thread(target=_help, args=(orders,), name="soil_env", daemon=True).start()

    def run(self, calls: Sequence[tuple], helpers: int) -> None:
        """Call each (function, arguments) in this thread and in so many helpers; raise what any of them raised."""
        done = SimpleQueue()
        for orders in self._orders[:helpers]:
            orders.put((calls, done))
        error = None
        try:
            for function, arguments in calls:
                function(*arguments)
        except BaseException as e:  # the helpers still write to the arrays
            error = e
        for _ in self._orders[:helpers]:
            error = done.get() or error
        if error is not None:
            raise error


def _help(orders: SimpleQueue) -> None:
    while True:
        calls, done = orders.get()
        try:
            for function, arguments in calls:
                function(*arguments)
            done.put(None)
        except BaseException as error:
            done.put(error)
        del calls, done


@cache
def threads(size: int) -> Threads:
    """The threads of this process where `size` work at once."""
    return Threads(size)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=threads.cache_clear)  # threads do not survive a fork
