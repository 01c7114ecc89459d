"""Resumable studies: the folder that says what is asked, the log of results, and the engines that do the tasks.

A study is a list of hashable tasks whose results follow from the task alone: tasks that draw random numbers draw them
from a seed of their own. A study that was interrupted or killed does the tasks whose results are missing, and no engine
makes a difference to the results.

An engine takes a picklable function and tasks, and yields (task, result) in the order in which they are done, each task
once. With `tell`, the function is called with the task and a function that passes numbers on to `tell`: progress
within a task (not on Ray). A worker that dies loses nothing but its task, which is given to another one.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import hashlib
import io
import json
import multiprocessing
import os
import signal
import socket
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator
from functools import partial
from multiprocessing.connection import wait
from pathlib import Path

import yaml

import soil_env
from soil_env._io.commands import whole_number
from soil_env._io.files import append_line, is_unused, make_folder, replace_file
from soil_env._io.loading import ParameterError, load, read_yaml, to_dict, unknown_value

from .progress import console

try:
    import fcntl
except ImportError:  # no POSIX: a log is then not locked
    fcntl = None

STUDY = "study.yaml"
ATTEMPTS = 4  # at a task whose worker has died
_AHEAD = 2  # tasks that wait for each CPU of a Ray cluster
_PATIENCE = 60.0  # [s] for workers to end after an interrupt: a training writes its checkpoint
_SINGLE_THREADED = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

Engine = Callable[..., Iterator[tuple]]  # (work, tasks, tell=None) -> (task, result)


# --- the folder -------------------------------------------------------------------------------------------------------


def fingerprint(files: Iterable[Path]) -> str:
    """Version of soil_env with a hash of the contents of `files`, to compare the code of two studies or machines."""
    return f"{soil_env.__version__}+{hashlib.sha256(b''.join(f.read_bytes() for f in files)).hexdigest()[:12]}"


def is_begun(study, folder: Path, ignored: Collection[str] = ()) -> bool:
    """Whether `folder` holds this study (a dataclass) already; `ignored` fields may differ.

    ParameterError where it holds another study or other files. Makes the folder.
    """
    path = Path(folder) / STUDY
    if not path.exists():
        if not is_unused(folder):
            raise ParameterError(f"{folder}: is not empty and holds no study; give another --out")
        make_folder(folder)
        return False
    begun, asked = read_yaml(path), yaml.safe_load(yaml.safe_dump(to_dict(study)))
    other = [key for key in asked if key not in ignored and begun.get(key) != asked[key]]
    if other:
        raise ParameterError(f"{folder}: holds another study (it differs in {', '.join(other)}); give another --out")
    return True


def save_study(study, folder: Path) -> None:
    """Write the study.yaml of a study."""
    replace_file(Path(folder) / STUDY, yaml.safe_dump(to_dict(study), sort_keys=False))


def load_study(cls, folder: Path, version: str):
    """The study of a folder, of dataclass `cls`; ParameterError where its `version` is that of other code."""
    path = Path(folder) / STUDY
    if not Path(folder).is_dir():
        raise ParameterError(f"{path}: no such folder; expected one that a study has written")
    study = load(cls, read_yaml(path), str(path))
    if study.version != version:
        raise ParameterError(f"{path}: begun with soil_env {study.version}, this is {version}: give another --out")
    return study


def save_csv(path: Path, rows: Iterable[Iterable[object]]) -> None:
    """A table as CSV; the first row is its heading."""
    text = io.StringIO(newline="")
    csv.writer(text).writerows(rows)
    replace_file(path, text.getvalue())


# --- the log ----------------------------------------------------------------------------------------------------------


class ResultLog:
    """Results of tasks in a file, a line of JSON each, held by one process at a time. Use with `with`.

    A line is on the disk when `add` returns. One that a crash has cut off is dropped when the log is opened. `parse`
    makes (task, result) of the content of a line; KeyError, TypeError or ValueError where it cannot,
    ParameterError where the file is that of another study.
    """

    def __init__(self, path: Path, parse: Callable[[dict], tuple]):
        self.path, self.parse = Path(path), parse
        self.results: dict = {}

    def __enter__(self) -> ResultLog:
        with contextlib.ExitStack() as stack:
            self._file = stack.enter_context(open(self.path, "a+b"))
            if fcntl is not None:
                try:
                    fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    raise ParameterError(f"{self.path}: another process is writing it") from None
            self._read()
            stack.pop_all()
        return self

    def __exit__(self, *error) -> None:
        self._file.close()

    def _read(self) -> None:
        self._file.seek(0)
        content = self._file.read()
        whole = content.rfind(b"\n") + 1
        for number, line in enumerate(content[:whole].splitlines(), 1):
            try:
                task, result = self.parse(json.loads(line))
                if task in self.results:
                    raise ValueError(f"{task} is there already")
            except ParameterError:
                raise
            except (ValueError, KeyError, TypeError) as error:
                raise ParameterError(
                    f"{self.path}: line {number} is damaged ({error}); delete the line to have it done again"
                ) from None
            self.results[task] = result
        self._file.truncate(whole)

    def add(self, content: dict) -> None:
        """Keep the result of a task; OSError leaves the file as it was."""
        task, result = self.parse(content)
        append_line(self.path, json.dumps(content, allow_nan=False))
        self.results[task] = result


# --- engines ----------------------------------------------------------------------------------------------------------


def add_options(parser: argparse.ArgumentParser, default: str) -> None:
    """--engine, --workers and --address; `default` says what is done without --workers."""
    parser.add_argument(
        "--engine", metavar="ENGINE", default="local", help="local or ray (default: local); the results are the same"
    )
    parser.add_argument(
        "--workers",
        metavar="N",
        type=whole_number(),
        help=f"processes of this machine (default: {default}; with ray: all processors)",
    )
    parser.add_argument(
        "--address", metavar="ADDRESS", help="of a Ray cluster (default: RAY_ADDRESS, else this machine)"
    )


def choose(engine: str, workers: int | None = None, address: str | None = None) -> Engine:
    """The engine that the options of `add_options` name; without `workers`, "local" means this process.

    Raises `ParameterError` where they do not fit together, or where there is no Ray or no cluster.
    """
    if workers is not None and workers < 1:
        raise ParameterError(f"--workers {workers}: expected a whole number >= 1")
    if engine == "ray":
        if address is not None and workers is not None:
            raise ParameterError("--workers: only without --address, whose cluster has its own")
        check_ray(address)
        return partial(on_ray, address=address, workers=workers)
    if engine != "local":
        raise unknown_value(engine, ("local", "ray"), "--engine")
    if address is not None:
        raise ParameterError("--address: only with --engine ray")
    return in_process if workers is None else partial(processes, workers=workers)


def in_process(work: Callable, tasks: Iterable, tell: Callable | None = None) -> Iterator[tuple]:
    """One task after the other in this process."""
    for task in tasks:
        yield task, work(task) if tell is None else work(task, tell)


class _Worker:
    """A process that does tasks, one at a time."""

    def __init__(self, work: Callable, telling: bool):
        context = multiprocessing.get_context("spawn")
        self.channel, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, work, telling), daemon=True)
        self.process.start()
        theirs.close()
        self.task = None
        self.busy = False

    def give(self, task) -> None:
        self.task, self.busy = task, True
        with contextlib.suppress(BrokenPipeError):  # it has died: seen when its answer is waited for
            self.channel.send(task)


def _serve(channel, work: Callable, telling: bool) -> None:
    """A worker process: do what comes through `channel`, until it is closed."""
    console.quiet = True
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is for the process that started this one,
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # which passes it on; a training then keeps a checkpoint
    more = (lambda *told: channel.send(("told", told)),) if telling else ()
    with contextlib.suppress(KeyboardInterrupt, EOFError, BrokenPipeError):
        while True:
            task = channel.recv()
            try:
                answer = "done", work(task, *more)
            except Exception as error:
                answer = "failed", error if isinstance(error, (ParameterError, OSError, MemoryError)) else repr(error)
            channel.send(answer)


def processes(work: Callable, tasks: Iterable, tell: Callable | None = None, *, workers: int) -> Iterator[tuple]:
    """`workers` processes of this machine, each single-threaded."""
    for name in _SINGLE_THREADED:
        os.environ.setdefault(name, "1")  # of the processes to come
    left, deaths = deque(tasks), Counter()
    pool = [_Worker(work, tell is not None) for _ in range(min(workers, len(left)))]
    try:
        while left or any(worker.busy for worker in pool):
            for worker in pool:
                if left and not worker.busy:
                    worker.give(left.popleft())
            ready = wait([worker.channel for worker in pool if worker.busy])
            for k, worker in enumerate(pool):
                if worker.channel not in ready:
                    continue
                try:
                    kind, value = worker.channel.recv()
                except (EOFError, ConnectionResetError):
                    worker.process.join()
                    _count_death(deaths, worker)
                    left.appendleft(worker.task)
                    pool[k] = _Worker(work, tell is not None)
                    continue
                if kind == "told":
                    tell(*value)
                elif kind == "failed":
                    raise value if isinstance(value, Exception) else RuntimeError(f"{worker.task}: {value}")
                else:
                    worker.busy = False
                    yield worker.task, value
    finally:
        _end(pool)


def _count_death(deaths: Counter, worker: _Worker) -> None:
    deaths[worker.task] += 1
    if deaths[worker.task] >= ATTEMPTS:
        raise ParameterError(
            f"--workers: {worker.task}: its process died {ATTEMPTS} times (last exit status "
            f"{worker.process.exitcode}); expected fewer workers"
        )


def _end(pool: list[_Worker]) -> None:
    """End processes; those at work have time to keep what they have."""
    for worker in pool:
        worker.channel.close()
        if worker.busy:
            worker.process.terminate()
    for worker in pool:
        worker.process.join(_PATIENCE)
        worker.process.kill()


# --- Ray --------------------------------------------------------------------------------------------------------------


def check_ray(address: str | None = None) -> None:
    """ParameterError with one line if Ray is not installed or nothing listens at `address` or RAY_ADDRESS.

    Ray itself tries an address for minutes.
    """
    try:
        import ray  # noqa: F401
    except ImportError:
        raise ParameterError("--engine ray: Ray is not installed; expected: pip install 'soil_env[ray]'") from None
    address = address or os.environ.get("RAY_ADDRESS")
    if address in (None, "", "auto", "local"):
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=10.0).close()
    except (OSError, ValueError) as error:
        raise ParameterError(f"--engine ray: no cluster at {address} ({error}); expected HOST:PORT") from None


def on_ray(
    work: Callable,
    tasks: Iterable,
    tell: Callable | None = None,
    *,
    address: str | None = None,
    workers: int | None = None,
) -> Iterator[tuple]:
    """Tasks of Ray Core on the cluster at `address`, else on the one that RAY_ADDRESS names, else on one started here.

    Every node needs this version of soil_env, and the modules of controllers given as module:Class. Each task takes
    one CPU. `workers` limits the CPUs of a cluster started here.
    """
    if tell is not None:
        raise ValueError("progress within a task is not passed on by Ray")
    check_ray(address)
    import ray

    ours = not ray.is_initialized()
    if ours:
        options = {"log_to_driver": False, "logging_level": "ERROR"}
        if address is not None or not os.environ.get("RAY_ADDRESS"):
            options["address"] = address or "local"  # not "auto": that tries one that died here for minutes
        if workers is not None:
            options["num_cpus"] = workers
        try:
            ray.init(**options)
        except (ConnectionError, ValueError, RuntimeError, OSError) as error:
            reason = (str(error).splitlines() or [""])[0][:200]
            raise ParameterError(f"--engine ray: no cluster at {address or 'this machine'} ({reason})") from None
    try:
        yield from _ray_tasks(ray, work, tasks)
    finally:
        if ours:
            ray.shutdown()


def _ray_tasks(ray, work, tasks):
    shared = ray.put(work)
    remote = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(_call)
    waiting, pending = deque((task, 1) for task in tasks), {}
    lost = (
        ray.exceptions.WorkerCrashedError,
        ray.exceptions.NodeDiedError,
        ray.exceptions.ObjectLostError,
        ray.exceptions.OutOfMemoryError,
        ray.exceptions.RaySystemError,
    )
    try:
        while waiting or pending:
            ahead = max(2, _AHEAD * int(ray.cluster_resources().get("CPU", 1)))
            while waiting and len(pending) < ahead:
                task, attempt = waiting.popleft()
                pending[remote.remote(shared, task)] = task, attempt
            done, _ = ray.wait(list(pending), num_returns=1, timeout=5.0)
            for reference in done:
                task, attempt = pending.pop(reference)
                try:
                    result = ray.get(reference)
                except ray.exceptions.RayTaskError as error:
                    if isinstance(error.cause, ParameterError):
                        raise ParameterError(str(error.cause)) from None
                    reason = (str(error).strip().splitlines() or [""])[-1][:200]
                    raise ParameterError(f"--engine ray: {task} failed ({reason})") from None
                except lost as error:
                    if attempt >= ATTEMPTS:
                        reason = (str(error).splitlines() or [""])[0][:200]
                        raise ParameterError(f"--engine ray: {task} was lost {attempt} times ({reason})") from None
                    waiting.append((task, attempt + 1))
                    continue
                yield task, result
    finally:
        for reference in pending:
            ray.cancel(reference, force=True)


def _call(work, task):
    return work(task)
