"""Functions that Python calls, compiled once and kept on disk by numba's own cache.

Numba notices an edit of a function's own file, not of the files of the functions that it calls. So
each version of the sources has a folder of its own, named by the hash of them and numba's version,
with a folder for each function. A lock file lets one process compile while others wait for its
result. Checksums beside the files tell a damaged file, which is dropped and compiled anew. Where
nothing can be written, every process compiles for itself.
"""

import hashlib
import json
import multiprocessing
import os
import shutil
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, update_wrapper
from pathlib import Path
from tempfile import TemporaryFile
from types import FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from filelock import FileLock, Timeout
from numba import config, njit
from numba.core.event import Event, Listener, register

PACKAGE = Path(__file__).resolve().parents[1]
#: Folders and files of the package whose sources and constants compiled code is made of.
SOURCES = (
    "_compiled",
    "parameters",
    "terramechanics",
    "simulation",
    "identification/online",
    "identification/status.py",
    "envs",
    "slip.py",
)
FOLDER = "kernels"
CHECKSUMS = "checksums.json"
COMPILED = not config.DISABLE_JIT
COMPILING = "(at the first use only, up to a minute for each environment)"
PATIENCE = 3.0  # [s] of a compilation before a line explains it; the first one is told at once
PACE = 0.5  # [s] between two counts of what is compiled, on a terminal


@cache
def folder() -> Path | None:
    """Folder of the compiled code of these sources, made if missing; None if none can be written.

    It is below the first place that can be written: NUMBA_CACHE_DIR where that is set, the folder
    `__pycache__` of the sources if they are a clone, the user's cache.
    """
    installed = not {"site-packages", "dist-packages"}.isdisjoint(PACKAGE.parts)
    places = [] if installed else [PACKAGE / "__pycache__"]
    with suppress(RuntimeError):  # a user without a home
        own = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        places.append(own / "soil_env")
    if config.CACHE_DIR:
        places.insert(0, Path(config.CACHE_DIR))
    for place in places:
        with suppress(OSError):
            found = place / FOLDER / _hash_of_sources()
            found.mkdir(parents=True, exist_ok=True)
            TemporaryFile(dir=found).close()  # an error if nothing can be written there
            return found
    return None


def _hash_of_sources() -> str:
    """First 16 hexadecimal digits of the SHA-256 of numba's version and all `.py` files of
    `SOURCES`.

    Without the version, environments with two of them would drop each other's code again and again.
    """
    files = [PACKAGE / name for name in SOURCES if name.endswith(".py")]
    for name in SOURCES:
        files += (PACKAGE / name).rglob("*.py")
    content = (numba.__version__.encode(), *(f.read_bytes() for f in sorted(files)))
    return hashlib.sha256(b"".join(content)).hexdigest()[:16]


