"""How often the discrepancy workflow finds what is missing: the easy set, tables in which an effect is hidden.

    python -m benchmarks.blind.easy                     all cases, 15 minutes on two cores; writes docs/discrepancy*
    python -m benchmarks.blind.easy --resume            goes on after an interrupt
    python -m benchmarks.blind.easy --engine ray        on a Ray cluster (--address); this clone on its PYTHONPATH
    python -m benchmarks.blind.easy --cases 60 --out X  fewer of each sort, the same ones
    python -m benchmarks.blind.easy --page              renews page and plots from the figures of the last run
    python -m benchmarks.blind.easy --smoke --out X     a case of each sort in seconds, numbers without meaning

Cases come from `benchmarks.blind.easy.cases`, which shares no code with the model; the workflow is given the table and
the setup of each and nothing else. A case follows from the seed, its group and its number alone. Each is kept as a line
of the records (runs/blind/seed-N.jsonl) as soon as it is done, so an interrupt loses the cases in work at most.
"""

from __future__ import annotations

import argparse
import json
from functools import partial
from importlib.metadata import version
from pathlib import Path

from rich.console import Console

from agents import studies
from agents.progress import Bar
from benchmarks.blind.easy import page as blind_page
from benchmarks.blind.easy.judge import figures
from benchmarks.blind.easy.study import IN_ALL, Task, solve, tasks
from benchmarks.common import ROOT, machine, machine_text
from soil_env._io.commands import command_line, command_parser, whole_number
from soil_env._io.files import make_folder, replace_file
from soil_env._io.loading import ParameterError

NAME = "benchmarks.blind.easy"
HERE = Path(__file__).parent
ABOUT = None  # key of the line of the records that says what they are of
FOLLOWS_FROM = (  # besides discrepancy
    "_io/loading.py", "_numba", "identification/priors.py", "identification/weighted.py", "measurement",
    "parameters.py", "terramechanics",
)  # fmt: skip
#: Modules of discrepancy (beside report/) and of the benchmark from which no record follows.
APART = ("__main__", "cmu", "law_tests", "command", "judge", "page", "plots")


def code_version() -> str:
    """Version of soil_env, with a hash of the code that the records follow from."""
    package = ROOT / "soil_env"
    files = [
        *(package / "discrepancy").glob("*.py"),
        *HERE.glob("*.py"),
        HERE.parent / "world.py",
        HERE.parent / "effect.py",
    ]
    files = [f for f in files if f.stem not in APART]
    for name in FOLLOWS_FROM:
        files += (package / name).glob("*.py") if (package / name).is_dir() else [package / name]
    return studies.fingerprint(sorted(files))


def log_of(path: Path, about: dict, resume: bool) -> studies.ResultLog:
    """The cases that are done by (group, index), and what they are of by `ABOUT`, the first line of the file."""
    if path.exists() and path.stat().st_size and not resume:
        raise ParameterError(f"{path}: holds cases already; expected --resume to go on, or another --records")

    def parse(content: dict) -> tuple:
        if "group" in content:
            return (content["group"], content["index"]), content
        other = [key for key in about if content[key] != about[key]]
        if other:
            raise ParameterError(
                f"{path}: holds cases of another {' and '.join(other)} ({content[other[0]]}, now {about[other[0]]}); "
                "expected another --records"
            )
        return ABOUT, content

    path.parent.mkdir(parents=True, exist_ok=True)
    return studies.ResultLog(path, parse)


# --- the command ------------------------------------------------------------------------------------------------------


