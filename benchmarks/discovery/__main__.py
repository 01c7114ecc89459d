"""A benchmark of discrepancy discovery: which mechanism is missing from the model of a wheel on soil?

    python -m benchmarks.blind run --entrant workflow --seed 2027 --out DIR --jobs 16    draw, ask, score
    python -m benchmarks.blind run --entrant bic --seed 2027 --out DIR --limit 200       the first 200, a fair sample
    python -m benchmarks.blind run --set easy --entrant workflow --out DIR               listed forms on exact laws
    python -m benchmarks.blind draw --seed 100001 --out DIR                              the cases only
    python -m benchmarks.blind score --out DIR                                           scores of all answers in DIR
    python -m benchmarks.blind list                                                      groups and forms

Sets: laws; log_slip and regimes, whose law errors go otherwise with slip; easy, listed forms on exact laws.
An entrant is `workflow`, `bic`, `pysindy`, module:function (from two paths to benchmarks.blind.entrants.Answer), or a
command with {data} and {setup} that prints the answer as JSON. The same command goes on with a run that was
interrupted. Seed 2027 is the one that is reported; develop with seeds from 100000 on. docs/blind_benchmark.md says how
to enter.
"""

from __future__ import annotations

import argparse
import json
import os
import re
from functools import partial
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is loaded: the cores are taken by the workers

from benchmarks.blind import page, run, score
from benchmarks.blind.entrants import NAMES, entrant
from benchmarks.blind.forms import MECHANISMS, forms_of
from benchmarks.blind.sets import SETS
from benchmarks.blind.unlisted import UNLISTED
from soil_env._io.commands import command_line, command_parser, leave, whole_number
from soil_env._io.loading import ParameterError

NAME = "benchmarks.blind"


@command_line(NAME, interrupted="go on with the same command")
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = _parser().parse_args(arguments)
    try:
        return options.work(options)
    except ValueError as error:
        raise error if isinstance(error, ParameterError) else ParameterError(str(error)) from None


def _names(options: argparse.Namespace) -> list[str]:
    return [t.name for t in SETS[options.set].tasks(options.limit) if not options.group or t.group in options.group]


def _draw(options: argparse.Namespace) -> int:
    run.begin(options.out, options.seed, SETS[options.set])
    left = [n for n in _names(options) if not (options.out / "truth" / f"{n}.json").exists()]
    run.in_processes(partial(run.draw, options.seed, options.out), left, options.jobs)
    print(f"{options.out}: {len(_names(options))} cases of seed {options.seed}")
    return 0


def _run(options: argparse.Namespace) -> int:
    label = options.label or re.sub(r"\W+", "_", options.entrant)[:40]
    entrant(options.entrant)  # before the work: that there is one
    run.begin(options.out, options.seed, SETS[options.set])
    run.describe(options.out, label, options.entrant)
    done = run.answered(options.out, label)
    left = [n for n in _names(options) if n not in done]
    run.in_processes(partial(run.ask, options.entrant, label, options.seed, options.out), left, options.jobs)
    return _score(options)


def _score(options: argparse.Namespace) -> int:
    try:
        about = json.loads((options.out / "study.json").read_text(encoding="utf-8"))
    except OSError as error:
        raise ParameterError(f"{options.out}: no study ({error.strerror}); expected the folder of a run") from None
    options.set = about.get("set", "laws")
    of = SETS[options.set]
    run.recorded(options.out)
    labels = sorted(p.name for p in (options.out / "answers").glob("*") if p.is_dir())
    if not labels:
        raise ParameterError(f"{options.out}: no answers; expected those of a run")
    names = _names(options)
    result = {**about, "limit": options.limit, "entrants": {}}
    for label in labels:
        records = score.read_records(options.out, label, names)
        if records:
            about = options.out / "answers" / f"{label}.json"
            known = json.loads(about.read_text(encoding="utf-8")) if about.exists() else {}
            result["entrants"][label] = known | score.figures(records, of)
            result["groups"] = score.group_counts(records, of)
    page.write(result, options.publish or options.out)
    print(page.summary(result))
    print(f"written: {(options.publish or options.out) / page.stem(of.name)}.md, .json and pictures")
    return 0


def _list(options: argparse.Namespace) -> int:
    for of in SETS.values():
        print(f"set {of.name}")
        for group in of.groups.values():
            print(f"{group.name:28s} {group.count:4d} cases")
        print(f"{'in all':28s} {of.in_all:4d}\n")
    for mechanism in MECHANISMS:
        for form in forms_of(mechanism):
            print(f"{mechanism:20s} {form.name:24s} {form.source.splitlines()[0]}")
    for form in UNLISTED:
        print(f"{'(in no catalogue)':20s} {form.name:24s} {form.source.splitlines()[0]}")
    return 0


def _parser() -> argparse.ArgumentParser:
    p = command_parser(f"python -m {NAME}", __doc__)
    known = [group for of in SETS.values() for group in of.groups]
    parts = p.add_subparsers(required=True, metavar="COMMAND")
    for name, work, text in (
        ("run", _run, "ask an entrant and score it"), ("draw", _draw, "write the cases"),
        ("score", _score, "score the answers in a folder"), ("list", _list, "what there is"),
    ):  # fmt: skip
        q = parts.add_parser(name, help=text)
        q.set_defaults(work=work)
        if name == "list":
            continue
        q.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder of cases, truths and answers")
        q.add_argument("--limit", metavar="N", type=whole_number(1), help="only the first N cases, a fair sample")
        if name in ("run", "score"):
            q.add_argument("--publish", metavar="DIR", type=Path, help="folder of the scores (default: that of --out)")
        q.add_argument("--group", action="append", choices=known, default=[], metavar="GROUP",
                       help="only this group, see list; may be given several times")  # fmt: skip
        if name != "score":
            q.add_argument("--set", choices=list(SETS), default="laws", help="of the cases (default laws)")
            q.add_argument("--seed", metavar="N", type=whole_number(), default=page.REPORTED,
                           help=f"of the cases (default {page.REPORTED}, the reported one)")  # fmt: skip
            q.add_argument("--jobs", metavar="N", type=whole_number(1), default=1, help="processes (default 1)")
        if name == "run":
            q.add_argument(
                "--entrant", metavar="WHO", required=True, help=f"{', '.join(NAMES)}, module:function or a command"
            )
            q.add_argument("--label", metavar="NAME", help="of the folder of the answers (default: from --entrant)")
    return p


if __name__ == "__main__":
    leave(main())
