"""Draw the cases and ask an entrant, in several processes; a file for every case, so that a run can be gone on with.

A folder holds cases/NAME/data.csv and setup.yaml, truth/NAME.json, answers/ENTRANT/NAME.json and study.json, which says
of which seed it is. An entrant is given a copy of the two files of a case, in a folder of their own.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from benchmarks.blind.cases import write_case
from benchmarks.blind.entrants import Answer, entrant
from benchmarks.blind.sets import CaseSet, set_of, task_of
from soil_env._io.files import make_folder, replace_file

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def generator(of: CaseSet) -> str:
    """Hash of the code that the cases of a set follow from."""
    return hashlib.sha256(b"".join(f.read_bytes() for f in of.sources)).hexdigest()[:12]


def begin(folder: Path, seed: int, of: CaseSet) -> None:
    """Make the folder of a seed. Raises `ValueError` where it holds cases of another set, seed or generator."""
    make_folder(folder)
    path, about = folder / "study.json", {"set": of.name, "seed": seed, "generator": generator(of)}
    if path.exists():
        begun = json.loads(path.read_text(encoding="utf-8"))
        for key, value in about.items():
            if begun.get(key) != value:
                raise ValueError(
                    f"{folder}: holds cases of {key} {begun.get(key)}, not {value}: expected another --out"
                )
    else:  # several entrants may be asked at the same time
        _write(path, about)


def draw(seed: int, folder: Path, name: str) -> None:
    """Write the case of that name, unless it is there."""
    truth = folder / "truth" / f"{name}.json"
    if not truth.exists():
        write_case(set_of(name).draw(seed, task_of(name)), folder / "cases" / name, truth)


def ask(who: str, label: str, seed: int, folder: Path, name: str) -> float:
    """Draw a case if it is not there, ask the entrant, keep the answer; the time that the entrant took [s]."""
    draw(seed, folder, name)
    with tempfile.TemporaryDirectory() as place:
        for file in ("data.csv", "setup.yaml"):
            shutil.copy(folder / "cases" / name / file, place)
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            said = entrant(who)(Path(place) / "data.csv", Path(place) / "setup.yaml")
            said = said if isinstance(said, Answer) else Answer.of(said)
        except Exception as error:
            said = Answer("error", note=f"{type(error).__name__}: {error}"[:300])
        seconds = time.perf_counter() - wall
    spent = {"seconds": round(seconds, 3), "cpu": round(time.process_time() - cpu, 3)}
    _write(folder / "answers" / label / f"{name}.json", asdict(said) | spent)
    return seconds


def _write(path: Path, content: dict) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def describe(folder: Path, label: str, who: str) -> None:
    """Keep beside the answers who gave them and by what version of soil_env, its sources hashed."""
    import soil_env

    package = Path(soil_env.__file__).parent
    sources = hashlib.sha256(b"".join(f.read_bytes() for f in sorted(package.rglob("*.py")))).hexdigest()[:12]
    about = {"entrant": who, "soil_env": f"{soil_env.__version__}+{sources}"}
    path = folder / "answers" / f"{label}.json"
    if path.exists() and (begun := json.loads(path.read_text(encoding="utf-8"))) != about:
        raise ValueError(f"{path}: answers of {begun}, now {about}: expected another --label")
    _write(path, about)


def recorded(folder: Path) -> None:
    """Put the recorded answers (recorded/LABEL.jsonl, the first line says of what) to cases that are in the folder."""
    about = json.loads((folder / "study.json").read_text(encoding="utf-8"))
    for path in sorted((Path(__file__).parent / "recorded").glob("*.jsonl")):
        head, *lines = (json.loads(line) for line in path.read_text(encoding="utf-8").splitlines())
        if {key: head.pop(key) for key in about} != about:
            continue
        for line in lines:
            name = line.pop("case")
            place = folder / "answers" / path.stem / f"{name}.json"
            if (folder / "truth" / f"{name}.json").exists() and not place.exists():
                _write(place, line)
                _write(folder / "answers" / f"{path.stem}.json", head)


def answered(folder: Path, label: str) -> set[str]:
    """Names of the cases that an entrant has answered."""
    return {p.stem for p in (folder / "answers" / label).glob("*.json") if not p.name.startswith(".")}


def _quiet() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is for the process that started this one


def in_processes(work: Callable[[str], object], names: Iterable[str], jobs: int, say=None) -> None:
    """Call `work` with every name, in `jobs` processes of one thread; an interrupt loses the cases in work only."""
    names = list(names)
    say = say or partial(_progress, time.perf_counter())
    for name in THREADS:
        os.environ.setdefault(name, "1")
    if jobs == 1:
        for done, name in enumerate(names, start=1):
            work(name)
            say(done, len(names), name)
        return
    pool = ProcessPoolExecutor(jobs, get_context("spawn"), initializer=_quiet)
    try:
        waiting = {pool.submit(work, name): name for name in names}
        for done, future in enumerate(as_completed(waiting), start=1):
            future.result()
            say(done, len(names), waiting[future])
    except BrokenProcessPool:
        raise ValueError("a process died (memory?): go on with the same command, or with fewer --jobs") from None
    except BaseException:
        processes = list((pool._processes or {}).values())  # the pool forgets them
        pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.kill()  # answers are written whole or not at all
        raise
    pool.shutdown()


def _progress(begun: float, done: int, of: int, name: str) -> None:
    passed = time.perf_counter() - begun
    left = passed / done * (of - done)
    end = "\n" if done == of or not sys.stderr.isatty() else "\r"
    if end == "\r" or done == of or done % max(of // 50, 1) == 0:
        print(f"{done}/{of}  {passed:.0f} s, {left:.0f} s left  {name:30s}", end=end, file=sys.stderr, flush=True)
