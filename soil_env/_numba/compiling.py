"""How the functions of a step are compiled.

`_nrt=False` takes numba's reference counting and heap out of them: two threads that count references to the same
arrays slow each other down, and a function that would allocate does not compile. Scratch is `lanes.scratch`, on the
stack. `error_model="numpy"`: a division by zero gives inf, as in numpy, not a test and an exception.
"""

import importlib
import multiprocessing
import os
import sys

from numba import njit, typeof, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array


def _nothing():
    pass


def _cacheable() -> bool:
    try:
        njit(cache=True)(_nothing)
    except RuntimeError:  # numba finds no folder that it could write
        return False
    return True


#: Whether compiled code is kept on the disk; without a folder for it every process compiles anew.
CACHE = _cacheable()
#: For functions of a step.
kernel = njit(cache=CACHE, error_model="numpy", _nrt=False, no_cfunc_wrapper=True)
#: The same for those that only compiled code calls: without what takes Python's arguments apart, which for the nested
#: tuples of a simulation is more code than the function. Called from Python they would crash.
inner = njit(cache=CACHE, error_model="numpy", _nrt=False, no_cfunc_wrapper=True, no_cpython_wrapper=True)
#: The same for small ones whose values should stay in registers: always inlined.
inlined = njit(cache=CACHE, error_model="numpy", _nrt=False, forceinline=True, no_cfunc_wrapper=True)
#: The same for large ones with one caller: put into it before compilation, so that they are not compiled twice.
pasted = njit(cache=CACHE, error_model="numpy", _nrt=False, inline="always")


@intrinsic
def take(typingctx, counter, count):
    """Present value of counter[0] (int64), which grows by `count` at once, whatever other threads do."""

    def emit(context, builder, sig, args):
        data = make_array(sig.args[0])(context, builder, args[0]).data
        return builder.atomic_rmw("add", data, args[1], "monotonic")

    return types.int64(counter, types.int64), emit


_told = [False]  # whether this process has said that it compiles


def _tell(function) -> None:
    """One line on stderr, once, where `function` is about to be compiled and not loaded from the cache.

    Not in workers of `multiprocessing`, whose parent says it, and not in tests.
    """
    if (
        _told[0]
        or "PYTEST_CURRENT_TEST" in os.environ
        or multiprocessing.parent_process() is not None
        or _kept(function)
    ):
        return
    _told[0] = True
    kept = "once" if CACHE else "in every process, as no cache can be written (NUMBA_CACHE_DIR)"
    print(f"soil_env: compiling, {kept}; about a minute", file=sys.stderr, flush=True)


def _kept(function) -> bool:
    """Whether the cache holds compiled code of the function as it is now."""
    if not CACHE:
        return False
    try:
        return bool(function._cache._cache_file._load_index())
    except (AttributeError, OSError):  # another numba: rather nothing than a wrong line
        return True


class Entry:
    """A compiled function without numba's look-up of the types of the arguments at each call.

    The look-up takes 8 us for the nested tuples of a simulation, the call itself 1 us. All calls must have arguments of
    the same types as the first; nothing checks that.
    """

    def __init__(self, function):
        self._function, self._code = function, None

    def __call__(self, *arguments):
        if self._code is None:
            signature = tuple(typeof(a) for a in arguments)
            _tell(self._function)
            self._function.compile(signature)
            self._code = self._function.overloads[signature].entry_point
        return self._code(*arguments)

    def __reduce__(self):
        """By name: numba would pickle the source of the function, and compile it anew in another process."""
        function = self._function.py_func
        return _entry, (function.__module__, function.__name__)


def _entry(module: str, name: str) -> Entry:
    return Entry(getattr(importlib.import_module(module), name))
