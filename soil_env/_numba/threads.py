"""Threads that wait for work on a compiled function that holds no lock.

`concurrent.futures` makes an object with its own lock for every block; here a helper waits on one queue and answers
through one lock, which takes a third of the time. Work is shared out by the kernel itself (`compiling.take`).
"""

from __future__ import annotations

import os
import threading
from functools import cache
from queue import SimpleQueue


class Threads:
    """`size` threads in all: the caller and size - 1 helpers."""

    def __init__(self, size: int) -> None:
        self._orders = [SimpleQueue() for _ in range(size - 1)]
        for orders in self._orders:
            threading.Thread(target=_help, args=(orders,), name="soil_env", daemon=True).start()

    def run(self, kernel, arguments: tuple, helpers: int) -> None:
        """kernel(*arguments) in this thread and in so many helpers at once; raises what any of them raised."""
        done = SimpleQueue()
        for orders in self._orders[:helpers]:
            orders.put((kernel, arguments, done))
        error = None
        try:
            kernel(*arguments)
        except BaseException as e:  # the helpers still write to the arrays
            error = e
        for _ in self._orders[:helpers]:
            error = done.get() or error
        if error is not None:
            raise error


def _help(orders: SimpleQueue) -> None:
    while True:
        kernel, arguments, done = orders.get()
        try:
            kernel(*arguments)
            done.put(None)
        except BaseException as error:
            done.put(error)
        del kernel, arguments, done


@cache
def threads(size: int) -> Threads:
    """The threads of this process where `size` work at once."""
    return Threads(size)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=threads.cache_clear)  # threads do not survive a fork
