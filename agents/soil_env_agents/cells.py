"""Resumable work: the folder of a study, one file for each finished cell, and the engines that do
the cells.

A study is a list of hashable cells whose results follow from the cell alone. A study that was
interrupted or killed does the cells whose files are missing, and every engine gives the same
results.

An engine takes a picklable function and cells, and yields (cell, result) in the order in which they
are done, each cell once. A worker that dies loses its cell, which is done again.
"""

import contextlib
import functools
import hashlib
import importlib.metadata
import json
import multiprocessing
import os
import signal
import socket
from collections import Counter, deque
from collections.abc import Callable, Collection, Generator, Hashable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import TypeVar

import yaml

import soil_env
from soil_env._io.files import is_unused, make_folder, replace_file
from soil_env._io.loading import ParameterError, load, one_line, read_yaml, to_dict, unknown_value
from soil_env.cli.running import end_with_parent

from .progress import console, show

STUDY = "study.yaml"
MADE_FROM = "made_from"  # key of a finished cell: digest of all that it depends on
ATTEMPTS = 4  # at a cell whose worker has died
# Environment variables with the number of threads of numerical libraries: 1 in `processes`.
_SINGLE_THREADED = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)

#: (work, cells) -> (cell, result).
Engine = Callable[[Callable, Iterable], Generator[tuple, None, None]]
Cell = TypeVar("Cell", bound=Hashable)


#: Libraries whose rounding and random numbers results depend on.
_NUMERICAL = ("numpy", "numba", "scipy", "torch", "stable-baselines3", "optuna")


@functools.cache
def code_version() -> str:
    """Version of soil_env, then a hash, "VERSION+HASH": of the code and weights of soil_env and of
    this package, and of the versions of `_NUMERICAL`.

    Results are kept only as long as it stays the same.
    """
    here = Path(soil_env.__file__).parent
    there = Path(__file__).parent
    weights = [*sorted(here.rglob("immobilisation.json")), *sorted(there.glob("*.npz"))]
    files = [*sorted(here.rglob("*.py")), *weights, *sorted(there.rglob("*.py"))]
    content = b"".join(f.read_bytes() for f in files)
    for name in _NUMERICAL:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            content += f"{name} {importlib.metadata.version(name)}".encode()
    digest = hashlib.sha256(content).hexdigest()
    return f"{soil_env.__version__}+{digest[:12]}"


class OtherStudy(ParameterError):
    """A folder holds a study that a command began here, but another one than is asked for."""


def is_begun(study, folder: Path, ignored: Collection[str]) -> bool:
    """True if `folder` holds this study (a dataclass) already; False if it is unused. A missing
    folder is made.

    `ignored` fields and the version of the code may differ.

    `OtherStudy` where it holds another study, `ParameterError` where it holds other files.
    """
    path = folder / STUDY
    if not path.exists():
        if not is_unused(folder):
            raise ParameterError(f"{folder}: is not empty and holds no study; give another --out")
        make_folder(folder)
        return False
    begun = read_yaml(path)
    if "version" not in begun:  # which every study that a command began has
        raise ParameterError(
            f"{path}: is a file of yours, no study that was begun here: give another --out, or "
            "move the file to another folder"
        )
    asked = yaml.safe_load(yaml.safe_dump(to_dict(study)))  # as it would be read from the file
    other = [
        key for key in asked if key not in ("version", *ignored) and begun.get(key) != asked[key]
    ]
    if other:
        raise OtherStudy(
            f"{folder}: holds another study (it differs in {', '.join(other)}); give another --out"
        )
    return True


def save_study(study, folder: Path) -> None:
    """Write the study.yaml of a study."""
    replace_file(folder / STUDY, yaml.safe_dump(to_dict(study), sort_keys=False))


def load_study(cls, folder: Path, check: Callable[[dict, str], None] | None = None):
    """The study of a folder, of dataclass `cls`. For one that was begun with other code it is
    `study.renewed(code_version())`, with a line of output.

    `check` receives the content and the path of its file before anything is made of it.
    ParameterError where there is no folder, or no such study in it.
    """
    path = folder / STUDY
    if not folder.is_dir():
        raise ParameterError(
            f"{folder}: no such folder; expected that of a begun {cls.__name__.lower()}"
        )
    content = read_yaml(path)
    if check is not None:
        check(content, str(path))
    study = load(cls, content, str(path))
    here = code_version()
    if study.version == here:
        return study
    show(
        f"{path}: begun with soil_env {study.version}, this is {here}, by other code or another "
        f"{', '.join(_NUMERICAL[:-1])} or {_NUMERICAL[-1]}: what is done counts no more."
    )
    return study.renewed(here)


def cell_file(folder: Path, cell: Hashable) -> Path:
    """Path of the file of a finished cell: its name with - for each /, .json, in the folder
    `cells`.
    """
    return folder / "cells" / f"{str(cell).replace('/', '-')}.json"


