"""Cache of compiled code on disk: its place, its validity, and the process that fills it.

Of several processes that find it empty one compiles, and the others wait and load. The lock is a
file beside the compiled code; the system releases it when its process ends, however that ends.
Where nothing can be written, every process compiles for itself, and says so.
"""

import hashlib
import multiprocessing
import os
import pickle
import sys
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path

from filelock import FileLock, Timeout
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.compiler_lock import global_compiler_lock

#: Folders, with the folders in them, and files whose sources and constants compiled code is made
#: of.
_ROOMS = ("identification", "parameters")
_FILES = ("slip.py",)


@cache
def _sources() -> str:
    """Hash of the sources that compiled code may be made of."""
    package = Path(__file__).resolve().parents[3]
    rooms = (f for room in _ROOMS for f in (package / room).rglob("*.py"))
    files = sorted([*(package / name for name in _FILES), *rooms])
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()


#: What reading a damaged file, or one whose types are gone, raises.
_UNREADABLE = (
    ArithmeticError,
    AttributeError,
    EOFError,
    ImportError,
    LookupError,
    MemoryError,
    TypeError,
    ValueError,
    pickle.UnpicklingError,
)


class _Index(IndexDataCacheFile):
    """Index of the cached code of one function; one that is damaged, or of earlier sources, counts
    as empty.
    """

    def _load_index(self):
        try:
            return super()._load_index()
        except _UNREADABLE:
            return {}

    def load(self, key):
        try:
            return super().load(key)
        except _UNREADABLE:
            return None

    def save(self, key, data):
        try:
            super().save(key, data)
        except OSError as error:
            _tell(f"compiled code cannot be kept ({error}): every process will compile anew")


def _places(installed: bool) -> list[type]:
    """Classes by which numba looks for a folder, in turn: beside the sources last if the package is
    `installed`.

    Files beside an installed package outlive it: pip leaves them, and the folder with them hides an
    editable install.
    """
    return sorted(
        CompileResultCacheImpl._locator_classes, key=lambda c: installed and "InTree" in c.__name__
    )


class _Place(CompileResultCacheImpl):
    _locator_classes = _places(
        not {"site-packages", "dist-packages"}.isdisjoint(Path(__file__).parts)
    )


class _Cache(FunctionCache):
    _impl_class = _Place


def _nothing():
    pass


def _folder() -> Path | None:
    """The folder where numba keeps compiled code of this package; None where it finds none that it
    could write.
    """
    try:
        return Path(_Cache(_nothing)._cache_path)
    except RuntimeError:
        return None


_FOLDER = _folder()
#: True if compiled code is kept on disk; without a folder for it every process compiles anew.
CACHE = _FOLDER is not None


def place() -> str:
    """Folder of the compiled code, in words."""
    if _FOLDER is None:
        return "compiled code is not kept: no folder for it can be written"
    return f"kept below {_FOLDER.parents[1] if _FOLDER.name == '__pycache__' else _FOLDER.parent}"


def keep(dispatcher):
    """Turn on the cache of a dispatcher, valid for its options, its own file and the sources of all
    compiled rooms.
    """
    if CACHE:
        with suppress(RuntimeError):  # a function of no file
            store = dispatcher._cache = _Cache(dispatcher.py_func)
            own = hashlib.sha256(
                Path(dispatcher.py_func.__code__.co_filename).read_bytes()
            ).hexdigest()
            store._cache_file = _Index(
                cache_path=store._cache_path,
                filename_base=store._impl.filename_base,
                source_stamp=(_sources(), own, repr(dispatcher.targetoptions)),
            )
    dispatcher.compile = _Once(dispatcher)
    return dispatcher


def is_kept(dispatcher, signature: tuple) -> bool:
    """True if the cache holds compiled code of the function as it is now, for arguments of these
    types.
    """
    index = getattr(dispatcher._cache, "_cache_file", None)
    return index is not None and any(key[0] == signature for key in index._load_index())


class _Once:
    """`compile` of a dispatcher, in one process at a time where the code is kept."""

    _depth = 0  # roots that this process compiles at present; only under numba's own lock

    def __init__(self, dispatcher) -> None:
        self._dispatcher = dispatcher

    def __call__(self, signature):
        dispatcher = self._dispatcher
        compiled = type(dispatcher).compile
        with global_compiler_lock:
            if _Once._depth or signature in dispatcher.overloads or is_kept(dispatcher, signature):
                return compiled(dispatcher, signature)
            with _alone(_lock_of(dispatcher)):
                if not is_kept(dispatcher, signature):
                    _tell(_announcement())
                _Once._depth += 1
                try:
                    return compiled(dispatcher, signature)
                finally:
                    _Once._depth -= 1


def _lock_of(dispatcher) -> Path | None:
    """The lock file beside the code of a function; None where none is kept."""
    store = getattr(dispatcher._cache, "_impl", None)
    return (
        None
        if store is None
        else Path(dispatcher._cache._cache_path) / f"{store.filename_base}.lock"
    )


@contextmanager
def _alone(lock: Path | None):
    """Wait until no other process compiles the same function; without a cache, or on a disk without
    locks, go on.
    """
    with ExitStack() as held:
        if lock is not None:
            with suppress(OSError, NotImplementedError):
                try:
                    held.enter_context(FileLock(lock, timeout=0))
                except Timeout:
                    _tell("a second process compiles at the same time; waiting for it")
                    held.enter_context(FileLock(lock))
        yield


_told: set[str] = set()  # lines that this process has said


def _tell(line: str) -> None:
    """A line on stderr, once; not in workers of `multiprocessing`, whose parent says it, and not in
    tests.
    """
    if (
        line in _told
        or "PYTEST_CURRENT_TEST" in os.environ
        or multiprocessing.parent_process() is not None
    ):
        return
    _told.add(line)
    print(f"soil_env: {line}", file=sys.stderr, flush=True)


def _announcement() -> str:
    wanted = os.environ.get("NUMBA_CACHE_DIR")
    line = "compiling, at the first use only: some 20 s for each kind of environment, "
    line += "minutes on a loaded machine"
    if _FOLDER is None or (wanted and Path(wanted).resolve() not in _FOLDER.resolve().parents):
        line += f" (NUMBA_CACHE_DIR={wanted} cannot be written; {place()})"
    return line
