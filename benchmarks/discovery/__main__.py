"""Blind benchmark of discrepancy discovery: which mechanism is missing from the model of a wheel on soil?

    python -m benchmarks.discovery run --entrant workflow --seed 2027 --out DIR --jobs 16   draw, ask, score
    python -m benchmarks.discovery run --entrant bic --seed 2027 --out DIR --limit 200      the first 200, a fair sample
    python -m benchmarks.discovery run --set regimes --group regimes-two-rich-10 --entrant workflow --out DIR
    python -m benchmarks.discovery draw --seed 100001 --out DIR                             the cases only
    python -m benchmarks.discovery score --out DIR --publish docs/results                   scores of all answers in DIR
    python -m benchmarks.discovery list                                                     sets, groups and forms

An entrant is `workflow`, `bic`, `gls`, `pysindy`, or module:function, from the paths of data.csv and setup.yaml to a
benchmarks.discovery.entrants.Answer. The same command goes on with a run that was interrupted. Seed 2027 is the
reported one; develop with seeds from 100000 on.

DIR holds cases/NAME/data.csv and setup.yaml, truth/NAME.json, answers/ENTRANT/NAME.json, and study.json with set, seed
and generator.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
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

from threadpoolctl import threadpool_limits

import soil_env
from benchmarks.common import write
from benchmarks.discovery import score
from benchmarks.discovery.cases import GROUPS, SETS, draw_case, generator, task_of, tasks, write_case
from benchmarks.discovery.entrants import ENTRANTS, Answer, entrant
from benchmarks.discovery.forms import FORMS, UNLISTED
from soil_env._io.commands import command_line, command_parser, leave, whole_number
from soil_env._io.files import make_folder, write_json
from soil_env._io.loading import ParameterError, read_json

NAME = "benchmarks.discovery"
REPORTED = 2027  # the seed that is reported
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def begin(folder: Path, of: str, seed: int) -> None:
    """Make the folder of a study. Raises `ParameterError` if it holds another set, seed or generator."""
    make_folder(folder)
    _agree(folder / "study.json", {"set": of, "seed": seed, "generator": generator()}, "--out")


def describe(folder: Path, label: str, who: str) -> None:
    """Keep the entrant and the hashed sources of soil_env beside its answers. Raises `ParameterError` for others."""
    sources = sorted(Path(soil_env.__file__).parent.rglob("*.py"))
    digest = hashlib.sha256(b"".join(f.read_bytes() for f in sources)).hexdigest()[:12]
    about = {"entrant": who, "soil_env": f"{soil_env.__version__}+{digest}"}
    _agree(folder / "answers" / f"{label}.json", about, "--label")


def _agree(path: Path, about: dict, option: str) -> None:
    known = read_json(path) if path.exists() else about
    if known != about:
        raise ParameterError(f"{path}: of {known}, asked {about}: expected another {option}")
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, about)


def draw(seed: int, folder: Path, name: str) -> None:
    """Write the case of that name, unless it is there."""
    truth = folder / "truth" / f"{name}.json"
    if not truth.exists():
        write_case(draw_case(seed, task_of(name)), folder / "cases" / name, truth)


def ask(who: str, label: str, seed: int, folder: Path, name: str) -> None:
    """Draw a case if it is not there, ask the entrant in a folder that holds only the case, keep the answer."""
    draw(seed, folder, name)
    with tempfile.TemporaryDirectory() as place:
        shutil.copytree(folder / "cases" / name, place, dirs_exist_ok=True)
        begun = time.perf_counter()
        try:
            with threadpool_limits(1):
                answer = entrant(who)(Path(place) / "data.csv", Path(place) / "setup.yaml")
            answer = answer if isinstance(answer, Answer) else Answer.of(answer)
        except Exception as error:
            answer = Answer("error", note=f"{type(error).__name__}: {error}"[:300])
        seconds = round(time.perf_counter() - begun, 3)
    file = folder / "answers" / label / f"{name}.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    write_json(file, asdict(answer) | {"seconds": seconds})


def each(work: Callable[[str], object], names: Iterable[str], jobs: int) -> None:
    """Call `work` with every name in `jobs` processes; an interrupt loses only the cases in work."""
    names = list(names)
    if jobs == 1:
        for done, name in enumerate(names, start=1):
            work(name)
            print(f"{done}/{len(names)} {name}", file=sys.stderr, flush=True)
        return
    for name in THREADS:
        os.environ.setdefault(name, "1")  # of the workers, which take the cores
    pool = ProcessPoolExecutor(jobs, get_context("spawn"), signal.signal, (signal.SIGINT, signal.SIG_IGN))
    try:
        waiting = {pool.submit(work, name): name for name in names}
        for done, future in enumerate(as_completed(waiting), start=1):
            future.result()
            print(f"{done}/{len(names)} {waiting[future]}", file=sys.stderr, flush=True)
    except BrokenProcessPool:
        raise ParameterError("a process died (memory?): expected fewer --jobs, with the same command") from None
    except BaseException:
        for process in list((pool._processes or {}).values()):
            process.kill()  # answers are written whole or not at all
        raise
    pool.shutdown()


# --- commands ---------------------------------------------------------------------------------------------------------


def _names(options: argparse.Namespace) -> list[str]:
    chosen = [t for t in tasks(options.set, options.limit) if not options.group or t.group in options.group]
    return [t.name for t in chosen]


def _draw(options: argparse.Namespace) -> None:
    begin(options.out, options.set, options.seed)
    each(partial(draw, options.seed, options.out), _names(options), options.jobs)
    print(f"{options.out}: {len(_names(options))} cases of seed {options.seed}")


def _run(options: argparse.Namespace) -> None:
    label = options.label or re.sub(r"\W+", "_", options.entrant)[:40]
    entrant(options.entrant)  # before the work: that there is one
    begin(options.out, options.set, options.seed)
    describe(options.out, label, options.entrant)
    answers = options.out / "answers" / label
    left = [n for n in _names(options) if not (answers / f"{n}.json").exists()]
    each(partial(ask, options.entrant, label, options.seed, options.out), left, options.jobs)
    _score(options)


def _score(options: argparse.Namespace) -> None:
    about = read_json(options.out / "study.json")
    options.set = about["set"]
    labels = sorted(p.name for p in (options.out / "answers").glob("*") if p.is_dir())
    if not labels:
        raise ParameterError(f"{options.out}: no answers; expected those of a run")
    entrants = {}
    for label in labels:
        if records := score.read_records(options.out, label, _names(options)):
            entrants[label] = read_json(options.out / "answers" / f"{label}.json") | score.figures(records)
    place = options.publish or options.out
    make_folder(place)
    write_json(place / f"discovery_{options.set}.json", about | {"limit": options.limit, "entrants": entrants})
    write(place, "discovery", score.page_of(place))


def _list(options: argparse.Namespace) -> None:
    for name, groups in SETS.items():
        print(f"set {name}: {sum(g.count for g in groups)} cases")
        print("\n".join(f"  {g.name:28s} {g.count:4d}" for g in groups))
    for form in (*FORMS, *UNLISTED):
        effect = "(in no catalogue)" if form in UNLISTED else form.effect
        print(f"{effect:20s} {form.name:24s} {form.source.splitlines()[0]}")


def _parser() -> argparse.ArgumentParser:
    p = command_parser(f"python -m {NAME}", __doc__)
    parts = p.add_subparsers(required=True, metavar="COMMAND")
    for name, work, text in (
        ("run", _run, "ask an entrant and score it"), ("draw", _draw, "write the cases"),
        ("score", _score, "score the answers in a folder"), ("list", _list, "list sets, groups and forms"),
    ):  # fmt: skip
        q = parts.add_parser(name, help=text)
        q.set_defaults(work=work)
        if name == "list":
            continue
        q.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder of cases, truths and answers")
        q.add_argument("--limit", metavar="N", type=whole_number(1), help="only the first N cases, a fair sample")
        q.add_argument("--group", action="append", choices=GROUPS, default=[], metavar="GROUP",
                       help="only this group, see list; may be given several times")  # fmt: skip
        if name != "draw":
            q.add_argument("--publish", metavar="DIR", type=Path, help="folder of the scores (default: that of --out)")
        if name != "score":
            q.add_argument("--set", choices=SETS, default="laws", help="of the cases (default laws)")
            q.add_argument("--seed", metavar="N", type=whole_number(), default=REPORTED,
                           help=f"of the cases (default {REPORTED})")  # fmt: skip
            q.add_argument("--jobs", metavar="N", type=whole_number(1), default=1, help="processes (default 1)")
        if name == "run":
            q.add_argument("--entrant", required=True, help=f"{', '.join(ENTRANTS)} or module:function")
            q.add_argument("--label", metavar="NAME", help="of the folder of the answers (default: from --entrant)")
    return p


@command_line(NAME, interrupted="go on with the same command")
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    options = _parser().parse_args(arguments)
    try:
        options.work(options)
    except ValueError as error:
        raise error if isinstance(error, ParameterError) else ParameterError(str(error)) from None
    return 0


if __name__ == "__main__":
    leave(main())