def read_cell(folder: Path, cell: Hashable, parse: Callable):
    """What `parse` makes of the content of a finished cell, a mapping without `MADE_FROM`;
    ParameterError where the file is damaged.
    """
    path = cell_file(folder, cell)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        content.pop(MADE_FROM, None)
        return parse(content)
    # `parse` meets whatever damaged JSON holds in place of its numbers and mappings.
    except (
        ArithmeticError,
        AttributeError,
        LookupError,
        RecursionError,
        TypeError,
        ValueError,
    ) as error:
        raise ParameterError(
            f"{path}: is damaged ({error}); delete it to have it done again"
        ) from None


def fill(
    work: Callable,
    cells: Iterable[Cell],
    folder: Path,
    engine: Engine,
    progress: Callable[[Cell], None],
    needs: Callable[[Cell], object] = lambda cell: None,
    found: Callable[[Cell], None] | None = None,
) -> None:
    """Do the cells without a file, and those made from something else than `needs` says now. Each
    result is written to its `cell_file` at once.

    `work` gives the content of a cell's file, a mapping, and `needs` the plain values on which it
    depends. `progress` receives every finished cell; those that were there already go to `found`,
    if given.
    """
    missing = []
    stale = 0  # cells that have a file and are done again
    made_from = {}
    for cell in cells:
        made_from[cell] = digest_of(needs(cell))
        path = cell_file(folder, cell)
        if _made_from(path) == made_from[cell]:
            (found or progress)(cell)
        else:
            stale += path.is_file()
            missing.append(cell)
    if stale:
        show(
            "Finished parts that are damaged, or made from what has changed since, are done again: "
            f"{stale}."
        )
    (folder / "cells").mkdir(parents=True, exist_ok=True)
    with contextlib.closing(engine(work, missing)) as results:
        for cell, content in results:
            kept = {MADE_FROM: made_from[cell], **content}
            replace_file(cell_file(folder, cell), json.dumps(kept, allow_nan=False))
            progress(cell)


def is_done(folder: Path, cell: Cell, needs: Callable[[Cell], object]) -> bool:
    """True if a cell has a file that was made from what `needs` says now."""
    return _made_from(cell_file(folder, cell)) == digest_of(needs(cell))


def digest_of(needed: object) -> str:
    """Digest of plain values, 16 hexadecimal digits; the order of keys does not matter."""
    return hashlib.sha256(json.dumps(needed, sort_keys=True).encode()).hexdigest()[:16]


def _made_from(path: Path) -> str | None:
    """Digest of what the file of a finished cell was made from; None if there is no file, or if it
    is damaged or has none.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8")).get(MADE_FROM)
    except (FileNotFoundError, ValueError, AttributeError, RecursionError):
        return None


def choose(engine: str, workers: int | None = None, address: str | None = None) -> Engine:
    """The engine of the options of `cli.engine_options`: `on_ray` for "ray"; for "local"
    `processes`, or `in_process` without `workers`.

    ParameterError where the options do not fit together, or where there is no Ray or no cluster.
    """
    if workers is not None and workers < 1:
        raise ParameterError(f"--workers {workers}: expected a whole number >= 1")
    if engine == "ray":
        if address is not None and workers is not None:
            raise ParameterError("--workers: only without --address, whose cluster has its own")
        _check_ray(address)
        return partial(on_ray, address=address, workers=workers)
    if engine != "local":
        raise unknown_value(engine, ("local", "ray"), "--engine")
    if address is not None:
        raise ParameterError("--address: only with --engine ray")
    return in_process if workers is None else partial(processes, workers=workers)


def in_process(work: Callable, cells: Iterable) -> Generator[tuple, None, None]:
    """Engine that does one cell after the other in this process."""
    for cell in cells:
        yield cell, work(cell)


class _Worker:
    """State of a worker process (`processes`): attributes of the class, set by `_begin`."""

    work: Callable
    busy = False  # with a cell, so that SIGTERM interrupts it


def _begin(work: Callable) -> None:
    """Begin a worker process: keep its `work`, print nothing, and end where the parent is killed.

    Only the parent interrupts it, by SIGTERM: KeyboardInterrupt in the work, so that a training
    writes its checkpoint. Between cells the signal is ignored.
    """

    def interrupt(*_) -> None:
        """Handler of SIGTERM."""
        if _Worker.busy:
            raise KeyboardInterrupt

    console.quiet = True
    _Worker.work = work
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, interrupt)
    end_with_parent()


@contextlib.contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
    """Hold SIGINT back inside the block, and in processes started there until `_begin` ignores it.

    Without it Ctrl-C of a terminal, which reaches all processes, would interrupt their imports.
    Where signals cannot be blocked, as on Windows, nothing is held back.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _call(cell):
    """Result of a cell, in a worker process."""
    _Worker.busy = True
    try:
        return _Worker.work(cell)
    finally:
        _Worker.busy = False


