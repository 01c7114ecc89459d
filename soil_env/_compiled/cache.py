"""Functions that Python calls, compiled once and kept on disk by numba's own cache.

Numba notices an edit of a function's own file, not of the files of the functions that it calls. So
each version of the sources has a folder of its own, named by their hash, with a folder for each
function. A lock file lets one process compile while others wait for its result. Checksums beside
the files tell a damaged file, which is dropped and compiled anew. Where nothing can be written,
every process compiles for itself.
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
from types import ModuleType
from typing import Any

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
    "envs",
    "slip.py",
)
FOLDER = "kernels"
CHECKSUMS = "checksums.json"
COMPILED = not config.DISABLE_JIT
COMPILING = "(at the first use only, up to a minute for each environment)"
PATIENCE = 3.0  # [s] that a compilation may take before a line explains it, but for the first
PACE = 0.5  # [s] between two counts of what is compiled, on a terminal


@cache
def folder() -> Path | None:
    """Folder of the compiled code of these sources; None where none can be written.

    It is below NUMBA_CACHE_DIR where that is set, beside the sources of a clone, else in the user's
    cache.
    """
    installed = not {"site-packages", "dist-packages"}.isdisjoint(PACKAGE.parts)
    own = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "soil_env"
    places = [own] if installed else [PACKAGE / "__pycache__", own]
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
    files = [PACKAGE / name for name in SOURCES if name.endswith(".py")]
    for name in SOURCES:
        files += (PACKAGE / name).rglob("*.py")
    return hashlib.sha256(b"".join(f.read_bytes() for f in sorted(files))).hexdigest()[:16]


class Kept:
    """A function that Python calls, compiled for the types that it gets and kept on disk.

    The first call in a process checks the files of the function, and compiles, or loads, under a
    lock. `py_func` is the function as Python runs it.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self._opened = False
        self._threads = threading.Lock()
        self._versions = 0  # compiled ones that the checksums hold
        _compilations.of.add(function)
        root = folder()
        self._folder = None
        if root is not None:
            self._folder = root / f"{function.__module__}.{function.__qualname__}"
        self._function = _compiled(function, self._folder)

    def __call__(self, *arguments: Any) -> Any:
        if not self._opened:
            return self._first_call(arguments)
        result = self._call(arguments)
        if len(self._function.overloads) != self._versions:
            with self._alone():
                self._note()
        return result

    def __reduce__(self) -> str:
        return self.__qualname__  # pickled by name

    def _first_call(self, arguments: tuple[Any, ...]) -> Any:
        with self._threads:
            if self._opened:  # by another thread
                return self._function(*arguments)
            with self._alone():
                loaded = self._check()
                try:
                    result = self._call(arguments)
                except Exception:
                    if not loaded or self._function.overloads:  # of the function itself
                        raise
                    self._drop()  # whole files that numba cannot load: nothing has run yet
                    result = self._call(arguments)
                self._opened = True
                self._note()
        return result

    def _call(self, arguments: tuple[Any, ...]) -> Any:
        try:
            return self._function(*arguments)
        except OSError as error:  # numba has compiled the function and cannot write it
            tell(f"compiled code cannot be kept: {error}")
            return self._function(*arguments)

    @contextmanager
    def _alone(self):
        """Wait until no other process compiles the function; on a disk without locks, go on."""
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
        """True if there are files to load; drop them if one is damaged, and say what is done."""
        if self._folder is None:
            tell("compiling in each process anew: compiled code cannot be kept without a folder")
            return False
        try:
            known = self._checksums()
            damaged = known is None or known != self._present()
        except OSError:  # a file that nobody may read, a folder or a link in its place
            damaged = True
        if damaged:
            self._drop()
        elif known:
            return COMPILED
        return False

    def _drop(self) -> None:
        """Delete the files of the function and say so; where one stays, none is kept any more."""
        assert self._folder is not None
        tell(f"compiled code in {self._folder} is damaged; it is dropped and compiled anew")
        shutil.rmtree(self._folder, ignore_errors=True)
        if self._folder.exists():
            self._folder = None
        self._function = _compiled(self.py_func, self._folder)

    def _note(self) -> None:
        """Write the checksums of the files that numba has written."""
        versions = len(self._function.overloads)
        if versions == self._versions:
            return
        self._versions = versions
        if self._folder is not None:
            with suppress(OSError):
                found = self._folder / CHECKSUMS
                partial = found.with_suffix(f".{os.getpid()}")
                partial.write_text(json.dumps(self._present()))
                partial.replace(found)

    def _checksums(self) -> dict[str, str] | None:
        """Checksums by file as they were written; empty before the first time, None if they cannot
        be read.
        """
        assert self._folder is not None
        try:
            known = json.loads((self._folder / CHECKSUMS).read_text())
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, RecursionError):
            return None
        return known if isinstance(known, dict) else None

    def _present(self) -> dict[str, str]:
        """Checksums by file as they are."""
        assert self._folder is not None
        files = sorted(self._folder.rglob("*.nb[ci]"))
        return {f.name: hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


_decorating = threading.Lock()  # while numba's setting of the cache folder is another one


def _compiled(function: Callable[..., Any], place: Path | None) -> Any:
    """Numba's dispatcher of a function, with its cache in the folder `place`."""
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
    """Print a line on stderr, once; not in workers of `multiprocessing`, whose parent says it, and
    not in tests.
    """
    if line not in _told and _speaks():
        _told.add(line)
        _say(line)


def _say(line: str) -> None:
    print(f"soil_env: {line}", file=sys.stderr, flush=True)


def _speaks() -> bool:
    """True in a process that tells the user what it compiles."""
    testing = "PYTEST_CURRENT_TEST" in os.environ
    return COMPILED and not testing and multiprocessing.parent_process() is None


class _Compilations(Listener):
    """Explains what somebody waits for: each version of a function that Python calls, while it is
    compiled, and none that is loaded.

    Numba tells the start and the end, and compiles for one thread at a time.
    """

    def __init__(self) -> None:
        self.of: set[Callable[..., Any]] = set()  # functions as Python runs them
        self._patience = 0.0
        self._done = threading.Event()
        self._watcher: threading.Thread | None = None

    def on_start(self, event: Event) -> None:
        function = event.data["dispatcher"].py_func
        if function in self.of and _speaks():
            self._done.clear()
            waiting = function, self._done, self._patience
            self._watcher = threading.Thread(target=_count, args=waiting, daemon=True)
            self._watcher.start()
            self._patience = PATIENCE

    def on_end(self, event: Event) -> None:
        if event.data["dispatcher"].py_func in self.of and self._watcher is not None:
            self._done.set()
            self._watcher.join()


_compilations = _Compilations()
register("numba:compile", _compilations)


def _count(function: Callable[..., Any], done: threading.Event, patience: float) -> None:
    """Say what takes longer than `patience` [s]: one line, or on a terminal, until it is done, how
    many of the functions that `function` calls are compiled.
    """
    if done.wait(patience):
        return
    if not sys.stderr.isatty():
        module = function.__module__.rpartition(".")[2]
        _say(f"compiling {module}.{function.__name__} {COMPILING}")
        return
    called = called_by(function)
    while not done.wait(PACE):
        ready = sum(bool(f.overloads) for f in called)
        text = f"compiling, at the first use only: {ready} of at most {len(called)} functions"
        print(f"\rsoil_env: {text}\x1b[K", end="", file=sys.stderr, flush=True)
    print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def called_by(function: Callable[..., Any]) -> set[Any]:
    """Compiled functions that a Python function names, directly or through one that it names."""
    found: set[Any] = set()
    left = [function]
    while left:
        one = left.pop()
        names = one.__code__.co_names
        known = [one.__globals__[name] for name in names if name in one.__globals__]
        for module in [thing for thing in known if isinstance(thing, ModuleType)]:
            known += [getattr(module, name) for name in names if hasattr(module, name)]
        for thing in known:
            if hasattr(thing, "overloads") and thing not in found:
                found.add(thing)
                left.append(thing.py_func)
    return found


def place() -> str:
    """Folder of the compiled code, in words."""
    found = folder()
    return "compiled code is not kept" if found is None else f"kept below {found}"
