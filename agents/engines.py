"""Where tasks are done: here, in processes of this machine, or on a Ray cluster.

An engine takes a picklable function and a list of hashable tasks, and yields (task, result) in the order in which they
are done, each task once. Tasks that draw random numbers draw them from a seed of their own, so that the engine makes
no difference to the results. A worker that is killed loses nothing: its task is given to another one.
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import os
import signal
import socket
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path

import soil_env
from soil_env._io.loading import ParameterError, unknown_key

ATTEMPTS = 4  # at a task whose worker has died
_AHEAD = 2  # tasks a worker has waiting

Engine = Callable[[Callable, Iterable], Iterator[tuple]]


def add_options(parser: argparse.ArgumentParser, default: str) -> None:
    """--engine, --workers and --address; `default` says what is done without --workers."""
    parser.add_argument(
        "--engine", metavar="ENGINE", default="local", help="local or ray (default: local); the results are the same"
    )
    parser.add_argument(
        "--workers",
        metavar="N",
        type=int,
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
        raise unknown_key(engine, ("local", "ray"), "--engine")
    if address is not None:
        raise ParameterError("--address: only with --engine ray")
    return in_process if workers is None else partial(processes, workers=workers)


def fingerprint(files: Iterable[Path]) -> str:
    """Version of soil_env with a hash of the contents of `files`, for telling whether two machines have one code."""
    return f"{soil_env.__version__}+{hashlib.sha256(b''.join(f.read_bytes() for f in files)).hexdigest()[:12]}"


def in_process(work: Callable, tasks: Iterable) -> Iterator[tuple]:
    """One task after the other in this process."""
    for task in tasks:
        yield task, work(task)


# --- processes --------------------------------------------------------------------------------------------------------

_work: Callable | None = None  # of this worker process


def _begin(work: Callable) -> None:
    global _work
    _work = work
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is for the process that writes the results


def _do(task):
    return _work(task)


def processes(work: Callable, tasks: Iterable, workers: int) -> Iterator[tuple]:
    """`workers` processes of this machine."""
    left = dict.fromkeys(tasks)
    deaths = 0
    while left:
        pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _begin, (work,))
        try:
            waiting, pending = deque(left), {}
            while waiting or pending:
                while waiting and len(pending) < _AHEAD * workers:
                    task = waiting.popleft()
                    pending[pool.submit(_do, task)] = task
                done, _ = wait(pending, return_when=FIRST_COMPLETED)
                for future in done:
                    result, task = future.result(), pending.pop(future)
                    del left[task]
                    deaths = 0
                    yield task, result
        except BrokenProcessPool:
            deaths += 1
            if deaths >= ATTEMPTS:
                raise ParameterError(
                    f"--workers {workers}: worker processes died {deaths} times in a row; expected fewer workers"
                ) from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


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


def on_ray(work: Callable, tasks: Iterable, address: str | None = None, workers: int | None = None) -> Iterator[tuple]:
    """Tasks of Ray Core on the cluster at `address`, else on the one that RAY_ADDRESS names, else on one started here.

    Every node needs this version of soil_env, and the modules of controllers given as module:Class. Each task takes
    one CPU. `workers` limits the CPUs of a cluster started here.
    """
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