class Kept:
    """A function that Python calls, compiled for the types that it gets and kept on disk.

    The first call in a process checks the files of the function, and compiles, or loads, under a
    lock. Later calls run the compiled code. A call that compiles a version for other types writes
    the checksums of the new files. `py_func` is the function as Python runs it.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        """Decorate `function`; nothing is compiled or loaded before the first call."""
        update_wrapper(self, function)
        self.py_func = function
        self._opened = False  # the first call is over
        self._threads = threading.Lock()  # lets one thread make the first call
        self._versions = 0  # compiled versions whose files have their checksums written
        _compilations.of.add(function)
        root = folder()
        name = f"{function.__module__}.{function.__qualname__}"
        self._folder = None if root is None else root / name
        self._function = _compiled(function, self._folder)

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled function, arguments by position only.

        The first call is `_first_call`. A call that compiled a version for other types writes the
        checksums of its files.
        """
        if not self._opened:
            return self._first_call(arguments)
        result = self._call(arguments)
        if len(self._function.overloads) != self._versions:  # it met other types than before
            with self._alone():
                self._write_checksums()
        return result

    def __reduce__(self) -> str:
        return self.__qualname__  # pickled by name

    def _first_call(self, arguments: tuple[Any, ...]) -> Any:
        """Check the files, call the function, write the checksums of new files; return the result.

        Files that are whole but that numba cannot load are dropped, and the function is compiled.
        Errors of the function itself are raised, as by any call; the next call is a first one then.
        """
        with self._threads:
            if self._opened:  # by another thread
                return self._function(*arguments)
            with self._alone():
                loaded = self._check()
                try:
                    result = self._call(arguments)
                except Exception:
                    # Nothing compiled means that numba failed to load: the function has not run.
                    if not loaded or self._function.overloads:
                        raise
                    self._drop()
                    result = self._call(arguments)
                self._opened = True
                self._write_checksums()
        return result

    def _call(self, arguments: tuple[Any, ...]) -> Any:
        """Call numba's function; where it cannot write a file, say so and call what it compiled."""
        try:
            return self._function(*arguments)
        except OSError as error:  # numba has compiled the function and cannot write it
            tell(f"compiled code cannot be kept: {error}")
            return self._function(*arguments)

    @contextmanager
    def _alone(self):
        """Hold the lock of the function's folder, so that no other process compiles it meanwhile.

        Waits for another one with a line that says so. Without a folder, or on a disk without
        locks, nothing is held.
        """
        with ExitStack() as held:
            if self._folder is not None:
                with suppress(OSError, NotImplementedError):
                    self._folder.mkdir(parents=True, exist_ok=True)
                    lock = self._folder.with_name(f"{self._folder.name}.lock")
                    try:
                        held.enter_context(FileLock(lock, timeout=0))
                    except Timeout:
                        tell("waiting for another process, which compiles the same code")
                        held.enter_context(FileLock(lock))
            yield

    def _check(self) -> bool:
        """True if numba has whole files to load; drop all if one is damaged, and say so.

        Whole are files whose names and checksums are those of `CHECKSUMS`. So files without that
        list are damaged; with neither, nothing has been compiled yet. Without a folder, say that
        each process compiles anew. False also with NUMBA_DISABLE_JIT, where numba loads nothing.
        """
        if self._folder is None:
            tell("compiling in each process anew: compiled code cannot be kept without a folder")
            return False
        known = {}  # {file name: checksum} of the files as numba wrote them
        try:
            with suppress(FileNotFoundError):
                known = json.loads((self._folder / CHECKSUMS).read_text())
            damaged = known != self._checksums_now()
        # No JSON, a file that nobody may read, a folder or a link in its place.
        except (OSError, ValueError, RecursionError):
            damaged = True
        if damaged:
            self._drop()
        elif known:
            return COMPILED
        return False

    def _drop(self) -> None:
        """Delete the files of the function, say so, and make numba's function anew.

        Where a file cannot be deleted this process keeps none on disk.
        """
        assert self._folder is not None
        tell(f"compiled code in {self._folder} is damaged; it is dropped and compiled anew")
        shutil.rmtree(self._folder, ignore_errors=True)
        if self._folder.exists():
            self._folder = None
        self._function = _compiled(self.py_func, self._folder)

    def _write_checksums(self) -> None:
        """Write the checksums of the function's files if versions were compiled or loaded since the
        last call. The caller holds the lock (`_alone`).

        Where they cannot be written, the next process takes the files for damaged.
        """
        versions = len(self._function.overloads)
        if versions == self._versions:
            return
        self._versions = versions
        if self._folder is not None:
            with suppress(OSError):
                found = self._folder / CHECKSUMS
                partial = found.with_suffix(f".{os.getpid()}")
                # written aside and then renamed: a process that ends halfway leaves the old list
                partial.write_text(json.dumps(self._checksums_now()))
                partial.replace(found)

    def _checksums_now(self) -> dict[str, str]:
        """{file name: SHA-256} of the files of numba's cache (.nbi, .nbc) that are there now."""
        assert self._folder is not None
        files = sorted(self._folder.rglob("*.nb[ci]"))
        return {f.name: hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


_decorating = threading.Lock()  # held while numba's setting of the cache folder is changed


def _compiled(function: Callable[..., Any], place: Path | None) -> Any:
    """Numba's dispatcher of a function, with its cache in the folder `place`; None: kept nowhere.

    It releases the GIL, and divides as numpy does. Nothing is compiled before its first call. With
    NUMBA_DISABLE_JIT it is the Python function, with numpy's warnings off; its `overloads` are
    empty, since `Kept` counts them.
    """
    if not COMPILED:
        interpreted: Any = np.errstate(all="ignore")(function)  # divides without a warning, too
        interpreted.overloads = ()
        return interpreted
    options = {"nogil": True, "error_model": "numpy"}
    if place is None:
        return njit(**options)(function)
    with _decorating:
        before = config.CACHE_DIR
        try:
            config.CACHE_DIR = str(place)  # numba looks for it when the function is decorated
            return njit(cache=True, **options)(function)
        finally:
            config.CACHE_DIR = before


#: Decorator of a function that Python calls.
kept = Kept


_told: set[str] = set()  # lines that this process has said


def tell(line: str) -> None:
    """Print a line on stderr, each line once in a process, unless the process is a silent one
    (`_speaks`).
    """
    if line not in _told and _speaks():
        _told.add(line)
        _say(line)


def _say(line: str) -> None:
    """Print a line on stderr, as one of this package."""
    print(f"soil_env: {line}", file=sys.stderr, flush=True)


def _speaks() -> bool:
    """True in a process that tells the user what it compiles: not in workers of `multiprocessing`,
    whose parent does, not in tests, and not where nothing is compiled.
    """
    testing = "PYTEST_CURRENT_TEST" in os.environ
    return COMPILED and not testing and multiprocessing.parent_process() is None


class _Compilations(Listener):
    """Explains on stderr what somebody waits for: each compilation of a `Kept` function.

    Functions that it calls are not told one by one, and loading from disk is not told. Numba calls
    `on_start` and `on_end`, and compiles for one thread at a time, so one watcher is enough.
    """

    def __init__(self) -> None:
        self.of: set[Callable[..., Any]] = set()  # `py_func` of every `Kept`
        self.done: set[Callable[..., Any]] = set()  # functions compiled in this process
        self._patience = 0.0  # [s]; `PATIENCE` after the first
        self._done = threading.Event()
        self._watcher: threading.Thread | None = None

    def on_start(self, event: Event) -> None:
        """Start the thread that tells of this compilation if it takes longer than `_patience`.

        Only of a `Kept` function, and in a process that speaks.
        """
        function = event.data["dispatcher"].py_func
        if function in self.of and _speaks():
            self._done.clear()
            waiting = function, self._done, self._patience
            self._watcher = threading.Thread(target=_explain, args=waiting, daemon=True)
            self._watcher.start()
            self._patience = PATIENCE

    def on_end(self, event: Event) -> None:
        """Note that a function is compiled, and end the thread of `on_start`, if it has one."""
        function = event.data["dispatcher"].py_func
        self.done.add(function)
        if function in self.of and self._watcher is not None:
            self._done.set()
            self._watcher.join()


_compilations = _Compilations()
register("numba:compile", _compilations)


def _explain(function: Callable[..., Any], done: threading.Event, patience: float) -> None:
    """Say that compiling `function` takes longer than `patience` [s]; return at once if `done` is
    set before.

    On a terminal a line counts how many of the functions that it calls are compiled, every `PACE`
    seconds until `done`, and is then erased. Elsewhere one line is printed. Both go to stderr.
    """
    if done.wait(patience):
        return
    if not sys.stderr.isatty():
        module = function.__module__.rpartition(".")[2]
        _say(f"compiling {module}.{function.__name__} {COMPILING}")
        return
    called = called_by(function)
    while not done.wait(PACE):
        ready = len(called & _compilations.done)
        text = f"compiling, at the first use only: {ready} of at most {len(called)} functions"
        print(f"\rsoil_env: {text}\x1b[K", end="", file=sys.stderr, flush=True)
    print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def called_by(function: Callable[..., Any]) -> set[Callable[..., Any]]:
    """Functions of the same package that a compiled function names, directly or through one that it
    names.

    Names are global ones, and attributes of modules of the package that it names. A name counts
    also where the function does not call it, so these are at least the functions called.
    """
    package = function.__module__.partition(".")[0]
    found: set[Callable[..., Any]] = set()
    left = [function]
    while left:
        one = left.pop()
        names = one.__code__.co_names
        known = [one.__globals__[name] for name in names if name in one.__globals__]
        for module in [thing for thing in known if isinstance(thing, ModuleType)]:
            if module.__name__.startswith(package):
                known += [getattr(module, name) for name in names if hasattr(module, name)]
        for thing in known:
            called = getattr(thing, "py_func", thing)  # an inlined one is numba's own object
            own = isinstance(called, FunctionType) and called.__module__.startswith(package)
            if own and called not in found:
                found.add(called)
                left.append(called)
    return found


def place() -> str:
    """Where compiled code is kept, in words for the user."""
    found = folder()
    return "compiled code is not kept" if found is None else f"kept below {found}"
