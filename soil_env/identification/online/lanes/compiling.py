"""Decorators of compiled functions: `compiled_part`, `compiled_inline`, and `compiled_root`, kept
on disk (`cache`).

A simulation step is some 150 small functions. Numba by itself optimises each of them together with
everything it calls, and emits machine code for each, although only a few are ever called from
Python. Here a part is only translated; its callers link it, and a root, a function that Python
calls, optimises the whole tree once. Called from Python, as in a test or a notebook, a part
compiles a root of its own.

Compiled code is kept beside the sources (or where NUMBA_CACHE_DIR says) and is valid for as long as
none of the compiled sources of the package has changed. With NUMBA_DISABLE_JIT=1 nothing is
compiled: the same functions run as Python, slowly, for a debugger.

`error_model="numpy"`: a division by zero gives inf, as in numpy. `_nrt=False` takes numba's
reference counting and heap out of a function: two threads that count references to the same arrays
slow each other down, and a function that would allocate does not compile. Scratch memory is on the
stack (`lanes.scratch`, `rows.scratch_rows`).
"""

import atexit
import contextlib
import importlib
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import update_wrapper
from pathlib import Path
from typing import Any, TypeAlias, overload

import numpy as np
from numba import config, njit, typeof, types
from numba.extending import typeof_impl

from soil_env.identification.online.lanes.cache import CACHE, is_kept, keep
from soil_env.identification.online.lanes.pipeline import PART, ROOT

#: True if functions are compiled at all.
COMPILED = not config.DISABLE_JIT


#: A compiled function, for type checkers: its numbers may be floats or lanes, its arguments arrays
#: or rows.
Compiled: TypeAlias = Callable[..., Any]

_OPTIONS = {"error_model": "numpy", "no_cfunc_wrapper": True}
_mask = getattr(signal, "pthread_sigmask", None)  # not on Windows


def _uninterrupted(function, arguments, keywords):
    """Call compiled code that may return a tuple; Ctrl-C waits until it is done.

    Numba makes a named tuple by Python code, in which an interrupt may be raised, and takes what
    that returns without checking it for an error: a crash.
    """
    if _mask is None:
        return function(*arguments, **keywords)
    before = _mask(signal.SIG_BLOCK, ())
    try:
        _mask(signal.SIG_BLOCK, (signal.SIGINT,))  # which raises an interrupt that has come already
        return function(*arguments, **keywords)
    finally:
        _mask(signal.SIG_SETMASK, before)


class Part:
    """A function of compiled code, which Python may call too; `py_func` is its source as a Python
    function.
    """

    def __init__(self, function, inline: bool) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self._root = None
        compiled = njit(
            _nrt=False, no_cpython_wrapper=True, forceinline=inline, pipeline_class=PART, **_OPTIONS
        )
        self.dispatcher = compiled(function)
        template = self.dispatcher.get_call_template
        # One version for a constant and for a number that is not known yet.
        self.dispatcher.get_call_template = lambda args, kws: template(
            tuple(types.unliteral(a) for a in args),
            {name: types.unliteral(t) for name, t in kws.items()},
        )

    @property
    def root(self):
        """The function compiled for calls from Python."""
        if self._root is None:
            self._root = keep(njit(_nrt=False, pipeline_class=ROOT, **_OPTIONS)(self.py_func))
        return self._root

    def __call__(self, *arguments, **keywords):
        if not self.root.overloads:  # it compiles, which Ctrl-C may end
            return self.root(*arguments, **keywords)
        return _uninterrupted(self.root, arguments, keywords)

    def __reduce__(self):
        return _named, (self.__module__, self.__qualname__)


@typeof_impl.register(Part)
def _typeof_part(value, context):
    return types.Dispatcher(value.dispatcher)


def _named(module: str, name: str):
    return getattr(importlib.import_module(module), name)


def compiled_part(function: Callable[..., Any]) -> Compiled:
    """Decorate a function of compiled code that its callers call."""
    return Part(function, False) if COMPILED else function


def compiled_inline(function: Callable[..., Any]) -> Compiled:
    """Decorate a function of compiled code that is put into its callers, so that values stay in
    registers.
    """
    return Part(function, True) if COMPILED else function


@overload
def compiled_root(function: Callable[..., Any]) -> Compiled: ...
@overload
def compiled_root(*, nogil: bool = ...) -> Callable[[Callable[..., Any]], Compiled]: ...
def compiled_root(function: Any = None, *, nogil: bool = False) -> Any:
    """Decorate a compiled function that Python calls; with `nogil` it holds no lock meanwhile."""
    if function is None:
        return lambda f: compiled_root(f, nogil=nogil)
    if not COMPILED:  # as compiled code, which divides by zero without a warning
        return np.errstate(all="ignore")(function)
    return keep(njit(_nrt=False, nogil=nogil, pipeline_class=ROOT, **_OPTIONS)(function))


class FastCall:
    """A compiled function without numba's look-up of the types of the arguments at each call.

    The look-up takes 8 us for the nested tuples of a simulation, the call itself 1 us. All calls
    must have arguments of the same types as the first; nothing checks that. The function returns no
    tuple (`_uninterrupted`).
    """

    def __init__(self, function) -> None:
        self.function = function  # of Python or compiled
        self._code = None if COMPILED else function

    def __call__(self, *arguments):
        if self._code is None:
            function = getattr(self.function, "root", self.function)
            signature = tuple(typeof(a) for a in arguments)
            function.compile(signature)
            self._code = function.overloads[signature].entry_point
        return self._code(*arguments)

    def __reduce__(self):
        """Pickle by name: numba would pickle the source of the function, and compile it anew in
        another process.
        """
        function = getattr(self.function, "py_func", self.function)
        return _fast_call, (function.__module__, function.__name__)


def _fast_call(module: str, name: str) -> FastCall:
    return FastCall(_named(module, name))


#: Program of a process that compiles a root into the cache on the disk: module, name and types come
#: pickled on stdin.
_COMPILE = """import importlib, pickle, sys
module, name, signature = pickle.load(sys.stdin.buffer)  # from `compile_aside`
getattr(importlib.import_module(module), name).compile(signature)"""


def compile_aside(function, arguments: tuple) -> None:
    """Start a process that compiles a root for such arguments, if the cache does not hold it yet.

    Meanwhile this process compiles what it needs first; a call of the root waits at the lock of the
    cache for the other process and loads its code. None is started without a second processor,
    without a cache or in workers of `multiprocessing`.
    """
    alone = os.cpu_count() == 1 or multiprocessing.parent_process() is not None
    signature = tuple(typeof(a) for a in arguments)
    if alone or not (COMPILED and CACHE and sys.executable) or is_kept(function, signature):
        return
    path = os.pathsep.join([str(Path(__file__).resolve().parents[4]), *sys.path])
    with contextlib.suppress(OSError):
        child = subprocess.Popen(
            [sys.executable, "-c", _COMPILE],
            env=os.environ | {"PYTHONPATH": path},
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        atexit.register(child.kill)
        with child.stdin as orders:
            orders.write(pickle.dumps((function.__module__, function.__name__, signature)))