def processes(work: Callable, cells: Iterable, *, workers: int) -> Generator[tuple, None, None]:
    """Engine of `workers` processes of this machine, each single-threaded.

    Where a process dies, all are ended, and the cells under way are done anew by others. The
    `ATTEMPTS`-th death while the same cell is under way is a ParameterError.
    """
    for name in _SINGLE_THREADED:
        os.environ.setdefault(name, "1")  # of the processes to come
    left = deque(cells)
    deaths: Counter[Hashable] = Counter()  # of processes, by the cell that they were at
    while left:
        others = multiprocessing.active_children()  # of this process, but not of the pool
        running: dict[Future, Hashable] = {}
        pool = ProcessPoolExecutor(
            min(workers, len(left)), multiprocessing.get_context("spawn"), _begin, (work,)
        )
        try:
            while left or running:
                while left and len(running) < workers:
                    with _ctrl_c_held_back():
                        future = pool.submit(_call, left[0])
                    running[future] = left.popleft()
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    result = future.result()
                    yield running.pop(future), result
        except BrokenProcessPool:
            deaths.update(running.values())
            left.extendleft(running.values())
            for cell in left:
                if deaths[cell] >= ATTEMPTS:
                    raise ParameterError(
                        f"{cell}: its process died {ATTEMPTS} times (memory?): expected fewer "
                        "processes, with the same command"
                    ) from None
        finally:
            if running:  # it ends before its cells: by a dead process, an error or an interrupt
                for child in set(multiprocessing.active_children()) - set(others):
                    child.terminate()
            pool.shutdown(cancel_futures=True)


def _check_ray(address: str | None) -> None:
    """ParameterError if Ray is not installed, or if nothing listens at `address`, by default that
    of RAY_ADDRESS. Without this check Ray would try for minutes.

    Without an address, and for "auto" and "local", nothing is tried.
    """
    try:
        import ray  # noqa: F401
    except ImportError:
        raise ParameterError(
            "--engine ray: Ray is not installed; expected: pip install 'soil_env[ray]'"
        ) from None
    address = address or os.environ.get("RAY_ADDRESS")
    if address in (None, "", "auto", "local"):
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=10.0).close()
    except (OSError, ValueError) as error:
        raise ParameterError(
            f"--engine ray: no cluster at {address} ({error}); expected HOST:PORT"
        ) from None


def on_ray(
    work: Callable, cells: Iterable, *, address: str | None = None, workers: int | None = None
) -> Generator[tuple, None, None]:
    """Engine of Ray Core tasks on the cluster at `address`, else on that of RAY_ADDRESS, else on
    one started here.

    Every node needs this version of soil_env, and the modules of controllers given as module:Class.
    Each cell takes one CPU. `workers` limits the CPUs of a cluster started here. ParameterError
    where there is no cluster, where a cell fails, and where it is lost `ATTEMPTS` times.
    """
    import ray

    ours = not ray.is_initialized()
    if ours:
        options = {"log_to_driver": False, "logging_level": "ERROR"}
        if address is not None or not os.environ.get("RAY_ADDRESS"):
            # Not "auto", by which Ray tries for minutes to reach a cluster that died here.
            options["address"] = address or "local"
        if workers is not None:
            options["num_cpus"] = workers
        try:
            ray.init(**options)
        except (ConnectionError, ValueError, RuntimeError, OSError) as error:
            where = address or "this machine"
            raise ParameterError(
                f"--engine ray: no cluster at {where} ({one_line(error)})"
            ) from None
    running: dict = {}
    try:
        shared = ray.put(work)
        remote = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(_on_node)
        running = {remote.remote(shared, code_version(), cell): cell for cell in cells}
        while running:
            (done,), _ = ray.wait(list(running), num_returns=1)
            cell = running.pop(done)
            try:
                result = ray.get(done)
            except ray.exceptions.RayTaskError as error:
                if isinstance(error.cause, ParameterError):
                    raise ParameterError(str(error.cause)) from None
                raise ParameterError(
                    f"--engine ray: {cell} failed ({one_line(error, -1)})"
                ) from None
            except ray.exceptions.RayError as error:
                raise ParameterError(f"--engine ray: {cell} was lost ({one_line(error)})") from None
            yield cell, result
    finally:
        for reference in running:
            ray.cancel(reference, force=True)
        if ours:
            ray.shutdown()


def _on_node(work: Callable, version: str, cell):
    """Result of a cell, in a task of Ray; ParameterError where the node has another `version`."""
    if version != code_version():
        raise ParameterError(f"a worker has soil_env {code_version()}, the study {version}")
    return work(cell)