def study(options: argparse.Namespace, console: Console) -> dict:
    """Do the cases that are not done yet; the result as discrepancy.json has it."""
    local = options.engine == "local"
    workers = 2 if local and options.workers is None else options.workers
    engine = studies.choose(options.engine, None if local and workers == 1 else workers, options.address)
    make_folder(options.out)
    about = {"seed": options.seed, "smoke": options.smoke, "code": code_version()}
    path = options.records or (
        options.out / "cases.jsonl" if options.smoke else ROOT / "runs" / "blind" / f"seed-{options.seed}.jsonl"
    )
    wanted = tasks(options.cases, options.smoke)
    with log_of(path, about, options.resume) as log:
        if ABOUT not in log.results:
            log.add(about)
        left = [t for t in wanted if (t.group, t.index) not in log.results]
        done = engine(partial(_solve, options.seed, about["code"]), left)
        with Bar("Blind cases", len(wanted), "cases", len(wanted) - len(left), console) as bar:
            for task, record in done:
                log.add(record)
                bar.update(advance=1, note=task.group)
    cases = [log.results[key] for key in sorted((t.group, t.index) for t in wanted)]
    ran_on = machine_text(machine() | {"load": None, "scipy": version("scipy")}, "numpy", "scipy", "numba")
    asked = "" if options.cases == IN_ALL else f" --cases {options.cases}"
    return {
        "command": f"python -m {NAME} --seed {options.seed}" + (" --smoke" if options.smoke else asked),
        **about,
        "machine": f"{ran_on}; {f'{workers} workers' if local else 'Ray'}",
        "figures": figures(cases),
        "cases": cases,
    }


def _solve(seed: int, code: str, task: Task) -> dict:
    """`solve`, where the worker has the code that the records are of."""
    if code != code_version():
        raise ParameterError(f"a worker has code {code_version()}, the study {code}")
    return solve(seed, task)


def read_result(path: Path) -> dict:
    """discrepancy.json, its figures made anew from its cases. Raises `ParameterError` where it cannot be read."""
    try:
        result = json.loads(path.read_text(encoding="utf-8"))
        return result | {"figures": figures(result["cases"])}
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read ({error.strerror}); expected the result of a run") from None
    except (ValueError, KeyError, TypeError):
        raise ParameterError(f"{path}: is not the result of a run") from None


def write_result(result: dict, folder: Path) -> None:
    """discrepancy.json with one line a case, the page and its plots."""
    head = json.dumps({k: v for k, v in result.items() if k != "cases"}, indent=1, allow_nan=False)
    lines = ",\n".join(json.dumps(r, allow_nan=False) for r in result["cases"])
    text = head.removesuffix("\n}") + ',\n "cases": [\n' + lines + "\n]}\n"
    blind_page.write(result, folder)
    replace_file(folder / "discrepancy.json", text)


@command_line(NAME, interrupted="go on with the same command and --resume")
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = _parser().parse_args(arguments)
    console = Console()
    result = read_result(options.out / "discrepancy.json") if options.page else study(options, console)
    write_result(result, options.out)
    console.print(blind_page.summary(result), markup=False, highlight=False, soft_wrap=True)
    console.print(f"Written: {options.out / 'discrepancy.md'}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _parser() -> argparse.ArgumentParser:
    p = command_parser(f"python -m {NAME}", __doc__)
    p.add_argument(
        "--cases", type=whole_number(1), default=IN_ALL, metavar="N", help=f"cases in all, about (default {IN_ALL})"
    )
    p.add_argument("--seed", type=whole_number(), default=0, metavar="N", help="of the cases, >= 0 (default 0)")
    p.add_argument(
        "--out", type=Path, default=ROOT / "docs", metavar="OUT",
        help="folder of discrepancy.json, .md and plots (default: docs of the clone)",
    )  # fmt: skip
    studies.add_options(p, "2; 1 is this one")
    p.add_argument("--records", type=Path, metavar="FILE", help="of the cases done (default runs/blind/seed-N.jsonl)")
    p.add_argument("--resume", action="store_true", help="go on with the cases that the records do not have yet")
    p.add_argument("--smoke", action="store_true", help="a case of each sort in seconds")
    p.add_argument("--page", action="store_true", help="no cases: page and plots from discrepancy.json in --out")
    return p
