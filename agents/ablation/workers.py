"""The steps of a study, one after the other in this process or side by side in processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterable
from multiprocessing.connection import wait
from pathlib import Path

from soil_env._io.loading import ParameterError

from .. import training
from .study import Ablation, Step, perform

ATTEMPTS = 3  # at a step whose process has died
_PATIENCE = 60.0  # [s] for processes to write their checkpoints after an interrupt


def here(study: Ablation, folder: Path, todo: Iterable[Step], progress: Callable[[int], None], ended) -> None:
    """One step after the other; `progress` is told environment steps, `ended` each step."""
    for step in todo:
        perform(study, folder, step, progress)
        ended(step)


def _serve(channel, study: Ablation, folder: Path) -> None:
    """A worker process: perform what comes through `channel` until None comes."""
    training.console.quiet = True
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a training then writes its checkpoint
    try:
        while (step := channel.recv()) is not None:
            try:
                perform(study, folder, step, lambda count: channel.send(("progress", count)))
                channel.send(("ended", None))
            except (ParameterError, OSError, MemoryError) as error:
                channel.send(("failed", f"{type(error).__name__}: {error}" if not str(error) else str(error)))
    except (KeyboardInterrupt, EOFError, BrokenPipeError):
        pass


class _Worker:
    """A process and what it is at."""

    def __init__(self, study: Ablation, folder: Path):
        context = multiprocessing.get_context("spawn")
        self.channel, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, study, folder), daemon=True)
        self.process.start()
        theirs.close()
        self.step: Step | None = None

    def give(self, step: Step) -> None:
        self.step = step
        self.channel.send(step)


def processes(
    study: Ablation, folder: Path, todo: Iterable[Step], progress: Callable[[int], None], ended, count: int
) -> None:
    """`count` processes, each single-threaded. A step whose process dies is begun again, from its last checkpoint."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # of the processes to come
    left, deaths = deque(todo), {}
    workers = [_Worker(study, folder) for _ in range(min(count, len(left)))]
    try:
        for worker in workers:
            worker.give(left.popleft())
        while busy := [w for w in workers if w.step is not None]:
            ready = wait([w.channel for w in busy])
            for worker in [w for w in busy if w.channel in ready]:
                _hear(worker, left, progress, ended, deaths)
                if worker.step is None and left:
                    if not worker.process.is_alive():
                        workers.remove(worker)
                        worker = _Worker(study, folder)
                        workers.append(worker)
                    worker.give(left.popleft())
    finally:
        for worker in workers:
            if worker.step is not None and worker.process.is_alive():
                worker.process.terminate()
            elif worker.process.is_alive():
                worker.channel.send(None)
        for worker in workers:
            worker.process.join(_PATIENCE)
            if worker.process.is_alive():
                worker.process.kill()


def _hear(worker: _Worker, left: deque, progress, ended, deaths: dict) -> None:
    """Take one message of a worker; a step that it has died of goes back to the front."""
    try:
        kind, value = worker.channel.recv()
    except (EOFError, ConnectionResetError):
        worker.process.join()
        step, worker.step = worker.step, None
        deaths[step] = deaths.get(step, 0) + 1
        if deaths[step] >= ATTEMPTS:
            code = worker.process.exitcode
            raise ParameterError(f"{step}: its process died {ATTEMPTS} times (last exit status {code})") from None
        left.appendleft(step)
        return
    if kind == "progress":
        progress(value)
    elif kind == "failed":
        raise ParameterError(f"{worker.step}: {value}")
    else:
        step, worker.step = worker.step, None
        ended(step)
